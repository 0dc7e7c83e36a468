//! Which vertices of a hull lie on an edge that the silhouettes show: where many cones are tight and their normals
//! differ. There the surface stays, and may bend.

use super::contour::Contour;
use super::shape::{Role, Shape};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use std::collections::VecDeque;

/// A cone is tight where its contour is within this many pixels.
const TIGHT_PX: f64 = 0.5;
/// Cones that must be tight.
const CONES: usize = 4;
/// Cones that must be tight between two vertices that are certain.
const CONES_BETWEEN: usize = 3;
/// Angle between normals above which the surface bends, at least.
const LEAST_ANGLE: f64 = 25.0;
/// A bend within this share of the object's radius is no edge but a part of its rounding.
const SHARPEST: f64 = 0.2;
/// Certain vertices that hang together must reach this far, in pixels, and as many times the mesh's edges.
const CHAIN_PX: f64 = 8.0;
const CHAIN_EDGES: f64 = 3.0;

/// What the cones say of one vertex.
struct Tight {
    cones: usize,
    /// Largest angle between normals of tight cones, in radians; of those in the table's plane where it is on it.
    angle: f64,
}

/// Gives the vertices of a hull's mesh that lie on certain edges their role. `radius_px` is about the object's
/// radius in pixels, `pixel` the size of a pixel in metres.
pub(super) fn mark(shape: &mut Shape, contours: &[Contour], radius_px: f64, pixel: f64) {
    let least_angle = sharpest_angle(radius_px);
    let vertices = (0..shape.len()).into_par_iter();
    let found: Vec<Tight> = vertices
        .map(|v| tight(shape.positions[v], shape.roles[v], contours))
        .collect();
    let bends = |v: usize, cones: usize| found[v].cones >= cones && found[v].angle > least_angle;
    let mut certain: Vec<bool> = (0..shape.len()).map(|v| shape.moves(v) && bends(v, CONES)).collect();
    let between: Vec<usize> = (0..shape.len())
        .filter(|&v| {
            let beside = shape.around(v).iter().filter(|&&j| certain[j as usize]).count();
            !certain[v] && shape.moves(v) && beside >= 2 && bends(v, CONES_BETWEEN)
        })
        .collect();
    between.into_iter().for_each(|v| certain[v] = true);
    drop_short(shape, &mut certain, pixel);
    for v in 0..shape.len() {
        if certain[v] {
            shape.roles[v] = Role::Edge;
        }
    }
}

/// A smooth surface of radius r lets cones be tight within t whose normals differ by √(8 t / r): an edge is what bends
/// more than the sharpest rounding that an object of this size has.
fn sharpest_angle(radius_px: f64) -> f64 {
    let rounding = (8.0 * TIGHT_PX / (SHARPEST * radius_px).max(1e-6)).sqrt();
    LEAST_ANGLE.to_radians().max(rounding)
}

fn tight(p: Point3<f64>, role: Role, contours: &[Contour]) -> Tight {
    let mut normals: Vec<Vector3<f64>> = Vec::new();
    for contour in contours {
        let Some(offset) = contour.offset(p).filter(|o| o.inside_px < TIGHT_PX) else {
            continue;
        };
        let mut outwards = -offset.gradient;
        if role == Role::Foot {
            outwards.z = 0.0;
        }
        normals.extend(outwards.try_normalize(1e-9));
    }
    let mut angle = 0.0_f64;
    for (i, a) in normals.iter().enumerate() {
        for b in &normals[..i] {
            angle = angle.max(a.dot(b).clamp(-1.0, 1.0).acos());
        }
    }
    Tight {
        cones: normals.len(),
        angle,
    }
}

/// Leaves out groups of certain vertices that do not reach far enough to be an edge.
fn drop_short(shape: &Shape, certain: &mut [bool], pixel: f64) {
    let mut seen = vec![false; certain.len()];
    for start in 0..certain.len() {
        if !certain[start] || seen[start] {
            continue;
        }
        let mut group = vec![start];
        let mut queue = VecDeque::from([start]);
        seen[start] = true;
        while let Some(v) = queue.pop_front() {
            for &j in shape.around(v) {
                let j = j as usize;
                if certain[j] && !std::mem::replace(&mut seen[j], true) {
                    group.push(j);
                    queue.push_back(j);
                }
            }
        }
        let first = shape.positions[start];
        let (low, high) = group.iter().fold((first, first), |(low, high), &v| {
            (low.inf(&shape.positions[v]), high.sup(&shape.positions[v]))
        });
        let edge = shape.around(start).iter().map(|&j| (shape.positions[j as usize] - first).norm());
        let edge = edge.sum::<f64>() / shape.around(start).len().max(1) as f64;
        if (high - low).norm() < (CHAIN_PX * pixel).max(CHAIN_EDGES * edge) {
            group.iter().for_each(|&v| certain[v] = false);
        }
    }
}
