//! The reasons that a rig gives of which some cameras hang together with the others by a single placement of the board.
//! Nothing contradicts that placement's pictures: if one is of another moment, or the board moved, the cameras are at
//! wrong places and all residuals are small.

use super::reason::{Reason, ReasonKind};
use super::result::Fit;
use crate::calibration::CalibrationLevel;
use std::collections::BTreeMap;

/// For each placement without which the cameras fall apart: which of them, and the placement.
pub(super) fn single_joints(fit: &Fit) -> Vec<Reason> {
    let mut found = Vec::new();
    let whole = groups_without(fit, None).len();
    for (placement, joint) in fit.placements.iter().enumerate() {
        let groups = groups_without(fit, Some(placement));
        if groups.len() == whole {
            continue;
        }
        // All but the largest group hang on it.
        let largest = groups.iter().map(Vec::len).max().unwrap_or(0);
        let kept = groups.iter().position(|group| group.len() == largest);
        let apart = groups.iter().enumerate().filter(|(k, _)| Some(*k) != kept);
        let apart: Vec<&str> = apart
            .flat_map(|(_, group)| group)
            .map(|&camera| fit.cameras[camera].camera.id.as_str())
            .collect();
        let subject = match apart[..] {
            [] => continue,
            [one] => format!("camera {one} was"),
            _ => format!("cameras {} were", apart.join(", ")),
        };
        let words = format!(
            "{subject} joined to the other cameras by a single placement, {}: if the board moved there, or a picture is of \
             another moment, no other placement shows it",
            joint.name
        );
        found.push(Reason::new(
            CalibrationLevel::Doubtful,
            ReasonKind::SingleJoint,
            words,
        ));
    }
    found
}

/// The cameras, as indices, in groups that share placements, where one placement may not be counted.
fn groups_without(fit: &Fit, placement: Option<usize>) -> Vec<Vec<usize>> {
    let mut group_of: Vec<usize> = (0..fit.cameras.len()).collect();
    let mut first_at: BTreeMap<usize, usize> = BTreeMap::new();
    let counted = fit.residuals.iter();
    for view in counted.filter(|v| Some(v.placement) != placement) {
        let first = *first_at.entry(view.placement).or_insert(view.camera);
        let [kept, joined] = [first, view.camera].map(|camera| group_of[camera]);
        for group in group_of.iter_mut().filter(|group| **group == joined) {
            *group = kept;
        }
    }
    let mut groups: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
    for (camera, group) in group_of.into_iter().enumerate() {
        groups.entry(group).or_default().push(camera);
    }
    groups.into_values().collect()
}

#[cfg(test)]
mod tests {
    use super::super::synthetic::{Random, Truth, color_lens, looking, placements};
    use super::super::{Limits, Parameters, Session, View, fit, judge};
    use super::*;
    use crate::calibration::Board;
    use nalgebra::Point3;

    /// Three cameras, of which the last shares its placements with the others or, if `is_apart`, only one; and which
    /// one. There it sees the board moved by so many metres.
    fn session(is_apart: bool, moved: f64) -> (Session, usize) {
        let board = Board::checkerboard(6, 5, 0.035).unwrap();
        let camera = |i: usize| {
            let from = Point3::new(0.2 * i as f64 - 0.2, -0.3, 0.75);
            let at = Point3::new(0.0, 0.0, 0.1);
            looking(&format!("c{i:02}"), color_lens(), from, at)
        };
        let recorded = |shown| {
            let truth = Truth::new(board, (0..3).map(camera).collect(), shown);
            truth.session(0.1, &mut Random(7))
        };
        let mut shown = placements(&board, 24, &mut Random(1));
        let mut session = recorded(shown.clone());
        let is_seen_by_all = |placement: &usize| {
            let views = session.views.iter();
            views.filter(|v| v.placement == *placement).count() == 3
        };
        let joint = (4..24).find(is_seen_by_all).unwrap();
        shown[joint].translation.vector.x += moved;
        let is_other = |v: &View| (v.camera, v.placement) == (2, joint);
        let other = recorded(shown).views.into_iter().find(is_other).unwrap();
        session.views.retain(|v| !is_other(v));
        session.views.push(other);
        let is_kept =
            |v: &View| v.placement == joint || (v.camera == 2) == v.placement.is_multiple_of(2);
        if is_apart {
            session.views.retain(is_kept);
        }
        (session, joint)
    }

    fn judged(session: &Session) -> (CalibrationLevel, Vec<Reason>) {
        let parameters = Parameters {
            folds: 0,
            ..Parameters::default()
        };
        let fit = fit(session, &parameters).unwrap();
        let judgement = judge(&fit, &[], &BTreeMap::new(), &Limits::default());
        let joints = judgement.reasons.into_iter();
        let joints = joints.filter(|r| r.kind == ReasonKind::SingleJoint);
        (judgement.level, joints.collect())
    }

    #[test]
    fn a_camera_that_shares_one_placement_with_the_others_is_doubted() {
        let (level, joints) = judged(&session(false, 0.0).0);
        assert!(level < CalibrationLevel::Doubtful && joints.is_empty());
        // Nothing contradicts what it saw there, whether it is right or wrong.
        for moved in [0.0, 0.02] {
            let (session, joint) = session(true, moved);
            let (level, joints) = judged(&session);
            assert_eq!(level, CalibrationLevel::Doubtful);
            let [reason] = &joints[..] else {
                panic!("{joints:?}")
            };
            let told = format!(
                "camera c02 was joined to the other cameras by a single placement, p{joint:02}: "
            );
            assert!(reason.words.starts_with(&told), "{}", reason.words);
        }
    }
}
