//! The contour to a fraction of a pixel. A pixel on the contour mixes object and backdrop, alpha : 1 − alpha,
//! in linear light; alpha follows from its colour, the object's colour just inside and the backdrop's just
//! outside, both estimated on the spot. Only a band around the coarse decision is looked at.

use super::cells::Cells;
use super::photometry::Photometry;
use crate::image::{Grid, Mask, PixelRect, RgbImage, srgb};

/// Half the width in pixels of the band that is searched for the contour.
const BAND_PX: usize = 8;
/// How far from the contour a pixel must be to show one side alone, in pixels.
const PURE_PX: isize = 2;
/// How far pure pixels are looked for, in pixels.
const REACH_PX: isize = 4;
/// Below this contrast, in standard deviations of noise, the neighbours' decision counts more than a
/// pixel's own colour.
const WEAK_CONTRAST: f32 = 3.0;

/// Finds the level set (see [`super::Silhouette::level`]) from the coarse decision.
pub(super) fn locate(
    picture: &RgbImage,
    plate: &RgbImage,
    cells: &Cells,
    photometry: &Photometry,
    object: &Grid<bool>,
) -> Mask {
    let mut level = Mask::filled(picture.width(), picture.height(), 0);
    let band = band_cells(object, BAND_PX.div_ceil(cells.size).max(2) as isize);
    fill_inside(&mut level, cells, object, &band);
    let mixture = Mixture::new(picture, plate, photometry);
    let sides = Sides::of_cells(&mixture, cells, object);
    for_band_pixels(cells, &band, |x, y, cell| {
        let side = &sides[cell];
        let prior = smooth_decision(cells, object, x, y);
        level[(x, y)] = to_level(mixture.alpha(x, y, side, prior));
    });
    for _ in 0..2 {
        refine(&mut level, &mixture, cells, &band, &sides);
    }
    level
}

fn to_level(alpha: f32) -> u8 {
    (alpha * 255.0 + 0.5) as u8
}

/// Cells within `radius` cells of one that is decided differently.
fn band_cells(object: &Grid<bool>, radius: isize) -> Grid<bool> {
    let (columns, rows) = (object.width(), object.height());
    let mut band = Grid::filled(columns, rows, false);
    for y in 0..rows {
        for x in 0..columns {
            let value = object[(x, y)];
            let right = x + 1 < columns && object[(x + 1, y)] != value;
            let below = y + 1 < rows && object[(x, y + 1)] != value;
            if right || below {
                mark(&mut band, x, y, radius);
            }
        }
    }
    band
}

fn mark(band: &mut Grid<bool>, x: usize, y: usize, radius: isize) {
    let columns = clip(x as isize - radius + 1, x as isize + radius, band.width());
    for y in clip(y as isize - radius + 1, y as isize + radius, band.height()) {
        band.row_mut(y)[columns.clone()].fill(true);
    }
}

/// Whole numbers from `first` to `last` that lie below `size`.
fn clip(first: isize, last: isize, size: usize) -> std::ops::Range<usize> {
    let end = (last + 1).clamp(0, size as isize) as usize;
    (first.max(0) as usize).min(end)..end
}

fn fill_inside(level: &mut Mask, cells: &Cells, object: &Grid<bool>, band: &Grid<bool>) {
    for cy in 0..object.height() {
        for cx in 0..object.width() {
            if object[(cx, cy)] && !band[(cx, cy)] {
                let r = cells.pixels(cx, cy);
                for y in r.y0..r.y1 {
                    level.row_mut(y)[r.x0..r.x1].fill(255);
                }
            }
        }
    }
}

fn for_band_pixels(
    cells: &Cells,
    band: &Grid<bool>,
    mut visit: impl FnMut(usize, usize, (usize, usize)),
) {
    for cy in 0..band.height() {
        for cx in (0..band.width()).filter(|&cx| band[(cx, cy)]) {
            let PixelRect { x0, y0, x1, y1 } = cells.pixels(cx, cy);
            for y in y0..y1 {
                for x in x0..x1 {
                    visit(x, y, (cx, cy));
                }
            }
        }
    }
}

/// The coarse decision, interpolated: 1 inside the object, 0 outside.
fn smooth_decision(cells: &Cells, object: &Grid<bool>, x: usize, y: usize) -> f32 {
    let coordinate = |p: usize, first: usize, count: usize| {
        let c = (p - first) as f32 + 0.5;
        let c = (c / cells.size as f32 - 0.5).clamp(0.0, (count - 1) as f32);
        let low = c as usize;
        (low, (low + 1).min(count - 1), c - low as f32)
    };
    let (x0, x1, fx) = coordinate(x, cells.region.x0, object.width());
    let (y0, y1, fy) = coordinate(y, cells.region.y0, object.height());
    let at = |x, y| f32::from(u8::from(object[(x, y)]));
    let mix = |y| at(x0, y) * (1.0 - fx) + at(x1, y) * fx;
    mix(y0) * (1.0 - fy) + mix(y1) * fy
}

