//! Compares a labelled grid of corners with the expected board: false corners, size, handedness, the colours of its
//! squares. It repairs or rejects the grid, and sees the picture only through the brightness that it is given.

use super::planar::homography;
use super::session::Corner;
use crate::calibration::Board;
use crate::statistics::upper_median;
use nalgebra::{Point2, Vector2, Vector3};
use std::collections::BTreeMap;

/// Corners by column and row, which may begin anywhere.
pub(super) type Labelled = BTreeMap<(i32, i32), Point2<f64>>;

/// Why a grid is not the board.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum Rejection {
    /// Nothing like it.
    #[error("no board was found")]
    Nothing,
    /// A grid without markers, or with those of another board.
    #[error(
        "something like a checkerboard was found, but no markers of this board were read in it: they may be too small or \
         blurred, mirrored, of another dictionary, or laid out otherwise"
    )]
    NoMarkers,
    /// Some markers, too few to say which corners are which.
    #[error("only {found} of the board's markers were read, expected at least {needed}")]
    FewMarkers {
        /// How many were read.
        found: usize,
        /// How many are needed.
        needed: usize,
    },
    /// Corners with no order.
    #[error("only {found} corners of a board were found, expected at least {needed}")]
    Few {
        /// How many were found.
        found: usize,
        /// How many are needed.
        needed: usize,
    },
    /// Corners of the board, too few to say where it was.
    #[error("only {found} of the board's corners were found, expected {needed} or more")]
    TooFewOfBoard {
        /// How many were found.
        found: usize,
        /// How many are needed.
        needed: usize,
    },
    /// Another board, or a part of this one; on a checkerboard the two cannot be distinguished.
    #[error("{}x{} inner corners were found, expected {}x{}", found[0], found[1], expected[0], expected[1])]
    Size {
        /// Columns and rows found, the longer first.
        found: [usize; 2],
        /// Columns and rows of the board.
        expected: [usize; 2],
    },
    /// Squares that are not black and white.
    #[error(
        "its squares differ by {contrast:.0} of 255 grey levels, expected at least {needed:.0}"
    )]
    Contrast {
        /// Difference of bright squares and dark ones.
        contrast: f64,
        needed: f64,
    },
}

/// Part of a square's side by which a corner may be off from what its neighbours let expect.
const FALSE_CORNER: f64 = 0.12;
/// An outermost row or column with fewer corners than this share of the median line is discarded.
const EDGE_PART: f64 = 0.35;
/// Part of the board's corners that must be found.
const LEAST_PART: f64 = 0.6;
/// Least difference of bright and dark squares in grey levels.
const LEAST_CONTRAST: f64 = 10.0;

/// Removes corners that are not where their neighbours predict them, the worst first: each is compared with the
/// homography of the corners up to two steps away.
pub(super) fn without_false_corners(mut labelled: Labelled) -> Labelled {
    for _ in 0..labelled.len() {
        let off = labelled
            .keys()
            .filter_map(|&at| Some((surprise(&labelled, at)?, at)));
        let Some((worst, at)) = off.max_by(|a, b| a.0.total_cmp(&b.0)) else {
            break;
        };
        if worst <= FALSE_CORNER {
            break;
        }
        labelled.remove(&at);
    }
    labelled
}

/// How far a corner is from where its neighbours predict it, in squares; infinite if it has too few neighbours.
fn surprise(labelled: &Labelled, at: (i32, i32)) -> Option<f64> {
    let own = labelled.get(&at)?;
    let mut pairs = Vec::new();
    for j in at.1 - 2..=at.1 + 2 {
        for i in at.0 - 2..=at.0 + 2 {
            if let Some(pixel) = labelled.get(&(i, j)).filter(|_| (i, j) != at) {
                let from = Point2::new(f64::from(i - at.0), f64::from(j - at.1));
                pairs.push((from, *pixel));
            }
        }
    }
    let Some(h) = (pairs.len() >= 5).then(|| homography(&pairs)).flatten() else {
        return Some(f64::INFINITY);
    };
    let predicted = |x: f64, y: f64| Point2::from_homogeneous(h * Vector3::new(x, y, 1.0));
    let (Some(here), Some(right), Some(below)) = (
        predicted(0.0, 0.0),
        predicted(1.0, 0.0),
        predicted(0.0, 1.0),
    ) else {
        return Some(f64::INFINITY);
    };
    let side = (right - here).norm().min((below - here).norm());
    Some((own - here).norm() / side.max(1e-9))
}

/// The smallest and largest label of an axis, without outermost lines that hardly have corners.
fn extent(labelled: &Labelled, axis: impl Fn(&(i32, i32)) -> i32) -> Option<[i32; 2]> {
    let mut lines: BTreeMap<i32, usize> = BTreeMap::new();
    for at in labelled.keys() {
        *lines.entry(axis(at)).or_default() += 1;
    }
    let mut counts: Vec<usize> = lines.values().copied().collect();
    let usual = upper_median(&mut counts)? as f64;
    let full = |count: &&usize| **count as f64 >= EDGE_PART * usual;
    let first = lines.iter().find(|(_, count)| full(count))?.0;
    let last = lines.iter().rev().find(|(_, count)| full(count))?.0;
    Some([*first, *last])
}

