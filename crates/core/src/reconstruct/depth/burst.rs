//! A burst, cut to the window that the object can cover and linearised, and its statistics over the frames
//! (equations 1 and 2). `fill` decides what holes are filled with.

use super::{Facts, Parameters, Spread};
use crate::image::{Grid, Mask};
use crate::reconstruct::DepthView;
use crate::statistics::upper_median;
use rayon::prelude::*;

/// The frames' depth in a window: the bounding rectangle of the region.
pub(super) struct Burst {
    /// Column of the window's first pixel.
    pub left: usize,
    /// Row of the window's first pixel.
    pub top: usize,
    /// Width of the window in pixels.
    pub width: usize,
    /// Height of the window in pixels.
    pub height: usize,
    /// Pixels of the window that the object can cover.
    pub inside: Grid<bool>,
    /// Depth in metres of each frame, 0 where there is no reading or the object cannot be.
    pub frames: Vec<Grid<f32>>,
}

/// What the frames say together.
pub struct Fused {
    /// Equation 1: the mean over the frames, 0 where there is none or a pixel was left out.
    pub depth: Grid<f32>,
    /// Standard deviation over the frames, in metres; 0 where there are fewer than two readings.
    pub deviation: Grid<f32>,
    /// Number of readings.
    pub count: Grid<u16>,
    /// Counts of pixels by why they were left out.
    pub facts: Facts,
}

impl Burst {
    /// Cuts and linearises.
    pub(super) fn new(view: &DepthView, region: &Mask) -> Self {
        let (left, top, width, height) = bounds(region);
        let inside = Grid::from_fn(width, height, |x, y| region[(x + left, y + top)] >= 128);
        let linearise = |readings: &Grid<u16>| {
            Grid::from_fn(width, height, |x, y| {
                let reading = readings[(x + left, y + top)];
                let depth = view.camera.response.depth(reading);
                depth.filter(|_| inside[(x, y)]).unwrap_or(0.0) as f32
            })
        };
        let frames = view
            .frames
            .par_iter()
            .map(|frame| linearise(&frame.readings))
            .collect();
        Self {
            left,
            top,
            width,
            height,
            inside,
            frames,
        }
    }

    /// Equations 1 and 2 over the frames as they are.
    pub(super) fn fuse(&self, parameters: &Parameters) -> Fused {
        let mut fused = Fused {
            depth: Grid::filled(self.width, self.height, 0.0),
            deviation: Grid::filled(self.width, self.height, 0.0),
            count: Grid::filled(self.width, self.height, 0),
            facts: Facts::default(),
        };
        let width = self.width.max(1);
        let (depth, deviation) = (fused.depth.pixels_mut(), fused.deviation.pixels_mut());
        let rows = depth
            .par_chunks_mut(width)
            .zip(deviation.par_chunks_mut(width))
            .zip(fused.count.pixels_mut().par_chunks_mut(width));
        fused.facts = rows
            .enumerate()
            .map(|(y, ((depth, deviation), count))| {
                self.fuse_row(y, [depth, deviation], count, parameters)
            })
            .reduce(Facts::default, |a, b| Facts {
                region: a.region + b.region,
                without_reading: a.without_reading + b.without_reading,
                spread_too_much: a.spread_too_much + b.spread_too_much,
                read_too_rarely: a.read_too_rarely + b.read_too_rarely,
                ..a
            });
        fused
    }

    /// One row of [`Self::fuse`].
    fn fuse_row(
        &self,
        y: usize,
        [depth, deviation]: [&mut [f32]; 2],
        count: &mut [u16],
        parameters: &Parameters,
    ) -> Facts {
        let mut facts = Facts::default();
        let mut sorted = Vec::with_capacity(self.frames.len());
        let least = (parameters.least_share * self.frames.len() as f32).max(1.0);
        for x in (0..self.width).filter(|&x| self.inside[(x, y)]) {
            let i = y * self.width + x;
            facts.region += 1;
            let mut readings = Readings::at(&self.frames, i, |_| true);
            if readings.count == 0 {
                facts.without_reading += 1;
                continue;
            }
            if parameters.spread == Spread::Majority {
                let middle = median_at(&self.frames, i, &mut sorted);
                let near = parameters.majority_mm * 1e-3;
                readings = Readings::at(&self.frames, i, |z| (z - middle).abs() <= near);
            }
            count[x] = readings.count as u16;
            if readings.spread() * 1e3 > parameters.spread_limit_mm {
                facts.spread_too_much += 1;
            } else if (readings.count as f32) < least {
                facts.read_too_rarely += 1;
            } else {
                depth[x] = readings.mean();
                deviation[x] = readings.deviation();
            }
        }
        facts
    }
}

/// Equations 1 and 2 over filtered frames: the mean per pixel of the valid depths, 0 where there is none
/// or they spread by more than `limit` metres.
pub(super) fn mean_of_filtered(frames: &[Grid<f32>], limit: f32) -> Grid<f32> {
    let Some(first) = frames.first() else {
        return Grid::default();
    };
    let mut out = first.map(|_| 0.0);
    for (i, out) in out.pixels_mut().iter_mut().enumerate() {
        let readings = Readings::at(frames, i, |_| true);
        if readings.count > 0 && readings.spread() <= limit {
            *out = readings.mean();
        }
    }
    out
}

/// Sums over the readings of one pixel; the first reading is the origin, so that f32 loses nothing.
#[derive(Default)]
struct Readings {
    count: usize,
    first: f32,
    sum: f32,
    sum_of_squares: f32,
    least: f32,
    most: f32,
}

