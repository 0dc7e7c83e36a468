//! The outcome of a job: the model that its worker made, or the reason why it made none.

use super::{Parameters, job, protocol};
use crate::make_model::{Model, ReportFile};
use std::os::unix::process::ExitStatusExt;
use std::path::Path;
use std::process::ExitStatus;

/// Longest reason that is reported, in characters.
const LONGEST_REASON: usize = 1000;

/// The report that lay in a job's folder before its process began, if any.
#[derive(Default)]
pub(super) struct ReportBefore(Option<String>);

impl ReportBefore {
    /// That of this folder, now.
    pub(super) fn of(folder: &Path) -> Self {
        Self(job::identity(&folder.join("report.json")))
    }

    /// The model that was put into the folder since. A process that is killed may have put its model in place before:
    /// models appear whole or not at all.
    pub(super) fn model_since(&self, folder: &Path) -> Option<Model> {
        let Self(now) = Self::of(folder);
        let is_new = now.is_some() && now != self.0;
        is_new.then(|| ReportFile::read(folder).ok()?.model)?
    }
}

/// The model in a folder, after a process ended with this status and this output.
///
/// # Errors
/// The reason, if there is no model.
pub(super) fn model(
    folder: &Path,
    status: ExitStatus,
    words: &str,
    parameters: &Parameters,
) -> Result<Model, String> {
    if !protocol::leaves_a_model(status.code()) {
        return Err(reason(status, words, parameters));
    }
    let report = ReportFile::read(folder)?;
    report
        .model
        .ok_or_else(|| reason(status, words, parameters))
}

/// The model in a folder that was put there from elsewhere.
///
/// # Errors
/// The reason that its report gives, if there is no model.
pub(super) fn of_folder(folder: &Path) -> Result<Model, String> {
    let report = ReportFile::read(folder)?;
    report.model.ok_or_else(|| {
        let said = std::fs::read(folder.join("report.json")).unwrap_or_default();
        let said: serde_json::Value = serde_json::from_slice(&said).unwrap_or_default();
        let reason = said["reason"]
            .as_str()
            .unwrap_or("its report gives no reason");
        reason.chars().take(LONGEST_REASON).collect()
    })
}

/// Why a worker made no model.
pub(super) fn reason(status: ExitStatus, words: &str, parameters: &Parameters) -> String {
    let said: Vec<&str> = protocol::complaints(words).collect();
    let said: String = said.join("; ").chars().take(LONGEST_REASON).collect();
    let memory = if said.contains("memory allocation of") {
        format!(" (workers.memory_mb is {})", parameters.memory_mb)
    } else {
        String::new()
    };
    match status.signal() {
        Some(signal) if said.is_empty() => format!("the worker was killed by signal {signal}"),
        Some(signal) => format!("the worker was killed by signal {signal}: {said}{memory}"),
        None if said.is_empty() => format!("the worker exited with {status} and no output"),
        None => said + &memory,
    }
}
