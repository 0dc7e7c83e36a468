//! The options of commands that only other processes of scand call, by which they confine themselves before they read
//! anything.

use crate::process::{ConfineError, Limits, bind_to_parent, confine};
use crate::workers::protocol;
use std::path::PathBuf;

/// What confines a process, as [`protocol::Confinement`] writes it.
#[cfg(feature = "live")]
#[derive(Debug, clap::Args)]
pub(super) struct ConfinementArgs {
    /// The process that started this one. When it ends, this one ends too.
    #[arg(long = protocol::PARENT, value_name = "PID")]
    parent: u32,
    /// Largest memory, in megabytes.
    #[arg(long = protocol::MEMORY_MB, value_name = "N")]
    memory_mb: u32,
    /// Niceness, 0 to 19.
    #[arg(long = protocol::NICE, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=19))]
    nice: u32,
}

/// Confines a process that only turns its input into its output: it can open no file, and ends with its parent.
pub(super) fn confine_filter(parent: u32, limits: Limits) -> Result<(), ConfineError> {
    bind_to_parent(parent)?;
    confine_by(limits, &[], &[])
}

/// As [`confine`]; tells the process that started this one what the system cannot do.
fn confine_by(limits: Limits, reads: &[PathBuf], writes: &[PathBuf]) -> Result<(), ConfineError> {
    for missing in confine(limits, reads, writes)? {
        protocol::warn(&missing);
    }
    Ok(())
}

#[cfg(feature = "live")]
impl ConfinementArgs {
    /// As [`bind_to_parent`], with the process that started this one.
    pub(super) fn bind_to_parent(&self) -> Result<(), ConfineError> {
        bind_to_parent(self.parent)
    }

    /// Confines this process to these files and the limits that it was given.
    pub(super) fn confine(
        &self,
        reads: &[PathBuf],
        writes: &[PathBuf],
    ) -> Result<(), ConfineError> {
        let limits = Limits {
            memory_mb: self.memory_mb,
            nice: self.nice,
        };
        confine_by(limits, reads, writes)
    }

    /// The parent's id, memory in megabytes, and niceness.
    #[cfg(test)]
    pub(super) fn numbers(&self) -> [u32; 3] {
        [self.parent, self.memory_mb, self.nice]
    }
}
