//! Tests that a painted board is what a camera would see, and that a rig can be calibrated from the placements.

use super::super::{Capture, Encoding, Options, Response};
use super::paint::{Directions, rendered};
use super::*;
use crate::random::Random;
use nalgebra::{Isometry3, Point2, Point3, Vector3};
use scand_core::calibration::fit::find_corners;
use scand_core::calibration::response::{PlaneParameters, PlaneView, fit_plane, mean_readings};
use scand_core::calibration::{Board, Camera, DepthResponse, Face};
use scand_core::frame::{Picture, Stream};
use scand_core::image::Grid;

fn session(width: usize, change: impl FnOnce(&mut Options, &mut BoardOptions)) -> BoardSession {
    let mut options = Options {
        width,
        height: width * 3 / 4,
        ..Options::for_boards()
    };
    options.color.encoding = Encoding::Mono;
    let mut boards = BoardOptions::default();
    change(&mut options, &mut boards);
    BoardSession::new(options, boards).unwrap()
}

/// The part of a pixel that is black, by many rays through the exact lens.
fn black_by_rays(
    camera: &Camera,
    board: &Board,
    rig_from_face: &Isometry3<f64>,
    pixel: [usize; 2],
    random: &mut Random,
) -> f64 {
    const RAYS: usize = 4000;
    let black = board.black_rectangles(Face::Front);
    let face_from_camera = rig_from_face.inverse() * camera.rig_from_camera;
    let hits = (0..RAYS).filter(|_| {
        let at = pixel.map(|v| v as f64 + random.between(-0.5, 0.5));
        let n = camera.intrinsics.unproject(Point2::from(at)).unwrap();
        let eye = face_from_camera * Point3::origin();
        let ray = face_from_camera * Vector3::new(n.x, n.y, 1.0);
        let p = eye - ray * (eye.z / ray.z);
        let inside =
            |a: usize, r: &scand_core::calibration::Rectangle| (r.min[a]..r.max[a]).contains(&p[a]);
        black.iter().any(|r| inside(0, r) && inside(1, r))
    });
    hits.count() as f64 / RAYS as f64
}

#[test]
fn painted_pixels_are_what_rays_through_the_lens_find() {
    let session = session(1280, |options, boards| {
        options.depth_cameras = 0;
        boards.board = "charuco:9x6:25mm".to_owned();
        boards.placements = 3;
    });
    let camera = &session.rig().colors[8].actual;
    let pose = session.placements()[2].rig_from_board;
    let directions = Directions::new(&camera.intrinsics);
    let picture = rendered(camera, &directions, &session.plate, &pose, 0.0);
    let mut rows = vec![vec![[0.0_f32; 3]; 1280]; 960];
    for (y, row) in rows.iter_mut().enumerate() {
        picture.fill_row(y, row);
    }
    let mut random = Random::new(&[5]);
    let (mut differences, mut partial) = (Vec::new(), 0);
    for (column, row) in [(0, 0), (4, 2), (8, 5), (3, 5)] {
        let corner = session.board().corner_position(column, row);
        let (at, _) = camera.project(pose * corner).unwrap();
        for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1), (5, 0), (0, 5), (-5, 2)] {
            let [x, y] = [at.x as isize + dx, at.y as isize + dy];
            if !(0..1280).contains(&x) || !(0..960).contains(&y) {
                continue;
            }
            let pixel = [x as usize, y as usize];
            let found = black_by_rays(camera, session.board(), &pose, pixel, &mut random);
            // Paper and ink are the brightest and the darkest that this picture has.
            let (white, black) = levels(&rows);
            let painted = f64::from((white - rows[pixel[1]][pixel[0]][1]) / (white - black));
            partial += usize::from((0.02..0.98).contains(&found));
            differences.push(painted - found);
        }
    }
    let worst = differences.iter().fold(0.0_f64, |m, d| m.max(d.abs()));
    let mean = differences.iter().sum::<f64>() / differences.len() as f64;
    assert!(
        partial >= 8 && differences.len() >= 20,
        "{partial} of {}",
        differences.len()
    );
    // 4000 rays are good to 0.8 %.
    assert!(worst < 0.03 && mean.abs() < 0.004, "{worst} {mean}");
}

