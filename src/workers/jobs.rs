//! The queue of jobs: a small file for each in the folder `jobs` beside the recordings, durable once it is enqueued and
//! removed when it is done. Memory holds only the jobs in progress and the number that wait; with a fleet also the
//! names of those that were read once.

use super::find::{Missing, search};
use super::job::{ENDING, Job, set_aside};
use super::object_jobs::ObjectJobs;
use super::remakes::Remakes;
use super::told_settings::told;
use crate::log;
use crate::process::Cancel;
use crate::recording::{Notes, Recording, unfinished_name};
use crate::storage::{self, write_atomically};
use parking_lot::{Condvar, Mutex};
use rustix::io::Errno;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Why a job cannot be kept.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum Error {
    /// The folder of jobs cannot be made or read.
    #[error("{}: {cause}", path.display())]
    Io {
        path: PathBuf,
        cause: std::io::Error,
    },
    /// Its file cannot be written.
    #[error(transparent)]
    Storage(#[from] storage::Error),
}

/// All jobs, shared by the threads that enqueue them and those that do them.
pub struct Jobs {
    recordings: PathBuf,
    folder: PathBuf,
    state: Mutex<State>,
    changed: Condvar,
    cancel: Cancel,
    objects: ObjectJobs,
    remakes: Remakes,
    /// Settings that could not be written at the start. Locked while any are written.
    unwritten: Mutex<Option<String>>,
}

#[derive(Default)]
struct State {
    waiting: usize,
    /// Jobs that are being enqueued: their files may be there, and are not counted yet.
    arriving: usize,
    /// Names of files that were found to be jobs, or could not be set aside, by [`Jobs::take_where`].
    checked: BTreeSet<String>,
    /// By the names of their files.
    running: BTreeMap<String, (Job, Instant)>,
    workers: usize,
    stopped: bool,
    done: u64,
    failed: u64,
    /// What one takes, as far as is known.
    seconds: Option<f64>,
    /// What clients are told of the settings.
    settings: BTreeMap<String, serde_json::Value>,
}

impl State {
    /// How many of these jobs nobody does.
    fn idle(&self, names: &[String]) -> usize {
        let idle = |name: &&String| !self.running.contains_key(*name);
        names.iter().filter(idle).count()
    }
}

/// What is to be done yet.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub struct Backlog {
    /// Jobs that wait.
    pub waiting: usize,
    /// Jobs that are being done.
    pub running: Vec<RunningJob>,
    /// Seconds until all are done; `None` before the first one was.
    pub expected_s: Option<f64>,
    /// Models made since the start.
    pub done: u64,
    /// Jobs that failed since the start.
    pub failed: u64,
    /// Objects of several captures that wait for their model, or whose model is being made.
    pub objects: usize,
    /// Models that are to be made again with other settings, or are being made.
    pub remakes: usize,
    /// What models that are begun from now on are made with, as far as clients are told: values by the names of the
    /// settings. Empty until the first worker starts.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub settings: BTreeMap<String, serde_json::Value>,
}

/// A job that is being done.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct RunningJob {
    /// File name of the recording, when it is complete.
    pub recording: String,
    /// The capture.
    pub capture: String,
    /// Since when, in seconds.
    pub seconds: f64,
}

/// A job that was taken and is to be given back or finished.
pub(super) struct ClaimedJob {
    name: String,
    pub(super) job: Job,
}

impl Jobs {
    /// The jobs of the recordings in a folder: those that an earlier run left, and those that come.
    ///
    /// # Errors
    /// If the folder of jobs cannot be made or read.
    pub fn open(recordings: &Path) -> Result<Self, Error> {
        let folder = recordings.join("jobs");
        let io = |cause| Error::Io {
            path: folder.clone(),
            cause,
        };
        std::fs::create_dir_all(&folder).map_err(io)?;
        let mut waiting = 0;
        for entry in std::fs::read_dir(&folder).map_err(io)? {
            let path = entry.map_err(io)?.path();
            if is_job(&path) {
                waiting += 1;
            } else if is_hidden(&path) {
                // What a kill left of a file that was being written.
                let _ = std::fs::remove_file(&path);
            }
        }
        let cancel = Cancel::new().map_err(io)?;
        let remakes = folder.join("remakes.json");
        let state = State {
            waiting,
            ..State::default()
        };
        Ok(Self {
            recordings: recordings.into(),
            folder,
            state: Mutex::new(state),
            changed: Condvar::new(),
            cancel,
            objects: ObjectJobs::open(recordings),
            remakes: Remakes::open(&remakes),
            unwritten: Mutex::default(),
        })
    }

