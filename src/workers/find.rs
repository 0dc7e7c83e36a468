//! Finds the recording that holds a job's capture now. A recording gets a new name when it is completed and becomes a
//! new file when it is packed, people rename it, and another session may have taken its old name.

use super::job::{Job, identity};
use crate::frame::Timestamp;
use crate::recording::{Recording, Topic, finished_name, unfinished_name};
use std::path::{Path, PathBuf};
use std::time::{Duration, UNIX_EPOCH};

/// The recording that has the capture now; `None` where none in the folder has. Where the file is the one that it was,
/// nothing is opened.
pub fn find(folder: &Path, job: &Job) -> Option<PathBuf> {
    find_unchanged(folder, job).or_else(|| {
        let candidates = names(folder, job).into_iter().chain(others(folder, job));
        candidates.into_iter().find(|path| holds(path, job))
    })
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

fn holds(path: &Path, job: &Job) -> bool {
    let Ok(recording) = Recording::open(path) else {
        return false;
    };
    let at = recording.messages_at(&Topic::Trigger, Timestamp(job.trigger_ns));
    at.iter().any(|message| {
        let trigger = recording.trigger(message);
        trigger.is_ok_and(|trigger| trigger.id.as_str() == job.capture)
    })
}
