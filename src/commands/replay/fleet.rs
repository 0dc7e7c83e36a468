//! A replay by the workers of a fleet: lists the captures, offers those that are wanted, takes their models in, and
//! shows how far it is. What cannot travel is made here, one capture at a time.

use super::console::Console;
use super::outcome::{Outcome, ReplayResult};
use super::{Options, Replay};
use crate::calibration::RigCalibration;
use crate::capture::CaptureSession;
use crate::commands::EXIT_INCOMPLETE;
use crate::commands::fleet::{AccessArgs, AddressParser, KEEP_FREE, block_on, termination};
use crate::config::Config;
use crate::fleet::{Dispatcher, DispatcherPlan, JobEvent, JobOutcome, Program, Role, Task};
use crate::frame::{CaptureId, Timestamp};
use crate::make_model::{FailedJob, ModelMaker, ReportFile, Settings, report_failure};
use crate::notes::CaptureNotes;
use crate::recording::finished_name;
use crate::report::FailedCapture;
use crate::words::count;
use crate::workers::FleetAddress;
use futures_util::StreamExt;
use parking_lot::Mutex;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// How often progress is shown.
const SHOW: Duration = Duration::from_secs(5);

/// Whether, and how, a fleet makes the models.
#[derive(Clone, Debug, clap::Args)]
pub(super) struct FleetOptions {
    /// Let the workers of a fleet make the models: nats://HOST or tls://HOST, with :PORT if it is not 4222
    #[arg(long, value_name = "ADDRESS", value_parser = AddressParser)]
    pub(super) fleet: Option<FleetAddress>,
    #[command(flatten)]
    access: AccessArgs,
    /// Captures that are offered to the fleet at the same time
    #[arg(long, default_value_t = 32, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=4096))]
    in_flight: u16,
}

/// A replay by a fleet.
pub(super) struct FleetReplay<'a> {
    pub(super) options: &'a Options,
    pub(super) config: &'a Config,
    pub(super) settings: &'a Settings,
    pub(super) calibration: Option<&'a RigCalibration>,
    pub(super) console: &'a Console,
}

/// A capture that is wanted.
#[derive(Clone)]
struct Wanted {
    recording: PathBuf,
    folder: PathBuf,
    id: CaptureId,
    time: Timestamp,
    source: String,
    notes: CaptureNotes,
}

