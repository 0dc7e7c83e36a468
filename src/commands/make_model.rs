//! `scand make-model`, which only the daemon calls: it does what `scand --replay` does for one capture, in a
//! confined process.

use super::confined::ConfinementArgs;
use super::replay;
use std::path::PathBuf;
use std::process::ExitCode;

/// Make a model of a capture in a confined process. Only the daemon calls this.
#[derive(Debug, clap::Args)]
#[group(id = "make_model")]
pub struct Args {
    #[command(flatten)]
    confinement: ConfinementArgs,
    #[command(flatten)]
    replay: replay::Args,
}

impl Args {
    /// Confines this process to what the replay needs and to folders in which it may write, too. Returns what is to be
    /// replayed.
    ///
    /// # Errors
    /// If the process cannot be confined.
    pub(super) fn confined(self, more: &[PathBuf]) -> anyhow::Result<replay::Args> {
        self.confinement.bind_to_parent()?;
        let mut writes = self.replay.writes()?;
        for folder in &writes {
            std::fs::create_dir_all(folder)?;
        }
        writes.extend_from_slice(more);
        self.confinement.confine(&self.replay.reads(), &writes)?;
        Ok(self.replay)
    }

    /// What is replayed.
    #[cfg(feature = "fleet")]
    pub(super) fn replay(&self) -> &replay::Args {
        &self.replay
    }
}

/// Confines this process, and replays.
///
/// # Errors
/// If it cannot be confined; else those of a replay.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    replay::run(args.confined(&[])?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::workers::protocol;
    use clap::Parser;
    use std::path::Path;

    #[derive(Parser)]
    struct Cli {
        #[command(flatten)]
        args: Args,
    }

    #[test]
    fn what_the_daemon_asks_for_is_what_this_command_understands() {
        let request = protocol::ModelRequest {
            confinement: protocol::Confinement {
                memory_mb: 640,
                nice: 19,
            },
            recording: Path::new("sessions/-a.mcap"),
            capture: "a-0001",
            models: Path::new("models"),
            config: Path::new("jobs/settings.toml"),
        };
        let words = std::iter::once(protocol::COMMAND.into()).chain(request.arguments());
        let Args {
            confinement,
            replay,
        } = Cli::parse_from(words).args;
        assert_eq!(confinement.numbers(), [std::process::id(), 640, 19]);
        let reads = ["sessions/-a.mcap", "jobs/settings.toml"].map(PathBuf::from);
        assert_eq!(replay.reads(), reads);
        assert_eq!(replay.writes().unwrap(), [PathBuf::from("models/-a")]);
    }
}
