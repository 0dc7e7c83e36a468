//! Finds the poses of all captures of an object: each is compared with one that has a pose already, and at the end with
//! all others together.

use super::body::Body;
use super::decide::{Decision, Prepared, decide};
use super::depth::Depths;
use super::noise;
use super::skin::Skin;
use super::touch::Target;
use super::unseen::{Unseen, unseen};
use super::{CaptureSilhouettes, PoseEvidence, Refusal, Registered, Registration, limits};
use crate::level::Level;
use nalgebra::Isometry3;
use rayon::prelude::*;

/// Finds how captures lie against each other. The object's frame is that of capture `frame_of`, or of another one where
/// that one has no place among them. `given` holds poses that are known, each mapping a point of the object into the
/// capture's rig; they are only checked.
pub fn register(
    captures: &[CaptureSilhouettes],
    frame_of: usize,
    given: Option<&[Isometry3<f64>]>,
) -> Registration {
    let prepared: Vec<Option<Prepared>> = captures.par_iter().map(prepare).collect();
    let usable = |i: &usize| {
        prepared[*i]
            .as_ref()
            .is_some_and(|p| !contradicts_itself(p))
    };
    let count = captures.len();
    let order = std::iter::once(frame_of).chain((0..count).filter(|&i| i != frame_of));
    let order: Vec<usize> = order.filter(|i| *i < count).filter(usable).collect();
    let group = Group {
        prepared: &prepared,
        given,
    };
    let mut best = group.around(&order);
    // The first may be the odd one out: the largest group that agrees counts.
    for start in 1..order.len() {
        if best.len() > 1 {
            break;
        }
        let found = group.around(&order[start..]);
        if found.len() > best.len() {
            best = found;
        }
    }
    group.registration(frame_of, order, best)
}

fn prepare(capture: &CaptureSilhouettes) -> Option<Prepared> {
    let body = Body::new(capture).ok()?;
    let (own, (skin, depths)) = rayon::join(
        || noise::of_capture(&body),
        || rayon::join(|| Skin::new(capture, &body), || Depths::new(capture, &body)),
    );
    Some(Prepared {
        skin,
        depths,
        own,
        body,
        cameras: capture
            .scene
            .colors
            .iter()
            .map(|view| view.camera.clone())
            .collect(),
    })
}

fn contradicts_itself(prepared: &Prepared) -> bool {
    prepared.own.rms > limits::own(prepared.body.pixel)
}

/// A capture with its place.
struct Placed {
    index: usize,
    rig_from_object: Isometry3<f64>,
    /// The capture that it was compared with, and what was found; `None` for the one whose frame it is.
    found: Option<(usize, Decision)>,
    all_at_once: Option<f64>,
}

struct Group<'a> {
    prepared: &'a [Option<Prepared>],
    given: Option<&'a [Isometry3<f64>]>,
}

/// Captures with a place, and what was found of those without.
#[derive(Default)]
struct Places {
    placed: Vec<Placed>,
    refused: Vec<(usize, usize, Decision)>,
    /// Captures that agree with one other, but not with all.
    outvoted: Vec<(usize, f64)>,
}

impl Places {
    fn len(&self) -> usize {
        self.placed.len()
    }
}

