//! Shared by recovery and packing, which both replace a recording: names, locks and errors.

use super::Error;
use std::fs::{File, Metadata, TryLockError};
use std::os::unix::fs::{MetadataExt, fchown};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// What the name of a recording ends with while it is written.
pub(super) const PART: &str = ".part";

/// A recording that is being written is locked.
pub(super) fn lock(file: &File, part: &Path) -> Result<(), Error> {
    match file.try_lock() {
        Ok(()) => Ok(()),
        Err(TryLockError::WouldBlock) => Err(Error::BeingWritten { path: part.into() }),
        Err(TryLockError::Error(cause)) => Err(io(part)(cause)),
    }
}

/// As [`lock`], of one that was left unfinished. A file system without locks cannot tell whether it is still being
/// written; it counts as left, for nothing else would ever complete it.
pub(super) fn lock_left(file: &File, part: &Path) -> Result<(), Error> {
    unless_held(file.try_lock(), part)
}

fn unless_held(tried: Result<(), TryLockError>, part: &Path) -> Result<(), Error> {
    match tried {
        Ok(()) => Ok(()),
        Err(TryLockError::WouldBlock) => Err(Error::BeingWritten { path: part.into() }),
        Err(TryLockError::Error(cause)) if has_no_locks(&cause) => Ok(()),
        Err(TryLockError::Error(cause)) => Err(io(part)(cause)),
    }
}

/// What NFS 3 says where nobody serves its locks.
const ENOLCK: i32 = 37;

/// Whether an error of locking means that the file system has no locks.
fn has_no_locks(cause: &std::io::Error) -> bool {
    cause.kind() == std::io::ErrorKind::Unsupported || cause.raw_os_error() == Some(ENOLCK)
}

/// How long nothing may have been written to a recording on a file system without locks until it counts as left.
const LEFT_AFTER: Duration = Duration::from_secs(60);

/// Whether a recording may still be being written, which its file system has no locks to tell: something was written to
/// it within the last minute.
pub fn may_be_being_written(part: &Path) -> bool {
    let Ok(file) = File::open(part) else {
        return false;
    };
    let has_locks = match file.try_lock_shared() {
        Err(TryLockError::Error(cause)) => !has_no_locks(&cause),
        _ => true,
    };
    let written = file.metadata().and_then(|about| about.modified());
    let age = written.ok().and_then(|at| at.elapsed().ok());
    !has_locks && age.is_none_or(|age| age < LEFT_AFTER)
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

/// Gives a copy the owner, the group and the permissions of the original: an administrator makes copies, too, and they
/// are to stay the daemon's.
pub(super) fn copy_ownership(copy: &File, original: &Metadata) -> std::io::Result<()> {
    let now = copy.metadata()?;
    let differing = |now: u32, wanted: u32| (now != wanted).then_some(wanted);
    let owner = differing(now.uid(), original.uid());
    let group = differing(now.gid(), original.gid());
    if owner.is_some() || group.is_some() {
        fchown(copy, owner, group)?;
    }
    copy.set_permissions(original.permissions())
}

pub(super) fn io(path: &Path) -> impl Fn(std::io::Error) -> Error {
    let path = path.to_owned();
    move |cause| Error::Io {
        path: path.clone(),
        cause,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_left_on_a_file_system_without_locks_can_be_completed() {
        let part = Path::new("a.mcap.part");
        let no_locks = std::io::Error::from_raw_os_error(ENOLCK);
        unless_held(Err(TryLockError::Error(no_locks)), part).unwrap();
        let other = std::io::ErrorKind::PermissionDenied.into();
        assert!(unless_held(Err(TryLockError::Error(other)), part).is_err());
        let held = unless_held(Err(TryLockError::WouldBlock), part);
        assert!(matches!(held, Err(Error::BeingWritten { .. })));
    }
}
