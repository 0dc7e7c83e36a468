//! The folder of a capture whose model could not be made: its report, and the log of the process that tried.

use crate::storage::{Error, StagedFolder};
use std::path::Path;

/// Puts the report of a failure (`report.json`) where the model would be, and beside it the `words` of the process that
/// failed (`worker.log`), if there are any. An existing model is worth more than the report of a failure: it stays,
/// unless it is to be replaced.
///
/// # Errors
/// If the folder cannot be written.
pub fn write_failure(
    target: &Path,
    report: &[u8],
    words: Option<&[u8]>,
    replace: bool,
) -> Result<(), Error> {
    if target.exists() && !failed_before(target) && !replace {
        return Ok(());
    }
    let staged = StagedFolder::create(target)?;
    staged.write("report.json", report)?;
    if let Some(words) = words {
        staged.write("worker.log", words)?;
    }
    staged.commit(true)
}

/// Whether the folder holds the report of a failure.
fn failed_before(target: &Path) -> bool {
    let report = std::fs::read(target.join("report.json")).unwrap_or_default();
    let report: Option<serde_json::Value> = serde_json::from_slice(&report).ok();
    report.is_some_and(|report| report["outcome"] == "failed")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failure_replaces_a_failure_and_no_model() {
        let home = tempfile::tempdir().unwrap();
        let target = home.path().join("s-0001");
        let failed = br#"{"outcome":"failed","reason":"a"}"#;
        write_failure(&target, failed, Some(b"words"), false).unwrap();
        assert_eq!(std::fs::read(target.join("worker.log")).unwrap(), b"words");
        write_failure(&target, failed, None, false).unwrap();
        assert!(!target.join("worker.log").exists());
        std::fs::write(target.join("report.json"), r#"{"outcome":"done"}"#).unwrap();
        write_failure(&target, failed, Some(b"words"), false).unwrap();
        assert!(!target.join("worker.log").exists());
        write_failure(&target, failed, Some(b"words"), true).unwrap();
        assert!(target.join("worker.log").exists());
    }
}
