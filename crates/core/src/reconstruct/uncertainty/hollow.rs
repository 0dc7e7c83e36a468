//! Where a hollow may hide: silhouettes show none, and a part of the hull that faces up and that no depth camera read
//! may be the lid over one. Nothing here carves.

use super::readings::{Readings, beneath};
use super::touch::ViewingEdge;
use nalgebra::{Point3, Vector3};

/// Height of a unit normal from which on a part of the surface faces up. Objects on a table open upwards.
const UP: f32 = 0.5;

/// Whether a place of the hull (metres, with its unit outward normal) may be the lid over a hollow.
pub fn may_be_lid(p: Point3<f64>, normal: Vector3<f32>, readings: &[Readings]) -> bool {
    normal.z > UP && beneath(p, normal, readings).is_none()
}

/// The way along a viewing edge to the nearest end at which the object has an edge, for there it is; `None` where it
/// has none. The object touches the viewing edge somewhere then, but over a hollow that may be as far as its rim.
pub(super) fn way_to_object(edge: &ViewingEdge) -> Option<f64> {
    let certain = edge.ends.iter().filter(|end| end.is_certain);
    certain.map(|end| end.distance).reduce(f64::min)
}
