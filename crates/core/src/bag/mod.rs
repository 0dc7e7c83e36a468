//! Packages for archives that follow BagIt (RFC 8493): a folder with the files under `data/`, and lists of their
//! SHA-512 digests. `Bag` makes one, and `verify` checks one, whichever program made it. This room knows nothing of the
//! files' contents.

mod manifest;
mod verify;
mod write;

pub use verify::{Checked, Finding, verify};
pub use write::Bag;

use std::path::PathBuf;

/// Why a package cannot be made or checked.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The file system said no.
    #[error("{}: {cause}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What the system said.
        cause: std::io::Error,
    },
    /// Something has the package's name.
    #[error("{} already exists: choose another name, because a package is never changed", .0.display())]
    Exists(PathBuf),
    /// Two files of a package would have one name.
    #[error("the package has two files named {0}")]
    Twice(String),
}

impl Error {
    fn io(path: &std::path::Path) -> impl FnOnce(std::io::Error) -> Self {
        move |cause| Self::Io {
            path: path.to_owned(),
            cause,
        }
    }
}

#[cfg(test)]
mod tests;
