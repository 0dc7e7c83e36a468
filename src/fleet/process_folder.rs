//! A folder of this process within one that several processes share, maybe on several machines, and the end of those
//! whose processes are dead. A process holds a lock in its folder: an id says nothing on another machine or in a
//! container.

use crate::log;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

/// The file that its process keeps locked.
const LOCK: &str = ".lock";

/// A folder that is this process's as long as this value lives; then it is removed.
#[derive(Debug)]
pub(super) struct ProcessFolder {
    path: PathBuf,
    _lock: File,
}

impl ProcessFolder {
    /// Makes a folder whose name begins with `prefix` in `shared`, and removes those of dead processes.
    pub(super) fn new(shared: &Path, prefix: &str) -> std::io::Result<Self> {
        std::fs::create_dir_all(shared)?;
        for entry in std::fs::read_dir(shared)? {
            let path = entry?.path();
            let name = path.file_name().and_then(|name| name.to_str());
            if name.is_some_and(|name| name.starts_with(prefix)) && is_dead(&path) {
                // What another user left stays: it takes space and does no harm.
                if let Err(error) = std::fs::remove_dir_all(&path) {
                    log::warning!("{}: {error}", path.display());
                }
            }
        }
        let since = SystemTime::now().duration_since(UNIX_EPOCH);
        let since = since.unwrap_or_default().as_nanos();
        let name = format!("{prefix}{}-{since:x}", std::process::id());
        // It gets its name when it is locked: nobody takes it for a dead one.
        let new = shared.join(format!(".new-{name}"));
        std::fs::create_dir(&new)?;
        let lock = File::create_new(new.join(LOCK))?;
        lock.lock()?;
        let path = shared.join(name);
        std::fs::rename(&new, &path)?;
        Ok(Self { path, _lock: lock })
    }

    /// Where it is.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }
}

impl Drop for ProcessFolder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.path);
    }
}

/// Whether nobody holds a folder's lock.
fn is_dead(folder: &Path) -> bool {
    match File::open(folder.join(LOCK)) {
        Ok(lock) => lock.try_lock().is_ok(),
        Err(error) => error.kind() == std::io::ErrorKind::NotFound,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_the_dead_left_goes_and_what_the_living_have_stays() {
        let home = tempfile::tempdir().unwrap();
        // One of a process of this id on another machine, whose lock is gone with it, and one without a lock.
        for name in [
            format!("x-{}-1", std::process::id()),
            "x-1".into(),
            "other".into(),
        ] {
            std::fs::create_dir(home.path().join(name)).unwrap();
        }
        std::fs::write(home.path().join("x-1").join(LOCK), b"").unwrap();
        let living = ProcessFolder::new(home.path(), "x-").unwrap();
        let own = ProcessFolder::new(home.path(), "x-").unwrap();
        assert!(living.path().exists() && own.path().exists());
        assert!(home.path().join("other").exists());
        let path = own.path().to_owned();
        drop(own);
        assert!(!path.exists());
        assert_eq!(std::fs::read_dir(home.path()).unwrap().count(), 2);
    }
}
