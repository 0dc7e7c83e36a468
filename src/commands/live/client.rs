//! `scand trigger`, `background`, `session`, `note`, `status` and `events`: clients of a running daemon.

use super::decision_word::{self, KINDS};
use super::status_table;
use crate::commands::{EXIT_BUSY, is_away, is_output_closed, wrong_usage};
use crate::level::Level;
use crate::recording::{self, Recording, note_beside};
use crate::trigger::{self, Client, Event, Reply, Request, SOCKET, Until};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::{Duration, SystemTime};

/// How long a client waits for an answer: a capture, its retry and a slow disk take less.
const PATIENCE: Duration = Duration::from_secs(120);

#[derive(Debug, clap::Args)]
struct Connection {
    /// The daemon's socket.
    #[arg(long, value_name = "PATH", default_value = SOCKET, global = true)]
    socket: PathBuf,
    /// Print the replies as lines of JSON, as they arrive.
    #[arg(long, global = true)]
    json: bool,
}

/// Ask the running daemon for a capture and wait until it is on the disk.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  scand trigger
  scand trigger --subject 1884.3 --until done
  scand trigger --subject 1884.3 --placement upside-down")]
pub struct TriggerArgs {
    #[command(flatten)]
    connection: Connection,
    /// The number of the object, recorded with the capture.
    #[arg(long, value_name = "NUMBER", value_parser = some_words)]
    subject: Option<String>,
    /// How the object lies, such as upside-down; scand only repeats it in the report.
    #[arg(long, value_name = "WORDS")]
    placement: Option<String>,
    /// Your own id for this press: asking again with it never takes a second capture.
    #[arg(long, value_name = "ID")]
    press_id: Option<String>,
    /// Which answer to wait for.
    #[arg(long, value_name = "WHAT", value_enum, default_value = "durable")]
    until: UntilArgument,
}

#[derive(Clone, Copy, Debug, PartialEq, clap::ValueEnum)]
enum UntilArgument {
    /// All frames have arrived: hands may move.
    Captured,
    /// The capture is on the disk.
    Durable,
    /// The model is made.
    Done,
}

impl From<UntilArgument> for Until {
    fn from(wait: UntilArgument) -> Self {
        match wait {
            UntilArgument::Captured => Self::Captured,
            UntilArgument::Durable => Self::Durable,
            UntilArgument::Done => Self::Done,
        }
    }
}

/// Print what happens at the rig until interrupted.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  scand events
  scand events --json")]
pub struct EventsArgs {
    #[command(flatten)]
    connection: Connection,
}

/// Take background pictures of the empty rig, with which silhouettes are found.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  scand background")]
pub struct BackgroundArgs {
    #[command(flatten)]
    connection: Connection,
}

/// Begin a session of captures, record a note about it, or complete it.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  scand session start amphora --about operator=Ann --about rights=CC0
  scand session note \"the lamp was changed\"
  scand session close")]
pub struct SessionArgs {
    #[command(flatten)]
    connection: Connection,
    #[command(subcommand)]
    what: SessionCommand,
}

#[derive(Debug, clap::Subcommand)]
enum SessionCommand {
    /// Begin a session, and complete the one before.
    Start {
        /// The name of the session and of its recording.
        name: String,
        /// A fact about the session, such as operator=Ann; may be given several times.
        #[arg(long, value_name = "KEY=VALUE", value_parser = pair)]
        about: Vec<(String, String)>,
    },
    /// Record a note about the session.
    Note {
        /// The note.
        #[arg(value_parser = some_words)]
        text: String,
    },
    /// Complete the session.
    Close,
}

/// Accept or reject a capture, take that back, or note something about it.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  scand note amphora-0003 reject \"a hand is in the picture\"
  scand note amphora-0003 clear
  scand note amphora-0003 \"the handle was turned left\"
  scand note amphora-0003 accept --recording /archive/amphora.mcap --author Ann")]
pub struct NoteArgs {
    #[command(flatten)]
    connection: Connection,
    /// The capture's id
    capture: String,
    /// `accept`, `reject`, `clear` (which takes either back), or a text
    #[arg(value_name = "accept|reject|clear|TEXT", value_parser = some_words)]
    what: String,
    /// Why it is accepted or rejected
    #[arg(value_name = "WHY")]
    why: Option<String>,
    /// Store the words as a text, although they are close to accept, reject or clear
    #[arg(long)]
    text: bool,
    /// The author of the note
    #[arg(long, value_name = "NAME")]
    author: Option<String>,
    /// Write the note beside this complete recording, without asking the daemon
    #[arg(long, value_name = "FILE.mcap")]
    recording: Option<PathBuf>,
}

