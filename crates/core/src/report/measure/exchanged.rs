//! Finds two cameras that were exchanged: their pictures have each other's names, or their poses were entered for each
//! other. If they are exchanged back, all silhouettes agree again. Pairs are compared by how much of space lies in all
//! silhouettes, on a coarse grid of points; for the best few, hulls are made and measured.

use super::color::{ColorMeasures, Consistency};
use super::trial_hull::trial_hull;
use crate::calibration::Camera;
use crate::frame::CameraId;
use crate::image::Mask;
use crate::reconstruct::{Reconstruction, Scene};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use serde::Serialize;
use std::borrow::Cow;

/// Two cameras that are exchanged.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Exchanged {
    /// The cameras.
    pub cameras: [CameraId; 2],
    /// The largest share of any silhouette that the hull leaves uncovered.
    pub missing_with: f64,
    /// The same with the two exchanged back.
    pub missing_without: f64,
}

/// Fewer cameras than this cannot tell which two are exchanged.
const LEAST_CAMERAS: usize = 4;
/// Uncovered share of a silhouette from which on exchanged cameras are looked for: no sound capture is amber for less.
const SUSPICIOUS: f64 = 0.004;
/// Exchanged back, two cameras leave at most this part of what was uncovered.
const EXPLAINED: f64 = 0.2;
/// Pairs that are made hulls of.
const CANDIDATES: usize = 3;
/// A pair is a candidate if so much more of space is in all silhouettes with it.
const LARGER: f64 = 1.02;
/// Points along each side of the grid.
const SIDE: usize = 40;
/// Places that points are projected to, at most: the more cameras there are, the fewer points.
const MOST_PROJECTIONS: usize = 8_000_000;
/// The first pixel value that is object.
const OBJECT: u8 = 128;

/// Finds the two cameras that are exchanged, if two are.
pub(super) fn exchanged(
    scene: &Scene,
    made: &Reconstruction,
    colors: &[ColorMeasures],
) -> Option<Exchanged> {
    let worst = |missing: &mut dyn Iterator<Item = f64>| missing.fold(0.0, f64::max);
    let missing_with = worst(&mut colors.iter().map(|c| c.consistency.missing));
    if colors.len() < LEAST_CAMERAS || missing_with < SUSPICIOUS {
        return None;
    }
    let cameras: Vec<&Camera> = scene.colors.iter().map(|view| &view.camera).collect();
    let masks: Vec<Cow<'_, Mask>> = made
        .silhouettes
        .iter()
        .map(|s| s.possible_object())
        .collect();
    let masks: Vec<&Mask> = masks.iter().map(AsRef::as_ref).collect();
    let tried = candidates(scene, &cameras, &masks).into_par_iter();
    let tried = tried.flat_map_iter(|pair| [(pair, false), (pair, true)]);
    let tried = tried.filter_map(|(pair, only_pose)| {
        let places = placed(&cameras, pair, only_pose);
        let hull = trial_hull(scene, made, |i| Some(&places[i]))?;
        let of_camera =
            |(camera, silhouette)| Consistency::of(camera, silhouette, &hull, scene.volume).missing;
        let missing = worst(&mut places.iter().zip(&made.silhouettes).map(of_camera));
        Some((pair, missing))
    });
    let tried: Vec<((usize, usize), f64)> = tried.collect();
    let (pair, missing_without) = tried.into_iter().min_by(|a, b| a.1.total_cmp(&b.1))?;
    (missing_without < EXPLAINED * missing_with).then(|| Exchanged {
        cameras: [pair.0, pair.1].map(|i| cameras[i].id.clone()),
        missing_with,
        missing_without,
    })
}

/// All cameras, two of them at each other's place: with each other's lens, unless `only_pose`.
fn placed(cameras: &[&Camera], (a, b): (usize, usize), only_pose: bool) -> Vec<Camera> {
    let mut placed: Vec<Camera> = cameras.iter().map(|&camera| camera.clone()).collect();
    for (at, from) in [(a, b), (b, a)] {
        let lens = cameras[if only_pose { at } else { from }].intrinsics;
        placed[at] = Camera::new(cameras[at].id.clone(), lens, cameras[from].rig_from_camera);
    }
    placed
}

