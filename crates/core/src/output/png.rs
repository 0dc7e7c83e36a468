//! Writes and reads pictures as PNG.

use super::Error;
use crate::image::{Grid, RgbImage};
use ::image::codecs::png::{CompressionType, FilterType, PngEncoder};
use ::image::{ExtendedColorType, ImageEncoder, ImageReader, Limits};
use std::io::Cursor;

/// Encodes a picture, quickly rather than smallest.
///
/// # Errors
/// If it has no pixels.
pub fn encode_png(picture: &RgbImage) -> Result<Vec<u8>, Error> {
    let mut bytes = Vec::new();
    let (width, height) = (picture.width() as u32, picture.height() as u32);
    PngEncoder::new_with_quality(&mut bytes, CompressionType::Fast, FilterType::Adaptive)
        .write_image(
            picture.pixels().as_flattened(),
            width,
            height,
            ExtendedColorType::Rgb8,
        )
        .map_err(Error::Png)?;
    Ok(bytes)
}

/// Encodes a picture of grey values, as [`encode_png`] does.
///
/// # Errors
/// If it has no pixels.
pub fn encode_grey_png(picture: &Grid<u8>) -> Result<Vec<u8>, Error> {
    let mut bytes = Vec::new();
    let (width, height) = (picture.width() as u32, picture.height() as u32);
    PngEncoder::new_with_quality(&mut bytes, CompressionType::Fast, FilterType::Adaptive)
        .write_image(picture.pixels(), width, height, ExtendedColorType::L8)
        .map_err(Error::Png)?;
    Ok(bytes)
}

/// Reads a picture that [`encode_png`] wrote, of at most `most` pixels.
///
/// # Errors
/// If it is not a PNG, or larger.
pub fn decode_png(bytes: &[u8], most: u64) -> Result<RgbImage, Error> {
    let mut reader = ImageReader::with_format(Cursor::new(bytes), ::image::ImageFormat::Png);
    let mut limits = Limits::default();
    limits.max_alloc = Some(most * 8);
    reader.limits(limits);
    let picture = reader.decode().map_err(Error::BadPng)?.into_rgb8();
    let (width, height) = (picture.width() as usize, picture.height() as usize);
    let pixels = picture.into_raw();
    Ok(RgbImage::from_fn(width, height, |x, y| {
        let at = 3 * (y * width + x);
        [pixels[at], pixels[at + 1], pixels[at + 2]]
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_encoded_decodes_to_the_same() {
        let picture = RgbImage::from_fn(7, 5, |x, y| [x as u8 * 30, y as u8 * 50, 9]);
        let bytes = encode_png(&picture).unwrap();
        assert_eq!(decode_png(&bytes, 35).unwrap(), picture);
        assert!(decode_png(&bytes, 3).is_err());
        assert!(decode_png(b"no png", 35).is_err());
        let grey = Grid::from_fn(7, 5, |x, y| (x * 30 + y) as u8);
        let decoded = decode_png(&encode_grey_png(&grey).unwrap(), 35).unwrap();
        assert_eq!(decoded, grey.map(|v| [*v; 3]));
    }
}
