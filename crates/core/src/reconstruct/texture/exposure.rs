//! Evens out exposures: finds one gain for each camera and channel, so that two cameras agree on a vertex that both
//! see. Gains act on the encoded values: by a power law, a factor of the light is a factor of these values too.

use super::Surface;
use super::view::View;
use super::visibility::Visibility;
use crate::statistics::upper_median;
use nalgebra::{DMatrix, DVector, Vector3};
use rayon::prelude::*;

/// A factor for each channel.
pub(super) type Gain = Vector3<f32>;

/// Vertices that a pair of cameras is compared at, at most.
const MOST_SAMPLES: usize = 2_000;
/// A pair with fewer common vertices says nothing.
const FEWEST_SAMPLES: usize = 30;
/// Channel values outside tell little of the exposure: noise below, clipping above.
const USABLE: std::ops::RangeInclusive<f32> = 12.0..=245.0;
/// Weight, in samples, of the assumption that a gain is 1: decides where nothing else does.
const PRIOR: f64 = 1.0;
/// The same, in samples, of the assumption that a camera has the gain of its capture, where there are several: the
/// light that differs between captures is the same for all cameras of one.
const PRIOR_OF_CAPTURE: f64 = 500.0;
/// Gains outside are not exposure; they are held at the limit.
const LIMITS: [f32; 2] = [0.5, 2.0];

/// How two cameras' colours differ.
struct Pair {
    views: [usize; 2],
    /// Median of the logarithm of the first's value over the second's, a channel each.
    log_ratio: [f64; 3],
    weight: f64,
}

/// A gain for each view and channel, their mean over the colour cameras 1.
pub(super) fn even_out(surface: &Surface) -> Vec<Gain> {
    let count = surface.views.len();
    let indices: Vec<[usize; 2]> = (0..count)
        .flat_map(|a| (a + 1..count).map(move |b| [a, b]))
        .collect();
    let pairs: Vec<Pair> = indices
        .par_iter()
        .filter_map(|&views| compare(surface, views))
        .collect();
    let channels = [0, 1, 2].map(|channel| of_channel(&surface.views, &pairs, channel));
    (0..count)
        .map(|view| Vector3::from_fn(|channel, _| channels[channel][view]))
        .collect()
}

fn compare(surface: &Surface, views: [usize; 2]) -> Option<Pair> {
    let [a, b] = views.map(|v| &surface.views[v]);
    let [sights_a, sights_b] = views.map(|v| &surface.sights[v]);
    let common: Vec<usize> = (0..surface.mesh.vertices.len())
        .filter(|&v| sights_a[v] == Visibility::Safe && sights_b[v] == Visibility::Safe)
        .collect();
    let step = common.len().div_ceil(MOST_SAMPLES).max(1);
    let mut ratios = [const { Vec::new() }; 3];
    for &v in common.iter().step_by(step) {
        let (p, q) = (mean_at(a, v), mean_at(b, v));
        for (channel, ratios) in ratios.iter_mut().enumerate() {
            if USABLE.contains(&p[channel]) && USABLE.contains(&q[channel]) {
                ratios.push((p[channel] / q[channel]).ln());
            }
        }
    }
    let fewest = ratios.iter().map(Vec::len).min().unwrap_or(0);
    (fewest >= FEWEST_SAMPLES).then(|| Pair {
        views,
        log_ratio: ratios.map(|mut r| f64::from(upper_median(&mut r).unwrap_or(0.0))),
        weight: fewest as f64,
    })
}

fn mean_at(view: &View, vertex: usize) -> Vector3<f32> {
    let [x, y, _] = view.projected[vertex];
    view.mean_color(x, y)
}

/// The gain of each view in a channel: first one a capture, then one a camera that differs from it as little as it may.
fn of_channel(views: &[View], pairs: &[Pair], channel: usize) -> Vec<f32> {
    let mut captures: Vec<u16> = views.iter().map(|view| view.capture).collect();
    captures.sort_unstable();
    captures.dedup();
    let none = vec![0.0; views.len()];
    if captures.len() < 2 {
        return normalised(views, solve(&none, PRIOR, &equations(pairs, channel)));
    }
    let capture = |view: usize| captures.partition_point(|&c| c < views[view].capture);
    let between = equations(pairs, channel).into_iter();
    let between = between.map(|e| Equation {
        unknowns: e.unknowns.map(capture),
        ..e
    });
    let between: Vec<Equation> = between.filter(|e| e.unknowns[0] != e.unknowns[1]).collect();
    let of_captures = solve(&vec![0.0; captures.len()], PRIOR, &between);
    let expected: Vec<f64> = (0..views.len()).map(|v| of_captures[capture(v)]).collect();
    normalised(
        views,
        solve(&expected, PRIOR_OF_CAPTURE, &equations(pairs, channel)),
    )
}

/// The logarithm of one unknown gain over another.
struct Equation {
    unknowns: [usize; 2],
    log_ratio: f64,
    weight: f64,
}

fn equations(pairs: &[Pair], channel: usize) -> Vec<Equation> {
    let equation = |pair: &Pair| Equation {
        unknowns: pair.views,
        log_ratio: -pair.log_ratio[channel],
        weight: pair.weight,
    };
    pairs.iter().map(equation).collect()
}

/// Least squares over the logarithms of gains, each expected with a weight.
fn solve(expected: &[f64], prior: f64, equations: &[Equation]) -> Vec<f64> {
    let count = expected.len();
    let mut normal = DMatrix::<f64>::identity(count, count) * prior;
    let mut right = DVector::from_iterator(count, expected.iter().map(|e| e * prior));
    for equation in equations {
        let [a, b] = equation.unknowns;
        let (weight, ratio) = (equation.weight, equation.log_ratio);
        normal[(a, a)] += weight;
        normal[(b, b)] += weight;
        normal[(a, b)] -= weight;
        normal[(b, a)] -= weight;
        right[a] += weight * ratio;
        right[b] -= weight * ratio;
    }
    match normal.cholesky() {
        Some(cholesky) => cholesky.solve(&right).iter().copied().collect(),
        None => vec![0.0; count],
    }
}

/// Gains of their logarithms, their mean over the colour cameras 1.
fn normalised(views: &[View], logs: Vec<f64>) -> Vec<f32> {
    let colors = views.iter().filter(|v| !v.is_depth).count();
    let anchors = if colors > 0 { colors } else { views.len() };
    let mean = logs.iter().take(anchors).map(|l| l.exp()).sum::<f64>() / anchors.max(1) as f64;
    logs.iter()
        .map(|l| ((l.exp() / mean) as f32).clamp(LIMITS[0], LIMITS[1]))
        .collect()
}

/// For each view the evened out colour of each vertex that it sees; 0 for the others.
pub(super) fn samples(surface: &Surface, gains: &[Gain]) -> Vec<Vec<Vector3<f32>>> {
    let views = surface.views.par_iter().zip(&surface.sights).zip(gains);
    let of_view = |((view, sights), gain): ((&View, &Vec<Visibility>), &Gain)| {
        let sample = |(v, sight): (usize, &Visibility)| match sight {
            Visibility::Hidden => Vector3::zeros(),
            _ => mean_at(view, v).component_mul(gain),
        };
        sights.par_iter().enumerate().map(sample).collect()
    };
    views.map(of_view).collect()
}
