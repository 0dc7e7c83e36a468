//! Putting files and folders into place: written beside under a temporary name, made durable, then renamed,
//! so that whatever has its final name is complete, whenever the power goes.

use super::Error;
use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

/// Distinguishes the temporary names of one process.
static NEXT: AtomicU32 = AtomicU32::new(0);

/// Writes a file so that under its final name there is the old content or all of the new, never a part.
///
/// # Errors
/// If the file system refuses a step; the error names the path, and nothing is left behind.
pub fn write_atomically(path: &Path, bytes: &[u8]) -> Result<(), Error> {
    let (parent, name) = split(path)?;
    fs::create_dir_all(&parent).map_err(Error::io("create", &parent))?;
    let part = parent.join(temporary_name(&name, "part"));
    let written = write_durably(&part, bytes)
        .and_then(|()| fs::rename(&part, path).map_err(Error::io("rename into place", path)))
        .and_then(|()| sync_folder(&parent));
    if written.is_err() {
        // The error that matters is the first one.
        let _ = fs::remove_file(&part);
    }
    written
}

/// A folder in the making. It lies beside its final place as `.NAME.part-PID-N` and is locked, so that
/// another process can tell it from one whose maker died. Dropped without [`Self::commit`], it is removed.
#[derive(Debug)]
pub struct StagedFolder {
    target: PathBuf,
    part: PathBuf,
    /// Held until the folder is in place or gone.
    _lock: File,
    committed: bool,
}

impl StagedFolder {
    /// Begins a folder that will be `target`. Removes what dead processes left unfinished of the same
    /// target, and puts back what one of them had set aside.
    ///
    /// # Errors
    /// If a folder cannot be made there.
    pub fn create(target: &Path) -> Result<Self, Error> {
        let (parent, name) = split(target)?;
        fs::create_dir_all(&parent).map_err(Error::io("create", &parent))?;
        clean_up(&parent, &name, target)?;
        let part = parent.join(temporary_name(&name, "part"));
        fs::create_dir(&part).map_err(Error::io("create", &part))?;
        let lock = File::open(&part).map_err(Error::io("open", &part))?;
        lock.lock().map_err(Error::io("lock", &part))?;
        Ok(Self {
            target: target.to_owned(),
            part,
            _lock: lock,
            committed: false,
        })
    }

    /// Writes one file of the folder, durably.
    ///
    /// # Errors
    /// If it cannot be written; the error names the path.
    pub fn write(&self, name: &str, bytes: &[u8]) -> Result<(), Error> {
        write_durably(&self.part.join(name), bytes)
    }

    /// Puts the folder into place. A folder that is already there is an error unless `replace`; it is then
    /// set aside, and removed when the new one is in place.
    ///
    /// # Errors
    /// If a folder is there and not to be replaced, or the file system refuses; the target is then as it was.
    pub fn commit(mut self, replace: bool) -> Result<(), Error> {
        let (parent, name) = split(&self.target)?;
        sync_folder(&self.part)?;
        let aside = parent.join(temporary_name(&name, "old"));
        let replaced = self.target.symlink_metadata().is_ok();
        if replaced && !replace {
            return Err(Error::Exists {
                path: self.target.clone(),
            });
        }
        if replaced {
            fs::rename(&self.target, &aside).map_err(Error::io("set aside", &self.target))?;
        }
        if let Err(source) = fs::rename(&self.part, &self.target) {
            if replaced {
                let _ = fs::rename(&aside, &self.target);
            }
            return Err(Error::io("rename into place", &self.target)(source));
        }
        self.committed = true;
        sync_folder(&parent)?;
        if replaced {
            remove(&aside)?;
        }
        Ok(())
    }
}

impl Drop for StagedFolder {
    fn drop(&mut self) {
        if !self.committed {
            let _ = fs::remove_dir_all(&self.part);
        }
    }
}

/// Removes the unfinished folders of dead processes and restores a target that one of them had set aside.
fn clean_up(parent: &Path, name: &str, target: &Path) -> Result<(), Error> {
    for path in leftovers(parent, &format!(".{name}.old-"))? {
        if target.symlink_metadata().is_ok() {
            remove(&path)?;
        } else {
            fs::rename(&path, target).map_err(Error::io("restore", target))?;
        }
    }
    for path in leftovers(parent, &format!(".{name}.part-"))? {
        if is_abandoned(&path) {
            remove(&path)?;
        }
    }
    Ok(())
}

