//! Decodes pictures: raw rows and picture files, checked against the size that they should have before memory is
//! allocated. Knows no camera.

use super::demosaic::{BayerOrder, demosaic};
use super::{Grid, RgbImage};
use ::image::codecs::bmp::BmpDecoder;
use ::image::codecs::png::PngDecoder;
use ::image::codecs::pnm::PnmDecoder;
use ::image::codecs::tiff::TiffDecoder;
use ::image::metadata::Orientation;
use ::image::{ColorType, DynamicImage, ImageDecoder};
use rayon::prelude::*;
use std::io::Cursor;
use std::panic::{AssertUnwindSafe, catch_unwind};
use zune_core::bytestream::ZCursor;
use zune_core::colorspace::ColorSpace;
use zune_core::options::DecoderOptions;
use zune_jpeg::JpegDecoder;

/// Why a picture cannot be decoded.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum DecodeError {
    /// An encoding that is not read here.
    #[error("the picture's encoding is {found:?}, expected {expected}")]
    Encoding {
        found: String,
        expected: &'static str,
    },
    /// Not the size it should have.
    #[error("the picture's size is {}x{}, expected {}x{} pixels", found.0, found.1, expected.0, expected.1)]
    Size {
        /// Width and height that were there.
        found: (usize, usize),
        /// Width and height it should have.
        expected: (usize, usize),
    },
    /// Rows closer together than they are long.
    #[error("the row step is {found} bytes, expected at least {expected}")]
    Step {
        /// Bytes from row to row.
        found: usize,
        /// Bytes of a row.
        expected: usize,
    },
    /// Too few bytes.
    #[error("the picture's data has {found} bytes, expected {expected}")]
    Short { found: usize, expected: usize },
    /// A picture file that is broken.
    #[error("the {format} data is broken: {reason}")]
    Broken {
        format: &'static str,
        /// What the decoder said.
        reason: String,
    },
}

/// Rows of pixels as they came.
#[derive(Clone, Copy, Debug)]
pub struct RawPixels<'a> {
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// Name of the encoding.
    pub encoding: &'a str,
    /// Bytes from one row's start to the next's.
    pub step: usize,
    /// The rows; the last may end with its last pixel.
    pub data: &'a [u8],
}

impl<'a> RawPixels<'a> {
    /// Checks that there are `size` pixels of `bytes` bytes.
    fn check(&self, size: (usize, usize), bytes: usize) -> Result<(), DecodeError> {
        let found = (self.width, self.height);
        if found != size || self.width == 0 || self.height == 0 {
            return Err(DecodeError::Size {
                found,
                expected: size,
            });
        }
        let row = self.width * bytes;
        if self.step < row {
            return Err(DecodeError::Step {
                found: self.step,
                expected: row,
            });
        }
        let expected = self
            .step
            .saturating_mul(self.height - 1)
            .saturating_add(row);
        if self.data.len() < expected {
            return Err(DecodeError::Short {
                found: self.data.len(),
                expected,
            });
        }
        Ok(())
    }

