//! The side that offers jobs, a rig or the replay of an archive: what its jobs share. It hears what workers say, hands
//! it to the job that it is about, and compares results that come once more. `dispatch_job` brings one job to its end.

use super::connection::FleetClient;
use super::job::{Heartbeat, JobReport};
use super::process_folder::process_folder;
use super::program::Program;
use super::subjects;
use crate::log;
use crate::process::Cancel;
use futures_util::StreamExt;
use parking_lot::Mutex;
use serde::Deserialize;
use std::collections::{BTreeMap, BTreeSet};
use std::hash::RandomState;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};
use tokio::sync::{Semaphore, mpsc, watch};

/// Messages about one job that are kept until it reads them; it asks the server for more.
const MESSAGES: usize = 32;
/// Children that pack, check or recheck at the same time.
const CHILDREN: usize = 2;

/// Processes that offer jobs share this folder among the models; each has one of its own in it.
const SPOOL: &str = ".fleet-spool";

/// How jobs are offered.
#[derive(Clone, Debug)]
pub struct DispatcherPlan {
    /// What is to make the models.
    pub program: Program,
    /// Another calibration to use instead of the recorded one, as TOML.
    pub calibration: Option<String>,
    /// Memory that a child may take, in megabytes; here, too.
    pub memory_mb: u32,
    /// How long one may take, in seconds.
    pub time_limit_s: u32,
    /// Nice value of the children here, 0 to 19.
    pub nice: u32,
    /// The folder of the models.
    pub models: PathBuf,
    /// The share of models that are made here again and compared, 0 to 1.
    pub recheck: f64,
    /// Whether other models may be replaced.
    pub replace: bool,
}

/// A capture whose model is wanted.
#[derive(Clone, Debug)]
pub struct Task {
    /// Its recording, where it is now.
    pub recording: PathBuf,
    /// The file name that the recording has when it is complete.
    pub name: String,
    /// Its id.
    pub capture: String,
    /// The configuration of the reconstruction, as TOML.
    pub settings: String,
    /// The folder of the model.
    pub target: PathBuf,
    /// The job lasts as long as this file is there.
    pub lasts: Option<PathBuf>,
}

/// How a job ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum JobOutcome {
    /// There is a result in its folder: a model, or the report of why there is none.
    Made,
    /// The model of these inputs, settings and program was there.
    Unchanged,
    /// There is no result.
    Failed {
        /// Why.
        reason: String,
        /// The last of what a child said.
        words: String,
    },
    /// It cannot be offered to others, or need not be.
    MakeLocally {
        /// Why.
        reason: String,
    },
    /// Nobody wants it any more.
    Withdrawn,
}

/// What happens to a job on its way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JobEvent<'a> {
    /// It is on the server.
    Offered,
    /// A worker has started it, or still does it.
    Started(&'a str),
    /// Something is to be done again, or waits.
    Problem(&'a str),
}

/// What a job hears.
#[derive(Debug)]
pub(super) enum JobMessage {
    Started(Started),
    Reported(JobReport),
}

/// A worker that has started a job.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Started {
    pub(super) worker: String,
    pub(super) instance: String,
}

/// All jobs that are offered.
pub struct Dispatcher {
    pub(super) fleet: FleetClient,
    pub(super) plan: DispatcherPlan,
    /// Where this process packs captures and results wait; on the disk of the models.
    pub(super) spool: PathBuf,
    pub(super) children: Semaphore,
    pub(super) cancel: Cancel,
    /// Numbers the folders in the spool.
    pub(super) next: AtomicU64,
    stopped: watch::Sender<bool>,
    waiting: Mutex<BTreeMap<String, mpsc::Sender<JobMessage>>>,
    /// When a run of a worker was last heard of, and the jobs that it did then.
    heard: Mutex<BTreeMap<String, (Instant, Vec<String>)>>,
    /// What was committed in this run: the contents' digests, by the jobs' digests.
    pub(super) committed: Mutex<BTreeMap<String, String>>,
    /// Workers whose models were found wrong.
    distrusted: Mutex<BTreeSet<String>>,
    defects: AtomicU64,
    /// Draws the jobs that are made again, in each run other ones: a worker that knew which could be right in those
    /// alone.
    pub(super) lots: RandomState,
}

