//! Writes folders under a temporary name, makes them durable and then renames them, so that a folder under its
//! final name is complete, whenever the power fails.

use super::Error;
use super::abandoned::{is_held, leftovers, remove, remove_abandoned};
use super::files::{split, sync_folder, temporary_name, temporary_prefix, write_durably};
use std::fs::{self, File};
use std::io;
use std::io::ErrorKind::{AlreadyExists, DirectoryNotEmpty, NotADirectory, NotFound};
use std::path::{Path, PathBuf};

/// How often a folder is put into place while other processes put theirs there.
const TRIES: usize = 8;

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

/// What had the name of a folder that replaces it.
struct SetAside {
    path: PathBuf,
    /// Held while it is aside, so that no other process takes it for one of a process that died, and puts it back.
    _lock: Option<File>,
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
    /// set aside, and removed when the new one is in place. Of processes that replace it at the same time, the last
    /// wins.
    ///
    /// # Errors
    /// If a folder is there and not to be replaced, or the file system refuses; the target is then as it was.
    pub fn commit(mut self, replace: bool) -> Result<(), Error> {
        let (parent, name) = split(&self.target)?;
        sync_folder(&self.part).map_err(Error::io("write", &self.part))?;
        let mut aside: Vec<SetAside> = Vec::new();
        let mut placed = Ok(());
        for _ in 0..TRIES {
            if self.target.symlink_metadata().is_ok() {
                if !replace {
                    return Err(Error::Exists {
                        path: self.target.clone(),
                    });
                }
                aside.extend(self.set_aside(&parent, &name)?);
            }
            placed = fs::rename(&self.part, &self.target);
            let came_since = |cause: &io::Error| {
                matches!(
                    cause.kind(),
                    AlreadyExists | DirectoryNotEmpty | NotADirectory
                )
            };
            if !placed.as_ref().is_err_and(came_since) {
                break;
            }
        }
        if let Err(cause) = placed {
            if let Some(last) = aside.last() {
                let _ = fs::rename(&last.path, &self.target);
            }
            return Err(Error::io("rename into place", &self.target)(cause));
        }
        self.committed = true;
        sync_folder(&parent).map_err(Error::io("write", &parent))?;
        aside.iter().try_for_each(|old| remove(&old.path))
    }

    /// Gives what has the target's name another one; `None` if another process has just done so.
    fn set_aside(&self, parent: &Path, name: &str) -> Result<Option<SetAside>, Error> {
        let path = parent.join(temporary_name(name, "old"));
        // Nothing else than a folder is opened: opening a pipe would wait for its writer.
        let is_folder = self.target.is_dir();
        let folder = is_folder.then(|| File::open(&self.target).ok()).flatten();
        let lock = folder.filter(|folder| folder.try_lock().is_ok());
        match fs::rename(&self.target, &path) {
            Ok(()) => Ok(Some(SetAside { path, _lock: lock })),
            Err(cause) if cause.kind() == NotFound => Ok(None),
            Err(cause) => Err(Error::io("set aside", &self.target)(cause)),
        }
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
        if is_held(&path) {
            continue;
        }
        if target.symlink_metadata().is_ok() {
            remove(&path)?;
        } else {
            restore(&path, target)?;
        }
    }
    remove_abandoned(parent, &temporary_prefix(name, "part"))
}

/// Puts back what was set aside. If it is gone, or something has its name, another process was faster.
fn restore(aside: &Path, target: &Path) -> Result<(), Error> {
    match fs::rename(aside, target) {
        // What has the name, file systems call by different errors.
        Err(cause)
            if !matches!(
                cause.kind(),
                NotFound | AlreadyExists | DirectoryNotEmpty | NotADirectory
            ) =>
        {
            Err(Error::io("restore", target)(cause))
        }
        _ => Ok(()),
    }
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

    #[test]
    fn a_folder_that_a_living_process_set_aside_is_left_to_it() {
        let home = tempfile::tempdir().unwrap();
        let target = home.path().join("cup");
        fs::create_dir(&target).unwrap();
        let staged = StagedFolder::create(&target).unwrap();
        let aside = staged.set_aside(home.path(), "cup").unwrap().unwrap();
        // Another process, while the name is free.
        drop(StagedFolder::create(&target).unwrap());
        assert!(aside.path.exists() && !target.exists());
        assert!(staged.set_aside(home.path(), "cup").unwrap().is_none());
        drop(aside);
        drop(StagedFolder::create(&target).unwrap());
        assert!(target.exists());
    }

    #[test]
    fn of_folders_that_are_replaced_at_the_same_time_the_last_is_there_and_no_commit_fails() {
        let home = tempfile::tempdir().unwrap();
        let target = home.path().join("cup");
        let staged = |number: usize| {
            let staged = StagedFolder::create(&target).unwrap();
            staged.write(&number.to_string(), b"").unwrap();
            staged
        };
        let mut all: Vec<StagedFolder> = (0..100).map(staged).collect();
        let half = all.split_off(50);
        std::thread::scope(|scope| {
            for folders in [all, half] {
                let mut folders = folders.into_iter();
                scope.spawn(move || folders.try_for_each(|folder| folder.commit(true)).unwrap());
            }
        });
        assert_eq!(names(&target).len(), 1);
        assert_eq!(names(home.path()), ["cup"]);
    }
}
