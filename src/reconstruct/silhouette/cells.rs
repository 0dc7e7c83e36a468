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

fn means(image: &RgbImage, rect: PixelRect, size: usize) -> Grid<[f32; 3]> {
    let (columns, rows) = (rect.width().div_ceil(size), rect.height().div_ceil(size));
    let mut means = Grid::filled(columns, rows, [0.0f32; 3]);
    let mut sums = vec![[0u32; 3]; columns];
    for cy in 0..rows {
        sums.fill([0; 3]);
        let y0 = rect.y0 + cy * size;
        let y1 = (y0 + size).min(rect.y1);
        for y in y0..y1 {
            add_row(&mut sums, &image.row(y)[rect.x0..rect.x1], size);
        }
        for (cx, (mean, sum)) in means.row_mut(cy).iter_mut().zip(&sums).enumerate() {
            let columns = size.min(rect.width() - cx * size);
            let scale = 1.0 / ((y1 - y0) * columns) as f32;
            *mean = sum.map(|s| s as f32 * scale);
        }
    }
    means
}

fn add_row(sums: &mut [[u32; 3]], pixels: &[[u8; 3]], size: usize) {
    for (sum, cell) in sums.iter_mut().zip(pixels.chunks(size)) {
        for pixel in cell {
            for c in 0..3 {
                sum[c] += u32::from(pixel[c]);
            }
        }
    }
}