impl Readings {
    fn at(frames: &[Grid<f32>], pixel: usize, counts: impl Fn(f32) -> bool) -> Self {
        let mut r = Self::default();
        for z in frames.iter().map(|frame| frame.pixels()[pixel]) {
            if z <= 0.0 || !counts(z) {
                continue;
            }
            if r.count == 0 {
                (r.first, r.least, r.most) = (z, z, z);
            }
            let d = z - r.first;
            r.count += 1;
            r.sum += d;
            r.sum_of_squares += d * d;
            r.least = r.least.min(z);
            r.most = r.most.max(z);
        }
        r
    }

    fn spread(&self) -> f32 {
        self.most - self.least
    }

    fn mean(&self) -> f32 {
        self.first + self.sum / self.count as f32
    }

    fn deviation(&self) -> f32 {
        if self.count < 2 {
            return 0.0;
        }
        let n = self.count as f32;
        ((self.sum_of_squares - self.sum * self.sum / n).max(0.0) / (n - 1.0)).sqrt()
    }
}

/// Median of one pixel's readings; 0 if there are none. `sorted` is working memory.
fn median_at(frames: &[Grid<f32>], pixel: usize, sorted: &mut Vec<f32>) -> f32 {
    sorted.clear();
    let readings = frames.iter().map(|frame| frame.pixels()[pixel]);
    sorted.extend(readings.filter(|&z| z > 0.0));
    upper_median(sorted).unwrap_or(0.0)
}

/// Left, top, width and height of the pixels that are 128 and up; all 0 where there are none.
fn bounds(region: &Mask) -> (usize, usize, usize, usize) {
    let (mut left, mut right, mut top, mut bottom) = (usize::MAX, 0, usize::MAX, 0);
    for y in 0..region.height() {
        let row = region.row(y);
        let Some(first) = row.iter().position(|&m| m >= 128) else {
            continue;
        };
        let last = row.iter().rposition(|&m| m >= 128).unwrap_or(first);
        (left, right) = (left.min(first), right.max(last + 1));
        (top, bottom) = (top.min(y), y + 1);
    }
    if left == usize::MAX {
        return (0, 0, 0, 0);
    }
    (left, top, right - left, bottom - top)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn burst(frames: &[&[f32]]) -> Burst {
        let width = frames[0].len();
        Burst {
            left: 0,
            top: 0,
            width,
            height: 1,
            inside: Grid::filled(width, 1, true),
            frames: frames
                .iter()
                .map(|f| Grid::from_pixels(width, 1, f.to_vec()))
                .collect(),
        }
    }

    #[test]
    fn equation_1_is_the_mean_of_the_valid_depths() {
        let frames = [
            [0.801, 0.0, 0.0].as_slice(),
            &[0.803, 0.9, 0.0],
            &[0.802, 0.904, 0.0],
        ];
        let mean = mean_of_filtered(&burst(&frames).frames, 0.03);
        for (found, expected) in mean.pixels().iter().zip([0.802, 0.902, 0.0]) {
            assert!((found - expected).abs() < 1e-6, "{found} {expected}");
        }
        for spread in [Spread::Majority, Spread::LeaveOut] {
            let parameters = Parameters {
                spread,
                ..Parameters::default()
            };
            assert_eq!(burst(&frames).fuse(&parameters).depth, mean);
        }
    }

    #[test]
    fn equation_2_leaves_out_a_spread_of_more_than_30_mm_of_valid_readings() {
        let frames = [
            [0.800, 0.800, 0.0].as_slice(),
            &[0.829, 0.831, 0.8],
            &[0.815, 0.815, 0.8],
        ];
        let paper = Parameters {
            spread: Spread::LeaveOut,
            ..Parameters::default()
        };
        let fused = burst(&frames).fuse(&paper);
        let kept: Vec<bool> = fused.depth.pixels().iter().map(|&z| z > 0.0).collect();
        assert_eq!(kept, [true, false, true], "a missing reading is no spread");
        assert_eq!(fused.facts.spread_too_much, 1);
        let filtered = mean_of_filtered(&burst(&frames).frames, 0.03);
        assert_eq!(filtered.pixels()[1], 0.0);
    }

    #[test]
    fn a_rim_stays_where_most_frames_see_it() {
        let near_mostly = [[0.80].as_slice(), &[0.801], &[0.90], &[0.799]];
        let fused = burst(&near_mostly).fuse(&Parameters::default());
        assert!((fused.depth.pixels()[0] - 0.80).abs() < 1e-6);
        assert_eq!(fused.count.pixels()[0], 3);
    }

    #[test]
    fn what_few_frames_read_is_left_out() {
        let frames: Vec<&[f32]> = vec![&[0.8], &[0.0], &[0.0], &[0.0], &[0.0]];
        let fused = burst(&frames).fuse(&Parameters::default());
        assert_eq!(fused.depth.pixels()[0], 0.0);
        assert_eq!(fused.facts.read_too_rarely, 1);
    }

    #[test]
    fn bounds_are_the_regions() {
        let mut region = Grid::filled(9, 7, 0);
        assert_eq!(bounds(&region), (0, 0, 0, 0));
        region[(3, 2)] = 255;
        region[(5, 4)] = 128;
        region[(8, 6)] = 127;
        assert_eq!(bounds(&region), (3, 2, 3, 3));
    }
}
