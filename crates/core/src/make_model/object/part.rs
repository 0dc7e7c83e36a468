//! The part of a report that tells how captures of one object were fused, and the reasons that come from it.

use crate::frame::CaptureId;
use crate::level::Level;
use crate::register::{
    ColorAgreement, DepthWitness, OtherPose, PoseEvidence, Refusal, Registered, Registration,
};
use crate::report::{Reason, ReasonCode};
use serde::Serialize;

/// Degrees of a turn's standard deviation from which on the words say that silhouettes hold it loosely.
const LOOSE_DEG: f64 = 1.0 / 3.0;
/// Share of depth readings that contradict a given pose, from which on the words say so.
const DEPTH_TOLD: f64 = 0.05;

/// How captures were fused.
#[derive(Clone, Debug, Serialize)]
pub struct Fusion {
    /// The object's number, or other name.
    pub subject: String,
    /// The capture whose rig is the model's frame.
    pub frame_of: CaptureId,
    /// A capture each, in the order of their triggers.
    pub captures: Vec<FusedCapture>,
    /// Captures that did not count, in words.
    pub not_used: Vec<String>,
    /// Share of the surface that no camera of any fused capture faced.
    pub unseen_share: f64,
    /// Where that lies, as the object stands in the last of them.
    pub unseen_side: Option<&'static str>,
}

/// A capture in a fusion.
#[derive(Clone, Debug, Serialize)]
pub struct FusedCapture {
    /// The file name of its recording.
    pub recording: String,
    /// Its name.
    pub id: CaptureId,
    /// How the object lay, in a person's words.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub placement: Option<String>,
    /// Whether it is part of the model.
    pub is_fused: bool,
    /// How its pose was found; `null` without a pose.
    pub held_by: Option<PoseEvidence>,
    /// Why it has no pose.
    pub refused: Option<Refusal>,
    /// How clear the evidence is.
    pub level: Level,
    /// The same in words.
    pub words: String,
    /// Maps a point of the object into the capture's rig.
    pub rig_from_object: Option<Pose>,
    /// The capture that it was compared with.
    pub compared_with: Option<CaptureId>,
    /// Standard deviation of its turn.
    pub sigma_deg: Option<f64>,
    /// Standard deviation of its place.
    pub sigma_mm: Option<f64>,
    /// The axis, in the object's frame, about which the form leaves the turn open.
    pub free_axis: Option<[f64; 3]>,
    /// Another capture whose turn is not known, and which this one's turn follows.
    pub turns_with: Option<CaptureId>,
    /// How far its silhouettes contradict each other.
    pub own_noise_mm: f64,
    /// How far silhouettes contradict its pose.
    pub disagreement_mm: Option<f64>,
    /// The most of that that is accepted.
    pub accepted_mm: f64,
    /// How far all other captures together contradict its silhouettes.
    pub all_at_once_mm: Option<f64>,
    /// The stretch of contour that misses most.
    pub worst_stretch: Option<WorstStretch>,
    /// By which share the lengths of its calibration are larger than those of `compared_with`, where that alone keeps
    /// the silhouettes from agreeing, or from agreeing clearly better.
    pub larger_by: Option<f64>,
    /// What depth says.
    pub depth: Option<DepthWitness>,
    /// What colours say.
    pub colours: Option<ColorAgreement>,
    /// Other poses that agree with the silhouettes.
    pub rivals: Vec<OtherPose>,
    /// What it was used for.
    pub used_for: Vec<&'static str>,
}

/// A pose as a report has it.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Pose {
    /// Quaternion x y z w.
    pub rotation: [f64; 4],
    /// In metres.
    pub translation: [f64; 3],
}

/// A stretch of contour that misses.
#[derive(Clone, Debug, Serialize)]
pub struct WorstStretch {
    /// Its capture.
    pub capture: CaptureId,
    /// Its camera.
    pub camera: String,
    /// Its length.
    pub length_px: f64,
    /// By how much it misses.
    pub miss_px: f64,
}

/// What is known of a capture besides its pose.
pub(super) struct Known {
    pub(super) recording: String,
    pub(super) id: CaptureId,
    pub(super) cameras: Vec<String>,
    /// How the object lay, in a person's words.
    pub(super) placement: Option<String>,
    /// Why it could not be compared with others.
    pub(super) problem: Option<String>,
}

