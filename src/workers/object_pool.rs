//! The two threads for objects, and the processes that they start: one finds poses beside the models that are being
//! made, because the object still stands there, and one makes objects' models when no capture's model waits.

use super::jobs::{Error, Jobs};
use super::object_find::of_session;
use super::object_jobs::ClaimedObjectJob;
use super::object_protocol::{CapturesFound, ObjectModelRequest, PosesFound, is_gone};
use super::outcome::{self, ReportBefore};
use super::pool::{MAX_STARTS, WorkerPlan};
use super::protocol::{self, Confinement};
use super::threads::Workers;
use crate::make_model::{FailedJob, Model, ReportFile, object_folder_name, report_failure};
use crate::process::{Child, ChildExit};
use crate::recording::finished_name;
use crate::report::FailedCapture;
use crate::{frame, log, queue};
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitStatus};
use std::sync::Arc;
use std::time::Duration;

/// By how much a process that finds poses is less nice than one that makes models: somebody stands there and waits.
const LESS_NICE: u32 = 9;

/// What became of an object.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ObjectResult {
    /// It is known how its captures lie against each other.
    Registered {
        /// The object's number.
        subject: String,
        /// The newest of its captures.
        capture: String,
        /// How they lie.
        poses: PosesFound,
    },
    /// Its model was made, or cannot be.
    Fused {
        /// The object's number.
        subject: String,
        /// The newest of its captures.
        capture: String,
        /// The model, or why there is none.
        model: Result<Model, String>,
        /// Captures that the model leaves out, by name and with the reason.
        left_out: Vec<String>,
    },
}

/// Starts the threads for objects; the command of `plan` begins a process for objects. `tell` is called for each thing
/// that is found, once, or once more after a crash.
///
/// # Errors
/// If the system has no thread left.
pub fn start_objects(
    jobs: &Arc<Jobs>,
    plan: WorkerPlan,
    tell: impl Fn(ObjectResult) + Send + Sync + 'static,
) -> Result<Workers, Error> {
    let folder = plan.parameters.folder.clone();
    repeat_noted(jobs).map_err(|cause| Error::Io {
        path: folder.clone(),
        cause,
    })?;
    let workers = Workers::new(jobs, folder);
    let shared = Arc::new(Shared {
        jobs: jobs.clone(),
        plan,
        tell: Box::new(tell),
    });
    for (name, registers) in [("registering", true), ("fusing", false)] {
        let shared = shared.clone();
        workers.spawn(name.into(), move || shared.run(registers))?;
    }
    Ok(workers)
}

/// Lets notes take effect that the end of the last run kept from it. The thread is not waited for at the end, because
/// it reads whole recordings: what it has not done is repeated again.
fn repeat_noted(jobs: &Arc<Jobs>) -> std::io::Result<()> {
    let left = jobs.objects().take_left();
    if left.is_empty() {
        return Ok(());
    }
    let jobs = jobs.clone();
    let repeat = move || {
        for capture in left {
            jobs.objects().noted(&capture);
        }
    };
    let thread = std::thread::Builder::new().name("object".into());
    thread.spawn(repeat).map(drop)
}

struct Shared {
    jobs: Arc<Jobs>,
    plan: WorkerPlan,
    tell: Box<dyn Fn(ObjectResult) + Send + Sync>,
}

/// How a process ended that did its work, or could not.
struct Ended {
    status: Option<ExitStatus>,
    words: String,
    /// Why it has no status.
    problem: Option<String>,
}

impl Shared {
    fn run(&self, registers: bool) {
        let objects = self.jobs.objects();
        let has_turn = || registers || (self.jobs.has_no_captures() && self.plan.has_room());
        let may = || has_turn() && self.jobs.has_settings();
        while let Some(mut taken) = objects.take(!registers, may) {
            let begun = taken.job.newest.begun;
            let work = if registers {
                Self::register
            } else {
                Self::fuse
            };
            // A panic costs one of the job's starts, and not the thread.
            let is_done = queue::guarded(|| work(self, &mut taken)).unwrap_or_else(|panicked| {
                log::error!("object {}: {panicked}", taken.job.subject);
                taken.job.newest.begun = begun + 1;
                objects.note(&taken);
                // The last one was only to report that it failed.
                (begun >= MAX_STARTS).then_some(true)
            });
            match is_done {
                // Better to report it twice, after a crash, than never.
                Some(true) => objects.finish(&taken),
                Some(false) => {
                    taken.job.is_registered = true;
                    taken.job.newest.begun = 0;
                    objects.note(&taken);
                    objects.requeue(&taken);
                }
                None => objects.requeue(&taken),
            }
        }
    }

