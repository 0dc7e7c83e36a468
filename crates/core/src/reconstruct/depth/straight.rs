//! Makes depth run straight across a wide hole between two surfaces. A harmonic function between the floor and the
//! rim of a round wall falls as the logarithm of the radius does, and so stands out into the hollow. A wall is mostly
//! straight from its foot to its top: here the second derivative along the steepest way becomes 0, in inverse depth,
//! in which lines in space are straight. It knows nothing of what decides that a hole is a wall.

use crate::image::Grid;

/// Narrowest hole, in pixels along the steepest way, that is made straight. In a narrower one a harmonic function
/// bulges by less than the few readings at its ends are off, and its smoothness around the wall is worth more.
const NARROWEST_PX: usize = 10;
/// Widest such hole: farther away, what a way meets need not be the same wall's end.
const WIDEST_PX: usize = 40;
/// Radius in pixels over which the steepest way is averaged.
const AROUND: isize = 2;
/// Sweeps of relaxation. The holes are bounded on both sides and begin as a harmonic function, so that these suffice.
const SWEEPS: usize = 150;
/// Over-relaxation.
const OVER: f32 = 1.5;

/// A hole's pixel, and the steps to its neighbours on both sides along the steepest way with their weights.
struct Pixel {
    at: (usize, usize),
    links: [((isize, isize), f32); 2],
}

/// Changes `depth` (metres) at those of the `open` pixels that lie in a wide hole between two surfaces. `measured` is
/// 0 at all holes, and `depth` is filled there already; measured neighbours that differ by more than `step` metres are
/// not of one surface.
pub(super) fn straighten(
    measured: &Grid<f32>,
    depth: &mut Grid<f32>,
    open: &[(usize, usize)],
    step: f32,
) {
    let pixels = pixels_to_straighten(measured, depth, open);
    for _ in 0..SWEEPS {
        for pixel in &pixels {
            if let Some(mean) = mean_along(measured, depth, pixel, step) {
                let here = depth[pixel.at].recip();
                depth[pixel.at] = (here + OVER * (mean - here)).recip();
            }
        }
    }
}

fn pixels_to_straighten(
    measured: &Grid<f32>,
    depth: &Grid<f32>,
    open: &[(usize, usize)],
) -> Vec<Pixel> {
    let gradient = gradient(measured, depth);
    let is_filled = |&&at: &&(usize, usize)| depth[at] > 0.0;
    let pixel = |&at: &(usize, usize)| {
        let way = steepest(&gradient, at);
        let links = links(way);
        crosses_wide_hole(measured, at, way).then_some(Pixel { at, links })
    };
    open.iter().filter(is_filled).filter_map(pixel).collect()
}

/// Differences of depth between the neighbours in x and in y, in metres a pixel, within the holes; 0 elsewhere.
fn gradient(measured: &Grid<f32>, depth: &Grid<f32>) -> Grid<[f32; 2]> {
    let in_hole = |x: isize, y: isize| {
        let is_hole = measured.get(x, y).is_some_and(|&z| z <= 0.0);
        depth.get(x, y).copied().filter(|&z| is_hole && z > 0.0)
    };
    let across = |x: usize, y: usize, dx: isize, dy: isize| {
        let at = |steps: isize| in_hole(x as isize + steps * dx, y as isize + steps * dy);
        match (at(-1), at(0), at(1)) {
            (Some(before), Some(_), Some(after)) => 0.5 * (after - before),
            (Some(before), Some(here), None) => here - before,
            (None, Some(here), Some(after)) => after - here,
            _ => 0.0,
        }
    };
    Grid::from_fn(depth.width(), depth.height(), |x, y| {
        [across(x, y, 1, 0), across(x, y, 0, 1)]
    })
}

/// Unit vector of the steepest way around a pixel, up or down: the first axis of the gradients' covariance. (0, 0)
/// where nothing is steep.
fn steepest(gradient: &Grid<[f32; 2]>, (x, y): (usize, usize)) -> [f32; 2] {
    let (mut xx, mut yy, mut xy) = (0.0f32, 0.0, 0.0);
    for dy in -AROUND..=AROUND {
        for dx in -AROUND..=AROUND {
            if let Some([gx, gy]) = gradient.get(x as isize + dx, y as isize + dy) {
                xx += gx * gx;
                yy += gy * gy;
                xy += gx * gy;
            }
        }
    }
    let twice_across = 2.0 * xy;
    let root = ((xx - yy) * (xx - yy) + twice_across * twice_across).sqrt();
    let [x, y] = if xx >= yy {
        [xx - yy + root, twice_across]
    } else {
        [twice_across, yy - xx + root]
    };
    let length = (x * x + y * y).sqrt();
    if length > 0.0 {
        [x / length, y / length]
    } else {
        [0.0, 0.0]
    }
}

/// Whether the way through a pixel meets readings on both sides, as far apart as a wide hole's ends are.
fn crosses_wide_hole(measured: &Grid<f32>, (x, y): (usize, usize), [wx, wy]: [f32; 2]) -> bool {
    let end = |sign: f32| {
        (1..WIDEST_PX).find(|&steps| {
            let by = sign * steps as f32;
            let pixel = (x as f32 + by * wx, y as f32 + by * wy);
            let reading = measured.get(pixel.0.round() as isize, pixel.1.round() as isize);
            reading.is_some_and(|&z| z > 0.0)
        })
    };
    match (end(-1.0), end(1.0)) {
        (Some(a), Some(b)) => (NARROWEST_PX..WIDEST_PX).contains(&(a + b - 1)),
        _ => false,
    }
}

