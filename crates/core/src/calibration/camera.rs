//! A camera of a calibrated rig: its lens and its pose. Projects points of the rig into its picture.

use super::{Error, Intrinsics};
use crate::frame::CameraId;
use nalgebra::{Isometry3, Point2, Point3, Quaternion, Translation3, UnitQuaternion, Vector3};

/// A lens at a pose. The camera's frame is optical: x right, y down, z forward.
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    /// Its name.
    pub id: CameraId,
    /// Its lens.
    pub intrinsics: Intrinsics,
    /// Maps a point of the camera's frame into the rig's.
    pub rig_from_camera: Isometry3<f64>,
    /// The inverse, kept because projecting needs it for every point.
    camera_from_rig: Isometry3<f64>,
}

/// Most metres that a camera may be from the rig's origin: one farther away was measured in another unit.
const FARTHEST_M: f64 = 50.0;

/// Refuses a pose that cannot be in metres.
///
/// # Errors
/// If the camera is farther from the rig's origin than any rig is large; in words for a person.
pub(crate) fn check_distance(rig_from_camera: &Isometry3<f64>) -> Result<(), String> {
    let far = rig_from_camera.translation.vector.norm();
    if far <= FARTHEST_M {
        return Ok(());
    }
    Err(format!(
        "it is {far:.0} m from the rig's origin, expected at most {FARTHEST_M} m: its translation looks like millimetres, \
        where metres are expected"
    ))
}

impl Camera {
    /// Puts a lens at a pose.
    pub fn new(id: CameraId, intrinsics: Intrinsics, rig_from_camera: Isometry3<f64>) -> Self {
        Self {
            id,
            intrinsics,
            rig_from_camera,
            camera_from_rig: rig_from_camera.inverse(),
        }
    }

    /// Checks a pose as a recording has it: translation in metres, quaternion x, y, z, w.
    ///
    /// # Errors
    /// If a number is not finite, the translation beyond 1000 m or the quaternion not of length 1 (to 1e-3).
    pub fn pose(translation: [f64; 3], rotation_xyzw: [f64; 4]) -> Result<Isometry3<f64>, Error> {
        if !translation.iter().all(|t| t.is_finite() && t.abs() <= 1e3) {
            return Err(Error::BadValue {
                what: "translation",
                found: format!("{translation:?} m"),
                expected: "finite, within 1000 m",
            });
        }
        let [x, y, z, w] = rotation_xyzw;
        let quaternion = Quaternion::new(w, x, y, z);
        if (quaternion.norm() - 1.0).abs() > 1e-3 || !quaternion.norm().is_finite() {
            return Err(Error::BadValue {
                what: "rotation",
                found: format!("{rotation_xyzw:?}"),
                expected: "a quaternion x, y, z, w of length 1",
            });
        }
        // One that is of length 1 but for its last digits stays what was written.
        let rotation = match (quaternion.norm() - 1.0).abs() < 1e-15 {
            true => UnitQuaternion::new_unchecked(quaternion),
            false => UnitQuaternion::from_quaternion(quaternion),
        };
        Ok(Isometry3::from_parts(
            Translation3::from(translation),
            rotation,
        ))
    }

    /// The camera's centre in the rig's frame.
    pub fn center(&self) -> Point3<f64> {
        self.rig_from_camera.translation.vector.into()
    }

    /// A point of the rig's frame in the camera's.
    #[inline]
    pub fn camera_from_rig(&self, p_in_rig: Point3<f64>) -> Point3<f64> {
        self.camera_from_rig * p_in_rig
    }

    /// Pixel and depth (metres along the optical axis) of a point of the rig's frame; `None` behind the
    /// camera or where the lens model folds over. The pixel may lie outside the picture.
    #[inline]
    pub fn project(&self, p_in_rig: Point3<f64>) -> Option<(Point2<f64>, f64)> {
        let p = self.camera_from_rig(p_in_rig);
        self.intrinsics
            .project(p.x, p.y, p.z)
            .map(|pixel| (pixel, p.z))
    }

    /// [`Camera::project`] as the z-buffer needs it: pixel x, y and depth, NaN if there is none.
    pub fn project_for_raster(&self, p_in_rig: Point3<f32>) -> [f32; 3] {
        match self.project(p_in_rig.cast()) {
            Some((pixel, depth)) => [pixel.x as f32, pixel.y as f32, depth as f32],
            None => [f32::NAN; 3],
        }
    }

    /// Unit direction in the rig's frame in which a pixel looks.
    pub fn ray(&self, pixel: Point2<f64>) -> Option<Vector3<f64>> {
        let n = self.intrinsics.unproject(pixel)?;
        Some(self.rig_from_camera.rotation * Vector3::new(n.x, n.y, 1.0).normalize())
    }

    /// Size in metres that one pixel covers at `p_in_rig`, seen head-on.
    pub fn pixel_footprint(&self, p_in_rig: Point3<f64>) -> f64 {
        let depth = self.camera_from_rig(p_in_rig).z.max(0.0);
        depth / self.intrinsics.focal_px.min()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pose_must_be_a_rotation() {
        assert!(Camera::pose([0.0; 3], [0.0, 0.0, 0.0, 1.0]).is_ok());
        assert!(Camera::pose([0.0; 3], [0.0; 4]).is_err());
        assert!(Camera::pose([0.0; 3], [0.0, 0.0, 0.0, 2.0]).is_err());
        assert!(Camera::pose([0.0; 3], [f64::NAN, 0.0, 0.0, 1.0]).is_err());
        assert!(Camera::pose([f64::INFINITY, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]).is_err());
    }
}
