//! Finds the poses of all captures of an object: prepares each, lets pairs be compared and groups be made of them, and
//! states what was found of each capture.

use super::body::Body;
use super::comparisons::Comparisons;
use super::decide::{Decision, Prepared, decide};
use super::depth::Depths;
use super::noise::{self, Disagreement};
use super::places::{AtOnce, Placed, Places, largest};
use super::skin::Skin;
use super::spots;
use super::touch::Target;
use super::unseen::unseen;
use super::{CaptureSilhouettes, PoseEvidence, Refusal, Registered, Registration, limits};
use crate::level::Level;
use nalgebra::Isometry3;
use rayon::prelude::*;

/// Finds how captures lie against each other; `None` is a capture without silhouettes. The object's frame is that of
/// capture `frame_of`, or of another one where that one has no place among them. `given` holds poses that are known,
/// each mapping a point of the object into the capture's rig; they are only checked.
pub fn register(
    captures: &[Option<CaptureSilhouettes>],
    frame_of: usize,
    given: Option<&[Isometry3<f64>]>,
) -> Registration {
    let prepared = captures.par_iter().map(|c| prepare(c.as_ref()?));
    let prepared: Vec<Option<Prepared>> = prepared.collect();
    let usable = |i: &usize| {
        prepared[*i]
            .as_ref()
            .is_some_and(|p| !contradicts_itself(&p.own, p.body.pixel))
    };
    let count = captures.len();
    let order = std::iter::once(frame_of).chain((0..count).filter(|&i| i != frame_of));
    let order: Vec<usize> = order.filter(|i| *i < count).filter(usable).collect();
    let compare = |a: usize, b: usize| {
        let given = given.map(|g| g[b] * g[a].inverse());
        Some(decide(prepared[a].as_ref()?, prepared[b].as_ref()?, given))
    };
    let most_at_once = match given {
        Some(_) => limits::at_once_objection,
        None => limits::all_at_once,
    };
    let against_all = |placed: &[Placed], i: usize| against_all(&prepared, placed, i, most_at_once);
    let mut comparisons = Comparisons::new(&compare, order.len());
    let places = largest(&mut comparisons, &against_all, &order);
    let found = Found {
        captures,
        prepared: &prepared,
        order: &order,
        comparisons: &comparisons,
        places: &places,
    };
    found.registration(frame_of)
}

/// Prepares a capture for comparisons; `None` where it has no hull.
pub(super) fn prepare(capture: &CaptureSilhouettes) -> Option<Prepared> {
    let body = Body::new(capture).ok()?;
    let ((own, alone), (skin, depths)) = rayon::join(
        || (noise::of_capture(&body), spots::own_misses(&body)),
        || rayon::join(|| Skin::new(capture, &body), || Depths::new(capture, &body)),
    );
    Some(Prepared {
        skin,
        depths,
        own,
        alone,
        body,
        cameras: capture
            .scene
            .colors
            .iter()
            .map(|view| view.camera.clone())
            .collect(),
    })
}

/// Whether silhouettes of one capture contradict each other: as a whole, or along a stretch, as where a prop hides a
/// part from one camera.
fn contradicts_itself(own: &Disagreement, pixel: f64) -> bool {
    let stretch = own.stretch.as_ref().map_or(0.0, |s| s.weight());
    own.rms > limits::own(pixel) || limits::does_contradict_itself(stretch, pixel)
}

/// What all others of `placed` say against one of them, where of that noise and pixel they may say so many metres.
fn against_all(
    prepared: &[Option<Prepared>],
    placed: &[Placed],
    i: usize,
    most: fn(f64, f64) -> f64,
) -> Option<AtOnce> {
    let own = &placed[i];
    let others = placed.iter().filter(|p| p.index != own.index);
    let targets = others.filter_map(|p| {
        Some(Target {
            body: &prepared[p.index].as_ref()?.body,
            body_from_ray: p.rig_from_object * own.rig_from_object.inverse(),
            is_self: false,
        })
    });
    let targets: Vec<Target> = targets.collect();
    let body = &prepared[own.index].as_ref()?.body;
    let rms = noise::of_rays(body, &targets).rms;
    let noises = placed.iter().filter_map(|p| prepared[p.index].as_ref());
    let noise = noises.map(|p| p.own.rms).fold(0.0, f64::max);
    Some(AtOnce {
        rms,
        share: rms / most(noise, body.pixel),
        is_clear: limits::is_green_at_once(rms, noise, body.pixel),
    })
}

