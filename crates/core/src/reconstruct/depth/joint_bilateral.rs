//! The joint bilateral filter over pictures with holes: a weighted mean of a pixel's surroundings. Weights fall
//! with distance and with the difference in the guide; a hole has weight 0. Without holes it is the filter of the
//! paper's section 2.D and of OpenCV's `ximgproc::jointBilateralFilter`.

use crate::image::Grid;

/// The filter's kernel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Kernel {
    /// Half-width in pixels: the kernel is the disc of this radius.
    pub half_width_px: usize,
    /// Standard deviation of the spatial weight, in pixels.
    pub spatial_sigma_px: f32,
    /// Standard deviation of the range weight, in units of the guide ([0, 1] an intensity). The guide's
    /// channels add up as absolute differences, as in OpenCV.
    pub range_sigma: f32,
    /// Standard deviation in metres of a second range weight, on depth itself; `None` has none, as in the
    /// paper.
    pub depth_sigma: Option<f32>,
}

/// One row's sums while it is filtered.
struct Row {
    weighted: Vec<f32>,
    weights: Vec<f32>,
}

/// Filters `depth` (0 is a hole) guided by the channels of `guide`, all of one size. A hole gets a value
/// where its surroundings have one; a pixel with nothing but holes within the kernel stays a hole.
pub(super) fn filter(depth: &Grid<f32>, guide: &[Grid<f32>], kernel: &Kernel) -> Grid<f32> {
    let (width, height) = (depth.width(), depth.height());
    let mut out = Grid::filled(width, height, 0.0);
    let mut row = Row {
        weighted: vec![0.0; width],
        weights: vec![0.0; width],
    };
    let taps = taps(kernel);
    for y in 0..height {
        row.weighted.fill(0.0);
        row.weights.fill(0.0);
        for tap in &taps {
            let Some(other) = y.checked_add_signed(tap.dy).filter(|&o| o < height) else {
                continue;
            };
            accumulate(&mut row, depth, guide, kernel, tap, y, other);
        }
        for (x, out) in out.row_mut(y).iter_mut().enumerate() {
            if row.weights[x] > 0.0 {
                *out = row.weighted[x] / row.weights[x];
            }
        }
    }
    out
}

/// One pixel of the kernel.
struct Tap {
    dx: isize,
    dy: isize,
    weight: f32,
}

/// The disc's pixels, row by row.
fn taps(kernel: &Kernel) -> Vec<Tap> {
    let r = kernel.half_width_px as isize;
    let scale = -0.5 / (kernel.spatial_sigma_px * kernel.spatial_sigma_px);
    let square = (-r..=r).flat_map(|dy| (-r..=r).map(move |dx| (dx, dy)));
    square
        .filter(|(dx, dy)| dx * dx + dy * dy <= r * r)
        .map(|(dx, dy)| Tap {
            dx,
            dy,
            weight: ((dx * dx + dy * dy) as f32 * scale).exp(),
        })
        .collect()
}

/// Adds to every pixel of row `y` its neighbour at one tap, which lies in row `other`. Plain loops over
/// slices of one length, so that the compiler vectorises them.
fn accumulate(
    row: &mut Row,
    depth: &Grid<f32>,
    guide: &[Grid<f32>],
    kernel: &Kernel,
    tap: &Tap,
    y: usize,
    other: usize,
) {
    let width = depth.width();
    let shift = tap.dx.unsigned_abs();
    if shift >= width {
        return;
    }
    let (to, from) = if tap.dx < 0 {
        (shift..width, 0..width - shift)
    } else {
        (0..width - shift, shift..width)
    };
    let mut difference = [0.0f32; CHUNK];
    let weighted = row.weighted[to.clone()].chunks_mut(CHUNK);
    let weights = row.weights[to.clone()].chunks_mut(CHUNK);
    for (i, (weighted, weights)) in weighted.zip(weights).enumerate() {
        let n = weights.len();
        let here = to.start + i * CHUNK..to.start + i * CHUNK + n;
        let there = from.start + i * CHUNK..from.start + i * CHUNK + n;
        let exponent = &mut difference[..n];
        range_exponent(
            exponent,
            guide,
            kernel,
            (y, here.clone()),
            (other, there.clone()),
        );
        let z = &depth.row(other)[there];
        if let Some(sigma) = kernel.depth_sigma {
            depth_exponent(exponent, &depth.row(y)[here], z, sigma);
        }
        for (((weighted, weights), &e), &z) in
            weighted.iter_mut().zip(weights).zip(&*exponent).zip(z)
        {
            let w = if z > 0.0 { tap.weight * exp(e) } else { 0.0 };
            *weighted += w * z;
            *weights += w;
        }
    }
}

