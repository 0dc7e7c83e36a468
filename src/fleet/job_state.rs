//! A job on its way: what is known of it, and what each step of it shares: child processes, the spool, and what is
//! taken off the server.

use super::dispatcher::{Dispatcher, JobEvent, JobOutcome, Task};
use super::distrust::is_marked;
use super::job::{JobOffer, JobReport};
use super::memory_class::MemoryClass;
use super::model_origin::ModelOrigin;
use super::step;
use super::subjects;
use crate::storage::free_bytes;
use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};
use tokio::task::spawn_blocking;

/// How often a job may crash its child, here or at a worker, or come back with a result that is refused.
const MAX_CRASHES: u32 = 3;

/// A job on its way.
pub(super) struct JobState<'a, T> {
    pub(super) offers: &'a Arc<Dispatcher>,
    pub(super) task: &'a Task,
    pub(super) on_event: &'a T,
    pub(super) spool: PathBuf,
    pub(super) crashes: u32,
    /// The attempts whose crashes were counted; the server may tell of one twice.
    pub(super) counted: BTreeSet<String>,
    /// The runs of workers that have started it, and when they, or the server, were last heard of.
    pub(super) started: BTreeMap<String, Instant>,
    /// Since when each of these runs has held the job, and the name of its worker.
    pub(super) held: BTreeMap<String, (String, Instant)>,
    pub(super) connections: u64,
    /// Its packed capture, as long as that is in the spool.
    pub(super) packed: Option<SpooledBytes<'a>>,
    /// Whether it waits for space or for the server, so that nothing is done for it.
    pub(super) waits: Arc<AtomicBool>,
}

/// A file in the spool; it is to be removed before this is dropped.
pub(super) struct SpooledBytes<'a> {
    all: &'a AtomicU64,
    bytes: u64,
}

impl<'a> SpooledBytes<'a> {
    /// Counts a file's bytes among `all` of its kind.
    pub(super) fn count(all: &'a AtomicU64, bytes: u64) -> Self {
        all.fetch_add(bytes, Ordering::Relaxed);
        Self { all, bytes }
    }
}

impl Drop for SpooledBytes<'_> {
    fn drop(&mut self) {
        self.all.fetch_sub(self.bytes, Ordering::Relaxed);
    }
}

/// What needs space on the disk of the models.
#[derive(Clone, Copy)]
pub(super) enum SpaceFor {
    /// A capture that is to be packed.
    Capture,
    /// A result of so many bytes that is to be fetched. It lets jobs end, and their captures give back their space.
    Result(u64),
    /// A model that is to be put into place. Then its result gives back its space, too.
    Model,
}

/// How one result was taken in.
pub(super) enum Received {
    Done(JobOutcome),
    /// The job is to be offered again.
    Again,
    /// It was taken in before.
    Nothing,
}

impl<'a, T: Fn(JobEvent) + Sync> JobState<'a, T> {
    pub(super) fn new(offers: &'a Arc<Dispatcher>, task: &'a Task, on_event: &'a T) -> Self {
        let number = offers.next.fetch_add(1, Ordering::Relaxed);
        Self {
            spool: offers.spool.path().join(number.to_string()),
            offers,
            task,
            on_event,
            crashes: 0,
            counted: BTreeSet::new(),
            started: BTreeMap::new(),
            held: BTreeMap::new(),
            connections: offers.fleet.connections(),
            packed: None,
            waits: Arc::default(),
        }
    }

    pub(super) fn packed_path(&self) -> PathBuf {
        self.spool.join("packed").join(&self.task.name)
    }

    /// Runs a confined step in a thread of its own.
    pub(super) async fn step(
        &self,
        step: &'static str,
        call: impl FnOnce(
            &dyn Fn(&step::Options, &[&str]) -> std::io::Result<step::StepEnd>,
        ) -> std::io::Result<step::StepEnd>
        + Send
        + 'static,
    ) -> std::io::Result<step::StepEnd> {
        let plan = &self.offers.plan;
        let limits = step::Limits {
            memory_mb: plan.memory_mb,
            nice: plan.nice,
            time: Duration::from_secs(plan.time_limit_s.into()),
            threads: 0,
        };
        let cancel = self.offers.cancel.clone();
        let child = spawn_blocking(move || {
            call(&|options, words| step::run(step, limits, options, words, &cancel))
        });
        child.await.map_err(std::io::Error::other)?
    }

