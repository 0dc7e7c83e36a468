//! Tests the check of a calibrated rig, and the measurements that confirm or contradict its scale.

use super::synthetic::{Random, Truth, color_lens, looking, placements, rig as whole_rig, upright};
use super::*;
use crate::calibration::{Board, BoardShape, CalibrationLevel, Camera, Face, RigCalibration};
use nalgebra::{Isometry3, Point3, Vector3};
use std::collections::BTreeMap;

/// `cameras` cameras around a board with squares of 25 mm that is shown `shown` times.
fn rig(cameras: usize, shown: usize) -> Truth {
    let board = Board::checkerboard(9, 6, 0.025).unwrap();
    let at = Point3::new(0.0, 0.0, 0.1);
    let camera = |i: usize| {
        let from = Point3::new(0.25 * i as f64 - 0.3, -0.3 - 0.1 * (i % 2) as f64, 0.75);
        looking(&format!("c{i:02}"), color_lens(), from, at)
    };
    let placements = placements(&board, shown, &mut Random(1));
    Truth::new(board, (0..cameras).map(camera).collect(), placements)
}

fn calibration(truth: &Truth) -> RigCalibration {
    let entry = |c: &Camera| (c.id.clone(), (c.clone(), None));
    RigCalibration {
        cameras: truth.cameras.iter().map(entry).collect(),
        ..RigCalibration::default()
    }
}

/// The rig with a camera turned.
fn turned(mut truth: Truth, camera: usize, axis: Vector3<f64>, degrees: f64) -> Truth {
    let turn = Isometry3::rotation(axis.normalize() * degrees.to_radians());
    let before = &truth.cameras[camera];
    let pose = before.rig_from_camera * turn;
    truth.cameras[camera] = Camera::new(before.id.clone(), before.intrinsics, pose);
    truth
}

#[test]
fn two_cameras_that_moved_against_each_other_are_told_so() {
    for shown in [1, 4] {
        let known = calibration(&rig(2, shown));
        let still = rig(2, shown).session(0.1, &mut Random(3));
        let checks = check(
            &still,
            &known,
            &DriftLimits::default(),
            &Parameters::default(),
        )
        .unwrap();
        assert_eq!(checks.against_each_other, None);
        let moved = turned(rig(2, shown), 1, Vector3::new(1.0, 0.2, 0.4), 0.3);
        let session = moved.session(0.1, &mut Random(3));
        let checks = check(
            &session,
            &known,
            &DriftLimits::default(),
            &Parameters::default(),
        )
        .unwrap();
        let pair = checks.against_each_other.unwrap();
        assert_eq!(
            pair.cameras.each_ref().map(CameraId::as_str),
            ["c00", "c01"]
        );
        assert!(
            (pair.motion.turn_degrees - 0.3).abs() < 0.05,
            "{shown}: {pair:?}"
        );
        assert_eq!(pair.board_larger, None, "{pair:?}");
    }
}

#[test]
fn two_cameras_with_noisy_pictures_moved_only_if_a_motion_explains_what_is_left() {
    let (limits, parameters) = (DriftLimits::default(), Parameters::default());
    for shown in [1, 4] {
        let known = calibration(&rig(2, shown));
        // 0.33 px in each of two coordinates are 0.47 px.
        let session = |truth: Truth| truth.session(0.33, &mut Random(3));
        let still = check(&session(rig(2, shown)), &known, &limits, &parameters).unwrap();
        let off_px = still.cameras.iter().map(|c| c.off_px).fold(0.0, f64::max);
        assert!(off_px > limits.moved_px, "{shown}: {off_px}");
        assert_eq!(still.against_each_other, None, "{shown}");
        let moved = turned(rig(2, shown), 1, Vector3::new(1.0, 0.2, 0.4), 0.3);
        let moved = check(&session(moved), &known, &limits, &parameters).unwrap();
        let pair = moved.against_each_other.unwrap();
        assert!(
            (pair.motion.turn_degrees - 0.3).abs() < 0.1,
            "{shown}: {pair:?}"
        );
    }
}

