//! Tests that fits to boards recover known responses.

use super::*;
use crate::calibration::{Board, DepthResponse, Distortion, Intrinsics};
use crate::image::Grid;
use nalgebra::{Isometry3, Point2, Translation3, UnitQuaternion, Vector2, Vector3};

fn lens() -> Intrinsics {
    let (focal, center) = (Vector2::repeat(575.8), Vector2::new(319.5, 239.5));
    Intrinsics::new(640, 480, focal, center, Distortion::default()).unwrap()
}

/// A sensor that needs all of it.
fn sensor() -> DepthResponse {
    DepthResponse {
        slope: 0.00104,
        intercept: -0.038,
        scale: [1.012, -0.009, 0.0, 0.0, 0.0],
        ..DepthResponse::default()
    }
}

/// Boards at distances from 0.7 to 1.3 m, here and there, tilted this way and that.
fn poses(count: usize) -> Vec<Isometry3<f64>> {
    let pose = |k: usize| {
        let turn = 2.4 * k as f64;
        let tilt = Vector3::new(turn.cos(), turn.sin(), 0.0) * (0.15 + 0.06 * (k % 7) as f64);
        let z = 0.7 + 0.6 * ((k * 5) % count) as f64 / (count - 1) as f64;
        let at = [
            -0.1 + 0.25 * z * (turn * 1.7).sin(),
            -0.08 + 0.16 * z * (turn * 0.9).cos(),
            z,
        ];
        Isometry3::from_parts(
            Translation3::from(at),
            UnitQuaternion::from_scaled_axis(tilt),
        )
    };
    (0..count).map(pose).collect()
}

fn board() -> Board {
    Board::checkerboard(9, 6, 0.025).unwrap()
}

/// What a sensor reads of a plane, in steps of whole units, with a pattern that grows with z².
fn readings(
    pose: &Isometry3<f64>,
    response: &DepthResponse,
    pattern: impl Fn(f64, f64) -> f64,
) -> Grid<u16> {
    let lens = lens();
    let normal = pose * Vector3::z();
    let offset = normal.dot(&pose.translation.vector);
    Grid::from_fn(640, 480, |x, y| {
        let n = lens.unproject(Point2::new(x as f64, y as f64)).unwrap();
        let mut z = offset / normal.z;
        for _ in 0..5 {
            let s = response.scale_at(z);
            z = offset / (normal.z + s * (normal.x * n.x + normal.y * n.y));
        }
        let noise = 0.001 * (((x * 7919 + y * 104_729) % 101) as f64 / 50.0 - 1.0);
        let z = z + z * z * (noise + pattern(n.x, n.y));
        ((z - response.intercept) / response.slope).round() as u16
    })
}

fn fitted(poses: &[Isometry3<f64>], frames: &[Vec<Grid<u16>>]) -> Result<PlaneFit, ResponseError> {
    fitted_with(poses, frames, &PlaneParameters::default())
}

fn fitted_with(
    poses: &[Isometry3<f64>],
    frames: &[Vec<Grid<u16>>],
    parameters: &PlaneParameters,
) -> Result<PlaneFit, ResponseError> {
    let means: Vec<Grid<f32>> = frames.iter().map(|f| mean_readings(f).unwrap()).collect();
    let names: Vec<String> = (0..poses.len()).map(|k| format!("p{k}")).collect();
    let views = poses
        .iter()
        .zip(&means)
        .zip(&names)
        .map(|((pose, readings), name)| PlaneView {
            placement: name,
            camera_from_face: *pose,
            readings,
        });
    let views: Vec<PlaneView<'_>> = views.collect();
    fit_plane(&lens(), &board(), &views, parameters)
}

fn no_pattern(_: f64, _: f64) -> f64 {
    0.0
}

/// Largest difference in depth between two responses from 0.7 to 1.3 m.
fn largest_bias(found: &DepthResponse, truth: &DepthResponse) -> f64 {
    let at = |k: i32| {
        let z = 0.7 + 0.01 * f64::from(k);
        let raw = (z - truth.intercept) / truth.slope;
        (found.slope * raw + found.intercept - z).abs()
    };
    (0..=60).map(at).fold(0.0, f64::max)
}

