//! Decides which captures show one object, from what was found of pairs of them: the largest group whose members hold
//! each other's poses, and in which none is contradicted by all others together.

use super::PoseEvidence;
use super::comparisons::Comparisons;
use super::decide::Decision;
use nalgebra::Isometry3;

/// A capture with its place.
#[derive(Clone, Debug)]
pub(super) struct Placed {
    pub(super) index: usize,
    pub(super) rig_from_object: Isometry3<f64>,
    /// The capture that it was compared with, and what was found; `None` for the one whose frame it is.
    pub(super) found: Option<(usize, Decision)>,
    /// The capture, maybe itself, whose turn is not known and which this one's turn follows; `None` where it is known.
    pub(super) turns_with: Option<usize>,
    /// What all others together say against it, where there are three or more.
    pub(super) at_once: Option<AtOnce>,
}

/// What all other captures together say against one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct AtOnce {
    /// Root of the mean square by which its rays miss, in metres.
    pub(super) rms: f64,
    /// The same as a share of what is accepted.
    pub(super) share: f64,
    /// Whether it lies in the lower half of what is accepted.
    pub(super) is_clear: bool,
}

/// Measures what all others of some captures say against one of them; `None` where that is not known.
pub(super) type AgainstAll<'a> = &'a dyn Fn(&[Placed], usize) -> Option<AtOnce>;

/// Captures with a place, and those that agree with one other but not with all.
#[derive(Clone, Debug, Default)]
pub(super) struct Places {
    pub(super) placed: Vec<Placed>,
    /// With what all others said against each.
    pub(super) outvoted: Vec<(usize, f64)>,
}

impl Places {
    /// The place of a capture.
    pub(super) fn of(&self, index: usize) -> Option<&Placed> {
        self.placed.iter().find(|p| p.index == index)
    }

    fn only(root: usize) -> Self {
        let placed = vec![Placed {
            index: root,
            rig_from_object: Isometry3::identity(),
            found: None,
            turns_with: None,
            at_once: None,
        }];
        Self {
            placed,
            outvoted: Vec::new(),
        }
    }

    fn add(&mut self, against: usize, index: usize, decision: &Decision) {
        let Some(base) = self.of(against) else {
            return;
        };
        // What is held against a capture whose turn is not known follows that turn.
        let turns_with = match decision.verdict {
            Ok(PoseEvidence::Nothing) => Some(index),
            _ => base.turns_with,
        };
        self.placed.push(Placed {
            index,
            rig_from_object: decision.pose * base.rig_from_object,
            found: Some((against, decision.clone())),
            turns_with,
            at_once: None,
        });
    }

    /// Places those of `open` that one with a place holds; whatever gets a place may hold others.
    fn add_held(&mut self, comparisons: &mut Comparisons, open: &mut Vec<usize>) {
        let mut next = 0;
        while let Some(against) = self.placed.get(next).map(|p| p.index) {
            open.retain(|&index| {
                comparisons.make(&[(against, index)]);
                match comparisons.held(against, index) {
                    Some(decision) => self.add(against, index, decision),
                    None => return true,
                }
                false
            });
            next += 1;
        }
    }
}

/// The largest group of captures that agree; of two as large the one with the earlier capture of `order`.
pub(super) fn largest(
    comparisons: &mut Comparisons,
    against_all: AgainstAll,
    order: &[usize],
) -> Places {
    let mut best = Places::default();
    let mut outvoted = Vec::new();
    let mut rest = order.to_vec();
    // The first may be the odd one out. What is in a group, or was outvoted in one, is in no larger one.
    while let Some(&root) = rest.first()
        && rest.len() > best.placed.len()
    {
        let found = agreeing(comparisons, against_all, &rest);
        let is_outvoted = |index: usize| found.outvoted.iter().any(|o| o.0 == index);
        rest.retain(|&i| i != root && found.of(i).is_none() && !is_outvoted(i));
        outvoted.extend_from_slice(&found.outvoted);
        if found.placed.len() > best.placed.len() {
            best = found;
        }
    }
    best.outvoted = outvoted;
    best
}

/// The captures that agree with the first of `order`. If all others contradict one, it is left out, and the rest is
/// placed anew: what only that one held may have no place without it.
fn agreeing(comparisons: &mut Comparisons, against_all: AgainstAll, order: &[usize]) -> Places {
    let mut order = order.to_vec();
    let mut outvoted = Vec::new();
    loop {
        let mut places = around(comparisons, &order);
        let Some((worst, rms)) = contradicted(&mut places, against_all) else {
            places.outvoted = outvoted;
            return places;
        };
        outvoted.push((worst, rms));
        order.retain(|&index| index != worst);
    }
}

