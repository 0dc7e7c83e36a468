//! From a picture to the board's corners: ChESS features refined at their saddle point, a labelled grid of them, held
//! against the board.

use super::grid::{self, Labelled, Rejection};
use super::refine;
use super::session::Corner;
use crate::calibration::{Board, BoardKind, Face};
use crate::image::Grid;
use calib_targets_charuco::{CharucoBoardSpec, CharucoDetector, CharucoParams};
use calib_targets_chessboard::{
    ChessCorner, ChessboardDetector, ChessboardParams, DetectorConfig, GrayImageView,
    default_chess_config, detect_corners,
};
use chess_corners::ImageRefiner;
use nalgebra::Point2;

/// Fewest markers that tell where a ChArUco board is.
const FEWEST_MARKERS: usize = 3;

/// Half a window's side over the distance of the next corner.
const WINDOW_PART: f64 = 0.25;
/// Half a window's side, in pixels, from which the gradients within it are worth more than a saddle point.
const SMALLEST_WINDOW: usize = 4;
/// A picture's side over the largest half of a window's: 19 pixels at 5 MP, as blur and squares grow with pictures.
const SIDE_PER_WINDOW: usize = 128;
/// Farthest, in pixels, that a corner may be from its saddle point.
const LARGEST_MOVE: f64 = 1.5;

/// Finds the board in a grey picture; of a two-sided one, the side that shows.
///
/// # Errors
/// If there is no board, or what is there is not this board.
pub fn find_corners(picture: &Grid<u8>, board: &Board) -> Result<(Face, Vec<Corner>), Rejection> {
    if picture.width() < 16 || picture.height() < 16 {
        return Err(Rejection::Nothing);
    }
    let view = GrayImageView {
        width: picture.width(),
        height: picture.height(),
        data: picture.pixels(),
    };
    let features = detect_corners(&view, &features_config());
    match board.kind {
        BoardKind::Checkerboard => checkerboard(picture, &features, board)
            .map(|corners| (Face::Front, polished(picture, corners))),
        BoardKind::Charuco(_) => charuco(&view, &features, board),
    }
}

fn features_config() -> DetectorConfig {
    default_chess_config().with_refiner(ImageRefiner::saddle_point())
}

/// From the strictest settings to the most forgiving ones: the first that yields the whole board counts, else the
/// error of the first that yields anything.
fn checkerboard(
    picture: &Grid<u8>,
    features: &[ChessCorner],
    board: &Board,
) -> Result<Vec<Corner>, Rejection> {
    let mut forgiving = ChessboardParams::default();
    forgiving.min_corner_strength = 8.0;
    let mut attempts = vec![ChessboardParams::default(), forgiving];
    attempts.extend(ChessboardParams::sweep_default().into_iter().skip(1));
    let mut best: Result<Vec<Corner>, Rejection> = Err(Rejection::Nothing);
    for parameters in attempts {
        let Ok(detector) = ChessboardDetector::new(parameters) else {
            continue;
        };
        for component in detector.detect_all(features) {
            let label = |c: &calib_targets_chessboard::ChessboardCorner| {
                (
                    (c.grid.u, c.grid.v),
                    Point2::new(f64::from(c.position.x), f64::from(c.position.y)),
                )
            };
            let labelled: Labelled = component.corners.iter().map(label).collect();
            let found = grid::read(labelled, board, |at| brightness(picture, at));
            if is_better(&found, &best) {
                best = found;
            }
        }
        if best
            .as_ref()
            .is_ok_and(|corners| corners.len() == board.corners_per_face())
        {
            break;
        }
    }
    best
}

fn is_better(
    found: &Result<Vec<Corner>, Rejection>,
    best: &Result<Vec<Corner>, Rejection>,
) -> bool {
    match (found, best) {
        (Ok(found), Ok(best)) => found.len() > best.len(),
        (Ok(_), Err(_)) | (Err(_), Err(Rejection::Nothing)) => true,
        _ => false,
    }
}

