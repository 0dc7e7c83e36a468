//! Finds which part of which face a grid of corners shows, where the markers are too small to be read one by one:
//! compares everything between the corners with how each face looks there. It sees pictures only through the
//! brightness that it is given.

use super::grid::{Labelled, bounded, turned, without_false_corners};
use super::session::Corner;
use crate::calibration::{Board, Face};
use crate::image::Grid;
use nalgebra::Point2;

/// Samples along a side of a square: about a marker's cells.
const SAMPLES: usize = 6;
/// White squares that tell anything, and squares of a large grid that are enough.
const FEWEST_SQUARES: usize = 6;
const MOST_SQUARES: usize = 128;
/// Least correlation of a picture with the board, and by how much it must exceed that of every other reading.
const LEAST_LIKENESS: f64 = 0.35;
const LEAST_LEAD: f64 = 0.15;

/// A square's darkness, row by row.
type Patch = [f64; SAMPLES * SAMPLES];

/// A square of a grid as a picture shows it.
struct Square {
    at: (usize, usize),
    darkness: Patch,
}

/// A face, and where on it a grid lies: turned by quarters, its first corner at a column and row.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Reading {
    face: Face,
    quarters: usize,
    first: [isize; 2],
}

/// Reads a grid of corners as a part of a ChArUco board. `None` where no reading, or more than one, is like it.
pub(super) fn read(
    labelled: Labelled,
    board: &Board,
    brightness: impl Fn(Point2<f64>) -> f64,
) -> Option<(Face, Vec<Corner>)> {
    let (grid, size) = bounded(without_false_corners(labelled))?;
    let squares = squares(&grid, brightness);
    let mut readings: Vec<(f64, Reading)> = Vec::new();
    for &face in board.faces() {
        let look = look(board, face);
        for reading in readings_of(board, face, size) {
            let likeness = likeness(board, &look, &squares, size, &reading);
            readings.extend(likeness.map(|likeness| (likeness, reading)));
        }
    }
    readings.sort_by(|a, b| b.0.total_cmp(&a.0));
    let &(best, reading) = readings.first()?;
    let second = readings.get(1).map_or(0.0, |r| r.0);
    let is_clear = best >= LEAST_LIKENESS && best - second >= LEAST_LEAD;
    is_clear.then(|| (reading.face, corners(board, &grid, size, &reading)))
}

/// How dark a face's squares are, `SAMPLES` by `SAMPLES` each: the part of each sample that is black.
fn look(board: &Board, face: Face) -> Grid<f64> {
    let [width, height] = [board.columns, board.rows].map(|n| (n + 1) * SAMPLES);
    let mut look = Grid::filled(width, height, 0.0);
    let scale = SAMPLES as f64 / board.square;
    for black in board.black_rectangles(face) {
        let [low, high] =
            [black.min, black.max].map(|p| p.map(|v| (v * scale + SAMPLES as f64).max(0.0)));
        let covered = |k: usize, axis: usize| {
            (high[axis].min(k as f64 + 1.0) - low[axis].max(k as f64)).max(0.0)
        };
        for y in low[1] as usize..(high[1].ceil() as usize).min(height) {
            for x in low[0] as usize..(high[0].ceil() as usize).min(width) {
                look[(x, y)] += covered(x, 0) * covered(y, 1);
            }
        }
    }
    look
}

/// Squares between four corners each; of many, some.
fn squares(grid: &Labelled, brightness: impl Fn(Point2<f64>) -> f64) -> Vec<Square> {
    let whole = |&(i, j): &(i32, i32)| {
        let corners = [(i, j), (i + 1, j), (i, j + 1), (i + 1, j + 1)].map(|at| grid.get(&at));
        let [Some(a), Some(b), Some(c), Some(d)] = corners else {
            return None;
        };
        Some(((i as usize, j as usize), [a, b, c, d]))
    };
    let all: Vec<_> = grid.keys().filter_map(whole).collect();
    let step = all.len().div_ceil(MOST_SQUARES).max(1);
    let look = |(at, [a, b, c, d]): ((usize, usize), [&Point2<f64>; 4])| Square {
        at,
        darkness: std::array::from_fn(|k| {
            let [u, v] = [k % SAMPLES, k / SAMPLES].map(|n| (n as f64 + 0.5) / SAMPLES as f64);
            let (above, below) = (a.lerp(b, u), c.lerp(d, u));
            -brightness(above.lerp(&below, v))
        }),
    };
    all.into_iter().step_by(step).map(look).collect()
}

/// All places on a face where a grid of this size may lie; one line of it may be none of the board's.
fn readings_of(board: &Board, face: Face, size: [usize; 2]) -> Vec<Reading> {
    let mut all = Vec::new();
    for quarters in 0..4_usize {
        let [width, height] = match quarters.is_multiple_of(2) {
            true => size,
            false => [size[1], size[0]],
        };
        let firsts = |corners: usize, all: usize| -1..=all as isize - corners as isize + 1;
        for row in firsts(height, board.rows) {
            for column in firsts(width, board.columns) {
                all.push(Reading {
                    face,
                    quarters,
                    first: [column, row],
                });
            }
        }
    }
    all
}

