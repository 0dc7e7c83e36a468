//! Finds cameras whose residuals say that the camera or its lens is another one from some placement on, also where no
//! view had to be left out. It uses a fit's equations alone, and says that something changed, and not what.

use super::adjust::{Bundle, CAMERA, Loss};
use super::lens::PARAMETERS;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

/// A camera whose views fit better if they are split in two.
#[derive(serde::Serialize, Clone, Debug, PartialEq)]
pub struct ViewChange {
    /// Index of the camera among the fitted ones.
    pub camera: usize,
    /// Indices, among the fitted ones, of the last placement before the change and of the first one after it, of those
    /// that the camera saw.
    pub placements: [usize; 2],
    /// Root mean square in pixels by which the shorter part of its views is displaced because of it.
    pub by_px: f64,
    /// By what part its focal length would be another one, if that is what changed.
    pub focal_part: f64,
}

/// What may change: focal lengths, centre and pose, as columns of a camera.
const COLUMNS: [usize; 10] = [0, 1, 2, 3, 12, 13, 14, 15, 16, 17];
/// Fewest views on either side of a change, and in all.
const FEWEST: usize = 2;
const FEWEST_VIEWS: usize = 8;
/// What a change must take away, as a part of the squared residuals of the camera's views: their sum over all cameras
/// falls by as much.
const LEAST_PART: f64 = 0.3;
/// Part that it must take away of what a change at each single view would: a change stays, and what is amiss with
/// single views does not.
const STAYS: f64 = 0.45;
/// Displacement in pixels below which a change is never worth a word.
const LEAST_PX: f64 = 0.1;
/// Part of its own information that is added to a parameter, so that what views do not determine stays.
const HELD: f64 = 1e-3;

/// What one of a camera's views says of it: its part of the normal equations, with the placement eliminated.
struct Vote {
    placement: usize,
    information: DMatrix<f64>,
    gradient: DVector<f64>,
    /// Sum of squared residuals, and how many corners.
    squares: f64,
    corners: f64,
}

/// The cameras of an adjusted bundle that change, the largest change first.
pub(super) fn changes(bundle: &Bundle) -> Vec<ViewChange> {
    let placements: Vec<usize> = (0..bundle.placements.len())
        .filter(|&p| bundle.views.iter().any(|v| v.placement == p))
        .collect();
    let of_placements: Vec<Vec<(usize, Vote)>> = placements
        .par_iter()
        .enumerate()
        .map(|(index, &placement)| votes(bundle, placement, index))
        .collect();
    let mut of_cameras: Vec<Vec<Vote>> = bundle.cameras.iter().map(|_| Vec::new()).collect();
    for (camera, vote) in of_placements.into_iter().flatten() {
        of_cameras[camera].push(vote);
    }
    let found = of_cameras.iter().enumerate();
    let mut found: Vec<ViewChange> = found
        .filter_map(|(camera, votes)| of_camera(bundle, camera, votes))
        .collect();
    found.sort_by(|a, b| b.by_px.total_cmp(&a.by_px).then(a.camera.cmp(&b.camera)));
    found
}

