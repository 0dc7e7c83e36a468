//! JPEG on all cores: a picture is cut into strips, each is encoded by itself, and their scans are joined by
//! restart markers (ITU-T T.81, B.2.4.4 and E.1.4) into one ordinary baseline file.

use super::Error;
use crate::image::RgbImage;
use jpeg_encoder::{ColorType, Encoder, EncodingError, SamplingFactor};
use rayon::prelude::*;

/// Side of a block in pixels.
const BLOCK: usize = 8;
/// Strips that a picture is cut into, at most; a matter of its size alone, so that bytes stay the same.
const MOST_STRIPS: usize = 16;

/// Encodes a picture without subsampling its colour. `quality` is 1 to 100.
///
/// # Errors
/// If the picture has no pixels or is larger than JPEG can hold.
pub fn encode(picture: &RgbImage, quality: u8) -> Result<Vec<u8>, Error> {
    let (width, height) = (picture.width(), picture.height());
    if !(1..=65_535).contains(&width) || !(1..=65_535).contains(&height) {
        return Err(Error::BadModel {
            what: "atlas",
            found: format!("{width}x{height}"),
            expected: "1 to 65535 pixels a side".into(),
        });
    }
    let blocks_across = width.div_ceil(BLOCK);
    let rows_of_blocks = height
        .div_ceil(BLOCK)
        .div_ceil(MOST_STRIPS)
        .clamp(1, 65_535 / blocks_across);
    let strips: Vec<Vec<u8>> = picture
        .pixels()
        .par_chunks(width * rows_of_blocks * BLOCK)
        .map(|pixels| strip(pixels.as_flattened(), width, quality))
        .collect::<Result<_, EncodingError>>()
        .map_err(Error::Jpeg)?;
    join(&strips, height, blocks_across * rows_of_blocks).ok_or_else(|| Error::BadModel {
        what: "atlas",
        found: "a JPEG strip without a frame or a scan".into(),
        expected: "baseline JPEG".into(),
    })
}

/// The quality with which [`encode`] wrote a file; `None` if another program wrote it.
pub fn quality(file: &[u8]) -> Option<u8> {
    let tables = tables(file);
    let sample = [0; BLOCK * BLOCK * 3];
    (1..=100).rev().find(|&quality| {
        let written = strip(&sample, BLOCK, quality);
        !tables.is_empty() && written.is_ok_and(|written| self::tables(&written) == tables)
    })
}

/// The tables of quantization before the first scan.
fn tables(file: &[u8]) -> Vec<&[u8]> {
    let mut tables = Vec::new();
    let mut at = 2;
    while let Some(&[0xff, marker, high, low]) = file.get(at..at + 4)
        && marker != 0xda
    {
        let next = at + 2 + usize::from(u16::from_be_bytes([high, low]));
        if marker == 0xdb {
            tables.extend(file.get(at + 4..next));
        }
        at = next;
    }
    tables
}

fn strip(pixels: &[u8], width: usize, quality: u8) -> Result<Vec<u8>, EncodingError> {
    let mut bytes = Vec::with_capacity(pixels.len() / 8);
    let height = pixels.len() / 3 / width;
    let mut encoder = Encoder::new(&mut bytes, quality.clamp(1, 100));
    encoder.set_sampling_factor(SamplingFactor::R_4_4_4);
    encoder.encode(pixels, width as u16, height as u16, ColorType::Rgb)?;
    Ok(bytes)
}

/// One file of strips that hold `interval` blocks each: the first one's head, made as high as all, and the
/// scans with a restart marker after each but the last.
fn join(strips: &[Vec<u8>], height: usize, interval: usize) -> Option<Vec<u8>> {
    let head = Head::of(strips.first()?)?;
    let mut file = strips[0][..head.scan_header].to_vec();
    file[head.height..head.height + 2].copy_from_slice(&(height as u16).to_be_bytes());
    file.extend_from_slice(&[0xff, 0xdd, 0, 4]);
    file.extend_from_slice(&(interval as u16).to_be_bytes());
    file.extend_from_slice(&strips[0][head.scan_header..head.scan]);
    for (index, strip) in strips.iter().enumerate() {
        if index > 0 {
            file.extend_from_slice(&[0xff, 0xd0 + ((index - 1) % 8) as u8]);
        }
        let scan = Head::of(strip)?.scan;
        file.extend_from_slice(strip.get(scan..strip.len() - 2)?);
    }
    file.extend_from_slice(&[0xff, 0xd9]);
    Some(file)
}

/// Where the parts of a JPEG file lie.
struct Head {
    /// The frame's height, two bytes.
    height: usize,
    /// The marker that begins the scan's header.
    scan_header: usize,
    /// The scan's first byte.
    scan: usize,
}

impl Head {
    /// Walks the segments up to the scan.
    fn of(file: &[u8]) -> Option<Self> {
        let mut at = 2;
        let mut height = None;
        loop {
            let &[0xff, marker, high, low] = file.get(at..at + 4)? else {
                return None;
            };
            let next = at + 2 + usize::from(u16::from_be_bytes([high, low]));
            match marker {
                0xc0 => height = Some(at + 5),
                0xda => {
                    return Some(Self {
                        height: height?,
                        scan_header: at,
                        scan: next,
                    });
                }
                _ => {}
            }
            at = next;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::rgb_from_file;

    fn picture(width: usize, height: usize) -> RgbImage {
        RgbImage::from_fn(width, height, |x, y| {
            let wave = |k: f32| 127.0 + 100.0 * ((x as f32 * k).sin() * (y as f32 * 0.11).cos());
            [wave(0.07) as u8, wave(0.13) as u8, (x * y % 251) as u8]
        })
    }

    #[test]
    fn strips_decode_to_what_one_piece_decodes_to() {
        for (width, height) in [(1, 1), (7, 300), (640, 123), (33, 1025), (2000, 16)] {
            let picture = picture(width, height);
            let whole = strip(picture.pixels().as_flattened(), width, 90).unwrap();
            let joined = encode(&picture, 90).unwrap();
            let decode = |bytes: &[u8]| rgb_from_file("jpeg", bytes, (width, height)).unwrap();
            assert_eq!(decode(&whole), decode(&joined), "{width}x{height}");
        }
    }

    #[test]
    fn a_file_tells_its_quality() {
        for quality in [1, 50, 72, 90, 100] {
            let file = encode(&picture(40, 300), quality).unwrap();
            assert_eq!(super::quality(&file), Some(quality));
        }
        assert_eq!(super::quality(b"\xff\xd8"), None);
        assert_eq!(
            super::quality(b"\xff\xd8\xff\xdb\0\x04aa\xff\xda\0\x02"),
            None
        );
    }

    #[test]
    fn what_jpeg_cannot_hold_is_refused() {
        assert!(encode(&RgbImage::default(), 90).is_err());
        assert!(encode(&RgbImage::filled(70_000, 1, [0; 3]), 90).is_err());
    }
}
