//! Fills holes. A hole between two depths is either a wall that is too steep to be read, and then the depth runs
//! across it, or an edge that hides what is behind it, and then each of its pixels belongs to one side. The far
//! side distinguishes the two: if it rises towards the near side, it is the foot of a wall.

use super::{Parameters, across};
use crate::image::Grid;

/// Radius in pixels in which a hole's surroundings are looked at.
const REACH: isize = 6;
/// Pixels of the far side that its slope is measured on.
const FOOT: usize = 12;
/// What a hole is filled with.
struct Holes<'a> {
    depth: &'a Grid<f32>,
    guide: &'a Grid<f32>,
    /// Metres that a pixel covers per metre of depth.
    pixel: f32,
    parameters: &'a Parameters,
}

/// A measured pixel near a hole, seen from the hole.
#[derive(Clone, Copy)]
struct Neighbour {
    dx: f32,
    dy: f32,
    distance: f32,
    depth: f32,
    /// How alike the guide is there, from 0 to 1.
    likeness: f32,
}

/// Fills the pixels of `inside` that have no depth (0). `pixel` is the size of a pixel at 1 m, in metres.
/// A pixel that no depth reaches stays 0.
pub(super) fn fill(
    depth: &Grid<f32>,
    inside: &Grid<bool>,
    guide: &Grid<f32>,
    pixel: f32,
    parameters: &Parameters,
) -> Grid<f32> {
    let holes = Holes {
        depth,
        guide,
        pixel,
        parameters,
    };
    let mut out = depth.clone();
    let mut open = Vec::new();
    for y in 0..depth.height() {
        for x in 0..depth.width() {
            if depth[(x, y)] > 0.0 || !inside[(x, y)] {
                continue;
            }
            match holes.behind_an_edge(x, y) {
                Some(z) => out[(x, y)] = z,
                None => open.push((x, y)),
            }
        }
    }
    across::run_across(&mut out, &open, pixel, parameters.least_step_mm * 1e-3);
    out
}

impl Holes<'_> {
    /// The depth at a hole's pixel if the hole is an edge that hides what is behind it.
    fn behind_an_edge(&self, x: usize, y: usize) -> Option<f32> {
        let around = self.around(x, y);
        let (near, far) = around.iter().fold((f32::INFINITY, 0.0f32), |(n, f), q| {
            (n.min(q.depth), f.max(q.depth))
        });
        if far - near < self.parameters.least_step_mm * 1e-3 {
            return None;
        }
        let (mut far_side, near_side): (Vec<_>, Vec<_>) = around
            .into_iter()
            .partition(|q| q.depth > (near + far) / 2.0);
        let width = nearest(&far_side) + nearest(&near_side) - 1.0;
        if width > self.parameters.widest_step_px {
            return None;
        }
        far_side.sort_by(|a, b| a.distance.total_cmp(&b.distance));
        far_side.truncate(FOOT);
        let floor = Plane::through(&far_side);
        let edge = center(&closest(&near_side, 1.0));
        if floor.depth_at(edge) - depth_of_nearest(&near_side)
            < self.parameters.least_step_mm * 1e-3
        {
            return None;
        }
        if floor.rise_towards(edge) > self.pixel * far * self.parameters.steepest_floor {
            return None;
        }
        let near_is_alike = likeness(&near_side) > 2.0 * likeness(&far_side);
        Some(if near_is_alike {
            depth_of_nearest(&near_side)
        } else {
            floor.depth_at((0.0, 0.0))
        })
    }

    /// The measured pixels around that a walk from the hole's pixel reaches: through the hole, then over
    /// the surface, not over a step. So a thin rim hides what lies beyond it.
    fn around(&self, x: usize, y: usize) -> Vec<Neighbour> {
        const SIDE: usize = 2 * REACH as usize + 1;
        let here = self.guide[(x, y)];
        let scale = -0.5 / self.parameters.range_sigma.powi(2);
        let step = self.parameters.least_step_mm * 1e-3;
        let mut seen = [[false; SIDE]; SIDE];
        seen[REACH as usize][REACH as usize] = true;
        let mut waiting = vec![(0isize, 0isize)];
        let mut out = Vec::new();
        while let Some((dx, dy)) = waiting.pop() {
            let from = self.depth[self.at(x, y, dx, dy)];
            for (nx, ny) in [(dx - 1, dy), (dx + 1, dy), (dx, dy - 1), (dx, dy + 1)] {
                let to = (x as isize + nx, y as isize + ny);
                let Some(&depth) = self.depth.get(to.0, to.1) else {
                    continue;
                };
                let crossing = from > 0.0 && (depth <= 0.0 || (depth - from).abs() > step);
                if nx * nx + ny * ny > REACH * REACH || crossing {
                    continue;
                }
                let mark = &mut seen[(ny + REACH) as usize][(nx + REACH) as usize];
                if std::mem::replace(mark, true) {
                    continue;
                }
                waiting.push((nx, ny));
                if depth > 0.0 {
                    let difference = self.guide[self.at(x, y, nx, ny)] - here;
                    out.push(Neighbour {
                        dx: nx as f32,
                        dy: ny as f32,
                        distance: (nx as f32).hypot(ny as f32),
                        depth,
                        likeness: (difference * difference * scale).exp(),
                    });
                }
            }
        }
        out
    }

    fn at(&self, x: usize, y: usize, dx: isize, dy: isize) -> (usize, usize) {
        (x.saturating_add_signed(dx), y.saturating_add_signed(dy))
    }
}

