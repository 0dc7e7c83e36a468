//! The side that offers jobs, a rig or the replay of an archive: what its jobs share. It hears what workers say, hands
//! it to the job that it is about, and compares results that come once more. `dispatch_job` brings one job to its end.

use super::bundle::{contents_sha256, has_model};
use super::connection::FleetClient;
use super::job::{self, Heartbeat, JobReport};
use super::process_folder::ProcessFolder;
use super::program::Program;
use super::subjects;
use crate::log;
use crate::process::Cancel;
use futures_util::StreamExt;
use parking_lot::Mutex;
use serde::Deserialize;
use std::collections::{BTreeMap, BTreeSet};
use std::hash::RandomState;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};
use tokio::sync::{Semaphore, mpsc, watch};
use tokio::task::spawn_blocking;

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
    /// Bytes that stay free on its disk.
    pub keep_free_bytes: u64,
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
    pub(super) spool: ProcessFolder,
    /// Bytes of packed captures in the spool, and of results there.
    pub(super) captures_in_spool: AtomicU64,
    pub(super) results_in_spool: AtomicU64,
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
    /// Jobs that were withdrawn in this run, and the folders of their models.
    withdrawn: Mutex<BTreeMap<String, PathBuf>>,
    /// Workers whose models were found wrong.
    distrusted: Mutex<BTreeSet<String>>,
    defects: AtomicU64,
    /// Draws the jobs that are made again, in each run other ones: a worker that knew which could be right in those
    /// alone.
    pub(super) lots: RandomState,
}

impl Started {
    fn parse(bytes: &[u8]) -> Result<Self, String> {
        let said: Self = job::parse(bytes)?;
        subjects::token(&said.worker).map_err(|e| e.to_string())?;
        subjects::token(&said.instance).map_err(|e| e.to_string())?;
        Ok(said)
    }
}

impl Drop for Dispatcher {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(self.spool.path());
        // As long as no other process has a folder in it.
        let _ = self.spool.path().parent().map(std::fs::remove_dir);
    }
}

