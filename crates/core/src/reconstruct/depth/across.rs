//! Lets depth run across holes: walls that are too steep to be read. It knows nothing of what decides that a hole is
//! one.
//!
//! A harmonic function between the floor and the rim of a round wall falls as the logarithm of the radius does, and so
//! stands out into the hollow. The slope that it has there falls with the radius, too. If depth spreads across the hole
//! the better, the steeper that function is, it falls straight from the rim to the floor, and is as smooth around the
//! wall.

use super::straight;
use crate::image::Grid;

/// Sweeps of relaxation over the holes.
const SWEEPS: usize = 60;
/// Over-relaxation: the usual value for holes of some ten pixels.
const OVER: f32 = 1.7;
/// What is added to all slopes, in metres of depth per metre across the view: what hardly slopes is left as it is.
const LEVEL: f32 = 1.0;

/// Lets depth run across the `open` pixels: the harmonic function bounded by what is around them, started
/// from the outside in, then relaxed; and again, spread by its slope. Linear depth is reproduced. (A plane in space is
/// linear in inverse depth; but walls are rounded at their foot, and there depth itself is nearer to the truth.) Across
/// wide holes it is made straight. `pixel` is the size of a pixel at 1 m, and measured neighbours that differ by more
/// than `step` are not of one surface, both in metres.
pub(super) fn run_across(depth: &mut Grid<f32>, open: &[(usize, usize)], pixel: f32, step: f32) {
    let measured = depth.clone();
    let holes = Holes {
        measured: &measured,
        step,
    };
    holes.begin(depth, open);
    holes.relax(depth, open, None);
    let slopes = holes.slopes(depth, open, pixel);
    holes.relax(depth, open, Some(&slopes));
    straight::straighten(&measured, depth, open, step);
}

/// What bounds the holes.
struct Holes<'a> {
    /// 0 in the holes.
    measured: &'a Grid<f32>,
    /// Measured neighbours that differ by more are not of one surface, in metres.
    step: f32,
}

