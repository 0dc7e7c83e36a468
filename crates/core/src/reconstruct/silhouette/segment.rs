//! Decides object or backdrop for all cells together: the labelling that agrees best with each cell's evidence and
//! has its boundaries where the light changes abruptly compared with the background. The soft edge of a shadow is
//! no such place, but an object's outline is, however faint the contrast.

use super::Parameters;
use super::cut::GridCut;
use super::evidence::Ratios;
use crate::image::Grid;

/// Whole units of cost in one of evidence.
const UNIT: f32 = 64.0;
/// Change of the logarithm of light, from cell to cell, at which a boundary of sharpness 2 costs a quarter.
const ABRUPT: f32 = 0.1;
/// Share of the cost of a boundary that remains where the light changes most.
const LEAST: f32 = 0.03;

/// Decides all cells from the evidence of each and from how its light compares with the background's; the higher
/// `sharpness`, the less a boundary costs where that changes.
pub(super) fn decide(
    evidence: &Grid<f32>,
    ratios: &Ratios,
    sharpness: i32,
    parameters: &Parameters,
) -> Grid<bool> {
    let (columns, rows) = (evidence.width(), evidence.height());
    let preference = evidence.map(|e| (e * UNIT) as i32);
    let costs = Grid::from_fn(columns, rows, |x, y| {
        let to = |nx: usize, ny: usize| {
            if nx == columns || ny == rows {
                return 0;
            }
            let change = change(ratios, (x, y), (nx, ny));
            let share = LEAST + (1.0 - LEAST) / (1.0 + change).powi(sharpness);
            (parameters.smoothness * share * UNIT) as i32
        };
        [to(x + 1, y), to(x, y + 1)]
    });
    GridCut::new(&preference, &costs).solve(columns, rows)
}

/// Square of the change of light between two cells, in units of what is abrupt or of noise.
fn change(ratios: &Ratios, a: (usize, usize), b: (usize, usize)) -> f32 {
    let (ratio_a, ratio_b) = (ratios.log_ratio[a], ratios.log_ratio[b]);
    if ratio_a == ratio_b {
        return 0.0;
    }
    let (variance_a, variance_b) = (ratios.variance[a], ratios.variance[b]);
    (0..3)
        .map(|c| {
            let variance = ABRUPT * ABRUPT + 4.0 * (variance_a[c] + variance_b[c]);
            (ratio_a[c] - ratio_b[c]).powi(2) / variance
        })
        .fold(0.0, f32::max)
}
