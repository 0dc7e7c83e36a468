//! The protocol between the daemon and a process that fuses an object's captures: the command with its options, and the
//! line on standard error by which it tells what it found. `scand make-object` is the other end.

use super::protocol::Confinement;
use crate::level::Level;
use std::ffi::OsString;
use std::path::{Path, PathBuf};

/// The command that registers an object's captures, or makes their model.
pub const COMMAND: &str = "make-object";
/// Its option for finding poses alone.
pub const REGISTER: &str = "register";

/// What a line on standard error begins with that has a [`CapturesFound`].
const FOUND: &str = "scand: found: ";

/// Whether a recording that a process was given has another name by now: then the process fails, and is started again
/// with that name. A link that leads nowhere has its name still.
pub fn is_gone(recording: &Path) -> bool {
    let found = recording.symlink_metadata();
    found.is_err_and(|error| error.kind() == std::io::ErrorKind::NotFound)
}

/// What a process is asked for.
#[derive(Clone, Copy, Debug)]
pub struct ObjectModelRequest<'a> {
    /// What confines the process.
    pub confinement: Confinement,
    /// The recordings of the session.
    pub recordings: &'a [PathBuf],
    /// The object's number.
    pub subject: &'a str,
    /// The newest of its captures.
    pub newest: &'a str,
    /// Whether poses are to be found alone, and no model made.
    pub registers: bool,
    /// Where models go: a folder for each recording.
    pub models: &'a Path,
    /// The configuration of the reconstruction, a TOML file.
    pub config: &'a Path,
}

impl ObjectModelRequest<'_> {
    /// The arguments that follow [`COMMAND`].
    pub fn arguments(&self) -> Vec<OsString> {
        let option = |name: &str| OsString::from(format!("--{name}"));
        let with = |name: &str, value: &str| {
            // In one word, so that a value may begin with a hyphen.
            OsString::from(format!("--{name}={value}"))
        };
        let mut arguments = Vec::from(self.confinement.arguments());
        arguments.extend([
            with("subject", self.subject),
            with("newest", self.newest),
            option("out"),
            self.models.into(),
            option("config"),
            self.config.into(),
        ]);
        for recording in self.recordings {
            arguments.extend([option("recording"), recording.into()]);
        }
        arguments.extend(self.registers.then(|| option(REGISTER)));
        arguments
    }
}

/// What was found of an object's captures.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct CapturesFound {
    /// Captures that count: complete ones that nobody rejected.
    pub captures: usize,
    /// Whether the object has a folder from before.
    pub has_folder: bool,
    /// Of two captures or more, how they lie.
    pub poses: Option<PosesFound>,
}

/// How an object's captures lie against each other.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct PosesFound {
    /// How clear the evidence for the newest capture's pose is; red where it has none.
    pub verdict: Level,
    /// How that pose was found; `None` without a pose.
    pub held_by: Option<String>,
    /// The same in words.
    pub words: String,
    /// Captures without a pose, by name and with the reason.
    pub left_out: Vec<String>,
    /// Percent of the surface that no camera of any capture with a pose faced.
    pub unseen_percent: u32,
    /// Which side to show next; `None` where nothing is left to show.
    pub show_next: Option<String>,
}

impl PosesFound {
    /// Nothing, and why.
    pub fn failed(reason: &str) -> Self {
        Self {
            verdict: Level::Red,
            held_by: None,
            words: format!("no poses were found: {reason}"),
            left_out: Vec::new(),
            unseen_percent: 0,
            show_next: None,
        }
    }
}

impl CapturesFound {
    /// Tells the daemon.
    pub fn print(&self) {
        eprintln!("{FOUND}{}", serde_json::to_string(self).unwrap_or_default());
    }

    /// What a process told with these words.
    pub fn parse(words: &str) -> Option<Self> {
        let line = words.lines().rev().find_map(|l| l.strip_prefix(FOUND))?;
        serde_json::from_str(line).ok()
    }

    /// What else it said.
    pub fn others(words: &str) -> String {
        let others = words.lines().filter(|line| !line.starts_with(FOUND));
        others.map(|line| format!("{line}\n")).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_found_is_one_line_among_others() {
        let words = "scand: warning: no Landlock\nscand: found: {\"captures\":1,\"has_folder\":false,\
                     \"poses\":null}\nscand: it ends\n";
        let found = CapturesFound {
            captures: 1,
            has_folder: false,
            poses: None,
        };
        assert_eq!(CapturesFound::parse(words), Some(found));
        let others = CapturesFound::others(words);
        assert_eq!(others, "scand: warning: no Landlock\nscand: it ends\n");
        assert_eq!(CapturesFound::parse("scand: found: {\n"), None);
        assert_eq!(CapturesFound::parse(""), None);
    }
}
