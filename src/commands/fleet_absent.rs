//! `scand fleet` and `scand worker` in a build without the feature `fleet`: both refuse, and say which build has them.

use crate::commands::wrong_usage;
use std::process::ExitCode;

/// Accepts any arguments: the command is refused with all of them.
#[derive(Debug, clap::Args)]
#[command(disable_help_flag = true)]
pub struct Args {
    #[arg(hide = true, trailing_var_arg = true, allow_hyphen_values = true)]
    _asked: Vec<std::ffi::OsString>,
}

/// Refuses the command.
///
/// # Errors
/// Always: wrong usage, with the place where the command is.
pub fn run(command: &str) -> anyhow::Result<ExitCode> {
    Err(wrong_usage(format!(
        "this build of scand has no `scand {command}`: install the Debian package that `make deb` makes (docs/installing.md), or build \
         with `cargo build --release --features fleet`"
    )))
}
