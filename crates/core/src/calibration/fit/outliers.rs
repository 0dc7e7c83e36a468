//! Finds what to leave out: false corners, views that no pose explains, placements whose views contradict each other,
//! and placements that were recorded twice. It gives the reason for each; it fits no lens.

use super::adjust::{Bundle, Loss, Observation, PlacementState};
use super::planar;
use crate::statistics::upper_median;
use nalgebra::{Isometry3, Point2, Point3};
use rayon::prelude::*;

/// Why something is left out.
pub(super) struct Omission {
    pub reason: String,
    /// How far from each other the placement's views show the board, over its distance from the camera; `None` where
    /// they do not contradict each other on that.
    pub apart: Option<f64>,
}

/// Something to leave out.
pub(super) enum ViewDecision {
    /// A view, by its index, and why.
    View(usize, Omission),
    /// A placement, by its index, and why.
    Placement(usize, Omission),
    /// A placement, by its index, that says nothing new, and why.
    Duplicate(usize, String),
}

/// A view's residual with the rig's pose, and with a pose of its own.
struct JudgedView {
    joint: f64,
    alone: f64,
    /// Where it shows the board by itself; `None` if no pose was found.
    rig_from_board: Option<Isometry3<f64>>,
}

/// The root mean square of a view's residuals, estimated from their median, so that single false corners do not count.
pub(super) fn rms(bundle: &Bundle, view: &Observation) -> f64 {
    let lengths = bundle.residuals(view).into_iter();
    rms_of_median(median(lengths.map(|r| r.map_or(1e3, |r| r.norm()))))
}

/// For residuals that are normally distributed in both coordinates.
fn rms_of_median(median: f64) -> f64 {
    median / (2.0 * std::f64::consts::LN_2).sqrt() * std::f64::consts::SQRT_2
}

fn judged(bundle: &Bundle, view: &Observation) -> JudgedView {
    let camera = &bundle.cameras[view.camera];
    let start = camera.camera_from_rig * bundle.placements[view.placement].rig_from_board;
    let start = if view.back {
        start * bundle.board_from_back
    } else {
        start
    };
    let points = bundle.sheet.shaped(view.back, &view.points);
    let alone = planar::refined(&camera.lens, &points, &start);
    let alone = alone.map(|alone| alone.camera_from_plane);
    let residual = |pose: &Isometry3<f64>| {
        let length = |(p, pixel): &(Point3<f64>, Point2<f64>)| {
            let seen = camera.lens.project((pose * p).coords);
            seen.map_or(1e3, |seen| (seen - pixel).norm())
        };
        rms_of_median(median(points.iter().map(length)))
    };
    let rig_from_board = |camera_from_face: &Isometry3<f64>| {
        let rig_from_face = camera.camera_from_rig.inverse() * camera_from_face;
        match view.back {
            true => rig_from_face * bundle.board_from_back.inverse(),
            false => rig_from_face,
        }
    };
    JudgedView {
        joint: rms(bundle, view),
        alone: alone.as_ref().map_or(1e3, residual),
        rig_from_board: alone.as_ref().map(rig_from_board),
    }
}

/// How far from each other the views of a placement, each by itself, show the board, over its distance from the camera:
/// the largest such part, of all views or of one of them against the others.
fn apart(bundle: &Bundle, judged: &[JudgedView], placement: usize, one: Option<usize>) -> f64 {
    let views: Vec<usize> = (0..bundle.views.len())
        .filter(|&i| bundle.views[i].placement == placement)
        .collect();
    let of = |&second: &usize| {
        let others = views.iter().filter(move |&&first| first != second);
        others.filter_map(move |&first| two_apart(bundle, judged, [first, second]))
    };
    let wanted = views.iter().filter(|i| one.is_none_or(|one| one == **i));
    wanted.flat_map(of).fold(0.0, f64::max)
}

/// How far the first of two views shows the board from where the second one does, over its distance from the camera of
/// the second; `None` if either shows none by itself.
fn two_apart(bundle: &Bundle, judged: &[JudgedView], views: [usize; 2]) -> Option<f64> {
    let view = &bundle.views[views[1]];
    let camera_from_rig = bundle.cameras[view.camera].camera_from_rig;
    let camera_from_face = |index: usize| {
        let camera_from_board = camera_from_rig * judged[index].rig_from_board?;
        Some(match view.back {
            true => camera_from_board * bundle.board_from_back,
            false => camera_from_board,
        })
    };
    let (other, own) = (camera_from_face(views[0])?, camera_from_face(views[1])?);
    let points = || view.points.iter().map(|(p, _)| p);
    let apart: f64 = points().map(|p| (other * p - own * p).norm()).sum();
    let away: f64 = points().map(|p| (own * p).coords.norm()).sum();
    Some(apart / away.max(1e-9))
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    upper_median(&mut values.collect::<Vec<f64>>()).unwrap_or(0.0)
}

/// What residuals usually are, in pixels, where they are less: a fifth of a pixel and less is never worth a word.
pub(super) const LEAST_USUAL: f64 = 0.06;

