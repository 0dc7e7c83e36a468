//! Writes files for people: models as glTF and PLY, boards to print, reports of failures. Other rooms decide what
//! is in a model; this one turns it into bytes, and `storage` brings them to the disk.

mod attributes;
mod board_sheet;
mod failure;
pub mod glb;
mod gltf;
mod jpeg;
mod pdf;
pub mod ply;
mod png;
mod xmp;

pub use attributes::{unit, y_up};
pub use board_sheet::{Paper, board_sheet, largest_square_mm};
pub use failure::write_failure;
pub use jpeg::{encode as encode_jpeg, quality as jpeg_quality};
pub use png::{decode_png, encode_grey_png, encode_png};

/// Why the bytes of a file could not be made.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum Error {
    /// A model that does not hold together.
    #[error("the model's {what} is {found}, expected {expected}")]
    BadModel {
        /// Which part of it.
        what: &'static str,
        found: String,
        expected: String,
    },
    /// The atlas could not be compressed.
    #[error("cannot encode the texture as JPEG: {0}")]
    Jpeg(jpeg_encoder::EncodingError),
    /// A picture of ours could not be read back.
    #[error("cannot read a PNG: {0}")]
    BadPng(::image::ImageError),
    /// A picture could not be compressed.
    #[error("cannot encode a picture as PNG: {0}")]
    Png(::image::ImageError),
}
