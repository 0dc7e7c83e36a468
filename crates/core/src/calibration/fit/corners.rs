//! Finds the board's corners in a picture: ChESS features, refined at their saddle points, form a labelled grid, which
//! is compared with the board.

use super::appearance;
use super::grid::{self, Labelled, Rejection};
use super::resize;
use super::session::Corner;
use super::subpixel;
use crate::calibration::{Board, BoardKind, Face};
use crate::image::Grid;
use calib_targets_charuco::{CharucoBoardSpec, CharucoDetectError, CharucoDetector, CharucoParams};
use calib_targets_chessboard::{
    ChessCorner, ChessboardDetector, ChessboardParams, DetectorConfig, GrayImageView,
    default_chess_config, detect_corners,
};
use chess_corners::ImageRefiner;
use nalgebra::{Point2, Vector2};

/// Fewest markers that tell where a ChArUco board is.
const FEWEST_MARKERS: usize = 3;

/// Shorter side of a picture, in pixels, that is worth looking at in half its size.
const SMALLEST_HALVED: usize = 600;
/// Shorter side of a picture, in pixels, up to which it is magnified where no marker can be read, and by how much: a
/// square of 10 pixels then has room for the ring that features are found by.
const LARGEST_MAGNIFIED: usize = 500;
const MAGNIFIED: f64 = 4.0;
/// Farthest, in pixels, that a corner may be from its saddle point.
const LARGEST_MOVE: f64 = 1.5;

/// Finds the board in a grey picture; of a two-sided one, the side that shows. Where it does not show at full size,
/// because it is blurred, it is looked for in the picture at half and a quarter of its size; and where its markers are
/// small, in a small picture magnified.
///
/// # Errors
/// If there is no board, or what is there is not this board.
pub fn find_corners(picture: &Grid<u8>, board: &Board) -> Result<(Face, Vec<Corner>), Rejection> {
    let mut first = find_at_size(picture, board, picture, 1.0);
    let side = picture.width().min(picture.height());
    if first.is_err() && board.kind != BoardKind::Checkerboard && side <= LARGEST_MAGNIFIED {
        let large = resize::magnified(picture, MAGNIFIED);
        first = better(first, find_at_size(&large, board, picture, 1.0 / MAGNIFIED));
    }
    let mut smaller = picture;
    let mut halved;
    for scale in [2.0, 4.0] {
        if first.is_ok() || smaller.width().min(smaller.height()) < SMALLEST_HALVED {
            break;
        }
        halved = resize::half_size(smaller);
        smaller = &halved;
        first = better(first, find_at_size(smaller, board, picture, scale));
    }
    first
}

/// What was found; of two errors the one that says more.
fn better<T>(first: Result<T, Rejection>, second: Result<T, Rejection>) -> Result<T, Rejection> {
    match (&first, &second) {
        (Ok(_), _) | (Err(Rejection::NoMarkers), Err(Rejection::Nothing)) => first,
        (Err(Rejection::Nothing | Rejection::NoMarkers), _) | (_, Ok(_)) => second,
        _ => first,
    }
}

/// Finds the board in a picture a pixel of which is `scale` pixels of `full` long; the corners are those of `full`.
fn find_at_size(
    picture: &Grid<u8>,
    board: &Board,
    full: &Grid<u8>,
    scale: f64,
) -> Result<(Face, Vec<Corner>), Rejection> {
    if picture.width() < 16 || picture.height() < 16 {
        return Err(Rejection::Nothing);
    }
    let view = GrayImageView {
        width: picture.width(),
        height: picture.height(),
        data: picture.pixels(),
    };
    let features = detect_corners(&view, &features_config());
    let (face, mut corners) = match board.kind {
        BoardKind::Checkerboard => (Face::Front, checkerboard(picture, &features, board)?),
        BoardKind::Charuco(_) => charuco(picture, &view, &features, board)?,
    };
    // Pixel centres are at whole numbers: the centre of a pixel of half size lies between two.
    let shift = Vector2::repeat((scale - 1.0) / 2.0);
    for corner in &mut corners {
        corner.pixel = corner.pixel * scale + shift;
    }
    let largest_move = scale.max(1.0) * LARGEST_MOVE;
    Ok((face, subpixel::polished(full, corners, board, largest_move)))
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
    picture: &Grid<u8>,
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
    let by_markers = best.1.map(|corners| (best.0, corners));
    by_markers.or_else(|why| by_appearance(picture, features, board).ok_or(why))
}