#[test]
fn a_board_of_another_size_is_told_from_cameras_that_moved() {
    let truth = rig(4, 1);
    let known = calibration(&truth);
    let mut session = truth.session(0.1, &mut Random(3));
    session.board.square = 0.024;
    let error = check(
        &session,
        &known,
        &DriftLimits::default(),
        &Parameters::default(),
    )
    .unwrap_err();
    let words = error.to_string();
    assert!(
        words.contains("the board looks 4.2 % larger than checkerboard:9x6:24mm"),
        "{words}"
    );
    session.board.square = 0.026;
    let words = check(
        &session,
        &known,
        &DriftLimits::default(),
        &Parameters::default(),
    )
    .unwrap_err()
    .to_string();
    assert!(
        words.contains("the board looks 3.8 % smaller than"),
        "{words}"
    );
    // Of two cameras it may be that they moved.
    let truth = rig(2, 1);
    let mut session = truth.session(0.1, &mut Random(3));
    session.board.square = 0.024;
    let known = calibration(&truth);
    let checks = check(
        &session,
        &known,
        &DriftLimits::default(),
        &Parameters::default(),
    )
    .unwrap();
    let larger = checks.against_each_other.unwrap().board_larger.unwrap();
    assert!((larger - 1.0 / 24.0).abs() < 0.002, "{larger}");
}

#[test]
fn two_cameras_that_are_exchanged_are_told_from_cameras_that_moved() {
    for (cameras, shown, [a, b]) in [
        (2, 1, [0, 1]),
        (2, 4, [0, 1]),
        (4, 1, [1, 2]),
        (6, 3, [0, 4]),
    ] {
        let truth = rig(cameras, shown);
        let known = calibration(&truth);
        let mut session = truth.session(0.1, &mut Random(3));
        for view in &mut session.views {
            view.camera = match view.camera {
                c if c == a => b,
                c if c == b => a,
                c => c,
            };
        }
        let (limits, parameters) = (DriftLimits::default(), Parameters::default());
        let words = check(&session, &known, &limits, &parameters)
            .unwrap_err()
            .to_string();
        let told = format!("cameras c{a:02} and c{b:02} are exchanged: ");
        assert!(words.starts_with(&told), "{words}");
    }
}

#[test]
fn a_camera_that_nobody_shared_a_placement_with_is_not_said_to_have_stayed() {
    let truth = rig(3, 2);
    let known = calibration(&truth);
    let mut session = truth.session(0.1, &mut Random(3));
    // The first two cameras share a placement, and the third one sees another.
    session
        .views
        .retain(|v| (v.camera == 2) == (v.placement == 1));
    let limits = DriftLimits::default();
    let checks = check(&session, &known, &limits, &Parameters::default()).unwrap();
    let alone: Vec<&str> = checks.alone.iter().map(CameraId::as_str).collect();
    assert_eq!(alone, ["c02"]);
    assert!(checks.rig_from_board.iter().all(Option::is_some));
    // Also where it is the only one: its own picture says where the board is.
    session.views.retain(|v| v.camera == 2);
    let checks = check(&session, &known, &limits, &Parameters::default()).unwrap();
    assert_eq!(checks.alone.len(), 1, "{checks:?}");
    assert!(checks.cameras.iter().all(|c| c.motion.is_none()));
    assert_eq!(checks.rig_from_board[0], None);
    let seen = checks.rig_from_board[1].unwrap();
    let off = seen.translation.vector - truth.placements[1].translation.vector;
    assert!(off.norm() < 2e-3, "{off}");
    // And where nobody saw it.
    session.views.clear();
    let checks = check(&session, &known, &limits, &Parameters::default()).unwrap();
    assert!(checks.alone.is_empty() && checks.against_each_other.is_none());
}

/// Eleven cameras in a ring around a board with two sides, which stands upright, so that some see its front and some
/// its back. The sides do not lie exactly behind each other.
fn two_sided(shown: usize) -> Truth {
    let board = Board::charuco(11, 8, 0.02, true).unwrap();
    Truth::new(board, whole_rig(), upright(&board, shown))
}

#[test]
fn a_board_whose_sides_lie_askew_moved_no_camera() {
    let (limits, parameters) = (DriftLimits::default(), Parameters::default());
    for shown in [1, 3] {
        let truth = two_sided(shown);
        let known = calibration(&truth);
        let still = truth.session(0.1, &mut Random(3));
        let checks = check(&still, &known, &limits, &parameters).unwrap();
        let moved = checks.cameras.iter().filter(|c| c.motion.is_some());
        assert_eq!(moved.count(), 0, "{shown}: {checks:?}");
        assert!(checks.alone.is_empty(), "{shown}: {checks:?}");
        let off = checks.front_from_back.inverse() * truth.front_from_back;
        assert!(off.translation.vector.norm() < 4e-4, "{shown}: {off}");
    }
    // A camera that moved is found all the same.
    let truth = two_sided(3);
    let known = calibration(&truth);
    let moved = turned(truth, 3, Vector3::new(1.0, 0.2, 0.4), 0.1);
    let session = moved.session(0.1, &mut Random(3));
    let checks = check(&session, &known, &limits, &parameters).unwrap();
    let named = checks.cameras.iter().filter(|c| c.motion.is_some());
    let named: Vec<&str> = named.map(|c| c.camera.as_str()).collect();
    assert_eq!(named, ["c03"]);
}

