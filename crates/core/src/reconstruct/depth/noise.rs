//! How far a reading of this sensor may be off, as a function of depth and slope. It is measured on the burst
//! itself, where the surface is smooth.

use super::burst::Fused;
use crate::image::Grid;
use crate::statistics::upper_median;

/// The sensor's noise in one frame: σ(z, slope)² = (coefficient·z²)² + (jitter·slope)², and separately the part that is
/// the same in every frame.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct SensorNoise {
    /// Standard deviation of one reading per squared depth, in 1/m: disparity noise grows with z².
    pub per_square_depth: f32,
    /// Standard deviation of one reading per slope (metres of depth a pixel), in pixels.
    pub jitter_px: f32,
    /// Deviation per squared depth that is the same in every frame, in 1/m. The burst cannot show it.
    pub fixed_per_square_depth: f32,
    /// Median over the measured pixels of the deviation over frames, in metres.
    pub median_deviation: f32,
}

/// Least noise per squared depth, in 1/m: a tenth of the step of a sensor with a disparity resolution of
/// 1/8 pixel (2.9 mm at 1 m).
const LEAST_PER_SQUARE_DEPTH: f32 = 2.9e-4;

/// Noise per squared depth, in 1/m, of a single frame, which cannot show its own: what Kinect v1 sensors have
/// (0.8 to 1.0 mm at 0.9 m, 1.7 to 2.2 mm at 1.3 m).
const TYPICAL_PER_SQUARE_DEPTH: f32 = 1.2e-3;

impl SensorNoise {
    /// Measures the noise of a burst.
    pub fn measure(fused: &Fused) -> Self {
        let mut deviations = Vec::new();
        let mut scaled = Vec::new();
        for (&z, &deviation) in fused.depth.pixels().iter().zip(fused.deviation.pixels()) {
            if z > 0.0 && deviation > 0.0 {
                deviations.push(deviation);
                scaled.push(deviation / (z * z));
            }
        }
        let per_square_depth = if scaled.is_empty() {
            TYPICAL_PER_SQUARE_DEPTH
        } else {
            upper_median(&mut scaled)
                .unwrap_or(0.0)
                .max(LEAST_PER_SQUARE_DEPTH)
        };
        Self {
            per_square_depth,
            jitter_px: 0.1,
            fixed_per_square_depth: 1.4e-3,
            median_deviation: upper_median(&mut deviations).unwrap_or(0.0),
        }
    }

    /// Standard error of the mean of `frames` readings in inverse depth (1/m), where the surface faces the
    /// camera.
    pub fn inverse_depth_error(&self, frames: usize) -> f32 {
        let mean = self.per_square_depth / (frames.max(1) as f32).sqrt();
        mean.hypot(self.fixed_per_square_depth)
    }

    /// Standard deviation in metres of one reading over the frames at depth `z` (metres) where the surface
    /// slopes by `slope` (metres of depth a pixel).
    pub fn frame_error(&self, z: f32, slope: f32) -> f32 {
        (self.per_square_depth * z * z).hypot(self.jitter_px * slope)
    }

    /// Standard error in metres of the mean of `frames` readings at depth `z` (metres) where the surface
    /// slopes by `slope` (metres of depth a pixel).
    pub fn standard_error(&self, z: f32, slope: f32, frames: usize) -> f32 {
        let mean = self.frame_error(z, slope) / (frames.max(1) as f32).sqrt();
        mean.hypot(self.fixed_per_square_depth * z * z)
    }
}

/// Steepness of the depth at a pixel, in metres a pixel: the larger of the differences across it in x and
/// in y, to the neighbours that have depth.
pub(super) fn slope(depth: &Grid<f32>, x: usize, y: usize) -> f32 {
    let here = depth[(x, y)];
    let across = |dx: isize, dy: isize| {
        let at = |s: isize| {
            let z = depth.get(x as isize + s * dx, y as isize + s * dy);
            z.copied().filter(|&z| z > 0.0)
        };
        match (at(-1), at(1)) {
            (Some(a), Some(b)) => (b - a).abs() / 2.0,
            (Some(a), None) | (None, Some(a)) => (a - here).abs(),
            (None, None) => 0.0,
        }
    };
    across(1, 0).hypot(across(0, 1))
}
