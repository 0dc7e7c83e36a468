//! How jobs of a rig are handed to the process of the fleet and back, by files beside them in the folder of jobs: the
//! process that has the connection says when a worker has begun a job, and what became of it; the daemon ends the job.
//! Neither waits for the other, and each may be started again at any time.

use super::find::find;
use super::job::{ENDING, Job};
use super::jobs::is_hidden;
use crate::log;
use crate::recording::{Notes, Recording};
use crate::storage::{self, write_atomically};
use serde::{Deserialize, Serialize};
use std::fs::File;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

/// What became of a job.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Answer {
    /// Its folder has a model, or the report of why there is none.
    Made,
    /// There is no result.
    Failed {
        /// Why.
        reason: String,
        /// The last of what a child said.
        words: String,
    },
    /// The rig has to make the model.
    MakeLocally {
        /// Why.
        reason: String,
    },
}

/// The ending of the file that says what became of a job.
const ANSWER: &str = "answer";
/// The ending of the file that says that a worker has begun a job, and which.
const STARTED: &str = "started";
/// The folder of jobs that failed, within that of jobs.
const FAILED: &str = "failed";

/// A job that is to be offered.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct OfferedJob {
    /// Its file, which is there until the job has ended.
    pub file: PathBuf,
    /// The job.
    pub job: Job,
}

/// The folder of the jobs of the recordings in a folder.
pub fn folder(recordings: &Path) -> PathBuf {
    recordings.join("jobs")
}

/// Where the settings of these jobs are.
pub fn settings_path(recordings: &Path) -> PathBuf {
    folder(recordings).join("settings.toml")
}

/// The jobs that have no answer, the oldest first. Answers about jobs that are over are removed.
///
/// # Errors
/// If the folder cannot be read.
pub fn offered(recordings: &Path) -> std::io::Result<Vec<OfferedJob>> {
    let mut offered_jobs = Vec::new();
    for entry in std::fs::read_dir(folder(recordings))? {
        let file = entry?.path();
        if is_hidden(&file) {
            continue;
        }
        let ending = file.extension().and_then(|ending| ending.to_str());
        match ending {
            Some(ANSWER | STARTED) if !file.with_extension(ENDING).exists() => {
                let _ = std::fs::remove_file(&file);
            }
            Some(ENDING) if !file.with_extension(ANSWER).exists() => {
                let job = std::fs::read(&file).ok();
                let job = job.and_then(|bytes| Job::parse(&bytes).ok());
                offered_jobs.extend(job.map(|job| OfferedJob { file, job }));
            }
            _ => {}
        }
    }
    offered_jobs.sort_by(|a, b| a.file.cmp(&b.file));
    Ok(offered_jobs)
}

/// Says that a worker has begun a job, or still does it. That is said again every few seconds and means nothing after a
/// power cut, so that nothing waits for the disk.
///
/// # Errors
/// If the file cannot be written.
pub fn report_started(file: &Path, worker: &str) -> std::io::Result<()> {
    let path = file.with_extension(STARTED);
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    // Hidden files are no jobs.
    let new = path.with_file_name(format!(".{name}"));
    std::fs::write(&new, worker)?;
    std::fs::rename(&new, &path)
}

/// Says what became of a job. One that failed is kept for [`offer_failed_again`].
///
/// # Errors
/// If the file cannot be written.
pub fn answer(file: &Path, answer: &Answer) -> Result<(), storage::Error> {
    if let (Answer::Failed { .. }, Some(kept)) = (answer, kept(file))
        && let Some(folder) = kept.parent()
        && std::fs::create_dir_all(folder).is_ok()
    {
        let copied = std::fs::read(file).map_err(|e| e.to_string());
        let copied =
            copied.and_then(|job| write_atomically(&kept, &job).map_err(|e| e.to_string()));
        if let Err(error) = copied {
            log::warning!("{}: {error}; it cannot be offered again", kept.display());
        }
    }
    let bytes = serde_json::to_vec(answer).unwrap_or_default();
    write_atomically(&file.with_extension(ANSWER), &bytes)
}

/// Where a job is kept that failed.
fn kept(file: &Path) -> Option<PathBuf> {
    Some(file.parent()?.join(FAILED).join(file.file_name()?))
}

