//! Refines the corners of a whole board to a fraction of a pixel, in windows that hold only the two edges that cross
//! there.

use super::gradient_refine;
use super::session::Corner;
use crate::calibration::{Board, BoardKind};
use crate::image::Grid;
use nalgebra::{Matrix2, Point2, Vector2};
use std::collections::BTreeMap;

/// Half a window's side over the distance of the next corner.
const WINDOW_PART: f64 = 0.25;
/// Half a window's side, in pixels, from which the gradients within it are worth more than a saddle point.
const SMALLEST_WINDOW: usize = 4;
/// A picture's side over the largest half of a window's: 19 pixels at 5 MP, as blur and squares grow with pictures.
const SIDE_PER_WINDOW: usize = 128;
/// Pixels by which a marker's blurred rim, and the gradients that know of it, reach beyond it; and the narrowest half
/// of a stripe beside it that is worth looking at.
const MARKER_REACH: f64 = 2.0;
const NARROWEST: f64 = 2.0;

/// Corners moved to where all gradients around them place them, which is more exact than saddle points; the window
/// stays clear of the next corners and of markers, and where there is too little room the saddle point stays.
pub(super) fn polished(
    picture: &Grid<u8>,
    mut corners: Vec<Corner>,
    board: &Board,
    largest_move: f64,
) -> Vec<Corner> {
    let windows = windows([picture.width(), picture.height()], &corners, board);
    for (corner, window) in corners.iter_mut().zip(windows) {
        let refined = window.and_then(|Window { half, stripes }| {
            gradient_refine::refined(picture, corner.pixel, half as i32, |o| stripes.hold(o))
        });
        if let Some(at) = refined.filter(|at| (at - corner.pixel).norm() < largest_move) {
            corner.pixel = at;
        }
    }
    corners
}

/// Whether a corner in a picture of this size has too little room to be polished.
pub(super) fn crowded(size: [usize; 2], corners: &[Corner], board: &Board) -> bool {
    let windows = windows(size, corners, board);
    windows.iter().any(Option::is_none)
}

/// The part of the picture around a corner that is examined.
struct Window {
    /// Half its side in pixels.
    half: usize,
    stripes: Stripes,
}

/// The windows of all corners; `None` where there is too little room.
fn windows(size: [usize; 2], corners: &[Corner], board: &Board) -> Vec<Option<Window>> {
    let largest = (size[0].max(size[1]) / SIDE_PER_WINDOW).max(SMALLEST_WINDOW);
    let places: BTreeMap<(usize, usize), Point2<f64>> = corners
        .iter()
        .map(|c| ((c.column, c.row), c.pixel))
        .collect();
    let window = |corner: &Corner| {
        let distances = places
            .values()
            .map(|p| (p - corner.pixel).norm())
            .filter(|d| *d > 0.0);
        let nearest = distances.fold(f64::INFINITY, f64::min);
        let half = ((nearest * WINDOW_PART) as usize).min(largest);
        let stripes = Stripes::around(corner, &places, board)?;
        (half >= SMALLEST_WINDOW).then_some(Window { half, stripes })
    };
    corners.iter().map(window).collect()
}

/// The pixels along the two edges that cross in a corner, without any of a marker. They have all the information about
/// the corner's position.
struct Stripes {
    squares_from_pixels: Matrix2<f64>,
    /// Half a stripe's width in squares.
    half: f64,
}

impl Stripes {
    /// `None` where markers leave too little.
    fn around(
        corner: &Corner,
        places: &BTreeMap<(usize, usize), Point2<f64>>,
        board: &Board,
    ) -> Option<Self> {
        let BoardKind::Charuco(markers) = board.kind else {
            return Some(Self {
                squares_from_pixels: Matrix2::zeros(),
                half: f64::INFINITY,
            });
        };
        let (column, row) = (corner.column, corner.row);
        let place = |column: Option<usize>, row: Option<usize>| places.get(&(column?, row?));
        let along = step(
            corner.pixel,
            place(column.checked_sub(1), Some(row)),
            place(Some(column + 1), Some(row)),
        )?;
        let down = step(
            corner.pixel,
            place(Some(column), row.checked_sub(1)),
            place(Some(column), Some(row + 1)),
        )?;
        let side_px = along.norm().min(down.norm());
        let half = 0.5 * (1.0 - markers.side / board.square) - MARKER_REACH / side_px;
        let squares_from_pixels = Matrix2::from_columns(&[along, down]).try_inverse()?;
        (half * side_px >= NARROWEST).then_some(Self {
            squares_from_pixels,
            half,
        })
    }

    /// Whether an offset in pixels from the corner lies in one of them.
    #[inline]
    fn hold(&self, offset: Vector2<f64>) -> bool {
        let at = (self.squares_from_pixels * offset).map(f64::abs);
        at.x.min(at.y) <= self.half
    }
}

/// From a corner to the next one, by its neighbours before and behind.
fn step(
    at: Point2<f64>,
    before: Option<&Point2<f64>>,
    behind: Option<&Point2<f64>>,
) -> Option<Vector2<f64>> {
    match (before, behind) {
        (Some(before), Some(behind)) => Some((behind - before) / 2.0),
        (Some(before), None) => Some(at - before),
        (None, Some(behind)) => Some(behind - at),
        (None, None) => None,
    }
}
