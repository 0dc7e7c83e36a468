//! Puts an object down on the table in a pose, so that it rests there as a real body would after being let go.

use super::pose::Pose;
use super::random::Random;
use super::rest::RestingPoses;
use super::rig::Bounds;
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use scand_core::mesh::Mesh;
use std::f64::consts::TAU;

/// Largest distance in metres of an object from the middle, along each side of the table.
const SHIFT: f64 = 0.010;

/// Where a pose puts an object of the given surface as capture `index` of a session. The first capture is not
/// shifted; an upright one is then the object as it was made.
pub(super) fn rig_from_shape(
    pose: Pose,
    index: usize,
    shape: &Mesh,
    rests: &RestingPoses,
    seed: u64,
) -> Isometry3<f64> {
    let mut random = Random::new(&[seed, 21, index as u64]);
    let mut beside = || match index {
        0 => 0.0,
        _ => random.between(-SHIFT, SHIFT),
    };
    let shift = Vector3::new(beside(), beside(), 0.0);
    let any_turn = random.between(0.0, TAU);
    let down = match pose {
        Pose::Upright => return turned(0.0, shift),
        Pose::Turn(degrees) => return turned(degrees.to_radians(), shift),
        Pose::Flip => Vector3::z(),
        Pose::Side(azimuth) => {
            let azimuth = azimuth.map_or_else(|| random.between(0.0, TAU), f64::to_radians);
            Vector3::new(azimuth.cos(), azimuth.sin(), 0.0)
        }
        Pose::Any => direction(&mut random),
    };
    let laid = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), any_turn)
        * turn_down(rests.nearest(down));
    let bounds = Bounds::of(&moved(
        shape,
        &Isometry3::from_parts(Translation3::identity(), laid),
    ));
    let middle = bounds.center();
    let onto_table = Vector3::new(-middle.x, -middle.y, -bounds.min.z) + shift;
    Isometry3::from_parts(onto_table.into(), laid)
}

fn turned(angle: f64, shift: Vector3<f64>) -> Isometry3<f64> {
    let turn = match angle == 0.0 {
        true => UnitQuaternion::identity(),
        false => UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle),
    };
    Isometry3::from_parts(shift.into(), turn)
}

/// The shortest turn that makes a direction look down.
fn turn_down(direction: Vector3<f64>) -> UnitQuaternion<f64> {
    let half_turn = || UnitQuaternion::from_scaled_axis(Vector3::x() * std::f64::consts::PI);
    UnitQuaternion::rotation_between(&direction, &-Vector3::z()).unwrap_or_else(half_turn)
}

fn direction(random: &mut Random) -> Vector3<f64> {
    let v = Vector3::from_fn(|_, _| random.normal());
    v.try_normalize(1e-9).unwrap_or_else(Vector3::z)
}

/// A mesh elsewhere.
pub(super) fn moved(mesh: &Mesh, to: &Isometry3<f64>) -> Mesh {
    let vertices = mesh.vertices.iter();
    Mesh {
        vertices: vertices.map(|v| (to * v.cast::<f64>()).cast()).collect(),
        triangles: mesh.triangles.clone(),
    }
}
