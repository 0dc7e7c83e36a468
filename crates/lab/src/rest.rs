//! How a body can lie on a table: on those faces of its convex hull above which its centre of mass is.

use nalgebra::{Point3, Vector3};
use scand_core::mesh::{Mesh, convex_hull};
use std::f64::consts::{PI, TAU};

/// Points so near to a face's plane touch the table with it, in metres.
const TOUCHING: f64 = 5e-5;
/// Safety margin, in radians: the widest angle between neighbouring contact points, as seen from the centre of mass,
/// must be this much below a half turn.
const MARGIN: f64 = 0.02;

/// A body's convex hull and centre of mass, from which its resting poses follow.
pub(super) struct RestingPoses {
    hull: Mesh,
    center: Point3<f64>,
}

impl RestingPoses {
    /// Of a solid body of even density.
    pub(super) fn new(body: &Mesh) -> Self {
        Self {
            hull: convex_hull(&body.vertices).unwrap_or_else(|| body.clone()),
            center: center_of_mass(body),
        }
    }

    /// Of the directions that can look down while the body lies still, the one nearest to `down`; `down` itself if
    /// there is none.
    pub(super) fn nearest(&self, down: Vector3<f64>) -> Vector3<f64> {
        let faces = (0..self.hull.triangles.len()).filter_map(|t| {
            let [a, b, c] = self.hull.corners(t).map(|v| v.cast::<f64>());
            let normal = (b - a).cross(&(c - a)).try_normalize(1e-12)?;
            Some((normal, normal.dot(&a.coords)))
        });
        let mut faces: Vec<(Vector3<f64>, f64)> = faces.collect();
        faces.sort_by(|(a, _), (b, _)| b.dot(&down).total_cmp(&a.dot(&down)));
        let still = faces
            .iter()
            .find(|(normal, height)| self.is_still_on(*normal, *height));
        still.map_or(down, |(normal, _)| *normal)
    }

    /// Whether the body lies still on the face with this outward normal, so far from the origin: seen from the
    /// centre of mass, the points that touch the table are all around.
    fn is_still_on(&self, normal: Vector3<f64>, height: f64) -> bool {
        let aside = match normal.x.abs() < 0.8 {
            true => Vector3::x(),
            false => Vector3::y(),
        };
        let u = normal.cross(&aside).normalize();
        let v = normal.cross(&u);
        let points = self.hull.vertices.iter().map(|p| p.cast::<f64>());
        let feet = points.filter(|p| normal.dot(&p.coords) > height - TOUCHING);
        let mut angles: Vec<f64> = feet
            .map(|p| (p - self.center).dot(&v).atan2((p - self.center).dot(&u)))
            .collect();
        angles.sort_by(f64::total_cmp);
        let (Some(first), Some(last)) = (angles.first(), angles.last()) else {
            return false;
        };
        let around = first + TAU - last;
        let widest = angles
            .windows(2)
            .map(|w| w[1] - w[0])
            .fold(around, f64::max);
        widest < PI - MARGIN
    }
}

fn center_of_mass(body: &Mesh) -> Point3<f64> {
    let (mut volume, mut moment) = (0.0, Vector3::zeros());
    for t in 0..body.triangles.len() {
        let [a, b, c] = body.corners(t).map(|v| v.coords.cast::<f64>());
        let part = a.dot(&b.cross(&c)) / 6.0;
        volume += part;
        moment += (a + b + c) * (part / 4.0);
    }
    Point3::from(moment / volume)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Shape;

    #[test]
    fn a_box_lies_on_its_faces_and_a_cup_stands_on_its_head_or_lies_on_its_side() {
        let block = RestingPoses::new(&Shape::Box.mesh(0.005));
        let (sin, cos) = 20_f64.to_radians().sin_cos();
        let face = block.nearest(Vector3::new(1.0, 0.2, 0.5).normalize());
        assert!((face - Vector3::new(cos, sin, 0.0)).norm() < 1e-4, "{face}");
        let cup = RestingPoses::new(&Shape::Cup.mesh(0.002));
        assert!((cup.nearest(Vector3::z()) - Vector3::z()).norm() < 1e-3);
        // The wall leans by a radius of 10 mm over 94 mm of height.
        let side = cup.nearest(Vector3::x());
        assert!((side.z + 0.1058).abs() < 0.01, "{side}");
    }

    #[test]
    fn an_egg_cannot_stand_on_its_head() {
        let egg = RestingPoses::new(&Shape::Egg.mesh(0.002));
        let down = egg.nearest(Vector3::z());
        assert!(down.z < 0.7, "{down}");
    }
}
