//! Tests the registration of bodies made of balls, whose outlines are known exactly, seen by a ring of small cameras.

use super::align::{Rays, align};
use super::body::{Body, doubt};
use super::decide::{Decision, decide};
use super::depth::{Depths, contradiction};
use super::determination::Determination;
use super::group::prepare;
use super::skin::{Skin, agreement};
use super::spots::AgainstBoth;
use super::touch::{Target, touch};
use super::*;
use crate::calibration::{Camera, DepthCamera, DepthResponse, Distortion, Intrinsics, Volume};
use crate::frame::CameraId;
use crate::image::{Grid, Mask, RgbImage};
use crate::reconstruct::silhouette::Facts;
use crate::reconstruct::{ColorView, DepthFrame, DepthView, SilhouetteSource};
use nalgebra::{Point2, Point3, UnitQuaternion, Vector2, Vector3};

/// Centre in the object's frame, and radius.
type Ball = (Point3<f64>, f64);

const SIZE: (usize, usize) = (320, 240);

fn ball(x: f64, y: f64, z: f64, radius: f64) -> Ball {
    (Point3::new(x, y, z), radius)
}

/// Three balls that no motion maps onto themselves.
fn crooked() -> Vec<Ball> {
    vec![
        ball(0.0, 0.0, 0.0, 0.03),
        ball(0.035, 0.005, 0.012, 0.016),
        ball(-0.006, 0.03, 0.02, 0.012),
    ]
}

/// A body of revolution.
fn round() -> Vec<Ball> {
    vec![ball(0.0, 0.0, 0.0, 0.03), ball(0.0, 0.0, 0.035, 0.018)]
}

/// A ball with as many equal ones around it, which fits again after each of as many turns.
fn with_handles(count: usize) -> Vec<Ball> {
    let handle = |i: usize| {
        let turn = std::f64::consts::TAU * i as f64 / count as f64;
        ball(0.036 * turn.cos(), 0.036 * turn.sin(), 0.01, 0.012)
    };
    std::iter::once(ball(0.0, 0.0, 0.0, 0.03))
        .chain((0..count).map(handle))
        .collect()
}

fn cameras() -> Vec<Camera> {
    let camera = |i: usize| {
        let turn = std::f64::consts::TAU * i as f64 / 9.0;
        let height = [0.12, 0.3, 0.45][i % 3];
        let eye = Point3::new(0.4 * turn.cos(), 0.4 * turn.sin(), height);
        let look = Isometry3::face_towards(&eye, &Point3::new(0.0, 0.0, 0.04), &-Vector3::z());
        let distortion = Distortion::from_model("plumb_bob", &[-0.1, 0.02]).unwrap();
        let center = Vector2::new(159.0, 121.0);
        let lens = Intrinsics::new(SIZE.0, SIZE.1, Vector2::repeat(420.0), center, distortion);
        Camera::new(
            CameraId::new(&format!("c{i}")).unwrap(),
            lens.unwrap(),
            look,
        )
    };
    (0..9).map(camera).collect()
}

/// The signed distance of each pixel to the outline of balls, 80 values a pixel.
fn level(camera: &Camera, balls: &[Ball], rig_from_object: &Isometry3<f64>) -> Mask {
    let lens = &camera.intrinsics;
    Grid::from_fn(lens.width, lens.height, |x, y| {
        let ray = camera.ray(Point2::new(x as f64, y as f64)).unwrap();
        let inside = balls.iter().map(|(center, radius)| {
            let to_center = rig_from_object * center - camera.center();
            let pixel = to_center.norm() / lens.focal_px.x;
            (radius - to_center.cross(&ray).norm()) / pixel
        });
        let inside = inside.fold(f64::NEG_INFINITY, f64::max);
        (127.5 + 80.0 * inside).round().clamp(0.0, 255.0) as u8
    })
}

fn capture(balls: &[Ball], rig_from_object: &Isometry3<f64>) -> (Scene, Vec<Silhouette>) {
    let image = RgbImage::filled(SIZE.0, SIZE.1, [120; 3]);
    let (mut colors, mut silhouettes) = (Vec::new(), Vec::new());
    for camera in cameras() {
        let level = level(&camera, balls, rig_from_object);
        let whole = crate::image::PixelRect::whole(SIZE.0, SIZE.1);
        silhouettes.push(Silhouette {
            bounds: level.extent(whole, |&l| l >= 128).unwrap(),
            region: whole,
            facts: Facts::default(),
            level: level.clone(),
            unknown: None,
        });
        colors.push(ColorView {
            camera,
            image: image.clone(),
            silhouette: SilhouetteSource::Mask(level),
            ignored: None,
        });
    }
    let corner = |z: f64| Point3::new(0.1, 0.1, z);
    let volume = Volume::new(Point3::new(-0.1, -0.1, 0.0), corner(0.2)).unwrap();
    let scene = Scene {
        colors,
        depths: Vec::new(),
        volume,
    };
    (scene, silhouettes)
}

/// Where a ray enters and leaves a ball.
fn crossings((center, radius): &Ball, eye: Point3<f64>, ray: Vector3<f64>) -> Option<[f64; 2]> {
    let to_center = center - eye;
    let along = to_center.dot(&ray);
    let squared = radius * radius - (to_center - ray * along).norm_squared();
    (squared > 0.0).then(|| [along - squared.sqrt(), along + squared.sqrt()])
}

