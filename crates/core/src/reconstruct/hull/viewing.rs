//! Lines through the hull: where a line leaves the hull, and which constraint bounds it there. On the viewing ray of a
//! point of the hull's surface, the part within the hull is its viewing edge, which the true surface touches somewhere
//! (Cheung, Baker and Kanade, "Visual hull alignment and refinement across time", 2003).

use super::solid::Hull;
use crate::reconstruct::surface::Side;
use nalgebra::{Point3, Vector3};

/// Where a line leaves the hull.
#[derive(Clone, Copy, Debug)]
pub struct Exit {
    /// How far away, in metres.
    pub distance: f64,
    /// Unit outward normal of that.
    pub normal: Vector3<f64>,
}

/// Steps that are decided at once, where nothing of them is near an outline.
const STRIDE: usize = 8;
/// Halvings of a step that find the exit within it.
const HALVINGS: usize = 5;

impl Hull<'_> {
    /// The camera whose cone bounds the hull at a point of its surface, and the cone's unit outward normal there;
    /// `None` where it is the volume.
    pub fn bounding_camera(&self, p: Point3<f64>) -> Option<(usize, Vector3<f64>)> {
        let values = self.cones().iter().enumerate();
        let nearest = values
            .filter_map(|(i, cone)| Some((i, cone.value(p)?)))
            .min_by(|a, b| a.1.total_cmp(&b.1))?;
        let normal = self.cones()[nearest.0].normal(p)?;
        Some((nearest.0, normal))
    }

    /// Whether a camera's silhouette excludes a point, in the volume or beyond it.
    pub fn is_excluded(&self, p: Point3<f64>) -> bool {
        let mut values = self.cones().iter().filter_map(|cone| cone.value(p));
        values.any(|value| value < 0.0)
    }

    /// The cameras that see a point within `radius_px` of their outlines, with their cones' unit outward normals there.
    pub fn outlines_near(
        &self,
        p: Point3<f64>,
        radius_px: f64,
    ) -> impl Iterator<Item = (usize, Vector3<f64>)> + '_ {
        let cones = self.cones().iter().enumerate();
        cones.filter_map(move |(i, cone)| Some((i, cone.normal_near(p, radius_px)?)))
    }

    /// Where a line from a point on or in the hull leaves it along a unit vector. `without` is a camera that is
    /// ignored, because the line is one of its viewing rays. The line is followed in steps of `step` metres; thinner
    /// parts may be missed.
    pub fn exit(&self, from: Point3<f64>, along: Vector3<f64>, without: usize, step: f64) -> Exit {
        let wall = self.wall(from, along);
        let mut begin = 0.0;
        while begin < wall.distance {
            let stride = (STRIDE as f64 * step).min(wall.distance - begin);
            let middle = from + along * (begin + 0.5 * stride);
            let near: Vec<usize> = self.near(middle, 0.5 * stride, without).collect();
            if let Some((distance, camera)) = self.first(from, along, begin, stride, step, &near) {
                let at = from + along * distance;
                return Exit {
                    distance,
                    normal: self.cones()[camera].normal(at).unwrap_or(along),
                };
            }
            begin += stride;
        }
        wall
    }

    /// The cameras whose outlines come near a cube, or exclude it.
    fn near(
        &self,
        center: Point3<f64>,
        half: f64,
        without: usize,
    ) -> impl Iterator<Item = usize> + '_ {
        let cones = self.cones().iter().enumerate();
        let is_near = move |(i, cone): &(usize, &super::Cone)| {
            *i != without && cone.side(center, half).side != Side::Inside
        };
        cones.filter(is_near).map(|(i, _)| i)
    }

    /// The first place of a stride that lies outside a camera's silhouette.
    fn first(
        &self,
        from: Point3<f64>,
        along: Vector3<f64>,
        begin: f64,
        stride: f64,
        step: f64,
        cameras: &[usize],
    ) -> Option<(f64, usize)> {
        let outside = |t: f64| {
            let p = from + along * t;
            let excludes = |&&i: &&usize| self.cones()[i].value(p).is_some_and(|v| v < 0.0);
            cameras.iter().find(excludes).copied()
        };
        let steps = if cameras.is_empty() {
            0
        } else {
            (stride / step).ceil() as usize
        };
        for i in 1..=steps {
            let mut high = begin + stride * i as f64 / steps as f64;
            let Some(mut camera) = outside(high) else {
                continue;
            };
            let mut low = high - stride / steps as f64;
            for _ in 0..HALVINGS {
                let middle = 0.5 * (low + high);
                match outside(middle) {
                    Some(found) => (high, camera) = (middle, found),
                    None => low = middle,
                }
            }
            return Some((0.5 * (low + high), camera));
        }
        None
    }

    /// Where the line leaves the volume.
    fn wall(&self, from: Point3<f64>, along: Vector3<f64>) -> Exit {
        let volume = self.volume();
        let mut found = (f64::INFINITY, Vector3::zeros());
        for axis in 0..3 {
            let face = if along[axis] > 0.0 {
                volume.max
            } else {
                volume.min
            };
            let distance = (face[axis] - from[axis]) / along[axis];
            if along[axis] != 0.0 && distance < found.0 {
                let mut normal = Vector3::zeros();
                normal[axis] = along[axis].signum();
                found = (distance, normal);
            }
        }
        Exit {
            distance: found.0.max(0.0),
            normal: found.1,
        }
    }
}
