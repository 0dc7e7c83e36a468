//! `scand replay`: makes models of recordings. This file has the arguments, the settings and the order of the
//! files; `make_model` processes a capture, and `console` shows the progress.

#[cfg(feature = "fleet")]
pub(super) mod confined;
mod console;
mod files;
#[cfg(feature = "fleet")]
mod fleet;
mod interrupt;
mod outcome;
mod shard;

use crate::calibration::RigCalibration;
use crate::capture::CaptureSession;
use crate::commands::first_aid::first_aid;
use crate::config::{Config, plain};
use crate::frame::CaptureId;
use crate::make_model::{ModelMaker, Settings, mark};
use crate::reconstruct::Method;
#[cfg(feature = "live")]
use crate::recording;
use crate::{queue, storage, sync};
use anyhow::Context;
use console::Console;
pub(super) use files::stem as recording_stem;
use outcome::{ReplayOutcome, ReplayResult, exit_code};
use serde::Deserialize;
use serde::de::IntoDeserializer;
use shard::Shard;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Reconstruct every capture of one or more recordings
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  scand replay recordings/cup.mcap
  scand replay -o models --jobs 3 /media/usb/sessions
  scand replay cup.mcap --capture cup-000 --vertices 10000 --set hull.resolution=160
  scand replay sessions --shard 2/8")]
pub struct CommandArgs {
    /// Recordings to reconstruct, or folders with recordings
    #[arg(required = true, value_name = "FILE|FOLDER")]
    recordings: Vec<PathBuf>,
    #[command(flatten)]
    options: Options,
}

/// `scand --replay`, which is the same as `scand replay`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Reconstruct these recordings, as scand replay does
    #[arg(long, num_args = 1.., required = true, value_name = "FILE|FOLDER")]
    replay: Vec<PathBuf>,
    #[command(flatten)]
    options: Options,
}

impl From<CommandArgs> for Args {
    fn from(args: CommandArgs) -> Self {
        Self {
            replay: args.recordings,
            options: args.options,
        }
    }
}

#[derive(Debug, clap::Args)]
struct Options {
    /// Write the models into DIR/RECORDING/CAPTURE/
    #[arg(short, long, default_value = "out", value_name = "DIR")]
    out: PathBuf,
    /// Reconstruct only this capture; may be given several times
    #[arg(long, value_name = "ID")]
    capture: Vec<String>,
    /// Reconstruct captures that a person rejected, too
    #[arg(long)]
    rejected: bool,
    /// Which model: hybrid (the hull restored from depth), hull (the hull alone), or depth-hull (the hull carved by
    /// every reading of depth, but for thin walls)
    #[arg(long, value_name = "METHOD", value_parser = parse_method)]
    method: Option<Method>,
    /// Simplify each model to about N vertices, such as 10000 or 10k
    #[arg(long, value_name = "N", value_parser = parse_vertices, allow_hyphen_values = true)]
    vertices: Option<u32>,
    /// Use this calibration (TOML) instead of the recorded one
    #[arg(long, value_name = "FILE")]
    calibration: Option<PathBuf>,
    /// Read this configuration (TOML); config/replay.toml shows every setting
    #[arg(short, long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Set one value of the configuration; may be given several times
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// How many captures to reconstruct at the same time
    #[arg(short, long, default_value_t = 1, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=64))]
    jobs: u16,
    /// Reconstruct only the I-th of N parts of all captures, for runs that share the work
    #[arg(long, value_name = "I/N")]
    shard: Option<Shard>,
    #[cfg(feature = "fleet")]
    #[command(flatten)]
    fleet: fleet::FleetOptions,
    /// Replace outputs that were made from other inputs or settings
    #[arg(short, long)]
    force: bool,
    /// Print a line of JSON for each capture, as soon as it has ended
    #[arg(long)]
    json: bool,
    /// Print only errors
    #[arg(short, long)]
    quiet: bool,
    /// End with exit code 1 if a verdict is red
    #[arg(long)]
    strict: bool,
}

