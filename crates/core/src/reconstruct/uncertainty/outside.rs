//! The expected error of the hull's outside, from silhouettes alone and before anything is carved, as a depth camera
//! sees it: so far a reading may lie behind the hull and show no more than that.

use super::{BORNE, Evidence, FairedHull};
use crate::calibration::DepthCamera;
use crate::mesh::Bvh;
use crate::reconstruct::hull::Hull;
use nalgebra::{Point2, Point3};
use rayon::prelude::*;
use std::sync::OnceLock;

/// A place that is seen more edge-on than this cosine counts as seen at it.
const GRAZING: f64 = 0.15;

/// The expected errors of a hull's outside.
pub struct OutsideErrors<'a> {
    evidence: Evidence<'a>,
    /// Of the plain hull, if it was faired; made when it is first needed.
    plain: OnceLock<Option<Bvh>>,
}

impl<'a> OutsideErrors<'a> {
    /// Of a hull, faired or not, that was extracted in cells of `cell_size` metres.
    pub fn new(hull: &'a Hull<'a>, faired: Option<FairedHull<'a>>, cell_size: f64) -> Self {
        Self {
            evidence: Evidence {
                hull,
                faired,
                readings: Vec::new(),
                cell_size,
            },
            plain: OnceLock::new(),
        }
    }

    /// The expected error at places of the surface, each given as a pixel of a depth camera and the depth there in
    /// metres: metres of depth along the pixel's view, infinite where the lens model cannot be inverted.
    pub fn along_views(&self, camera: &DepthCamera, places: &[(Point2<f64>, f64)]) -> Vec<f64> {
        if places.is_empty() {
            return Vec::new();
        }
        let plain = || self.evidence.faired.map(|faired| Bvh::new(faired.plain));
        let plain = self.plain.get_or_init(plain);
        let at = |&(pixel, depth): &(Point2<f64>, f64)| {
            let p = camera.point(pixel, depth);
            p.map_or(f64::INFINITY, |p| {
                self.along_view(plain.as_ref(), camera, p)
            })
        };
        places.par_iter().map(at).collect()
    }

    /// The expected error at a point of the surface. Where it is the volume that bounds the hull, nothing tells how far
    /// the object is, and half of how far the hull reaches along the view is expected.
    fn along_view(&self, plain: Option<&Bvh>, camera: &DepthCamera, p: Point3<f64>) -> f64 {
        let towards = camera.camera.center() - p;
        let view = towards.normalize();
        let Evidence {
            hull, cell_size, ..
        } = self.evidence;
        let place = self.evidence.at(plain, p, view.cast());
        let bounding = hull.bounding_camera(place.on_hull);
        let along = match (place.outlined(), bounding) {
            (Some(outlined), Some((_, normal))) => {
                let across = self.evidence.of_outside(&place, outlined.of_hull, &BORNE);
                across / normal.dot(&view).max(GRAZING)
            }
            _ => 0.5 * hull.reach(place.on_hull, -view, cell_size),
        };
        along * camera.camera.camera_from_rig(p).z / towards.norm()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::{Camera, DepthResponse, Distortion, Intrinsics, Volume};
    use crate::frame::CameraId;
    use crate::image::Grid;
    use crate::reconstruct::hull::Cone;
    use nalgebra::{Isometry3, Vector2, Vector3};

    /// A camera that looks at a point from another.
    fn camera(eye: Point3<f64>, target: Point3<f64>) -> Camera {
        let (focal, middle) = (Vector2::repeat(300.0), Vector2::repeat(99.5));
        let lens = Intrinsics::new(200, 200, focal, middle, Distortion::default());
        let pose = Isometry3::face_towards(&eye, &target, &-Vector3::z());
        Camera::new(CameraId::new("c00").unwrap(), lens.unwrap(), pose)
    }

    /// The error at a point of a column, 66 mm wide and 100 mm high, as a depth camera sees it that looks at the point
    /// from `eye`. Two cameras see its sides, and none its ends.
    fn error(p: Point3<f64>, eye: Point3<f64>) -> f64 {
        let middle = Point3::new(0.0, 0.0, 0.05);
        let eyes = [Point3::new(0.0, -0.5, 0.05), Point3::new(0.5, 0.0, 0.05)];
        let cameras = eyes.map(|eye| camera(eye, middle));
        let is_object = |x: usize, _: usize| if (80..120).contains(&x) { 255 } else { 0 };
        let level = Grid::from_fn(200, 200, is_object);
        let cones = cameras.iter().map(|c| Cone::new(c, &level)).collect();
        let low = Point3::new(-0.06, -0.06, 0.0);
        let volume = Volume::new(low, Point3::new(0.06, 0.06, 0.1)).unwrap();
        let hull = Hull::new(cones, volume, 2);
        let depth_camera = DepthCamera {
            camera: camera(eye, p),
            response: DepthResponse::default(),
        };
        let (pixel, depth) = depth_camera.project(p).unwrap();
        let errors = OutsideErrors::new(&hull, None, 1e-3);
        errors.along_views(&depth_camera, &[(pixel, depth)])[0]
    }

    #[test]
    fn the_more_aslant_a_side_is_seen_the_deeper_a_reading_has_to_pass() {
        let side = Point3::new(0.033, 0.0, 0.05);
        let straight = error(side, side + Vector3::new(0.5, 0.0, 0.0));
        let aslant = error(side, side + Vector3::new(0.3, 0.4, 0.0));
        assert!(straight > 1e-4, "{straight}");
        // The side of the cone turns away from the column's by 4 degrees.
        let ratio = aslant / straight;
        assert!((1.7..2.0).contains(&ratio), "{ratio}");
    }

    #[test]
    fn where_the_volume_bounds_the_hull_the_object_may_be_half_as_deep_as_that() {
        let top = Point3::new(0.0, 0.0, 0.1);
        let found = error(top, top + Vector3::new(0.1, 0.0, 0.5));
        assert!((0.02..0.08).contains(&found), "{found}");
    }
}
