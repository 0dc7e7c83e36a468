//! Small motions, evenly spread rotations, and how far a motion moves a surface.

use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion, Vector3, Vector6};

/// A motion as six numbers: a translation in metres, then a rotation vector in radians, about a fixed centre.
pub(super) type Twist = Vector6<f64>;

/// A pose after a small motion about `center`, which lies in the frame that the pose maps to.
pub(super) fn moved(pose: &Isometry3<f64>, center: Point3<f64>, twist: &Twist) -> Isometry3<f64> {
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(twist[3], twist[4], twist[5]));
    let shift = Vector3::new(twist[0], twist[1], twist[2]);
    // x -> turn (x - center) + center + shift, after the pose.
    let translation = turn * (pose.translation.vector - center.coords) + center.coords + shift;
    Isometry3::from_parts(
        Translation3::from(translation),
        renormalized(turn * pose.rotation),
    )
}

fn renormalized(rotation: UnitQuaternion<f64>) -> UnitQuaternion<f64> {
    UnitQuaternion::from_quaternion(rotation.into_inner())
}

/// Rotations spread evenly over all of them: super-Fibonacci spirals (Alexa 2022).
pub(super) fn rotations(count: usize) -> impl Iterator<Item = UnitQuaternion<f64>> {
    const PSI: f64 = 1.533_751_168_755_204_3;
    (0..count).map(move |i| {
        let s = i as f64 + 0.5;
        let t = s / count as f64;
        let d = std::f64::consts::TAU * s;
        let (r, big_r) = (t.sqrt(), (1.0 - t).sqrt());
        let (alpha, beta) = (d / std::f64::consts::SQRT_2, d / PSI);
        UnitQuaternion::from_quaternion(Quaternion::new(
            big_r * beta.cos(),
            r * alpha.sin(),
            r * alpha.cos(),
            big_r * beta.sin(),
        ))
    })
}

/// Root of the mean square distance between the places that two poses give to points.
pub(super) fn displacement(a: &Isometry3<f64>, b: &Isometry3<f64>, points: &[Point3<f64>]) -> f64 {
    let sum: f64 = points.iter().map(|p| (a * p - b * p).norm_squared()).sum();
    (sum / points.len().max(1) as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_rotation_is_far_from_one_of_the_list() {
        let list: Vec<_> = rotations(1500).collect();
        let worst = rotations(377).map(|r| {
            let nearest = list.iter().map(|q| q.angle_to(&r));
            nearest.fold(f64::INFINITY, f64::min)
        });
        let worst = worst.fold(0.0, f64::max).to_degrees();
        assert!(worst < 18.0, "{worst}");
    }

    #[test]
    fn a_turn_about_a_centre_leaves_the_centre() {
        let center = Point3::new(0.1, 0.2, 0.3);
        let pose = Isometry3::translation(0.0, 0.0, 0.1);
        let twist = Twist::new(0.0, 0.0, 0.0, 0.0, 0.0, 0.5);
        let at = moved(&pose, center, &twist) * (pose.inverse() * center);
        assert!((at - center).norm() < 1e-12);
    }
}
