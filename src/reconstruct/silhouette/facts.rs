//! What is worth knowing of a silhouette besides its contour: what the verdict and a person judge it by.

use super::cells::Cells;
use super::components::Tidied;
use super::contour::ContourFacts;
use super::photometry::Photometry;
use crate::image::{Mask, PixelRect, RgbImage};

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
    /// What the difference to a background plate showed; `None` for a mask.
    pub difference: Option<DifferenceFacts>,
}

/// What the difference to a background plate showed.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub struct DifferenceFacts {
    /// Light of the picture over that of the plate, where both show the backdrop, per channel.
    pub gain: [f32; 3],
    /// Standard deviation of a pixel's difference, in sRGB units, per channel.
    pub noise: [f32; 3],
    /// Mean difference between object and plate, in sRGB units (the largest channel's).
    pub mean_difference: f32,
    /// Median contrast of object and backdrop along the contour, in standard deviations of a pixel's noise.
    pub contrast: f32,
    /// Share of the contour whose contrast is too weak to locate it.
    pub weak_contour: f32,
    /// Share of the backdrop around the volume that is not as the plate shows it.
    pub mismatch: f32,
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
    /// Of a level set within `region`.
    pub(super) fn of_level(picture: &RgbImage, level: &Mask, region: PixelRect) -> Self {
        let (mut sum, mut object, mut over, mut under) = (0u64, 0usize, 0usize, 0usize);
        for y in region.y0..region.y1 {
            let levels = &level.row(y)[region.x0..region.x1];
            let pixels = &picture.row(y)[region.x0..region.x1];
            for (&l, pixel) in levels.iter().zip(pixels) {
                sum += u64::from(l);
                if l >= 128 {
                    object += 1;
                    over += usize::from(pixel.contains(&255));
                    under += usize::from(pixel.iter().all(|&v| v <= 3));
                }
            }
        }
        let share = |n: usize| n as f32 / object.max(1) as f32;
        Self {
            area_px: sum as f64 / 255.0,
            edge_px: edge_pixels(level),
            overexposed: share(over),
            underexposed: share(under),
            blur_px: None,
            difference: None,
        }
    }

    /// Of a silhouette from a background plate.
    pub(super) fn of_difference(
        picture: &RgbImage,
        level: &Mask,
        cells: &Cells,
        photometry: &Photometry,
        contour: ContourFacts,
        tidied: Tidied,
    ) -> Self {
        Self {
            difference: Some(DifferenceFacts {
                gain: photometry.gain,
                noise: photometry.pixel_noise,
                mean_difference: mean_difference(level, cells, photometry),
                contrast: contour.contrast,
                weak_contour: contour.weak,
                mismatch: photometry.mismatch,
                pieces: tidied.pieces,
                dropped_pieces: tidied.dropped,
                holes: tidied.holes,
                filled_holes: tidied.filled,
            }),
            ..Self::of_level(picture, level, cells.region)
        }
    }
}

fn edge_pixels(level: &Mask) -> [usize; 4] {
    let (w, h) = (level.width(), level.height());
    let row = |y: usize| level.row(y).iter().filter(|&&l| l >= 128).count();
    let column = |x: usize| (0..h).filter(|&y| level[(x, y)] >= 128).count();
    [column(0), row(0), column(w - 1), row(h - 1)]
}

fn mean_difference(level: &Mask, cells: &Cells, photometry: &Photometry) -> f32 {
    let (mut sum, mut count) = (0.0, 0);
    for cy in 0..cells.picture.height() {
        for cx in 0..cells.picture.width() {
            let pixels = cells.pixels(cx, cy);
            if level[(pixels.x0, pixels.y0)] >= 128 {
                let (picture, plate) = (cells.picture[(cx, cy)], cells.plate[(cx, cy)]);
                let difference = |c: usize| photometry.error(picture[c], plate[c], c).abs();
                sum += (0..3).map(difference).fold(0.0, f32::max);
                count += 1;
            }
        }
    }
    sum / count.max(1) as f32
}

/// The pixels of `region` that are object: their rectangle, empty where there are none.
pub(super) fn bounds(level: &Mask, region: PixelRect) -> PixelRect {
    let mut bounds: Option<PixelRect> = None;
    for y in region.y0..region.y1 {
        let row = &level.row(y)[region.x0..region.x1];
        let Some(first) = row.iter().position(|&l| l >= 128) else {
            continue;
        };
        let last = row.iter().rposition(|&l| l >= 128).unwrap_or(first);
        let (x0, x1) = (region.x0 + first, region.x0 + last + 1);
        let b = bounds.get_or_insert(PixelRect {
            x0,
            y0: y,
            x1,
            y1: y,
        });
        *b = PixelRect {
            x0: b.x0.min(x0),
            y0: b.y0,
            x1: b.x1.max(x1),
            y1: y + 1,
        };
    }
    bounds.unwrap_or_default()
}
