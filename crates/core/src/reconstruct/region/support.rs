//! Decides which pixels a region may grow over. Pixels with a reading may. A hole of the depth may be the wall of a
//! hollow, too steep to be read; then a reading of that hollow lies at its end. A hole between an object's top and
//! the table beside it is the object's side, and the depth that was filled in there means nothing.

use super::hollow::{FOUR_DIRECTIONS, lines};
use crate::image::Grid;
use crate::reconstruct::depth::{DepthKind, EnhancedDepth};

/// The pixels with a reading, and those without one from which a row, column or diagonal leads over others like them
/// to a reading that is hollow by `least`, in metres.
pub(super) fn by_readings(depth: &EnhancedDepth, hollow: &Grid<f32>, least: f32) -> Grid<bool> {
    let mut supported = depth.kind.map(|&k| k == DepthKind::Measured);
    let (width, height) = (supported.width(), supported.height());
    let mut hole = Vec::new();
    for line in lines(width, height, FOUR_DIRECTIONS) {
        // Whether the hole began at a hollow reading.
        let mut begins_hollow = false;
        hole.clear();
        for pixel in line {
            if depth.kind[pixel] == DepthKind::Filled {
                hole.push(pixel);
                continue;
            }
            let is_hollow = depth.kind[pixel] == DepthKind::Measured && hollow[pixel] > least;
            if begins_hollow || is_hollow {
                hole.iter().for_each(|&p| supported[p] = true);
            }
            hole.clear();
            begins_hollow = is_hollow;
        }
        if begins_hollow {
            hole.iter().for_each(|&p| supported[p] = true);
        }
    }
    supported
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reconstruct::depth::{Facts, SensorNoise};

    #[test]
    fn a_hole_is_supported_by_a_hollow_reading_at_its_end_alone() {
        // One row: top, unread wall, hollow floor, unread wall, top, unread side, table.
        let kinds = b"mmffmmffmmffmm";
        let kind = Grid::from_fn(kinds.len(), 1, |x, _| match kinds[x] {
            b'm' => DepthKind::Measured,
            _ => DepthKind::Filled,
        });
        let hollow = Grid::from_fn(kinds.len(), 1, |x, _| f32::from(u8::from(x == 4 || x == 5)));
        let depth = EnhancedDepth {
            depth: Grid::filled(kinds.len(), 1, 1.0),
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
            assert_eq!(supported[(x, 0)], !(10..12).contains(&x), "pixel {x}");
        }
    }
}
