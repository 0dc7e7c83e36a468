//! Where a hollow may hide: silhouettes show none, and a part of the hull that faces up and that no depth camera read
//! may be the lid over one. Nothing here carves.

use super::touch::ViewingEdge;
use crate::calibration::DepthCamera;
use crate::reconstruct::depth::{DepthKind, EnhancedDepth};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

/// Height of a unit normal from which on a part of the surface faces up. Objects on a table open upwards.
const UP: f32 = 0.5;
/// Metres that a reading may lie in front of a place and still be one of it.
const SAME_PLACE: f64 = 0.01;

/// What a depth camera read.
pub struct Readings<'a> {
    /// The camera.
    pub camera: &'a DepthCamera,
    /// Its enhanced depth.
    pub depth: &'a EnhancedDepth,
}

impl Readings<'_> {
    /// Whether the camera read a place, or what lies behind it.
    fn reach(&self, p: Point3<f64>) -> bool {
        let Some((pixel, z)) = self.camera.project(p) else {
            return false;
        };
        let (x, y) = (pixel.x.round() as isize, pixel.y.round() as isize);
        let measured = self.depth.kind.get(x, y) == Some(&DepthKind::Measured);
        let reading = self.depth.depth.get(x, y).map_or(0.0, |&d| f64::from(d));
        measured && reading + SAME_PLACE > z
    }
}

/// Whether a place of the hull (metres, with its unit outward normal) may be the lid over a hollow.
pub fn may_be_lid(p: Point3<f64>, normal: Vector3<f32>, readings: &[Readings]) -> bool {
    normal.z > UP && !readings.iter().any(|camera| camera.reach(p))
}

/// The way along a viewing edge to the nearest end at which the object has an edge, for there it is. Zero where it has
/// none: the object is round there, and touches the viewing edge on its way.
pub(super) fn way_to_object(edge: &ViewingEdge) -> f64 {
    let certain = edge.ends.iter().filter(|end| end.is_certain);
    let nearest = certain.map(|end| end.distance).reduce(f64::min);
    nearest.unwrap_or(0.0)
}

/// What is known of a place of the hull.
#[derive(Clone, Copy)]
pub(super) struct Place {
    /// Where it is.
    pub point: Point3<f64>,
    /// What is expected of the outside there, in metres.
    pub of_outside: f64,
    /// Whether it may be the lid over a hollow.
    pub may_be_lid: bool,
    /// How far the object is at most; `None` where it is the volume that bounds the hull, so that no outline tells.
    pub way_to_object: Option<f64>,
}

/// What is expected at each of `places`: on a lid half of how far the object is at most.
pub(super) fn with_hollows(places: &[Place]) -> Vec<f64> {
    let known = |place: &Place| Some((place.point, place.way_to_object?));
    let known: Vec<(Point3<f64>, f64)> = places.iter().filter_map(known).collect();
    let of_nearest = |p: Point3<f64>| {
        let ways = known.iter().map(|(q, way)| (q - p).norm() + way);
        ways.fold(f64::INFINITY, f64::min)
    };
    let expected = |place: &Place| {
        if !place.may_be_lid {
            return place.of_outside;
        }
        let bound = match place.way_to_object {
            Some(way) => way,
            None => of_nearest(place.point),
        };
        // Where no outline is known at all, there is no bound.
        let bound = if bound.is_finite() { bound } else { 0.0 };
        place.of_outside.hypot(0.5 * bound)
    };
    places.par_iter().map(expected).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lid_states_half_the_way_to_the_object_and_asks_others_where_no_outline_tells() {
        let place = |x: f64, may_be_lid, way_to_object| Place {
            point: Point3::new(x, 0.0, 0.0),
            of_outside: 0.0,
            may_be_lid,
            way_to_object,
        };
        let places = [
            place(0.0, false, Some(0.03)),
            place(0.01, true, Some(0.02)),
            place(0.05, true, None),
            place(0.05, false, None),
        ];
        let found = with_hollows(&places);
        let expected = [0.0, 0.01, 0.03, 0.0];
        for (found, expected) in found.into_iter().zip(expected) {
            assert!((found - expected).abs() < 1e-12, "{found} {expected}");
        }
        assert_eq!(with_hollows(&places[2..3]), [0.0]);
    }
}
