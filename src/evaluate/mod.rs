//! A model against the truth or against another model: distances, what they say, and pictures of them.
//! Files are only read here; what is found is handed back as data.

pub mod load;

use std::path::PathBuf;

/// What can be wrong with what is to be evaluated.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A file cannot be read.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A file's ending is none that is known.
    #[error("{}: the ending is {extension}, where ply, glb or obj are read", path.display())]
    UnknownFormat {
        /// The file.
        path: PathBuf,
        /// Its ending.
        extension: String,
    },
    /// A file is not what its ending says.
    #[error("{}: {what}", path.display())]
    Format {
        /// The file.
        path: PathBuf,
        /// What is wrong, and where.
        what: String,
    },
}
