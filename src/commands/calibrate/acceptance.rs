//! Decides which files a calibration is written to, and the exit code, from its verdict.

use crate::calibrate::Outcome;
use crate::calibration::CalibrationLevel;
use crate::commands::EXIT_INCOMPLETE;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// The exit code for a calibration that is not to be used.
const EXIT_REFUSED: u8 = 1;

/// How much of a calibration is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Acceptance {
    /// Everything that was asked for, under its name.
    Whole,
    /// The calibration alone, under a name that says that it is doubtful.
    Aside,
    /// The calibration alone, under its name, although it is refused.
    Forced,
    /// Nothing.
    Nothing,
}

impl Acceptance {
    /// What is done with a calibration of this level. `forced` takes a refused one, `doubtful_too` a doubtful one.
    pub(super) fn of(level: CalibrationLevel, forced: bool, doubtful_too: bool) -> Self {
        match level {
            CalibrationLevel::Good | CalibrationLevel::Accepted => Self::Whole,
            CalibrationLevel::Doubtful if doubtful_too => Self::Whole,
            CalibrationLevel::Doubtful => Self::Aside,
            CalibrationLevel::Refused if forced => Self::Forced,
            CalibrationLevel::Refused => Self::Nothing,
        }
    }

    /// The file that the calibration goes to.
    pub(super) fn out(self, asked: Option<&Path>) -> Option<PathBuf> {
        match self {
            Self::Whole | Self::Forced => asked.map(Path::to_owned),
            Self::Aside => asked.map(doubtful_name),
            Self::Nothing => None,
        }
    }

    /// The file of the other name, which this calibration does not write, if an earlier one left it there.
    pub(super) fn earlier_file(self, asked: Option<&Path>) -> Option<PathBuf> {
        let asked = asked?;
        let other = match self {
            Self::Whole | Self::Forced => doubtful_name(asked),
            Self::Aside => asked.to_owned(),
            Self::Nothing => return None,
        };
        other.symlink_metadata().is_ok().then_some(other)
    }

    /// 0: all well, or accepted as it is. 1: refused, also where it is written. 3: doubtful, or something was lost.
    pub(super) fn exit_code(self, outcome: &Outcome, doubtful_too: bool) -> ExitCode {
        let lost = match doubtful_too {
            // Cameras and responses that are missing are part of what was accepted.
            true => outcome.has_unread(),
            false => outcome.has_lost(),
        };
        ExitCode::from(self.code(lost))
    }

    /// The same as a number.
    pub(super) fn code(self, has_lost: bool) -> u8 {
        match self {
            Self::Nothing | Self::Forced => EXIT_REFUSED,
            Self::Aside => EXIT_INCOMPLETE,
            Self::Whole if has_lost => EXIT_INCOMPLETE,
            Self::Whole => 0,
        }
    }
}

/// `rig.doubtful.toml` for `rig.toml`.
pub(super) fn doubtful_name(asked: &Path) -> PathBuf {
    let extension = match asked.extension() {
        Some(extension) => format!("doubtful.{}", extension.to_string_lossy()),
        None => "doubtful".to_owned(),
    };
    asked.with_extension(extension)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_doubtful_calibration_never_gets_the_name_that_was_asked_for_unasked() {
        let out = |level, forced, doubtful_too| {
            Acceptance::of(level, forced, doubtful_too).out(Some(Path::new("a/rig.toml")))
        };
        let (whole, aside) = (
            PathBuf::from("a/rig.toml"),
            PathBuf::from("a/rig.doubtful.toml"),
        );
        for level in [CalibrationLevel::Good, CalibrationLevel::Accepted] {
            assert_eq!(out(level, false, false), Some(whole.clone()));
        }
        assert_eq!(
            out(CalibrationLevel::Doubtful, false, false),
            Some(aside.clone())
        );
        assert_eq!(out(CalibrationLevel::Doubtful, true, false), Some(aside));
        assert_eq!(
            out(CalibrationLevel::Doubtful, false, true),
            Some(whole.clone())
        );
        assert_eq!(out(CalibrationLevel::Refused, false, true), None);
        assert_eq!(out(CalibrationLevel::Refused, true, false), Some(whole));
        assert_eq!(doubtful_name(Path::new("rig")), Path::new("rig.doubtful"));
    }

    #[test]
    fn a_file_of_an_earlier_calibration_under_the_other_name_is_found() {
        let folder = tempfile::tempdir().unwrap();
        let asked = folder.path().join("rig.toml");
        let doubtful = doubtful_name(&asked);
        let earlier = |acceptance: Acceptance| acceptance.earlier_file(Some(&asked));
        for acceptance in [Acceptance::Whole, Acceptance::Forced, Acceptance::Aside] {
            assert_eq!(earlier(acceptance), None);
        }
        std::fs::write(&doubtful, "").unwrap();
        assert_eq!(earlier(Acceptance::Whole), Some(doubtful.clone()));
        assert_eq!(earlier(Acceptance::Forced), Some(doubtful));
        assert_eq!(earlier(Acceptance::Aside), None);
        std::fs::write(&asked, "").unwrap();
        assert_eq!(earlier(Acceptance::Aside), Some(asked.clone()));
        assert_eq!(earlier(Acceptance::Nothing), None);
        assert_eq!(Acceptance::Whole.earlier_file(None), None);
    }

    #[test]
    fn the_exit_code_says_what_a_calibration_is_worth_whatever_is_written() {
        use CalibrationLevel::{Accepted, Doubtful, Good, Refused};
        for (level, forced, doubtful_too, has_lost, code) in [
            (Good, false, false, false, 0),
            (Accepted, true, true, false, 0),
            (Accepted, false, false, true, 3),
            (Doubtful, false, false, false, 3),
            (Doubtful, true, false, false, 3),
            (Doubtful, false, true, false, 0),
            (Doubtful, false, true, true, 3),
            (Refused, false, false, false, 1),
            (Refused, true, false, false, 1),
            (Refused, true, true, true, 1),
        ] {
            let acceptance = Acceptance::of(level, forced, doubtful_too);
            let found = acceptance.code(has_lost);
            assert_eq!(found, code, "{level:?} {forced} {doubtful_too} {has_lost}");
        }
        // What has no place for a verdict is not written from a refused calibration.
        assert_ne!(Acceptance::of(Refused, true, true), Acceptance::Whole);
    }
}
