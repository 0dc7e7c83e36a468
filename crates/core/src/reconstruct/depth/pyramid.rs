//! The pyramid of section 2.D: depth and guide are halved, the coarsest level is filtered, and every finer
//! level has its holes filled from the one above before it is filtered itself.

use super::joint_bilateral::{Kernel, filter};
use crate::image::Grid;

/// One level: depth with holes, its guide, and where the object can be.
pub(super) struct PyramidLevel {
    /// Depth in metres, 0 is a hole.
    pub depth: Grid<f32>,
    /// The guide's channels.
    pub guide: Vec<Grid<f32>>,
    /// Pixels that may be filled.
    pub inside: Grid<bool>,
}

/// Filters `finest` through a pyramid of `levels` levels, itself included. Holes within `inside` are filled
/// as far as the kernels reach; nothing outside is.
pub(super) fn filter_pyramid(
    finest: PyramidLevel,
    levels: usize,
    kernel: &Kernel,
    step: f32,
) -> Grid<f32> {
    let mut pyramid = vec![finest];
    while pyramid.len() < levels {
        let below = &pyramid[pyramid.len() - 1];
        if below.depth.width() < 2 || below.depth.height() < 2 {
            break;
        }
        pyramid.push(below.halved(step));
    }
    let mut coarser: Option<Grid<f32>> = None;
    for level in pyramid.iter().rev() {
        let carried = match &coarser {
            Some(coarser) => level.with_holes_from(coarser),
            None => level.depth.clone(),
        };
        let mut filtered = filter(&carried, &level.guide, kernel);
        for (z, &inside) in filtered.pixels_mut().iter_mut().zip(level.inside.pixels()) {
            if !inside {
                *z = 0.0;
            }
        }
        coarser = Some(filtered);
    }
    coarser.unwrap_or_default()
}

impl PyramidLevel {
    /// The next coarser level: means of two by two pixels. Where two depths more than `step` apart meet in
    /// one coarse pixel, the nearer alone counts, so that no depth arises between them.
    fn halved(&self, step: f32) -> Self {
        let (width, height) = (
            self.depth.width().div_ceil(2),
            self.depth.height().div_ceil(2),
        );
        let depth = Grid::from_fn(width, height, |x, y| {
            let nearest = self.four(&self.depth, x, y).filter(|&z| z > 0.0);
            let nearest = nearest.fold(f32::INFINITY, f32::min);
            mean(
                self.four(&self.depth, x, y)
                    .filter(|&z| z > 0.0 && z <= nearest + step),
            )
        });
        let halve = |channel| Grid::from_fn(width, height, |x, y| mean(self.four(channel, x, y)));
        Self {
            depth,
            guide: self.guide.iter().map(halve).collect(),
            inside: Grid::from_fn(width, height, |x, y| {
                self.four(&self.inside, x, y).any(|inside| inside)
            }),
        }
    }

    /// The up to four pixels under a coarse one.
    fn four<'a, T: Copy>(
        &self,
        of: &'a Grid<T>,
        x: usize,
        y: usize,
    ) -> impl Iterator<Item = T> + 'a {
        let at = move |dx: usize, dy: usize| {
            of.get((2 * x + dx) as isize, (2 * y + dy) as isize)
                .copied()
        };
        [at(0, 0), at(1, 0), at(0, 1), at(1, 1)]
            .into_iter()
            .flatten()
    }

    /// Depth with its holes filled from the coarser level: the mean of the four coarse pixels around,
    /// weighted bilinearly, of those that have depth.
    fn with_holes_from(&self, coarser: &Grid<f32>) -> Grid<f32> {
        Grid::from_fn(self.depth.width(), self.depth.height(), |x, y| {
            let own = self.depth[(x, y)];
            if own > 0.0 || !self.inside[(x, y)] {
                return own;
            }
            let (mut sum, mut weights) = (0.0, 0.0);
            // A pixel's centre lies a quarter of a coarse pixel beside its coarse pixel's centre.
            for (cx, wx) in [(x as isize / 2, 0.75), (x as isize / 2 + side(x), 0.25)] {
                for (cy, wy) in [(y as isize / 2, 0.75), (y as isize / 2 + side(y), 0.25)] {
                    let z = coarser.get(cx, cy).copied().unwrap_or(0.0);
                    if z > 0.0 {
                        sum += wx * wy * z;
                        weights += wx * wy;
                    }
                }
            }
            if weights > 0.0 { sum / weights } else { 0.0 }
        })
    }
}

/// Which coarse neighbour a pixel is nearer to.
fn side(x: usize) -> isize {
    if x.is_multiple_of(2) { -1 } else { 1 }
}

fn mean(values: impl Iterator<Item = f32>) -> f32 {
    let (sum, count) = values.fold((0.0, 0.0), |(s, n), v| (s + v, n + 1.0));
    if count > 0.0 { sum / count } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    const KERNEL: Kernel = Kernel {
        half_width_px: 3,
        spatial_sigma_px: 1.0,
        range_sigma: 0.1,
        depth_sigma: None,
    };

    fn level(depth: Grid<f32>) -> PyramidLevel {
        PyramidLevel {
            guide: vec![depth.map(|_| 0.5)],
            inside: depth.map(|_| true),
            depth,
        }
    }

    #[test]
    fn coarse_levels_fill_a_hole_wider_than_the_kernel() {
        let hole = |x: usize, y: usize| (10..30).contains(&x) && (10..30).contains(&y);
        let depth = Grid::from_fn(40, 40, |x, y| if hole(x, y) { 0.0 } else { 0.85 });
        let alone = filter_pyramid(level(depth.clone()), 1, &KERNEL, 0.012);
        assert_eq!(alone[(20, 20)], 0.0, "beyond the kernel's reach");
        let carried = filter_pyramid(level(depth), 4, &KERNEL, 0.012);
        for z in carried.pixels() {
            assert!((z - 0.85).abs() < 1e-5, "{z}");
        }
    }

    #[test]
    fn nothing_is_filled_outside() {
        let mut level = level(Grid::from_fn(16, 16, |x, _| if x < 8 { 0.85 } else { 0.0 }));
        level.inside = Grid::from_fn(16, 16, |x, _| x < 8);
        let out = filter_pyramid(level, 4, &KERNEL, 0.012);
        for y in 0..16 {
            for x in 0..16 {
                assert_eq!(out[(x, y)] > 0.0, x < 8);
            }
        }
    }

    #[test]
    fn halving_makes_no_depth_between_two() {
        let depth = Grid::from_fn(8, 8, |x, _| if x < 3 { 0.80 } else { 0.90 });
        let half = level(depth).halved(0.012);
        let expected = [0.80, 0.80, 0.90, 0.90];
        for (x, expected) in expected.into_iter().enumerate() {
            assert!((half.depth[(x, 1)] - expected).abs() < 1e-6);
        }
    }
}
