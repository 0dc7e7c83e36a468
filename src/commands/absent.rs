//! Commands that this build does not contain. Each refuses, and names the package or feature that contains it.

use super::wrong_usage;
use std::process::ExitCode;

/// Accepts any arguments: the command is refused with all of them.
#[derive(Debug, clap::Args)]
#[command(disable_help_flag = true)]
pub struct Args {
    /// The arguments of the command that is not here.
    #[arg(hide = true, trailing_var_arg = true, allow_hyphen_values = true)]
    _asked: Vec<std::ffi::OsString>,
}

const PACKAGE: &str = "install the Debian package that `make deb` makes (docs/installing.md), or";

/// Refuses `scand run`, `check` or `pedal`.
///
/// # Errors
/// Always: wrong usage, with the place where the command is.
pub fn without_cameras(command: &str) -> anyhow::Result<ExitCode> {
    Err(wrong_usage(format!(
        "this build of scand has no cameras, and so no `scand {command}`: {PACKAGE} build with `cargo build --release \
         --features rig`"
    )))
}

/// Refuses `scand fleet` or `worker`.
///
/// # Errors
/// As [`without_cameras`].
pub fn without_fleet(command: &str) -> anyhow::Result<ExitCode> {
    Err(wrong_usage(format!(
        "this build of scand has no `scand {command}`: {PACKAGE} build with `cargo build --release --features fleet`"
    )))
}

/// Refuses `scand page`.
///
/// # Errors
/// As [`without_cameras`].
pub fn without_page() -> anyhow::Result<ExitCode> {
    Err(wrong_usage(format!(
        "this build of scand has no page: {PACKAGE} run `make ui` and build with `cargo build --release --features \
         page`"
    )))
}

/// Refuses `scand simulate`, which an installed rig does not need.
///
/// # Errors
/// As [`without_cameras`].
pub fn without_simulator() -> anyhow::Result<ExitCode> {
    Err(wrong_usage(
        "this build of scand has no simulator, which an installed rig does not need: build scand from its source with \
         `cargo build --release` (feature `lab`, on by default) and run `target/release/scand simulate`",
    ))
}

#[cfg(all(test, not(feature = "lab")))]
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