impl Fusion {
    /// Of a registration; whether its poses were given.
    pub(super) fn new(
        subject: &str,
        (known, is_given): (&[Known], bool),
        found: &Registration,
        not_used: Vec<String>,
    ) -> Self {
        let is_one = found.placed().len() > 1 || known.len() == 1;
        let told = Told {
            known,
            is_given,
            is_one,
        };
        let capture = |i: usize| fused_capture(i, &told, &found.captures[i]);
        Self {
            subject: subject.to_owned(),
            frame_of: known[found.frame_of].id.clone(),
            captures: (0..known.len()).map(capture).collect(),
            not_used,
            unseen_share: found.unseen.share,
            unseen_side: (found.unseen.share > 0.01).then(|| side(found)),
        }
    }

    /// The captures that are not part of the model, by name and with the reason.
    pub fn left_out(&self) -> impl Iterator<Item = String> + '_ {
        let is_left = |c: &&FusedCapture| !c.is_fused && c.held_by != Some(PoseEvidence::Frame);
        let left = self.captures.iter().filter(is_left);
        left.map(|c| format!("{}: {}", self.name_of(c), c.words))
    }

    /// A capture's name, with that of its recording where two recordings have a capture of this name.
    fn name_of(&self, capture: &FusedCapture) -> String {
        let ids = self.captures.iter().map(|c| &c.id);
        full_name(&capture.id, &capture.recording, ids)
    }

    /// What a person should know, as reasons of the verdict.
    pub(super) fn reasons(&self) -> Vec<Reason> {
        let reason = |c: &FusedCapture| {
            let (level, code) = match (c.held_by, c.is_fused) {
                (Some(PoseEvidence::Frame), is_fused) if !is_fused || c.level == Level::Green => {
                    return None;
                }
                (_, false) => (Level::Amber, ReasonCode::CaptureLeftOut),
                (Some(PoseEvidence::Nothing), _) => (Level::Amber, ReasonCode::TurnUnknown),
                _ if c.level > Level::Green => (Level::Amber, ReasonCode::PoseDoubtful),
                _ => (Level::Green, ReasonCode::PoseFound),
            };
            Some(Reason {
                level,
                code,
                cameras: Vec::new(),
                words: format!("capture {}: {}", self.name_of(c), c.words),
            })
        };
        self.captures.iter().filter_map(reason).collect()
    }
}

fn full_name<'a>(
    id: &CaptureId,
    recording: &str,
    ids: impl Iterator<Item = &'a CaptureId>,
) -> String {
    match ids.filter(|other| *other == id).count() {
        0 | 1 => id.to_string(),
        _ => format!("{id} of {recording}"),
    }
}

fn side(found: &Registration) -> &'static str {
    let z = found.unseen.towards.z;
    if z < -0.5 {
        "underneath, as the object stands now: turn it upside-down"
    } else if z > 0.5 {
        "on top, as the object stands now"
    } else {
        "on a side, as the object stands now: lay it on its other side"
    }
}

/// What the words of a capture depend on besides what was found of it.
struct Told<'a> {
    known: &'a [Known],
    /// Whether a person gave the poses.
    is_given: bool,
    /// Whether there is a model.
    is_one: bool,
}

fn fused_capture(i: usize, told: &Told, found: &Registered) -> FusedCapture {
    let known = told.known;
    let is_fused = found.is_placed() && told.is_one;
    let held_by = found.verdict.ok();
    let used_for = match held_by {
        _ if !is_fused => vec![],
        Some(PoseEvidence::Nothing) => vec!["form", "what others do not see"],
        _ => vec!["form", "depth", "colour"],
    };
    let pose = |p: nalgebra::Isometry3<f64>| Pose {
        rotation: p.rotation.coords.into(),
        translation: p.translation.vector.into(),
    };
    let is_known = !matches!(
        held_by,
        None | Some(PoseEvidence::Nothing | PoseEvidence::Given)
    );
    FusedCapture {
        recording: known[i].recording.clone(),
        id: known[i].id.clone(),
        placement: known[i].placement.clone(),
        is_fused,
        held_by,
        refused: found.verdict.err(),
        level: found.level,
        words: told.words(i, found),
        rig_from_object: found
            .rig_from_object
            .filter(|_| found.is_placed())
            .map(pose),
        compared_with: found.against.map(|a| known[a].id.clone()),
        sigma_deg: is_known.then_some(found.sigma_deg),
        sigma_mm: is_known.then_some(found.sigma_mm),
        free_axis: found.free_axis.map(|a| a.into_inner().into()),
        turns_with: found.turns_with.map(|leader| known[leader].id.clone()),
        own_noise_mm: found.own_noise_mm,
        disagreement_mm: found.disagreement_mm,
        accepted_mm: found.accepted_mm,
        all_at_once_mm: found.all_at_once_mm,
        worst_stretch: found.worst_stretch.as_ref().map(|(of, s)| WorstStretch {
            capture: known[*of].id.clone(),
            camera: known[*of].cameras[s.camera].clone(),
            length_px: s.length_px,
            miss_px: s.miss_px,
        }),
        larger_by: found.larger_by,
        depth: found.depth,
        colours: found.colours,
        rivals: found.rivals.clone(),
        used_for,
    }
}