/// Adds what a depth camera above reads of a hollow, which is the lower half of a ball around the object's origin, and
/// of the balls that lie in it.
fn hollowed(
    (mut scene, silhouettes): (Scene, Vec<Silhouette>),
    rig_from_object: &Isometry3<f64>,
    inside: &[Ball],
) -> (Scene, Vec<Silhouette>) {
    let hollow = ball(0.0, 0.0, 0.0, 0.022);
    let eye = Point3::new(0.0, 0.0, 0.5);
    let look = Isometry3::face_towards(&eye, &Point3::new(0.0, 0.0, 0.05), &Vector3::y());
    let (focal, center) = (Vector2::repeat(700.0), Vector2::new(160.0, 120.0));
    let lens = Intrinsics::new(SIZE.0, SIZE.1, focal, center, Distortion::default());
    let camera = Camera::new(CameraId::new("depth").unwrap(), lens.unwrap(), look);
    let axis = look.rotation * Vector3::z();
    let object_from_rig = rig_from_object.inverse();
    let from = object_from_rig * eye;
    let reading = |x: usize, y: usize| {
        let ray = camera.ray(Point2::new(x as f64, y as f64)).unwrap();
        let turned = object_from_rig.rotation * ray;
        let far = crossings(&hollow, from, turned).map(|[_, leaves]| leaves);
        let far = far.filter(|&along| (from + turned * along).z < 0.0);
        let near = inside
            .iter()
            .filter_map(|ball| crossings(ball, from, turned));
        let nearest = near.map(|[enters, _]| enters).chain(far);
        let nearest = nearest.fold(f64::INFINITY, f64::min);
        if nearest.is_finite() {
            // In tenths of a millimetre along the optical axis.
            (1e4 * nearest * ray.dot(&axis)).round() as u16
        } else {
            0
        }
    };
    scene.depths.push(DepthView {
        frames: vec![DepthFrame {
            readings: Grid::from_fn(SIZE.0, SIZE.1, reading),
            color: None,
        }],
        camera: DepthCamera {
            camera,
            response: DepthResponse {
                slope: 1e-4,
                ..DepthResponse::default()
            },
        },
    });
    (scene, silhouettes)
}

/// What two captures say of the second one's pose where both are given.
fn checked(captures: &[(Scene, Vec<Silhouette>); 2], given: [Isometry3<f64>; 2]) -> Registered {
    let captures = captures
        .each_ref()
        .map(|(scene, silhouettes)| Some(CaptureSilhouettes { scene, silhouettes }));
    register(&captures, 0, Some(&given)).captures.remove(1)
}

/// Degrees by which a pose of the second capture is off.
fn error_deg(found: &Registered, poses: &[Isometry3<f64>; 2]) -> f64 {
    let truth = poses[1] * poses[0].inverse();
    let found = found.rig_from_object.unwrap();
    (truth.inverse() * found).rotation.angle().to_degrees()
}

/// Paints a capture's pictures: brightness of a point of the object's frame, 0 to 1, where a camera sees a ball.
fn painted(
    (mut scene, silhouettes): (Scene, Vec<Silhouette>),
    balls: &[Ball],
    rig_from_object: &Isometry3<f64>,
    brightness: fn(Point3<f64>) -> f64,
) -> (Scene, Vec<Silhouette>) {
    for view in &mut scene.colors {
        let camera = &view.camera;
        let eye = rig_from_object.inverse() * camera.center();
        let color = |x: usize, y: usize| {
            let ray = camera.ray(Point2::new(x as f64, y as f64)).unwrap();
            let ray = rig_from_object.rotation.inverse() * ray;
            let hits = balls.iter().filter_map(|ball| crossings(ball, eye, ray));
            let nearest = hits.map(|[enters, _]| enters).fold(f64::INFINITY, f64::min);
            let value = if nearest.is_finite() {
                40.0 + 180.0 * brightness(eye + ray * nearest)
            } else {
                120.0
            };
            [value.round() as u8; 3]
        };
        view.image = RgbImage::from_fn(SIZE.0, SIZE.1, color);
    }
    (scene, silhouettes)
}

fn stripes(p: Point3<f64>) -> f64 {
    0.5 + 0.25 * ((p.x * 450.0).sin() + (p.z * 430.0).cos())
}

fn other_stripes(p: Point3<f64>) -> f64 {
    0.5 + 0.25 * (((p.x + p.y) * 330.0).cos() + ((p.z - p.y) * 370.0 + 1.0).sin())
}

fn registered(captures: &[(Scene, Vec<Silhouette>)]) -> Registration {
    let captures = captures
        .iter()
        .map(|(scene, silhouettes)| Some(CaptureSilhouettes { scene, silhouettes }));
    register(&captures.collect::<Vec<_>>(), 0, None)
}

/// Lying somewhere above the table, turned.
fn pose(axis: [f64; 3], radians: f64) -> Isometry3<f64> {
    let turn = UnitQuaternion::from_scaled_axis(Vector3::from(axis).normalize() * radians);
    Isometry3::from_parts(nalgebra::Translation3::new(0.004, -0.006, 0.055), turn)
}

/// A turn about the axis of a body of revolution.
fn turn(degrees: f64) -> Isometry3<f64> {
    Isometry3::rotation(Vector3::z() * degrees.to_radians())
}

