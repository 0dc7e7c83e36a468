//! The rig's side of a fleet while it captures: takes jobs from the folder of jobs, offers them, and says there what
//! became of them. The daemon writes the jobs and ends them; it has no connection.

use super::bundle::has_model;
use super::connection::FleetClient;
use super::dispatcher::{Dispatcher, DispatcherPlan, JobEvent, JobOutcome, Task};
use super::distrust::is_marked;
use super::job::clean;
use super::program::Program;
use super::subjects;
use crate::log;
use crate::recording::finished_name;
use crate::workers::Parameters;
use crate::workers::handover::{self, Answer, OfferedJob};
use bytes::Bytes;
use futures_util::StreamExt;
use futures_util::future::select;
use parking_lot::Mutex;
use std::collections::BTreeMap;
use std::future::Future;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::task::{AbortHandle, Id, JoinError, JoinHandle, JoinSet};

/// How often the folder of jobs is looked at.
const POLL_INTERVAL: Duration = Duration::from_millis(500);
/// How often the rig writes into the folder that a worker still does a job.
const REPEAT_INTERVAL: Duration = Duration::from_secs(5);
/// How often the rig sends a failure to the server, until it is there.
const FAILURE_INTERVAL: Duration = Duration::from_secs(5);
/// Jobs that are offered at the same time; others stay on the disk.
const MAX_IN_FLIGHT: usize = 32;

/// What a rig offers, and where.
#[derive(Clone, Debug)]
pub struct RigPlan {
    /// What is to make the models.
    pub program: Program,
    /// The folder of recordings, with that of jobs in it.
    pub recordings: PathBuf,
    /// Limits of a job, the folder of models and the share that is made again.
    pub parameters: Parameters,
    /// Bytes that stay free on the disk of the models, for captures.
    pub keep_free_bytes: u64,
}

/// Offers a rig's jobs to the fleet until `stop` is ready.
///
/// # Errors
/// If a folder cannot be used, or a task of the connection ends by itself, which is a defect of scand.
pub async fn serve_rig(
    fleet: FleetClient,
    plan: RigPlan,
    stop: impl Future<Output = ()>,
) -> std::io::Result<()> {
    let offers = Dispatcher::new(
        fleet.clone(),
        DispatcherPlan {
            program: plan.program.clone(),
            calibration: None,
            memory_mb: plan.parameters.memory_mb,
            time_limit_s: plan.parameters.time_limit_s,
            nice: plan.parameters.nice,
            models: plan.parameters.folder.clone(),
            keep_free_bytes: plan.keep_free_bytes,
            recheck: plan.parameters.recheck,
            replace: false,
        },
    )?;
    let listening = tokio::spawn(offers.clone().listen());
    let retries = tokio::spawn(hear_retries(fleet, plan.recordings.clone()));
    let mut rig = Live {
        offers: offers.clone(),
        plan,
        running: BTreeMap::new(),
        jobs: JoinSet::new(),
    };
    let to_abort = [listening.abort_handle(), retries.abort_handle()];
    let defect = select(Box::pin(defect_of(listening)), Box::pin(defect_of(retries)));
    tokio::pin!(stop, defect);
    let ended = loop {
        rig.look();
        tokio::select! {
            () = &mut stop => break Ok(()),
            () = tokio::time::sleep(POLL_INTERVAL) => {}
            Some(ended) = rig.jobs.join_next_with_id() => rig.end(ended),
            defect = &mut defect => {
                let error = defect.factor_first().0;
                let words = format!("a defect of scand ended a task of the fleet: {error}");
                break Err(std::io::Error::other(words));
            }
        }
    };
    to_abort.iter().for_each(AbortHandle::abort);
    offers.stop();
    let all = async { while rig.jobs.join_next().await.is_some() {} };
    let _ = tokio::time::timeout(Duration::from_secs(10), all).await;
    offers.flush().await;
    ended
}

/// Ready once a task broke off; a task that has nothing left to do is none.
async fn defect_of(task: JoinHandle<()>) -> JoinError {
    match task.await {
        Err(error) if error.is_panic() => error,
        _ => std::future::pending().await,
    }
}

struct Live {
    offers: Arc<Dispatcher>,
    plan: RigPlan,
    /// Files of jobs that are on their way, each with its task.
    running: BTreeMap<Id, PathBuf>,
    jobs: JoinSet<()>,
}

impl Live {
    /// Begins the jobs that are new.
    fn look(&mut self) {
        let offered = match handover::offered(&self.plan.recordings) {
            Ok(offered) => offered,
            // The daemon makes the folder when it starts.
            Err(_) => return,
        };
        for handed in offered {
            if self.running.len() >= MAX_IN_FLIGHT {
                return;
            }
            if self.running.values().all(|file| *file != handed.file) {
                let (offers, plan) = (self.offers.clone(), self.plan.clone());
                let file = handed.file.clone();
                let task = self
                    .jobs
                    .spawn(async move { run_job(&offers, &plan, &handed).await });
                self.running.insert(task.id(), file);
            }
        }
    }

    /// A job whose task broke off is the rig's again.
    fn end(&mut self, ended: Result<(Id, ()), JoinError>) {
        let id = ended.as_ref().map_or_else(JoinError::id, |&(id, ())| id);
        let file = self.running.remove(&id);
        if let (Err(error), Some(file)) = (ended, file) {
            log::error!(
                "{}: a defect of scand ended this job of the fleet: {error}",
                file.display()
            );
            let reason = "a defect of scand, which its log names".into();
            say(&file, &Answer::MakeLocally { reason });
        }
    }
}