/// Pixels that are worked on at a time: few enough to stay in the first cache.
const CHUNK: usize = 128;

type Span = (usize, std::ops::Range<usize>);

/// −d²/2σ² of the guide's L1 difference d between two spans of pixels.
fn range_exponent(out: &mut [f32], guide: &[Grid<f32>], kernel: &Kernel, a: Span, b: Span) {
    out.fill(0.0);
    for channel in guide {
        let (a, b) = (
            &channel.row(a.0)[a.1.clone()],
            &channel.row(b.0)[b.1.clone()],
        );
        for ((out, a), b) in out.iter_mut().zip(a).zip(b) {
            *out += (a - b).abs();
        }
    }
    let scale = -0.5 / (kernel.range_sigma * kernel.range_sigma);
    for out in out {
        *out = *out * *out * scale;
    }
}

/// Adds −d²/2σ² of the depth's difference d; a hole in the middle has no opinion.
fn depth_exponent(out: &mut [f32], here: &[f32], there: &[f32], sigma: f32) {
    let scale = -0.5 / (sigma * sigma);
    for ((out, &a), &b) in out.iter_mut().zip(here).zip(there) {
        let d = a - b;
        *out += if a > 0.0 { d * d * scale } else { 0.0 };
    }
}

/// e^x for x <= 0 to a relative error of 1e-5 down to x = −80, below which it stays at e^−80: a
/// polynomial for 2^fraction, and the whole part put into the exponent's bits.
#[inline]
fn exp(x: f32) -> f32 {
    /// 1.5 · 2^23: adding it leaves the nearest whole number in the lowest bits.
    const ROUND: f32 = 12_582_912.0;
    let t = x.max(-80.0) * std::f32::consts::LOG2_E;
    let shifted = t + ROUND;
    let f = t - (shifted - ROUND);
    let p = 1.333_355_8e-3;
    let p = p * f + 9.618_129e-3;
    let p = p * f + 5.550_411e-2;
    let p = p * f + 0.240_226_5;
    let p = p * f + std::f32::consts::LN_2;
    let p = p * f + 1.0;
    f32::from_bits(p.to_bits().wrapping_add(shifted.to_bits() << 23))
}

#[cfg(test)]
mod tests {
    use super::*;

    const KERNEL: Kernel = Kernel {
        half_width_px: 3,
        spatial_sigma_px: 1.5,
        range_sigma: 0.1,
        depth_sigma: None,
    };

    /// A depth and a guide's channel without any order, but the same in every language.
    fn depth() -> Grid<f32> {
        Grid::from_fn(16, 12, |x, y| {
            0.8 + ((x * 7 + y * 13 + x * y) % 23) as f32 * 1e-3
        })
    }

    fn channel(c: usize) -> Grid<f32> {
        Grid::from_fn(16, 12, |x, y| {
            ((x * 37 + y * 101 + x * x * y * c) % 64) as f32 / 255.0
        })
    }