impl Holes<'_> {
    /// Gives each pixel a depth from the outside in.
    fn begin(&self, depth: &mut Grid<f32>, open: &[(usize, usize)]) {
        let mut waiting: Vec<_> = open.to_vec();
        while !waiting.is_empty() {
            let reached: Vec<_> = waiting
                .iter()
                .filter_map(|&p| self.mean(depth, p, None).map(|z| (p, z)))
                .collect();
            if reached.is_empty() {
                break;
            }
            for (p, z) in reached {
                depth[p] = z;
            }
            waiting.retain(|&p| depth[p] <= 0.0);
        }
    }

    fn relax(&self, depth: &mut Grid<f32>, open: &[(usize, usize)], slopes: Option<&Grid<f32>>) {
        for _ in 0..SWEEPS {
            for &p in open {
                if let Some(mean) = self.mean(depth, p, slopes) {
                    depth[p] += OVER * (mean - depth[p]);
                }
            }
        }
    }

    /// Weighted mean of the up to four neighbours that have depth. A link between two pixels weighs as the mean of
    /// their `slopes`, if there are any, and as one over its length.
    fn mean(
        &self,
        depth: &Grid<f32>,
        (x, y): (usize, usize),
        slopes: Option<&Grid<f32>>,
    ) -> Option<f32> {
        let (mut sum, mut weights) = (0.0, 0.0);
        for (dx, dy) in [(-1, 0), (1, 0), (0, -1), (0, 1)] {
            if let Some((z, length)) = self.beside(depth, (x, y), (dx, dy)) {
                let slope = slopes.map_or(1.0, |slopes| {
                    let here = slopes[(x, y)];
                    let there = slopes.get(x as isize + dx, y as isize + dy);
                    0.5 * (here + there.copied().filter(|&s| s > 0.0).unwrap_or(here))
                });
                sum += slope * z / length;
                weights += slope / length;
            }
        }
        (weights > 0.0).then(|| sum / weights)
    }

    /// The depth on one side of a pixel, and how many pixels away it is. A measured surface reaches to its pixel's
    /// border, half as far away as the next pixel of the hole: without that a wall between a floor and a rim
    /// would start half a pixel before the floor's end.
    fn beside(
        &self,
        depth: &Grid<f32>,
        (x, y): (usize, usize),
        (dx, dy): (isize, isize),
    ) -> Option<(f32, f32)> {
        let at = |grid: &Grid<f32>, steps: isize| {
            let beside = grid.get(x as isize + steps * dx, y as isize + steps * dy);
            beside.copied().filter(|&z| z > 0.0)
        };
        if let (Some(near), Some(far)) = (at(self.measured, 1), at(self.measured, 2)) {
            // Beyond a step it is another surface, which tells nothing of this one's slope.
            let rise = if (near - far).abs() < self.step {
                near - far
            } else {
                0.0
            };
            return Some((near + 0.5 * rise, 0.5));
        }
        at(depth, 1).map(|z| (z, 1.0))
    }

    /// How steep depth is at each of the `open` pixels, in metres a pixel: the mean over those around, and [`LEVEL`]. 0
    /// elsewhere.
    fn slopes(&self, depth: &Grid<f32>, open: &[(usize, usize)], pixel: f32) -> Grid<f32> {
        let mut each = Grid::filled(depth.width(), depth.height(), 0.0);
        for &p in open.iter().filter(|&&p| depth[p] > 0.0) {
            each[p] = self
                .slope_along(depth, p, (1, 0))
                .hypot(self.slope_along(depth, p, (0, 1)));
        }
        let mut slopes = Grid::filled(depth.width(), depth.height(), 0.0);
        for &(x, y) in open.iter().filter(|&&p| depth[p] > 0.0) {
            let around = (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (dx, dy)));
            let (sum, count) = around
                .filter_map(|(dx, dy)| each.get(x as isize + dx, y as isize + dy))
                .filter(|&&slope| slope > 0.0)
                .fold((0.0, 0.0), |(sum, count), slope| (sum + slope, count + 1.0));
            slopes[(x, y)] = sum / f32::max(count, 1.0) + LEVEL * pixel * depth[(x, y)];
        }
        slopes
    }

    fn slope_along(&self, depth: &Grid<f32>, p: (usize, usize), (dx, dy): (isize, isize)) -> f32 {
        let to = |sign: isize| {
            let (z, length) = self.beside(depth, p, (sign * dx, sign * dy))?;
            Some(sign as f32 * (z - depth[p]) / length)
        };
        match (to(-1), to(1)) {
            (Some(before), Some(after)) => 0.5 * (before + after),
            (before, after) => before.or(after).unwrap_or(0.0),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIDE: usize = 81;
    const FOOT_PX: f32 = 20.0;
    const WIDTH_PX: f32 = 8.0;

    /// Depth of a round wall, 80 mm high, of which the middle of the picture is the axis.
    fn wall(x: usize, y: usize) -> (f32, bool) {
        let middle = (SIDE / 2) as f32;
        let out = (x as f32 - middle).hypot(y as f32 - middle) - FOOT_PX;
        let share = (out / WIDTH_PX).clamp(0.0, 1.0);
        (0.85 - 0.08 * share, (0.0..WIDTH_PX).contains(&out))
    }

    #[test]
    fn a_round_wall_in_a_narrow_hole_stands_out_far_less_than_a_harmonic_function() {
        let measured = Grid::from_fn(SIDE, SIDE, |x, y| {
            let (depth, is_hole) = wall(x, y);
            if is_hole { 0.0 } else { depth }
        });
        let all = (0..SIDE * SIDE).map(|i| (i % SIDE, i / SIDE));
        let open: Vec<_> = all.filter(|&(x, y)| wall(x, y).1).collect();
        let bias = |depth: &Grid<f32>| {
            let off = |&(x, y): &(usize, usize)| depth[(x, y)] - wall(x, y).0;
            open.iter().map(off).sum::<f32>() / open.len() as f32
        };
        let holes = Holes {
            measured: &measured,
            step: 0.012,
        };
        let mut harmonic = measured.clone();
        holes.begin(&mut harmonic, &open);
        holes.relax(&mut harmonic, &open, None);
        let mut depth = measured.clone();
        run_across(&mut depth, &open, 1.0 / 576.0, 0.012);
        let (before, after) = (bias(&harmonic), bias(&depth));
        assert!(before < -1.2e-3, "{before}");
        assert!(after.abs() < 0.5 * before.abs(), "{after} {before}");
    }

    #[test]
    fn a_pixel_that_no_depth_reaches_stays_0() {
        let mut depth = Grid::filled(5, 5, 0.0);
        run_across(&mut depth, &[(2, 2)], 1.0 / 576.0, 0.012);
        assert_eq!(depth[(2, 2)], 0.0);
    }
}
