//! Resizes pictures in which the board is too blurred or too small to be found at the original size.

use crate::image::Grid;
use nalgebra::Point2;

/// Each pixel the mean of four.
pub(super) fn half_size(picture: &Grid<u8>) -> Grid<u8> {
    let (width, height) = (picture.width() / 2, picture.height() / 2);
    Grid::from_fn(width, height, |x, y| {
        let [top, bottom] = [2 * y, 2 * y + 1].map(|y| &picture.row(y)[2 * x..2 * x + 2]);
        let sum: u16 = top.iter().chain(bottom).map(|&v| u16::from(v)).sum();
        ((sum + 2) / 4) as u8
    })
}

/// The picture with `times` as many pixels along each side, by cubic convolution (Keys 1981, equation 15).
pub(super) fn magnified(picture: &Grid<u8>, times: f64) -> Grid<u8> {
    let [width, height] =
        [picture.width(), picture.height()].map(|side| (side as f64 * times) as usize);
    let taps = |k: usize| {
        let at = (k as f64 + 0.5) / times - 0.5;
        (at.floor() as isize - 1, weights(at - at.floor()))
    };
    let columns: Vec<_> = (0..width).map(taps).collect();
    Grid::from_fn(width, height, |x, y| {
        let ((left, across), (top, down)) = (columns[x], taps(y));
        let row = |j: isize| -> f64 {
            let value = |i: isize| f64::from(clamped(picture, left + i, top + j));
            (0..4).map(|i| across[i as usize] * value(i)).sum()
        };
        let sum: f64 = (0..4).map(|j| down[j as usize] * row(j)).sum();
        sum.round().clamp(0.0, 255.0) as u8
    })
}

/// Of four pixels in a row, for a place so far behind the second.
fn weights(t: f64) -> [f64; 4] {
    let (t2, t3) = (t * t, t * t * t);
    [
        -0.5 * t + t2 - 0.5 * t3,
        1.0 - 2.5 * t2 + 1.5 * t3,
        0.5 * t + 2.0 * t2 - 1.5 * t3,
        -0.5 * t2 + 0.5 * t3,
    ]
}

/// Brightness between pixels.
pub(super) fn between(picture: &Grid<u8>, at: Point2<f64>) -> f64 {
    let (x, y) = (at.x.floor(), at.y.floor());
    let (u, v) = (at.x - x, at.y - y);
    let (x, y) = (x as isize, y as isize);
    let value = |dx, dy| f64::from(clamped(picture, x + dx, y + dy));
    let row = |dy| value(0, dy) * (1.0 - u) + value(1, dy) * u;
    row(0) * (1.0 - v) + row(1) * v
}

/// A pixel; beyond the picture the nearest one.
#[inline]
fn clamped(picture: &Grid<u8>, x: isize, y: isize) -> u8 {
    let within = |v: isize, side: usize| v.clamp(0, side as isize - 1) as usize;
    picture[(within(x, picture.width()), within(y, picture.height()))]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slope_stays_a_slope_and_places_stay_where_they_are() {
        let picture = Grid::from_fn(20, 16, |x, y| (20 + 5 * x + 3 * y) as u8);
        let value = |x: f64, y: f64| 20.0 + 5.0 * x + 3.0 * y;
        let (large, small) = (magnified(&picture, 4.0), half_size(&picture));
        assert_eq!((large.width(), large.height()), (80, 64));
        for (x, y) in [(20, 20), (33, 41), (50, 17)] {
            let [u, v] = [x, y].map(|k: usize| (k as f64 + 0.5) / 4.0 - 0.5);
            let found = f64::from(large[(x, y)]);
            assert!((found - value(u, v)).abs() <= 0.51, "{x} {y} {found}");
        }
        assert!((f64::from(small[(4, 5)]) - value(8.5, 10.5)).abs() <= 0.51);
        assert!((between(&picture, Point2::new(7.25, 3.5)) - value(7.25, 3.5)).abs() < 1e-9);
    }
}
