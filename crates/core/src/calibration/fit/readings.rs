//! One reading of the board for all cameras of a placement. Views that contradict the others are set aside; where it is
//! not known which of them are right, the whole placement is.

use super::pose_graph::{Comparison, PlacementEstimate, Poses, Tree};
use super::result::LeftOut;
use super::session::Session;
use std::collections::BTreeSet;

/// Distance of a camera's board from where the others see it, over its distance from the camera, beyond which the view
/// is left out at once.
const ELSEWHERE: f64 = 0.15;
/// Why such a view is left out.
pub(super) const FAR: &str = "it saw the board far from where the other cameras did";
/// Why a placement is left out at which no more cameras agree than contradict them.
pub(super) const UNDECIDED: &str = "its cameras saw the board at places far from each other, and it is not known which of \
                                    them are right: a picture may be of another moment or camera";
/// Placements at which the others outvoted a camera, from which on it counts for less.
const OUTVOTED: usize = 2;
/// For how much.
const OF_OUTVOTED: f64 = 0.5;

/// Where the cameras of a tree saw the board at each placement.
pub(super) struct Readings {
    /// Of each placement; `None` where no camera saw it.
    pub placements: Vec<Option<PlacementEstimate>>,
    /// What the word of each camera counts.
    trust: Vec<f64>,
}

impl Readings {
    pub(super) fn of(comparison: &Comparison, poses: &Poses, tree: &Tree, count: usize) -> Self {
        let of = |trust: &[f64]| -> Vec<Option<PlacementEstimate>> {
            (0..count)
                .map(|placement| comparison.agree(poses, tree, placement, trust))
                .collect()
        };
        let equal = Self {
            trust: vec![1.0; poses.len()],
            placements: of(&vec![1.0; poses.len()]),
        };
        let trust: Vec<f64> = (0..poses.len())
            .map(|camera| match equal.outvoted(camera) {
                n if n < OUTVOTED => 1.0,
                _ => OF_OUTVOTED,
            })
            .collect();
        match trust == equal.trust {
            true => equal,
            false => Self {
                placements: of(&trust),
                trust,
            },
        }
    }

    /// At how many placements two cameras or more, and most of them, agree against this one.
    fn outvoted(&self, camera: usize) -> usize {
        let contradicts = |estimate: &&PlacementEstimate| {
            let [agreeing, apart] = self.votes(estimate);
            let own = estimate.turns[camera];
            own.is_some_and(|(_, off)| off > ELSEWHERE) && agreeing >= 2.0 && agreeing > apart
        };
        self.placements.iter().flatten().filter(contradicts).count()
    }

    /// What the cameras count that agree on a placement, and those that contradict them.
    fn votes(&self, estimate: &PlacementEstimate) -> [f64; 2] {
        let seen = estimate.turns.iter().zip(&self.trust);
        seen.fold([0.0; 2], |[agreeing, apart], (turn, trust)| match turn {
            Some((_, off)) if *off > ELSEWHERE => [agreeing, apart + trust],
            Some(_) => [agreeing + trust, apart],
            None => [agreeing, apart],
        })
    }

    /// How far from the place that most agree on some camera saw the board of a placement, over its distance.
    fn apart(&self, placement: usize) -> Option<f64> {
        let turns = self.placements[placement].iter().flat_map(|e| &e.turns);
        turns.flatten().map(|(_, off)| *off).reduce(f64::max)
    }

    /// Whether it is not known which views of a placement are right.
    fn is_undecided(&self, placement: usize) -> bool {
        self.placements[placement].as_ref().is_some_and(|estimate| {
            let [agreeing, apart] = self.votes(estimate);
            apart > 0.0 && apart >= agreeing
        })
    }

    /// Gives the views of each placement the reading on which its cameras agree, and sets the others aside.
    pub(super) fn apply(&self, session: &mut Session, left_out: &mut Vec<LeftOut>) {
        let id = |camera: usize| session.cameras[camera].id.clone();
        for placement in (0..session.placements.len()).filter(|&p| self.is_undecided(p)) {
            let own = session.views.iter().filter(|v| v.placement == placement);
            let cameras: BTreeSet<usize> = own.map(|v| v.camera).collect();
            left_out.push(LeftOut {
                camera: None,
                placement: Some(session.placements[placement].clone()),
                reason: UNDECIDED.into(),
                views: cameras.into_iter().map(id).collect(),
                apart: self.apart(placement),
            });
        }
        let Session {
            board,
            cameras,
            placements,
            views,
        } = session;
        views.retain_mut(|view| {
            if self.is_undecided(view.placement) {
                return false;
            }
            let estimate = self.placements[view.placement].as_ref();
            let own = estimate.and_then(|estimate| estimate.turns[view.camera]);
            let Some((quarters, _)) = own.filter(|(_, off)| *off <= ELSEWHERE) else {
                left_out.push(LeftOut {
                    camera: Some(cameras[view.camera].id.clone()),
                    placement: Some(placements[view.placement].clone()),
                    reason: FAR.into(),
                    views: vec![cameras[view.camera].id.clone()],
                    apart: own.map(|(_, off)| off),
                });
                return false;
            };
            view.turn(board, quarters);
            true
        });
    }
}