impl Dispatcher {
    /// Prepares to offer jobs.
    ///
    /// # Errors
    /// If the spool cannot be made, or this process has no open file left.
    pub fn new(fleet: FleetClient, plan: DispatcherPlan) -> std::io::Result<Arc<Self>> {
        // Whatever an earlier run left is packed again.
        let spool = ProcessFolder::new(&plan.models.join(SPOOL), "offers-")?;
        Ok(Arc::new(Self {
            fleet,
            spool,
            captures_in_spool: AtomicU64::default(),
            results_in_spool: AtomicU64::default(),
            plan,
            children: Semaphore::new(CHILDREN),
            cancel: Cancel::new()?,
            next: AtomicU64::default(),
            stopped: watch::channel(false).0,
            waiting: Mutex::default(),
            heard: Mutex::default(),
            committed: Mutex::default(),
            withdrawn: Mutex::default(),
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

    /// Whether all jobs are to end.
    pub fn is_stopped(&self) -> bool {
        *self.stopped.borrow()
    }

    /// Waits, but not longer than until all is to end.
    pub(super) async fn pause(&self, time: Duration) {
        let mut stopped = self.stopped.subscribe();
        let _ = tokio::time::timeout(time, stopped.wait_for(|stopped| *stopped)).await;
    }

    /// Waits until all is to end.
    pub(super) async fn stopped(&self) {
        let mut stopped = self.stopped.subscribe();
        // It fails only if there is no sender any more, and this owns it.
        let _ = stopped.wait_for(|stopped| *stopped).await;
    }

    /// Hears what workers say, and finds what was said while nobody listened, for ever.
    pub async fn listen(self: Arc<Self>) {
        tokio::join!(self.hear_workers(), self.compare_late_results());
    }

    async fn hear_workers(&self) {
        let rig = self.fleet.name.clone();
        let subjects = [
            format!("scand.result.{rig}.*"),
            format!("scand.started.{rig}.*.*"),
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
            let parts: Vec<&str> = subject.split('.').collect();
            // The server lets each worker use only subjects with its own name.
            match parts[..] {
                [_, "worker", name] => match Heartbeat::parse(&message.payload) {
                    Ok(said) if said.worker == name => self.hear(said).await,
                    _ => {}
                },
                [_, "started", _, digest, name] if subjects::is_digest(digest) => {
                    match Started::parse(&message.payload) {
                        Ok(started) if started.worker == name => {
                            self.hand_on(digest, JobMessage::Started(started));
                        }
                        _ => {}
                    }
                }
                [_, "result", _, digest]
                    if subjects::is_digest(digest) && !message.payload.is_empty() =>
                {
                    self.reported(digest, &message.payload).await;
                }
                _ => {}
            }
        }
    }

    async fn hear(&self, said: Heartbeat) {
        if self.is_distrusted(&said.worker) {
            // It may not have heard it the first time.
            let words = format!("rig {}", self.fleet.name);
            self.stop_worker(&said.worker, words).await;
        }
        let is_new = self.note_sign_of_life(&said);
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

    /// Notes when a run of a worker was heard of; whether it is the first time.
    fn note_sign_of_life(&self, said: &Heartbeat) -> bool {
        const MOST: usize = 10_000;
        const FORGOTTEN_AFTER: Duration = Duration::from_secs(600);
        let mut heard = self.heard.lock();
        let is_new = !heard.contains_key(&said.instance);
        if heard.len() >= MOST {
            heard.retain(|_, (at, _)| at.elapsed() < FORGOTTEN_AFTER);
        }
        if heard.len() < MOST || !is_new {
            let own = said.jobs.iter().filter(|job| job.rig == self.fleet.name);
            let jobs = own.map(|job| job.digest.clone()).collect();
            heard.insert(said.instance.clone(), (Instant::now(), jobs));
        }
        is_new
    }

    /// Wants a worker to stop.
    pub(super) async fn stop_worker(&self, worker: &str, words: String) {
        let subject = subjects::stop(worker);
        let _ = self.fleet.client.publish(subject, words.into()).await;
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
        match self.committed_contents(digest) {
            Some(known) => self.compare(digest, &known, &reported).await,
            None if self.is_waiting(digest) => self.hand_on(digest, JobMessage::Reported(reported)),
            None => self.compare_withdrawn(digest, &reported).await,
        }
    }

    /// A result of a job that was withdrawn because its model was made here meanwhile.
    async fn compare_withdrawn(&self, digest: &str, reported: &JobReport) {
        let target = self.withdrawn.lock().get(digest).cloned();
        let Some(target) = target else {
            return;
        };
        let there = spawn_blocking(move || {
            has_model(&target)
                .then(|| contents_sha256(&target).ok())
                .flatten()
        });
        match there.await {
            Ok(Some(known)) => self.compare(digest, &known, reported).await,
            // There is no model to compare it with.
            _ => self.erase_result(digest, reported).await,
        }
    }

    /// Notes a job that nobody wants any more, and where its model may have been put by another process.
    pub(super) fn note_withdrawn(&self, digest: &str, target: &Path) {
        const MOST: usize = 10_000;
        let mut withdrawn = self.withdrawn.lock();
        if withdrawn.len() < MOST {
            withdrawn.insert(digest.to_owned(), target.to_owned());
        }
    }

    /// The digest of the contents of what was put into place for a job, in this run.
    pub(super) fn committed_contents(&self, digest: &str) -> Option<String> {
        self.committed.lock().get(digest).cloned()
    }

    /// Compares a second result with the one in place, and takes it off the server.
    pub(super) async fn compare(&self, digest: &str, known: &str, reported: &JobReport) {
        if let JobReport::Result {
            worker,
            contents_sha256,
            ..
        } = reported
            && contents_sha256 != known
        {
            self.add_defect();
            log::error!(
                "job {digest}: worker {worker} made a model that differs from the existing one, although the inputs, settings \
                 and program are the same: one of the two machines is faulty, or scand has a bug; make the model again with scand replay --force"
            );
        }
        self.erase_result(digest, reported).await;
    }

    /// Takes a result off the server.
    pub(super) async fn erase_result(&self, digest: &str, reported: &JobReport) {
        let rig = &self.fleet.name;
        if let JobReport::Result { pieces, .. } = reported {
            let part = |piece| subjects::part(rig, digest, reported.sender(), piece);
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
        self.withdrawn.lock().remove(digest);
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