/// The second derivative along a way, as that along an axis and that along the diagonal beside it.
fn links([wx, wy]: [f32; 2]) -> [((isize, isize), f32); 2] {
    let both = (wx * wy).abs();
    let diagonal = if wx * wy > 0.0 { (1, 1) } else { (1, -1) };
    let axis = if wx.abs() >= wy.abs() {
        ((1, 0), wx * wx - both)
    } else {
        ((0, 1), wy * wy - both)
    };
    [axis, (diagonal, both)]
}

/// Weighted mean of the neighbours' inverse depths. A measured surface reaches to its pixel's border, which is half as
/// far away as the next pixel of the hole.
fn mean_along(measured: &Grid<f32>, depth: &Grid<f32>, pixel: &Pixel, step: f32) -> Option<f32> {
    let (x, y) = (pixel.at.0 as isize, pixel.at.1 as isize);
    let beside = |grid: &Grid<f32>, dx: isize, dy: isize| {
        grid.get(x + dx, y + dy).copied().filter(|&z| z > 0.0)
    };
    let (mut sum, mut weights) = (0.0, 0.0);
    for ((dx, dy), weight) in pixel.links {
        for (dx, dy) in [(dx, dy), (-dx, -dy)] {
            let near = beside(measured, dx, dy);
            let (inverse, weight) = match (near, beside(measured, 2 * dx, 2 * dy)) {
                (Some(near), Some(far)) if (near - far).abs() < step => {
                    (1.5 * near.recip() - 0.5 * far.recip(), 2.0 * weight)
                }
                (Some(near), Some(_)) => (near.recip(), 2.0 * weight),
                _ => (beside(depth, dx, dy)?.recip(), weight),
            };
            sum += weight * inverse;
            weights += weight;
        }
    }
    (weights > 0.0).then(|| sum / weights)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIDE: usize = 91;
    const FOOT_PX: f32 = 10.0;

    fn radius((x, y): (usize, usize)) -> f32 {
        let middle = (SIDE / 2) as f32;
        (x as f32 - middle).hypot(y as f32 - middle)
    }

    /// A cone seen from its axis: from a floor at 0.85 m and 10 px around the axis up to a rim at 0.77 m that is
    /// `width` px farther out. Straight in inverse depth over the radius. Its wall is not read, and begins as the
    /// harmonic function.
    struct Cone {
        truth: Grid<f32>,
        measured: Grid<f32>,
        harmonic: Grid<f32>,
        open: Vec<(usize, usize)>,
    }

    impl Cone {
        fn of_wall(width: f32) -> Self {
            let is_hole = |p| (FOOT_PX..FOOT_PX + width).contains(&radius(p));
            let truth = Grid::from_fn(SIDE, SIDE, |x, y| {
                let share = ((radius((x, y)) - FOOT_PX) / width).clamp(0.0, 1.0);
                (0.85f32.recip() * (1.0 - share) + 0.77f32.recip() * share).recip()
            });
            let or_hole = |x, y, hole: f32| if is_hole((x, y)) { hole } else { truth[(x, y)] };
            let all_round = ((FOOT_PX + width) / FOOT_PX).ln();
            Self {
                measured: Grid::from_fn(SIDE, SIDE, |x, y| or_hole(x, y, 0.0)),
                harmonic: Grid::from_fn(SIDE, SIDE, |x, y| {
                    let share = (radius((x, y)) / FOOT_PX).ln() / all_round;
                    or_hole(x, y, 0.85 - 0.08 * share)
                }),
                open: (0..SIDE * SIDE)
                    .map(|i| (i % SIDE, i / SIDE))
                    .filter(|&p| is_hole(p))
                    .collect(),
                truth,
            }
        }

        /// Mean signed error in metres over the hole.
        fn bias(&self, of: &Grid<f32>) -> f32 {
            let off = |&p: &(usize, usize)| of[p] - self.truth[p];
            self.open.iter().map(off).sum::<f32>() / self.open.len() as f32
        }

        fn straight(&self) -> Grid<f32> {
            let mut out = self.harmonic.clone();
            straighten(&self.measured, &mut out, &self.open, 0.012);
            out
        }
    }

    #[test]
    fn a_round_wall_runs_straight_from_its_foot_to_its_rim() {
        let cone = Cone::of_wall(18.0);
        let (before, after) = (cone.bias(&cone.harmonic), cone.bias(&cone.straight()));
        assert!(before < -4.5e-3, "{before}");
        assert!(after.abs() < 1.5e-3, "{after}");
    }

    #[test]
    fn a_narrow_hole_stays_as_it_is() {
        let cone = Cone::of_wall(6.0);
        assert_eq!(cone.straight(), cone.harmonic);
    }

    #[test]
    fn a_hole_that_ends_on_one_side_alone_stays_as_it_is() {
        let mut cone = Cone::of_wall(18.0);
        for i in 0..SIDE * SIDE {
            let p = (i % SIDE, i / SIDE);
            if radius(p) > FOOT_PX + 9.0 {
                (cone.measured[p], cone.harmonic[p]) = (0.0, 0.0);
            }
        }
        assert_eq!(cone.straight(), cone.harmonic);
    }

    #[test]
    fn the_steepest_way_is_that_of_the_gradients_whatever_their_sign() {
        for (gradient, expected) in [
            ([0.003, 0.0], [1.0, 0.0]),
            ([0.0, -0.003], [0.0, 1.0]),
            ([-0.003, -0.003], [0.5f32.sqrt(), 0.5f32.sqrt()]),
            ([0.0, 0.0], [0.0, 0.0]),
        ] {
            let [x, y] = steepest(&Grid::filled(7, 7, gradient), (3, 3));
            let off = (x - expected[0]).hypot(y - expected[1]);
            assert!(off < 1e-6, "{x} {y} of {gradient:?}");
        }
    }
}
