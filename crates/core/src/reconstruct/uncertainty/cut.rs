//! Places where the volume bounds the hull, so that no outline tells how far the object is. Either the volume cuts off
//! what the hull has too much between views, and the object is as far beneath as beside the cut; or it cuts the object.

use crate::reconstruct::hull::Hull;
use nalgebra::{Point3, Vector3};

/// Pixels and cells that one has to go beyond the volume at least: nearer, an outline need not tell yet.
const LEAST_PX: f64 = 3.0;
const LEAST_CELLS: f64 = 2.0;

/// A place of the hull's surface that an outline bounds.
#[derive(Clone, Copy, Debug)]
pub(super) struct Outlined {
    /// Where it is.
    pub point: Point3<f64>,
    /// How deep beneath the hull the surface is expected, in metres.
    pub of_hull: f64,
    /// How far the object is at most, in metres; `None` where nothing tells.
    pub way_to_object: Option<f64>,
}

/// The place of `known` that is nearest to a point, and how far away it is in metres.
pub(super) fn nearest(p: Point3<f64>, known: &[Outlined]) -> Option<(Outlined, f64)> {
    let away = known.iter().map(|place| (*place, (place.point - p).norm()));
    away.min_by(|a, b| a.1.total_cmp(&b.1))
}

/// How far from a point the object is at most in metres, as one of `known` tells; infinite where there is none.
pub(super) fn way_to_object(p: Point3<f64>, known: &[Outlined]) -> f64 {
    let ways = known
        .iter()
        .filter_map(|place| Some((place.point - p).norm() + place.way_to_object?));
    ways.fold(f64::INFINITY, f64::min)
}

/// Whether the object may go on beyond a place where the volume bounds the hull: as far beyond as the nearest outline
/// is away, `beside` metres, no silhouette excludes it. What stands out between views ends sooner, for the outlines
/// that bound it lean inwards.
pub(super) fn goes_on(
    hull: &Hull,
    p: Point3<f64>,
    outwards: Vector3<f64>,
    beside: f64,
    cell_size: f64,
) -> bool {
    let least = (LEAST_PX * hull.pixel_footprint(p)).max(LEAST_CELLS * cell_size);
    !hull.is_excluded(p + outwards * beside.max(least))
}
