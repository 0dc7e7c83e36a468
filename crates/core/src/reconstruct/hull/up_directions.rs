//! The directions that were up when the object stood on its tables, and which parts of a surface face one. Knows
//! neither readings nor outlines.

use super::Bounds;
use nalgebra::Vector3;

/// Cosine between a unit normal and a direction that was up from which on a part of the surface faces up.
const UP: f32 = 0.5;

/// The directions that were up in the captures of a scene, as unit vectors of its frame: the frame's own, then those of
/// the captures that were fused into it.
#[derive(Clone, Debug)]
pub struct UpDirections(Vec<Vector3<f32>>);

impl UpDirections {
    /// Those of the tables that bound a hull.
    pub fn of(bounds: &Bounds) -> Self {
        let fused = bounds.planes().iter().map(|plane| plane.normal.cast());
        Self(std::iter::once(Vector3::z()).chain(fused).collect())
    }

    /// All of them.
    pub fn all(&self) -> &[Vector3<f32>] {
        &self.0
    }

    /// The number of the direction that a part of the surface with this unit normal faces most, if it faced up in any
    /// capture.
    pub fn faced(&self, normal: Vector3<f32>) -> Option<usize> {
        let facing = self.0.iter().map(|up| up.dot(&normal)).enumerate();
        let most = facing.max_by(|a, b| a.1.total_cmp(&b.1));
        most.filter(|(_, cosine)| *cosine > UP)
            .map(|(number, _)| number)
    }
}

impl Default for UpDirections {
    /// That of a scene of one capture.
    fn default() -> Self {
        Self(vec![Vector3::z()])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::Volume;
    use crate::reconstruct::hull::{Hull, Plane};
    use nalgebra::Point3;

    #[test]
    fn what_lay_on_the_table_of_one_capture_faces_up_in_one_that_was_upside_down() {
        let volume = Volume::new(Point3::origin(), Point3::new(0.1, 0.1, 0.1)).unwrap();
        let upside_down = Plane {
            point: Point3::new(0.0, 0.0, 0.08),
            normal: -Vector3::z(),
        };
        let one = Hull::new(Vec::new(), volume, 2);
        let one = UpDirections::of(one.bounds());
        assert_eq!(one.faced(-Vector3::z()), None);
        assert_eq!(one.faced(Vector3::z()), Some(0));
        let two = Hull::new(Vec::new(), volume, 2).within(&[upside_down]);
        let two = UpDirections::of(two.bounds());
        assert_eq!(two.faced(-Vector3::z()), Some(1));
        assert_eq!(two.faced(Vector3::z()), Some(0));
        assert_eq!(two.faced(Vector3::x()), None);
    }
}
