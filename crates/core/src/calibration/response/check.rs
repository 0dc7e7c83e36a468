//! Tests whether a depth camera's readings still match its response, on boards whose places the rig knows.

use super::misfit::{self, Patch};
use super::plane::{Plane, PlaneParameters, PlaneView};
use crate::calibration::{Board, DepthResponse, Intrinsics};

/// A depth camera's readings against its response.
#[derive(serde::Serialize, Clone, Debug, PartialEq)]
pub struct DepthCheck {
    /// Each placement that it read, in the order given.
    pub placements: Vec<DepthDeviation>,
    /// The placement that is the farthest off for its distance.
    pub worst: DepthDeviation,
    /// Whether that is more than can be.
    pub is_off: bool,
    /// By how many pixels in x and y the depth is displaced against its colour picture, if several placements show
    /// that.
    pub beside_px: Option<[f64; 2]>,
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
}

impl DepthDeviation {
    /// At 1 m: noise and errors of disparity grow with the square of the distance.
    fn at_1m(&self) -> f64 {
        self.off / self.distance.powi(2)
    }
}

/// Holds readings against a response; `most` is by how many metres they may be off at 1 m beyond what the response's
/// uncertainty says.
///
/// # Errors
/// If no placement has readings enough: why, of each.
pub fn check_depth(
    lens: &Intrinsics,
    board: &Board,
    views: &[PlaneView<'_>],
    response: &DepthResponse,
    most: f64,
) -> Result<DepthCheck, String> {
    let parameters = PlaneParameters::default();
    let (mut placements, mut patches, mut reasons) = (Vec::new(), Vec::new(), Vec::new());
    for view in views {
        match Plane::gather(lens, board, view, &parameters) {
            Ok(plane) => {
                let (off, own) = against(lens, &plane, response);
                placements.push(off);
                patches.push(own);
            }
            Err(reason) => reasons.push(format!("{}: {reason}", view.placement)),
        }
    }
    let worst = placements
        .iter()
        .max_by(|a, b| a.at_1m().abs().total_cmp(&b.at_1m().abs()))
        .cloned();
    let Some(worst) = worst else {
        return Err(match reasons.is_empty() {
            true => "it did not see the board".into(),
            false => reasons.join("; "),
        });
    };
    let allowed = most * worst.distance.powi(2).max(1.0) + response.uncertainty;
    Ok(DepthCheck {
        is_off: worst.off.abs() > allowed,
        beside_px: misfit::shift(&patches),
        placements,
        worst,
    })
}

/// What a plane's readings are off by.
fn against(
    lens: &Intrinsics,
    plane: &Plane<'_>,
    response: &DepthResponse,
) -> (DepthDeviation, Vec<Patch>) {
    let (mut depth, mut off) = (0.0, 0.0);
    for sample in &plane.samples {
        let z = response.slope * sample.reading + response.intercept;
        let truth = plane.depth(sample, response.scale_at(z));
        depth += truth;
        off += z - truth;
    }
    let count = plane.samples.len().max(1) as f64;
    let line = [response.slope, response.intercept];
    let found = DepthDeviation {
        placement: plane.placement.to_owned(),
        distance: depth / count,
        off: off / count,
    };
    (found, plane.patches(lens, line))
}