/// The two colours that mix, in linear light.
#[derive(Clone, Copy, Debug, Default)]
struct Side {
    /// The object's.
    object: [f32; 3],
    /// The backdrop's light over what the plate leads to expect: less in a shadow, more under spill.
    shade: [f32; 3],
}

/// Picture and plate in linear light.
struct Mixture<'a> {
    picture: &'a RgbImage,
    plate: &'a RgbImage,
    /// Linear light of the backdrop by the plate's encoded value, per channel.
    backdrop: [[f32; 256]; 3],
    /// Reciprocal variance of the picture's light by the expected encoded value, per channel.
    weight: [[f32; 256]; 3],
}

impl<'a> Mixture<'a> {
    fn new(picture: &'a RgbImage, plate: &'a RgbImage, photometry: &Photometry) -> Self {
        let linear = srgb::linear_from_srgb();
        let backdrop: [[f32; 256]; 3] =
            std::array::from_fn(|c| linear.map(|l| l * photometry.gain[c]));
        let weight = std::array::from_fn(|c| {
            std::array::from_fn(|v| {
                let slope = linear[(v + 2).min(255)] - linear[v.saturating_sub(2)];
                1.0 / ((photometry.pixel_noise[c] * slope / 4.0).powi(2) + 1e-8)
            })
        });
        Self {
            picture,
            plate,
            backdrop,
            weight,
        }
    }

    #[inline]
    fn light(&self, x: usize, y: usize) -> [f32; 3] {
        let linear = srgb::linear_from_srgb();
        self.picture[(x, y)].map(|v| linear[usize::from(v)])
    }

    #[inline]
    fn backdrop(&self, x: usize, y: usize) -> [f32; 3] {
        let plate = self.plate[(x, y)];
        std::array::from_fn(|c| self.backdrop[c][usize::from(plate[c])])
    }

    /// The object's share of a pixel: the least-squares mixture of the two colours; where they hardly differ,
    /// `prior`.
    #[inline]
    fn alpha(&self, x: usize, y: usize, side: &Side, prior: f32) -> f32 {
        let (light, backdrop) = (self.light(x, y), self.backdrop(x, y));
        let plate = self.plate[(x, y)];
        let (mut along, mut square) = (0.0, 0.0);
        for c in 0..3 {
            let outside = backdrop[c] * side.shade[c];
            let contrast = side.object[c] - outside;
            let weight = self.weight[c][usize::from(plate[c])];
            along += weight * (light[c] - outside) * contrast;
            square += weight * contrast * contrast;
        }
        let doubt = WEAK_CONTRAST * WEAK_CONTRAST;
        ((along + doubt * prior) / (square + doubt)).clamp(0.0, 1.0)
    }
}

/// Sums of light over pure pixels.
#[derive(Clone, Copy, Default)]
struct Sum {
    object: [f32; 3],
    objects: u32,
    seen: [f32; 3],
    expected: [f32; 3],
    backdrops: u32,
}

impl Sum {
    fn add_object(&mut self, light: [f32; 3]) {
        for (sum, light) in self.object.iter_mut().zip(light) {
            *sum += light;
        }
        self.objects += 1;
    }

    fn add_backdrop(&mut self, light: [f32; 3], expected: [f32; 3]) {
        for c in 0..3 {
            self.seen[c] += light[c];
            self.expected[c] += expected[c];
        }
        self.backdrops += 1;
    }

    /// The sides, from `fallback` where too few pixels are pure.
    fn side(&self, fallback: &Side, fewest: u32) -> Side {
        let mut side = *fallback;
        if self.objects >= fewest {
            side.object = self.object.map(|s| s / self.objects as f32);
        }
        if self.backdrops >= fewest {
            // A little light is added so that a black plate gives no wild ratio.
            let ratio = |c: usize| (self.seen[c] + 1e-3) / (self.expected[c] + 1e-3);
            side.shade = std::array::from_fn(ratio);
        }
        side
    }
}

struct Sides;