#[test]
fn a_crooked_body_is_found_by_its_outlines_in_any_pose() {
    let poses = [pose([0.0, 0.0, 1.0], 0.3), pose([1.0, 0.3, 0.2], 2.6)];
    let captures = poses.map(|p| capture(&crooked(), &p));
    let found = registered(&captures);
    let second = &found.captures[1];
    assert_eq!(second.verdict, Ok(PoseEvidence::Silhouettes), "{second:?}");
    let truth = poses[1] * poses[0].inverse();
    let error = truth.inverse() * second.rig_from_object.unwrap();
    assert!(error.rotation.angle().to_degrees() < 0.5, "{second:?}");
    assert!((error * Point3::new(0.0, 0.0, 0.055) - Point3::new(0.0, 0.0, 0.055)).norm() < 3e-4);
    // The same without the search, from a pose that is given, and refused from a wrong one.
    let given = checked(&captures, poses);
    assert_eq!(given.verdict, Ok(PoseEvidence::Given));
    assert_eq!(given.free_axis, None);
    let wrong = checked(&captures, [poses[0], pose([1.0, 0.3, 0.2], 2.5)]);
    assert!(wrong.verdict.is_err(), "{wrong:?}");
}

#[test]
fn a_body_that_changed_is_refused_and_a_faulty_capture_is_left_out() {
    let poses = [
        pose([0.0, 0.0, 1.0], 0.3),
        pose([1.0, 0.3, 0.2], 2.6),
        pose([0.0, 1.0, 0.2], 1.5),
    ];
    let mut changed = crooked();
    changed[2].0.z += 0.004;
    let mut captures = [
        capture(&crooked(), &poses[0]),
        capture(&changed, &poses[1]),
        capture(&crooked(), &poses[2]),
    ];
    // The third lost a ball in one of its pictures.
    let camera = captures[2].0.colors[4].camera.clone();
    captures[2].1[4].level = level(&camera, &crooked()[..2], &poses[2]);
    let found = registered(&captures);
    assert_eq!(found.placed(), [0]);
    let why = |i: usize| found.captures[i].verdict.unwrap_err();
    assert!(
        matches!(why(1), Refusal::NoPose | Refusal::Stretch),
        "{:?}",
        found.captures[1]
    );
    assert_eq!(why(2), Refusal::ContradictsItself);
}

/// What is decided of two captures whose silhouettes are said to be as noisy as they may be, so that the whole contour
/// tells nothing.
fn decided_of_noisy(captures: &[(Scene, Vec<Silhouette>); 2]) -> Decision {
    let [a, b] = [0, 1].map(|i| {
        let (scene, silhouettes) = &captures[i];
        let mut prepared = prepare(&CaptureSilhouettes { scene, silhouettes }).unwrap();
        prepared.own.rms = limits::own(prepared.body.pixel);
        let camera = 0;
        let (length_px, miss_px) = (30.0, 2.0);
        let stretch = ContourStretch {
            camera,
            length_px,
            miss_px,
        };
        prepared.own.stretch = Some(stretch);
        prepared
    });
    decide(&a, &b, None)
}

/// Leaves only some balls of a capture's body in one outline, the one in which that changes most.
fn lose_in_one_view(
    (scene, silhouettes): &mut (Scene, Vec<Silhouette>),
    left: &[Ball],
    rig_from_object: &Isometry3<f64>,
) {
    let views = scene.colors.iter();
    let levels: Vec<Mask> = views
        .map(|view| level(&view.camera, left, rig_from_object))
        .collect();
    let missing = |i: &usize| {
        let before = silhouettes[*i].level.pixels().iter();
        before
            .zip(levels[*i].pixels())
            .filter(|(a, b)| a != b)
            .count()
    };
    let most = (0..levels.len()).max_by_key(missing).unwrap();
    silhouettes[most].level = levels[most].clone();
}

#[test]
fn a_given_pose_to_which_only_a_stretch_objects_is_refused_for_it() {
    let poses = near_poses();
    let mut captures = poses.map(|pose| capture(&crooked(), &pose));
    lose_in_one_view(&mut captures[1], &crooked()[..1], &poses[1]);
    let decided = |noise: Option<f64>| {
        let [a, b] = captures.each_ref().map(|(scene, silhouettes)| {
            let mut prepared = prepare(&CaptureSilhouettes { scene, silhouettes }).unwrap();
            prepared.own.rms = noise.unwrap_or(prepared.own.rms);
            prepared
        });
        decide(&a, &b, Some(poses[1] * poses[0].inverse()))
    };
    // More than is accepted of a pose that is found, and less than silhouettes as a whole object to.
    let disagreement = decided(None).disagreement;
    let decision = decided(Some(disagreement / 1.9));
    assert!(disagreement > 0.3e-3, "{decision:?}");
    assert!(disagreement < decision.accepted, "{decision:?}");
    assert_eq!(decision.verdict, Err(Refusal::Stretch), "{decision:?}");
}

#[test]
fn a_piece_that_one_outline_lost_counts_although_its_capture_contradicts_itself_too() {
    let poses = near_poses();
    let whole = [&crooked()[..], &[ball(0.0, -0.03, 0.012, 0.008)]].concat();
    let mut captures = poses.map(|pose| capture(&whole, &pose));
    lose_in_one_view(&mut captures[1], &crooked(), &poses[1]);
    let decision = decided_of_noisy(&captures);
    let beyond_own = decision.beyond_own.clone().unwrap().0.weight();
    assert!(beyond_own > 70.0, "{decision:?}");
    assert!(decision.is_doubtful, "{decision:?}");
}

