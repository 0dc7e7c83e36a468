//! Calibrating a rig, from recordings of a board to a calibration and what it is worth, or to the cameras that moved
//! since an older one. The steps and their order stand here; what they compute is in `calibration::fit` and
//! `calibration::response`. Nothing here knows arguments, a console or exit codes, or writes a file.

mod check;
mod depth;
mod detections;
mod error;
mod import;
mod two_pass_fit;

pub use check::{Check, check};
pub use depth::{Depth, DepthMethod, Table};
pub use detections::{Detections, board, detect_boards, open};
pub use error::{Error, Rejected};
pub use import::{import, load, of_recording};

use crate::calibration::fit::{
    self, Finding, Fit, FittedCamera, Judgement, Limits, Wanted, diagnose, judge, missing,
};
use crate::calibration::{DepthResponse, RigCalibration, Verdict};
use crate::capture::Placements;
use crate::frame::CameraId;
use std::collections::BTreeMap;

/// How a session is calibrated.
#[derive(Debug)]
pub struct Options {
    /// How lenses and poses are fitted.
    pub fit: fit::Parameters,
    /// Where the depth cameras' responses come from.
    pub depth: DepthMethod,
    /// Responses of depth cameras for which none is found.
    pub responses: BTreeMap<CameraId, DepthResponse>,
    /// What the session should have.
    pub wanted: Wanted,
    /// What the result is judged by.
    pub limits: Limits,
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
    let fitted = two_pass_fit::fit_in_two_passes(&mut detections, recordings, &options.fit)?;
    let missing = missing(
        &detections.session,
        fitted.as_ref().ok(),
        &detections.depth_cameras,
        &options.wanted,
    );
    let fit = match fitted {
        Ok(fit) => fit,
        Err(cause) => {
            let findings = diagnose(&detections.session, None, &options.fit);
            let rejected = &detections.rejected;
            return Err(Error::unfitted(cause, findings, missing, rejected));
        }
    };
    let depth = depth::respond(options.depth, recordings, &fit, &detections.depth_cameras);
    let findings = diagnose(&detections.session, Some(&fit), &options.fit);
    let judgement = judge(&fit, &findings, &depth.found(), &options.limits);
    let mut responses = options.responses;
    let found = detections.depth_cameras.iter();
    responses.extend(found.filter_map(|id| Some((id.clone(), depth.response(id)?))));
    Ok(Outcome {
        calibration: calibration(&fit, &responses, &judgement),
        detections,
        fit,
        findings,
        judgement,
        missing,
        depth,
    })
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
        verdict: Some(Verdict {
            level: judgement.level,
            reasons: judgement.reasons.clone(),
        }),
        cameras: fit.cameras.iter().map(entry).collect(),
    }
}
