//! Finds how several captures of one rigid object lie against each other, or says why that cannot be known. The
//! evidence is of three kinds: silhouettes, colours and depth. A pose is only accepted if the silhouettes determine it,
//! if colours or depth choose it among the poses that the silhouettes allow, or if the choice does not change the form.
//! No I/O, no clock and no random numbers.
//!
//! - `contour` and `outline` find a silhouette's contour, and the distance to it without the lens' distortion;
//! - `body` prepares a capture: its outlines, viewing rays and hull;
//! - `search` tries all rotations on the hulls' distance grids; `align` refines the best by rays that must `touch`, and
//!   `sweep` looks for those that the search missed;
//! - `determination` finds the directions in which the silhouettes do not determine the pose;
//! - `loose` asks colours where silhouettes hold a pose, but hold it loosely;
//! - `skin` compares colours, which may be `alike` at every turn, and `depth` readings; `noise` measures how far a
//!   capture contradicts itself, `spots` finds where the object changed, and `lost` an outline that lost a piece;
//! - `decide` compares two captures, with `witnesses` where the silhouettes leave a choice, and with a `scale` where
//!   their calibrations differ; `comparisons` keeps what was found of pairs, `places` makes groups of it, and `group`
//!   does so for all and states what was found;
//! - `unseen` measures what no camera faced.

mod align;
mod alike;
mod body;
mod comparisons;
mod contour;
mod decide;
mod depth;
mod determination;
mod group;
mod limits;
mod loose;
mod lost;
mod motion;
mod noise;
mod outline;
mod places;
mod scale;
mod search;
mod skin;
mod spots;
mod sweep;
mod touch;
mod unseen;
mod witnesses;

pub use group::register;
pub use noise::{ContourStretch, Disagreement};
pub use unseen::Unseen;

use crate::level::Level;
use crate::reconstruct::silhouette::Silhouette;
use crate::reconstruct::{Scene, hull};
use nalgebra::{Isometry3, UnitVector3};

/// A capture, with the silhouettes of its colour cameras in their order.
#[derive(Clone, Copy)]
pub struct CaptureSilhouettes<'a> {
    /// The capture.
    pub scene: &'a Scene,
    /// Its silhouettes.
    pub silhouettes: &'a [Silhouette],
}

/// Why a capture cannot be compared with others.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// It has no hull.
    #[error(transparent)]
    Hull(#[from] hull::Error),
}

/// Which evidence a pose was found by.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum PoseEvidence {
    /// None is needed: the object has the frame of this capture's rig.
    Frame,
    /// The silhouettes alone.
    Silhouettes,
    /// Colours, among poses that agree with the silhouettes.
    Colours,
    /// Depth, among poses that agree with the silhouettes.
    Depth,
    /// Nothing: a turn cannot be known, and the form does not depend on it.
    Nothing,
    /// A person gave it.
    Given,
}

/// Why a capture has no pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Refusal {
    /// It could not be read, or has no silhouettes.
    Unusable,
    /// Its silhouettes contradict each other.
    ContradictsItself,
    /// It has no hull.
    NoHull,
    /// In every pose its silhouettes contradict those of the others.
    NoPose,
    /// Its silhouettes agree with those of the others in no pose, but would if the lengths of its calibration were
    /// others.
    Scale,
    /// A stretch of a contour contradicts the others.
    Stretch,
    /// Depth contradicts the pose that silhouettes or colours chose.
    DepthContradicts,
    /// Several poses differ in more than the silhouettes show, and nothing decides.
    Undecided,
    /// It agrees with another capture, but not with all.
    AllAtOnce,
    /// Too many captures were compared before its turn came.
    NotCompared,
}

/// Another pose that agrees with the silhouettes.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct OtherPose {
    /// How far it is turned against the best one.
    pub turned_deg: f64,
    /// How far it moves the surface, root of the mean square.
    pub moved_mm: f64,
    /// How far the silhouettes contradict it.
    pub disagreement_mm: f64,
}

/// How well the colours of two captures agree at a pose.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct ColorAgreement {
    /// Correlation of the contrasts over the common surface at the pose.
    pub best: f64,
    /// The highest correlation at another pose that agrees with the silhouettes; 0 without such a pose.
    pub next: f64,
    /// Standard deviation of the logarithm of brightness against its surroundings, of the plainer capture.
    pub contrast: f64,
    /// Points of the common surface that were compared at the pose.
    #[serde(skip)]
    pub points: usize,
}

