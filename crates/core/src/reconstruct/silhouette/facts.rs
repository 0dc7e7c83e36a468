//! Facts about a silhouette besides its contour, by which the verdict and a person judge it.

use super::cells::Cells;
use super::components::MaskRepairs;
use super::contour::ContourFacts;
use super::photometry::Photometry;
use crate::image::{Grid, Mask, PixelRect, RgbImage};

/// How a silhouette came out.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub struct Facts {
    /// The object's area in pixels.
    pub area_px: f64,
    /// The object's pixels on the picture's left, top, right and bottom edge: there the frame cuts it.
    pub edge_px: [usize; 4],
    /// Share of the object's pixels with a channel at 255.
    pub overexposed: f32,
    /// Share of the object's pixels with all channels at 3 or less.
    pub underexposed: f32,
    /// Standard deviation in pixels of the blur across the contour; `None` where it could not be measured.
    pub blur_px: Option<f32>,
    /// What the difference to a background showed; `None` for a mask.
    pub difference: Option<DifferenceFacts>,
    /// Pixels of which the silhouette says nothing, because they are ignored or beside such; `None` where none are.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unknown_px: Option<usize>,
}

/// What the difference to a background showed.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub struct DifferenceFacts {
    /// Light of the picture over that of the background, where both show the backdrop, per channel.
    pub gain: [f32; 3],
    /// Standard deviation of a pixel's difference, in sRGB units, per channel.
    pub noise: [f32; 3],
    /// The same of the mean over a cell, which tells object from backdrop: larger than a pixel's where the
    /// object was taken for noise.
    pub cell_noise: [f32; 3],
    /// Mean difference between object and background, in sRGB units (the largest channel's).
    pub mean_difference: f32,
    /// Median contrast of object and backdrop along the contour, in standard deviations of a pixel's noise.
    pub contrast: f32,
    /// Share of the contour whose contrast is too weak to locate it.
    pub weak_contour: f32,
    /// Share of the backdrop around the volume that differs from the background.
    pub mismatch: f32,
    /// Share of the object that is no brighter than the backdrop, lit or in a shadow, and that only an outline
    /// distinguishes from it; `None` in a picture with colours.
    pub told_by_outline: Option<f32>,
    /// Separate pieces of the silhouette.
    pub pieces: usize,
    /// Specks that were dropped.
    pub dropped_pieces: usize,
    /// Holes of the silhouette.
    pub holes: usize,
    /// Pinholes that were filled.
    pub filled_holes: usize,
}

impl Facts {
    /// Of a level set whose object has the given `bounds`.
    pub(super) fn of_level(picture: &RgbImage, level: &Mask, bounds: PixelRect) -> Self {
        // The contour's outer half lies beyond.
        let region = bounds.grown(2, level.width(), level.height());
        let (mut sum, mut object, mut over, mut under) = (0u64, 0usize, 0usize, 0usize);
        for y in region.y0..region.y1 {
            let levels = &level.row(y)[region.x0..region.x1];
            let pixels = &picture.row(y)[region.x0..region.x1];
            sum += levels.iter().map(|&l| u64::from(l)).sum::<u64>();
            for (&l, &[r, g, b]) in levels.iter().zip(pixels) {
                let is_object = l >= 128;
                object += usize::from(is_object);
                over += usize::from(is_object && r.max(g).max(b) == 255);
                under += usize::from(is_object && r.max(g).max(b) <= 3);
            }
        }
        let share = |n: usize| n as f32 / object.max(1) as f32;
        Self {
            area_px: sum as f64 / 255.0,
            edge_px: edge_pixels(level, region),
            overexposed: share(over),
            underexposed: share(under),
            blur_px: None,
            difference: None,
            unknown_px: None,
        }
    }
}

impl DifferenceFacts {
    /// Of the cells that were found to be object, and what was found on the way to them.
    pub(super) fn new(
        cells: &Cells,
        object: &Grid<bool>,
        photometry: &Photometry,
        contour: ContourFacts,
        tidied: MaskRepairs,
    ) -> Self {
        Self {
            gain: photometry.gain,
            noise: photometry.pixel_noise,
            cell_noise: photometry.noise,
            mean_difference: mean_difference(cells, object, photometry),
            contrast: contour.contrast,
            weak_contour: contour.weak,
            mismatch: photometry.mismatch,
            told_by_outline: None,
            pieces: tidied.pieces,
            dropped_pieces: tidied.dropped,
            holes: tidied.holes,
            filled_holes: tidied.filled,
        }
    }
}

/// Outside `region` there is no object.
fn edge_pixels(level: &Mask, region: PixelRect) -> [usize; 4] {
    let (w, h) = (level.width(), level.height());
    let is_object = |l: u8| usize::from(l >= 128);
    let row = |y: usize| level.row(y).iter().map(|&l| is_object(l)).sum();
    let column = |x: usize| {
        (region.y0..region.y1)
            .map(|y| is_object(level[(x, y)]))
            .sum()
    };
    [
        if region.x0 == 0 { column(0) } else { 0 },
        if region.y0 == 0 { row(0) } else { 0 },
        if region.x1 == w { column(w - 1) } else { 0 },
        if region.y1 == h { row(h - 1) } else { 0 },
    ]
}

fn mean_difference(cells: &Cells, object: &Grid<bool>, photometry: &Photometry) -> f32 {
    let (mut sum, mut count) = (0.0, 0);
    for i in (0..object.pixels().len()).filter(|&i| object.pixels()[i]) {
        let (picture, plate) = (cells.picture.pixels()[i], cells.plate.pixels()[i]);
        let difference = |c: usize| (picture[c] - photometry.expected(c, plate[c])).abs();
        sum += (0..3).map(difference).fold(0.0, f32::max);
        count += 1;
    }
    sum / count.max(1) as f32
}

/// The pixels of `region` that are object: their rectangle, empty where there are none.
pub(super) fn bounds(level: &Mask, region: PixelRect) -> PixelRect {
    level.extent(region, |&l| l >= 128).unwrap_or_default()
}
