//! Passes the arguments to the library and exits with the code that it returns. Everything else lives in the library.

#![warn(clippy::unwrap_used)]

use scand::commands::{exit_code, parse, run};
use std::process::ExitCode;

fn main() -> ExitCode {
    match run(parse()) {
        Ok(code) => code,
        Err(error) => {
            eprintln!("scand: {error:#}");
            exit_code(&error)
        }
    }
}
