//! `scand calibrate --check`: whether the rig still is as it was calibrated, in words or JSON.

use super::sight::Sight;
use crate::calibration::RigCalibration;
use crate::calibration::fit::{Checked, Watch, check};
use crate::commands::EXIT_LOST;
use crate::frame::CameraId;
use std::collections::BTreeSet;
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
    let unchecked = unchecked(sight, known, &checked);
    if json {
        let told = serde_json::json!({
            "cameras": checked,
            "not_in_calibration": unknown,
            "not_checked": unchecked,
            "lost": sight.lost,
        });
        say!("{told:#}");
    } else if !quiet {
        checked.iter().for_each(|c| say!("{}", words(c)));
        unknown
            .iter()
            .for_each(|id| say!("camera {id}: it is not in the calibration"));
        say!("{}", summary(&checked, &unchecked));
    }
    Ok(match checked.iter().any(|c| c.motion.is_some()) {
        true => ExitCode::FAILURE,
        false if !unchecked.is_empty() || !sight.lost.is_empty() => ExitCode::from(EXIT_LOST),
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

/// Cameras of the calibration and of the session that did not see the board or are not in both.
fn unchecked<'a>(
    sight: &'a Sight,
    known: &'a RigCalibration,
    checked: &[Checked],
) -> BTreeSet<&'a CameraId> {
    let of_session = sight.session.cameras.iter().map(|c| &c.id);
    let seeing = |id: &CameraId| checked.iter().any(|c| c.camera == *id && c.views > 0);
    let all = known.cameras.keys().chain(of_session);
    all.filter(|id| !seeing(id)).collect()
}

fn summary(checked: &[Checked], unchecked: &BTreeSet<&CameraId>) -> String {
    let names: Vec<&str> = unchecked.iter().map(|id| id.as_str()).collect();
    let (who, rest) = match names.as_slice() {
        [] => ("no camera", String::new()),
        names => (
            "no camera that saw the board",
            format!("; not checked: {}", names.join(", ")),
        ),
    };
    let moved = checked.iter().filter(|c| c.motion.is_some());
    let moved: Vec<&str> = moved.map(|c| c.camera.as_str()).collect();
    match moved.as_slice() {
        [] => format!("{who} moved{rest}"),
        [one] => format!("camera {one} moved: calibrate the rig anew{rest}"),
        several => format!(
            "cameras {} moved: calibrate the rig anew{rest}",
            several.join(", ")
        ),
    }
}
