//! What processes that were killed left beside files and folders in the making: finding it, and removing what no living
//! process holds. Making such files and folders is not here.

use super::Error;
use super::files::{split, temporary_prefix};
use std::fs::{self, File, TryLockError};
use std::path::{Path, PathBuf};

/// Removes what killed writers of a file left beside it. What a living process writes stays.
///
/// # Errors
/// If the folder cannot be listed, or such a file cannot be removed. A folder that does not exist holds none.
pub fn remove_abandoned_parts(path: &Path) -> Result<(), Error> {
    let (parent, name) = split(path)?;
    if !parent.exists() {
        return Ok(());
    }
    remove_abandoned(&parent, &temporary_prefix(&name, "part"))
}

/// Removes what in `parent` begins with `prefix` and no living process holds.
pub(super) fn remove_abandoned(parent: &Path, prefix: &str) -> Result<(), Error> {
    for path in leftovers(parent, prefix)? {
        if is_abandoned(&path) {
            remove(&path)?;
        }
    }
    Ok(())
}

/// What in `parent` begins with `prefix`, in the order of names.
pub(super) fn leftovers(parent: &Path, prefix: &str) -> Result<Vec<PathBuf>, Error> {
    let mut found = Vec::new();
    for entry in fs::read_dir(parent).map_err(Error::io("list", parent))? {
        let entry = entry.map_err(Error::io("list", parent))?;
        if entry.file_name().to_string_lossy().starts_with(prefix) {
            found.push(entry.path());
        }
    }
    found.sort();
    Ok(found)
}

/// Whether no process holds the lock of an unfinished file or folder: the system releases the locks of a dead process.
fn is_abandoned(part: &Path) -> bool {
    File::open(part).is_ok_and(|part| part.try_lock().is_ok())
}

/// Whether a living process holds the lock of a folder. On a file system without locks none does.
pub(super) fn is_held(folder: &Path) -> bool {
    let is_locked = |folder: File| matches!(folder.try_lock(), Err(TryLockError::WouldBlock));
    folder.is_dir() && File::open(folder).is_ok_and(is_locked)
}

/// Removes a file or a folder; it is not an error if it does not exist.
pub(super) fn remove(path: &Path) -> Result<(), Error> {
    let removed = if path.is_dir() && !path.is_symlink() {
        fs::remove_dir_all(path)
    } else {
        fs::remove_file(path)
    };
    match removed {
        Err(source) if source.kind() != std::io::ErrorKind::NotFound => {
            Err(Error::io("remove", path)(source))
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::names;
    use super::*;

    #[test]
    fn what_a_killed_writer_left_goes_and_what_is_being_written_stays() {
        let home = tempfile::tempdir().unwrap();
        fs::write(home.path().join(".note.part-1-0"), "half").unwrap();
        let written = home.path().join(".note.part-2-0");
        let writer = File::create(&written).unwrap();
        writer.lock().unwrap();
        fs::write(home.path().join(".notes.part-1-0"), "another file's").unwrap();
        remove_abandoned_parts(&home.path().join("note")).unwrap();
        assert_eq!(names(home.path()), [".note.part-2-0", ".notes.part-1-0"]);
        drop(writer);
        remove_abandoned_parts(&home.path().join("note")).unwrap();
        assert_eq!(names(home.path()), [".notes.part-1-0"]);
        remove_abandoned_parts(&home.path().join("nowhere/note")).unwrap();
    }
}
