//! Laplacian coordinates (equation 7) on a patch of a mesh, and the screened systems that turn them back into
//! positions. The factorisation is `faer`'s sparse Cholesky.

use crate::mesh::Mesh;
use faer::linalg::solvers::Solve;
use faer::sparse::{SparseColMat, SymbolicSparseColMat};
use faer::{Mat, Side};
use rayon::prelude::*;
use std::ops::Range;

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

    /// Weight of each neighbour in the row of L of an inner vertex.
    fn share(&self, i: usize) -> f64 {
        -1.0 / self.neighbours[i].len().max(1) as f64
    }

    /// The row of L of an inner vertex, as far as it is over inner vertices: columns and weights.
    fn row(&self, i: usize) -> impl Iterator<Item = (usize, f64)> {
        let around = &self.neighbours[i];
        let share = self.share(i);
        let own = (!around.is_empty()).then_some((i, 1.0));
        let others = around.iter().map(|&j| j as usize);
        let inner = others.filter(|&j| j < self.inner);
        own.into_iter().chain(inner.map(move |j| (j, share)))
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
    let known: Vec<[f64; 3]> = (0..n).map(|i| known_side(patch, system, i)).collect();
    let columns: Vec<Columns> = (0..n.div_ceil(COLUMNS))
        .into_par_iter()
        .map(|task| task * COLUMNS..n.min((task + 1) * COLUMNS))
        .map(|range| Columns::new(patch, system, &known, range))
        .collect();
    let rights: Vec<&[f64; 3]> = columns.iter().flat_map(|c| &c.right).collect();
    let right = Mat::from_fn(n, 3, |i, k| rights[i][k]);
    let matrix = joined(n, &columns);
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

/// δᵢ less what the ring adds to row i of L x: the part of the row that is known.
fn known_side(patch: &Patch, system: &Screened, i: usize) -> [f64; 3] {
    let share = patch.share(i);
    let mut known = system.delta[i];
    for &j in &patch.neighbours[i] {
        if let Some(ring) = (j as usize).checked_sub(patch.inner) {
            (0..3).for_each(|k| known[k] -= share * system.ring[ring][k]);
        }
    }
    known
}

/// Columns that one task makes.
const COLUMNS: usize = 1024;

/// Some columns of the lower half of diag(w) + μ LᵀL, and their right sides. They are made one after the other, in
/// order: summing up entries that come in any order took as long as the factorisation.
#[derive(Default)]
struct Columns {
    lengths: Vec<usize>,
    rows: Vec<usize>,
    values: Vec<f64>,
    right: Vec<[f64; 3]>,
}

impl Columns {
    fn new(patch: &Patch, system: &Screened, known: &[[f64; 3]], range: Range<usize>) -> Self {
        let mut columns = Self::default();
        let mut entries = Vec::new();
        for b in range {
            let weight = system.target_weight[b];
            let mut right = system.target[b].map(|t| weight * t);
            entries.clear();
            entries.push((b, weight));
            // The rows of L that hold b: its own, and those of its neighbours, of whom it is one.
            for i in patch.row(b).map(|(i, _)| i) {
                let here = if i == b { 1.0 } else { patch.share(i) };
                let here = system.delta_weight * here;
                (0..3).for_each(|k| right[k] += here * known[i][k]);
                let below = patch.row(i).filter(|&(a, _)| a >= b);
                entries.extend(below.map(|(a, there)| (a, here * there)));
            }
            entries.sort_by_key(|&(a, _)| a);
            let before = columns.rows.len();
            for group in entries.chunk_by(|x, y| x.0 == y.0) {
                columns.rows.push(group[0].0);
                columns.values.push(group.iter().map(|&(_, v)| v).sum());
            }
            columns.lengths.push(columns.rows.len() - before);
            columns.right.push(right);
        }
        columns
    }
}

/// All columns as a matrix.
fn joined(n: usize, columns: &[Columns]) -> SparseColMat<usize, f64> {
    let mut starts = vec![0];
    let lengths = columns.iter().flat_map(|c| &c.lengths);
    starts.extend(lengths.scan(0, |end, &length| {
        *end += length;
        Some(*end)
    }));
    let rows = columns.iter().flat_map(|c| &c.rows).copied().collect();
    let values = columns.iter().flat_map(|c| &c.values).copied().collect();
    let pattern = SymbolicSparseColMat::new_checked(n, n, starts, None, rows);
    SparseColMat::new(pattern, values)
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
