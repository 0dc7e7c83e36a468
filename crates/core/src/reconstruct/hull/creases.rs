//! Depth between the pixels of a depth picture. Where the surface has a convex crease between two pixels, as between a
//! rim and the wall below it, a straight line from one to the other would cut it off: the more, the steeper the wall is
//! in the picture. There each side goes on straight to where both meet. At a concave crease, as at the foot of a wall,
//! it would dig into what is mostly rounded.

use crate::image::Grid;

/// Which cells, of four pixels each, have a crease on their border, and what depth is within them.
pub(super) struct Creases {
    /// A cell is numbered by its left upper pixel.
    cells: Grid<bool>,
    least_turn: LeastTurn,
}

/// By how much the slope has to change at a crease: by the size of a pixel at 1 m, in metres of depth a pixel for each
/// metre of depth. That is what a plane turned by 45 degrees against the picture has.
#[derive(Clone, Copy)]
struct LeastTurn(f32);

impl Creases {
    /// Of a `depth` in metres, 0 where there is none. `pixel` is the size of a pixel at 1 m, in metres.
    pub(super) fn new(depth: &Grid<f32>, pixel: f32) -> Self {
        let least_turn = LeastTurn(pixel);
        let creased = |x: usize, y: usize, across: bool| {
            let line = line(depth, x, y, across);
            line[1] > 0.0 && line[2] > 0.0 && crease(line, least_turn).is_some()
        };
        let (width, height) = (depth.width(), depth.height());
        let cells = Grid::from_fn_parallel(width, height, |x, y| {
            depth[(x, y)] > 0.0
                && x + 1 < width
                && y + 1 < height
                && (creased(x, y, true)
                    || creased(x, y + 1, true)
                    || creased(x, y, false)
                    || creased(x + 1, y, false))
        });
        Self { cells, least_turn }
    }

    /// Whether the cell right of and below a pixel has one.
    pub(super) fn is_creased(&self, x: usize, y: usize) -> bool {
        self.cells[(x, y)]
    }

    /// Depth in a cell all of whose corners have one, `fx` and `fy` of a pixel right of and below its first corner: the
    /// mean of what rows and then columns, and columns and then rows, say. Never beyond the corners' depths.
    pub(super) fn depth_at(
        &self,
        depth: &Grid<f32>,
        (x, y): (usize, usize),
        [fx, fy]: [f32; 2],
    ) -> f32 {
        let at = |i: usize, j: usize| {
            let pixel = ((x + i) as isize - 1, (y + j) as isize - 1);
            depth.get(pixel.0, pixel.1).copied().unwrap_or(0.0)
        };
        let four = [0, 1, 2, 3];
        let of_rows = four.map(|j| self.between(four.map(|i| at(i, j)), fx));
        let of_columns = four.map(|i| self.between(four.map(|j| at(i, j)), fy));
        0.5 * (self.between(of_rows, fy) + self.between(of_columns, fx))
    }

    /// Depth between the two in the middle of four neighbours; 0 if one of the two is.
    fn between(&self, line: [f32; 4], share: f32) -> f32 {
        let [_, a, b, _] = line;
        if a <= 0.0 || b <= 0.0 {
            return 0.0;
        }
        match crease(line, self.least_turn) {
            Some(crease) => crease.depth_at(share),
            None => a + share * (b - a),
        }
    }
}

/// The four pixels in a row or column of which the second is (x, y).
pub(super) fn line(depth: &Grid<f32>, x: usize, y: usize, in_row: bool) -> [f32; 4] {
    [-1, 0, 1, 2].map(|step| {
        let (dx, dy) = if in_row { (step, 0) } else { (0, step) };
        let pixel = depth.get(x as isize + dx, y as isize + dy);
        pixel.copied().unwrap_or(0.0)
    })
}

/// A crease between two neighbours.
struct Crease {
    depths: [f32; 2],
    /// Metres a pixel, towards the second, on both sides.
    slopes: [f32; 2],
}

/// The crease between the two in the middle of four neighbours, if it is convex and neither side goes on beyond the
/// other. Where nothing is known beyond one of them, the surface is taken to be level there.
fn crease([before, a, b, after]: [f32; 4], least_turn: LeastTurn) -> Option<Crease> {
    let first = if before > 0.0 { a - before } else { 0.0 };
    let second = if after > 0.0 { after - b } else { 0.0 };
    let rise = b - a;
    let is_convex = first <= rise && rise <= second;
    let turns = second - first >= least_turn.0 * a.min(b);
    (is_convex && turns).then_some(Crease {
        depths: [a, b],
        slopes: [first, second],
    })
}

