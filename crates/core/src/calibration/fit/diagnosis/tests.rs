//! Sessions with a fault each, and sound ones.

use super::super::synthetic::{Random, Truth, color_lens, looking, placements};
use super::super::{Error, Finding, Limits, Parameters, Session, diagnose, fit, judge};
use crate::calibration::{Board, Level};
use nalgebra::{Isometry3, Point3, Vector3};
use std::collections::BTreeMap;

/// So many cameras side by side, a fifth of a metre apart.
fn rig(cameras: usize, seed: u64) -> Truth {
    let board = Board::checkerboard(9, 6, 0.025).unwrap();
    let at = Point3::new(0.0, 0.0, 0.1);
    let camera = |i: usize| {
        let from = Point3::new(0.2 * i as f64 - 0.3, -0.3, 0.75);
        looking(&format!("c{i:02}"), color_lens(), from, at)
    };
    let placements = placements(&board, 20, &mut Random(seed));
    Truth::new(board, (0..cameras).map(camera).collect(), placements)
}

/// A session whose views of camera `camera` are, from placement `from` on, those of `changed`.
fn from_on(session: &mut Session, changed: &Session, camera: usize, from: usize) {
    session
        .views
        .retain(|v| v.camera != camera || v.placement < from);
    let later = changed
        .views
        .iter()
        .filter(|v| v.camera == camera && v.placement >= from);
    session.views.extend(later.cloned());
    session.views.sort_by_key(|v| (v.placement, v.camera));
}

/// What is found, and the verdict.
fn told(session: &Session) -> (Vec<Finding>, Level) {
    let parameters = Parameters {
        folds: 0,
        ..Parameters::default()
    };
    match fit(session, &parameters) {
        Ok(fit) => {
            let findings = diagnose(session, Some(&fit), &parameters);
            let level = judge(&fit, &findings, &BTreeMap::new(), &Limits::default()).level;
            println!("{level:?} {:?} {findings:?}", fit.left_out_share());
            (findings, level)
        }
        Err(error @ Error::Disjoint { .. }) => {
            let findings = diagnose(session, None, &parameters);
            println!("{error} {findings:?}");
            (findings, Level::Refused)
        }
        Err(error) => panic!("{error}"),
    }
}

fn is_told(session: &Session, words: &[&str]) {
    let (findings, level) = told(session);
    assert!(level >= Level::Doubtful, "{findings:?}");
    assert_eq!(findings.len(), 1, "{findings:?}");
    for words in words {
        assert!(findings[0].words.contains(words), "{words}: {findings:?}");
    }
}

/// A camera turned by degrees from a placement on.
fn bumped(cameras: usize, camera: usize, degrees: f64, from: usize) -> Session {
    let truth = rig(cameras, 1);
    let mut session = truth.session(0.1, &mut Random(7));
    let mut moved = rig(cameras, 1);
    let turn = Isometry3::rotation(Vector3::new(0.3, 0.9, 0.1).normalize() * degrees.to_radians());
    let before = &truth.cameras[camera];
    moved.cameras[camera] = crate::calibration::Camera::new(
        before.id.clone(),
        before.intrinsics,
        before.rig_from_camera * turn,
    );
    from_on(
        &mut session,
        &moved.session(0.1, &mut Random(8)),
        camera,
        from,
    );
    session
}

#[test]
fn a_camera_that_is_bumped_late_is_named_with_turn_and_placement() {
    for (degrees, told) in [(0.1, "0.10°"), (0.7, "0.70°")] {
        let words = [
            &format!("camera c02 moved by {told}") as &str,
            "between p13 and p14",
            "--from-placement p14",
        ];
        is_told(&bumped(4, 2, degrees, 14), &words);
    }
}

#[test]
fn a_camera_that_is_bumped_early_leaves_the_rig_since() {
    let words = [
        "camera c01 moved by 0.3",
        "between p02 and p03",
        "since p03",
    ];
    is_told(&bumped(4, 1, 0.3, 3), &words);
}

