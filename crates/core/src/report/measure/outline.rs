//! Measures how far one outline is displaced against another that can only be larger: a silhouette against the hull
//! of the other cameras. At frontier points, where the hull's outline touches the true one (Cipolla and Giblin,
//! "Visual Motion of Curves and Surfaces", 2000, chapter 4), the distance between both is the displacement alone.

use crate::image::Grid;
use nalgebra::{Matrix2, Vector2};

/// A point of a silhouette's contour and how far the other outline is.
#[derive(Clone, Copy, Debug)]
pub(super) struct Gap {
    /// Unit normal of the contour, outwards.
    normal: Vector2<f64>,
    /// From the contour along the normal to the other outline, in cells; negative where that lies inside.
    length: f64,
}

/// The value of an outline, between 1 inside and 0 outside.
const OUTLINE: f32 = 0.5;
/// Cells along a normal within which the other outline is looked for.
const REACH: f64 = 30.0;

/// The gaps along the contour of `level` to the outline of `others`; both smooth, a value a cell. A cell that is
/// unknown has none.
pub(super) fn gaps(
    level: &Grid<f32>,
    others: &Grid<f32>,
    is_unknown: impl Fn(usize, usize) -> bool,
) -> Vec<Gap> {
    let mut gaps = Vec::new();
    for y in 2..level.height().saturating_sub(2) {
        for x in 2..level.width().saturating_sub(2) {
            for (dx, dy) in [(1usize, 0usize), (0, 1)] {
                let (here, next) = (level[(x, y)], level[(x + dx, y + dy)]);
                let is_known = !is_unknown(x, y) && !is_unknown(x + dx, y + dy);
                if (here > OUTLINE) == (next > OUTLINE) || !is_known {
                    continue;
                }
                let part = f64::from((OUTLINE - here) / (next - here));
                let at = Vector2::new(x as f64 + part * dx as f64, y as f64 + part * dy as f64);
                gaps.extend(gap(level, others, at));
            }
        }
    }
    gaps
}

fn gap(level: &Grid<f32>, others: &Grid<f32>, at: Vector2<f64>) -> Option<Gap> {
    let slope = |step: Vector2<f64>| f64::from(sample(level, at - step) - sample(level, at + step));
    let normal = Vector2::new(slope(Vector2::x()), slope(Vector2::y())).try_normalize(1e-3)?;
    const STEP: f64 = 0.5;
    let value = |t: f64| sample(others, at + normal * t);
    let outwards = value(0.0) > OUTLINE;
    let step = if outwards { STEP } else { -STEP };
    let (mut t, mut before) = (0.0_f64, value(0.0));
    while t.abs() < REACH {
        let after = value(t + step);
        if (after > OUTLINE) != outwards {
            let part = f64::from((OUTLINE - before) / (after - before));
            let length = t + part * step;
            return Some(Gap { normal, length });
        }
        (t, before) = (t + step, after);
    }
    None
}

/// Bilinear; 0 outside.
fn sample(grid: &Grid<f32>, at: Vector2<f64>) -> f32 {
    let (x, y) = (at.x.floor() as isize, at.y.floor() as isize);
    let (fx, fy) = ((at.x - at.x.floor()) as f32, (at.y - at.y.floor()) as f32);
    let value = |dx, dy| grid.get(x + dx, y + dy).copied().unwrap_or(0.0);
    let row = |dy| value(0, dy) + fx * (value(1, dy) - value(0, dy));
    row(0) + fy * (row(1) - row(0))
}

/// The displacement, in cells, of a contour whose gaps would be zero or more without it, and zero where the
/// outlines touch. A gap is the excess less the displacement along the normal; what juts out counts in full,
/// excess the less the larger it is, and ever less from round to round (reweighted least squares).
pub(super) fn displacement(gaps: &[Gap]) -> Vector2<f64> {
    const SCALES: [f64; 6] = [16.0, 8.0, 4.0, 2.0, 1.0, 0.5];
    const ROUNDS: usize = 8;
    let mut found = Vector2::zeros();
    for scale in SCALES {
        for _ in 0..ROUNDS {
            let (mut normal, mut right) = (Matrix2::identity() * 1e-6, Vector2::zeros());
            for gap in gaps {
                let excess = gap.length + found.dot(&gap.normal);
                let weight = (1.0 + (excess.max(0.0) / scale).powi(2)).powi(-2);
                normal += gap.normal * gap.normal.transpose() * weight;
                right -= gap.normal * (weight * gap.length);
            }
            let solved = normal.try_inverse().map(|inverse| inverse * right);
            found = solved.unwrap_or(found);
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    fn disc(dx: f32, dy: f32, radius: f32) -> Grid<f32> {
        Grid::from_fn(120, 100, |x, y| {
            let r = (x as f32 - 60.0 - dx).hypot(y as f32 - 50.0 - dy);
            (radius + 0.5 - r).clamp(0.0, 1.0)
        })
    }

    #[test]
    fn a_displacement_is_found_to_a_fraction_of_a_cell() {
        for (dx, dy) in [(0.0, 0.0), (0.4, -0.2), (5.0, -9.0)] {
            let found = displacement(&gaps(&disc(dx, dy, 30.0), &disc(0.0, 0.0, 30.0), |_, _| {
                false
            }));
            let expected = Vector2::new(f64::from(dx), f64::from(dy));
            assert!((found - expected).norm() < 0.1, "{found} {expected}");
        }
    }

    #[test]
    fn excess_of_the_hull_hides_no_displacement_where_the_outlines_touch_elsewhere() {
        // The other outline has a bulge to the right: only there is it larger.
        let bulged = |dx: f32, dy: f32| {
            let (disc, bulge) = (disc(dx, dy, 30.0), disc(dx + 14.0, dy, 25.0));
            Grid::from_fn(120, 100, |x, y| disc[(x, y)].max(bulge[(x, y)]))
        };
        for (dx, dy) in [(0.0, 0.0), (1.5, -1.0), (-2.0, 3.0)] {
            let found = displacement(&gaps(&disc(dx, dy, 30.0), &bulged(0.0, 0.0), |_, _| false));
            let expected = Vector2::new(f64::from(dx), f64::from(dy));
            assert!((found - expected).norm() < 0.25, "{found} {expected}");
        }
    }
}