/// Reads a grid as the board: its corners by the board's columns and rows. `brightness` tells how bright the picture
/// is around a pixel. On a board that looks the same turned, one of its readings is taken.
pub(super) fn read(
    labelled: Labelled,
    board: &Board,
    brightness: impl Fn(Point2<f64>) -> f64,
) -> Result<Vec<Corner>, Rejection> {
    let labelled = without_false_corners(labelled);
    let needed = ((board.corners_per_face() as f64 * LEAST_PART).ceil() as usize).max(4);
    let few = Rejection::Few {
        found: labelled.len(),
        needed,
    };
    let Some((inside, size)) = bounded(labelled) else {
        return Err(few);
    };
    let expected = [board.columns, board.rows];
    if size != expected && size != [expected[1], expected[0]] {
        let found = [size[0].max(size[1]), size[0].min(size[1])];
        return Err(Rejection::Size { found, expected });
    }
    if inside.len() < needed {
        return Err(few);
    }
    let contrast = contrast(&inside, brightness);
    if contrast.abs() < LEAST_CONTRAST {
        return Err(Rejection::Contrast {
            contrast: contrast.abs(),
            needed: LEAST_CONTRAST,
        });
    }
    // The square behind the first corner must be black, as the one before it is.
    let fits = |quarters: &usize| {
        let [w, h] = if quarters.is_multiple_of(2) {
            size
        } else {
            [size[1], size[0]]
        };
        [w, h] == expected && (contrast > 0.0) == (first_cell(size, *quarters).is_multiple_of(2))
    };
    // With odd numbers of corners both ways a board is printed in two phases, each the other turned by a quarter. Which
    // one is meant can be told from its columns and rows alone.
    let is_of_two_phases = expected.iter().all(|corners| !corners.is_multiple_of(2));
    let in_other_phase = |quarters: &usize| {
        let [columns, rows] = expected;
        let as_found = if quarters.is_multiple_of(2) {
            [columns, rows]
        } else {
            [rows, columns]
        };
        is_of_two_phases && size == as_found
    };
    let quarters = (0..4).find(fits).or_else(|| (0..4).find(in_other_phase));
    let Some(quarters) = quarters else {
        let found = [size[0].max(size[1]), size[0].min(size[1])];
        return Err(Rejection::Size { found, expected });
    };
    let named = |((i, j), pixel): ((i32, i32), Point2<f64>)| {
        let (column, row) = turned((i as usize, j as usize), size, quarters);
        Corner { column, row, pixel }
    };
    Ok(inside.into_iter().map(named).collect())
}

/// A grid without outermost lines that hardly have corners, right-handed and labelled from (0, 0) on, with its columns
/// and rows.
pub(super) fn bounded(labelled: Labelled) -> Option<(Labelled, [usize; 2])> {
    let columns = extent(&labelled, |at| at.0)?;
    let rows = extent(&labelled, |at| at.1)?;
    let inside: Labelled = labelled
        .into_iter()
        .filter(|((i, j), _)| {
            (columns[0]..=columns[1]).contains(i) && (rows[0]..=rows[1]).contains(j)
        })
        .map(|((i, j), pixel)| ((i - columns[0], j - rows[0]), pixel))
        .collect();
    let size = [columns, rows].map(|[first, last]| (last - first + 1) as usize);
    Some((right_handed(inside, size[0] as i32 - 1), size))
}

/// Flips columns where the grid runs the wrong way round: seen from the front, rows are to the right of columns.
fn right_handed(labelled: Labelled, last_column: i32) -> Labelled {
    if handedness(&labelled) >= 0.0 {
        return labelled;
    }
    labelled
        .into_iter()
        .map(|((i, j), pixel)| ((last_column - i, j), pixel))
        .collect()
}

/// Sum over all cells of the sine-like turn from their columns' direction to their rows'.
pub(super) fn handedness(labelled: &Labelled) -> f64 {
    let cell = |(&(i, j), here): (&(i32, i32), &Point2<f64>)| {
        let (right, below) = (labelled.get(&(i + 1, j))?, labelled.get(&(i, j + 1))?);
        let turn: Vector2<f64> = right - here;
        Some(turn.perp(&(below - here)).signum())
    };
    labelled.iter().filter_map(cell).sum()
}

/// Where a corner of a grid of `size` is named once the grid is turned.
pub(super) fn turned(
    (i, j): (usize, usize),
    [w, h]: [usize; 2],
    quarters: usize,
) -> (usize, usize) {
    match quarters {
        1 => (j, w - 1 - i),
        2 => (w - 1 - i, h - 1 - j),
        3 => (h - 1 - j, i),
        _ => (i, j),
    }
}

/// Parity, in the grid as it was found, of the cell that comes first once it is turned.
fn first_cell([w, h]: [usize; 2], quarters: usize) -> usize {
    match quarters {
        1 => w - 2,
        2 => w - 2 + h - 2,
        3 => h - 2,
        _ => 0,
    }
}

