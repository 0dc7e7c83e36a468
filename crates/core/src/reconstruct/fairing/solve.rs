//! Linear least squares over sparse rows: conjugate gradients on the normal equations, preconditioned by their
//! diagonal (Saad, Iterative Methods for Sparse Linear Systems, 2003, algorithm 9.7). Knows no surface. Each sum is
//! added up in one order whatever the threads.

use rayon::prelude::*;

/// A thread takes at least so many rows or columns.
const FEWEST_ROWS: usize = 4096;

/// Rows of a least-squares problem: minimise Σ (Σ_j a_ij x_j + r_i)².
#[derive(Default)]
pub(super) struct Rows {
    starts: Vec<u32>,
    columns: Vec<u32>,
    values: Vec<f64>,
    /// What each row is at x = 0.
    residuals: Vec<f64>,
}

impl Rows {
    /// Adds a row that is `residual` at x = 0, all of it times `weight`.
    pub(super) fn push(
        &mut self,
        weight: f64,
        residual: f64,
        entries: impl Iterator<Item = (u32, f64)>,
    ) {
        if self.starts.is_empty() {
            self.starts.push(0);
        }
        for (column, value) in entries {
            self.columns.push(column);
            self.values.push(weight * value);
        }
        self.starts.push(self.columns.len() as u32);
        self.residuals.push(weight * residual);
    }

    fn entries(&self, row: usize) -> impl Iterator<Item = (usize, f64)> + '_ {
        let range = self.starts[row] as usize..self.starts[row + 1] as usize;
        let columns = self.columns[range.clone()].iter();
        columns
            .map(|&c| c as usize)
            .zip(self.values[range].iter().copied())
    }

    /// The sum of squares at x = 0.
    #[cfg(test)]
    pub(super) fn cost(&self) -> f64 {
        self.residuals.iter().map(|r| r * r).sum()
    }

    /// A x.
    fn times(&self, x: &[f64], out: &mut [f64]) {
        let of = |row: usize| self.entries(row).map(|(j, a)| a * x[j]).sum();
        let rows = out.par_iter_mut().with_min_len(FEWEST_ROWS).enumerate();
        rows.for_each(|(row, out)| *out = of(row));
    }

    /// Aᵀ, whose rows have their entries in ascending order.
    fn transposed(&self, columns: usize) -> Self {
        let mut starts = vec![0_u32; columns + 1];
        for &column in &self.columns {
            starts[column as usize + 1] += 1;
        }
        for column in 0..columns {
            starts[column + 1] += starts[column];
        }
        let mut next = starts.clone();
        let mut transposed = Self {
            starts,
            columns: vec![0; self.columns.len()],
            values: vec![0.0; self.values.len()],
            residuals: Vec::new(),
        };
        for row in 0..self.residuals.len() {
            for (column, value) in self.entries(row) {
                let at = next[column] as usize;
                next[column] += 1;
                transposed.columns[at] = row as u32;
                transposed.values[at] = value;
            }
        }
        transposed
    }

    /// The `unknowns` values that make the sum of squares small, after at most `steps` steps. Each is held to zero
    /// by `damping` of its own weight, so that there is one solution.
    pub(super) fn solve(&self, unknowns: usize, damping: f64, steps: usize) -> Vec<f64> {
        /// What is left of the residual, against the first one.
        const TOLERANCE: f64 = 1e-3;
        let mut diagonal = vec![0.0; unknowns];
        let mut residual = vec![0.0; unknowns];
        for row in 0..self.residuals.len() {
            for (j, a) in self.entries(row) {
                diagonal[j] += a * a;
                residual[j] -= a * self.residuals[row];
            }
        }
        let least = 1e-12 * diagonal.iter().fold(f64::MIN_POSITIVE, |m, &d| m.max(d));
        let damping: Vec<f64> = diagonal.iter().map(|d| damping * d + least).collect();
        let inverse: Vec<f64> = diagonal
            .iter()
            .zip(&damping)
            .map(|(d, e)| (d + e).recip())
            .collect();
        let mut x = vec![0.0; unknowns];
        let preconditioned =
            |r: &[f64]| -> Vec<f64> { r.iter().zip(&inverse).map(|(r, i)| r * i).collect() };
        let mut direction = preconditioned(&residual);
        let mut size = dot(&residual, &direction);
        let goal = size * TOLERANCE * TOLERANCE;
        let transposed = self.transposed(unknowns);
        let mut product = vec![0.0; self.residuals.len()];
        let mut image = vec![0.0; unknowns];
        for _ in 0..steps {
            if size <= goal {
                break;
            }
            self.times(&direction, &mut product);
            transposed.times(&product, &mut image);
            for ((image, d), e) in image.iter_mut().zip(&direction).zip(&damping) {
                *image += e * d;
            }
            let curvature = dot(&direction, &image);
            if curvature <= 0.0 {
                break;
            }
            let step = size / curvature;
            for i in 0..unknowns {
                x[i] += step * direction[i];
                residual[i] -= step * image[i];
            }
            let next = preconditioned(&residual);
            let last = std::mem::replace(&mut size, dot(&residual, &next));
            let keep = size / last;
            direction
                .iter_mut()
                .zip(&next)
                .for_each(|(d, n)| *d = n + keep * *d);
        }
        x
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_chain_held_at_one_end_is_solved() {
        // x0 = 1, and each next one two more.
        let mut rows = Rows::default();
        rows.push(3.0, -1.0, [(0, 1.0)].into_iter());
        for i in 1..40 {
            rows.push(1.0, -2.0, [(i - 1, -1.0), (i, 1.0)].into_iter());
        }
        let x = rows.solve(40, 0.0, 200);
        for (i, x) in x.iter().enumerate() {
            assert!((x - (1.0 + 2.0 * i as f64)).abs() < 0.05, "{x} at {i}");
        }
    }

    #[test]
    fn what_nothing_holds_stays() {
        let mut rows = Rows::default();
        rows.push(1.0, -1.0, [(0, 1.0)].into_iter());
        assert_eq!(rows.solve(2, 1e-6, 50)[1], 0.0);
    }
}