    /// Whether a model that is there may be replaced: because that is wanted, or because its worker is distrusted.
    pub(super) fn replaces(&self) -> bool {
        self.offers.plan.replace || is_marked(&self.task.target)
    }

    pub(super) fn is_over(&self) -> bool {
        let lasts = self.task.lasts.as_ref();
        self.offers.is_stopped() || lasts.is_some_and(|file| !file.exists())
    }

    /// Whether this is the report of a crash that was counted.
    pub(super) fn was_counted(&self, reported: &JobReport) -> bool {
        let attempt = reported.crashed_attempt();
        attempt.is_some_and(|attempt| self.counted.contains(&attempt))
    }

    /// Counts a crash. Returns why the job failed if it is not to be tried again.
    pub(super) fn count_crash(&mut self, reason: &str) -> Option<String> {
        self.crashes += 1;
        if self.crashes < MAX_CRASHES {
            self.report_problem(&format!("{reason}; it is tried again"));
            return None;
        }
        Some(format!(
            "the job failed {MAX_CRASHES} times; the last time: {reason}"
        ))
    }

    pub(super) fn report_problem(&self, words: &str) {
        (self.on_event)(JobEvent::Problem(words));
    }

    /// Whether that would leave less free than captures, or others, need. What jobs give back when they end counts as
    /// free for what lets them end: otherwise the spool could keep them from ending for ever.
    pub(super) fn lacks_space(&self, purpose: SpaceFor) -> bool {
        let offers = self.offers;
        let captures = || offers.captures_in_spool.load(Ordering::Relaxed);
        let results = || offers.results_in_spool.load(Ordering::Relaxed);
        let given_back = match purpose {
            SpaceFor::Capture => 0,
            SpaceFor::Result(_) => captures(),
            SpaceFor::Model => captures().saturating_add(results()),
        };
        let needed = self.needed_bytes(purpose);
        free_bytes(offers.spool.path()).is_ok_and(|free| free.saturating_add(given_back) < needed)
    }

    /// Bytes that have to be free.
    fn needed_bytes(&self, purpose: SpaceFor) -> u64 {
        let bytes = match purpose {
            SpaceFor::Result(bytes) => bytes,
            SpaceFor::Capture | SpaceFor::Model => 0,
        };
        self.offers.plan.keep_free_bytes.saturating_add(bytes)
    }

    /// Waits until there is space enough.
    pub(super) async fn wait_for_space(&self, purpose: SpaceFor) {
        while self.lacks_space(purpose) && !self.is_over() {
            self.set_waiting(true);
            let folder = self.offers.spool.path().display();
            self.report_problem(&format!(
                "{folder} has less than {} MB left; jobs wait until you free some space",
                self.needed_bytes(purpose) / 1_000_000
            ));
            self.offers.pause(Duration::from_secs(5)).await;
        }
        self.set_waiting(false);
    }

    pub(super) async fn wait_for_server(&self) {
        while let Err(away) = self.offers.fleet.is_there() {
            if self.is_over() {
                break;
            }
            self.set_waiting(true);
            self.report_problem(&away.to_string());
            self.offers.pause(Duration::from_millis(500)).await;
        }
        self.set_waiting(false);
    }

    pub(super) fn set_waiting(&self, waits: bool) {
        self.waits.store(waits, Ordering::Relaxed);
    }

    pub(super) async fn erase_capture(&self, offer: &JobOffer) {
        let fleet = &self.offers.fleet;
        let piece = |piece| subjects::capture(&fleet.name, &offer.digest, piece);
        fleet.erase_file(offer.pieces, piece).await;
    }

    pub(super) fn note(&self, origin: &ModelOrigin) {
        if let Err(error) = origin.write(&self.task.target) {
            self.report_problem(&error.to_string());
        }
    }

    /// Takes a job off the server that nobody wants any more; not when this process ends alone.
    pub(super) async fn withdraw(&self, offer: &JobOffer) -> JobOutcome {
        if !self.offers.is_stopped() {
            self.offers.fleet.erase(self.subject(offer)).await;
            self.erase_capture(offer).await;
            self.offers.note_withdrawn(&offer.digest, &self.task.target);
        }
        JobOutcome::Withdrawn
    }

    pub(super) fn subject(&self, offer: &JobOffer) -> String {
        let needs = MemoryClass::of(offer.memory_mb);
        subjects::job(
            &self.offers.plan.program,
            needs,
            &self.offers.fleet.name,
            &offer.digest,
        )
    }
}