/// Mean of the nine pixels around a place.
fn brightness(picture: &Grid<u8>, at: Point2<f64>) -> f64 {
    let (x, y) = (at.x.round() as isize, at.y.round() as isize);
    let around = (y - 1..=y + 1).flat_map(|y| (x - 1..=x + 1).map(move |x| (x, y)));
    let values: Vec<f64> = around
        .filter_map(|(x, y)| picture.get(x, y))
        .map(|&v| f64::from(v))
        .collect();
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

fn charuco(
    view: &GrayImageView<'_>,
    features: &[ChessCorner],
    board: &Board,
) -> Result<(Face, Vec<Corner>), Rejection> {
    let of_faces = board
        .faces()
        .iter()
        .map(|&face| (face, charuco_face(view, features, board, face)));
    let count =
        |found: &(Face, Result<Vec<Corner>, Rejection>)| found.1.as_ref().map_or(0, Vec::len);
    let best = of_faces.max_by_key(count).ok_or(Rejection::Nothing)?;
    best.1.map(|corners| (best.0, corners))
}

fn charuco_face(
    view: &GrayImageView<'_>,
    features: &[ChessCorner],
    board: &Board,
    face: Face,
) -> Result<Vec<Corner>, Rejection> {
    let (BoardKind::Charuco(markers), Some(dictionary)) = (board.kind, board.dictionary(face))
    else {
        return Err(Rejection::Nothing);
    };
    let [columns, rows] = [board.columns, board.rows].map(|n| n as u32);
    let part = (markers.side / board.square) as f32;
    let spec = CharucoBoardSpec::new(rows + 1, columns + 1, board.square as f32, part, dictionary);
    let mut parameters = CharucoParams::for_board(spec);
    parameters.chess = features_config();
    let detector = CharucoDetector::new(parameters).map_err(|_| Rejection::Nothing)?;
    let found = detector
        .detect_with_corners(view, features)
        .map_err(|_| Rejection::Nothing)?;
    let needed = FEWEST_MARKERS;
    if found.markers.len() < needed {
        return Err(Rejection::Few {
            found: found.corners.len(),
            needed: 4 * needed,
        });
    }
    let label = |c: &calib_targets_charuco::CharucoCorner| {
        let (column, row) = (c.id % columns, c.id / columns);
        let pixel = Point2::new(f64::from(c.position.x), f64::from(c.position.y));
        ((column as i32, row as i32), pixel)
    };
    let labelled: Labelled = found.corners.iter().map(label).collect();
    if grid::handedness(&labelled) < 0.0 {
        return Err(Rejection::Nothing);
    }
    let corners = grid::without_false_corners(labelled).into_iter();
    let named = |((column, row), pixel): ((i32, i32), Point2<f64>)| Corner {
        column: column as usize,
        row: row as usize,
        pixel,
    };
    let corners: Vec<Corner> = corners.map(named).collect();
    let needed = 4 * FEWEST_MARKERS;
    if corners.len() < needed {
        return Err(Rejection::Few {
            found: corners.len(),
            needed,
        });
    }
    Ok(corners)
}

/// Corners moved to where all gradients around them say that they are, which strays less than saddle points do; the
/// window stays clear of the next corners, and where there is too little room the saddle point stays. Between markers
/// there never is.
fn polished(picture: &Grid<u8>, mut corners: Vec<Corner>) -> Vec<Corner> {
    let side = picture.width().max(picture.height());
    let largest = (side / SIDE_PER_WINDOW).max(SMALLEST_WINDOW);
    let all: Vec<Point2<f64>> = corners.iter().map(|c| c.pixel).collect();
    for corner in &mut corners {
        let distances = all
            .iter()
            .map(|p| (p - corner.pixel).norm())
            .filter(|d| *d > 0.0);
        let nearest = distances.fold(f64::INFINITY, f64::min);
        let half = ((nearest * WINDOW_PART) as usize).min(largest);
        let refined = (half >= SMALLEST_WINDOW)
            .then(|| refine::refined(picture, corner.pixel, half as i32))
            .flatten();
        if let Some(at) = refined.filter(|at| (at - corner.pixel).norm() < LARGEST_MOVE) {
            corner.pixel = at;
        }
    }
    corners
}
