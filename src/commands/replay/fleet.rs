//! A replay by the workers of a fleet: lists the captures, offers those that are wanted, takes their models in, and
//! shows how far it is. What cannot travel is made here, one capture at a time.

use super::Prepared;
use super::confined::{ListedCapture, Listing};
use super::outcome::{ReplayOutcome, ReplayResult};
use crate::commands::EXIT_INCOMPLETE;
use crate::commands::fleet::{AccessArgs, AddressParser, KEEP_FREE, block_on, termination};
use crate::fleet::{
    Dispatcher, DispatcherPlan, HereRequest, JobEvent, JobOutcome, Program, Role, Task, step,
};
use crate::frame::{CaptureId, Timestamp};
use crate::make_model::{FailedJob, ReportFile, report_failure};
use crate::notes::CaptureNotes;
use crate::recording::finished_name;
use crate::report::FailedCapture;
use crate::words::count;
use crate::workers::{FleetAddress, distrusted};
use futures_util::StreamExt;
use parking_lot::Mutex;
use serde::de::DeserializeOwned;
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
pub(super) struct FleetReplay<'a>(pub(super) &'a Prepared);

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

/// What a run found and made.
struct Ended {
    outcomes: Vec<ReplayOutcome>,
    /// Captures whose models were left for the next run.
    left: usize,
    /// Recordings that were not even listed.
    unlisted: usize,
    /// Differences between models that should be equal.
    defects: u64,
}