    /// Enqueues a job until it is done. When this returns, it survives a power cut. A job that is already in the queue
    /// is not added again.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn enqueue(&self, job: &Job) -> Result<(), Error> {
        let path = self.folder.join(job.file_name());
        if path.exists() || path.with_extension(REJECTED).exists() {
            return Ok(());
        }
        self.state.lock().arriving += 1;
        let written = write_atomically(&path, &as_bytes(job)).inspect_err(|_| {
            // It may be there although it is not sure to stay; who is told that there is none must be right.
            let _ = std::fs::remove_file(&path);
        });
        let mut state = self.state.lock();
        state.arriving -= 1;
        state.waiting += usize::from(written.is_ok());
        drop(state);
        self.changed.notify_all();
        written?;
        Ok(())
    }

    /// The jobs of objects of which there are several captures.
    pub fn objects(&self) -> &ObjectJobs {
        &self.objects
    }

    /// The models that are to be made again.
    pub fn remakes(&self) -> &Remakes {
        &self.remakes
    }

    /// Whether nothing waits and nothing is being done, apart from remakes.
    pub fn is_idle(&self) -> bool {
        self.has_no_captures() && self.objects.is_empty()
    }

    /// Whether no capture's model waits or is being made.
    pub(super) fn has_no_captures(&self) -> bool {
        let state = self.state.lock();
        state.waiting == 0 && state.running.is_empty()
    }

    /// Whether one of a session's captures waits or is being made into a model, or would be if it were not rejected.
    pub fn has_jobs_of_session(&self, session: &str) -> bool {
        if self.objects.has_jobs_of_session(session) {
            return true;
        }
        let files = std::fs::read_dir(&self.folder).into_iter().flatten();
        let mut files = files.flatten().map(|file| file.path());
        files.any(|path| {
            let is_kept = is_job(&path) || is_withdrawn(&path);
            let job = std::fs::read(&path).ok().filter(|_| is_kept);
            let job = job.and_then(|bytes| Job::parse(&bytes).ok());
            job.is_some_and(|job| {
                let of = job.capture.rsplit_once('-');
                of.is_some_and(|(name, _)| name == session)
            })
        })
    }

    /// Offers the complete captures of recordings that have no folder in `models` yet: a crash may have come between a
    /// capture and its job. Recordings are named as if they were complete. What cannot be read or kept is logged.
    /// Returns whether all that could be read was kept.
    pub fn enqueue_missing(&self, recordings: &[PathBuf], models: &Path) -> bool {
        let mut are_kept = true;
        for path in recordings {
            let recovered = path.exists();
            let found = if recovered {
                path.clone()
            } else {
                unfinished_name(path)
            };
            let jobs = match Recording::open(&found) {
                Ok(recording) => {
                    are_kept &= self.objects.enqueue_missing(&recording, path);
                    Job::of_recording(&recording, path)
                }
                Err(error) => {
                    log::warning!("{error}; no models will be made from it");
                    continue;
                }
            };
            let folder = models.join(path.file_stem().unwrap_or_default());
            for job in jobs.iter().filter(|j| !folder.join(&j.capture).exists()) {
                if let Err(error) = self.enqueue(job) {
                    let capture = &job.capture;
                    log::error!(
                        "capture {capture}: no model will be made before the daemon's next start: {error}"
                    );
                    are_kept = false;
                }
            }
        }
        are_kept
    }

    /// Withdraws a capture's job that no worker has begun, until [`Self::offer_again`]. Returns its recording, if there
    /// was such a job.
    pub fn withdraw(&self, capture: &str) -> Option<PathBuf> {
        let mut state = self.state.lock();
        let is_idle = |name: &String| !state.running.contains_key(name);
        let name = self.named(capture, ENDING).into_iter().find(is_idle)?;
        let path = self.folder.join(&name);
        let job = std::fs::read(&path)
            .ok()
            .and_then(|bytes| Job::parse(&bytes).ok())?;
        if let Err(error) = std::fs::rename(&path, path.with_extension(REJECTED)) {
            log::error!("{}: {error}", path.display());
            return None;
        }
        state.waiting = state.waiting.saturating_sub(1);
        // A foot switch asks for the status before each press, which counts the jobs: it does not wait for the disk.
        drop(state);
        self.sync();
        Some(self.recordings.join(job.recording))
    }

    /// Puts a withdrawn job back into the queue.
    pub fn offer_again(&self, capture: &str) {
        let mut state = self.state.lock();
        for name in self.named(capture, REJECTED) {
            let path = self.folder.join(name);
            match std::fs::rename(&path, path.with_extension(ENDING)) {
                Ok(()) => state.waiting += 1,
                Err(error) => log::error!("{}: {error}", path.display()),
            }
        }
        drop(state);
        self.changed.notify_all();
        self.sync();
    }

    /// Brings the names of jobs to the disk. If that fails, the notes that changed them are heeded at the next start.
    fn sync(&self) {
        if let Err(error) = storage::sync_folder(&self.folder) {
            log::warning!("{}: {error}", self.folder.display());
        }
    }

    /// Lets notes take effect that were written beside recordings while no daemon ran: a job whose capture was rejected
    /// is withdrawn, and a withdrawn one whose capture is not rejected any more is offered again. Returns the captures
    /// of the former, with their recordings. What cannot be read stays as it is; a withdrawn job that no recording has
    /// a capture of any more is removed.
    pub fn heed_notes(&self) -> Vec<(String, PathBuf)> {
        let files = std::fs::read_dir(&self.folder).into_iter().flatten();
        let mut paths: Vec<PathBuf> = files.flatten().map(|file| file.path()).collect();
        paths.sort();
        let mut notes: BTreeMap<PathBuf, Option<Notes>> = BTreeMap::new();
        let mut withdrawn = Vec::new();
        for path in paths {
            let is_withdrawn = is_withdrawn(&path);
            if !is_withdrawn && !is_job(&path) {
                continue;
            }
            let job = std::fs::read(&path).map_err(|e| e.to_string());
            let Ok(job) = job.and_then(|bytes| Job::parse(&bytes)) else {
                continue;
            };
            let recording = match search(&self.recordings, &job) {
                Ok(recording) => recording,
                Err(Missing::Gone) if is_withdrawn => {
                    remove_withdrawn(&path, &job);
                    continue;
                }
                Err(_) => continue,
            };
            let notes = notes.entry(recording.clone()).or_insert_with(|| {
                let recording = Recording::open(&recording);
                recording.ok().map(|recording| Notes::of(&recording))
            });
            let Some(notes) = notes else {
                continue;
            };
            match (is_withdrawn, notes.on(&job.capture).is_rejected()) {
                (true, false) => self.offer_again(&job.capture),
                (false, true) => {
                    let of = self.withdraw(&job.capture);
                    withdrawn.extend(of.map(|recording| (job.capture, recording)));
                }
                _ => {}
            }
        }
        withdrawn
    }

    /// Whether the model of a capture is being made.
    pub fn is_running(&self, capture: &str) -> bool {
        let state = self.state.lock();
        state
            .running
            .values()
            .any(|(job, _)| job.capture == capture)
    }

    /// The names of a capture's files of this ending.
    fn named(&self, capture: &str, ending: &str) -> Vec<String> {
        let end = format!("-{capture}.{ending}");
        let files = std::fs::read_dir(&self.folder)
            .into_iter()
            .flatten()
            .flatten();
        let names = files.filter_map(|file| file.file_name().into_string().ok());
        // A name begins with the trigger's time, in digits alone.
        let is_of = |name: &String| {
            let time = name.strip_suffix(&end);
            time.is_some_and(|time| time.len() == 20 && time.bytes().all(|b| b.is_ascii_digit()))
        };
        let mut names: Vec<String> = names.filter(is_of).collect();
        names.sort();
        names
    }

    /// What is to be done yet.
    pub fn backlog(&self) -> Backlog {
        // Their locks are never waited for with this one held: whether one of them may begin is asked of this queue.
        let (objects, remakes) = (self.objects.len(), self.remakes.len());
        let state = self.state.lock();
        let running: Vec<RunningJob> = state.running.values().map(running).collect();
        let expected = |each: f64| {
            let left = running.iter().map(|r| (each - r.seconds).max(0.0));
            (left.sum::<f64>() + each * state.waiting as f64) / state.workers.max(1) as f64
        };
        Backlog {
            waiting: state.waiting,
            expected_s: state.seconds.map(expected),
            done: state.done,
            failed: state.failed,
            objects,
            remakes,
            settings: state.settings.clone(),
            running,
        }
    }

    /// Where the recordings are.
    pub(super) fn recordings(&self) -> &Path {
        &self.recordings
    }

    /// Sets the settings of jobs that are begun from now on: the configuration of a reconstruction, as TOML. Each
    /// process reads this copy, so later edits of the configuration file do not affect it.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn set_settings(&self, settings: &str) -> Result<(), Error> {
        let mut unwritten = self.unwritten.lock();
        self.write_settings(settings)?;
        *unwritten = None;
        Ok(())
    }

    /// Sets the settings at the start, which goes on also if they cannot be written; then no job is begun until they
    /// are ([`Self::has_settings`]).
    pub(super) fn begin_with_settings(&self, settings: &str) {
        let mut unwritten = self.unwritten.lock();
        if let Err(error) = self.write_settings(settings) {
            log::error!("{error}; no model is made until the settings of models can be written");
            // The process of the fleet must not find those of an earlier start.
            let _ = std::fs::remove_file(self.settings());
            *unwritten = Some(settings.to_owned());
        }
    }

    /// Whether the settings are on the disk; tries once more to write them if they are not.
    pub(super) fn has_settings(&self) -> bool {
        let mut unwritten = self.unwritten.lock();
        let Some(settings) = unwritten.as_deref() else {
            return true;
        };
        let is_written = self.write_settings(settings).is_ok();
        if is_written {
            log::notice!("the settings of models are written, so that models are made");
            *unwritten = None;
        }
        is_written
    }

    /// A full disk does not matter to settings that are there already.
    fn write_settings(&self, settings: &str) -> Result<(), Error> {
        let path = self.settings();
        let is_there = std::fs::read(&path).is_ok_and(|found| found == settings.as_bytes());
        if !is_there {
            write_atomically(&path, settings.as_bytes())?;
        }
        self.state.lock().settings = told(settings);
        Ok(())
    }

    /// Where the settings are.
    pub(super) fn settings(&self) -> PathBuf {
        self.folder.join("settings.toml")
    }

    /// Says how many do jobs at the same time.
    pub(super) fn set_workers(&self, workers: usize) {
        self.state.lock().workers = workers;
    }

    /// The oldest job that no worker has begun, as soon as there is one; `None` after the queue was closed.
    pub(super) fn take(&self) -> Option<ClaimedJob> {
        let mut state = self.state.lock();
        while !state.stopped {
            if state.waiting == 0 {
                self.changed.wait(&mut state);
                continue;
            }
            match self.read_oldest(&state.running) {
                Ok(Some((name, job))) => {
                    state.waiting -= 1;
                    if let Some(job) = job {
                        let running = (job.clone(), Instant::now());
                        state.running.insert(name.clone(), running);
                        return Some(ClaimedJob { name, job });
                    }
                }
                // A person has removed them.
                Ok(None) => state.waiting = 0,
                Err(error) => {
                    log::error!("{}: {error}", self.folder.display());
                    drop(state);
                    self.pause(Duration::from_secs(5));
                    state = self.state.lock();
                }
            }
        }
        None
    }

    /// The oldest job whose file is as `wanted`, if there is one that nobody does. Also sets right how many wait, and
    /// sets aside what is not a job, whether it is wanted or not: nothing else does where jobs are taken in this way.
    pub(super) fn take_where(&self, wanted: impl Fn(&Path) -> bool) -> Option<ClaimedJob> {
        // Files are looked at without the lock, because a capture that is enqueued waits for it.
        let names = self.names().ok()?;
        self.recount(&names);
        for name in names {
            let path = self.folder.join(&name);
            let is_wanted = wanted(&path);
            let mut state = self.state.lock();
            if state.stopped {
                return None;
            }
            if !is_wanted && state.checked.contains(&name) {
                continue;
            }
            if state.running.contains_key(&name) || !path.exists() {
                continue;
            }
            let Ok(read) = self.read(&name) else {
                continue;
            };
            match read.filter(|_| is_wanted) {
                Some(job) => {
                    state.checked.remove(&name);
                    state.waiting = state.waiting.saturating_sub(1);
                    let running = (job.clone(), Instant::now());
                    state.running.insert(name.clone(), running);
                    return Some(ClaimedJob { name, job });
                }
                None => {
                    state.checked.insert(name);
                }
            }
        }
        None
    }

    /// The names of all jobs, the oldest first.
    fn names(&self) -> std::io::Result<Vec<String>> {
        let mut names = Vec::new();
        for entry in std::fs::read_dir(&self.folder)? {
            // No job has a name of other characters.
            let Ok(name) = entry?.file_name().into_string() else {
                continue;
            };
            if is_job(Path::new(&name)) {
                names.push(name);
            }
        }
        names.sort();
        Ok(names)
    }

    /// Sets right how many jobs wait, if these names show another number: people remove files of jobs, and the process
    /// of the fleet puts failed ones back.
    fn recount(&self, names: &[String]) {
        let mut state = self.state.lock();
        if state.arriving > 0 || state.idle(names) == state.waiting {
            return;
        }
        // Jobs may have come or ended since they were listed; as long as this is locked, none is counted.
        if let Ok(names) = self.names() {
            state.waiting = state.idle(&names);
            state
                .checked
                .retain(|name| names.binary_search(name).is_ok());
        }
    }

    /// A job's file.
    pub(super) fn file(&self, taken: &ClaimedJob) -> PathBuf {
        self.folder.join(&taken.name)
    }

    /// The name of the oldest job that nobody does, and the job; `None` instead of one that was set aside.
    fn read_oldest(
        &self,
        running: &BTreeMap<String, (Job, Instant)>,
    ) -> std::io::Result<Option<(String, Option<Job>)>> {
        let Some(name) = oldest(&self.folder, running)? else {
            return Ok(None);
        };
        let job = self.read(&name)?;
        Ok(Some((name, job)))
    }

    /// Reads a job; a file that is not a job is set aside.
    ///
    /// # Errors
    /// If this process can open or read no file at present: the job may be sound.
    fn read(&self, name: &str) -> std::io::Result<Option<Job>> {
        let path = self.folder.join(name);
        let bytes = match std::fs::read(&path) {
            Err(error) if lacks_resources(&error) => return Err(error),
            read => read.map_err(|error| error.to_string()),
        };
        match bytes.and_then(|bytes| Job::parse(&bytes)) {
            Ok(job) => Ok(Some(job)),
            Err(problem) => {
                let end = set_aside(&path);
                log::error!("{} is not a job: {problem}; {end}", path.display());
                Ok(None)
            }
        }
    }

    /// Notes on the disk how often a job was begun.
    pub(super) fn note(&self, taken: &ClaimedJob) {
        let written = write_atomically(&self.folder.join(&taken.name), &as_bytes(&taken.job));
        if let Err(error) = written {
            log::warning!("{error}");
        }
    }

    /// Lets a job wait again.
    pub(super) fn requeue(&self, taken: &ClaimedJob) {
        let mut state = self.state.lock();
        state.running.remove(&taken.name);
        state.waiting += 1;
        self.changed.notify_all();
    }

    /// Removes a job that has come to its end.
    pub(super) fn finish(&self, taken: &ClaimedJob, done: bool) {
        let path = self.folder.join(&taken.name);
        if let Err(error) = std::fs::remove_file(&path) {
            log::warning!("{}: {error}", path.display());
        }
        let mut state = self.state.lock();
        let Some((_, since)) = state.running.remove(&taken.name) else {
            return;
        };
        if done {
            let (seconds, before) = (since.elapsed().as_secs_f64(), state.seconds);
            // The last ones count most: another object, another resolution.
            state.seconds = Some(before.map_or(seconds, |before| 0.7 * before + 0.3 * seconds));
            state.done += 1;
        } else {
            state.failed += 1;
        }
    }

    /// Waits, but not longer than until there shall be no more jobs.
    pub(super) fn pause(&self, time: Duration) {
        let mut state = self.state.lock();
        let goes_on = |state: &mut State| !state.stopped;
        self.changed.wait_while_for(&mut state, goes_on, time);
    }

    /// Whether there shall be no more jobs.
    pub(super) fn is_stopped(&self) -> bool {
        self.state.lock().stopped
    }

    /// Ends the processes that do jobs once there shall be no more.
    pub(super) fn cancel(&self) -> &Cancel {
        &self.cancel
    }

    /// Closes the queue: no more jobs are handed out. Their files stay.
    pub(super) fn stop(&self) {
        self.state.lock().stopped = true;
        self.changed.notify_all();
        self.objects.stop();
        self.remakes.stop();
        self.cancel.cancel();
    }
}