/// All that was found, to be stated.
struct Found<'a> {
    captures: &'a [Option<CaptureSilhouettes<'a>>],
    prepared: &'a [Option<Prepared>],
    /// The captures that do not contradict themselves.
    order: &'a [usize],
    comparisons: &'a Comparisons<'a>,
    places: &'a Places,
}

impl Found<'_> {
    fn registration(&self, wanted: usize) -> Registration {
        let placed = &self.places.placed;
        let frame_of = placed.first().map_or(wanted, |p| p.index);
        let bodies = placed.iter().filter_map(|p| {
            let prepared = self.prepared[p.index].as_ref()?;
            Some((p.index, &prepared.body, p.rig_from_object))
        });
        let mut bodies: Vec<(usize, &Body, Isometry3<f64>)> = bodies.collect();
        bodies.sort_by_key(|(index, ..)| (*index != frame_of, *index));
        let last = bodies.iter().max_by_key(|(index, ..)| *index);
        let pose_of_last = last.map_or(Isometry3::identity(), |(.., pose)| *pose);
        let bodies: Vec<_> = bodies
            .into_iter()
            .map(|(_, body, pose)| (body, pose))
            .collect();
        let unseen = unseen(&bodies, &pose_of_last);
        let numbers = 0..self.prepared.len();
        Registration {
            frame_of,
            captures: numbers.map(|index| self.registered(index)).collect(),
            unseen,
        }
    }

    fn registered(&self, index: usize) -> Registered {
        let Some(prepared) = &self.prepared[index] else {
            return nothing_known(match self.captures[index] {
                Some(_) => Refusal::NoHull,
                None => Refusal::Unusable,
            });
        };
        let mut registered = nothing_known(Refusal::NotCompared);
        registered.own_noise_mm = 1e3 * prepared.own.rms;
        registered.accepted_mm = 1e3 * limits::own(prepared.body.pixel);
        if !self.order.contains(&index) {
            registered.verdict = Err(Refusal::ContradictsItself);
            let stretch = prepared.own.stretch.clone();
            registered.worst_stretch = stretch.map(|s| (index, s));
        } else if let Some(placed) = self.places.of(index) {
            self.fill_placed(&mut registered, placed);
        } else if let Some(outvoted) = self.places.outvoted.iter().find(|o| o.0 == index) {
            registered.verdict = Err(Refusal::AllAtOnce);
            registered.all_at_once_mm = Some(1e3 * outvoted.1);
        } else {
            let placed: Vec<usize> = self.places.placed.iter().map(|p| p.index).collect();
            if let Some((against, decision)) = self.comparisons.refusal(index, &placed) {
                fill(&mut registered, against, index, &decision);
            }
        }
        registered
    }

    fn fill_placed(&self, into: &mut Registered, placed: &Placed) {
        into.rig_from_object = Some(placed.rig_from_object);
        into.all_at_once_mm = placed.at_once.map(|a| 1e3 * a.rms);
        let at_once = match placed.at_once {
            Some(at_once) if !at_once.is_clear => Level::Amber,
            _ => Level::Green,
        };
        let Some((against, decision)) = &placed.found else {
            into.verdict = Ok(PoseEvidence::Frame);
            into.level = at_once;
            (into.sigma_deg, into.sigma_mm) = (0.0, 0.0);
            return;
        };
        fill(into, *against, placed.index, decision);
        let axis = decision.free_axis;
        into.free_axis = axis.map(|a| placed.rig_from_object.rotation.inverse() * a);
        into.level = into.level.max(at_once);
        if let Some(leader) = placed.turns_with {
            into.verdict = Ok(PoseEvidence::Nothing);
            into.level = Level::Amber;
            into.turns_with = (leader != placed.index).then_some(leader);
        }
    }
}

