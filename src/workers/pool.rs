//! The threads that take jobs one after the other and start a worker process for each.

use super::find::find;
use super::handover::{self, Answer};
use super::jobs::{ClaimedJob, Error, Jobs};
use super::outcome::{self, ReportBefore};
use super::threads::Workers;
use super::{Job, Parameters, distrusted, protocol};
use crate::clock::Clock;
use crate::frame::{CaptureId, Timestamp};
use crate::make_model::{FailedJob, Model, report_failure};
use crate::process::{Child, ChildExit};
use crate::reconstruct::Method;
use crate::report::FailedCapture;
use crate::storage::free_bytes;
use crate::{log, queue, recording};
use parking_lot::Mutex;
use std::collections::BTreeSet;
use std::ffi::OsString;
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitStatus};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

/// A job that was interrupted this many times, because the daemon ended, counts as failed.
pub(super) const MAX_STARTS: u32 = 3;

/// How often the files of the fleet are looked for.
const HANDOVER: Duration = Duration::from_millis(250);
/// How often it is tried to write settings that could not be written at the start.
const SETTINGS: Duration = Duration::from_secs(1);

/// What the threads work with.
#[derive(Clone)]
pub struct WorkerPlan {
    /// How many, how long, and where models go.
    pub parameters: Parameters,
    /// The configuration of the reconstruction, as TOML.
    pub settings: String,
    /// The clock that a job has its time of.
    pub clock: Clock,
    /// Which model is made; for the reports of failures.
    pub method: Method,
    /// Bytes of the models' disk that are left to others: no job is begun when there is less. May change at any time.
    pub keep_free: Arc<AtomicU64>,
    /// The program that does a job and the first of its arguments; those of a [`protocol::ModelRequest`] follow.
    pub command: Vec<OsString>,
}

/// What is free on the models' disk, in bytes.
struct DiskSpace {
    free: u64,
    /// What must stay free.
    keep_free: u64,
}

impl DiskSpace {
    fn is_enough(&self) -> bool {
        self.free >= self.keep_free
    }
}

impl WorkerPlan {
    fn disk_space(&self) -> std::io::Result<DiskSpace> {
        Ok(DiskSpace {
            free: free_bytes(&self.parameters.folder)?,
            keep_free: self.keep_free.load(Ordering::Relaxed),
        })
    }

    /// Whether the models' disk has as much space free as must stay free; false if the system does not say it.
    pub(super) fn has_room(&self) -> bool {
        self.disk_space().is_ok_and(|space| space.is_enough())
    }
}

/// A job that came to its end.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FinishedJob {
    /// The capture.
    pub capture: String,
    /// Its recording, under the name that it has when it is complete.
    pub recording: PathBuf,
    /// The model, or why there is none.
    pub model: Result<Model, String>,
}

/// Starts the threads that make models of captures. `ended` is called for each job that ends, once, or once more after
/// a crash.
///
/// # Errors
/// If the folders cannot be made, or the system has no thread left.
pub fn start_models(
    jobs: &Arc<Jobs>,
    plan: WorkerPlan,
    ended: impl Fn(FinishedJob) + Send + Sync + 'static,
) -> Result<Workers, Error> {
    let models = plan.parameters.folder.clone();
    std::fs::create_dir_all(&models).map_err(|cause| Error::Io {
        path: models.clone(),
        cause,
    })?;
    jobs.begin_with_settings(&plan.settings);
    let count = plan.parameters.count;
    let has_fleet = plan.parameters.fleet.is_some();
    let shared = Arc::new(Shared {
        jobs: jobs.clone(),
        plan,
        told: Mutex::default(),
        ended: Box::new(ended),
    });
    jobs.set_workers(count as usize);
    let workers = Workers::new(jobs, models);
    let spawn = |name: String, work: fn(&Shared)| {
        let shared = shared.clone();
        workers.spawn(name, move || work(&shared))
    };
    if has_fleet {
        spawn("fleet".into(), Shared::finish_answered)?;
    }
    // Even a fleet leaves some to be made here.
    for number in 0..count.max(u32::from(has_fleet)) {
        let work = if has_fleet {
            Shared::make_unanswered
        } else {
            Shared::run
        };
        spawn(format!("worker {number}"), work)?;
    }
    Ok(workers)
}

/// What all threads share.
struct Shared {
    jobs: Arc<Jobs>,
    plan: WorkerPlan,
    /// Warnings about the system that were already logged.
    told: Mutex<BTreeSet<String>>,
    ended: Box<dyn Fn(FinishedJob) + Send + Sync>,
}

impl Shared {
    fn run(&self) {
        while let Some(taken) = self.jobs.take() {
            self.guarded(taken, Self::carry_out_or_requeue);
        }
    }

