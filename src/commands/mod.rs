//! The command line: each command's arguments and output. Commands call the other rooms, which do the work, and turn
//! errors into messages and exit codes.

/// `println!` that ignores a closed pipe, as with `head`: it is not an error. [`check_output`] tells of other errors.
macro_rules! outln {
    ($($words:tt)*) => {
        $crate::commands::write_out(&format!($($words)*))
    };
}

pub mod absent;
pub mod archive;
pub mod board;
pub mod calibrate;
mod comparison;
#[cfg(any(feature = "live", feature = "page"))]
mod confined;
pub mod demo;
pub mod diff;
pub mod evaluate;
pub mod export;
mod first_aid;
#[cfg(feature = "fleet")]
pub mod fleet;
#[cfg(feature = "fleet")]
pub mod fleet_step;
pub mod fuse;
pub mod generate;
pub mod info;
pub mod live;
#[cfg(feature = "live")]
pub mod make_look;
#[cfg(feature = "live")]
pub mod make_model;
#[cfg(feature = "live")]
pub mod make_object;
#[cfg(feature = "page")]
pub mod make_view;
mod model_notes;
pub mod pack;
#[cfg(feature = "page")]
pub mod page;
mod parse;
#[cfg(feature = "page")]
mod photographs;
#[cfg(any(feature = "live", feature = "page"))]
mod picture_limit;
pub mod publish;
pub mod recover;
pub mod replay;
#[cfg(feature = "lab")]
pub mod simulate;
pub mod verify;

use clap::{Parser, Subcommand};
pub use parse::parse;
use std::path::Path;
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

pub use crate::workers::protocol::EXIT_INCOMPLETE;
use crate::{storage, trigger};

/// Exit code of a call with wrong arguments, the same as clap's.
pub const EXIT_USAGE: u8 = 2;

/// Exit code of a client whose daemon does not answer (EX_UNAVAILABLE of sysexits.h).
pub const EXIT_AWAY: u8 = 69;

/// Exit code of a client whose daemon is busy or ending, and which may ask again (EX_TEMPFAIL of sysexits.h).
pub const EXIT_BUSY: u8 = 75;

/// Exit code of a run whose configuration is bad (EX_CONFIG of sysexits.h).
pub const EXIT_CONFIGURATION: u8 = 78;

/// The first error of the standard output that is not a closed pipe. It ends no work that is in progress, such as
/// models that are being made.
static OUTPUT_ERROR: Mutex<Option<std::io::Error>> = Mutex::new(None);

/// Whether nobody reads the standard output any more, as when `head` has the lines that it wanted.
static OUTPUT_IS_CLOSED: AtomicBool = AtomicBool::new(false);

/// Writes a text and the end of its line, if it has none, to the standard output.
fn write_out(text: &str) {
    use std::io::Write;
    let end = if text.ends_with('\n') { "" } else { "\n" };
    let mut output = std::io::stdout().lock();
    let written = write!(output, "{text}{end}").and_then(|()| output.flush());
    match written {
        Ok(()) => {}
        Err(error) if error.kind() == std::io::ErrorKind::BrokenPipe => {
            OUTPUT_IS_CLOSED.store(true, Ordering::Relaxed);
        }
        Err(error) => {
            output_error().get_or_insert(error);
        }
    }
}

/// Whether a line found no reader: what has nothing to do but to print may end.
fn is_output_closed() -> bool {
    OUTPUT_IS_CLOSED.load(Ordering::Relaxed)
}

fn output_error() -> MutexGuard<'static, Option<std::io::Error>> {
    OUTPUT_ERROR.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Whether all results could be printed until now. A command calls this itself if [`check_output`] would give it an
/// exit code that means something else.
///
/// # Errors
/// If they could not; this is told once.
fn all_is_printed() -> anyhow::Result<()> {
    match output_error().take() {
        None => Ok(()),
        Some(error) => {
            let advice = storage::advice(&error);
            anyhow::bail!("cannot write to standard output: {error}{advice}")
        }
    }
}

