//! Laplacian coordinates (equation 7) on a patch of a mesh, and the screened systems that turn them back into
//! positions. The factorisation is `faer`'s sparse Cholesky.

use crate::mesh::Mesh;
use faer::linalg::solvers::Solve;
use faer::sparse::{SparseColMat, Triplet};
use faer::{Mat, Side};

/// A system that could not be solved.
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
            // In an oriented mesh each edge is met once in either direction.
            for i in 0..3 {
                let (a, b) = (t[i], t[(i + 1) % 3]);
                let from = index[a as usize];
                if (from as usize) < inner {
                    if index[b as usize] == u32::MAX {
                        index[b as usize] = vertices.len() as u32;
                        vertices.push(b);
                    }
                    neighbours[from as usize].push(index[b as usize]);
                }
            }
        }
        neighbours.iter_mut().for_each(|n| n.sort_unstable());
        Self {
            vertices,
            inner,
            neighbours,
        }
    }

    /// Equation 7 with uniform weights: each inner value less the mean of its neighbours' values. `values`
    /// is indexed as `vertices`.
    pub(super) fn laplacian(&self, values: &[[f64; 3]]) -> Vec<[f64; 3]> {
        let of = |i: usize| {
            let around = &self.neighbours[i];
            std::array::from_fn(|k| {
                let sum: f64 = around.iter().map(|&j| values[j as usize][k]).sum();
                values[i][k] - sum / around.len().max(1) as f64
            })
        };
        (0..self.inner).map(of).collect()
    }
}

/// What a screened system asks of the inner vertices of a patch.
pub(super) struct Screened<'a> {
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

/// Minimises Σ wᵢ |xᵢ - tᵢ|² + μ Σ |L x - δ|² over the inner vertices of a patch, the ring held.
pub(super) fn solve(patch: &Patch, system: &Screened) -> Result<Vec<[f64; 3]>, Singular> {
    let n = patch.inner;
    if n == 0 {
        return Ok(Vec::new());
    }
    let singular = || Singular(n);
    let mut triplets = Vec::with_capacity(60 * n);
    let mut right = Mat::<f64>::zeros(n, 3);
    for i in 0..n {
        triplets.push(Triplet::new(i, i, system.target_weight[i]));
        for k in 0..3 {
            right[(i, k)] += system.target_weight[i] * system.target[i][k];
        }
        add_row(patch, system, i, &mut triplets, &mut right);
    }
    let matrix = SparseColMat::<usize, f64>::try_new_from_triplets(n, n, &triplets)
        .map_err(|_| singular())?;
    let factor = matrix.sp_cholesky(Side::Lower).map_err(|_| singular())?;
    let x = factor.solve(&right);
    let solution: Vec<[f64; 3]> = (0..n).map(|i| std::array::from_fn(|k| x[(i, k)])).collect();
    let finite = solution.iter().flatten().all(|v| v.is_finite());
    if finite {
        Ok(solution)
    } else {
        Err(singular())
    }
}

/// Adds μ (row i of L)ᵀ (row i of L) and its share of the right side; the ring's values are known.
fn add_row(
    patch: &Patch,
    system: &Screened,
    i: usize,
    triplets: &mut Vec<Triplet<usize, usize, f64>>,
    right: &mut Mat<f64>,
) {
    let around = &patch.neighbours[i];
    if around.is_empty() {
        return;
    }
    let share = -1.0 / around.len() as f64;
    let mut known = system.delta[i];
    let mut row = vec![(i, 1.0)];
    for &j in around {
        let j = j as usize;
        if j < patch.inner {
            row.push((j, share));
        } else {
            for (value, ring) in known.iter_mut().zip(system.ring[j - patch.inner]) {
                *value -= share * ring;
            }
        }
    }
    for &(a, weight_a) in &row {
        for k in 0..3 {
            right[(a, k)] += system.delta_weight * weight_a * known[k];
        }
        for &(b, weight_b) in &row {
            if b <= a {
                triplets.push(Triplet::new(
                    a,
                    b,
                    system.delta_weight * weight_a * weight_b,
                ));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;

    /// A square sheet of n x n vertices.
    pub(crate) fn sheet(n: u32) -> Mesh {
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

    fn inner_of(mesh: &Mesh, n: u32) -> Patch {
        Patch::new(mesh, |v| {
            (1..n - 1).contains(&(v % n)) && (1..n - 1).contains(&(v / n))
        })
    }

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
        let system = Screened {
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
    fn a_patch_without_anchor_is_singular_and_says_so() {
        // All vertices are inner, so there is no ring, and no weight holds any.
        let mesh = sheet(5);
        let patch = Patch::new(&mesh, |_| true);
        let delta = vec![[0.0; 3]; patch.inner];
        let system = Screened {
            delta: &delta,
            delta_weight: 1.0,
            target: &delta,
            target_weight: &vec![0.0; patch.inner],
            ring: &[],
        };
        let solved = solve(&patch, &system);
        // Round-off may hide the singularity from the factorisation; the solution is then the null vector.
        assert!(
            solved
                .as_ref()
                .map_or(true, |x| x.iter().flatten().all(|v| v.abs() < 1e-6)),
            "{solved:?}"
        );
    }
}
