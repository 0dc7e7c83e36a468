//! The confined steps of a job, each a child process: the arguments with which it is started, how it ends, and the
//! lines in which it says what it made. `scand fleet-step` is the other end. The child inherits neither the connection
//! nor the credentials.

use crate::clock::Clock;
use crate::log;
use crate::process::{Cancel, Child, ChildExit};
use crate::workers::protocol::{self, Confinement};
use parking_lot::Mutex;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::ffi::OsString;
use std::path::Path;
use std::process::Command;
use std::time::Duration;

/// The command of all steps.
pub const COMMAND: &str = "fleet-step";
/// Exit code of a commit where the same result was in place.
pub const EXIT_EQUAL: u8 = 10;
/// Exit code of a commit where another result was in place.
pub const EXIT_DIFFERS: u8 = 11;
/// Exit code of a commit that refused the result, and of a step that refused its recording.
pub const EXIT_REFUSED: u8 = 12;
/// What a capture's own recording is called beside its result.
pub const PACKED: &str = "packed.json";
/// The file in which a child names the recording that it found; empty if there is none.
pub const FOUND: &str = "found.txt";
/// The step that lists a recording's captures.
pub const LIST: &str = "list";
/// The step that replays a recording here.
pub const REPLAY: &str = "replay";
/// The file in which a child answers these two, in JSON.
pub const ANSWER: &str = "answer.json";
/// What a result is called beside the folder of its model.
pub const BUNDLE: &str = "result.bundle";

/// What a child may take.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// Memory in megabytes.
    pub memory_mb: u32,
    /// Nice value, 0 to 19.
    pub nice: u32,
    /// Time.
    pub time: Duration,
    /// Threads; 0 for as many as there are processors.
    pub threads: usize,
}

/// What packing a capture says of it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Packed {
    /// SHA-256 over what the recording holds.
    pub content_sha256: String,
    /// Length of the file in bytes.
    pub bytes: u64,
    /// CRC-32 of the file.
    pub crc32: u32,
}

impl Packed {
    /// What the child said, in its folder.
    ///
    /// # Errors
    /// If it said nothing that makes sense.
    pub fn read(folder: &Path) -> Result<Self, String> {
        let path = folder.join(PACKED);
        let bytes = std::fs::read(&path).map_err(|e| format!("{}: {e}", path.display()))?;
        serde_json::from_slice(&bytes).map_err(|e| format!("{}: {e}", path.display()))
    }
}

/// How a step ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StepEnd {
    /// Its exit code; none if it was killed.
    pub code: Option<i32>,
    /// Why it has none: it crashed, took too long or was cancelled.
    pub crash: Option<String>,
    /// Nobody wants its work any more.
    pub cancelled: bool,
    /// The last of what it said.
    pub words: String,
}

impl StepEnd {
    /// What it said, without what is only for the process that started it.
    pub fn lines(&self) -> Vec<String> {
        protocol::complaints(&self.words)
            .map(str::to_owned)
            .collect()
    }

    /// What it complained of, in one line.
    pub fn complaint(&self) -> String {
        let said = self.lines().join("; ");
        match &self.crash {
            Some(crash) if said.is_empty() => crash.clone(),
            Some(crash) => format!("{crash}: {said}"),
            None => said,
        }
    }
}

/// Logs what the system cannot do to confine a step, once.
fn warn_once(words: &str) {
    static WARNED: Mutex<BTreeSet<String>> = Mutex::new(BTreeSet::new());
    for missing in protocol::warnings(words) {
        if WARNED.lock().insert(missing.to_owned()) {
            log::warning!("{missing}");
        }
    }
}

/// Options that a step has, with their values.
pub(super) type Options<'a> = Vec<(&'static str, &'a Path)>;

/// Runs a step to its end, which comes with its time limit at the latest. Blocks; the child ends with this thread.
///
/// # Errors
/// If it cannot be started.
pub(super) fn run(
    step: &str,
    limits: Limits,
    options: &Options,
    words: &[&str],
    cancel: &Cancel,
) -> std::io::Result<StepEnd> {
    // This very program, also when another version has been installed meanwhile.
    let mut command = Command::new("/proc/self/exe");
    let option = |name: &str| OsString::from(format!("--{name}"));
    command.arg(COMMAND).arg(step);
    let confinement = Confinement {
        memory_mb: limits.memory_mb,
        nice: limits.nice,
    };
    command.args(confinement.arguments());
    for (name, path) in options {
        command.arg(option(name)).arg(path);
    }
    command.args(words);
    if limits.threads > 0 {
        command.env("RAYON_NUM_THREADS", limits.threads.to_string());
        // Two threads hardly wait for each other, and reuse each other's buffers.
        command.env("MALLOC_ARENA_MAX", limits.threads.div_ceil(2).to_string());
    }
    // A child ends soon: what it frees, it keeps for its next buffers, so that the kernel clears fewer pages for it.
    for option in ["MALLOC_MMAP_THRESHOLD_", "MALLOC_TRIM_THRESHOLD_"] {
        command.env(option, "4294967296");
    }
    // Where systemd keeps this process's credentials, which are not the child's.
    command.env_remove("CREDENTIALS_DIRECTORY");
    let (end, words) = Child::start(&mut command)?.wait(limits.time, Clock::system(), cancel)?;
    warn_once(&words);
    let mut ended = StepEnd {
        code: None,
        crash: None,
        cancelled: false,
        words,
    };
    match end {
        ChildExit::Ended(status) => {
            use std::os::unix::process::ExitStatusExt;
            ended.code = status.code();
            let signal = status.signal();
            ended.crash = signal.map(|signal| format!("it was killed by signal {signal}"));
        }
        ChildExit::TimedOut => {
            let limit = limits.time.as_secs();
            ended.crash = Some(format!("it did not finish within {limit} s"));
        }
        ChildExit::Cancelled => ended.cancelled = true,
    }
    Ok(ended)
}
