//! Slope, intercept and lateral scale from the samples of all boards at once, by weighted least squares with a robust
//! loss.

use super::jackknife::{BoardEquations, NormalEquations};
use super::lateral::{self, Lateral};
use super::plane_view::PlaneParameters;
use super::samples::{Plane, Sample, Values};
use crate::statistics::upper_median;
use nalgebra::{Matrix4, Vector4};
use rayon::prelude::*;

/// How far beyond the boards the line may be followed, as a part of the distance.
pub(super) const BEYOND: f64 = 0.25;
/// How many times what is expected of it the lateral scale may be off 1 anywhere in the response's range.
const MOST_LATERAL: f64 = 1.5;
/// Weight of a value that stays.
const HELD: f64 = 1e18;
/// Least error that is taken for usual, in units of what is expected.
const LEAST_USUAL: f64 = 0.3;

/// Slope, intercept and scale by weighted least squares with a robust loss, from an offset alone on.
pub(super) fn solve(
    planes: &[Plane<'_>],
    lateral: Lateral,
    parameters: &PlaneParameters,
) -> Values {
    const ROUNDS: usize = 12;
    let mut values = start(planes, parameters);
    let is_line = spans(planes, parameters.min_span);
    for _ in 0..ROUNDS {
        // Tukey's and Huber's idea in one: a pixel counts less the farther off it is, in units of what is usual.
        let usual = usual_error(planes, &values, parameters).max(LEAST_USUAL);
        let mut normal = prior(&values, lateral, parameters, is_line);
        for plane in planes {
            for sample in &plane.samples {
                add(&mut normal, plane, sample, &values, parameters, usual);
            }
        }
        match normal.0.cholesky() {
            Some(solved) => values -= solved.solve(&normal.1),
            None => break,
        }
        for (k, held) in [(2, 1.0), (3, 0.0)] {
            if !lateral.is_free()[k - 2] {
                values[k] = held;
            }
        }
    }
    values
}

/// The values with no more of a lateral scale than boards that are held out bear out, from those with all of it.
pub(super) fn settled(planes: &[Plane<'_>], line: Values, parameters: &PlaneParameters) -> Values {
    let normals = normals(planes, &line, Lateral::Line, parameters);
    let is_line = spans(planes, parameters.min_span);
    let [near, far] = distances(planes);
    let ends = [near * (1.0 - BEYOND), far * (1.0 + BEYOND)];
    let most = MOST_LATERAL * parameters.scale_expected;
    for lateral in lateral::in_order_of_merit(&normals, |lateral| {
        prior(&line, lateral, parameters, is_line)
    }) {
        let values = match lateral {
            Lateral::Line => line,
            less => solve(planes, less, parameters),
        };
        let off = |z: f64| (values[2] + values[3] * z - 1.0).abs();
        if ends.iter().all(|&z| off(z) <= most) {
            return values;
        }
    }
    solve(planes, Lateral::One, parameters)
}

/// What each board says of the values that were found, and all of them together with what is expected.
pub(super) fn normals(
    planes: &[Plane<'_>],
    values: &Values,
    lateral: Lateral,
    parameters: &PlaneParameters,
) -> BoardEquations {
    let usual = usual_error(planes, values, parameters).max(LEAST_USUAL);
    let of_plane = |plane: &Plane<'_>| {
        let (mut normal, mut squares) = ((Matrix4::zeros(), Vector4::zeros()), 0.0);
        for sample in &plane.samples {
            squares += add(&mut normal, plane, sample, values, parameters, usual);
        }
        (normal, squares)
    };
    let of_planes: Vec<_> = planes.par_iter().map(of_plane).collect();
    let (of_boards, squares): (Vec<NormalEquations>, Vec<f64>) = of_planes.into_iter().unzip();
    let is_line = spans(planes, parameters.min_span);
    let expected = prior(values, lateral, parameters, is_line);
    let all = of_boards
        .iter()
        .fold(expected, |all, own| (all.0 + own.0, all.1 + own.1));
    BoardEquations {
        all,
        of_boards,
        squares,
    }
}

/// Millimetres, with the offset that is right for half of the views.
fn start(planes: &[Plane<'_>], parameters: &PlaneParameters) -> Values {
    let mut ratios: Vec<f64> = Vec::new();
    for plane in planes {
        ratios.extend(
            plane
                .samples
                .iter()
                .map(|s| plane.depth(s, 1.0) / s.reading),
        );
    }
    let usual = upper_median(&mut ratios).filter(|_| spans(planes, parameters.min_span));
    let slope = usual.unwrap_or(0.001);
    Values::new(slope, 0.0, 1.0, 0.0)
}

/// Whether the boards' distances differ enough to say what the slope is.
pub(super) fn spans(planes: &[Plane<'_>], min_span: f64) -> bool {
    let [near, far] = distances(planes);
    far > min_span * near
}

/// Mean distance of the nearest and the farthest view.
pub(super) fn distances(planes: &[Plane<'_>]) -> [f64; 2] {
    let means = planes.iter().map(Plane::distance);
    means.fold([f64::INFINITY, 0.0], |[near, far], z| {
        [near.min(z), far.max(z)]
    })
}

/// What is expected before any reading, as normal equations about `values`. With boards at one distance the slope
/// stays.
fn prior(
    values: &Values,
    lateral: Lateral,
    parameters: &PlaneParameters,
    is_line: bool,
) -> (Matrix4<f64>, Vector4<f64>) {
    let expected = Values::new(values[0], values[1], 1.0, 0.0);
    let slope = if is_line { 0.0 } else { 1e-18_f64.recip() };
    let scale = parameters.scale_expected.max(1e-6).powi(-2);
    let [constant, change] = lateral
        .is_free()
        .map(|free| if free { scale } else { HELD });
    let weights = Vector4::new(slope, 0.0, constant, change);
    let gradient = weights.component_mul(&(values - expected));
    (Matrix4::from_diagonal(&weights), gradient)
}

/// Adds a sample's equation; gives its weighted squared error.
fn add(
    normal: &mut (Matrix4<f64>, Vector4<f64>),
    plane: &Plane<'_>,
    sample: &Sample,
    values: &Values,
    parameters: &PlaneParameters,
    usual: f64,
) -> f64 {
    let z = values[0] * sample.reading + values[1];
    let scale = values[2] + values[3] * z;
    let across = plane.across(sample);
    let along = plane.normal.z + scale * across;
    // Distance from the plane, and by z: the lateral scale changes with it too.
    let error = z * along - plane.offset;
    let by_z = along + z * values[3] * across;
    let derivative = Vector4::new(by_z * sample.reading, by_z, z * across, z * z * across);
    let deviation = parameters.noise_at_1m * z * z * along.abs();
    let off = (error / deviation / usual).abs();
    let robust = if off <= 2.0 { 1.0 } else { (2.0 / off).powi(2) };
    let weight = robust / (deviation * deviation * parameters.correlated_pixels.max(1.0));
    normal.0 += derivative * derivative.transpose() * weight;
    normal.1 += derivative * (error * weight);
    error * error * weight
}

/// Median error of all samples in units of what is expected, times 1.4826: 1 where the noise is as expected.
fn usual_error(planes: &[Plane<'_>], values: &Values, parameters: &PlaneParameters) -> f64 {
    let mut errors: Vec<f64> = Vec::new();
    for plane in planes {
        errors.extend(plane.samples.iter().map(|s| {
            let z = values[0] * s.reading + values[1];
            (plane.error(s, values) / (parameters.noise_at_1m * z * z)).abs()
        }));
    }
    1.4826 * upper_median(&mut errors).unwrap_or(0.0)
}
