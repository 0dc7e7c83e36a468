//! Lists what a session still lacks, as instructions to the person who holds the board.

use super::result::Fit;
use super::session::Session;
use crate::calibration::Camera;
use crate::frame::CameraId;
use crate::range;
use crate::words::count;
use nalgebra::{Point2, Vector3};
use std::collections::BTreeSet;

/// What a session needs for a calibration.
#[derive(serde::Deserialize, serde::Serialize, Clone, Debug, PartialEq)]
#[serde(deny_unknown_fields, default)]
pub struct CoverageLimits {
    /// Views of each camera.
    /// Default 6, range 0 to 1000.
    #[serde(deserialize_with = "range::count::<_, _, 0, 1000>")]
    pub views: usize,
    /// Placements that each camera shares with the camera with which it shares most.
    /// Default 4, range 0 to 1000.
    #[serde(deserialize_with = "range::count::<_, _, 0, 1000>")]
    pub shared: usize,
    /// Distances from a depth camera, in metres, between which the board should be seen. Default 0.7 to 1.3.
    #[serde(deserialize_with = "range::each_within::<_, 0, 20>")]
    pub depths: [f64; 2],
    /// Length of the steps in which these distances should be seen, in metres.
    /// Default 0.15, range 0.01 to 20.
    #[serde(deserialize_with = "range::at_least_a_hundredth::<_, _, 20>")]
    pub depth_step: f64,
    /// Tilts against a depth camera, in degrees: it should see the board tilted by at most the first, and by at least
    /// the second. Default 15, 35.
    #[serde(deserialize_with = "range::each_within::<_, 0, 90>")]
    pub tilts_degrees: [f64; 2],
}

impl Default for CoverageLimits {
    fn default() -> Self {
        Self {
            views: 6,
            shared: 4,
            depths: [0.7, 1.3],
            depth_step: 0.15,
            tilts_degrees: [15.0, 35.0],
        }
    }
}

impl CoverageLimits {
    /// Refuses values that contradict each other.
    ///
    /// # Errors
    /// The first value out of its range: its field, the value, and the range.
    pub fn checked(&self) -> Result<(), String> {
        let [near, far] = self.depths;
        match near <= far {
            true => Ok(()),
            false => Err(format!("depths is {near}, expected 0 to {far}")),
        }
    }
}

const PARTS: [[&str; 3]; 3] = [
    ["top left", "top", "top right"],
    ["left", "middle", "right"],
    ["bottom left", "bottom", "bottom right"],
];

/// What a session lacks: of each camera, parts of its picture (where a fit knows the table, those above it) and views;
/// of pairs of cameras, shared views; and of the depth cameras named, distances and tilts, which need a fit to be
/// known.
pub fn missing(
    session: &Session,
    fit: Option<&Fit>,
    depth_cameras: &[CameraId],
    wanted: &CoverageLimits,
) -> Vec<String> {
    let mut found = Vec::new();
    for camera in 0..session.cameras.len() {
        found.extend(of_camera(session, camera, fit, wanted));
    }
    if fit.is_none() {
        found.extend(unseen_placements(session));
    }
    found.extend(of_pairs(session, wanted));
    for id in depth_cameras {
        found.extend(fit.into_iter().flat_map(|fit| of_depth(fit, id, wanted)));
    }
    found
}

fn of_camera(
    session: &Session,
    camera: usize,
    fit: Option<&Fit>,
    wanted: &CoverageLimits,
) -> Vec<String> {
    let subject = &session.cameras[camera];
    let views: Vec<_> = session
        .views
        .iter()
        .filter(|v| v.camera == camera)
        .collect();
    if views.is_empty() {
        return vec![format!("camera {}: it has not seen the board", subject.id)];
    }
    let mut found = Vec::new();
    if views.len() < wanted.views {
        let words = "views of the board";
        found.push(format!(
            "camera {}: it has {} {words}, expected {} or more",
            subject.id,
            views.len(),
            wanted.views
        ));
    }
    let mut seen = [[false; 3]; 3];
    for corner in views.iter().flat_map(|v| &v.corners) {
        let part = |at: f64, side: usize| (at.max(0.0) / side as f64 * 3.0).min(2.0) as usize;
        seen[part(corner.pixel.y, subject.size[1])][part(corner.pixel.x, subject.size[0])] = true;
    }
    let below = fit.map_or([[false; 3]; 3], |fit| below_the_table(fit, &subject.id));
    let cells = (0..9)
        .map(|i| (i / 3, i % 3))
        .filter(|&(row, column)| !seen[row][column] && !below[row][column]);
    let parts: Vec<&str> = cells.map(|(row, column)| PARTS[row][column]).collect();
    if !parts.is_empty() {
        let words = "the board has not been in these parts of its picture";
        found.push(format!(
            "camera {}: {words}: {}",
            subject.id,
            parts.join(", ")
        ));
    }
    found
}

