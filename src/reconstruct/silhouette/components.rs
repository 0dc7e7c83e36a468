//! Connected pieces and holes of a coarse silhouette: what cannot be the object is dropped, what cannot be a
//! hole is filled, and both are counted.

use super::Parameters;
use super::cells::Cells;
use crate::image::Grid;

/// What was mended.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Tidied {
    /// Pieces kept.
    pub pieces: usize,
    /// Pieces dropped as too small.
    pub dropped: usize,
    /// Holes that stayed.
    pub holes: usize,
    /// Holes filled as too small or not clearly backdrop.
    pub filled: usize,
}

/// One connected piece.
struct Piece {
    cells: Vec<usize>,
    touches_border: bool,
}

/// Drops specks and fills pinholes.
pub(super) fn tidy(
    object: &mut Grid<bool>,
    cells: &Cells,
    evidence: &Grid<f32>,
    parameters: &Parameters,
) -> Tidied {
    let mut tidied = Tidied::default();
    let pieces = pieces(object, true);
    let largest = pieces.iter().map(|p| p.cells.len()).max().unwrap_or(0) as f32;
    for piece in pieces {
        if (piece.cells.len() as f32) < parameters.smallest_piece * largest {
            tidied.dropped += 1;
            set(object, &piece.cells, false);
        } else {
            tidied.pieces += 1;
        }
    }
    let cell_area = (cells.size * cells.size) as f32;
    for hole in self::pieces(object, false) {
        if hole.touches_border {
            continue;
        }
        let weigh = |&i: &usize| evidence.pixels()[i];
        let sum: f32 = hole.cells.iter().map(weigh).sum();
        let small = hole.cells.len() as f32 * cell_area < parameters.smallest_hole_px;
        if small || sum > 0.0 {
            tidied.filled += 1;
            set(object, &hole.cells, true);
        } else {
            tidied.holes += 1;
        }
    }
    tidied
}

fn set(grid: &mut Grid<bool>, cells: &[usize], value: bool) {
    for &i in cells {
        grid.pixels_mut()[i] = value;
    }
}

/// The connected pieces of `value`, in the order of their first cells. Object connects over corners,
/// backdrop over sides, so that no line of one crosses the other.
fn pieces(grid: &Grid<bool>, value: bool) -> Vec<Piece> {
    let mut seen = vec![false; grid.pixels().len()];
    let mut found = Vec::new();
    for start in 0..seen.len() {
        if !seen[start] && grid.pixels()[start] == value {
            found.push(grow(grid, value, start, &mut seen));
        }
    }
    found
}

fn grow(grid: &Grid<bool>, value: bool, start: usize, seen: &mut [bool]) -> Piece {
    const SIDES: [(isize, isize); 4] = [(1, 0), (-1, 0), (0, 1), (0, -1)];
    const CORNERS: [(isize, isize); 4] = [(1, 1), (-1, 1), (1, -1), (-1, -1)];
    let corners: &[(isize, isize)] = if value { &CORNERS } else { &[] };
    let width = grid.width();
    let mut touches_border = false;
    let mut cells = vec![start];
    seen[start] = true;
    let mut next = 0;
    while let Some(&i) = cells.get(next) {
        next += 1;
        let (x, y) = ((i % width) as isize, (i / width) as isize);
        for &(dx, dy) in SIDES.iter().chain(corners) {
            let Some(&neighbour) = grid.get(x + dx, y + dy) else {
                touches_border = true;
                continue;
            };
            let j = (y + dy) as usize * width + (x + dx) as usize;
            if neighbour == value && !seen[j] {
                seen[j] = true;
                cells.push(j);
            }
        }
    }
    Piece {
        cells,
        touches_border,
    }
}