    /// What OpenCV 5.0's `cv2.ximgproc.jointBilateralFilter(guide, depth, 7, sigmaColor, 1.5)` gave in
    /// Python for the pictures above as float32, in rows 3, 6 and 8, columns 3 to 12; the guide is
    /// `channel(1)` with sigmaColor 0.1, or channels 1, 2 and 3 with sigmaColor 0.2.
    #[rustfmt::skip]
    const OPENCV: [[f32; 30]; 2] = [
        [
            0.810521, 0.810664, 0.811123, 0.810815, 0.810270, 0.809156, 0.808990, 0.807391, 0.810309, 0.810480,
            0.811372, 0.811832, 0.810846, 0.811706, 0.812486, 0.811369, 0.809838, 0.807631, 0.809101, 0.809050,
            0.811024, 0.810705, 0.810451, 0.810851, 0.810169, 0.811869, 0.808703, 0.807827, 0.810253, 0.809094,
        ],
        [
            0.810598, 0.810187, 0.811143, 0.810302, 0.810633, 0.809307, 0.808970, 0.807153, 0.809088, 0.811121,
            0.811185, 0.811857, 0.809570, 0.811185, 0.811615, 0.811593, 0.809569, 0.807317, 0.808504, 0.808064,
            0.810720, 0.810478, 0.810509, 0.812109, 0.808537, 0.811677, 0.809109, 0.807696, 0.809462, 0.809162,
        ],
    ];

    #[test]
    fn without_holes_it_is_opencvs_filter() {
        let color = Kernel {
            range_sigma: 0.2,
            ..KERNEL
        };
        let ours = [
            filter(&depth(), &[channel(1)], &KERNEL),
            filter(&depth(), &[channel(1), channel(2), channel(3)], &color),
        ];
        for (ours, theirs) in ours.iter().zip(&OPENCV) {
            for (i, theirs) in theirs.iter().enumerate() {
                let z = ours[(3 + i % 10, [3, 6, 8][i / 10])];
                // The numbers have 6 decimals; OpenCV's table of weights adds up to 1e-6.
                assert!((z - theirs).abs() < 2e-6, "{z} and {theirs} at {i}");
            }
        }
    }

    #[test]
    fn a_hole_has_no_weight() {
        let flat = Grid::filled(21, 21, 0.5);
        let with_hole = Grid::from_fn(21, 21, |x, y| {
            if (9..12).contains(&x) && y == 10 {
                0.0
            } else {
                0.9
            }
        });
        let out = filter(&with_hole, &[flat], &KERNEL);
        for z in out.pixels() {
            assert!((z - 0.9).abs() < 1e-6, "{z}");
        }
        let nothing = Grid::filled(21, 21, 0.0);
        let out = filter(&nothing, &[Grid::filled(21, 21, 0.5)], &KERNEL);
        assert!(out.pixels().iter().all(|&z| z == 0.0));
    }

    #[test]
    fn a_weight_on_depth_keeps_a_step_that_the_guide_does_not_show() {
        let step = Grid::from_fn(20, 5, |x, _| if x < 10 { 0.8 } else { 0.9 });
        let guide = [Grid::filled(20, 5, 0.5)];
        let smeared = filter(&step, &guide, &KERNEL);
        assert!((smeared[(9, 2)] - 0.8).abs() > 0.02);
        let kernel = Kernel {
            depth_sigma: Some(0.005),
            ..KERNEL
        };
        let kept = filter(&step, &guide, &kernel);
        for (a, b) in kept.pixels().iter().zip(step.pixels()) {
            assert!((a - b).abs() < 1e-6);
        }
    }

    #[test]
    fn the_exponential_is_as_near_as_it_says() {
        for i in 0..80_000 {
            let x = i as f32 * -1e-3;
            let relative = f64::from(exp(x)) / f64::from(x).exp() - 1.0;
            assert!(relative.abs() < 1e-5, "{x}: {relative}");
        }
        assert!(exp(-1e9) < 1e-30);
    }
}
