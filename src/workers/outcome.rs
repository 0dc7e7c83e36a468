//! What became of a job: the model that its process left, or in words why there is none.

use super::{Parameters, protocol};
use crate::report::Level;
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::ExitStatus;

/// A model that was made.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Model {
    /// How far it can be trusted.
    pub verdict: Level,
    /// Why not further, and what else is to be said.
    pub reasons: Vec<String>,
    /// Its folder.
    pub folder: PathBuf,
}

/// Largest report that is read, in bytes.
const LONGEST_REPORT: u64 = 16 << 20;
/// Longest reason that is told, in letters.
const LONGEST_REASON: usize = 1000;

/// What this room reads of a report.
#[derive(serde::Deserialize)]
struct Report {
    outcome: String,
    verdict: Option<Verdict>,
}

#[derive(serde::Deserialize)]
struct Verdict {
    level: Level,
    reasons: Vec<Reason>,
}

#[derive(serde::Deserialize)]
struct Reason {
    words: String,
}

/// The model in a folder, for a process that ended with this status, having said these words.
///
/// # Errors
/// In words, if there is none.
pub(super) fn model(
    folder: &Path,
    status: ExitStatus,
    words: &str,
    parameters: &Parameters,
) -> Result<Model, String> {
    if !protocol::left_a_model(status.code()) {
        return Err(reason(status, words, parameters));
    }
    let path = folder.join("report.json");
    let bad = |problem: String| format!("{}: {problem}", path.display());
    let length = std::fs::metadata(&path).map_err(|e| bad(e.to_string()))?;
    if length.len() > LONGEST_REPORT {
        return Err(bad(format!("{} bytes are too many", length.len())));
    }
    let bytes = std::fs::read(&path).map_err(|e| bad(e.to_string()))?;
    let report: Report = serde_json::from_slice(&bytes).map_err(|e| bad(e.to_string()))?;
    match report.verdict {
        Some(verdict) if report.outcome == "done" => Ok(Model {
            verdict: verdict.level,
            reasons: verdict.reasons.into_iter().map(|r| r.words).collect(),
            folder: folder.into(),
        }),
        _ => Err(reason(status, words, parameters)),
    }
}

/// Why a process left no model.
fn reason(status: ExitStatus, words: &str, parameters: &Parameters) -> String {
    let said: Vec<&str> = protocol::complaints(words).collect();
    let said: String = said.join("; ").chars().take(LONGEST_REASON).collect();
    let memory = if said.contains("memory allocation of") {
        format!(" (workers.memory_mb is {})", parameters.memory_mb)
    } else {
        String::new()
    };
    match status.signal() {
        Some(signal) if said.is_empty() => format!("its process died by signal {signal}"),
        Some(signal) => format!("its process died by signal {signal}: {said}{memory}"),
        None if said.is_empty() => format!("its process said nothing and gave {status}"),
        None => said + &memory,
    }
}
