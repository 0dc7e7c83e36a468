//! The one container for pictures: a dense, row-major grid of pixels of any type.

use super::PixelRect;
use rayon::prelude::*;
use std::ops::{Index, IndexMut};

/// A row-major picture of `width` x `height` pixels. Pixel centres are at whole numbers: the centre of the
/// top left pixel is (0, 0).
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Grid<T> {
    width: usize,
    height: usize,
    pixels: Vec<T>,
}

impl<T: Clone> Grid<T> {
    /// A grid with every pixel set to `value`.
    pub fn filled(width: usize, height: usize, value: T) -> Self {
        Self {
            width,
            height,
            pixels: vec![value; width * height],
        }
    }
}

impl<T> Grid<T> {
    /// Wraps `pixels`, which holds rows from top to bottom.
    ///
    /// # Panics
    /// If `pixels` does not hold exactly `width * height` values.
    pub fn from_pixels(width: usize, height: usize, pixels: Vec<T>) -> Self {
        assert_eq!(pixels.len(), width * height, "a {width}x{height} grid");
        Self {
            width,
            height,
            pixels,
        }
    }

    /// Computes every pixel from its coordinates.
    pub fn from_fn(width: usize, height: usize, mut f: impl FnMut(usize, usize) -> T) -> Self {
        let mut pixels = Vec::with_capacity(width * height);
        for y in 0..height {
            for x in 0..width {
                pixels.push(f(x, y));
            }
        }
        Self {
            width,
            height,
            pixels,
        }
    }

    /// [`Self::from_fn`] on all threads: worth it for pixels that take long.
    pub fn from_fn_parallel(
        width: usize,
        height: usize,
        f: impl Fn(usize, usize) -> T + Sync,
    ) -> Self
    where
        T: Send,
    {
        let rows = (0..height).into_par_iter().with_min_len(16);
        let row = |y| (0..width).map(move |x| (x, y));
        let pixels = rows.flat_map_iter(row).map(|(x, y)| f(x, y)).collect();
        Self {
            width,
            height,
            pixels,
        }
    }

    /// Width in pixels.
    #[inline]
    pub fn width(&self) -> usize {
        self.width
    }

    /// Height in pixels.
    #[inline]
    pub fn height(&self) -> usize {
        self.height
    }

    /// Whether `other` has the same width and height.
    pub fn same_size<U>(&self, other: &Grid<U>) -> bool {
        self.width == other.width && self.height == other.height
    }

    /// The pixel at (x, y), or `None` outside the grid.
    #[inline]
    pub fn get(&self, x: isize, y: isize) -> Option<&T> {
        let inside = x >= 0 && y >= 0 && (x as usize) < self.width && (y as usize) < self.height;
        inside.then(|| &self.pixels[y as usize * self.width + x as usize])
    }

    /// Row `y`, left to right.
    #[inline]
    pub fn row(&self, y: usize) -> &[T] {
        &self.pixels[y * self.width..(y + 1) * self.width]
    }

    /// Row `y`, to be written.
    #[inline]
    pub fn row_mut(&mut self, y: usize) -> &mut [T] {
        &mut self.pixels[y * self.width..(y + 1) * self.width]
    }

    /// All pixels, row by row.
    pub fn pixels(&self) -> &[T] {
        &self.pixels
    }

    /// All pixels, to be written.
    pub fn pixels_mut(&mut self) -> &mut [T] {
        &mut self.pixels
    }

    /// The smallest rectangle around the pixels of `part` that are `wanted`; `None` where there are none.
    pub fn extent(&self, part: PixelRect, wanted: impl Fn(&T) -> bool) -> Option<PixelRect> {
        let mut extent: Option<PixelRect> = None;
        for y in part.y0..part.y1 {
            let row = &self.row(y)[part.x0..part.x1];
            let Some(first) = row.iter().position(&wanted) else {
                continue;
            };
            let last = row.iter().rposition(&wanted).unwrap_or(first);
            let (x0, x1) = (part.x0 + first, part.x0 + last + 1);
            extent = Some(extent.map_or(
                PixelRect {
                    x0,
                    y0: y,
                    x1,
                    y1: y + 1,
                },
                |e| PixelRect {
                    x0: e.x0.min(x0),
                    y0: e.y0,
                    x1: e.x1.max(x1),
                    y1: y + 1,
                },
            ));
        }
        extent
    }

    /// A grid of the same size with `f` applied to every pixel.
    pub fn map<U>(&self, f: impl FnMut(&T) -> U) -> Grid<U> {
        let pixels = self.pixels.iter().map(f).collect();
        Grid {
            width: self.width,
            height: self.height,
            pixels,
        }
    }
}

impl<T> Index<(usize, usize)> for Grid<T> {
    type Output = T;

    #[inline]
    fn index(&self, (x, y): (usize, usize)) -> &T {
        debug_assert!(x < self.width);
        &self.pixels[y * self.width + x]
    }
}

impl<T> IndexMut<(usize, usize)> for Grid<T> {
    #[inline]
    fn index_mut(&mut self, (x, y): (usize, usize)) -> &mut T {
        debug_assert!(x < self.width);
        &mut self.pixels[y * self.width + x]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_extent_holds_all_that_is_wanted_and_no_more() {
        let grid = Grid::from_fn(9, 7, |x, y| (x, y) == (2, 5) || (x, y) == (6, 1) || x == 8);
        let part = PixelRect {
            x0: 1,
            y0: 0,
            x1: 8,
            y1: 7,
        };
        let found = PixelRect {
            x0: 2,
            y0: 1,
            x1: 7,
            y1: 6,
        };
        assert_eq!(grid.extent(part, |&v| v), Some(found));
        let row = PixelRect { y1: 1, ..part };
        assert_eq!(grid.extent(row, |&v| v), None);
    }
}