#[test]
fn a_response_is_found_from_planes() {
    let poses = poses(9);
    let frames: Vec<_> = poses
        .iter()
        .map(|p| vec![readings(p, &sensor(), no_pattern)])
        .collect();
    let fit = fitted(&poses, &frames).unwrap();
    let bias = largest_bias(&fit.response, &sensor());
    assert!(bias < 2e-4, "{bias}");
    for z in [0.7, 1.0, 1.3] {
        let off = fit.response.scale_at(z) - sensor().scale_at(z);
        assert!(off.abs() < 2e-3, "{off} at {z}");
    }
    assert!(fit.response.uncertainty < 5e-4);
    let worst = |pick: fn(&DistanceBias) -> f64| fit.bias.iter().map(pick).fold(0.0, f64::max);
    assert!(worst(|b| b.bias.abs()) < 2e-4, "{:?}", fit.bias);
    assert!(worst(|b| b.bias_before.abs()) > 0.01, "{:?}", fit.bias);
    assert!(
        fit.left_out.is_empty() && !fit.correction.pays,
        "{:?}",
        fit.correction
    );
}

#[test]
fn a_board_that_moved_and_one_without_readings_are_left_out_and_named() {
    let poses = poses(9);
    let mut frames: Vec<_> = poses
        .iter()
        .map(|p| vec![readings(p, &sensor(), no_pattern)])
        .collect();
    let moved = Translation3::new(0.0, 0.0, 0.012) * poses[4];
    frames[4] = vec![readings(&moved, &sensor(), no_pattern)];
    frames[6] = vec![Grid::filled(640, 480, 0)];
    let fit = fitted(&poses, &frames).unwrap();
    let names = |all: &[(String, String)]| -> Vec<String> {
        all.iter().map(|(name, _)| name.clone()).collect()
    };
    assert_eq!(names(&fit.unread), ["p6"], "{:?}", fit.unread);
    assert_eq!(names(&fit.left_out), ["p4"], "{:?}", fit.left_out);
    assert_eq!(fit.change, None);
    assert!(largest_bias(&fit.response, &sensor()) < 3e-4);
}

#[test]
fn bias_at_most_covers_boards_that_moved_between_colour_and_depth() {
    let poses = poses(12);
    let frames: Vec<Grid<u16>> = poses.iter().map(readings_of).collect();
    let mut told = Vec::new();
    for k in 0..12 {
        for side in [-1.0, 1.0] {
            let mut frames = frames.clone();
            for (index, metres) in [(k, 0.002), ((k + 5) % 12, 0.0004)] {
                let moved = Translation3::new(0.0, 0.0, side * metres) * poses[index];
                frames[index] = readings_of(&moved);
            }
            let frames: Vec<Vec<Grid<u16>>> = frames.into_iter().map(|f| vec![f]).collect();
            let fit = fitted(&poses, &frames).unwrap();
            let off = largest_bias(&fit.response, &sensor());
            told.push((k, side, 1e3 * off, 1e3 * fit.response.uncertainty));
        }
    }
    assert!(
        told.iter().all(|(_, _, off, most)| off <= most),
        "{told:#?}"
    );
    // And it is no excuse for anything.
    assert!(told.iter().all(|(_, _, _, most)| *most < 3.0), "{told:#?}");
}

#[test]
fn readings_that_change_during_the_session_are_told_from_boards_that_moved() {
    let poses = poses(14);
    let frames: Vec<_> = (poses.iter().enumerate())
        .map(|(k, pose)| {
            let times = if k < 9 { 1.0 } else { 1.03 };
            let truth = readings(pose, &DepthResponse::default(), no_pattern);
            vec![truth.map(|&r| (times * f64::from(r)).round() as u16)]
        })
        .collect();
    let fit = fitted(&poses, &frames).unwrap();
    assert_eq!(fit.left_out.len(), 5, "{:?}", fit.left_out);
    assert!(largest_bias(&fit.response, &DepthResponse::default()) < 3e-4);
    let words = fit.change.unwrap().words();
    assert_eq!(
        words,
        "its readings changed between p8 and p9 (3.0 % deeper)"
    );
}

