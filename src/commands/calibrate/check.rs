//! `scand calibrate --check`: reports whether the rig still matches its calibration, as text or JSON.

use crate::calibrate::{Check, Detections};
use crate::calibration::fit::{CheckedCamera, Motion, PairMotion};
use crate::calibration::response::{DepthCheck, DepthDeviation, TooFewBoards};
use crate::commands::EXIT_INCOMPLETE;
use crate::frame::CameraId;
use std::process::ExitCode;

/// Prints a check: 0 if all is as it was, 1 if a camera moved or a depth camera reads something else, 3 if some could
/// not be checked.
pub(super) fn print(check: &Check, detections: &Detections, json: bool, quiet: bool) -> ExitCode {
    if json {
        let depth = |(id, found): (&CameraId, &Result<DepthCheck, String>)| {
            let told = match found {
                Ok(found) => serde_json::json!(found),
                Err(reason) => serde_json::json!({ "not_checked": reason }),
            };
            (id.to_string(), told)
        };
        let depths: serde_json::Map<_, _> = check.depths.iter().map(depth).collect();
        let lost: Vec<&String> = detections.lost.iter().chain(&check.lost).collect();
        let told = serde_json::json!({
            "cameras": check.cameras,
            "moved_against_each_other": check.against_each_other,
            "depth": depths,
            "not_in_calibration": check.unknown,
            "not_checked": check.unchecked,
            "alone": check.alone,
            "lost": lost,
            "warnings": detections.warnings,
        });
        outln!("{told:#}");
    } else if !quiet {
        let cameras = check.cameras.iter();
        cameras.for_each(|c| outln!("{}", words(c, check.alone.contains(&c.camera))));
        let depths = check.depths.iter();
        depths.for_each(|(id, found)| outln!("depth camera {id}: {}", depth_words(found)));
        check
            .unknown
            .iter()
            .for_each(|id| outln!("camera {id}: it is not in the calibration"));
        outln!("{}", summary(check));
    }
    let is_other = check.moved().next().is_some()
        || check.against_each_other.is_some()
        || check.misread_cameras().next().is_some();
    match is_other {
        true => ExitCode::FAILURE,
        false if !check.is_whole() || !detections.lost.is_empty() => {
            ExitCode::from(EXIT_INCOMPLETE)
        }
        false => ExitCode::SUCCESS,
    }
}

fn depth_words(found: &Result<DepthCheck, String>) -> String {
    let found = match found {
        Ok(found) => found,
        Err(reason) => return format!("its depth was not checked: {reason}"),
    };
    let DepthDeviation { distance, off, .. } = &found.worst;
    let words = match found.is_off {
        true => format!(
            "reads {:.0} mm too {} at {distance:.1} m: calibrate it again",
            1e3 * off.abs(),
            if *off > 0.0 { "deep" } else { "near" }
        ),
        false => format!(
            "reads as calibrated, to {:.1} mm at {distance:.1} m",
            1e3 * off.abs()
        ),
    };
    words + &misfit_words(found).unwrap_or_default()
}

/// What readings have that a response cannot have, or why that was not checked.
fn misfit_words(found: &DepthCheck) -> Option<String> {
    if let Some(TooFewBoards { found, needed }) = found.too_few_for_misfit {
        return Some(format!(
            "; whether its depth lies on its colour picture (registration) was not checked: it takes boards at {needed} \
             places, and there were {found}"
        ));
    }
    if found.is_displacement_hidden && found.misfit.is_none() {
        return Some(
            "; whether its depth lies on its colour picture (registration) was not checked: its boards are tilted too \
             little, or too much alike, to show it beyond the uncertainty of its calibration"
                .into(),
        );
    }
    if let Some([x, y]) = found.beside_px() {
        return Some(format!(
            "; its depth is displaced against its colour picture by {x:+.1} px in x and {y:+.1} px in y: register them again, \
             and calibrate it"
        ));
    }
    let misfit = found.misfit.as_ref()?;
    Some(format!(
        "; its readings are {:.1} mm off boards at 1 m (rms) in a way that it was not calibrated for; {}",
        1e3 * misfit.held_out,
        misfit.words()
    ))
}

fn words(checked: &CheckedCamera, is_alone: bool) -> String {
    let CheckedCamera {
        camera,
        views,
        off_px,
        motion,
    } = checked;
    match motion {
        _ if *views == 0 => format!("camera {camera}: it did not see the board"),
        _ if is_alone => format!(
            "camera {camera}: it saw the board, or a side of it, only where no other camera did, so it is not known \
             whether it moved"
        ),
        None => format!("camera {camera}: it is as calibrated, to {off_px:.2} px"),
        Some(motion) => format!(
            "camera {camera}: it moved: the board is {off_px:.2} px off; turned by {:.3}°, shifted by {:.2} mm ({:.2} \
             px are left)",
            motion.turn_degrees,
            1e3 * motion.shift,
            motion.rest_px
        ),
    }
}