impl FleetReplay<'_> {
    /// Makes the models of the recordings.
    pub(super) fn run(&self, address: &FleetAddress) -> anyhow::Result<ExitCode> {
        let Prepared {
            options,
            config,
            console,
            ..
        } = self.0;
        let plan = DispatcherPlan {
            program: Program::current()?,
            calibration: self.other_calibration()?,
            memory_mb: config.workers.memory_mb,
            time_limit_s: config.workers.time_limit_s,
            nice: 10,
            models: options.out.clone(),
            keep_free_bytes: KEEP_FREE,
            recheck: config.workers.recheck,
            replace: options.force,
        };
        let mut ended = block_on(self.make(address, plan))?;
        let key = |o: &ReplayOutcome| (o.recording.clone(), o.capture.clone());
        ended.outcomes.sort_by_key(key);
        console.summary(&ended.outcomes, &options.out);
        if ended.defects > 0 {
            eprintln!(
                "scand: found {} between models of the same job: a machine of the fleet is faulty; the log names the workers",
                count(ended.defects as usize, "difference")
            );
            return Ok(ExitCode::FAILURE);
        }
        if ended.left > 0 || ended.unlisted > 0 {
            let unlisted = match ended.unlisted {
                0 => String::new(),
                all => format!(
                    " and {} that scand did not open yet",
                    count(all, "recording")
                ),
            };
            eprintln!(
                "scand: stopped before all models were made; {}{unlisted} left: run the same command again",
                count(ended.left, "capture")
            );
            return Ok(ExitCode::from(EXIT_INCOMPLETE));
        }
        Ok(self.0.conclude(&ended.outcomes))
    }

    fn other_calibration(&self) -> anyhow::Result<Option<String>> {
        let path = self.0.options.calibration.as_ref();
        Ok(path.map(std::fs::read_to_string).transpose()?)
    }

    /// Connects, and makes all models that are wanted.
    async fn make(&self, address: &FleetAddress, plan: DispatcherPlan) -> anyhow::Result<Ended> {
        let access = &self.0.options.fleet.access;
        let fleet = access.connect(address, Role::Rig).await?;
        let offers = Dispatcher::new(fleet, plan)?;
        let stopping = tokio::spawn({
            let offers = offers.clone();
            async move {
                termination().await;
                offers.stop();
            }
        });
        let listening = tokio::spawn(offers.clone().listen());
        let (wanted, mut outcomes, unlisted) = self.list(&offers).await;
        let all = wanted.len();
        let mut made = self.offer(&offers, wanted).await;
        stopping.abort();
        listening.abort();
        offers.flush().await;
        let left = all - made.len();
        outcomes.append(&mut made);
        Ok(Ended {
            outcomes,
            left,
            unlisted,
            defects: offers.defects(),
        })
    }

    /// What is wanted, the outcomes that are known without making anything, and how many recordings were not listed
    /// because the run is to end.
    async fn list(&self, offers: &Arc<Dispatcher>) -> (Vec<Wanted>, Vec<ReplayOutcome>, usize) {
        let console = &self.0.console;
        let (mut wanted, mut outcomes) = (Vec::new(), Vec::new());
        let recordings = &self.0.recordings;
        for (number, (path, stem)) in recordings.iter().enumerate() {
            let words = self.words_of_captures();
            let listed = self.child(offers, step::LIST, path, words).await;
            if offers.is_stopped() {
                return (wanted, outcomes, recordings.len() - number);
            }
            match listed {
                Ok((
                    Listing {
                        wanted: all,
                        left_out,
                    },
                    lines,
                )) => {
                    lines.iter().for_each(|line| console.line(line));
                    left_out.iter().for_each(|outcome| console.outcome(outcome));
                    outcomes.extend(left_out);
                    let folder = self.0.options.out.join(stem);
                    let of = |capture| Wanted::new(path, &folder, capture);
                    wanted.extend(all.into_iter().filter_map(of));
                }
                Err(problem) => {
                    let error = anyhow::Error::msg(problem);
                    outcomes.extend(self.0.unreadable(path, stem, &error));
                }
            }
        }
        (wanted, outcomes, 0)
    }

    /// The arguments that say which captures are wanted.
    fn words_of_captures(&self) -> Vec<String> {
        let options = &self.0.options;
        let captures = options.capture.iter();
        let mut words: Vec<String> = captures.map(|id| format!("--capture={id}")).collect();
        words.extend(options.shard.map(|shard| format!("--shard={shard}")));
        words.extend(options.rejected.then(|| "--rejected".to_owned()));
        words
    }

    /// Lets a confined child look into a recording: it parses what this process, which has the connection, does not.
    async fn child<T: DeserializeOwned>(
        &self,
        offers: &Arc<Dispatcher>,
        step: &'static str,
        recording: &Path,
        words: Vec<String>,
    ) -> Result<(T, Vec<String>), String> {
        let request = HereRequest {
            step,
            recording: recording.to_owned(),
            out: self.0.options.out.clone(),
            settings: self.0.settings.text.clone(),
            words,
        };
        let answered = offers.replay_here(request).await?;
        let answer = serde_json::from_str(&answered.answer).map_err(|e| e.to_string())?;
        Ok((answer, answered.lines))
    }

    /// Offers all captures to the fleet. Returns the outcomes of those that ended.
    async fn offer(&self, offers: &Arc<Dispatcher>, wanted: Vec<Wanted>) -> Vec<ReplayOutcome> {
        let (console, options) = (&self.0.console, &self.0.options.fleet);
        let progress = Progress::new(wanted.len());
        let here = tokio::sync::Semaphore::new(1);
        let (here, progress) = (&here, &progress);
        let jobs = wanted.into_iter().map(|wanted| async move {
            let outcome = self.run_job(offers, here, progress, wanted).await;
            if let Some(outcome) = &outcome {
                console.outcome(outcome);
                progress.add(outcome);
            }
            outcome
        });
        let mut jobs = futures_util::stream::iter(jobs).buffer_unordered(options.in_flight.into());
        let mut outcomes = Vec::new();
        let mut show = tokio::time::interval(SHOW);
        show.tick().await;
        loop {
            tokio::select! {
                next = jobs.next() => match next {
                    Some(outcome) => outcomes.extend(outcome),
                    None => break,
                },
                _ = show.tick() => console.line(&progress.words()),
            }
        }
        console.line(&progress.words());
        outcomes
    }

    /// Brings one capture to its end; `None` if this run is to end before.
    async fn run_job(
        &self,
        offers: &Arc<Dispatcher>,
        here: &tokio::sync::Semaphore,
        progress: &Progress,
        wanted: Wanted,
    ) -> Option<ReplayOutcome> {
        if offers.is_stopped() {
            return None;
        }
        let complete = finished_name(&wanted.recording).unwrap_or_else(|| wanted.recording.clone());
        let task = Task {
            recording: wanted.recording.clone(),
            name: complete.file_name()?.to_str()?.to_owned(),
            capture: wanted.id.to_string(),
            settings: self.0.settings.text.clone(),
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
            JobOutcome::Unchanged => {
                offers.forget_failure(&task).await;
                Some(placed(&wanted, &task.target, ReplayResult::Unchanged))
            }
            JobOutcome::Failed { reason, words } => {
                offers.tell_failure(&task, &reason).await;
                Some(self.failed(&wanted, &task.target, reason, &words))
            }
            JobOutcome::MakeLocally { .. } => {
                let _turn = here.acquire().await;
                if offers.is_stopped() {
                    return None;
                }
                let made = self.make_here(offers, wanted, &task.target).await;
                if made.is_done() {
                    offers.forget_failure(&task).await;
                }
                // The run ended it.
                Some(made).filter(|made| made.is_done() || !offers.is_stopped())
            }
            JobOutcome::Withdrawn => None,
        }
    }

    fn failed(&self, wanted: &Wanted, target: &Path, reason: String, words: &str) -> ReplayOutcome {
        let job = FailedJob {
            recording: &wanted.recording,
            method: self.0.settings.reconstruction.method,
            capture: FailedCapture {
                id: &wanted.id,
                time_ns: wanted.time,
                source: &wanted.source,
            },
        };
        let words = (!words.is_empty()).then_some(words.as_bytes());
        let written = report_failure(target, job, &reason, words, self.0.options.force);
        let reason = match written {
            Ok(()) => reason,
            Err(also) => format!("{reason}; {also}"),
        };
        ended(wanted, ReplayResult::Failed, vec![reason])
    }

    /// Makes a model on this machine, as a replay without a fleet does.
    async fn make_here(
        &self,
        offers: &Arc<Dispatcher>,
        wanted: Wanted,
        target: &Path,
    ) -> ReplayOutcome {
        let mut words = vec![format!("--capture={}", wanted.id), "--quiet".to_owned()];
        let replaces = distrusted::is_to_be_replaced(target) || self.0.options.force;
        words.extend(replaces.then(|| "--force".to_owned()));
        let step = step::REPLAY;
        let made = self.child::<Vec<ReplayOutcome>>(offers, step, &wanted.recording, words);
        match made.await.map(|(outcomes, _)| outcomes.into_iter().next()) {
            Ok(Some(outcome)) => outcome,
            Ok(None) => {
                let reason = "its recording does not have it any more".into();
                ended(&wanted, ReplayResult::Failed, vec![reason])
            }
            Err(problem) => ended(&wanted, ReplayResult::Failed, vec![problem]),
        }
    }
}

impl Wanted {
    fn new(recording: &Path, folder: &Path, capture: ListedCapture) -> Option<Self> {
        Some(Self {
            recording: recording.to_owned(),
            folder: folder.to_owned(),
            id: CaptureId::new(&capture.id).ok()?,
            time: Timestamp(capture.time_ns),
            source: capture.source,
            notes: capture.notes,
        })
    }
}

/// The outcome of a capture whose folder came from elsewhere.
fn placed(wanted: &Wanted, target: &Path, ending: ReplayResult) -> ReplayOutcome {
    match ReportFile::read(target) {
        Ok(ReportFile {
            model: Some(model), ..
        }) => ReplayOutcome {
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

fn ended(wanted: &Wanted, result: ReplayResult, reasons: Vec<String>) -> ReplayOutcome {
    ReplayOutcome {
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

    fn add(&self, outcome: &ReplayOutcome) {
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
