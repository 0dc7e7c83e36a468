//! Fits a depth camera's response from boards. The colour picture tells where the board's plane is, so each depth
//! pixel on it has a known depth. A line for the depth and one for the lateral scale are fitted to all of them at
//! once.

use super::ResponseError;
use super::bias::{DistanceBias, ViewBias, by_distance, view_bias};
use super::consistent::Consistent;
use super::correction::Correction;
use super::jackknife;
use super::lateral::Lateral;
use super::misfit::{self, Misfit, Patch};
use super::plane_view::{PlaneParameters, PlaneView};
use super::reading_change::ReadingChange;
use super::samples::{Plane, Sample, Values};
use super::solve::{BEYOND, distances, normals, settled, spans};
use crate::calibration::{Board, DepthResponse, Intrinsics};
use rayon::prelude::*;

/// The least uncertainty, in metres, that is stated.
const LEAST_DOUBT: f64 = 1e-4;
/// Standard deviation of the slope that a factory set, as a share of it: all that is known of a slope that the boards
/// do not show.
const FACTORY_SLOPE: f64 = 0.01;

/// A fitted response with what it leaves.
#[derive(Clone, Debug, PartialEq)]
pub struct PlaneFit {
    /// The response; its range reaches a quarter beyond the nearest and the farthest board.
    pub response: DepthResponse,
    /// Standard deviation of its slope, in metres a unit; `None` where the boards' distances do not say what the slope
    /// is.
    pub slope_deviation: Option<f64>,
    /// Bias that is left, by distance, in ascending order.
    pub bias: Vec<DistanceBias>,
    /// Each view that was used, in the order given.
    pub views: Vec<ViewBias>,
    /// Views without enough readings, and why.
    pub unread: Vec<(String, String)>,
    /// Views whose readings contradict all others and were left out, and why.
    pub left_out: Vec<(String, String)>,
    /// What those that were left out agree on, if they do.
    pub change: Option<ReadingChange>,
    /// A smooth correction a pixel, and whether it would pay.
    pub correction: Correction,
    /// Why the line does not fit, if it does not and a cause explains it.
    pub misfit: Option<Misfit>,
}

/// Fits a response to boards.
///
/// # Errors
/// If too few views show enough of the board in depth, or no real sensor would have the fitted response.
pub fn fit_plane(
    lens: &Intrinsics,
    board: &Board,
    views: &[PlaneView<'_>],
    parameters: &PlaneParameters,
) -> Result<PlaneFit, ResponseError> {
    let gathered: Vec<Result<Plane<'_>, String>> = views
        .par_iter()
        .map(|view| Plane::gather(lens, board, view, parameters))
        .collect();
    let (mut planes, mut unread) = (Vec::new(), Vec::new());
    for (view, plane) in views.iter().zip(gathered) {
        match plane {
            Ok(plane) => planes.push(plane),
            Err(reason) => unread.push((view.placement.to_owned(), reason)),
        }
    }
    let consistent = Consistent::of(planes, &unread, parameters)?;
    let planes = &consistent.planes;
    let values = settled(planes, consistent.line, parameters);
    let fit = report(lens, planes, &values, parameters)?;
    let change = consistent.change(&values);
    let left_out = consistent.left_out.iter();
    Ok(PlaneFit {
        unread,
        left_out: left_out.map(|c| c.told(change.is_some())).collect(),
        change,
        ..fit
    })
}

/// The response with what it leaves of the views that agree.
fn report(
    lens: &Intrinsics,
    planes: &[Plane<'_>],
    values: &Values,
    parameters: &PlaneParameters,
) -> Result<PlaneFit, ResponseError> {
    let bias = by_distance(planes, values);
    let [near, far] = distances(planes);
    let readings = [near, far].map(|z| (z - values[1]) / values[0]);
    let lateral = Lateral::of([values[2], values[3]]);
    let normals = normals(planes, values, lateral, parameters);
    let is_line = spans(planes, parameters.min_span);
    let of_slope = if is_line {
        0.0
    } else {
        doubt_of_slope([near, far])
    };
    let doubt = jackknife::deviation(&normals, readings).max(LEAST_DOUBT);
    let doubt = doubt.hypot(of_slope);
    let line = [values[0], values[1]];
    let patches: Vec<Vec<Patch>> = planes.iter().map(|p| p.patches(lens, line)).collect();
    let placements: Vec<&str> = planes.iter().map(|p| p.placement).collect();
    let misfit = misfit::explain_session(&placements, &patches);
    // What does not fit grows with the squared distance.
    let unfit = misfit.as_ref().map_or(0.0, |m| m.held_out * far.powi(2));
    let response = DepthResponse {
        slope: values[0],
        intercept: values[1],
        scale: [values[2], values[3], 0.0, 0.0, 0.0],
        range: Some([near * (1.0 - BEYOND), far * (1.0 + BEYOND)]),
        uncertainty: bias
            .iter()
            .map(|b| b.bias.abs())
            .fold(doubt.max(unfit), f64::max)
            .min(DepthResponse::MOST_UNCERTAINTY),
    };
    let views = planes
        .iter()
        .map(|plane| view_bias(plane, values))
        .collect();
    let correction = Correction::weigh(lens, &correction_samples(planes, values));
    let response = response.checked()?;
    Ok(PlaneFit {
        response,
        slope_deviation: jackknife::slope_deviation(&normals).filter(|_| is_line),
        bias,
        views,
        unread: Vec::new(),
        left_out: Vec::new(),
        change: None,
        correction,
        misfit,
    })
}

/// What an assumed slope leaves unknown at the far end of the range, in metres: the boards show the depth where they
/// were.
fn doubt_of_slope([near, far]: [f64; 2]) -> f64 {
    FACTORY_SLOPE * (far * (1.0 + BEYOND) - 0.5 * (near + far))
}

/// For each view its samples' pixels with their error over z²: what a disparity is off.
fn correction_samples(planes: &[Plane<'_>], values: &Values) -> Vec<Vec<([f64; 2], f64)>> {
    let of = |plane: &Plane<'_>| {
        let error = |s: &Sample| {
            let z = plane.depth(s, 1.0);
            (s.pixel, plane.error(s, values) / (z * z))
        };
        plane.samples.iter().map(error).collect()
    };
    planes.iter().map(of).collect()
}
