//! `scand page` in a build without the feature `page`: it refuses, and says which build has the page.

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
pub fn run() -> anyhow::Result<ExitCode> {
    Err(wrong_usage(
        "this build of scand has no page: install the Debian package that `make deb` makes (docs/installing.md), or \
         run `make ui` and build with `cargo build --release --features page`",
    ))
}
