//! Measures how much of the object no camera faced, and on which side that is.

use super::body::Body;
use nalgebra::{Isometry3, Point3, Vector3};

/// Cosine between normal and view from which on a camera faces a point.
const FACING: f64 = 0.2;
/// Height above the table, as a share of the radius, below which nothing counts as seen.
const ON_TABLE: f64 = 0.01;

/// What no camera faced.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Unseen {
    /// Share of the surface, 0 to 1.
    pub share: f64,
    /// The mean normal of it, in the frame of the last capture's rig; of length 1, or zero where nothing is unseen.
    pub towards: Vector3<f64>,
}

/// What no camera of these bodies faced, of the first one's surface. Poses map a point of the object into each body's
/// rig, `rig_of_last_from_object` into that of the last capture.
pub(super) fn unseen(
    bodies: &[(&Body, Isometry3<f64>)],
    rig_of_last_from_object: &Isometry3<f64>,
) -> Unseen {
    let Some(first) = bodies.first() else {
        return Unseen::default();
    };
    let mesh = &first.0.mesh;
    let from_first = first.1.inverse();
    let (mut all, mut missed, mut towards) = (0.0, 0.0, Vector3::zeros());
    for t in 0..mesh.triangles.len() {
        let [a, b, c] = mesh.corners(t).map(|p| p.cast::<f64>());
        let area = (b - a).cross(&(c - a));
        let middle = a + ((b - a) + (c - a)) / 3.0;
        let size = area.norm();
        if size < 1e-18 {
            continue;
        }
        all += size;
        let faces = |(body, pose): &(&Body, Isometry3<f64>)| {
            let p = pose * (from_first * middle);
            let normal = pose.rotation * (from_first.rotation * (area / size));
            let above = p.z > body.floor + ON_TABLE * body.radius;
            let faced = |eye: Point3<f64>| normal.dot(&(eye - p).normalize()) > FACING;
            above && body.outlines.iter().any(|o| faced(o.eye))
        };
        if !bodies.iter().any(faces) {
            missed += size;
            towards += rig_of_last_from_object.rotation * (from_first.rotation * area);
        }
    }
    Unseen {
        share: missed / f64::max(all, 1e-18),
        towards: towards.try_normalize(1e-12).unwrap_or_default(),
    }
}
