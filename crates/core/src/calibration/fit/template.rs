//! Renders what is printed around a corner as a picture would show it: the ink on a grid finer than the pixels, blurred
//! by a lens and shifted, with the derivatives by blur and shift.

use crate::calibration::{Board, Rectangle};
use nalgebra::{Point2, Vector2};

/// Samples to a pixel's side.
const FINE: usize = 2;
/// Margin around the window, in pixels, for ink that blur carries in; and where the blur's kernel is cut off, in
/// standard deviations.
const REACH: usize = 8;
const DEVIATIONS: f64 = 3.5;

/// The ink around a window of a picture.
pub(super) struct Template {
    /// Pixels along the window's side.
    side: usize,
    /// Samples along the side of the window with what is beyond it.
    samples: usize,
    ink: Vec<f64>,
    /// Where the first sample, the middle and the last one of each row and column lie on the face.
    nodes: [[Point2<f64>; 3]; 3],
}

/// The brightness that is expected of a pixel.
#[derive(Clone, Copy)]
pub(super) struct Pixel {
    /// The part of its light that is taken by ink.
    pub ink: f64,
    /// Derivatives by the shift in pixels, and by the variance of the spread in px².
    pub by_x: f64,
    pub by_y: f64,
    pub by_spread: f64,
}

impl Template {
    /// A window that begins at pixel `first`; `on_face` says where a pixel lies on the board.
    pub(super) fn new(
        first: Point2<f64>,
        side: usize,
        on_face: impl Fn(Point2<f64>) -> Option<Point2<f64>>,
    ) -> Option<Self> {
        let samples = FINE * (side + 2 * REACH);
        let length = (samples - 1) as f64 / FINE as f64;
        let begin = first - Vector2::repeat(REACH as f64 + 0.5 - 0.5 / FINE as f64);
        let mut nodes = [[Point2::origin(); 3]; 3];
        for (j, row) in nodes.iter_mut().enumerate() {
            for (i, node) in row.iter_mut().enumerate() {
                let offset = Vector2::new(i as f64, j as f64) * (0.5 * length);
                *node = on_face(begin + offset)?;
            }
        }
        Some(Self {
            side,
            samples,
            ink: Vec::new(),
            nodes,
        })
    }

    /// The same with the board's ink on it: of each sample the part that is black.
    pub(super) fn painted(mut self, board: &Board, black: &[Vec<Rectangle>]) -> Self {
        let size = self.sample_size();
        let last = (self.samples - 1) as f64;
        let weights: Vec<[f64; 3]> = (0..self.samples)
            .map(|k| quadratic(2.0 * k as f64 / last - 1.0))
            .collect();
        self.ink.reserve(self.samples * self.samples);
        for down in &weights {
            let column = |i: usize| -> Vector2<f64> {
                (0..3).map(|j| self.nodes[j][i].coords * down[j]).sum()
            };
            let columns = [column(0), column(1), column(2)];
            for across in &weights {
                let at: Vector2<f64> = (0..3).map(|i| columns[i] * across[i]).sum();
                self.ink.push(black_part(board, black, at, size));
            }
        }
        self
    }

    /// Sides, on the face, of the rectangle along its axes that is as large as a sample.
    fn sample_size(&self) -> Vector2<f64> {
        let [[_, top, _], [left, _, right], [_, bottom, _]] = self.nodes;
        let steps = (self.samples - 1) as f64;
        let (across, down) = ((right - left) / steps, (bottom - top) / steps);
        across.zip_map(&down, f64::hypot)
    }

    /// The window's pixels row by row, the ink spread to this variance and shifted.
    pub(super) fn spread(&self, shift: Vector2<f64>, variance: f64) -> Vec<Pixel> {
        let (across, down) = (
            self.kernels(shift.x, variance),
            self.kernels(shift.y, variance),
        );
        let mut rows = vec![[0.0; 3]; self.samples * self.side];
        for (ink, row) in self
            .ink
            .chunks(self.samples)
            .zip(rows.chunks_mut(self.side))
        {
            for (sum, kernel) in row.iter_mut().zip(&across) {
                *sum = kernel.taken(|k| [ink[k]; 3]);
            }
        }
        let mut pixels = Vec::with_capacity(self.side * self.side);
        for kernel in &down {
            for x in 0..self.side {
                let row = |k: usize| rows[k * self.side + x];
                let [ink, by_y, twice_y] = kernel.taken(|k| [row(k)[0]; 3]);
                let [_, by_x, twice_x] = kernel.smoothed(row);
                pixels.push(Pixel {
                    ink,
                    by_x: -by_x,
                    by_y: -by_y,
                    by_spread: 0.5 * (twice_x + twice_y),
                });
            }
        }
        pixels
    }

