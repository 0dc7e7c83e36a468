//! `scand calibrate SESSION.mcap`: from pictures of a board to the rig's calibration, with a verdict.

mod checking;
mod depth;
mod files;
pub(super) mod known;
mod second_look;
mod sight;
mod words;

use super::{BadConfiguration, EXIT_LOST, refuse_to_replace};
use crate::calibration::fit::{Fit, Level, Model, Parameters, judge, missing};
use crate::calibration::{Board, DepthResponse, RigCalibration};
use crate::config::Config;
use crate::frame::CameraId;
use crate::job::Placements;
use crate::storage::write_atomically;
use crate::sync;
use indicatif::{ProgressBar, ProgressStyle};
use sight::Sight;
use std::collections::BTreeMap;
use std::io::IsTerminal;
use std::path::PathBuf;
use std::process::ExitCode;
use words::Told;

/// Calibrate a rig from recordings in which its cameras see a board in many places.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Recordings: each trigger is a placement of the board
    #[arg(required_unless_present = "from", value_name = "SESSION.mcap")]
    sessions: Vec<PathBuf>,
    /// Fit nothing: write the calibration that this calibration file or recording has, with --ros, --kalibr or --out
    #[arg(long, value_name = "FILE", conflicts_with_all = [
        "sessions", "board", "fix_intrinsics", "start", "model", "table_placement", "depth_response", "depth_table",
        "report", "check", "json",
    ])]
    from: Option<PathBuf>,
    /// The board, such as checkerboard:11x8:25mm or charuco:11x8:25mm:two-sided (in inner corners); by default what
    /// the recordings say
    #[arg(long, value_name = "BOARD")]
    board: Option<Board>,
    /// Calibration file to write
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Replace the files that are there, and write a calibration that is refused
    #[arg(long)]
    force: bool,
    /// Lenses to keep, from a calibration file, a recording, ROS camera_info or a Kalibr camchain (YAML), or a folder of
    /// them; those of cameras that are not in it are fitted
    #[arg(long, value_name = "FILE")]
    fix_intrinsics: Option<PathBuf>,
    /// Lenses to start from, in the same formats
    #[arg(long, value_name = "FILE")]
    start: Option<PathBuf>,
    /// Lens model: plumb_bob (k1 k2 k3 p1 p2) or rational (k1 to k6, p1, p2); by default what the configuration says,
    /// or plumb_bob
    #[arg(long, value_enum)]
    model: Option<LensModel>,
    /// Placement that lies flat on the table, where the rig's frame will be; by default the lowest one
    #[arg(long, value_name = "ID")]
    table_placement: Option<String>,
    #[command(flatten)]
    depth: depth::DepthArgs,
    #[command(flatten)]
    files: files::FileArgs,
    /// Cameras run freely: take the frame nearest to the trigger
    #[arg(long)]
    nearest: bool,
    /// Check the rig against a calibration instead: which camera moved, and by how much? One placement is enough.
    /// The exit code is 1 if one moved
    #[arg(long, requires = "against", conflicts_with_all = [
        "out", "fix_intrinsics", "start", "model", "table_placement", "depth_response", "depth_table", "report", "ros",
        "kalibr",
    ])]
    check: bool,
    /// The calibration to check against: a calibration file, or a recording that has one
    #[arg(long, value_name = "FILE", requires = "check")]
    against: Option<PathBuf>,
    /// Configuration (TOML); config/calibrate.toml shows what a calibration takes of it
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Set one value over the configuration, such as calibration.limits.good_px=0.2; may be given several times
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
    /// Print nothing but errors
    #[arg(long)]
    quiet: bool,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
#[value(rename_all = "snake_case")]
enum LensModel {
    PlumbBob,
    Rational,
}

impl From<LensModel> for Model {
    fn from(model: LensModel) -> Self {
        match model {
            LensModel::PlumbBob => Self::PlumbBob,
            LensModel::Rational => Self::Rational,
        }
    }
}