#[test]
fn an_outline_that_lost_a_piece_is_named_and_where_none_did_nothing_is() {
    let poses = near_poses();
    let knob = ball(0.0, -0.03, 0.012, 0.008);
    let whole = [&crooked()[..], &[knob]].concat();
    let mut captures = poses.map(|pose| capture(&whole, &pose));
    let piece = |captures: &[(Scene, Vec<Silhouette>); 2]| {
        let [a, b] = captures.each_ref().map(|(scene, silhouettes)| {
            Body::new(&CaptureSilhouettes { scene, silhouettes }).unwrap()
        });
        let pose = poses[1] * poses[0].inverse();
        lost::piece(&[
            AgainstBoth::new(&a, &b, pose),
            AgainstBoth::new(&b, &a, pose.inverse()),
        ])
    };
    let is_maybe_lost = |weight: f64| limits::is_maybe_lost_piece(weight, 1e-3);
    let of_whole = piece(&captures);
    assert!(
        of_whole
            .as_ref()
            .is_none_or(|p| !is_maybe_lost(p.at.weight)),
        "{of_whole:?}"
    );
    for i in 0..9 {
        let (before, camera) = (
            captures[1].1[i].level.clone(),
            captures[1].0.colors[i].camera.clone(),
        );
        let without = level(&camera, &crooked(), &poses[1]);
        let shown = before.pixels().iter().zip(without.pixels());
        if shown.filter(|(a, b)| a.abs_diff(**b) > 100).count() < 20 {
            continue;
        }
        captures[1].1[i].level = without;
        let found = piece(&captures).unwrap();
        assert_eq!((found.at.stretch.camera, found.is_second), (i, true));
        assert!(limits::is_lost_piece(found.at.weight, 1e-3), "{found:?}");
        captures[1].1[i].level = before;
    }
}

#[test]
fn a_knob_that_broke_off_is_seen_at_one_spot_and_one_wrong_outline_shows_no_change() {
    let poses = near_poses();
    let knob = ball(-0.02, -0.015, 0.018, 0.0055);
    let with_knob = [&crooked()[..], &[knob]].concat();
    let broken = [
        capture(&with_knob, &poses[0]),
        capture(&crooked(), &poses[1]),
    ];
    let decision = decided_of_noisy(&broken);
    let (spot, is_second) = decision.changed.clone().unwrap();
    assert!(
        limits::is_change(spot.weight, 1e-3) && !is_second,
        "{decision:?}"
    );
    assert_eq!(decision.verdict, Err(Refusal::Stretch), "{decision:?}");
    assert!(decision.disagreement < decision.accepted, "{decision:?}");
    let stretch = decision.stretch.clone().unwrap().0;
    assert!(!limits::is_long(stretch.weight(), 1e-3), "{decision:?}");

    // The same in one picture alone is a fault of that silhouette.
    let mut one_wrong = poses.map(|pose| capture(&crooked(), &pose));
    let camera = broken[0].0.colors[spot.stretch.camera].camera.clone();
    one_wrong[0].1[spot.stretch.camera].level = level(&camera, &with_knob, &poses[0]);
    let decision = decided_of_noisy(&one_wrong);
    assert!(decision.changed.is_none(), "{decision:?}");
    assert_ne!(decision.verdict, Err(Refusal::Stretch), "{decision:?}");
}

#[test]
fn outlines_are_as_clear_as_the_coarser_of_two_captures_can_show() {
    let poses = [pose([0.0, 0.0, 1.0], 0.3), pose([1.0, 0.3, 0.2], 2.6)];
    let captures = poses.map(|p| capture(&crooked(), &p));
    let decided = |pixel_of_second: Option<f64>| {
        let [mut a, mut b] = captures.each_ref().map(|(scene, silhouettes)| {
            prepare(&CaptureSilhouettes { scene, silhouettes }).unwrap()
        });
        (a.own.rms, b.own.rms) = (0.0, 0.0);
        b.body.pixel = pixel_of_second.unwrap_or(b.body.pixel);
        decide(&a, &b, Some(poses[1] * poses[0].inverse()))
    };
    // What is too much for the second one's pixels alone.
    let disagreement = decided(None).disagreement;
    let pixel = disagreement / 0.11;
    assert!(!limits::is_green(disagreement, 0.0, pixel));
    let decision = decided(Some(pixel));
    assert!(!decision.is_doubtful, "{decision:?}");
}

#[test]
fn captures_whose_calibrations_differ_in_scale_are_not_fused_and_say_so() {
    let poses = [pose([0.0, 0.0, 1.0], 0.3), pose([1.0, 0.3, 0.2], 2.6)];
    let mut captures = poses.map(|p| capture(&crooked(), &p));
    for view in &mut captures[1].0.colors {
        let mut longer = view.camera.rig_from_camera;
        longer.translation.vector *= 1.012;
        view.camera = Camera::new(view.camera.id.clone(), view.camera.intrinsics, longer);
    }
    let second = registered(&captures).captures.remove(1);
    assert_eq!(second.verdict, Err(Refusal::Scale), "{second:?}");
    let larger_by = second.larger_by.unwrap();
    assert!((larger_by - 0.012).abs() < 0.002, "{larger_by}");
    // Another object under the same cameras is not excused by a scale.
    let mut changed = crooked();
    for (center, radius) in &mut changed {
        (*center, *radius) = (*center * 1.012, *radius * 1.012);
    }
    let captures = [capture(&crooked(), &poses[0]), capture(&changed, &poses[1])];
    let second = registered(&captures).captures.remove(1);
    assert_eq!(
        (second.verdict, second.larger_by),
        (Err(Refusal::NoPose), None)
    );
}

