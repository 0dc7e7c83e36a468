//! What readings are off by after a fit, by view and by distance.

use super::samples::{Plane, Sample, Values};
use std::collections::{BTreeMap, BTreeSet};

/// Metres of a step of [`DistanceBias`], and pixels that make one.
const STEP: f64 = 0.1;
const FEWEST_IN_STEP: usize = 200;

/// Readings at one distance, against the boards' planes.
#[derive(serde::Serialize, Clone, Copy, Debug, PartialEq)]
pub struct DistanceBias {
    /// Middle of the step, in metres.
    pub distance: f64,
    /// Views and pixels in it.
    pub views: usize,
    /// Pixels in it.
    pub pixels: usize,
    /// Mean of measured less true depth after the fit, in metres.
    pub bias: f64,
    /// The same before it, with readings taken for millimetres.
    pub bias_before: f64,
    /// Standard deviation of a pixel after the fit, in metres.
    pub spread: f64,
}

/// One view against its plane.
#[derive(serde::Serialize, Clone, Debug, PartialEq)]
pub struct ViewBias {
    /// The placement's name.
    pub placement: String,
    /// Mean distance in metres.
    pub distance: f64,
    /// Mean angle between rays and the normal, in degrees.
    pub tilt_degrees: f64,
    /// Pixels on the board.
    pub pixels: usize,
    /// Mean of measured less true depth after the fit, in metres.
    pub bias: f64,
}

pub(super) fn view_bias(plane: &Plane<'_>, values: &Values) -> ViewBias {
    let count = plane.samples.len() as f64;
    let mean = |of: &dyn Fn(&Sample) -> f64| plane.samples.iter().map(of).sum::<f64>() / count;
    ViewBias {
        placement: plane.placement.to_owned(),
        distance: mean(&|s| plane.depth(s, 1.0)),
        tilt_degrees: plane.tilt_degrees,
        pixels: plane.samples.len(),
        bias: mean(&|s| plane.error(s, values)),
    }
}

pub(super) fn by_distance(planes: &[Plane<'_>], values: &Values) -> Vec<DistanceBias> {
    let mut steps: BTreeMap<usize, (usize, Vec<[f64; 2]>)> = Default::default();
    let millimetres = Values::new(0.001, 0.0, 1.0, 0.0);
    for plane in planes {
        let mut touched = BTreeSet::new();
        for sample in &plane.samples {
            let step = (plane.depth(sample, 1.0) / STEP).max(0.0) as usize;
            let entry = steps.entry(step).or_default();
            entry.0 += usize::from(touched.insert(step));
            entry.1.push([
                plane.error(sample, values),
                plane.error(sample, &millimetres),
            ]);
        }
    }
    let large = steps
        .into_iter()
        .filter(|(_, (_, errors))| errors.len() >= FEWEST_IN_STEP);
    large
        .map(|(step, (views, errors))| {
            let count = errors.len() as f64;
            let mean = |a: usize| errors.iter().map(|e| e[a]).sum::<f64>() / count;
            let (bias, bias_before) = (mean(0), mean(1));
            let variance = errors.iter().map(|e| (e[0] - bias).powi(2)).sum::<f64>() / count;
            DistanceBias {
                distance: (step as f64 + 0.5) * STEP,
                views,
                pixels: errors.len(),
                bias,
                bias_before,
                spread: variance.sqrt(),
            }
        })
        .collect()
}
