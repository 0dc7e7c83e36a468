//! `scand calibrate SESSION.mcap`: its arguments, its output and its exit code. `calibrate` does the work.

mod acceptance;
mod check;
mod depth;
mod export;
mod files;
mod measured;
mod pictures;
mod report_pictures;
mod summary;

use super::{BadConfiguration, check_folder_of, refuse_to_replace, wrong_usage};
use crate::calibrate::{self, CheckOptions, Detections, Options, Outcome};
use crate::calibration::fit::LensModel;
use crate::calibration::{Board, CalibrationLevel, DepthResponse, RigCalibration};
use crate::capture::Placements;
use crate::config::Config;
use crate::frame::CameraId;
use crate::storage::write_atomically;
use crate::sync;
use acceptance::{Acceptance, doubtful_name};
use anyhow::Context;
use indicatif::{ProgressBar, ProgressStyle};
use std::collections::BTreeMap;
use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use summary::Summary;

/// Calibrate a rig from recordings of a board in many places.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  scand calibrate session.mcap -o calibration.toml --report calibration.html
  scand calibrate --check --against calibration.toml today.mcap
  scand calibrate --from calibration.toml --ros camera_info --kalibr camchain.yaml")]
pub struct Args {
    /// Recordings in which each trigger is a placement of the board
    #[arg(required_unless_present_any = ["from", "pictures"], value_name = "SESSION.mcap")]
    sessions: Vec<PathBuf>,
    /// Calibrate from picture files (PNG, JPEG, TIFF, BMP, PNM) instead of recordings, such as --pictures
    /// left='left/*.png' right='right/*.png'. The n-th picture of each camera, in the order of their names, shows one
    /// placement
    #[arg(long, value_name = "CAMERA=FILES", num_args = 1.., conflicts_with_all = ["sessions", "nearest"])]
    pictures: Vec<String>,
    /// Fit nothing, but export the calibration of this calibration file or recording with --ros, --kalibr or --out
    #[arg(long, value_name = "FILE", conflicts_with_all = [
        "sessions", "board", "fix_intrinsics", "start", "model", "table_placement", "depth_response", "depth_table",
        "report", "check", "json", "from_placement", "until_placement", "measured", "distance", "pictures", "nearest",
        "config", "set",
    ])]
    from: Option<PathBuf>,
    /// The board, such as checkerboard:11x8:25mm or charuco:11x8:25mm:two-sided (in inner corners); by default the
    /// one that the recordings describe
    #[arg(long, value_name = "BOARD")]
    board: Option<Board>,
    /// Write the calibration into this file
    #[arg(short, long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Replace existing files, and write even a refused calibration, without exports; the exit code is 1 all the same
    #[arg(short, long)]
    force: bool,
    /// Write a doubtful calibration and its exports as asked; without it, --out rig.toml writes rig.doubtful.toml, and
    /// the exit code is 3
    #[arg(long)]
    accept_doubtful: bool,
    /// Lenses to keep, from a calibration file, a recording, ROS camera_info or a Kalibr camchain (YAML), or a folder
    /// of them; those of cameras that are not in it are fitted
    #[arg(long, value_name = "FILE")]
    fix_intrinsics: Option<PathBuf>,
    /// Lenses to start from, in the same formats
    #[arg(long, value_name = "FILE")]
    start: Option<PathBuf>,
    /// Lens model: plumb_bob (k1 k2 k3 p1 p2) or rational (k1 to k6, p1, p2); by default that of the configuration,
    /// or plumb_bob
    #[arg(long, value_enum)]
    model: Option<ModelArgument>,
    /// Placement that lies flat on the table, where the rig's frame will be; by default the lowest one
    #[arg(long, value_name = "ID")]
    table_placement: Option<String>,
    /// The first placement to use, for a session in which a camera moved
    #[arg(long, value_name = "ID")]
    from_placement: Option<String>,
    /// The last placement to use
    #[arg(long, value_name = "ID")]
    until_placement: Option<String>,
    #[command(flatten)]
    depth: depth::DepthArgs,
    #[command(flatten)]
    measured: measured::MeasuredArgs,
    #[command(flatten)]
    files: files::FileArgs,
    /// The cameras run freely: use the frame nearest to the trigger
    #[arg(long)]
    nearest: bool,
    /// Check the rig against a calibration instead, and name cameras that moved and depth cameras whose readings no
    /// longer fit. One placement is enough. The exit code is 1 if there is one, 3 if a camera could not be checked
    #[arg(long, requires = "against", conflicts_with_all = [
        "out", "fix_intrinsics", "start", "model", "table_placement", "depth_response", "depth_table", "report", "ros",
        "kalibr", "accept_doubtful", "measured", "distance",
    ])]
    check: bool,
    /// The calibration to check against: a calibration file, or a recording that has one
    #[arg(long, value_name = "FILE", requires = "check")]
    against: Option<PathBuf>,
    /// Configuration (TOML); config/calibrate.toml shows the settings of a calibration
    #[arg(short, long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Set one value of the configuration, such as calibration.limits.good_px=0.2; may be given several times
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
    /// Print only errors
    #[arg(short, long)]
    quiet: bool,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
