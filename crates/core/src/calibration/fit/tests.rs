//! Tests fits of sessions whose truth is known.

use super::synthetic::{
    Random, Truth, apart, color_lens, looking, placed, placements, rig, upright,
};
use super::*;
use crate::calibration::{Board, BoardShape, CalibrationLevel, Distortion, Face, Intrinsics};
use nalgebra::{Point2, Point3, Vector2, Vector3};
use std::collections::BTreeMap;

fn checkerboard() -> Board {
    Board::checkerboard(11, 8, 0.025).unwrap()
}

fn truth(board: Board, count: usize, seed: u64) -> Truth {
    let placements = placements(&board, count, &mut Random(seed));
    Truth::new(board, rig(), placements)
}

/// Mean and largest distance, in pixels, of points of the volume from where they truly are seen by each camera, once
/// they are triangulated from what the other cameras truly see.
fn prediction(truth: &Truth, fit: &Fit) -> (f64, f64) {
    let mut all = Vec::new();
    let mut random = Random(99);
    for _ in 0..60 {
        let p = Point3::new(
            random.between(-0.1, 0.1),
            random.between(-0.1, 0.1),
            random.between(0.0, 0.2),
        );
        let seen: Vec<_> = truth
            .cameras
            .iter()
            .map(|c| c.project(p).unwrap().0)
            .collect();
        for left_out in 0..truth.cameras.len() {
            let (mut a, mut b) = (nalgebra::Matrix3::zeros(), Vector3::zeros());
            for (i, camera) in fit
                .cameras
                .iter()
                .enumerate()
                .filter(|(i, _)| *i != left_out)
            {
                let ray = camera.camera.ray(seen[i]).unwrap();
                let weight = (camera.camera.intrinsics.focal_px.x
                    / (camera.camera.center() - p).norm())
                .powi(2);
                let across = (nalgebra::Matrix3::identity() - ray * ray.transpose()) * weight;
                a += across;
                b += across * camera.camera.center().coords;
            }
            let found = Point3::from(a.try_inverse().unwrap() * b);
            let (pixel, _) = fit.cameras[left_out].camera.project(found).unwrap();
            all.push(apart(pixel, seen[left_out]));
        }
    }
    (
        all.iter().sum::<f64>() / all.len() as f64,
        all.iter().copied().fold(0.0, f64::max),
    )
}

/// Errors of a fitted rig over their stated standard deviations: of fx, fy, cx, cy and the centres' coordinates, in the
/// frame of the table's placement.
fn normalized_errors(truth: &Truth, fit: &Fit) -> Vec<f64> {
    let table = fit
        .placements
        .iter()
        .position(|p| p.name == fit.table)
        .unwrap();
    let fit_from_truth = truth.fit_from_truth(table);
    let mut all = Vec::new();
    for (found, true_one) in fit.cameras.iter().zip(&truth.cameras) {
        let (a, b, u) = (
            found.camera.intrinsics,
            true_one.intrinsics,
            found.uncertainty,
        );
        let center = fit_from_truth * true_one.center() - found.camera.center();
        for i in 0..2 {
            all.push((a.focal_px[i] - b.focal_px[i]) / u.focal_px[i]);
            all.push((a.center_px[i] - b.center_px[i]) / u.center_px[i]);
        }
        all.extend((0..3).map(|i| center[i] / u.position[i]));
    }
    all
}

