//! The segmentation of the difference image (equation 5): adaptive threshold, erosion and dilation, contours
//! and their interiors, kept where the difference is significant.

use super::Parameters;
use crate::image::{Grid, Mask, PixelRect};

/// What speaks for a pixel.
pub(super) struct Evidence<'a> {
    /// The difference is significant.
    pub(super) significant: &'a Grid<bool>,
    /// The difference is more likely than not.
    pub(super) belongs: &'a Grid<bool>,
    /// The depth lies behind the hull, however steep the hull is there.
    pub(super) behind: &'a Grid<bool>,
    /// How far the measured surface lies behind its own rims, in metres.
    pub(super) hollow: &'a Grid<f32>,
}

/// Numbers the regions: pixels of the paper's segmentation grown over adjacent ones that belong, where
/// enough of them are significant and hollow, with what they enclose and lies behind the hull too. Returns labels from
/// 1 on (0 means no region) and how many there are.
pub(super) fn regions(
    difference: &Grid<f32>,
    evidence: &Evidence,
    parameters: &Parameters,
) -> (Grid<u16>, usize) {
    let Evidence {
        significant,
        belongs,
        behind,
        hollow,
    } = evidence;
    let mut mask = adaptive_threshold(difference, parameters.window);
    for _ in 0..parameters.morphology_iterations {
        mask = erode(&mask);
    }
    for _ in 0..parameters.morphology_iterations {
        mask = dilate(&mask);
    }
    let inner = fill_interiors(&mask);
    let is_seed = |x: usize, y: usize| {
        inner[(x, y)] != 0
            && significant[(x, y)]
            && hollow[(x, y)] > 1e-3 * parameters.least_hollow_mm
    };
    let (mut labels, mut count) = (
        Grid::filled(significant.width(), significant.height(), 0),
        0,
    );
    let mut seen = Grid::filled(significant.width(), significant.height(), false);
    for y in 0..significant.height() {
        for x in 0..significant.width() {
            if seen[(x, y)] || !belongs[(x, y)] {
                continue;
            }
            let pixels = connected(belongs, &mut seen, (x, y));
            let seeds = pixels.iter().filter(|&&(x, y)| is_seed(x, y)).count();
            if seeds >= parameters.least_pixels && count < u16::MAX {
                count += 1;
                pixels.into_iter().for_each(|pixel| labels[pixel] = count);
            }
        }
    }
    fill_enclosed(&mut labels, behind);
    (labels, usize::from(count))
}

/// Gives the pixels that a region encloses to it, where they lie behind the hull: steep folds of the hull make
/// the difference doubtful there, and would be left standing as pegs.
pub(super) fn fill_enclosed(labels: &mut Grid<u16>, behind: &Grid<bool>) {
    let none = labels.map(|&l| l == 0);
    let mut seen = outside_of(&none);
    for y in 0..labels.height() {
        for x in 1..labels.width() {
            if seen[(x, y)] || !none[(x, y)] {
                continue;
            }
            // The first pixel of a hole in reading order has the region on its left.
            let label = labels[(x - 1, y)];
            let hole = connected(&none, &mut seen, (x, y));
            for pixel in hole.into_iter().filter(|&p| behind[p]) {
                labels[pixel] = label;
            }
        }
    }
}

/// The pixels 4-connected to `start` over true ones, which are marked as seen.
pub(super) fn connected(
    mask: &Grid<bool>,
    seen: &mut Grid<bool>,
    start: (usize, usize),
) -> Vec<(usize, usize)> {
    let mut pixels = vec![start];
    seen[start] = true;
    let mut next = 0;
    while let Some(&(x, y)) = pixels.get(next) {
        next += 1;
        for (nx, ny) in [
            (x.wrapping_sub(1), y),
            (x + 1, y),
            (x, y.wrapping_sub(1)),
            (x, y + 1),
        ] {
            if nx < mask.width() && ny < mask.height() && mask[(nx, ny)] && !seen[(nx, ny)] {
                seen[(nx, ny)] = true;
                pixels.push((nx, ny));
            }
        }
    }
    pixels
}

