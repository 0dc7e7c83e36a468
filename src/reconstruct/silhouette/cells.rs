//! Means of picture and plate over small cells: less noise and less work for the coarse decision.

use super::region::Region;
use crate::image::{Grid, PixelRect, RgbImage};
use std::ops::Range;

/// A region of the picture cut into square cells.
pub(super) struct Cells {
    /// Side of a cell in pixels.
    pub size: usize,
    /// The pixels that the cells cover.
    pub region: PixelRect,
    /// Mean sRGB-encoded values of the picture.
    pub picture: Grid<[f32; 3]>,
    /// Mean sRGB-encoded values of the plate.
    pub plate: Grid<[f32; 3]>,
    /// For each row of cells those that show a part of the volume; the others can only be backdrop.
    pub in_volume: Vec<Range<usize>>,
}

impl Cells {
    /// Averages over cells of `size` pixels a side; 0 chooses the size.
    pub fn new(picture: &RgbImage, plate: &RgbImage, region: &Region, size: usize) -> Self {
        let (width, height) = region.picture;
        let long_side = region.rect.width().max(region.rect.height());
        let size = match size {
            0 if long_side >= 700 => 4,
            0 if long_side >= 160 => 2,
            0 => 1,
            given => given.min(16),
        };
        // The margin shows the backdrop, from which exposure and noise are learnt.
        let margin = (long_side / 12).max(4 * size + 4);
        let rect = region.rect.grown(margin, width, height);
        let columns = rect.width().div_ceil(size);
        let in_volume = (0..rect.height().div_ceil(size)).map(|row| {
            let y = (rect.y0 + row * size) as f64 + size as f64 / 2.0;
            let (first, last) = region.columns(y, size as f64 + 1.0);
            let cell = |x: f64| ((x - rect.x0 as f64) / size as f64).clamp(0.0, columns as f64);
            cell(first).floor() as usize..cell(last).ceil() as usize
        });
        Self {
            size,
            region: rect,
            picture: means(picture, rect, size),
            plate: means(plate, rect, size),
            in_volume: in_volume.collect(),
        }
    }
}

impl Cells {
    /// The pixels of a cell.
    pub fn pixels(&self, cx: usize, cy: usize) -> PixelRect {
        let (x0, y0) = (
            self.region.x0 + cx * self.size,
            self.region.y0 + cy * self.size,
        );
        PixelRect {
            x0,
            y0,
            x1: (x0 + self.size).min(self.region.x1),
            y1: (y0 + self.size).min(self.region.y1),
        }
    }
}

impl Cells {
    /// The cells of a rectangle, given in cells.
    pub fn cropped(&self, part: PixelRect) -> Self {
        let first = self.pixels(part.x0, part.y0);
        let last = self.pixels(part.x1 - 1, part.y1 - 1);
        let shifted = |range: &Range<usize>| {
            let cell = |c: usize| c.clamp(part.x0, part.x1) - part.x0;
            cell(range.start)..cell(range.end)
        };
        Self {
            size: self.size,
            region: PixelRect {
                x0: first.x0,
                y0: first.y0,
                x1: last.x1,
                y1: last.y1,
            },
            picture: cropped(&self.picture, part),
            plate: cropped(&self.plate, part),
            in_volume: self.in_volume[part.y0..part.y1]
                .iter()
                .map(shifted)
                .collect(),
        }
    }
}

/// A rectangle of a grid.
pub(super) fn cropped<T: Clone>(grid: &Grid<T>, part: PixelRect) -> Grid<T> {
    let mut values = Vec::with_capacity(part.width() * part.height());
    for y in part.y0..part.y1 {
        values.extend_from_slice(&grid.row(y)[part.x0..part.x1]);
    }
    Grid::from_pixels(part.width(), part.height(), values)
}

fn means(image: &RgbImage, rect: PixelRect, size: usize) -> Grid<[f32; 3]> {
    let (columns, rows) = (rect.width().div_ceil(size), rect.height().div_ceil(size));
    let mut means = Grid::filled(columns, rows, [0.0f32; 3]);
    let mut sums = vec![[0u32; 3]; columns];
    // Every second row of a large cell is enough.
    let step = if size >= 4 { 2 } else { 1 };
    for cy in 0..rows {
        sums.fill([0; 3]);
        let y0 = rect.y0 + cy * size;
        let lines = (y0..(y0 + size).min(rect.y1)).step_by(step);
        let count = lines.len();
        for y in lines {
            let row = &image.row(y)[rect.x0..rect.x1];
            match size {
                1 => add_row::<1>(&mut sums, row),
                2 => add_row::<2>(&mut sums, row),
                4 => add_row::<4>(&mut sums, row),
                _ => row.chunks(size).zip(&mut sums).for_each(add_cell),
            }
        }
        for (cx, (mean, sum)) in means.row_mut(cy).iter_mut().zip(&sums).enumerate() {
            let columns = size.min(rect.width() - cx * size);
            let scale = 1.0 / (count * columns) as f32;
            *mean = sum.map(|s| s as f32 * scale);
        }
    }
    means
}

/// Adds a row of pixels to cells whose size the compiler knows.
fn add_row<const SIZE: usize>(sums: &mut [[u32; 3]], row: &[[u8; 3]]) {
    let (whole, rest) = row.as_chunks::<SIZE>();
    for (sum, cell) in sums.iter_mut().zip(whole) {
        for c in 0..3 {
            sum[c] += cell.iter().map(|p| u32::from(p[c])).sum::<u32>();
        }
    }
    if !rest.is_empty() {
        sums.iter_mut()
            .skip(whole.len())
            .for_each(|sum| add_cell((rest, sum)));
    }
}

fn add_cell((cell, sum): (&[[u8; 3]], &mut [u32; 3])) {
    for pixel in cell {
        for c in 0..3 {
            sum[c] += u32::from(pixel[c]);
        }
    }
}
