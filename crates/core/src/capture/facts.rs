//! Facts about a capture for the verdict and the report that its pictures do not show. Data only.

use crate::calibration::CalibrationVerdict;
use crate::frame::{CameraId, CaptureId, Timestamp};
use crate::recording::Damage;
use serde::Serialize;

/// How a capture was taken.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CaptureFacts {
    /// Its name.
    pub id: CaptureId,
    /// When it was triggered, in UTC nanoseconds.
    pub time_ns: Timestamp,
    /// What triggered it.
    pub source: String,
    /// The object's number: the trigger's, or else the session's.
    pub subject: Option<String>,
    /// How the object lay, in a person's words.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub placement: Option<String>,
    /// Spread of the colour cameras' timestamps in nanoseconds.
    pub skew_ns: u64,
    /// Its colour cameras, in the order of their ids.
    pub colors: Vec<ColorFacts>,
    /// Its depth cameras, in the order of their ids.
    pub depths: Vec<DepthFacts>,
    /// What the calibration is worth, where that is known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub calibration: Option<CalibrationVerdict>,
    /// Cameras that take no part, each a reason for amber.
    pub left_out: Vec<LeftOutCamera>,
    /// What else a person should know.
    pub warnings: Vec<String>,
    /// Parts of the file that could not be read.
    pub damage: Vec<Damage>,
}

/// How a colour camera took part.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ColorFacts {
    /// The camera.
    pub camera: CameraId,
    /// Its frame's timestamp less the trigger's, in nanoseconds.
    pub delay_ns: i64,
    /// What its silhouette comes from.
    pub silhouette: Silhouette,
}

/// What a silhouette comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case", tag = "from")]
pub enum Silhouette {
    /// A mask in the recording.
    Mask,
    /// The view with no object in it.
    Background {
        /// Nanoseconds from the background to the trigger.
        age_ns: u64,
    },
}

/// How a depth camera took part.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DepthFacts {
    /// The camera.
    pub camera: CameraId,
    /// Depth frames of the burst.
    pub frames: usize,
    /// Different colour pictures that go with them; 0 when a uniform grey is used instead.
    pub color_frames: usize,
    /// Largest difference in time between a depth frame and its colour, in nanoseconds.
    pub largest_color_lag_ns: u64,
}

/// A camera that takes no part.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct LeftOutCamera {
    /// The camera.
    pub camera: CameraId,
    /// Why.
    pub reason: String,
}