/// What in `parent` begins with `prefix`, in the order of names.
fn leftovers(parent: &Path, prefix: &str) -> Result<Vec<PathBuf>, Error> {
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

/// Whether nobody holds the lock of a folder in the making: the system lets go of a dead process' locks.
fn is_abandoned(part: &Path) -> bool {
    File::open(part).is_ok_and(|folder| folder.try_lock().is_ok())
}

/// Removes a file or a folder; that it is gone already is no error.
fn remove(path: &Path) -> Result<(), Error> {
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

fn write_durably(path: &Path, bytes: &[u8]) -> Result<(), Error> {
    let mut file = File::create(path).map_err(Error::io("create", path))?;
    file.write_all(bytes).map_err(Error::io("write", path))?;
    file.sync_data().map_err(Error::io("write", path))
}

/// Makes renames in a folder durable.
fn sync_folder(folder: &Path) -> Result<(), Error> {
    let sync = || File::open(folder)?.sync_all();
    sync().map_err(Error::io("write", folder))
}

/// Hidden, beside the target, of this process and this call.
fn temporary_name(name: &str, kind: &str) -> String {
    let number = NEXT.fetch_add(1, Ordering::Relaxed);
    format!(".{name}.{kind}-{}-{number}", std::process::id())
}

/// A path's folder and its last name.
fn split(path: &Path) -> Result<(PathBuf, String), Error> {
    let name = path.file_name().ok_or_else(|| {
        let no_name = std::io::Error::new(std::io::ErrorKind::InvalidInput, "it has no name");
        Error::io("write", path)(no_name)
    })?;
    let parent = match path.parent() {
        Some(parent) if parent != Path::new("") => parent.to_owned(),
        _ => PathBuf::from("."),
    };
    Ok((parent, name.to_string_lossy().into_owned()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let entries = fs::read_dir(folder).unwrap();
        let mut names: Vec<_> = entries
            .map(|e| e.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn a_file_is_replaced_whole_and_nothing_stays_beside_it() {
        let home = tempfile::tempdir().unwrap();
        let path = home.path().join("deep/er/a.txt");
        write_atomically(&path, b"one").unwrap();
        write_atomically(&path, b"two").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"two");
        assert_eq!(names(path.parent().unwrap()), ["a.txt"]);
    }

    #[test]
    fn an_error_names_the_path_and_leaves_nothing() {
        let home = tempfile::tempdir().unwrap();
        let taken = home.path().join("folder");
        fs::create_dir(&taken).unwrap();
        let error = write_atomically(&taken, b"x").unwrap_err().to_string();
        assert!(error.contains(taken.to_str().unwrap()), "{error}");
        assert_eq!(names(home.path()), ["folder"]);
        let below_a_file = home.path().join("file/folder");
        fs::write(home.path().join("file"), b"").unwrap();
        let error = StagedFolder::create(&below_a_file).unwrap_err();
        assert!(error.to_string().contains("file"), "{error}");
    }

    #[test]
    fn a_folder_appears_only_when_committed() {
        let home = tempfile::tempdir().unwrap();
        let target = home.path().join("cup");
        let staged = StagedFolder::create(&target).unwrap();
        staged.write("model.glb", b"glTF").unwrap();
        assert!(!target.exists());
        drop(staged);
        assert_eq!(
            names(home.path()),
            [""; 0],
            "an abandoned folder is removed"
        );
        let staged = StagedFolder::create(&target).unwrap();
        staged.write("model.glb", b"glTF").unwrap();
        staged.commit(false).unwrap();
        assert_eq!(names(home.path()), ["cup"]);
        assert_eq!(fs::read(target.join("model.glb")).unwrap(), b"glTF");
    }

    #[test]
    fn a_folder_is_replaced_only_when_asked() {
        let home = tempfile::tempdir().unwrap();
        let target = home.path().join("cup");
        for (content, replace) in [("one", false), ("two", true)] {
            let staged = StagedFolder::create(&target).unwrap();
            staged.write(content, b"").unwrap();
            staged.commit(replace).unwrap();
        }
        let staged = StagedFolder::create(&target).unwrap();
        assert!(matches!(staged.commit(false), Err(Error::Exists { .. })));
        assert_eq!(names(&target), ["two"]);
        assert_eq!(names(home.path()), ["cup"]);
    }

    #[test]
    fn what_a_dead_process_left_is_cleaned_and_what_lives_is_kept() {
        let home = tempfile::tempdir().unwrap();
        let target = home.path().join("cup");
        let dead = home.path().join(".cup.part-1-0");
        fs::create_dir(&dead).unwrap();
        fs::write(dead.join("model.glb"), b"half").unwrap();
        fs::create_dir(home.path().join(".cupboard.part-1-0")).unwrap();
        let living = StagedFolder::create(&target).unwrap();
        let second = StagedFolder::create(&target).unwrap();
        assert!(!dead.exists());
        assert!(living.part.exists() && second.part.exists());
        assert!(home.path().join(".cupboard.part-1-0").exists());
    }

    #[test]
    fn a_folder_that_a_dead_process_set_aside_is_put_back() {
        let home = tempfile::tempdir().unwrap();
        let target = home.path().join("cup");
        let aside = home.path().join(".cup.old-1-0");
        fs::create_dir(&aside).unwrap();
        fs::write(aside.join("report.json"), b"{}").unwrap();
        drop(StagedFolder::create(&target).unwrap());
        assert_eq!(names(&target), ["report.json"]);
        assert_eq!(names(home.path()), ["cup"]);
    }
}