impl Sides {
    /// Both colours for every cell, from whole cells nearby.
    fn of_cells(mixture: &Mixture, cells: &Cells, object: &Grid<bool>) -> Grid<Side> {
        let (columns, rows) = (object.width(), object.height());
        let everywhere = {
            let mut sum = Sum::default();
            for i in 0..columns * rows {
                add_cell(&mut sum, mixture, cells, object, i);
            }
            let neutral = Side {
                object: [1.0; 3],
                shade: [1.0; 3],
            };
            let mut side = sum.side(&neutral, 1);
            side.shade = [1.0; 3];
            side
        };
        let band = band_cells(object, BAND_PX.div_ceil(cells.size).max(2) as isize);
        Grid::from_fn(columns, rows, |x, y| {
            if !band[(x, y)] {
                return everywhere;
            }
            let mut sum = Sum::default();
            let radius = (BAND_PX / cells.size + 2) as isize;
            for ny in clip(y as isize - radius, y as isize + radius, rows) {
                for nx in clip(x as isize - radius, x as isize + radius, columns) {
                    if is_pure(object, nx, ny) {
                        add_cell(&mut sum, mixture, cells, object, ny * columns + nx);
                    }
                }
            }
            sum.side(&everywhere, 1)
        })
    }
}

fn is_pure(object: &Grid<bool>, x: usize, y: usize) -> bool {
    let value = object[(x, y)];
    let columns = clip(x as isize - 1, x as isize + 1, object.width());
    clip(y as isize - 1, y as isize + 1, object.height())
        .all(|y| object.row(y)[columns.clone()].iter().all(|&v| v == value))
}

fn add_cell(sum: &mut Sum, mixture: &Mixture, cells: &Cells, object: &Grid<bool>, i: usize) {
    let light = cells.picture.pixels()[i].map(srgb::decode);
    if object.pixels()[i] {
        sum.add_object(light);
    } else {
        let plate = cells.plate.pixels()[i];
        let expected = |c: usize| mixture.backdrop[c][(plate[c] + 0.5) as usize];
        sum.add_backdrop(light, std::array::from_fn(expected));
    }
}

/// Estimates alpha again near the contour, with both colours taken from pixels just beside it.
fn refine(
    level: &mut Mask,
    mixture: &Mixture,
    cells: &Cells,
    band: &Grid<bool>,
    coarse: &Grid<Side>,
) {
    let pure = pure_pixels(level, cells.region);
    let region = cells.region;
    let previous = level.clone();
    for_band_pixels(cells, band, |x, y, cell| {
        let at = |x: usize, y: usize| pure[(x - region.x0, y - region.y0)];
        if at(x, y) != Purity::Mixed {
            level[(x, y)] = if at(x, y) == Purity::Object { 255 } else { 0 };
            return;
        }
        let mut sum = Sum::default();
        for ny in window(y, region.y0, region.y1) {
            for nx in window(x, region.x0, region.x1) {
                match at(nx, ny) {
                    Purity::Object => sum.add_object(mixture.light(nx, ny)),
                    Purity::Backdrop => {
                        sum.add_backdrop(mixture.light(nx, ny), mixture.backdrop(nx, ny));
                    }
                    Purity::Mixed => {}
                }
            }
        }
        let side = sum.side(&coarse[cell], 3);
        let prior = f32::from(previous[(x, y)]) / 255.0;
        level[(x, y)] = to_level(mixture.alpha(x, y, &side, prior));
    });
}

fn window(p: usize, first: usize, end: usize) -> std::ops::Range<usize> {
    p.saturating_sub(REACH_PX as usize).max(first)..(p + REACH_PX as usize + 1).min(end)
}

/// What a pixel shows.
#[derive(Clone, Copy, PartialEq)]
enum Purity {
    Object,
    Backdrop,
    Mixed,
}

/// Pixels whose surroundings lie all on their side of the contour.
fn pure_pixels(level: &Mask, region: PixelRect) -> Grid<Purity> {
    let (width, height) = (region.width(), region.height());
    // Runs of one side along rows, then along columns: a square without a loop over it.
    let mut along_rows = Grid::filled(width, height, Purity::Mixed);
    for y in 0..height {
        let row = &level.row(region.y0 + y)[region.x0..region.x1];
        let sides = |x: usize| {
            if row[x] >= 128 {
                Purity::Object
            } else {
                Purity::Backdrop
            }
        };
        let out = along_rows.row_mut(y);
        for (x, purity) in out.iter_mut().enumerate() {
            let side = sides(x);
            let same =
                clip(x as isize - PURE_PX, x as isize + PURE_PX, width).all(|x| sides(x) == side);
            *purity = if same { side } else { Purity::Mixed };
        }
    }
    Grid::from_fn(width, height, |x, y| {
        let side = along_rows[(x, y)];
        let same = clip(y as isize - PURE_PX, y as isize + PURE_PX, height)
            .all(|y| along_rows[(x, y)] == side);
        if same { side } else { Purity::Mixed }
    })
}
