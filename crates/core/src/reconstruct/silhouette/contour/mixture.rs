//! A pixel on the contour mixes object and backdrop, alpha : 1 − alpha, in linear light; alpha follows from
//! its colour, the object's colour just inside and the backdrop's just outside.

use super::{Band, Colors, ContourFacts, clip};
use crate::array::three;
use crate::image::{Mask, PixelRect};
use crate::statistics::upper_median;
use std::ops::Range;

/// How far from the contour a pixel must be to show one side alone, in pixels.
const PURE_PX: isize = 2;
/// How far pure pixels are looked for, in pixels.
const REACH_PX: isize = 5;
/// Below this contrast, in standard deviations of noise, the decision made before counts more than a
/// pixel's own colour.
const WEAK_CONTRAST: f32 = 3.0;
/// Misfit of a mixture, in squared standard deviations, that noise explains.
const NOISE: f32 = 12.0;
/// How much more the decision made before counts for every unit of misfit beyond that.
const THIRD_COLOR: f32 = 100.0;
/// Least sum of the pure pixels' weights (the fourth power of twice the distance, inverted) that makes a
/// colour: two pixels as far as they are looked for.
const FEWEST: f32 = 2.0 / (162.0 * 162.0);

/// Sets the levels of the pixels near the contour.
pub(super) fn locate(level: &mut Mask, colors: &Colors, band: &Band) -> ContourFacts {
    let region = band.cells.region;
    let crossings = crossings(level, band);
    let owners = Owners::new(&crossings, region);
    let weights = weights();
    let sides: Vec<Sides> = crossings
        .iter()
        .map(|&at| Sides::around(at, level, colors, &owners, &weights))
        .collect();
    let mut decisions = Vec::with_capacity(6 * crossings.len());
    owners.for_pixels(&crossings, |_, x, y| decisions.push(decided(level, x, y)));
    let mut decisions = decisions.iter();
    band.for_pixels(|x, y| level[(x, y)] = if level[(x, y)] >= 128 { 255 } else { 0 });
    owners.for_pixels(&crossings, |crossing, x, y| {
        let prior = decisions.next().copied().unwrap_or(0.5);
        level[(x, y)] = (sides[crossing].alpha(colors, x, y, prior) * 255.0 + 0.5) as u8;
    });
    let contour = crossings.iter().zip(&sides);
    let contour = contour.filter(|((x, y), _)| !colors.is_beside_unknown(*x, *y));
    facts(&contour.map(|(_, sides)| sides).collect::<Vec<_>>())
}

/// What was decided of a pixel: half its own level and half the share of object among the nine around it, which
/// smooths the stair of whole pixels.
fn decided(level: &Mask, x: usize, y: usize) -> f32 {
    let columns = x.saturating_sub(1)..(x + 2).min(level.width());
    let rows = y.saturating_sub(1)..(y + 2).min(level.height());
    let count = columns.len() * rows.len();
    let objects: usize = rows
        .flat_map(|y| &level.row(y)[columns.clone()])
        .map(|&l| usize::from(l >> 7))
        .sum();
    0.5 * (f32::from(level[(x, y)]) / 255.0 + objects as f32 / count as f32)
}