impl FleetReplay<'_> {
    /// Makes the models of the recordings, each with the stem that names its folder.
    pub(super) fn run(
        &self,
        address: &FleetAddress,
        recordings: &[(PathBuf, String)],
    ) -> anyhow::Result<ExitCode> {
        let program = Program::this()?;
        let (wanted, mut outcomes) = self.list(recordings);
        let plan = DispatcherPlan {
            program,
            calibration: self.other_calibration()?,
            memory_mb: self.config.workers.memory_mb,
            time_limit_s: self.config.workers.time_limit_s,
            nice: 10,
            models: self.options.out.clone(),
            keep_free_bytes: KEEP_FREE,
            recheck: self.config.workers.recheck,
            replace: self.options.force,
        };
        let all = wanted.len();
        let (mut made, defects) = block_on(self.offer(address, plan, wanted))?;
        let stopped = all - made.len();
        outcomes.append(&mut made);
        let key = |o: &Outcome| (o.recording.clone(), o.capture.clone());
        outcomes.sort_by_key(key);
        self.console.summary(&outcomes, &self.options.out);
        if defects > 0 {
            eprintln!(
                "scand: found {} between models of the same job: a machine of the fleet is faulty; the log names the workers",
                count(defects as usize, "difference")
            );
            return Ok(ExitCode::FAILURE);
        }
        if stopped > 0 {
            eprintln!(
                "scand: stopped before all models were made; {} left: run the same command again",
                count(stopped, "capture")
            );
            return Ok(ExitCode::from(EXIT_INCOMPLETE));
        }
        if self.options.shard.is_some() && outcomes.is_empty() {
            self.console
                .line("no capture falls into this part (--shard)");
            return Ok(ExitCode::SUCCESS);
        }
        Ok(super::exit_code(&outcomes, self.options.strict))
    }

    fn other_calibration(&self) -> anyhow::Result<Option<String>> {
        let path = self.options.calibration.as_ref();
        Ok(path.map(std::fs::read_to_string).transpose()?)
    }

    /// What is wanted, and the outcomes that are known without making anything.
    fn list(&self, recordings: &[(PathBuf, String)]) -> (Vec<Wanted>, Vec<Outcome>) {
        let (mut wanted, mut outcomes) = (Vec::new(), Vec::new());
        for (path, stem) in recordings {
            let folder = self.options.out.join(stem);
            let replay = Replay {
                sync: &self.config.sync,
                only: &self.options.capture,
                with_rejected: self.options.rejected,
                shard: self.options.shard,
                jobs: 1,
                console: self.console,
                maker: self.maker(folder.clone(), &|_, _| ()),
            };
            let of_session = |session: &CaptureSession, ids: Vec<CaptureId>| {
                let summary = |id: CaptureId| {
                    let summary = session.capture(&id)?;
                    Some(Wanted {
                        recording: path.clone(),
                        folder: folder.clone(),
                        time: summary.time,
                        source: summary.source,
                        notes: summary.notes,
                        id,
                    })
                };
                ids.into_iter().filter_map(summary).collect::<Vec<_>>()
            };
            match replay.open(path) {
                Ok((session, ids, left_out)) => {
                    outcomes.extend(left_out);
                    wanted.extend(of_session(&session, ids));
                }
                Err(error) if self.options.shard.is_some_and(|s| !s.has_recording(stem)) => {
                    self.console
                        .line(&format!("{error:#}; another part reports it as failed"));
                }
                Err(error) => {
                    let unreadable = Outcome::unreadable(path, &error);
                    self.console.outcome(&unreadable);
                    outcomes.push(unreadable);
                }
            }
        }
        (wanted, outcomes)
    }

    fn maker<'a>(
        &'a self,
        folder: PathBuf,
        on_stage: &'a (dyn Fn(&CaptureId, &str) + Sync),
    ) -> ModelMaker<'a> {
        ModelMaker {
            settings: self.settings,
            calibration: self.calibration,
            force: self.options.force,
            folder,
            on_stage,
        }
    }

    /// Offers all captures to the fleet. Returns the outcomes of those that ended, and how many differences were found.
    async fn offer(
        &self,
        address: &FleetAddress,
        plan: DispatcherPlan,
        wanted: Vec<Wanted>,
    ) -> anyhow::Result<(Vec<Outcome>, u64)> {
        let options = &self.options.fleet;
        let fleet = options.access.connect(address, Role::Rig).await?;
        let offers = Dispatcher::new(fleet, plan)?;
        let listening = tokio::spawn(offers.clone().listen());
        let progress = Progress::new(wanted.len());
        let here = tokio::sync::Semaphore::new(1);
        let (offers, here, progress) = (&offers, &here, &progress);
        let jobs = wanted.into_iter().map(|wanted| async move {
            let outcome = self.run_job(offers, here, progress, wanted).await;
            if let Some(outcome) = &outcome {
                self.console.outcome(outcome);
                progress.add(outcome);
            }
            outcome
        });
        let mut jobs = futures_util::stream::iter(jobs).buffer_unordered(options.in_flight.into());
        let mut outcomes = Vec::new();
        let mut show = tokio::time::interval(SHOW);
        show.tick().await;
        let stop = termination();
        tokio::pin!(stop);
        let mut stopping = false;
        loop {
            tokio::select! {
                next = jobs.next() => match next {
                    Some(outcome) => outcomes.extend(outcome),
                    None => break,
                },
                _ = show.tick() => self.console.line(&progress.words()),
                () = &mut stop, if !stopping => {
                    stopping = true;
                    offers.stop();
                }
            }
        }
        listening.abort();
        offers.flush().await;
        self.console.line(&progress.words());
        Ok((outcomes, offers.defects()))
    }

    /// Brings one capture to its end; `None` if this run is to end before.
    async fn run_job(
        &self,
        offers: &Arc<Dispatcher>,
        here: &tokio::sync::Semaphore,
        progress: &Progress,
        wanted: Wanted,
    ) -> Option<Outcome> {
        if offers.is_stopped() {
            return None;
        }
        let complete = finished_name(&wanted.recording).unwrap_or_else(|| wanted.recording.clone());
        let task = Task {
            recording: wanted.recording.clone(),
            name: complete.file_name()?.to_str()?.to_owned(),
            capture: wanted.id.to_string(),
            settings: self.settings.text.clone(),
            target: wanted.folder.join(wanted.id.as_str()),
            lasts: None,
        };
        let on_event = |event: JobEvent| {
            if let JobEvent::Problem(words) = event
                && progress.is_new(words)
            {
                // Also where only errors are wanted: a run that waits for a server or a disk would say nothing.
                eprintln!("scand: {}: {words}", wanted.id);
            }
        };
        match offers.run_job(&task, on_event).await {
            JobOutcome::Made => {
                offers.forget_failure(&task).await;
                Some(placed(&wanted, &task.target, ReplayResult::Done))
            }
            JobOutcome::Unchanged => Some(placed(&wanted, &task.target, ReplayResult::Unchanged)),
            JobOutcome::Failed { reason, words } => {
                offers.tell_failure(&task, &reason).await;
                Some(self.failed(&wanted, &task.target, reason, &words))
            }
            JobOutcome::MakeLocally { .. } => {
                let _turn = here.acquire().await;
                if offers.is_stopped() {
                    return None;
                }
                Some(self.make_here(wanted).await)
            }
            JobOutcome::Withdrawn => None,
        }
    }

    fn failed(&self, wanted: &Wanted, target: &Path, reason: String, words: &str) -> Outcome {
        let job = FailedJob {
            recording: &wanted.recording,
            method: self.settings.reconstruction.method,
            capture: FailedCapture {
                id: &wanted.id,
                time_ns: wanted.time,
                source: &wanted.source,
            },
        };
        let words = (!words.is_empty()).then_some(words.as_bytes());
        let written = report_failure(target, job, &reason, words, self.options.force);
        let reason = match written {
            Ok(()) => reason,
            Err(also) => format!("{reason}; {also}"),
        };
        ended(wanted, ReplayResult::Failed, vec![reason])
    }

    /// Makes a model in this process, as a replay without a fleet does.
    async fn make_here(&self, wanted: Wanted) -> Outcome {
        let settings = self.settings.clone();
        let calibration = self.calibration.cloned();
        let (sync, force) = (self.config.sync.clone(), self.options.force);
        let of = wanted.clone();
        let made = tokio::task::spawn_blocking(move || {
            let session = CaptureSession::open(&wanted.recording, &sync)?;
            let maker = ModelMaker {
                settings: &settings,
                calibration: calibration.as_ref(),
                force,
                folder: wanted.folder.clone(),
                on_stage: &|_, _| (),
            };
            let made = maker.make(&session, &wanted.id);
            anyhow::Ok(Outcome::new(&session, &wanted.id, made))
        });
        match made.await {
            Ok(Ok(outcome)) => outcome,
            Ok(Err(error)) => ended(&of, ReplayResult::Failed, vec![format!("{error:#}")]),
            Err(error) => ended(
                &of,
                ReplayResult::Failed,
                vec![format!("internal error: {error}")],
            ),
        }
    }
}

