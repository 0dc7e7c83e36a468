//! `scand fleet-step`, which only the processes of a fleet call: finds or lists a recording, packs one capture, makes
//! its model, or checks a result and puts it into place, each in a confined process without network.

use crate::capture::CaptureSession;
use crate::commands::confined::ConfinementArgs;
use crate::commands::make_model;
use crate::commands::replay;
use crate::config::Config;
use crate::fleet::{Bundle, CommitResult, FileSum, commit, step, write_bundle};
use crate::frame::CaptureId;
use crate::make_model::mark;
use crate::recording::{Notes, Recording, beside};
use crate::workers::{self, Job};
use anyhow::Context;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// A confined step of a job. Only the processes of a fleet call this.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    step: Step,
}

#[derive(Debug, clap::Subcommand)]
enum Step {
    Find(FindArgs),
    List(Box<AnswerArgs>),
    Replay(Box<AnswerArgs>),
    Pack(PackArgs),
    Make(Box<make_model::Args>),
    Commit(CommitArgs),
}

/// Finds the recording that has a job's capture now.
#[derive(Debug, clap::Args)]
struct FindArgs {
    #[command(flatten)]
    confinement: ConfinementArgs,
    /// The folder of recordings.
    #[arg(long)]
    recordings: PathBuf,
    /// The file of the job.
    #[arg(long)]
    job: PathBuf,
    /// The folder in which to write the recording's name.
    #[arg(long)]
    to: PathBuf,
}

/// Looks into a recording, or replays it, and answers in a file.
#[derive(Debug, clap::Args)]
struct AnswerArgs {
    #[command(flatten)]
    make: make_model::Args,
    /// The folder in which to write the answer.
    #[arg(long)]
    to: PathBuf,
}

/// Writes a capture's own recording into a folder, and what it is.
#[derive(Debug, clap::Args)]
struct PackArgs {
    #[command(flatten)]
    confinement: ConfinementArgs,
    /// The recording.
    #[arg(long)]
    recording: PathBuf,
    /// The capture.
    #[arg(long)]
    capture: String,
    /// The configuration of the reconstruction.
    #[arg(long)]
    config: PathBuf,
    /// The file to write, in a folder of its own.
    #[arg(long)]
    to: PathBuf,
}

/// Checks a result and puts it into place.
#[derive(Debug, clap::Args)]
struct CommitArgs {
    #[command(flatten)]
    confinement: ConfinementArgs,
    /// The result.
    #[arg(long)]
    bundle: PathBuf,
    /// The folder of the model.
    #[arg(long)]
    target: PathBuf,
    /// The digest of its contents, as its worker named it.
    #[arg(long)]
    contents: String,
    /// The recording of the capture, for people's notes on it.
    #[arg(long)]
    recording: PathBuf,
    /// The file name that the recording has when it is complete.
    #[arg(long)]
    name: String,
    /// The capture.
    #[arg(long)]
    capture: String,
    /// Replace another model.
    #[arg(long)]
    replace: bool,
}

/// Runs a step.
///
/// # Errors
/// If it cannot be confined, or cannot do its work.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    match args.step {
        Step::Find(args) => find(&args),
        Step::List(args) => answer(*args, replay::confined::list),
        Step::Replay(args) => answer(*args, replay::confined::outcomes),
        Step::Pack(args) => pack(&args),
        Step::Make(args) => make(*args),
        Step::Commit(args) => put_into_place(&args),
    }
}

fn find(args: &FindArgs) -> anyhow::Result<ExitCode> {
    args.confinement.bind_to_parent()?;
    let reads = [args.recordings.clone(), args.job.clone()];
    args.confinement
        .confine(&reads, std::slice::from_ref(&args.to))?;
    let job = Job::read(&args.job).with_context(|| args.job.display().to_string())?;
    let found = workers::find(&args.recordings, &job);
    let name = found.as_deref().and_then(Path::file_name);
    let name = name.unwrap_or_default().as_encoded_bytes();
    std::fs::write(args.to.join(step::FOUND), name)?;
    Ok(ExitCode::SUCCESS)
}

fn parent(path: &Path) -> anyhow::Result<&Path> {
    let parent = path.parent();
    parent.with_context(|| format!("{} has no parent folder", path.display()))
}

