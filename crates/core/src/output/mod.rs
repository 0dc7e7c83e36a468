//! Files for people: models as glTF and PLY, boards to print, reports of failures. What goes into a model is decided
//! elsewhere; here it only becomes bytes, which `storage` brings to the disk.

mod attributes;
mod board_sheet;
mod failure;
pub mod glb;
mod gltf;
mod jpeg;
mod pdf;
pub mod ply;
mod png;

pub use board_sheet::{Paper, board_sheet};
pub use failure::write_failure;
pub use png::encode_png;

/// Why the bytes of a file could not be made.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A model that does not hold together.
    #[error("the model's {what} is {found}, expected {expected}")]
    BadModel {
        /// Which part of it.
        what: &'static str,
        /// What was there.
        found: String,
        /// What would do.
        expected: String,
    },
    /// The atlas could not be compressed.
    #[error("cannot encode the texture as JPEG: {0}")]
    Jpeg(jpeg_encoder::EncodingError),
    /// A picture could not be compressed.
    #[error("cannot encode a picture as PNG: {0}")]
    Png(::image::ImageError),
}
