//! The procedure of calibrating a rig, from recordings of a board to a calibration with its verdict, and of
//! checking which cameras moved since an older one. This room has the steps and their order; `calibration::fit` and
//! `calibration::response` do the computing. Nothing here knows arguments, a console or exit codes, or writes a
//! file.

mod check;
mod depth;
mod detections;
mod error;
mod import;
mod two_pass_fit;

pub use check::{Check, CheckOptions, check};
pub use depth::{Depth, DepthMethod, Table};
pub use detections::{Detections, board, detect_boards, open, open_pictures, shots};
pub use error::{Error, Rejected};
pub use import::{import, load, of_recording};

use crate::calibration::fit::{
    self, CameraDistance, CoverageLimits, Finding, Fit, FittedCamera, Judgement, LeftOut, Limits,
    MeasuredLengths, ScaleWitnessLimits, WitnessReading, diagnose, judge, missing,
    refer_to_findings, witnesses,
};
use crate::calibration::{CalibrationVerdict, DepthResponse, RigCalibration};
use crate::capture::Placements;
use crate::frame::CameraId;
use detections::WITHOUT_COLOR;
use std::collections::BTreeMap;

/// How a session is calibrated.
#[derive(Debug)]
pub struct Options {
    /// How lenses and poses are fitted.
    pub fit: fit::Parameters,
    /// Where the depth cameras' responses come from.
    pub depth: DepthMethod,
    /// Responses that depth cameras keep for which none is found.
    pub responses: BTreeMap<CameraId, DepthResponse>,
    /// What the session should have.
    pub wanted: CoverageLimits,
    /// What the result is judged by.
    pub limits: Limits,
    /// What witnesses of the scale are expected to know.
    pub witnesses: ScaleWitnessLimits,
    /// What was measured by hand.
    pub measured: MeasuredLengths,
}

/// A session that was calibrated.
#[derive(Debug)]
pub struct Outcome {
    /// What the cameras saw.
    pub detections: Detections,
    /// Lenses, poses and placements.
    pub fit: Fit,
    /// What the views that were left out agree on.
    pub findings: Vec<Finding>,
    /// What witnesses say of the scale, which the board's size sets.
    pub scale: Vec<WitnessReading>,
    /// What they are worth.
    pub judgement: Judgement,
    /// What the session lacks, in words.
    pub missing: Vec<String>,
    /// What the depth cameras' readings mean.
    pub depth: Depth,
    /// The calibration as its file holds it.
    pub calibration: RigCalibration,
}

impl Outcome {
    /// Whether a picture, a reading, a view or a camera's depth response was lost on the way.
    pub fn has_lost(&self) -> bool {
        self.has_unread()
            || !self.depth.unfitted.is_empty()
            || self.fit.left_out.iter().any(|l| l.placement.is_none())
    }

    /// Whether a picture or a reading could not be read.
    pub fn has_unread(&self) -> bool {
        !self.detections.lost.is_empty() || !self.depth.lost.is_empty()
    }
}

/// Fits the rig to what its cameras saw in `recordings`, and judges the result.
///
/// # Errors
/// If the views do not determine the rig, or a picture cannot be read any more.
pub fn run(
    mut detections: Detections,
    recordings: &[Placements],
    options: Options,
) -> Result<Outcome, Error> {
    check_measured(&detections, &options.measured)?;
    detections.reject_views_with_few_corners(options.fit.fewest_corners());
    let fitted = two_pass_fit::fit_in_two_passes(&mut detections, recordings, &options.fit)?;
    let mut missing = missing(
        &detections.session,
        fitted.as_ref().ok(),
        &detections.depth_cameras,
        &options.wanted,
    );
    let mut fit = match fitted {
        Ok(fit) => fit,
        Err(cause) => {
            let findings = diagnose(
                &detections.session,
                None,
                &options.fit,
                options.limits.placements,
            );
            let (rejected, views) = (&detections.rejected, detections.session.views.len());
            return Err(Error::unfitted(cause, findings, missing, rejected, views));
        }
    };
    missing.extend(uncompared(&fit.cameras, &options.measured));
    let depth_cameras = &detections.depth_cameras;
    let given = options.responses;
    let depth = depth::fit_responses(options.depth, recordings, &fit, depth_cameras, given);
    let findings = diagnose(
        &detections.session,
        Some(&fit),
        &options.fit,
        options.limits.placements,
    );
    refer_to_findings(&mut fit.left_out, &findings);
    fit.left_out
        .extend(detections.without_color.iter().map(without_color));
    let (slopes, measured) = (depth.slopes(), &options.measured);
    let scale = witnesses(&fit, &slopes, measured, &options.witnesses);
    let judgement = judge(&fit, &findings, &depth.found(), &options.limits);
    let judgement = judgement.with_witnesses(&scale);
    let responses = depth.responses(depth_cameras);
    Ok(Outcome {
        calibration: calibration(&fit, &responses, &judgement),
        detections,
        fit,
        findings,
        scale,
        judgement,
        missing,
        depth,
    })
}

