//! Finds the program as it was built for the tests.

use std::process::Command;

/// A call of `scand`, to be given its arguments.
pub fn scand() -> Command {
    Command::new(env!("CARGO_BIN_EXE_scand"))
}
