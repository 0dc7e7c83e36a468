//! A rig's cameras and what their depth readings mean: projects, unprojects, linearises, and reads and writes
//! calibration files. This room sees no pictures.

mod board;
mod camera;
mod depth_response;
pub mod exchange;
mod file;
pub mod fit;
mod intrinsics;
pub mod response;
mod verdict;

pub use board::{Board, BoardKind, BoardShape, Face, Markers, Rectangle, Surface};
pub use camera::Camera;
pub(crate) use camera::check_distance;
pub use depth_response::DepthResponse;
pub use file::{FileError, RigCalibration};
pub use intrinsics::{Distortion, Intrinsics};
pub use verdict::{CalibrationLevel, CalibrationRecord, CalibrationVerdict};

use nalgebra::{Point2, Point3};

/// Why a calibration is refused.
#[derive(Debug, thiserror::Error, PartialEq)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum Error {
    /// A number out of its range.
    #[error("{what} is {found}, expected {expected}")]
    BadValue {
        what: &'static str,
        found: String,
        expected: &'static str,
    },
    /// The same, where the range is checked by [`crate::range`].
    #[error("{what} is {found}, expected {expected}")]
    OutOfRange {
        what: &'static str,
        found: String,
        expected: String,
    },
    /// A lens model that is not read.
    #[error("distortion model is {0:?}, expected plumb_bob, rational_polynomial or an empty name")]
    UnknownDistortionModel(String),
}

/// The box that bounds the object, in the rig's frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Volume {
    /// Smallest corner.
    pub min: Point3<f64>,
    /// Largest corner.
    pub max: Point3<f64>,
}

impl Volume {
    /// Longest edge that a volume may have, in metres: larger than any rig, small enough to bound the work.
    pub const LONGEST_EDGE: f64 = 10.0;
    /// Shortest edge that a volume may have, in metres.
    pub const SHORTEST_EDGE: f64 = 1e-4;

    /// Checks and makes a volume.
    ///
    /// # Errors
    /// If a coordinate is not finite, or an edge is not from 0.1 mm to 10 m.
    pub fn new(min: Point3<f64>, max: Point3<f64>) -> Result<Self, Error> {
        let edges = max - min;
        let fits = |e: f64| (Self::SHORTEST_EDGE..=Self::LONGEST_EDGE).contains(&e);
        if min.coords.iter().all(|c| c.is_finite() && c.abs() <= 1e3)
            && edges.iter().all(|&e| fits(e))
        {
            return Ok(Self { min, max });
        }
        Err(Error::BadValue {
            what: "volume",
            found: format!(
                "{:?} to {:?} m",
                min.coords.as_slice(),
                max.coords.as_slice()
            ),
            expected: "edges from 0.0001 to 10 m, within 1000 m of the origin",
        })
    }
}

/// A depth camera: where it is, and what its readings mean.
#[derive(Clone, Debug, PartialEq)]
pub struct DepthCamera {
    /// Lens and pose, shared by its depth and its colour.
    pub camera: Camera,
    /// From raw readings to metres.
    pub response: DepthResponse,
}

impl DepthCamera {
    /// The pixel that sees a point of the rig's frame, and its depth in metres along the optical axis;
    /// `None` behind the camera. The pixel may lie outside the picture.
    #[inline]
    pub fn project(&self, p_in_rig: Point3<f64>) -> Option<(Point2<f64>, f64)> {
        let p = self.camera.camera_from_rig(p_in_rig);
        self.response
            .project(&self.camera.intrinsics, p)
            .map(|pixel| (pixel, p.z))
    }

    /// [`DepthCamera::project`] as the z-buffer needs it: pixel x, y and depth, NaN if there is none.
    pub fn project_for_raster(&self, p_in_rig: Point3<f32>) -> [f32; 3] {
        match self.project(p_in_rig.cast()) {
            Some((pixel, depth)) => [pixel.x as f32, pixel.y as f32, depth as f32],
            None => [f32::NAN; 3],
        }
    }

    /// The point of the rig's frame at `depth` metres seen by `pixel`; `None` where the lens model cannot be
    /// inverted.
    pub fn point(&self, pixel: Point2<f64>, depth: f64) -> Option<Point3<f64>> {
        let p = self.response.point(&self.camera.intrinsics, pixel, depth)?;
        Some(self.camera.rig_from_camera * p)
    }
}
