//! From how many different directions cameras see a place: where an object was not moved between captures, two cameras
//! are one. What more directions prove is decided elsewhere.

use crate::calibration::Camera;
use nalgebra::{Point3, Vector3};

/// Directions less than two degrees apart, given as a cosine, are the same.
const SAME_COSINE: f64 = 0.9994;

/// Different directions from a place to cameras.
#[derive(Debug, Default)]
pub struct Directions(Vec<Vector3<f64>>);

impl Directions {
    /// The number of the direction from the place `p` to a camera: a new one, or that of a camera before it.
    pub fn number(&mut self, p: Point3<f64>, camera: &Camera) -> usize {
        let direction = (camera.center() - p).normalize();
        let is_same = |other: &Vector3<f64>| other.dot(&direction) > SAME_COSINE;
        self.0.iter().position(is_same).unwrap_or_else(|| {
            self.0.push(direction);
            self.0.len() - 1
        })
    }

    /// How many there are.
    pub fn count(&self) -> usize {
        self.0.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::{Distortion, Intrinsics};
    use crate::frame::CameraId;
    use nalgebra::{Isometry3, Vector2};

    #[test]
    fn cameras_beside_each_other_see_a_place_from_one_direction() {
        let middle = Vector2::repeat(99.5);
        let lens = Intrinsics::new(200, 200, middle, middle, Distortion::default()).unwrap();
        let mut directions = Directions::default();
        let mut number = |x: f64| {
            let pose = Isometry3::translation(x, 0.0, -1.0);
            let camera = Camera::new(CameraId::new("c00").unwrap(), lens, pose);
            directions.number(Point3::origin(), &camera)
        };
        // Metres beside each other, a metre away: 2 degrees are 35 mm.
        assert_eq!(
            [0.0, 0.03, -0.03, 0.1, 0.08].map(&mut number),
            [0, 0, 0, 1, 1]
        );
        assert_eq!(directions.count(), 2);
    }
}
