//! `scand trigger`, `background`, `session`, `note`, `status` and `events`: clients of a running daemon.

use super::status_table;
use crate::level::Level;
use crate::trigger::{Client, Event, Reply, Request, SOCKET, Until};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

/// How long an answer is waited for: a capture, its retry and a slow disk are done by then.
const PATIENCE: Duration = Duration::from_secs(120);

#[derive(Debug, clap::Args)]
struct Connection {
    /// The daemon's socket.
    #[arg(long, value_name = "PATH", default_value = SOCKET, global = true)]
    socket: PathBuf,
    /// Print replies as they come, lines of JSON.
    #[arg(long, global = true)]
    json: bool,
}

/// Ask the running daemon for a capture and wait until it is on the disk.
#[derive(Debug, clap::Args)]
pub struct TriggerArgs {
    #[command(flatten)]
    connection: Connection,
    /// The object's number.
    #[arg(long, value_name = "NUMBER")]
    subject: Option<String>,
    /// A name for this press, of your own.
    #[arg(long, value_name = "ID")]
    press_id: Option<String>,
    /// What to wait for.
    #[arg(long, value_name = "WHAT", value_enum, default_value = "durable")]
    until: Wait,
}

#[derive(Clone, Copy, Debug, PartialEq, clap::ValueEnum)]
enum Wait {
    /// All frames are in: hands may move.
    Captured,
    /// It is on the disk.
    Durable,
    /// Its model is made.
    Done,
}

impl From<Wait> for Until {
    fn from(wait: Wait) -> Self {
        match wait {
            Wait::Captured => Self::Captured,
            Wait::Durable => Self::Durable,
            Wait::Done => Self::Done,
        }
    }
}

/// Tell what happens at the rig, until interrupted.
#[derive(Debug, clap::Args)]
pub struct EventsArgs {
    #[command(flatten)]
    connection: Connection,
}

/// Take the plates of the empty rig, which silhouettes are found against.
#[derive(Debug, clap::Args)]
pub struct BackgroundArgs {
    #[command(flatten)]
    connection: Connection,
}

/// Begin a session of captures, note something about it, or complete it.
#[derive(Debug, clap::Args)]
pub struct SessionArgs {
    #[command(flatten)]
    connection: Connection,
    #[command(subcommand)]
    what: Session,
}

#[derive(Debug, clap::Subcommand)]
enum Session {
    /// Begin one; the one before is completed.
    Start {
        /// Its name, which its recording gets.
        name: String,
        /// A pair about it, such as operator=Ann; may be given several times.
        #[arg(long, value_name = "KEY=VALUE", value_parser = pair)]
        about: Vec<(String, String)>,
    },
    /// Note something about it in its recording.
    Note {
        /// In words.
        text: String,
    },
    /// Complete it.
    Close,
}

/// Note something about a capture in its recording.
#[derive(Debug, clap::Args)]
pub struct NoteArgs {
    #[command(flatten)]
    connection: Connection,
    /// The capture.
    capture: String,
    /// `accept`, `reject` or a text.
    text: String,
}

/// Show what the running daemon knows of its cameras, its disk and its captures.
#[derive(Debug, clap::Args)]
pub struct StatusArgs {
    #[command(flatten)]
    connection: Connection,
}

fn pair(text: &str) -> Result<(String, String), String> {
    let (key, value) = text
        .split_once('=')
        .ok_or_else(|| format!("{text:?} is not KEY=VALUE"))?;
    Ok((key.into(), value.into()))
}

/// Asks for a capture.
///
/// # Errors
/// If the daemon cannot be asked; so for all that follow.
pub fn trigger(args: TriggerArgs) -> anyhow::Result<ExitCode> {
    let request = Request::Trigger {
        source: "socket".into(),
        press_id: args.press_id,
        subject: args.subject,
        until: args.until.into(),
    };
    Ok(code(&ask(&args.connection, &request, args.until.into())?))
}

/// Asks for plates.
pub fn background(args: BackgroundArgs) -> anyhow::Result<ExitCode> {
    let last = ask(&args.connection, &Request::Background {}, Until::default())?;
    Ok(code(&last))
}

/// Begins or completes a session.
pub fn session(args: SessionArgs) -> anyhow::Result<ExitCode> {
    let request = match args.what {
        Session::Start { name, about } => Request::Begin {
            name,
            about: about.into_iter().collect::<BTreeMap<_, _>>(),
        },
        Session::Note { text } => Request::Note {
            capture: running_session(&args.connection)?,
            kind: "text".into(),
            text,
        },
        Session::Close => Request::Close {},
    };
    let last = ask(&args.connection, &request, Until::default())?;
    Ok(code(&last))
}

