//! A job on its way: what is known of it, and what each step of it shares: child processes, the spool, and what is
//! taken off the server.

use super::dispatcher::{Dispatcher, JobEvent, JobOutcome, Task};
use super::distrust::is_marked;
use super::job::JobOffer;
use super::memory_class::MemoryClass;
use super::model_origin::ModelOrigin;
use super::step;
use super::subjects;
use crate::storage::free_bytes;
use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::Ordering;
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

    pub(super) fn lacks_space(&self) -> bool {
        self.lacks_space_for(0)
    }

    fn lacks_space_for(&self, bytes: u64) -> bool {
        let needed = self.offers.plan.keep_free_bytes.saturating_add(bytes);
        free_bytes(self.offers.spool.path()).is_ok_and(|free| free < needed)
    }

    /// Waits until a file of this length leaves as much space free as captures, or others, need.
    pub(super) async fn wait_for_space(&self, bytes: u64) {
        while self.lacks_space_for(bytes) && !self.is_over() {
            let folder = self.offers.spool.path().display();
            let needed = self.offers.plan.keep_free_bytes.saturating_add(bytes);
            self.report_problem(&format!(
                "{folder} has less than {} MB left; jobs wait until you free some space",
                needed / 1_000_000
            ));
            self.offers.pause(Duration::from_secs(5)).await;
        }
    }

    pub(super) async fn wait_for_server(&self) {
        while let Err(away) = self.offers.fleet.is_there() {
            if self.is_over() {
                return;
            }
            self.report_problem(&away.to_string());
            self.offers.pause(Duration::from_millis(500)).await;
        }
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
