//! `scand fuse`: makes one model of several captures of one object, or says why it cannot.

use super::replay::recording_stem;
use super::wrong_usage;
use crate::calibration::RigCalibration;
use crate::capture::{CaptureSession, CaptureSummary};
use crate::config::Config;
use crate::frame::CaptureId;
use crate::make_model::{
    Gathered, ModelMaker, ObjectOutcome, ObjectRequest, Settings, Source, Wanted, gather,
    read_poses, subject_of,
};
use crate::storage;
use crate::words::count;
use anyhow::Context;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Make one model of several captures of one object, which was turned between them
#[derive(Debug, clap::Args)]
#[command(
    after_help = "The model lies in DIR/RECORDING/SUBJECT.object/, where RECORDING is the one with the earliest capture. \
Its report says how each capture's pose was found.

Exit codes: 0, all captures are fused; 3, a model was made, and captures were left out; 1, there is no model.

Examples:
  scand fuse pot.mcap --subject 17
  scand fuse monday.mcap tuesday.mcap --subject 17 --upright pot-003
  scand fuse pot.mcap --capture pot-000 --capture pot-001"
)]
pub struct Args {
    /// Recordings with captures of the object
    #[arg(required = true, value_name = "FILE")]
    recordings: Vec<PathBuf>,
    /// Take the captures of this subject, except those that a person rejected
    #[arg(long, value_name = "SUBJECT", conflicts_with = "capture")]
    subject: Option<String>,
    /// Use this capture; name two or more
    #[arg(long, value_name = "ID", required_unless_present = "subject")]
    capture: Vec<String>,
    /// Use the rig's frame at this capture as the model's frame, instead of that at the earliest one
    #[arg(long, value_name = "ID")]
    upright: Option<String>,
    /// Read the captures' poses from this file (JSON with rig_from_object), instead of finding them
    #[arg(long, value_name = "FILE")]
    poses: Option<PathBuf>,
    /// Write the model into DIR/RECORDING/SUBJECT.object/
    #[arg(short, long, default_value = "out", value_name = "DIR")]
    out: PathBuf,
    /// Use this calibration (TOML) instead of the recorded ones
    #[arg(long, value_name = "FILE")]
    calibration: Option<PathBuf>,
    /// Read this configuration (TOML); config/replay.toml shows every setting
    #[arg(short, long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Set one value of the configuration; may be given several times
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Replace a model that was made from other inputs or settings
    #[arg(short, long)]
    force: bool,
    /// Print a line of JSON instead of words
    #[arg(long)]
    json: bool,
    /// Print only errors
    #[arg(short, long)]
    quiet: bool,
}

/// Bytes of the longest file of poses.
const LONGEST_POSES: u64 = 1 << 20;
/// Exit code of a fusion that leaves captures out.
const EXIT_LEFT_OUT: u8 = super::EXIT_INCOMPLETE;

/// Makes the model of one object.
///
/// # Errors
/// If the arguments contradict each other, a recording cannot be read, or no capture is the object's.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    let config = Config::load(args.config.as_deref(), &args.set)
        .map_err(|e| super::BadConfiguration(e.into()))?;
    let calibration = args.calibration.as_deref().map(RigCalibration::load);
    let calibration = calibration
        .transpose()
        .map_err(|e| super::BadConfiguration(e.into()))?;
    let settings = Settings {
        reconstruction: config.reconstruction(),
        verdict: config.verdict.clone(),
        glb: config.glb.clone(),
        text: config.replay_toml()?,
    };
    let open = |path: &PathBuf| {
        CaptureSession::open(path, &config.sync).with_context(|| path.display().to_string())
    };
    let mut paths = args.recordings.clone();
    paths.sort();
    paths.dedup();
    let sessions: Vec<CaptureSession> = paths.iter().map(open).collect::<Result<_, _>>()?;
    let wanted = match &args.subject {
        Some(subject) if subject.is_empty() => {
            return Err(wrong_usage(
                "--subject is empty: expected the object's number",
            ));
        }
        Some(subject) => Wanted::Subject(subject),
        None => Wanted::Captures(&args.capture),
    };
    let found = gather(&sessions, wanted);
    let ids: Vec<CaptureId> = found.captures.iter().map(|(_, id)| id.clone()).collect();
    check(&args, &sessions, &ids, &found.left_out)?;
    let given = args
        .poses
        .as_deref()
        .map(|path| poses(path, &found))
        .transpose()?;
    let sources: Vec<Source> = found
        .captures
        .iter()
        .map(|(number, id)| Source {
            session: &sessions[*number],
            id,
        })
        .collect();
    let first = sources[0].session.recording().path();
    let folder = args.out.join(recording_stem(first)?);
    storage::check_writable(&folder).context("nothing was made: give another folder with --out")?;
    let maker = ModelMaker {
        settings: &settings,
        calibration: calibration.as_ref(),
        force: args.force,
        folder,
        on_stage: &|_, stage| {
            if !args.quiet && !args.json {
                eprintln!("{stage}");
            }
        },
    };
    let request = ObjectRequest {
        subject: args.subject.as_deref().unwrap_or_else(|| subject_of(&ids)),
        upright: args.upright.as_deref(),
        given: given.as_deref(),
        not_used: found.left_out.clone(),
        replaces: false,
    };
    let outcome = maker.make_object(&sources, &request);
    Ok(told(&args, &request, &outcome))
}