/// The name of the session that is recorded: what is noted of it, is noted under its name.
fn running_session(connection: &Connection) -> anyhow::Result<String> {
    let mut client = Client::connect(&connection.socket, Some(PATIENCE))?;
    client.send(&Request::Status {})?;
    match client.reply()? {
        Reply::Status { status } => {
            let name = status["session"].as_str().map(Into::into);
            name.ok_or_else(|| anyhow::anyhow!("there is no session (scand session start)"))
        }
        other => Err(anyhow::anyhow!("{}", words(&other))),
    }
}

/// Notes something about a capture.
pub fn note(args: NoteArgs) -> anyhow::Result<ExitCode> {
    let plain = matches!(args.text.as_str(), "accept" | "reject");
    let (kind, text) = if plain {
        (args.text, String::new())
    } else {
        ("text".to_owned(), args.text)
    };
    let request = Request::Note {
        capture: args.capture,
        kind,
        text,
    };
    let last = ask(&args.connection, &request, Until::default())?;
    Ok(code(&last))
}

/// Shows the status.
pub fn status(args: StatusArgs) -> anyhow::Result<ExitCode> {
    let last = ask(&args.connection, &Request::Status {}, Until::default())?;
    Ok(code(&last))
}

/// Tells what happens.
pub fn events(args: EventsArgs) -> anyhow::Result<ExitCode> {
    let Connection { socket, json } = &args.connection;
    let mut client = Client::connect(socket, None)?;
    client.send(&Request::Events {})?;
    let first = client.reply()?;
    if *json {
        outln!("{}", serde_json::to_string(&first)?);
    } else if first != Reply::Listening {
        outln!("{}", words(&first));
    }
    if first != Reply::Listening {
        return Ok(ExitCode::FAILURE);
    }
    loop {
        let event = client.event()?;
        if *json {
            outln!("{}", serde_json::to_string(&event)?);
        } else {
            outln!("{}", words(&event));
        }
    }
}

/// Asks and tells, up to the last reply.
fn ask(connection: &Connection, request: &Request, until: Until) -> anyhow::Result<Reply> {
    let patience = (until != Until::Done).then_some(PATIENCE);
    let mut client = Client::connect(&connection.socket, patience)?;
    client.send(request)?;
    loop {
        let reply = client.reply()?;
        if connection.json {
            outln!("{}", serde_json::to_string(&reply)?);
        } else {
            outln!("{}", words(&reply));
        }
        if reply.is_end(until) {
            return Ok(reply);
        }
    }
}

fn code(last: &Reply) -> ExitCode {
    match last {
        Reply::Failed { .. }
        | Reply::JobFailed { .. }
        | Reply::Refused { .. }
        | Reply::Busy
        | Reply::Ending => ExitCode::FAILURE,
        _ => ExitCode::SUCCESS,
    }
}

fn words(event: &Event) -> String {
    match event {
        Event::Accepted {
            capture,
            source: Some(source),
            ..
        } => format!("{capture}: accepted from {source}"),
        Event::Accepted { capture, .. } => format!("{capture}: accepted"),
        Event::Captured { capture, skew_ns } => {
            format!("{capture}: captured, skew {:.2} ms", *skew_ns as f64 / 1e6)
        }
        Event::Retried { capture, reason } => {
            format!("{capture}: failed: {reason}; it is taken once more")
        }
        Event::Durable { capture, recording } => {
            format!("{capture}: durable in {}", recording.display())
        }
        Event::Failed { capture, reason } => format!("{capture}: failed: {reason}"),
        Event::Busy => "busy: a capture is being taken".into(),
        Event::Refused { reason } => format!("refused: {reason}"),
        Event::Done {
            capture,
            verdict,
            reasons,
            model,
            ..
        } => done_words(capture, *verdict, reasons, model),
        Event::JobFailed {
            capture, reason, ..
        } => format!("{capture}: no model: {reason}"),
        Event::Ok { words } | Event::Plates { words } => words.clone(),
        Event::Status { status } => status_table::status(status),
        Event::Listening => "listening".into(),
        Event::Camera { id, state, words } => format!("camera {id}: {state}: {words}"),
        Event::Session { name: Some(name) } => format!("session {name}"),
        Event::Session { name: None } => "the session is completed".into(),
        Event::Note {
            capture,
            kind,
            text,
        } => format!("{capture}: {kind} {text}"),
        Event::Ending => "the daemon is ending: ask again with the same press id later".into(),
        Event::Lost { events } => format!("{events} events are lost: this reader is too slow"),
    }
}

fn done_words(capture: &str, verdict: Level, reasons: &[String], model: &Path) -> String {
    let verdict = verdict.name();
    let why = match reasons {
        [] => String::new(),
        reasons => format!(" ({})", reasons.join("; ")),
    };
    format!("{capture}: done, {verdict}{why}, in {}", model.display())
}
