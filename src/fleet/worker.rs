//! A worker: takes jobs that its program and its memory can do, lets a confined child do each, and sends the results.
//! It says that it lives every few seconds; when it does not, the server gives its jobs to another.

use super::connection::FleetClient;
use super::job::{Heartbeat, HeartbeatJob, seconds_since_1970};
use super::memory_class::MemoryClass;
use super::process_folder::ProcessFolder;
use super::program::Program;
use super::store::ServerError;
use super::subjects::{self, JOBS};
use crate::log;
use crate::process::Cancel;
use crate::storage::{free_bytes, with_advice};
use async_nats::jetstream::Message;
use async_nats::jetstream::consumer::{AckPolicy, PullConsumer, pull};
use futures_util::StreamExt;
use parking_lot::Mutex;
use std::collections::{BTreeMap, BTreeSet};
use std::future::Future;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};
use tokio::sync::watch;

/// How long the server waits for a sign of life before it gives a job to another worker.
const ACK_WAIT: Duration = Duration::from_secs(10);
/// How often a worker says that it lives.
const HEARTBEAT_INTERVAL: Duration = Duration::from_secs(3);
/// How long a worker waits for a job of one class before it asks for another class.
const PULL_TIMEOUT: Duration = Duration::from_secs(3);
/// Bytes of its disk that stay free.
const KEEP_FREE: u64 = 300_000_000;

/// How a worker works.
#[derive(Clone, Debug)]
pub struct WorkerPlan {
    /// What it can make models with.
    pub program: Program,
    /// Where recordings and models are while a job is done.
    pub scratch: PathBuf,
    /// Jobs at the same time.
    pub jobs: usize,
    /// Memory that each may take, in megabytes.
    pub memory_mb: u32,
    /// Nice value of the children, 0 to 19.
    pub nice: u32,
}

/// Why a worker ends.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum WorkerError {
    /// Its folder cannot be used.
    #[error("{}", with_advice(path, cause))]
    Scratch {
        path: PathBuf,
        cause: std::io::Error,
    },
    /// A rig made one of its models again and got another.
    #[error(
        "a rig repeated one of this worker's models and got a different one ({0}): check this machine's memory, then start \
         the worker again"
    )]
    Distrusted(String),
    /// A task of the worker's ended although nothing asked it to.
    #[error("a defect of scand ended a task of the worker: {0}; start the worker again")]
    Defect(tokio::task::JoinError),
}

/// Does jobs until `stop` is ready. What is being done then goes back to the server.
///
/// # Errors
/// If its folder cannot be used, a rig wants it to stop, or one of its tasks ends by itself, which is a defect.
pub async fn work(
    fleet: FleetClient,
    plan: WorkerPlan,
    stop: impl Future<Output = ()>,
) -> Result<(), WorkerError> {
    let scratch = |cause| WorkerError::Scratch {
        path: plan.scratch.clone(),
        cause,
    };
    let folder = ProcessFolder::new(&plan.scratch, "worker-").map_err(scratch)?;
    let cancel = Cancel::new().map_err(scratch)?;
    let (stopping, stopped) = watch::channel(false);
    let began = SystemTime::now().duration_since(UNIX_EPOCH);
    let began = began.unwrap_or_default().as_nanos();
    let worker = Arc::new(Worker {
        instance: format!("{began:x}-{}", std::process::id()),
        consumers: Mutex::default(),
        running: Mutex::default(),
        results: AtomicU64::default(),
        crashed: AtomicU64::default(),
        connections: AtomicU64::default(),
        logged: Mutex::default(),
        own: folder.path().to_owned(),
        cancel: cancel.clone(),
        stopped,
        fleet,
        plan,
    });
    let mut slots = tokio::task::JoinSet::new();
    for number in 0..worker.plan.jobs {
        let worker = worker.clone();
        slots.spawn(async move { worker.run(number).await });
    }
    let mut living = tokio::spawn({
        let worker = worker.clone();
        async move { worker.live().await }
    });
    let ended = tokio::select! {
        () = stop => Ok(()),
        reason = worker.stop_requested() => Err(WorkerError::Distrusted(reason)),
        Some(Err(error)) = slots.join_next() => Err(WorkerError::Defect(error)),
        Err(error) = &mut living => Err(WorkerError::Defect(error)),
    };
    let _ = stopping.send(true);
    cancel.cancel();
    // Each gives its job back.
    let all = async { while slots.join_next().await.is_some() {} };
    let _ = tokio::time::timeout(Duration::from_secs(10), all).await;
    living.abort();
    worker.fleet.flush().await;
    ended
}

/// A worker at its work.
pub(super) struct Worker {
    pub(super) fleet: FleetClient,
    pub(super) plan: WorkerPlan,
    /// Tells this run from others of the same worker.
    pub(super) instance: String,
    pub(super) own: PathBuf,
    pub(super) consumers: Mutex<BTreeMap<MemoryClass, PullConsumer>>,
    /// By the number of the slot.
    pub(super) running: Mutex<BTreeMap<usize, (HeartbeatJob, Instant)>>,
    pub(super) results: AtomicU64,
    pub(super) crashed: AtomicU64,
    /// How often the connection had been made when the consumers were looked up.
    pub(super) connections: AtomicU64,
    /// Problems that were logged and last.
    pub(super) logged: Mutex<BTreeSet<String>>,
    pub(super) cancel: Cancel,
    pub(super) stopped: watch::Receiver<bool>,
}

impl Worker {
    pub(super) fn is_stopped(&self) -> bool {
        *self.stopped.borrow()
    }

