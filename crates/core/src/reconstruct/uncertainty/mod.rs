//! The expected error of the hull's vertices, from the silhouettes around each. `touch` finds the viewing edge through
//! a vertex and where the true surface touches it, `depth_of_surface` computes how far the surface then lies beneath
//! the vertex, `hollow` what may hide beneath a lid, and `patches` spreads the results of some vertices over all.
//! Nothing here moves a vertex.

mod depth_of_surface;
mod hollow;
mod patches;
mod touch;

use super::fairing::Body;
use super::hull::Hull;
use super::{Model, Provenance};
use crate::mesh::{Bvh, Mesh};
pub use hollow::{Readings, may_be_lid};
use nalgebra::{Point3, Vector3};
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

/// What fairing is expected to be off, in shares of what it did; `design/surface.md` tells what they were chosen on.
/// All errors are far from normal: the largest tenth are thirty times the smallest.
mod share {
    /// Of the way that a vertex was moved.
    pub(super) const OF_MOVED: f64 = 0.5;
    /// Pixels at which half as much is expected as in proportion to the way: long ways end at a surface as smooth as
    /// short ones do.
    pub(super) const MOVED_PX: f64 = 10.0;
    /// Of what fairing left of the hull's expected depth.
    pub(super) const OF_LEFT: f64 = 0.42;
    /// Of the hull's expected depth, where the hull was kept.
    pub(super) const OF_KEPT: f64 = 0.6;
    /// Of a contour's error, on a flat side that many contours hold.
    pub(super) const OF_CONTOUR: f64 = 0.5;
}

/// What the stated errors follow from.
pub struct Evidence<'a> {
    /// The plain hull.
    pub hull: &'a Hull<'a>,
    /// What fairing made of it, if it was faired.
    pub faired: Option<FairedHull<'a>>,
    /// What the depth cameras read; empty where none was used.
    pub readings: Vec<Readings<'a>>,
    /// Edge of the cells that the hull was extracted in, in metres.
    pub cell_size: f64,
}

/// States the expected error of those vertices of a model that lie on its hull. The other vertices keep theirs.
pub fn state_errors(model: &mut Model, evidence: &Evidence) {
    let vertices = model.mesh.vertices.iter().zip(&model.provenance);
    let on_hull = vertices
        .zip(0..)
        .filter(|((_, provenance), _)| **provenance == Provenance::Hull)
        .map(|((&p, _), index)| (index, p));
    let patches = Patches::new(on_hull, PATCH_CELLS * evidence.cell_size);
    let plain = evidence.faired.as_ref().map(|f| Bvh::new(f.plain));
    let of_patch = |indices: &[u32]| {
        let vertex = indices[indices.len() / 2] as usize;
        let p = model.mesh.vertices[vertex].cast();
        evidence.at(plain.as_ref(), p, model.normals[vertex])
    };
    let each: Vec<&[u32]> = patches.indices().collect();
    let places: Vec<hollow::Place> = each.into_par_iter().map(of_patch).collect();
    let found = hollow::with_hollows(&places);
    for (indices, error) in patches.indices().zip(patches.smoothed(&found)) {
        for &index in indices {
            model.expected_error[index as usize] = error as f32;
        }
    }
}

impl Evidence<'_> {
    /// What is known at a point of the model's surface that lies on the hull. `plain` finds places on the plain hull's
    /// surface, where that was faired.
    fn at(&self, plain: Option<&Bvh>, p: Point3<f64>, normal: Vector3<f32>) -> hollow::Place {
        let above = plain.and_then(|plain| plain.closest_point(p));
        let on_hull = above.as_ref().map_or(p, |above| above.point);
        let edge = ViewingEdge::through(self.hull, on_hull, self.cell_size);
        let of_contour = CONTOUR_PX * self.hull.pixel_footprint(p);
        let of_hull = edge.map_or(0.0, |edge| depth_of_surface::expected(&edge));
        let of_hull = of_hull.hypot(of_contour);
        let of_outside = match (&self.faired, above) {
            (Some(faired), Some(above)) => {
                of_faired(faired.body, p, of_hull, above.distance, of_contour)
            }
            _ => of_hull,
        };
        hollow::Place {
            point: p,
            of_outside,
            may_be_lid: hollow::may_be_lid(p, normal, &self.readings),
            way_to_object: edge.map(|edge| hollow::way_to_object(&edge)),
        }
    }
}

/// The expected error in metres at a point of a faired hull, which moved by `moved` from where `of_hull` is expected:
/// on a flat side a share of that of the contours, where the hull was kept a share of its own, and elsewhere of how
/// far the surface was moved and of what is left of the hull's own.
fn of_faired(body: &Body, p: Point3<f64>, of_hull: f64, moved: f64, of_contour: f64) -> f64 {
    if body.is_on_side(p) {
        return share::OF_CONTOUR * of_contour;
    }
    let much = share::MOVED_PX / CONTOUR_PX * of_contour;
    let left = (of_hull - moved).max(0.0);
    let of_moved = (share::OF_MOVED * moved / (1.0 + moved / much))
        .hypot(share::OF_LEFT * left)
        .hypot(of_contour);
    let of_kept = (share::OF_KEPT * of_hull).hypot(of_contour);
    let kept = body.kept(p);
    (1.0 - kept) * of_moved + kept * of_kept
}