/// The exit code of a run that would end with `code`: failure, with a message, if results could not be printed.
pub fn check_output(code: ExitCode) -> ExitCode {
    match all_is_printed() {
        Ok(()) => code,
        Err(error) => {
            eprintln!("scand: {error}");
            ExitCode::FAILURE
        }
    }
}

/// Refuses to overwrite the existing file of an option unless `force` is given.
///
/// # Errors
/// If something has the file's name.
fn refuse_to_replace(option: &str, file: Option<&Path>, force: bool) -> anyhow::Result<()> {
    match file.filter(|path| !force && path.symlink_metadata().is_ok()) {
        Some(path) => anyhow::bail!(
            "{} already exists: give --force to replace it, or another {option}",
            path.display()
        ),
        None => Ok(()),
    }
}

/// Finds out before long work whether a file can be written: its folder is made, if there is none.
///
/// # Errors
/// If the folder cannot be made or written to.
fn check_folder_of(file: &Path) -> Result<(), storage::Error> {
    let folder = file.parent().filter(|folder| *folder != Path::new(""));
    storage::check_writable(folder.unwrap_or(Path::new(".")))
}

/// A configuration or calibration that is refused.
#[derive(Debug, thiserror::Error)]
#[error(transparent)]
struct BadConfiguration(Box<dyn std::error::Error + Send + Sync>);

/// Arguments that are wrong or contradict each other.
#[derive(Debug, thiserror::Error)]
#[error(transparent)]
struct WrongUsage(Box<dyn std::error::Error + Send + Sync>);

/// The error of a call with such arguments.
fn wrong_usage(cause: impl Into<Box<dyn std::error::Error + Send + Sync>>) -> anyhow::Error {
    WrongUsage(cause.into()).into()
}

/// Whether no process listens on the daemon's socket. If this user may not open the socket, it counts as listening.
fn is_away(error: &anyhow::Error) -> bool {
    let denied = std::io::ErrorKind::PermissionDenied;
    matches!(error.downcast_ref(), Some(trigger::Error::Away { cause, .. }) if cause.kind() != denied)
}

/// The exit code of an error.
pub fn exit_code(error: &anyhow::Error) -> ExitCode {
    if error.is::<BadConfiguration>() {
        ExitCode::from(EXIT_CONFIGURATION)
    } else if error.is::<WrongUsage>() {
        ExitCode::from(EXIT_USAGE)
    } else if is_away(error) {
        ExitCode::from(EXIT_AWAY)
    } else {
        ExitCode::FAILURE
    }
}

/// What `--version` prints: the version, and the commit and the features of this build (`build.rs`).
const VERSION: &str = concat!(
    env!("CARGO_PKG_VERSION"),
    " (commit ",
    env!("SCAND_COMMIT"),
    "; features: ",
    env!("SCAND_FEATURES"),
    ")"
);

/// The help of the program: its commands in groups. A test holds that each command has its place.
const HELP: &str = "\
{about}

Usage: {usage}

Reconstruct:
  replay      Reconstruct every capture of recordings
  fuse        Make one model of several captures of an object
  demo        Reconstruct a simulated cup, to see what comes out
  simulate    Render a rig around an object of known shape into a recording

Run a rig:
  check       Look for problems before work
  run         Run the rig: open the cameras, take captures, make models
  trigger     Take a capture and wait until it is on the disk
  background  Take background pictures of the empty rig
  session     Start, annotate or complete a session
  note        Accept or reject a capture, take that back, or note something about it
  status      Show cameras, captures and disk
  events      Show what happens
  pedal       Turn the keys of a foot switch into presses
  page        Serve the operator's page, and let people in

Use many machines:
  fleet       Offer a rig's captures to workers, and look at what happens
  worker      Make models for the rigs of a fleet

Calibrate:
  board       Make a calibration board to print
  calibrate   Calibrate a rig, or check its calibration