#[test]
fn a_pair_whose_cameras_moved_against_each_other_is_told_so() {
    let words = [
        "cameras c00 and c01 moved against each other by 0.5",
        "between p11 and p12",
    ];
    is_told(&bumped(2, 1, 0.5, 12), &words);
}

#[test]
fn cameras_that_are_exchanged_are_named() {
    for cameras in [3, 4] {
        let mut session = rig(cameras, 1).session(0.1, &mut Random(7));
        for view in session.views.iter_mut().filter(|v| v.placement >= 12) {
            view.camera = [0, 2, 1, 3][view.camera];
        }
        is_told(&session, &["cameras c01 and c02 are exchanged from p12 on"]);
    }
}

#[test]
fn a_camera_whose_pictures_are_late_is_named() {
    let late = |cameras: usize, from: usize| {
        let mut session = rig(cameras, 1).session(0.1, &mut Random(7));
        for view in session.views.iter_mut() {
            view.placement += usize::from(view.camera == 2 && view.placement + 1 >= from);
        }
        session.views.retain(|v| v.placement < 20);
        session
    };
    is_told(
        &late(4, 0),
        &["camera c02: its pictures are one placement late: each"],
    );
    is_told(
        &late(4, 11),
        &["camera c02: its pictures are one placement late from p11 on"],
    );
}

#[test]
fn a_mirrored_camera_is_named() {
    let mut session = rig(4, 1).session(0.1, &mut Random(7));
    for view in session.views.iter_mut().filter(|v| v.camera == 2) {
        for corner in &mut view.corners {
            corner.pixel.x = 2447.0 - corner.pixel.x;
            corner.row = 5 - corner.row;
        }
    }
    is_told(&session, &["camera c02: its pictures are mirrored"]);
}

#[test]
fn a_camera_that_is_refocused_is_named() {
    let truth = rig(4, 1);
    let mut session = truth.session(0.1, &mut Random(7));
    let mut zoomed = rig(4, 1);
    zoomed.cameras[2].intrinsics.focal_px *= 1.005;
    from_on(&mut session, &zoomed.session(0.1, &mut Random(8)), 2, 13);
    let words = [
        "the focal length of camera c02 changed by +0.5",
        "between p12 and p13",
    ];
    is_told(&session, &words);
}

#[test]
fn sound_sessions_are_not_doubted() {
    for seed in 0..10 {
        for cameras in [2, 4] {
            let session = rig(cameras, seed).session(0.1, &mut Random(100 + seed));
            let (findings, level) = told(&session);
            assert!(
                findings.is_empty() && level < Level::Doubtful,
                "{seed}: {findings:?}"
            );
        }
    }
}

#[test]
fn blurred_views_and_boards_that_moved_are_no_change_of_the_rig() {
    let mut session = rig(4, 1).session(0.1, &mut Random(7));
    let mut random = Random(5);
    for view in session
        .views
        .iter_mut()
        .filter(|v| v.camera == 1 && v.placement >= 17)
    {
        for corner in &mut view.corners {
            corner.pixel += nalgebra::Vector2::new(random.normal(), random.normal());
        }
    }
    let mut moved = rig(4, 1);
    for placement in [4, 19] {
        moved.placements[placement].translation.vector.x += 0.002;
    }
    let moved = moved.session(0.1, &mut Random(9));
    for view in session.views.iter_mut().filter(|v| v.camera == 3) {
        let same = |other: &&super::super::View| {
            (other.camera, other.placement) == (view.camera, view.placement)
        };
        if let Some(other) = moved
            .views
            .iter()
            .find(same)
            .filter(|v| [4, 19].contains(&v.placement))
        {
            *view = other.clone();
        }
    }
    let (findings, _) = told(&session);
    assert!(findings.is_empty(), "{findings:?}");
}
