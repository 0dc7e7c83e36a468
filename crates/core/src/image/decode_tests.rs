//! Every encoding, and every way a picture can be broken.

use super::decode::*;
use super::{Grid, RgbImage};
use ::image::{DynamicImage, ImageBuffer, ImageFormat, Luma, Rgb};
use jpeg_encoder::{ColorType, Encoder};
use std::io::Cursor;

fn raw<'a>(size: (usize, usize), encoding: &'a str, step: usize, data: &'a [u8]) -> RawPixels<'a> {
    RawPixels {
        width: size.0,
        height: size.1,
        encoding,
        step,
        data,
    }
}

#[test]
fn plain_encodings_are_read_over_wide_steps() {
    let size = (2, 2);
    let rgb = [1, 2, 3, 4, 5, 6, 0xee, 7, 8, 9, 10, 11, 12];
    let expected = Grid::from_pixels(2, 2, vec![[1, 2, 3], [4, 5, 6], [7, 8, 9], [10, 11, 12]]);
    assert_eq!(
        rgb_from_raw(&raw(size, "rgb8", 7, &rgb), size).unwrap(),
        expected
    );
    let bgr = rgb_from_raw(&raw(size, "bgr8", 7, &rgb), size).unwrap();
    assert_eq!(bgr, expected.map(|&[r, g, b]| [b, g, r]));
    let mono = raw(size, "mono8", 3, &[9, 8, 0xee, 7, 6]);
    let grey = Grid::from_pixels(2, 2, vec![9, 8, 7, 6]);
    assert_eq!(grey_from_raw(&mono, size).unwrap(), grey);
    assert_eq!(rgb_from_raw(&mono, size).unwrap(), grey.map(|&v| [v; 3]));
    let depth = raw(size, "16UC1", 5, &[1, 0, 2, 1, 0xee, 0xff, 0xff, 0, 0]);
    let readings = readings_from_raw(&depth, size).unwrap();
    assert_eq!(readings.pixels(), [1, 258, 65535, 0]);
}

#[test]
fn chroma_is_that_of_bt_601_in_limited_range() {
    let size = (2, 1);
    // White, black, and the primaries as the standard's table of 75 % and 100 % bars has them.
    let cases = [
        ([235, 128, 128], [255, 255, 255]),
        ([16, 128, 128], [0, 0, 0]),
        ([82, 90, 240], [255, 0, 0]),
        ([145, 54, 34], [0, 255, 0]),
        ([41, 240, 110], [0, 0, 255]),
        ([126, 128, 128], [128, 128, 128]),
    ];
    for ([y, u, v], expected) in cases {
        let yuyv = [y, u, y, v];
        let uyvy = [u, y, v, y];
        let read =
            |encoding, data: &[u8]| rgb_from_raw(&raw(size, encoding, 4, data), size).unwrap();
        for encoding in ["yuv422_yuy2", "yuyv"] {
            for pixel in read(encoding, &yuyv).pixels() {
                for (found, expected) in pixel.iter().zip(expected) {
                    assert!(found.abs_diff(expected) <= 2, "{pixel:?} {expected:?}");
                }
            }
            assert_eq!(read("uyvy", &uyvy), read(encoding, &yuyv));
            assert_eq!(read("yuv422", &uyvy), read(encoding, &yuyv));
        }
    }
}

#[test]
fn bayer_orders_put_red_where_they_say() {
    for (encoding, red) in [
        ("bayer_rggb8", (0, 0)),
        ("bayer_grbg8", (1, 0)),
        ("bayer_gbrg8", (0, 1)),
        ("bayer_bggr8", (1, 1)),
    ] {
        let mut data = [10u8; 64];
        for y in 0..8 {
            for x in 0..8 {
                if (x % 2, y % 2) == red {
                    data[y * 8 + x] = 200;
                }
            }
        }
        let picture = rgb_from_raw(&raw((8, 8), encoding, 8, &data), (8, 8)).unwrap();
        assert!(
            picture.pixels().iter().all(|&p| p == [200, 10, 10]),
            "{encoding}"
        );
    }
}

