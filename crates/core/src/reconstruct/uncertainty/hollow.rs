//! Where a hollow may hide: silhouettes show none, and a part of the hull that faces up and that no depth camera read
//! may be the lid over one. Nothing here carves.

use super::readings::{Readings, beneath};
use super::touch::ViewingEdge;
use crate::reconstruct::hull::UpDirections;
use nalgebra::{Point3, Vector3};

/// The number of the direction that a place of the hull (metres, with its unit outward normal) faces, if it may be the
/// lid over a hollow: objects on a table open upwards.
pub fn may_be_lid(
    p: Point3<f64>,
    normal: Vector3<f32>,
    up: &UpDirections,
    readings: &[Readings],
) -> Option<usize> {
    let faced = up.faced(normal)?;
    beneath(p, normal, readings).is_none().then_some(faced)
}

/// The way along a viewing edge to the nearest end at which the object has an edge, for there it is; `None` where it
/// has none. The object touches the viewing edge somewhere then, but over a hollow that may be as far as its rim.
pub(super) fn way_to_object(edge: &ViewingEdge) -> Option<f64> {
    let certain = edge.ends.iter().filter(|end| end.is_certain);
    certain.map(|end| end.distance).reduce(f64::min)
}