#[test]
fn a_camera_that_alone_tells_where_the_back_lies_is_not_said_to_have_stayed() {
    let (limits, parameters) = (DriftLimits::default(), Parameters::default());
    let truth = two_sided(2);
    let known = calibration(&truth);
    let session = truth.session(0.1, &mut Random(3));
    let of_back = |v: &&View| v.placement == 0 && v.face == Face::Back;
    let lone = session.views.iter().find(of_back).unwrap().camera;
    let moved = turned(truth, lone, Vector3::new(1.0, 0.2, 0.4), 0.3);
    let mut session = moved.session(0.1, &mut Random(3));
    let is_kept = |v: &View| v.face == Face::Front || v.camera == lone;
    session.views.retain(|v| v.placement == 0 && is_kept(v));
    let checks = check(&session, &known, &limits, &parameters).unwrap();
    let alone: Vec<&CameraId> = checks.alone.iter().collect();
    assert_eq!(alone, [&session.cameras[lone].id]);
    assert!(checks.cameras.iter().all(|c| c.motion.is_none()));
    // Where others tell where the back lies, it is compared.
    let mut session = moved.session(0.1, &mut Random(3));
    session.views.retain(|v| v.placement == 1 || is_kept(v));
    let checks = check(&session, &known, &limits, &parameters).unwrap();
    assert!(checks.alone.is_empty(), "{checks:?}");
    let named = checks.cameras.iter().filter(|c| c.motion.is_some());
    let named: Vec<&CameraId> = named.map(|c| &c.camera).collect();
    assert_eq!(named, [&session.cameras[lone].id]);
}

#[test]
fn a_bent_board_does_not_hide_a_camera_that_moved() {
    let mut truth = rig(4, 1);
    let known = calibration(&truth);
    truth.shape = BoardShape::of_terms([1.5e-3, 0.0, 0.0]);
    let limits = DriftLimits::default();
    let off = |truth: &Truth, parameters: &Parameters| {
        let session = truth.session(0.1, &mut Random(3));
        let checks = check(&session, &known, &limits, parameters)?;
        let moved = checks.cameras.iter().filter(|c| c.motion.is_some());
        let moved: Vec<String> = moved.map(|c| c.camera.to_string()).collect();
        let most = checks.cameras.iter().map(|c| c.off_px).fold(0.0, f64::max);
        Ok::<_, CheckError>((moved, most))
    };
    let may_be_bent = Parameters::default();
    let (moved, most) = off(&truth, &may_be_bent).unwrap();
    assert!(moved.is_empty() && most < 0.3, "{moved:?} {most}");
    // A board that is taken for flat leaves more in all cameras, among which a motion is lost.
    let flat = Parameters {
        bend_expected_mm: 1e-6,
        stretch_expected_percent: 1e-6,
        ..Parameters::default()
    };
    let of_flat = off(&truth, &flat);
    let is_as_good = of_flat
        .as_ref()
        .is_ok_and(|(_, of_flat)| *of_flat < 2.0 * most);
    assert!(!is_as_good, "{of_flat:?} {most}");
    let turned = turned(truth, 2, Vector3::new(1.0, 0.2, 0.4), 0.025);
    let (moved, _) = off(&turned, &may_be_bent).unwrap();
    assert_eq!(moved, ["c02"]);
}

