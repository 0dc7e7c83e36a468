//! How far a stated pose is from the true one, apart from turns that change nothing of the object.

use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion};
use scand::mesh::{Bvh, Mesh};
use serde_json::Value;

/// Points of the surface that are compared, about.
const POINTS: usize = 4000;
/// What moves the surface less than this, in metres, moves it nowhere.
const SAME_FORM: f64 = 0.25e-3;

/// The error of a pose.
#[derive(Clone, Copy, Debug)]
pub(super) struct PoseError {
    /// Root of the mean squared distance, in millimetres, of the object's surface moved by the error to itself.
    pub form_mm: f64,
    /// Root of the mean squared distance, in millimetres, by which the error moves points of the surface.
    pub moved_mm: f64,
    /// The error's turn in degrees; of an object without a pattern 0 where the turn changes nothing of its form.
    pub turned_deg: f64,
}

/// A pose as a report has it.
pub(super) fn pose(value: &Value) -> Option<Isometry3<f64>> {
    let numbers = |name: &str| -> Option<Vec<f64>> {
        value[name].as_array()?.iter().map(Value::as_f64).collect()
    };
    let (q, t) = (numbers("rotation")?, numbers("translation")?);
    let [x, y, z, w] = q[..].try_into().ok()?;
    let [tx, ty, tz] = t[..].try_into().ok()?;
    Some(Isometry3::from_parts(
        Translation3::new(tx, ty, tz),
        UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z)),
    ))
}

/// How far `found` is from `truth`, both from the frame in which `surface` is.
pub(super) fn error(
    surface: &Mesh,
    has_pattern: bool,
    truth: &Isometry3<f64>,
    found: &Isometry3<f64>,
) -> PoseError {
    let error = truth.inverse() * found;
    let bvh = Bvh::new(surface);
    let every = (surface.vertices.len() / POINTS).max(1);
    let points = surface
        .vertices
        .iter()
        .step_by(every)
        .map(|v| v.cast::<f64>());
    let (mut form, mut moved, mut count) = (0.0, 0.0, 0.0);
    for p in points {
        let q: Point3<f64> = error * p;
        form += bvh
            .closest_point(q)
            .map_or(f64::INFINITY, |near| near.distance.powi(2));
        moved += (q - p).norm_squared();
        count += 1.0;
    }
    let rms = |sum: f64| (sum / f64::max(count, 1.0)).sqrt();
    let is_same = !has_pattern && rms(form) < SAME_FORM;
    PoseError {
        form_mm: 1e3 * rms(form),
        moved_mm: 1e3 * rms(moved),
        turned_deg: if is_same {
            0.0
        } else {
            error.rotation.angle().to_degrees()
        },
    }
}

#[test]
fn turns_that_change_nothing_count_nothing_and_others_do() {
    let cup = scand_lab::Shape::Cup.mesh(0.002);
    let turn = |degrees: f64| {
        let axis = nalgebra::Vector3::z_axis();
        Isometry3::from_parts(
            Translation3::identity(),
            UnitQuaternion::from_axis_angle(&axis, degrees.to_radians()),
        )
    };
    let truth = turn(10.0);
    let plain = error(&cup, false, &truth, &turn(50.0));
    assert!(plain.form_mm < 0.05 && plain.turned_deg == 0.0, "{plain:?}");
    let painted = error(&cup, true, &truth, &turn(50.0));
    assert!((painted.turned_deg - 40.0).abs() < 1e-6, "{painted:?}");
    assert!(painted.moved_mm > 10.0, "{painted:?}");
    let lifted = Isometry3::from_parts(Translation3::new(0.0, 0.0, 1e-3), truth.rotation);
    let lifted = error(&cup, false, &truth, &lifted);
    assert!((lifted.moved_mm - 1.0).abs() < 1e-6, "{lifted:?}");
    assert!(lifted.form_mm > 0.25, "{lifted:?}");
    let mug = scand_lab::Shape::Mug.mesh(0.002);
    let handle = error(&mug, false, &truth, &turn(20.0));
    assert!(
        handle.turned_deg > 9.0 && handle.form_mm > 0.5,
        "{handle:?}"
    );
}

#[test]
fn a_pose_is_read_as_it_is_written() {
    let written =
        serde_json::json!({"rotation": [0.0, 0.0, 0.0, 1.0], "translation": [0.1, 0.2, 0.3]});
    let read = pose(&written).unwrap();
    assert_eq!(read, Isometry3::translation(0.1, 0.2, 0.3));
    assert_eq!(
        pose(&serde_json::json!({"rotation": [1.0], "translation": []})),
        None
    );
}
