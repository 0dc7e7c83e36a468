//! `scand make-object`, which only the daemon calls: it finds how the captures of an object lie, or makes their model
//! as `scand fuse` does, in a confined process.

use super::confined::ConfinementArgs;
use super::replay::settings;
use crate::capture::CaptureSession;
use crate::config::Config;
use crate::frame::CaptureId;
use crate::level::Level;
use crate::make_model::{
    FailedJob, Gathered, ModelMaker, ObjectOutcome, ObjectRequest, Registering, ReportFile, Source,
    Wanted, gather, object_folder_name, report_failure,
};
use crate::recording::{Recording, beside, finished_name};
use crate::report::FailedCapture;
use crate::workers::object_protocol::{self, CapturesFound, PosesFound};
use crate::workers::protocol;
use anyhow::Context;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Fuse captures of an object in a confined process. Only the daemon calls this.
#[derive(Debug, clap::Args)]
#[group(id = "make_object")]
pub struct Args {
    #[command(flatten)]
    confinement: ConfinementArgs,
    /// A recording of the session; may be given several times.
    #[arg(long, required = true, value_name = "FILE")]
    recording: Vec<PathBuf>,
    /// The object's number.
    #[arg(long, value_name = "SUBJECT")]
    subject: String,
    /// The newest of its captures.
    #[arg(long, value_name = "ID")]
    newest: String,
    /// Where models go.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// The configuration.
    #[arg(long, value_name = "FILE")]
    config: PathBuf,
    /// Find poses, and make no model.
    #[arg(long = object_protocol::REGISTER)]
    register: bool,
}

/// Most captures that the message to the daemon names.
const MOST_NAMED: usize = 8;

/// Confines this process, and registers or fuses.
///
/// # Errors
/// If it cannot be confined, or a recording cannot be read.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    args.confinement.bind_to_parent()?;
    let config =
        Config::load(Some(&args.config), &[]).map_err(|e| super::BadConfiguration(e.into()))?;
    let writes: Vec<PathBuf> = args
        .recording
        .iter()
        .map(|path| folder_of(&args.out, path))
        .collect();
    for folder in &writes {
        std::fs::create_dir_all(folder)?;
    }
    let mut reads = args.recording.clone();
    let notes = args.recording.iter().map(|path| beside(path));
    reads.extend(notes.filter(|path| path.exists()));
    args.confinement.confine(&reads, &writes)?;
    let (sessions, unread) = open_all(&args.recording, &config)?;
    let settings = settings(&config)?;
    let found = gather(&sessions, Wanted::Subject(&args.subject));
    let sources = sources(&sessions, &found);
    let first = sources.first().map_or(args.recording[0].as_path(), |s| {
        s.session.recording().path()
    });
    let maker = ModelMaker {
        settings: &settings,
        calibration: None,
        force: false,
        folder: folder_for(&writes, &args.subject).unwrap_or_else(|| folder_of(&args.out, first)),
        on_stage: &|_, _| {},
    };
    let cannot_be_read = |unread: &Unread| format!("recording {} cannot be read", unread.name);
    let mut not_used = found.left_out.clone();
    not_used.extend(unread.iter().map(cannot_be_read));
    let request = ObjectRequest {
        subject: &args.subject,
        upright: None,
        given: None,
        not_used,
        replaces: true,
    };
    let mut told = CapturesFound {
        captures: sources.len(),
        has_folder: maker.object_folder(&args.subject).exists(),
        poses: None,
    };
    if args.register && sources.len() > 1 {
        let registering = maker.register_object(&sources, &request);
        told.poses = Some(match registering {
            Ok(registering) => poses(&args.newest, &registering),
            Err(error) => PosesFound::failed(&error.to_string()),
        });
    }
    told.print();
    if args.register || (sources.len() < 2 && !told.has_folder) {
        return Ok(ExitCode::SUCCESS);
    }
    if let Some(unread) = unread.first() {
        let earlier = maker.object_folder(&args.subject);
        if told.has_folder && has_captures_of_others(&earlier, &sessions) {
            anyhow::bail!("{}; the model that was made before stays", unread.why);
        }
        // What became of its captures is not known.
        anyhow::ensure!(!sources.is_empty(), "{}", unread.why);
    }
    if sources.is_empty() {
        return none_left(&args, &sessions, &maker);
    }
    let outcome = maker.make_object(&sources, &request);
    Ok(code(&outcome))
}

/// A recording that cannot be read.
struct Unread {
    /// The name of its file.
    name: String,
    why: String,
}

/// The recordings of the session, and those that cannot be read: these hinder no object of the others.
///
/// # Errors
/// If none can be read, or one has another name by now, with which this process is started again.
fn open_all(
    paths: &[PathBuf],
    config: &Config,
) -> anyhow::Result<(Vec<CaptureSession>, Vec<Unread>)> {
    let (mut sessions, mut unread) = (Vec::new(), Vec::new());
    for path in paths {
        let recording = Recording::open(path).map_err(anyhow::Error::from);
        let session = recording.and_then(|r| Ok(CaptureSession::of_any(r, &config.sync)?));
        match session.with_context(|| path.display().to_string()) {
            Ok(session) => sessions.push(session),
            Err(error) if object_protocol::is_gone(path) => return Err(error),
            Err(error) => unread.push(Unread {
                name: path
                    .file_name()
                    .unwrap_or_default()
                    .to_string_lossy()
                    .into_owned(),
                why: format!("{error:#}"),
            }),
        }
    }
    match unread.last() {
        Some(last) if sessions.is_empty() => anyhow::bail!("{}", last.why),
        _ => unread.iter().for_each(|unread| protocol::warn(&unread.why)),
    }
    Ok((sessions, unread))
}

