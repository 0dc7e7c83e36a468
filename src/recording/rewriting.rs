//! What making a recording anew beside itself needs, whether after a crash or to pack it: names, locks, errors.

use super::Error;
use std::fs::{File, TryLockError};
use std::path::{Path, PathBuf};

/// A recording that is being written is locked.
pub(super) fn lock(file: &File, part: &Path) -> Result<(), Error> {
    match file.try_lock() {
        Ok(()) => Ok(()),
        Err(TryLockError::WouldBlock) => Err(Error::BeingWritten { path: part.into() }),
        Err(TryLockError::Error(cause)) => Err(io(part)(cause)),
    }
}

/// Removes what was begun and not finished, if it is there.
pub(super) fn remove_stale(path: &Path) -> Result<(), Error> {
    match std::fs::remove_file(path) {
        Err(cause) if cause.kind() != std::io::ErrorKind::NotFound => Err(io(path)(cause)),
        _ => Ok(()),
    }
}

/// A name with another ending behind it.
pub(super) fn with_ending(path: &Path, ending: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".");
    name.push(ending);
    name.into()
}

pub(super) fn io(path: &Path) -> impl Fn(std::io::Error) -> Error {
    let path = path.to_owned();
    move |cause| Error::Io {
        path: path.clone(),
        cause,
    }
}
