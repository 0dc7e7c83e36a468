//! Finds the camera that has moved since the calibration: the one without which the others agree again. Also measures
//! by how much its silhouette is displaced against the hull of the others. Both need the camera to be left out, because
//! the hull of all cameras stays within every silhouette, which hides half of the error and makes other cameras look
//! wrong as well.

use super::color::{ColorMeasures, Consistency};
use super::trial_hull::trial_hull;
use crate::frame::CameraId;
use crate::reconstruct::{Reconstruction, Scene};
use rayon::prelude::*;
use serde::Serialize;

/// A camera that has moved.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MovedCamera {
    /// The camera.
    pub camera: CameraId,
    /// By how many pixels its silhouette is displaced from where the others put it, x to the right and y down.
    pub shift_px: [f64; 2],
    /// The length of that over the longest side of the object in the picture.
    pub shift_share: f64,
    /// How far the other cameras' silhouettes are displaced against the hull of all cameras, as a share of the object's
    /// longest side: the root mean square over them.
    pub others_share_with: f64,
    /// The same against the hull without it.
    pub others_share_without: f64,
}

/// Fewer cameras than this cannot tell which one of them moved.
const LEAST_CAMERAS: usize = 4;
/// Shift, as a share of the object's longest side, from which on a camera is looked into. Sound captures stay
/// below (`design/verdict.md`), and cost nothing here.
const SUSPICIOUS: f64 = 0.003;
/// Cameras looked into, the most shifted first: the one that moved is among them.
const SUSPECTS: usize = 3;
/// A camera is to blame if the others disagree this much less without it.
const BLAMED: f64 = 0.5;

/// Finds the camera that has moved, if one has.
pub(super) fn moved(
    scene: &Scene,
    made: &Reconstruction,
    colors: &[ColorMeasures],
) -> Option<MovedCamera> {
    let suspects = suspects(colors);
    if colors.len() < LEAST_CAMERAS || suspects.is_empty() {
        return None;
    }
    let of_suspect = |camera| without(scene, made, colors, camera);
    let found = suspects.into_par_iter().filter_map(of_suspect);
    let found: Vec<MovedCamera> = found.collect();
    found
        .into_iter()
        .filter(|m| m.shift_share > SUSPICIOUS && improvement(m) < BLAMED)
        .min_by(|a, b| improvement(a).total_cmp(&improvement(b)))
}

/// What remains of the others' disagreement without the camera.
fn improvement(moved: &MovedCamera) -> f64 {
    moved.others_share_without / moved.others_share_with
}

fn suspects(colors: &[ColorMeasures]) -> Vec<usize> {
    let share = |&i: &usize| colors[i].shift_share(colors[i].consistency.shift_px);
    let mut suspects: Vec<usize> = (0..colors.len())
        .filter(|i| share(i) > SUSPICIOUS)
        .collect();
    suspects.sort_by(|a, b| share(b).total_cmp(&share(a)));
    suspects.truncate(SUSPECTS);
    suspects
}

/// How the others agree without a camera, and where they put its silhouette.
fn without(
    scene: &Scene,
    made: &Reconstruction,
    colors: &[ColorMeasures],
    camera: usize,
) -> Option<MovedCamera> {
    let all_but_it = |i: usize| (i != camera).then(|| &scene.colors[i].camera);
    let hull = trial_hull(scene, made, all_but_it)?;
    let share_without = |i: usize| {
        let (view, silhouette) = (&scene.colors[i], &made.silhouettes[i]);
        let consistency = Consistency::of(&view.camera, silhouette, &hull, scene.volume);
        colors[i].shift_share(consistency.shift_px)
    };
    let share_with = |i: usize| colors[i].shift_share(colors[i].consistency.shift_px);
    let others = || (0..colors.len()).filter(|&i| i != camera);
    let (view, silhouette) = (&scene.colors[camera], &made.silhouettes[camera]);
    let shift_px = Consistency::shift_against(&view.camera, silhouette, &hull, scene.volume);
    Some(MovedCamera {
        camera: view.camera.id.clone(),
        shift_px,
        shift_share: colors[camera].shift_share(shift_px),
        others_share_with: root_mean_square(others().map(share_with)),
        others_share_without: root_mean_square(others().map(share_without)),
    })
}

fn root_mean_square(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0.0), |(sum, count), v| (sum + v * v, count + 1.0));
    f64::sqrt(sum / count)
}
