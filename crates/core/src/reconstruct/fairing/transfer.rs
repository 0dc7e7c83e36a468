//! Begins a finer mesh on the curved surface that a coarser one became.

use super::curved::{Curved, weights};
use super::shape::{Role, Shape};
use crate::mesh::{Bvh, Mesh};
use nalgebra::Point3;
use rayon::prelude::*;

/// A mesh before and after.
pub(super) struct MovedMesh {
    before: Bvh,
    places: Vec<Point3<f64>>,
    after: Curved,
}

impl MovedMesh {
    /// Of a shape that began at the positions `before`.
    pub(super) fn new(shape: &Shape, before: &[Point3<f64>]) -> Self {
        let mesh = Mesh {
            vertices: before.iter().map(|p| p.cast()).collect(),
            triangles: shape.triangles.clone(),
        };
        Self {
            before: Bvh::new(&mesh),
            places: before.to_vec(),
            after: Curved::new(shape),
        }
    }

    /// Moves the vertices of another mesh of the same surface to where this one's went.
    pub(super) fn begin(&self, shape: &mut Shape) {
        let begun: Vec<Point3<f64>> = (0..shape.len())
            .into_par_iter()
            .map(|v| {
                let p = shape.positions[v];
                let found = shape
                    .moves(v)
                    .then(|| self.before.closest_point(p))
                    .flatten();
                let Some(found) = found else {
                    return p;
                };
                let t = found.triangle;
                let corners = self.after.triangles[t].map(|v| self.places[v as usize]);
                let mut to = self.after.point(t, weights(corners, found.point));
                if shape.roles[v] == Role::Foot {
                    to.z = p.z;
                }
                to
            })
            .collect();
        shape.positions = begun;
    }
}
