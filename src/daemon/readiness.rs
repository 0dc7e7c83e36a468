//! Decides whether the daemon is ready, and sums its status up in one line. It is pure: it reads only the status that
//! it is given. Whether one camera is ready is decided by its thread, `drivers::live::supervise`.

use super::parameters::ServiceParameters;
use super::status::{CameraStatus, Status};
use crate::words::count;
use std::time::Duration;

/// Whether work may begin, and the status in one line.
#[derive(Debug, PartialEq)]
pub(super) struct Readiness {
    pub ready: bool,
    pub words: String,
}

/// Judges a status `waited` after the start. Every camera must be ready; after `patience_s`, as many may be missing as
/// the policy allows.
pub(super) fn readiness(
    status: &Status,
    waited: Duration,
    policy: &ServiceParameters,
) -> Readiness {
    let is_missing = |camera: &CameraStatus| camera.state != "ready";
    let missing: Vec<&str> = status
        .cameras
        .iter()
        .filter_map(|(id, camera)| is_missing(camera).then_some(id.as_str()))
        .collect();
    let all = status.cameras.len();
    let patient = waited.as_secs_f64() < policy.patience_s;
    let allowed = if patient { 0 } else { policy.missing_cameras };
    let ready = all > 0 && missing.len() <= allowed;
    let mut words = if ready { "ready: " } else { "not ready: " }.to_owned();
    words += &format!("{} of {}", all - missing.len(), count(all, "camera"));
    if !missing.is_empty() {
        words += &format!(" (missing: {})", missing.join(", "));
    }
    if let Some(session) = &status.session {
        words += &format!("; session {session}");
    }
    words += &format!(
        "; {}, {} failed",
        count(status.complete as usize, "capture"),
        status.failed
    );
    if status.capture_bytes > 0 {
        words += &format!("; space for {} more", status.captures_left);
    }
    Readiness { ready, words }
}

#[cfg(test)]
mod tests {
    use super::super::rig::CameraKind;
    use super::*;

    fn status(states: &[(&str, &'static str)]) -> Status {
        let camera = |state| CameraStatus {
            kind: CameraKind::Color,
            state,
            words: String::new(),
            settings: Vec::new(),
            health: Vec::new(),
            remarks: Vec::new(),
            lost_frames: 0,
        };
        let cameras = states.iter();
        Status {
            cameras: cameras
                .map(|(id, s)| ((*id).to_owned(), camera(*s)))
                .collect(),
            ..Status::default()
        }
    }

    #[test]
    fn the_policy_decides_when_fewer_cameras_are_enough() {
        let strict = ServiceParameters::default();
        let lenient = ServiceParameters {
            missing_cameras: 1,
            patience_s: 20.0,
        };
        let (early, late) = (Duration::from_secs(1), Duration::from_secs(3600));
        let all = status(&[("c00", "ready"), ("c01", "ready")]);
        let one_away = status(&[("c00", "ready"), ("c01", "away")]);
        let one_opening = status(&[("c00", "ready"), ("c01", "opening")]);
        let both_away = status(&[("c00", "away"), ("c01", "away")]);
        let ready = |status, waited, policy| readiness(status, waited, policy).ready;
        assert!(ready(&all, early, &strict) && ready(&all, early, &lenient));
        assert!(!ready(&one_away, early, &lenient));
        assert!(ready(&one_away, late, &lenient));
        assert!(!ready(&one_away, late, &strict));
        assert!(!ready(&one_opening, early, &lenient));
        assert!(!ready(&both_away, late, &lenient));
        // Before the capturing thread has published its first status.
        assert!(!ready(&Status::default(), late, &lenient));
    }

    #[test]
    fn the_line_names_who_is_missing() {
        let one_away = status(&[("c00", "ready"), ("c01", "away")]);
        let told = readiness(&one_away, Duration::ZERO, &ServiceParameters::default());
        assert_eq!(
            told.words,
            "not ready: 1 of 2 cameras (missing: c01); 0 captures, 0 failed"
        );
    }
}
