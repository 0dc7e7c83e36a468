//! Finds the scale by which the lengths of one capture's calibration would have to change for its silhouettes to agree
//! with those of another: the seventh unknown of a pose, beside turn and place. It is not used to fuse, but to say why
//! captures under different calibrations do not agree.

use super::align::{Aligned, Rays, align};
use super::body::Body;
use nalgebra::Isometry3;
use rayon::prelude::*;

/// Scales that are tried: up to this many steps below and above 1 …
const STEPS: i32 = 8;
/// … so far apart.
const STEP: f64 = 0.0025;
/// Halvings of a step that find the best scale between them: to a hundredth of a per cent.
const HALVINGS: usize = 5;

/// The scale of the second body at which contours agree best, with the pose there; the pose of the first into the
/// second's rig at scale 1 is `start`.
pub(super) fn best(a: &Body, b: &Body, start: &Isometry3<f64>) -> (f64, Aligned) {
    let at =
        |scale: f64, rays: Rays| align(a, &b.scaled(scale), grown(start, b, scale), rays, None);
    let few = |scale: f64| at(scale, Rays::FEW).disagreement;
    let tried = (-STEPS..=STEPS).into_par_iter();
    let tried: Vec<(f64, f64)> = tried
        .map(|i| {
            let scale = 1.0 + STEP * f64::from(i);
            (few(scale), scale)
        })
        .collect();
    let least = |a: &(f64, f64), b: &(f64, f64)| a.0.total_cmp(&b.0);
    let mut best = tried
        .into_iter()
        .min_by(least)
        .unwrap_or((f64::INFINITY, 1.0));
    let mut step = STEP;
    for _ in 0..HALVINGS {
        step *= 0.5;
        let (_, scale) = best;
        let beside = [scale - step, scale + step].map(|scale| (few(scale), scale));
        best = beside.into_iter().fold(
            best,
            |best, tried| if tried.0 < best.0 { tried } else { best },
        );
    }
    (best.1, at(best.1, Rays::MANY))
}

/// A pose after the second body has grown, so that the same point comes to lie at its centre.
fn grown(pose: &Isometry3<f64>, b: &Body, scale: f64) -> Isometry3<f64> {
    let mut pose = *pose;
    pose.translation.vector += b.center.coords * (scale - 1.0);
    pose
}
