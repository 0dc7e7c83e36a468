//! `scand calibrate --check`: whether the rig still is as it was calibrated, in words or JSON.

use super::sight::Sight;
use crate::calibration::RigCalibration;
use crate::calibration::fit::{Checked, Watch, check};
use crate::commands::EXIT_LOST;
use std::process::ExitCode;

/// Checks and tells: 0 if all cameras are where they were, 1 if one moved, 3 if some could not be checked.
pub(super) fn run(
    sight: &Sight,
    known: &RigCalibration,
    watch: &Watch,
    json: bool,
    quiet: bool,
) -> anyhow::Result<ExitCode> {
    let checked = check(&sight.session, known, watch)?;
    let unknown = sight
        .session
        .cameras
        .iter()
        .filter(|c| !known.cameras.contains_key(&c.id));
    let unknown: Vec<String> = unknown.map(|c| c.id.to_string()).collect();
    if json {
        let told = serde_json::json!({ "cameras": checked, "not_in_calibration": unknown, "lost": sight.lost });
        say!("{told:#}");
    } else if !quiet {
        checked.iter().for_each(|c| say!("{}", words(c)));
        unknown
            .iter()
            .for_each(|id| say!("camera {id}: it is not in the calibration"));
        say!("{}", summary(&checked));
    }
    let unchecked =
        checked.iter().any(|c| c.views == 0) || !unknown.is_empty() || !sight.lost.is_empty();
    Ok(match checked.iter().any(|c| c.motion.is_some()) {
        true => ExitCode::FAILURE,
        false if unchecked => ExitCode::from(EXIT_LOST),
        false => ExitCode::SUCCESS,
    })
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

fn summary(checked: &[Checked]) -> String {
    let moved = checked.iter().filter(|c| c.motion.is_some());
    let moved: Vec<&str> = moved.map(|c| c.camera.as_str()).collect();
    match moved.as_slice() {
        [] => "no camera moved".into(),
        [one] => format!("camera {one} moved: calibrate the rig anew"),
        several => format!(
            "cameras {} moved: calibrate the rig anew",
            several.join(", ")
        ),
    }
}
