//! A box with a regular mesh on its faces.

use nalgebra::{Point3, Rotation3, Vector3};
use scand_core::mesh::Mesh;
use std::collections::HashMap;

/// A box of edges `size` (metres) that stands on the table, turned about z by `degrees`.
pub(super) fn turned_box(size: [f64; 3], degrees: f64, spacing: f64) -> Mesh {
    let cells = size.map(|s| (s / spacing).ceil().max(1.0) as u32);
    let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), degrees.to_radians());
    let mut builder = Builder {
        mesh: Mesh::default(),
        known: HashMap::new(),
        position: |at: [u32; 3]| {
            let part = |a: usize| f64::from(at[a]) / f64::from(cells[a]) * size[a];
            let p = Point3::new(part(0) - size[0] / 2.0, part(1) - size[1] / 2.0, part(2));
            (turn * p).cast()
        },
    };
    for axis in 0..3 {
        for far in [false, true] {
            builder.face(cells, axis, far);
        }
    }
    builder.mesh
}

struct Builder<F> {
    mesh: Mesh,
    /// Vertices that faces share, by their place on the lattice; only looked up, never walked.
    known: HashMap<[u32; 3], u32>,
    position: F,
}

impl<F: Fn([u32; 3]) -> Point3<f32>> Builder<F> {
    fn face(&mut self, cells: [u32; 3], axis: usize, far: bool) {
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        for j in 0..cells[v] {
            for i in 0..cells[u] {
                let corner = |di: u32, dj: u32| {
                    let mut at = [0; 3];
                    (at[u], at[v]) = (i + di, j + dj);
                    at[axis] = if far { cells[axis] } else { 0 };
                    at
                };
                let ring = [(0, 0), (1, 0), (1, 1), (0, 1)];
                let [a, b, c, d] = ring.map(|(di, dj)| self.vertex(corner(di, dj)));
                let square = if far { [a, b, c, d] } else { [a, d, c, b] };
                let [a, b, c, d] = square;
                self.mesh.triangles.extend([[a, b, c], [a, c, d]]);
            }
        }
    }

    fn vertex(&mut self, at: [u32; 3]) -> u32 {
        *self.known.entry(at).or_insert_with(|| {
            self.mesh.vertices.push((self.position)(at));
            self.mesh.vertices.len() as u32 - 1
        })
    }
}
