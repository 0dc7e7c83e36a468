//! `scand calibrate --from`: writes an existing calibration in the formats of ROS and Kalibr. These have no place for a
//! verdict, so a doubtful calibration is exported only if that is accepted, and a refused one never.

use super::acceptance::Acceptance;
use super::bad_file;
use super::files::FileArgs;
use crate::calibrate;
use crate::calibration::{CalibrationLevel, CalibrationVerdict};
use crate::storage::write_atomically;
use crate::words::count;
use std::path::Path;
use std::process::ExitCode;

/// What is written of an existing calibration, and how.
pub(super) struct Export<'a> {
    pub(super) from: &'a Path,
    pub(super) out: Option<&'a Path>,
    pub(super) files: &'a FileArgs,
    pub(super) force: bool,
    pub(super) accept_doubtful: bool,
    pub(super) quiet: bool,
}

impl Export<'_> {
    /// Writes the calibration of `from` to the files that are asked for. Its own file keeps the verdict.
    pub(super) fn run(&self) -> anyhow::Result<ExitCode> {
        let (from, files) = (self.from, self.files);
        anyhow::ensure!(
            self.out.is_some() || files.exports(),
            "--from {}: also give --ros, --kalibr or --out for the result",
            from.display()
        );
        let calibration = calibrate::load(from).map_err(bad_file)?;
        files.refuse_to_replace(calibration.cameras.keys(), self.force)?;
        if let Some(path) = self.out {
            write_atomically(path, calibration.to_toml().as_bytes())?;
        }
        // What does not say what it is worth is taken as it is.
        let verdict = calibration.verdict.as_ref();
        let level = verdict.map_or(CalibrationLevel::Good, |verdict| verdict.level);
        let acceptance = Acceptance::of(level, self.force, self.accept_doubtful);
        if let (true, Some(words)) = (files.exports(), why_not_exported(acceptance, verdict)) {
            eprintln!("scand: {}: {words}", from.display());
            return Ok(ExitCode::from(acceptance.code(false)));
        }
        files.write_exports(&calibration)?;
        if !self.quiet {
            let cameras = count(calibration.cameras.len(), "camera");
            outln!("{}: {cameras}", from.display());
        }
        Ok(ExitCode::SUCCESS)
    }
}

/// Why a calibration that is worth this much is not exported; `None` if it is.
fn why_not_exported(
    acceptance: Acceptance,
    verdict: Option<&CalibrationVerdict>,
) -> Option<String> {
    let (worth, remedy) = match acceptance {
        Acceptance::Whole => return None,
        Acceptance::Aside => ("doubtful", "; --accept-doubtful exports it"),
        Acceptance::Forced | Acceptance::Nothing => ("refused", ""),
    };
    let reason = verdict.and_then(|verdict| verdict.reasons.first());
    let reason = reason.map_or_else(String::new, |reason| format!(" ({reason})"));
    Some(format!(
        "the calibration is {worth}{reason}, and the formats of ROS and Kalibr have no place for that: it is not \
         exported{remedy}"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_doubtful_calibration_is_exported_only_if_that_is_accepted_and_a_refused_one_never() {
        let told = |level: CalibrationLevel, force: bool, accept_doubtful: bool| {
            let verdict = CalibrationVerdict {
                level,
                reasons: vec!["camera c02 moved".into()],
            };
            let acceptance = Acceptance::of(level, force, accept_doubtful);
            let words = why_not_exported(acceptance, Some(&verdict));
            words.map(|words| (acceptance.code(false), words))
        };
        assert_eq!(told(CalibrationLevel::Accepted, false, false), None);
        assert_eq!(told(CalibrationLevel::Doubtful, false, true), None);
        let (code, words) = told(CalibrationLevel::Doubtful, true, false).unwrap();
        assert!(code == 3 && words.contains("is doubtful (camera c02 moved), and"));
        assert!(words.ends_with("--accept-doubtful exports it"), "{words}");
        for force in [false, true] {
            let (code, words) = told(CalibrationLevel::Refused, force, true).unwrap();
            assert!(
                code == 1 && words.ends_with("it is not exported"),
                "{words}"
            );
        }
    }
}
