//! Lists the recordings that were open when a daemon ended, in a file, until the ends of their presses and the jobs of
//! their captures are on the disk too. Recovery renames a recording, so after another crash, or after a person
//! recovered it, nothing else would tell that it was interrupted. Presses and jobs themselves live elsewhere.

use crate::storage::{self, write_atomically};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// The file, below the recordings' folder.
fn list(recordings: &Path) -> PathBuf {
    recordings.join("presses/left")
}

/// Enters recordings, given by the names that they have when they are complete, before any of them is completed. When
/// this returns it survives a power cut. Where no daemon has its presses, there is nothing to enter.
///
/// # Errors
/// If it cannot be written.
pub fn enter(recordings: &Path, complete: &[PathBuf]) -> Result<(), storage::Error> {
    let file = list(recordings);
    if complete.is_empty() || !file.parent().is_some_and(Path::is_dir) {
        return Ok(());
    }
    let names = complete.iter().filter_map(|path| path.file_name());
    let names = names.map(|name| name.to_string_lossy().into_owned());
    let all: BTreeSet<String> = entered(recordings).chain(names).collect();
    let lines: String = all.iter().map(|name| format!("{name}\n")).collect();
    write_atomically(&file, lines.as_bytes())
}

fn entered(recordings: &Path) -> impl Iterator<Item = String> {
    let text = std::fs::read_to_string(list(recordings)).unwrap_or_default();
    let names = text.lines().filter(|name| name.ends_with(".mcap"));
    let names: Vec<String> = names.map(str::to_owned).collect();
    names.into_iter()
}

/// All that were entered, under the names that they have when they are complete.
pub fn all(recordings: &Path) -> Vec<PathBuf> {
    let names = entered(recordings);
    names.map(|name| recordings.join(name)).collect()
}

/// Removes the list of them, because all that follows from them is on the disk.
///
/// # Errors
/// If the list is there and cannot be removed.
pub fn forget(recordings: &Path) -> Result<(), storage::Error> {
    let file = list(recordings);
    match std::fs::remove_file(&file) {
        Err(cause) if cause.kind() != std::io::ErrorKind::NotFound => Err(storage::Error::Io {
            action: "remove",
            path: file,
            cause,
        }),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_open_is_known_until_it_is_settled() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        enter(folder.path(), &[path("a.mcap")]).unwrap();
        assert!(!path("presses").exists(), "no daemon's recordings");
        std::fs::create_dir(path("presses")).unwrap();
        enter(folder.path(), &[path("b.mcap"), path("a.mcap")]).unwrap();
        enter(folder.path(), &[path("c.mcap"), path("a.mcap")]).unwrap();
        let expected = ["a.mcap", "b.mcap", "c.mcap"].map(path);
        assert_eq!(all(folder.path()), expected);
        forget(folder.path()).unwrap();
        forget(folder.path()).unwrap();
        assert_eq!(all(folder.path()), Vec::<PathBuf>::new());
    }
}