/// 255 where the difference exceeds its mean over a window of `window` times the extent of all differences
/// to either side, else 0.
fn adaptive_threshold(difference: &Grid<f32>, window: f32) -> Mask {
    let (width, height) = (difference.width(), difference.height());
    let (sums, counts) = (
        integral(difference, f64::from),
        integral(difference, |_| 1.0),
    );
    let half = (window * extent(difference) as f32).ceil().max(1.0) as usize;
    Grid::from_fn_parallel(width, height, |x, y| {
        let f = difference[(x, y)];
        if !f.is_finite() {
            return 0;
        }
        let (x0, x1) = (x.saturating_sub(half), (x + half + 1).min(width));
        let (y0, y1) = (y.saturating_sub(half), (y + half + 1).min(height));
        let within = |g: &Grid<f64>| g[(x1, y1)] - g[(x0, y1)] - g[(x1, y0)] + g[(x0, y0)];
        if f64::from(f) > within(&sums) / within(&counts) {
            255
        } else {
            0
        }
    })
}

/// Sums of `value` over all finite pixels above and to the left; a row and a column larger.
fn integral(difference: &Grid<f32>, value: impl Fn(f32) -> f64) -> Grid<f64> {
    let mut sums = Grid::filled(difference.width() + 1, difference.height() + 1, 0.0);
    for y in 0..difference.height() {
        let mut row = 0.0;
        for x in 0..difference.width() {
            let f = difference[(x, y)];
            row += if f.is_finite() { value(f) } else { 0.0 };
            sums[(x + 1, y + 1)] = sums[(x + 1, y)] + row;
        }
    }
    sums
}

/// The longer side of the box around all finite differences, in pixels.
fn extent(difference: &Grid<f32>) -> usize {
    let (mut x_range, mut y_range) = ((usize::MAX, 0), (usize::MAX, 0));
    for y in 0..difference.height() {
        for (x, _) in difference
            .row(y)
            .iter()
            .enumerate()
            .filter(|(_, f)| f.is_finite())
        {
            x_range = (x_range.0.min(x), x_range.1.max(x));
            y_range = (y_range.0.min(y), y_range.1.max(y));
        }
    }
    let length = |(low, high): (usize, usize)| (high + 1).saturating_sub(low.min(high + 1));
    length(x_range).max(length(y_range))
}

/// Each pixel becomes the least of itself and its four neighbours; beyond the picture nothing is taken off.
pub(super) fn erode(mask: &Mask) -> Mask {
    around(mask, u8::min)
}

/// Each pixel becomes the largest of itself and its four neighbours.
pub(super) fn dilate(mask: &Mask) -> Mask {
    around(mask, u8::max)
}

fn around(mask: &Mask, pick: fn(u8, u8) -> u8) -> Mask {
    Grid::from_fn_parallel(mask.width(), mask.height(), |x, y| {
        let neighbours = [(-1, 0), (1, 0), (0, -1), (0, 1)];
        neighbours
            .iter()
            .filter_map(|&(dx, dy)| mask.get(x as isize + dx, y as isize + dy))
            .fold(mask[(x, y)], |a, &b| pick(a, b))
    })
}

/// The mask with everything inside its contours: what the outside does not reach.
fn fill_interiors(mask: &Mask) -> Mask {
    outside_of(&mask.map(|&m| m == 0)).map(|&out| if out { 0 } else { 255 })
}