#[test]
fn raw_pictures_that_do_not_fit_are_refused() {
    let size = (4, 2);
    let data = [0u8; 24];
    let rgb = |size, step, data| rgb_from_raw(&raw((4, 2), "rgb8", step, data), size);
    assert!(rgb(size, 12, &data[..]).is_ok());
    let short = rgb(size, 12, &data[..23]).unwrap_err();
    assert_eq!(
        short.to_string(),
        "the picture's data has 23 bytes, expected 24"
    );
    let step = rgb(size, 11, &data[..]).unwrap_err();
    assert_eq!(
        step.to_string(),
        "the row step is 11 bytes, expected at least 12"
    );
    let wrong = rgb((4, 3), 12, &data[..]).unwrap_err();
    assert_eq!(
        wrong.to_string(),
        "the picture's size is 4x2, expected 4x3 pixels"
    );
    assert!(rgb(size, usize::MAX, &data[..]).is_err());
    let unknown = rgb_from_raw(&raw(size, "rgba8", 16, &data), size).unwrap_err();
    assert!(
        unknown
            .to_string()
            .starts_with("the picture's encoding is \"rgba8\", expected bayer_rggb8")
    );
    assert!(readings_from_raw(&raw(size, "mono16", 8, &data), size).is_err());
    assert!(grey_from_raw(&raw(size, "rgb8", 12, &data), size).is_err());
    assert!(rgb_from_raw(&raw((3, 2), "yuyv", 6, &data), (3, 2)).is_err());
    let huge = (1 << 40, 1 << 40);
    assert!(rgb_from_raw(&raw(huge, "rgb8", usize::MAX, &data), (4, 2)).is_err());
}

fn gradient() -> RgbImage {
    Grid::from_fn(48, 40, |x, y| [(x * 5) as u8, (y * 6) as u8, 90])
}

fn jpeg(picture: &RgbImage) -> Vec<u8> {
    let mut data = Vec::new();
    let bytes = picture.pixels().as_flattened();
    let (w, h) = (picture.width() as u16, picture.height() as u16);
    Encoder::new(&mut data, 95)
        .encode(bytes, w, h, ColorType::Rgb)
        .unwrap();
    data
}

fn png(picture: &DynamicImage) -> Vec<u8> {
    file(picture, ImageFormat::Png)
}

fn file(picture: &DynamicImage, format: ImageFormat) -> Vec<u8> {
    let mut data = Cursor::new(Vec::new());
    picture.write_to(&mut data, format).unwrap();
    data.into_inner()
}

fn largest_difference(a: &RgbImage, b: &RgbImage) -> u8 {
    let pairs = a
        .pixels()
        .as_flattened()
        .iter()
        .zip(b.pixels().as_flattened());
    pairs.map(|(a, b)| a.abs_diff(*b)).max().unwrap()
}

#[test]
fn picture_files_are_read() {
    let picture = gradient();
    let size = (48, 40);
    let read = rgb_from_file("jpeg", &jpeg(&picture), size).unwrap();
    assert!(largest_difference(&read, &picture) < 12);
    let mut grey = Vec::new();
    let bytes: Vec<u8> = picture.pixels().iter().map(|p| p[0]).collect();
    Encoder::new(&mut grey, 95)
        .encode(&bytes, 48, 40, ColorType::Luma)
        .unwrap();
    let read = rgb_from_file("jpeg", &grey, size).unwrap();
    assert!(largest_difference(&read, &picture.map(|p| [p[0]; 3])) < 8);
    assert!(read.pixels().iter().all(|[r, g, b]| r == g && g == b));

    let bytes = picture.pixels().as_flattened().to_vec();
    let rgb = ImageBuffer::<Rgb<u8>, _>::from_raw(48, 40, bytes).unwrap();
    let rgb = DynamicImage::ImageRgb8(rgb);
    for same in [
        rgb.clone(),
        DynamicImage::ImageRgba8(rgb.to_rgba8()),
        DynamicImage::ImageRgb16(rgb.to_rgb16()),
    ] {
        let read = rgb_from_file("png", &png(&same), size).unwrap();
        assert_eq!(read, picture, "{:?}", same.color());
    }
    for (name, format) in [
        ("bmp", ImageFormat::Bmp),
        ("ppm", ImageFormat::Pnm),
        ("pnm", ImageFormat::Pnm),
        ("tiff", ImageFormat::Tiff),
        ("tif", ImageFormat::Tiff),
    ] {
        let file = file(&rgb, format);
        assert_eq!(size_of_file(name, &file), Ok(size), "{name}");
        assert_eq!(rgb_from_file(name, &file, size).unwrap(), picture, "{name}");
    }
    let luma = ImageBuffer::<Luma<u8>, _>::from_fn(48, 40, |x, y| Luma([(x + y) as u8]));
    let luma = png(&DynamicImage::ImageLuma8(luma));
    let expected = Grid::from_fn(48, 40, |x, y| (x + y) as u8);
    assert_eq!(
        rgb_from_file("png", &luma, size).unwrap(),
        expected.map(|&v| [v; 3])
    );
    assert_eq!(grey_from_file("png", &luma, size).unwrap(), expected);
}

