//! The protocol between the daemon and a worker process: the command and its options, the lines on standard error, and
//! the exit codes. `scand make-model` is the other end. Nothing here starts a process.

use std::ffi::OsString;
use std::path::Path;

/// The command that makes one model.
pub const COMMAND: &str = "make-model";
/// Its option for the id of the process that started it.
pub const PARENT: &str = "parent";
/// Its option for the memory that it may take, in megabytes.
pub const MEMORY_MB: &str = "memory-mb";
/// Its option for its nice value.
pub const NICE: &str = "nice";

/// Exit code of a run that did what was asked but lost something on the way: damage in a recording, or some captures
/// that failed.
pub const EXIT_INCOMPLETE: u8 = 3;

/// What a line on standard error begins with.
const LINE: &str = "scand: ";
/// What a line begins with that says what the system cannot do for the process.
const WARNING: &str = "scand: warning: ";

/// What confines a process that this one starts, whatever it is asked for.
#[derive(Clone, Copy, Debug)]
pub struct Confinement {
    /// Memory that may be taken, in megabytes.
    pub memory_mb: u32,
    /// Nice value, 0 to 19.
    pub nice: u32,
}

impl Confinement {
    /// The arguments of a process that ends with this one.
    pub fn arguments(&self) -> [OsString; 3] {
        [
            (PARENT, std::process::id()),
            (MEMORY_MB, self.memory_mb),
            (NICE, self.nice),
        ]
        .map(|(name, value)| format!("--{name}={value}").into())
    }
}

/// One model that a process is asked for.
#[derive(Clone, Copy, Debug)]
pub struct ModelRequest<'a> {
    /// What confines the process.
    pub confinement: Confinement,
    /// The recording.
    pub recording: &'a Path,
    /// The capture in it.
    pub capture: &'a str,
    /// Where models go: a folder for each recording, and in it one for each capture.
    pub models: &'a Path,
    /// The configuration of the reconstruction, a TOML file.
    pub config: &'a Path,
}

impl ModelRequest<'_> {
    /// The arguments that follow [`COMMAND`].
    pub fn arguments(&self) -> Vec<OsString> {
        let option = |name: &str| OsString::from(format!("--{name}"));
        let mut arguments = Vec::from(self.confinement.arguments());
        arguments.extend([
            option("replay"),
            self.recording.into(),
            option("capture"),
            self.capture.into(),
            option("out"),
            self.models.into(),
            option("config"),
            self.config.into(),
            option("quiet"),
        ]);
        arguments
    }
}

/// Tells the daemon what the system cannot do for this process.
pub fn warn(missing: &str) {
    eprintln!("{WARNING}{missing}");
}

/// Whether a process with this exit code left a model. Its recording may be damaged elsewhere.
pub fn leaves_a_model(code: Option<i32>) -> bool {
    code == Some(0) || code == Some(i32::from(EXIT_INCOMPLETE))
}

/// What the system could not do for the process that said these words.
pub fn warnings(words: &str) -> impl Iterator<Item = &str> {
    words.lines().filter_map(|line| line.strip_prefix(WARNING))
}

/// What a process said of why it failed, without warnings, empty lines and the backtrace of a panic.
pub fn complaints(words: &str) -> impl Iterator<Item = &str> {
    words
        .lines()
        .filter(|line| !line.starts_with(WARNING))
        .take_while(|line| *line != "stack backtrace:")
        .map(|line| line.strip_prefix(LINE).unwrap_or(line))
        .filter(|line| !line.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn warnings_are_told_apart_from_complaints() {
        let words = "scand: warning: no Landlock\nscand: a.mcap: it is damaged\n\nthread panicked\n\
                     stack backtrace:\n  0: main\n";
        assert_eq!(warnings(words).collect::<Vec<_>>(), ["no Landlock"]);
        let complaints: Vec<&str> = complaints(words).collect();
        assert_eq!(complaints, ["a.mcap: it is damaged", "thread panicked"]);
    }
}
