//! Why no model was made from a capture.

use crate::reconstruct::MOST_CAPTURES;
use crate::{capture, output, reconstruct, storage};
use std::path::PathBuf;

/// Why no model was made of a capture.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum Error {
    /// The capture cannot be loaded.
    #[error(transparent)]
    Capture(#[from] capture::Error),
    /// Another calibration does not fit it.
    #[error(transparent)]
    Calibration(#[from] capture::CalibrationMismatch),
    /// It cannot be reconstructed.
    #[error(transparent)]
    Reconstruction(#[from] reconstruct::Error),
    /// The folder holds a model that may not be replaced.
    #[error(
        "{} holds a model made from other inputs or settings: give --force to replace it, or another --out",
        .0.display()
    )]
    OtherModel(PathBuf),
    /// An object without captures.
    #[error("no capture of the object can be used")]
    NoCaptures,
    /// An object of more captures than a vertex has bits for, and memory may hold.
    #[error(
        "{0} captures of the object are to be fused, expected {MOST_CAPTURES} at most: leave some out, or reject them"
    )]
    TooManyCaptures(usize),
    /// A capture has the name that the object's folder would have.
    #[error(
        "{}: a capture of this recording has this name, so the object's folder cannot have it: give another --out",
        .0.display()
    )]
    NameTaken(PathBuf),
    /// Captures that cannot be fused, with the reason of each.
    #[error("no model was made, because fewer than two captures agree: {0}")]
    NotOneObject(String),
    /// A model or a picture cannot be encoded.
    #[error(transparent)]
    Encoding(#[from] output::Error),
    /// A file cannot be written.
    #[error(transparent)]
    Storage(#[from] storage::Error),
    /// The notes cannot be added to a model's folder.
    #[error("{0}")]
    Unmarked(String),
    /// The finished folder cannot get its name.
    #[error("{}: {cause}", folder.display())]
    NotPlaced {
        folder: PathBuf,
        cause: storage::Error,
    },
    /// The report cannot become text.
    #[error(transparent)]
    Report(#[from] serde_json::Error),
}

impl Error {
    /// Whether another process has put a folder where this one was to be.
    pub(super) fn is_taken(&self) -> bool {
        let Self::NotPlaced { cause, .. } = self else {
            return false;
        };
        matches!(cause, storage::Error::Exists { .. })
    }
}
