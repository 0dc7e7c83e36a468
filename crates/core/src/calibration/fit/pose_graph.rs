//! Joins cameras through the placements that they share: relative poses by vote, a maximum spanning tree of cameras,
//! and one reading of the board for all cameras of a placement.

use super::planar::PlanePose;
use super::session::{Session, board_from_turned, outermost, turns};
use crate::calibration::Face;
use nalgebra::Isometry3;
use rayon::prelude::*;

/// Distance of two poses of the board, over its distance from the camera, up to which they agree.
pub(super) const AGREES: f64 = 0.03;
/// Most placements of a pair of cameras that are tried as its hypothesis.
const MOST_HYPOTHESES: usize = 40;

/// How two cameras lie to each other.
#[derive(Clone, Debug)]
pub(super) struct Link {
    pub cameras: [usize; 2],
    /// From the second camera's frame to the first's.
    pub first_from_second: Isometry3<f64>,
    /// How many placements agree on it, each by how well.
    pub score: f64,
}

/// The board's pose in each camera at each placement, as `poses[camera][placement]`.
pub(super) type Poses = Vec<Vec<Option<Isometry3<f64>>>>;

/// Collects the board's pose by camera and placement. A view of the back is converted with the nominal offset between
/// back and front.
pub(super) fn poses(session: &Session, of_views: &[Option<PlanePose>]) -> Poses {
    let mut poses = vec![vec![None; session.placements.len()]; session.cameras.len()];
    let back_from_front = session.board.front_from_back().inverse();
    for (view, pose) in session.views.iter().zip(of_views) {
        let Some(pose) = pose else { continue };
        let camera_from_board = match view.face {
            Face::Front => pose.camera_from_plane,
            Face::Back => pose.camera_from_plane * back_from_front,
        };
        poses[view.camera][view.placement] = Some(camera_from_board);
    }
    poses
}

/// Compares poses of the board and knows under which turns it looks the same.
pub(super) struct Comparison<'a> {
    session: &'a Session,
    turns: &'static [usize],
}

impl<'a> Comparison<'a> {
    pub(super) fn new(session: &'a Session) -> Self {
        Self {
            session,
            turns: turns(&session.board),
        }
    }

    /// How far two poses of the board in one camera lie apart, over its distance.
    fn distance(&self, a: &Isometry3<f64>, b: &Isometry3<f64>) -> f64 {
        let corners = outermost(&self.session.board);
        let apart: f64 = corners.iter().map(|p| (a * p - b * p).norm()).sum();
        let away: f64 = corners.iter().map(|p| (a * p).coords.norm()).sum();
        apart / away.max(1e-9)
    }

    /// The board's pose under another reading.
    fn turned(&self, pose: &Isometry3<f64>, quarters: usize) -> Isometry3<f64> {
        pose * board_from_turned(&self.session.board, quarters)
    }

    /// The board's pose under each of its readings.
    pub(super) fn readings(
        &self,
        pose: &Isometry3<f64>,
    ) -> impl Iterator<Item = Isometry3<f64>> + use<'a> {
        let (pose, board) = (*pose, self.session.board);
        let turns = self.turns.iter();
        turns.map(move |&quarters| pose * board_from_turned(&board, quarters))
    }

    /// The turn under which a camera's own pose is nearest to the one predicted, and how near that is.
    pub(super) fn nearest_turn(
        &self,
        own: &Isometry3<f64>,
        predicted: &Isometry3<f64>,
    ) -> (usize, f64) {
        let of = |&quarters: &usize| {
            (
                quarters,
                self.distance(&self.turned(own, quarters), predicted),
            )
        };
        let all = self.turns.iter().map(of);
        all.min_by(|a, b| a.1.total_cmp(&b.1))
            .unwrap_or((0, f64::INFINITY))
    }

    /// The link of two cameras, if their common placements speak for one and no other.
    fn link(&self, poses: &Poses, first: usize, second: usize) -> Option<Link> {
        let both = poses[first].iter().zip(&poses[second]);
        let shared: Vec<_> = both.filter_map(|(a, b)| Some(((*a)?, (*b)?))).collect();
        let step = shared.len().div_ceil(MOST_HYPOTHESES).max(1);
        let mut tried: Vec<(f64, Isometry3<f64>)> = Vec::new();
        for (a, b) in shared.iter().step_by(step) {
            for &quarters in self.turns {
                let hypothesis = a * self.turned(b, quarters).inverse();
                let vote = |(a, b): &(Isometry3<f64>, Isometry3<f64>)| {
                    let (_, apart) = self.nearest_turn(b, &(hypothesis.inverse() * a));
                    (1.0 - apart / AGREES).max(0.0)
                };
                tried.push((shared.iter().map(vote).sum(), hypothesis));
            }
        }
        let best = tried.iter().max_by(|a, b| a.0.total_cmp(&b.0))?;
        let (a, _) = shared.first()?;
        let seen_by = |link: &Isometry3<f64>| link.inverse() * a;
        let rival = tried.iter().any(|other| {
            other.0 > 0.8 * best.0
                && self.distance(&seen_by(&best.1), &seen_by(&other.1)) > 2.0 * AGREES
        });
        let link = Link {
            cameras: [first, second],
            first_from_second: best.1,
            score: best.0,
        };
        (best.0 > 0.0 && !rival).then_some(link)
    }

    /// All links between cameras.
    pub(super) fn links(&self, poses: &Poses) -> Vec<Link> {
        let n = poses.len();
        let pairs: Vec<_> = (0..n)
            .flat_map(|a| (a + 1..n).map(move |b| (a, b)))
            .collect();
        let links: Vec<_> = pairs
            .par_iter()
            .map(|&(a, b)| self.link(poses, a, b))
            .collect();
        links.into_iter().flatten().collect()
    }
}

