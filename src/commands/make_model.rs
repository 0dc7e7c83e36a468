//! `scand make-model`, which only the daemon calls: it does what `scand --replay` does for one capture, in a
//! confined process.

use super::replay;
use crate::workers::{Limits, confine, part_from, protocol};
use std::process::ExitCode;

/// Make a model of a capture in a confined process. Only the daemon calls this.
#[derive(Debug, clap::Args)]
#[group(id = "make_model")]
pub struct Args {
    /// The process that started this one. When it ends, this one ends too.
    #[arg(long = protocol::PARENT, value_name = "PID")]
    parent: u32,
    /// Largest memory, in megabytes.
    #[arg(long = protocol::MEMORY_MB, value_name = "N")]
    memory_mb: u32,
    /// Niceness, 0 to 19.
    #[arg(long = protocol::NICE, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=19))]
    nice: u32,
    #[command(flatten)]
    replay: replay::Args,
}

#[cfg(feature = "fleet")]
impl Args {
    /// What is replayed.
    pub(super) fn replay(&self) -> &replay::Args {
        &self.replay
    }
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
        protocol::warn(&missing);
    }
    replay::run(args.replay)
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;
    use std::path::{Path, PathBuf};

    #[derive(Parser)]
    struct Cli {
        #[command(flatten)]
        args: Args,
    }

    #[test]
    fn what_the_daemon_asks_for_is_what_this_command_understands() {
        let request = protocol::ModelRequest {
            parent: 7,
            memory_mb: 640,
            nice: 19,
            recording: Path::new("sessions/-a.mcap"),
            capture: "a-0001",
            models: Path::new("models"),
            config: Path::new("jobs/settings.toml"),
        };
        let words = std::iter::once(protocol::COMMAND.into()).chain(request.arguments());
        let Args {
            parent,
            memory_mb,
            nice,
            replay,
        } = Cli::parse_from(words).args;
        assert_eq!([parent, memory_mb, nice], [7, 640, 19]);
        let reads = ["sessions/-a.mcap", "jobs/settings.toml"].map(PathBuf::from);
        assert_eq!(replay.reads(), reads);
        assert_eq!(replay.writes().unwrap(), [PathBuf::from("models/-a")]);
    }
}
