//! What became of each capture, and the exit code that follows from all of them.

use crate::commands::EXIT_LOST;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// What became of a capture, or of a whole recording that could not be read.
#[derive(Debug, serde::Serialize)]
pub(super) struct Outcome {
    /// The recording.
    pub(super) recording: String,
    /// The capture; none for a recording that could not be read.
    pub(super) capture: Option<String>,
    /// `done`, `unchanged` or `failed`.
    pub(super) result: &'static str,
    /// `green`, `amber` or `red`.
    pub(super) verdict: Option<String>,
    /// Why it failed, or the reasons of its verdict.
    pub(super) reasons: Vec<String>,
    /// Where its files are.
    pub(super) folder: Option<PathBuf>,
    /// Whether the recording was damaged.
    pub(super) damaged: bool,
    /// Seconds a stage.
    pub(super) seconds: Vec<(String, f64)>,
}

impl Outcome {
    pub(super) fn unreadable(path: &Path, error: &anyhow::Error) -> Self {
        Self {
            recording: path.display().to_string(),
            capture: None,
            result: "failed",
            verdict: None,
            reasons: vec![format!("{error:#}")],
            folder: None,
            damaged: false,
            seconds: Vec::new(),
        }
    }

    pub(super) fn is_done(&self) -> bool {
        self.result != "failed"
    }

    pub(super) fn is_red(&self) -> bool {
        self.verdict.as_deref() == Some("red")
    }

    pub(super) fn has_lost(&self) -> bool {
        self.damaged || !self.is_done()
    }
}

/// 0: all done. 1: nothing done, or a red verdict with `strict`. 3: done, but something was lost.
pub(super) fn exit_code(outcomes: &[Outcome], strict: bool) -> ExitCode {
    let done = outcomes.iter().any(Outcome::is_done);
    if !done || (strict && outcomes.iter().any(Outcome::is_red)) {
        ExitCode::FAILURE
    } else if outcomes.iter().any(Outcome::has_lost) {
        ExitCode::from(EXIT_LOST)
    } else {
        ExitCode::SUCCESS
    }
}
