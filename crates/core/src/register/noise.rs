//! Measures how much contours contradict the other contours of the same capture, or those of all other captures, and
//! finds the longest stretch of a contour that does.

use super::align::disagreement;
use super::body::{Body, Ray};
use super::touch::{Target, touch};
use rayon::prelude::*;
use std::ops::Range;

/// A ray that misses by more than this many pixels disagrees.
const MISS_PX: f64 = 1.25;
/// Rays of a stretch that may agree between two that do not.
const LARGEST_GAP: usize = 2;

/// How far contours contradict a set of cones and tables.
#[derive(Clone, Debug, PartialEq)]
pub struct Disagreement {
    /// Root of the mean square by which the rays miss, in metres.
    pub rms: f64,
    /// The longest stretch of contour that misses, if one does.
    pub stretch: Option<ContourStretch>,
}

/// A stretch of a contour whose rays miss.
#[derive(Clone, Debug, PartialEq)]
pub struct ContourStretch {
    /// The number of its camera in its capture.
    pub camera: usize,
    /// Its length in pixels.
    pub length_px: f64,
    /// By how many pixels its rays miss, the mean.
    pub miss_px: f64,
}

impl ContourStretch {
    /// Its length by its depth, in square pixels.
    pub(super) fn weight(&self) -> f64 {
        self.length_px * self.miss_px
    }
}

/// All rays of a body against targets.
pub(super) fn of_rays(own: &Body, targets: &[Target]) -> Disagreement {
    let touches: Vec<_> = own
        .rays
        .par_iter()
        .map(|ray| touch(own, ray, targets, None))
        .collect();
    let misses: Vec<f64> = touches.iter().map(|t| -t.inside / own.pixel).collect();
    let mut worst: Option<ContourStretch> = None;
    for chain in chains(own) {
        let first = &own.rays[chain.start];
        let is_closed = own.outlines[first.view].is_closed[first.chain];
        if let Some(run) = heaviest_run(&misses[chain], is_closed) {
            let found = ContourStretch {
                camera: own.cameras[first.view],
                length_px: run.length as f64 * first.length_px,
                miss_px: run.sum / run.length as f64,
            };
            if worst.as_ref().is_none_or(|w| w.weight() < found.weight()) {
                worst = Some(found);
            }
        }
    }
    Disagreement {
        rms: disagreement(&touches, own.pixel),
        stretch: worst,
    }
}

/// What a capture's contours say against each other.
pub(super) fn of_capture(body: &Body) -> Disagreement {
    let itself = [Target {
        body,
        body_from_ray: nalgebra::Isometry3::identity(),
        is_self: true,
    }];
    of_rays(body, &itself)
}

/// The rays of each chain of a body's contours.
pub(super) fn chains(own: &Body) -> Vec<Range<usize>> {
    let is_same = |a: &Ray, b: &Ray| a.view == b.view && a.chain == b.chain;
    let mut begin = 0;
    let chain = |rays: &[Ray]| {
        let range = begin..begin + rays.len();
        begin = range.end;
        range
    };
    own.rays.chunk_by(is_same).map(chain).collect()
}

/// A run of rays that miss, with small gaps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Run {
    /// The number of its first ray in the chain.
    pub(super) first: usize,
    /// How many rays long it is, with its gaps.
    pub(super) length: usize,
    /// The sum of what its rays miss by.
    pub(super) sum: f64,
}

/// The runs of a chain's rays that miss by more than `least`. In a closed chain, one may go on across its begin.
pub(super) fn runs(misses: &[f64], is_closed: bool, least: f64) -> Vec<Run> {
    let mut runs: Vec<Run> = Vec::new();
    for (i, &miss) in misses.iter().enumerate().filter(|(_, miss)| **miss > least) {
        match runs.last_mut() {
            Some(run) if i <= run.first + run.length + LARGEST_GAP => {
                run.length = i + 1 - run.first;
                run.sum += miss;
            }
            _ => runs.push(Run {
                first: i,
                length: 1,
                sum: miss,
            }),
        }
    }
    if is_closed
        && let [first, .., last] = runs[..]
        && first.first + misses.len() <= last.first + last.length + LARGEST_GAP
    {
        runs.pop();
        runs[0] = Run {
            first: last.first,
            length: first.first + misses.len() - last.first + first.length,
            sum: last.sum + first.sum,
        };
    }
    runs
}

/// The run with the largest sum.
fn heaviest_run(misses: &[f64], is_closed: bool) -> Option<Run> {
    let runs = runs(misses, is_closed, MISS_PX).into_iter();
    runs.max_by(|a, b| a.sum.total_cmp(&b.sum))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_goes_on_across_the_begin_of_a_closed_contour_and_across_small_gaps() {
        let misses = [2.0, 2.0, 0.0, 0.0, 0.0, 0.0, 2.0, 0.0, 2.5];
        let run = |first, length, sum| Run { first, length, sum };
        let open = [run(0, 2, 4.0), run(6, 3, 4.5)];
        assert_eq!(runs(&misses, false, MISS_PX), open);
        assert_eq!(runs(&misses, true, MISS_PX), [run(6, 5, 8.5)]);
        assert_eq!(heaviest_run(&misses, false), Some(open[1]));
        assert_eq!(heaviest_run(&[0.5, 1.2], true), None);
        assert_eq!(runs(&[2.0; 4], true, MISS_PX), [run(0, 4, 8.0)]);
    }
}
