//! Tests whether a board of another size than the stated one explains what the cameras of a calibrated rig see.

use super::Parameters;
use super::adjust::Bundle;
use super::as_calibrated::{off_px, start};
use super::lens::Lens;
use super::planar;
use super::session::Session;
use crate::calibration::Camera;
use nalgebra::{Point3, Vector3};

/// Share by which a board's size must differ from the stated one.
const LEAST: f64 = 0.005;
/// Step in which the size is refined, as a part of it.
const STEP: f64 = 0.002;

/// A board of another size than the stated one.
pub(super) struct OtherSize {
    /// By what share it is larger.
    pub larger: f64,
    /// The largest root mean square in pixels that it leaves of a camera.
    pub left_px: f64,
}

/// The size that the board would have to be of so that no camera is off by more than `most_px`; `None` if no other size
/// does that.
pub(super) fn explaining(
    session: &Session,
    cameras: &[Camera],
    parameters: &Parameters,
    most_px: f64,
) -> Option<OtherSize> {
    let rough = by_rays(session, cameras)?;
    if !(0.2..=5.0).contains(&rough) {
        return None;
    }
    // A bend that is free would flatten the minimum.
    let flat = |times: f64| off(&started(session, cameras, parameters, times, false));
    let costs = [rough - STEP, rough, rough + STEP].map(flat);
    let squares = costs.map(|c| c * c);
    let curve = squares[0] - 2.0 * squares[1] + squares[2];
    let step = match curve > 0.0 {
        true => (0.5 * (squares[0] - squares[2]) / curve).clamp(-1.0, 1.0),
        false => 0.0,
    };
    let times = rough + STEP * step;
    if (times - 1.0).abs() <= LEAST {
        return None;
    }
    let left_px = off(&started(session, cameras, parameters, times, true));
    let larger = times - 1.0;
    (left_px <= most_px).then_some(OtherSize { larger, left_px })
}

/// How many times as large the board must be for the cameras' lines of sight to its middle to meet: each camera by
/// itself sees it the farther away, the larger it is.
fn by_rays(session: &Session, cameras: &[Camera]) -> Option<f64> {
    let board = &session.board;
    let last = board.corner_position(board.columns - 1, board.rows - 1);
    let middle = nalgebra::center(&board.corner_position(0, 0), &last);
    let mut seen: Vec<Vec<(Point3<f64>, Vector3<f64>)>> =
        vec![Vec::new(); session.placements.len()];
    for view in &session.views {
        let camera = &cameras[view.camera];
        let lens = Lens::from_intrinsics(&camera.intrinsics);
        if let Some(pose) = planar::pose(&lens, &view.pairs(board)) {
            let to_middle = camera.rig_from_camera * (pose.camera_from_plane * middle).coords;
            seen[view.placement].push((camera.center(), to_middle));
        }
    }
    let (mut along, mut squares) = (0.0, 0.0);
    for views in &seen {
        for (index, (center, to_middle)) in views.iter().enumerate() {
            for (other_center, other_to_middle) in &views[index + 1..] {
                let (apart, between) = (center - other_center, to_middle - other_to_middle);
                along -= apart.dot(&between);
                squares += between.norm_squared();
            }
        }
    }
    (squares > 0.0).then(|| along / squares)
}

/// The board where the cameras see it if it is `times` as large, and bent as its parameters expect, or flat.
fn started(
    session: &Session,
    cameras: &[Camera],
    parameters: &Parameters,
    times: f64,
    may_be_bent: bool,
) -> Bundle {
    let mut scaled = session.clone();
    scaled.board.square *= times;
    let mut bundle = start(scaled, cameras, parameters);
    bundle.sheet.free.fill(may_be_bent);
    bundle.adjust_robustly(4);
    bundle
}

/// The largest root mean square of a camera's residuals.
fn off(bundle: &Bundle) -> f64 {
    let seen = (0..bundle.cameras.len()).filter(|&c| bundle.views.iter().any(|v| v.camera == c));
    seen.map(|c| off_px(bundle, c)).fold(0.0, f64::max)
}
