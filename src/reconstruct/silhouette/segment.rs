//! Object or backdrop for every cell, decided together with its neighbours.

use super::Parameters;
use super::evidence::Evidence;
use crate::image::Grid;

/// Decides all cells.
pub(super) fn decide(evidence: &Evidence, parameters: &Parameters) -> Grid<bool> {
    let mut object = evidence.object.map(|&e| e > 0.0);
    for _ in 0..4 {
        let previous = object.clone();
        object = Grid::from_fn(previous.width(), previous.height(), |x, y| {
            let mut sum = evidence.object[(x, y)];
            for (dx, dy) in [(1, 0), (-1, 0), (0, 1), (0, -1)] {
                match previous.get(x as isize + dx, y as isize + dy) {
                    Some(true) => sum += parameters.smoothness,
                    Some(false) => sum -= parameters.smoothness,
                    None => {}
                }
            }
            sum > 0.0
        });
    }
    object
}
