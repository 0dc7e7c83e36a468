//! The poses in which one object is shown, one for each capture, as words of the command line. `lay` computes where
//! they put it.

use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// How an object lies when it is captured.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
#[serde(try_from = "String", into = "String")]
pub enum Pose {
    /// As it was made.
    Upright,
    /// Upside down, turned by any angle; on its side if it cannot stand so.
    Flip,
    /// On the side that looked towards this azimuth (degrees), or on any.
    Side(Option<f64>),
    /// Upright, turned about the vertical by this many degrees.
    Turn(f64),
    /// Let go in any orientation.
    Any,
}

impl fmt::Display for Pose {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Upright => write!(f, "upright"),
            Self::Flip => write!(f, "flip"),
            Self::Side(None) => write!(f, "side"),
            Self::Side(Some(degrees)) => write!(f, "side:{degrees}"),
            Self::Turn(degrees) => write!(f, "turn:{degrees}"),
            Self::Any => write!(f, "any"),
        }
    }
}

impl FromStr for Pose {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (word, degrees) = match text.split_once(':') {
            Some((word, degrees)) => (word, Some(degrees)),
            None => (text, None),
        };
        let angle = |degrees: &str| {
            let parsed: Option<f64> = degrees.parse().ok();
            let within = parsed.filter(|d| d.abs() <= 360.0);
            within.ok_or_else(|| format!("{degrees:?} is not an angle from -360 to 360 degrees"))
        };
        match (word, degrees) {
            ("upright", None) => Ok(Self::Upright),
            ("flip", None) => Ok(Self::Flip),
            ("side", None) => Ok(Self::Side(None)),
            ("side", Some(degrees)) => Ok(Self::Side(Some(angle(degrees)?))),
            ("turn", Some(degrees)) => Ok(Self::Turn(angle(degrees)?)),
            ("any", None) => Ok(Self::Any),
            _ => Err(format!(
                "{text:?} is not a pose: expected upright, flip, side, side:DEGREES, turn:DEGREES or any"
            )),
        }
    }
}

impl TryFrom<String> for Pose {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl From<Pose> for String {
    fn from(pose: Pose) -> Self {
        pose.to_string()
    }
}
