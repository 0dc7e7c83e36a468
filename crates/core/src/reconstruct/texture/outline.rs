//! A chart's outline in cells of the atlas, for packing: the cells within its own gutter's width of one of its
//! triangles.

use crate::image::CellShape;
use std::ops::Range;

/// Collects a chart's triangles; `new` is given its width and height in texels, gutters included.
pub(super) struct Outline {
    rows: Vec<Vec<Range<usize>>>,
    /// Texels along a cell's side.
    cell: f32,
    gutter: f32,
    columns: usize,
}

impl Outline {
    pub(super) fn new([width, height]: [usize; 2], cell: usize, gutter: usize) -> Self {
        Self {
            rows: vec![Vec::new(); height.div_ceil(cell)],
            cell: cell as f32,
            // The texel of a triangle's middle is painted even where the triangle does not reach its centre.
            gutter: gutter as f32 + 0.5,
            columns: width.div_ceil(cell),
        }
    }

    /// Adds a triangle, given by its corners from the centre of the chart's top left texel.
    pub(super) fn add(&mut self, corners: [[f32; 2]; 3]) {
        let [low, high] =
            [f32::min, f32::max].map(|of| of(of(corners[0][1], corners[1][1]), corners[2][1]));
        let first = self.row(low - self.gutter);
        let last = self.row(high + self.gutter);
        for row in first..=last {
            let top = row as f32 * self.cell - 0.5 - self.gutter;
            let bottom = top + self.cell + 2.0 * self.gutter;
            let Some([left, right]) = extent(corners, [top, bottom]) else {
                continue;
            };
            let column = |x: f32| (((x + 0.5) / self.cell).max(0.0) as usize).min(self.columns - 1);
            let run = column(left - self.gutter)..column(right + self.gutter) + 1;
            match self.rows[row].last_mut() {
                // Neighbours follow each other mostly.
                Some(previous) if run.start <= previous.end && previous.start <= run.end => {
                    *previous = previous.start.min(run.start)..previous.end.max(run.end);
                }
                _ => self.rows[row].push(run),
            }
        }
    }

    pub(super) fn into_shape(self) -> CellShape {
        CellShape::new(self.rows)
    }

    fn row(&self, y: f32) -> usize {
        (((y + 0.5) / self.cell).max(0.0) as usize).min(self.rows.len() - 1)
    }
}

/// From where to where a triangle reaches sideways between two heights; `None` where it is not between them.
fn extent(corners: [[f32; 2]; 3], [top, bottom]: [f32; 2]) -> Option<[f32; 2]> {
    let mut found: Option<[f32; 2]> = None;
    let mut take = |x: f32| {
        let [left, right] = found.unwrap_or([x, x]);
        found = Some([left.min(x), right.max(x)]);
    };
    for i in 0..3 {
        let (a, b) = (corners[i], corners[(i + 1) % 3]);
        if (top..=bottom).contains(&a[1]) {
            take(a[0]);
        }
        for y in [top, bottom] {
            if (a[1] < y) != (b[1] < y) {
                take(a[0] + (b[0] - a[0]) * (y - a[1]) / (b[1] - a[1]));
            }
        }
    }
    found
}