/// How much darker cells with an even sum of labels are than the others, in the grey levels of the picture.
fn contrast(labelled: &Labelled, brightness: impl Fn(Point2<f64>) -> f64) -> f64 {
    let (mut sums, mut counts) = ([0.0; 2], [0.0_f64; 2]);
    for &(i, j) in labelled.keys() {
        let corners = [(i, j), (i + 1, j), (i, j + 1), (i + 1, j + 1)].map(|at| labelled.get(&at));
        let [Some(a), Some(b), Some(c), Some(d)] = corners else {
            continue;
        };
        let middle = Point2::from((a.coords + b.coords + c.coords + d.coords) / 4.0);
        let parity = (i + j).rem_euclid(2) as usize;
        sums[parity] += brightness(middle);
        counts[parity] += 1.0;
    }
    sums[1] / counts[1].max(1.0) - sums[0] / counts[0].max(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The grid of a board, turned, mirrored and shifted; and its brightness.
    fn grid(board: &Board, quarters: usize, mirrored: bool) -> Labelled {
        let mut labelled = Labelled::new();
        let (columns, rows) = (board.columns as i32, board.rows as i32);
        for row in 0..rows {
            for column in 0..columns {
                let (i, j) = match quarters {
                    1 => (row, -column),
                    2 => (-column, -row),
                    3 => (-row, column),
                    _ => (column, row),
                };
                let label = if mirrored { (-i, j) } else { (i, j) };
                labelled.insert(label, pixel(f64::from(column), f64::from(row)));
            }
        }
        labelled
    }

    fn pixel(column: f64, row: f64) -> Point2<f64> {
        Point2::new(
            50.0 + 20.0 * column + 3.0 * row,
            60.0 - 2.0 * column + 21.0 * row,
        )
    }

    fn bright(p: Point2<f64>) -> f64 {
        let m = nalgebra::Matrix2::new(20.0, 3.0, -2.0, 21.0)
            .try_inverse()
            .unwrap();
        let at = m * (p - Point2::new(50.0, 60.0));
        if (at.x.floor() + at.y.floor()).rem_euclid(2.0) == 0.0 {
            30.0
        } else {
            200.0
        }
    }

    proptest! {
        #[test]
        fn any_labels_are_read_as_the_board_that_it_is(
            columns in 3..12_usize, rows in 3..12_usize, quarters in 0..4_usize, mirrored: bool,
        ) {
            let board = Board::checkerboard(columns, rows, 0.02).unwrap();
            let corners = read(grid(&board, quarters, mirrored), &board, bright).unwrap();
            prop_assert_eq!(corners.len(), columns * rows);
            let right = |turn: usize| corners.iter().all(|c| {
                let (column, row) = match turn {
                    1 => (columns - 1 - c.row, c.column),
                    2 => (columns - 1 - c.column, rows - 1 - c.row),
                    3 => (c.row, rows - 1 - c.column),
                    _ => (c.column, c.row),
                };
                pixel(column as f64, row as f64) == c.pixel
            });
            let readings = super::super::session::turns(&board);
            prop_assert!(readings.iter().any(|&turn| right(turn)));
        }
    }

    #[test]
    fn a_board_of_two_phases_is_read_in_both_and_with_the_same_names() {
        let board = Board::checkerboard(7, 5, 0.02).unwrap();
        for quarters in 0..4 {
            let printed = read(grid(&board, quarters, false), &board, bright).unwrap();
            let other = read(grid(&board, quarters, false), &board, |p| 230.0 - bright(p)).unwrap();
            assert_eq!(other.len(), 35);
            for (a, b) in printed.iter().zip(&other) {
                let same = (a.column, a.row) == (b.column, b.row);
                let half_a_turn = (a.column, a.row) == (6 - b.column, 4 - b.row);
                assert!(a.pixel == b.pixel && (same || half_a_turn), "{a:?} {b:?}");
            }
        }
    }

    #[test]
    fn false_corners_are_taken_out_and_wrong_boards_refused() {
        let board = Board::checkerboard(9, 6, 0.02).unwrap();
        let mut labelled = grid(&board, 0, false);
        *labelled.get_mut(&(3, 2)).unwrap() += Vector2::new(6.0, 0.0);
        *labelled.get_mut(&(8, 5)).unwrap() += Vector2::new(0.0, -7.0);
        labelled.insert((9, 2), pixel(9.2, 2.0));
        let corners = read(labelled, &board, bright).unwrap();
        assert_eq!(corners.len(), 52);
        let other = Board::checkerboard(10, 7, 0.02).unwrap();
        let size = |found| {
            Err(Rejection::Size {
                found,
                expected: [9, 6],
            })
        };
        assert_eq!(read(grid(&other, 0, false), &board, bright), size([10, 7]));
        let smaller = Board::checkerboard(8, 6, 0.02).unwrap();
        assert_eq!(read(grid(&smaller, 1, false), &board, bright), size([8, 6]));
        let grey = read(grid(&board, 0, false), &board, |_| 100.0);
        assert!(matches!(grey, Err(Rejection::Contrast { .. })), "{grey:?}");
    }
}
