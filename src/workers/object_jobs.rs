//! The queue of jobs for objects: a file for each in the folder `jobs/objects` beside the recordings, durable once it
//! is enqueued, replaced by a newer one of the same object, and removed when it is done. A note on a capture of an
//! earlier session has a file there until its object is enqueued.

use super::job::{Job, set_aside};
use super::object_find::{named, session_of};
use crate::frame::{CaptureId, Trigger};
use crate::log;
use crate::recording::{CaptureOutcome, Recording, Topic, finished_name};
use crate::storage::write_atomically;
use parking_lot::{Condvar, Mutex, MutexGuard};
use sha2::{Digest, Sha256};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

/// An object whose captures are to be fused.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObjectJob {
    /// The object's number.
    pub subject: String,
    /// The newest of its captures. It says in which session the others are.
    pub newest: Job,
    /// Whether it was told how the captures lie, or nobody waits for that: then their model is made.
    #[serde(default)]
    pub is_registered: bool,
}

/// The ending of their files' names.
const ENDING: &str = "object";
/// The ending of the names of files that say which captures notes are about.
const NOTED: &str = "noted";
/// How often something is looked for that nobody tells of.
const LOOK_AGAIN: Duration = Duration::from_millis(300);

/// All objects' jobs.
pub struct ObjectJobs {
    folder: PathBuf,
    recordings: PathBuf,
    state: Mutex<State>,
    /// How many entries the state has. It can be read while the state is locked to write one of them to the disk.
    count: AtomicUsize,
    changed: Condvar,
}

#[derive(Default)]
struct State {
    /// By the names of their files.
    entries: BTreeMap<String, Entry>,
    session: Session,
    /// Captures that notes were about whose objects an earlier run did not enqueue any more.
    left: Vec<String>,
    generation: u64,
    is_stopped: bool,
}

/// The session in progress: one that is over gets no more captures, and each start begins another one.
#[derive(Default)]
struct Session {
    name: String,
    /// Its durable captures of subjects: subject and job, by the captures' ids.
    captures: BTreeMap<String, (String, Job)>,
}

impl Session {
    fn add(&mut self, job: &Job, subject: &str) {
        let name = session_of(&job.capture);
        // A name serves again when its recording was moved away.
        if self.name != name || self.captures.contains_key(&job.capture) {
            *self = Self {
                name: name.to_owned(),
                captures: BTreeMap::new(),
            };
        }
        if !subject.is_empty() {
            let of_subject = (subject.to_owned(), job.clone());
            self.captures.insert(job.capture.clone(), of_subject);
        }
    }

    /// The newest capture of a subject of which there are several.
    fn newest_of_several(&self, subject: &str) -> Option<&Job> {
        let captures = self.captures.values();
        let of_subject: Vec<&Job> = captures
            .filter(|(of, _)| of == subject)
            .map(|(_, job)| job)
            .collect();
        let newest = of_subject.iter().max_by_key(|job| job.trigger_ns).copied();
        newest.filter(|_| of_subject.len() > 1)
    }

    /// The job of a capture's object, which is to be made again; `None` of a capture without an object of several.
    fn object_of(&self, capture: &str) -> Option<ObjectJob> {
        let (subject, _) = self.captures.get(capture)?;
        Some(ObjectJob {
            subject: subject.clone(),
            newest: self.newest_of_several(subject)?.clone(),
            is_registered: true,
        })
    }
}

impl State {
    /// The oldest job that waits and is registered or not, and the name of its file.
    fn oldest(&mut self, is_registered: bool) -> Option<(&String, &mut Entry)> {
        let entries = self.entries.iter_mut();
        let waiting =
            entries.filter(|(_, e)| !e.is_running && e.job.is_registered == is_registered);
        waiting.min_by_key(|(_, e)| e.job.newest.trigger_ns)
    }
}

struct Entry {
    job: ObjectJob,
    /// Tells it from the one that it replaces, which may still be carried out.
    generation: u64,
    is_running: bool,
}

/// A job that was taken, to be given back or finished.
pub(super) struct ClaimedObjectJob {
    name: String,
    generation: u64,
    pub(super) job: ObjectJob,
}

