//! Which rays carve, and how deep: the enhanced depth in the regions, kept from breaking through walls that
//! a remaining bias or noise would perforate.

use super::Parameters;
use crate::image::Grid;
use crate::reconstruct::depth::{DepthKind, EnhancedDepth};
use crate::reconstruct::region::Regions;

/// Depth before which space is empty, for each pixel of the depth camera; 0 where the ray carves nothing.
/// Around each region there is a ring of pixels at the hull's own depth, so that a wall stands between the
/// last pixel outside and the first inside.
pub(super) fn carving_depth(
    depth: &EnhancedDepth,
    regions: &Regions,
    cell_size: f64,
    parameters: &Parameters,
) -> Grid<f32> {
    let bias = regions.bias.metres as f32;
    let (width, height) = (depth.depth.width(), depth.depth.height());
    let mut carving = Grid::from_fn(width, height, |x, y| {
        let usable = regions.contains(x, y) && depth.kind[(x, y)] != DepthKind::None;
        if usable {
            depth.depth[(x, y)] - bias
        } else {
            0.0
        }
    });
    keep_walls(&mut carving, depth, regions, cell_size, parameters);
    add_ring(&mut carving, regions);
    carving
}

/// Pixels that would leave less than the least wall behind them break through only together: where the
/// readings of a connected group agree that there is nothing but what lies behind the hull. Otherwise the
/// wall stays.
fn keep_walls(
    carving: &mut Grid<f32>,
    depth: &EnhancedDepth,
    regions: &Regions,
    cell_size: f64,
    parameters: &Parameters,
) {
    let least_wall = 1e-3 * parameters.least_wall_mm;
    // A sheet thinner than this falls through the lattice.
    let wall = least_wall.max(1.5 * cell_size as f32);
    let limit = |x: usize, y: usize| regions.front.exit[(x, y)] - wall;
    let (width, height) = (carving.width(), carving.height());
    let mut seen = Grid::from_fn(width, height, |x, y| carving[(x, y)] <= limit(x, y));
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
            gaps.sort_by(f32::total_cmp);
            let through = -0.5 * least_wall + regions.bias.remaining as f32;
            let opens = measured && gaps[gaps.len() / 2] > through;
            for p in group {
                carving[p] = if opens {
                    // All of the hull on this ray goes, whatever noise says.
                    carving[p].max(regions.front.exit[p] + 4.0 * wall)
                } else {
                    limit(p.0, p.1)
                };
            }
        }
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
    for y in 0..inner.height() {
        for x in 0..inner.width() {
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
