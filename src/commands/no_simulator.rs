//! `scand simulate` in a build without the feature `lab`, such as that of an installed rig: it refuses, and says which
//! build has the simulator.

use super::wrong_usage;
use std::process::ExitCode;

/// Render a rig of cameras around a known object into a recording. This build has no simulator; a build from the
/// source has it.
#[derive(Debug, clap::Args)]
#[command(disable_help_flag = true)]
pub struct Args {
    /// The arguments for the simulator.
    #[arg(hide = true, trailing_var_arg = true, allow_hyphen_values = true)]
    _asked: Vec<std::ffi::OsString>,
}

/// Refuses.
///
/// # Errors
/// Always: wrong usage, with the place where the simulator is.
pub fn run() -> anyhow::Result<ExitCode> {
    Err(wrong_usage(
        "this build of scand has no simulator, which an installed rig does not need: build scand from its source with \
         `cargo build --release` (feature `lab`, on by default) and run `target/release/scand simulate`",
    ))
}

#[cfg(test)]
mod tests {
    use crate::commands::{Cli, run};
    use clap::Parser;

    #[test]
    fn whatever_it_is_asked_it_says_where_the_simulator_is() {
        for asked in [&[][..], &["--help"], &["--shape", "cup", "--out", "a.mcap"]] {
            let line = ["scand", "simulate"].iter().chain(asked);
            let error = run(Cli::try_parse_from(line).unwrap()).unwrap_err();
            let words = error.to_string();
            assert!(
                words.contains("no simulator") && words.contains("`lab`"),
                "{words}"
            );
        }
    }
}
