//! Laplacian coordinates (equation 7) on a patch of a mesh, and the screened systems that turn them back into
//! positions. `factor` and `iterate` solve them.

use crate::array::three;
use crate::mesh::Mesh;

/// A system that has no solution.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[error("the Laplacian system of {0} vertices is singular: a part of the patch has no anchor")]
pub struct Singular(pub usize);

/// A patch of a mesh: some of its vertices and all their edges.
pub(super) struct Patch {
    /// Vertices of the mesh, ascending: first those of the patch, then the ring around it.
    pub(super) vertices: Vec<u32>,
    /// How many of them are the patch; the others only are its neighbours.
    pub(super) inner: usize,
    /// For each inner vertex its neighbours, as indices into `vertices`, ascending.
    pub(super) neighbours: Vec<Vec<u32>>,
}

impl Patch {
    /// The vertices for which `is_inner` holds, with their neighbours.
    pub(super) fn new(mesh: &Mesh, is_inner: impl Fn(u32) -> bool) -> Self {
        let count = mesh.vertices.len() as u32;
        let mut vertices: Vec<u32> = (0..count).filter(|&v| is_inner(v)).collect();
        let inner = vertices.len();
        let mut index = vec![u32::MAX; count as usize];
        for (i, &v) in vertices.iter().enumerate() {
            index[v as usize] = i as u32;
        }
        let mut neighbours = vec![Vec::new(); inner];
        for t in &mesh.triangles {
            for i in 0..3 {
                for (a, b) in [(t[i], t[(i + 1) % 3]), (t[(i + 1) % 3], t[i])] {
                    let from = index[a as usize] as usize;
                    if from < inner {
                        if index[b as usize] == u32::MAX {
                            index[b as usize] = vertices.len() as u32;
                            vertices.push(b);
                        }
                        neighbours[from].push(index[b as usize]);
                    }
                }
            }
        }
        for around in &mut neighbours {
            around.sort_unstable();
            around.dedup();
        }
        Self {
            vertices,
            inner,
            neighbours,
        }
    }

    /// The inner neighbours of an inner vertex.
    pub(super) fn inner_neighbours(&self, i: usize) -> impl Iterator<Item = usize> {
        let around = self.neighbours[i].iter().map(|&j| j as usize);
        around.filter(|&j| j < self.inner)
    }

    /// Weight of each neighbour in the row of L of an inner vertex, less its sign.
    pub(super) fn share(&self, i: usize) -> f64 {
        1.0 / self.neighbours[i].len().max(1) as f64
    }

    /// Equation 7 with uniform weights: each inner value less the mean of its neighbours' values. `values`
    /// is indexed as `vertices`.
    pub(super) fn laplacian(&self, values: &[[f64; 3]]) -> Vec<[f64; 3]> {
        let of = |i: usize| {
            let around = &self.neighbours[i];
            three(|k| {
                let sum: f64 = around.iter().map(|&j| values[j as usize][k]).sum();
                values[i][k] - sum / around.len().max(1) as f64
            })
        };
        (0..self.inner).map(of).collect()
    }
}

/// A screened system over the inner vertices of a patch: minimise Σ wᵢ |xᵢ - tᵢ|² + μ Σ |L x - δ|², the ring held.
pub(super) struct ScreenedSystem<'a> {
    /// Laplacian coordinates wanted at each inner vertex.
    pub(super) delta: &'a [[f64; 3]],
    /// Weight of the Laplacian coordinates.
    pub(super) delta_weight: f64,
    /// Positions wanted at each inner vertex.
    pub(super) target: &'a [[f64; 3]],
    /// Weights of the positions, a vertex each.
    pub(super) target_weight: &'a [f64],
    /// Positions of the ring, which are kept, in the order of `Patch::vertices` from `inner` on.
    pub(super) ring: &'a [[f64; 3]],
}

impl ScreenedSystem<'_> {
    /// Whether each part of the patch is held somewhere: by a weight, or by a neighbour in the ring. Round-off would
    /// hide it from a factorisation.
    pub(super) fn is_anchored(&self, patch: &Patch) -> bool {
        let held = |&i: &usize| {
            let beside_ring = patch.neighbours[i]
                .iter()
                .any(|&j| j as usize >= patch.inner);
            beside_ring || self.target_weight[i] > 0.0
        };
        let mut reached: Vec<usize> = (0..patch.inner).filter(held).collect();
        let mut is_reached = vec![false; patch.inner];
        reached.iter().for_each(|&i| is_reached[i] = true);
        let mut next = 0;
        while next < reached.len() {
            for j in patch.inner_neighbours(reached[next]) {
                if !std::mem::replace(&mut is_reached[j], true) {
                    reached.push(j);
                }
            }
            next += 1;
        }
        reached.len() == patch.inner
    }

    /// Half of how steeply the sum falls along each inner vertex' coordinates, at positions `x` of the inner
    /// vertices: W (t - x) + μ Lᵀ (δ - L x), which is zero at the solution.
    pub(super) fn descent(&self, patch: &Patch, x: &[[f64; 3]]) -> Vec<[f64; 3]> {
        let all: Vec<[f64; 3]> = x.iter().chain(self.ring).copied().collect();
        let mut off = patch.laplacian(&all);
        for (off, delta) in off.iter_mut().zip(self.delta) {
            *off = three(|k| delta[k] - off[k]);
        }
        let of = |i: usize| {
            let mut sum = off[i];
            for j in patch.inner_neighbours(i) {
                let share = patch.share(j);
                sum = three(|k| sum[k] - share * off[j][k]);
            }
            let weight = self.target_weight[i];
            three(|k| weight * (self.target[i][k] - x[i][k]) + self.delta_weight * sum[k])
        };
        (0..patch.inner).map(of).collect()
    }
}