    /// Finds poses. Whether nothing more is to be done for the object; `None` if this is to be done again.
    fn register(&self, taken: &mut ClaimedObjectJob) -> Option<bool> {
        let Some(recordings) = of_session(self.jobs.recordings(), &taken.job.newest) else {
            log::warning!(
                "object {}: no recording has its captures any more",
                taken.job.subject
            );
            return Some(true);
        };
        if taken.job.newest.begun >= MAX_STARTS {
            self.registered(taken, PosesFound::failed(&started_too_often(taken)));
            return Some(false);
        }
        let ended = self.process(taken, &recordings, true)?;
        let Some(found) = CapturesFound::parse(&ended.words) else {
            self.registered(taken, PosesFound::failed(&ended.why(&self.plan)));
            return Some(false);
        };
        if let Some(poses) = found.poses {
            self.registered(taken, poses);
        }
        Some(found.captures < 2 && !found.has_folder)
    }

    fn registered(&self, taken: &ClaimedObjectJob, poses: PosesFound) {
        let job = &taken.job;
        log::notice!(
            "object {}: capture {}: {}",
            job.subject,
            job.newest.capture,
            poses.words
        );
        (self.tell)(ObjectResult::Registered {
            subject: job.subject.clone(),
            capture: job.newest.capture.clone(),
            poses,
        });
    }

    /// Makes the model.
    fn fuse(&self, taken: &mut ClaimedObjectJob) -> Option<bool> {
        let Some(recordings) = of_session(self.jobs.recordings(), &taken.job.newest) else {
            self.fused(
                taken,
                Err("no recording has its captures any more".into()),
                None,
            );
            return Some(true);
        };
        if taken.job.newest.begun >= MAX_STARTS {
            self.failed(taken, &recordings, started_too_often(taken), "");
            return Some(true);
        }
        let before = self.folder(&taken.job.subject, &recordings);
        let before = before.map(|f| ReportBefore::of(&f)).unwrap_or_default();
        let ended = self.process(taken, &recordings, false)?;
        let found = CapturesFound::parse(&ended.words);
        if found
            .as_ref()
            .is_some_and(|f| f.captures < 2 && !f.has_folder)
        {
            return Some(true);
        }
        let folder = self.folder(&taken.job.subject, &recordings);
        match (ended.status, folder) {
            (Some(status), Some(folder)) if protocol::leaves_a_model(status.code()) => {
                let parameters = &self.plan.parameters;
                let model = outcome::model(&folder, status, &ended.words, parameters);
                self.fused(taken, model, Some(&folder));
            }
            // It has left its own report, or a model that was made before.
            (Some(status), Some(folder)) if status.code() == Some(1) && found.is_some() => {
                let is_report = ReportFile::read(&folder).is_ok_and(|r| r.model.is_none());
                let folder = is_report.then_some(folder.as_path());
                self.fused(taken, Err(ended.why(&self.plan)), folder);
            }
            (_, folder) => match folder.and_then(|folder| before.model_since(&folder)) {
                Some(model) => {
                    let folder = model.folder.clone();
                    self.fused(taken, Ok(model), Some(&folder));
                }
                None => {
                    let words = CapturesFound::others(&ended.words);
                    self.failed(taken, &recordings, ended.why(&self.plan), &words);
                }
            },
        }
        Some(true)
    }

    /// Starts a process and waits for its end; `None` if the job is to be done again.
    fn process(
        &self,
        taken: &mut ClaimedObjectJob,
        recordings: &[PathBuf],
        registers: bool,
    ) -> Option<Ended> {
        taken.job.newest.begun += 1;
        self.jobs.objects().note(taken);
        let parameters = &self.plan.parameters;
        let request = ObjectModelRequest {
            confinement: Confinement {
                memory_mb: parameters.memory_mb,
                nice: parameters
                    .nice
                    .saturating_sub(if registers { LESS_NICE } else { 0 }),
            },
            recordings,
            subject: &taken.job.subject,
            newest: &taken.job.newest.capture,
            registers,
            models: &parameters.folder,
            config: &self.jobs.settings(),
        };
        let mut command = Command::new(self.plan.command.first().cloned().unwrap_or_default());
        command
            .args(self.plan.command.iter().skip(1))
            .args(request.arguments());
        let limit = Duration::from_secs(parameters.time_limit_s.into());
        let child = Child::start(&mut command);
        let waited = child.and_then(|child| child.wait(limit, self.plan.clock, self.jobs.cancel()));
        match waited {
            Err(error) => Some(Ended {
                status: None,
                words: String::new(),
                problem: Some(format!("the worker cannot be started: {error}")),
            }),
            Ok((ChildExit::TimedOut, words)) => Some(Ended {
                status: None,
                words,
                problem: Some(format!(
                    "it did not finish within {} s (workers.time_limit_s)",
                    limit.as_secs()
                )),
            }),
            Ok((ChildExit::Ended(status), words)) if !was_ended(status, recordings) => {
                Some(Ended {
                    status: Some(status),
                    words,
                    problem: None,
                })
            }
            Ok(_) => {
                let is_renamed = recordings.iter().any(|path| is_gone(path));
                // Otherwise it counts: a job whose process is ended again and again must come to an end.
                if self.jobs.objects().is_stopped() || is_renamed {
                    taken.job.newest.begun -= 1;
                    self.jobs.objects().note(taken);
                } else {
                    // Who ends a process may end this one next.
                    self.jobs.pause(Duration::from_millis(300));
                }
                None
            }
        }
    }