/// The pairs with which the most of space is in all silhouettes, the best first, if it is more than without.
fn candidates(scene: &Scene, cameras: &[&Camera], masks: &[&Mask]) -> Vec<(usize, usize)> {
    let points = points(scene, cameras, masks);
    let count = cameras.len();
    let excluded = |p: &Point3<f64>, i: usize| excludes(cameras[i], masks[i], p);
    // Which of the silhouettes a point is outside of: two at most, or no pair can take it in.
    let outside: Vec<(Point3<f64>, Vec<usize>)> = points
        .into_iter()
        .map(|p| (p, (0..count).filter(|&i| excluded(&p, i)).collect()))
        .collect();
    let inside = outside.iter().filter(|(_, out)| out.is_empty()).count();
    let pairs = (0..count).flat_map(|a| (a + 1..count).map(move |b| (a, b)));
    let same_size = |&(a, b): &(usize, usize)| {
        let size = |i: usize| (cameras[i].intrinsics.width, cameras[i].intrinsics.height);
        size(a) == size(b)
    };
    let pairs: Vec<(usize, usize)> = pairs.filter(same_size).collect();
    let taken_in = |&(a, b): &(usize, usize)| {
        let taken_in = |(p, out): &&(Point3<f64>, Vec<usize>)| {
            out.iter().all(|&i| i == a || i == b)
                && !excludes(cameras[b], masks[a], p)
                && !excludes(cameras[a], masks[b], p)
        };
        outside.iter().filter(taken_in).count()
    };
    let counts: Vec<usize> = pairs.par_iter().map(taken_in).collect();
    let larger = |&(_, count): &(_, usize)| count as f64 > LARGER * inside as f64;
    let mut larger: Vec<_> = pairs.into_iter().zip(counts).filter(larger).collect();
    larger.sort_by_key(|&(pair, count)| (std::cmp::Reverse(count), pair));
    larger.truncate(CANDIDATES);
    larger.into_iter().map(|(pair, _)| pair).collect()
}

/// Points of a grid that no more than two silhouettes exclude, first over the volume and then over what that leaves.
fn points(scene: &Scene, cameras: &[&Camera], masks: &[&Mask]) -> Vec<Point3<f64>> {
    let pairs = cameras.len() * cameras.len();
    let most = (MOST_PROJECTIONS / pairs.max(1)) as f64;
    let side = (most.cbrt() as usize).clamp(8, SIDE);
    let kept = |p: &Point3<f64>| {
        let excluding = (0..cameras.len()).filter(|&i| excludes(cameras[i], masks[i], p));
        excluding.take(3).count() < 3
    };
    let mut kept_points = Vec::new();
    let (mut min, mut max) = (scene.volume.min, scene.volume.max);
    for _ in 0..2 {
        let cell = (max - min) / side as f64;
        let at = |i: usize| {
            let index = Vector3::new(i % side, i / side % side, i / side / side);
            min + cell.component_mul(&index.map(|i| i as f64 + 0.5))
        };
        let all = (0..side * side * side).into_par_iter();
        kept_points = all.map(at).filter(&kept).collect();
        let low = |a: Point3<f64>, b: &Point3<f64>| a.inf(b);
        let high = |a: Point3<f64>, b: &Point3<f64>| a.sup(b);
        let Some(first) = kept_points.first().copied() else {
            break;
        };
        min = kept_points.iter().fold(first, low) - cell;
        max = kept_points.iter().fold(first, high) + cell;
    }
    kept_points
}

/// Whether a point is in a picture, but not in its silhouette.
fn excludes(camera: &Camera, mask: &Mask, p: &Point3<f64>) -> bool {
    let Some((pixel, _)) = camera.project(*p) else {
        return false;
    };
    let level = mask.get(pixel.x.round() as isize, pixel.y.round() as isize);
    level.is_some_and(|&level| level < OBJECT)
}
