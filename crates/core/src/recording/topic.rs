//! The topics of a recording and the schemas their messages have.

use crate::frame::CameraId;
use std::fmt;

/// What a channel carries.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Topic {
    /// `/color/{id}/…`
    Color(CameraId, ColorPart),
    /// `/depth/{id}/…`
    Depth(CameraId, DepthPart),
    /// `/tf`: poses.
    Tf,
    /// `/volume`: the box that is reconstructed.
    Volume,
    /// `/trigger`: a capture was asked for.
    Trigger,
    /// `/capture`: a capture is complete or has failed.
    Capture,
    /// `/note`: what a person said of a capture.
    Note,
    /// `/log`: what the daemon had to say.
    Log,
}

/// What a colour camera's channel carries.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum ColorPart {
    /// Frames.
    Image,
    /// Views with no object in them.
    Background,
    /// Silhouettes of frames with the same timestamp.
    Mask,
    /// Intrinsics.
    Calibration,
    /// How the camera was set.
    Settings,
}

/// What a depth camera's channel carries.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
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

const COLOR_PARTS: [(ColorPart, &str); 5] = [
    (ColorPart::Image, "image"),
    (ColorPart::Background, "background"),
    (ColorPart::Mask, "mask"),
    (ColorPart::Calibration, "calibration"),
    (ColorPart::Settings, "settings"),
];

const DEPTH_PARTS: [(DepthPart, &str); 4] = [
    (DepthPart::Image, "image"),
    (DepthPart::Color, "color"),
    (DepthPart::Calibration, "calibration"),
    (DepthPart::Response, "response"),
];

impl Topic {
    /// Reads a topic's name; `None` for one that is no business of ours.
    pub fn parse(name: &str) -> Option<Self> {
        match name {
            "/tf" => return Some(Self::Tf),
            "/volume" => return Some(Self::Volume),
            "/trigger" => return Some(Self::Trigger),
            "/capture" => return Some(Self::Capture),
            "/note" => return Some(Self::Note),
            "/log" => return Some(Self::Log),
            _ => {}
        }
        let mut words = name.strip_prefix('/')?.split('/');
        let (kind, id, part) = (words.next()?, words.next()?, words.next()?);
        let id = CameraId::new(id).ok()?;
        if words.next().is_some() {
            return None;
        }
        match kind {
            "color" => Some(Self::Color(id, named(&COLOR_PARTS, part)?)),
            "depth" => Some(Self::Depth(id, named(&DEPTH_PARTS, part)?)),
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

fn named<P: Copy>(parts: &[(P, &str)], name: &str) -> Option<P> {
    parts.iter().find(|(_, n)| *n == name).map(|(p, _)| *p)
}

fn name_of<P: PartialEq>(parts: &[(P, &'static str)], part: &P) -> &'static str {
    parts.iter().find(|(p, _)| p == part).map_or("", |(_, n)| n)
}

impl fmt::Display for Topic {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Color(id, part) => write!(f, "/color/{id}/{}", name_of(&COLOR_PARTS, part)),
            Self::Depth(id, part) => write!(f, "/depth/{id}/{}", name_of(&DEPTH_PARTS, part)),
            Self::Tf => f.write_str("/tf"),
            Self::Volume => f.write_str("/volume"),
            Self::Trigger => f.write_str("/trigger"),
            Self::Capture => f.write_str("/capture"),
            Self::Note => f.write_str("/note"),
            Self::Log => f.write_str("/log"),
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