/// What the views of one placement say of each camera, the others being as they are.
fn votes(bundle: &Bundle, placement: usize, index: usize) -> Vec<(usize, Vote)> {
    let mut alone = bundle.clone();
    alone.views.retain(|v| v.placement == placement);
    alone.placements[placement].free = true;
    alone.back_free = false;
    alone.sheet.free.fill(false);
    for view in &mut alone.views {
        view.weight = 1.0;
    }
    for camera in &mut alone.cameras {
        camera.prior = [None; PARAMETERS];
        camera.pose_free = true;
    }
    let (matrix, gradient, _) = alone.reduced(&alone.normal(Loss::SQUARED), 0.0);
    let lengths = |index: usize| {
        let residuals = alone.residuals(&alone.views[index]).into_iter().flatten();
        residuals.fold([0.0; 2], |[sum, count], r| {
            [sum + r.norm_squared(), count + 1.0]
        })
    };
    let vote = |view: usize| {
        let camera = alone.views[view].camera;
        let column = |k: usize| camera * CAMERA + COLUMNS[k];
        let free = |k: usize| COLUMNS[k] >= PARAMETERS || alone.cameras[camera].free[COLUMNS[k]];
        let count = COLUMNS.len();
        let information = DMatrix::from_fn(count, count, |i, k| match free(i) && free(k) {
            true => matrix[(column(i), column(k))],
            false => 0.0,
        });
        let gradient = DVector::from_fn(count, |i, _| match free(i) {
            true => gradient[column(i)],
            false => 0.0,
        });
        let [squares, corners] = lengths(view);
        let vote = Vote {
            placement: index,
            information,
            gradient,
            squares,
            corners,
        };
        (camera, vote)
    };
    (0..alone.views.len()).map(vote).collect()
}

/// The split of a camera's views that takes away most of their squared residuals, if that is more than chance does.
fn of_camera(bundle: &Bundle, camera: usize, votes: &[Vote]) -> Option<ViewChange> {
    if votes.len() < FEWEST_VIEWS {
        return None;
    }
    let all = Step::of(votes);
    let single: f64 = votes
        .iter()
        .map(|vote| Step::of(std::slice::from_ref(vote)).gain)
        .sum();
    let squares: f64 = votes.iter().map(|vote| vote.squares).sum();
    let splits = (FEWEST..=votes.len() - FEWEST).map(|at| {
        let parts = [&votes[..at], &votes[at..]].map(Step::of);
        (parts[0].gain + parts[1].gain - all.gain, at, parts)
    });
    let (gain, at, [early, late]) = splits.max_by(|a, b| a.0.total_cmp(&b.0))?;
    let corners = |part: &[Vote]| part.iter().map(|vote| vote.corners).sum::<f64>();
    let shorter = corners(&votes[..at]).min(corners(&votes[at..]));
    let by_px = (gain / shorter.max(1.0)).max(0.0).sqrt();
    let is_certain = gain >= LEAST_PART * squares && gain >= STAYS * single && by_px >= LEAST_PX;
    is_certain.then(|| ViewChange {
        camera,
        placements: [votes[at - 1].placement, votes[at].placement],
        by_px,
        focal_part: (late.focal_px - early.focal_px) / bundle.cameras[camera].lens.focal_px(),
    })
}

/// How some views would change their camera.
struct Step {
    /// By how much their squared residuals would fall.
    gain: f64,
    /// By how many pixels the focal length would grow.
    focal_px: f64,
}

impl Step {
    fn of(votes: &[Vote]) -> Self {
        let count = COLUMNS.len();
        let mut information = DMatrix::<f64>::zeros(count, count);
        let mut gradient = DVector::<f64>::zeros(count);
        for vote in votes {
            information += &vote.information;
            gradient += &vote.gradient;
        }
        // Scaled to a unit diagonal: focal lengths and turns differ by many powers of ten.
        let scale = DVector::from_fn(count, |i, _| {
            let own: f64 = information[(i, i)];
            if own > 1e-9 { own.sqrt().recip() } else { 0.0 }
        });
        let scaled = DMatrix::from_fn(count, count, |i, k| {
            let held = if i == k { HELD } else { 0.0 };
            let empty = if i == k && scale[i] == 0.0 { 1.0 } else { 0.0 };
            information[(i, k)] * scale[i] * scale[k] + held + empty
        });
        let pulled = gradient.component_mul(&scale);
        let step = scaled.cholesky().map(|c| c.solve(&pulled));
        let step = step.unwrap_or_else(|| DVector::zeros(count));
        Self {
            gain: pulled.dot(&step).max(0.0),
            focal_px: -0.5 * (step[0] * scale[0] + step[1] * scale[1]),
        }
    }
}
