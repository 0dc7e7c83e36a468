//! What depth cameras read of a place of the hull: its surface, or one that lies beneath it. Knows no outlines, and
//! carves nothing.

use crate::calibration::DepthCamera;
use crate::reconstruct::depth::EnhancedDepth;
use crate::reconstruct::region::Regions;
use nalgebra::{Point3, Vector3};

/// Standard errors of a reading within which it may be of a place.
const NOISE: f32 = 3.0;
/// Pixels around a place that count: of those none may be nearer than what is read beneath it, for beside a step, a
/// reading may be of either side.
const AROUND_PX: isize = 2;
/// Pixels to each side of one over which the depth bends there.
const BEND_PX: isize = 2;

/// What a depth camera read.
pub struct Readings<'a> {
    /// The camera.
    pub camera: &'a DepthCamera,
    /// Its enhanced depth.
    pub depth: &'a EnhancedDepth,
    /// What was found in it.
    pub regions: &'a Regions,
}

impl Readings<'_> {
    /// Depth of a pixel's reading in metres, less its bias.
    pub(super) fn read(&self, x: isize, y: isize) -> Option<f32> {
        let depth = self.depth.reading(x, y)?;
        Some(depth - self.regions.bias.metres as f32)
    }

    /// By how many metres of depth a pixel's reading may be off from a place of the hull that it shows.
    pub(super) fn doubt(&self, x: usize, y: usize) -> f32 {
        let slope = self.regions.front.slope(x, y);
        let slope = if slope.is_finite() { slope } else { 0.0 };
        let noise = NOISE * self.depth.sigma[(x, y)];
        noise.max(slope) + self.regions.bias.remaining as f32
    }

    /// How far the depth around a place departs from a plane, in metres: twice its own, less that of the pixels on both
    /// sides. Infinite where one of these has no depth, `None` where the place itself has none.
    pub(super) fn bend(&self, p: Point3<f64>) -> Option<f32> {
        let (pixel, _) = self.camera.project(p)?;
        let (x, y) = (pixel.x.round() as isize, pixel.y.round() as isize);
        let at = |x, y| self.depth.depth.get(x, y).copied().filter(|&z| z > 0.0);
        let here = at(x, y)?;
        let along = |dx: isize, dy: isize| match (at(x - dx, y - dy), at(x + dx, y + dy)) {
            (Some(before), Some(after)) => (before + after - 2.0 * here).abs(),
            _ => f32::INFINITY,
        };
        Some(along(BEND_PX, 0).max(along(0, BEND_PX)))
    }

    /// How far beneath a place the camera read a surface, across the hull's; see [`beneath`].
    fn beneath(&self, p: Point3<f64>, normal: Vector3<f32>) -> Option<f64> {
        let (pixel, z) = self.camera.project(p)?;
        let (x, y) = (pixel.x.round() as isize, pixel.y.round() as isize);
        let read = self.read(x, y)?;
        let (doubt, z) = (self.doubt(x as usize, y as usize), z as f32);
        if read + doubt <= z {
            return None;
        }
        // Behind its far side the hull claims nothing.
        let exit = self.regions.front.exit[(x as usize, y as usize)];
        let exit = if exit.is_finite() { exit } else { z };
        let gap = self.nearest_around(x, y).min(exit) - z - doubt;
        Some(f64::from(gap.max(0.0)) * self.across(p, normal))
    }

    /// The nearest reading of the pixels around one.
    fn nearest_around(&self, x: isize, y: isize) -> f32 {
        let read = around(x, y).filter_map(|(x, y)| self.read(x, y));
        read.fold(f32::INFINITY, f32::min)
    }

    /// Metres across a surface for each metre of depth along the view of a point of it; 0 where it faces away.
    pub(super) fn across(&self, p: Point3<f64>, normal: Vector3<f32>) -> f64 {
        let camera = &self.camera.camera;
        let facing = normal.cast::<f64>().dot(&(camera.center() - p));
        facing.max(0.0) / camera.camera_from_rig(p).z.max(1e-3)
    }
}

