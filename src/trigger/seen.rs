//! What is seen in a picture that a camera took for a look. Positions are in pixels of that small picture, (0, 0) being
//! the upper left corner of its first pixel.

use serde::{Deserialize, Serialize};

/// A closed polygon.
pub type Polygon = Vec<[u16; 2]>;

/// What is seen in a picture. Members that do not concern the camera, or are not known, are left out.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct LookFigures {
    /// Width of the picture.
    pub width: u32,
    /// Height of the picture.
    pub height: u32,
    /// Pixels of the camera's own picture on a side of one of these.
    pub scale: u32,
    /// Whether the camera joined pixels for this picture.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub is_binned: bool,
    /// Where the camera joined pixels: how many milliseconds before this picture the whole one was exposed that
    /// `clipped_ppm` and `sharpness_percent` are of. Without it they are not known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub measured_before_ms: Option<u64>,
    /// Why the camera does not join pixels although it was to.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub why_whole: Option<String>,
    /// How many of a million of the camera's own pixels are clipped.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub clipped_ppm: Option<u32>,
    /// Where many of them are.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub clipped: Vec<Polygon>,
    /// How sharp the edges are, from 0 to 100: the share of their contrast that lies between neighbouring pixels of the
    /// camera's own picture.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sharpness_percent: Option<u32>,
    /// The silhouette's outline as it would be cut, with its holes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub outline: Option<Vec<Polygon>>,
    /// Sides of the frame that the object touches: `left`, `top`, `right`, `bottom`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub touches: Vec<String>,
    /// Why there is no outline.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub no_outline: Option<String>,
    /// Percent of a depth camera's pixels that have a reading.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub readings_percent: Option<u32>,
}