/// The recordings that are named by their files or by their folders, and what a person should know of the folders.
///
/// # Errors
/// If a folder cannot be read, or has no recording.
pub(super) fn find_recordings(paths: &[PathBuf]) -> anyhow::Result<(Vec<PathBuf>, Vec<String>)> {
    let found = files::find(paths)?;
    Ok((found.recordings, found.warnings))
}

/// A number of vertices, also in thousands (`10k`).
fn parse_vertices(text: &str) -> Result<u32, String> {
    let (digits, factor) = match text.strip_suffix(['k', 'K']) {
        Some(thousands) => (thousands, 1000),
        None => (text, 1),
    };
    let number = digits.parse().ok().and_then(|n: u32| n.checked_mul(factor));
    number
        .filter(|&n| n >= 4)
        .ok_or_else(|| "expected a number of 4 or more, such as 10000 or 10k".into())
}

/// A method by the name that the configuration has for it.
fn parse_method(name: &str) -> Result<Method, String> {
    let method: Result<_, serde::de::value::Error> = Method::deserialize(name.into_deserializer());
    method.map_err(|error| plain(&error.to_string()))
}

impl Args {
    /// The files that are read.
    #[cfg(feature = "live")]
    pub(super) fn reads(&self) -> Vec<PathBuf> {
        let others = self.options.calibration.iter().chain(&self.options.config);
        let notes = self.replay.iter().map(|path| recording::beside(path));
        let notes = notes.filter(|path| path.exists());
        let mut reads: Vec<PathBuf> = self.replay.iter().chain(others).cloned().collect();
        reads.extend(notes);
        reads
    }

    /// The captures that are asked for by name.
    #[cfg(feature = "fleet")]
    pub(super) fn captures(&self) -> &[String] {
        &self.options.capture
    }

    /// The output folders, one for each recording.
    #[cfg(feature = "live")]
    pub(super) fn writes(&self) -> anyhow::Result<Vec<PathBuf>> {
        let stems = files::stems(&self.replay)?.into_iter();
        Ok(stems.map(|stem| self.options.out.join(stem)).collect())
    }
}

/// [`run`] at a terminal, where Ctrl-C stops it.
///
/// # Errors
/// As [`run`].
pub fn run_interactive(args: Args) -> anyhow::Result<ExitCode> {
    // A run with a fleet ends by itself, with its summary, and takes back what it has just erased.
    #[cfg(feature = "fleet")]
    let has_fleet = args.options.fleet.fleet.is_some();
    #[cfg(not(feature = "fleet"))]
    let has_fleet = false;
    if !has_fleet {
        interrupt::explain();
    }
    run(args)
}

/// Reconstructs every capture of the recordings.
///
/// # Errors
/// If the arguments contradict each other, the configuration is bad, no recording could be read or the output folder
/// cannot be written.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    let prepared = prepare(args)?;
    #[cfg(feature = "fleet")]
    if let Some(address) = &prepared.options.fleet.fleet {
        return fleet::FleetReplay(&prepared).run(address);
    }
    let outcomes = prepared.outcomes();
    prepared.console.summary(&outcomes, &prepared.options.out);
    Ok(prepared.conclude(&outcomes))
}

/// Checks the arguments, and finds the recordings.
fn prepare(args: Args) -> anyhow::Result<Prepared> {
    let Args {
        replay,
        options: args,
    } = args;
    let mut config = Config::load(args.config.as_deref(), &args.set)
        .map_err(|e| super::BadConfiguration(e.into()))?;
    if let Some(method) = args.method {
        config.method = method;
    }
    if let Some(vertices) = args.vertices {
        config.vertices = vertices as usize;
    }
    let calibration = match &args.calibration {
        Some(path) => {
            Some(RigCalibration::load(path).map_err(|e| super::BadConfiguration(e.into()))?)
        }
        None => None,
    };
    let files::RecordingsFound {
        recordings,
        warnings,
    } = files::find(&replay)?;
    let stems = files::stems(&recordings)?;
    let out_was_there = args.out.exists();
    // A full day's work is not lost at its end for want of a folder.
    for stem in &stems {
        storage::check_writable(&args.out.join(stem))
            .context("nothing was reconstructed: give another folder with --out")?;
    }
    let console = Console::new(args.quiet, args.json);
    warnings.iter().for_each(|warning| console.line(warning));
    Ok(Prepared {
        settings: settings(&config)?,
        recordings: recordings.into_iter().zip(stems).collect(),
        out_was_there,
        options: args,
        config,
        calibration,
        console,
    })
}

