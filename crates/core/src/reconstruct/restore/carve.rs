//! Decides which rays carve, and how deep: to the enhanced depth in the regions, to what was read elsewhere if all
//! of the hull is carved, but not through walls that a remaining bias or noise would perforate.

use super::{Parameters, Source};
use crate::image::{Grid, PixelRect};
use crate::reconstruct::depth::DepthKind;
use crate::reconstruct::region::Regions;
use crate::statistics::upper_median;
use rayon::prelude::*;

/// Depth before which space is empty, for each pixel of the depth camera; 0 where the ray carves nothing.
/// Around each region there is a ring of pixels at the hull's own depth, so that a wall stands between the
/// last pixel outside and the first inside.
pub(super) fn carving_depth(source: &Source, cell_size: f64, parameters: &Parameters) -> Grid<f32> {
    let Source { depth, regions, .. } = source;
    let (width, height) = (depth.depth.width(), depth.depth.height());
    let mut carving =
        Grid::from_fn_parallel(width, height, |x, y| of_region(source, x, y).unwrap_or(0.0));
    keep_walls(&mut carving, source, cell_size, parameters);
    add_ring(&mut carving, regions);
    carving
}

/// The same, but outside of regions, too, each ray carves that was read. What is only filled in carves nothing
/// there: at the widest place of a vase, between its shoulder and the table, it would go through the wall.
pub(super) fn carving_depth_everywhere(
    source: &Source,
    cell_size: f64,
    parameters: &Parameters,
) -> Grid<f32> {
    let Source { depth, regions, .. } = source;
    let bias = regions.bias.metres as f32;
    let (width, height) = (depth.depth.width(), depth.depth.height());
    let of_reading = |x, y| {
        let is_read =
            depth.kind[(x, y)] == DepthKind::Measured && regions.front.depth[(x, y)].is_finite();
        is_read.then(|| depth.depth[(x, y)] - bias)
    };
    let mut carving = Grid::from_fn_parallel(width, height, |x, y| {
        let carved = of_region(source, x, y).or_else(|| of_reading(x, y));
        carved.unwrap_or(0.0)
    });
    keep_walls(&mut carving, source, cell_size, parameters);
    carving
}

/// How deep a pixel carves that belongs to a region or to the top of its wall; `None` for any other.
fn of_region(source: &Source, x: usize, y: usize) -> Option<f32> {
    let Source { depth, regions, .. } = source;
    let carved = depth.depth[(x, y)] - regions.bias.metres as f32;
    if depth.kind[(x, y)] == DepthKind::None {
        None
    } else if regions.contains(x, y) {
        Some(carved)
    } else if is_top_of_wall(source, x, y, carved) {
        Some(carved.max(regions.front.depth[(x, y)]))
    } else {
        None
    }
}

/// Whether a pixel beside a hollow is where a wall begins that is too steep to be read. Its filled depth lies so little
/// behind the hull that it does not belong to the region; without it, the wall would begin a pixel farther in. What is
/// filled in deeper than the hollow is no wall of it.
fn is_top_of_wall(source: &Source, x: usize, y: usize, carved: f32) -> bool {
    let Source { depth, regions, .. } = source;
    let beside = [(-1, 0), (1, 0), (0, -1), (0, 1)]
        .iter()
        .map(|(dx, dy)| (x as isize + dx, y as isize + dy))
        .filter(|&(x, y)| regions.is_hollow(x, y))
        .filter_map(|(x, y)| depth.depth.get(x, y))
        .any(|&hollow| depth.depth[(x, y)] <= hollow);
    beside
        && depth.kind[(x, y)] == DepthKind::Filled
        && regions.front.depth[(x, y)].is_finite()
        && carved < regions.front.exit[(x, y)]
}

/// Keeps walls standing: [`break_through`] finds the rays that may open the object, [`keep_across`] what all others
/// have to leave.
fn keep_walls(carving: &mut Grid<f32>, source: &Source, cell_size: f64, parameters: &Parameters) {
    let least_wall = 1e-3 * parameters.least_wall_mm;
    // A sheet thinner than this falls through the lattice.
    let wall = least_wall.max(1.5 * cell_size as f32);
    let opened = break_through(carving, source, wall, parameters);
    // Across a wall that the ray grazes there are cells beside each other: half of that holds.
    let across = least_wall.max(0.75 * cell_size as f32);
    keep_across(carving, source, across, &opened);
}

