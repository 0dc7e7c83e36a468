//! The expected error of the hull's vertices, from the silhouettes around each. `touch` finds the viewing edge through
//! a vertex and where the true surface touches it, `depth_of_surface` computes how far the surface then lies beneath
//! the vertex, and `patches` spreads the results of some vertices over all. Nothing here moves a vertex or uses depth.

mod depth_of_surface;
mod patches;
mod touch;

use super::hull::Hull;
use super::{Model, Provenance};
use nalgebra::Point3;
use patches::Patches;
use rayon::prelude::*;
use touch::ViewingEdge;

/// Cells along a patch: between touches there are more.
const PATCH_CELLS: f64 = 3.0;

/// Pixels by which a contour is off: no hull is better known than its outlines.
const CONTOUR_PX: f64 = 0.3;

/// States the expected error of those vertices of a model that lie on its hull, extracted in cells of `cell_size`
/// metres. The other vertices keep theirs.
pub fn state(model: &mut Model, hull: &Hull, cell_size: f64) {
    let vertices = model.mesh.vertices.iter().zip(&model.provenance);
    let on_hull = vertices
        .zip(0..)
        .filter(|((_, provenance), _)| **provenance == Provenance::Hull)
        .map(|((&p, _), index)| (index, p));
    let patches = Patches::new(on_hull, PATCH_CELLS * cell_size);
    let of_patch = |indices: &[u32]| {
        let p = model.mesh.vertices[indices[indices.len() / 2] as usize];
        expected_error(hull, p.cast(), cell_size)
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
    let of_contour = CONTOUR_PX * hull.pixel_footprint(p);
    // Where it is the volume that bounds the hull, nothing is known but that the object is cut off.
    let edge = ViewingEdge::through(hull, p, step);
    edge.map_or(of_contour, |edge| {
        depth_of_surface::expected(&edge).hypot(of_contour)
    })
}