    /// Waits, but not longer than until the worker stops.
    pub(super) async fn pause(&self, time: Duration) {
        let mut stopped = self.stopped.clone();
        let _ = tokio::time::timeout(time, stopped.wait_for(|stopped| *stopped)).await;
    }

    /// Says a problem once, until it is over.
    pub(super) fn log_once(&self, problem: &str) {
        if self.logged.lock().insert(problem.to_owned()) {
            log::warning!("{problem}");
        }
    }

    async fn run(&self, slot: usize) {
        while !self.is_stopped() {
            if let Some(full) = self.lack_of_space(0) {
                self.log_once(&full);
                self.pause(Duration::from_secs(10)).await;
                continue;
            }
            match self.next_job().await {
                Ok(Some(message)) => {
                    self.logged.lock().clear();
                    self.run_job(slot, message).await;
                }
                Ok(None) => {}
                Err(problem) => {
                    if self.fleet.is_connected() {
                        self.log_once(&problem.to_string());
                    }
                    self.consumers.lock().clear();
                    self.pause(Duration::from_secs(1)).await;
                }
            }
        }
    }

    /// The next job, of the largest class first; `None` if none came for a while.
    async fn next_job(&self) -> Result<Option<Message>, ServerError> {
        if !self.fleet.is_connected() {
            self.pause(Duration::from_millis(300)).await;
            return Ok(None);
        }
        let mut classes = MemoryClass::within(self.plan.memory_mb);
        classes.reverse();
        let last = classes.len() - 1;
        let connections = self.fleet.connections();
        if self.connections.swap(connections, Ordering::AcqRel) != connections {
            // The server may have been started without what it had.
            self.consumers.lock().clear();
        }
        for (i, needs) in classes.into_iter().enumerate() {
            let failed = ServerError::error_while("give jobs");
            let consumer = self.consumer(needs).await?;
            let batch = consumer.batch().max_messages(1);
            let patience = if i == last {
                PULL_TIMEOUT
            } else {
                Duration::from_millis(200)
            };
            let messages = batch.expires(patience).messages().await;
            let mut messages = messages.map_err(|e| failed(&e))?;
            let since = Instant::now();
            tokio::select! {
                next = messages.next() => match next {
                    Some(Ok(message)) => return Ok(Some(message)),
                    Some(Err(error)) => return Err(failed(&error)),
                    // A consumer that is there lets one wait.
                    None if since.elapsed() < patience / 2 => {
                        self.consumers.lock().clear();
                        self.pause(Duration::from_millis(500)).await;
                    }
                    None => {}
                },
                () = self.pause(2 * PULL_TIMEOUT) => return Ok(None),
            }
        }
        Ok(None)
    }

    /// The consumer that all workers of this program share.
    async fn consumer(&self, needs: MemoryClass) -> Result<PullConsumer, ServerError> {
        if let Some(known) = self.consumers.lock().get(&needs) {
            return Ok(known.clone());
        }
        let name = subjects::consumer(&self.plan.program, needs);
        let config = pull::Config {
            durable_name: Some(name),
            filter_subject: subjects::jobs_for(&self.plan.program, needs),
            ack_policy: AckPolicy::Explicit,
            ack_wait: ACK_WAIT,
            // The rig counts: the server cannot tell a lost worker from its own restart.
            max_deliver: -1,
            max_ack_pending: 100_000,
            ..pull::Config::default()
        };
        let made = self
            .fleet
            .context
            .create_consumer_on_stream(config, JOBS)
            .await;
        let made = made.map_err(|e| ServerError::error_while("give jobs")(&e))?;
        self.consumers.lock().insert(needs, made.clone());
        Ok(made)
    }

    /// Says again and again that the worker lives.
    async fn live(&self) {
        let mut alive = tokio::time::interval(HEARTBEAT_INTERVAL);
        alive.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        loop {
            alive.tick().await;
            self.send_heartbeat().await;
        }
    }

    pub(super) async fn send_heartbeat(&self) {
        if !self.fleet.is_connected() {
            return;
        }
        let jobs = self.running.lock().values().cloned().collect::<Vec<_>>();
        let jobs = jobs.into_iter().map(|(job, since)| HeartbeatJob {
            seconds: since.elapsed().as_secs_f64(),
            ..job
        });
        let said = Heartbeat {
            worker: self.fleet.name.clone(),
            instance: self.instance.clone(),
            program: self.plan.program.to_string(),
            jobs: jobs.collect(),
            results: self.results.load(Ordering::Relaxed),
            crashed: self.crashed.load(Ordering::Relaxed),
            memory_mb: self.plan.memory_mb,
            time_s: seconds_since_1970(),
        };
        let bytes = serde_json::to_vec(&said).unwrap_or_default();
        let subject = subjects::worker(&self.fleet.name);
        let _ = self.fleet.client.publish(subject, bytes.into()).await;
    }

    /// Returns when a rig wants this worker to stop, with its reason.
    async fn stop_requested(&self) -> String {
        let subject = subjects::stop(&self.fleet.name);
        let Ok(mut heard) = self.fleet.client.subscribe(subject).await else {
            return std::future::pending().await;
        };
        match heard.next().await {
            Some(message) => super::job::clean(&String::from_utf8_lossy(&message.payload), 500),
            None => std::future::pending().await,
        }
    }

    /// Why the disk has no room for a capture of this length and its model.
    pub(super) fn lack_of_space(&self, bytes: u64) -> Option<String> {
        let free = free_bytes(&self.own).ok()?;
        let needed = KEEP_FREE + 3 * bytes;
        let folder = self.own.display();
        (free < needed).then(|| {
            format!(
                "the disk of {folder} has less than {} MB free: this worker takes no job until you free some",
                needed / 1_000_000
            )
        })
    }
}
