//! What the daemon and `scand make-look` say to each other: a line of JSON and pixels one way, a line of JSON and a
//! JPEG the other. The process is confined, for it decodes what cameras send, and has no file but its input and its
//! output.

use serde::{Deserialize, Serialize};

/// The command that makes a look's picture of a frame.
pub const COMMAND: &str = "make-look";
/// The option for the id of the process that started it.
pub const PARENT: &str = "parent";
/// Longest input in bytes: a frame and a background.
pub const LARGEST_INPUT: u64 = 400 << 20;
/// Longest output in bytes.
pub const LARGEST_OUTPUT: u64 = 2 << 20;

/// The first line of the input. The frame's bytes follow it, and then the background's.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Head {
    /// The camera.
    pub camera: String,
    /// Whether the frame has depth readings.
    pub depth: bool,
    /// Pixels of the camera's sensor on a side of one of the frame's: 2 where it joined pixels for the look.
    pub joined: u32,
    /// The frame.
    pub frame: Pixels,
    /// The camera's view of the empty rig.
    pub background: Option<Pixels>,
    /// What the object is cut out with; `None` for a rig that is not calibrated.
    pub cutting: Option<SegmentationSettings>,
}

/// A picture whose bytes follow.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Pixels {
    /// Width in pixels; 0 of a file, which says so itself.
    pub width: u32,
    /// Height in pixels; 0 of a file.
    pub height: u32,
    /// Name of the pixels' encoding, or of the file's format.
    pub encoding: String,
    /// Bytes from one row's start to the next's; 0 of a file.
    pub step: u32,
    /// How many bytes follow.
    pub bytes: u64,
}

/// What does not change from picture to picture.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SegmentationSettings {
    /// The text of a calibration file that has the cameras and the volume.
    pub calibration: String,
    /// The silhouettes' settings.
    pub silhouette: serde_json::Value,
}
