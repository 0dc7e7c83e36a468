//! Reads the report in a model's folder: for a replay that finds a model there, and for the daemon when its process
//! has ended.

use crate::level::Level;
use crate::report::ReportOutcome;
use crate::storage;
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
    /// Why it cannot be trusted further, and what else a person should know.
    pub reasons: Vec<String>,
    /// Its folder.
    pub folder: PathBuf,
}

/// What programs act on in a folder's report.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ReportFile {
    /// Whether there is a model.
    pub outcome: ReportOutcome,
    /// Tells inputs and settings apart from others; empty in the report of a failure.
    pub digest: String,
    /// The model, if there is one.
    pub model: Option<Model>,
}

/// The members that are read, of a report of any version.
#[derive(Deserialize)]
struct Members {
    outcome: ReportOutcome,
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

/// The text of the report in `folder`.
///
/// # Errors
/// If there is none, or it is larger than any report. The message names the file.
pub(super) fn text(folder: &Path) -> Result<String, String> {
    let path = folder.join(NAME);
    storage::read_text(&path, LONGEST).map_err(|problem| format!("{}: {problem}", path.display()))
}

impl ReportFile {
    /// Reads the report in `folder`.
    ///
    /// # Errors
    /// If there is no report, or the file is larger than any report or is not a report. The message names the file.
    pub fn read(folder: &Path) -> Result<Self, String> {
        let text = text(folder)?;
        let bad = |e: serde_json::Error| format!("{}: {e}", folder.join(NAME).display());
        let members: Members = serde_json::from_str(&text).map_err(bad)?;
        let verdict = members
            .verdict
            .filter(|_| members.outcome == ReportOutcome::Done);
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

    /// The captures that an object's report leaves out, by name and with the reason; none where it cannot be read.
    pub fn left_out(folder: &Path) -> Vec<String> {
        let captures = json(folder).map(|json| captures(&json)).unwrap_or_default();
        let left = captures.iter().filter(|c| c["is_fused"] == false);
        let of =
            |c: &serde_json::Value, name: &str| c[name].as_str().unwrap_or_default().to_owned();
        left.map(|c| format!("{}: {}", of(c, "id"), of(c, "words")))
            .collect()
    }

    /// The names of the captures that an object's model is made of, none where its report is that of a failure; `None`
    /// where no report can be read.
    pub fn fused(folder: &Path) -> Option<Vec<String>> {
        let json = json(folder)?;
        let is_model = json["outcome"] == "done";
        let captures = captures(&json).into_iter().filter(|_| is_model);
        let fused = captures.filter(|c| c["is_fused"] == true);
        let names = fused.filter_map(|c| c["id"].as_str().map(str::to_owned));
        Some(names.collect())
    }
}

fn json(folder: &Path) -> Option<serde_json::Value> {
    serde_json::from_str(&text(folder).ok()?).ok()
}

/// What an object's report says of each of its captures.
fn captures(report: &serde_json::Value) -> Vec<serde_json::Value> {
    let captures = report["fusion"]["captures"].as_array();
    captures.cloned().unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::{CaptureId, Timestamp};
    use crate::make_model::{FailedJob, report_failure};
    use crate::reconstruct::Method;
    use crate::report::FailedCapture;

    fn read(text: &str) -> Result<ReportFile, String> {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join(NAME), text).unwrap();
        ReportFile::read(folder.path())
    }

    #[test]
    fn a_model_is_read_whatever_else_its_report_tells() {
        let report = read(
            r#"{"version": 9, "outcome": "done", "digest": "abc", "new": [1], "verdict": {"level": "amber",
                "reasons": [{"level": "amber", "code": "a_new_one", "words": "it was cut"}]}}"#,
        )
        .unwrap();
        assert_eq!(
            (report.outcome, report.digest.as_str()),
            (ReportOutcome::Done, "abc")
        );
        let model = report.model.unwrap();
        assert_eq!(model.verdict, Level::Amber);
        assert_eq!(model.reasons, ["it was cut"]);
    }

    #[test]
    fn the_report_of_a_failure_is_no_model() {
        let home = tempfile::tempdir().unwrap();
        let folder = home.path().join("a1");
        let job = FailedJob {
            recording: Path::new("cup.mcap"),
            method: Method::default(),
            capture: FailedCapture {
                id: &CaptureId::new("a1").unwrap(),
                time_ns: Timestamp(1),
                source: "test",
            },
        };
        report_failure(&folder, job, "no light", Some(b"words"), false).unwrap();
        let report = ReportFile::read(&folder).unwrap();
        assert_eq!(
            (report.outcome, report.model),
            (ReportOutcome::Failed, None)
        );
        assert_eq!(std::fs::read(folder.join("worker.log")).unwrap(), b"words");
    }

    #[test]
    fn an_objects_report_tells_of_which_captures_its_model_is() {
        let fused = |text: &str| {
            let folder = tempfile::tempdir().unwrap();
            std::fs::write(folder.path().join(NAME), text).unwrap();
            let left_out = ReportFile::left_out(folder.path());
            (ReportFile::fused(folder.path()), left_out)
        };
        let captures = r#""fusion": {"captures": [{"id": "a", "is_fused": true},
            {"id": "b", "is_fused": false, "words": "it moved"}]}}"#;
        let (of_model, left_out) = fused(&format!(r#"{{"outcome": "done", {captures}"#));
        assert_eq!(of_model, Some(vec!["a".to_owned()]));
        assert_eq!(left_out, ["b: it moved"]);
        let (of_failure, _) = fused(&format!(r#"{{"outcome": "failed", {captures}"#));
        assert_eq!(of_failure, Some(Vec::new()));
        assert_eq!(fused(r#"{"outcome": "#), (None, Vec::new()));
    }

    #[test]
    fn what_is_no_report_is_named() {
        for text in ["", "{}", r#"{"outcome": "unknown"}"#] {
            let problem = read(text).unwrap_err();
            assert!(problem.contains(NAME), "{problem}");
        }
        let folder = tempfile::tempdir().unwrap();
        let file = std::fs::File::create(folder.path().join(NAME)).unwrap();
        file.set_len(LONGEST + 1).unwrap();
        let problem = ReportFile::read(folder.path()).unwrap_err();
        assert!(problem.contains("expected at most"), "{problem}");
        assert!(ReportFile::read(&folder.path().join("none")).is_err());
    }
}