impl ObjectJob {
    /// The name of its file: an object of a session has but one.
    fn file_name(&self) -> String {
        let session = session_of(&self.newest.capture);
        let digest = Sha256::digest(format!("{session}\0{}", self.subject));
        let letters = format!("{digest:x}");
        format!("{letters:.24}.{ENDING}")
    }

    /// The objects of a session's recordings with two complete captures or more, rejected or not, each with the newest
    /// of them. Each recording comes with the path that it has when it is complete.
    fn of_session(recordings: &[(&Recording, &Path)]) -> Vec<Self> {
        let mut of_subject: BTreeMap<String, (usize, Self)> = BTreeMap::new();
        for (recording, path) in recordings {
            for (subject, trigger) in complete_captures(recording) {
                let id = trigger.id.as_str();
                let job = Self {
                    newest: Job::new(path, id, trigger.time.0, &trigger.source),
                    subject: subject.clone(),
                    is_registered: false,
                };
                let (count, newest) = of_subject.entry(subject).or_insert((0, job.clone()));
                *count += 1;
                if job.newest.trigger_ns >= newest.newest.trigger_ns {
                    *newest = job;
                }
            }
        }
        let several = of_subject.into_values().filter(|(count, _)| *count > 1);
        several.map(|(_, job)| job).collect()
    }
}

/// The triggers of a recording's complete captures that name an object, with its number.
fn complete_captures(recording: &Recording) -> Vec<(String, Trigger)> {
    let records = recording.messages(&Topic::Capture).iter();
    let complete: BTreeSet<String> = records
        .filter_map(|m| recording.capture_record(m).ok())
        .filter(|record| record.outcome == CaptureOutcome::Complete)
        .map(|record| record.id)
        .collect();
    let triggers = recording.messages(&Topic::Trigger).iter();
    triggers
        .filter_map(|m| recording.trigger(m).ok())
        .filter(|trigger| complete.contains(trigger.id.as_str()))
        .filter_map(|trigger| {
            let subject = trigger.subject.clone().filter(|s| !s.is_empty())?;
            Some((subject, trigger))
        })
        .collect()
}

impl ObjectJobs {
    /// Those that an earlier run left, and those that come. The folder need not be there.
    pub(super) fn open(recordings: &Path) -> Self {
        let folder = recordings.join("jobs").join("objects");
        let mut state = State::default();
        for file in std::fs::read_dir(&folder).into_iter().flatten().flatten() {
            let path = file.path();
            let Some(name) = path.file_name().and_then(|n| n.to_str()) else {
                continue;
            };
            if name.starts_with('.') {
                // What a kill left of a file that was being written.
                let _ = std::fs::remove_file(&path);
            } else if let Some(capture) = noted_capture(name) {
                state.left.push(capture.to_owned());
            } else if path.extension().is_some_and(|e| e == ENDING)
                && let Some(job) = read(&path)
            {
                state.generation += 1;
                let entry = Entry {
                    job,
                    generation: state.generation,
                    is_running: false,
                };
                state.entries.insert(name.to_owned(), entry);
            }
        }
        Self {
            folder,
            recordings: recordings.into(),
            count: AtomicUsize::new(state.entries.len()),
            state: Mutex::new(state),
            changed: Condvar::new(),
        }
    }

    /// Takes in that a capture of a subject, which may be empty, is durable. From the second one of a session on, its
    /// object is fused.
    pub fn captured(&self, newest: Job, subject: &str) {
        let mut state = self.state.lock();
        state.session.add(&newest, subject);
        if state.session.newest_of_several(subject).is_none() {
            return;
        }
        drop(state);
        self.enqueue(ObjectJob {
            subject: subject.to_owned(),
            newest,
            is_registered: false,
        });
    }

    /// Takes in that somebody rejected a capture, or took that back: its object's model is made again, if it has a
    /// subject of which the session has several captures. Unless [`Self::noted_in_progress`], reads the session's
    /// recordings.
    pub fn noted(&self, capture: &str) {
        if self.noted_in_progress(capture) || self.noted_in_recordings(capture) {
            let _ = std::fs::remove_file(self.noted_file(capture));
        }
    }

