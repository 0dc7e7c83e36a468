//! A model that lies in its folder, as its report tells: read back by who makes models and by who waits for one.

use crate::report::{Level, Outcome};
use serde::Deserialize;
use std::path::{Path, PathBuf};

/// The report's file in a model's folder.
pub(super) const NAME: &str = "report.json";
/// Largest report that is read, in bytes.
const LONGEST: u64 = 16 << 20;

/// A model in its folder.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Model {
    /// How far it can be trusted.
    pub verdict: Level,
    /// Why not further, and what else is to be said.
    pub reasons: Vec<String>,
    /// Its folder.
    pub folder: PathBuf,
}

/// What programs act on in a folder's report.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ReportFile {
    /// Whether there is a model.
    pub outcome: Outcome,
    /// Tells inputs and settings apart from others; empty in the report of a failure.
    pub digest: String,
    /// The model, if there is one.
    pub model: Option<Model>,
}

/// The members that are read, of a report of any version.
#[derive(Deserialize)]
struct Members {
    outcome: Outcome,
    #[serde(default)]
    digest: String,
    verdict: Option<Verdict>,
}

#[derive(Deserialize)]
struct Verdict {
    level: Level,
    reasons: Vec<Reason>,
}

#[derive(Deserialize)]
struct Reason {
    words: String,
}

impl ReportFile {
    /// Reads the report in `folder`.
    ///
    /// # Errors
    /// If there is none, it is larger than any report, or is not one: in words that name its file.
    pub fn read(folder: &Path) -> Result<Self, String> {
        let path = folder.join(NAME);
        let bad = |problem: String| format!("{}: {problem}", path.display());
        let length = std::fs::metadata(&path)
            .map_err(|e| bad(e.to_string()))?
            .len();
        if length > LONGEST {
            return Err(bad(format!("{length} bytes, expected at most {LONGEST}")));
        }
        let bytes = std::fs::read(&path).map_err(|e| bad(e.to_string()))?;
        let members: Members = serde_json::from_slice(&bytes).map_err(|e| bad(e.to_string()))?;
        let verdict = members.verdict.filter(|_| members.outcome == Outcome::Done);
        let model = |verdict: Verdict| Model {
            verdict: verdict.level,
            reasons: verdict.reasons.into_iter().map(|r| r.words).collect(),
            folder: folder.into(),
        };
        Ok(Self {
            outcome: members.outcome,
            digest: members.digest,
            model: verdict.map(model),
        })
    }
}
