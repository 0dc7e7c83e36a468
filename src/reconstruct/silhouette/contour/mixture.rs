//! A pixel on the contour mixes object and backdrop, alpha : 1 − alpha, in linear light; alpha follows from
//! its colour, the object's colour just inside and the backdrop's just outside.

use super::{Band, Colors, ContourFacts, clip};
use crate::image::{Mask, PixelRect};

/// How far from the contour a pixel must be to show one side alone, in pixels.
const PURE_PX: isize = 2;
/// How far pure pixels are looked for, in pixels.
const REACH_PX: isize = 5;
/// Below this contrast, in standard deviations of noise, the decision made before counts more than a
/// pixel's own colour.
const WEAK_CONTRAST: f32 = 3.0;
/// Fewest pure pixels that make a colour.
const FEWEST: f32 = 2.0;

/// Sets the levels of the pixels near the contour.
pub(super) fn locate(level: &mut Mask, colors: &Colors, band: &Band) -> ContourFacts {
    let region = band.cells.region;
    let crossings = crossings(level, band);
    let owners = owners(&crossings, region);
    let sides: Vec<Sides> = crossings
        .iter()
        .map(|&at| Sides::around(at, level, colors, &owners, region))
        .collect();
    let mut changes = Vec::with_capacity(crossings.len() * 6);
    band.for_pixels(|x, y| {
        let object = level[(x, y)] >= 128;
        let owner = owners.at(x, y);
        let alpha = if owner == NONE {
            if object { 1.0 } else { 0.0 }
        } else {
            sides[owner as usize].alpha(colors, x, y, f32::from(level[(x, y)]) / 255.0)
        };
        changes.push((x, y, (alpha * 255.0 + 0.5) as u8));
    });
    for (x, y, value) in changes {
        level[(x, y)] = value;
    }
    facts(&sides)
}

/// The pixels whose right or lower neighbour is on the other side.
fn crossings(level: &Mask, band: &Band) -> Vec<(usize, usize)> {
    let (width, height) = (level.width(), level.height());
    let mut crossings = Vec::new();
    band.for_pixels(|x, y| {
        let side = level[(x, y)] >= 128;
        let right = x + 1 < width && (level[(x + 1, y)] >= 128) != side;
        let below = y + 1 < height && (level[(x, y + 1)] >= 128) != side;
        if right || below {
            crossings.push((x, y));
        }
    });
    crossings
}

/// No crossing is near.
const NONE: u32 = u32::MAX;

/// For each pixel of the region the crossing that it belongs to.
struct Owners {
    region: PixelRect,
    owner: Vec<u32>,
}

impl Owners {
    fn at(&self, x: usize, y: usize) -> u32 {
        self.owner[(y - self.region.y0) * self.region.width() + x - self.region.x0]
    }
}

/// Gives every pixel within reach of a crossing to the nearest one.
fn owners(crossings: &[(usize, usize)], region: PixelRect) -> Owners {
    let width = region.width();
    let mut owner = vec![NONE; width * region.height()];
    for (index, &(cx, cy)) in crossings.iter().enumerate() {
        let (ix, iy) = (cx as isize, cy as isize);
        for y in clip(iy + 1 - PURE_PX, iy + PURE_PX, region.y0..region.y1) {
            for x in clip(ix + 1 - PURE_PX, ix + PURE_PX, region.x0..region.x1) {
                let cell = &mut owner[(y - region.y0) * width + x - region.x0];
                let nearer = *cell == NONE || {
                    let (ox, oy) = crossings[*cell as usize];
                    distance(x, y, cx, cy) < distance(x, y, ox, oy)
                };
                if nearer {
                    *cell = index as u32;
                }
            }
        }
    }
    Owners { region, owner }
}

/// Square of the distance to the middle between a crossing and its lower right neighbour, times 4.
fn distance(x: usize, y: usize, cx: usize, cy: usize) -> isize {
    let (dx, dy) = (
        2 * (x as isize - cx as isize) - 1,
        2 * (y as isize - cy as isize) - 1,
    );
    dx * dx + dy * dy
}

/// The two colours that mix at a crossing, in linear light.
struct Sides {
    object: [f32; 3],
    /// The backdrop's light over the expected: less in a shadow, more under spill.
    shade: [f32; 3],
    /// Contrast in standard deviations of noise; 0 where one of the colours is not known.
    contrast: f32,
}

impl Sides {
    /// Means over the pure pixels around a crossing, the nearer the heavier.
    fn around(
        (cx, cy): (usize, usize),
        level: &Mask,
        colors: &Colors,
        owners: &Owners,
        region: PixelRect,
    ) -> Self {
        let (mut object, mut objects) = ([0.0f32; 3], 0.0f32);
        let (mut seen, mut expected, mut backdrops) = ([1e-3f32; 3], [1e-3f32; 3], 0.0f32);
        let (ix, iy) = (cx as isize, cy as isize);
        for y in clip(iy - REACH_PX + 1, iy + REACH_PX, region.y0..region.y1) {
            for x in clip(ix - REACH_PX + 1, ix + REACH_PX, region.x0..region.x1) {
                if owners.at(x, y) != NONE {
                    continue;
                }
                let weight = 64.0 / (distance(x, y, cx, cy) as f32).powi(2);
                let light = colors.light(x, y);
                if level[(x, y)] >= 128 {
                    objects += weight;
                    (0..3).for_each(|c| object[c] += weight * light[c]);
                } else {
                    backdrops += weight;
                    let backdrop = colors.expected(x, y);
                    for c in 0..3 {
                        seen[c] += weight * light[c];
                        expected[c] += weight * backdrop[c];
                    }
                }
            }
        }
        let mut sides = Self {
            object: object.map(|o| o / objects.max(1e-6)),
            shade: std::array::from_fn(|c| seen[c] / expected[c]),
            contrast: 0.0,
        };
        let known = 64.0 / (4.0f32 * 36.0 * 36.0) * FEWEST;
        if objects > known && backdrops > known {
            let (backdrop, weight) = (colors.expected(cx, cy), colors.weight(cx, cy));
            let squared = |c: usize| (sides.object[c] - backdrop[c] * sides.shade[c]).powi(2);
            let sum: f32 = (0..3).map(|c| weight[c] * squared(c)).sum();
            sides.contrast = sum.sqrt();
        }
        sides
    }

    /// The object's share of a pixel: the least-squares mixture of the two colours; where they hardly differ,
    /// `prior`.
    #[inline]
    fn alpha(&self, colors: &Colors, x: usize, y: usize, prior: f32) -> f32 {
        if self.contrast == 0.0 {
            return prior;
        }
        let (light, expected) = (colors.light(x, y), colors.expected(x, y));
        let weight = colors.weight(x, y);
        let (mut along, mut square) = (0.0, 0.0);
        for c in 0..3 {
            let outside = expected[c] * self.shade[c];
            let contrast = self.object[c] - outside;
            along += weight[c] * (light[c] - outside) * contrast;
            square += weight[c] * contrast * contrast;
        }
        let doubt = WEAK_CONTRAST * WEAK_CONTRAST;
        ((along + doubt * prior) / (square + doubt)).clamp(0.0, 1.0)
    }
}

fn facts(sides: &[Sides]) -> ContourFacts {
    let mut contrasts: Vec<f32> = sides.iter().map(|s| s.contrast).collect();
    let weak = contrasts.iter().filter(|&&c| c < WEAK_CONTRAST).count();
    ContourFacts {
        contrast: super::super::photometry::median(&mut contrasts).unwrap_or(0.0),
        weak: weak as f32 / sides.len().max(1) as f32,
    }
}