/// Show the state of the running daemon, its cameras, disk and captures.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  scand status
  scand status --json")]
pub struct StatusArgs {
    #[command(flatten)]
    connection: Connection,
}

/// A text that says something.
fn some_words(text: &str) -> Result<String, String> {
    match text.trim() {
        "" => Err("it is empty, expected a text".into()),
        _ => Ok(text.into()),
    }
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
        placement: args.placement,
        until: args.until.into(),
    };
    Ok(code(&ask(&args.connection, &request, args.until.into())?))
}

/// Asks for backgrounds.
pub fn background(args: BackgroundArgs) -> anyhow::Result<ExitCode> {
    let last = ask(&args.connection, &Request::Background {}, Until::default())?;
    Ok(code(&last))
}

/// Begins or completes a session.
pub fn session(args: SessionArgs) -> anyhow::Result<ExitCode> {
    let request = match args.what {
        SessionCommand::Start { name, about } => Request::Begin {
            name,
            about: about.into_iter().collect::<BTreeMap<_, _>>(),
        },
        SessionCommand::Note { text } => Request::Note {
            capture: running_session(&args.connection)?,
            kind: "text".into(),
            text,
            author: None,
        },
        SessionCommand::Close => Request::Close {},
    };
    let last = ask(&args.connection, &request, Until::default())?;
    Ok(code(&last))
}

/// The name of the open session: a note on it is recorded under this name.
fn running_session(connection: &Connection) -> anyhow::Result<String> {
    let mut client = Client::connect(&connection.socket, Some(PATIENCE))?;
    client.send(&Request::Status {})?;
    match client.reply()? {
        Reply::Status { status } => {
            let name = status["session"].as_str().map(Into::into);
            name.ok_or_else(|| {
                anyhow::anyhow!(
                    "no session is open: begin one with scand session \
                start NAME"
                )
            })
        }
        other => Err(anyhow::anyhow!("{}", words(&other))),
    }
}

/// Notes something about a capture.
pub fn note(args: NoteArgs) -> anyhow::Result<ExitCode> {
    let (kind, text) = kind_and_text(&args)?;
    if let Some(path) = &args.recording {
        let note = recording::Note {
            capture: args.capture,
            kind,
            text,
            author: args.author,
        };
        let written = note_beside(&Recording::open(path)?, &note, SystemTime::now().into())?;
        let reply = Reply::Ok {
            words: written.words(),
        };
        print(args.connection.json, &reply, words)?;
        return Ok(ExitCode::SUCCESS);
    }
    let request = Request::Note {
        capture: args.capture,
        kind,
        text,
        author: args.author,
    };
    let last = ask(&args.connection, &request, Until::default()).map_err(|error| {
        match is_away(&error) {
            true => error.context(
                "nothing was noted; --recording FILE.mcap notes on a complete recording, without a daemon",
            ),
            false => error,
        }
    })?;
    Ok(code(&last))
}

/// The kind of a note, and its text. A word close to accept, reject or clear must not become a mere text.
fn kind_and_text(args: &NoteArgs) -> anyhow::Result<(String, String)> {
    let what = args.what.trim();
    let why = args.why.clone().unwrap_or_default();
    if KINDS.contains(&what) && !args.text {
        return Ok((what.to_owned(), why));
    }
    // A person may write a decision and its reason as one text.
    if let Some(close) = decision_word::meant(what).filter(|_| !args.text) {
        let first = what.split([' ', ',', ':', '.']).next().unwrap_or_default();
        return Err(wrong_usage(format!(
            "{first:?} is close to {close:?}: write `scand note {} {close}`, followed by the reason if there is one, or \
             give --text to store {what:?} as a text",
            args.capture
        )));
    }
    if args.why.is_some() && !args.text {
        return Err(wrong_usage(format!(
            "a text is one argument: write it in quotes, as in `scand note {} \"{what} {why}\"`",
            args.capture
        )));
    }
    let text = [what, &why].join(" ");
    Ok(("text".into(), text.trim().to_owned()))
}

/// Shows the status.
pub fn status(args: StatusArgs) -> anyhow::Result<ExitCode> {
    let last = ask(&args.connection, &Request::Status {}, Until::default())?;
    match last {
        Reply::Status { status } if !status_table::is_known(&status) => Ok(ExitCode::FAILURE),
        last => Ok(code(&last)),
    }
}

