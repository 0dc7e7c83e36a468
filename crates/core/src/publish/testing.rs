//! A published object for the tests of this room.

use super::{Facts, LevelFile, Picture, PublishedObject, Share};
use crate::description::Description;
use crate::level::Level;

/// What an object may be called.
pub(super) const HOSTILE: &str = "\"><script>alert(1)</script>'\u{1b}\u{202e}x";

pub(super) fn described() -> Description {
    Description {
        capture: "annes-session-0001".into(),
        captures: Some("annes-session-0001, annes-session-0002".into()),
        subject: Some("1884.3".into()),
        title: Some("A cup".into()),
        operator: Some("Ann".into()),
        project: Some("secret project".into()),
        rights: Some("CC0".into()),
        session: Some("annes-session".into()),
        rig: Some("rig 4711".into()),
        time: "2026-01-01T00:00:05.000Z".into(),
        input_sha256: "0123abcd4567".into(),
        calibration_sha256: "89ab".into(),
        program: "scand 0.1.0".into(),
    }
}

pub(super) fn object() -> PublishedObject {
    let level = |name: &str, quality, triangles| LevelFile {
        name: name.into(),
        quality,
        triangles,
        bytes: triangles * 20,
    };
    let picture = |name: &str, size| Picture {
        name: name.into(),
        size,
        bytes: 9000,
    };
    PublishedObject {
        id: "1884-3-0123abcd".into(),
        about: described(),
        facts: Facts {
            level: Some(Level::Amber),
            reasons: vec![super::Reason {
                code: "region_unread".into(),
                words: "kinect-4711 saw little".into(),
            }],
            shares: vec![Share {
                provenance: "hull".into(),
                share: 0.75,
                mean_expected_error: 0.0004,
            }],
            is_watertight: Some(true),
            volume: Some(7.3e-5),
            notes: vec!["note by Bea: broken".into()],
        },
        bounds: [[-0.04, -0.03, 0.0], [0.04, 0.03, 0.1]],
        levels: vec![
            level("high.glb", "High", 4000),
            level("medium.glb", "Medium", 1000),
            level("low.glb", "Low", 250),
        ],
        picture: picture("picture.jpg", (1200, 900)),
        thumbnail: picture("thumbnail.jpg", (400, 300)),
    }
}