    /// As [`Self::noted`], if the capture is of the session in progress, whose captures are known. Returns whether it
    /// is.
    pub fn noted_in_progress(&self, capture: &str) -> bool {
        let state = self.state.lock();
        if state.session.name != session_of(capture) {
            return false;
        }
        let object = state.session.object_of(capture);
        drop(state);
        if let Some(job) = object {
            self.enqueue(job);
        }
        true
    }

    /// As [`Self::noted`], of any session. Returns whether nothing is left to do.
    fn noted_in_recordings(&self, capture: &str) -> bool {
        let recordings = self.recordings_of(session_of(capture));
        let is_noted = |(_, trigger): &(String, Trigger)| trigger.id.as_str() == capture;
        let noted = recordings
            .iter()
            .find_map(|(recording, _)| complete_captures(recording).into_iter().find(is_noted));
        let Some((subject, _)) = noted else {
            // One that cannot be read now may have it.
            return named(&self.recordings, session_of(capture)).len() == recordings.len();
        };
        let recordings: Vec<_> = recordings.iter().map(|(r, p)| (r, p.as_path())).collect();
        let objects = ObjectJob::of_session(&recordings).into_iter();
        let mut are_kept = true;
        for job in objects.filter(|job| job.subject == subject) {
            are_kept &= self.enqueue(ObjectJob {
                is_registered: true,
                ..job
            });
        }
        are_kept
    }

    /// Has [`Self::noted`] repeated after the next start if this run ends before it is done.
    pub fn keep_noted(&self, capture: &str) {
        if CaptureId::new(capture).is_err() {
            return;
        }
        if let Err(error) = self.put(&self.noted_file(capture), &[]) {
            log::warning!("capture {capture}: {error}");
        }
    }

    /// The captures of which [`Self::noted`] was not done when the last run ended. Tells them once.
    pub(super) fn take_left(&self) -> Vec<String> {
        std::mem::take(&mut self.state.lock().left)
    }

    fn noted_file(&self, capture: &str) -> PathBuf {
        self.folder.join(format!("{capture}.{NOTED}"))
    }

    /// A session's recordings that can be read, each with the path that it has when it is complete.
    fn recordings_of(&self, session: &str) -> Vec<(Recording, PathBuf)> {
        let paths = named(&self.recordings, session).into_iter();
        let read = paths.filter_map(|path| {
            let recording = Recording::open(&path).ok()?;
            Some((recording, finished_name(&path).unwrap_or(path)))
        });
        read.collect()
    }

    /// Enqueues the objects of recordings that the end of an earlier run interrupted: it may have come between a
    /// capture and its job. Captures in other recordings of the session count, too. A job that is there already stays.
    /// Returns whether all were kept.
    pub(super) fn enqueue_missing(&self, recording: &Recording, path: &Path) -> bool {
        let own = complete_captures(recording);
        let Some((_, first)) = own.first() else {
            return true;
        };
        let others = self.recordings_of(session_of(first.id.as_str()));
        let others = others.iter().map(|(r, p)| (r, p.as_path()));
        let others = others.filter(|(_, other)| *other != path);
        let all: Vec<_> = std::iter::once((recording, path)).chain(others).collect();
        let objects = ObjectJob::of_session(&all).into_iter();
        let mut are_kept = true;
        for job in objects.filter(|job| own.iter().any(|(subject, _)| *subject == job.subject)) {
            let is_known = self.state.lock().entries.contains_key(&job.file_name());
            are_kept &= is_known || self.enqueue(job);
        }
        are_kept
    }

    /// Puts a job into the place of an older one of its object. Returns whether it was kept.
    fn enqueue(&self, job: ObjectJob) -> bool {
        let name = job.file_name();
        let mut state = self.state.lock();
        if let Err(error) = self.write(&name, &job) {
            log::error!(
                "object {}: its captures will not be fused: {error}",
                job.subject
            );
            return false;
        }
        state.generation += 1;
        let entry = Entry {
            job,
            generation: state.generation,
            is_running: false,
        };
        state.entries.insert(name, entry);
        self.count.store(state.entries.len(), Ordering::Release);
        self.changed.notify_all();
        true
    }

    fn write(&self, name: &str, job: &ObjectJob) -> Result<(), String> {
        let bytes = serde_json::to_vec(job).map_err(|e| e.to_string())?;
        self.put(&self.folder.join(name), &bytes)
    }