/// Places all captures of `order` around its first.
fn around(comparisons: &mut Comparisons, order: &[usize]) -> Places {
    let Some((&root, others)) = order.split_first() else {
        return Places::default();
    };
    let pairs: Vec<(usize, usize)> = others.iter().map(|&index| (root, index)).collect();
    comparisons.make(&pairs);
    let mut places = Places::only(root);
    let mut open = others.to_vec();
    loop {
        places.add_held(comparisons, &mut open);
        // What nothing holds gets its place when all that is held has one.
        let is_unheld = |&index: &usize| comparisons.unheld(root, index).is_some();
        let Some(at) = open.iter().position(is_unheld) else {
            return places;
        };
        let index = open.remove(at);
        if let Some(decision) = comparisons.unheld(root, index) {
            places.add(root, index, decision);
        }
    }
}

/// Measures what all others say against each of three or more captures: the one that they contradict most, if it is by
/// more than is accepted, and by how many metres.
fn contradicted(places: &mut Places, against_all: AgainstAll) -> Option<(usize, f64)> {
    if places.placed.len() < 3 {
        return None;
    }
    let count = places.placed.len();
    let all: Vec<Option<AtOnce>> = (0..count).map(|i| against_all(&places.placed, i)).collect();
    let mut worst: Option<(usize, AtOnce)> = None;
    for (placed, at_once) in places.placed.iter_mut().zip(all) {
        placed.at_once = at_once;
        let is_worse = |a: &AtOnce| worst.is_none_or(|(_, w)| a.share > w.share);
        if let Some(at_once) = at_once.filter(is_worse) {
            worst = Some((placed.index, at_once));
        }
    }
    let (index, at_once) = worst?;
    (at_once.share > 1.0).then_some((index, at_once.rms))
}

#[cfg(test)]
mod tests {
    use super::super::Refusal;
    use super::*;
    use crate::register::limits;

    type Verdict = Result<PoseEvidence, Refusal>;
    const HELD: Verdict = Ok(PoseEvidence::Silhouettes);
    const COLOURS: Verdict = Ok(PoseEvidence::Colours);
    const NOTHING: Verdict = Ok(PoseEvidence::Nothing);
    const NO: Verdict = Err(Refusal::NoPose);

    /// Compares by a table; pairs that it does not have do not agree.
    fn table(
        pairs: &[(usize, usize, Verdict)],
    ) -> impl Fn(usize, usize) -> Option<Decision> + Sync + use<> {
        let pairs = pairs.to_vec();
        move |a, b| {
            let found = pairs.iter().find(|p| (p.0, p.1) == (a.min(b), a.max(b)));
            Some(Decision::of(found.map_or(NO, |p| p.2)))
        }
    }

    fn silent(_: &[Placed], _: usize) -> Option<AtOnce> {
        None
    }

    fn indices(places: &Places) -> Vec<usize> {
        places.placed.iter().map(|p| p.index).collect()
    }

    fn at_once(share: f64) -> AtOnce {
        AtOnce {
            rms: share * 1e-4,
            share,
            is_clear: share < 0.5,
        }
    }

    #[test]
    fn the_largest_group_counts_and_the_odd_one_out_keeps_its_refusal() {
        let compare = table(&[(0, 1, HELD), (2, 3, HELD), (2, 4, HELD), (3, 4, HELD)]);
        let mut comparisons = Comparisons::new(&compare, 5);
        let found = largest(&mut comparisons, &silent, &[0, 1, 2, 3, 4]);
        assert_eq!(indices(&found), [2, 3, 4]);
        let (against, refused) = comparisons.refusal(0, &indices(&found)).unwrap();
        assert_eq!((against, refused.verdict), (2, NO));
        // Of two as large, that of the earlier capture.
        let compare = table(&[(0, 2, HELD), (1, 3, HELD)]);
        let mut comparisons = Comparisons::new(&compare, 4);
        let found = largest(&mut comparisons, &silent, &[0, 1, 2, 3]);
        assert_eq!(indices(&found), [0, 2]);
    }

    #[test]
    fn a_refusal_is_told_from_the_side_of_the_capture_that_has_no_place() {
        let compare = |a: usize, _: usize| {
            let larger_by = (a == 0).then_some(0.25);
            let verdict = if a == 0 { Err(Refusal::Scale) } else { HELD };
            Some(Decision {
                larger_by,
                ..Decision::of(verdict)
            })
        };
        let mut comparisons = Comparisons::new(&compare, 3);
        let found = largest(&mut comparisons, &silent, &[0, 1, 2]);
        assert_eq!(indices(&found), [1, 2]);
        let (against, refused) = comparisons.refusal(0, &[1, 2]).unwrap();
        assert_eq!((against, refused.verdict), (1, Err(Refusal::Scale)));
        assert!((refused.larger_by.unwrap() + 0.2).abs() < 1e-12);
    }