/// A replay whose arguments make sense.
struct Prepared {
    options: Options,
    config: Config,
    settings: Settings,
    calibration: Option<RigCalibration>,
    /// Each with the stem that names its folder.
    recordings: Vec<(PathBuf, String)>,
    /// Whether the folder of all models was there before.
    out_was_there: bool,
    console: Console,
}

impl Prepared {
    /// Reconstructs every capture in this process.
    fn outcomes(&self) -> Vec<ReplayOutcome> {
        let on_stage = |id: &CaptureId, stage: &str| self.console.stage(id.as_str(), stage);
        let mut outcomes = Vec::new();
        for (path, stem) in &self.recordings {
            match self.replay(stem, &on_stage).recording(path) {
                Ok(mut of_file) => outcomes.append(&mut of_file),
                Err(error) => outcomes.extend(self.unreadable(path, stem, &error)),
            }
        }
        outcomes
    }

    fn replay<'a>(
        &'a self,
        stem: &str,
        on_stage: &'a (dyn Fn(&CaptureId, &str) + Sync),
    ) -> Replay<'a> {
        let args = &self.options;
        Replay {
            sync: &self.config.sync,
            only: &args.capture,
            with_rejected: args.rejected,
            shard: args.shard,
            jobs: usize::from(args.jobs),
            console: &self.console,
            maker: ModelMaker {
                settings: &self.settings,
                calibration: self.calibration.as_ref(),
                force: args.force,
                folder: args.out.join(stem),
                on_stage,
            },
        }
    }

    /// The outcome of a recording that cannot be read, if this part of the captures reports it.
    fn unreadable(&self, path: &Path, stem: &str, error: &anyhow::Error) -> Option<ReplayOutcome> {
        if self
            .options
            .shard
            .is_some_and(|shard| !shard.has_recording(stem))
        {
            let words = format!("{error:#}; another part reports it as failed");
            self.console.line(&words);
            return None;
        }
        let unreadable = ReplayOutcome::unreadable(path, error);
        self.console.outcome(&unreadable);
        Some(unreadable)
    }

    /// Nothing is left of a recording without a model, not even a folder.
    fn remove_empty_folders(&self) {
        let out = &self.options.out;
        for (_, stem) in &self.recordings {
            let _ = std::fs::remove_dir(out.join(stem));
        }
        if !self.out_was_there {
            let _ = std::fs::remove_dir(out);
        }
    }

    /// Tells how all ended.
    fn conclude(&self, outcomes: &[ReplayOutcome]) -> ExitCode {
        self.remove_empty_folders();
        if self.options.shard.is_some() && outcomes.is_empty() {
            self.console
                .line("no capture falls into this part (--shard)");
            return ExitCode::SUCCESS;
        }
        exit_code(outcomes, self.options.strict)
    }
}

/// The settings that models depend on.
pub(super) fn settings(config: &Config) -> anyhow::Result<Settings> {
    Ok(Settings {
        reconstruction: config.reconstruction(),
        verdict: config.verdict.clone(),
        glb: config.glb.clone(),
        text: config.replay_toml()?,
    })
}

/// How a recording's captures are replayed.
struct Replay<'a> {
    sync: &'a sync::Parameters,
    /// The captures that are wanted; if none is named, all but rejected ones.
    only: &'a [String],
    /// Whether rejected captures are wanted too.
    with_rejected: bool,
    /// The part of the captures that this run reconstructs.
    shard: Option<Shard>,
    /// Captures at the same time.
    jobs: usize,
    console: &'a Console,
    maker: ModelMaker<'a>,
}

