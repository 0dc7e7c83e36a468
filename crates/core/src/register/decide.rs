//! Compares two captures: decides whether they show the same object, how it was turned between them, and which evidence
//! shows that.

use super::align::{Aligned, Rays, align};
use super::body::Body;
use super::depth::Depths;
use super::determination::{Determination, axis};
use super::lost;
use super::motion::displacement;
use super::noise::{self, ContourStretch, Disagreement};
use super::scale;
use super::search;
use super::skin::Skin;
use super::spots::{AgainstBoth, Spot};
use super::sweep;
use super::touch::Target;
use super::{ColorAgreement, DepthWitness, OtherPose, PoseEvidence, Refusal, limits};
use crate::calibration::Camera;
use nalgebra::{Isometry3, UnitVector3};
use rayon::prelude::*;

/// A capture prepared for comparisons.
pub(super) struct Prepared {
    pub(super) body: Body,
    pub(super) skin: Skin,
    pub(super) depths: Depths,
    /// What its silhouettes say against each other.
    pub(super) own: Disagreement,
    /// By how many pixels each of its rays misses what its other outlines leave.
    pub(super) alone: Vec<f64>,
    /// The cameras as it was calibrated.
    pub(super) cameras: Vec<Camera>,
}

/// What was found of two captures.
#[derive(Clone, Debug)]
pub(super) struct Decision {
    /// Maps a point of the first's rig into the second's; the best there is, also where it is refused.
    pub(super) pose: Isometry3<f64>,
    /// What holds it, or why it is refused.
    pub(super) verdict: Result<PoseEvidence, Refusal>,
    /// By how much contours disagree at it: all rays of both, in metres.
    pub(super) disagreement: f64,
    /// By how much they may, in metres.
    pub(super) accepted: f64,
    /// Worst stretch among both captures' contours; whether it is the second's.
    pub(super) stretch: Option<(ContourStretch, bool)>,
    /// The worst one of what they miss beyond what they miss in their own capture.
    pub(super) beyond_own: Option<(ContourStretch, bool)>,
    /// Whether that one is too long, and no spot shows that the object changed.
    pub(super) is_stretch_to_blame: bool,
    /// Where outlines of several views disagree at one spot, so that something may have broken off there, or where one
    /// outline seems to lack a piece; whether they are the second's.
    pub(super) changed: Option<(Spot, bool)>,
    /// The axis in the second's rig about which a turn is free.
    pub(super) free_axis: Option<UnitVector3<f64>>,
    /// Other poses that the silhouettes bear, and how far they move the surface.
    pub(super) rivals: Vec<OtherPose>,
    pub(super) colours: Option<ColorAgreement>,
    pub(super) depth: Option<DepthWitness>,
    /// By which share the second's lengths are larger than the first's, where the silhouettes agree without that alone,
    /// or agree clearly better.
    pub(super) larger_by: Option<f64>,
    /// Whether a person should look at the pose, although it is accepted.
    pub(super) is_doubtful: bool,
    /// Standard deviations: degrees, and metres of the surface.
    pub(super) uncertainty: (f64, f64),
}

impl Decision {
    /// Whether both captures show a pattern, and the patterns have nothing in common at the pose.
    pub(super) fn do_colours_contradict(&self) -> bool {
        let colours = self.colours.as_ref();
        self.verdict.is_ok() && colours.is_some_and(limits::do_colours_contradict)
    }

    /// The same of the second capture as the first, and the first as the second.
    pub(super) fn reversed(&self) -> Self {
        let turn = self.pose.rotation.inverse();
        let (stretch, changed) = (self.stretch.clone(), self.changed.clone());
        let beyond_own = self.beyond_own.clone();
        Self {
            pose: self.pose.inverse(),
            stretch: stretch.map(|(stretch, is_second)| (stretch, !is_second)),
            beyond_own: beyond_own.map(|(stretch, is_second)| (stretch, !is_second)),
            changed: changed.map(|(spot, is_second)| (spot, !is_second)),
            free_axis: self.free_axis.map(|axis| turn * axis),
            larger_by: self.larger_by.map(|share| 1.0 / (1.0 + share) - 1.0),
            ..self.clone()
        }
    }
}

