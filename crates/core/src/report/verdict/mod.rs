//! The verdict: green, amber or red, with its reasons. It depends only on figures and limits. The rules are in
//! `capture` (how the pictures were taken), `silhouettes`, `depth` and `model`.

mod capture;
mod depth;
mod model;
mod parameters;
mod silhouettes;
#[cfg(test)]
mod tests;

pub use parameters::{Limits, Parameters};

use super::Measurements;
use crate::capture::CaptureFacts;
use crate::frame::CameraId;
use crate::level::Level;
use serde::Serialize;

/// What a reason is about; for programs, as the words are for people.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[cfg_attr(test, derive(serde::Deserialize))]
#[serde(rename_all = "snake_case")]
pub enum ReasonCode {
    /// A silhouette is displaced from where the other cameras put it: the camera moved.
    CameraDisplaced,
    /// All silhouettes are displaced against the model: the calibration is that of another recording or rig.
    CalibrationForeign,
    /// Two cameras have each other's pictures or poses.
    CamerasExchanged,
    /// The hull does not cover a silhouette: it, or another camera's, is wrong.
    SilhouetteUncovered,
    /// The frame cuts the object.
    FrameCut,
    /// The volume cuts the object, as far as outlines tell.
    VolumeCut,
    /// Pictures are too bright.
    Overexposed,
    /// Pictures are too dark.
    Underexposed,
    /// Pictures are out of focus, or something moved.
    Blurred,
    /// The backdrop differs from its background picture.
    BackdropChanged,
    /// Without colours, only an outline distinguishes the object from its shadow.
    ToldByOutline,
    /// The background is old.
    BackgroundOld,
    /// The cameras did not take their pictures together.
    Skew,
    /// The calibration is doubtful, or was refused.
    CalibrationDoubtful,
    /// A camera takes no part.
    CameraLeftOut,
    /// What reading the recording had to say.
    Warning,
    /// Parts of the recording cannot be read.
    Damage,
    /// No depth camera took part in the capture.
    NoDepthCamera,
    /// The method uses no depth.
    DepthNotUsed,
    /// A depth camera has no readings of the object.
    NoDepth,
    /// No concave region was found.
    NoRegion,
    /// Little of a concave region was read.
    RegionUnread,
    /// Nearly all that a depth camera sees was restored from it.
    RegionLarge,
    /// Model and depth do not agree in a concave region.
    DepthDisagrees,
    /// A depth camera is off by more than its calibration says.
    DepthBiased,
    /// The object's outline in the depth is not where the hull's is.
    DepthOutline,
    /// Outside of hollows, a depth camera reads the object elsewhere than the model has it.
    DepthElsewhere,
    /// Nothing shows by how much a depth camera is off.
    DepthUnchecked,
    /// No depth camera read parts of the hull that face up: each may be the lid over a hollow.
    LidUnread,
    /// Much of the surface is a guess, because no camera saw it, or a depth camera saw through it.
    Unobserved,
    /// Much of the model bridges holes of the depth.
    HolesBridged,
    /// The model itself expects a large error.
    ErrorLarge,
    /// Carving contradicted colour cameras and was undone.
    CarvingUndone,
    /// Pieces were dropped.
    PiecesDropped,
    /// The model is not a solid.
    NotWatertight,
    /// The model is in more pieces than the object.
    SeveralComponents,
    /// The model has more handles than most objects have: it may be perforated.
    ManyHandles,
    /// The depth opened holes that no silhouette shows.
    OpenedByDepth,
    /// Much of the model was seen by no colour camera.
    Unpainted,
    /// How the pose of a capture was found, if several captures of one object are fused.
    PoseFound,
    /// The evidence for the pose of a capture is not clear.
    PoseDoubtful,
    /// A turn of a capture cannot be known.
    TurnUnknown,
    /// A capture of the object is not part of the model.
    CaptureLeftOut,
    /// What is ignored in the pictures leaves it open whether more belongs to the object.
    Unproved,
    /// No silhouette requires pieces of the model: they may be phantoms.
    PieceUnrequired,
}

/// One reason of a verdict.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Reason {
    /// How much it weighs.
    pub level: Level,
    /// What it is about.
    pub code: ReasonCode,
    /// The cameras it is about, the worst one first.
    pub cameras: Vec<CameraId>,
    /// What a person should know.
    pub words: String,
}

/// How far a model can be trusted, and why.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Verdict {
    /// The level of the gravest reason.
    pub level: Level,
    /// The reasons, the gravest ones first.
    pub reasons: Vec<Reason>,
}

impl Verdict {
    fn of(mut reasons: Vec<Reason>) -> Self {
        reasons.sort_by_key(|reason| std::cmp::Reverse(reason.level));
        Self {
            level: reasons.first().map_or(Level::Green, |first| first.level),
            reasons,
        }
    }

    /// With more reasons.
    #[must_use]
    pub fn with(self, more: Vec<Reason>) -> Self {
        let mut reasons = self.reasons;
        reasons.extend(more);
        Self::of(reasons)
    }
}

/// Judges a model by the figures of its reconstruction and by how its capture was taken.
pub fn judge(measured: &Measurements, capture: &CaptureFacts, parameters: &Parameters) -> Verdict {
    let mut reasons = Vec::new();
    silhouettes::judge(measured, parameters, &mut reasons);
    depth::judge(measured, parameters, &mut reasons);
    model::judge(measured, parameters, &mut reasons);
    capture::judge(capture, parameters, &mut reasons);
    Verdict::of(reasons)
}

impl Limits {
    /// The level of a value; `None` if it gives no reason. A value that is not a number is beyond all limits.
    fn level(&self, value: f64) -> Option<Level> {
        let within = |limit: f64| value <= limit;
        match self.red {
            Some(red) if !within(red) => Some(Level::Red),
            _ => (!within(self.amber)).then_some(Level::Amber),
        }
    }
}

/// One reason about all cameras whose value is beyond its limits, the worst one first. `words` is given their
/// names and values.
fn about_cameras<'a>(
    code: ReasonCode,
    limits: &Limits,
    values: impl Iterator<Item = (&'a CameraId, f64)>,
    in_words: impl Fn(f64) -> String,
    words: impl Fn(&str) -> String,
) -> Option<Reason> {
    let beyond = |&(_, value): &(&CameraId, f64)| limits.level(value).is_some();
    let mut found: Vec<_> = values.filter(beyond).collect();
    found.sort_by(|a, b| b.1.total_cmp(&a.1).then_with(|| a.0.cmp(b.0)));
    let (_, worst) = found.first()?;
    let level = limits.level(*worst)?;
    let listed = found.iter().take(NAMED);
    let mut names: Vec<String> = listed
        .map(|(camera, value)| format!("{camera} ({})", in_words(*value)))
        .collect();
    if found.len() > NAMED {
        names.push(format!("{} more", found.len() - NAMED));
    }
    Some(Reason {
        level,
        code,
        cameras: found.iter().map(|(camera, _)| (*camera).clone()).collect(),
        words: words(&names.join(", ")),
    })
}

/// Cameras that a reason names in words; the others are counted.
const NAMED: usize = 4;

fn percent(share: f64) -> String {
    let percent = 100.0 * share;
    if percent.abs() < 10.0 {
        format!("{percent:.1} %")
    } else {
        format!("{percent:.0} %")
    }
}

fn mm(metres: f64) -> String {
    format!("{:.1} mm", 1e3 * metres)
}
