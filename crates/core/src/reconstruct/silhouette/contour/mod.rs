//! Locates the contour to a fraction of a pixel, from the coarse decision: each pixel of a band around it goes to
//! the side whose colours nearby it resembles (`classify`); then the pixels that the contour crosses are separated
//! into object and backdrop (`mixture`).

mod blur;
mod classify;
mod edge;
mod mixture;

use super::cells::Cells;
use super::photometry::Photometry;
use crate::array::three;
use crate::image::{Grid, Mask, RgbImage, srgb};

/// Half the width in pixels of the band that is searched for the contour.
const BAND_PX: usize = 8;
/// How often the contour is located, each time with colours from beside the contour as it was then.
const PASSES: usize = 2;

/// Facts that come with the contour.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct ContourFacts {
    /// Median contrast of object and backdrop, in standard deviations of noise.
    pub contrast: f32,
    /// Share of the contour where the contrast is too weak to locate it.
    pub weak: f32,
    /// Standard deviation of the blur across it, in pixels.
    pub blur_px: Option<f32>,
}

/// Finds the level set (see [`super::Silhouette::level`]) from the coarse decision.
pub(super) fn locate(
    (picture, plate): (&RgbImage, &RgbImage),
    unknown: Option<&Mask>,
    cells: &Cells,
    photometry: &Photometry,
    object: &Grid<bool>,
) -> (Mask, ContourFacts) {
    let colors = Colors {
        unknown,
        ..Colors::new(picture, plate, photometry)
    };
    let band = Band::new(cells, object);
    let mut level = Mask::filled(picture.width(), picture.height(), 0);
    band.fill_inside(&mut level);
    classify::classify(&mut level, &colors, &band);
    let mut facts = ContourFacts::default();
    for _ in 0..PASSES {
        facts = mixture::locate(&mut level, &colors, &band);
    }
    let crossings = mixture::crossings(&level, &band);
    facts.blur_px = blur::measure(&level, &colors, &crossings);
    (level, facts)
}

/// The cells around the coarse contour.
struct Band<'a> {
    cells: &'a Cells,
    object: &'a Grid<bool>,
    /// Column and row of each.
    members: Vec<(usize, usize)>,
    is_member: Grid<bool>,
}

impl<'a> Band<'a> {
    fn new(cells: &'a Cells, object: &'a Grid<bool>) -> Self {
        let radius = BAND_PX.div_ceil(cells.size).max(2) as isize;
        let (columns, rows) = (object.width(), object.height());
        let mut is_member = Grid::filled(columns, rows, false);
        for y in 0..rows {
            for x in 0..columns {
                let value = object[(x, y)];
                let right = x + 1 < columns && object[(x + 1, y)] != value;
                let below = y + 1 < rows && object[(x, y + 1)] != value;
                if right || below {
                    mark(&mut is_member, x, y, radius);
                }
            }
        }
        let all = (0..rows).flat_map(|y| (0..columns).map(move |x| (x, y)));
        Self {
            cells,
            object,
            members: all.filter(|&cell| is_member[cell]).collect(),
            is_member,
        }
    }

    /// 255 in the object's cells that are not in the band.
    fn fill_inside(&self, level: &mut Mask) {
        for cy in 0..self.object.height() {
            for cx in 0..self.object.width() {
                if self.object[(cx, cy)] && !self.is_member[(cx, cy)] {
                    let r = self.cells.pixels(cx, cy);
                    for y in r.y0..r.y1 {
                        level.row_mut(y)[r.x0..r.x1].fill(255);
                    }
                }
            }
        }
    }

    /// All pixels of the band.
    fn for_pixels(&self, mut visit: impl FnMut(usize, usize)) {
        for &(cx, cy) in &self.members {
            let r = self.cells.pixels(cx, cy);
            for y in r.y0..r.y1 {
                for x in r.x0..r.x1 {
                    visit(x, y);
                }
            }
        }
    }
}

fn mark(band: &mut Grid<bool>, x: usize, y: usize, radius: isize) {
    let columns = clip(
        x as isize - radius + 1,
        x as isize + radius,
        0..band.width(),
    );
    for y in clip(
        y as isize - radius + 1,
        y as isize + radius,
        0..band.height(),
    ) {
        band.row_mut(y)[columns.clone()].fill(true);
    }
}

/// The whole numbers from `first` to `last` that lie within `range`.
fn clip(first: isize, last: isize, range: std::ops::Range<usize>) -> std::ops::Range<usize> {
    let bound = |v: isize| v.clamp(range.start as isize, range.end as isize) as usize;
    bound(first)..bound(last + 1)
}

/// Picture and background in linear light.
struct Colors<'a> {
    picture: &'a RgbImage,
    plate: &'a RgbImage,
    /// 128 and up where neither object nor backdrop is known.
    unknown: Option<&'a Mask>,
    /// Linear light of the backdrop by the background's encoded value, per channel.
    expected: [[f32; 256]; 3],
    /// Reciprocal variance of a pixel's light by the background's encoded value, per channel.
    weight: [[f32; 256]; 3],
}

impl<'a> Colors<'a> {
    fn new(picture: &'a RgbImage, plate: &'a RgbImage, photometry: &Photometry) -> Self {
        let linear = srgb::linear_from_srgb();
        Self {
            picture,
            plate,
            unknown: None,
            expected: photometry.gain.map(|gain| linear.map(|l| l * gain)),
            weight: std::array::from_fn(|c| {
                std::array::from_fn(|v| 1.0 / photometry.variance_of_pixel(c, v as f32))
            }),
        }
    }

    /// Whether a pixel, or the one to its right or below, is unknown.
    #[inline]
    fn is_beside_unknown(&self, x: usize, y: usize) -> bool {
        let Some(unknown) = self.unknown else {
            return false;
        };
        let at = |dx: isize, dy: isize| unknown.get(x as isize + dx, y as isize + dy);
        let around = [at(0, 0), at(1, 0), at(0, 1)];
        around.into_iter().flatten().any(|&m| m >= 128)
    }

    #[inline]
    fn light(&self, x: usize, y: usize) -> [f32; 3] {
        let linear = srgb::linear_from_srgb();
        let pixel = self.picture[(x, y)];
        three(|c| linear[usize::from(pixel[c])])
    }

    #[inline]
    fn expected(&self, x: usize, y: usize) -> [f32; 3] {
        let pixel = self.plate[(x, y)];
        three(|c| self.expected[c][usize::from(pixel[c])])
    }

    #[inline]
    fn weight(&self, x: usize, y: usize) -> [f32; 3] {
        let pixel = self.plate[(x, y)];
        three(|c| self.weight[c][usize::from(pixel[c])])
    }
}