#[test]
fn the_turn_of_a_plain_body_of_revolution_is_not_claimed() {
    let poses = [pose([0.0, 0.0, 1.0], 0.3), pose([1.0, 0.3, 0.2], 2.6)];
    let captures = poses.map(|p| capture(&round(), &p));
    let second = registered(&captures).captures.remove(1);
    assert_eq!(second.verdict, Ok(PoseEvidence::Nothing), "{second:?}");
    assert_eq!(second.level, Level::Amber);
    // The axis is known, and the form: where the axis' ends come to lie.
    let found = second.rig_from_object.unwrap();
    let truth = poses[1] * poses[0].inverse();
    for (center, _) in round() {
        let p = poses[0] * center;
        assert!((found * p - truth * p).norm() < 3e-4, "{second:?}");
    }
}

#[test]
fn the_odd_first_capture_keeps_its_reason_when_others_agree() {
    let poses = [
        pose([0.0, 0.0, 1.0], 0.3),
        pose([1.0, 0.3, 0.2], 2.6),
        pose([0.0, 1.0, 0.2], 1.5),
    ];
    let mut changed = crooked();
    changed[2].0.z += 0.004;
    let captures = [
        capture(&changed, &poses[0]),
        capture(&crooked(), &poses[1]),
        capture(&crooked(), &poses[2]),
    ];
    let found = registered(&captures);
    assert_eq!((found.placed(), found.frame_of), (vec![1, 2], 1));
    let first = &found.captures[0];
    let why = first.verdict.unwrap_err();
    assert!(
        matches!(why, Refusal::NoPose | Refusal::Stretch),
        "{first:?}"
    );
    assert_eq!((first.against, first.all_at_once_mm), (Some(1), None));
    assert!(first.disagreement_mm.unwrap() > 0.1, "{first:?}");
}

#[test]
fn a_capture_without_silhouettes_hinders_no_other() {
    let poses = [pose([0.0, 0.0, 1.0], 0.3), pose([1.0, 0.3, 0.2], 2.6)];
    let captures = poses.map(|p| capture(&crooked(), &p));
    let of = |i: usize| {
        Some(CaptureSilhouettes {
            scene: &captures[i].0,
            silhouettes: &captures[i].1,
        })
    };
    let found = register(&[of(0), None, of(1)], 1, None);
    assert_eq!((found.placed(), found.frame_of), (vec![0, 2], 0));
    assert_eq!(found.captures[1].verdict, Err(Refusal::Unusable));
    let none = register(&[None, None], 0, None);
    assert!(none.placed().is_empty());
}

#[test]
fn equal_forms_with_other_patterns_are_doubtful() {
    let poses = [pose([0.0, 0.0, 1.0], 0.3), pose([0.1, 0.2, 1.0], 1.4)];
    let with = |i: usize, brightness: fn(Point3<f64>) -> f64| {
        painted(
            capture(&crooked(), &poses[i]),
            &crooked(),
            &poses[i],
            brightness,
        )
    };
    let same = [with(0, stripes), with(1, stripes)];
    let second = registered(&same).captures.remove(1);
    let held = (Ok(PoseEvidence::Silhouettes), Level::Green);
    assert_eq!((second.verdict, second.level), held, "{second:?}");
    let other = [with(0, stripes), with(1, other_stripes)];
    let second = registered(&other).captures.remove(1);
    let doubtful = (Ok(PoseEvidence::Silhouettes), Level::Amber);
    assert_eq!((second.verdict, second.level), doubtful, "{second:?}");
    assert!(second.do_colours_contradict(), "{second:?}");
    // One that is plain contradicts no pattern.
    let plain = [with(0, stripes), capture(&crooked(), &poses[1])];
    let second = registered(&plain).captures.remove(1);
    assert_eq!((second.verdict, second.level), held, "{second:?}");
}

#[test]
fn a_camera_that_one_capture_lacks_is_no_other_calibration() {
    let poses = [pose([0.0, 0.0, 1.0], 0.3), pose([1.0, 0.3, 0.2], 2.6)];
    let mut larger = crooked();
    for (center, radius) in &mut larger {
        (*center, *radius) = (*center * 1.012, *radius * 1.012);
    }
    let mut captures = [capture(&crooked(), &poses[0]), capture(&larger, &poses[1])];
    captures[1].0.colors.remove(3);
    captures[1].1.remove(3);
    let second = registered(&captures).captures.remove(1);
    assert_eq!(
        (second.verdict, second.larger_by),
        (Err(Refusal::NoPose), None)
    );
}

#[test]
fn a_small_scale_between_calibrations_makes_a_pose_doubtful() {
    let poses = [pose([0.0, 0.0, 1.0], 0.3), pose([1.0, 0.3, 0.2], 2.6)];
    let mut captures = poses.map(|p| capture(&crooked(), &p));
    let second = registered(&captures).captures.remove(1);
    assert_eq!((second.level, second.larger_by), (Level::Green, None));
    for view in &mut captures[1].0.colors {
        let mut longer = view.camera.rig_from_camera;
        longer.translation.vector *= 1.003;
        view.camera = Camera::new(view.camera.id.clone(), view.camera.intrinsics, longer);
    }
    let second = registered(&captures).captures.remove(1);
    assert_eq!(second.verdict, Ok(PoseEvidence::Silhouettes), "{second:?}");
    assert_eq!(second.level, Level::Amber, "{second:?}");
    let larger_by = second.larger_by.unwrap();
    assert!((larger_by - 0.003).abs() < 0.0015, "{larger_by}");
}

/// Two poses that show nearly the same sides, so that patterns have much in common.
fn near_poses() -> [Isometry3<f64>; 2] {
    [pose([0.0, 0.0, 1.0], 0.3), pose([0.1, 0.2, 1.0], 1.4)]
}