/// Two captures that are compared.
pub(super) struct CapturePair<'a> {
    pub(super) a: &'a Prepared,
    pub(super) b: &'a Prepared,
    /// The worse own noise, and what of it is accepted at a pose.
    noise: f64,
    accept: f64,
    /// The most that still counts as no objection.
    pub(super) object: f64,
}

/// Candidates of the search that are refined.
const MOST_REFINED: usize = 24;
/// Candidates that are refined by many rays, and rivals that are compared.
const MOST_SETTLED: usize = 12;
const MOST_RIVALS: usize = 24;
/// They disagree, by few rays, by less than this many times the least, or what counts as no objection.
const CLOSE: f64 = 1.5;
/// Candidates that cost more than this many times the best are left out.
const COSTLIER: f64 = 2.5;
/// If the best pose disagrees by at most this many times what is accepted, turns that the search missed are tried.
const MISSED: f64 = 6.0;
/// A scale between two calibrations is significant from this share of all lengths on …
const SCALE: f64 = 1e-3;
/// … if silhouettes disagree by less than this share of what they do without it.
const BETTER_SCALED: f64 = 0.9;
/// Standard deviations of a turn that is as good as known.
const SIGMAS: f64 = 3.0;
/// The most degrees that so many standard deviations may be, for silhouettes alone to state a turn.
const STATED_DEG: f64 = 1.0;

/// Decides about two captures. `given` is a pose that is known, and only checked.
pub(super) fn decide(a: &Prepared, b: &Prepared, given: Option<Isometry3<f64>>) -> Decision {
    let noise = a.own.rms.max(b.own.rms);
    let pixel = a.body.pixel.max(b.body.pixel);
    let two = CapturePair {
        a,
        b,
        noise,
        accept: limits::accepted(noise, pixel),
        object: limits::objection(noise, pixel),
    };
    match given {
        Some(pose) => two.checked(pose),
        None => two.found(),
    }
}

