//! Object or backdrop for every cell, decided for all of them together: the labelling that agrees best with
//! each cell's evidence and has its boundaries where the light changes abruptly against the plate. A
//! shadow's soft edge is no such place, an object's outline is, however faint the contrast beside it.

use super::Parameters;
use super::cells::Cells;
use super::cut::GridCut;
use super::evidence::Evidence;
use crate::image::Grid;

/// Whole units of cost in one of evidence.
const UNIT: f32 = 64.0;
/// Change of the logarithm of light, from cell to cell, at which a boundary costs a quarter.
const ABRUPT: f32 = 0.08;
/// Share of the cost of a boundary that remains where the light changes most.
const LEAST: f32 = 0.06;

/// Decides all cells.
pub(super) fn decide(cells: &Cells, evidence: &Evidence, parameters: &Parameters) -> Grid<bool> {
    let (columns, rows) = (cells.picture.width(), cells.picture.height());
    let preference = evidence.object.map(|e| (e * UNIT) as i32);
    let costs = Grid::from_fn(columns, rows, |x, y| {
        let to = |nx: usize, ny: usize| {
            if nx == columns || ny == rows {
                return 0;
            }
            let change = change(evidence, (x, y), (nx, ny));
            let share = LEAST + (1.0 - LEAST) / (1.0 + change).powi(2);
            (parameters.smoothness * share * UNIT) as i32
        };
        [to(x + 1, y), to(x, y + 1)]
    });
    GridCut::new(&preference, &costs).solve(columns, rows)
}

/// Square of the change of light between two cells, in units of what is abrupt or of noise.
fn change(evidence: &Evidence, a: (usize, usize), b: (usize, usize)) -> f32 {
    let (ratio_a, ratio_b) = (evidence.log_ratio[a], evidence.log_ratio[b]);
    let (noise_a, noise_b) = (evidence.noise[a], evidence.noise[b]);
    (0..3)
        .map(|c| {
            let variance = ABRUPT * ABRUPT + 4.0 * (noise_a[c].powi(2) + noise_b[c].powi(2));
            (ratio_a[c] - ratio_b[c]).powi(2) / variance
        })
        .fold(0.0, f32::max)
}
