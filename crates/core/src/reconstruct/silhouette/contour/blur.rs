//! Measures how blurred a picture is across the contour. A single place is too noisy or too textured; the median
//! profile of many is that of the edge (`edge`).

use super::{Colors, edge};
use crate::image::Mask;
use crate::statistics::upper_median;

/// Places along the contour that are looked at, about.
const PLACES: usize = 300;
/// Fewest that make a profile.
const FEWEST: usize = 20;
/// How far profiles reach, in pixels, tried in turn: short ones see little of an object's shading, long ones hold
/// more blur and need an object that is as wide.
const REACHES_PX: [usize; 3] = [4, 8, 24];
/// Pixels at either end of a profile that show one side alone.
const END_PX: usize = 2;
/// Widest blur, as a share of the reach, that a profile shows well; a longer one is tried for wider ones.
const WIDEST: f32 = 0.3;
/// Least contrast of a profile's ends, in standard deviations of noise.
const LEAST_CONTRAST: f32 = 10.0;
/// Samples a pixel of the median profile.
const FINE: usize = 2;

/// Standard deviation in pixels of the blur across the contour that passes by `crossings`; `None` where too few
/// places show both sides clearly.
pub(super) fn measure(level: &Mask, colors: &Colors, crossings: &[(usize, usize)]) -> Option<f32> {
    let mut found = None;
    for reach in REACHES_PX {
        let sigma = spread(level, colors, crossings, reach);
        found = sigma.or(found);
        if sigma.is_none_or(|sigma| sigma <= WIDEST * reach as f32) {
            break;
        }
    }
    found
}

/// The blur of the median profile.
fn spread(
    level: &Mask,
    colors: &Colors,
    crossings: &[(usize, usize)],
    reach: usize,
) -> Option<f32> {
    let every = crossings.len().div_ceil(PLACES).max(1);
    let profiles: Vec<Vec<f32>> = crossings
        .iter()
        .step_by(every)
        .filter_map(|&at| Profile::at(level, colors, at, reach)?.centred())
        .collect();
    if profiles.len() < FEWEST {
        return None;
    }
    let mut values = Vec::with_capacity(profiles.len());
    let profile: Vec<f32> = (0..profiles[0].len())
        .filter_map(|i| {
            values.clear();
            values.extend(profiles.iter().map(|p| p[i]));
            upper_median(&mut values)
        })
        .collect();
    edge::blur_px(&profile, FINE).map(|sigma| sigma as f32)
}

/// Where a profile first falls below a value, between samples.
fn falls_below(profile: &[f32], value: f32) -> Option<f32> {
    let i = profile
        .windows(2)
        .position(|w| w[0] >= value && w[1] < value)?;
    let part = (profile[i] - value) / (profile[i] - profile[i + 1]);
    Some(i as f32 + part)
}

/// The object's share of the light along a line from inside the object to outside, a sample a pixel.
struct Profile {
    share: Vec<f32>,
    reach: usize,
}

impl Profile {
    /// Across the contour at a crossing; `None` if the line leaves the picture, crosses another contour or
    /// shows too little contrast.
    fn at(level: &Mask, colors: &Colors, (x, y): (usize, usize), reach: usize) -> Option<Self> {
        let (nx, ny) = outward(level, x, y)?;
        let half = (reach + search(reach)) as isize;
        let mut light = Vec::with_capacity(2 * half as usize + 1);
        for t in -half..=half {
            let (px, py) = (
                x as f32 + 0.5 + nx * t as f32,
                y as f32 + 0.5 + ny * t as f32,
            );
            let is_object = *level.get(px.round() as isize, py.round() as isize)? >= 128;
            let is_unknown = colors.is_beside_unknown(px as usize, py as usize);
            let may_differ = t.unsigned_abs() <= search(reach);
            if !may_differ && is_object != (t < 0) || is_unknown {
                return None;
            }
            light.push(sample(level, colors, px, py)?);
        }
        let ends = 2 * END_PX;
        let inside = mean(&light[..ends]);
        let outside = mean(&light[light.len() - ends..]);
        let weight = colors.weight(x, y);
        let contrast: [f32; 3] = std::array::from_fn(|c| inside[c] - outside[c]);
        let square: f32 = (0..3).map(|c| weight[c] * contrast[c] * contrast[c]).sum();
        if square < LEAST_CONTRAST * LEAST_CONTRAST {
            return None;
        }
        let share = |l: &[f32; 3]| {
            let along = |c: usize| weight[c] * (l[c] - outside[c]) * contrast[c];
            (0..3).map(along).sum::<f32>() / square
        };
        Some(Self {
            share: light.iter().map(share).collect(),
            reach,
        })
    }

    /// The profile around the place where it passes one half, finer; `None` if that is not near the middle.
    fn centred(&self) -> Option<Vec<f32>> {
        let (middle, search) = (self.share.len() / 2, search(self.reach));
        let near_middle = &self.share[middle - search..=middle + search];
        let first = middle as f32 + falls_below(near_middle, 0.5)? - (search + self.reach) as f32;
        let at = |i: usize| {
            let t = first + i as f32 / FINE as f32;
            let low = (t as usize).min(self.share.len() - 2);
            let [a, b] = [self.share[low], self.share[low + 1]];
            a + (b - a) * (t - low as f32)
        };
        Some((0..=2 * FINE * self.reach).map(at).collect())
    }
}

/// How far from the contour that was found its place in a profile of `reach` is looked for, in pixels.
fn search(reach: usize) -> usize {
    END_PX.max(reach / 4)
}

/// The unit normal of the contour near a pixel, away from the object.
fn outward(level: &Mask, x: usize, y: usize) -> Option<(f32, f32)> {
    let (mut gx, mut gy) = (0i32, 0i32);
    for dy in -3..=4isize {
        for dx in -3..=4isize {
            let l = i32::from(*level.get(x as isize + dx, y as isize + dy)?);
            gx -= l * (2 * dx as i32 - 1);
            gy -= l * (2 * dy as i32 - 1);
        }
    }
    let length = (gx as f32).hypot(gy as f32);
    (length > 0.0).then(|| (gx as f32 / length, gy as f32 / length))
}

/// Linear light between pixels; `None` outside the picture.
fn sample(level: &Mask, colors: &Colors, x: f32, y: f32) -> Option<[f32; 3]> {
    let (x0, y0) = (x.floor(), y.floor());
    let inside = x0 >= 0.0 && y0 >= 0.0;
    let (fx, fy) = (x - x0, y - y0);
    let (x0, y0) = (x0 as usize, y0 as usize);
    if !inside || x0 + 1 >= level.width() || y0 + 1 >= level.height() {
        return None;
    }
    let corners = [
        colors.light(x0, y0),
        colors.light(x0 + 1, y0),
        colors.light(x0, y0 + 1),
        colors.light(x0 + 1, y0 + 1),
    ];
    let [a, b, c, d] = corners;
    Some(std::array::from_fn(|i| {
        let upper = a[i] + (b[i] - a[i]) * fx;
        let lower = c[i] + (d[i] - c[i]) * fx;
        upper + (lower - upper) * fy
    }))
}

fn mean(values: &[[f32; 3]]) -> [f32; 3] {
    std::array::from_fn(|c| values.iter().map(|v| v[c]).sum::<f32>() / values.len() as f32)
}
