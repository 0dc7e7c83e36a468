//! Solves screened systems directly, however weakly their vertices are anchored: the sparse Cholesky factorisation
//! of `nalgebra-sparse`, in the order that an approximate minimum degree gives.

use super::laplacian::{Patch, ScreenedSystem, Singular};
use crate::array::three;
use nalgebra::DMatrix;
use nalgebra_sparse::CscMatrix;
use nalgebra_sparse::factorization::CscCholesky;
use rayon::prelude::*;

/// Positions of the inner vertices.
///
/// # Errors
/// If a part of the patch has no anchor.
pub(super) fn solve(patch: &Patch, system: &ScreenedSystem) -> Result<Vec<[f64; 3]>, Singular> {
    let n = patch.inner;
    if !system.is_anchored(patch) {
        return Err(Singular(n));
    }
    let columns: Vec<Column> = (0..n)
        .into_par_iter()
        .map(|b| column(patch, system, b))
        .collect();
    let order = Order::new(&columns).ok_or(Singular(n))?;
    let right = system.descent(patch, &vec![[0.0; 3]; n]);
    let right = DMatrix::from_fn(n, 3, |i, k| right[order.old[i]][k]);
    let matrix = order.permuted(columns).ok_or(Singular(n))?;
    let factor = CscCholesky::factor(&matrix).map_err(|_| Singular(n))?;
    let x = factor.solve(&right);
    if x.iter().all(|v| v.is_finite()) {
        Ok((0..n).map(|i| three(|k| x[(order.new[i], k)])).collect())
    } else {
        Err(Singular(n))
    }
}

/// Rows, ascending, and values of a column of diag(w) + μ LᵀL.
type Column = Vec<(usize, f64)>;

fn column(patch: &Patch, system: &ScreenedSystem, b: usize) -> Column {
    let mut entries = vec![(b, system.target_weight[b])];
    // The rows of L that hold b: its own, and those of its neighbours, of whom it is one.
    for i in patch.inner_neighbours(b).chain([b]) {
        let of = |j: usize| if j == i { 1.0 } else { -patch.share(i) };
        let here = system.delta_weight * of(b);
        let row = patch.inner_neighbours(i).chain([i]);
        entries.extend(row.map(|a| (a, here * of(a))));
    }
    entries.sort_by_key(|&(a, _)| a);
    let groups = entries.chunk_by(|x, y| x.0 == y.0);
    groups
        .map(|group| (group[0].0, group.iter().map(|&(_, v)| v).sum()))
        .collect()
}

/// The order in which unknowns are eliminated.
struct Order {
    /// For each place in it the unknown.
    old: Vec<usize>,
    /// For each unknown its place.
    new: Vec<usize>,
}

impl Order {
    /// An order that keeps the factor sparse; `None` if the pattern is invalid.
    fn new(columns: &[Column]) -> Option<Self> {
        let starts = starts(columns);
        let starts: Vec<i64> = starts.into_iter().map(|s| s as i64).collect();
        let rows: Vec<i64> = columns.iter().flatten().map(|&(a, _)| a as i64).collect();
        let control = amd::Control::default();
        let (old, new, _) = amd::order(columns.len() as i64, &starts, &rows, &control).ok()?;
        let index = |order: Vec<i64>| order.into_iter().map(|i| i as usize).collect();
        Some(Self {
            old: index(old),
            new: index(new),
        })
    }

    /// All columns as a matrix, rows and columns in this order.
    fn permuted(&self, mut columns: Vec<Column>) -> Option<CscMatrix<f64>> {
        let n = columns.len();
        let columns: Vec<Column> = self
            .old
            .iter()
            .map(|&b| {
                let mut column = std::mem::take(&mut columns[b]);
                column.iter_mut().for_each(|(a, _)| *a = self.new[*a]);
                column.sort_by_key(|&(a, _)| a);
                column
            })
            .collect();
        let (rows, values) = columns.iter().flatten().copied().unzip();
        CscMatrix::try_from_csc_data(n, n, starts(&columns), rows, values).ok()
    }
}

/// Where each column begins among all entries, and their number.
fn starts(columns: &[Column]) -> Vec<usize> {
    let mut starts = vec![0];
    starts.extend(columns.iter().scan(0, |end, column| {
        *end += column.len();
        Some(*end)
    }));
    starts
}
