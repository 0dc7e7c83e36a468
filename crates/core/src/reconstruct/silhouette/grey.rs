//! Finds the object in pictures without colour. What is as bright as the background may be object as well, and what is
//! darker may be shadow or object, so only the outline decides: compared with the background, the backdrop and any
//! shadow on it change softly, and only the object's outline is abrupt.

use super::Parameters;
use super::cells::Cells;
use super::evidence::{LEAN, Ratios};
use super::segment;
use crate::image::Grid;

/// Cells beside the rectangle's border that are backdrop: all around it agrees with the background.
const BORDER: usize = 2;
/// How much cheaper a boundary becomes where the light changes; more than beside colours, which decide there.
const SHARPNESS: i32 = 4;
/// Evidence below which a cell is not surely object by itself.
const UNSURE: f32 = 1.0;

/// Whether neither picture nor background has any colour.
pub(super) fn is_grey(cells: &Cells) -> bool {
    let is_grey = |grid: &Grid<[f32; 3]>| grid.pixels().iter().all(|&[r, g, b]| r == g && g == b);
    is_grey(&cells.picture) && is_grey(&cells.plate)
}

/// Decides all cells by the outline around them.
pub(super) fn decide(
    cells: &Cells,
    evidence: &Grid<f32>,
    ratios: &Ratios,
    parameters: &Parameters,
) -> Grid<bool> {
    let leaning = leaning(cells, evidence, parameters);
    segment::decide(&leaning, ratios, SHARPNESS, parameters)
}

/// Share of the object's cells that only the outline distinguishes from the backdrop.
pub(super) fn told_by_outline(object: &Grid<bool>, evidence: &Grid<f32>) -> f32 {
    let cells = object.pixels().iter().zip(evidence.pixels());
    let (unsure, all) = cells
        .filter(|&(&is_object, _)| is_object)
        .fold((0u32, 0u32), |(unsure, all), (_, &evidence)| {
            (unsure + u32::from(evidence < UNSURE), all + 1)
        });
    unsure as f32 / all.max(1) as f32
}

/// What is not surely object leans to it, so slightly that a piece of any size within a soft boundary is backdrop.
fn leaning(cells: &Cells, evidence: &Grid<f32>, parameters: &Parameters) -> Grid<f32> {
    let (columns, rows) = (evidence.width(), evidence.height());
    let lean = LEAN * parameters.smoothness / ((columns * rows) as f32).sqrt();
    let is_within = |x: usize, y: usize| {
        let margin = x.min(y).min(columns - 1 - x).min(rows - 1 - y);
        margin >= BORDER && cells.in_volume[y].contains(&x)
    };
    Grid::from_fn(columns, rows, |x, y| match is_within(x, y) {
        true => evidence[(x, y)].max(lean),
        false => evidence[(x, y)],
    })
}