#[test]
fn readings_that_change_half_way_are_told_though_no_response_fits_most_boards() {
    let poses = poses(14);
    let frames: Vec<_> = (poses.iter().enumerate())
        .map(|(k, pose)| {
            let times = if k < 7 { 1.0 } else { 1.03 };
            let truth = readings(pose, &DepthResponse::default(), no_pattern);
            vec![truth.map(|&r| (times * f64::from(r)).round() as u16)]
        })
        .collect();
    let fit = fitted(&poses, &frames).unwrap();
    // Of equally many, those stay that tell how the camera reads now.
    let left_out: Vec<&str> = fit.left_out.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(left_out, ["p0", "p1", "p2", "p3", "p4", "p5", "p6"]);
    let now = DepthResponse {
        slope: DepthResponse::default().slope / 1.03,
        ..DepthResponse::default()
    };
    let bias = largest_bias(&fit.response, &now);
    assert!(bias < 1e-3, "{bias}");
    let words = fit.change.unwrap().words();
    assert!(
        words.starts_with("its readings changed between p6 and p7 (")
            && words.ends_with(" % deeper)"),
        "{words}"
    );
}

#[test]
fn boards_at_one_distance_give_an_offset_and_no_slope() {
    let mut poses = poses(5);
    for pose in &mut poses {
        pose.translation.z = 1.0;
    }
    let offset = DepthResponse {
        intercept: -0.02,
        ..DepthResponse::default()
    };
    let frames: Vec<_> = poses
        .iter()
        .map(|p| vec![readings(p, &offset, no_pattern)])
        .collect();
    let fit = fitted(&poses, &frames).unwrap();
    assert!(
        (fit.response.slope - 0.001).abs() < 1e-9,
        "{:?}",
        fit.response
    );
    assert!(
        (fit.response.intercept + 0.02).abs() < 2e-4,
        "{:?}",
        fit.response
    );
    // A factory's slope is known to 1 %: a quarter of a metre beyond the boards these are 2.5 mm.
    let stated = fit.response.uncertainty;
    assert!((0.0024..0.005).contains(&stated), "{stated}");
    // One board is compared with nothing.
    let parameters = PlaneParameters {
        min_views: 1,
        ..PlaneParameters::default()
    };
    let one = fitted_with(&poses[..1], &frames[..1], &parameters).unwrap();
    assert_eq!(one.response.uncertainty, DepthResponse::MOST_UNCERTAINTY);
}

#[test]
fn a_bowl_of_errors_is_offered_a_correction() {
    let poses = poses(12);
    let bowl = |x: f64, y: f64| 0.02 * (x * x + y * y) - 0.001;
    let frames: Vec<_> = poses
        .iter()
        .map(|p| vec![readings(p, &sensor(), bowl)])
        .collect();
    let fit = fitted(&poses, &frames).unwrap();
    assert!(fit.correction.pays, "{:?}", fit.correction);
    assert!(fit.correction.held_out_corrected < 0.5 * fit.correction.held_out);
}

#[test]
fn too_little_is_refused_with_what_there_was() {
    let poses = poses(3);
    let frames = vec![vec![Grid::filled(640, 480, 0)]; 3];
    let message = fitted(&poses, &frames).unwrap_err().to_string();
    assert!(
        message.contains("0 usable views") && message.contains("p1: 0 of"),
        "{message}"
    );
    let small = vec![vec![Grid::filled(320, 240, 800)]; 3];
    let message = fitted(&poses, &small).unwrap_err().to_string();
    let told = "p1: the depth camera's frames have 320x240 pixels, but its lens is for pictures of 640x480";
    assert!(message.contains(told), "{message}");
    // Boards beside the picture, and behind the camera, are no reason to panic.
    let away = [
        Isometry3::translation(9.0, 0.0, 1.0),
        Isometry3::translation(0.0, 0.0, -1.0),
    ];
    assert!(fitted(&away, &frames[..2]).is_err());
}

/// Boards of a sensor without a fault but what `wrong` makes of the true depth of each pixel.
fn misread(count: usize, wrong: impl Fn(f64, f64, f64) -> f64) -> PlaneFit {
    let poses = poses(count);
    let frames: Vec<_> = poses
        .iter()
        .map(|pose| {
            let truth = readings(pose, &DepthResponse::default(), no_pattern);
            let lens = lens();
            vec![Grid::from_fn(640, 480, |x, y| {
                let n = lens.unproject(Point2::new(x as f64, y as f64)).unwrap();
                let z = 1e-3 * f64::from(truth[(x, y)]);
                (1e3 * wrong(z, n.x, n.y)).round() as u16
            })]
        })
        .collect();
    fitted(&poses, &frames).unwrap()
}