    /// Ends the jobs that the process of the fleet has an answer to.
    fn finish_answered(&self) {
        let is_over = |file: &Path| {
            let answer = handover::answer_to(file);
            matches!(answer, Some(Answer::Made | Answer::Failed { .. }))
        };
        while !self.jobs.is_stopped() {
            // The process of the fleet waits for them.
            self.jobs.has_settings();
            match self.jobs.take_where(is_over) {
                Some(taken) => self.guarded(taken, Self::end_answered),
                None => self.jobs.pause(HANDOVER),
            }
        }
    }

    /// Makes the models that the fleet cannot make, or has not begun for a while.
    fn make_unanswered(&self) {
        let Parameters {
            fleet_or_local,
            fleet_wait_s,
            ..
        } = self.plan.parameters;
        let wait = Duration::from_secs(fleet_wait_s.into());
        let is_ours = |file: &Path| match handover::answer_to(file) {
            Some(Answer::MakeLocally { .. }) => true,
            Some(_) => false,
            None => fleet_or_local && handover::is_neglected(file, wait),
        };
        while !self.jobs.is_stopped() {
            match self.jobs.take_where(is_ours) {
                Some(taken) => self.guarded(taken, Self::carry_out_or_requeue),
                None => self.jobs.pause(HANDOVER),
            }
        }
    }

    /// Does something with a job. A panic costs one of the job's starts, and not the thread.
    fn guarded(&self, mut taken: ClaimedJob, work: impl FnOnce(&Self, &mut ClaimedJob)) {
        let begun = taken.job.begun;
        let Err(panicked) = queue::guarded(|| work(self, &mut taken)) else {
            return;
        };
        log::error!("capture {}: {panicked}", taken.job.capture);
        taken.job.begun = begun + 1;
        // The last one was only to report that it failed.
        if begun >= MAX_STARTS {
            self.jobs.finish(&taken, false);
        } else {
            self.jobs.note(&taken);
            self.jobs.requeue(&taken);
        }
    }

    fn end_answered(&self, taken: &mut ClaimedJob) {
        let file = self.jobs.file(taken);
        let ended = self.answer_to(&taken.job, handover::answer_to(&file));
        self.end(taken, ended);
    }

    /// What the answer of the fleet says of a job.
    fn answer_to(&self, job: &Job, answer: Option<Answer>) -> FinishedJob {
        let folder = self.jobs.recordings();
        let found = find(folder, job).unwrap_or_else(|| folder.join(&job.recording));
        let complete = recording::finished_name(&found).unwrap_or(found);
        let model = match answer {
            Some(Answer::Failed { reason, words }) => {
                return self.failed(job, &complete, reason, &words);
            }
            _ => outcome::of_folder(&self.target(&complete, job)),
        };
        FinishedJob {
            capture: job.capture.clone(),
            recording: complete,
            model,
        }
    }

    fn carry_out_or_requeue(&self, taken: &mut ClaimedJob) {
        match self.carry_out(taken) {
            Some(ended) => self.end(taken, ended),
            None => self.jobs.requeue(taken),
        }
    }

    /// Tells how a job ended, and removes it.
    fn end(&self, taken: &ClaimedJob, ended: FinishedJob) {
        match &ended.model {
            Ok(model) => log::notice!(
                "capture {}: {}, {}",
                ended.capture,
                model.verdict.name(),
                model.folder.display()
            ),
            Err(reason) => {
                log::error!(
                    "capture {}: its model could not be made: {reason}",
                    ended.capture
                );
            }
        }
        let done = ended.model.is_ok();
        // Better to report it twice, after a crash, than never.
        (self.ended)(ended);
        let file = self.jobs.file(taken);
        self.jobs.finish(taken, done);
        handover::forget(&file);
    }

    /// Does a job; `None` if it is to be done again.
    fn carry_out(&self, taken: &mut ClaimedJob) -> Option<FinishedJob> {
        let folder = self.jobs.recordings();
        let Some(path) = find(folder, &taken.job) else {
            let reason = format!(
                "no recording in {} has this capture any more",
                folder.display()
            );
            let complete = folder.join(&taken.job.recording);
            return Some(self.failed(&taken.job, &complete, reason, ""));
        };
        let complete = recording::finished_name(&path).unwrap_or_else(|| path.clone());
        if taken.job.begun >= MAX_STARTS {
            let begun = taken.job.begun;
            let reason = format!(
                "it was started {begun} times, and each time the daemon or the worker ended first"
            );
            return Some(self.failed(&taken.job, &complete, reason, ""));
        }
        self.wait_for_room();
        while !self.jobs.is_stopped() && !self.jobs.has_settings() {
            self.jobs.pause(SETTINGS);
        }
        if self.jobs.is_stopped() {
            return None;
        }
        taken.job.begun += 1;
        self.jobs.note(taken);
        let (model, words) = self.run_process(taken, &path, &complete)?;
        self.tell_missing(&words);
        Some(match model {
            Ok(model) => FinishedJob {
                capture: taken.job.capture.clone(),
                recording: complete,
                model: Ok(model),
            },
            Err(reason) => self.failed(&taken.job, &complete, reason, &words),
        })
    }

