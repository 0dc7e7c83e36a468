//! A calibration board: its corners and markers, their positions and ids. `pattern` describes how it looks, `text`
//! how it is written, `shape` how a print differs from it; nothing here draws or detects.

mod pattern;
mod shape;
mod text;

pub use pattern::Rectangle;
pub use shape::{BoardShape, Surface};

use super::Error;
use crate::range;
use calib_targets_aruco::{Dictionary, builtins};
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use std::ops::Range;

/// A board with a pattern of squares.
///
/// Each face has a frame of its own: the origin is the first inner corner, x runs along the rows, y down the columns
/// and z into the board, away from an observer of the face. Looked at upright, the square before the first inner
/// corner, at the top left, is black.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Board {
    /// What its white squares hold.
    pub kind: BoardKind,
    /// Inner corners in a row; the squares are one more.
    pub columns: usize,
    /// Rows of inner corners.
    pub rows: usize,
    /// Side of a square in metres.
    pub square: f64,
    /// Whether the back has a pattern too, with ids of its own.
    pub two_sided: bool,
    /// Metres from the front's plane to the back's.
    pub thickness: f64,
}

/// What the white squares of a board hold.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum BoardKind {
    /// Nothing.
    Checkerboard,
    /// Markers, so that every corner has an id even where the board is cut off.
    Charuco(Markers),
}

/// Markers of a ChArUco board, as OpenCV (from 4.6 on, not its "legacy pattern") lays them out: in white squares, their
/// ids in the order of reading.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Markers {
    /// Side of a marker with its black rim, in metres.
    pub side: f64,
    /// Name of their dictionary, such as `DICT_4X4_100`.
    pub dictionary: &'static str,
}

/// A side of a board.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Face {
    /// The one whose frame is the board's.
    Front,
    /// The other side of a two-sided board.
    Back,
}

/// The default ratio of a marker's side to its square's.
const MARKER_PART: f64 = 0.75;

impl Board {
    /// Most inner corners a row and a column may have.
    pub const MOST_CORNERS: usize = 100;
    /// Dictionaries by their size; the smallest that has enough markers is taken, because fewer are mistaken then.
    const DICTIONARIES: [&str; 4] = [
        "DICT_4X4_50",
        "DICT_4X4_100",
        "DICT_4X4_250",
        "DICT_4X4_1000",
    ];

    /// A checkerboard of `columns` by `rows` inner corners and squares of `square` metres.
    ///
    /// # Errors
    /// As [`Self::checked`].
    pub fn checkerboard(columns: usize, rows: usize, square: f64) -> Result<Self, Error> {
        let (two_sided, thickness) = (false, 0.0);
        let kind = BoardKind::Checkerboard;
        Self {
            kind,
            columns,
            rows,
            square,
            two_sided,
            thickness,
        }
        .checked()
    }

    /// A ChArUco board with markers of three quarters of its squares, of the smallest dictionary that does.
    ///
    /// # Errors
    /// As [`Self::checked`].
    pub fn charuco(
        columns: usize,
        rows: usize,
        square: f64,
        two_sided: bool,
    ) -> Result<Self, Error> {
        let plain = Self::checkerboard(columns, rows, square)?;
        let mut board = Self { two_sided, ..plain };
        let dictionary = board.usual_dictionary();
        board.kind = BoardKind::Charuco(Markers {
            side: MARKER_PART * square,
            dictionary,
        });
        board.checked()
    }