#[test]
fn a_bent_and_stretched_board_shows_its_corners_where_its_sheet_is() {
    let session = session(1280, |options, boards| {
        options.depth_cameras = 0;
        boards.placements = 3;
        boards.bend_mm = [2.0, -1.0];
        boards.stretch_percent = 0.4;
    });
    let (board, pose) = (session.board(), session.placements()[2].rig_from_board);
    let surface = session.plate.surface(Face::Front);
    let (mut off_sheet, mut off_plane, mut views) = (0.0_f64, 0.0_f64, 0);
    let capture = session.capture(2).unwrap();
    for frame in &capture.frames {
        let colors = session.rig().colors.iter();
        let mut stations = colors.filter(|s| s.actual.id == frame.camera);
        let camera = &stations.next().unwrap().actual;
        let Picture::Raw {
            data,
            width,
            height,
            ..
        } = &frame.picture
        else {
            panic!("pictures are raw")
        };
        let (width, height) = (*width as usize, *height as usize);
        let picture = Grid::from_fn(width, height, |x, y| data[y * width + x]);
        let Ok((_, corners)) = find_corners(&picture, board) else {
            continue;
        };
        views += 1;
        for corner in corners {
            let plane = board.corner_position(corner.column, corner.row);
            let off = |p: Point3<f64>| (camera.project(pose * p).unwrap().0 - corner.pixel).norm();
            off_sheet = off_sheet.max(off(surface.point([plane.x, plane.y])));
            off_plane = off_plane.max(off(plane));
        }
    }
    assert!(
        views >= 2 && off_sheet < 0.2 && off_plane > 1.0,
        "{views}: {off_sheet} {off_plane}"
    );
}

/// The lightest and the darkest value of the green channel.
fn levels(rows: &[Vec<[f32; 3]>]) -> (f32, f32) {
    let values = rows.iter().flatten().map(|p| p[1]);
    values.fold((0.0, 1.0), |(high, low), v| {
        (f32::max(high, v), f32::min(low, v))
    })
}

/// How many corners of the front a camera has in its picture, seen at less than 70 degrees.
fn corners_seen(camera: &Camera, board: &Board, pose: &Isometry3<f64>) -> usize {
    let eye = pose.inverse() * camera.center();
    let middle = board.corner_position(board.columns / 2, board.rows / 2);
    let cosine = -eye.z / (eye - middle).norm();
    if cosine < 70_f64.to_radians().cos() {
        return 0;
    }
    let inside = |p: &Point3<f64>| {
        let seen = camera.project(pose * p);
        seen.is_some_and(|(pixel, _)| camera.intrinsics.contains(pixel))
    };
    board
        .corner_positions()
        .iter()
        .filter(|p| inside(p))
        .count()
}

#[test]
fn placements_join_neighbours_and_vary_distance_and_tilt() {
    for seed in 1..4 {
        let session = session(320, |options, _| options.seed = seed);
        let board = session.board();
        let all = board.corners_per_face();
        let sees =
            |camera: &Camera, p: &Placement| corners_seen(camera, board, &p.rig_from_board) == all;
        let colors = &session.rig().colors;
        for station in colors {
            let seen = session
                .placements()
                .iter()
                .filter(|p| sees(&station.actual, p));
            let count = seen.count();
            assert!(
                count >= 4,
                "{} sees {count}, seed {seed}",
                station.actual.id
            );
            let partners = colors.iter().filter(|other| {
                let both = |p: &&Placement| sees(&station.actual, p) && sees(&other.actual, p);
                other.actual.id != station.actual.id
                    && session.placements().iter().filter(both).count() >= 2
            });
            assert!(partners.count() >= 2, "{}, seed {seed}", station.actual.id);
        }
        let kinect = &session.rig().depths[0].actual.camera;
        let distances = session.placements().iter().filter(|p| sees(kinect, p));
        let distances: Vec<f64> = distances
            .map(|p| {
                kinect
                    .camera_from_rig(p.rig_from_board * Point3::origin())
                    .z
            })
            .collect();
        let near = distances.iter().copied().fold(f64::INFINITY, f64::min);
        let far = distances.iter().copied().fold(0.0, f64::max);
        assert!(distances.len() >= 7, "{distances:?}");
        assert!(near < 0.85 && far > 1.25, "{near} to {far}, seed {seed}");
        let lowest = session.placements().iter().flat_map(|p| {
            let corners = super::plate::corners(board);
            corners.map(|[x, y]| (p.rig_from_board * Point3::new(x, y, 0.0)).z)
        });
        assert!(lowest.fold(f64::INFINITY, f64::min) > -1e-9);
    }
}

