//! Connected pieces and holes of a coarse silhouette: drops pieces that cannot be the object, fills holes that
//! cannot be holes, and counts both.

use super::Parameters;
use super::cells::Cells;
use super::region::Region;
use crate::image::{Grid, Mask, PixelRect};

/// What was mended.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct MaskRepairs {
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
    /// Whether it goes on, or may, beyond the part that was looked at.
    touches_border: bool,
}

/// Drops specks and fills pinholes.
pub(super) fn tidy(
    object: &mut Grid<bool>,
    cells: &Cells,
    evidence: &Grid<f32>,
    parameters: &Parameters,
) -> MaskRepairs {
    let mut tidied = MaskRepairs::default();
    let (columns, rows) = (object.width(), object.height());
    let Some(extent) = object.extent(PixelRect::whole(columns, rows), |&o| o) else {
        return tidied;
    };
    let pieces = pieces(object, true, extent);
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
    // The backdrop around the object is one piece with what lies beyond.
    for hole in self::pieces(object, false, extent.grown(1, columns, rows)) {
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

/// The rectangle in `part` of those pieces of a mask (128 and up) that can be the object: they reach into the volume's
/// projection, and are no specks. All of `part` where none does.
pub(super) fn object_bounds(
    mask: &Mask,
    part: PixelRect,
    region: &Region,
    parameters: &Parameters,
) -> PixelRect {
    let mut object = mask.map(|&level| level >= 128);
    let columns: Vec<(f64, f64)> = (0..mask.height())
        .map(|y| region.columns(y as f64, 1.0))
        .collect();
    let is_in_volume = |&i: &usize| {
        let (first, last) = columns[i / mask.width()];
        (first..=last).contains(&((i % mask.width()) as f64))
    };
    let (candidates, others): (Vec<_>, Vec<_>) = pieces(&object, true, part)
        .into_iter()
        .partition(|piece| piece.cells.iter().any(is_in_volume));
    let largest = candidates.iter().map(|p| p.cells.len()).max().unwrap_or(0) as f32;
    let is_speck = |p: &&Piece| (p.cells.len() as f32) < parameters.smallest_piece * largest;
    for piece in others.iter().chain(candidates.iter().filter(is_speck)) {
        set(&mut object, &piece.cells, false);
    }
    object.extent(part, |&o| o).unwrap_or(part)
}

fn set(grid: &mut Grid<bool>, cells: &[usize], value: bool) {
    for &i in cells {
        grid.pixels_mut()[i] = value;
    }
}

/// The connected pieces of `value` within `part`, in the order of their first cells. Object connects over corners,
/// backdrop over sides, so that no line of one crosses the other.
fn pieces(grid: &Grid<bool>, value: bool, part: PixelRect) -> Vec<Piece> {
    let mut seen = vec![false; grid.pixels().len()];
    let mut found = Vec::new();
    for y in part.y0..part.y1 {
        for start in (y * grid.width() + part.x0)..(y * grid.width() + part.x1) {
            if !seen[start] && grid.pixels()[start] == value {
                found.push(grow(grid, value, part, start, &mut seen));
            }
        }
    }
    found
}

fn grow(grid: &Grid<bool>, value: bool, part: PixelRect, start: usize, seen: &mut [bool]) -> Piece {
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
        let (x, y) = (i % width, i / width);
        for &(dx, dy) in SIDES.iter().chain(corners) {
            let (nx, ny) = (x.wrapping_add_signed(dx), y.wrapping_add_signed(dy));
            if !part.contains(nx, ny) {
                touches_border = true;
                continue;
            }
            let j = ny * width + nx;
            if grid.pixels()[j] == value && !seen[j] {
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
