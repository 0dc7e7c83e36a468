//! Filling holes. A hole between two depths is either a wall too steep to give readings, and then the depth
//! runs across it, or an edge that hides what is behind it, and then each of its pixels belongs to one side.
//! Which of the two it is, the far side tells: where it rises towards the near one, it is a wall's foot.

use super::Parameters;
use crate::image::Grid;

/// Radius in pixels in which a hole's surroundings are looked at.
const REACH: isize = 6;
/// Pixels of the far side that its slope is measured on.
const FOOT: usize = 12;
/// Sweeps of relaxation over the holes that depth runs across.
const SWEEPS: usize = 60;
/// Over-relaxation: the usual value for holes of some ten pixels.
const OVER: f32 = 1.7;

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
pub fn fill(
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
    run_across(&mut out, &open);
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
        let (rise, far_depth) = rise_towards(&far_side, &near_side);
        if rise > self.pixel * far * self.parameters.steepest_floor {
            return None;
        }
        let near_is_alike = likeness(&near_side) > 2.0 * likeness(&far_side);
        Some(if near_is_alike {
            depth_of_nearest(&near_side)
        } else {
            far_depth
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

fn depth_of_nearest(side: &[Neighbour]) -> f32 {
    let d = nearest(side);
    let closest = side.iter().filter(|q| q.distance < d + 0.5);
    let (sum, count) = closest.fold((0.0, 0.0), |(s, n), q| (s + q.depth, n + 1.0));
    sum / count
}

/// Mean likeness of a side's closest pixels.
fn likeness(side: &[Neighbour]) -> f32 {
    let d = nearest(side);
    let closest = side.iter().filter(|q| q.distance < d + 1.5);
    let (sum, count) = closest.fold((0.0, 0.0), |(s, n), q| (s + q.likeness, n + 1.0));
    sum / count
}

/// How steeply (metres a pixel) the far side comes nearer in the direction of the near side, and its depth
/// carried on to the hole's pixel: a line fitted to the depth along that direction.
fn rise_towards(far: &[Neighbour], near: &[Neighbour]) -> (f32, f32) {
    let center = |side: &[Neighbour]| {
        let n = side.len() as f32;
        let sum = side
            .iter()
            .fold((0.0, 0.0), |(x, y), q| (x + q.dx, y + q.dy));
        (sum.0 / n, sum.1 / n)
    };
    let (f, n) = (center(far), center(near));
    let length = (n.0 - f.0).hypot(n.1 - f.1).max(1e-3);
    let toward = ((n.0 - f.0) / length, (n.1 - f.1) / length);
    let along = |q: &Neighbour| q.dx * toward.0 + q.dy * toward.1;
    let count = far.len() as f32;
    let mean_along = far.iter().map(along).sum::<f32>() / count;
    let mean_depth = far.iter().map(|q| q.depth).sum::<f32>() / count;
    let (mut xx, mut xz) = (0.0, 0.0);
    for q in far {
        let x = along(q) - mean_along;
        xx += x * x;
        xz += x * (q.depth - mean_depth);
    }
    let slope = if xx > 1.0 { xz / xx } else { 0.0 };
    (-slope, mean_depth - slope * mean_along)
}

/// Lets depth run across the `open` pixels: the harmonic function bounded by what is around them, started
/// from the outside in, then relaxed. It reproduces a plane.
fn run_across(depth: &mut Grid<f32>, open: &[(usize, usize)]) {
    let mut waiting: Vec<_> = open.to_vec();
    while !waiting.is_empty() {
        let reached: Vec<_> = waiting
            .iter()
            .filter_map(|&p| around_mean(depth, p).map(|z| (p, z)))
            .collect();
        if reached.is_empty() {
            break;
        }
        for (p, z) in reached {
            depth[p] = z;
        }
        waiting.retain(|&p| depth[p] <= 0.0);
    }
    for _ in 0..SWEEPS {
        for &p in open {
            if let Some(mean) = around_mean(depth, p) {
                depth[p] += OVER * (mean - depth[p]);
            }
        }
    }
}

/// Mean of the up to four neighbours that have depth.
fn around_mean(depth: &Grid<f32>, (x, y): (usize, usize)) -> Option<f32> {
    let (mut sum, mut count) = (0.0, 0.0);
    for (dx, dy) in [(-1, 0), (1, 0), (0, -1), (0, 1)] {
        if let Some(&z) = depth.get(x as isize + dx, y as isize + dy)
            && z > 0.0
        {
            sum += z;
            count += 1.0;
        }
    }
    (count > 0.0).then(|| sum / count)
}
