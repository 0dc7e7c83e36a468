//! Pictures as PNG.

use super::Error;
use crate::image::RgbImage;
use ::image::codecs::png::{CompressionType, FilterType, PngEncoder};
use ::image::{ExtendedColorType, ImageEncoder};

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_encoded_decodes_to_the_same() {
        let picture = RgbImage::from_fn(7, 5, |x, y| [x as u8 * 30, y as u8 * 50, 9]);
        let bytes = encode_png(&picture).unwrap();
        let decoded = ::image::load_from_memory(&bytes).unwrap().into_rgb8();
        assert_eq!(decoded.dimensions(), (7, 5));
        assert_eq!(decoded.as_raw().as_slice(), picture.pixels().as_flattened());
    }
}
