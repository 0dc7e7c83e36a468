//! Where a skilled operator shows the board: once flat on the table, then towards one group of neighbouring cameras
//! after the other, and every third time to a depth camera, near and far.

use super::super::Rig;
use super::super::random::Random;
use super::super::rig::looking_at;
use nalgebra::{Isometry3, Point2, Point3, Translation3, UnitQuaternion, Vector3};
use scand_core::calibration::{Board, DepthCamera};
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// Metres that the board's lowest corner stays above the table, and that its centre stays within of the rig's axis.
const ABOVE_TABLE: f64 = 0.012;
const JITTER: f64 = 0.03;
/// Angles in degrees between the table and where the board faces, in turn.
const ELEVATIONS: [f64; 4] = [20.0, 42.0, 56.0, 30.0];
/// Where in a depth camera's picture the board's middle is, in turn, as parts of its width and height.
const SPOTS: [[f64; 2]; 5] = [
    [0.25, 0.28],
    [0.76, 0.70],
    [0.5, 0.5],
    [0.74, 0.27],
    [0.24, 0.72],
];
/// Where a board is nearest to a depth camera, as a part of the table's distance, and in metres at least.
const NEAREST: f64 = 0.53;
const NEAREST_AT_LEAST: f64 = 0.45;

/// Where the board is at one press of the pedal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// Maps a point of the frame of the board's front into the rig's.
    pub rig_from_board: Isometry3<f64>,
}

/// Chooses `count` placements.
pub(super) fn choose(board: &Board, rig: &Rig, seed: u64, count: usize) -> Vec<Placement> {
    let chooser = Chooser { board, rig, seed };
    let for_depth = |k: usize| k.is_multiple_of(3) && !rig.depths.is_empty();
    let depths = (1..count).filter(|&k| for_depth(k)).count();
    let (mut shared, mut deep) = (0, 0);
    let mut next = |k: usize| {
        if k == 0 {
            return chooser.flat();
        }
        if for_depth(k) {
            deep += 1;
            return chooser.to_depth(deep - 1, depths);
        }
        shared += 1;
        chooser.to_colors(shared - 1)
    };
    let poses = (0..count).map(|k| Placement {
        rig_from_board: next(k),
    });
    poses.collect()
}

struct Chooser<'a> {
    board: &'a Board,
    rig: &'a Rig,
    seed: u64,
}

impl Chooser<'_> {
    /// On the table, its middle at the rig's origin and its rows along x.
    fn flat(&self) -> Isometry3<f64> {
        let rotation = looking_at(Point3::new(0.0, 0.0, 1.0), Point3::origin(), 0.0).rotation;
        self.at(Point3::origin(), rotation)
    }

    /// Towards some of the colour cameras, the golden angle on from the time before.
    fn to_colors(&self, k: usize) -> Isometry3<f64> {
        let mut random = Random::new(&[self.seed, 21, k as u64]);
        let azimuth = TAU * 0.381_966 * k as f64 + random.between(-0.15, 0.15);
        let elevation = ELEVATIONS[k % 4].to_radians() + random.between(-0.06, 0.06);
        let towards = Vector3::new(
            elevation.cos() * azimuth.cos(),
            elevation.cos() * azimuth.sin(),
            elevation.sin(),
        );
        let jitter = Vector3::from_fn(|_, _| random.between(-JITTER, JITTER));
        let middle = nalgebra::center(&self.rig.volume.min, &self.rig.volume.max)
            + towards * random.between(-0.05, 0.10)
            + jitter;
        // Upright boards stand on their long side, as they fit into the pictures.
        let upended = if k % 4 == 1 { FRAC_PI_2 } else { 0.0 };
        let roll = upended + random.between(-0.2, 0.2);
        let rotation = looking_at(middle + towards, middle, roll).rotation;
        self.raised(self.at(middle, rotation))
    }

    /// In front of a depth camera, `k` of `count` times: at distances in even steps, in no order of nearness.
    fn to_depth(&self, k: usize, count: usize) -> Isometry3<f64> {
        let mut random = Random::new(&[self.seed, 22, k as u64]);
        let DepthCamera { camera, response } = &self.rig.depths[k % self.rig.depths.len()].actual;
        let forward = camera.rig_from_camera.rotation * Vector3::z();
        let table = camera.center().z / -forward.z.min(-0.1);
        let nearest = (NEAREST * table).max(NEAREST_AT_LEAST);
        let farthest = (table - 0.04).max(nearest + 0.02);
        let step =
            (k * 2 % count.max(1) + usize::from(count.is_multiple_of(2) && k * 2 >= count)) as f64;
        let part = (step + random.uniform()) / count.max(1) as f64;
        let depth = nearest + (farthest - nearest) * part.min(1.0);
        let lens = &camera.intrinsics;
        let [u, v] = SPOTS[k % SPOTS.len()].map(|part| part + random.between(-0.05, 0.05));
        let pixel = Point2::new(lens.width as f64 * u, lens.height as f64 * v);
        let middle = response.point(lens, pixel, depth);
        let middle = camera.rig_from_camera * middle.unwrap_or(Point3::new(0.0, 0.0, depth));
        let (tilt, about) = (random.between(0.25, 0.65), random.between(0.0, TAU));
        let axis = Vector3::new(about.cos(), about.sin(), 0.0);
        let roll = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), random.between(-PI, PI));
        let tilted = UnitQuaternion::from_scaled_axis(axis * tilt) * roll;
        self.raised(self.at(middle, camera.rig_from_camera.rotation * tilted))
    }

    /// The pose that brings the middle of the pattern to `middle`.
    fn at(&self, middle: Point3<f64>, rotation: UnitQuaternion<f64>) -> Isometry3<f64> {
        let outline = self.board.outline();
        let in_board = Vector3::new(
            0.5 * (outline.min[0] + outline.max[0]),
            0.5 * (outline.min[1] + outline.max[1]),
            0.0,
        );
        let translation = middle.coords - rotation * in_board;
        Isometry3::from_parts(Translation3::from(translation), rotation)
    }

    /// Lifts a board that would cut through the table.
    fn raised(&self, mut pose: Isometry3<f64>) -> Isometry3<f64> {
        let lowest = super::plate::corners(self.board)
            .into_iter()
            .map(|[x, y]| (pose * Point3::new(x, y, 0.0)).z)
            .fold(f64::INFINITY, f64::min);
        pose.translation.z += (ABOVE_TABLE - lowest).max(0.0);
        pose
    }
}