/// The ending of the names of jobs that were withdrawn because their captures were rejected.
const REJECTED: &str = "rejected";

fn as_bytes(job: &Job) -> Vec<u8> {
    serde_json::to_vec(job).unwrap_or_default()
}

fn is_job(path: &Path) -> bool {
    !is_hidden(path) && path.extension().is_some_and(|e| e == ENDING)
}

fn is_withdrawn(path: &Path) -> bool {
    !is_hidden(path) && path.extension().is_some_and(|e| e == REJECTED)
}

/// Removes a withdrawn job that nothing can be made of. A capture of the same name could bring it back into the queue.
fn remove_withdrawn(path: &Path, job: &Job) {
    match std::fs::remove_file(path) {
        Ok(()) => log::notice!(
            "capture {}: rejected, and in no recording any more: its job is removed",
            job.capture
        ),
        Err(error) => log::warning!("{}: {error}", path.display()),
    }
}

/// Whether the process or the system lacks what it takes to open or read any file.
fn lacks_resources(error: &std::io::Error) -> bool {
    matches!(
        Errno::from_io_error(error),
        Some(Errno::MFILE | Errno::NFILE | Errno::NOMEM)
    )
}

/// Whether a file is being written, or none of a job.
pub(super) fn is_hidden(path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default();
    name.as_encoded_bytes().starts_with(b".")
}