/// Whether the model in a folder was made of a capture that none of these recordings has, or may have been.
fn has_captures_of_others(folder: &Path, sessions: &[CaptureSession]) -> bool {
    let is_known = |id: &String| {
        let id = CaptureId::new(id);
        id.is_ok_and(|id| sessions.iter().any(|s| s.capture(&id).is_some()))
    };
    ReportFile::fused(folder).is_none_or(|fused| !fused.iter().all(is_known))
}

fn sources<'a>(sessions: &'a [CaptureSession], found: &'a Gathered) -> Vec<Source<'a>> {
    let captures = found.captures.iter();
    captures
        .map(|(number, id)| Source {
            session: &sessions[*number],
            id,
        })
        .collect()
}

/// Where the models of a recording go.
fn folder_of(models: &Path, recording: &Path) -> PathBuf {
    let complete = finished_name(recording).unwrap_or_else(|| recording.to_owned());
    models.join(complete.file_stem().unwrap_or_default())
}

/// Where the object's model is already, among the models of these recordings: its earliest capture may have been of
/// another recording, and was rejected since.
fn folder_for(writes: &[PathBuf], subject: &str) -> Option<PathBuf> {
    let name = object_folder_name(subject);
    let found = writes.iter().find(|folder| folder.join(&name).exists());
    found.cloned()
}

/// The message to the daemon about how captures lie.
fn poses(newest: &str, registering: &Registering) -> PosesFound {
    let fusion = &registering.fusion;
    let of_newest = fusion.captures.iter().find(|c| c.id.as_str() == newest);
    let of_newest = of_newest.or(fusion.captures.last());
    let held_by = of_newest.and_then(|c| c.held_by).and_then(|held_by| {
        let name = serde_json::to_value(held_by).ok()?;
        name.as_str().map(str::to_owned)
    });
    let is_lost = of_newest.is_none_or(|c| !c.is_fused);
    let side = fusion.unseen_side.filter(|_| !is_lost);
    let left_out: Vec<String> = fusion.left_out().take(MOST_NAMED).collect();
    let is_refused = of_newest.is_some_and(|c| c.refused.is_some());
    PosesFound {
        verdict: of_newest
            .filter(|_| !is_lost)
            .map_or(Level::Red, |c| c.level),
        held_by: held_by.filter(|_| !is_lost),
        // Where it is the only one that is left, the others say why.
        words: match of_newest {
            Some(c) if is_refused || !is_lost => c.words.clone(),
            _ => left_out.join("; "),
        },
        left_out,
        unseen_percent: (100.0 * fusion.unseen_share).round() as u32,
        show_next: side.map(str::to_owned),
    }
}

/// There is a model from before, and each capture of it was rejected since.
fn none_left(
    args: &Args,
    sessions: &[CaptureSession],
    maker: &ModelMaker,
) -> anyhow::Result<ExitCode> {
    let reason = "every capture of this object was rejected, or failed";
    let id = CaptureId::new(&args.newest)?;
    let summary = sessions.iter().find_map(|s| s.capture(&id));
    let (time_ns, source) = summary.map(|c| (c.time, c.source)).unwrap_or_default();
    let job = FailedJob {
        recording: &args.recording[0],
        method: maker.settings.reconstruction.method,
        capture: FailedCapture {
            id: &id,
            time_ns,
            source: &source,
        },
    };
    let folder = maker.folder.join(object_folder_name(&args.subject));
    report_failure(&folder, job, reason, None, true)?;
    eprintln!("scand: {reason}");
    Ok(ExitCode::FAILURE)
}

fn code(outcome: &ObjectOutcome) -> ExitCode {
    let is_whole = match outcome {
        ObjectOutcome::Failed { reason, .. } => {
            eprintln!("scand: {reason}");
            return ExitCode::FAILURE;
        }
        ObjectOutcome::Made { fusion, .. } => fusion.left_out().next().is_none(),
        ObjectOutcome::Unchanged { left_out, .. } => left_out.is_empty(),
    };
    if is_whole {
        ExitCode::SUCCESS
    } else {
        ExitCode::from(protocol::EXIT_INCOMPLETE)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Cli {
        #[command(flatten)]
        args: Args,
    }

    #[test]
    fn a_model_that_is_there_is_replaced_where_it_is() {
        let root = tempfile::tempdir().unwrap();
        let writes = ["a", "a-002"].map(|name| root.path().join(name));
        assert_eq!(folder_for(&writes, "Inv. 17"), None);
        std::fs::create_dir_all(writes[1].join(object_folder_name("Inv. 17"))).unwrap();
        assert_eq!(folder_for(&writes, "Inv. 17").as_ref(), Some(&writes[1]));
        assert_eq!(folder_for(&writes, "17"), None);
    }

    #[test]
    fn what_the_daemon_asks_for_is_what_this_command_understands() {
        let request = object_protocol::ObjectModelRequest {
            confinement: protocol::Confinement {
                memory_mb: 640,
                nice: 10,
            },
            recordings: &["sessions/a.mcap.part".into(), "sessions/a-002.mcap".into()],
            subject: "--force 17",
            newest: "-a-0002",
            registers: true,
            models: Path::new("models"),
            config: Path::new("jobs/settings.toml"),
        };
        let words = std::iter::once(object_protocol::COMMAND.into()).chain(request.arguments());
        let args = Cli::parse_from(words).args;
        assert_eq!(args.confinement.numbers(), [std::process::id(), 640, 10]);
        assert_eq!(args.recording.len(), 2);
        assert_eq!(
            (args.subject.as_str(), args.newest.as_str()),
            ("--force 17", "-a-0002")
        );
        assert!(args.register);
        assert_eq!(
            folder_of(&args.out, &args.recording[0]),
            Path::new("models/a")
        );
    }
}
