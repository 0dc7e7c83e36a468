//! Writes folders under a temporary name, makes them durable and then renames them, so that a folder under its
//! final name is complete, whenever the power fails.

use super::Error;
use super::abandoned::{leftovers, remove, remove_abandoned};
use super::files::{split, sync_folder, temporary_name, temporary_prefix, write_durably};
use std::fs::{self, File};
use std::path::{Path, PathBuf};

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

    /// Where the folder is while it is made.
    pub fn path(&self) -> &Path {
        &self.part
    }

    /// Writes one file of the folder, durably. Its name may be a path of folders below, with `/`, which are made.
    ///
    /// # Errors
    /// If it cannot be written; the error names the path.
    pub fn write(&self, name: &str, bytes: &[u8]) -> Result<(), Error> {
        let path = self.part.join(name);
        let folders = name.rsplit_once('/').map(|(folders, _)| folders);
        if let Some(folders) = folders {
            let folders = self.part.join(folders);
            fs::create_dir_all(&folders).map_err(Error::io("create", &folders))?;
        }
        write_durably(&path, bytes, &mut File::options())?;
        let Some(folders) = folders else {
            return Ok(());
        };
        // The names of the file and of its folders; that of the outermost one is made durable with the whole.
        let inner = Path::new(folders)
            .ancestors()
            .filter(|f| *f != Path::new(""));
        for folder in inner.map(|folder| self.part.join(folder)) {
            sync_folder(&folder).map_err(Error::io("write", &folder))?;
        }
        Ok(())
    }

    /// Puts the folder into place. A folder that is already there is an error unless `replace`; it is then
    /// set aside, and removed when the new one is in place.
    ///
    /// # Errors
    /// If a folder is there and not to be replaced, or the file system refuses; the target is then as it was.
    pub fn commit(mut self, replace: bool) -> Result<(), Error> {
        let (parent, name) = split(&self.target)?;
        sync_folder(&self.part).map_err(Error::io("write", &self.part))?;
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
            // One that came since the check.
            if !replace && self.target.symlink_metadata().is_ok() {
                return Err(Error::Exists {
                    path: self.target.clone(),
                });
            }
            return Err(Error::io("rename into place", &self.target)(source));
        }
        self.committed = true;
        sync_folder(&parent).map_err(Error::io("write", &parent))?;
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
    for path in leftovers(parent, &temporary_prefix(name, "old"))? {
        if target.symlink_metadata().is_ok() {
            remove(&path)?;
        } else {
            fs::rename(&path, target).map_err(Error::io("restore", target))?;
        }
    }
    remove_abandoned(parent, &temporary_prefix(name, "part"))
}

#[cfg(test)]
mod tests {
    use super::super::testing::names;
    use super::*;

    #[test]
    fn an_error_names_the_path() {
        let home = tempfile::tempdir().unwrap();
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
    fn files_may_lie_in_folders_below() {
        let home = tempfile::tempdir().unwrap();
        let target = home.path().join("cup");
        let staged = StagedFolder::create(&target).unwrap();
        staged.write("sparse/0/cameras.txt", b"1").unwrap();
        staged.write("sparse/0/images.txt", b"2").unwrap();
        staged.commit(false).unwrap();
        assert_eq!(
            names(&target.join("sparse/0")),
            ["cameras.txt", "images.txt"]
        );
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