    /// The smallest dictionary that has markers for this board, or the largest if none has.
    fn usual_dictionary(&self) -> &'static str {
        let markers = self.markers_per_face() * self.faces().len();
        let enough = |name: &&str| {
            builtins::builtin_dictionary(name).is_some_and(|d| d.codes().len() >= markers)
        };
        let found = Self::DICTIONARIES.into_iter().find(enough);
        found.unwrap_or(Self::DICTIONARIES[3])
    }

    /// Checks the numbers.
    ///
    /// # Errors
    /// If there are fewer than 2 or more than 100 corners a side, a length cannot be one, the dictionary is unknown or
    /// too small, or a board without ids is two-sided.
    pub fn checked(self) -> Result<Self, Error> {
        let corners = 2..=Self::MOST_CORNERS;
        if !corners.contains(&self.columns) || !corners.contains(&self.rows) {
            let found = format!("{}x{}", self.columns, self.rows);
            return bad("board size", found, "2x2 to 100x100 inner corners");
        }
        let square = range::check(self.square, [1e-3, 1.0], " m");
        in_range("board square", self.square, square)?;
        let thickness = range::check(self.thickness, [0.0, 0.2], " m");
        in_range("board thickness", self.thickness, thickness)?;
        match self.kind {
            BoardKind::Checkerboard if self.two_sided => bad(
                "board with two sides",
                "a checkerboard".into(),
                "a charuco board: a checkerboard's sides cannot be told apart",
            ),
            BoardKind::Checkerboard => Ok(self),
            BoardKind::Charuco(markers) => self.checked_markers(markers).map(|()| self),
        }
    }

    fn checked_markers(&self, markers: Markers) -> Result<(), Error> {
        let part = range::check(markers.side / self.square, [0.3, 0.95], " of the square");
        in_range("board marker", markers.side, part)?;
        let Some(dictionary) = builtins::builtin_dictionary(markers.dictionary) else {
            let found = markers.dictionary.to_owned();
            return bad("board dictionary", found, "a name such as DICT_4X4_100");
        };
        let needed = self.markers_per_face() * self.faces().len();
        let held = dictionary.codes().len();
        if held < needed {
            let sides = if self.two_sided { " on two sides" } else { "" };
            let found = format!(
                "{}, {held} markers for the {needed} that {}x{} inner corners{sides} need",
                markers.dictionary, self.columns, self.rows
            );
            let expected =
                "a larger dictionary, fewer corners, or a checkerboard, which needs no markers";
            return bad("board dictionary", found, expected);
        }
        Ok(())
    }

    /// The faces with a pattern.
    pub fn faces(&self) -> &'static [Face] {
        match self.two_sided {
            true => &[Face::Front, Face::Back],
            false => &[Face::Front],
        }
    }

    /// Corners of one face.
    pub fn corners_per_face(&self) -> usize {
        self.columns * self.rows
    }

    /// Id of a face's corner: the front's count in the order of reading from 0, the back's go on behind them.
    pub fn corner_id(&self, face: Face, column: usize, row: usize) -> usize {
        self.first_corner(face) + row * self.columns + column
    }

    /// Face, column and row of a corner's id; `None` if the board has no such corner.
    pub fn corner(&self, id: usize) -> Option<(Face, usize, usize)> {
        let face = *self.faces().get(id / self.corners_per_face())?;
        let within = id % self.corners_per_face();
        Some((face, within % self.columns, within / self.columns))
    }

    /// Where a corner lies in its face's frame, in metres.
    pub fn corner_position(&self, column: usize, row: usize) -> Point3<f64> {
        Point3::new(column as f64 * self.square, row as f64 * self.square, 0.0)
    }

    /// The corners of one face in the order of their ids, in the face's frame.
    pub fn corner_positions(&self) -> Vec<Point3<f64>> {
        let all = (0..self.rows).flat_map(|row| (0..self.columns).map(move |column| (column, row)));
        all.map(|(column, row)| self.corner_position(column, row))
            .collect()
    }

    fn first_corner(&self, face: Face) -> usize {
        match face {
            Face::Front => 0,
            Face::Back => self.corners_per_face(),
        }
    }

    /// The back's pose as the board is meant to be, its page turned over about a vertical line: a point of the back's
    /// frame in the front's. Prints never lie that well behind each other: a calibration solves for the pose and
    /// starts here.
    pub fn front_from_back(&self) -> Isometry3<f64> {
        let width = (self.columns - 1) as f64 * self.square;
        let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), std::f64::consts::PI);
        Isometry3::from_parts(Translation3::new(width, 0.0, self.thickness), turn)
    }

    /// Whether a turn by 180° maps the pattern onto itself, so that a picture of it has two readings.
    pub fn is_symmetric(&self) -> bool {
        self.kind == BoardKind::Checkerboard && (self.columns + self.rows).is_multiple_of(2)
    }

    /// Markers that one face of a ChArUco board of this size has: one in each white square.
    fn markers_per_face(&self) -> usize {
        (self.columns + 1) * (self.rows + 1) / 2
    }

    /// Ids that a face's markers have in the dictionary; none on a checkerboard.
    pub fn marker_ids(&self, face: Face) -> Range<usize> {
        let count = self.markers_per_face();
        match (self.kind, face) {
            (BoardKind::Checkerboard, _) => 0..0,
            (BoardKind::Charuco(_), Face::Front) => 0..count,
            (BoardKind::Charuco(_), Face::Back) => count..2 * count,
        }
    }

    /// A dictionary of one face's markers alone, numbered from 0 as a detector of one-sided boards expects them; so
    /// the other face cannot be mistaken for it. `None` for a checkerboard.
    pub fn dictionary(&self, face: Face) -> Option<Dictionary> {
        let BoardKind::Charuco(markers) = self.kind else {
            return None;
        };
        let whole = builtins::builtin_dictionary(markers.dictionary)?;
        let codes = whole.codes().get(self.marker_ids(face))?;
        let name = match face {
            Face::Front => "front",
            Face::Back => "back",
        };
        Dictionary::from_static_codes(
            name,
            whole.marker_size(),
            whole.max_correction_bits(),
            codes,
        )
        .ok()
    }
}

