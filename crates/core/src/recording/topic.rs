//! The topics of a recording and the schemas of their messages. The parts of a topic's name are the names of the enums'
//! members in lower case. A new member needs its schemas in `Topic::schemas`; ARCHITECTURE.md lists the other files to
//! change.

use crate::frame::CameraId;
use serde::de::IntoDeserializer;
use serde::de::value::Error as NotAWord;
use serde::{Deserialize, Serialize};
use std::fmt;

/// What a channel carries. Only [`Topic::parse`] and `Display` use what serde derives.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Deserialize, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Topic {
    /// `/color/{id}/…`
    #[serde(skip)]
    Color(CameraId, ColorPart),
    /// `/depth/{id}/…`
    #[serde(skip)]
    Depth(CameraId, DepthPart),
    /// `/tf`: poses.
    Tf,
    /// `/volume`: the box that is reconstructed.
    Volume,
    /// `/trigger`: a capture was asked for.
    Trigger,
    /// `/capture`: a capture is complete or has failed.
    Capture,
    /// `/note`: a person's note on a capture.
    Note,
    /// `/log`: lines of the daemon's log.
    Log,
}

/// What a colour camera's channel carries.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Deserialize, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum ColorPart {
    /// Frames.
    Image,
    /// Views with no object in them.
    Background,
    /// Silhouettes of frames with the same timestamp.
    Mask,
    /// What is not to be looked at in frames with the same timestamp.
    Ignore,
    /// Intrinsics.
    Calibration,
    /// How the camera was set.
    Settings,
}

/// What a depth camera's channel carries.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Deserialize, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum DepthPart {
    /// Raw readings.
    Image,
    /// Colour pictures registered to them.
    Color,
    /// Intrinsics that both share.
    Calibration,
    /// What turns readings into metres.
    Response,
}

impl Topic {
    /// Parses a topic's name; `None` if it is not a topic of the format.
    pub fn parse(name: &str) -> Option<Self> {
        let mut words = name.strip_prefix('/')?.split('/');
        let first = words.next()?;
        let Some(id) = words.next() else {
            return from_word(first);
        };
        let part = words.next()?;
        let id = CameraId::new(id).ok()?;
        if words.next().is_some() {
            return None;
        }
        match first {
            "color" => Some(Self::Color(id, from_word(part)?)),
            "depth" => Some(Self::Depth(id, from_word(part)?)),
            _ => None,
        }
    }

    /// The schemas that its messages may have.
    pub(super) fn schemas(&self) -> &'static [&'static str] {
        match self {
            Self::Color(_, ColorPart::Calibration) | Self::Depth(_, DepthPart::Calibration) => {
                &["foxglove.CameraCalibration"]
            }
            Self::Color(_, ColorPart::Settings) => &["scand.CameraSettings"],
            Self::Depth(_, DepthPart::Image) => &["foxglove.RawImage"],
            Self::Depth(_, DepthPart::Response) => &["scand.DepthResponse"],
            Self::Color(..) | Self::Depth(_, DepthPart::Color) => {
                &["foxglove.RawImage", "foxglove.CompressedImage"]
            }
            Self::Tf => &["foxglove.FrameTransform", "foxglove.FrameTransforms"],
            Self::Volume => &["scand.Volume"],
            Self::Trigger => &["scand.Trigger"],
            Self::Capture => &["scand.Capture"],
            Self::Note => &["scand.Note"],
            Self::Log => &["foxglove.Log"],
        }
    }
}

/// The member of an enum that has this word.
fn from_word<'de, T: Deserialize<'de>>(word: &'de str) -> Option<T> {
    let word: serde::de::value::StrDeserializer<'_, NotAWord> = word.into_deserializer();
    T::deserialize(word).ok()
}

impl fmt::Display for Topic {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("/")?;
        match self {
            Self::Color(id, part) => {
                write!(f, "color/{id}/")?;
                part.serialize(f)
            }
            Self::Depth(id, part) => {
                write!(f, "depth/{id}/")?;
                part.serialize(f)
            }
            one_of_a_kind => one_of_a_kind.serialize(f),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_and_topics_are_one_to_one() {
        for name in [
            "/color/c00/image",
            "/color/c00/background",
            "/color/c-1/mask",
            "/color/c-1/ignore",
            "/color/c_1/calibration",
            "/color/x/settings",
            "/depth/kinect/image",
            "/depth/kinect/color",
            "/depth/kinect/calibration",
            "/depth/kinect/response",
            "/tf",
            "/volume",
            "/trigger",
            "/capture",
            "/note",
            "/log",
        ] {
            assert_eq!(Topic::parse(name).unwrap().to_string(), name);
        }
        for name in [
            "",
            "/",
            "tf",
            "/color",
            "/color/c",
            "/Tf",
            "/color/C/image",
            "/color/c/response",
            "/color//image",
        ] {
            assert_eq!(Topic::parse(name), None, "{name}");
        }
        assert_eq!(Topic::parse("/color/c/image/x"), None);
        assert_eq!(Topic::parse("/depth/c/background"), None);
    }
}