impl Replay<'_> {
    /// A recording with the captures that are wanted, and the outcomes of those that are left out.
    fn open(
        &self,
        path: &Path,
    ) -> anyhow::Result<(CaptureSession, Vec<CaptureId>, Vec<ReplayOutcome>)> {
        let session = CaptureSession::open(path, self.sync)?;
        let mut wanted = wanted(&session, self.only).with_context(|| path.display().to_string())?;
        wanted.retain(|id| self.is_in_shard(&session, id));
        // A capture that is asked for by its name is wanted, whatever its notes say.
        let takes_all = self.with_rejected || !self.only.is_empty();
        let is_rejected = |id: &CaptureId| session.notes().on(id.as_str()).is_rejected();
        let (left_out, wanted): (Vec<CaptureId>, Vec<CaptureId>) = wanted
            .into_iter()
            .partition(|id| !takes_all && is_rejected(id));
        self.console.file(path, &session, wanted.len());
        let left_out = left_out.iter().map(|id| self.leave_out(&session, id));
        let left_out: Vec<ReplayOutcome> = left_out.collect();
        Ok((session, wanted, left_out))
    }

    /// The outcomes of one recording's captures.
    fn recording(&self, path: &Path) -> anyhow::Result<Vec<ReplayOutcome>> {
        let (session, wanted, mut outcomes) = self.open(path)?;
        let results = queue::run(self.jobs, wanted.len(), |i| {
            let made = self.maker.make(&session, &wanted[i]);
            let outcome = ReplayOutcome::new(&session, &wanted[i], made);
            if outcome.result != ReplayResult::Failed {
                interrupt::done();
            }
            self.console.finished(wanted[i].as_str());
            self.console.outcome(&outcome);
            outcome
        });
        let outcome = |(id, result): (&CaptureId, Result<ReplayOutcome, queue::Panicked>)| {
            result.unwrap_or_else(|panicked| {
                let failed = self.maker.fail_with_report(&session, id, &panicked);
                let outcome = ReplayOutcome::new(&session, id, failed);
                self.console.outcome(&outcome);
                outcome
            })
        };
        outcomes.extend(wanted.iter().zip(results).map(outcome));
        if outcomes.iter().any(ReplayOutcome::is_failed) {
            self.tell_damage(&session);
        }
        Ok(outcomes)
    }

    /// Says of a recording with failed captures whether it is damaged. Opening it does not read everything.
    fn tell_damage(&self, session: &CaptureSession) {
        let is_told = !session.damage().is_empty();
        if let Ok(Some(words)) = first_aid(session.recording())
            && !is_told
        {
            self.console.error(&words);
        }
    }

    fn is_in_shard(&self, session: &CaptureSession, id: &CaptureId) -> bool {
        let time = session.capture(id).map(|c| c.time).unwrap_or_default();
        self.shard.is_none_or(|shard| shard.has_capture(id, time))
    }

    /// The outcome of a rejected capture: no model is made, and an existing one is marked.
    fn leave_out(&self, session: &CaptureSession, id: &CaptureId) -> ReplayOutcome {
        let notes = session.notes().on(id.as_str());
        let folder = self.maker.folder.join(id.as_str());
        if folder.join("report.json").exists()
            && let Err(error) = mark(&folder, &notes)
        {
            self.console.line(&format!(
                "{id}: cannot mark its model with the notes: {error}"
            ));
        }
        let outcome = ReplayOutcome::rejected(session, id);
        self.console.outcome(&outcome);
        outcome
    }
}

/// The captures that were asked for, each once; all if none was named.
fn wanted(session: &CaptureSession, only: &[String]) -> anyhow::Result<Vec<CaptureId>> {
    let all: Vec<CaptureId> = session.captures().into_iter().map(|c| c.id).collect();
    if only.is_empty() {
        anyhow::ensure!(
            !all.is_empty(),
            "the recording has no capture: it has no /trigger message"
        );
        return Ok(all);
    }
    let find = |name: &String| {
        all.iter()
            .find(|id| id.as_str() == name)
            .cloned()
            .with_context(|| {
                let known: Vec<&str> = all.iter().take(20).map(CaptureId::as_str).collect();
                format!("there is no capture {name:?}, only {}", known.join(", "))
            })
    };
    let mut found = Vec::new();
    for name in only {
        let id = find(name)?;
        // Two at once would write to one folder.
        if !found.contains(&id) {
            found.push(id);
        }
    }
    Ok(found)
}