/// The part of a ChArUco board that a grid of corners is most like, where markers are too small to be read.
fn by_appearance(
    picture: &Grid<u8>,
    features: &[ChessCorner],
    board: &Board,
) -> Option<(Face, Vec<Corner>)> {
    // Markers' own corners are weaker than those of squares.
    let mut strict = ChessboardParams::default();
    strict.min_corner_strength = 60.0;
    let mut found = Vec::new();
    for parameters in [ChessboardParams::default(), strict] {
        let Ok(detector) = ChessboardDetector::new(parameters) else {
            continue;
        };
        let grids = detector.detect_all(features);
        let grids = grids
            .iter()
            .filter(|grid| grid.corners.len() >= 4 * FEWEST_MARKERS);
        found.extend(grids.filter_map(|grid| {
            let labelled = grid.corners.iter().map(label).collect();
            appearance::read(labelled, board, |at| resize::between(picture, at))
        }));
    }
    let large = |found: &(Face, Vec<Corner>)| found.1.len() >= 4 * FEWEST_MARKERS;
    found
        .into_iter()
        .filter(large)
        .max_by_key(|found| found.1.len())
}

/// A detected corner's label and pixel.
fn label(corner: &calib_targets_chessboard::ChessboardCorner) -> ((i32, i32), Point2<f64>) {
    let pixel = Point2::new(f64::from(corner.position.x), f64::from(corner.position.y));
    ((corner.grid.u, corner.grid.v), pixel)
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
        .map_err(|cause| match cause {
            CharucoDetectError::NoMarkers | CharucoDetectError::AlignmentFailed { .. } => {
                Rejection::NoMarkers
            }
            _ => Rejection::Nothing,
        })?;
    if found.markers.len() < FEWEST_MARKERS {
        return Err(Rejection::FewMarkers {
            found: found.markers.len(),
            needed: FEWEST_MARKERS,
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

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Isometry3, Point3, Vector3};

    /// A board as a pinhole camera of 700 px sees it, each pixel the mean of 5x5 samples, blurred by averaging.
    fn picture(board: &Board, pose: &Isometry3<f64>, size: [usize; 2]) -> Grid<u8> {
        let h = pose.to_homogeneous();
        let plane = nalgebra::Matrix3::from_columns(&[
            h.fixed_view::<3, 1>(0, 0).into_owned(),
            h.fixed_view::<3, 1>(0, 1).into_owned(),
            h.fixed_view::<3, 1>(0, 3).into_owned(),
        ]);
        let lens = nalgebra::Matrix3::new(
            700.0,
            0.0,
            size[0] as f64 / 2.0,
            0.0,
            700.0,
            size[1] as f64 / 2.0,
            0.0,
            0.0,
            1.0,
        );
        let back = (lens * plane).try_inverse().unwrap();
        let light = |x: f64, y: f64| {
            let at = Point2::from_homogeneous(back * Vector3::new(x, y, 1.0)).unwrap();
            let square = |v: f64| (v / board.square).floor() as i64 + 1;
            let (i, j) = (square(at.x), square(at.y));
            let inside =
                (0..=board.columns as i64).contains(&i) && (0..=board.rows as i64).contains(&j);
            if inside && (i + j) % 2 == 0 {
                40.0
            } else {
                210.0
            }
        };
        Grid::from_fn(size[0], size[1], |x, y| {
            let sample = |k: usize| (k as f64 - 3.5) / 4.0;
            let samples =
                (0..64).map(|k| light(x as f64 + sample(k % 8), y as f64 + sample(k / 8)));
            (samples.sum::<f64>() / 64.0).round() as u8
        })
    }

    #[test]
    fn a_rendered_boards_corners_are_found_to_a_twentieth_of_a_pixel() {
        let board = Board::checkerboard(9, 6, 0.025).unwrap();
        let pose = Isometry3::new(
            Vector3::new(-0.11, -0.05, 0.55),
            Vector3::new(0.3, -0.35, 0.2),
        );
        let picture = picture(&board, &pose, [640, 480]);
        let (_, corners) = find_corners(&picture, &board).unwrap();
        assert_eq!(corners.len(), 54);
        let squares = corners.iter().map(|c| {
            let p: Point3<f64> = pose * board.corner_position(c.column, c.row);
            let truth = Point2::new(700.0 * p.x / p.z + 320.0, 700.0 * p.y / p.z + 240.0);
            (c.pixel - truth).norm_squared()
        });
        let rms = (squares.sum::<f64>() / 54.0).sqrt();
        assert!(rms < 0.05, "{rms}");
        let other = Board::checkerboard(8, 6, 0.025).unwrap();
        assert!(matches!(
            find_corners(&picture, &other),
            Err(Rejection::Size { .. })
        ));
    }

    #[test]
    fn a_board_whose_markers_are_not_there_is_told_from_no_board() {
        let plain = Board::checkerboard(9, 6, 0.025).unwrap();
        let pose = Isometry3::new(Vector3::new(-0.11, -0.05, 0.55), Vector3::zeros());
        let picture = picture(&plain, &pose, [800, 600]);
        let with_markers = Board::charuco(9, 6, 0.025, false).unwrap();
        let found = find_corners(&picture, &with_markers);
        let is_without = |cause: &Rejection| {
            matches!(cause, Rejection::NoMarkers | Rejection::FewMarkers { .. })
        };
        assert!(found.as_ref().is_err_and(is_without), "{found:?}");
        let blank = Grid::from_fn(800, 600, |_, _| 128);
        let found = find_corners(&blank, &with_markers);
        assert!(matches!(found, Err(Rejection::Nothing)), "{found:?}");
    }

    #[test]
    fn a_board_too_blurred_for_full_size_is_found_in_half() {
        let board = Board::checkerboard(9, 6, 0.025).unwrap();
        let pose = Isometry3::new(Vector3::new(-0.1, -0.06, 0.5), Vector3::new(0.2, 0.1, 0.1));
        let small = picture(&board, &pose, [320, 240]);
        // Five times the size, between pixels linear: every edge is five pixels wide.
        let large = Grid::from_fn(1600, 1200, |x, y| {
            let at = Vector2::new(x as f64 / 5.0, y as f64 / 5.0);
            let (i, j) = ((at.x as usize).min(318), (at.y as usize).min(238));
            let (fx, fy) = (at.x - i as f64, at.y - j as f64);
            let v = |i: usize, j: usize| f64::from(small[(i, j)]);
            let top = v(i, j) * (1.0 - fx) + v(i + 1, j) * fx;
            let bottom = v(i, j + 1) * (1.0 - fx) + v(i + 1, j + 1) * fx;
            (top * (1.0 - fy) + bottom * fy).round() as u8
        });
        let (_, corners) = find_corners(&large, &board).unwrap();
        let squares = corners.iter().map(|c| {
            let p: Point3<f64> = pose * board.corner_position(c.column, c.row);
            let truth = Point2::new(700.0 * p.x / p.z + 160.0, 700.0 * p.y / p.z + 120.0) * 5.0;
            (c.pixel - truth).norm_squared()
        });
        let rms = (squares.sum::<f64>() / corners.len() as f64).sqrt();
        assert!(corners.len() >= 50 && rms < 0.4, "{} {rms}", corners.len());
    }
}