#[test]
fn the_first_board_lies_on_the_table_around_the_origin() {
    let session = session(320, |_, _| ());
    let pose = session.placements()[0].rig_from_board;
    let board = session.board();
    let first = pose * board.corner_position(0, 0);
    let last = pose * board.corner_position(board.columns - 1, board.rows - 1);
    assert!((nalgebra::center(&first, &last).coords).norm() < 1e-12);
    assert!((pose * Vector3::x() - Vector3::x()).norm() < 1e-12);
    assert!((pose * Vector3::z() + Vector3::z()).norm() < 1e-12);
}

#[test]
fn depth_readings_are_the_plane_and_the_bias() {
    let session = session(320, |options, boards| {
        options.cameras = 2;
        options.depth.bias_mm = 20.0;
        options.depth.noise_steps = 0.0;
        options.depth.pattern_steps = 0.0;
        options.depth.quantized = false;
        options.depth.holes = false;
        boards.placements = 4;
    });
    let truth = session.truth();
    let (camera, response) = truth.cameras.values().last().unwrap();
    let response: DepthResponse = response.unwrap();
    assert!((response.intercept + 0.020).abs() < 1e-12);
    let capture = session.capture(3).unwrap();
    let frame = capture
        .frames
        .iter()
        .find(|f| f.stream == Stream::Depth)
        .unwrap();
    let Picture::Raw { data, .. } = &frame.picture else {
        panic!("depth is raw")
    };
    let pose = camera.rig_from_camera.inverse() * session.placements()[3].rig_from_board;
    let normal = pose * Vector3::z();
    let mut worst = 0.0_f64;
    for p in session.board().corner_positions() {
        let pixel = camera
            .intrinsics
            .project((pose * p).x, (pose * p).y, (pose * p).z)
            .unwrap();
        let (x, y) = (pixel.x.round() as usize, pixel.y.round() as usize);
        let at = 2 * (y * camera.intrinsics.width + x);
        let z = response
            .depth(u16::from_le_bytes([data[at], data[at + 1]]))
            .unwrap();
        let p = response
            .point(&camera.intrinsics, Point2::new(x as f64, y as f64), z)
            .unwrap();
        worst = worst.max((p - pose * Point3::origin()).dot(&normal).abs());
    }
    assert!(worst < 8e-4, "{worst}");
}

#[test]
fn sessions_are_the_same_each_time_and_their_faults_are_seen() {
    let make = |change: fn(&mut BoardOptions)| {
        session(320, |options, boards| {
            options.cameras = 3;
            options.depth.frames = 1;
            boards.placements = 4;
            change(boards);
        })
    };
    let plain = make(|_| ());
    let capture = |session: &BoardSession, index| session.capture(index).unwrap();
    assert_eq!(capture(&plain, 2), capture(&make(|_| ()), 2));
    let duplicate = make(|boards| boards.faults.duplicate = vec![3]);
    assert_eq!(duplicate.placements()[3], duplicate.placements()[2]);
    let blind = make(|boards| boards.faults.blind = vec!["c01".to_owned()]);
    let (seeing, blind) = (capture(&plain, 1), capture(&blind, 1));
    for (a, b) in seeing.frames.iter().zip(&blind.frames) {
        assert_eq!(
            a.picture == b.picture,
            a.camera.as_str() != "c01",
            "{}",
            a.camera
        );
    }
    let turned = make(|boards| boards.faults.turned_over = vec![1]);
    let board = plain.board();
    let first = plain.placements()[1].rig_from_board * board.corner_position(0, 0);
    let last = board.corner_position(board.columns - 1, board.rows - 1);
    assert!((turned.placements()[1].rig_from_board * last - first).norm() < 1e-12);
    let moved = |boards: &mut BoardOptions| {
        boards.faults.moved_mm = vec![PlacementFault {
            placement: 1,
            amount: 9.0,
        }];
    };
    let moved = capture(&make(moved), 1);
    assert_eq!(
        seeing.frames[0].picture == moved.frames[0].picture,
        seeing.frames[0].camera.as_str() == "c00"
    );
}

