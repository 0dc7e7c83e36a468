//! How hollow the measured surface itself is: how far each pixel lies behind the straight lines between nearer
//! parts of the object. A convex object is nowhere hollow, however far the hull stands off, and neither an offset
//! of the depth nor a misregistration makes it so. What lies beside the object does not count as a part of it.
//! Otherwise the table next to a box would be hollow, between the box and the table farther out.

use crate::image::{Grid, Mask};
use crate::reconstruct::depth::{DepthKind, EnhancedDepth};
use crate::statistics::lower_median;

/// Steps from pixel to pixel along the rows, columns and diagonals of a picture.
pub(super) const FOUR_DIRECTIONS: &[Step] = EIGHT_DIRECTIONS.split_at(4).0;
/// The same, and those of a chess knight's moves.
pub(super) const EIGHT_DIRECTIONS: &[Step] = &[
    (1, 0),
    (0, 1),
    (1, 1),
    (1, -1),
    (2, 1),
    (1, 2),
    (2, -1),
    (1, -2),
];

/// A step in x and y.
type Step = (isize, isize);

/// For each pixel, in metres, how far it lies behind the convex envelope of the measured depth of the object along
/// the lines through it that go in `steps` (the largest of them). 0 where there is no measured depth, and where the
/// object does not lie to either side. `on_object` are the readings of the object, of those in its image.
pub(super) fn depth_below_rims(
    depth: &EnhancedDepth,
    object: &Mask,
    on_object: &Grid<bool>,
    steps: &[Step],
) -> Grid<f32> {
    let (width, height) = (depth.depth.width(), depth.depth.height());
    let inverse = inverse_depth(depth, object);
    let mut hollow = Grid::filled(width, height, 0f32);
    let mut line = Vec::new();
    for pixels in lines(width, height, steps) {
        line.clear();
        line.extend(pixels.enumerate().filter_map(|(i, pixel)| {
            let value = inverse[pixel];
            (value > 0.0).then_some((i as f64, f64::from(value), pixel))
        }));
        let is_rim = |&(_, _, pixel): &Point| on_object[pixel];
        if let (Some(first), Some(last)) =
            (line.iter().position(is_rim), line.iter().rposition(is_rim))
        {
            below_envelope(&line[first..=last], |pixel| on_object[pixel], &mut hollow);
        }
    }
    hollow
}

/// The lines of a picture that go in some steps, each as its pixels in order.
pub(super) fn lines(
    width: usize,
    height: usize,
    steps: &[Step],
) -> impl Iterator<Item = impl Iterator<Item = (usize, usize)>> {
    let (w, h) = (width as isize, height as isize);
    let is_inside = move |x: isize, y: isize| x >= 0 && y >= 0 && x < w && y < h;
    steps.iter().flat_map(move |&(dx, dy)| {
        let pixels = (0..h).flat_map(move |y| (0..w).map(move |x| (x, y)));
        let starts = pixels.filter(move |&(x, y)| !is_inside(x - dx, y - dy));
        starts.map(move |(x, y)| {
            let ray = (0..).map(move |i: isize| (x + i * dx, y + i * dy));
            let inside = ray.take_while(move |&(x, y)| is_inside(x, y));
            inside.map(|(x, y)| (x as usize, y as usize))
        })
    })
}

/// 1 / depth of measured pixels, the median of 3 x 3 so that no single reading makes a rim; 0 elsewhere. In
/// 1 / depth, straight lines of space are straight lines of the picture.
fn inverse_depth(depth: &EnhancedDepth, object: &Mask) -> Grid<f32> {
    let usable =
        |x: usize, y: usize| depth.kind[(x, y)] == DepthKind::Measured && object[(x, y)] >= 128;
    Grid::from_fn_parallel(depth.depth.width(), depth.depth.height(), |x, y| {
        if !usable(x, y) {
            return 0.0;
        }
        let mut values = [0f32; 9];
        let mut count = 0;
        for ny in y.saturating_sub(1)..=(y + 1).min(depth.depth.height() - 1) {
            for nx in x.saturating_sub(1)..=(x + 1).min(depth.depth.width() - 1) {
                if usable(nx, ny) {
                    values[count] = depth.depth[(nx, ny)];
                    count += 1;
                }
            }
        }
        lower_median(&mut values[..count]).map_or(0.0, f32::recip)
    })
}

/// A point of a line: position, 1 / depth, pixel.
type Point = (f64, f64, (usize, usize));

/// Raises `hollow` by how far the points of a line lie below the upper convex envelope of those that are rims
/// (Andrew's monotone chain, 1979). Points are in the order of their positions; the first and the last are rims.
fn below_envelope(line: &[Point], is_rim: impl Fn((usize, usize)) -> bool, hollow: &mut Grid<f32>) {
    let mut envelope: Vec<(f64, f64)> = Vec::new();
    for &(t, value, _) in line.iter().filter(|p| is_rim(p.2)) {
        while let [.., a, b] = envelope[..]
            && (b.1 - a.1) * (t - a.0) <= (value - a.1) * (b.0 - a.0)
        {
            envelope.pop();
        }
        envelope.push((t, value));
    }
    let mut segment = 0;
    for &(t, value, pixel) in line {
        while segment + 2 < envelope.len() && envelope[segment + 1].0 < t {
            segment += 1;
        }
        let [a, b] = [
            envelope[segment],
            envelope[(segment + 1).min(envelope.len() - 1)],
        ];
        let share = if b.0 > a.0 {
            (t - a.0) / (b.0 - a.0)
        } else {
            0.0
        };
        let top = a.1 + (b.1 - a.1) * share;
        let behind = (1.0 / value - 1.0 / top) as f32;
        hollow[pixel] = hollow[pixel].max(behind);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_pass_each_pixel_once_in_each_direction() {
        let (width, height) = (7, 5);
        let mut passed = Grid::filled(width, height, 0);
        for line in lines(width, height, EIGHT_DIRECTIONS) {
            for pixel in line {
                passed[pixel] += 1;
            }
        }
        assert!(passed.pixels().iter().all(|&n| n == 8), "{passed:?}");
    }

    #[test]
    fn points_below_the_envelope_are_hollow_and_those_on_it_are_not() {
        let depths = [1.0, 1.05, 1.2, 1.05, 1.0, 1.3, 1.6];
        let line: Vec<_> = depths
            .iter()
            .enumerate()
            .map(|(x, z)| (x as f64, 1.0 / z, (x, 0)))
            .collect();
        let mut hollow = Grid::filled(7, 1, 0.0);
        below_envelope(&line, |_| true, &mut hollow);
        assert!((hollow[(2, 0)] - 0.2).abs() < 1e-6);
        assert!((hollow[(1, 0)] - 0.05).abs() < 1e-6);
        for on in [0, 4, 6] {
            assert!(hollow[(on, 0)].abs() < 1e-6, "{on}");
        }
    }
}