/// A tree of cameras.
pub(super) struct Tree {
    /// Each camera's pose: from the root's frame to the camera's. `None` for those that no link reaches.
    pub camera_from_root: Vec<Option<Isometry3<f64>>>,
    /// The links that it consists of.
    pub links: Vec<[usize; 2]>,
}

/// The maximum spanning tree (Prim) of the cameras that hang together with `root`.
pub(super) fn tree(cameras: usize, links: &[Link], root: usize) -> Tree {
    let mut tree = Tree {
        camera_from_root: vec![None; cameras],
        links: Vec::new(),
    };
    tree.camera_from_root[root] = Some(Isometry3::identity());
    loop {
        let reached = |c: usize| tree.camera_from_root[c].is_some();
        let open = links
            .iter()
            .filter(|l| reached(l.cameras[0]) != reached(l.cameras[1]));
        let Some(best) = open.max_by(|a, b| a.score.total_cmp(&b.score)) else {
            return tree;
        };
        let [first, second] = best.cameras;
        let link = best.first_from_second;
        if let Some(from_root) = tree.camera_from_root[first] {
            tree.camera_from_root[second] = Some(link.inverse() * from_root);
        } else if let Some(from_root) = tree.camera_from_root[second] {
            tree.camera_from_root[first] = Some(link * from_root);
        }
        tree.links.push(best.cameras);
    }
}

/// A placement as all its cameras see it.
pub(super) struct PlacementEstimate {
    pub root_from_board: Isometry3<f64>,
    /// How far each camera's estimate is from the common pose; `None` for a camera that did not see it.
    pub turns: Vec<Option<(usize, f64)>>,
}

impl Comparison<'_> {
    /// The pose of a placement on which most cameras agree, and each camera's reading of the board under it. Each
    /// camera counts as much as its `trust`.
    pub(super) fn agree(
        &self,
        poses: &Poses,
        tree: &Tree,
        placement: usize,
        trust: &[f64],
    ) -> Option<PlacementEstimate> {
        let seen: Vec<_> = (0..poses.len())
            .map(|c| Some((tree.camera_from_root[c]?, poses[c][placement]?)))
            .collect();
        let judge = |root_from_board: Isometry3<f64>| {
            let of = |seen: &Option<(Isometry3<f64>, Isometry3<f64>)>| {
                let (camera_from_root, own) = (*seen)?;
                Some(self.nearest_turn(&own, &(camera_from_root * root_from_board)))
            };
            let turns: Vec<_> = seen.iter().map(of).collect();
            let cost: f64 = turns
                .iter()
                .zip(trust)
                .filter_map(|(turn, trust)| turn.map(|(_, apart)| trust * apart.min(AGREES)))
                .sum();
            (
                cost,
                PlacementEstimate {
                    root_from_board,
                    turns,
                },
            )
        };
        let candidates = seen
            .iter()
            .flatten()
            .map(|(camera, own)| judge(camera.inverse() * own));
        let best = candidates.min_by(|a, b| a.0.total_cmp(&b.0));
        best.map(|(_, agreed)| agreed)
    }
}
