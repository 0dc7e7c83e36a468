//! Finds the recordings that a replay is given, by name or by folder, and the names of their output folders.

use crate::recording::{finished_name, noted_recording};
use anyhow::Context;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// What a replay was given.
pub(super) struct RecordingsFound {
    /// The recordings, in the order in which they were named; those of a folder in the order of their names.
    pub(super) recordings: Vec<PathBuf>,
    /// What a person should know of the folders.
    pub(super) warnings: Vec<String>,
}

/// Finds the recordings that are named. A folder stands for the recordings in it, but not for those in its subfolders.
///
/// # Errors
/// If a folder cannot be read, or has no recording.
pub(super) fn find(paths: &[PathBuf]) -> anyhow::Result<RecordingsFound> {
    let mut found = RecordingsFound {
        recordings: Vec::new(),
        warnings: Vec::new(),
    };
    for path in paths {
        if path.is_dir() {
            found.add_folder(path)?;
        } else {
            found.recordings.push(path.clone());
        }
    }
    Ok(found)
}

impl RecordingsFound {
    fn add_folder(&mut self, folder: &Path) -> anyhow::Result<()> {
        let at = |error: std::io::Error| anyhow::anyhow!("{}: {error}", folder.display());
        let entries = std::fs::read_dir(folder).map_err(at)?;
        let mut files = Vec::new();
        for entry in entries {
            files.push(entry.map_err(at)?.path());
        }
        files.sort();
        let is_recording = |path: &&PathBuf| {
            path.extension().is_some_and(|ending| ending == "mcap") || finished_name(path).is_some()
        };
        let recordings: Vec<PathBuf> = files.iter().filter(is_recording).cloned().collect();
        anyhow::ensure!(
            !recordings.is_empty(),
            "{}: the folder has no recording (*.mcap)",
            folder.display()
        );
        for (notes, recording) in files.iter().filter_map(|f| Some((f, noted_recording(f)?))) {
            let is_ours = |path: &PathBuf| {
                *path == recording || finished_name(path).as_ref() == Some(&recording)
            };
            if !recordings.iter().any(is_ours) {
                self.warnings.push(format!(
                    "{}: its recording {} does not exist, so these notes belong to no recording",
                    notes.display(),
                    recording.display()
                ));
            }
        }
        self.recordings.extend(recordings);
        Ok(())
    }
}

/// The stem of a complete recording, which names the folder of its models.
///
/// # Errors
/// If it is no name of a folder.
pub(in crate::commands) fn stem(file: &Path) -> anyhow::Result<String> {
    let complete = finished_name(file).unwrap_or_else(|| file.to_owned());
    let stem = complete.file_stem().and_then(|stem| stem.to_str());
    let stem =
        stem.with_context(|| format!("{}: the recording's name is not UTF-8", file.display()))?;
    // Models would be written beside or above the folder that they are to go into.
    anyhow::ensure!(
        !matches!(stem, "." | ".."),
        "{}: a folder for its models cannot be called {stem:?}: expected a recording's name such as cup.mcap",
        file.display()
    );
    Ok(stem.to_owned())
}

/// The files' stems, those of complete recordings, which name their output folders: two of one stem would share one.
pub(super) fn stems(files: &[PathBuf]) -> anyhow::Result<Vec<String>> {
    let mut seen = BTreeMap::new();
    let mut stems = Vec::new();
    for file in files {
        let stem = stem(file)?;
        if let Some(other) = seen.insert(stem.clone(), file) {
            anyhow::bail!(
                "{} and {} have the same name and would share an output folder: rename one of them, or give each its own --out",
                other.display(),
                file.display()
            );
        }
        stems.push(stem);
    }
    Ok(stems)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_that_leads_out_of_the_folder_is_refused() {
        for name in ["...mcap", "..mcap", "a/...mcap"] {
            let error = stems(&[name.into()]).unwrap_err().to_string();
            assert!(
                error.starts_with(name) && error.contains("expected"),
                "{error}"
            );
        }
        let good = ["a/cup.mcap", "..cup.mcap", "b.mcap.part"].map(PathBuf::from);
        assert_eq!(stems(&good).unwrap(), ["cup", "..cup", "b"]);
    }
}