#[test]
fn of_16_bits_those_are_used_that_the_brightest_pixel_has() {
    // As cameras of 10, 12 and 16 bits write them.
    for (bits, scale) in [(10, 4), (12, 16), (16, 256)] {
        let value = |x: u32, y: u32| Luma([(x * y % 255) as u16 * scale]);
        let luma = ImageBuffer::<Luma<u16>, Vec<u16>>::from_fn(48, 40, value);
        let expected = Grid::from_fn(48, 40, |x, y| (x * y % 255) as u8);
        let luma = DynamicImage::ImageLuma16(luma);
        for (name, format) in [("png", ImageFormat::Png), ("tiff", ImageFormat::Tiff)] {
            let read = grey_of_used_bits(name, &file(&luma, format), (48, 40)).unwrap();
            let pairs = read.pixels().iter().zip(expected.pixels());
            let most = pairs.map(|(a, b)| a.abs_diff(*b)).max();
            assert!(most <= Some(1), "{bits} bits, {name}: {most:?}");
        }
    }
    let black = ImageBuffer::<Luma<u16>, Vec<u16>>::new(48, 40);
    let black = png(&DynamicImage::ImageLuma16(black));
    let read = grey_of_used_bits("png", &black, (48, 40)).unwrap();
    assert!(read.pixels().iter().all(|&value| value == 0));
    // Pictures of 8 bits stay as they are, however dark.
    let dark = ImageBuffer::<Luma<u8>, Vec<u8>>::from_pixel(48, 40, Luma([7]));
    let dark = png(&DynamicImage::ImageLuma8(dark));
    let read = grey_of_used_bits("png", &dark, (48, 40)).unwrap();
    assert!(read.pixels().iter().all(|&value| value == 7));
}

#[test]
fn the_orientation_of_a_file_is_read() {
    let plain = jpeg(&gradient());
    assert_eq!(orientation_of_file("jpeg", &plain), AS_STORED);
    for stated in 1..=8 {
        // A TIFF header, and one entry: the orientation, a single number of 16 bits.
        let mut exif = b"Exif\0\0II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0".to_vec();
        exif.extend([stated, 0, 0, 0, 0, 0, 0, 0]);
        let length = (exif.len() as u16 + 2).to_be_bytes();
        let segment = [&[0xff, 0xe1][..], &length, &exif].concat();
        let marked = [&plain[..2], &segment, &plain[2..]].concat();
        assert_eq!(orientation_of_file("jpeg", &marked), stated);
        for length in 0..64 {
            let cut = orientation_of_file("jpeg", &marked[..length]);
            assert!(cut == AS_STORED || cut == stated, "cut at {length}: {cut}");
        }
    }
    assert_eq!(orientation_of_file("png", b"no picture"), AS_STORED);
    assert_eq!(orientation_of_file("webp", &plain), AS_STORED);
}

#[test]
fn tiff_files_are_read_or_refused() {
    let size = (48, 40);
    let luma = ImageBuffer::<Luma<u8>, _>::from_fn(48, 40, |x, y| Luma([(x + y) as u8]));
    let luma = DynamicImage::ImageLuma8(luma);
    let expected = Grid::from_fn(48, 40, |x, y| [(x + y) as u8; 3]);
    // Cameras of laboratories write 16 bits.
    for same in [luma.clone(), DynamicImage::ImageLuma16(luma.to_luma16())] {
        let file = file(&same, ImageFormat::Tiff);
        let read = rgb_from_file("tiff", &file, size).unwrap();
        assert_eq!(read, expected, "{:?}", same.color());
    }
    let file = file(&luma, ImageFormat::Tiff);
    assert!(rgb_from_file("tiff", &file, (48, 41)).is_err());
    assert!(rgb_from_file("tiff", &file[..file.len() / 2], size).is_err());
    // What says how the pixels lie stands before and behind them.
    let ends = (0..16).chain(file.len().saturating_sub(300)..file.len());
    for (at, bit) in ends.flat_map(|at| [(at, 0), (at, 3), (at, 7)]) {
        let mut broken = file.clone();
        broken[at] ^= 1 << bit;
        if let Ok(read) = rgb_from_file("tiff", &broken, size) {
            assert_eq!((read.width(), read.height()), size);
        }
    }
}