/// What a check says of a rig of `cameras` cameras, some of them turned by this many degrees, and a board that is
/// described with squares of `square` millimetres: the cameras that it names, or why it names none.
fn checked(
    cameras: usize,
    turned_cameras: &[usize],
    degrees: f64,
    square: f64,
) -> Result<Vec<String>, CheckError> {
    let truth = rig(cameras, 6);
    let known = calibration(&truth);
    let turn = |truth, &camera: &usize| {
        let to = 2.4 * camera as f64;
        turned(
            truth,
            camera,
            Vector3::new(to.cos(), to.sin(), 0.3),
            degrees,
        )
    };
    let truth = turned_cameras.iter().fold(truth, turn);
    let mut session = truth.session(0.05, &mut Random(3));
    session.board.square = 1e-3 * square;
    let (limits, parameters) = (DriftLimits::default(), Parameters::default());
    let checks = check(&session, &known, &limits, &parameters)?;
    for camera in &checks.cameras {
        let is_near = camera.off_px <= limits.moved_px;
        assert!(is_near || camera.motion.is_some(), "{camera:?}");
    }
    let moved = checks.cameras.iter().filter(|c| c.motion.is_some());
    Ok(moved.map(|c| c.camera.to_string()).collect())
}

#[test]
fn a_camera_that_draws_the_board_with_it_is_found() {
    for degrees in [0.05, 0.1] {
        for camera in 0..3 {
            let moved = checked(3, &[camera], degrees, 25.0).unwrap();
            assert_eq!(moved, [format!("c{camera:02}")], "{degrees}");
        }
        for two in [[0, 1], [2, 4], [1, 3]] {
            let moved = checked(5, &two, degrees, 25.0).unwrap();
            assert_eq!(
                moved,
                two.map(|camera| format!("c{camera:02}")),
                "{degrees}"
            );
        }
    }
    for cameras in [3, 5] {
        assert!(checked(cameras, &[], 0.0, 25.0).unwrap().is_empty());
    }
}

#[test]
fn if_most_cameras_moved_none_is_named() {
    for moved in [&[0, 1, 2, 3][..], &[0, 1, 2, 3, 4]] {
        let error = checked(5, moved, 0.05, 25.0).unwrap_err();
        assert!(
            matches!(error, CheckError::Disagree { seen: 5, .. }),
            "{error}"
        );
        let words = error.to_string();
        assert!(
            words.contains("it cannot be told which of them moved") && !words.contains("c0"),
            "{words}"
        );
    }
}

#[test]
fn a_board_that_is_a_little_larger_is_told_before_cameras_are_blamed() {
    for (square, told) in [
        (24.7, "1.2 % larger"),
        (24.8, "0.8 % larger"),
        (25.3, "1.2 % smaller"),
    ] {
        for cameras in [3, 5] {
            let words = checked(cameras, &[], 0.0, square).unwrap_err().to_string();
            assert!(words.contains(told), "{square} {cameras}: {words}");
        }
    }
}

#[test]
fn a_camera_whose_pictures_are_mirrored_is_named_alone() {
    for (cameras, shown, camera) in [(3, 6, 1), (5, 1, 3), (5, 6, 0), (2, 4, 1)] {
        let truth = rig(cameras, shown);
        let mut session = truth.session(0.1, &mut Random(3));
        let (board, width) = (session.board, session.cameras[camera].size[0]);
        let own = session.views.iter_mut().filter(|v| v.camera == camera);
        own.for_each(|view| *view = view.mirrored(&board, width));
        let (limits, parameters) = (DriftLimits::default(), Parameters::default());
        let error = check(&session, &calibration(&truth), &limits, &parameters).unwrap_err();
        let told = format!("c{camera:02}");
        assert_eq!(error, CheckError::Mirrored { camera: told });
    }
}

/// The witnesses' readings of a rig whose board is described with squares of this size, and the verdict.
fn testified(
    square: f64,
    slope: Option<f64>,
    measured: &MeasuredLengths,
) -> (Vec<WitnessReading>, Judgement) {
    let mut session = rig(3, 12).session(0.1, &mut Random(7));
    session.board.square = square;
    let parameters = Parameters {
        folds: 0,
        ..Parameters::default()
    };
    let fit = fit(&session, &parameters).unwrap();
    let slope = slope.map(|value| {
        let deviation = 1e-6;
        (CameraId::new("kinect").unwrap(), Slope { value, deviation })
    });
    let slopes = slope.into_iter().collect();
    let found = witnesses(&fit, &slopes, measured, &ScaleWitnessLimits::default());
    let judgement = judge(&fit, &[], &BTreeMap::new(), &Limits::default());
    (found.clone(), judgement.with_witnesses(&found))
}