    /// The object's folder, which is where its earliest capture's recording has its models.
    fn folder(&self, subject: &str, recordings: &[PathBuf]) -> Option<PathBuf> {
        let name = object_folder_name(subject);
        let candidates = recordings.iter().filter_map(|path| {
            let complete = finished_name(path).unwrap_or_else(|| path.clone());
            let stem = complete.file_stem()?.to_owned();
            Some(self.plan.parameters.folder.join(stem).join(&name))
        });
        let candidates: Vec<PathBuf> = candidates.collect();
        let newest = candidates.iter().filter_map(|folder| {
            let written = std::fs::metadata(folder.join("report.json"))
                .ok()?
                .modified()
                .ok()?;
            Some((written, folder))
        });
        newest.max().map(|(_, folder)| folder.clone())
    }

    /// Reports that no model was made, and why, if the process could not write that report itself.
    fn failed(
        &self,
        taken: &ClaimedObjectJob,
        recordings: &[PathBuf],
        reason: String,
        words: &str,
    ) {
        let job = &taken.job.newest;
        let written = || -> Result<(), String> {
            let recording = recordings.first().ok_or("it has no recording")?;
            let complete = finished_name(recording).unwrap_or_else(|| recording.clone());
            let stem = complete.file_stem().unwrap_or_default();
            let target = self.plan.parameters.folder.join(stem);
            let target = target.join(object_folder_name(&taken.job.subject));
            let id = frame::CaptureId::new(&job.capture).map_err(|e| e.to_string())?;
            let failed = FailedJob {
                recording: &complete,
                method: self.plan.method,
                capture: FailedCapture {
                    id: &id,
                    time_ns: frame::Timestamp(job.trigger_ns),
                    source: &job.source,
                },
            };
            let words = (!words.is_empty()).then_some(words.as_bytes());
            report_failure(&target, failed, &reason, words, false).map_err(|e| e.to_string())
        };
        if let Err(problem) = written() {
            let subject = &taken.job.subject;
            log::error!("object {subject}: cannot write the report of its failure: {problem}");
        }
        self.fused(taken, Err(reason), None);
    }

    fn fused(&self, taken: &ClaimedObjectJob, model: Result<Model, String>, folder: Option<&Path>) {
        let subject = &taken.job.subject;
        match &model {
            Ok(model) => log::notice!(
                "object {subject}: {}, {}",
                model.verdict.name(),
                model.folder.display()
            ),
            Err(reason) => log::warning!("object {subject}: no model was made: {reason}"),
        }
        let left_out = folder.map(ReportFile::left_out).unwrap_or_default();
        (self.tell)(ObjectResult::Fused {
            subject: subject.clone(),
            capture: taken.job.newest.capture.clone(),
            model,
            left_out,
        });
    }
}

fn started_too_often(taken: &ClaimedObjectJob) -> String {
    format!(
        "it was started {} times, and each time the daemon or the worker ended first",
        taken.job.newest.begun
    )
}

impl Ended {
    fn why(&self, plan: &WorkerPlan) -> String {
        match (&self.problem, self.status) {
            (Some(problem), _) => problem.clone(),
            (None, Some(status)) => outcome::reason(
                status,
                &CapturesFound::others(&self.words),
                &plan.parameters,
            ),
            (None, None) => "it ended without giving a reason".to_owned(),
        }
    }
}

/// Whether a process ended because it was asked to, or because a recording got another name before it was opened.
fn was_ended(status: ExitStatus, recordings: &[PathBuf]) -> bool {
    const HANGUP_INTERRUPT_TERMINATE: [i32; 3] = [1, 2, 15];
    let asked = status
        .signal()
        .is_some_and(|signal| HANGUP_INTERRUPT_TERMINATE.contains(&signal));
    asked || (!status.success() && recordings.iter().any(|path| is_gone(path)))
}