/// Correlation of what white squares show beyond what they all show: their markers' own bits. `None` for too few.
fn likeness(
    board: &Board,
    look: &Grid<f64>,
    squares: &[Square],
    size: [usize; 2],
    reading: &Reading,
) -> Option<f64> {
    let [width, height] = size.map(|n| n - 1);
    let mut pairs: Vec<(Patch, Patch)> = Vec::new();
    for square in squares {
        let at = turned(square.at, [width, height], reading.quarters);
        // The board's squares begin before its first corner.
        let [i, j] = [
            at.0 as isize + reading.first[0] + 1,
            at.1 as isize + reading.first[1] + 1,
        ];
        let within =
            (1..board.columns as isize).contains(&i) && (1..board.rows as isize).contains(&j);
        if !within || Board::is_black(i as usize, j as usize) {
            continue;
        }
        let (x, y) = (i as usize * SAMPLES, j as usize * SAMPLES);
        let mut shown = [0.0; SAMPLES * SAMPLES];
        for (k, darkness) in square.darkness.iter().enumerate() {
            let at = turned((k % SAMPLES, k / SAMPLES), [SAMPLES; 2], reading.quarters);
            shown[at.1 * SAMPLES + at.0] = *darkness;
        }
        let expected = |k: usize| look[(x + k % SAMPLES, y + k / SAMPLES)];
        pairs.push((shown, std::array::from_fn(expected)));
    }
    (pairs.len() >= FEWEST_SQUARES).then(|| correlation(&pairs))
}

/// Correlation of two lists of patches, each position less its mean.
fn correlation(pairs: &[(Patch, Patch)]) -> f64 {
    let count = pairs.len() as f64;
    let (mut both, mut left, mut right) = (0.0, 0.0, 0.0);
    for k in 0..SAMPLES * SAMPLES {
        let mean = |of: fn(&(Patch, Patch)) -> &Patch| {
            pairs.iter().map(|pair| of(pair)[k]).sum::<f64>() / count
        };
        let (a, b) = (mean(|p| &p.0), mean(|p| &p.1));
        for (shown, expected) in pairs {
            let (s, e) = (shown[k] - a, expected[k] - b);
            both += s * e;
            left += s * s;
            right += e * e;
        }
    }
    both / (left * right).sqrt().max(1e-12)
}

/// The corners of a grid by the board's columns and rows.
fn corners(board: &Board, grid: &Labelled, size: [usize; 2], reading: &Reading) -> Vec<Corner> {
    let named = |(&(i, j), &pixel): (&(i32, i32), &Point2<f64>)| {
        let (i, j) = turned((i as usize, j as usize), size, reading.quarters);
        let column = usize::try_from(i as isize + reading.first[0]).ok()?;
        let row = usize::try_from(j as isize + reading.first[1]).ok()?;
        let corner = Corner { column, row, pixel };
        (column < board.columns && row < board.rows).then_some(corner)
    };
    grid.iter().filter_map(named).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// How bright a face is at a place in squares from its first corner.
    fn bright(board: &Board, face: Face, x: f64, y: f64) -> f64 {
        let at = [x, y].map(|v| v * board.square);
        let black = board
            .black_rectangles(face)
            .into_iter()
            .any(|r| (0..2).all(|a| (r.min[a]..r.max[a]).contains(&at[a])));
        if black { 40.0 } else { 190.0 }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn any_part_of_either_face_is_read_as_what_it_is(
            back in any::<bool>(), quarters in 0..4_usize, column in 0..3_usize, row in 0..2_usize,
        ) {
            let board = Board::charuco(9, 6, 0.025, true).unwrap();
            let face = if back { Face::Back } else { Face::Front };
            // Seven by five corners of the board; pixels are 12 to the square, turned.
            let pixel = |c: f64, r: f64| match quarters {
                1 => Point2::new(-12.0 * r, 12.0 * c),
                2 => Point2::new(-12.0 * c, -12.0 * r),
                3 => Point2::new(12.0 * r, -12.0 * c),
                _ => Point2::new(12.0 * c, 12.0 * r),
            };
            let place = |p: Point2<f64>| match quarters {
                1 => (p.y / 12.0, -p.x / 12.0),
                2 => (-p.x / 12.0, -p.y / 12.0),
                3 => (-p.y / 12.0, p.x / 12.0),
                _ => (p.x / 12.0, p.y / 12.0),
            };
            let mut labelled = Labelled::new();
            for j in 0..5 {
                for i in 0..7 {
                    let at = pixel((column + i) as f64, (row + j) as f64);
                    // Labels run along the picture's own axes.
                    let label = ((at.x / 12.0).round() as i32, (at.y / 12.0).round() as i32);
                    labelled.insert(label, at);
                }
            }
            let brightness = |p: Point2<f64>| {
                let (x, y) = place(p);
                bright(&board, face, x, y)
            };
            let (found, corners) = read(labelled.clone(), &board, brightness).unwrap();
            prop_assert_eq!(found, face);
            prop_assert_eq!(corners.len(), 35);
            for corner in corners {
                let expected = pixel(corner.column as f64, corner.row as f64);
                prop_assert!((corner.pixel - expected).norm() < 1e-9, "{:?}", corner);
            }
            // Squares without markers are no ChArUco board.
            let plain = |p: Point2<f64>| {
                let (x, y) = place(p);
                if (x.floor() + y.floor()).rem_euclid(2.0) == 0.0 { 40.0 } else { 190.0 }
            };
            prop_assert!(read(labelled, &board, plain).is_none());
        }
    }
}