/// A body in two poses, painted or grey.
fn twice(
    balls: &[Ball],
    poses: &[Isometry3<f64>; 2],
    brightness: fn(Point3<f64>) -> f64,
) -> [(Scene, Vec<Silhouette>); 2] {
    poses
        .each_ref()
        .map(|pose| painted(capture(balls, pose), balls, pose, brightness))
}

/// Colours alone must find the turn of a painted body.
fn colours_find_the_turn_of(body: &[Ball]) {
    let poses = near_poses();
    let captures = twice(body, &poses, other_stripes);
    let second = registered(&captures).captures.remove(1);
    assert_eq!(second.verdict, Ok(PoseEvidence::Colours), "{second:?}");
    let error = error_deg(&second, &poses);
    assert!(error < 3.0, "{error} degrees: {second:?}");
}

#[test]
fn colours_find_the_turn_of_a_body_of_revolution() {
    colours_find_the_turn_of(&round());
}

#[test]
fn colours_tell_one_of_two_equal_handles_from_the_other() {
    colours_find_the_turn_of(&with_handles(2));
}

fn rings(p: Point3<f64>) -> f64 {
    0.5 + 0.4 * (430.0 * p.z).cos()
}

/// Rings with a spot on one side.
fn rings_with_a_spot(p: Point3<f64>) -> f64 {
    if (p - Point3::new(0.029, 0.0, 0.005)).norm() < 0.01 {
        0.05
    } else {
        rings(p)
    }
}

/// Rings, and stripes from end to end that fit again after a quarter of a turn.
fn rings_and_stripes(p: Point3<f64>) -> f64 {
    0.5 + 0.25 * (430.0 * p.z).cos() + 0.2 * (4.0 * p.y.atan2(p.x)).cos()
}

#[test]
fn rings_that_agree_at_every_turn_make_a_model_whose_turn_is_not_claimed() {
    let poses = near_poses();
    let captures = twice(&round(), &poses, rings);
    let second = registered(&captures).captures.remove(1);
    assert_eq!(second.verdict, Ok(PoseEvidence::Nothing), "{second:?}");
    assert_eq!(second.level, Level::Amber);
    assert!(second.free_axis.is_some(), "{second:?}");
    // The form: where the axis' ends come to lie.
    let found = second.rig_from_object.unwrap();
    let truth = poses[1] * poses[0].inverse();
    for (center, _) in round() {
        let p = poses[0] * center;
        assert!((found * p - truth * p).norm() < 3e-4, "{second:?}");
    }
}

#[test]
fn colours_that_differ_between_turns_and_do_not_decide_are_refused() {
    for brightness in [rings_with_a_spot, rings_and_stripes] {
        let poses = near_poses();
        let captures = twice(&round(), &poses, brightness);
        let second = registered(&captures).captures.remove(1);
        let is_found = second.verdict == Ok(PoseEvidence::Colours);
        assert!(
            second.verdict == Err(Refusal::Undecided)
                || is_found && error_deg(&second, &poses) < 3.0,
            "{second:?}"
        );
    }
}

#[test]
fn a_plain_body_that_fits_in_several_turns_has_all_of_them_as_rivals() {
    let poses = near_poses();
    for count in [2, 5] {
        let body = with_handles(count);
        let captures = poses.each_ref().map(|p| capture(&body, p));
        let second = registered(&captures).captures.remove(1);
        assert_eq!(second.verdict, Ok(PoseEvidence::Nothing), "{second:?}");
        assert_eq!(second.level, Level::Amber);
        assert_eq!(second.free_axis, None, "{second:?}");
        // All turns but the one that was taken, whichever that is.
        let step = 360.0 / count as f64;
        assert_eq!(second.rivals.len(), count - 1, "{second:?}");
        for rival in &second.rivals {
            let off = (rival.turned_deg / step - (rival.turned_deg / step).round()).abs() * step;
            assert!(off < 2.0, "{rival:?}");
        }
        // And the one that was taken is one of them.
        let error = error_deg(&second, &poses) / step;
        assert!((error - error.round()).abs() * step < 2.0, "{second:?}");
    }
}

#[test]
fn of_three_free_turns_none_is_stated_that_is_wrong() {
    let balls = [ball(0.0, 0.0, 0.0, 0.03)];
    let poses = near_poses();
    let painted = twice(&balls, &poses, other_stripes);
    let painted = registered(&painted).captures.remove(1);
    assert_ne!(painted.verdict, Ok(PoseEvidence::Nothing), "{painted:?}");
    let is_right = || error_deg(&painted, &poses) < 3.0;
    assert!(painted.verdict.is_err() || is_right(), "{painted:?}");
    let plain = poses.each_ref().map(|p| capture(&balls, p));
    let plain = registered(&plain).captures.remove(1);
    assert!(plain.level > Level::Green, "{plain:?}");
    // Where it has a place, the centre is known.
    if plain.is_placed() {
        let [first, second] = poses.map(|pose| pose * Point3::origin());
        let off = plain.rig_from_object.unwrap() * first - second;
        assert!(off.norm() < 3e-4, "{plain:?}");
    }
}

/// What lies in a hollow.
fn fruit() -> [Ball; 2] {
    [
        ball(0.013, 0.0, -0.004, 0.007),
        ball(-0.004, 0.011, -0.004, 0.006),
    ]
}