/// Refuses a length in metres whose check failed.
fn in_range(
    what: &'static str,
    length: f64,
    checked: Result<f64, range::OutOfRange>,
) -> Result<(), Error> {
    checked.map(drop).map_err(|range| Error::OutOfRange {
        what,
        found: format!("{length} m"),
        expected: range.expected,
    })
}

fn bad<T>(what: &'static str, found: String, expected: &'static str) -> Result<T, Error> {
    Err(Error::BadValue {
        what,
        found,
        expected,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn corners_have_ids_and_ids_corners() {
        let board = Board::charuco(11, 8, 0.025, true).unwrap();
        assert_eq!(board.corner_id(Face::Front, 10, 0), 10);
        assert_eq!(board.corner_id(Face::Back, 0, 1), 88 + 11);
        for id in 0..2 * 88 {
            let (face, column, row) = board.corner(id).unwrap();
            assert_eq!(board.corner_id(face, column, row), id);
        }
        assert_eq!(board.corner(2 * 88), None);
        let position = board.corner_positions()[12];
        assert_eq!(position, Point3::new(0.025, 0.025, 0.0));
    }

    #[test]
    fn the_back_lies_behind_the_front_and_looks_the_other_way() {
        let board = Board {
            thickness: 0.004,
            ..Board::charuco(4, 3, 0.03, true).unwrap()
        };
        let front_from_back = board.front_from_back();
        let first = front_from_back * board.corner_position(0, 0);
        assert!((first - Point3::new(0.09, 0.0, 0.004)).norm() < 1e-12);
        let last = front_from_back * board.corner_position(3, 2);
        assert!((last - Point3::new(0.0, 0.06, 0.004)).norm() < 1e-12);
        let into = front_from_back * Vector3::z();
        assert!((into + Vector3::z()).norm() < 1e-12);
    }

    #[test]
    fn faces_share_no_marker_and_the_dictionary_is_the_smallest() {
        let board = Board::charuco(11, 8, 0.025, true).unwrap();
        assert_eq!(board.marker_ids(Face::Front), 0..54);
        assert_eq!(board.marker_ids(Face::Back), 54..108);
        let front = board.dictionary(Face::Front).unwrap();
        let back = board.dictionary(Face::Back).unwrap();
        assert!(front.codes().iter().all(|c| !back.codes().contains(c)));
        let BoardKind::Charuco(markers) = board.kind else {
            panic!("{board:?}")
        };
        assert_eq!(markers.dictionary, "DICT_4X4_250");
        assert_eq!(markers.side, 0.75 * 0.025);
    }

    #[test]
    fn a_board_that_cannot_be_is_refused_with_its_numbers() {
        let good = Board::charuco(11, 8, 0.025, false).unwrap();
        let with = |side, dictionary| BoardKind::Charuco(Markers { side, dictionary });
        #[rustfmt::skip]
        let bad = [
            (Board { columns: 1, ..good }, "1x8"),
            (Board { rows: 101, ..good }, "11x101"),
            (Board { square: f64::NAN, ..good }, "NaN"),
            (Board { thickness: -0.1, ..good }, "-0.1 m"),
            (Board { kind: with(0.025, "DICT_4X4_100"), ..good }, "0.025 m"),
            (Board { kind: with(0.02, "DICT_9X9"), ..good }, "DICT_9X9"),
            (Board { kind: with(0.02, "DICT_4X4_50"), ..good }, "50 markers for the 54 that 11x8 inner corners need"),
            (Board { kind: BoardKind::Checkerboard, two_sided: true, ..good }, "checkerboard"),
        ];
        for (board, named) in bad {
            let message = board.checked().unwrap_err().to_string();
            assert!(message.contains(named), "{message}");
        }
    }

    proptest! {
        #[test]
        fn a_symmetric_board_looks_the_same_upside_down(columns in 2..14_usize, rows in 2..14_usize) {
            let board = Board::checkerboard(columns, rows, 0.03).unwrap();
            let turned = |i: usize, j: usize| (columns - i, rows - j);
            let same = (0..=columns).all(|i| {
                (0..=rows).all(|j| {
                    let (k, l) = turned(i, j);
                    Board::is_black(i, j) == Board::is_black(k, l)
                })
            });
            prop_assert_eq!(board.is_symmetric(), same);
        }
    }
}