/// What moved two cameras against each other, or seems to.
fn pair_words(pair: &PairMotion) -> String {
    let [first, second] = &pair.cameras;
    let Motion {
        turn_degrees,
        shift,
        ..
    } = pair.motion;
    let other = pair.board_larger.map(|larger| {
        format!(
            ", or the board is {:.1} % {} than stated",
            100.0 * larger.abs(),
            if larger > 0.0 { "larger" } else { "smaller" }
        )
    });
    format!(
        "cameras {first} and {second} moved against each other, by {turn_degrees:.3}° and {:.2} mm if {first} stayed{}: \
         calibrate the rig again",
        1e3 * shift,
        other.unwrap_or_default()
    )
}

fn summary(check: &Check) -> String {
    let names: Vec<&str> = check.unchecked.iter().map(|id| id.as_str()).collect();
    let is_compared = |c: &&CheckedCamera| !check.unchecked.contains(&c.camera);
    let compared = check.cameras.iter().filter(is_compared).count();
    let (who, rest) = match names.as_slice() {
        [] => ("no camera", String::new()),
        names => (
            "no camera that saw the board",
            format!("; not checked: {}", names.join(", ")),
        ),
    };
    let moved: Vec<&str> = check.moved().map(|id| id.as_str()).collect();
    match (&check.against_each_other, moved.as_slice()) {
        (Some(pair), _) => pair_words(pair) + &rest,
        (None, []) if compared == 0 => format!(
            "it is not known whether a camera moved: no two cameras of the calibration saw the board at one place{rest}"
        ),
        (None, []) => format!("{who} moved{rest}"),
        (None, [one]) => format!("camera {one} moved: calibrate the rig again{rest}"),
        (None, several) => format!(
            "cameras {} moved: calibrate the rig again{rest}",
            several.join(", ")
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::response::{Cause, Misfit};

    fn depth(off: f64, is_off: bool) -> DepthCheck {
        let deviation = DepthDeviation {
            placement: "p01".into(),
            distance: 1.0,
            off,
            allowed: 0.005,
        };
        DepthCheck {
            placements: vec![deviation.clone()],
            worst: deviation,
            is_off,
            misfit: None,
            too_few_for_misfit: None,
            is_displacement_hidden: false,
        }
    }

    #[test]
    fn what_a_depth_camera_reads_is_told_with_its_distance() {
        for (off, is_off, words) in [
            (
                0.03,
                true,
                "reads 30 mm too deep at 1.0 m: calibrate it again",
            ),
            (
                -0.012,
                true,
                "reads 12 mm too near at 1.0 m: calibrate it again",
            ),
            (0.0012, false, "reads as calibrated, to 1.2 mm at 1.0 m"),
        ] {
            assert_eq!(depth_words(&Ok(depth(off, is_off))), words);
        }
        let unseen = depth_words(&Err("it did not see the board".into()));
        assert_eq!(
            unseen,
            "its depth was not checked: it did not see the board"
        );
    }

    #[test]
    fn registration_is_told_or_why_it_was_not_checked() {
        let too_few = DepthCheck {
            too_few_for_misfit: Some(TooFewBoards {
                found: 1,
                needed: 5,
            }),
            ..depth(0.001, false)
        };
        let words = depth_words(&Ok(too_few));
        let expected =
            "(registration) was not checked: it takes boards at 5 places, and there were 1";
        assert!(words.ends_with(expected), "{words}");
        let hidden = DepthCheck {
            is_displacement_hidden: true,
            ..depth(0.001, false)
        };
        let words = depth_words(&Ok(hidden));
        let expected = "(registration) was not checked: its boards are tilted too little, or too much alike, to show it \
            beyond the uncertainty of its calibration";
        assert!(words.ends_with(expected), "{words}");
        let misfit = |causes| DepthCheck {
            misfit: Some(Misfit {
                held_out: 0.003,
                explained: 0.0003,
                causes,
                part: None,
            }),
            ..depth(0.001, false)
        };
        let displaced = Cause::Misregistered([6.0, -1.0]);
        let words = depth_words(&Ok(misfit(vec![displaced])));
        let expected = "is displaced against its colour picture by +6.0 px in x and -1.0 px in y";
        assert!(words.contains(expected), "{words}");
        // If another cause would do nearly as well, both are told.
        let words = depth_words(&Ok(misfit(vec![displaced, Cause::Bowl(0.012)])));
        assert!(
            words.contains("+6.0 px in x") && words.contains("its corners"),
            "{words}"
        );
    }

    #[test]
    fn two_cameras_that_moved_against_each_other_are_told_with_what_else_it_may_be() {
        let pair = |board_larger| PairMotion {
            cameras: ["left", "right"].map(|id| CameraId::new(id).unwrap()),
            motion: Motion {
                turn_degrees: 0.3,
                shift: 0.0012,
                rest_px: 0.1,
            },
            board_larger,
        };
        let words = pair_words(&pair(None));
        let expected = "cameras left and right moved against each other, by 0.300° and 1.20 mm if left stayed: \
                        calibrate the rig again";
        assert_eq!(words, expected);
        let words = pair_words(&pair(Some(-0.04)));
        assert!(
            words.contains(", or the board is 4.0 % smaller than stated"),
            "{words}"
        );
    }
}