fn nearest(side: &[Neighbour]) -> f32 {
    side.iter().fold(f32::INFINITY, |n, q| n.min(q.distance))
}

/// The pixels of a side that are hardly farther than its nearest.
fn closest(side: &[Neighbour], more_px: f32) -> Vec<Neighbour> {
    let limit = nearest(side) + more_px;
    side.iter()
        .copied()
        .filter(|q| q.distance < limit)
        .collect()
}

fn mean(side: &[Neighbour], of: impl Fn(&Neighbour) -> f32) -> f32 {
    side.iter().map(of).sum::<f32>() / side.len() as f32
}

fn center(side: &[Neighbour]) -> (f32, f32) {
    (mean(side, |q| q.dx), mean(side, |q| q.dy))
}

fn depth_of_nearest(side: &[Neighbour]) -> f32 {
    mean(&closest(side, 0.5), |q| q.depth)
}

/// Mean likeness of a side's closest pixels.
fn likeness(side: &[Neighbour]) -> f32 {
    mean(&closest(side, 1.5), |q| q.likeness)
}

/// A plane of depth over the pixels around a hole's pixel.
struct Plane {
    center: (f32, f32),
    depth: f32,
    /// Metres a pixel in x and y.
    slope: (f32, f32),
}

impl Plane {
    /// Least squares, held level where the pixels lie in one line.
    fn through(side: &[Neighbour]) -> Self {
        const LEVEL: f32 = 0.05;
        let (center, depth) = (center(side), mean(side, |q| q.depth));
        let (mut xx, mut xy, mut yy, mut xz, mut yz) = (LEVEL, 0.0, LEVEL, 0.0, 0.0);
        for q in side {
            let (x, y, z) = (q.dx - center.0, q.dy - center.1, q.depth - depth);
            xx += x * x;
            xy += x * y;
            yy += y * y;
            xz += x * z;
            yz += y * z;
        }
        let determinant = xx * yy - xy * xy;
        Self {
            center,
            depth,
            slope: (
                (xz * yy - yz * xy) / determinant,
                (yz * xx - xz * xy) / determinant,
            ),
        }
    }

    fn depth_at(&self, (dx, dy): (f32, f32)) -> f32 {
        self.depth + self.slope.0 * (dx - self.center.0) + self.slope.1 * (dy - self.center.1)
    }

