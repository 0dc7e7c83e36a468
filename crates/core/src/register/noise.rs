//! Measures how much contours contradict the other contours of the same capture, or those of all other captures, and
//! finds the longest stretch of a contour that does.

use super::align::disagreement;
use super::body::Body;
use super::touch::{Target, touch};
use rayon::prelude::*;

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
    let miss = |i: usize| -touches[i].inside / own.pixel;
    let mut worst: Option<ContourStretch> = None;
    let mut start = 0;
    while start < own.rays.len() {
        let same = |i: usize| {
            let (a, b) = (&own.rays[i], &own.rays[start]);
            a.view == b.view && a.chain == b.chain
        };
        let mut end = start;
        while end < own.rays.len() && same(end) {
            end += 1;
        }
        let is_closed = own.outlines[own.rays[start].view].is_closed[own.rays[start].chain];
        let misses: Vec<f64> = (start..end).map(miss).collect();
        if let Some((count, miss_px)) = longest_run(&misses, is_closed) {
            let length_px = count as f64 * own.rays[start].length_px;
            let found = ContourStretch {
                camera: own.cameras[own.rays[start].view],
                length_px,
                miss_px,
            };
            if worst.as_ref().is_none_or(|w| w.weight() < found.weight()) {
                worst = Some(found);
            }
        }
        start = end;
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

/// The run of misses with the largest sum, and its mean.
fn longest_run(misses: &[f64], is_closed: bool) -> Option<(usize, f64)> {
    let count = misses.len();
    let rounds = if is_closed { 2 * count } else { count };
    let mut best: Option<(usize, f64)> = None;
    let (mut length, mut gap, mut sum) = (0, 0, 0.0);
    for i in 0..rounds {
        let miss = misses[i % count];
        if miss > MISS_PX {
            length += gap + 1;
            gap = 0;
            sum += miss;
        } else if length > 0 {
            gap += 1;
            if gap > LARGEST_GAP {
                (length, gap, sum) = (0, 0, 0.0);
            }
        }
        let length = length.min(count);
        if length > 0 && best.is_none_or(|(l, mean)| l as f64 * mean < sum) && i < count + length {
            best = Some((length, sum / length as f64));
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_goes_on_across_the_begin_of_a_closed_contour_and_across_small_gaps() {
        let misses = [2.0, 2.0, 0.0, 0.0, 0.0, 0.0, 2.0, 0.0, 2.5];
        assert_eq!(longest_run(&misses, false).unwrap().0, 3);
        assert_eq!(longest_run(&misses, true).unwrap().0, 5);
        assert_eq!(longest_run(&[0.5, 1.2], true), None);
    }
}