/// How many depth readings contradict a pose.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct DepthWitness {
    /// Share of the common readings that contradict the pose.
    pub contradicting: f64,
    /// The least share at any pose that agrees with the silhouettes.
    pub least: f64,
}

/// The result for one capture: its pose, with the evidence, or why it has none.
#[derive(Clone, Debug)]
pub struct Registered {
    /// Which evidence its pose was found by, or why it has none.
    pub verdict: Result<PoseEvidence, Refusal>,
    /// Green where the evidence is clear, else amber; red where there is no pose.
    pub level: Level,
    /// Maps a point of the object into the capture's rig. Where the pose is refused, the best there is, or `None`.
    pub rig_from_object: Option<Isometry3<f64>>,
    /// The number of the capture that it was compared with.
    pub against: Option<usize>,
    /// Standard deviation of its turn.
    pub sigma_deg: f64,
    /// Standard deviation of its place.
    pub sigma_mm: f64,
    /// The axis in the object's frame about which its turn is not known from form.
    pub free_axis: Option<UnitVector3<f64>>,
    /// The number of another capture whose turn is not known, and against which this one's pose was found: both follow
    /// one turn.
    pub turns_with: Option<usize>,
    /// How far its silhouettes contradict each other, in millimetres.
    pub own_noise_mm: f64,
    /// How far silhouettes contradict the pose, in millimetres.
    pub disagreement_mm: Option<f64>,
    /// Beyond this many millimetres the pose is refused.
    pub accepted_mm: f64,
    /// The worst stretch of contour, and the number of its capture. If the object may have changed, that where it did.
    pub worst_stretch: Option<(usize, ContourStretch)>,
    /// Whether outlines of several cameras disagree at one place, so that something may have broken off there.
    pub may_have_changed: bool,
    /// Whether depth contradicts the pose.
    pub depth: Option<DepthWitness>,
    /// How well colours agree at the pose.
    pub colours: Option<ColorAgreement>,
    /// By which share the lengths of its calibration are larger than those of the capture that it was compared with,
    /// if the silhouettes would agree without that, or agree clearly better; `None` where that explains nothing.
    pub larger_by: Option<f64>,
    /// Other poses that agree with the silhouettes.
    pub rivals: Vec<OtherPose>,
    /// How far all other captures together contradict its silhouettes, in millimetres.
    pub all_at_once_mm: Option<f64>,
}

/// How captures of one object lie against each other.
#[derive(Clone, Debug)]
pub struct Registration {
    /// The number of the capture whose rig is the object's frame.
    pub frame_of: usize,
    /// A capture each, in their order.
    pub captures: Vec<Registered>,
    /// What no camera of the captures with a pose faced.
    pub unseen: Unseen,
}

impl Registered {
    /// Whether the capture has a pose.
    pub fn is_placed(&self) -> bool {
        self.verdict.is_ok()
    }

    /// Whether it has a pose that colours had no part in, both captures show a pattern, and the patterns have nothing
    /// in common at that pose.
    pub fn do_colours_contradict(&self) -> bool {
        let without = [PoseEvidence::Silhouettes, PoseEvidence::Given];
        let is_without = self.verdict.is_ok_and(|by| without.contains(&by));
        is_without
            && self
                .colours
                .as_ref()
                .is_some_and(limits::do_colours_contradict)
    }

    /// Whether its pose was given, silhouettes leave a turn open, and colours do not confirm the turn that was given:
    /// nothing else says that it is right.
    pub fn is_turn_only_given(&self) -> bool {
        let is_confirmed = self
            .colours
            .as_ref()
            .is_some_and(limits::do_colours_confirm);
        self.verdict == Ok(PoseEvidence::Given) && self.free_axis.is_some() && !is_confirmed
    }
}

impl Registration {
    /// The numbers of the captures with a pose.
    pub fn placed(&self) -> Vec<usize> {
        let numbers = 0..self.captures.len();
        numbers.filter(|&i| self.captures[i].is_placed()).collect()
    }
}

#[cfg(test)]
mod tests;