#[test]
fn depth_beside_its_colour_picture_is_told_from_a_bowl_and_a_bend() {
    let poses = poses(14);
    let frames: Vec<_> = poses
        .iter()
        .map(|pose| {
            let truth = readings(pose, &DepthResponse::default(), no_pattern);
            let beside = |x: usize, y: usize| truth[((x + 6).min(639), y)];
            vec![Grid::from_fn(640, 480, beside)]
        })
        .collect();
    let fit = fitted(&poses, &frames).unwrap();
    let misfit = fit.misfit.unwrap();
    let Cause::Misregistered([x, y]) = misfit.causes[0] else {
        panic!("{misfit:?}")
    };
    assert!((x - 6.0).abs() < 1.0 && y.abs() < 1.0, "{misfit:?}");
    assert!(
        misfit
            .words()
            .contains("depth that is displaced against its colour picture by +"),
        "{}",
        misfit.words()
    );

    let bowl = misread(14, |z, x, y| z + 0.03 * z * z * (x * x + y * y))
        .misfit
        .unwrap();
    assert!(
        matches!(bowl.causes[0], Cause::Bowl(deeper) if deeper > 0.0),
        "{bowl:?}"
    );
    let bent = misread(14, |z, _, _| z + 0.1 * (z - 1.0).powi(2))
        .misfit
        .unwrap();
    assert!(matches!(bent.causes[0], Cause::Curve(_)), "{bent:?}");
    assert_eq!(misread(14, |z, _, _| 1.01 * z - 0.02).misfit, None);
}

#[test]
fn depth_that_is_displaced_in_a_part_of_the_session_is_told_with_the_placement() {
    let poses = poses(14);
    let told = |is_displaced: fn(usize) -> bool| {
        let frames: Vec<_> = (poses.iter().enumerate())
            .map(|(k, pose)| {
                let truth = readings(pose, &DepthResponse::default(), no_pattern);
                let by = if is_displaced(k) { 6 } else { 0 };
                let beside = |x: usize, y: usize| truth[((x + by).min(639), y)];
                vec![Grid::from_fn(640, 480, beside)]
            })
            .collect();
        fitted(&poses, &frames).unwrap().misfit.unwrap()
    };
    let misfit = told(|k| k >= 7);
    let part = SessionPart::From("p7".into());
    assert_eq!(misfit.part, Some(part), "{misfit:?}");
    let Cause::Misregistered([x, y]) = misfit.causes[0] else {
        panic!("{misfit:?}")
    };
    assert!((x - 6.0).abs() < 1.5 && y.abs() < 1.5, "{misfit:?}");
    assert!(
        misfit.words().contains(" px in y from p7 on would explain"),
        "{}",
        misfit.words()
    );
    assert_eq!(told(|_| true).part, None);
}

#[test]
fn the_lateral_scale_never_runs_away() {
    for fit in [
        misread(14, |z, _, _| {
            z + 0.006 * (1.0 - 40.0 * (z - 1.0).powi(2) + 300.0 * (z - 1.0).powi(4))
        }),
        misread(14, |z, x, y| z + 0.05 * z * z * (x * x + y * y)),
    ] {
        let [near, far] = fit.response.range.unwrap();
        for z in [near, 0.7, 1.0, 1.3, far] {
            let off = fit.response.scale_at(z) - 1.0;
            assert!(off.abs() <= 0.03, "{off} at {z}: {:?}", fit.response);
        }
    }
    // Where nothing speaks for it, it is 1.
    let plain = misread(9, |z, _, _| z - 0.02).response;
    assert_eq!(plain.scale[1], 0.0, "{plain:?}");
}

/// Readings of boards at `poses`, each what `wrong` makes of the sensor's, against what the sensor's response says.
fn checked(
    poses: &[Isometry3<f64>],
    response: &DepthResponse,
    wrong: impl Fn(&Grid<u16>, usize) -> Grid<f32>,
) -> DepthCheck {
    let readings = poses.iter().enumerate();
    let readings: Vec<Grid<f32>> = readings
        .map(|(k, pose)| wrong(&readings_of(pose), k))
        .collect();
    let views = poses
        .iter()
        .zip(&readings)
        .map(|(pose, readings)| PlaneView {
            placement: "p",
            camera_from_face: *pose,
            readings,
        });
    let views: Vec<PlaneView<'_>> = views.collect();
    let plane = PlaneParameters::default();
    check_depth(&lens(), &board(), &views, response, tolerance(&plane)).unwrap()
}

fn readings_of(pose: &Isometry3<f64>) -> Grid<u16> {
    readings(pose, &sensor(), no_pattern)
}

