//! Tests whether a depth camera's readings still match its response, on boards whose places the rig knows.

use super::misfit::{self, Cause, FEWEST_BOARDS, Misfit, Patch};
use super::plane_view::{PlaneParameters, PlaneView};
use super::samples::{FEWEST_IN_VIEW, Plane};
use crate::calibration::{Board, DepthResponse, Intrinsics};

/// How much a depth camera may read otherwise than its response says, beyond the response's uncertainty, and how boards
/// are read.
#[derive(Clone, Copy, Debug)]
pub struct DepthTolerance<'a> {
    /// Metres at 1 m that the mean over a board may be off; they grow with the square of the distance.
    pub off: f64,
    /// Metres at 1 m, as root mean square, that readings may be off in a way that a response cannot have.
    pub misfit: f64,
    /// How boards are read.
    pub plane: &'a PlaneParameters,
}

/// A depth camera's readings against its response.
#[derive(serde::Serialize, Clone, Debug, PartialEq)]
pub struct DepthCheck {
    /// Each placement that it read, in the order given.
    pub placements: Vec<DepthDeviation>,
    /// The placement that is the farthest off for what is allowed at its distance.
    pub worst: DepthDeviation,
    /// Whether that is more than is allowed.
    pub is_off: bool,
    /// What readings have that a response cannot have, where that is more than is allowed.
    pub misfit: Option<Misfit>,
    /// Whether there were boards enough to tell that: how many it read, if there were too few.
    pub too_few_for_misfit: Option<TooFewBoards>,
    /// Whether there were boards enough, but so little tilted, or so much alike, that they would not show depth that is
    /// displaced against its colour picture.
    pub is_displacement_hidden: bool,
}

/// By how many pixels depth may be displaced against its colour picture without being told.
const DISPLACED_PX: f64 = 6.0;

/// Why it was not checked whether depth lies on its colour picture.
#[derive(serde::Serialize, Clone, Copy, Debug, PartialEq, Eq)]
pub struct TooFewBoards {
    /// Boards that were read.
    pub found: usize,
    /// How many it takes.
    pub needed: usize,
}

/// Readings of one placement.
#[derive(serde::Serialize, Clone, Debug, PartialEq)]
pub struct DepthDeviation {
    /// The placement's name.
    pub placement: String,
    /// Mean distance in metres.
    pub distance: f64,
    /// Mean of measured less true depth, in metres.
    pub off: f64,
    /// By how many metres it may be off.
    pub allowed: f64,
}

impl DepthDeviation {
    /// How many times what is allowed it is off.
    fn times_allowed(&self) -> f64 {
        self.off.abs() / self.allowed.max(1e-9)
    }
}

impl DepthCheck {
    /// Whether the camera reads something else than its response says.
    pub fn is_other(&self) -> bool {
        self.is_off || self.misfit.is_some()
    }

    /// Whether its boards show whether the depth lies on its colour picture.
    pub fn shows_registration(&self) -> bool {
        self.too_few_for_misfit.is_none() && !self.is_displacement_hidden
    }

    /// By how many pixels in x and y the depth is displaced against its colour picture, if nothing else would explain
    /// the readings nearly as well.
    pub fn beside_px(&self) -> Option<[f64; 2]> {
        match self.misfit.as_ref()?.causes.as_slice() {
            [Cause::Misregistered(shift)] => Some(*shift),
            _ => None,
        }
    }
}

/// Holds readings against a response.
///
/// # Errors
/// If no placement has readings enough within the response's range: why, of each.
pub fn check_depth(
    lens: &Intrinsics,
    board: &Board,
    views: &[PlaneView<'_>],
    response: &DepthResponse,
    tolerance: DepthTolerance<'_>,
) -> Result<DepthCheck, String> {
    let (mut placements, mut patches, mut reasons) = (Vec::new(), Vec::new(), Vec::new());
    for view in views {
        let gathered = Plane::gather(lens, board, view, tolerance.plane);
        match gathered.and_then(|plane| within_range(plane, response)) {
            Ok(plane) => {
                placements.push(against(&plane, response, tolerance.off));
                patches.push(plane.patches(lens, [response.slope, response.intercept]));
            }
            Err(reason) => reasons.push(format!("{}: {reason}", view.placement)),
        }
    }
    let worst = placements
        .iter()
        .max_by(|a, b| a.times_allowed().total_cmp(&b.times_allowed()))
        .cloned();
    let Some(worst) = worst else {
        return Err(match reasons.is_empty() {
            true => "it did not see the board".into(),
            false => reasons.join("; "),
        });
    };
    let most = tolerance.misfit + response.uncertainty;
    let too_few_for_misfit = too_few(&patches);
    Ok(DepthCheck {
        is_off: worst.times_allowed() > 1.0,
        misfit: misfit::explain(&patches).filter(|misfit| misfit.held_out > most),
        is_displacement_hidden: too_few_for_misfit.is_none()
            && !misfit::would_show_displacement(&patches, DISPLACED_PX, most),
        too_few_for_misfit,
        placements,
        worst,
    })
}

/// The part of a board that lies where the response holds, or that too little of it does.
fn within_range<'a>(mut plane: Plane<'a>, response: &DepthResponse) -> Result<Plane<'a>, String> {
    plane.keep_within_range(response);
    match response.range {
        Some([near, far]) if plane.samples.len() < FEWEST_IN_VIEW => Err(format!(
            "the board lies outside the distances that were calibrated, {near:.2} to {far:.2} m"
        )),
        _ => Ok(plane),
    }
}

/// Why nothing can be said of what readings have that a response cannot have; `None` where there are boards enough.
fn too_few(boards: &[Vec<Patch>]) -> Option<TooFewBoards> {
    let found = boards.iter().filter(|board| !board.is_empty()).count();
    (found < FEWEST_BOARDS).then_some(TooFewBoards {
        found,
        needed: FEWEST_BOARDS,
    })
}

/// What a plane's readings are off by; they may be off by `most` metres at 1 m and by the response's uncertainty.
fn against(plane: &Plane<'_>, response: &DepthResponse, most: f64) -> DepthDeviation {
    let (mut depth, mut off) = (0.0, 0.0);
    for sample in &plane.samples {
        let z = response.slope * sample.reading + response.intercept;
        let truth = plane.depth(sample, response.scale_at(z));
        depth += truth;
        off += z - truth;
    }
    let count = plane.samples.len().max(1) as f64;
    let distance = depth / count;
    DepthDeviation {
        placement: plane.placement.to_owned(),
        distance,
        off: off / count,
        allowed: most * distance.powi(2).max(1.0) + response.uncertainty,
    }
}
