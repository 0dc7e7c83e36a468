//! Finds the triangles around a vertex and beside a triangle, and smooths over them.

use super::Mesh;
use nalgebra::Vector3;
use rayon::prelude::*;

/// What is across a side where there is no triangle.
pub const NO_TRIANGLE: u32 = u32::MAX;

/// The corners around each vertex; a corner is three times its triangle plus which of its corners it is.
pub struct Rings {
    starts: Vec<u32>,
    corners: Vec<u32>,
    /// For each corner the vertex that follows in its triangle.
    next: Vec<u32>,
}

impl Rings {
    /// Sorts a mesh's corners by vertex, in linear time.
    pub fn new(mesh: &Mesh) -> Self {
        let flat = mesh.triangles.as_flattened();
        let mut starts = vec![0_u32; mesh.vertices.len() + 1];
        for &v in flat {
            starts[v as usize + 1] += 1;
        }
        for v in 0..mesh.vertices.len() {
            starts[v + 1] += starts[v];
        }
        let mut free = starts.clone();
        let mut corners = vec![0; flat.len()];
        let mut next = vec![0; flat.len()];
        for (triangle, t) in mesh.triangles.iter().enumerate() {
            for i in 0..3 {
                let slot = &mut free[t[i] as usize];
                corners[*slot as usize] = (3 * triangle + i) as u32;
                next[*slot as usize] = t[(i + 1) % 3];
                *slot += 1;
            }
        }
        Self {
            starts,
            corners,
            next,
        }
    }

    fn range(&self, vertex: usize) -> std::ops::Range<usize> {
        self.starts[vertex] as usize..self.starts[vertex + 1] as usize
    }

    /// The triangles around a vertex.
    pub fn triangles(&self, vertex: usize) -> impl Iterator<Item = usize> {
        self.corners[self.range(vertex)]
            .iter()
            .map(|c| *c as usize / 3)
    }

    /// The vertices around a vertex: on a closed mesh each of them once.
    pub fn neighbors(&self, vertex: usize) -> impl Iterator<Item = usize> {
        self.next[self.range(vertex)].iter().map(|v| *v as usize)
    }

    /// For each triangle the ones across its three sides; [`NO_TRIANGLE`] where there is none.
    pub fn across(&self, mesh: &Mesh) -> Vec<[u32; 3]> {
        let beside = |t: &[u32; 3]| [0, 1, 2].map(|i| self.on_side(t[(i + 1) % 3], t[i]));
        mesh.triangles.par_iter().map(beside).collect()
    }

    /// The triangle that runs from vertex `from` to `to`.
    fn on_side(&self, from: u32, to: u32) -> u32 {
        let found = self.range(from as usize).find(|&i| self.next[i] == to);
        found.map_or(NO_TRIANGLE, |i| self.corners[i] / 3)
    }

    /// The normals of vertices, of which each is the mean over itself and its neighbours, three times over.
    pub fn smoothed_normals(&self, mesh: &Mesh, normals: &[Vector3<f32>]) -> Vec<Vector3<f32>> {
        const PASSES: usize = 3;
        let mut current = normals.to_vec();
        for _ in 0..PASSES {
            let mean = |v: usize| {
                let around = self.neighbors(v).map(|n| current[n]);
                let sum = around.fold(current[v], |sum, n| sum + n);
                sum.try_normalize(1e-6).unwrap_or(current[v])
            };
            current = (0..mesh.vertices.len()).into_par_iter().map(mean).collect();
        }
        current
    }
}
