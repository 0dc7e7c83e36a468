//! Tests whether a camera's pictures are of another moment than their placement, or mirrored: its views vote for one
//! pose of the camera. Only gross errors are found here: another placement of the board lies a board's length away.

use super::super::Parameters;
use super::super::pose_graph::{AGREES, Comparison};
use super::super::session::View;
use super::suspects::{FEWEST_VIEWS, IndependentFit, Reference};
use nalgebra::Isometry3;

/// Why a camera's pictures do not show their own placements.
pub(super) enum PictureFault {
    /// They are of a placement this many before (less than 0) or after, all of them or from a placement on.
    Shifted { by: isize, from: Option<usize> },
    /// They are mirrored, all of them or from a placement on.
    Mirrored { from: Option<usize> },
}

/// By how many placements pictures may be late (less than 0) or early, the likeliest first.
const SHIFTS: [isize; 6] = [-1, 1, -2, 2, -3, 3];
/// Part of the views that must agree on a cause, and that may agree without it.
const MOST_AGREE: f64 = 0.8;
const FEW_AGREE: f64 = 0.5;

/// Finds why a camera's pictures do not show their own placements; `None` if they do, or if that cannot be known.
pub(super) fn of(
    reference: &Reference,
    camera: usize,
    parameters: &Parameters,
) -> Option<PictureFault> {
    let subject = &reference.session.cameras[camera];
    let views = reference.views(camera);
    let comparison = Comparison::new(reference.session);
    let solo = IndependentFit::of(reference, subject, &views, parameters)?;
    let plain = vote(reference, &comparison, &solo, 0);
    if plain
        .as_ref()
        .is_some_and(|plain| plain.part() >= MOST_AGREE)
    {
        return None;
    }
    let is_unlikely = plain.as_ref().is_none_or(|plain| plain.part() <= FEW_AGREE);
    let agrees = |vote: Option<PoseVote>| {
        vote.is_some_and(|v| v.part() >= MOST_AGREE && v.agreeing.len() >= FEWEST_VIEWS)
    };
    for by in SHIFTS {
        if is_unlikely && agrees(vote(reference, &comparison, &solo, by)) {
            return Some(PictureFault::Shifted { by, from: None });
        }
        let late = plain
            .as_ref()
            .and_then(|plain| shifted_part(reference, &comparison, &solo, plain, by));
        if let Some(from) = late {
            return Some(PictureFault::Shifted {
                by,
                from: Some(from),
            });
        }
    }
    // Mirrored views agree on a place, and as they are they do not.
    let are_mirrored = |views: &[View]| {
        let seen = |view: &View| mirrored(reference, view);
        let mirrored: Vec<View> = views.iter().map(seen).collect();
        let solo = IndependentFit::of(reference, subject, &mirrored, parameters);
        agrees(solo.and_then(|solo| vote(reference, &comparison, &solo, 0)))
    };
    if is_unlikely && are_mirrored(&views) {
        return Some(PictureFault::Mirrored { from: None });
    }
    let (from, late) = contradicting_part(&solo, &plain?)?;
    let as_seen = IndependentFit::of(reference, subject, &late, parameters);
    let as_seen = as_seen.and_then(|solo| vote(reference, &comparison, &solo, 0));
    let is_unlikely = as_seen.is_none_or(|vote| vote.part() <= FEW_AGREE);
    let is_mirrored = is_unlikely && are_mirrored(&late);
    is_mirrored.then_some(PictureFault::Mirrored { from: Some(from) })
}

/// The placement from which on most views contradict the pose on which the others agree, and the views since then.
fn contradicting_part(solo: &IndependentFit, plain: &PoseVote) -> Option<(usize, Vec<View>)> {
    let contradicts = |index: &usize| !plain.agreeing.contains(index);
    let first = (0..solo.views.len()).find(contradicts)?;
    let late: Vec<View> = solo.views[first..].iter().map(|(v, _)| v.clone()).collect();
    let contradicting = (first..solo.views.len()).filter(contradicts).count();
    let enough = plain.agreeing.len() >= FEWEST_VIEWS
        && late.len() >= FEWEST_VIEWS
        && contradicting as f64 >= MOST_AGREE * late.len() as f64;
    enough.then(|| (late[0].placement, late))
}

/// The views that agree on one place of their camera.
struct PoseVote {
    camera_from_rig: Isometry3<f64>,
    /// Indices of the views that agree.
    agreeing: Vec<usize>,
    /// Views that could.
    of: usize,
}

impl PoseVote {
    fn part(&self) -> f64 {
        self.agreeing.len() as f64 / self.of.max(1) as f64
    }
}

/// The board `by` placements after that of a view, where the others saw it.
fn shifted(reference: &Reference, view: &View, by: isize) -> Option<Isometry3<f64>> {
    let placement = view.placement.checked_add_signed(by)?;
    reference.rig_from_board.get(placement).copied().flatten()
}

/// Views of `solo` that agree with a camera at `camera_from_rig`.
fn agreeing(
    reference: &Reference,
    comparison: &Comparison,
    solo: &IndependentFit,
    camera_from_rig: &Isometry3<f64>,
    by: isize,
) -> Vec<usize> {
    let agrees = |(view, own): &(View, Isometry3<f64>)| {
        shifted(reference, view, by).is_some_and(|rig_from_board| {
            comparison
                .nearest_turn(own, &(camera_from_rig * rig_from_board))
                .1
                < AGREES
        })
    };
    let all = solo.views.iter().enumerate();
    all.filter(|(_, v)| agrees(v))
        .map(|(index, _)| index)
        .collect()
}

/// The place on which most views agree if each is of the placement `by` after its own.
fn vote(
    reference: &Reference,
    comparison: &Comparison,
    solo: &IndependentFit,
    by: isize,
) -> Option<PoseVote> {
    let seen = solo.views.iter();
    let pairs: Vec<_> = seen
        .filter_map(|(view, own)| Some((*own, shifted(reference, view, by)?)))
        .collect();
    let candidates = pairs.iter().flat_map(|(own, rig_from_board)| {
        comparison
            .readings(own)
            .map(move |own| own * rig_from_board.inverse())
    });
    let votes = candidates.map(|camera_from_rig| PoseVote {
        agreeing: agreeing(reference, comparison, solo, &camera_from_rig, by),
        camera_from_rig,
        of: pairs.len(),
    });
    votes.reduce(
        |best, vote| match vote.agreeing.len() > best.agreeing.len() {
            true => vote,
            false => best,
        },
    )
}

/// The placement from which on the views that do not agree do so when they are shifted.
fn shifted_part(
    reference: &Reference,
    comparison: &Comparison,
    solo: &IndependentFit,
    plain: &PoseVote,
    by: isize,
) -> Option<usize> {
    let shifted = agreeing(reference, comparison, solo, &plain.camera_from_rig, by);
    let first = *shifted
        .iter()
        .find(|index| !plain.agreeing.contains(index))?;
    let rest = first..solo.views.len();
    let count = |of: &[usize]| of.iter().filter(|index| rest.contains(index)).count();
    let enough = plain.agreeing.len() >= FEWEST_VIEWS
        && count(&shifted) >= 3
        && count(&shifted) as f64 >= MOST_AGREE * rest.len() as f64
        && count(&plain.agreeing) * 2 < rest.len();
    enough.then(|| solo.views[first].0.placement)
}

/// What the camera would have seen without the mirror.
fn mirrored(reference: &Reference, view: &View) -> View {
    let session = &reference.session;
    view.mirrored(&session.board, session.cameras[view.camera].size[0])
}
