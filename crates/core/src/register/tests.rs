//! Tests the registration of bodies made of balls, whose outlines are known exactly, seen by a ring of small cameras.

use super::*;
use crate::calibration::{Camera, Distortion, Intrinsics, Volume};
use crate::frame::CameraId;
use crate::image::{Grid, Mask, RgbImage};
use crate::reconstruct::silhouette::Facts;
use crate::reconstruct::{ColorView, SilhouetteSource};
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
            let hits = balls.iter().filter_map(|(center, radius)| {
                let to_center = center - eye;
                let along = to_center.dot(&ray);
                let squared = radius * radius - (to_center - ray * along).norm_squared();
                (squared > 0.0).then(|| along - squared.sqrt())
            });
            let nearest = hits.fold(f64::INFINITY, f64::min);
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
    let given = |second: Isometry3<f64>| {
        let captures = captures
            .each_ref()
            .map(|(scene, silhouettes)| Some(CaptureSilhouettes { scene, silhouettes }));
        register(&captures, 0, Some(&[poses[0], second])).captures[1].verdict
    };
    assert_eq!(given(poses[1]), Ok(PoseEvidence::Given));
    assert!(given(pose([1.0, 0.3, 0.2], 2.5)).is_err());
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