    /// Row `y` of pixels of `N` bytes.
    fn row<const N: usize>(&self, y: usize) -> &'a [[u8; N]] {
        let start = y * self.step;
        self.data[start..start + N * self.width].as_chunks().0
    }

    /// Makes a picture of pixels that stand for themselves.
    fn map<const N: usize, T: Default + Copy + Send>(
        &self,
        size: (usize, usize),
        f: impl Fn([u8; N]) -> T + Sync,
    ) -> Result<Grid<T>, DecodeError> {
        self.check(size, N)?;
        let mut pixels = vec![T::default(); self.width * self.height];
        let rows = pixels.par_chunks_mut(self.width).enumerate();
        rows.with_min_len(64).for_each(|(y, out)| {
            for (out, &bytes) in out.iter_mut().zip(self.row::<N>(y)) {
                *out = f(bytes);
            }
        });
        Ok(Grid::from_pixels(self.width, self.height, pixels))
    }

    /// Makes a picture of pairs of pixels that share their chroma; `order` gives y0, u, y1, v.
    fn yuv(
        &self,
        size: (usize, usize),
        order: impl Fn([u8; 4]) -> [u8; 4] + Sync,
    ) -> Result<RgbImage, DecodeError> {
        // An odd width would split a pair; cameras have none.
        if !self.width.is_multiple_of(2) {
            return Err(DecodeError::Encoding {
                found: format!("{} of odd width {}", self.encoding, self.width),
                expected: "an even width",
            });
        }
        self.check(size, 2)?;
        let mut pixels = vec![[0; 3]; self.width * self.height];
        let rows = pixels.par_chunks_mut(self.width).enumerate();
        rows.with_min_len(64).for_each(|(y, out)| {
            let start = y * self.step;
            let (pairs, _) = self.data[start..start + 2 * self.width].as_chunks::<4>();
            for (out, &bytes) in out.as_chunks_mut::<2>().0.iter_mut().zip(pairs) {
                let [y0, u, y1, v] = order(bytes);
                *out = [rgb_from_yuv(y0, u, v), rgb_from_yuv(y1, u, v)];
            }
        });
        Ok(Grid::from_pixels(self.width, self.height, pixels))
    }
}

/// BT.601, limited range, with 8 fractional bits.
#[inline(always)]
fn rgb_from_yuv(y: u8, u: u8, v: u8) -> [u8; 3] {
    let y = 298 * (i32::from(y) - 16) + 128;
    let (u, v) = (i32::from(u) - 128, i32::from(v) - 128);
    let channel = |sum: i32| (sum >> 8).clamp(0, 255) as u8;
    [
        channel(y + 409 * v),
        channel(y - 100 * u - 208 * v),
        channel(y + 516 * u),
    ]
}

const COLOR_ENCODINGS: &str = "bayer_rggb8, bayer_bggr8, bayer_gbrg8, bayer_grbg8, rgb8, bgr8, mono8, \
                               yuv422_yuy2, yuyv, uyvy or yuv422";

/// Enough of a hostile name to find it, and no more.
fn unknown(found: &str, expected: &'static str) -> DecodeError {
    DecodeError::Encoding {
        found: found.chars().take(40).collect(),
        expected,
    }
}

/// Makes colours of raw rows; `size` is the width and height they should have.
///
/// # Errors
/// If the encoding is not read, or size, step or data do not fit; so for all that follow.
pub fn rgb_from_raw(raw: &RawPixels<'_>, size: (usize, usize)) -> Result<RgbImage, DecodeError> {
    let bayer = |order| {
        raw.check(size, 1)?;
        Ok(demosaic(raw.width, raw.height, raw.step, raw.data, order))
    };
    match raw.encoding {
        "bayer_rggb8" => bayer(BayerOrder::RGGB),
        "bayer_bggr8" => bayer(BayerOrder::BGGR),
        "bayer_gbrg8" => bayer(BayerOrder::GBRG),
        "bayer_grbg8" => bayer(BayerOrder::GRBG),
        "rgb8" => raw.map(size, |rgb: [u8; 3]| rgb),
        "bgr8" => raw.map(size, |[b, g, r]: [u8; 3]| [r, g, b]),
        "mono8" => raw.map(size, |[grey]: [u8; 1]| [grey; 3]),
        "yuv422_yuy2" | "yuyv" => raw.yuv(size, |yuyv| yuyv),
        "uyvy" | "yuv422" => raw.yuv(size, |[u, y0, v, y1]| [y0, u, y1, v]),
        other => Err(unknown(other, COLOR_ENCODINGS)),
    }
}

/// Makes grey values of raw `mono8` rows.
pub fn grey_from_raw(raw: &RawPixels<'_>, size: (usize, usize)) -> Result<Grid<u8>, DecodeError> {
    match raw.encoding {
        "mono8" => raw.map(size, |[grey]: [u8; 1]| grey),
        other => Err(unknown(other, "mono8")),
    }
}

