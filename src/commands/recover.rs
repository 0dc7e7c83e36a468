//! `scand recover`: completes recordings that a crash or a power cut left unfinished.

use super::EXIT_INCOMPLETE;
use crate::recording::{
    Error, Recovered, beside, finished_name, interrupted, may_be_being_written, recover,
    recover_copy, unfinished,
};
use crate::words::count;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Complete recordings that were interrupted (NAME.mcap.part becomes NAME.mcap). Bytes that cannot be read are kept
/// in NAME.mcap.tail.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  scand recover /var/lib/scand/recordings
  scand recover copy-that-was-cut-off.mcap")]
pub struct Args {
    /// Interrupted recordings, copies that were cut off (NAME.mcap, of which NAME.recovered.mcap is made), or folders
    /// with interrupted recordings.
    #[arg(required = true, value_name = "FILE|FOLDER")]
    paths: Vec<PathBuf>,
}

/// Recovers all recordings that are named, and continues after a failure.
///
/// # Errors
/// If a folder cannot be read. A recording that cannot be recovered is reported here and stays as it is.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    let mut parts = Vec::new();
    for path in args.paths {
        if path.is_dir() {
            parts.extend(unfinished(&path)?);
        } else {
            parts.push(path);
        }
    }
    let (mut failed, mut lost) = (false, false);
    for part in &parts {
        let is_cut_copy = part.extension().is_some_and(|ending| ending == "mcap");
        let recovered = if is_cut_copy {
            recover_copy(part)
        } else {
            complete(part)
        };
        match recovered {
            Ok(recovered) => {
                lost |= recovered.tail.is_some();
                outln!("{}", words(&recovered));
                let notes = beside(&recovered.path);
                if is_cut_copy && notes.is_file() {
                    outln!("{}: a copy of the notes", notes.display());
                }
            }
            Err(error) => {
                failed = true;
                eprintln!("scand: {error}; {} was left unchanged", part.display());
            }
        }
    }
    if parts.is_empty() {
        outln!("there is no recording to recover");
    }
    Ok(match (failed, lost) {
        (true, _) => ExitCode::FAILURE,
        (_, true) => ExitCode::from(EXIT_INCOMPLETE),
        _ => ExitCode::SUCCESS,
    })
}

/// Completes a recording. Its daemon will still know that it was open.
fn complete(part: &Path) -> Result<Recovered, Error> {
    if let (Some(folder), Some(complete)) = (part.parent(), finished_name(part)) {
        let entered = interrupted::enter(folder, &[complete]);
        entered.map_err(|cause| Error::Io {
            path: part.into(),
            cause: std::io::Error::other(cause),
        })?;
    }
    if may_be_being_written(part) {
        return Err(Error::BeingWritten { path: part.into() });
    }
    recover(part)
}

fn words(recovered: &Recovered) -> String {
    let Recovered {
        path,
        messages,
        tail,
    } = recovered;
    let kept = tail.as_ref().map(|(tail, length)| {
        format!(
            "; {length} bytes could not be read and are in {}",
            tail.display()
        )
    });
    let kept = kept.unwrap_or_default();
    let messages = count(*messages as usize, "message");
    format!("{}: recovered, {messages}{kept}", path.display())
}