fn running((job, since): &(Job, Instant)) -> RunningJob {
    RunningJob {
        recording: job.recording.clone(),
        capture: job.capture.clone(),
        seconds: since.elapsed().as_secs_f64(),
    }
}

/// The name of the oldest job that is not being done.
fn oldest(
    folder: &Path,
    running: &BTreeMap<String, (Job, Instant)>,
) -> std::io::Result<Option<String>> {
    let mut oldest: Option<String> = None;
    for entry in std::fs::read_dir(folder)? {
        let path = entry?.path();
        let Some(name) = path.file_name().and_then(|n| n.to_str()) else {
            continue;
        };
        let older = oldest.as_deref().is_none_or(|o| name < o);
        if older && is_job(&path) && !running.contains_key(name) {
            oldest = Some(name.to_owned());
        }
    }
    Ok(oldest)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_hinders_all_files_leaves_a_job_in_the_queue() {
        let hinders = |errno: Errno| lacks_resources(&errno.into());
        assert!(
            [Errno::MFILE, Errno::NFILE, Errno::NOMEM]
                .map(hinders)
                .iter()
                .all(|&h| h)
        );
        assert!(
            ![Errno::IO, Errno::ISDIR, Errno::ACCESS]
                .map(hinders)
                .iter()
                .any(|&h| h)
        );
    }
}
