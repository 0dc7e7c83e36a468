//! `scand --replay`: recordings in, models out.

use std::path::PathBuf;
use std::process::ExitCode;

/// What `--replay` is asked.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Recordings to reconstruct
    #[arg(long, num_args = 1.., required = true, value_name = "FILE")]
    replay: Vec<PathBuf>,
}

/// Reconstructs every capture of the recordings.
///
/// # Errors
/// If a recording cannot be read or nothing could be made of it.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    anyhow::bail!("cannot replay {:?} yet", args.replay)
}