/// Puts failed jobs back into the queue: that of `capture`, or all; how many. Those of captures that a person rejected
/// since stay, and each begins to wait for a worker anew.
///
/// # Errors
/// If the file system refuses.
pub fn offer_failed_again(recordings: &Path, capture: Option<&str>) -> std::io::Result<usize> {
    let folder = folder(recordings);
    let Ok(entries) = std::fs::read_dir(folder.join(FAILED)) else {
        return Ok(0);
    };
    let mut count = 0;
    for entry in entries {
        let kept = entry?.path();
        if is_hidden(&kept) {
            continue;
        }
        let job = Job::parse(&std::fs::read(&kept)?).ok();
        let is_wanted = |job: &Job| capture.is_none_or(|wanted| wanted == job.capture);
        let queued = kept.file_name().map(|name| folder.join(name));
        let (Some(job), Some(queued)) = (job.filter(is_wanted), queued) else {
            continue;
        };
        if is_rejected(recordings, &job) {
            log::notice!(
                "capture {} was rejected, so its model is not asked for again",
                job.capture
            );
        } else {
            set_modified_now(&kept);
            let _ = std::fs::remove_file(queued.with_extension(ANSWER));
            let renamed = storage::rename_durably(&kept, &queued);
            renamed.map_err(std::io::Error::other)?;
            count += 1;
        }
    }
    Ok(count)
}

/// Whether a person rejected a job's capture; not if that cannot be read.
fn is_rejected(recordings: &Path, job: &Job) -> bool {
    let recording = find(recordings, job).and_then(|path| Recording::open(&path).ok());
    recording.is_some_and(|recording| Notes::of(&recording).on(&job.capture).is_rejected())
}

/// What became of a job, if that is known.
pub(super) fn answer_to(file: &Path) -> Option<Answer> {
    let bytes = std::fs::read(file.with_extension(ANSWER)).ok()?;
    serde_json::from_slice(&bytes).ok()
}

/// Whether no worker has begun, or gone on with, a job for this long. If the clock was set back meanwhile, the wait
/// begins anew, for which the file gets the present time: otherwise it would last until the clock is there again.
pub(super) fn is_neglected(file: &Path, wait: Duration) -> bool {
    let Some((last, path)) = last_sign(file) else {
        return false;
    };
    match last.elapsed() {
        Ok(silent) => silent >= wait,
        Err(ahead) => {
            if ahead.duration() > Duration::from_secs(2) {
                set_modified_now(&path);
            }
            false
        }
    }
}

/// When a worker last said that it does a job, or else when the job was written; and the file that says it.
fn last_sign(file: &Path) -> Option<(SystemTime, PathBuf)> {
    let said = |path: PathBuf| Some((std::fs::metadata(&path).ok()?.modified().ok()?, path));
    said(file.with_extension(STARTED)).or_else(|| said(file.to_owned()))
}

fn set_modified_now(path: &Path) {
    let opened = File::options().append(true).open(path);
    let _ = opened.and_then(|file| file.set_modified(SystemTime::now()));
}

/// Removes the answers about a job.
pub(super) fn forget(file: &Path) {
    for ending in [ANSWER, STARTED] {
        let _ = std::fs::remove_file(file.with_extension(ending));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_job_is_offered_until_it_is_answered_and_again_when_it_is_retried() {
        let home = tempfile::tempdir().unwrap();
        let jobs = super::super::Jobs::open(home.path()).unwrap();
        let job = |capture: &str, ns| Job::new(&home.path().join("a.mcap"), capture, ns, "test");
        jobs.enqueue(&job("a-2", 2)).unwrap();
        jobs.enqueue(&job("a-1", 1)).unwrap();
        let captures = || -> Vec<String> {
            let offered = offered(home.path()).unwrap().into_iter();
            offered
                .map(|offered_jobs| offered_jobs.job.capture)
                .collect()
        };
        assert_eq!(captures(), ["a-1", "a-2"]);
        let file = offered(home.path()).unwrap()[0].file.clone();
        assert!(is_neglected(&file, Duration::ZERO));
        assert!(!is_neglected(&file, Duration::from_secs(60)));
        // The clock is set back by an hour.
        let written = File::options().append(true).open(&file).unwrap();
        let ahead = SystemTime::now() + Duration::from_secs(3600);
        written.set_modified(ahead).unwrap();
        assert!(!is_neglected(&file, Duration::ZERO));
        assert!(is_neglected(&file, Duration::ZERO));
        report_started(&file, "w").unwrap();
        let failed = Answer::Failed {
            reason: "no light".into(),
            words: String::new(),
        };
        answer(&file, &failed).unwrap();
        assert_eq!(
            (captures(), answer_to(&file)),
            (vec!["a-2".into()], Some(failed))
        );
        // The daemon ends it; the answers about it go, and the job is kept.
        std::fs::remove_file(&file).unwrap();
        assert_eq!(captures(), ["a-2"]);
        assert_eq!(answer_to(&file), None);
        assert_eq!(offer_failed_again(home.path(), Some("a-9")).unwrap(), 0);
        assert_eq!(offer_failed_again(home.path(), Some("a-1")).unwrap(), 1);
        assert_eq!(captures(), ["a-1", "a-2"]);
        assert_eq!(offer_failed_again(home.path(), None).unwrap(), 0);
    }
}