    #[test]
    fn a_root_that_all_others_contradict_is_left_out_itself() {
        let compare = table(&[(0, 1, HELD), (0, 2, HELD), (1, 2, HELD)]);
        let against_all = |placed: &[Placed], i: usize| {
            let has_root = placed.iter().any(|p| p.index == 0);
            let share = if placed[i].index == 0 { 2.0 } else { 1.5 };
            Some(at_once(if has_root { share } else { 0.4 }))
        };
        let mut comparisons = Comparisons::new(&compare, 3);
        let found = largest(&mut comparisons, &against_all, &[0, 1, 2]);
        assert_eq!(indices(&found), [1, 2]);
        assert_eq!(found.outvoted, [(0, 2e-4)]);
        // The frame is that of the next one.
        assert_eq!(found.placed[0].rig_from_object, Isometry3::identity());
        assert!(found.placed[0].found.is_none());
    }

    #[test]
    fn who_was_outvoted_in_a_group_is_told_although_another_group_counts() {
        // 1 is another object, and the first of those that are left.
        let compare = table(&[(0, 2, HELD), (0, 3, HELD), (2, 3, HELD)]);
        let against_all = |placed: &[Placed], i: usize| {
            Some(at_once(if placed[i].index == 0 { 2.0 } else { 0.1 }))
        };
        let mut comparisons = Comparisons::new(&compare, 4);
        let found = largest(&mut comparisons, &against_all, &[0, 1, 2, 3]);
        assert_eq!(indices(&found), [2, 3]);
        assert_eq!(found.outvoted, [(0, 2e-4)]);
    }

    #[test]
    fn two_that_only_a_capture_between_them_held_have_no_place_without_it() {
        // 1 holds 2, which 0 does not know.
        let compare = table(&[(0, 1, HELD), (1, 2, HELD)]);
        let against_all = |placed: &[Placed], i: usize| {
            Some(at_once(if placed[i].index == 1 { 2.0 } else { 0.1 }))
        };
        let mut comparisons = Comparisons::new(&compare, 3);
        let found = largest(&mut comparisons, &against_all, &[0, 1, 2]);
        assert_eq!(indices(&found), [0]);
        assert_eq!(found.outvoted, [(1, 2e-4)]);
        let (against, refused) = comparisons.refusal(2, &[0]).unwrap();
        assert_eq!((against, refused.verdict), (0, NO));
    }

    #[test]
    fn what_is_held_against_a_turn_that_is_not_known_follows_it() {
        let compare = table(&[
            (0, 1, NOTHING),
            (0, 2, NOTHING),
            (0, 3, NOTHING),
            (1, 2, COLOURS),
        ]);
        let mut comparisons = Comparisons::new(&compare, 4);
        let found = largest(&mut comparisons, &silent, &[0, 1, 2, 3]);
        let follows = |index: usize| found.of(index).unwrap().turns_with;
        assert_eq!([0, 1, 2, 3].map(follows), [None, Some(1), Some(1), Some(3)]);
        assert_eq!(found.of(2).unwrap().found.as_ref().unwrap().0, 1);
    }

    #[test]
    fn one_that_is_placed_late_holds_those_that_were_tried_before() {
        // 3 holds 2, which holds 1, whose turn nothing holds against 0.
        let compare = table(&[(0, 1, NOTHING), (0, 3, HELD), (2, 3, HELD), (1, 2, HELD)]);
        let mut comparisons = Comparisons::new(&compare, 4);
        let found = largest(&mut comparisons, &silent, &[0, 1, 2, 3]);
        assert_eq!(indices(&found), [0, 3, 2, 1]);
        assert!(found.placed.iter().all(|p| p.turns_with.is_none()));
    }

    #[test]
    fn a_pair_is_compared_once_whichever_of_the_two_comes_first() {
        let count = std::sync::atomic::AtomicUsize::new(0);
        let compare = |_: usize, _: usize| {
            count.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
            Some(Decision::of(HELD))
        };
        let mut comparisons = Comparisons::new(&compare, 2);
        comparisons.make(&[(0, 1)]);
        comparisons.make(&[(1, 0), (0, 1)]);
        assert_eq!(count.load(std::sync::atomic::Ordering::Relaxed), 1);
        let pose = |first, second| comparisons.held(first, second).unwrap().pose;
        let off = (pose(1, 0) * pose(0, 1)).translation.vector;
        assert!(off.norm() < 1e-12, "{off}");
    }

    #[test]
    fn many_captures_that_never_agree_come_to_an_end() {
        let count = std::sync::atomic::AtomicUsize::new(0);
        let compare = |_: usize, _: usize| {
            count.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
            Some(Decision::of(NO))
        };
        let order: Vec<usize> = (0..24).collect();
        let mut comparisons = Comparisons::new(&compare, order.len());
        let found = largest(&mut comparisons, &silent, &order);
        assert_eq!(indices(&found), [0]);
        let made = count.load(std::sync::atomic::Ordering::Relaxed);
        assert_eq!(made, limits::comparisons(24));
        // Each is told something all the same.
        assert!(
            order
                .iter()
                .all(|&i| comparisons.refusal(i, &[0]).is_some())
        );
    }
}
