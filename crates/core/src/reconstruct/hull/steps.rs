//! Depth between the pixels of a depth picture where one surface hides another. A line from the one to the other would
//! be a wall that nothing showed, and would cover a strip of the farther surface that the camera sees. There each
//! surface goes on to the middle between the two.

use super::creases::line;
use crate::image::Grid;

/// Least step, in sizes of a pixel: a wall as steep as that has hardly a reading.
const LEAST_STEP_PX: f32 = 8.0;
/// How many times as far it goes over a step as from a pixel to the next on both sides of it. Along a steep wall it
/// goes as far.
const LEAST_RATIO: f32 = 4.0;
/// Steepest slope towards the step, in metres of depth per metre across the view, that the farther surface may have: a
/// steeper one is a wall, or its foot, and goes on to the nearer surface.
const STEEPEST_FLOOR: f32 = 1.0;

/// Which cells, of four pixels each, have a step on their border, and what depth is within them.
pub(super) struct Steps {
    /// A cell is numbered by its left upper pixel.
    cells: Grid<bool>,
}

impl Steps {
    /// Of a `depth` in metres, 0 where there is none. `pixel` is the size of a pixel at 1 m, in metres.
    pub(super) fn new(depth: &Grid<f32>, pixel: f32) -> Self {
        let on = |x: usize, y: usize, in_row: bool| is_step(line(depth, x, y, in_row), pixel);
        let (width, height) = (depth.width(), depth.height());
        let cells = Grid::from_fn_parallel(width, height, |x, y| {
            depth[(x, y)] > 0.0
                && x + 1 < width
                && y + 1 < height
                && (on(x, y, true) || on(x, y + 1, true) || on(x, y, false) || on(x + 1, y, false))
        });
        Self { cells }
    }

    /// Whether the cell right of and below a pixel has one.
    pub(super) fn is_stepped(&self, x: usize, y: usize) -> bool {
        self.cells[(x, y)]
    }
}

/// The two surfaces at a place in a cell with a step.
pub(super) struct Step {
    /// Mean depth of the corners on each, in metres.
    near: f64,
    far: f64,
    /// Share of the corners on the farther one, as bilinear weights count them.
    of_far: f64,
}

impl Step {
    /// From the cell's corners and their weights.
    pub(super) fn new(corners: [(f32, f64); 4]) -> Self {
        let depths = corners.map(|(depth, _)| depth);
        let low = depths.into_iter().fold(f32::INFINITY, f32::min);
        let high = depths.into_iter().fold(0.0, f32::max);
        let middle = 0.5 * (low + high);
        let side = |is_far: bool, otherwise: f32| {
            let of_side = corners
                .iter()
                .filter(|(depth, _)| (*depth > middle) == is_far);
            let (sum, weights) = of_side.fold((0.0, 0.0), |(sum, weights), (depth, weight)| {
                (sum + f64::from(*depth) * weight, weights + weight)
            });
            let mean = if weights > 0.0 {
                sum / weights
            } else {
                f64::from(otherwise)
            };
            (mean, weights)
        };
        let [(near, of_near), (far, of_far)] = [side(false, low), side(true, high)];
        Self {
            near,
            far,
            of_far: of_far / (of_near + of_far),
        }
    }

    /// Depth of the surface that the camera sees.
    pub(super) fn depth(&self) -> f64 {
        if self.of_far > 0.5 {
            self.far
        } else {
            self.near
        }
    }

    /// How far a point at depth `z` lies behind the surfaces and the side between them, where a pixel has the size
    /// `pixel`, all in metres: negative in front of them.
    pub(super) fn behind(&self, z: f64, pixel: f64) -> f64 {
        let within_side = (0.5 - self.of_far) * pixel;
        (z - self.near).min(within_side).max(z - self.far)
    }
}

/// Whether there is a step between the two in the middle of four neighbours.
fn is_step([before, a, b, after]: [f32; 4], pixel: f32) -> bool {
    if a <= 0.0 || b <= 0.0 {
        return false;
    }
    let rise = (b - a).abs();
    let goes = |from: f32, to: f32| {
        if from > 0.0 && to > 0.0 {
            (to - from).abs()
        } else {
            0.0
        }
    };
    let (far, beyond) = if a < b { (b, after) } else { (a, before) };
    let is_foot = beyond > 0.0 && beyond - far > STEEPEST_FLOOR * pixel * far;
    !is_foot
        && rise >= LEAST_STEP_PX * pixel * a.min(b)
        && rise >= LEAST_RATIO * goes(before, a).max(goes(b, after))
}

#[cfg(test)]
mod tests {
    use super::*;

    const PIXEL: f32 = 1.0 / 576.0;

    #[test]
    fn a_surface_goes_on_to_the_middle_of_a_step() {
        let depth = Grid::from_fn(12, 12, |x, _| if x < 6 { 0.80 } else { 0.85 });
        let steps = Steps::new(&depth, PIXEL);
        assert!(steps.is_stepped(5, 6) && !steps.is_stepped(4, 6) && !steps.is_stepped(6, 6));
        for (share, expected) in [(0.0, 0.80), (0.45, 0.80), (0.55, 0.85), (1.0, 0.85)] {
            let weights = [
                0.7 * (1.0 - share),
                0.7 * share,
                0.3 * (1.0 - share),
                0.3 * share,
            ];
            let corners = [
                (0.80, weights[0]),
                (0.85, weights[1]),
                (0.80, weights[2]),
                (0.85, weights[3]),
            ];
            let found = Step::new(corners).depth();
            assert!((found - expected).abs() < 1e-6, "{found} {expected}");
        }
    }

    #[test]
    fn what_lies_beside_the_side_of_a_step_lies_less_far_behind_it() {
        let step =
            |share: f64| Step::new([(0.80, 1.0 - share), (0.85, share), (0.80, 0.0), (0.85, 0.0)]);
        for (share, z, expected) in [
            (0.0, 0.79, -0.01),
            (0.0, 0.81, 0.0005),
            (0.4, 0.81, 0.0001),
            (0.6, 0.81, -0.0001),
            (1.0, 0.81, -0.0005),
            (0.6, 0.86, 0.01),
        ] {
            let found = step(share).behind(z, 1e-3);
            assert!(
                (found - expected).abs() < 1e-6,
                "{share} {z}: {found} {expected}"
            );
        }
    }

    #[test]
    fn a_steep_wall_and_its_ends_have_no_step() {
        // A rim, 20 mm a pixel down, and a floor.
        let depth = Grid::from_fn(12, 12, |x, _| {
            0.80 + 0.02 * (x as f32 - 4.0).clamp(0.0, 4.0)
        });
        let steps = Steps::new(&depth, PIXEL);
        assert!((0..11).all(|x| !steps.is_stepped(x, 5)));
    }

    #[test]
    fn a_foot_that_rises_towards_a_wall_has_no_step() {
        let stepped = |rise: f32| {
            let floor = |x: usize| 0.85 + rise * (x as f32 - 6.0);
            let depth = Grid::from_fn(12, 12, |x, _| if x < 6 { 0.80 } else { floor(x) });
            Steps::new(&depth, PIXEL).is_stepped(5, 6)
        };
        assert!(stepped(0.001) && stepped(-0.003) && !stepped(0.003));
    }

    #[test]
    fn what_is_less_than_a_steep_walls_pixel_is_no_step() {
        let depth = Grid::from_fn(12, 12, |x, _| if x < 6 { 0.80 } else { 0.808 });
        let steps = Steps::new(&depth, PIXEL);
        assert!((0..11).all(|x| !steps.is_stepped(x, 5)));
    }
}