    /// For each pixel along a side the weights of the samples around it.
    fn kernels(&self, shift: f64, variance: f64) -> Vec<Kernel> {
        let reach = DEVIATIONS * variance.sqrt();
        let kernel = |pixel: usize| {
            // In pixels from the first sample.
            let middle = (pixel + REACH) as f64 + 0.5 - 0.5 / FINE as f64 - shift;
            let low = ((middle - reach) * FINE as f64).ceil().max(0.0) as usize;
            let high = ((middle + reach) * FINE as f64).floor().max(0.0) as usize;
            let taps = low..=high.min(self.samples - 1);
            Kernel::new(
                taps.clone().map(|k| middle - k as f64 / FINE as f64),
                variance,
                low,
            )
        };
        (0..self.side).map(kernel).collect()
    }
}

/// A normal distribution over samples, with its first and second derivatives.
struct Kernel {
    first: usize,
    taps: Vec<[f64; 3]>,
}

impl Kernel {
    fn new(distances: impl Iterator<Item = f64>, variance: f64, first: usize) -> Self {
        let values = distances.map(|x| {
            let value = (-0.5 * x * x / variance).exp();
            let (slope, bend) = (
                -x / variance,
                x * x / (variance * variance) - 1.0 / variance,
            );
            [value, value * slope, value * bend]
        });
        let mut taps: Vec<[f64; 3]> = values.collect();
        let sum: f64 = taps.iter().map(|tap| tap[0]).sum();
        taps.iter_mut().flatten().for_each(|v| *v /= sum);
        Self { first, taps }
    }

    /// Sums of values by the distribution and its derivatives, each of its own value.
    #[inline]
    fn taken(&self, values: impl Fn(usize) -> [f64; 3]) -> [f64; 3] {
        let mut sums = [0.0; 3];
        for (k, tap) in self.taps.iter().enumerate() {
            let value = values(self.first + k);
            for (sum, (weight, value)) in sums.iter_mut().zip(tap.iter().zip(value)) {
                *sum += weight * value;
            }
        }
        sums
    }

    /// Sums of values by the distribution itself.
    #[inline]
    fn smoothed(&self, values: impl Fn(usize) -> [f64; 3]) -> [f64; 3] {
        let mut sums = [0.0; 3];
        for (k, tap) in self.taps.iter().enumerate() {
            let value = values(self.first + k);
            for (sum, value) in sums.iter_mut().zip(value) {
                *sum += tap[0] * value;
            }
        }
        sums
    }
}

/// Weights of three nodes at -1, 0 and 1.
fn quadratic(t: f64) -> [f64; 3] {
    [0.5 * t * (t - 1.0), 1.0 - t * t, 0.5 * t * (t + 1.0)]
}

/// The part of a rectangle of this size around a place that is black.
fn black_part(
    board: &Board,
    black: &[Vec<Rectangle>],
    at: Vector2<f64>,
    size: Vector2<f64>,
) -> f64 {
    let (low, high) = (at - 0.5 * size, at + 0.5 * size);
    let columns = board.columns as isize + 1;
    let square = |v: f64, count: isize| {
        let index = (v / board.square).floor() as isize + 1;
        index.clamp(0, count - 1)
    };
    let mut area = 0.0;
    for j in square(low.y, board.rows as isize + 1)..=square(high.y, board.rows as isize + 1) {
        for i in square(low.x, columns)..=square(high.x, columns) {
            for rectangle in &black[(j * columns + i) as usize] {
                let shared = |a: usize| {
                    (high[a].min(rectangle.max[a]) - low[a].max(rectangle.min[a])).max(0.0)
                };
                area += shared(0) * shared(1);
            }
        }
    }
    (area / (size.x * size.y)).min(1.0)
}
