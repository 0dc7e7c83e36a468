//! `scand trigger`, `background`, `session`, `note` and `status`: what a running daemon is asked.

use crate::trigger::{Client, Reply, Request, SOCKET};
use std::collections::BTreeMap;
use std::path::PathBuf;
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
    until: Until,
}

#[derive(Clone, Copy, Debug, PartialEq, clap::ValueEnum)]
enum Until {
    /// All frames are in: hands may move.
    Captured,
    /// It is on the disk.
    Durable,
}

/// Take the plates of the empty rig, which silhouettes are found against.
#[derive(Debug, clap::Args)]
pub struct BackgroundArgs {
    #[command(flatten)]
    connection: Connection,
}

/// Begin or complete a session of captures.
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
    };
    let captured = |reply: &Reply| matches!(reply, Reply::Captured { .. });
    let last = match args.until {
        Until::Captured => ask_until(&args.connection, &request, captured)?,
        Until::Durable => ask_until(&args.connection, &request, |_| false)?,
    };
    Ok(code(&last))
}

/// Asks for plates.
#[allow(clippy::missing_errors_doc)]
pub fn background(args: BackgroundArgs) -> anyhow::Result<ExitCode> {
    let last = ask_until(&args.connection, &Request::Background {}, |_| false)?;
    Ok(code(&last))
}

/// Begins or completes a session.
#[allow(clippy::missing_errors_doc)]
pub fn session(args: SessionArgs) -> anyhow::Result<ExitCode> {
    let request = match args.what {
        Session::Start { name, about } => Request::Begin {
            name,
            about: about.into_iter().collect::<BTreeMap<_, _>>(),
        },
        Session::Close => Request::Close {},
    };
    let last = ask_until(&args.connection, &request, |_| false)?;
    Ok(code(&last))
}

/// Notes something about a capture.
#[allow(clippy::missing_errors_doc)]
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
    let last = ask_until(&args.connection, &request, |_| false)?;
    Ok(code(&last))
}

/// Shows the status.
#[allow(clippy::missing_errors_doc)]
pub fn status(args: StatusArgs) -> anyhow::Result<ExitCode> {
    let last = ask_until(&args.connection, &Request::Status {}, |_| false)?;
    Ok(code(&last))
}

/// Asks and tells, up to the last reply or one that will do.
fn ask_until(
    connection: &Connection,
    request: &Request,
    enough: impl Fn(&Reply) -> bool,
) -> anyhow::Result<Reply> {
    let mut client = Client::connect(&connection.socket, PATIENCE)?;
    client.send(request)?;
    loop {
        let reply = client.reply()?;
        if connection.json {
            say!("{}", serde_json::to_string(&reply)?);
        } else {
            say!("{}", words(&reply));
        }
        if reply.is_end() || enough(&reply) {
            return Ok(reply);
        }
    }
}

fn code(last: &Reply) -> ExitCode {
    match last {
        Reply::Failed { .. } | Reply::Refused { .. } | Reply::Busy => ExitCode::FAILURE,
        _ => ExitCode::SUCCESS,
    }
}

fn words(reply: &Reply) -> String {
    match reply {
        Reply::Accepted { capture } => format!("{capture}: accepted"),
        Reply::Captured { capture, skew_ns } => {
            format!("{capture}: captured, skew {:.2} ms", *skew_ns as f64 / 1e6)
        }
        Reply::Retried { capture, reason } => {
            format!("{capture}: failed: {reason}; it is taken once more")
        }
        Reply::Durable { capture, recording } => {
            format!("{capture}: durable in {}", recording.display())
        }
        Reply::Failed { capture, reason } => format!("{capture}: failed: {reason}"),
        Reply::Busy => "busy: a capture is being taken".into(),
        Reply::Refused { reason } => format!("refused: {reason}"),
        Reply::Done { words } => words.clone(),
        Reply::Status { status } => status_words(status),
    }
}

/// The status as a table.
fn status_words(status: &serde_json::Value) -> String {
    let number = |key: &str| status[key].as_u64().unwrap_or(0);
    let mut text = format!(
        "session {}; {} complete, {} failed, {} refused; {} captures left on the disk, {} wait for it\n",
        status["session"].as_str().unwrap_or("none"),
        number("complete"),
        number("failed"),
        number("refused"),
        number("captures_left"),
        number("waiting"),
    );
    text += &match status["plates_age_h"].as_f64() {
        Some(hours) => format!("background plates: {hours:.1} h old\n"),
        None => "background plates: none (scand background takes them)\n".into(),
    };
    for (id, camera) in status["cameras"].as_object().into_iter().flatten() {
        let word = |key: &str| camera[key].as_str().unwrap_or("").to_owned();
        text += &format!(
            "{id:12} {:7} lost {:4}  {}\n",
            word("state"),
            camera["lost_frames"].as_u64().unwrap_or(0),
            word("words")
        );
        for setting in camera["settings"].as_array().into_iter().flatten() {
            let part = |i: usize| setting[i].as_str().unwrap_or("");
            if part(1) != part(2) {
                text += &format!(
                    "{:13}{}: asked for {}, has {}\n",
                    "",
                    part(0),
                    part(1),
                    part(2)
                );
            }
        }
        for remark in camera["remarks"].as_array().into_iter().flatten() {
            text += &format!("{:13}{}\n", "", remark.as_str().unwrap_or(""));
        }
    }
    text
}
