//! Solves screened systems in which the depth anchors every vertex: conjugate gradients, preconditioned by the
//! diagonal (Saad, Iterative Methods for Sparse Linear Systems, 2003, algorithm 9.1), for the three coordinates
//! side by side. No factorisation is needed.

use super::laplacian::{Patch, ScreenedSystem, Singular};
use crate::array::three;
use rayon::prelude::*;

/// What is left of the residual, against the first one: some nanometres of the millimetres that depth is moved.
const TOLERANCE: f64 = 1e-6;
/// Far more steps than weights and smoothness that make sense need.
const MOST_STEPS: usize = 2000;
/// Vertices that one task takes.
const TASK: usize = 1024;

/// Positions of the inner vertices.
///
/// # Errors
/// If a part of the patch is held so weakly that no solution is found.
pub(super) fn solve(patch: &Patch, system: &ScreenedSystem) -> Result<Vec<[f64; 3]>, Singular> {
    let operator = Operator::new(patch, system);
    let mut x = system.target.to_vec();
    let mut residual = system.descent(patch, &x);
    let mut direction = operator.preconditioned(&residual);
    let mut size = dot(&residual, &direction);
    let goal = size.map(|s| s * TOLERANCE * TOLERANCE);
    for _ in 0..MOST_STEPS {
        if (0..3).all(|k| size[k] <= goal[k]) {
            return Ok(x);
        }
        let image = operator.apply(&direction);
        let curvature = dot(&direction, &image);
        let step = three(|k| ratio(size[k], curvature[k]));
        add(&mut x, step, &direction);
        add(&mut residual, step.map(|s| -s), &image);
        let next = operator.preconditioned(&residual);
        let last = std::mem::replace(&mut size, dot(&residual, &next));
        let keep = three(|k| ratio(size[k], last[k]));
        let pairs = direction.par_iter_mut().with_min_len(TASK).zip(&next);
        pairs.for_each(|(d, n)| *d = three(|k| n[k] + keep[k] * d[k]));
    }
    Err(Singular(patch.inner))
}

/// A coordinate that has converged does not change any more.
fn ratio(a: f64, b: f64) -> f64 {
    if b > 0.0 { a / b } else { 0.0 }
}

/// Per coordinate; tasks' sums are added in order, so that the sum does not depend on threads.
fn dot(a: &[[f64; 3]], b: &[[f64; 3]]) -> [f64; 3] {
    let of_task = |(a, b): (&[[f64; 3]], &[[f64; 3]])| {
        let products = a.iter().zip(b);
        products.fold([0.0; 3], |sum, (a, b)| three(|k| sum[k] + a[k] * b[k]))
    };
    let tasks = a.par_chunks(TASK).zip(b.par_chunks(TASK));
    let sums: Vec<[f64; 3]> = tasks.map(of_task).collect();
    sums.iter()
        .fold([0.0; 3], |all, sum| three(|k| all[k] + sum[k]))
}

fn add(to: &mut [[f64; 3]], factor: [f64; 3], what: &[[f64; 3]]) {
    let pairs = to.par_iter_mut().with_min_len(TASK).zip(what);
    pairs.for_each(|(to, what)| *to = three(|k| to[k] + factor[k] * what[k]));
}

/// diag(w) + μ LᵀL, which is never written down.
struct Operator<'a> {
    weights: &'a [f64],
    smoothness: f64,
    /// Where each vertex' inner neighbours begin in `neighbours`, and their number.
    starts: Vec<u32>,
    neighbours: Vec<u32>,
    shares: Vec<f64>,
    inverse_diagonal: Vec<f64>,
}

impl<'a> Operator<'a> {
    fn new(patch: &Patch, system: &'a ScreenedSystem) -> Self {
        let n = patch.inner;
        let (mut starts, mut neighbours) = (Vec::with_capacity(n + 1), Vec::with_capacity(6 * n));
        let shares: Vec<f64> = (0..n).map(|i| patch.share(i)).collect();
        let mut inverse_diagonal = Vec::with_capacity(n);
        for i in 0..n {
            starts.push(neighbours.len() as u32);
            neighbours.extend(patch.inner_neighbours(i).map(|j| j as u32));
            let squares = patch.inner_neighbours(i).map(|j| shares[j] * shares[j]);
            let laplacian = 1.0 + squares.sum::<f64>();
            let diagonal = system.target_weight[i] + system.delta_weight * laplacian;
            inverse_diagonal.push(diagonal.recip());
        }
        starts.push(neighbours.len() as u32);
        Self {
            weights: system.target_weight,
            smoothness: system.delta_weight,
            starts,
            neighbours,
            shares,
            inverse_diagonal,
        }
    }

