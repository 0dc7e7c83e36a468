//! Keeps the hull at places where something else than an outline shows that the faired surface lies too deep. Knows no
//! camera, and not what showed it.

use super::Facts;
use super::accept::{moved_area, passage, return_to_hull};
use super::shape::Shape;
use crate::mesh::{Bvh, Mesh};
use nalgebra::Point3;

/// Returns the surface of `shape` to the hull, `before`, at `places` on it and some rings around them, and puts into
/// `facts` how much of it that is.
pub(super) fn keep_hull_at(
    shape: &mut Shape,
    before: &[Point3<f64>],
    places: &[Point3<f64>],
    facts: &mut Facts,
) {
    let areas = shape.areas();
    let passage = passage(shape, &near(shape, places));
    let both = shape.kept.iter().zip(&passage);
    let keep: Vec<f64> = both.map(|(was, now)| f64::max(*was, *now)).collect();
    let more = |v: usize| (keep[v] - shape.kept[v]) * areas[v];
    let held: f64 = (0..shape.len()).map(more).sum();
    return_to_hull(shape, before, keep);
    facts.held_by_depth_area = Some(held);
    facts.kept = (facts.kept + held / facts.area).min(1.0);
    facts.moved_area = moved_area(shape, before, &areas);
}

/// For each vertex whether it is a corner of a triangle that is the nearest to one of some places, or beside such a
/// corner: places are as far apart as pixels, which may be longer than edges.
fn near(shape: &Shape, places: &[Point3<f64>]) -> Vec<bool> {
    let surface = Bvh::new(&Mesh {
        vertices: shape.positions.iter().map(|p| p.cast()).collect(),
        triangles: shape.triangles.clone(),
    });
    let mut near = vec![false; shape.len()];
    for found in places.iter().filter_map(|&p| surface.closest_point(p)) {
        for corner in shape.triangles[found.triangle] {
            let corner = corner as usize;
            near[corner] = true;
            for &beside in shape.around(corner) {
                near[beside as usize] = true;
            }
        }
    }
    near
}