/// Makes depth readings of raw `16UC1` rows, little endian.
pub fn readings_from_raw(
    raw: &RawPixels<'_>,
    size: (usize, usize),
) -> Result<Grid<u16>, DecodeError> {
    match raw.encoding {
        "16UC1" => raw.map(size, u16::from_le_bytes),
        other => Err(unknown(other, "16UC1")),
    }
}

/// Formats of picture files, as errors name them.
const FILE_FORMATS: &str = "jpeg, png, tiff, bmp or pnm (pbm, pgm, ppm)";
/// Longest side in pixels of a picture file.
const LONGEST_SIDE: usize = 1 << 14;
/// The EXIF orientation of a picture that is shown as it is stored.
pub const AS_STORED: u8 = 1;

/// Makes colours of a picture file; grey becomes three equal channels, more than 8 bits are rounded to 8,
/// transparency is dropped, orientation is ignored.
pub fn rgb_from_file(
    format: &str,
    data: &[u8],
    size: (usize, usize),
) -> Result<RgbImage, DecodeError> {
    match format {
        "jpeg" | "jpg" => guarded("jpeg", || rgb_from_jpeg(data, size)),
        _ => lossless(format, data, size, |picture| rgb_of(picture, size)),
    }
}

/// Makes grey values of a picture file of any camera, to find a board in it. Of 16 bits a channel it takes 8, from the
/// highest one that the brightest pixel uses: cameras of 10 or 12 bits leave those above empty. Orientation is ignored.
pub fn grey_of_used_bits(
    format: &str,
    data: &[u8],
    size: (usize, usize),
) -> Result<Grid<u8>, DecodeError> {
    let rgb = match format {
        "jpeg" | "jpg" => rgb_from_file(format, data, size),
        _ => lossless(format, data, size, |picture| {
            rgb_of(without_unused_bits(picture), size)
        }),
    };
    rgb.map(|rgb| grey_from_rgb(&rgb))
}

/// Decodes a file of another format than JPEG, and makes something of its picture.
fn lossless<T>(
    format: &str,
    data: &[u8],
    size: (usize, usize),
    make: impl FnOnce(DynamicImage) -> T,
) -> Result<T, DecodeError> {
    if format == "png" {
        return guarded("png", || decode_png(data, size).map(make));
    }
    let format = other_format(format)?;
    guarded(format, || decode_other(format, data, size).map(make))
}

fn rgb_of(picture: DynamicImage, size: (usize, usize)) -> RgbImage {
    let pixels = picture.into_rgb8().into_raw().as_chunks().0.to_vec();
    Grid::from_pixels(size.0, size.1, pixels)
}

/// A picture of 16 bits a channel, multiplied by the largest power of two that leaves its brightest pixel within 16
/// bits; any other as it is.
fn without_unused_bits(picture: DynamicImage) -> DynamicImage {
    let has_16_bits = matches!(
        picture.color(),
        ColorType::L16 | ColorType::La16 | ColorType::Rgb16 | ColorType::Rgba16
    );
    if !has_16_bits {
        return picture;
    }
    // Without transparency, which would count as bright.
    let mut picture = picture.into_rgb16();
    let brightest = picture.iter().copied().max().unwrap_or_default();
    if brightest > 0 {
        let unused = brightest.leading_zeros();
        picture.iter_mut().for_each(|value| *value <<= unused);
    }
    DynamicImage::ImageRgb16(picture)
}

/// Makes grey values of a picture file.
pub fn grey_from_file(
    format: &str,
    data: &[u8],
    size: (usize, usize),
) -> Result<Grid<u8>, DecodeError> {
    match format {
        "png" => guarded("png", || {
            let picture = decode_png(data, size)?.into_luma8().into_raw();
            Ok(Grid::from_pixels(size.0, size.1, picture))
        }),
        other => Ok(rgb_from_file(other, data, size)?.map(|&[_, green, _]| green)),
    }
}