impl CapturePair<'_> {
    /// A pose that a person gave, and that is not changed. Limits of poses that were fitted to the silhouettes are too
    /// narrow for it: it is refused only where silhouettes object, and doubtful before.
    fn checked(&self, pose: Isometry3<f64>) -> Decision {
        let still = Rays {
            rounds: 0,
            ..Rays::MANY
        };
        let aligned = align(&self.a.body, &self.b.body, pose, still, None);
        let mut decision = self.state(&aligned, Ok(PoseEvidence::Given));
        decision.accepted = self.object;
        let is_beyond_fitted = decision.verdict.is_err();
        if is_beyond_fitted {
            let objection = self.objection_of_silhouettes(&decision);
            decision.verdict = objection.map_or(Ok(PoseEvidence::Given), Err);
        }
        decision.free_axis = self.free_axis(&aligned);
        decision.colours = Some(match &decision.free_axis {
            Some(axis) => self.colours_around(&aligned.pose, axis),
            None => self.colours_at(&aligned.pose, 0.0),
        });
        decision.depth = self.depth_near(&aligned.pose);
        let is_open = decision.free_axis.is_some()
            && decision
                .colours
                .as_ref()
                .is_some_and(limits::do_colours_leave_open);
        // Readings on a steep wall may contradict the true pose.
        decision.is_doubtful |= is_beyond_fitted
            || self.is_contradicted(&decision)
            || decision.do_colours_contradict()
            || is_open;
        decision
    }

    /// Metres that a pixel covers on the object, of the capture of which it covers more.
    fn pixel(&self) -> f64 {
        self.a.body.pixel.max(self.b.body.pixel)
    }

    /// Why silhouettes object to a pose that was not fitted to them, if they do.
    fn objection_of_silhouettes(&self, decision: &Decision) -> Option<Refusal> {
        if decision.disagreement > self.object {
            return Some(Refusal::NoPose);
        }
        let beyond_own = weight_of(decision.beyond_own.as_ref());
        let objects = limits::does_stretch_object(beyond_own, self.pixel());
        objects.then_some(Refusal::Stretch)
    }

    /// The axis about which the silhouettes leave the turn of a pose open, in the second's rig.
    fn free_axis(&self, aligned: &Aligned) -> Option<UnitVector3<f64>> {
        let determination = Determination::of(&self.a.body, &self.b.body, aligned, self.object);
        let is_free = determination.is_free();
        is_free.then(|| axis(&determination.softest)).flatten()
    }

    fn found(&self) -> Decision {
        let (a, b) = (&self.a.body, &self.b.body);
        let mut refined = self.settled(self.refined());
        let Some(best) = refined.first() else {
            let nowhere = align(a, b, Isometry3::identity(), Rays::FEW, None);
            return self.state(&nowhere, Err(Refusal::NoPose));
        };
        let mut stated = self.state(best, Ok(PoseEvidence::Silhouettes));
        if stated.verdict.is_err() && self.may_be_missed(&refined[0]) {
            let around = sweep::around(a, b, &refined[0]);
            refined = self.settled(self.each_once([refined, around].concat()));
            stated = self.state(&refined[0], Ok(PoseEvidence::Silhouettes));
        }
        if stated.verdict.is_err() {
            return self.at_another_scale(stated);
        }
        self.doubted_for_scale(self.chosen(stated, &refined[0], &refined))
    }

    /// Whether the search may have missed a pose that would be accepted. What makes it miss one is small, as a notch
    /// is, so that the best pose that it found disagrees little, too.
    fn may_be_missed(&self, best: &Aligned) -> bool {
        best.disagreement <= MISSED * self.accept
    }

    /// Chooses among the poses that the silhouettes bear, of which the best is `stated`.
    fn chosen(&self, stated: Decision, best: &Aligned, refined: &[Aligned]) -> Decision {
        let determination = Determination::of(&self.a.body, &self.b.body, best, self.object);
        let is_free = determination.is_free();
        let rivals = self.rivals(best, refined, is_free);
        if is_free || !rivals.is_empty() {
            return self.by_witnesses(stated, best, &determination, &rivals);
        }
        if determination.is_loose() || SIGMAS * stated.uncertainty.0 > STATED_DEG {
            return self.loosely_held(stated, best, &determination);
        }
        self.unique(stated)
    }

    /// Other poses that the silhouettes bear. An object that looks the same after each of two turns looks the same
    /// after both, so that what the search missed of a symmetry follows from what it found. Where a turn is free, all
    /// turns are looked at later.
    fn rivals(&self, best: &Aligned, refined: &[Aligned], is_free: bool) -> Vec<Aligned> {
        let (a, b) = (&self.a.body, &self.b.body);
        let apart = limits::APART * a.radius;
        let is_other =
            |x: &Aligned, y: &Aligned| displacement(&x.pose, &y.pose, &a.surface) > apart;
        let mut rivals: Vec<Aligned> = Vec::new();
        for found in refined.iter().skip(1) {
            let is_new = is_other(found, best) && rivals.iter().all(|r| is_other(r, found));
            if is_new && found.disagreement < self.object {
                rivals.push(found.clone());
            }
        }
        let mut known = 0;
        while !is_free && known < rivals.len() && rivals.len() < MOST_RIVALS {
            let turns: Vec<Isometry3<f64>> = rivals
                .iter()
                .map(|r| best.pose.inverse() * r.pose)
                .collect();
            let begin = std::mem::replace(&mut known, rivals.len());
            let pairs = (0..turns.len()).flat_map(|i| (0..turns.len()).map(move |j| (i, j)));
            let is_new = |&(i, j): &(usize, usize)| i.max(j) >= begin;
            let tried: Vec<Aligned> = pairs
                .filter(is_new)
                .map(|(i, j)| best.pose * turns[i] * turns[j])
                .filter(|pose| {
                    let is_known = |r: &Aligned| displacement(&r.pose, pose, &a.surface) <= apart;
                    !is_known(best) && !rivals.iter().any(is_known)
                })
                .collect::<Vec<_>>()
                .par_iter()
                .map(|pose| align(a, b, *pose, Rays::MANY, None))
                .collect();
            for found in tried {
                let is_new = is_other(&found, best) && rivals.iter().all(|r| is_other(r, &found));
                if found.disagreement < self.object && is_new && rivals.len() < MOST_RIVALS {
                    rivals.push(found);
                }
            }
        }
        rivals
    }

    /// The survivors of the search on the silhouettes, each once, the best first.
    fn refined(&self) -> Vec<Aligned> {
        let (a, b) = (&self.a.body, &self.b.body);
        let found = search::candidates(a, b);
        let first = found.first().map_or(0.0, |c| c.cost);
        let limit = (COSTLIER * first).max(first + 0.02 * a.radius);
        let near = found.iter().filter(|c| c.cost <= limit).take(MOST_REFINED);
        let near: Vec<_> = near.collect();
        let refined = near.par_iter();
        let refined = refined.map(|c| align(a, b, c.pose, Rays::FEW, None));
        self.each_once(refined.collect())
    }

    /// Poses that differ, the best first.
    fn each_once(&self, mut poses: Vec<Aligned>) -> Vec<Aligned> {
        let a = &self.a.body;
        poses.sort_by(|x, y| x.disagreement.total_cmp(&y.disagreement));
        let mut kept: Vec<Aligned> = Vec::new();
        for aligned in poses {
            let same = |k: &Aligned| {
                displacement(&k.pose, &aligned.pose, &a.surface) < limits::SAME * a.radius
            };
            if !kept.iter().any(same) {
                kept.push(aligned);
            }
        }
        kept
    }

    /// The first of the survivors refined by more rays, the best first: few rays tell poses apart, but do not say which
    /// of two that nearly agree is the right one.
    fn settled(&self, refined: Vec<Aligned>) -> Vec<Aligned> {
        let (a, b) = (&self.a.body, &self.b.body);
        let least = refined.first().map_or(0.0, |best| best.disagreement);
        let limit = CLOSE * least.max(self.object);
        let near = refined.iter().enumerate();
        let near = near.filter(|(i, r)| *i == 0 || r.disagreement < limit);
        let near: Vec<&Aligned> = near.map(|(_, r)| r).take(MOST_SETTLED).collect();
        let mut settled: Vec<Aligned> = near
            .par_iter()
            .map(|r| align(a, b, r.pose, Rays::MANY, None))
            .collect();
        settled.sort_by(|x, y| x.disagreement.total_cmp(&y.disagreement));
        settled
    }

    /// Silhouettes that agree in no pose: whether they would, if the lengths of the calibrations were the same.
    fn at_another_scale(&self, mut decision: Decision) -> Decision {
        if self.share_a_calibration() {
            return decision;
        }
        let (scale, aligned) = scale::best(&self.a.body, &self.b.body, &decision.pose);
        let resized = self.b.body.scaled(scale);
        let stated = self.state_of(
            [&self.a.body, &resized],
            &aligned,
            Ok(PoseEvidence::Silhouettes),
        );
        if stated.verdict.is_ok() {
            decision.verdict = Err(Refusal::Scale);
            decision.larger_by = Some(1.0 / scale - 1.0);
        }
        decision
    }

    /// A pose that is accepted, of captures whose calibrations differ: doubtful if silhouettes agree clearly better
    /// with other lengths.
    fn doubted_for_scale(&self, mut decision: Decision) -> Decision {
        if decision.verdict.is_err() || self.share_a_calibration() {
            return decision;
        }
        let (a, b) = (&self.a.body, &self.b.body);
        let as_it_is = align(a, b, decision.pose, Rays::MANY, None).disagreement;
        let (scale, scaled) = scale::best(a, b, &decision.pose);
        let larger_by = 1.0 / scale - 1.0;
        if larger_by.abs() > SCALE && scaled.disagreement < BETTER_SCALED * as_it_is {
            decision.larger_by = Some(larger_by);
            decision.is_doubtful = true;
        }
        decision
    }

    /// Whether the cameras that both captures have are calibrated alike. One of them may lack a camera.
    fn share_a_calibration(&self) -> bool {
        let mut common = self.a.cameras.iter().filter_map(|camera| {
            let same = self.b.cameras.iter().find(|other| other.id == camera.id)?;
            Some(same == camera)
        });
        common
            .next()
            .is_some_and(|is_same| is_same && common.all(|is_same| is_same))
    }

    /// A pose that the silhouettes alone hold.
    pub(super) fn unique(&self, mut decision: Decision) -> Decision {
        decision.colours = Some(self.colours_at(&decision.pose, 0.0));
        decision.depth = self.depth_at(&decision.pose);
        if self.is_contradicted(&decision) {
            decision.verdict = Err(Refusal::DepthContradicts);
        }
        decision.is_doubtful |= decision.do_colours_contradict();
        decision
    }

    pub(super) fn rival(&self, rival: &Aligned, best: &Aligned) -> OtherPose {
        OtherPose {
            turned_deg: (best.pose.inverse() * rival.pose)
                .rotation
                .angle()
                .to_degrees(),
            moved_mm: 1e3 * displacement(&rival.pose, &best.pose, &self.a.body.surface),
            disagreement_mm: 1e3 * rival.disagreement,
        }
    }

    /// What is known of a pose, refused where the silhouettes do not bear it.
    pub(super) fn state(
        &self,
        aligned: &Aligned,
        verdict: Result<PoseEvidence, Refusal>,
    ) -> Decision {
        self.state_of([&self.a.body, &self.b.body], aligned, verdict)
    }

    fn state_of(
        &self,
        [a, b]: [&Body; 2],
        aligned: &Aligned,
        verdict: Result<PoseEvidence, Refusal>,
    ) -> Decision {
        let target = |body, body_from_ray| {
            [Target {
                body,
                body_from_ray,
                is_self: false,
            }]
        };
        let of_a = noise::of_rays(a, &target(b, aligned.pose));
        let of_b = noise::of_rays(b, &target(a, aligned.pose.inverse()));
        let disagreement = (0.5 * (of_a.rms.powi(2) + of_b.rms.powi(2))).sqrt();
        let stretch = heavier([(of_a.stretch, false), (of_b.stretch, true)]);
        let both = [
            AgainstBoth::new(a, b, aligned.pose),
            AgainstBoth::new(b, a, aligned.pose.inverse()),
        ];
        let of_a = both[0].changes(&self.a.alone);
        let of_b = both[1].changes(&self.b.alone);
        let spots = [(of_a.spot, false), (of_b.spot, true)].into_iter();
        let spots = spots.filter_map(|(spot, is_second)| Some((spot?, is_second)));
        let spot = spots.max_by(|x, y| x.0.weight.total_cmp(&y.0.weight));
        let weight = spot.as_ref().map_or(0.0, |(spot, _)| spot.weight);
        let pixel = self.pixel();
        let is_maybe_change = limits::is_maybe_change(weight, pixel);
        let is_change = limits::is_change(weight, pixel);
        let beyond_own = heavier([(of_a.stretch, false), (of_b.stretch, true)]);
        let is_long = limits::is_long(weight_of(beyond_own.as_ref()), pixel);
        let own = [&self.a.own, &self.b.own].map(|own| own.stretch.as_ref());
        let own = own.map(|stretch| stretch.map_or(0.0, ContourStretch::weight));
        let longest = weight_of(beyond_own.as_ref()).max(own[0]).max(own[1]);
        let is_clear = limits::is_green(disagreement, self.noise, pixel);
        let verdict = match verdict {
            Ok(_) if disagreement > self.accept => Err(Refusal::NoPose),
            Ok(_) if is_long || is_change => Err(Refusal::Stretch),
            verdict => verdict,
        };
        // Where much misses, looking for one outline that explains it is long, and says nothing.
        let lost = verdict.is_ok().then(|| lost::piece(&both)).flatten();
        let lost_weight = lost.as_ref().map_or(0.0, |piece| piece.at.weight);
        let is_lost = limits::is_lost_piece(lost_weight, pixel);
        let is_maybe_lost = limits::is_maybe_lost_piece(lost_weight, pixel);
        let verdict = match verdict {
            Ok(_) if is_lost => Err(Refusal::Stretch),
            verdict => verdict,
        };
        let lost = lost.filter(|_| is_maybe_lost);
        let lost = lost.map(|piece| (piece.at, piece.is_second));
        Decision {
            uncertainty: self.uncertainty(aligned, disagreement),
            pose: aligned.pose,
            verdict,
            disagreement,
            accepted: self.accept,
            stretch: if is_long { beyond_own.clone() } else { stretch },
            beyond_own,
            is_stretch_to_blame: is_long && !is_change,
            changed: lost.or_else(|| spot.filter(|_| is_maybe_change)),
            free_axis: None,
            rivals: Vec::new(),
            colours: None,
            depth: None,
            larger_by: None,
            is_doubtful: !is_clear
                || is_maybe_change
                || is_maybe_lost
                || limits::is_doubtful(longest, pixel),
        }
    }

    /// Standard deviations of turn and place, from how firmly contours hold the pose: neighbouring points of a contour
    /// err together, so that far fewer count than there are.
    fn uncertainty(&self, aligned: &Aligned, disagreement: f64) -> (f64, f64) {
        const INDEPENDENT: f64 = 100.0;
        let scatter = disagreement.max(0.1 * self.a.body.pixel).powi(2) / INDEPENDENT;
        let Some(inverse) = (aligned.firmness + nalgebra::Matrix6::identity() * 1e-9).try_inverse()
        else {
            return (180.0, self.a.body.radius);
        };
        let sum = |range: std::ops::Range<usize>| range.map(|i| inverse[(i, i)]).sum::<f64>();
        let turn = (sum(3..6) * scatter).sqrt() / super::align::lever(&self.a.body, &self.b.body);
        let place = (sum(0..3) * scatter).sqrt();
        (turn.to_degrees().min(180.0), place)
    }
}

#[cfg(test)]
impl Decision {
    /// One that a test makes, with this verdict.
    pub(super) fn of(verdict: Result<PoseEvidence, Refusal>) -> Self {
        Self {
            pose: Isometry3::translation(0.001, 0.0, 0.0),
            verdict,
            disagreement: 1e-5,
            accepted: 1e-3,
            stretch: None,
            beyond_own: None,
            is_stretch_to_blame: false,
            changed: None,
            free_axis: None,
            rivals: Vec::new(),
            colours: None,
            depth: None,
            larger_by: None,
            is_doubtful: false,
            uncertainty: (0.1, 1e-5),
        }
    }
}

/// The heavier of two captures' stretches, with whether it is the second's.
fn heavier(stretches: [(Option<ContourStretch>, bool); 2]) -> Option<(ContourStretch, bool)> {
    let known = stretches.into_iter();
    let known = known.filter_map(|(stretch, is_second)| Some((stretch?, is_second)));
    known.max_by(|x, y| x.0.weight().total_cmp(&y.0.weight()))
}

/// Length by depth, in square pixels, of a stretch.
fn weight_of(stretch: Option<&(ContourStretch, bool)>) -> f64 {
    stretch.map_or(0.0, |(stretch, _)| stretch.weight())
}