#[test]
fn what_is_not_there_cannot_fail() {
    let bad: [fn(&mut BoardOptions); 6] = [
        |b| b.faults.duplicate = vec![0],
        |b| b.faults.turned_over = vec![20],
        |b| b.faults.blind = vec!["c77".to_owned()],
        |b| {
            b.faults.moved_mm = vec![PlacementFault {
                placement: 1,
                amount: f64::NAN,
            }]
        },
        |b| b.placements = 0,
        |b| b.board = "checkerboard".to_owned(),
    ];
    for change in bad {
        let mut boards = BoardOptions::default();
        change(&mut boards);
        assert!(BoardSession::new(Options::for_boards(), boards).is_err());
    }
}

/// The depth frames of a capture.
fn depth_frames(capture: &Capture) -> Vec<Grid<u16>> {
    let depth = capture.frames.iter().filter(|f| f.stream == Stream::Depth);
    let grid = |frame: &scand_core::frame::Frame| {
        let Picture::Raw {
            width,
            height,
            data,
            ..
        } = &frame.picture
        else {
            panic!("depth is raw")
        };
        let readings = data
            .as_chunks::<2>()
            .0
            .iter()
            .map(|&b| u16::from_le_bytes(b));
        Grid::from_pixels(*width as usize, *height as usize, readings.collect())
    };
    depth.map(grid).collect()
}

/// Tests of more than ten seconds: `make check` leaves them to `make test`.
mod long {
    use super::*;

    #[test]
    fn boards_take_20_mm_of_bias_to_less_than_1_mm_from_70_to_130_cm() {
        for (seed, response) in [(1, Response::Ideal), (2, Response::Hidden)] {
            let session = session(320, |options, boards| {
                options.seed = seed;
                options.cameras = 2;
                options.depth.bias_mm = 20.0;
                options.depth.response = response;
                boards.placements = 20;
            });
            let truth = session.truth();
            let (camera, actual) = truth.cameras.values().last().unwrap();
            let actual = actual.unwrap();
            let captures: Vec<Grid<f32>> = (0..20)
                .filter(|k| k % 3 == 0 || k % 4 == 2)
                .map(|k| mean_readings(&depth_frames(&session.capture(k).unwrap())).unwrap())
                .collect();
            let used = (0..20).filter(|k| k % 3 == 0 || k % 4 == 2);
            let views: Vec<PlaneView<'_>> = used
                .zip(&captures)
                .map(|(k, readings)| PlaneView {
                    placement: "a",
                    camera_from_face: camera.rig_from_camera.inverse()
                        * session.placements()[k].rig_from_board,
                    readings,
                })
                .collect();
            let parameters = PlaneParameters::default();
            let fit = fit_plane(&camera.intrinsics, session.board(), &views, &parameters).unwrap();
            let bias = |z: f64| {
                let raw = (z - actual.intercept) / actual.slope;
                fit.response.slope * raw + fit.response.intercept - z
            };
            let worst = (0..=60)
                .map(|k| bias(0.7 + 0.01 * f64::from(k)).abs())
                .fold(0.0, f64::max);
            assert!(worst < 1e-3, "{worst} {:?} {:?}", fit.bias, fit.left_out);
            // Without the fit they are off by a centimetre or two.
            assert!(
                fit.bias.iter().any(|b| b.bias_before.abs() > 0.01),
                "{:?}",
                fit.bias
            );
            for z in [0.7, 1.3] {
                let off = fit.response.scale_at(z) - actual.scale_at(z);
                assert!(off.abs() < 0.005, "{off}");
            }
        }
    }
}