/// States what was found of a capture against another one.
fn fill(into: &mut Registered, against: usize, index: usize, decision: &Decision) {
    into.against = Some(against);
    into.verdict = decision.verdict;
    into.sigma_deg = decision.uncertainty.0;
    into.sigma_mm = 1e3 * decision.uncertainty.1;
    into.disagreement_mm = Some(1e3 * decision.disagreement);
    into.accepted_mm = 1e3 * decision.accepted;
    // A spot that only may be a change refuses no pose.
    let is_refused = decision.verdict == Err(Refusal::Stretch);
    let changed = decision.changed.as_ref();
    let of_spot = changed.filter(|_| !(is_refused && decision.is_stretch_to_blame));
    let stretch = of_spot.map(|(spot, is_second)| (spot.stretch.clone(), *is_second));
    into.may_have_changed = stretch.is_some();
    let stretch = stretch.or_else(|| decision.stretch.clone());
    into.worst_stretch = stretch.map(|(s, is_second)| (if is_second { index } else { against }, s));
    into.larger_by = decision.larger_by;
    into.depth = decision.depth;
    into.colours = decision.colours;
    into.rivals.clone_from(&decision.rivals);
    into.level = match decision.verdict {
        Err(_) => Level::Red,
        Ok(PoseEvidence::Nothing | PoseEvidence::Depth) => Level::Amber,
        Ok(_) if decision.is_doubtful => Level::Amber,
        Ok(_) => Level::Green,
    };
}

/// A capture of which nothing is known but why it has no pose.
fn nothing_known(refusal: Refusal) -> Registered {
    Registered {
        verdict: Err(refusal),
        level: Level::Red,
        rig_from_object: None,
        against: None,
        sigma_deg: 180.0,
        sigma_mm: 1e3,
        free_axis: None,
        turns_with: None,
        own_noise_mm: 0.0,
        disagreement_mm: None,
        accepted_mm: 0.0,
        worst_stretch: None,
        may_have_changed: false,
        depth: None,
        colours: None,
        larger_by: None,
        rivals: Vec::new(),
        all_at_once_mm: None,
    }
}

#[cfg(test)]
mod tests {
    use super::super::ContourStretch;
    use super::super::spots::Spot;
    use super::*;

    #[test]
    fn a_stretch_of_one_outline_spoils_a_capture_that_is_quiet_as_a_whole() {
        let with = |rms: f64, length_px: f64| Disagreement {
            rms,
            stretch: Some(ContourStretch {
                camera: 4,
                length_px,
                miss_px: 2.0,
            }),
        };
        let pixel = 0.4e-3;
        assert!(!contradicts_itself(&with(0.05e-3, 50.0), pixel));
        assert!(contradicts_itself(&with(0.05e-3, 70.0), pixel));
        assert!(contradicts_itself(&with(0.3e-3, 50.0), pixel));
    }

    #[test]
    fn a_refusal_for_a_stretch_names_that_and_no_spot_that_only_may_be_a_change() {
        let stretch = |camera: usize| ContourStretch {
            camera,
            length_px: 50.0,
            miss_px: 2.0,
        };
        let camera_told = |verdict, is_stretch_to_blame| {
            let spot = Spot {
                weight: 45.0,
                stretch: stretch(7),
            };
            let decision = Decision {
                stretch: Some((stretch(4), true)),
                is_stretch_to_blame,
                changed: Some((spot, true)),
                ..Decision::of(verdict)
            };
            let mut into = nothing_known(Refusal::NotCompared);
            fill(&mut into, 0, 1, &decision);
            into.worst_stretch.map(|(_, stretch)| stretch.camera)
        };
        let refused = Err(Refusal::Stretch);
        assert_eq!(camera_told(refused, true), Some(4));
        assert_eq!(camera_told(refused, false), Some(7));
        // A person looks at the spot.
        assert_eq!(camera_told(Ok(PoseEvidence::Given), true), Some(7));
    }
}