#[test]
fn what_lies_in_the_hollow_of_a_round_body_is_not_turned_at_will() {
    let poses = [pose([0.0, 0.0, 1.0], 0.3), pose([0.0, 0.0, 1.0], 1.4)];
    let captures = poses
        .each_ref()
        .map(|p| hollowed(capture(&round(), p), p, &fruit()));
    let second = registered(&captures).captures.remove(1);
    // Without depth, the turn would be taken for one that changes nothing.
    assert!(
        matches!(
            second.verdict,
            Ok(PoseEvidence::Depth) | Err(Refusal::Undecided)
        ),
        "{second:?}"
    );
    assert!(
        second.verdict.is_err() || error_deg(&second, &poses) < 3.0,
        "{second:?}"
    );
    // Depth bears the right pose, and contradicts one that is turned by 50 degrees.
    let right = checked(&captures, poses);
    assert_eq!(right.verdict, Ok(PoseEvidence::Given), "{right:?}");
    let share = right.depth.unwrap().contradicting;
    assert!(share < 0.01, "{right:?}");
    let turned = poses[1] * turn(50.0);
    let wrong = checked(&captures, [poses[0], turned]);
    assert_eq!(wrong.level, Level::Amber, "{wrong:?}");
    let share = wrong.depth.unwrap().contradicting;
    assert!(share > 0.05, "{wrong:?}");
}

#[test]
fn depth_refuses_a_pose_that_outlines_hold_when_something_moved_in_the_hollow() {
    let poses = [pose([0.0, 0.0, 1.0], 0.3), pose([0.0, 0.0, 1.0], 1.4)];
    let moved = fruit().map(|(center, radius)| (turn(180.0) * center, radius));
    let captures = |second: &[Ball]| {
        [&fruit()[..], second]
            .into_iter()
            .zip(&poses)
            .map(|(inside, p)| hollowed(capture(&crooked(), p), p, inside))
            .collect::<Vec<_>>()
    };
    let second = registered(&captures(&fruit())).captures.remove(1);
    assert_eq!(second.verdict, Ok(PoseEvidence::Silhouettes), "{second:?}");
    let second = registered(&captures(&moved)).captures.remove(1);
    assert_eq!(second.verdict, Err(Refusal::DepthContradicts), "{second:?}");
}

#[test]
fn a_given_turn_that_outlines_leave_open_is_told_and_checked_by_colours() {
    let poses = near_poses();
    let turned = [poses[0], poses[1] * turn(50.0)];
    // Plain: whatever turn is given is as good as any, and the report says where it is open.
    let plain = poses.each_ref().map(|p| capture(&round(), p));
    for given in [poses, turned] {
        let second = checked(&plain, given);
        assert_eq!(second.verdict, Ok(PoseEvidence::Given), "{second:?}");
        let axis = second.free_axis.unwrap();
        assert!(axis.z.abs() > 0.98, "{second:?}");
        assert!(second.is_turn_only_given(), "{second:?}");
    }
    // Painted: colours confirm the right turn, and leave another one in doubt.
    let painted = twice(&round(), &poses, other_stripes);
    let right = checked(&painted, poses);
    assert_eq!(
        (right.verdict, right.level),
        (Ok(PoseEvidence::Given), Level::Green),
        "{right:?}"
    );
    assert!(!right.is_turn_only_given(), "{right:?}");
    let wrong = checked(&painted, turned);
    assert_eq!(
        (wrong.verdict, wrong.level),
        (Ok(PoseEvidence::Given), Level::Amber),
        "{wrong:?}"
    );
    assert!(wrong.is_turn_only_given(), "{wrong:?}");
}

fn body_of((scene, silhouettes): &(Scene, Vec<Silhouette>)) -> Body {
    Body::new(&CaptureSilhouettes { scene, silhouettes }).unwrap()
}

#[test]
fn a_turn_that_has_room_to_one_side_alone_is_held_loosely() {
    let poses = near_poses();
    let knobbed = [&round()[..], &[ball(0.03, 0.0, 0.005, 0.008)]].concat();
    let [a, b] = poses.each_ref().map(|p| body_of(&capture(&knobbed, p)));
    let turned = |degrees: f64| {
        let pose = poses[1] * turn(degrees) * poses[0].inverse();
        let still = Rays {
            rounds: 0,
            ..Rays::MANY
        };
        align(&a, &b, pose, still, None)
    };
    // Let the silhouettes bear eight degrees to either side.
    let softest = turned(0.0).softest()[0].0;
    let limit = align(&a, &b, turned(8.0).pose, Rays::SOME, Some(&softest)).disagreement;
    for degrees in [0.0, 7.0, -7.0] {
        let held = Determination::of(&a, &b, &turned(degrees), limit);
        assert!(held.is_loose() && !held.is_free(), "{degrees}: {held:?}");
    }
}

#[test]
fn outlines_are_known_to_a_fraction_of_a_pixel() {
    let (radius, at) = (0.03, pose([0.0, 0.0, 1.0], 0.3));
    let body = body_of(&capture(&[ball(0.0, 0.0, 0.0, radius)], &at));
    let center = at * Point3::origin();
    assert!(body.rays.len() > 500, "{}", body.rays.len());
    let (mut worst_ray, mut worst_value) = (0.0_f64, 0.0_f64);
    for ray in &body.rays {
        let nearest = ray.eye + ray.direction * (center - ray.eye).dot(&ray.direction);
        let outwards = nearest - center;
        worst_ray = worst_ray.max((outwards.norm() - radius).abs());
        let outline = &body.outlines[ray.view];
        for off in [-0.001, 0.001] {
            let p = nearest + outwards.normalize() * off;
            let inside = outline.value(outline.in_camera(p));
            worst_value = worst_value.max((inside + off).abs());
        }
    }
    // A pixel is nearly a millimetre here, and the lenses distort.
    assert!(worst_ray < 1e-4, "{worst_ray}");
    assert!(worst_value < 1.5e-4, "{worst_value}");
}

