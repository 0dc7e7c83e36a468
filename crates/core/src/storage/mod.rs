//! What every room that reads or writes files needs: reading files up to a size, files and folders that get their final
//! name only when they are complete and durable, renaming without replacing, and free space. Knows nothing of what the
//! files hold.

mod abandoned;
mod files;
mod space;
mod staged_folder;
#[cfg(test)]
mod testing;

pub use abandoned::remove_abandoned_parts;
pub use files::{
    check_writable, read, read_text, rename_durably, rename_noreplace, sync_folder, sync_parent,
    write_atomically, write_atomically_for_owner, write_new, write_new_for_owner,
};
pub use space::free_bytes;
pub use staged_folder::StagedFolder;

use std::io::ErrorKind;
use std::path::{Path, PathBuf};

/// Why a file or folder could not be put into place.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The file system said no.
    #[error("cannot {action} {}: {cause}{}", path.display(), advice(cause))]
    Io {
        /// What was tried, such as `write`.
        action: &'static str,
        /// On which file or folder.
        path: PathBuf,
        /// What the system said.
        cause: std::io::Error,
    },
    /// A file or folder of that name already exists and was not to be replaced.
    #[error("{} already exists", path.display())]
    Exists {
        /// The file or folder.
        path: PathBuf,
    },
}

/// What a person can do about what the system said, in words that follow it; nothing for most causes.
pub fn advice(cause: &std::io::Error) -> &'static str {
    match cause.kind() {
        ErrorKind::StorageFull => ": the disk is full: free some space there, and try again",
        ErrorKind::QuotaExceeded => {
            ": your share of the disk is used up: free some of it, and try again"
        }
        ErrorKind::PermissionDenied => {
            ": you have no right to that: ask its owner (ls -l shows who that is), or run scand as a user who has it"
        }
        ErrorKind::ReadOnlyFilesystem => ": the disk can only be read: give a place on another one",
        _ => "",
    }
}

/// What the system said about a file or folder, between its path and what a person can do about it.
pub fn with_advice(path: &Path, cause: &std::io::Error) -> String {
    format!("{}: {cause}{}", path.display(), advice(cause))
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
