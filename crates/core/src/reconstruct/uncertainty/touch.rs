//! Viewing edges. A viewing edge is the part of a camera's viewing ray, along the hull's surface, that lies in the
//! hull: the true surface touches it at least once. The position of that touch determines how far the true surface is
//! from the rest of the edge. At an end where the outlines of three cameras or more meet at an angle, the object has an
//! edge, and touches there.

use crate::reconstruct::hull::Hull;
use nalgebra::Point3;

/// A viewing edge, as it is seen from a point on it.
#[derive(Clone, Copy, Debug)]
pub(super) struct ViewingEdge {
    /// Its ends, towards the camera and away from it.
    pub ends: [End; 2],
}

/// An end of a viewing edge.
#[derive(Clone, Copy, Debug)]
pub(super) struct End {
    /// How far it is from the point, in metres.
    pub distance: f64,
    /// Sine of the angle by which the hull's surface turns there, in the plane of the ray and the surface's normal.
    pub turn: f64,
    /// Whether the object has an edge there, which the viewing edge touches.
    pub is_certain: bool,
}

/// Pixels within which outlines meet.
const MEETING_PX: f64 = 1.5;
/// Cosine of the angle beyond which another cone's normal is another side of the object: 0.3 radians.
const OTHER_SIDE: f64 = 0.955;
/// Other sides that meet at an edge of the object: by chance it is one, that of the cone that ends the viewing edge.
const LEAST_OTHERS: usize = 2;

impl ViewingEdge {
    /// The viewing edge through a point of the hull's surface, in steps of so many metres; `None` where it is not a
    /// cone that bounds the hull.
    pub(super) fn through(hull: &Hull, p: Point3<f64>, step: f64) -> Option<Self> {
        let (camera, normal) = hull.bounding_camera(p)?;
        let eye = hull.cones()[camera].camera().center();
        let ray = (p - eye).try_normalize(1e-9)?;
        let ends = [-ray, ray].map(|along| {
            let exit = hull.exit(p, along, camera, step);
            let cosine = exit.normal.dot(&normal);
            let outwards = exit.normal.dot(&along).max(0.0);
            // A turn of more than a right angle bounds no more than that does.
            let turn = if cosine > 0.0 {
                outwards / outwards.hypot(cosine)
            } else {
                1.0
            };
            let others = hull.outlines_near(p + along * exit.distance, MEETING_PX);
            let is_other = |(i, n): &(usize, nalgebra::Vector3<f64>)| {
                *i != camera && n.dot(&normal) < OTHER_SIDE
            };
            End {
                distance: exit.distance,
                turn: if turn.is_finite() { turn } else { 0.0 },
                is_certain: others.filter(is_other).take(LEAST_OTHERS).count() == LEAST_OTHERS,
            }
        });
        Some(Self { ends })
    }
}