Look and measure:
  info        List what recordings have: captures, cameras, notes, damage
  evaluate    Measure how far a model is from the truth
  diff        Compare two models

Hand on:
  export      Write models and captures in the formats of other programs
  publish     Make a folder for a web server: a gallery, and a page for each object

Keep and repair:
  recover     Complete recordings that were interrupted
  pack        Compress complete recordings without loss
  archive     Make a package for an archive
  verify      Check a package for an archive

Options (those of replay serve without a command after --replay):
  -h, --help     Print help; scand COMMAND --help has options and examples
  -V, --version  Print version, commit and features

Examples:
  scand replay recordings/cup.mcap
  scand info --json cup.mcap
  scand trigger --subject 1884.3 --until done
";

/// Scan objects with colour cameras and a depth camera.
#[derive(Debug, Parser)]
#[command(
    version = VERSION,
    about,
    long_about = None,
    args_conflicts_with_subcommands = true,
    arg_required_else_help = true,
    override_usage = "scand <COMMAND> [OPTIONS]\n       scand --replay <FILE|FOLDER>... [OPTIONS]",
    help_template = HELP,
)]
pub struct Cli {
    #[command(flatten)]
    replay: replay::Args,
    #[command(subcommand)]
    command: Option<Command>,
}

#[derive(Debug, Subcommand)]
enum Command {
    Archive(Box<archive::Args>),
    Background(live::client::BackgroundArgs),
    Board(board::Args),
    Calibrate(Box<calibrate::Args>),
    #[cfg(feature = "live")]
    Check(live::check::Args),
    #[cfg(not(feature = "live"))]
    #[command(hide = true)]
    Check(absent::Args),
    Demo(demo::Args),
    Diff(diff::Args),
    Evaluate(evaluate::Args),
    Events(live::client::EventsArgs),
    Export(Box<export::Args>),
    #[cfg(feature = "fleet")]
    Fleet(Box<fleet::Args>),
    #[cfg(not(feature = "fleet"))]
    #[command(hide = true)]
    Fleet(absent::Args),
    #[cfg(feature = "fleet")]
    #[command(hide = true, name = crate::fleet::step::COMMAND)]
    FleetStep(Box<fleet_step::Args>),
    Fuse(Box<fuse::Args>),
    #[command(hide = true)]
    Generate(generate::Args),
    Info(info::Args),
    #[cfg(feature = "live")]
    #[command(hide = true, name = crate::daemon::look::protocol::COMMAND)]
    MakeLook(make_look::Args),
    #[cfg(feature = "live")]
    #[command(hide = true, name = crate::workers::protocol::COMMAND)]
    MakeModel(Box<make_model::Args>),
    #[cfg(feature = "live")]
    #[command(hide = true, name = crate::workers::object_protocol::COMMAND)]
    MakeObject(Box<make_object::Args>),
    #[cfg(feature = "page")]
    #[command(hide = true, name = crate::page::make_view::COMMAND)]
    MakeView(make_view::Args),
    Note(live::client::NoteArgs),
    Pack(pack::Args),
    #[cfg(feature = "page")]
    Page(page::Args),
    #[cfg(not(feature = "page"))]
    #[command(hide = true)]
    Page(absent::Args),
    #[cfg(feature = "pedal")]
    Pedal(live::pedal::Args),
    #[cfg(not(feature = "pedal"))]
    #[command(hide = true)]
    Pedal(absent::Args),
    Publish(Box<publish::Args>),
    Recover(recover::Args),
    Replay(Box<replay::CommandArgs>),
    #[cfg(feature = "live")]
    Run(live::run::Args),
    #[cfg(not(feature = "live"))]
    #[command(hide = true)]
    Run(absent::Args),
    Session(live::client::SessionArgs),
    #[cfg(feature = "lab")]
    Simulate(Box<simulate::Args>),
    #[cfg(not(feature = "lab"))]
    /// Render a rig of cameras around a known object into a recording. This build has no simulator; a build from the
    /// source has it.
    Simulate(absent::Args),
    Status(live::client::StatusArgs),
    Trigger(live::client::TriggerArgs),
    Verify(verify::Args),
    #[cfg(feature = "fleet")]
    Worker(Box<fleet::worker::Args>),
    #[cfg(not(feature = "fleet"))]
    #[command(hide = true)]
    Worker(absent::Args),
}