    /// How steeply (metres a pixel) it comes nearer on the way from its centre to a pixel.
    fn rise_towards(&self, pixel: (f32, f32)) -> f32 {
        let way = (pixel.0 - self.center.0).hypot(pixel.1 - self.center.1);
        (self.depth - self.depth_at(pixel)) / way.max(1e-3)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Size of a pixel at 1 m of a lens of 576 px.
    const PIXEL: f32 = 1.0 / 576.0;

    fn filled(depth: &Grid<f32>) -> Grid<f32> {
        let inside = depth.map(|_| true);
        fill(
            depth,
            &inside,
            &depth.map(|_| 0.5),
            PIXEL,
            &Parameters::default(),
        )
    }

    proptest! {
        // Across a hole of 7x7 pixels it is far enough to run straight in inverse depth, as no such plane does.
        #[test]
        fn a_hole_on_a_plane_is_filled_onto_the_plane(
            slope_x in -0.01..0.01f32, slope_y in -0.01..0.01f32,
            left in 1..12usize, top in 1..12usize, width in 1..8usize, height in 1..7usize,
        ) {
            let plane = |x: usize, y: usize| 1.0 + slope_x * x as f32 + slope_y * y as f32;
            let hole = |x, y| (left..left + width).contains(&x) && (top..top + height).contains(&y);
            let depth = Grid::from_fn(21, 21, |x, y| if hole(x, y) { 0.0 } else { plane(x, y) });
            let out = filled(&depth);
            for y in 0..21 {
                for x in 0..21 {
                    let error = out[(x, y)] - plane(x, y);
                    prop_assert!(error.abs() < 1e-4, "{error} at {x} {y}");
                }
            }
        }
    }

    #[test]
    fn a_hole_at_an_edge_keeps_the_step() {
        // A shadow of 3 pixels beside a near box, on a floor that does not rise towards it.
        let depth = Grid::from_fn(30, 20, |x, _| match x {
            0..12 => 0.88,
            12..15 => 0.0,
            _ => 0.83,
        });
        let out = filled(&depth);
        for y in 0..20 {
            for x in 0..30 {
                let expected = if x < 15 { 0.88 } else { 0.83 };
                assert!(
                    (out[(x, y)] - expected).abs() < 1e-5,
                    "{x} {y}: {}",
                    out[(x, y)]
                );
            }
        }
    }

    #[test]
    fn colour_gives_a_hole_at_an_edge_to_the_near_side() {
        let depth = Grid::from_fn(30, 20, |x, _| match x {
            0..12 => 0.88,
            12..14 => 0.0,
            _ => 0.83,
        });
        let guide = Grid::from_fn(30, 20, |x, _| if x < 12 { 0.3 } else { 0.7 });
        let inside = depth.map(|_| true);
        let out = fill(&depth, &inside, &guide, PIXEL, &Parameters::default());
        assert!((out[(12, 9)] - 0.83).abs() < 1e-5, "{}", out[(12, 9)]);
        assert!((out[(11, 9)] - 0.88).abs() < 1e-5);
    }

    #[test]
    fn depth_runs_across_a_wall_too_steep_to_read() {
        // From a rim at 0.80 down to a floor at 0.88 that rises towards the wall's foot.
        let depth = Grid::from_fn(30, 20, |x, _| match x {
            0..8 => 0.80,
            8..15 => 0.0,
            15..18 => 0.88 - 0.003 * (18 - x) as f32,
            _ => 0.88,
        });
        let out = filled(&depth);
        for y in 2..18 {
            for x in 8..15 {
                // From where the rim's last pixel ends to where the floor's first begins.
                let expected = 0.80 + (0.8695 - 0.80) * (x as f32 - 7.5) / 7.0;
                assert!(
                    (out[(x, y)] - expected).abs() < 2e-3,
                    "{x} {y}: {}",
                    out[(x, y)]
                );
            }
        }
    }

    #[test]
    fn a_thin_rim_hides_the_table_behind_it() {
        // Rim of 3 pixels between the table at 0.95 and a hole of the wall inside it.
        let depth = Grid::from_fn(30, 20, |x, _| match x {
            0..5 => 0.95,
            5..8 => 0.80,
            8..11 => 0.0,
            _ => 0.81,
        });
        let out = filled(&depth);
        for x in 8..11 {
            assert!((0.80..=0.81).contains(&out[(x, 10)]), "{}", out[(x, 10)]);
        }
    }
}