#[value(rename_all = "snake_case")]
enum ModelArgument {
    PlumbBob,
    Rational,
}

impl From<ModelArgument> for LensModel {
    fn from(model: ModelArgument) -> Self {
        match model {
            ModelArgument::PlumbBob => Self::PlumbBob,
            ModelArgument::Rational => Self::Rational,
        }
    }
}

/// Calibrates.
///
/// # Errors
/// If a recording cannot be read, the board is unknown or a different one, the cameras cannot be joined, or the file
/// already exists.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    refuse_recording_as_out(args.out.as_deref())?;
    refuse_to_replace("--out", args.out.as_deref(), args.force)?;
    args.files.check_folders()?;
    if let Some(from) = &args.from {
        let (out, files) = (args.out.as_deref(), &args.files);
        let export = export::Export {
            from,
            out,
            files,
            force: args.force,
            accept_doubtful: args.accept_doubtful,
            quiet: args.quiet,
        };
        return export.run();
    }
    if let (Some(out), false) = (&args.out, args.accept_doubtful) {
        refuse_to_replace("--out", Some(&doubtful_name(out)), args.force)?;
    }
    if let Some(out) = &args.out {
        check_folder_of(out).context("nothing was calibrated: give another file with --out")?;
    }
    let config = configuration(&args)?;
    let depth = args.depth.method(config.calibration.plane.clone())?;
    let lenses = Lenses::read(&args)?;
    let measured = args.measured.all()?;
    let recordings = recordings(&args, &config.sync)?;
    let cameras: BTreeMap<CameraId, bool> =
        recordings.iter().flat_map(Placements::cameras).collect();
    args.files.refuse_to_replace(cameras.keys(), args.force)?;
    let board = calibrate::board(args.board, &recordings)?;
    let range = [&args.from_placement, &args.until_placement].map(Option::as_deref);
    let detections = detect_boards(&recordings, &board, &lenses, range, args.quiet)?;
    if let (true, Some(known)) = (args.check, &lenses.known) {
        let check = calibrate::check(&detections, &recordings, known, &check_options(&config))?;
        print_problems(&check.lost, args.quiet);
        return Ok(check::print(&check, &detections, args.json, args.quiet));
    }
    let limits = config.calibration.limits.clone();
    let options = Options {
        depth,
        responses: lenses.known.map(responses).unwrap_or_default(),
        fit: config.calibration.fit,
        wanted: config.calibration.wanted,
        limits: config.calibration.limits,
        witnesses: config.calibration.witness,
        measured,
    };
    let outcome = calibrate::run(detections, &recordings, options)?;
    print_problems(&outcome.depth.lost, args.quiet);
    args.files.write_report(&recordings, &outcome, &limits)?;
    let acceptance = Acceptance::of(outcome.judgement.level, args.force, args.accept_doubtful);
    if acceptance == Acceptance::Whole {
        args.files.write_exports(&outcome.calibration)?;
    }
    let out = acceptance.out(args.out.as_deref());
    if let Some(path) = &out {
        write_atomically(path, outcome.calibration.to_toml().as_bytes())?;
    }
    print(&args, &outcome, out.as_deref());
    tell_what_is_not_written(&args, acceptance);
    if let Some(earlier) = acceptance.earlier_file(args.out.as_deref()) {
        eprintln!(
            "scand: {} is of an earlier calibration, not of this one: remove it if nothing needs it",
            earlier.display()
        );
    }
    Ok(acceptance.exit_code(&outcome, args.accept_doubtful))
}

/// Refuses to write a calibration to the name of a recording, as which it would be read; with `--force` it would
/// replace the session.
fn refuse_recording_as_out(out: Option<&Path>) -> anyhow::Result<()> {
    match out.filter(|out| out.extension().is_some_and(|e| e == "mcap")) {
        None => Ok(()),
        Some(out) => Err(wrong_usage(format!(
            "--out {}: what ends in .mcap is read as a recording; give the calibration another name, such as rig.toml",
            out.display()
        ))),
    }
}

/// The placements of the recordings, or of the pictures.
fn recordings(args: &Args, parameters: &sync::Parameters) -> anyhow::Result<Vec<Placements>> {
    if args.pictures.is_empty() {
        return Ok(calibrate::open(&args.sessions, parameters)?);
    }
    let files = pictures::files(&args.pictures).map_err(wrong_usage)?;
    Ok(vec![calibrate::open_pictures(files)?])
}

/// The configuration with the arguments applied over it, checked for values out of range.
fn configuration(args: &Args) -> anyhow::Result<Config> {
    let mut config =
        Config::load(args.config.as_deref(), &args.set).map_err(|e| BadConfiguration(e.into()))?;
    let checked = config.calibration.checked();
    checked.map_err(|words| BadConfiguration(words.into()))?;
    if args.nearest {
        config.sync.nearest_color = sync::FreeRunning::All;
    }
    let fit = &mut config.calibration.fit;
    if let Some(model) = args.model {
        fit.model = model.into();
    }
    if let Some(placement) = &args.table_placement {
        fit.table_placement = Some(placement.clone());
    }
    Ok(config)
}