/// The usual residual in the views of each camera: the median of its own views, or of all if it has few.
fn usual(bundle: &Bundle, of_views: &[f64]) -> Vec<f64> {
    const FEW: usize = 3;
    let all = median(of_views.iter().copied()).max(LEAST_USUAL);
    let of_camera = |camera: usize| {
        let own = bundle
            .views
            .iter()
            .zip(of_views)
            .filter(|(v, _)| v.camera == camera);
        let own: Vec<f64> = own.map(|(_, rms)| *rms).collect();
        if own.len() < FEW {
            all
        } else {
            median(own.into_iter()).max(LEAST_USUAL)
        }
    };
    (0..bundle.cameras.len()).map(of_camera).collect()
}

/// The worst view or placement that does not belong; `None` when all do.
pub(super) fn worst(bundle: &Bundle, ratio: f64) -> Option<ViewDecision> {
    let judged: Vec<JudgedView> = (bundle.views.par_iter())
        .map(|v| judged(bundle, v))
        .collect();
    let alone = usual(bundle, &judged.iter().map(|j| j.alone).collect::<Vec<_>>());
    let joint = usual(bundle, &judged.iter().map(|j| j.joint).collect::<Vec<_>>());
    let excess = |i: usize| {
        let camera = bundle.views[i].camera;
        (judged[i].joint / joint[camera]).max(judged[i].alone / alone[camera])
    };
    let index = (0..judged.len()).max_by(|&a, &b| excess(a).total_cmp(&excess(b)))?;
    if excess(index) <= ratio {
        return None;
    }
    let (view, worst) = (&bundle.views[index], &judged[index]);
    let (usual_alone, usual_joint) = (alone[view.camera], joint[view.camera]);
    if worst.alone / usual_alone > ratio {
        let reason = format!(
            "its corners fit no pose of the board: they are {:.2} px off by themselves, and {usual_alone:.2} px are \
             usual; the picture may be blurred, the board bent, or the lens beyond the lens model there",
            worst.alone
        );
        let apart = None;
        return Some(ViewDecision::View(index, Omission { reason, apart }));
    }
    let placement = view.placement;
    let odd_one = odd_one_out(bundle, placement, |camera| ratio * joint[camera]);
    let apart = Some(apart(bundle, &judged, placement, odd_one));
    Some(match odd_one {
        Some(odd_one) => {
            let reason = ELSEWHERE.into();
            ViewDecision::View(odd_one, Omission { reason, apart })
        }
        None => {
            let reason = format!(
                "{DISAGREE} on where the board was ({:.2} px, {usual_joint:.2} px are usual): the board may have moved \
                 during the capture, or a camera, or a picture is of another moment",
                worst.joint
            );
            ViewDecision::Placement(placement, Omission { reason, apart })
        }
    })
}

/// Why a view is left out that fits a pose of the board, but not the one that the placement's other views agree on.
pub(super) const ELSEWHERE: &str = "it saw the board elsewhere than the other cameras did: it may have been moved, or \
                                    its picture taken at another moment";

/// With what the reason begins for which a placement is left out whose views contradict each other.
pub(super) const DISAGREE: &str = "its cameras disagree";

/// Index of the one view of a placement without which its other views agree, each camera's to `most` pixels.
fn odd_one_out(bundle: &Bundle, placement: usize, most: impl Fn(usize) -> f64) -> Option<usize> {
    let views: Vec<usize> = (0..bundle.views.len())
        .filter(|&i| bundle.views[i].placement == placement)
        .collect();
    if views.len() < 3 {
        return None;
    }
    let without = |left_out: usize| {
        let others = views
            .iter()
            .filter(|&&i| i != left_out)
            .map(|&i| bundle.views[i].clone());
        let pose = placed(bundle, placement, others.collect());
        pose.views
            .iter()
            .map(|v| rms(&pose, v) / most(v.camera))
            .fold(0.0, f64::max)
    };
    let (rest, odd) =
        (views.iter().map(|&i| (without(i), i))).min_by(|a, b| a.0.total_cmp(&b.0))?;
    (rest <= 1.0).then_some(odd)
}

/// A bundle of one placement's views in which only the board's pose is free, adjusted.
pub(super) fn placed(bundle: &Bundle, placement: usize, views: Vec<Observation>) -> Bundle {
    let mut cameras = bundle.cameras.clone();
    for camera in &mut cameras {
        camera.pose_free = false;
        camera.free.fill(false);
    }
    let seen = views.into_iter().map(|view| Observation {
        placement: 0,
        ..view
    });
    let rig_from_board = bundle.placements[placement].rig_from_board;
    let mut sheet = bundle.sheet.clone();
    sheet.free.fill(false);
    let mut alone = Bundle {
        cameras,
        placements: vec![PlacementState {
            rig_from_board,
            free: true,
        }],
        board_from_back: bundle.board_from_back,
        back_free: false,
        sheet,
        views: seen.collect(),
    };
    alone.adjust(alone.robust_loss(), 20);
    alone.adjust(alone.robust_loss(), 20);
    alone
}