/// That a depth camera could not see the board in any picture.
fn without_color(id: &CameraId) -> LeftOut {
    LeftOut {
        camera: Some(id.clone()),
        placement: None,
        reason: format!("it {WITHOUT_COLOR}: let it record them, too"),
        views: Vec::new(),
        apart: None,
    }
}

/// Refuses distances of cameras that are not in the session.
fn check_measured(detections: &Detections, measured: &MeasuredLengths) -> Result<(), Error> {
    let known = detections.session.cameras.iter().map(|c| &c.id);
    let mut named = measured.distances.iter().flat_map(|d| &d.cameras);
    match named.find(|id| !known.clone().any(|k| k == *id)) {
        None => Ok(()),
        Some(camera) => Err(Error::NoSuchCamera {
            camera: camera.clone(),
            known: known.map(CameraId::as_str).collect::<Vec<_>>().join(", "),
        }),
    }
}

/// The measured distances that say nothing of the scale, because one of their cameras is not calibrated.
fn uncompared(fitted: &[FittedCamera], measured: &MeasuredLengths) -> Vec<String> {
    let is_fitted = |id: &CameraId| fitted.iter().any(|c| c.camera.id == *id);
    let of_distance = |distance: &CameraDistance| {
        let [a, b] = &distance.cameras;
        let (unfitted, other) = match (is_fitted(a), is_fitted(b)) {
            (true, true) => return None,
            (false, _) => (a, b),
            (true, false) => (b, a),
        };
        Some(format!(
            "camera {unfitted}: it is not calibrated, so its measured distance from camera {other} says nothing of the scale"
        ))
    };
    measured.distances.iter().filter_map(of_distance).collect()
}

/// The fit as a calibration file holds it.
fn calibration(
    fit: &Fit,
    responses: &BTreeMap<CameraId, DepthResponse>,
    judgement: &Judgement,
) -> RigCalibration {
    let entry = |c: &FittedCamera| {
        let id = c.camera.id.clone();
        let response = responses.get(&id).copied();
        (id, (c.camera.clone(), response))
    };
    RigCalibration {
        volume: fit.volume,
        // No ruler is known to a thousandth of a millimetre.
        at_object_mm: fit.at_object().map(|m| (1e6 * m).round() / 1e3),
        verdict: Some(CalibrationVerdict {
            level: judgement.level,
            reasons: judgement.reasons.iter().map(|r| r.words.clone()).collect(),
        }),
        cameras: fit.cameras.iter().map(entry).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::fit::Length;

    #[test]
    fn a_distance_of_a_camera_that_is_not_calibrated_is_told() {
        let [a, b] = ["left", "right"].map(|id| CameraId::new(id).unwrap());
        let measured = MeasuredLengths {
            rulers: Vec::new(),
            distances: vec![CameraDistance {
                cameras: [a, b],
                measured: Length {
                    metres: 1.2,
                    deviation: 0.015,
                },
            }],
        };
        let told = "camera left: it is not calibrated, so its measured distance from camera right says nothing of the scale";
        assert_eq!(uncompared(&[], &measured), [told]);
        assert!(uncompared(&[], &MeasuredLengths::default()).is_empty());
    }
}
