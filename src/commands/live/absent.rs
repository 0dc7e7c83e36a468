//! `scand run`, `check` and `pedal` in a build without cameras: each names the package or feature that contains the
//! command.

use crate::commands::wrong_usage;
use std::process::ExitCode;

/// Accepts any arguments: the command is refused with all of them.
#[derive(Debug, clap::Args)]
#[command(disable_help_flag = true)]
pub struct Args {
    #[arg(hide = true, trailing_var_arg = true, allow_hyphen_values = true)]
    _asked: Vec<std::ffi::OsString>,
}

/// Refuses the command of this name.
///
/// # Errors
/// Always: wrong usage, with the place where the command is.
pub fn run(name: &str) -> anyhow::Result<ExitCode> {
    Err(wrong_usage(format!(
        "this build of scand has no cameras, and so no `scand {name}`: install the Debian package that `make deb` makes \
         (docs/installing.md), or build with `cargo build --release --features rig`"
    )))
}
