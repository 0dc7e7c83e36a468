//! Finds the recording that holds a job's capture now. A recording gets a new name when it is completed and becomes a
//! new file when it is packed, people rename it, and another session may have taken its old name.

use super::job::{Job, identity};
use crate::frame::Timestamp;
use crate::recording::{Error, Recording, Topic, finished_name, unfinished_name};
use std::path::{Path, PathBuf};
use std::time::{Duration, UNIX_EPOCH};

/// Why no recording was found that has a capture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Missing {
    /// None has it.
    Gone,
    /// One that may have it cannot be read now, such as a link to a disk that is not mounted.
    Unreadable,
}

/// The recording that has the capture now; `None` where none in the folder has. Where the file is the one that it was,
/// nothing is opened.
pub fn find(folder: &Path, job: &Job) -> Option<PathBuf> {
    search(folder, job).ok()
}

/// As [`find`], and why there is none.
pub(super) fn search(folder: &Path, job: &Job) -> Result<PathBuf, Missing> {
    if let Some(path) = find_unchanged(folder, job) {
        return Ok(path);
    }
    let mut missing = match std::fs::read_dir(folder) {
        Ok(_) => Missing::Gone,
        Err(_) => Missing::Unreadable,
    };
    for path in names(folder, job).into_iter().chain(others(folder, job)) {
        match holds(&path, job) {
            Ok(true) => return Ok(path),
            Err(_) if path.symlink_metadata().is_ok() => missing = Missing::Unreadable,
            Ok(false) | Err(_) => {}
        }
    }
    Err(missing)
}

/// The recording that had the capture when the job was enqueued, if it still has one of its names. Opens no file.
pub fn find_unchanged(folder: &Path, job: &Job) -> Option<PathBuf> {
    let names = names(folder, job);
    names.into_iter().find(|path| is_same(path, job))
}

/// The names that the recording has while it is written and afterwards.
fn names(folder: &Path, job: &Job) -> [PathBuf; 2] {
    let complete = folder.join(&job.recording);
    let unfinished = unfinished_name(&complete);
    [complete, unfinished]
}

/// The file that the capture was in, and all recordings that were written to since.
fn others(folder: &Path, job: &Job) -> Vec<PathBuf> {
    // Some file systems round the times of files.
    let since = UNIX_EPOCH + Duration::from_nanos(job.trigger_ns) - Duration::from_secs(60);
    let was_written = |path: &Path| {
        let written = std::fs::metadata(path).and_then(|m| m.modified());
        written.is_ok_and(|written| written >= since)
    };
    let entries = std::fs::read_dir(folder).into_iter().flatten();
    let mut found: Vec<_> = entries
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|path| {
            path.extension().is_some_and(|e| e == "mcap") || finished_name(path).is_some()
        })
        .map(|path| (!is_same(&path, job), path))
        // If the clock was ahead at the capture, its own file seems older.
        .filter(|(is_another, path)| !is_another || was_written(path))
        .collect();
    found.sort();
    found.into_iter().map(|(_, path)| path).collect()
}

fn is_same(path: &Path, job: &Job) -> bool {
    !job.file.is_empty() && identity(path).as_ref() == Some(&job.file)
}

/// Whether a file has the capture; an error if it may have it and cannot be read.
fn holds(path: &Path, job: &Job) -> Result<bool, Error> {
    let recording = match Recording::open(path) {
        Err(Error::NotMcap { .. } | Error::NotAFile { .. }) => return Ok(false),
        opened => opened?,
    };
    let at = recording.messages_at(&Topic::Trigger, Timestamp(job.trigger_ns));
    Ok(at.iter().any(|message| {
        let trigger = recording.trigger(message);
        trigger.is_ok_and(|trigger| trigger.id.as_str() == job.capture)
    }))
}