#[test]
fn a_look_at_a_block_leaves_out_only_what_does_not_decide() {
    let body = body_of(&capture(&crooked(), &pose([0.0, 0.0, 1.0], 0.3)));
    let mut left_out = 0;
    let mut decided = 0;
    for i in 0..40_000_u32 {
        // Also beside the pictures and behind the cameras.
        let share = |prime: u32| f64::from(i.wrapping_mul(prime) % 1009) / 504.5 - 1.0;
        let far = if i % 10 == 0 { 2.0 } else { 0.06 };
        let p = body.center + Vector3::new(share(7919), share(6011), share(104_729)) * far;
        for outline in &body.outlines {
            let q = outline.in_camera(p);
            let value = outline.value(q) + 0.0005;
            for limit in [-0.01, 0.0, 0.002, value, value.next_up()] {
                let expected = (value < limit).then_some(value);
                assert_eq!(outline.sum_below(limit, q, 0.0005), expected, "{p} {limit}");
                *(if expected.is_some() {
                    &mut decided
                } else {
                    &mut left_out
                }) += 1;
            }
        }
    }
    assert!(
        decided > 10_000 && left_out > 10_000,
        "{decided} {left_out}"
    );
}

#[test]
fn the_steps_along_a_ray_miss_no_better_place() {
    // A small thing stands out.
    let mut balls = crooked();
    balls.push(ball(0.0, -0.031, 0.01, 0.005));
    let poses = [pose([0.0, 0.0, 1.0], 0.3), pose([1.0, 0.3, 0.2], 2.6)];
    let [own, other] = poses.each_ref().map(|p| body_of(&capture(&balls, p)));
    let target = Target {
        body: &other,
        body_from_ray: poses[1] * poses[0].inverse(),
        is_self: false,
    };
    let (mut sum, mut worst, mut count) = (0.0, 0.0_f64, 0.0);
    for ray in own.chosen_rays(30) {
        let found = touch(&own, ray, &[target], None).inside;
        // Every tenth of a millimetre, for all of the ray that may touch.
        let at = |i: i32| ray.eye + ray.direction * (0.2 + 1e-4 * f64::from(i));
        let inside = |p: Point3<f64>| {
            let q = target.body_from_ray * p;
            let height = q.z - other.floor;
            let outlines = other.outlines.iter();
            let cones = outlines.map(|o| o.value(o.in_camera(q)) + doubt(height));
            cones.fold(height.min(p.z - own.floor), f64::min)
        };
        let most = (0..5000).map(|i| inside(at(i)));
        let missed = (most.fold(f64::NEG_INFINITY, f64::max) - found).max(0.0);
        sum += missed;
        worst = worst.max(missed);
        count += 1.0;
    }
    assert!(count > 20.0, "{count}");
    assert!(
        sum / count < 1e-5 && worst < 3e-4,
        "{} {worst}",
        sum / count
    );
}

#[test]
fn outlines_are_doubted_beside_the_table_and_not_above() {
    assert!(doubt(0.0) > 0.0 && doubt(-0.001) == doubt(0.0));
    assert!(doubt(0.002) < doubt(0.001) && doubt(0.004) == 0.0);
}

#[test]
fn what_no_camera_faced_lies_underneath_until_the_body_is_turned_over() {
    let poses = [pose([0.0, 0.0, 1.0], 0.3), pose([1.0, 0.3, 0.2], 2.6)];
    let captures = poses.each_ref().map(|p| capture(&crooked(), p));
    let one = registered(&captures[..1]).unseen;
    assert!(one.share > 0.02 && one.towards.z < -0.5, "{one:?}");
    let both = registered(&captures).unseen;
    assert!(both.share < 0.7 * one.share, "{both:?} {one:?}");
}

#[test]
fn colours_where_an_outline_says_nothing_are_not_taken_for_the_objects() {
    let poses = near_poses();
    let captures = twice(&round(), &poses, stripes);
    let compared = |is_ignored: bool| {
        let [a, b] = captures.each_ref().map(|captured| {
            let body = body_of(captured);
            let (scene, mut silhouettes) = captured.clone();
            for silhouette in &mut silhouettes {
                let unknown = Mask::filled(SIZE.0, SIZE.1, 255);
                silhouette.unknown = is_ignored.then_some(unknown);
            }
            let ignoring = CaptureSilhouettes {
                scene: &scene,
                silhouettes: &silhouettes,
            };
            Skin::new(&ignoring, &body)
        });
        agreement(&a, &b, &(poses[1] * poses[0].inverse()), 1500).points
    };
    assert!(compared(false) > 100);
    assert_eq!(compared(true), 0);
}

#[test]
fn readings_where_an_outline_says_nothing_are_not_taken_for_the_objects() {
    let poses = near_poses();
    let mut captures = poses.map(|pose| hollowed(capture(&round(), &pose), &pose, &[]));
    let compared = |captures: &[(Scene, Vec<Silhouette>); 2]| {
        let [a, b] = captures.each_ref().map(|(scene, silhouettes)| {
            let given = CaptureSilhouettes { scene, silhouettes };
            Depths::new(&given, &Body::new(&given).unwrap())
        });
        contradiction(&a, &b, &(poses[1] * poses[0].inverse()))
    };
    assert!(compared(&captures).is_some());
    for (_, silhouettes) in &mut captures {
        silhouettes[4].unknown = Some(Mask::filled(SIZE.0, SIZE.1, 255));
    }
    assert_eq!(compared(&captures), None);
}
