//! Decides which pixels a region may grow over. Pixels with a reading may. A hole of the depth may be the wall of a
//! hollow, too steep to be read; then a reading of that hollow lies at its end. A hole between an object's top and
//! the table beside it is the object's side, and the depth that was filled in there means nothing. Where it is deeper
//! than the hollow, it was filled in from something else, too.

use super::hollow::{FOUR_DIRECTIONS, lines};
use crate::image::Grid;
use crate::reconstruct::depth::{DepthKind, EnhancedDepth};

/// The pixels with a reading, and those without one from which a row, column or diagonal leads over others like them
/// to a reading that is hollow by `least`, in metres, and at least as deep as they are.
pub(super) fn by_readings(depth: &EnhancedDepth, hollow: &Grid<f32>, least: f32) -> Grid<bool> {
    let mut supported = depth.kind.map(|&k| k == DepthKind::Measured);
    let (width, height) = (supported.width(), supported.height());
    // How deep the hollow is at an end of a hole.
    let end = |pixel: (usize, usize)| {
        let is_hollow = depth.kind[pixel] == DepthKind::Measured && hollow[pixel] > least;
        if is_hollow {
            depth.depth[pixel]
        } else {
            f32::NEG_INFINITY
        }
    };
    let mut hole = Vec::new();
    for line in lines(width, height, FOUR_DIRECTIONS) {
        let mut begins = f32::NEG_INFINITY;
        hole.clear();
        let mut support = |hole: &[(usize, usize)], deepest: f32| {
            for &p in hole.iter().filter(|&&p| depth.depth[p] <= deepest) {
                supported[p] = true;
            }
        };
        for pixel in line {
            if depth.kind[pixel] == DepthKind::Filled {
                hole.push(pixel);
                continue;
            }
            let ends = end(pixel);
            support(&hole, begins.max(ends));
            hole.clear();
            begins = ends;
        }
        support(&hole, begins);
    }
    supported
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reconstruct::depth::{Facts, SensorNoise};

    #[test]
    fn a_hole_is_supported_by_a_hollow_reading_at_its_end_alone_that_is_as_deep() {
        /// Here the depth that was filled in is deeper than the floor.
        const TOO_DEEP: usize = 6;
        // One row: top, unread wall, hollow floor, unread wall, top, unread side, table.
        let kinds = b"mmffmmffmmffmm";
        let kind = Grid::from_fn(kinds.len(), 1, |x, _| match kinds[x] {
            b'm' => DepthKind::Measured,
            _ => DepthKind::Filled,
        });
        let hollow = Grid::from_fn(kinds.len(), 1, |x, _| f32::from(u8::from(x == 4 || x == 5)));
        let depth = EnhancedDepth {
            depth: Grid::from_fn(kinds.len(), 1, |x, _| if x == TOO_DEEP { 1.1 } else { 1.0 }),
            sigma: Grid::filled(kinds.len(), 1, 0.0),
            kind,
            noise: SensorNoise {
                per_square_depth: 0.0,
                jitter_px: 0.0,
                fixed_per_square_depth: 0.0,
                median_deviation: 0.0,
            },
            facts: Facts::default(),
        };
        let supported = by_readings(&depth, &hollow, 0.5);
        for x in 0..kinds.len() {
            let is_supported = x != TOO_DEEP && !(10..12).contains(&x);
            assert_eq!(supported[(x, 0)], is_supported, "pixel {x}");
        }
    }
}