/// Takes corners out that lie further off than `deviations` robust standard deviations of their camera's residuals;
/// how many of each camera.
pub(super) fn drop_false_corners(bundle: &mut Bundle, deviations: f64) -> Vec<usize> {
    let mut dropped = vec![0; bundle.cameras.len()];
    for (camera, dropped) in dropped.iter_mut().enumerate() {
        let of_camera = bundle.views.iter().filter(|v| v.camera == camera);
        let residuals = of_camera.flat_map(|v| bundle.residuals(v));
        let usual = median(residuals.map(|r| r.map_or(1e3, |r| r.norm()))) / 1.1774;
        let most = deviations * usual.max(0.01);
        for i in 0..bundle.views.len() {
            if bundle.views[i].camera == camera {
                let residuals = bundle.residuals(&bundle.views[i]);
                let mut keep = residuals
                    .iter()
                    .map(|r| r.is_some_and(|r| r.norm() <= most));
                let points = &mut bundle.views[i].points;
                let before = points.len();
                points.retain(|_| keep.next().unwrap_or(false));
                *dropped += before - points.len();
            }
        }
    }
    dropped
}

/// Placements that say nothing new, with the reason: each camera that saw one saw the same face of the board at another
/// one, in the same place to a fraction of a pixel. Of two that the same cameras saw, it is the later one.
pub(super) fn duplicates(bundle: &Bundle, names: &[String]) -> Vec<(usize, String)> {
    let mut by_placement: Vec<Vec<&Observation>> = vec![Vec::new(); bundle.placements.len()];
    for view in &bundle.views {
        by_placement[view.placement].push(view);
    }
    let adds_nothing = |own: usize, other: usize| {
        let (own, other) = (&by_placement[own], &by_placement[other]);
        !own.is_empty() && own.iter().all(|view| is_seen_again(view, other))
    };
    let mut found: Vec<(usize, usize)> = Vec::new();
    for later in 0..bundle.placements.len() {
        let is_kept = |p: &usize| found.iter().all(|(own, _)| own != p);
        let kept: Vec<usize> = (0..later).filter(is_kept).collect();
        let known = kept.iter().copied().find(|&p| adds_nothing(later, p));
        match known {
            Some(earlier) => found.push((later, earlier)),
            None => {
                let less = kept.into_iter().filter(|&p| adds_nothing(p, later));
                found.extend(less.map(|earlier| (earlier, later)));
            }
        }
    }
    let told = |(own, other): (usize, usize)| {
        let other = &names[other];
        let reason =
            format!("the board lies where it lay at {other}, so this placement adds nothing");
        (own, reason)
    };
    found.into_iter().map(told).collect()
}

/// Whether one of these views is the same camera's of the same face, in the same place.
fn is_seen_again(view: &Observation, others: &[&Observation]) -> bool {
    const SAME_PX: f64 = 1.0;
    let is_of = |other: &&&Observation| other.camera == view.camera && other.back == view.back;
    let other = others.iter().find(is_of);
    let apart = other.and_then(|other| mean_distance(view, other));
    apart.is_some_and(|d| d <= SAME_PX)
}

/// Mean distance of some of a view's corners from the other's nearest; of whatever name, for a board that looks the
/// same turned may have been read the other way round.
fn mean_distance(a: &Observation, b: &Observation) -> Option<f64> {
    const SOME: usize = 12;
    let nearest = |pixel: &Point2<f64>| {
        let distances = b.points.iter().map(|(_, other)| (pixel - other).norm());
        distances.fold(f64::INFINITY, f64::min)
    };
    let step = a.points.len().div_ceil(SOME).max(1);
    let some = a.points.iter().step_by(step);
    let distances: Vec<f64> = some.map(|(_, pixel)| nearest(pixel)).collect();
    (!distances.is_empty()).then(|| distances.iter().sum::<f64>() / distances.len() as f64)
}

impl Bundle {
    /// Takes views out; placements that nothing sees any more stay where they are.
    pub(super) fn retain_views(&mut self, keep: impl Fn(usize, &Observation) -> bool) {
        let mut index = 0;
        self.views.retain(|view| {
            index += 1;
            keep(index - 1, view)
        });
        for placement in 0..self.placements.len() {
            let seen = self.views.iter().any(|v| v.placement == placement);
            self.placements[placement].free &= seen;
        }
    }

    /// Moves the rig's frame: `new_from_old` maps the old one into the new one.
    pub(super) fn reframe(&mut self, new_from_old: &Isometry3<f64>) {
        let old_from_new = new_from_old.inverse();
        for camera in &mut self.cameras {
            camera.camera_from_rig *= old_from_new;
        }
        for placement in &mut self.placements {
            placement.rig_from_board = new_from_old * placement.rig_from_board;
        }
    }
}

/// The loss for a bundle without false corners: nearly squared, so that covariances mean what they say.
pub(super) fn mild_loss(bundle: &Bundle) -> Loss {
    Loss {
        scale_px: (10.0 * bundle.robust_deviation()).max(0.05),
    }
}