impl Drop for Dispatcher {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.spool);
        // As long as no other process has a folder in it.
        let _ = self.spool.parent().map(std::fs::remove_dir);
    }
}

impl Dispatcher {
    /// Prepares to offer jobs.
    ///
    /// # Errors
    /// If the spool cannot be made, or this process has no open file left.
    pub fn new(fleet: FleetClient, plan: DispatcherPlan) -> std::io::Result<Arc<Self>> {
        // Whatever an earlier run left is packed again.
        let spool = process_folder(&plan.models.join(SPOOL), "offers-")?;
        Ok(Arc::new(Self {
            fleet,
            spool,
            plan,
            children: Semaphore::new(CHILDREN),
            cancel: Cancel::new()?,
            next: AtomicU64::default(),
            stopped: watch::channel(false).0,
            waiting: Mutex::default(),
            heard: Mutex::default(),
            committed: Mutex::default(),
            distrusted: Mutex::default(),
            defects: AtomicU64::default(),
            lots: RandomState::new(),
        }))
    }

    /// Lets all jobs end as withdrawn; they stay on the server, and are found there by the next run.
    pub fn stop(&self) {
        self.stopped.send_replace(true);
        self.cancel.cancel();
    }

    /// Second results that were not those that were there, and models that were not the same when they were made again.
    pub fn defects(&self) -> u64 {
        self.defects.load(Ordering::Relaxed)
    }

    pub(super) fn is_stopped(&self) -> bool {
        *self.stopped.borrow()
    }

    /// Waits, but not longer than until all is to end.
    pub(super) async fn pause(&self, time: Duration) {
        let mut stopped = self.stopped.subscribe();
        let _ = tokio::time::timeout(time, stopped.wait_for(|stopped| *stopped)).await;
    }

    /// Hears what workers say, and finds what was said while nobody listened, for ever.
    pub async fn listen(self: Arc<Self>) {
        tokio::join!(self.hear_workers(), self.compare_late_results());
    }

    async fn hear_workers(&self) {
        let rig = self.fleet.name.clone();
        let subjects = [
            format!("scand.result.{rig}.*"),
            format!("scand.started.{rig}.*"),
            "scand.worker.*".to_owned(),
        ];
        let mut heard = futures_util::stream::SelectAll::new();
        for subject in subjects {
            match self.fleet.client.subscribe(subject).await {
                Ok(subscriber) => heard.push(subscriber),
                Err(error) => log::error!("cannot subscribe to the workers' messages: {error}"),
            }
        }
        while let Some(message) = heard.next().await {
            let subject = message.subject.as_str();
            if subject.starts_with("scand.worker.") {
                if let Ok(said) = Heartbeat::parse(&message.payload) {
                    self.hear(said);
                }
                continue;
            }
            let Some(digest) = subject
                .rsplit('.')
                .next()
                .filter(|d| subjects::is_digest(d))
            else {
                continue;
            };
            if subject.starts_with("scand.started.") {
                let started = serde_json::from_slice::<Started>(&message.payload).ok();
                let named = started.filter(|b| subjects::token(&b.worker).is_ok());
                if let Some(started) = named {
                    self.hand_on(digest, JobMessage::Started(started));
                }
            } else if !message.payload.is_empty() {
                self.reported(digest, &message.payload).await;
            }
        }
    }