#[test]
fn a_rig_of_twelve_cameras_is_found_again() {
    let truth = truth(checkerboard(), 20, 1);
    let session = truth.session(0.1, &mut Random(7));
    let fit = fit(&session, &Parameters::default()).unwrap();
    assert_eq!(
        (fit.cameras.len(), fit.table.as_str(), fit.table_is_lowest),
        (12, "p00", true)
    );
    assert!(fit.left_out.is_empty(), "{:?}", fit.left_out);
    // 0.1 px in each of two coordinates.
    assert!(
        (fit.figures.rms_px - 0.1414).abs() < 0.003,
        "{:?}",
        fit.figures
    );
    assert!(fit.held_out.unwrap().ratio < 1.05, "{:?}", fit.held_out);
    for (found, true_one) in fit.cameras.iter().zip(&truth.cameras) {
        let ratio = found
            .camera
            .intrinsics
            .focal_px
            .component_div(&true_one.intrinsics.focal_px);
        assert!(
            ratio.iter().all(|r| (r - 1.0).abs() < 5e-4),
            "{}: {ratio}",
            true_one.id
        );
    }
    let (mean, worst) = prediction(&truth, &fit);
    assert!(mean < 0.02 && worst < 0.06, "{mean} {worst}");
    let errors = normalized_errors(&truth, &fit);
    let rms = (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt();
    let largest = errors.iter().fold(0.0, |m: f64, e| m.max(e.abs()));
    assert!(
        (0.6..1.4).contains(&rms) && largest < 4.5,
        "{rms} {largest}"
    );
}

/// A session with a change, its fit, and how the cameras' predictions are then.
fn fitted(truth: &Truth, change: impl FnOnce(&mut Session)) -> Result<Fit, Error> {
    let mut session = truth.session(0.1, &mut Random(7));
    change(&mut session);
    let parameters = Parameters {
        folds: 0,
        ..Parameters::default()
    };
    fit(&session, &parameters)
}

/// The terms of a board's shape, as a fit with this many of the rig's cameras finds them; it holds that they are no
/// farther from the truth than is stated, and that focal lengths are right.
fn shape_found(board: Board, cameras: usize, terms: [f64; 3]) -> FittedShape {
    let mut bent = truth(board, 20, 1);
    bent.cameras.truncate(cameras);
    bent.shape = BoardShape::of_terms(terms);
    let session = bent.session(0.1, &mut Random(7));
    let found = fit(&session, &Parameters::default()).unwrap();
    for (term, true_one) in found.shape.terms().iter().zip(terms) {
        let off = (term.value - true_one).abs();
        assert!(off < 3.5 * term.deviation, "{terms:?}: {:?}", found.shape);
    }
    for (found, true_one) in found.cameras.iter().zip(&bent.cameras) {
        let focal = found.camera.intrinsics.focal_px;
        let ratio = focal.component_div(&true_one.intrinsics.focal_px);
        assert!(ratio.iter().all(|r| (r - 1.0).abs() < 1e-3), "{ratio}");
    }
    found.shape
}

#[test]
fn a_bent_or_stretched_board_is_found_and_a_flat_one_stays_flat() {
    let fates = |terms| {
        shape_found(checkerboard(), 2, terms)
            .terms()
            .map(|t| t.fate)
    };
    let (kept, not_needed) = (TermStatus::Kept, TermStatus::NotNeeded);
    assert_eq!(fates([0.0; 3]), [not_needed; 3]);
    assert_eq!(fates([5e-4, 0.0, 0.0]), [kept, not_needed, not_needed]);
    assert_eq!(fates([3e-4, -2e-4, 5e-4]), [kept; 3]);
    let flat = shape_found(checkerboard(), 2, [0.0; 3]);
    assert_eq!(flat.shape(), BoardShape::default());
    // What it may be all the same is far less than what is expected of any board.
    assert!(flat.depth_deviation() < 5e-5, "{flat:?}");
}

#[test]
fn of_a_board_that_looks_the_same_after_a_quarter_turn_the_bend_is_found_that_is_alike() {
    let board = Board::checkerboard(8, 8, 0.025).unwrap();
    let (kept, not_needed) = (TermStatus::Kept, TermStatus::NotNeeded);
    let flat = shape_found(board, 2, [0.0; 3]);
    assert_eq!(flat.terms().map(|t| t.fate), [not_needed; 3]);
    assert_eq!(flat.bends_differ, Some(not_needed));
    let bowl = shape_found(board, 2, [5e-4, 5e-4, 0.0]);
    assert_eq!(bowl.terms().map(|t| t.fate), [kept, kept, not_needed]);
    assert_eq!(bowl.bends_differ, Some(not_needed));
    // A bend along the rows alone is not known as such, and is not passed over.
    let mut rolled = truth(board, 20, 1);
    rolled.cameras.truncate(2);
    rolled.shape = BoardShape::of_terms([5e-4, 0.0, 0.0]);
    let fit = fit(&rolled.session(0.1, &mut Random(7)), &Parameters::default()).unwrap();
    let differ = fit.shape.bends_differ;
    assert_eq!(differ, Some(TermStatus::NotHeld), "{:?}", fit.shape);
}

#[test]
fn a_two_sided_board_is_bent_the_other_way_on_its_back() {
    let board = Board::charuco(11, 8, 0.025, true).unwrap();
    let found = shape_found(board, 6, [4e-4, 0.0, 0.0]);
    assert_eq!(found.bend[0].fate, TermStatus::Kept, "{found:?}");
}

fn predicts_well(truth: &Truth, fit: &Fit) {
    let (mean, worst) = prediction(truth, fit);
    assert!(mean < 0.05 && worst < 0.2, "{mean} {worst}");
}

#[test]
fn a_two_sided_board_is_better_and_its_back_is_found() {
    let board = Board::charuco(11, 8, 0.025, true).unwrap();
    let two_sided = truth(board, 20, 1);
    let found = fitted(&two_sided, |_| {}).unwrap();
    let off = found.front_from_back.inverse() * two_sided.front_from_back;
    assert!(
        off.translation.vector.norm() < 2e-5 && off.rotation.angle() < 1e-3,
        "{off}"
    );
    let one_sided = truth(checkerboard(), 20, 1);
    let with_one = prediction(&one_sided, &fitted(&one_sided, |_| {}).unwrap());
    let with_two = prediction(&two_sided, &found);
    assert!(with_two.0 < with_one.0, "{with_two:?} {with_one:?}");
}

#[test]
fn a_back_whose_pose_nothing_tells_any_more_is_where_the_board_has_it() {
    let board = Board::charuco(11, 8, 0.025, true).unwrap();
    let mut truth = truth(board, 14, 1);
    truth.placements.extend(upright(&board, 3));
    let mut session = truth.session(0.1, &mut Random(7));
    let is_of_back = |v: &View| v.face == Face::Back;
    let mut views = session.views.iter();
    let lone = views.find(|v| v.placement == 14 && is_of_back(v));
    let lone = lone.unwrap().camera;
    // One view tells how the sides lie to each other; others show the back alone.
    session.views.retain(|v| match v.placement {
        14 => !is_of_back(v) || v.camera == lone,
        15.. => is_of_back(v),
        _ => !is_of_back(v),
    });
    let mut random = Random(5);
    let mut views = session.views.iter_mut();
    let blurred = views.find(|v| v.placement == 14 && is_of_back(v));
    for corner in &mut blurred.unwrap().corners {
        corner.pixel += Vector2::new(random.normal(), random.normal());
    }
    let parameters = Parameters {
        folds: 0,
        ..Parameters::default()
    };
    let fit = fit(&session, &parameters).unwrap();
    let id = &session.cameras[lone].id;
    let is_lone = |l: &LeftOut| l.camera.as_ref() == Some(id) && l.reason.contains("blurred");
    assert!(fit.left_out.iter().any(is_lone), "{:?}", fit.left_out);
    assert_eq!(fit.front_from_back, board.front_from_back());
    let of_back = fit.views.iter().filter(|v| is_of_back(v));
    assert!(of_back.count() >= 4);
    assert!(fit.figures.rms_px < 0.16, "{:?}", fit.figures);
}

#[test]
fn a_board_that_looks_the_same_turned_is_read_alike_by_all() {
    for board in [
        Board::checkerboard(9, 7, 0.025).unwrap(),
        Board::checkerboard(8, 8, 0.025).unwrap(),
    ] {
        let truth = truth(board, 16, 2);
        let readings = session::turns(&board);
        let mut random = Random(3);
        let fit = fitted(&truth, |session| {
            for view in &mut session.views {
                let reading = (random.uniform() * readings.len() as f64) as usize;
                view.turn(&board, readings[reading.min(readings.len() - 1)]);
            }
        })
        .unwrap();
        assert!(fit.left_out.is_empty(), "{:?}", fit.left_out);
        predicts_well(&truth, &fit);
    }
}

/// Only the views of these pairs of cameras and placements.
fn only(session: &mut Session, seen: impl Fn(usize, usize) -> bool) {
    session.views.retain(|v| seen(v.camera, v.placement));
}

#[test]
fn a_chain_of_cameras_is_joined_and_a_broken_one_says_what_would_join_it() {
    let mut truth = truth(checkerboard(), 24, 4);
    truth.cameras = [1, 3, 5].map(|i| truth.cameras[i].clone()).to_vec();
    // The first two share the even placements of the first half, the last two those of the second: never all three.
    let chain = |camera: usize, placement: usize| match camera {
        0 => placement < 12,
        1 => true,
        _ => placement >= 12,
    };
    let fit = fitted(&truth, |session| only(session, chain)).unwrap();
    let of = |camera: usize| fit.views.iter().filter(|v| v.camera == camera).count();
    assert!((0..3).all(|c| of(c) >= 3), "{:?}", [of(0), of(1), of(2)]);
    let (mean, worst) = prediction(&truth, &fit);
    assert!(mean < 0.2 && worst < 0.8, "{mean} {worst}");
    let broken = fitted(&truth, |session| {
        only(session, |c, p| if c == 1 { p < 12 } else { chain(c, p) })
    });
    let Err(error @ Error::Disjoint { .. }) = broken else {
        panic!("{broken:?}")
    };
    let words = error.to_string();
    assert!(words.contains("[c01, c03] and [c05]"), "{words}");
}

#[test]
fn a_camera_that_saw_nothing_is_named_and_the_others_fitted() {
    let truth = truth(checkerboard(), 20, 1);
    let fit = fitted(&truth, |session| session.views.retain(|v| v.camera != 4)).unwrap();
    assert_eq!(fit.cameras.len(), 11);
    let named: Vec<_> = fit
        .left_out
        .iter()
        .filter_map(|l| l.camera.as_ref())
        .collect();
    assert_eq!(named.len(), 1);
    assert_eq!(named[0].as_str(), "c04");
    let judgement = judge(&fit, &[], &BTreeMap::new(), &Limits::default());
    assert!(
        judgement.level >= CalibrationLevel::Doubtful
            && judgement.reasons.iter().any(|r| r.words.contains("c04"))
    );
}

#[test]
fn a_camera_that_read_no_markers_may_have_mirrored_pictures() {
    let board = Board::charuco(9, 6, 0.025, false).unwrap();
    let mut truth = truth(board, 16, 1);
    truth.cameras.truncate(3);
    let fit = fitted(&truth, |session| session.views.retain(|v| v.camera != 1)).unwrap();
    let judgement = judge(&fit, &[], &BTreeMap::new(), &Limits::default());
    let mut reasons = judgement.reasons.iter();
    let is_told = |r: &Reason| r.words.contains("c01") && r.words.contains("mirrored");
    assert!(reasons.any(is_told), "{:?}", judgement.reasons);
}

#[test]
fn a_depth_camera_without_a_response_or_with_a_bias_is_named() {
    let fit = fitted(&truth(checkerboard(), 20, 1), |_| {}).unwrap();
    let judged = |found: Result<[f64; 2], String>| {
        let error = |[seen, at_most]: [f64; 2]| DepthError {
            seen,
            at_most,
            misfit: None,
            boards: LeftOutShare::default(),
            change: None,
        };
        let depths = BTreeMap::from([(CameraId::new("kinect").unwrap(), found.map(error))]);
        judge(&fit, &[], &depths, &Limits::default())
    };
    let fine = judged(Ok([0.0009, 0.0009]));
    assert!(fine.level < CalibrationLevel::Doubtful, "{fine:?}");
    let told = "depth camera kinect: its distances are known only to 2.00 mm, expected 1 or better";
    let unknown = judged(Ok([0.0002, 0.002]));
    assert_eq!(unknown.level, CalibrationLevel::Accepted);
    assert!(
        unknown.reasons.iter().any(|r| r.words == told),
        "{unknown:?}"
    );
    let hardly_known = judged(Ok([0.0002, 0.0031]));
    assert_eq!(hardly_known.level, CalibrationLevel::Doubtful);
    let biased = judged(Ok([0.0012, 0.0015]));
    assert_eq!(biased.level, CalibrationLevel::Doubtful);
    let told = "depth camera kinect: a bias of 1.20 mm is left, expected at most 1";
    assert!(biased.reasons.iter().any(|r| r.words == told), "{biased:?}");
    let told = "depth camera kinect has no response: no boards";
    let without = judged(Err(told.to_owned()));
    assert_eq!(without.level, CalibrationLevel::Doubtful);
    assert!(
        without.reasons.iter().any(|r| r.words == told),
        "{without:?}"
    );
}

#[test]
fn what_the_fit_threw_out_counts_in_the_verdict() {
    let sound = fitted(&truth(checkerboard(), 20, 1), |_| {}).unwrap();
    let id = sound.cameras[3].camera.id.clone();
    let used = sound.cameras[3].views;
    let judged = |of_camera: usize, of_others: usize| {
        let mut fit = sound.clone();
        let other = sound.cameras[4].camera.id.clone();
        let views = [vec![id.clone(); of_camera], vec![other; of_others]].concat();
        fit.left_out.push(LeftOut {
            camera: None,
            placement: Some("p01".to_owned()),
            reason: "it moved".to_owned(),
            views,
            apart: None,
        });
        judge(&fit, &[], &BTreeMap::new(), &Limits::default())
    };
    assert!(
        judged(0, 0).level < CalibrationLevel::Doubtful,
        "{:?}",
        judged(0, 0)
    );
    // One view of a camera may be an accident; a share of them is not.
    assert!(
        judged(1, 0).level < CalibrationLevel::Doubtful,
        "{:?}",
        judged(1, 0)
    );
    let quarter = judged(used / 3 + 1, 0);
    assert_eq!(quarter.level, CalibrationLevel::Doubtful, "{quarter:?}");
    let told = format!(
        "camera {id}: {} of {} views",
        used / 3 + 1,
        used + used / 3 + 1
    );
    assert!(quarter.reasons[0].words.starts_with(&told), "{quarter:?}");
    let half = judged(used, 0);
    assert_eq!(half.level, CalibrationLevel::Refused, "{half:?}");
    // Of all views, whosever they are.
    let all = sound.residuals.len();
    let whole = judged(0, all);
    let told = format!("{all} of {} views (50 %) were left out", 2 * all);
    assert!(whole.reasons[0].words.starts_with(&told), "{whole:?}");
    let share = LeftOutShare {
        read: 0,
        left_out: 0,
    };
    assert_eq!(share.part(), 0.0);
}

#[test]
fn one_camera_among_sharp_ones_refuses_a_calibration_only_if_it_is_far_off() {
    let mut fit = fitted(&truth(checkerboard(), 20, 1), |_| {}).unwrap();
    for (rms_px, level) in [
        (0.2, CalibrationLevel::Accepted),
        (0.5, CalibrationLevel::Doubtful),
        (1.0, CalibrationLevel::Doubtful),
        (2.0, CalibrationLevel::Refused),
    ] {
        fit.cameras[2].figures.rms_px = rms_px;
        let judgement = judge(&fit, &[], &BTreeMap::new(), &Limits::default());
        assert!(
            judgement.level == level || (rms_px < 0.25 && judgement.level < level),
            "{rms_px}: {judgement:?}"
        );
        let told = format!("camera c02: the rms of its residuals is {rms_px:.3} px");
        let is_told = judgement.reasons.iter().any(|r| r.words.starts_with(&told));
        assert_eq!(is_told, rms_px > 0.25, "{judgement:?}");
    }
}

#[test]
fn dropped_corners_have_a_figure_of_their_own() {
    let mut fit = fitted(&truth(checkerboard(), 20, 1), |_| {}).unwrap();
    fit.table_is_lowest = true;
    fit.held_out = Some(HeldOut {
        figures: fit.figures,
        ratio: 1.0,
        folds: 5,
    });
    let sound = judge(&fit, &[], &BTreeMap::new(), &Limits::default());
    assert_eq!(sound.level, CalibrationLevel::Good, "{sound:?}");
    let kept = fit.cameras[2].figures.corners;
    fit.cameras[2].false_corners = kept / 10;
    let dropped_part = 100.0 * (kept / 10) as f64 / (kept + kept / 10) as f64;
    let dropped = judge(&fit, &[], &BTreeMap::new(), &Limits::default());
    assert_eq!(dropped.level, CalibrationLevel::Accepted, "{dropped:?}");
    let told = format!(
        "camera c02: {dropped_part:.1} % of its corners were dropped, expected at most 5 %"
    );
    assert_eq!(dropped.reasons.len(), 1);
    assert_eq!(dropped.reasons[0].words, told);
}

#[test]
fn two_cameras_at_one_place_are_refused_unless_that_is_meant() {
    let mut fit = fitted(&truth(checkerboard(), 20, 1), |_| {}).unwrap();
    let first = fit.cameras[0].camera.rig_from_camera;
    let mut second = fit.cameras[1].camera.clone();
    let beside = |mm: f64, degrees: f64| {
        let turn = Vector3::x() * f64::to_radians(degrees);
        first * nalgebra::Isometry3::new(Vector3::x() * mm * 1e-3, turn)
    };
    for (mm, degrees, refused) in [(9.0, 9.0, true), (11.0, 0.0, false), (0.0, 11.0, false)] {
        second.rig_from_camera = beside(mm, degrees);
        fit.cameras[1].camera = crate::calibration::Camera::new(
            second.id.clone(),
            second.intrinsics,
            second.rig_from_camera,
        );
        let found = judge(&fit, &[], &BTreeMap::new(), &Limits::default());
        assert_eq!(
            found.level == CalibrationLevel::Refused,
            refused,
            "{mm} mm {degrees}°: {found:?}"
        );
        let named = |r: &Reason| r.words.contains("cameras c00 and c01 are at one place");
        assert_eq!(found.reasons.iter().any(named), refused, "{found:?}");
        let meant = Limits {
            same_place: true,
            ..Limits::default()
        };
        assert!(judge(&fit, &[], &BTreeMap::new(), &meant).level < CalibrationLevel::Doubtful);
    }
}

/// Whether what was left out names just this placement, and this camera if one is given.
fn names_only(fit: &Fit, camera: Option<&str>, placement: &str) {
    let named = |l: &LeftOut| {
        l.placement.as_deref() == Some(placement)
            && camera.is_none_or(|c| l.camera.as_ref().is_some_and(|id| id.as_str() == c))
    };
    assert!(
        !fit.left_out.is_empty() && fit.left_out.iter().all(named),
        "{:?}",
        fit.left_out
    );
}

#[test]
fn a_board_that_moved_between_the_cameras_pictures_is_named() {
    let mut truth = truth(checkerboard(), 20, 1);
    let session = truth.session(0.1, &mut Random(7));
    // By 3 mm before half of the cameras took their picture.
    truth.placements[6].translation.vector += Vector3::new(0.002, 0.002, 0.001);
    let moved = truth.session(0.1, &mut Random(8));
    let mut mixed = session.clone();
    for view in &mut mixed.views {
        let same = |other: &&View| (other.camera, other.placement) == (view.camera, 6);
        let later = moved.views.iter().find(same);
        if let Some(other) = later.filter(|_| view.placement == 6 && view.camera.is_multiple_of(2))
        {
            *view = other.clone();
        }
    }
    let fit = fit(&mixed, &Parameters::default()).unwrap();
    names_only(&fit, None, "p06");
    predicts_well(&truth, &fit);
}

#[test]
fn a_placement_that_is_named_as_the_table_is_measured_like_any_other() {
    let board = Board::charuco(11, 8, 0.025, true).unwrap();
    let mut truth = truth(board, 10, 1);
    truth.cameras.drain(4..11);
    let upside_down = Vector3::x() * std::f64::consts::PI;
    let middle = Point3::new(0.01, 0.02, 0.0);
    truth
        .placements
        .push(placed(&board, middle, upside_down, 0.3));
    let session = truth.session(0.1, &mut Random(7));
    let named = |name: &str| {
        let parameters = Parameters {
            table_placement: Some(name.to_owned()),
            folds: 0,
            ..Parameters::default()
        };
        fit(&session, &parameters)
    };
    let flat = named("p00").unwrap();
    assert_eq!((flat.table.as_str(), flat.table_is_lowest), ("p00", true));
    assert!(flat.cameras.iter().all(|c| c.camera.center().z > 0.3));
    let tilted = named("p03").unwrap();
    assert_eq!(
        (tilted.table.as_str(), tilted.table_is_lowest),
        ("p03", false)
    );
    // It would be consistent, but z would point down.
    let words = named("p10").unwrap_err().to_string();
    for part in [
        "placement \"p10\" cannot define",
        "no camera saw the board's front there (camera c00 saw its back)",
        "p00, p01",
    ] {
        assert!(words.contains(part), "{words}");
    }
    assert!(!words.contains("p09, p10"), "{words}");
}

#[test]
fn a_board_of_which_only_the_back_was_seen_defines_no_table() {
    let board = Board::charuco(11, 8, 0.025, true).unwrap();
    let mut truth = truth(board, 1, 1);
    truth.cameras.truncate(11);
    truth.placements.extend(upright(&board, 20));
    let mut session = truth.session(0.1, &mut Random(7));
    session.views.retain(|v| v.face == Face::Back);
    for (subject, camera) in session.cameras.iter_mut().zip(&truth.cameras) {
        subject.known = Some(camera.intrinsics);
    }
    let error = fit(&session, &Parameters::default()).unwrap_err();
    // Nobody saw the one that lies on the table.
    let Error::TableUpsideDown { name, .. } = &error else {
        panic!("{error}")
    };
    assert_eq!(name, "p01");
    let words = error.to_string();
    assert!(
        words.ends_with("with its front side up and show it again"),
        "{words}"
    );
}

#[test]
fn a_blurred_view_is_named_and_a_duplicate_placement_too() {
    let truth = truth(checkerboard(), 20, 1);
    let mut random = Random(5);
    let blurred = fitted(&truth, |session| {
        let view = session
            .views
            .iter_mut()
            .find(|v| v.camera == 3 && v.placement > 4)
            .unwrap();
        for corner in &mut view.corners {
            corner.pixel += nalgebra::Vector2::new(random.normal(), random.normal());
        }
    })
    .unwrap();
    assert_eq!(blurred.left_out.len(), 1);
    assert!(
        blurred.left_out[0].reason.contains("blurred"),
        "{:?}",
        blurred.left_out
    );
    predicts_well(&truth, &blurred);
    let mut twice = truth;
    twice.placements.push(twice.placements[9]);
    let fit = fitted(&twice, |_| {}).unwrap();
    names_only(&fit, None, "p20");
    assert!(fit.left_out[0].reason.contains("p09"), "{:?}", fit.left_out);
}

#[test]
fn a_placement_is_a_duplicate_only_of_one_that_the_same_cameras_saw() {
    let mut twice = truth(checkerboard(), 14, 1);
    twice.cameras.drain(4..11);
    twice.placements.push(twice.placements[9]);
    let session = twice.session(0.1, &mut Random(7));
    let cameras = |placement: usize| -> Vec<usize> {
        let views = session.views.iter();
        let own = views.filter(|v| v.placement == placement);
        own.map(|v| v.camera).collect()
    };
    let [first, .., last] = cameras(9)[..] else {
        panic!("one camera saw it")
    };
    assert_eq!(cameras(9), cameras(14));
    let fitted = |without: &[(usize, usize)]| {
        let mut session = session.clone();
        let is_without = |v: &View| without.contains(&(v.camera, v.placement));
        session.views.retain(|v| !is_without(v));
        let parameters = Parameters {
            folds: 0,
            ..Parameters::default()
        };
        fit(&session, &parameters).unwrap()
    };
    names_only(&fitted(&[(last, 14)]), None, "p14");
    // The view that only the later one has is kept.
    let later = fitted(&[(last, 9)]);
    names_only(&later, None, "p09");
    assert!(later.left_out[0].reason.contains("p14"), "{later:?}");
    let both = fitted(&[(last, 9), (first, 14)]);
    assert!(both.left_out.is_empty(), "{:?}", both.left_out);
}

#[test]
fn false_corners_do_no_harm() {
    let truth = truth(checkerboard(), 20, 1);
    let fit = fitted(&truth, |session| {
        for view in session.views.iter_mut().step_by(7) {
            view.corners[13].pixel.x += 9.0;
            view.corners[40].pixel.y -= 4.0;
        }
    })
    .unwrap();
    assert!(
        fit.cameras.iter().map(|c| c.false_corners).sum::<usize>() >= 40,
        "{:?}",
        fit.figures
    );
    predicts_well(&truth, &fit);
}

#[test]
fn known_lenses_are_kept() {
    let mut truth = truth(checkerboard(), 8, 6);
    truth.cameras = truth.cameras[6..10].to_vec();
    let mut session = truth.session(0.1, &mut Random(7));
    for (subject, camera) in session.cameras.iter_mut().zip(&truth.cameras) {
        subject.known = Some(camera.intrinsics);
    }
    let fit = fit(&session, &Parameters::default()).unwrap();
    assert_eq!(
        fit.cameras[0].camera.intrinsics,
        truth.cameras[0].intrinsics
    );
    predicts_well(&truth, &fit);
}

#[test]
fn a_given_lens_that_does_not_fit_is_told_from_a_lens_beyond_the_model() {
    let mut truth = truth(checkerboard(), 12, 6);
    truth.cameras = truth.cameras[6..9].to_vec();
    let mut session = truth.session(0.1, &mut Random(7));
    for (subject, camera) in session.cameras.iter_mut().zip(&truth.cameras) {
        let mut lens = camera.intrinsics;
        lens.distortion.radial[0] += 0.01;
        subject.known = Some(lens);
    }
    let fit = fit(&session, &Parameters::default()).unwrap();
    let judgement = judge(&fit, &[], &BTreeMap::new(), &Limits::default());
    let kinds: Vec<ReasonKind> = judgement.reasons.iter().map(|r| r.kind).collect();
    assert!(kinds.contains(&ReasonKind::GivenLens), "{judgement:?}");
    assert!(!kinds.contains(&ReasonKind::BeyondLensModel));
    let told = "the lens that was given does not fit: fit it anew";
    assert!(judgement.reasons.iter().any(|r| r.words.ends_with(told)));
}

#[test]
fn a_lens_to_start_from_is_improved_and_leads_to_the_same_fit() {
    let truth = truth(checkerboard(), 12, 4);
    let plain = fitted(&truth, |_| {}).unwrap();
    let started = fitted(&truth, |session| {
        for (subject, camera) in session.cameras.iter_mut().zip(&truth.cameras) {
            let mut lens = camera.intrinsics;
            lens.focal_px *= 1.1;
            subject.start = Some(lens);
        }
    });
    for (a, b) in plain.cameras.iter().zip(&started.unwrap().cameras) {
        let (a, b) = (&a.camera.intrinsics, &b.camera.intrinsics);
        let apart = (a.focal_px - b.focal_px).norm() / a.focal_px.norm();
        assert!(apart < 1e-4, "{} {}", a.focal_px, b.focal_px);
    }
}

#[test]
fn a_lens_that_no_polynomial_describes_is_found_with_the_rational_model() {
    let distortion = Distortion {
        radial: [6.0, 2.0, 0.1, 7.0, 4.0, 0.6],
        tangential: [0.0; 2],
    };
    let (focal, center) = (Vector2::repeat(1300.0), Vector2::new(1221.0, 1019.0));
    let lens = Intrinsics::new(2448, 2048, focal, center, distortion).unwrap();
    let mut truth = truth(checkerboard(), 24, 5);
    truth.cameras = [-0.12, 0.0, 0.12]
        .into_iter()
        .enumerate()
        .map(|(i, x)| {
            let from = Point3::new(x, 0.05, 0.5);
            looking(&format!("c{i:02}"), lens, from, Point3::new(0.0, 0.0, 0.1))
        })
        .collect();
    let session = truth.session(0.1, &mut Random(7));
    let rms = |model| {
        let parameters = Parameters {
            model,
            folds: 0,
            ..Parameters::default()
        };
        fit(&session, &parameters).unwrap().figures.rms_px
    };
    let rational = rms(LensModel::Rational);
    // 0.1 px in each of two coordinates.
    assert!((rational - 0.1414).abs() < 0.004, "{rational}");
    let polynomial = rms(LensModel::PlumbBob);
    assert!(polynomial > 1.3 * rational, "{polynomial} {rational}");
}

#[test]
fn a_turned_camera_is_found_by_one_placement_and_by_how_much() {
    let truth = truth(checkerboard(), 3, 1);
    let mut session = truth.session(0.1, &mut Random(7));
    session.views.retain(|v| v.placement == 0);
    let mut known = crate::calibration::RigCalibration::default();
    for (index, camera) in truth.cameras.iter().enumerate() {
        let turn = nalgebra::UnitQuaternion::from_scaled_axis(
            Vector3::new(0.3, 0.9, 0.1).normalize() * 0.1_f64.to_radians(),
        );
        let mut before = camera.rig_from_camera;
        if index == 5 {
            before.rotation *= turn;
        }
        let before = crate::calibration::Camera::new(camera.id.clone(), camera.intrinsics, before);
        known.cameras.insert(camera.id.clone(), (before, None));
    }
    let limits = DriftLimits::default();
    let checked = check(&session, &known, &limits, &Parameters::default())
        .unwrap()
        .cameras;
    let moved: Vec<_> = checked.iter().filter(|c| c.motion.is_some()).collect();
    assert_eq!(moved.len(), 1, "{checked:?}");
    let motion = moved[0].motion.unwrap();
    assert_eq!(moved[0].camera.as_str(), "c05");
    assert!(
        (motion.turn_degrees - 0.1).abs() < 0.005 && motion.shift == 0.0,
        "{motion:?}"
    );
    assert!(moved[0].off_px > 3.0 && motion.rest_px < 0.25);
    let session = truth.session(0.1, &mut Random(1));
    let nothing = check(
        &session,
        &Default::default(),
        &limits,
        &Parameters::default(),
    )
    .unwrap();
    assert!(nothing.cameras.is_empty(), "{nothing:?}");
}

#[test]
fn what_an_unfinished_session_lacks_is_said() {
    let truth = truth(checkerboard(), 4, 1);
    let session = truth.session(0.1, &mut Random(7));
    let fit = fit(
        &session,
        &Parameters {
            min_views: 1,
            folds: 0,
            ..Parameters::default()
        },
    )
    .ok();
    let kinect = truth.cameras[11].id.clone();
    let words = missing(
        &session,
        fit.as_ref(),
        &[kinect],
        &CoverageLimits::default(),
    )
    .join("\n");
    for expected in [
        "camera c01: it has",
        "parts of its picture",
        "share",
        "depth camera kinect: it has not seen the board 1.",
    ] {
        assert!(words.contains(expected), "{expected}: {words}");
    }
}

#[test]
fn two_cameras_that_share_too_little_are_named_once() {
    let truth = truth(checkerboard(), 4, 1);
    let mut session = truth.session(0.1, &mut Random(7));
    only(&mut session, |camera, _| camera < 2);
    let wanted = CoverageLimits {
        shared: 5,
        ..CoverageLimits::default()
    };
    let words = missing(&session, None, &[], &wanted);
    let pairs: Vec<_> = words.iter().filter(|w| w.contains("share")).collect();
    assert_eq!(pairs.len(), 1, "{pairs:?}");
    assert!(pairs[0].contains("cameras c00 and c01 share"), "{pairs:?}");
}

#[test]
fn nobody_is_asked_to_show_the_board_below_the_table() {
    let mut truth = truth(checkerboard(), 20, 1);
    // Down at the table's height it looks at what lies on it: a third of its picture is the table before it.
    let at = Point3::new(0.0, 0.0, 0.03);
    let low = looking("c02", color_lens(), Point3::new(0.7, 0.2, 0.06), at);
    let [height, column] = [low.intrinsics.height as f64, low.intrinsics.center_px.x];
    let rise = |row: f64| low.ray(Point2::new(column, row)).unwrap().z;
    let table = if rise(0.0) < rise(height) {
        "top"
    } else {
        "bottom"
    };
    truth.cameras[2] = low;
    let session = truth.session(0.1, &mut Random(7));
    let fit = fit(&session, &Parameters::default()).unwrap();
    let words = |fit| {
        let all = missing(&session, fit, &[], &CoverageLimits::default());
        let of_it = all
            .iter()
            .find(|w| w.contains("c02") && w.contains("parts"));
        of_it.cloned().unwrap_or_default()
    };
    assert!(words(None).contains(table), "{}", words(None));
    assert!(!words(Some(&fit)).contains(table), "{}", words(Some(&fit)));
}

#[test]
fn cameras_that_see_worse_are_doubted_more_and_spoil_no_others() {
    let truth = truth(checkerboard(), 20, 1);
    let mut session = truth.session(0.03, &mut Random(7));
    let blunt = truth.session(0.3, &mut Random(8));
    let is_blunt = |camera: usize| camera == 2 || camera == 7;
    for (view, worse) in session.views.iter_mut().zip(blunt.views) {
        assert_eq!(
            (view.camera, view.placement),
            (worse.camera, worse.placement)
        );
        if is_blunt(view.camera) {
            *view = worse;
        }
    }
    let fit = fit(&session, &Parameters::default()).unwrap();
    let errors = normalized_errors(&truth, &fit);
    let rms = |of_blunt: bool| {
        let own = errors.chunks(errors.len() / fit.cameras.len()).enumerate();
        let own = own.filter(|(camera, _)| is_blunt(*camera) == of_blunt);
        let squares: Vec<f64> = own.flat_map(|(_, e)| e).map(|e| e * e).collect();
        (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
    };
    let both = [rms(false), rms(true)];
    assert!(both.iter().all(|rms| (0.6..1.5).contains(rms)), "{both:?}");
    let focal = |camera: usize| fit.cameras[camera].uncertainty.focal_px[0];
    assert!(focal(2) > 3.0 * focal(3), "{} {}", focal(2), focal(3));
}

#[test]
fn a_placement_that_nobody_saw_is_named() {
    let truth = truth(checkerboard(), 20, 1);
    let unseen = |session: &mut Session| {
        session.views.retain(|v| v.placement != 7);
        for view in session.views.iter_mut().filter(|v| v.placement == 11) {
            view.corners.truncate(3);
        }
    };
    let fit = fitted(&truth, unseen).unwrap();
    let named: Vec<_> = fit.left_out.iter().map(LeftOut::subject).collect();
    assert_eq!(named, ["placement p07", "placement p11"]);
    predicts_well(&truth, &fit);
    // Where nothing can be fitted it is among what is missing.
    let mut session = truth.session(0.1, &mut Random(7));
    unseen(&mut session);
    let words = missing(&session, None, &[], &CoverageLimits::default()).join("\n");
    assert!(words.contains("placement p07: no camera saw"), "{words}");
}