/// Prints what happens, as long as somebody reads it.
pub fn events(args: EventsArgs) -> anyhow::Result<ExitCode> {
    let Connection { socket, json } = &args.connection;
    let mut client = Client::connect(socket, None)?;
    client.send(&Request::Events {})?;
    let first = client.reply()?;
    if *json || first != Reply::Listening {
        print(*json, &first, words)?;
    }
    if first != Reply::Listening {
        return Ok(ExitCode::FAILURE);
    }
    while !is_output_closed() {
        let event = match client.event() {
            Err(ended @ trigger::Error::Ended(_)) => {
                eprintln!("scand: {ended}: ask again when it runs");
                return Ok(ExitCode::from(EXIT_BUSY));
            }
            event => event?,
        };
        print(*json, &event, words)?;
    }
    Ok(ExitCode::SUCCESS)
}

/// Sends a request and prints the replies, up to the last one.
fn ask(connection: &Connection, request: &Request, until: Until) -> anyhow::Result<Reply> {
    let patience = (until != Until::Done).then_some(PATIENCE);
    let mut client = Client::connect(&connection.socket, patience)?;
    client.send(request)?;
    loop {
        let reply = client.reply()?;
        print(connection.json, &reply, |reply| reply_words(request, reply))?;
        if reply.is_end(until) {
            return Ok(reply);
        }
    }
}

/// Prints an event as a line of JSON if that is asked for, otherwise in words.
fn print(json: bool, event: &Event, words: impl FnOnce(&Event) -> String) -> anyhow::Result<()> {
    match json {
        true => outln!("{}", serde_json::to_string(event)?),
        false => outln!("{}", words(event)),
    }
    Ok(())
}

fn code(last: &Reply) -> ExitCode {
    match last {
        Reply::Busy | Reply::Ending => ExitCode::from(EXIT_BUSY),
        Reply::Failed { .. } | Reply::JobFailed { .. } | Reply::Refused { .. } => ExitCode::FAILURE,
        _ => ExitCode::SUCCESS,
    }
}

/// What a reply says to the person who asked. The daemon's word for a refusal is the same for presses and other orders.
fn reply_words(request: &Request, reply: &Reply) -> String {
    match (request, reply) {
        (Request::Trigger { .. }, _) => words(reply),
        (_, Reply::Refused { reason }) => format!("refused: {reason}"),
        _ => words(reply),
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
        Event::Busy => "busy: another order is being carried out, such as a capture".into(),
        Event::Refused { reason } => format!("a press was refused: {reason}"),
        Event::Done {
            capture,
            verdict,
            reasons,
            model,
            ..
        } => done_words(capture, *verdict, reasons, model),
        Event::JobFailed {
            capture, reason, ..
        } => format!("{capture}: its model could not be made: {reason}"),
        Event::Registered {
            subject,
            capture,
            words,
            unseen_percent,
            show_next,
            ..
        } => {
            let next = show_next.as_deref().map_or_else(String::new, |side| {
                format!("; no camera has faced {unseen_percent} % of the surface, {side}")
            });
            format!("object {subject}: {capture}: {words}{next}")
        }
        Event::Fused {
            subject,
            verdict: Some(verdict),
            reasons,
            model: Some(model),
            ..
        } => done_words(&format!("object {subject}"), *verdict, reasons, model),
        Event::Fused {
            subject, reasons, ..
        } => format!(
            "object {subject}: no model was made: {}",
            reasons.join("; ")
        ),
        Event::Remade {
            capture,
            verdict: Some(verdict),
            reasons,
            model: Some(model),
        } => done_words(&format!("{capture}, made again"), *verdict, reasons, model),
        Event::Remade {
            capture, reasons, ..
        } => format!("{capture}: it was not made again: {}", reasons.join("; ")),
        Event::Ok { words } | Event::Plates { words } => words.clone(),
        Event::Status { status } => status_table::status(status),
        Event::Listening => "listening".into(),
        Event::Looking => "pictures of the cameras follow".into(),
        Event::Looked {
            camera,
            words: Some(words),
            ..
        } => format!("camera {camera}: no picture: {words}"),
        Event::Looked { camera, age_ms, .. } => {
            format!("camera {camera}: a picture, {age_ms} ms old")
        }
        Event::Camera { id, state, words } => format!("camera {id}: {state}: {words}"),
        Event::Session { name: Some(name) } => format!("session {name}"),
        Event::Session { name: None } => "the session is completed".into(),
        Event::Note {
            capture,
            kind,
            text,
        } => format!("{capture}: {kind} {text}"),
        Event::Ending => "the daemon is ending: ask again with the same press id later".into(),
        Event::Lost { events } => format!(
            "{} lost, because this client reads too slowly",
            match events {
                1 => "1 event was".to_owned(),
                n => format!("{n} events were"),
            }
        ),
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
