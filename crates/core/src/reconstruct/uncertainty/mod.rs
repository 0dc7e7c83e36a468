//! The expected error of the hull's vertices, from the silhouettes around each. `touch` finds the viewing edge through
//! a vertex and where the true surface touches it, `depth_of_surface` computes how far the surface then lies beneath
//! the vertex, `readings` tells what depth cameras read of it, `hollow` what may hide beneath a lid, and `patches`
//! spreads the results of some vertices over all. Nothing here moves a vertex.

mod depth_of_surface;
mod hollow;
mod patches;
mod readings;
#[cfg(test)]
pub(crate) mod testing;
mod touch;

use super::fairing::Body;
use super::hull::Hull;
use super::{Model, Provenance};
use crate::mesh::{Bvh, Mesh};
use hollow::Bound;
pub use hollow::may_be_lid;
use nalgebra::{Point3, Vector3};
use patches::Patches;
use rayon::prelude::*;
pub use readings::{Readings, beneath};
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

/// Pixels within which an outline bounds a place, and cells: between the vertices of a cell the hull bends.
const OUTLINE_PX: f64 = 3.0;
const OUTLINE_CELLS: f64 = 2.0;

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

/// States the expected error of those vertices of a model that lie on its hull, and which of them nothing observed,
/// because the volume cuts the object there. The other vertices keep what they state.
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
    let stated = places.iter().zip(patches.smoothed(&found));
    for (indices, (place, error)) in patches.indices().zip(stated) {
        for &index in indices {
            model.expected_error[index as usize] = error as f32;
            if place.is_guess {
                model.provenance[index as usize] = Provenance::Unseen;
            }
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
        let reach = || {
            self.hull
                .reach(on_hull, -normal.cast::<f64>(), self.cell_size)
        };
        hollow::Place {
            point: p,
            of_outside,
            may_be_lid: hollow::may_be_lid(p, normal, &self.readings),
            is_guess: edge.is_none() && self.is_far_from_outlines(on_hull),
            beneath: beneath(p, normal, &self.readings).unwrap_or(0.0),
            bound: match edge {
                Some(edge) => Bound::Outline(hollow::way_to_object(&edge)),
                None => Bound::Volume(reach()),
            },
        }
    }

    /// Whether no outline comes near a point of the hull's surface.
    fn is_far_from_outlines(&self, p: Point3<f64>) -> bool {
        let of_cells = OUTLINE_CELLS * self.cell_size / self.hull.pixel_footprint(p).max(1e-9);
        let mut outlines = self.hull.outlines_near(p, OUTLINE_PX.max(of_cells));
        outlines.next().is_none()
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::{Camera, Distortion, Intrinsics, Volume};
    use crate::frame::CameraId;
    use crate::image::Grid;
    use crate::reconstruct::hull::Cone;
    use nalgebra::{Isometry3, Vector2};

    /// A camera half a metre away along an axis, 0.05 m above the table.
    fn camera(eye: Point3<f64>) -> Camera {
        let (focal, middle) = (Vector2::repeat(300.0), Vector2::repeat(99.5));
        let lens = Intrinsics::new(200, 200, focal, middle, Distortion::default());
        let target = Point3::new(0.0, 0.0, 0.05);
        let pose = Isometry3::face_towards(&eye, &target, &-Vector3::z());
        Camera::new(CameraId::new("c00").unwrap(), lens.unwrap(), pose)
    }

    /// A column of 66 mm that is taller than the volume, of 0.1 m.
    #[test]
    fn what_the_volume_cuts_off_was_not_seen_and_is_known_least() {
        let cameras = [Point3::new(0.0, -0.5, 0.05), Point3::new(0.5, 0.0, 0.05)].map(camera);
        let is_object = |x: usize| (80..120).contains(&x);
        let level = Grid::from_fn(200, 200, |x, _| if is_object(x) { 255 } else { 0 });
        let cones = cameras.iter().map(|c| Cone::new(c, &level)).collect();
        let low = Point3::new(-0.06, -0.06, 0.0);
        let volume = Volume::new(low, Point3::new(0.06, 0.06, 0.1)).unwrap();
        let hull = Hull::new(cones, volume, 2);
        let evidence = Evidence {
            hull: &hull,
            faired: None,
            readings: Vec::new(),
            cell_size: 1e-3,
        };
        let vertices = vec![Point3::new(0.0, 0.0, 0.1), Point3::new(0.033, 0.0, 0.05)];
        let mut model = Model {
            mesh: Mesh {
                vertices,
                triangles: Vec::new(),
            },
            normals: vec![Vector3::z(), Vector3::x()],
            provenance: vec![Provenance::Hull; 2],
            expected_error: vec![0.0; 2],
            ..Model::default()
        };
        state_errors(&mut model, &evidence);
        assert_eq!(model.provenance, [Provenance::Unseen, Provenance::Hull]);
        // Half of how far the hull reaches, which is known to a third of it.
        assert!(
            (0.02..0.08).contains(&model.expected_error[0]),
            "{:?}",
            model.expected_error
        );
        assert!(model.expected_error[1] < 0.03, "{:?}", model.expected_error);
    }
}
