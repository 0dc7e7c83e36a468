//! `scand work`, which only the daemon calls: `scand --replay` of one capture, in a process that may do nothing else.

use super::replay;
use crate::workers::{Limits, confine, part_from};
use std::process::ExitCode;

/// Make a model of a capture, confined. For the daemon.
#[derive(Debug, clap::Args)]
#[group(id = "work")]
pub struct Args {
    /// The process that started this one, which ends with it.
    #[arg(long, value_name = "PID")]
    parent: u32,
    /// Memory that may be taken, in megabytes.
    #[arg(long, value_name = "N")]
    memory_mb: u32,
    /// How much others come first, 0 to 19.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=19))]
    nice: u32,
    #[command(flatten)]
    replay: replay::Args,
}

/// Confines this process, and replays.
///
/// # Errors
/// If it cannot be confined; else those of a replay.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    part_from(args.parent)?;
    let writes = args.replay.writes()?;
    for folder in &writes {
        std::fs::create_dir_all(folder)?;
    }
    let limits = Limits {
        memory_mb: args.memory_mb,
        nice: args.nice,
    };
    for missing in confine(limits, &args.replay.reads(), &writes)? {
        eprintln!("scand: warning: {missing}");
    }
    replay::run(args.replay)
}
