//! Compares corners that lie close to markers, in rendered pictures, with their true positions.

use nalgebra::{Isometry3, Point2, Vector3};
use scand_core::calibration::Face;
use scand_core::calibration::fit::{
    Corner, Figures, Fit, FittedCamera, FittedPlacement, FittedShape, Session, SessionCamera,
    Uncertainty, View, find_corners, matched_with_print,
};
use scand_core::frame::Picture;
use scand_core::image::Grid;
use scand_lab::{BoardOptions, BoardSession, Encoding, Options};

/// Pictures of a two-sided board whose markers leave little room, with their cameras.
fn rendered() -> BoardSession {
    let mut options = Options {
        width: 640,
        height: 480,
        cameras: 5,
        depth_cameras: 0,
        ..Options::for_boards()
    };
    options.color.encoding = Encoding::Mono;
    let boards = BoardOptions {
        board: "charuco:9x6:25mm:two-sided".to_owned(),
        placements: 3,
        ..BoardOptions::default()
    };
    BoardSession::new(options, boards).unwrap()
}

/// A session of one picture, with the corners that were found in it.
fn session_of(rendered: &BoardSession, camera: usize, face: Face, corners: Vec<Corner>) -> Session {
    let camera = &rendered.rig().colors[camera].actual;
    Session {
        board: *rendered.board(),
        cameras: vec![SessionCamera {
            id: camera.id.clone(),
            size: [camera.intrinsics.width, camera.intrinsics.height],
            known: None,
            start: None,
        }],
        placements: vec!["one".to_owned()],
        views: vec![View {
            camera: 0,
            placement: 0,
            face,
            corners,
        }],
    }
}

/// The true camera, and a board that lies a little beside its place: what a first fit could have found.
fn first_fit(rendered: &BoardSession, placement: usize, camera: usize, face: Face) -> Fit {
    let beside = Isometry3::new(
        Vector3::new(2e-4, -1e-4, 2e-4),
        Vector3::new(1e-3, 2e-3, 0.0),
    );
    let of_face = |seen| {
        if face == seen {
            beside
        } else {
            Isometry3::identity()
        }
    };
    let rig_from_board = rendered.placements()[placement].rig_from_board;
    Fit {
        board: *rendered.board(),
        cameras: vec![FittedCamera {
            camera: rendered.rig().colors[camera].actual.clone(),
            uncertainty: Uncertainty::default(),
            projection: None,
            figures: Figures::default(),
            views: 1,
            coverage: 1.0,
            false_corners: 0,
            is_lens_given: false,
        }],
        placements: vec![FittedPlacement {
            name: "one".to_owned(),
            rig_from_board: rig_from_board * of_face(Face::Front),
            figures: Figures::default(),
            cameras: 1,
        }],
        front_from_back: rendered.front_from_back() * of_face(Face::Back),
        shape: FittedShape::default(),
        table: "one".to_owned(),
        changes: Vec::new(),
        table_is_lowest: true,
        figures: Figures::default(),
        held_out: None,
        volume: None,
        left_out: Vec::new(),
        views: Vec::new(),
        residuals: Vec::new(),
        links: Vec::new(),
    }
}

/// Squared errors of a picture's corners as they are found, and as they match the print that a fit expects a little
/// beside its place.
fn squares(rendered: &BoardSession, placement: usize, camera: usize) -> Option<[Vec<f64>; 2]> {
    let capture = rendered.capture(placement).unwrap();
    let truth = &rendered.rig().colors[camera].actual;
    let mut frames = capture.frames.iter().filter(|f| f.camera == truth.id);
    let Some(Picture::Raw { data, .. }) = frames.next().map(|f| &f.picture) else {
        panic!("{placement} {camera}");
    };
    let lens = &truth.intrinsics;
    let picture = Grid::from_pixels(lens.width, lens.height, data.to_vec());
    let board = rendered.board();
    let (face, found) = find_corners(&picture, board).ok()?;
    let session = session_of(rendered, camera, face, found.clone());
    let fit = first_fit(rendered, placement, camera, face);
    let matched = matched_with_print(&session, &fit, &session.views[0], &picture).unwrap();
    let front = rendered.placements()[placement].rig_from_board;
    let rig_from_face = match face {
        Face::Front => front,
        Face::Back => front * rendered.front_from_back(),
    };
    let error = |corner: &Corner| {
        let p = rig_from_face * board.corner_position(corner.column, corner.row);
        let true_pixel: Point2<f64> = truth.project(p).unwrap().0;
        (corner.pixel - true_pixel).norm_squared()
    };
    Some([&found, &matched].map(|corners| corners.iter().map(error).collect()))
}

/// Tests of more than ten seconds: `make check` leaves them to `make test`.
mod long {
    use super::*;

    #[test]
    fn corners_between_markers_are_where_the_print_is() {
        let session = rendered();
        let seen = (0..15).filter_map(|k| squares(&session, k / 5, k % 5));
        let (mut found, mut matched) = (Vec::new(), Vec::new());
        for [of_found, of_matched] in seen {
            found.extend(of_found);
            matched.extend(of_matched);
        }
        let rms = |squares: &[f64]| (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
        assert!(matched.len() > 200 && 10 * matched.len() > 9 * found.len());
        let [found, matched] = [rms(&found), rms(&matched)];
        println!("rms {found:.4} px as found, {matched:.4} px as matched");
        assert!(matched < 0.02 && matched < 0.4 * found, "{matched} {found}");
    }
}
