//! Checks whether the rig still matches its calibration: its cameras, and what its depth cameras read.

use super::depth::{BoardView, views};
use super::{Detections, Error};
use crate::calibration::fit::{self, CheckedCamera, DriftLimits, DriftResult, PairMotion};
use crate::calibration::response::{DepthCheck, PlaneView, check_depth};
use crate::calibration::{Camera, DepthResponse, RigCalibration};
use crate::capture::Placements;
use crate::frame::CameraId;
use std::collections::{BTreeMap, BTreeSet};

/// A rig, camera by camera, against its calibration.
#[derive(Debug)]
pub struct Check {
    /// Cameras of the calibration that were in the session.
    pub cameras: Vec<CheckedCamera>,
    /// How two cameras moved against each other, if no third camera shows which of them moved.
    pub against_each_other: Option<PairMotion>,
    /// What the depth cameras of the calibration read, or why that was not checked.
    pub depths: BTreeMap<CameraId, Result<DepthCheck, String>>,
    /// Cameras of the session that the calibration does not have.
    pub unknown: Vec<CameraId>,
    /// Cameras that did not see the board, or are not in both.
    pub unchecked: BTreeSet<CameraId>,
    /// What could not be read of depth.
    pub lost: Vec<String>,
}

impl Check {
    /// Cameras that are not where they were.
    pub fn moved(&self) -> impl Iterator<Item = &CameraId> {
        let moved = self.cameras.iter().filter(|c| c.motion.is_some());
        moved.map(|c| &c.camera)
    }

    /// Depth cameras that do not read what they did.
    pub fn misread_cameras(&self) -> impl Iterator<Item = &CameraId> {
        let depths = self.depths.iter();
        depths.filter_map(|(id, found)| {
            let found = found.as_ref().ok()?;
            (found.is_off || found.beside_px.is_some()).then_some(id)
        })
    }

    /// Whether everything that could have changed was checked.
    pub fn is_whole(&self) -> bool {
        self.unchecked.is_empty() && self.lost.is_empty() && self.depths.values().all(Result::is_ok)
    }
}

/// Checks the cameras of a session against `known`.
///
/// # Errors
/// If fewer than two cameras saw the board, it is another board, or half of three or more cameras disagree.
pub fn check(
    detections: &Detections,
    recordings: &[Placements],
    known: &RigCalibration,
    watch: &DriftLimits,
) -> Result<Check, Error> {
    let session = &detections.session;
    let found = fit::check(session, known, watch)?;
    let of_session = session.cameras.iter().map(|c| &c.id);
    let seeing = |id: &CameraId| found.cameras.iter().any(|c| c.camera == *id && c.views > 0);
    let all = known.cameras.keys().chain(of_session.clone());
    let mut lost = Vec::new();
    let depths = depths(detections, recordings, known, &found, watch, &mut lost);
    Ok(Check {
        unchecked: all.filter(|id| !seeing(id)).cloned().collect(),
        unknown: of_session
            .filter(|id| !known.cameras.contains_key(*id))
            .cloned()
            .collect(),
        depths,
        lost,
        cameras: found.cameras,
        against_each_other: found.against_each_other,
    })
}

/// Each depth camera of the calibration that has a response, or is in the session as one.
fn depths(
    detections: &Detections,
    recordings: &[Placements],
    known: &RigCalibration,
    checks: &DriftResult,
    watch: &DriftLimits,
    lost: &mut Vec<String>,
) -> BTreeMap<CameraId, Result<DepthCheck, String>> {
    let mut found = BTreeMap::new();
    for (id, (camera, response)) in &known.cameras {
        let is_read = detections.depth_cameras.contains(id);
        let checked = match (is_read, response) {
            (false, None) => continue,
            (true, None) => Err("the calibration has no depth response for it".into()),
            (false, Some(_)) => Err("the recording has no depth frames from it".into()),
            (true, Some(response)) => {
                let now = camera_now(checks, camera);
                against(
                    detections,
                    recordings,
                    checks,
                    (&now, response),
                    watch,
                    lost,
                )
            }
        };
        found.insert(id.clone(), checked);
    }
    found
}

/// A camera where it is now: a depth camera that moved may still read what it did.
fn camera_now(checks: &DriftResult, known: &Camera) -> Camera {
    let cameras = checks.cameras.iter().zip(&checks.rig_from_camera);
    let mut own = cameras.filter(|(checked, _)| checked.camera == known.id);
    let pose = own.next().map_or(known.rig_from_camera, |(_, pose)| *pose);
    Camera::new(known.id.clone(), known.intrinsics, pose)
}

fn against(
    detections: &Detections,
    recordings: &[Placements],
    checks: &DriftResult,
    (camera, response): (&Camera, &DepthResponse),
    watch: &DriftLimits,
    lost: &mut Vec<String>,
) -> Result<DepthCheck, String> {
    let session = &detections.session;
    let camera_from_front = |name: &str| {
        let placement = session.placements.iter().position(|p| p == name)?;
        let rig_from_board = checks.rig_from_board.get(placement).copied()??;
        Some(camera.rig_from_camera.inverse() * rig_from_board)
    };
    let (board, back) = (&session.board, checks.front_from_back);
    let views = views(
        recordings,
        &camera.id,
        board,
        back,
        &camera_from_front,
        lost,
    );
    let views: Vec<PlaneView<'_>> = views.iter().map(BoardView::plane).collect();
    let most = 1e-3 * watch.depth_mm;
    check_depth(&camera.intrinsics, board, &views, response, most)
}