impl Group<'_> {
    fn get(&self, index: usize) -> Option<&Prepared> {
        self.prepared[index].as_ref()
    }

    fn decide(&self, a: usize, b: usize) -> Option<Decision> {
        let given = self.given.map(|g| g[b] * g[a].inverse());
        Some(decide(self.get(a)?, self.get(b)?, given))
    }

    /// Places all captures of `order` around its first.
    fn around(&self, order: &[usize]) -> Places {
        let Some((&root, others)) = order.split_first() else {
            return Places::default();
        };
        let mut places = Places::default();
        places.placed.push(Placed {
            index: root,
            rig_from_object: Isometry3::identity(),
            found: None,
            all_at_once: None,
        });
        let first = others.par_iter().map(|&i| Some((i, self.decide(root, i)?)));
        let mut open: Vec<(usize, usize, Decision)> = Vec::new();
        for (index, decision) in first.collect::<Vec<_>>().into_iter().flatten() {
            match decision.verdict {
                Ok(held) if held != PoseEvidence::Nothing => places.add(root, index, decision),
                _ => open.push((root, index, decision)),
            }
        }
        self.place_against_others(&mut places, open);
        self.check_all_at_once(&mut places);
        places
    }

    /// What the first one does not place, another one may: a third pose in between.
    fn place_against_others(&self, places: &mut Places, open: Vec<(usize, usize, Decision)>) {
        for (root, index, decision) in open {
            let known: Vec<usize> = places.placed.iter().map(|p| p.index).collect();
            let others = known.into_iter().filter(|&k| k != root);
            let found = others.filter_map(|k| Some((k, self.decide(k, index)?)));
            let mut held =
                found.filter(|(_, d)| d.verdict.is_ok_and(|h| h != PoseEvidence::Nothing));
            if let Some((against, better)) = held.next() {
                places.add(against, index, better);
            } else if decision.verdict.is_ok() {
                places.add(root, index, decision);
            } else {
                places.refused.push((root, index, decision));
            }
        }
    }

    /// Leaves out captures that the others together contradict, the worst first.
    fn check_all_at_once(&self, places: &mut Places) {
        if places.len() < 3 {
            return;
        }
        loop {
            let mut worst: Option<(usize, f64)> = None;
            for i in 0..places.len() {
                let Some(rms) = self.against_all(places, i) else {
                    continue;
                };
                places.placed[i].all_at_once = Some(rms);
                let Some(prepared) = self.get(places.placed[i].index) else {
                    continue;
                };
                let noises = places.placed.iter().filter_map(|p| self.get(p.index));
                let noise = noises.map(|p| p.own.rms).fold(0.0, f64::max);
                let excess = rms / limits::all_at_once(noise, prepared.body.pixel);
                if worst.is_none_or(|(_, w)| excess > w) {
                    worst = Some((i, excess));
                }
            }
            match worst {
                Some((i, excess)) if excess > 1.0 && places.len() > 2 => {
                    let i = if i == 0 { places.len() - 1 } else { i };
                    let left = places.placed.remove(i);
                    places
                        .outvoted
                        .push((left.index, left.all_at_once.unwrap_or(0.0)));
                }
                _ => return,
            }
        }
    }

    fn against_all(&self, places: &Places, i: usize) -> Option<f64> {
        let own = &places.placed[i];
        let others = places.placed.iter().filter(|p| p.index != own.index);
        let targets = others.filter_map(|p| {
            Some(Target {
                body: &self.get(p.index)?.body,
                body_from_ray: p.rig_from_object * own.rig_from_object.inverse(),
                is_self: false,
            })
        });
        let targets: Vec<Target> = targets.collect();
        let body = &self.get(own.index)?.body;
        Some(noise::of_rays(body, &targets).rms)
    }

    fn registration(&self, wanted: usize, order: Vec<usize>, places: Places) -> Registration {
        let frame_of = places.placed.first().map_or(wanted, |p| p.index);
        let of_capture = |index: usize| self.registered(index, &order, &places);
        let placed = places.placed.iter();
        let mut bodies: Vec<(usize, &Body, Isometry3<f64>)> = placed
            .filter_map(|p| Some((p.index, &self.get(p.index)?.body, p.rig_from_object)))
            .collect();
        bodies.sort_by_key(|(index, ..)| (*index != frame_of, *index));
        let bodies: Vec<_> = bodies
            .into_iter()
            .map(|(_, body, pose)| (body, pose))
            .collect();
        let unseen = if bodies.is_empty() {
            Unseen::default()
        } else {
            unseen(&bodies)
        };
        Registration {
            frame_of,
            captures: (0..self.prepared.len()).map(of_capture).collect(),
            unseen,
        }
    }

    fn registered(&self, index: usize, order: &[usize], places: &Places) -> Registered {
        let mut registered = Registered {
            verdict: Err(Refusal::NoHull),
            level: Level::Red,
            rig_from_object: None,
            against: None,
            sigma_deg: 180.0,
            sigma_mm: 1e3,
            free_axis: None,
            own_noise_mm: 0.0,
            disagreement_mm: None,
            accepted_mm: 0.0,
            worst_stretch: None,
            depth: None,
            colours: None,
            larger_by: None,
            rivals: Vec::new(),
            all_at_once_mm: None,
        };
        let Some(prepared) = self.get(index) else {
            return registered;
        };
        registered.own_noise_mm = 1e3 * prepared.own.rms;
        registered.accepted_mm = 1e3 * limits::own(prepared.body.pixel);
        if !order.contains(&index) {
            registered.verdict = Err(Refusal::ContradictsItself);
            let stretch = prepared.own.stretch.clone();
            registered.worst_stretch = stretch.map(|s| (index, s));
            return registered;
        }
        if let Some(placed) = places.placed.iter().find(|p| p.index == index) {
            registered.rig_from_object = Some(placed.rig_from_object);
            registered.all_at_once_mm = placed.all_at_once.map(|m| 1e3 * m);
            let Some((against, decision)) = &placed.found else {
                registered.verdict = Ok(PoseEvidence::Frame);
                registered.level = Level::Green;
                (registered.sigma_deg, registered.sigma_mm) = (0.0, 0.0);
                return registered;
            };
            self.fill(&mut registered, *against, index, decision);
            let axis = decision.free_axis;
            registered.free_axis = axis.map(|a| placed.rig_from_object.rotation.inverse() * a);
        } else if let Some((against, _, decision)) = places.refused.iter().find(|r| r.1 == index) {
            self.fill(&mut registered, *against, index, decision);
        } else {
            registered.verdict = Err(Refusal::AllAtOnce);
            let found = places.outvoted.iter().find(|o| o.0 == index);
            registered.all_at_once_mm = found.map(|o| 1e3 * o.1);
        }
        registered
    }

    fn fill(&self, into: &mut Registered, against: usize, index: usize, decision: &Decision) {
        let pixel = self.get(index).map_or(0.0, |p| p.body.pixel);
        into.against = Some(against);
        into.verdict = decision.verdict;
        into.sigma_deg = decision.uncertainty.0;
        into.sigma_mm = 1e3 * decision.uncertainty.1;
        into.disagreement_mm = Some(1e3 * decision.disagreement);
        into.accepted_mm = 1e3 * limits::accepted(decision.noise, pixel);
        let stretch = decision.stretch.clone();
        into.worst_stretch =
            stretch.map(|(s, is_second)| (if is_second { index } else { against }, s));
        into.larger_by = decision.larger_by;
        into.depth = decision.depth;
        into.colours = decision.colours;
        into.rivals.clone_from(&decision.rivals);
        let is_clear = limits::is_green(decision.disagreement, decision.noise, pixel);
        into.level = match decision.verdict {
            Err(_) => Level::Red,
            Ok(PoseEvidence::Nothing | PoseEvidence::Depth) => Level::Amber,
            Ok(_) if is_clear => Level::Green,
            Ok(_) => Level::Amber,
        };
    }
}

impl Places {
    fn add(&mut self, against: usize, index: usize, decision: Decision) {
        let Some(base) = self.placed.iter().find(|p| p.index == against) else {
            return;
        };
        self.placed.push(Placed {
            index,
            rig_from_object: decision.pose * base.rig_from_object,
            found: Some((against, decision)),
            all_at_once: None,
        });
    }
}