/// Pixels that would leave less than a `wall` behind them break through only together: where the readings of a
/// connected group agree that there is nothing but what lies behind the hull. Otherwise the wall stays. Tells
/// which break through.
fn break_through(
    carving: &mut Grid<f32>,
    source: &Source,
    wall: f32,
    parameters: &Parameters,
) -> Grid<bool> {
    let Source { depth, regions, .. } = source;
    let limit = |x: usize, y: usize| regions.front.exit[(x, y)] - wall;
    let through = -0.5e-3 * parameters.least_wall_mm + regions.bias.remaining as f32;
    let (width, height) = (carving.width(), carving.height());
    let stays = |x: usize, y: usize| carving[(x, y)] <= limit(x, y);
    let mut seen = Grid::from_fn_parallel(width, height, stays);
    let mut opened = Grid::filled(width, height, false);
    for y in 0..height {
        for x in 0..width {
            if seen[(x, y)] {
                continue;
            }
            let group = connected(&mut seen, (x, y));
            let mut gaps: Vec<f32> = group
                .iter()
                .filter(|&&p| depth.kind[p] == DepthKind::Measured)
                .map(|&p| carving[p] - regions.front.exit[p])
                .collect();
            let measured =
                2 * gaps.len() >= group.len() && gaps.len() >= parameters.least_opening_px;
            let usual = upper_median(&mut gaps);
            let opens = measured && usual.is_some_and(|gap| gap > through);
            for p in group {
                opened[p] = opens;
                carving[p] = if opens {
                    // All of the hull on this ray goes, whatever noise says.
                    carving[p].max(regions.front.exit[p] + 4.0 * wall)
                } else {
                    limit(p.0, p.1)
                };
            }
        }
    }
    opened
}

/// Leaves walls of `across` metres, measured across them, on all rays that do not break through.
fn keep_across(carving: &mut Grid<f32>, source: &Source, across: f32, opened: &Grid<bool>) {
    let front = &source.regions.front;
    let width = carving.width().max(1);
    let rows = carving.pixels_mut().par_chunks_mut(width).enumerate();
    rows.for_each(|(y, row)| {
        for (x, carved) in row.iter_mut().enumerate() {
            if *carved > 0.0 && !opened[(x, y)] {
                let deepest = front.exit[(x, y)] - across * slant(source, x, y);
                *carved = carved.min(deepest.max(front.depth[(x, y)]));
            }
        }
    });
}

/// How much longer a ray's way through a wall is than the wall is thick, where the wall's far side is slanted as
/// the hull's is there. Of the differences to either side the smaller one counts, which is not that of an edge.
fn slant(source: &Source, x: usize, y: usize) -> f32 {
    /// A wall seen more edge-on than this is left to its neighbours.
    const STEEPEST: f32 = 10.0;
    let exit = &source.regions.front.exit;
    let here = exit[(x, y)];
    let pixel = here / source.camera.camera.intrinsics.focal_px.min() as f32;
    let slope = |dx: isize, dy: isize| {
        let beside = |step: isize| {
            let at = (x as isize + step * dx, y as isize + step * dy);
            exit.get(at.0, at.1)
                .map_or(f32::INFINITY, |&d| (d - here).abs())
        };
        beside(-1).min(beside(1)) / pixel
    };
    let length = 1.0f32.hypot(slope(1, 0)).hypot(slope(0, 1));
    if length.is_finite() {
        length.min(STEEPEST)
    } else {
        1.0
    }
}

fn connected(seen: &mut Grid<bool>, start: (usize, usize)) -> Vec<(usize, usize)> {
    let mut pixels = vec![start];
    seen[start] = true;
    let mut next = 0;
    while let Some(&(x, y)) = pixels.get(next) {
        next += 1;
        for p in [
            (x.wrapping_sub(1), y),
            (x + 1, y),
            (x, y.wrapping_sub(1)),
            (x, y + 1),
        ] {
            if p.0 < seen.width() && p.1 < seen.height() && !seen[p] {
                seen[p] = true;
                pixels.push(p);
            }
        }
    }
    pixels
}