/// The parts of a camera's picture whose lines of sight meet the table before they come as far as the board has been:
/// the board cannot be shown there.
fn below_the_table(fit: &Fit, id: &CameraId) -> [[bool; 3]; 3] {
    let Some(index) = fit.cameras.iter().position(|c| c.camera.id == *id) else {
        return Default::default();
    };
    let camera = &fit.cameras[index].camera;
    let (last_column, last_row) = (fit.board.columns - 1, fit.board.rows - 1);
    let extremes = [
        (0, 0),
        (last_column, 0),
        (0, last_row),
        (last_column, last_row),
    ];
    let seen = fit.views.iter().filter(|v| v.camera == index);
    let nearest = seen
        .flat_map(|v| {
            let rig_from_board = fit.placements[v.placement].rig_from_board;
            extremes.map(|(c, r)| rig_from_board * fit.board.corner_position(c, r))
        })
        .map(|corner| (corner - camera.center()).norm())
        .fold(f64::INFINITY, f64::min);
    if !fit.table_is_lowest || !nearest.is_finite() {
        return Default::default();
    }
    std::array::from_fn(|row| {
        std::array::from_fn(|column| part_is_below(camera, nearest, [column, row]))
    })
}

/// Whether nearly everything that a part of the picture shows at a distance is below z = 0: a board does not fit into
/// the sliver above.
fn part_is_below(camera: &Camera, distance: f64, part: [usize; 2]) -> bool {
    const SAMPLES: usize = 5;
    let size = [camera.intrinsics.width, camera.intrinsics.height];
    let at = |axis: usize, i: usize| {
        (part[axis] as f64 + i as f64 / (SAMPLES - 1) as f64) / 3.0 * (size[axis] - 1) as f64
    };
    let below = |i: &usize| {
        let pixel = Point2::new(at(0, i % SAMPLES), at(1, i / SAMPLES));
        let ray = camera.ray(pixel);
        ray.is_some_and(|ray| camera.center().z + distance * ray.z < 0.0)
    };
    let all = SAMPLES * SAMPLES;
    5 * (0..all).filter(below).count() >= 4 * all
}

/// Placements that no camera saw; a fit says so itself.
fn unseen_placements(session: &Session) -> Vec<String> {
    let is_seen = |placement: usize| session.views.iter().any(|v| v.placement == placement);
    let all = session.placements.iter().enumerate();
    all.filter(|(placement, _)| !is_seen(*placement))
        .map(|(_, name)| format!("placement {name}: no camera saw the board"))
        .collect()
}

/// Cameras whose best partner shares too few placements with them, by name of both; two that are each other's, once.
fn of_pairs(session: &Session, wanted: &CoverageLimits) -> Vec<String> {
    let placements = |camera: usize| -> BTreeSet<usize> {
        session
            .views
            .iter()
            .filter(|v| v.camera == camera)
            .map(|v| v.placement)
            .collect()
    };
    let seen: Vec<_> = (0..session.cameras.len()).map(placements).collect();
    let partner = |camera: usize| {
        let others = (0..seen.len()).filter(|&other| other != camera && !seen[other].is_empty());
        others
            .map(|other| (seen[camera].intersection(&seen[other]).count(), other))
            .max_by_key(|&(shared, other)| (shared, usize::MAX - other))
    };
    let lacking = |camera: usize| {
        let (shared, other) = partner(camera).filter(|_| !seen[camera].is_empty())?;
        (shared < wanted.shared).then(|| (camera.min(other), camera.max(other), shared))
    };
    let lacking: BTreeSet<_> = (0..session.cameras.len()).filter_map(lacking).collect();
    let id = |camera: usize| &session.cameras[camera].id;
    let words = |(one, other, shared): (usize, usize, usize)| {
        format!(
            "cameras {} and {} share {}, expected {} or more: show the board to both at once",
            id(one),
            id(other),
            count(shared, "placement"),
            wanted.shared
        )
    };
    lacking.into_iter().map(words).collect()
}

fn of_depth(fit: &Fit, id: &CameraId, wanted: &CoverageLimits) -> Vec<String> {
    let Some(index) = fit.cameras.iter().position(|c| c.camera.id == *id) else {
        return Vec::new();
    };
    let camera = &fit.cameras[index].camera;
    let seen = fit.views.iter().filter(|v| v.camera == index);
    let poses =
        seen.map(|v| camera.rig_from_camera.inverse() * fit.placements[v.placement].rig_from_board);
    let middle = fit
        .board
        .corner_position(fit.board.columns / 2, fit.board.rows / 2);
    let measures: Vec<(f64, f64)> = poses
        .map(|pose| {
            (
                (pose * middle).z,
                (pose * Vector3::z()).z.abs().min(1.0).acos().to_degrees(),
            )
        })
        .collect();
    let mut found = Vec::new();
    let mut near = wanted.depths[0];
    while near + 0.5 * wanted.depth_step < wanted.depths[1] {
        let far = (near + wanted.depth_step).min(wanted.depths[1]);
        if !measures.iter().any(|(z, _)| (near..far).contains(z)) {
            found.push(format!(
                "depth camera {id}: it has not seen the board {near:.2} to {far:.2} m away"
            ));
        }
        near += wanted.depth_step.max(0.01);
    }
    let [flat, tilted] = wanted.tilts_degrees;
    if !measures.iter().any(|(_, tilt)| *tilt <= flat) {
        found.push(format!(
            "depth camera {id}: it has not seen the board facing it, within {flat:.0}°"
        ));
    }
    if !measures.iter().any(|(_, tilt)| *tilt >= tilted) {
        found.push(format!(
            "depth camera {id}: it has not seen the board tilted by {tilted:.0}° or more"
        ));
    }
    found
}