fn tolerance(plane: &PlaneParameters) -> DepthTolerance<'_> {
    DepthTolerance {
        off: 0.005,
        misfit: 0.001,
        plane,
    }
}

#[test]
fn readings_that_are_not_those_of_the_calibration_are_told() {
    let poses = poses(6);
    let checked = |count: usize, times: f64, beside: usize| {
        checked(&poses[..count], &sensor(), |truth, _| {
            Grid::from_fn(640, 480, |x, y| {
                times as f32 * f32::from(truth[((x + beside).min(639), y)])
            })
        })
    };
    let sound = checked(1, 1.0, 0);
    assert!(!sound.is_other(), "{sound:?}");
    let too_few = TooFewBoards {
        found: 1,
        needed: 5,
    };
    assert_eq!(sound.too_few_for_misfit, Some(too_few));
    let sound = checked(6, 1.0, 0);
    assert!(!sound.is_other() && sound.shows_registration());
    let deep = checked(1, 1.03, 0);
    let expected = 0.03 * (deep.worst.distance - sensor().intercept);
    assert!(
        deep.is_off && (deep.worst.off - expected).abs() < 1e-3,
        "{deep:?}"
    );
    let beside = checked(6, 1.0, 6);
    let [x, y] = beside.beside_px().unwrap();
    assert!((x - 6.0).abs() < 1.5 && y.abs() < 1.5, "{x} {y}");
    assert!(beside.is_other());
    let nothing = Grid::filled(640, 480, 0.0);
    let view = PlaneView {
        placement: "p7",
        camera_from_face: poses[0],
        readings: &nothing,
    };
    let plane = PlaneParameters::default();
    let tolerance = tolerance(&plane);
    let reason = check_depth(&lens(), &board(), &[view], &sensor(), tolerance).unwrap_err();
    assert!(reason.contains("p7: 0 of"), "{reason}");
}

#[test]
fn boards_outside_the_calibrated_distances_check_nothing() {
    let poses = [0.6, 1.0].map(|z| Isometry3::translation(-0.1, -0.06, z));
    let response = DepthResponse {
        range: Some([0.8, 1.6]),
        ..sensor()
    };
    // It reads 30 mm too deep where it was not calibrated.
    let wrong = |truth: &Grid<u16>, k: usize| {
        let off = if k == 0 { 0.03 / 0.00104 } else { 0.0 };
        truth.map(|&r| f32::from(r) + off as f32)
    };
    let found = checked(&poses, &response, wrong);
    assert!(
        !found.is_off && found.placements.len() == 1,
        "{:?}",
        found.placements
    );
    let readings = wrong(&readings_of(&poses[0]), 0);
    let near = PlaneView {
        placement: "p0",
        camera_from_face: poses[0],
        readings: &readings,
    };
    let plane = PlaneParameters::default();
    let reason = check_depth(&lens(), &board(), &[near], &response, tolerance(&plane));
    let told = "p0: the board lies outside the distances that were calibrated, 0.80 to 1.60 m";
    assert_eq!(reason.unwrap_err(), told);
}

#[test]
fn boards_that_would_not_show_displaced_depth_do_not_check_it() {
    let shows = |poses: &[Isometry3<f64>]| {
        let sound = checked(poses, &sensor(), |truth, _| truth.map(|&r| f32::from(r)));
        assert!(
            !sound.is_other() && sound.too_few_for_misfit.is_none(),
            "{sound:?}"
        );
        sound.shows_registration()
    };
    for count in [6, 7] {
        assert!(shows(&poses(count)), "{count}");
    }
    let turned = |tilt: Vector3<f64>, at: [f64; 3]| {
        let middle = Isometry3::new(Vector3::from(at), tilt);
        middle * Isometry3::translation(-0.1, -0.0625, 0.0)
    };
    let squarely = (0..5).map(|k| turned(Vector3::zeros(), [0.0, 0.0, 0.7 + 0.1 * f64::from(k)]));
    assert!(!shows(&squarely.collect::<Vec<_>>()));
    let table = Isometry3::new(Vector3::new(0.0, 0.0, 1.0), Vector3::x() * 0.6);
    let places = [
        [0.0, 0.0],
        [0.1, 0.06],
        [-0.1, 0.06],
        [0.1, -0.06],
        [-0.1, -0.06],
    ];
    let flat = places.map(|[x, y]| table * Isometry3::translation(x - 0.1, y - 0.0625, 0.0));
    assert!(!shows(&flat));
    // Tilted about x alone, they do not show a displacement in x.
    let alike = (0..5).map(|k| {
        let k = f64::from(k);
        turned(Vector3::x() * (0.2 * k - 0.4), [0.0, 0.0, 0.7 + 0.1 * k])
    });
    assert!(!shows(&alike.collect::<Vec<_>>()));
}

