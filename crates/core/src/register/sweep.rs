//! Looks for poses that the search missed. An object that is round but for something small, such as a notch in its rim,
//! has hulls that are nearly alike at all turns about its axis, and may be upside-down as well. So few of the turns
//! that the search keeps are near the right one, and a refinement from farther away than the notch is wide does not see
//! it.

use super::align::{Aligned, Rays, align};
use super::body::Body;
use super::determination::{Turns, axis};
use super::motion::{Twist, moved};
use nalgebra::{UnitVector3, Vector3};
use rayon::prelude::*;
use std::f64::consts::PI;

/// Degrees between turns that are refined.
const STEP_DEG: f64 = 5.0;

/// Poses all the way round in the direction in which the silhouettes hold `best` least, and the same upside-down, each
/// on the silhouettes by few rays.
pub(super) fn around(a: &Body, b: &Body, best: &Aligned) -> Vec<Aligned> {
    let softest = best.softest()[0].0;
    let upside_down = axis(&softest).map(|axis| {
        let half_turn = across(&axis) * PI;
        let twist = Twist::new(0.0, 0.0, 0.0, half_turn.x, half_turn.y, half_turn.z);
        let pose = moved(&best.pose, b.center, &twist);
        align(a, b, pose, Rays::SOME, Some(&softest))
    });
    let starts: Vec<_> = std::iter::once(best.clone())
        .chain(upside_down)
        .flat_map(|pose| {
            let turns = Turns::of(a, b, &pose, &pose.softest()[0].0);
            turns.bearable(a, b, STEP_DEG, f64::INFINITY)
        })
        .collect();
    let refined = starts.par_iter();
    refined
        .map(|pose| align(a, b, *pose, Rays::FEW, None))
        .collect()
}

/// A unit direction across an axis.
fn across(axis: &UnitVector3<f64>) -> Vector3<f64> {
    let aside = Vector3::ith(axis.iamin(), 1.0);
    axis.cross(&aside).normalize()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_across_an_axis_has_no_part_along_it() {
        for axis in [Vector3::x(), Vector3::new(0.3, -0.2, 0.9)] {
            let axis = UnitVector3::new_normalize(axis);
            let across = across(&axis);
            assert!(across.dot(&axis).abs() < 1e-12 && (across.norm() - 1.0).abs() < 1e-12);
        }
    }
}
