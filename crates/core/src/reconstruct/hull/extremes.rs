//! The smallest and largest value in any rectangle of a picture, from a pyramid of blocks. They quickly decide that
//! a whole cell lies inside or outside a silhouette.

use crate::image::Grid;

/// Blocks of 2, 4, 8 … pixels a side with their smallest and largest values.
pub(super) struct Extremes<T> {
    levels: Vec<Grid<[T; 2]>>,
}

impl<T: Copy + PartialOrd> Extremes<T> {
    /// # Panics
    /// If the picture has no pixel.
    pub(super) fn new(picture: &Grid<T>) -> Self {
        let mut levels = vec![halve_picture(picture)];
        while levels
            .last()
            .is_some_and(|l| l.width() > 1 || l.height() > 1)
        {
            let coarser = halve(&levels[levels.len() - 1]);
            levels.push(coarser);
        }
        Self { levels }
    }

    /// Bounds of the values in the pixels x0..=x1, y0..=y1, which must lie within the picture. The bounds
    /// may be wider than the rectangle's own, never narrower.
    pub(super) fn within(&self, [x0, x1]: [usize; 2], [y0, y1]: [usize; 2]) -> [T; 2] {
        let longest = (x1 - x0).max(y1 - y0) + 1;
        // Blocks of a quarter of the rectangle: tight enough, and at most 6 x 6 of them.
        let level = (longest / 4).max(2).ilog2() as usize - 1;
        let level = level.min(self.levels.len() - 1);
        let (shift, blocks) = (level + 1, &self.levels[level]);
        let mut bounds = blocks[(x0 >> shift, y0 >> shift)];
        for y in y0 >> shift..=y1 >> shift {
            for &block in &blocks.row(y)[x0 >> shift..=x1 >> shift] {
                bounds = join(bounds, block);
            }
        }
        bounds
    }
}

#[inline(always)]
fn join<T: Copy + PartialOrd>(a: [T; 2], b: [T; 2]) -> [T; 2] {
    [
        if b[0] < a[0] { b[0] } else { a[0] },
        if b[1] > a[1] { b[1] } else { a[1] },
    ]
}

fn halve<T: Copy + PartialOrd>(fine: &Grid<[T; 2]>) -> Grid<[T; 2]> {
    halved(fine, join)
}

/// The first level, without pairing each pixel with itself first.
fn halve_picture<T: Copy + PartialOrd>(picture: &Grid<T>) -> Grid<[T; 2]> {
    halved(picture, |a, b| join([a; 2], [b; 2]))
}

/// Joins pixels of two columns and two rows, of one where there is no second.
#[inline(always)]
fn halved<P: Copy, T: Copy + PartialOrd>(
    fine: &Grid<P>,
    pair: impl Fn(P, P) -> [T; 2],
) -> Grid<[T; 2]> {
    let (width, height) = (fine.width().div_ceil(2), fine.height().div_ceil(2));
    let mut blocks = Vec::with_capacity(width * height);
    for y in 0..height {
        let top = fine.row(2 * y);
        let bottom = fine.row((2 * y + 1).min(fine.height() - 1));
        let (tops, bottoms) = (top.as_chunks::<2>().0, bottom.as_chunks::<2>().0);
        for (a, b) in tops.iter().zip(bottoms) {
            blocks.push(join(pair(a[0], a[1]), pair(b[0], b[1])));
        }
        if fine.width() % 2 == 1 {
            let (a, b) = (top[fine.width() - 1], bottom[fine.width() - 1]);
            blocks.push(pair(a, b));
        }
    }
    Grid::from_pixels(width, height, blocks)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn bounds_hold_every_value_in_the_rectangle(
            width in 1..40usize, height in 1..40usize, seed in any::<u32>(),
            corners in any::<[u16; 4]>(),
        ) {
            let value = |x: usize, y: usize| (seed ^ (x * 31 + y * 57) as u32).wrapping_mul(2_654_435_761) >> 24;
            let picture = Grid::from_fn(width, height, |x, y| value(x, y) as u8);
            let sorted = |a: u16, b: u16, n: usize| {
                let (a, b) = (a as usize % n, b as usize % n);
                [a.min(b), a.max(b)]
            };
            let (xs, ys) = (sorted(corners[0], corners[1], width), sorted(corners[2], corners[3], height));
            let [low, high] = Extremes::new(&picture).within(xs, ys);
            for y in ys[0]..=ys[1] {
                for x in xs[0]..=xs[1] {
                    prop_assert!((low..=high).contains(&picture[(x, y)]));
                }
            }
            if xs == [0, width - 1] && ys == [0, height - 1] {
                prop_assert_eq!(low, *picture.pixels().iter().min().unwrap());
                prop_assert_eq!(high, *picture.pixels().iter().max().unwrap());
            }
        }
    }
}