    fn hear(&self, said: Heartbeat) {
        const MOST: usize = 100_000;
        let mut heard = self.heard.lock();
        let is_new = !heard.contains_key(&said.instance);
        if heard.len() < MOST || !is_new {
            let jobs = said.jobs.iter().map(|job| job.digest.clone()).collect();
            heard.insert(said.instance.clone(), (Instant::now(), jobs));
        }
        drop(heard);
        if is_new && let Some(problem) = said.clock_problem() {
            log::warning!("{problem}");
        }
        for job in said.jobs.iter().filter(|job| job.rig == self.fleet.name) {
            let started = Started {
                worker: said.worker.clone(),
                instance: said.instance.clone(),
            };
            self.hand_on(&job.digest, JobMessage::Started(started));
        }
    }

    /// When a run of a worker was last heard of, and whether it did this job then.
    pub(super) fn last_heard(&self, instance: &str, digest: &str) -> Option<(Instant, bool)> {
        let heard = self.heard.lock();
        let (at, jobs) = heard.get(instance)?;
        Some((*at, jobs.iter().any(|job| job == digest)))
    }

    fn hand_on(&self, digest: &str, news: JobMessage) {
        if let Some(waiting) = self.waiting.lock().get(digest) {
            // A full channel loses nothing: the job asks the server now and then.
            let _ = waiting.try_send(news);
        }
    }

    /// A result, of a job that waits for one or has one.
    async fn reported(&self, digest: &str, payload: &[u8]) {
        let reported = match JobReport::parse(payload) {
            Ok(reported) => reported,
            Err(problem) => {
                log::error!(
                    "job {digest}: a worker sent a report that is not valid, and scand ignores it: {problem}"
                );
                return;
            }
        };
        let known = self.committed.lock().get(digest).cloned();
        match known {
            Some(known) => self.compare(digest, &known, &reported).await,
            None => self.hand_on(digest, JobMessage::Reported(reported)),
        }
    }

    /// Compares a second result with the one in place, and takes it off the server.
    pub(super) async fn compare(&self, digest: &str, known: &str, reported: &JobReport) {
        let rig = &self.fleet.name;
        if let JobReport::Result {
            worker,
            instance,
            pieces,
            contents_sha256,
            ..
        } = reported
        {
            if contents_sha256 != known {
                self.add_defect();
                log::error!(
                    "job {digest}: worker {worker} made a model that differs from the existing one, although the inputs, settings \
                     and program are the same: one of the two machines is faulty, or scand has a bug; make the model again with scand replay --force"
                );
            }
            let part = |piece| subjects::part(rig, digest, instance, piece);
            self.fleet.erase_file(*pieces, part).await;
        }
        self.fleet.erase(subjects::result(rig, digest)).await;
    }

    /// Waits a little until the server has what was sent. The last call before the process ends.
    pub async fn flush(&self) {
        self.fleet.flush().await;
    }

    pub(super) fn add_defect(&self) {
        self.defects.fetch_add(1, Ordering::Relaxed);
    }

    /// Whether a job of this process waits for its result.
    pub(super) fn is_waiting(&self, digest: &str) -> bool {
        self.waiting.lock().contains_key(digest)
    }

    /// Begins to hand the news of a job on to it.
    pub(super) fn subscribe_job(&self, digest: &str) -> mpsc::Receiver<JobMessage> {
        let (sender, receiver) = mpsc::channel(MESSAGES);
        // A model that is made again is not compared with the one that it replaces.
        self.committed.lock().remove(digest);
        self.waiting.lock().insert(digest.to_owned(), sender);
        receiver
    }

    /// Ends that.
    pub(super) fn leave(&self, digest: &str) {
        self.waiting.lock().remove(digest);
    }

    /// Notes what was committed, to compare it with what comes later.
    pub(super) fn note_committed(&self, digest: &str, contents: &str) {
        let mut committed = self.committed.lock();
        committed.insert(digest.to_owned(), contents.to_owned());
    }

    pub(super) fn is_distrusted(&self, worker: &str) -> bool {
        self.distrusted.lock().contains(worker)
    }

    /// Takes nothing from a worker any more.
    pub(super) fn distrust(&self, worker: &str) {
        self.distrusted.lock().insert(worker.to_owned());
    }
}
