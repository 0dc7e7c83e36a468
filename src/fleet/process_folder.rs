//! A folder of this process within one that several processes share, and the end of those whose processes are dead.

use std::path::{Path, PathBuf};

/// Makes the folder `PREFIX` and this process's id in `shared`, empty, and removes what dead processes left there.
pub(super) fn process_folder(shared: &Path, prefix: &str) -> std::io::Result<PathBuf> {
    std::fs::create_dir_all(shared)?;
    let own = shared.join(format!("{prefix}{}", std::process::id()));
    for entry in std::fs::read_dir(shared)? {
        let path = entry?.path();
        let name = path.file_name().and_then(|name| name.to_str());
        let process = name.and_then(|name| name.strip_prefix(prefix));
        let is_dead = |id: &str| !Path::new("/proc").join(id).exists();
        if process.is_some_and(is_dead) || path == own {
            std::fs::remove_dir_all(&path)?;
        }
    }
    std::fs::create_dir(&own)?;
    Ok(own)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_the_dead_left_goes_and_what_the_living_have_stays() {
        let home = tempfile::tempdir().unwrap();
        // No process has a number as large as this.
        for name in ["x-4194999", "x-1", "other"] {
            std::fs::create_dir(home.path().join(name)).unwrap();
        }
        let own = process_folder(home.path(), "x-").unwrap();
        std::fs::write(own.join("file"), b"").unwrap();
        assert_eq!(process_folder(home.path(), "x-").unwrap(), own);
        assert!(own.exists() && !own.join("file").exists());
        assert!(!home.path().join("x-4194999").exists());
        assert!(home.path().join("x-1").exists() && home.path().join("other").exists());
    }
}