/// Runs what was asked.
///
/// # Errors
/// What went wrong, in words for the terminal; [`exit_code`] has its exit code.
pub fn run(cli: Cli) -> anyhow::Result<ExitCode> {
    match cli.command {
        Some(Command::Archive(args)) => archive::run(*args),
        Some(Command::Background(args)) => live::client::background(args),
        Some(Command::Board(args)) => board::run(args),
        Some(Command::Calibrate(args)) => calibrate::run(*args),
        #[cfg(feature = "live")]
        Some(Command::Check(args)) => live::check::run(args),
        #[cfg(not(feature = "live"))]
        Some(Command::Check(_)) => absent::without_cameras("check"),
        Some(Command::Demo(args)) => demo::run(args),
        Some(Command::Diff(args)) => diff::run(args),
        Some(Command::Evaluate(args)) => evaluate::run(args),
        Some(Command::Events(args)) => live::client::events(args),
        Some(Command::Export(args)) => export::run(*args),
        #[cfg(feature = "fleet")]
        Some(Command::Fleet(args)) => fleet::run(*args),
        #[cfg(not(feature = "fleet"))]
        Some(Command::Fleet(_)) => absent::without_fleet("fleet"),
        #[cfg(feature = "fleet")]
        Some(Command::FleetStep(args)) => fleet_step::run(*args),
        Some(Command::Fuse(args)) => fuse::run(*args),
        Some(Command::Generate(args)) => generate::run(args),
        Some(Command::Info(args)) => info::run(args),
        #[cfg(feature = "live")]
        Some(Command::MakeLook(args)) => make_look::run(args),
        #[cfg(feature = "live")]
        Some(Command::MakeModel(args)) => make_model::run(*args),
        #[cfg(feature = "live")]
        Some(Command::MakeObject(args)) => make_object::run(*args),
        #[cfg(feature = "page")]
        Some(Command::MakeView(args)) => make_view::run(args),
        Some(Command::Note(args)) => live::client::note(args),
        Some(Command::Pack(args)) => pack::run(args),
        #[cfg(feature = "page")]
        Some(Command::Page(args)) => page::run(args),
        #[cfg(not(feature = "page"))]
        Some(Command::Page(_)) => absent::without_page(),
        #[cfg(feature = "pedal")]
        Some(Command::Pedal(args)) => live::pedal::run(args),
        #[cfg(not(feature = "pedal"))]
        Some(Command::Pedal(_)) => absent::without_cameras("pedal"),
        Some(Command::Publish(args)) => publish::run(*args),
        Some(Command::Recover(args)) => recover::run(args),
        Some(Command::Replay(args)) => replay::run_interactive((*args).into()),
        #[cfg(feature = "live")]
        Some(Command::Run(args)) => live::run::run(args),
        #[cfg(not(feature = "live"))]
        Some(Command::Run(_)) => absent::without_cameras("run"),
        Some(Command::Session(args)) => live::client::session(args),
        #[cfg(feature = "lab")]
        Some(Command::Simulate(args)) => simulate::run(*args),
        #[cfg(not(feature = "lab"))]
        Some(Command::Simulate(_)) => absent::without_simulator(),
        Some(Command::Status(args)) => live::client::status(args),
        Some(Command::Trigger(args)) => live::client::trigger(args),
        Some(Command::Verify(args)) => verify::run(args),
        #[cfg(feature = "fleet")]
        Some(Command::Worker(args)) => fleet::worker::run(*args),
        #[cfg(not(feature = "fleet"))]
        Some(Command::Worker(_)) => absent::without_fleet("worker"),
        None => replay::run_interactive(cli.replay),
    }
}

#[cfg(test)]
mod tests;
