//! Rules about how the capture was taken: its time, its cameras, its recording.

use super::{Level, Parameters, Reason, ReasonCode, about_cameras};
use crate::calibration;
use crate::capture::{CaptureFacts, ColorFacts, Silhouette};
use crate::frame::CameraId;

const NS_PER_HOUR: f64 = 3.6e12;
const NS_PER_MS: f64 = 1e6;
/// Messages of one kind that are repeated; the others are counted.
const REPEATED: usize = 5;

pub(super) fn judge(capture: &CaptureFacts, parameters: &Parameters, into: &mut Vec<Reason>) {
    let skew_ms = capture.skew_ns as f64 / NS_PER_MS;
    into.extend(parameters.skew_ms.level(skew_ms).map(|level| Reason {
        level,
        code: ReasonCode::Skew,
        cameras: farthest(capture),
        words: format!("the colour cameras' pictures are {skew_ms:.1} ms apart"),
    }));
    into.extend(about_cameras(
        ReasonCode::BackgroundOld,
        &parameters.background_age_h,
        capture.colors.iter().map(|c| (&c.camera, age_h(c))),
        |hours| format!("{hours:.0} h"),
        |names| format!("the background is old: {names}"),
    ));
    into.extend(capture.calibration.as_ref().and_then(doubted));
    for left_out in &capture.left_out {
        into.push(Reason {
            level: Level::Amber,
            code: ReasonCode::CameraLeftOut,
            cameras: vec![left_out.camera.clone()],
            words: format!("the camera was not used: {}", left_out.reason),
        });
    }
    repeat(
        ReasonCode::Damage,
        capture.damage.iter().map(ToString::to_string),
        into,
    );
    repeat(ReasonCode::Warning, capture.warnings.iter().cloned(), into);
}

/// A model is no better than its calibration.
fn doubted(calibration: &calibration::CalibrationVerdict) -> Option<Reason> {
    let reasons = &calibration.reasons;
    let first = reasons.first().map_or(String::new(), |r| format!(": {r}"));
    let why = match reasons.len() {
        0 | 1 => first,
        all => format!("{first} ({all} reasons in all)"),
    };
    let (level, words) = match calibration.level {
        calibration::CalibrationLevel::Good | calibration::CalibrationLevel::Accepted => {
            return None;
        }
        calibration::CalibrationLevel::Doubtful => {
            (Level::Amber, format!("the calibration is doubtful{why}"))
        }
        calibration::CalibrationLevel::Refused => {
            (Level::Red, format!("the calibration was refused{why}"))
        }
    };
    Some(Reason {
        level,
        code: ReasonCode::CalibrationDoubtful,
        cameras: Vec::new(),
        words,
    })
}

/// The camera that was farthest from the trigger.
fn farthest(capture: &CaptureFacts) -> Vec<CameraId> {
    let delays = capture.colors.iter();
    let farthest = delays.max_by_key(|c| c.delay_ns.unsigned_abs());
    farthest.map(|c| c.camera.clone()).into_iter().collect()
}

fn age_h(camera: &ColorFacts) -> f64 {
    match camera.silhouette {
        Silhouette::Background { age_ns } => age_ns as f64 / NS_PER_HOUR,
        Silhouette::Mask => 0.0,
    }
}

/// Makes an amber reason of each warning.
fn repeat(
    code: ReasonCode,
    messages: impl ExactSizeIterator<Item = String>,
    into: &mut Vec<Reason>,
) {
    let rest = messages.len().saturating_sub(REPEATED);
    let more = (rest > 0).then(|| format!("and {rest} more of this kind"));
    into.extend(messages.take(REPEATED).chain(more).map(|words| Reason {
        level: Level::Amber,
        code,
        cameras: Vec::new(),
        words,
    }));
}
