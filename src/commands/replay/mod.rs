//! `scand --replay`: recordings in, models out. This file has the arguments, the settings and the order of the
//! files; `make_model` processes a capture, and `console` shows the progress.

mod console;
mod outcome;

use crate::calibration::RigCalibration;
use crate::capture::Session;
use crate::config::Config;
use crate::frame::CaptureId;
use crate::make_model::{ModelMaker, Settings};
use crate::reconstruct::Method;
use crate::{queue, recording, sync};
use anyhow::Context;
use console::Console;
use outcome::{Outcome, exit_code};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// What `--replay` is asked.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Recordings to reconstruct
    #[arg(long, num_args = 1.., required = true, value_name = "FILE")]
    replay: Vec<PathBuf>,
    /// Where the models go: DIR/RECORDING'S-STEM/CAPTURE-ID/
    #[arg(long, default_value = "out", value_name = "DIR")]
    out: PathBuf,
    /// Only this capture; may be given several times
    #[arg(long, value_name = "ID")]
    capture: Vec<String>,
    /// Which model: the hull restored from depth, the hull alone, or the hull carved by depth everywhere
    #[arg(long, value_enum)]
    method: Option<Method>,
    /// Simplify each model to about N vertices
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(4..))]
    vertices: Option<u32>,
    /// Cameras to use instead of the recorded ones (TOML)
    #[arg(long, value_name = "FILE")]
    calibration: Option<PathBuf>,
    /// Configuration (TOML); config/replay.toml shows every setting
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Set one value over the configuration; may be given several times
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Captures reconstructed at the same time
    #[arg(long, default_value_t = 1, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=64))]
    jobs: u16,
    /// Replace outputs that were made from other inputs or settings
    #[arg(long)]
    force: bool,
    /// Print the summary as JSON
    #[arg(long)]
    json: bool,
    /// Print nothing but errors
    #[arg(long)]
    quiet: bool,
    /// A red verdict is a failure
    #[arg(long)]
    strict: bool,
}

impl Args {
    /// The files that are read.
    #[cfg(feature = "live")]
    pub(super) fn reads(&self) -> Vec<PathBuf> {
        let others = self.calibration.iter().chain(&self.config);
        self.replay.iter().chain(others).cloned().collect()
    }

    /// The folders that are written to, one a recording.
    #[cfg(feature = "live")]
    pub(super) fn writes(&self) -> anyhow::Result<Vec<PathBuf>> {
        let stems = stems(&self.replay)?.into_iter();
        Ok(stems.map(|stem| self.out.join(stem)).collect())
    }
}

/// Reconstructs every capture of the recordings.
///
/// # Errors
/// If the arguments contradict each other, the configuration is bad or no recording could be read.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
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
    let stems = stems(&args.replay)?;
    let console = Console::new(args.quiet, args.json);
    let settings = settings(&config)?;
    let mut outcomes = Vec::new();
    for (path, stem) in args.replay.iter().zip(&stems) {
        let replay = Replay {
            sync: &config.sync,
            only: &args.capture,
            jobs: usize::from(args.jobs),
            console: &console,
            maker: ModelMaker {
                settings: &settings,
                calibration: calibration.as_ref(),
                force: args.force,
                folder: args.out.join(stem),
                on_stage: &|id, stage| console.stage(id.as_str(), stage),
            },
        };
        match replay.recording(path) {
            Ok(mut of_file) => outcomes.append(&mut of_file),
            Err(error) => outcomes.push(Outcome::unreadable(path, &error)),
        }
    }
    console.summary(&outcomes, &args.out);
    Ok(exit_code(&outcomes, args.strict))
}

/// The settings that models depend on.
fn settings(config: &Config) -> anyhow::Result<Settings> {
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
    /// The captures that are wanted; all where none is named.
    only: &'a [String],
    /// Captures at the same time.
    jobs: usize,
    console: &'a Console,
    maker: ModelMaker<'a>,
}

impl Replay<'_> {
    /// The outcomes of one recording's captures.
    fn recording(&self, path: &Path) -> anyhow::Result<Vec<Outcome>> {
        let session = Session::open(path, self.sync)?;
        let wanted = wanted(&session, self.only).with_context(|| path.display().to_string())?;
        self.console.file(path, &session, wanted.len());
        let results = queue::run(self.jobs, wanted.len(), |i| {
            let outcome = self.maker.make(&session, &wanted[i]);
            self.console.finished(wanted[i].as_str());
            outcome
        });
        let outcome = |(id, result): (&CaptureId, Result<_, queue::Panicked>)| {
            let outcome =
                result.unwrap_or_else(|panicked| self.maker.failed(&session, id, &panicked));
            Outcome::new(&session, id, outcome)
        };
        Ok(wanted.iter().zip(results).map(outcome).collect())
    }
}

/// The captures that were asked for, each once; all where none was named.
fn wanted(session: &Session, only: &[String]) -> anyhow::Result<Vec<CaptureId>> {
    let all: Vec<CaptureId> = session.captures().into_iter().map(|c| c.id).collect();
    if only.is_empty() {
        anyhow::ensure!(
            !all.is_empty(),
            "no capture: the recording has no /trigger message"
        );
        return Ok(all);
    }
    let find = |name: &String| {
        all.iter()
            .find(|id| id.as_str() == name)
            .cloned()
            .with_context(|| {
                let known: Vec<&str> = all.iter().take(20).map(CaptureId::as_str).collect();
                format!("no capture {name:?}; there are {}", known.join(", "))
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

/// The files' stems, those of complete recordings, which name their output folders: two of one stem would share one.
fn stems(files: &[PathBuf]) -> anyhow::Result<Vec<String>> {
    let mut seen = BTreeMap::new();
    let mut stems = Vec::new();
    for file in files {
        let complete = recording::finished_name(file).unwrap_or_else(|| file.clone());
        let stem = complete
            .file_stem()
            .and_then(|s| s.to_str())
            .unwrap_or_default()
            .to_owned();
        anyhow::ensure!(
            !stem.is_empty(),
            "{}: a recording needs a name in UTF-8",
            file.display()
        );
        if let Some(other) = seen.insert(stem.clone(), file) {
            anyhow::bail!(
                "{} and {} have the same stem, and so would share an output folder",
                other.display(),
                file.display()
            );
        }
        stems.push(stem);
    }
    Ok(stems)
}