/// What a check allows for.
fn check_options(config: &Config) -> CheckOptions {
    let calibration = config.calibration.clone();
    CheckOptions {
        watch: calibration.watch,
        fit: calibration.fit,
        plane: calibration.plane,
        depth_bias_mm: calibration.limits.depth_bias_mm,
    }
}

/// Calibrations that were given.
struct Lenses {
    /// Lenses to keep, or the whole to check against.
    known: Option<RigCalibration>,
    /// Lenses to start from.
    start: Option<RigCalibration>,
}

impl Lenses {
    fn read(args: &Args) -> anyhow::Result<Self> {
        let import = |path: &PathBuf| calibrate::import(path).map_err(bad_file);
        let load = |path: &PathBuf| calibrate::load(path).map_err(bad_file);
        let known = match args.fix_intrinsics.as_ref().map(import).transpose()? {
            Some(fixed) => Some(fixed),
            None => args.against.as_ref().map(load).transpose()?,
        };
        if let (true, Some(path), Some(known)) = (args.check, &args.against, &known) {
            refuse_refused(path, known, args.force)?;
        }
        let start = args.start.as_ref().map(import).transpose()?;
        Ok(Self { known, start })
    }
}

/// Refuses to compare a rig with a calibration that was refused: what disagrees need not be the rig.
fn refuse_refused(path: &Path, known: &RigCalibration, is_forced: bool) -> anyhow::Result<()> {
    let level = known.verdict.as_ref().map(|verdict| verdict.level);
    if level != Some(CalibrationLevel::Refused) || is_forced {
        return Ok(());
    }
    let words = format!(
        "calibration {}: verdict is \"refused\", expected \"good\", \"accepted\" or \"doubtful\": calibrate the rig again; \
         --force checks it all the same",
        path.display()
    );
    Err(BadConfiguration(words.into()).into())
}

/// A calibration file that is refused is a bad configuration.
fn bad_file(error: calibrate::Error) -> anyhow::Error {
    match error {
        calibrate::Error::File(error) => BadConfiguration(error.into()).into(),
        other => other.into(),
    }
}

/// Looks for the board while a bar shows the progress, and reports what could not be read.
fn detect_boards(
    recordings: &[Placements],
    board: &Board,
    lenses: &Lenses,
    range: [Option<&str>; 2],
    quiet: bool,
) -> anyhow::Result<Detections> {
    let progress = progress(quiet);
    let on_picture = |pictures: usize| {
        progress.set_length(pictures as u64);
        progress.inc(1);
    };
    let lenses = [&lenses.known, &lenses.start].map(Option::as_ref);
    let detections = calibrate::detect_boards(recordings, board, lenses, range, &on_picture)?;
    progress.finish_and_clear();
    print_problems(detections.warnings.iter().chain(&detections.lost), quiet);
    Ok(detections)
}

fn progress(quiet: bool) -> ProgressBar {
    if quiet || !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let style = ProgressStyle::with_template("looking for the board [{bar:30}] {pos}/{len}");
    ProgressBar::new(0).with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
}

fn print_problems<'a>(problems: impl IntoIterator<Item = &'a String>, quiet: bool) {
    if !quiet {
        problems
            .into_iter()
            .for_each(|words| eprintln!("scand: {words}"));
    }
}

fn responses(known: RigCalibration) -> BTreeMap<CameraId, DepthResponse> {
    let response = |(id, (_, response))| Some((id, response?));
    known.cameras.into_iter().filter_map(response).collect()
}

fn print(args: &Args, outcome: &Outcome, written: Option<&Path>) {
    let told = Summary { outcome, written };
    if args.json {
        outln!("{:#}", told.json());
    } else if !args.quiet {
        outln!("{}", told.text());
    }
}

/// Says which requested outputs were not written, and how to get them.
fn tell_what_is_not_written(args: &Args, acceptance: Acceptance) {
    match (acceptance, &args.out) {
        (Acceptance::Nothing, _) => {
            eprintln!("scand: the calibration is refused and not written; --force writes it");
        }
        (Acceptance::Forced, Some(out)) => eprintln!(
            "scand: the calibration is refused; {} is written with that verdict because of --force, with no export",
            out.display()
        ),
        (Acceptance::Forced, None) if args.files.exports() => {
            eprintln!("scand: the calibration is refused and not exported, also with --force");
        }
        (Acceptance::Aside, Some(out)) => eprintln!(
            "scand: the calibration is doubtful and written as {}, with no export; --accept-doubtful writes it as {}",
            doubtful_name(out).display(),
            out.display()
        ),
        (Acceptance::Aside, None) if args.files.exports() => eprintln!(
            "scand: the calibration is doubtful and not exported; --accept-doubtful exports it"
        ),
        (Acceptance::Aside | Acceptance::Forced, None) | (Acceptance::Whole, _) => {}
    }
}