/// Calibrates.
///
/// # Errors
/// If a recording cannot be read, the board is unknown or another, the cameras cannot be joined, or the file is there
/// already.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    refuse_to_replace("--out", args.out.as_deref(), args.force)?;
    if let Some(from) = &args.from {
        let (out, files) = (args.out.as_deref(), &args.files);
        return known::export(from, out, files, args.force, args.quiet);
    }
    let table = args.depth.table()?;
    let config = configuration(&args)?;
    let fixed = args
        .fix_intrinsics
        .as_deref()
        .map(known::import)
        .transpose()?;
    let known = match fixed {
        Some(fixed) => Some(fixed),
        None => args.against.as_deref().map(known::load).transpose()?,
    };
    let start = args.start.as_deref().map(known::import).transpose()?;
    let synchronisation = sync::Parameters {
        nearest_color: match args.nearest {
            true => sync::FreeRunning::All,
            false => config.sync.nearest_color,
        },
        ..config.sync
    };
    let config = config.calibration;
    let recordings = sight::open(&args.sessions, &synchronisation)?;
    let cameras: BTreeMap<CameraId, bool> =
        recordings.iter().flat_map(Placements::cameras).collect();
    args.files.refuse_to_replace(cameras.keys(), args.force)?;
    let board = sight::board(args.board, &recordings)?;
    let progress = progress(args.quiet);
    let mut sight = sight::look(
        &recordings,
        &board,
        [&known, &start].map(Option::as_ref),
        &progress,
    )?;
    progress.finish_and_clear();
    if !args.quiet {
        sight
            .warnings
            .iter()
            .chain(&sight.lost)
            .for_each(|words| eprintln!("scand: {words}"));
    }
    if let (true, Some(known)) = (args.check, &known) {
        return checking::run(&sight, known, &config.watch, args.json, args.quiet);
    }
    let parameters = Parameters {
        model: args.model.map_or(config.fit.model, Into::into),
        table_placement: args.table_placement.clone().or(config.fit.table_placement),
        ..config.fit
    };
    let fitted = second_look::fitted(&mut sight, &recordings, &parameters)?;
    let lacking = missing(
        &sight.session,
        fitted.as_ref().ok(),
        &sight.depth_cameras,
        &config.wanted,
    );
    let fitted = match fitted {
        Ok(fitted) => fitted,
        Err(error) => return Err(unfinished(&sight, &lacking, error.into())),
    };
    let depth = depth::respond(
        &args.depth,
        table,
        &recordings,
        &fitted,
        &sight.depth_cameras,
        &config.plane,
    );
    if !args.quiet {
        depth
            .lost
            .iter()
            .for_each(|words| eprintln!("scand: {words}"));
    }
    let judgement = judge(&fitted, &depth.found(), &config.limits);
    args.files.write_report(
        &args.sessions,
        &sight,
        &fitted,
        (&judgement, &config.limits),
        &lacking,
        &depth,
    )?;
    let refused = judgement.level == Level::Refused && !args.force;
    let out = args.out.as_deref().filter(|_| !refused);
    if !refused {
        let mut responses = known.map(responses).unwrap_or_default();
        let found = sight.depth_cameras.iter();
        responses.extend(found.filter_map(|id| Some((id.clone(), depth.response(id)?))));
        let calibration = calibration(&fitted, &responses);
        args.files.write_exports(&calibration)?;
        if let Some(path) = out {
            write_atomically(path, calibration.to_toml().as_bytes())?;
        }
    }
    let told = Told {
        sight: &sight,
        fit: &fitted,
        judgement: &judgement,
        missing: &lacking,
        depth: &depth,
        written: out,
    };
    if args.json {
        say!("{:#}", told.json());
    } else if !args.quiet {
        say!("{}", told.text());
    }
    if refused {
        let rms = fitted.figures.rms_px;
        eprintln!(
            "scand: the calibration is refused (rms {rms:.3} px) and not written; --force writes it"
        );
        return Ok(ExitCode::FAILURE);
    }
    let lost = !sight.lost.is_empty()
        || !depth.lost.is_empty()
        || !depth.unfitted.is_empty()
        || fitted.left_out.iter().any(|l| l.placement.is_none());
    Ok(if lost {
        ExitCode::from(EXIT_LOST)
    } else {
        ExitCode::SUCCESS
    })
}

/// The configuration, with values that can be meant.
fn configuration(args: &Args) -> anyhow::Result<Config> {
    let config =
        Config::load(args.config.as_deref(), &args.set).map_err(|e| BadConfiguration(e.into()))?;
    let checked = config.calibration.checked();
    checked.map_err(|words| BadConfiguration(words.into()))?;
    Ok(config)
}

fn progress(quiet: bool) -> ProgressBar {
    if quiet || !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let style = ProgressStyle::with_template("looking for the board [{bar:30}] {pos}/{len}");
    ProgressBar::new(0).with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
}

/// An error with what the session lacks.
fn unfinished(sight: &Sight, lacking: &[String], error: anyhow::Error) -> anyhow::Error {
    let mut words = String::new();
    for lack in lacking {
        words += &format!("\n  missing: {lack}");
    }
    let mut reasons: BTreeMap<(&CameraId, &str), usize> = BTreeMap::new();
    for rejected in &sight.rejected {
        *reasons
            .entry((&rejected.camera, &rejected.reason))
            .or_default() += 1;
    }
    for ((camera, reason), count) in reasons.into_iter().take(40) {
        words += &format!("\n  camera {camera}: {reason} ({count} pictures)");
    }
    anyhow::anyhow!("{error}{words}")
}

fn responses(known: RigCalibration) -> BTreeMap<CameraId, DepthResponse> {
    let response = |(id, (_, response))| Some((id, response?));
    known.cameras.into_iter().filter_map(response).collect()
}

/// The fit as a calibration file holds it.
fn calibration(fit: &Fit, responses: &BTreeMap<CameraId, DepthResponse>) -> RigCalibration {
    let entry = |c: &crate::calibration::fit::FittedCamera| {
        let id = c.camera.id.clone();
        let response = responses.get(&id).copied();
        (id, (c.camera.clone(), response))
    };
    RigCalibration {
        volume: fit.volume,
        cameras: fit.cameras.iter().map(entry).collect(),
    }
}