    fn around(&self, i: usize) -> &[u32] {
        &self.neighbours[self.starts[i] as usize..self.starts[i + 1] as usize]
    }

    fn apply(&self, x: &[[f64; 3]]) -> Vec<[f64; 3]> {
        let n = x.len();
        // Each inner vertex' Laplacian coordinates, the ring at zero.
        let of_row = |i: usize| {
            let sum = sum(self.around(i), |j| x[j]);
            three(|k| x[i][k] - self.shares[i] * sum[k])
        };
        let rows = (0..n).into_par_iter().with_min_len(TASK);
        let laplacian: Vec<[f64; 3]> = rows.map(of_row).collect();
        let of_column = |i: usize| {
            let sum = sum(self.around(i), |j| {
                three(|k| self.shares[j] * laplacian[j][k])
            });
            three(|k| self.weights[i] * x[i][k] + self.smoothness * (laplacian[i][k] - sum[k]))
        };
        let columns = (0..n).into_par_iter().with_min_len(TASK);
        columns.map(of_column).collect()
    }

    fn preconditioned(&self, residual: &[[f64; 3]]) -> Vec<[f64; 3]> {
        let pairs = residual
            .par_iter()
            .with_min_len(TASK)
            .zip(&self.inverse_diagonal);
        pairs.map(|(r, d)| three(|k| r[k] * d)).collect()
    }
}

#[inline(always)]
fn sum(indices: &[u32], value: impl Fn(usize) -> [f64; 3]) -> [f64; 3] {
    indices.iter().fold([0.0; 3], |sum, &j| {
        let value = value(j as usize);
        three(|k| sum[k] + value[k])
    })
}

#[cfg(test)]
mod tests {
    use super::super::laplacian::testing::{inner_of, sheet};
    use super::*;

    #[test]
    fn conjugate_gradients_find_what_the_factorisation_finds() {
        let mesh = sheet(60);
        let patch = inner_of(&mesh, 60);
        // Millimetres of noise, and weights from one end to the other of those that depth has.
        let noise = |i: usize, k: usize| ((i * 37 + k * 101) % 97) as f64 * 2e-5;
        let target: Vec<[f64; 3]> = (0..patch.inner).map(|i| three(|k| noise(i, k))).collect();
        let weights: Vec<f64> = (0..patch.inner).map(|i| [0.05, 1.0, 4.0][i % 3]).collect();
        for smoothness in [0.1, 1.0, 100.0] {
            let system = ScreenedSystem {
                delta: &vec![[0.0; 3]; patch.inner],
                delta_weight: smoothness,
                target: &target,
                target_weight: &weights,
                ring: &vec![[1e-3; 3]; patch.vertices.len() - patch.inner],
            };
            let exact = super::super::factor::solve(&patch, &system).unwrap();
            let found = solve(&patch, &system).unwrap();
            let off = exact.as_flattened().iter().zip(found.as_flattened());
            let worst = off.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            assert!(worst < 1e-7, "{worst} at smoothness {smoothness}");
        }
    }

    #[test]
    fn what_is_not_finite_is_refused() {
        let mesh = sheet(40);
        let patch = Patch::new(&mesh, |_| true);
        let target: Vec<[f64; 3]> = (0..patch.inner).map(|i| [(i % 7) as f64; 3]).collect();
        let system = ScreenedSystem {
            delta: &vec![[f64::NAN; 3]; patch.inner],
            delta_weight: 1.0,
            target: &target,
            target_weight: &vec![0.0; patch.inner],
            ring: &[],
        };
        assert_eq!(solve(&patch, &system), Err(Singular(patch.inner)));
    }
}
