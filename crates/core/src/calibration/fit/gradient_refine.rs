//! Refines one corner to a fraction of a pixel: the point to which the gradients around it are perpendicular
//! (Förstner and Gülch, "A fast operator for detection and precise location of distinct points, corners and centres
//! of circular features", 1987).

use crate::image::Grid;
use nalgebra::{Matrix2, Point2, Vector2};

/// Steps until a corner stays where it is.
const STEPS: usize = 30;
/// Step, in pixels, that counts as none.
const STILL: f64 = 1e-3;

/// Moves a corner to where the gradients within `half` pixels say that it is, those that `counts` keeps of them by
/// their offset from the corner; `None` if they say nothing or lead more than `half` pixels away.
pub(super) fn refined(
    picture: &Grid<u8>,
    start: Point2<f64>,
    half: i32,
    counts: impl Fn(Vector2<f64>) -> bool,
) -> Option<Point2<f64>> {
    let mut at = start;
    for _ in 0..STEPS {
        let (mut a, mut b) = (Matrix2::zeros(), Vector2::zeros());
        for dy in -half..=half {
            for dx in -half..=half {
                let offset = Vector2::new(f64::from(dx), f64::from(dy));
                if !counts(offset) {
                    continue;
                }
                let reach = f64::from(half);
                let weight = (-offset.norm_squared() / (reach * reach)).exp();
                let gradient = gradient(picture, at + offset)?;
                let outer = gradient * gradient.transpose() * weight;
                a += outer;
                b += outer * offset;
            }
        }
        let step = a.try_inverse()? * b;
        at += step;
        let moved = (at - start).norm();
        if moved.is_nan() || moved > f64::from(half) {
            return None;
        }
        if step.norm() < STILL {
            break;
        }
    }
    Some(at)
}

/// Central differences of the picture between its pixels.
fn gradient(picture: &Grid<u8>, at: Point2<f64>) -> Option<Vector2<f64>> {
    let (x, y) = (at.x.floor(), at.y.floor());
    let (fx, fy) = (at.x - x, at.y - y);
    let (x, y) = (x as isize, y as isize);
    if x < 1 || y < 1 || x + 2 >= picture.width() as isize || y + 2 >= picture.height() as isize {
        return None;
    }
    let value = |x: isize, y: isize| f64::from(picture[(x as usize, y as usize)]);
    let between = |dx: isize, dy: isize| {
        let (x, y) = (x + dx, y + dy);
        let top = value(x, y) * (1.0 - fx) + value(x + 1, y) * fx;
        let bottom = value(x, y + 1) * (1.0 - fx) + value(x + 1, y + 1) * fx;
        top * (1.0 - fy) + bottom * fy
    };
    Some(Vector2::new(
        between(1, 0) - between(-1, 0),
        between(0, 1) - between(0, -1),
    ))
}
