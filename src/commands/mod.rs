//! The command line: each command's arguments and output. Commands call the other rooms, which do the work, and turn
//! errors into messages and exit codes.

/// `println!` that ignores a reader that has gone away, as `head` does: a closed pipe is no error.
macro_rules! outln {
    ($($words:tt)*) => {
        $crate::commands::write_out(&format!($($words)*))
    };
}

pub mod board;
pub mod calibrate;
pub mod diff;
pub mod evaluate;
pub mod info;
pub mod live;
#[cfg(feature = "live")]
pub mod make_model;
#[cfg(not(feature = "lab"))]
pub mod no_simulator;
pub mod pack;
pub mod recover;
pub mod replay;
#[cfg(feature = "lab")]
pub mod simulate;

use clap::{Parser, Subcommand};
use std::path::Path;
use std::process::ExitCode;

pub use crate::workers::protocol::EXIT_LOST;

/// Exit code of a call with arguments that cannot be met, as clap has it.
pub const EXIT_USAGE: u8 = 2;

/// Exit code of a run whose configuration is bad (EX_CONFIG of sysexits.h).
pub const EXIT_CONFIGURATION: u8 = 78;

/// Writes a text and the end of its line, if it has none, to the standard output.
fn write_out(text: &str) {
    use std::io::Write;
    let end = if text.ends_with('\n') { "" } else { "\n" };
    let _ = write!(std::io::stdout().lock(), "{text}{end}");
}

/// Refuses to overwrite the existing file of an option unless `force` is given.
///
/// # Errors
/// If something has the file's name.
fn refuse_to_replace(option: &str, file: Option<&Path>, force: bool) -> anyhow::Result<()> {
    match file.filter(|path| !force && path.symlink_metadata().is_ok()) {
        Some(path) => anyhow::bail!(
            "{} is there already: give --force to replace it, or another {option}",
            path.display()
        ),
        None => Ok(()),
    }
}

/// A configuration or calibration that is refused.
#[derive(Debug, thiserror::Error)]
#[error(transparent)]
struct BadConfiguration(Box<dyn std::error::Error + Send + Sync>);

/// Arguments that cannot be met.
#[derive(Debug, thiserror::Error)]
#[error(transparent)]
struct WrongUsage(Box<dyn std::error::Error + Send + Sync>);

/// The error of a call whose arguments cannot be met.
fn wrong_usage(cause: impl Into<Box<dyn std::error::Error + Send + Sync>>) -> anyhow::Error {
    WrongUsage(cause.into()).into()
}

/// The exit code of an error.
pub fn exit_code(error: &anyhow::Error) -> ExitCode {
    if error.is::<BadConfiguration>() {
        ExitCode::from(EXIT_CONFIGURATION)
    } else if error.is::<WrongUsage>() {
        ExitCode::from(EXIT_USAGE)
    } else {
        ExitCode::FAILURE
    }
}

/// What `--version` tells: the version, and of this build its commit and its features (`build.rs`).
const VERSION: &str = concat!(
    env!("CARGO_PKG_VERSION"),
    " (commit ",
    env!("SCAND_COMMIT"),
    "; features: ",
    env!("SCAND_FEATURES"),
    ")"
);

/// Scans objects with colour cameras and a depth camera.
#[derive(Debug, Parser)]
#[command(version = VERSION, about, long_about = None, args_conflicts_with_subcommands = true)]
pub struct Cli {
    #[command(flatten)]
    replay: replay::Args,
    #[command(subcommand)]
    command: Option<Command>,
}

#[derive(Debug, Subcommand)]
enum Command {
    Background(live::client::BackgroundArgs),
    Board(board::Args),
    Calibrate(Box<calibrate::Args>),
    #[cfg(feature = "live")]
    Check(live::check::Args),
    Diff(diff::Args),
    Evaluate(evaluate::Args),
    Events(live::client::EventsArgs),
    Info(info::Args),
    #[cfg(feature = "live")]
    #[command(hide = true, name = crate::workers::protocol::COMMAND)]
    MakeModel(Box<make_model::Args>),
    Note(live::client::NoteArgs),
    Pack(pack::Args),
    #[cfg(feature = "pedal")]
    Pedal(live::pedal::Args),
    Recover(recover::Args),
    #[cfg(feature = "live")]
    Run(live::run::Args),
    Session(live::client::SessionArgs),
    #[cfg(feature = "lab")]
    Simulate(Box<simulate::Args>),
    #[cfg(not(feature = "lab"))]
    Simulate(no_simulator::Args),
    Status(live::client::StatusArgs),
    Trigger(live::client::TriggerArgs),
}

/// Runs what was asked.
///
/// # Errors
/// What went wrong, in words for the terminal; [`exit_code`] has its exit code.
pub fn run(cli: Cli) -> anyhow::Result<ExitCode> {
    match cli.command {
        Some(Command::Background(args)) => live::client::background(args),
        Some(Command::Board(args)) => board::run(args),
        Some(Command::Calibrate(args)) => calibrate::run(*args),
        #[cfg(feature = "live")]
        Some(Command::Check(args)) => live::check::run(args),
        Some(Command::Diff(args)) => diff::run(args),
        Some(Command::Evaluate(args)) => evaluate::run(args),
        Some(Command::Events(args)) => live::client::events(args),
        Some(Command::Info(args)) => info::run(args),
        #[cfg(feature = "live")]
        Some(Command::MakeModel(args)) => make_model::run(*args),
        Some(Command::Note(args)) => live::client::note(args),
        Some(Command::Pack(args)) => pack::run(args),
        #[cfg(feature = "pedal")]
        Some(Command::Pedal(args)) => live::pedal::run(args),
        Some(Command::Recover(args)) => recover::run(args),
        #[cfg(feature = "live")]
        Some(Command::Run(args)) => live::run::run(args),
        Some(Command::Session(args)) => live::client::session(args),
        #[cfg(feature = "lab")]
        Some(Command::Simulate(args)) => simulate::run(*args),
        #[cfg(not(feature = "lab"))]
        Some(Command::Simulate(_)) => no_simulator::run(),
        Some(Command::Status(args)) => live::client::status(args),
        Some(Command::Trigger(args)) => live::client::trigger(args),
        None => replay::run(cli.replay),
    }
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    #[test]
    fn the_command_line_is_sound() {
        super::Cli::command().debug_assert();
    }
}