/// What no silhouette shows: a dent in the middle of a side changes no outline.
const NOT_SEEN: &str =
    "a change within the outlines, such as a new dent in a side, is not seen by outlines";
/// What helps where evidence lacks or contradicts.
const ADVICE: &str = "put a mark in view of both captures, or add a capture in a pose in between";

impl Told<'_> {
    fn name(&self, i: usize) -> String {
        let ids = self.known.iter().map(|k| &k.id);
        full_name(&self.known[i].id, &self.known[i].recording, ids)
    }

    /// What was found of a capture, and what a person can do about it.
    fn words(&self, i: usize, found: &Registered) -> String {
        match found.verdict {
            Ok(held_by) => self.words_of_pose(held_by, found),
            Err(refusal) => self.words_of_refusal(i, refusal, found),
        }
    }

    fn words_of_pose(&self, held_by: PoseEvidence, found: &Registered) -> String {
        let doubts: String = self
            .doubts(found)
            .map(|doubt| format!("; {doubt}"))
            .collect();
        match held_by {
            PoseEvidence::Frame if self.is_one => {
                "the model has the frame of its rig".to_owned() + &doubts
            }
            PoseEvidence::Frame => "the others were compared with it".to_owned(),
            PoseEvidence::Silhouettes => format!(
                "its pose was found by the silhouettes alone, to {:.2} degrees{doubts}; {NOT_SEEN}",
                found.sigma_deg
            ),
            PoseEvidence::Colours => {
                let colours = found.colours.map_or((0.0, 0.0), |c| (c.best, c.next));
                format!(
                    "its turn was found by colours: they correlate by {:.2}, and by {:.2} at the next best turn{doubts}; \
                     {NOT_SEEN}",
                    colours.0, colours.1
                )
            }
            PoseEvidence::Depth => format!(
                "its turn was found by depth alone, to about {:.1} degrees: look at the hollow for steps{doubts}; {NOT_SEEN}",
                found.sigma_deg
            ),
            PoseEvidence::Nothing => format!("{}{doubts}; {NOT_SEEN}", self.words_of_turn(found)),
            PoseEvidence::Given => format!(
                "its pose was given; silhouettes disagree with it by {:.2} mm{doubts}; {NOT_SEEN}",
                found.disagreement_mm.unwrap_or(0.0)
            ),
        }
    }

    /// Of a capture whose turn is not known.
    fn words_of_turn(&self, found: &Registered) -> String {
        if let Some(leader) = found.turns_with {
            return format!(
                "its pose was found against {}, whose own turn about the axis cannot be known: both follow one turn. The \
                 form does not depend on it",
                self.name(leader)
            );
        }
        let asked = match found.depth {
            Some(_) => "neither form nor colours nor depth tell one turn from another",
            None => {
                "neither form nor colours tell one turn from another, and hollows were not compared, because depth read too \
                 little in both captures"
            }
        };
        format!(
            "its turn about the axis cannot be known: {asked}. The form of the outside does not depend on it; each side has \
             the colours and the depth of one capture"
        )
    }

    /// Why a person should look at a pose that is accepted.
    fn doubts<'a>(&'a self, found: &'a Registered) -> impl Iterator<Item = String> + 'a {
        let is_loose =
            found.verdict == Ok(PoseEvidence::Silhouettes) && found.sigma_deg > LOOSE_DEG;
        let loose = is_loose.then(|| {
            "they hold one turn loosely, and colours do not decide it: look for steps".to_owned()
        });
        let changed = found.may_have_changed.then(|| {
            format!(
                "outlines of several cameras disagree a little at one place{}: look whether a piece broke off \
                 there, or an outline lost one",
                self.place_of_stretch(found)
            )
        });
        let larger = found.larger_by.map(|share| {
            let other = found.against.map_or_else(String::new, |i| self.name(i));
            format!(
                "silhouettes agree clearly better if its lengths differ from those of {other} by {:.1} %: the calibrations \
                 may differ by that",
                100.0 * share.abs()
            )
        });
        let is_given = found.verdict == Ok(PoseEvidence::Given);
        let depth = found
            .depth
            .filter(|d| is_given && d.contradicting > DEPTH_TOLD);
        let depth = depth.map(|d| {
            format!(
                "depth contradicts it in {:.0} % of what both captures read",
                100.0 * d.contradicting
            )
        });
        let patterns = found.do_colours_contradict().then(|| {
            "its form agrees, but not its colours: look whether all captures show one object"
                .to_owned()
        });
        let open = found.is_turn_only_given().then(|| {
            "silhouettes leave the turn about its axis open, and colours do not confirm the one that \
             was given"
                .to_owned()
        });
        let doubts = loose.into_iter().chain(changed).chain(larger).chain(depth);
        let doubts: Vec<String> = doubts.chain(patterns).chain(open).collect();
        let outlines = doubts.is_empty().then(|| self.doubt_of_outlines(found));
        doubts.into_iter().chain(outlines.flatten())
    }

    /// What outlines say against a pose that they hold, or that colours chose among such poses, or against the capture
    /// whose frame the model has, if it is amber.
    fn doubt_of_outlines(&self, found: &Registered) -> Option<String> {
        use PoseEvidence::{Colours, Frame, Silhouettes};
        let (off, against) = match found.verdict {
            Ok(Silhouettes | Colours) => (found.disagreement_mm, "in all"),
            Ok(Frame) => (found.all_at_once_mm, "from all others together"),
            _ => return None,
        };
        (found.level == Level::Amber).then(|| {
            format!(
                "outlines disagree more than is usual, by {:.2} mm {against}{}: look for a step there, and whether \
                 something hid the object or a piece broke off",
                off.unwrap_or(0.0),
                self.place_of_stretch(found)
            )
        })
    }

    fn words_of_refusal(&self, i: usize, refusal: Refusal, found: &Registered) -> String {
        let to = found
            .against
            .map_or_else(|| "the others".to_owned(), |against| self.name(against));
        let off = found.disagreement_mm.unwrap_or(0.0);
        let most = found.accepted_mm;
        let place = self.place_of_stretch(found);
        match refusal {
            Refusal::Unusable => format!(
                "it cannot be used: {}; take this capture again",
                self.known[i].problem.as_deref().unwrap_or("it has no silhouettes")
            ),
            Refusal::ContradictsItself => format!(
                "its silhouettes contradict each other by {:.2} mm{place}: a prop, a lost piece of a silhouette, or \
                 something moved while the cameras took their pictures; take this capture again",
                found.own_noise_mm
            ),
            Refusal::NoHull => "no solid fits all its silhouettes; take this capture again".to_owned(),
            Refusal::NoPose if self.is_given => format!(
                "in the pose that was given its silhouettes disagree with those of {to} by {off:.2} mm, at most {most:.2} mm \
                 were expected{place}. The pose is not right, or it is not this object, or it changed"
            ),
            Refusal::NoPose => format!(
                "in no pose do its silhouettes agree with those of {to}: they disagree by {off:.2} mm at best, at most \
                 {most:.2} mm were expected{place}. It is not this object, or it changed, or something hid a part of it"
            ),
            Refusal::Scale => format!(
                "its silhouettes agree with those of {to} only if lengths differ by {:.1} %: the calibrations may differ by \
                 that. Take all captures under one calibration; if both are right, it is another object",
                100.0 * found.larger_by.unwrap_or(0.0).abs()
            ),
            Refusal::Stretch if self.is_given => format!(
                "in the pose that was given a part of its outline disagrees with {to}{place}: the pose is not right, or the \
                 object changed there, or something hid it"
            ),
            Refusal::Stretch => format!(
                "a part of its outline disagrees with {to}{place}: the object changed there, something hid it, or an outline lost \
                 a piece there"
            ),
            Refusal::DepthContradicts => format!(
                "depth contradicts the pose in which its silhouettes agree with {to}: {ADVICE}"
            ),
            Refusal::Undecided => format!(
                "its silhouettes agree with {to} in several poses that differ in colours or hollows, and nothing decides \
                 between them: {ADVICE}"
            ),
            Refusal::AllAtOnce => format!(
                "it agrees with one capture, but not with all others together ({:.2} mm): take this capture again",
                found.all_at_once_mm.unwrap_or(0.0)
            ),
            Refusal::NotCompared => {
                "too many captures disagree for it to be compared with all of them: fuse those that show one object".to_owned()
            }
        }
    }

    /// The worst stretch of contour, in parentheses.
    fn place_of_stretch(&self, found: &Registered) -> String {
        found
            .worst_stretch
            .as_ref()
            .map_or_else(String::new, |(of, s)| {
                let (id, camera) = (self.name(*of), &self.known[*of].cameras[s.camera]);
                format!(
                    " (worst in camera {camera} of {id}: {:.0} px of contour are off by {:.1} px)",
                    s.length_px, s.miss_px
                )
            })
    }
}

#[cfg(test)]
mod tests;