/// Runs another library's decoder on bytes that are not trusted: should it panic after
/// all, the picture is broken and the program goes on.
fn guarded<T>(
    format: &'static str,
    decode: impl FnOnce() -> Result<T, DecodeError>,
) -> Result<T, DecodeError> {
    catch_unwind(AssertUnwindSafe(decode)).unwrap_or_else(|_| {
        Err(DecodeError::Broken {
            format,
            reason: "the decoder gave up".into(),
        })
    })
}

fn broken(format: &'static str, reason: &impl ToString) -> DecodeError {
    DecodeError::Broken {
        format,
        reason: reason.to_string().chars().take(200).collect(),
    }
}

fn rgb_from_jpeg(data: &[u8], size: (usize, usize)) -> Result<RgbImage, DecodeError> {
    // Strict, because data that end early would else be shown as grey.
    let options = DecoderOptions::default()
        .set_strict_mode(true)
        .set_max_width(LONGEST_SIDE)
        .set_max_height(LONGEST_SIDE)
        .jpeg_set_max_scans(32)
        .jpeg_set_out_colorspace(ColorSpace::RGB);
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(data), options);
    decoder.decode_headers().map_err(|e| broken("jpeg", &e))?;
    check_size(decoder.dimensions().unwrap_or_default(), size)?;
    if !data.windows(2).rev().any(|w| w == [0xff, 0xd9]) {
        return Err(broken("jpeg", &"cut off: there is no end of image"));
    }
    let mut pixels = vec![[0u8; 3]; size.0 * size.1];
    if decoder.output_buffer_size() != Some(3 * pixels.len()) {
        return Err(broken("jpeg", &"its colours cannot be made RGB"));
    }
    decoder
        .decode_into(pixels.as_flattened_mut())
        .map_err(|e| broken("jpeg", &e))?;
    Ok(Grid::from_pixels(size.0, size.1, pixels))
}

fn decode_png(data: &[u8], size: (usize, usize)) -> Result<DynamicImage, DecodeError> {
    let mut limits = ::image::Limits::default();
    // Four channels of 16 bits and some room for what goes with them.
    limits.max_alloc = Some(8 * (size.0 as u64 * size.1 as u64) + (16 << 20));
    let decoder = PngDecoder::with_limits(Cursor::new(data), limits.clone())
        .map_err(|e| broken("png", &e))?;
    let (width, height) = decoder.dimensions();
    check_size((width as usize, height as usize), size)?;
    DynamicImage::from_decoder(decoder).map_err(|e| broken("png", &e))
}

/// Formats of picture files that no camera sends, by their name or by the ending of their files.
fn other_format(format: &str) -> Result<&'static str, DecodeError> {
    match format {
        "tiff" | "tif" => Ok("tiff"),
        "bmp" => Ok("bmp"),
        "pnm" | "pbm" | "pgm" | "ppm" => Ok("pnm"),
        other => Err(unknown(other, FILE_FORMATS)),
    }
}

/// Reads the header of such a file.
fn other_decoder<'a>(
    format: &'static str,
    data: &'a [u8],
) -> Result<Box<dyn ImageDecoder + 'a>, DecodeError> {
    let bytes = Cursor::new(data);
    let decoder: Box<dyn ImageDecoder + 'a> = match format {
        "bmp" => Box::new(BmpDecoder::new(bytes).map_err(|e| broken(format, &e))?),
        "tiff" => Box::new(TiffDecoder::new(bytes).map_err(|e| broken(format, &e))?),
        _ => Box::new(PnmDecoder::new(bytes).map_err(|e| broken(format, &e))?),
    };
    let (width, height) = decoder.dimensions();
    match width.max(height) as usize > LONGEST_SIDE {
        true => Err(broken(format, &"it is larger than any picture")),
        false => Ok(decoder),
    }
}