    fn put(&self, path: &Path, bytes: &[u8]) -> Result<(), String> {
        std::fs::create_dir_all(&self.folder).map_err(|e| e.to_string())?;
        write_atomically(path, bytes).map_err(|e| e.to_string())
    }

    /// How many wait or are carried out.
    pub fn len(&self) -> usize {
        self.count.load(Ordering::Acquire)
    }

    /// Whether no job waits.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Whether one is of a session.
    pub(super) fn has_jobs_of_session(&self, session: &str) -> bool {
        let state = self.state.lock();
        let mut jobs = state.entries.values().map(|entry| &entry.job);
        jobs.any(|job| session_of(&job.newest.capture) == session)
    }

    /// The oldest job that is registered or not, as soon as there is one and `may` says that it may begin, which may
    /// wait for other locks; `None` after the end.
    pub(super) fn take(
        &self,
        is_registered: bool,
        may: impl Fn() -> bool,
    ) -> Option<ClaimedObjectJob> {
        let mut state = self.state.lock();
        while !state.is_stopped {
            if state.oldest(is_registered).is_none() {
                self.changed.wait(&mut state);
            } else if !MutexGuard::unlocked(&mut state, &may) {
                self.changed.wait_for(&mut state, LOOK_AGAIN);
            } else if !state.is_stopped
                && let Some((name, entry)) = state.oldest(is_registered)
            {
                entry.is_running = true;
                return Some(ClaimedObjectJob {
                    name: name.clone(),
                    generation: entry.generation,
                    job: entry.job.clone(),
                });
            }
        }
        None
    }

    /// Notes on the disk how far a job is, unless a newer one replaced it.
    pub(super) fn note(&self, taken: &ClaimedObjectJob) {
        let mut state = self.state.lock();
        let entry = state.entries.get_mut(&taken.name);
        let Some(entry) = entry.filter(|e| e.generation == taken.generation) else {
            return;
        };
        entry.job = taken.job.clone();
        if let Err(error) = self.write(&taken.name, &taken.job) {
            log::warning!("object {}: {error}", taken.job.subject);
        }
    }

    /// Lets a job wait again.
    pub(super) fn requeue(&self, taken: &ClaimedObjectJob) {
        let mut state = self.state.lock();
        let entry = state.entries.get_mut(&taken.name);
        if let Some(entry) = entry.filter(|e| e.generation == taken.generation) {
            entry.is_running = false;
        }
        self.changed.notify_all();
    }

    /// Removes a job that has come to its end, unless a newer one replaced it.
    pub(super) fn finish(&self, taken: &ClaimedObjectJob) {
        let mut state = self.state.lock();
        let of = state.entries.get(&taken.name);
        if of.is_some_and(|e| e.generation == taken.generation) {
            state.entries.remove(&taken.name);
            let path = self.folder.join(&taken.name);
            if let Err(error) = std::fs::remove_file(&path) {
                log::warning!("{}: {error}", path.display());
            }
            self.count.store(state.entries.len(), Ordering::Release);
        }
    }

    /// Ends [`Self::take`]. The files stay.
    pub(super) fn stop(&self) {
        self.state.lock().is_stopped = true;
        self.changed.notify_all();
    }

    /// Whether there shall be no more jobs.
    pub(super) fn is_stopped(&self) -> bool {
        self.state.lock().is_stopped
    }
}

/// The capture that a file of this name says notes are about.
fn noted_capture(name: &str) -> Option<&str> {
    let capture = name.strip_suffix(NOTED)?.strip_suffix('.')?;
    CaptureId::new(capture).is_ok().then_some(capture)
}

/// Reads a job; a file that is not a job is set aside.
fn read(path: &Path) -> Option<ObjectJob> {
    let bytes = std::fs::read(path).map_err(|e| e.to_string());
    let parsed = bytes.and_then(|b| {
        let job: ObjectJob = serde_json::from_slice(&b).map_err(|e| e.to_string())?;
        let newest = serde_json::to_vec(&job.newest).map_err(|e| e.to_string())?;
        Job::parse(&newest)?;
        Ok(job)
    });
    match parsed {
        Ok(job) => Some(job),
        Err(problem) => {
            let end = set_aside(path);
            log::error!("{} is not a job: {problem}; {end}", path.display());
            None
        }
    }
}