impl Crease {
    fn depth_at(&self, share: f32) -> f32 {
        let [a, b] = self.depths;
        let [first, second] = self.slopes;
        let (from_a, from_b) = (a + first * share, b - second * (1.0 - share));
        from_a.max(from_b).clamp(a.min(b), a.max(b))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PIXEL: f32 = 1.0 / 576.0;

    /// A rim 0.8 m away up to column `edge`, and then a wall that falls by `slope` metres a pixel.
    fn rim(edge: f32, slope: f32) -> Grid<f32> {
        Grid::from_fn(12, 12, |x, _| 0.8 + slope * (x as f32 - edge).max(0.0))
    }

    fn transposed(depth: &Grid<f32>) -> Grid<f32> {
        Grid::from_fn(depth.height(), depth.width(), |x, y| depth[(y, x)])
    }

    fn mirrored(depth: &Grid<f32>) -> Grid<f32> {
        let last = depth.width() - 1;
        Grid::from_fn(depth.width(), depth.height(), |x, y| depth[(last - x, y)])
    }

    #[test]
    fn a_wall_begins_where_its_line_meets_the_rim() {
        for edge in [5.1, 5.5, 5.9] {
            let depth = rim(edge, 0.01);
            let creases = Creases::new(&depth, PIXEL);
            assert!(creases.is_creased(5, 6) && !creases.is_creased(8, 6));
            for share in [0.0, 0.2, 0.5, 0.8, 1.0] {
                let expected = 0.8 + 0.01 * (5.0 + share - edge).max(0.0);
                let found = creases.depth_at(&depth, (5, 6), [share, 0.3]);
                assert!((found - expected).abs() < 1e-5, "{found} {expected}");
            }
        }
    }

    #[test]
    fn along_a_gentle_bend_a_step_and_a_foot_depth_is_linear() {
        let step = Grid::from_fn(12, 12, |x, _| if x < 6 { 0.8 } else { 0.85 });
        let foot = rim(5.5, -0.01);
        for depth in [rim(5.5, 0.001), step, foot] {
            let creases = Creases::new(&depth, PIXEL);
            // Beyond the picture it is taken to be level.
            for x in 1..9 {
                let expected = 0.5 * (depth[(x, 5)] + depth[(x + 1, 5)]);
                let found = creases.depth_at(&depth, (x, 5), [0.5, 0.5]);
                assert!((found - expected).abs() < 1e-6, "{x}: {found} {expected}");
            }
        }
    }

    #[test]
    fn where_the_rim_ends_it_is_level() {
        let mut depth = rim(5.5, 0.01);
        for y in 0..12 {
            for x in 0..5 {
                depth[(x, y)] = 0.0;
            }
        }
        let creases = Creases::new(&depth, PIXEL);
        assert!(creases.is_creased(5, 6));
        let found = creases.depth_at(&depth, (5, 6), [0.5, 0.5]);
        assert!((found - 0.8).abs() < 1e-5, "{found}");
    }

    #[test]
    fn a_mirrored_or_transposed_picture_has_the_mirrored_depth() {
        // A round wall, its middle beside the pixels' grid.
        let radius = |x: usize, y: usize| (x as f32 - 5.3).hypot(y as f32 - 5.8);
        let depth = Grid::from_fn(12, 12, |x, y| 0.8 + 0.01 * (4.2 - radius(x, y)).max(0.0));
        let here = Creases::new(&depth, PIXEL);
        let (left, turned) = (mirrored(&depth), transposed(&depth));
        let of_left = Creases::new(&left, PIXEL);
        let of_turned = Creases::new(&turned, PIXEL);
        for y in 1..10 {
            for x in 1..10 {
                let found = here.depth_at(&depth, (x, y), [0.25, 0.4]);
                let mirror = of_left.depth_at(&left, (10 - x, y), [0.75, 0.4]);
                let transpose = of_turned.depth_at(&turned, (y, x), [0.4, 0.25]);
                assert!((found - mirror).abs() < 1e-6, "{x} {y}: {found} {mirror}");
                assert!(
                    (found - transpose).abs() < 1e-6,
                    "{x} {y}: {found} {transpose}"
                );
            }
        }
    }
}
