//! Whether the rig still is as it was calibrated.

use super::{Detections, Error};
use crate::calibration::RigCalibration;
use crate::calibration::fit::{self, Checked, Watch};
use crate::frame::CameraId;
use std::collections::BTreeSet;

/// A rig, camera by camera, against its calibration.
#[derive(Debug)]
pub struct Check {
    /// Cameras of the calibration that were in the session.
    pub cameras: Vec<Checked>,
    /// Cameras of the session that the calibration does not have.
    pub unknown: Vec<CameraId>,
    /// Cameras that did not see the board, or are not in both.
    pub unchecked: BTreeSet<CameraId>,
}

impl Check {
    /// Cameras that are not where they were.
    pub fn moved(&self) -> impl Iterator<Item = &CameraId> {
        let moved = self.cameras.iter().filter(|c| c.motion.is_some());
        moved.map(|c| &c.camera)
    }
}

/// Checks the cameras of a session against `known`.
///
/// # Errors
/// If fewer than three cameras saw the board, or half of them and more disagree.
pub fn check(
    detections: &Detections,
    known: &RigCalibration,
    watch: &Watch,
) -> Result<Check, Error> {
    let cameras = fit::check(&detections.session, known, watch)?;
    let of_session = detections.session.cameras.iter().map(|c| &c.id);
    let seeing = |id: &CameraId| cameras.iter().any(|c| c.camera == *id && c.views > 0);
    let all = known.cameras.keys().chain(of_session.clone());
    Ok(Check {
        unchecked: all.filter(|id| !seeing(id)).cloned().collect(),
        unknown: of_session
            .filter(|id| !known.cameras.contains_key(*id))
            .cloned()
            .collect(),
        cameras,
    })
}
