//! Means of picture and background over small cells: less noise and less work for the coarse decision.

use super::region::Region;
use crate::array::three;
use crate::image::{Grid, Mask, PixelRect, RgbImage};
use std::ops::Range;

/// A region of the picture cut into square cells.
pub(super) struct Cells {
    /// Side of a cell in pixels.
    pub size: usize,
    /// The pixels that the cells cover.
    pub region: PixelRect,
    /// Mean sRGB-encoded values of the picture.
    pub picture: Grid<[f32; 3]>,
    /// Mean sRGB-encoded values of the background.
    pub plate: Grid<[f32; 3]>,
    /// For each row of cells those that show a part of the volume; the others can only be backdrop.
    pub in_volume: Vec<Range<usize>>,
    /// Whether all pixels of a cell are hidden; `None` where none is.
    pub hidden: Option<Grid<bool>>,
}

impl Cells {
    /// Averages over cells of `size` pixels a side; 0 chooses the size.
    pub(super) fn new(
        (picture, plate): (&RgbImage, &RgbImage),
        hidden: Option<&Mask>,
        region: &Region,
        size: usize,
    ) -> Self {
        let (width, height) = region.picture;
        let long_side = region.rect.width().max(region.rect.height());
        let size = match size {
            0 if long_side >= 700 => 4,
            0 if long_side >= 160 => 2,
            0 => 1,
            given => given,
        };
        // The margin shows the backdrop, from which exposure and noise are learnt.
        let margin = (long_side / 12).max(4 * size + 4);
        let rect = region.rect.grown(margin, width, height);
        let columns = rect.width().div_ceil(size);
        let in_volume = (0..rect.height().div_ceil(size)).map(|row| {
            let y = (rect.y0 + row * size) as f64 + size as f64 / 2.0;
            let (first, last) = region.columns(y, size as f64 + 1.0);
            let cell = |x: f64| ((x - rect.x0 as f64) / size as f64).clamp(0.0, columns as f64);
            let start = cell(first).floor() as usize;
            start..(cell(last).ceil() as usize).max(start)
        });
        let of = |image| move || means(image, rect, size);
        let (picture, plate) = rayon::join(of(picture), of(plate));
        Self {
            size,
            region: rect,
            picture,
            plate,
            in_volume: in_volume.collect(),
            hidden: hidden.map(|mask| hidden_cells(mask, rect, size)),
        }
    }
}

impl Cells {
    /// Whether nothing is seen of a cell.
    pub(super) fn is_hidden(&self, cell: usize) -> bool {
        let hidden = self.hidden.as_ref();
        hidden.is_some_and(|hidden| hidden.pixels()[cell])
    }

    /// Sets the cells of which nothing is seen.
    pub(super) fn mark_hidden(&self, object: &mut Grid<bool>, value: bool) {
        let Some(hidden) = &self.hidden else {
            return;
        };
        for (object, &hidden) in object.pixels_mut().iter_mut().zip(hidden.pixels()) {
            if hidden {
                *object = value;
            }
        }
    }

    /// The pixels of a cell.
    pub(super) fn pixels(&self, cx: usize, cy: usize) -> PixelRect {
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
    pub(super) fn cropped(&self, part: PixelRect) -> Self {
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
            hidden: self.hidden.as_ref().map(|hidden| cropped(hidden, part)),
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

/// The cells of which all pixels are hidden.
fn hidden_cells(mask: &Mask, rect: PixelRect, size: usize) -> Grid<bool> {
    let (columns, rows) = (rect.width().div_ceil(size), rect.height().div_ceil(size));
    Grid::from_fn(columns, rows, |cx, cy| {
        let (x0, y0) = (rect.x0 + cx * size, rect.y0 + cy * size);
        let (x1, y1) = ((x0 + size).min(rect.x1), (y0 + size).min(rect.y1));
        (y0..y1).all(|y| mask.row(y)[x0..x1].iter().all(|&m| m >= 128))
    })
}

fn means(image: &RgbImage, rect: PixelRect, size: usize) -> Grid<[f32; 3]> {
    let (columns, rows) = (rect.width().div_ceil(size), rect.height().div_ceil(size));
    let mut means = Grid::filled(columns, rows, [0.0f32; 3]);
    // Sums over the rows of a cell, for each of a pixel's three values.
    let mut sums = vec![0u16; 3 * rect.width()];
    // Every second row of a large cell is enough.
    let step = if size >= 4 { 2 } else { 1 };
    for cy in 0..rows {
        sums.fill(0);
        let y0 = rect.y0 + cy * size;
        let lines = (y0..(y0 + size).min(rect.y1)).step_by(step);
        let count = lines.len();
        for y in lines {
            let row = image.row(y)[rect.x0..rect.x1].as_flattened();
            for (sum, &value) in sums.iter_mut().zip(row) {
                *sum += u16::from(value);
            }
        }
        let means = means.row_mut(cy);
        match size {
            1 => across::<3>(&sums, count, means),
            2 => across::<6>(&sums, count, means),
            4 => across::<12>(&sums, count, means),
            _ => {
                for (mean, cell) in means.iter_mut().zip(sums.chunks(3 * size)) {
                    *mean = mean_of(cell, count);
                }
            }
        }
    }
    means
}

/// Means of cells of which a row's number of values is known when this is compiled.
fn across<const VALUES: usize>(sums: &[u16], lines: usize, means: &mut [[f32; 3]]) {
    let (whole, rest) = sums.as_chunks::<VALUES>();
    for (mean, cell) in means.iter_mut().zip(whole) {
        *mean = mean_of(cell, lines);
    }
    if !rest.is_empty()
        && let Some(last) = means.last_mut()
    {
        *last = mean_of(rest, lines);
    }
}

#[inline(always)]
fn mean_of(sums: &[u16], lines: usize) -> [f32; 3] {
    let mut total = [0u32; 3];
    for pixel in sums.as_chunks::<3>().0 {
        for c in 0..3 {
            total[c] += u32::from(pixel[c]);
        }
    }
    let scale = 3.0 / (sums.len() * lines) as f32;
    three(|c| total[c] as f32 * scale)
}