/// The pixels around one, and itself.
pub(super) fn around(x: isize, y: isize) -> impl Iterator<Item = (isize, isize)> {
    let rows = y - AROUND_PX..=y + AROUND_PX;
    rows.flat_map(move |y| (x - AROUND_PX..=x + AROUND_PX).map(move |x| (x, y)))
}

/// How far beneath a place of the hull (metres, with its unit outward normal) depth cameras read the surface: metres
/// across the hull's surface, 0 where that is no farther than a reading may be off. Where several cameras read, the
/// nearest counts. `None` where none read the place, or what lies behind it.
pub fn beneath(p: Point3<f64>, normal: Vector3<f32>, readings: &[Readings]) -> Option<f64> {
    let each = readings
        .iter()
        .filter_map(|camera| camera.beneath(p, normal));
    each.reduce(f64::min)
}

#[cfg(test)]
mod tests {
    use super::super::testing::{Above, SIDE};
    use super::*;

    fn beneath_origin(above: &Above, normal: Vector3<f32>) -> Option<f64> {
        beneath(Point3::origin(), normal, &above.readings())
    }

    fn up() -> Vector3<f32> {
        Vector3::z()
    }

    fn is(found: Option<f64>, expected: f64) -> bool {
        found.is_some_and(|found| (found - expected).abs() < 1e-6)
    }

    #[test]
    fn a_camera_that_is_known_to_read_too_near_reads_the_place_all_the_same() {
        assert_eq!(beneath_origin(&Above::reads(0.788, 0.0, 0.0), up()), None);
        assert!(is(
            beneath_origin(&Above::reads(0.788, -12e-3, 0.0), up()),
            0.0
        ));
        assert!(is(
            beneath_origin(&Above::reads(0.788, 0.0, 12e-3), up()),
            0.0
        ));
    }

    #[test]
    fn what_is_read_far_behind_a_place_is_not_of_it() {
        assert!(is(
            beneath_origin(&Above::reads(0.801, 0.0, 0.0), up()),
            0.0
        ));
        assert!(is(
            beneath_origin(&Above::reads(0.83, 0.0, 0.0), up()),
            28.5e-3
        ));
        assert!(is(
            beneath_origin(&Above::reads(0.83, 0.0, 10e-3), up()),
            18.5e-3
        ));
        // Aslant it is nearer, and what lies behind the hull is no part of it.
        let aslant = Vector3::new(0.8, 0.0, 0.6);
        assert!(is(
            beneath_origin(&Above::reads(0.83, 0.0, 0.0), aslant),
            0.6 * 28.5e-3
        ));
        assert!(is(
            beneath_origin(&Above::reads(1.2, 0.0, 0.0), up()),
            98.5e-3
        ));
    }

    #[test]
    fn beside_a_step_a_reading_may_be_of_either_side() {
        let mut above = Above::reads(0.83, 0.0, 0.0);
        let middle = SIDE / 2;
        above.depth.depth[(middle + 2, middle)] = 0.8;
        assert!(is(beneath_origin(&above, up()), 0.0));
    }

    #[test]
    fn a_slope_does_not_bend_and_an_end_does_without_limit() {
        let mut above = Above::reads(0.8, 0.0, 0.0);
        above.depth.depth = crate::image::Grid::from_fn(SIDE, SIDE, |x, _| 0.8 + 1e-3 * x as f32);
        let bend = |above: &Above| above.readings()[0].bend(Point3::origin());
        assert!(bend(&above).unwrap() < 1e-6);
        let middle = SIDE / 2;
        above.depth.depth[(middle, middle - 2)] += 4e-3;
        assert!((bend(&above).unwrap() - 4e-3).abs() < 1e-6);
        above.depth.depth[(middle, middle - 2)] = 0.0;
        assert_eq!(bend(&above), Some(f32::INFINITY));
        above.depth.depth[(middle, middle)] = 0.0;
        assert_eq!(bend(&above), None);
        assert_eq!(above.readings()[0].bend(Point3::new(1.0, 0.0, 0.0)), None);
    }
}