#[test]
fn a_difference_that_is_allowed_is_no_larger_than_what_is_said_to_be_allowed() {
    for (metres, deviation) in [(0.5, 0.001), (0.5, 0.015), (0.48, 0.015), (0.496, 0.0001)] {
        let (found, _) = testified(0.024, None, &distance(metres, deviation));
        let WitnessReading { off, allowed, .. } = found[0];
        let words = &found[0].words;
        assert_eq!(found[0].contradicts, off.abs() > allowed, "{words}");
        if !found[0].contradicts {
            let said = format!("within the allowed ±{:.2} %", 100.0 * allowed);
            assert!(words.ends_with(&said), "{said}: {words}");
        }
    }
}

fn distance(metres: f64, deviation: f64) -> MeasuredLengths {
    let camera = |name| CameraId::new(name).unwrap();
    MeasuredLengths {
        distances: vec![CameraDistance {
            cameras: [camera("c00"), camera("c02")],
            measured: Length { metres, deviation },
        }],
        rulers: Vec::new(),
    }
}

#[test]
fn a_board_of_a_wrong_size_is_contradicted_by_a_distance_with_both_explanations() {
    // c00 and c02 are 500 mm apart.
    let (found, judgement) = testified(0.025, None, &distance(0.5, 0.001));
    assert!(
        !found[0].contradicts && judgement.level < CalibrationLevel::Doubtful,
        "{found:?}"
    );
    let (found, judgement) = testified(0.024, None, &distance(0.5, 0.001));
    assert_eq!(judgement.level, CalibrationLevel::Doubtful);
    let words = &found[0].words;
    for part in [
        "cameras c00 and c02 are 480",
        "measured: 500 mm ±1 mm",
        "either the board's squares have 25",
        "not 24 mm",
        "or the distance was measured wrongly",
    ] {
        assert!(words.contains(part), "{part}: {words}");
    }
    assert!(judgement.reasons.iter().any(|r| &r.words == words));
    // A tape measure that is no better than this board is wrong says nothing, and says so.
    let (found, _) = testified(0.024, None, &distance(0.5, 0.015));
    assert!(
        !found[0].contradicts && found[0].words.contains("within the allowed"),
        "{found:?}"
    );
}

#[test]
fn a_depth_cameras_slope_contradicts_a_wrong_board_and_its_own_scale() {
    let none = MeasuredLengths::default();
    for (slope, contradicts) in [
        (0.00096, true),
        (0.00097, true),
        (0.00103, true),
        (0.00104, true),
        (0.000985, false),
        (0.00101, false),
    ] {
        let (found, judgement) = testified(0.025, Some(slope), &none);
        assert_eq!(found[0].contradicts, contradicts, "{slope}: {found:?}");
        assert_eq!(
            judgement.level >= CalibrationLevel::Doubtful,
            contradicts,
            "{slope}"
        );
    }
    let (found, _) = testified(0.024, Some(0.00096), &none);
    let words = &found[0].words;
    for part in [
        "0.000960",
        "0.001 ±1.0 %",
        "squares have 25 mm and not 24 mm",
        "reads 4.2 % too deep",
    ] {
        assert!(words.contains(part), "{part}: {words}");
    }
    // Of a sensor that counts tenths of millimetres nothing is known.
    assert!(testified(0.025, Some(0.0001), &none).0.is_empty());
}

#[test]
fn a_ruler_tells_a_print_that_is_not_true_to_scale() {
    let reading = |measured: f64| MeasuredLengths {
        rulers: vec![RulerReading {
            printed: 0.2,
            measured: Length {
                metres: measured,
                deviation: 0.0005,
            },
        }],
        distances: Vec::new(),
    };
    let (found, judgement) = testified(0.025, None, &reading(0.1992));
    assert!(judgement.level < CalibrationLevel::Doubtful);
    assert!(found[0].words.contains("would have 24.9 mm"), "{found:?}");
    let (found, judgement) = testified(0.025, None, &reading(0.194));
    assert_eq!(judgement.level, CalibrationLevel::Doubtful);
    assert!(found[0].words.contains("have 24.25 mm"), "{found:?}");
}

#[test]
fn without_a_witness_nothing_but_the_board_is_said_to_set_the_scale() {
    let board = Board::checkerboard(9, 6, 0.025).unwrap();
    let words = scale_words(&[], &board);
    assert!(
        words[0].contains("nothing but the board's size (25 mm a square)"),
        "{words:?}"
    );
    // A board of a wrong size is not seen.
    let (found, judgement) = testified(0.024, None, &MeasuredLengths::default());
    assert!(
        found.is_empty() && judgement.level < CalibrationLevel::Doubtful,
        "{found:?} {judgement:?}"
    );
}
