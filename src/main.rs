//! The thin binary: arguments in, exit code out. Everything else lives in the library.

#![warn(clippy::unwrap_used)]

use clap::Parser;
use scand::commands::{Cli, exit_code, run};
use std::process::ExitCode;

fn main() -> ExitCode {
    match run(Cli::parse()) {
        Ok(code) => code,
        Err(error) => {
            eprintln!("scand: {error:#}");
            exit_code(&error)
        }
    }
}