/// The outcome of a capture whose folder came from elsewhere.
fn placed(wanted: &Wanted, target: &Path, ending: ReplayResult) -> Outcome {
    match ReportFile::read(target) {
        Ok(ReportFile {
            model: Some(model), ..
        }) => Outcome {
            verdict: Some(model.verdict),
            folder: Some(model.folder),
            ..ended(wanted, ending, model.reasons)
        },
        Ok(_) => {
            let text = std::fs::read(target.join("report.json")).unwrap_or_default();
            let report: serde_json::Value = serde_json::from_slice(&text).unwrap_or_default();
            let reason = report["reason"].as_str().unwrap_or("no reason given");
            ended(wanted, ReplayResult::Failed, vec![reason.to_owned()])
        }
        Err(problem) => ended(wanted, ReplayResult::Failed, vec![problem]),
    }
}

fn ended(wanted: &Wanted, result: ReplayResult, reasons: Vec<String>) -> Outcome {
    Outcome {
        recording: wanted.recording.display().to_string(),
        capture: Some(wanted.id.to_string()),
        result,
        verdict: None,
        reasons,
        notes: wanted.notes.clone(),
        folder: None,
        damaged: false,
        seconds: Vec::new(),
    }
}

/// How far it is.
struct Progress {
    all: usize,
    since: Instant,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    done: usize,
    failed: usize,
    /// Those that were there tell nothing of the rate.
    unchanged: usize,
    problems: BTreeSet<String>,
}

impl Progress {
    fn new(all: usize) -> Self {
        Self {
            all,
            since: Instant::now(),
            state: Mutex::default(),
        }
    }

    fn add(&self, outcome: &Outcome) {
        let mut state = self.state.lock();
        match outcome.result {
            ReplayResult::Failed => state.failed += 1,
            ReplayResult::Unchanged => state.unchanged += 1,
            _ => state.done += 1,
        }
    }

    /// Whether a problem was not shown yet.
    fn is_new(&self, words: &str) -> bool {
        const MOST: usize = 1000;
        let problems = &mut self.state.lock().problems;
        problems.len() < MOST && problems.insert(words.to_owned())
    }

    fn words(&self) -> String {
        let state = self.state.lock();
        let ended = state.done + state.failed;
        let left = self.all - ended - state.unchanged;
        let seconds = self.since.elapsed().as_secs_f64();
        let rate = ended as f64 / seconds.max(1e-3);
        let time_left = match ended {
            0 if left > 0 => String::new(),
            _ => format!(", {:.0} s left", left as f64 / rate.max(1e-9)),
        };
        format!(
            "{} done, {} unchanged, {} failed, {left} to go; {:.2} a second{time_left}",
            state.done, state.unchanged, state.failed, rate
        )
    }
}