async fn run_job(offers: &Arc<Dispatcher>, plan: &RigPlan, handed: &OfferedJob) {
    let capture = &handed.job.capture;
    let Ok(settings) = std::fs::read_to_string(handover::settings_path(&plan.recordings)) else {
        // The daemon writes them as soon as its disk has room for them; the job is looked at again.
        return;
    };
    let Some(recording) = offers.find_recording(&plan.recordings, handed).await else {
        let reason = "its recording cannot be found".into();
        return say(&handed.file, &Answer::MakeLocally { reason });
    };
    let complete = finished_name(&recording).unwrap_or_else(|| recording.clone());
    let name = complete.file_name().unwrap_or_default().to_string_lossy();
    let stem = complete.file_stem().unwrap_or_default();
    let task = Task {
        target: plan.parameters.folder.join(stem).join(capture),
        name: name.into_owned(),
        recording,
        capture: capture.clone(),
        settings,
        lasts: Some(handed.file.clone()),
    };
    let said: Mutex<Option<Instant>> = Mutex::default();
    let problems: Mutex<BTreeMap<String, ()>> = Mutex::default();
    let on_event = |event: JobEvent| match event {
        JobEvent::Offered => log::info!("capture {capture} was offered to the fleet"),
        JobEvent::Started(worker) => {
            let mut said = said.lock();
            if said.is_none() {
                log::info!("worker {worker} has begun the model of capture {capture}");
            }
            if said.is_none_or(|said| said.elapsed() >= REPEAT_INTERVAL) {
                *said = Some(Instant::now());
                if let Err(error) = handover::report_started(&handed.file, worker) {
                    log::warning!("{error}");
                }
            }
        }
        JobEvent::Problem(words) => {
            if problems.lock().insert(words.to_owned(), ()).is_none() {
                log::warning!("capture {capture}: {words}");
            }
        }
    };
    match offers.run_job(&task, on_event).await {
        JobOutcome::Made | JobOutcome::Unchanged => {
            say(&handed.file, &Answer::Made);
            forget_failure(offers, task).await;
        }
        JobOutcome::Failed { reason, words } => {
            tokio::spawn(tell_failure(offers.clone(), task, reason.clone()));
            say(&handed.file, &Answer::Failed { reason, words });
        }
        JobOutcome::MakeLocally { reason } => {
            log::info!("capture {capture}: its model is made here: {reason}");
            say(&handed.file, &Answer::MakeLocally { reason });
            tokio::spawn(forget_failure_once_made(offers.clone(), task));
        }
        JobOutcome::Withdrawn => {
            tokio::spawn(forget_failure_once_made(offers.clone(), task));
        }
    }
}

/// Tells people on other machines that a job failed, as soon as the server is there.
async fn tell_failure(offers: Arc<Dispatcher>, task: Task, reason: String) {
    while !offers.tell_failure(&task, &reason).await && !offers.is_stopped() {
        offers.pause(FAILURE_INTERVAL).await;
    }
}

/// Takes back that a job failed, which has a result now. If the server is away, that waits and the caller does not.
async fn forget_failure(offers: &Arc<Dispatcher>, task: Task) {
    if !offers.forget_failure(&task).await {
        tokio::spawn(forget_failure_patiently(offers.clone(), task));
    }
}

/// As [`forget_failure`], as soon as the server is there.
async fn forget_failure_patiently(offers: Arc<Dispatcher>, task: Task) {
    while !offers.is_stopped() && !offers.forget_failure(&task).await {
        offers.pause(FAILURE_INTERVAL).await;
    }
}

/// Takes back that a job failed once the daemon has ended the job, if it made a model.
async fn forget_failure_once_made(offers: Arc<Dispatcher>, task: Task) {
    let lasts = || task.lasts.as_ref().is_some_and(|file| file.exists());
    while lasts() && !offers.is_stopped() {
        offers.pause(FAILURE_INTERVAL).await;
    }
    if has_model(&task.target) && !is_marked(&task.target) {
        forget_failure_patiently(offers, task).await;
    }
}

fn say(file: &Path, answer: &Answer) {
    if !file.exists() {
        // The daemon has ended it meanwhile.
        return;
    }
    if let Err(error) = handover::answer(file, answer) {
        log::error!("{error}; the job is offered again");
    }
}

/// Puts failed jobs back into the queue when a person wants it.
async fn hear_retries(fleet: FleetClient, recordings: PathBuf) {
    let subject = subjects::retry(&fleet.name);
    let Ok(mut heard) = fleet.client.subscribe(subject).await else {
        return;
    };
    while let Some(message) = heard.next().await {
        let wanted = clean(&String::from_utf8_lossy(&message.payload), 200);
        let capture = Some(wanted.as_str()).filter(|wanted| !wanted.is_empty());
        let answer = match handover::offer_failed_again(&recordings, capture) {
            Ok(count) => {
                log::notice!("failed jobs were offered again on request: {count}");
                count.to_string()
            }
            Err(error) => {
                log::warning!("cannot offer failed jobs again: {error}");
                error.to_string()
            }
        };
        if let Some(reply) = message.reply {
            let _ = fleet.client.publish(reply, Bytes::from(answer)).await;
        }
    }
}