    /// Runs the process of a job to its end. Returns the model, or why there is none, and what the process said; `None`
    /// if the job is to be done again.
    fn run_process(
        &self,
        taken: &mut ClaimedJob,
        path: &Path,
        complete: &Path,
    ) -> Option<(Result<Model, String>, String)> {
        let target = self.target(complete, &taken.job);
        let before = ReportBefore::of(&target);
        let mut command = self.command(path, &taken.job);
        if distrusted::is_to_be_replaced(&target) {
            command.arg("--force");
        }
        let child = Child::start(&mut command);
        let limit = Duration::from_secs(self.plan.parameters.time_limit_s.into());
        let waited = child.and_then(|child| child.wait(limit, self.plan.clock, self.jobs.cancel()));
        match waited {
            Err(error) => {
                let reason = format!("the worker cannot be started: {error}");
                Some((Err(reason), String::new()))
            }
            Ok((ChildExit::TimedOut, words)) => {
                let reason = format!(
                    "it did not finish within {} s (workers.time_limit_s)",
                    limit.as_secs()
                );
                Some((before.model_since(&target).ok_or(reason), words))
            }
            Ok((ChildExit::Ended(status), words)) if !self.is_to_be_repeated(status, path) => {
                let parameters = &self.plan.parameters;
                let model = outcome::model(&target, status, &words, parameters)
                    .or_else(|reason| before.model_since(&target).ok_or(reason));
                Some((model, words))
            }
            Ok(_) => {
                // Otherwise it counts: a job whose process is ended again and again must not block all others.
                if self.jobs.is_stopped() || !path.exists() {
                    taken.job.begun -= 1;
                    self.jobs.note(taken);
                }
                None
            }
        }
    }

    /// Whether a process ended because it was asked to, or because its recording got another name before it was opened.
    fn is_to_be_repeated(&self, status: ExitStatus, path: &Path) -> bool {
        const HANGUP_INTERRUPT_TERMINATE: [i32; 3] = [1, 2, 15];
        let asked = status
            .signal()
            .is_some_and(|signal| HANGUP_INTERRUPT_TERMINATE.contains(&signal));
        let renamed = !status.success() && !path.exists();
        if asked || renamed {
            // Who ends a process may end this one next.
            self.jobs.pause(Duration::from_millis(300));
        }
        asked || renamed
    }

    fn target(&self, complete: &Path, job: &Job) -> PathBuf {
        let stem = complete.file_stem().unwrap_or_default();
        self.plan.parameters.folder.join(stem).join(&job.capture)
    }

    fn command(&self, path: &Path, job: &Job) -> Command {
        let parameters = &self.plan.parameters;
        let mut command = Command::new(self.plan.command.first().cloned().unwrap_or_default());
        let request = protocol::ModelRequest {
            confinement: protocol::Confinement {
                memory_mb: parameters.memory_mb,
                nice: parameters.nice,
            },
            recording: path,
            capture: &job.capture,
            models: &parameters.folder,
            config: &self.jobs.settings(),
        };
        command
            .args(self.plan.command.iter().skip(1))
            .args(request.arguments());
        command
    }

    /// Waits while the disk has less room than it is to have.
    fn wait_for_room(&self) {
        let mut told = false;
        while let Ok(space) = self.plan.disk_space()
            && !space.is_enough()
            && !self.jobs.is_stopped()
        {
            if !told {
                log::warning!(
                    "{} has {} MB free: no model is made until {} MB are free (recording.keep_free_mb)",
                    self.plan.parameters.folder.display(),
                    space.free / 1_000_000,
                    space.keep_free / 1_000_000
                );
                told = true;
            }
            self.jobs.pause(Duration::from_secs(5));
        }
    }

    /// Says what the system cannot do for a process, once.
    fn tell_missing(&self, words: &str) {
        for missing in protocol::warnings(words) {
            if self.told.lock().insert(missing.to_owned()) {
                log::warning!("{missing}");
            }
        }
    }

    /// The end of a job that failed, with a report in the place of its model.
    fn failed(&self, job: &Job, recording: &Path, reason: String, words: &str) -> FinishedJob {
        if let Err(problem) = self.report(job, recording, &reason, words) {
            log::error!(
                "capture {}: cannot write the report of its failure: {problem}",
                job.capture
            );
        }
        FinishedJob {
            capture: job.capture.clone(),
            recording: recording.into(),
            model: Err(reason),
        }
    }

    fn report(&self, job: &Job, path: &Path, reason: &str, words: &str) -> Result<(), String> {
        let id = CaptureId::new(&job.capture).map_err(|e| e.to_string())?;
        let failed = FailedJob {
            recording: path,
            method: self.plan.method,
            capture: FailedCapture {
                id: &id,
                time_ns: Timestamp(job.trigger_ns),
                source: &job.source,
            },
        };
        let words = (!words.is_empty()).then_some(words.as_bytes());
        let target = self.target(path, job);
        report_failure(&target, failed, reason, words, false).map_err(|e| e.to_string())
    }
}