/// Refuses captures that are not there, and says which are.
fn check(
    args: &Args,
    sessions: &[CaptureSession],
    ids: &[CaptureId],
    left_out: &[String],
) -> anyhow::Result<()> {
    let is_missing = |name: &&String| !ids.iter().any(|id| id.as_str() == name.as_str());
    if let Some(missing) = args.capture.iter().chain(&args.upright).find(is_missing) {
        let because: String = left_out.iter().map(|l| format!("; {l}")).collect();
        let mut captures = sessions.iter().flat_map(CaptureSession::captures);
        if captures.any(|capture| capture.id.as_str() == missing.as_str()) {
            anyhow::bail!("capture {missing:?} is not among those that can be used{because}");
        }
        let known = listed(sessions, |capture| Some(capture.id.to_string()));
        let known = known.unwrap_or_else(|| "none".to_owned());
        anyhow::bail!("there is no capture {missing:?}; the captures here: {known}{because}");
    }
    if !ids.is_empty() {
        return Ok(());
    }
    let subject = args.subject.as_deref().unwrap_or_default();
    if left_out.is_empty() {
        let known = listed(sessions, |capture| capture.subject);
        let known = known.unwrap_or_else(|| "no subject".to_owned());
        anyhow::bail!("no capture of subject {subject:?}; the captures here are of {known}");
    }
    let left_out = left_out.join("; ");
    anyhow::bail!("no capture of subject {subject:?} can be used; {left_out}")
}

/// What captures are called, each name once, the first few of many; `None` if they have no names.
fn listed(
    sessions: &[CaptureSession],
    name: impl Fn(CaptureSummary) -> Option<String>,
) -> Option<String> {
    const MOST: usize = 10;
    let captures = sessions.iter().flat_map(CaptureSession::captures);
    let names: BTreeSet<String> = captures.filter_map(name).collect();
    let mut listed: Vec<String> = names.iter().take(MOST).map(|n| format!("{n:?}")).collect();
    if names.len() > MOST {
        listed.push(format!("{} more", names.len() - MOST));
    }
    (!listed.is_empty()).then(|| listed.join(", "))
}

/// Reads poses, one for each capture of the object, or for each that counts; those of the captures that count.
fn poses(path: &Path, found: &Gathered) -> anyhow::Result<Vec<nalgebra::Isometry3<f64>>> {
    let name = || path.display().to_string();
    let text = storage::read_text(path, LONGEST_POSES).with_context(name)?;
    let poses = read_poses(&text)
        .map_err(anyhow::Error::msg)
        .with_context(name)?;
    if poses.len() == found.all {
        return Ok(found.places.iter().map(|&place| poses[place]).collect());
    }
    let used = found.captures.len();
    let expected = match found.all - used {
        0 => String::new(),
        left => format!(", or for each of the {used} that are not left out ({left} are)"),
    };
    anyhow::ensure!(
        poses.len() == used,
        "{}: rig_from_object has {} for {} of the object, expected one for each{expected}",
        name(),
        count(poses.len(), "pose"),
        count(found.all, "capture")
    );
    Ok(poses)
}

/// Prints what became of the object; its exit code.
fn told(args: &Args, request: &ObjectRequest, outcome: &ObjectOutcome) -> ExitCode {
    let (model, left_out, fusion) = match outcome {
        ObjectOutcome::Failed { reason, fusion } => {
            if args.json {
                outln!(
                    "{}",
                    serde_json::json!({"subject": request.subject, "result": "failed", "reason": reason, "fusion": fusion})
                );
            }
            eprintln!("scand: {}: {reason}", request.subject);
            return ExitCode::FAILURE;
        }
        ObjectOutcome::Made { model, fusion, .. } => {
            (model, fusion.left_out().collect(), Some(fusion))
        }
        ObjectOutcome::Unchanged { model, left_out } => (model, left_out.clone(), None),
    };
    if args.json {
        outln!(
            "{}",
            serde_json::json!({
                "subject": request.subject, "result": "done", "verdict": model.verdict, "reasons": model.reasons,
                "folder": model.folder, "left_out": left_out, "fusion": fusion,
            })
        );
    } else if !args.quiet {
        outln!("{}: {}", request.subject, model.verdict.name());
        for reason in &model.reasons {
            outln!("  {reason}");
        }
        if let Some(fusion) = fusion.filter(|f| f.unseen_share > 0.01) {
            let side = fusion.unseen_side.unwrap_or("in places");
            outln!(
                "  no camera has faced {:.0} % of the surface, {side}",
                100.0 * fusion.unseen_share
            );
        }
        outln!("  {}", model.folder.display());
    }
    if left_out.is_empty() {
        ExitCode::SUCCESS
    } else {
        ExitCode::from(EXIT_LEFT_OUT)
    }
}
