//! Checks of the machine and the rig before work starts. Each check gives a finding: in order, or what to do about it.
//! This module runs the checks and rates the results; the caller passes the cameras' status in.

mod bundle;
mod cameras;
mod disk;
mod host;

pub use bundle::{Bundle, LARGEST_FILE, without_passwords};
pub use cameras::cameras;
pub use disk::{folder, plates, space, speed};
pub use host::Host;

use crate::words::count;
use std::time::{Duration, SystemTime};

/// The result of a check.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum State {
    /// As it should be.
    Ok,
    /// It works, but could be better.
    Advice,
    /// It does not work, or loses captures.
    Wrong,
}

/// What one check found.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize)]
pub struct Finding {
    /// What was checked.
    pub subject: String,
    /// The result.
    pub state: State,
    /// What was found.
    pub found: String,
    /// What to do, if it is not in order.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub remedy: Option<String>,
}

impl Finding {
    /// In order.
    pub fn ok(subject: impl Into<String>, found: impl Into<String>) -> Self {
        Self {
            subject: subject.into(),
            state: State::Ok,
            found: found.into(),
            remedy: None,
        }
    }

    /// Not in order, and what to do.
    pub fn not_ok(
        state: State,
        subject: impl Into<String>,
        found: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        Self {
            state,
            remedy: Some(remedy.into()),
            ..Self::ok(subject, found)
        }
    }

    /// A line for people.
    pub fn line(&self) -> String {
        let word = match self.state {
            State::Ok => "ok    ",
            State::Advice => "advice",
            State::Wrong => "WRONG ",
        };
        let mut line = format!("{word} {}: {}", self.subject, self.found);
        if let Some(remedy) = &self.remedy {
            line += &format!("\n       → {remedy}");
        }
        line
    }
}

/// Checks the age of the calibration by its file, if the rig has one. Advises to calibrate again after 90 days.
pub fn calibration(modified: Option<std::io::Result<SystemTime>>) -> Finding {
    let subject = "calibration";
    let Some(modified) = modified else {
        let remedy = "record a session with a board, and calibrate: docs/calibration.md";
        return Finding::not_ok(
            State::Wrong,
            subject,
            "the rig has no calibration, so no models are made",
            remedy,
        );
    };
    let age = modified.map(|time| time.elapsed().unwrap_or_default());
    match age {
        Ok(age) if age <= Duration::from_secs(90 * 86_400) => Finding::ok(subject, days_old(age)),
        Ok(age) => Finding::not_ok(
            State::Advice,
            subject,
            days_old(age),
            "calibrate again if anything was touched since: docs/calibration.md",
        ),
        Err(cause) => {
            let remedy = "rig.calibration names the file that scand calibrate wrote";
            Finding::not_ok(State::Wrong, subject, cause.to_string(), remedy)
        }
    }
}

/// A calibration whose own verdict, `worth`, is worse than accepted: with the first reason for that.
pub fn doubted_calibration(worth: &str, is_refused: bool, reason: Option<&str>) -> Finding {
    let state = match is_refused {
        true => State::Wrong,
        false => State::Advice,
    };
    let reason = reason.map_or_else(String::new, |reason| format!(": {reason}"));
    Finding::not_ok(
        state,
        "the calibration's verdict",
        format!("{worth}{reason}"),
        "models made with it say so: calibrate again, docs/calibration.md",
    )
}

fn days_old(age: Duration) -> String {
    let days = age.as_secs() / 86_400;
    format!("{} old", count(days as usize, "day"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_says_what_to_do() {
        let finding = Finding::not_ok(State::Wrong, "disk", "full", "remove something");
        assert_eq!(
            finding.line(),
            "WRONG  disk: full\n       → remove something"
        );
        assert_eq!(
            Finding::ok("disk", "room for 7").line(),
            "ok     disk: room for 7"
        );
    }

    #[test]
    fn a_calibration_that_is_not_to_be_used_is_told() {
        let reason = Some("camera c02 moved");
        let doubted = doubted_calibration("doubtful", false, reason);
        assert_eq!(doubted.state, State::Advice);
        assert_eq!(doubted.found, "doubtful: camera c02 moved");
        assert_eq!(
            doubted_calibration("refused", true, None).state,
            State::Wrong
        );
    }

    #[test]
    fn an_old_calibration_is_told() {
        let days = |n: u64| Ok(SystemTime::now() - Duration::from_secs(n * 86_400));
        assert_eq!(calibration(Some(days(3))).state, State::Ok);
        let old = calibration(Some(days(200)));
        assert_eq!(
            (old.state, old.found.as_str()),
            (State::Advice, "200 days old")
        );
        let none = std::io::ErrorKind::NotFound.into();
        assert_eq!(calibration(Some(Err(none))).state, State::Wrong);
        assert_eq!(calibration(None).state, State::Wrong);
    }
}