#[cfg(test)]
pub(super) mod testing {
    use super::*;
    use nalgebra::Point3;

    /// A square sheet of n x n vertices.
    pub(in super::super) fn sheet(n: u32) -> Mesh {
        let vertices = (0..n * n)
            .map(|i| Point3::new((i % n) as f32, (i / n) as f32, 0.0))
            .collect();
        let mut triangles = Vec::new();
        for y in 0..n - 1 {
            for x in 0..n - 1 {
                let a = y * n + x;
                triangles.extend([[a, a + 1, a + n + 1], [a, a + n + 1, a + n]]);
            }
        }
        Mesh {
            vertices,
            triangles,
        }
    }

    /// All of it but its border.
    pub(in super::super) fn inner_of(mesh: &Mesh, n: u32) -> Patch {
        Patch::new(mesh, |v| {
            (1..n - 1).contains(&(v % n)) && (1..n - 1).contains(&(v / n))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::factor::solve;
    use super::testing::{inner_of, sheet};
    use super::*;

    fn positions(patch: &Patch, f: impl Fn(f64, f64) -> f64, mesh: &Mesh) -> Vec<[f64; 3]> {
        let at = |&v: &u32| {
            let p = mesh.vertices[v as usize];
            [f64::from(p.x), f64::from(p.y), f(p.x.into(), p.y.into())]
        };
        patch.vertices.iter().map(at).collect()
    }

    #[test]
    fn positions_come_back_from_their_own_laplacian_coordinates() {
        let mesh = sheet(12);
        let patch = inner_of(&mesh, 12);
        let wanted = positions(&patch, |x, y| (x * 0.7).sin() + 0.3 * y, &mesh);
        let delta = patch.laplacian(&wanted);
        let free = vec![0.0; patch.inner];
        let system = ScreenedSystem {
            delta: &delta,
            delta_weight: 1.0,
            target: &wanted[..patch.inner],
            target_weight: &free,
            ring: &wanted[patch.inner..],
        };
        for (x, w) in solve(&patch, &system).unwrap().iter().zip(&wanted) {
            assert!((0..3).all(|k| (x[k] - w[k]).abs() < 1e-9), "{x:?} {w:?}");
        }
    }

    #[test]
    fn a_surface_that_is_moved_as_a_whole_has_the_same_detail() {
        let mesh = sheet(12);
        let patch = inner_of(&mesh, 12);
        let here = positions(&patch, |x, y| (x * 0.7).sin() + 0.3 * y, &mesh);
        let moved: Vec<[f64; 3]> = here.iter().map(|p| [p[0], p[1], p[2] + 8.0]).collect();
        let free = vec![0.0; patch.inner];
        let restored = |surface: &[[f64; 3]]| {
            let delta = patch.laplacian(surface);
            let system = ScreenedSystem {
                delta: &delta,
                delta_weight: 1.0,
                target: &surface[..patch.inner],
                target_weight: &free,
                ring: &here[patch.inner..],
            };
            solve(&patch, &system).unwrap()
        };
        for (x, y) in restored(&here).iter().zip(restored(&moved)) {
            assert!((0..3).all(|k| (x[k] - y[k]).abs() < 1e-9), "{x:?} {y:?}");
        }
    }

    #[test]
    fn each_part_of_a_patch_needs_an_anchor() {
        // All vertices of the first sheet are inner, so it has no ring; the second one has.
        let (mut mesh, other) = (sheet(5), sheet(4));
        let first = mesh.vertices.len() as u32;
        mesh.vertices.extend(other.vertices);
        let moved = |t: &[u32; 3]| t.map(|v| v + first);
        mesh.triangles.extend(other.triangles.iter().map(moved));
        let patch = Patch::new(&mesh, |v| v < first || [5, 6, 9, 10].contains(&(v - first)));
        let all = positions(&patch, |x, _| x, &mesh);
        let delta = patch.laplacian(&all);
        let solved = |target_weight: &[f64]| {
            let system = ScreenedSystem {
                delta: &delta,
                delta_weight: 1.0,
                target: &all[..patch.inner],
                target_weight,
                ring: &all[patch.inner..],
            };
            solve(&patch, &system)
        };
        let mut weights = vec![0.0; patch.inner];
        assert_eq!(solved(&weights), Err(Singular(patch.inner)));
        weights[7] = 0.1;
        for (x, w) in solved(&weights).unwrap().iter().zip(&all) {
            assert!((0..3).all(|k| (x[k] - w[k]).abs() < 1e-9), "{x:?} {w:?}");
        }
    }
}
