//! The input of a fit: cameras, placements, and which corners of the board each camera saw. Data only.

use crate::calibration::{Board, BoardKind, Face, Intrinsics};
use crate::frame::CameraId;
use nalgebra::{Isometry3, Point2, Point3, Translation3, UnitQuaternion, Vector3};
use std::collections::BTreeSet;

/// A camera that is to be calibrated.
#[derive(Clone, Debug, PartialEq)]
pub struct SessionCamera {
    /// Its name.
    pub id: CameraId,
    /// Width and height of its pictures in pixels.
    pub size: [usize; 2],
    /// Its lens if it is known and must not change.
    pub known: Option<Intrinsics>,
    /// A lens to start from, if there is a better one than the views alone give.
    pub start: Option<Intrinsics>,
}

/// A corner of the board in a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Corner {
    /// Its column on the face.
    pub column: usize,
    /// Its row.
    pub row: usize,
    /// Where it is seen.
    pub pixel: Point2<f64>,
}

/// A camera's corners of one placement.
#[derive(Clone, Debug, PartialEq)]
pub struct View {
    /// Index of the camera.
    pub camera: usize,
    /// Index of the placement.
    pub placement: usize,
    /// The side that it saw.
    pub face: Face,
    /// The corners it saw.
    pub corners: Vec<Corner>,
}

/// A session of placements of one board.
#[derive(Clone, Debug, PartialEq)]
pub struct Session {
    /// The board.
    pub board: Board,
    /// The cameras.
    pub cameras: Vec<SessionCamera>,
    /// The placements' names.
    pub placements: Vec<String>,
    /// What was seen; at most one view a camera and placement.
    pub views: Vec<View>,
}

impl View {
    /// Points of the face, in its frame, with their pixels.
    pub(super) fn pairs(&self, board: &Board) -> Vec<(Point3<f64>, Point2<f64>)> {
        let pair = |c: &Corner| (board.corner_position(c.column, c.row), c.pixel);
        self.corners.iter().map(pair).collect()
    }

    /// The same corners under the names that they have on the board turned by `quarters` of a full turn.
    pub(super) fn turn(&mut self, board: &Board, quarters: usize) {
        let (last_column, last_row) = (board.columns - 1, board.rows - 1);
        for corner in &mut self.corners {
            let (column, row) = (corner.column, corner.row);
            (corner.column, corner.row) = match quarters {
                1 => (row, last_column - column),
                2 => (last_column - column, last_row - row),
                3 => (last_row - row, column),
                _ => (column, row),
            };
        }
    }

    /// What the camera would have seen without a mirror, in pictures of this width.
    pub(super) fn mirrored(&self, board: &Board, width: usize) -> View {
        let mut mirrored = self.clone();
        for corner in &mut mirrored.corners {
            corner.pixel.x = width as f64 - 1.0 - corner.pixel.x;
            // The order that keeps the first square black.
            match board.rows.is_multiple_of(2) {
                true => corner.row = board.rows - 1 - corner.row,
                false => corner.column = board.columns - 1 - corner.column,
            }
        }
        mirrored
    }
}

/// Quarter turns that map the pattern onto itself.
pub(super) fn turns(board: &Board) -> &'static [usize] {
    let square = board.columns == board.rows && board.columns.is_multiple_of(2);
    match board.kind {
        BoardKind::Charuco(_) => &[0],
        BoardKind::Checkerboard if square => &[0, 1, 2, 3],
        BoardKind::Checkerboard if board.is_symmetric() => &[0, 2],
        BoardKind::Checkerboard => &[0],
    }
}

/// The board's frame under its old names, from its frame under the names of [`View::turn`].
pub(super) fn board_from_turned(board: &Board, quarters: usize) -> Isometry3<f64> {
    let length = |corners: usize| (corners - 1) as f64 * board.square;
    let (width, height) = (length(board.columns), length(board.rows));
    let shift = match quarters {
        1 => Vector3::new(width, 0.0, 0.0),
        2 => Vector3::new(width, height, 0.0),
        3 => Vector3::new(0.0, height, 0.0),
        _ => Vector3::zeros(),
    };
    let angle = quarters as f64 * std::f64::consts::FRAC_PI_2;
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle);
    Isometry3::from_parts(Translation3::from(shift), turn)
}

/// Whether some placement was seen from both sides, so that the back's pose can be estimated.
pub(super) fn both_faces_at_once(session: &Session) -> bool {
    let of = |face: Face| -> BTreeSet<usize> {
        let views = session.views.iter().filter(|v| v.face == face);
        views.map(|v| v.placement).collect()
    };
    !of(Face::Front).is_disjoint(&of(Face::Back))
}

/// The four outermost corners of the front.
pub(super) fn outermost(board: &Board) -> [Point3<f64>; 4] {
    let (c, r) = (board.columns - 1, board.rows - 1);
    [(0, 0), (c, 0), (0, r), (c, r)].map(|(column, row)| board.corner_position(column, row))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_turned_board_has_its_corners_where_they_were() {
        let board = Board::checkerboard(6, 6, 0.025).unwrap();
        for &quarters in turns(&board) {
            let mut view = View {
                camera: 0,
                placement: 0,
                face: Face::Front,
                corners: vec![Corner {
                    column: 4,
                    row: 1,
                    pixel: Point2::origin(),
                }],
            };
            let before = view.pairs(&board)[0].0;
            view.turn(&board, quarters);
            let after = board_from_turned(&board, quarters) * view.pairs(&board)[0].0;
            assert!((before - after).norm() < 1e-12, "{quarters}");
        }
        assert_eq!(turns(&board), [0, 1, 2, 3]);
        assert_eq!(turns(&Board::checkerboard(7, 7, 0.025).unwrap()), [0, 2]);
        assert_eq!(turns(&Board::checkerboard(9, 6, 0.025).unwrap()), [0]);
    }
}
