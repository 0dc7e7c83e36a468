//! Holds a response that was not fitted to boards against what boards show. The only fit here finds the boards that
//! contradict the others.

use super::bias::{DistanceBias, by_distance};
use super::consistent::Consistent;
use super::plane_view::{PlaneParameters, PlaneView};
use super::reading_change::ReadingChange;
use super::samples::{Plane, Values};
use crate::calibration::{Board, DepthResponse, Intrinsics};

/// What boards show of a response that was not fitted to them.
#[derive(Clone, Debug, PartialEq)]
pub struct BoardsBias {
    /// Bias that is left, by distance, in ascending order; empty if no board was read within the response's range.
    pub bias: Vec<DistanceBias>,
    /// How many boards had readings enough.
    pub read: usize,
    /// Boards without enough readings, and why.
    pub unread: Vec<(String, String)>,
    /// Boards whose readings contradict all others and do not count, and why.
    pub left_out: Vec<(String, String)>,
    /// What those that were left out agree on, if they do.
    pub change: Option<ReadingChange>,
}

/// What boards show of a response, within its range.
pub fn bias_on_boards(
    lens: &Intrinsics,
    board: &Board,
    views: &[PlaneView<'_>],
    response: &DepthResponse,
    parameters: &PlaneParameters,
) -> BoardsBias {
    let (mut planes, mut unread) = (Vec::new(), Vec::new());
    for view in views {
        match Plane::gather(lens, board, view, parameters) {
            Ok(plane) => planes.push(plane),
            Err(reason) => unread.push((view.placement.to_owned(), reason)),
        }
    }
    let read = planes.len();
    let (mut left_out, mut change) = (Vec::new(), None);
    // With too few boards to compare them with each other, all of them count.
    if let Ok(consistent) = Consistent::of(planes.clone(), &[], parameters) {
        change = consistent.change(&consistent.line);
        let told = consistent.left_out.iter();
        left_out = told.map(|c| c.told(change.is_some())).collect();
        planes = consistent.planes;
    }
    for plane in &mut planes {
        plane.keep_within_range(response);
    }
    let [constant, by_metre, ..] = response.scale;
    let values = Values::new(response.slope, response.intercept, constant, by_metre);
    BoardsBias {
        bias: by_distance(&planes, &values),
        read,
        unread,
        left_out,
        change,
    }
}
