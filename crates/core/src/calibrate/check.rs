//! Checks whether the rig still matches its calibration: its cameras, and what its depth cameras read.

use super::depth::{BoardView, views};
use super::detections::WITHOUT_COLOR;
use super::{Detections, Error};
use crate::calibration::fit::{self, CheckedCamera, DriftLimits, DriftResult, PairMotion};
use crate::calibration::response::{
    DepthCheck, DepthTolerance, PlaneParameters, PlaneView, check_depth,
};
use crate::calibration::{Camera, DepthResponse, RigCalibration};
use crate::capture::Placements;
use crate::frame::CameraId;
use std::collections::{BTreeMap, BTreeSet};

/// What a check allows for.
#[derive(Clone, Debug)]
pub struct CheckOptions {
    /// When a camera counts as moved, and a depth camera as changed.
    pub watch: DriftLimits,
    /// How far a board is expected to be bent.
    pub fit: fit::Parameters,
    /// How boards are read in depth.
    pub plane: PlaneParameters,
    /// What may be left of a depth camera's readings when it is calibrated, in millimetres.
    pub depth_bias_mm: f64,
}

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
    /// Cameras that did not see the board, saw it only where no other did, or are not in both.
    pub unchecked: BTreeSet<CameraId>,
    /// Cameras of these that saw the board, or a side of it, but only where no other camera saw it.
    pub alone: BTreeSet<CameraId>,
    /// Whether it counts as unchecked if boards do not show whether depth lies on its colour picture.
    wants_registration: bool,
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
        depths
            .filter_map(|(id, found)| found.as_ref().is_ok_and(DepthCheck::is_other).then_some(id))
    }

    /// Whether everything that could have changed was checked.
    pub fn is_whole(&self) -> bool {
        let is_checked = |found: &Result<DepthCheck, String>| match self.wants_registration {
            true => found.as_ref().is_ok_and(DepthCheck::shows_registration),
            false => found.is_ok(),
        };
        self.unchecked.is_empty() && self.lost.is_empty() && self.depths.values().all(is_checked)
    }
}

/// Checks the cameras of a session against `known`.
///
/// # Errors
/// If it is another board, or half of three or more cameras disagree.
pub fn check(
    detections: &Detections,
    recordings: &[Placements],
    known: &RigCalibration,
    options: &CheckOptions,
) -> Result<Check, Error> {
    let session = &detections.session;
    let found = fit::check(session, known, &options.watch, &options.fit)?;
    let of_session = session.cameras.iter().map(|c| &c.id);
    let seeing = |id: &CameraId| found.cameras.iter().any(|c| c.camera == *id && c.views > 0);
    let is_checked = |id: &CameraId| seeing(id) && !found.alone.contains(id);
    let all = known.cameras.keys().chain(of_session.clone());
    let mut lost = Vec::new();
    let depths = depths(detections, recordings, known, &found, options, &mut lost);
    Ok(Check {
        unchecked: all.filter(|id| !is_checked(id)).cloned().collect(),
        unknown: of_session
            .filter(|id| !known.cameras.contains_key(*id))
            .cloned()
            .collect(),
        depths,
        lost,
        wants_registration: options.watch.registration,
        alone: found.alone,
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
    options: &CheckOptions,
    lost: &mut Vec<String>,
) -> BTreeMap<CameraId, Result<DepthCheck, String>> {
    let mut found = BTreeMap::new();
    for (id, (camera, response)) in &known.cameras {
        let is_read = detections.depth_cameras.contains(id);
        let checked = match (is_read, response) {
            (false, None) => continue,
            (true, None) => Err("the calibration has no depth response for it".into()),
            (false, Some(_)) if detections.without_color.contains(id) => {
                Err(format!("it {WITHOUT_COLOR}"))
            }
            (false, Some(_)) => Err("the recording has no depth frames from it".into()),
            (true, Some(response)) => {
                let now = camera_now(checks, camera);
                let known = (&now, response);
                against(detections, recordings, checks, known, options, lost)
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
    options: &CheckOptions,
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
    let tolerance = DepthTolerance {
        off: 1e-3 * options.watch.depth_mm,
        misfit: 1e-3 * options.depth_bias_mm,
        plane: &options.plane,
    };
    check_depth(&camera.intrinsics, board, &views, response, tolerance)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::fit::Session;
    use crate::calibration::response::{DepthDeviation, TooFewBoards};
    use crate::calibration::{Board, Distortion, Intrinsics};
    use nalgebra::{Isometry3, Vector2};

    #[test]
    fn a_depth_camera_that_is_not_checked_is_told_with_the_reason() {
        let board = Board::checkerboard(9, 6, 0.025).unwrap();
        let session = Session {
            board,
            cameras: Vec::new(),
            placements: Vec::new(),
            views: Vec::new(),
        };
        let lens = Intrinsics::new(
            640,
            480,
            Vector2::repeat(575.0),
            Vector2::new(319.5, 239.5),
            Distortion::default(),
        );
        let id = CameraId::new("kinect").unwrap();
        let camera = Camera::new(id.clone(), lens.unwrap(), Isometry3::identity());
        let known = RigCalibration {
            cameras: BTreeMap::from([(id.clone(), (camera, Some(DepthResponse::default())))]),
            ..RigCalibration::default()
        };
        let options = CheckOptions {
            watch: DriftLimits::default(),
            fit: fit::Parameters::default(),
            plane: PlaneParameters::default(),
            depth_bias_mm: 1.0,
        };
        let checks = DriftResult {
            cameras: Vec::new(),
            alone: BTreeSet::new(),
            against_each_other: None,
            rig_from_board: Vec::new(),
            rig_from_camera: Vec::new(),
            front_from_back: Isometry3::identity(),
        };
        let told = |without_color: &[CameraId]| {
            let detections = Detections {
                session: session.clone(),
                depth_cameras: Vec::new(),
                without_color: without_color.iter().cloned().collect(),
                rejected: Vec::new(),
                lost: Vec::new(),
                warnings: Vec::new(),
            };
            let mut lost = Vec::new();
            let found = depths(&detections, &[], &known, &checks, &options, &mut lost);
            found[&id].clone().unwrap_err()
        };
        let words = "it has no colour pictures, in which the board could be found";
        assert_eq!(told(std::slice::from_ref(&id)), words);
        assert_eq!(told(&[]), "the recording has no depth frames from it");
    }

    #[test]
    fn a_check_is_whole_only_if_boards_enough_show_where_depth_lies_in_its_picture() {
        let deviation = DepthDeviation {
            placement: "p0".into(),
            distance: 1.0,
            off: 0.001,
            allowed: 0.005,
        };
        let check = |found: usize, is_displacement_hidden: bool, wants_registration: bool| {
            let needed = 5;
            let depth = DepthCheck {
                placements: vec![deviation.clone()],
                worst: deviation.clone(),
                is_off: false,
                misfit: None,
                too_few_for_misfit: (found < needed).then_some(TooFewBoards { found, needed }),
                is_displacement_hidden,
            };
            let check = Check {
                cameras: Vec::new(),
                against_each_other: None,
                depths: BTreeMap::from([(CameraId::new("kinect").unwrap(), Ok(depth))]),
                unknown: Vec::new(),
                unchecked: BTreeSet::new(),
                alone: BTreeSet::new(),
                wants_registration,
                lost: Vec::new(),
            };
            assert_eq!(check.misread_cameras().next(), None);
            check.is_whole()
        };
        assert!(!check(1, false, true));
        assert!(check(1, false, false));
        assert!(check(5, false, true));
        assert!(!check(5, true, true));
        assert!(check(5, true, false));
    }
}