/// The pixels whose right or lower neighbour is on the other side.
pub(super) fn crossings(level: &Mask, band: &Band) -> Vec<(usize, usize)> {
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

/// Pixels along a side of the square that a crossing may own.
const OWNED: usize = 2 * PURE_PX as usize;

/// For each pixel of the region where in the square of its crossing it lies: its number in reading order from 1,
/// or 0 where no crossing is near. A byte a pixel, since most of the region is never touched.
struct Owners {
    region: PixelRect,
    place: Vec<u8>,
}

impl Owners {
    /// Gives every pixel within reach of a crossing to the nearest one.
    fn new(crossings: &[(usize, usize)], region: PixelRect) -> Self {
        let mut this = Self {
            region,
            place: vec![0; region.width() * region.height()],
        };
        let distances: [isize; OWNED * OWNED] = std::array::from_fn(|i| {
            let middle = PURE_PX as usize - 1;
            distance(i % OWNED, i / OWNED, middle, middle)
        });
        for &crossing in crossings {
            this.visit(crossing, |current, place| {
                let nearer =
                    |&p: &u8| distances[usize::from(place) - 1] < distances[usize::from(p) - 1];
                if *current == 0 || nearer(current) {
                    *current = place;
                }
            });
        }
        this
    }

    /// The pixels of a crossing's square: what is noted of each, and its place.
    fn visit(&mut self, (cx, cy): (usize, usize), mut visit: impl FnMut(&mut u8, u8)) {
        let (region, width) = (self.region, self.region.width());
        let (columns, rows) = square(region, cx, cy);
        for y in rows {
            for x in columns.clone() {
                let place = place(x, y, cx, cy);
                visit(
                    &mut self.place[(y - region.y0) * width + x - region.x0],
                    place,
                );
            }
        }
    }

    /// Visits every pixel that a crossing owns, with the crossing's index.
    fn for_pixels(&self, crossings: &[(usize, usize)], mut visit: impl FnMut(usize, usize, usize)) {
        for (index, &(cx, cy)) in crossings.iter().enumerate() {
            let (columns, rows) = square(self.region, cx, cy);
            for y in rows {
                for x in columns.clone() {
                    if self.at(x, y) == place(x, y, cx, cy) {
                        visit(index, x, y);
                    }
                }
            }
        }
    }

    #[inline]
    fn at(&self, x: usize, y: usize) -> u8 {
        self.place[(y - self.region.y0) * self.region.width() + x - self.region.x0]
    }
}

/// Columns and rows of the square that a crossing may own.
fn square(region: PixelRect, cx: usize, cy: usize) -> (Range<usize>, Range<usize>) {
    let side = |c: usize, range| clip(c as isize + 1 - PURE_PX, c as isize + PURE_PX, range);
    (
        side(cx, region.x0..region.x1),
        side(cy, region.y0..region.y1),
    )
}

/// Where in a crossing's square a pixel lies, from 1.
#[inline]
fn place(x: usize, y: usize, cx: usize, cy: usize) -> u8 {
    let before = PURE_PX as usize - 1;
    ((y + before - cy) * OWNED + x + before - cx + 1) as u8
}

/// Square of the distance to the middle between a crossing and its lower right neighbour, times 4.
fn distance(x: usize, y: usize, cx: usize, cy: usize) -> isize {
    let (dx, dy) = (
        2 * (x as isize - cx as isize) - 1,
        2 * (y as isize - cy as isize) - 1,
    );
    dx * dx + dy * dy
}

/// Pixels along a side of the square in which pure pixels are looked for.
const WINDOW: usize = 2 * REACH_PX as usize;

/// Weights of the pixels of that square, by their distance.
fn weights() -> [[f32; WINDOW]; WINDOW] {
    let middle = REACH_PX as usize - 1;
    let weight = |x: usize, y: usize| 1.0 / (distance(x, y, middle, middle) as f32).powi(2);
    std::array::from_fn(|y| std::array::from_fn(|x| weight(x, y)))
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
        weights: &[[f32; WINDOW]; WINDOW],
    ) -> Self {
        let region = owners.region;
        let (mut object, mut objects) = ([0.0f32; 3], 0.0f32);
        let (mut seen, mut expected, mut backdrops) = ([1e-6f32; 3], [1e-6f32; 3], 0.0f32);
        let (ix, iy) = (cx as isize, cy as isize);
        let columns = clip(ix - REACH_PX + 1, ix + REACH_PX, region.x0..region.x1);
        for y in clip(iy - REACH_PX + 1, iy + REACH_PX, region.y0..region.y1) {
            let weights = &weights[y + REACH_PX as usize - 1 - cy];
            for x in columns.clone().filter(|&x| owners.at(x, y) == 0) {
                let weight = weights[x + REACH_PX as usize - 1 - cx];
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
            object: three(|c| object[c] / objects.max(1e-9)),
            shade: three(|c| seen[c] / expected[c]),
            contrast: 0.0,
        };
        if objects > FEWEST && backdrops > FEWEST {
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
        let (mut along, mut square, mut off) = (0.0, 0.0, 0.0);
        for c in 0..3 {
            let outside = expected[c] * self.shade[c];
            let contrast = self.object[c] - outside;
            along += weight[c] * (light[c] - outside) * contrast;
            square += weight[c] * contrast * contrast;
            off += weight[c] * (light[c] - outside) * (light[c] - outside);
        }
        // A colour that no mixture of the two makes is a third one, about which nothing is known here.
        let misfit = (off - along * along / square.max(1e-6)).max(0.0);
        let doubt = WEAK_CONTRAST * WEAK_CONTRAST + THIRD_COLOR * (misfit - NOISE).max(0.0);
        ((along + doubt * prior) / (square + doubt)).clamp(0.0, 1.0)
    }
}

fn facts(sides: &[&Sides]) -> ContourFacts {
    let mut contrasts: Vec<f32> = sides.iter().map(|s| s.contrast).collect();
    let weak = contrasts.iter().filter(|&&c| c < WEAK_CONTRAST).count();
    ContourFacts {
        contrast: upper_median(&mut contrasts).unwrap_or(0.0),
        weak: weak as f32 / sides.len().max(1) as f32,
        blur_px: None,
    }
}