fn decode_other(
    format: &'static str,
    data: &[u8],
    size: (usize, usize),
) -> Result<DynamicImage, DecodeError> {
    let mut decoder = other_decoder(format, data)?;
    let (width, height) = decoder.dimensions();
    check_size((width as usize, height as usize), size)?;
    let mut limits = ::image::Limits::default();
    // Four channels of 32 bits, and some room for what is unpacked.
    limits.max_alloc = Some(16 * (size.0 as u64 * size.1 as u64) + (16 << 20));
    decoder.set_limits(limits).map_err(|e| broken(format, &e))?;
    DynamicImage::from_decoder(decoder).map_err(|e| broken(format, &e))
}

fn check_size(found: (usize, usize), expected: (usize, usize)) -> Result<(), DecodeError> {
    if found == expected {
        return Ok(());
    }
    Err(DecodeError::Size { found, expected })
}

/// Encodes colours that are proportional to light as sRGB (IEC 61966-2-1).
pub fn encode_linear_as_srgb(picture: &mut RgbImage) {
    let encoded = |value: usize| super::srgb::encode(value as f32 / 255.0).round() as u8;
    let table: [u8; 256] = std::array::from_fn(encoded);
    let bytes = picture.pixels_mut().as_flattened_mut();
    bytes.par_chunks_mut(1 << 16).for_each(|part| {
        for byte in part {
            *byte = table[usize::from(*byte)];
        }
    });
}

/// Width and height of a picture file, from its header.
pub fn size_of_file(format: &str, data: &[u8]) -> Result<(usize, usize), DecodeError> {
    match format {
        "jpeg" | "jpg" => guarded("jpeg", || {
            let mut decoder = JpegDecoder::new(ZCursor::new(data));
            decoder.decode_headers().map_err(|e| broken("jpeg", &e))?;
            let size = decoder.dimensions();
            size.ok_or_else(|| broken("jpeg", &"its header has no size"))
        }),
        "png" => guarded("png", || {
            let decoder = PngDecoder::new(Cursor::new(data)).map_err(|e| broken("png", &e))?;
            let (width, height) = decoder.dimensions();
            Ok((width as usize, height as usize))
        }),
        other => {
            let format = other_format(other)?;
            guarded(format, || {
                let (width, height) = other_decoder(format, data)?.dimensions();
                Ok((width as usize, height as usize))
            })
        }
    }
}

/// How a picture file says that it is to be shown: its EXIF orientation, from 1 (as it is stored) to 8; 1 if it says
/// nothing, or cannot be read.
pub fn orientation_of_file(format: &str, data: &[u8]) -> u8 {
    let found = match format {
        "jpeg" | "jpg" => guarded("jpeg", || {
            let mut decoder = JpegDecoder::new(ZCursor::new(data));
            decoder.decode_headers().map_err(|e| broken("jpeg", &e))?;
            let exif = decoder.exif().map(Vec::as_slice);
            Ok(exif.and_then(Orientation::from_exif_chunk))
        }),
        "png" => guarded("png", || {
            let decoder = PngDecoder::new(Cursor::new(data)).map_err(|e| broken("png", &e))?;
            Ok(stated_orientation(decoder))
        }),
        other => other_format(other).and_then(|format| {
            guarded(format, || {
                let decoder = other_decoder(format, data)?;
                Ok(stated_orientation(decoder))
            })
        }),
    };
    found.ok().flatten().map_or(AS_STORED, Orientation::to_exif)
}

fn stated_orientation(mut decoder: impl ImageDecoder) -> Option<Orientation> {
    decoder.orientation().ok()
}

/// How bright each pixel is: the mean of its channels, green counted twice.
pub fn grey_from_rgb(picture: &RgbImage) -> Grid<u8> {
    picture.map(|&[r, g, b]| ((u16::from(r) + 2 * u16::from(g) + u16::from(b) + 2) / 4) as u8)
}
