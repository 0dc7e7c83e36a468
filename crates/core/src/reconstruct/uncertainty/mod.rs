//! The expected error of the hull's vertices, from the silhouettes around each. `touch` finds the viewing edge through
//! a vertex and where the true surface touches it, `depth_of_surface` computes how far the surface then lies beneath
//! the vertex, and `patches` spreads the results of some vertices over all. Nothing here moves a vertex or uses depth.

mod depth_of_surface;
mod patches;
mod touch;

use super::fairing::Body;
use super::hull::Hull;
use super::{Model, Provenance};
use crate::mesh::{Bvh, Mesh};
use nalgebra::Point3;
use patches::Patches;
use rayon::prelude::*;
use touch::ViewingEdge;

/// Cells along a patch: between touches there are more.
const PATCH_CELLS: f64 = 3.0;

/// Pixels by which a contour is off: no hull is better known than its outlines.
const CONTOUR_PX: f64 = 0.3;

/// What fairing made of a hull.
pub struct FairedHull<'a> {
    /// The plain hull's surface.
    pub plain: &'a Mesh,
    /// The faired one.
    pub body: &'a Body,
}

/// What fairing is expected to be off, in shares of what it did; `design/surface.md` tells what they were chosen on. All
/// errors are far from normal: the largest tenth are thirty times the smallest.
mod share {
    /// Of the way that a vertex was moved.
    pub(super) const OF_MOVED: f64 = 0.5;
    /// Pixels at which half as much is expected as in proportion to the way: long ways end at a surface as smooth as
    /// short ones do.
    pub(super) const MOVED_PX: f64 = 4.0;
    /// Of what fairing left of the hull's expected depth.
    pub(super) const OF_LEFT: f64 = 0.2;
    /// Of the hull's expected depth, where the hull was kept.
    pub(super) const OF_KEPT: f64 = 0.6;
    /// Of a contour's error, on a flat side that many contours hold.
    pub(super) const OF_CONTOUR: f64 = 0.5;
}

/// States the expected error of those vertices of a model that lie on its hull, extracted in cells of `cell_size`
/// metres, and faired if `faired` says so. The other vertices keep theirs.
pub fn state(model: &mut Model, hull: &Hull, faired: Option<&FairedHull>, cell_size: f64) {
    let vertices = model.mesh.vertices.iter().zip(&model.provenance);
    let on_hull = vertices
        .zip(0..)
        .filter(|((_, provenance), _)| **provenance == Provenance::Hull)
        .map(|((&p, _), index)| (index, p));
    let patches = Patches::new(on_hull, PATCH_CELLS * cell_size);
    let plain = faired.map(|faired| (Bvh::new(faired.plain), faired.body));
    let of_patch = |indices: &[u32]| {
        let p = model.mesh.vertices[indices[indices.len() / 2] as usize].cast();
        match &plain {
            Some((plain, body)) => of_faired(hull, plain, body, p, cell_size),
            None => expected_error(hull, p, cell_size),
        }
    };
    let each: Vec<&[u32]> = patches.indices().collect();
    let found: Vec<f64> = each.into_par_iter().map(of_patch).collect();
    for (indices, error) in patches.indices().zip(patches.smoothed(&found)) {
        for &index in indices {
            model.expected_error[index as usize] = error as f32;
        }
    }
}

/// The expected error in metres at a point of the hull's surface.
fn expected_error(hull: &Hull, p: Point3<f64>, step: f64) -> f64 {
    // Where it is the volume that bounds the hull, nothing is known but that the object is cut off.
    let edge = ViewingEdge::through(hull, p, step);
    let depth = edge.map_or(0.0, |edge| depth_of_surface::expected(&edge));
    depth.hypot(CONTOUR_PX * hull.pixel_footprint(p))
}

/// The expected error in metres at a point of the faired hull's surface: on a flat side a share of that of the contours,
/// where the hull was kept a share of its own, and elsewhere of how far the surface was moved and of what is left of
/// the hull's own.
fn of_faired(hull: &Hull, plain: &Bvh, body: &Body, p: Point3<f64>, step: f64) -> f64 {
    let pixel = hull.pixel_footprint(p);
    let of_contour = CONTOUR_PX * pixel;
    if body.is_on_side(p) {
        return share::OF_CONTOUR * of_contour;
    }
    let Some(above) = plain.closest_point(p) else {
        return expected_error(hull, p, step);
    };
    let of_hull = expected_error(hull, above.point, step);
    let moved = above.distance / (1.0 + above.distance / (share::MOVED_PX * pixel));
    let left = (of_hull - above.distance).max(0.0);
    let of_moved = (share::OF_MOVED * moved)
        .hypot(share::OF_LEFT * left)
        .hypot(of_contour);
    let of_kept = (share::OF_KEPT * of_hull).hypot(of_contour);
    let kept = body.kept(p);
    (1.0 - kept) * of_moved + kept * of_kept
}