#[test]
fn each_board_is_held_against_what_is_allowed_at_its_distance() {
    let mut poses = poses(2);
    for (pose, z) in poses.iter_mut().zip([0.6, 1.0]) {
        *pose = Isometry3::translation(-0.1, -0.06, z);
    }
    // In thousandths of a metre at slope 0.00104: 4 mm at 0.6 m are more at 1 m than 8 mm at 1 m.
    let off = checked(&poses, &sensor(), |truth, k| {
        truth.map(|&r| f32::from(r) + [0.004, 0.008][k] / 0.00104)
    });
    assert!(off.is_off, "{off:?}");
    assert!((off.worst.distance - 1.0).abs() < 0.02, "{off:?}");
    assert!((off.worst.off - 0.008).abs() < 5e-4, "{off:?}");
}

#[test]
fn depth_is_said_to_be_displaced_only_where_nothing_else_would_explain_it() {
    let poses = poses(7);
    let lens = lens();
    let bowl = |bowl: f64, response: &DepthResponse| {
        checked(&poses, response, |truth, _| {
            Grid::from_fn(640, 480, |x, y| {
                let n = lens.unproject(Point2::new(x as f64, y as f64)).unwrap();
                let z = sensor().slope * f64::from(truth[(x, y)]) + sensor().intercept;
                let wrong = z + bowl * z * z * (n.x * n.x + n.y * n.y);
                ((wrong - sensor().intercept) / sensor().slope) as f32
            })
        })
    };
    let strong = bowl(0.06, &sensor());
    assert_eq!(strong.beside_px(), None, "{strong:?}");
    let misfit = strong.misfit.as_ref().unwrap();
    assert!(matches!(misfit.causes[0], Cause::Bowl(_)), "{strong:?}");
    // What the calibration itself left is no change.
    let known = DepthResponse {
        uncertainty: misfit.held_out,
        ..sensor()
    };
    assert_eq!(bowl(0.06, &known).misfit, None);
}

#[test]
fn a_response_that_the_boards_contradict_is_told_with_its_bias() {
    let poses = poses(9);
    let truth = DepthResponse {
        range: Some([0.7, 1.3]),
        ..DepthResponse::default()
    };
    let found = |response: DepthResponse, moved: f64, count: usize| {
        let readings = poses[..count].iter().enumerate().map(|(k, pose)| {
            let by = if k == 4 { moved } else { 0.0 };
            let pose = Translation3::new(0.0, 0.0, by) * pose;
            mean_readings(&[readings(&pose, &truth, no_pattern)]).unwrap()
        });
        let readings: Vec<Grid<f32>> = readings.collect();
        let views = poses
            .iter()
            .zip(&readings)
            .map(|(pose, readings)| PlaneView {
                placement: "p",
                camera_from_face: *pose,
                readings,
            });
        let views: Vec<PlaneView<'_>> = views.collect();
        let plane = PlaneParameters::default();
        bias_on_boards(&lens(), &board(), &views, &response, &plane)
    };
    let worst = |found: &BoardsBias| found.bias.iter().map(|b| b.bias.abs()).fold(0.0, f64::max);
    // Distances that were measured from 40 mm before the optical centre, as a table may have them.
    let taped = DepthResponse {
        intercept: -0.04,
        ..truth
    };
    for count in [1, 9] {
        let right = found(truth, 0.0, count);
        assert!(worst(&right) < 5e-4 && right.read == count, "{right:?}");
        let wrong = found(taped, 0.0, count);
        assert!((worst(&wrong) - 0.04).abs() < 5e-4, "{wrong:?}");
    }
    // A board that moved says nothing of the response.
    let moved = found(truth, 0.012, 9);
    assert!(
        worst(&moved) < 2e-3 && moved.left_out.len() == 1,
        "{moved:?}"
    );
    let near = DepthResponse {
        range: Some([0.3, 0.4]),
        ..truth
    };
    assert_eq!(found(near, 0.0, 9).bias, []);
}
