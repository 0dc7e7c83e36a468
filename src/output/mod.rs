//! Files for people: models as glTF and PLY, boards to print, and folders that are complete once they have their final name.
//! What goes into a model is decided elsewhere; here it only becomes bytes on a disk.

mod attributes;
mod board_sheet;
mod failure;
pub mod glb;
mod gltf;
mod jpeg;
mod pdf;
pub mod ply;
mod png;
mod staging;

pub use board_sheet::{Paper, board_sheet};
pub use failure::write_failure;
pub use png::encode_png;
pub use staging::{StagedFolder, write_atomically};

use std::path::{Path, PathBuf};

/// Why a file could not be made.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The file system said no.
    #[error("cannot {action} {}: {cause}", path.display())]
    Io {
        /// What was tried, such as `write`.
        action: &'static str,
        /// On which file or folder.
        path: PathBuf,
        /// What the system said.
        cause: std::io::Error,
    },
    /// A file or folder of that name is there already and was not to be replaced.
    #[error("{} is there already", path.display())]
    Exists {
        /// The file or folder.
        path: PathBuf,
    },
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

impl Error {
    fn io(action: &'static str, path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        move |cause| Self::Io {
            action,
            path: path.to_owned(),
            cause,
        }
    }
}
