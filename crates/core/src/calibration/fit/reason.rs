//! A reason why a calibration is not good: how much it weighs, what kind it is, and its words. What helps against each
//! kind is for the reader of the report and stands there.

use crate::calibration::CalibrationLevel;
use serde::{Serialize, Serializer};

/// A reason why a calibration is not good.
#[derive(Clone, Debug, PartialEq)]
pub struct Reason {
    /// The best level that a calibration can have because of it.
    pub level: CalibrationLevel,
    /// What kind of reason it is.
    pub kind: ReasonKind,
    /// What was found and what was expected, in words.
    pub words: String,
}

impl Reason {
    /// A reason of a kind.
    pub fn new(level: CalibrationLevel, kind: ReasonKind, words: impl Into<String>) -> Self {
        Self {
            level,
            kind,
            words: words.into(),
        }
    }
}

/// It is written as its words, as calibrations' files and recordings have it.
impl Serialize for Reason {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        to.serialize_str(&self.words)
    }
}

/// The kinds of reasons.
#[derive(Clone, Copy, Debug, Eq, Ord, PartialEq, PartialOrd)]
pub enum ReasonKind {
    /// Views that were left out agree on a cause, which the words name with its remedy.
    Diagnosed,
    /// Pictures of one placement show the board at different places; the words name what to do.
    Contradiction,
    /// Too many views were left out.
    LeftOut,
    /// Two cameras are at one place.
    AtOnePlace,
    /// The residuals are large.
    Residual,
    /// A lens is beyond the lens model.
    BeyondLensModel,
    /// A lens that was given does not fit.
    GivenLens,
    /// Many corners were dropped.
    DroppedCorners,
    /// A camera has few views.
    FewViews,
    /// The board was seen in a small part of a camera's picture.
    Coverage,
    /// There are few placements.
    FewPlacements,
    /// Cameras are joined to the others by one placement only.
    SingleJoint,
    /// A camera's focal length is known poorly.
    FocalLength,
    /// Placements that were held out are predicted poorly.
    HeldOut,
    /// The board is bent.
    Bent,
    /// The board's squares are longer in one direction.
    Stretched,
    /// The board seems to change its shape, or too few placements show it.
    ShapeNotHeld,
    /// A camera could not be calibrated.
    NotCalibrated,
    /// It is not known which placement is the table.
    TableUnknown,
    /// Lengths that were measured contradict the board's.
    Scale,
    /// A depth camera has no response of this session.
    NoResponse,
    /// A depth camera's readings are biased.
    DepthBias,
    /// A depth camera's distances are known poorly, because boards show too little of them.
    DepthUnknown,
    /// Too many boards that a depth camera read were left out.
    DepthLeftOut,
    /// A depth camera's readings changed during the session.
    DepthChanged,
    /// Depth is displaced against its colour picture.
    DepthMisregistered,
    /// Readings differ from the middle of the picture to its corners.
    DepthBowl,
    /// Readings are not linear in the distance.
    DepthNotLinear,
}
