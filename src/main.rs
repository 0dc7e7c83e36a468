//! Passes the arguments to the library and exits with the code that it returns. Everything else lives in the library.

#![warn(clippy::unwrap_used)]

use scand::commands::{check_output, exit_code, parse, run};
use std::process::ExitCode;

fn main() -> ExitCode {
    let code = run(parse()).unwrap_or_else(|error| {
        eprintln!("scand: {error:#}");
        exit_code(&error)
    });
    check_output(code)
}