#[test]
fn a_palette_is_looked_up() {
    let mut data = Vec::new();
    let mut encoder = png::Encoder::new(&mut data, 2, 1);
    encoder.set_color(png::ColorType::Indexed);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_palette(vec![1, 2, 3, 250, 251, 252]);
    encoder
        .write_header()
        .unwrap()
        .write_image_data(&[1, 0])
        .unwrap();
    let read = rgb_from_file("png", &data, (2, 1)).unwrap();
    assert_eq!(read.pixels(), [[250, 251, 252], [1, 2, 3]]);
}

#[test]
fn picture_files_that_are_broken_are_refused_or_read_as_they_are() {
    let size = (48, 40);
    let picture = gradient();
    let bytes = picture.pixels().as_flattened().to_vec();
    let rgb = ImageBuffer::<Rgb<u8>, _>::from_raw(48, 40, bytes).unwrap();
    let files = [
        ("jpeg", jpeg(&picture)),
        ("png", png(&DynamicImage::ImageRgb8(rgb.clone()))),
        (
            "bmp",
            file(&DynamicImage::ImageRgb8(rgb.clone()), ImageFormat::Bmp),
        ),
        ("pnm", file(&DynamicImage::ImageRgb8(rgb), ImageFormat::Pnm)),
    ];
    for (format, file) in &files {
        assert!(rgb_from_file(format, file, (48, 41)).is_err());
        for length in 0..file.len() {
            let cut = rgb_from_file(format, &file[..length], size);
            // All of a PNG's pixels may be there before its last chunks are.
            let complete = *format == "png" && length + 16 > file.len();
            assert!(
                complete || cut.is_err(),
                "{format} cut at {length} of {}",
                file.len()
            );
        }
        for at in 0..file.len() {
            for bit in [0, 3, 7] {
                let mut broken = file.clone();
                broken[at] ^= 1 << bit;
                if let Ok(read) = rgb_from_file(format, &broken, size) {
                    assert_eq!((read.width(), read.height()), size);
                }
            }
        }
    }
    let unread = rgb_from_file("webp", &files[0].1, size).unwrap_err();
    let words =
        "the picture's encoding is \"webp\", expected jpeg, png, tiff, bmp or pnm (pbm, pgm, ppm)";
    assert_eq!(unread.to_string(), words);
    assert!(rgb_from_file("png", &files[0].1, size).is_err());
}

#[test]
fn a_picture_file_that_claims_to_be_huge_takes_no_memory() {
    let mut file = jpeg(&gradient());
    let frame = file.windows(2).position(|w| w == [0xff, 0xc0]).unwrap();
    file[frame + 5..frame + 9].fill(0xff);
    assert!(rgb_from_file("jpeg", &file, (48, 40)).is_err());
    let mut file = png(&DynamicImage::new_rgb8(48, 40));
    file[16..24].fill(0x7f);
    assert!(rgb_from_file("png", &file, (48, 40)).is_err());
    let huge = b"P6 1000000 1000000 255\n";
    assert!(size_of_file("ppm", huge).is_err());
    let mut file = self::file(&DynamicImage::new_rgb8(48, 40), ImageFormat::Bmp);
    file[18..26].fill(0x7f);
    assert!(size_of_file("bmp", &file).is_err());
}

#[test]
fn linear_light_is_encoded_as_the_standard_has_it() {
    let mut picture = Grid::from_pixels(1, 4, vec![[0; 3], [1; 3], [55; 3], [255; 3]]);
    encode_linear_as_srgb(&mut picture);
    assert_eq!(picture.pixels(), [[0; 3], [13; 3], [128; 3], [255; 3]]);
}