/// The empty pixels that are 4-connected to the picture's border.
fn outside_of(empty: &Grid<bool>) -> Grid<bool> {
    let (width, height) = (empty.width(), empty.height());
    // All is outside around the box of what is not empty.
    let mut outside = Grid::filled(width, height, true);
    let Some(full) = empty.extent(PixelRect::whole(width, height), |&e| !e) else {
        return outside;
    };
    for y in full.y0..full.y1 {
        outside.row_mut(y)[full.x0..full.x1].fill(false);
    }
    let sides = (full.x0..full.x1).flat_map(|x| [(x, full.y0), (x, full.y1 - 1)]);
    let ends = (full.y0..full.y1).flat_map(|y| [(full.x0, y), (full.x1 - 1, y)]);
    for start in sides.chain(ends) {
        if empty[start] && !outside[start] {
            connected(empty, &mut outside, start);
        }
    }
    outside
}

#[cfg(test)]
mod tests {
    use super::*;

    fn evidence<'a>(significant: &'a Grid<bool>, hollow: &'a Grid<f32>) -> Evidence<'a> {
        Evidence {
            significant,
            belongs: significant,
            behind: significant,
            hollow,
        }
    }

    #[test]
    fn a_ring_is_filled_and_a_gap_is_not() {
        let ring = |gap: bool| {
            Grid::from_fn(9, 9, |x, y| {
                let on = (2..7).contains(&x)
                    && (2..7).contains(&y)
                    && !((3..6).contains(&x) && (3..6).contains(&y));
                if on && !(gap && x == 4 && y == 2) {
                    255
                } else {
                    0
                }
            })
        };
        assert_eq!(fill_interiors(&ring(false))[(4, 4)], 255);
        assert_eq!(fill_interiors(&ring(true))[(4, 4)], 0);
    }

    #[test]
    fn a_flat_floor_and_its_rims_are_one_region() {
        // A cavity of 20 mm with a flat floor in a field without difference.
        let inside = |x: usize, y: usize| (10..30).contains(&x) && (10..30).contains(&y);
        let difference = Grid::from_fn(40, 40, |x, y| if inside(x, y) { 0.02 } else { 0.0 });
        let significant = difference.map(|&f| f > 0.001);
        let (labels, count) = regions(
            &difference,
            &evidence(&significant, &difference),
            &Parameters::default(),
        );
        assert_eq!(count, 1);
        for y in 0..40 {
            for x in 0..40 {
                assert_eq!(labels[(x, y)] == 1, inside(x, y), "{x} {y}");
            }
        }
    }

    #[test]
    fn what_a_region_encloses_is_its_own_where_it_lies_behind_the_hull() {
        // A cavity with two doubtful pixels: one lies behind the hull, the other on it, as a fruit's top does.
        let cavity = |x: usize, y: usize| (5..25).contains(&x) && (5..25).contains(&y);
        let (doubtful, fruit) = ((10, 10), (20, 15));
        let difference = Grid::from_fn(30, 30, |x, y| if cavity(x, y) { 0.02 } else { 0.0 });
        let belongs = Grid::from_fn(30, 30, |x, y| {
            cavity(x, y) && ![doubtful, fruit].contains(&(x, y))
        });
        let behind = Grid::from_fn(30, 30, |x, y| (x, y) != fruit);
        let evidence = Evidence {
            behind: &behind,
            ..evidence(&belongs, &difference)
        };
        let (labels, count) = regions(&difference, &evidence, &Parameters::default());
        assert_eq!((count, labels[doubtful], labels[fruit]), (1, 1, 0));
        assert_eq!(labels[(2, 2)], 0, "outside stays outside");
    }

    #[test]
    fn a_loose_hull_over_a_flat_top_is_no_region() {
        let difference = Grid::from_fn(
            40,
            40,
            |x, _| if (10..30).contains(&x) { 0.01 } else { 0.0 },
        );
        let significant = difference.map(|&f| f > 0.001);
        let flat = difference.map(|_| 0.0);
        assert_eq!(
            regions(
                &difference,
                &evidence(&significant, &flat),
                &Parameters::default()
            )
            .1,
            0
        );
    }
}
