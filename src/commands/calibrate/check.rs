//! `scand calibrate --check`: reports whether the rig still matches its calibration, as text or JSON.

use crate::calibrate::{Check, Detections};
use crate::calibration::fit::Checked;
use crate::commands::EXIT_LOST;
use std::process::ExitCode;

/// Prints a check: 0 if all cameras are where they were, 1 if one moved, 3 if some could not be checked.
pub(super) fn print(check: &Check, detections: &Detections, json: bool, quiet: bool) -> ExitCode {
    if json {
        let told = serde_json::json!({
            "cameras": check.cameras,
            "not_in_calibration": check.unknown,
            "not_checked": check.unchecked,
            "lost": detections.lost,
        });
        outln!("{told:#}");
    } else if !quiet {
        check.cameras.iter().for_each(|c| outln!("{}", words(c)));
        check
            .unknown
            .iter()
            .for_each(|id| outln!("camera {id}: it is not in the calibration"));
        outln!("{}", summary(check));
    }
    match check.moved().next() {
        Some(_) => ExitCode::FAILURE,
        None if !check.unchecked.is_empty() || !detections.lost.is_empty() => {
            ExitCode::from(EXIT_LOST)
        }
        None => ExitCode::SUCCESS,
    }
}

fn words(checked: &Checked) -> String {
    let Checked {
        camera,
        views,
        off_px,
        motion,
    } = checked;
    match motion {
        _ if *views == 0 => format!("camera {camera}: it did not see the board"),
        None => format!("camera {camera}: as calibrated, to {off_px:.2} px"),
        Some(motion) => format!(
            "camera {camera}: it moved: the board is {off_px:.2} px off; turned by {:.3}°, shifted by {:.2} mm ({:.2} \
             px are left)",
            motion.turn_degrees,
            1e3 * motion.shift,
            motion.rest_px
        ),
    }
}

fn summary(check: &Check) -> String {
    let names: Vec<&str> = check.unchecked.iter().map(|id| id.as_str()).collect();
    let (who, rest) = match names.as_slice() {
        [] => ("no camera", String::new()),
        names => (
            "no camera that saw the board",
            format!("; not checked: {}", names.join(", ")),
        ),
    };
    let moved: Vec<&str> = check.moved().map(|id| id.as_str()).collect();
    match moved.as_slice() {
        [] => format!("{who} moved{rest}"),
        [one] => format!("camera {one} moved: calibrate the rig anew{rest}"),
        several => format!(
            "cameras {} moved: calibrate the rig anew{rest}",
            several.join(", ")
        ),
    }
}
