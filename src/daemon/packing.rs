//! The thread that compresses complete recordings, one after the other, while the rig is idle, if that is configured. A
//! press interrupts it at once; the recording that it was working on is packed again later, from its start.

use super::capturing::Capturing;
use super::parameters::RecordingParameters;
use crate::clock::Clock;
use crate::log;
use crate::process::lower_thread_priority;
use crate::recording::{Packed, pack};
use crate::storage::free_bytes;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// How often the thread checks whether the rig is idle.
const ASKED: Duration = Duration::from_millis(250);

/// The handle of the thread. Dropping it makes the thread abandon its recording and stop.
pub struct Packing {
    stopped: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Packing {
    /// Starts the thread; `None` if packing is not configured. `keep_free_bytes` of the disk must stay free; the number
    /// may change at any time.
    ///
    /// # Errors
    /// If the system cannot start a thread.
    pub fn start(
        capturing: &Arc<Capturing>,
        parameters: &RecordingParameters,
        keep_free_bytes: Arc<AtomicU64>,
        clock: Clock,
    ) -> std::io::Result<Option<Self>> {
        if parameters.pack_after_idle_s == 0 {
            return Ok(None);
        }
        let packer = Packer::new(capturing, parameters, keep_free_bytes, clock);
        packer.start().map(Some)
    }
}

impl Drop for Packing {
    fn drop(&mut self) {
        self.stopped.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

pub(super) struct Packer {
    capturing: Arc<Capturing>,
    folder: PathBuf,
    clock: Clock,
    /// Since when the rig is idle, or when no recording was found to pack.
    since: Instant,
    /// How long the rig must be idle before a recording is packed.
    rest: Duration,
    keep_free_bytes: Arc<AtomicU64>,
    stopped: Arc<AtomicBool>,
    /// Recordings that were packed or are not worth it.
    done: BTreeSet<PathBuf>,
}

impl Packer {
    pub(super) fn new(
        capturing: &Arc<Capturing>,
        parameters: &RecordingParameters,
        keep_free_bytes: Arc<AtomicU64>,
        clock: Clock,
    ) -> Self {
        Self {
            capturing: capturing.clone(),
            folder: parameters.folder.clone(),
            clock,
            since: clock.now(),
            rest: Duration::from_secs(parameters.pack_after_idle_s),
            keep_free_bytes,
            stopped: Arc::default(),
            done: BTreeSet::new(),
        }
    }

    /// Starts the thread.
    ///
    /// # Errors
    /// If the system cannot start a thread.
    pub(super) fn start(mut self) -> std::io::Result<Packing> {
        let stopped = self.stopped.clone();
        let thread = std::thread::Builder::new().name("packing".into());
        let thread = thread.spawn(move || self.run())?;
        Ok(Packing {
            stopped,
            thread: Some(thread),
        })
    }

    fn run(&mut self) {
        for missing in lower_thread_priority(19) {
            log::warning!("the thread that packs recordings cannot set {missing}");
        }
        while !self.stopped.load(Ordering::Acquire) {
            if !self.step() {
                self.clock.sleep(ASKED);
            }
        }
    }

    /// Packs one recording if the rig has been idle for long enough; false if there is nothing to do now.
    pub(super) fn step(&mut self) -> bool {
        let is_idle = self.capturing.is_idle();
        if is_idle && self.clock.elapsed(self.since) < self.rest {
            return false;
        }
        if is_idle && let Some(path) = self.next() {
            self.pack(path);
            return true;
        }
        self.since = self.clock.now();
        false
    }

    /// The first recording that is not done and for whose copy the disk has space.
    fn next(&self) -> Option<PathBuf> {
        let entries = std::fs::read_dir(&self.folder).ok()?.flatten();
        let mut paths: Vec<PathBuf> = entries.map(|entry| entry.path()).collect();
        paths.retain(|path| path.extension().is_some_and(|e| e == "mcap"));
        paths.sort();
        let mut left = paths.into_iter().filter(|path| !self.done.contains(path));
        left.find(|path| self.has_room(path))
    }

    fn has_room(&self, path: &Path) -> bool {
        let (length, free) = (std::fs::metadata(path), free_bytes(&self.folder));
        let keep_free_bytes = self.keep_free_bytes.load(Ordering::Relaxed);
        match (length, free) {
            (Ok(length), Ok(free)) => free >= length.len().saturating_add(keep_free_bytes),
            _ => false,
        }
    }

    fn pack(&mut self, path: PathBuf) {
        let goes_on = || !self.stopped.load(Ordering::Acquire) && self.capturing.is_idle();
        match pack(&path, goes_on) {
            Ok(Packed::GivenUp) => return,
            Ok(Packed::Smaller(before, after)) => log::notice!(
                "packed {} from {} MB to {} MB",
                path.display(),
                before / 1_000_000,
                after / 1_000_000
            ),
            Ok(Packed::Already | Packed::NotWorthwhile) => {}
            Err(error) => log::warning!(
                "cannot pack a recording, which was left unchanged: \
                {error}"
            ),
        }
        self.done.insert(path);
    }
}
