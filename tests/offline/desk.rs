//! A folder in which a person works with the command line: a small recording lies in it, and commands run there.

use assert_cmd::Command;
use std::path::PathBuf;
use std::process::Output;

pub struct Desk(tempfile::TempDir);

impl Desk {
    /// A folder with `ball.mcap`, a recording of two captures.
    pub fn new() -> Self {
        let desk = Self(tempfile::tempdir().unwrap());
        #[rustfmt::skip]
        desk.done(&[
            "simulate", "--shape", "ball", "--cameras", "5", "--size", "160x120", "--masks", "--depth-cameras", "0",
            "--captures", "2", "--out", "ball.mcap",
        ]);
        desk
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    pub fn run(&self, arguments: &[&str]) -> Output {
        let mut command = Command::cargo_bin("scand").unwrap();
        command
            .current_dir(self.0.path())
            .args(arguments)
            .output()
            .unwrap()
    }

    /// Runs a command that must succeed; gives what it says.
    pub fn done(&self, arguments: &[&str]) -> String {
        let output = self.run(arguments);
        assert!(output.status.success(), "{arguments:?}: {output:?}");
        said(&output)
    }
}

/// What a command printed, on standard output and on standard error.
pub fn said(output: &Output) -> String {
    [&output.stdout, &output.stderr]
        .map(|bytes| String::from_utf8_lossy(bytes))
        .concat()
}