fn answer(
    args: AnswerArgs,
    work: fn(replay::Args) -> anyhow::Result<String>,
) -> anyhow::Result<ExitCode> {
    let replay = args.make.confined(std::slice::from_ref(&args.to))?;
    std::fs::write(args.to.join(step::ANSWER), work(replay)?)?;
    Ok(ExitCode::SUCCESS)
}

fn pack(args: &PackArgs) -> anyhow::Result<ExitCode> {
    args.confinement.bind_to_parent()?;
    let folder = parent(&args.to)?;
    let reads = [args.recording.clone(), args.config.clone()];
    args.confinement.confine(&reads, &[folder.to_owned()])?;
    let config = Config::load(Some(&args.config), &[])?;
    let id = CaptureId::new(&args.capture)?;
    let session = CaptureSession::open(&args.recording, &config.sync)?;
    let program = concat!("scand ", env!("CARGO_PKG_VERSION"));
    let extract = match session.extract(&id, &args.to, program, &config.sync) {
        Ok(extract) => extract,
        Err(error) => {
            eprintln!("scand: {error}");
            return Ok(ExitCode::from(step::EXIT_REFUSED));
        }
    };
    let FileSum { bytes, crc32 } = FileSum::of(&args.to)?;
    let packed = step::Packed {
        content_sha256: extract.content_sha256,
        bytes,
        crc32,
    };
    std::fs::write(folder.join(step::PACKED), serde_json::to_vec(&packed)?)?;
    Ok(ExitCode::SUCCESS)
}

/// Makes a model as `scand make-model` does, and bundles its folder, or the report of why there is none.
fn make(args: make_model::Args) -> anyhow::Result<ExitCode> {
    let (folder, capture) = args.output()?;
    let code = make_model::run(args)?;
    let bundle = Bundle::of_folder(&folder.join(capture))?;
    if bundle.files.is_empty() {
        return Ok(code);
    }
    write_bundle(&bundle, &folder.join(step::BUNDLE))?;
    Ok(ExitCode::SUCCESS)
}

fn put_into_place(args: &CommitArgs) -> anyhow::Result<ExitCode> {
    args.confinement.bind_to_parent()?;
    let folder = parent(&args.target)?.to_owned();
    std::fs::create_dir_all(&folder)?;
    let mut reads = vec![args.bundle.clone(), args.recording.clone()];
    reads.extend(Some(beside(&args.recording)).filter(|path| path.exists()));
    args.confinement.confine(&reads, &[folder])?;
    let of = (args.name.as_str(), args.capture.as_str());
    let committed = commit(&args.bundle, &args.target, of, &args.contents, args.replace);
    let code = match committed.map_err(anyhow::Error::msg)? {
        CommitResult::Placed => ExitCode::SUCCESS,
        CommitResult::Equal => ExitCode::from(step::EXIT_EQUAL),
        CommitResult::Differs => return Ok(ExitCode::from(step::EXIT_DIFFERS)),
        CommitResult::Refused(why) => {
            eprintln!("scand: {why}");
            return Ok(ExitCode::from(step::EXIT_REFUSED));
        }
    };
    note(&args.recording, &args.target, &args.capture);
    Ok(code)
}

/// Marks a model with people's notes on its capture, which do not travel.
fn note(recording: &Path, target: &Path, capture: &str) {
    if !target.join("preview.png").exists() {
        return;
    }
    let marked = Recording::open(recording)
        .map_err(|e| e.to_string())
        .and_then(|recording| {
            let notes = Notes::of(&recording);
            mark(target, &notes.on(capture)).map_err(|e| e.to_string())
        });
    if let Err(problem) = marked {
        eprintln!("scand: capture {capture}: cannot mark its model with the notes: {problem}");
    }
}

impl make_model::Args {
    /// The folder of the recording's models, and the one capture.
    fn output(&self) -> anyhow::Result<(PathBuf, String)> {
        let replay: &replay::Args = self.replay();
        let folder = replay
            .writes()?
            .into_iter()
            .next()
            .context("no output folder was given for a recording")?;
        let capture = replay.captures().first();
        let capture = capture.context("no capture was named")?;
        Ok((folder, capture.clone()))
    }
}