/// Pixels next to a carving one that carve nothing get the hull's own depth; beyond the hull's contour that
/// of the carving neighbours.
fn add_ring(carving: &mut Grid<f32>, regions: &Regions) {
    let inner = carving.clone();
    let (width, height) = (inner.width(), inner.height());
    let Some(carved) = inner.extent(PixelRect::whole(width, height), |&d| d != 0.0) else {
        return;
    };
    let part = carved.grown(1, width, height);
    for y in part.y0..part.y1 {
        for x in part.x0..part.x1 {
            if inner[(x, y)] != 0.0 {
                continue;
            }
            let around = (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (dx, dy)));
            let (mut sum, mut count) = (0.0, 0);
            for (dx, dy) in around {
                let (nx, ny) = (x as isize + dx, y as isize + dy);
                if inner.get(nx, ny).is_some_and(|&d| d != 0.0) {
                    sum += regions.front.depth[(nx as usize, ny as usize)];
                    count += 1;
                }
            }
            if count > 0 {
                let own = regions.front.depth[(x, y)];
                carving[(x, y)] = if own.is_finite() {
                    own
                } else {
                    sum / count as f32
                };
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reconstruct::depth::EnhancedDepth;
    use crate::reconstruct::restore::testing::{SIDE, camera, evidence};

    /// How deep each pixel of the middle row carves, where the left half is a region, free space or a hollow, and the
    /// right half was not read but filled in with what the left half has: `read` metres, of which `remaining` may be
    /// bias. The hull is from 0.7 m to 0.9 m.
    fn carved_row(read: f32, remaining: f64, last_hollow: usize) -> Vec<f32> {
        filled_row(read, read, remaining, last_hollow)
    }

    /// The same, where `filled` metres were filled in.
    fn filled_row(read: f32, filled: f32, remaining: f64, last_hollow: usize) -> Vec<f32> {
        let (depth, mut regions) = half_read(read, filled);
        regions.bias.remaining = remaining;
        regions.labels = Grid::from_fn(SIDE, SIDE, |x, _| u16::from(x < SIDE / 2));
        regions.last_hollow = last_hollow;
        middle_row(&depth, &regions, carving_depth)
    }

    /// Evidence of which the left half was read, and the right half filled in.
    fn half_read(read: f32, filled: f32) -> (EnhancedDepth, Regions) {
        let (mut depth, regions) = evidence(read);
        let halves = |x: usize| match x < SIDE / 2 {
            true => (DepthKind::Measured, read),
            false => (DepthKind::Filled, filled),
        };
        depth.kind = Grid::from_fn(SIDE, SIDE, |x, _| halves(x).0);
        depth.depth = Grid::from_fn(SIDE, SIDE, |x, _| halves(x).1);
        (depth, regions)
    }

    /// How deep each pixel of the middle row carves.
    fn middle_row(
        depth: &EnhancedDepth,
        regions: &Regions,
        carving: fn(&Source, f64, &Parameters) -> Grid<f32>,
    ) -> Vec<f32> {
        let source = Source {
            number: 0,
            camera: &camera(0.8),
            depth,
            regions,
        };
        carving(&source, 1e-3, &Parameters::default())
            .row(SIDE / 2)
            .to_vec()
    }

    #[test]
    fn a_wall_that_is_not_read_begins_beside_a_hollow_and_not_beside_free_space() {
        let (first, beside) = (SIDE / 2 - 1, SIDE / 2);
        let hollow = carved_row(0.8, 0.0, 1);
        assert_eq!((hollow[first], hollow[beside]), (0.8, 0.8));
        // There the side of the body stands that hides what is behind it: the hull's own depth.
        let free_space = carved_row(0.8, 0.0, 0);
        assert_eq!((free_space[first], free_space[beside]), (0.8, 0.7));
        assert_eq!(free_space[beside + 1], 0.0);
    }

    #[test]
    fn what_is_only_filled_in_carves_nothing_outside_of_regions() {
        let (depth, mut regions) = half_read(0.8, 0.8);
        let (last_read, beside) = (SIDE / 2 - 1, SIDE / 2);
        let inside = middle_row(&depth, &regions, carving_depth_everywhere);
        assert_eq!((inside[last_read], inside[beside]), (0.8, 0.8));
        regions.labels = Grid::filled(SIDE, SIDE, 0);
        let outside = middle_row(&depth, &regions, carving_depth_everywhere);
        assert_eq!((outside[last_read], outside[beside]), (0.8, 0.0));
    }

    #[test]
    fn what_is_filled_in_deeper_than_a_hollow_is_no_wall_of_it() {
        let beside = SIDE / 2;
        assert_eq!(filled_row(0.8, 0.78, 0.0, 1)[beside], 0.78);
        assert_eq!(filled_row(0.8, 0.81, 0.0, 1)[beside], 0.7);
    }

    #[test]
    fn rays_that_reach_the_table_open_the_hull_unless_a_bias_may_explain_that() {
        let table = 0.901;
        let opened = carved_row(table, 0.5e-3, 0);
        assert!(opened[1] > 0.905, "{opened:?}");
        let doubtful = carved_row(table, 5e-3, 0);
        assert!((doubtful[1] - 0.898).abs() < 1e-6, "{doubtful:?}");
    }
}
