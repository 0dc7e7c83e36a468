//! Statistics of a set of numbers: means, quantiles, shares.

use crate::statistics::interpolated_quantile;
use serde::Serialize;

/// Distances in millimetres, in five figures.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// How many there are.
    pub samples: usize,
    /// The mean.
    pub mean_mm: f64,
    /// Half are below.
    pub median_mm: f64,
    /// Nine of ten are below.
    pub p90_mm: f64,
    /// 99 of 100 are below.
    pub p99_mm: f64,
    /// The largest.
    pub max_mm: f64,
}

impl Summary {
    /// Sums up `values`, given in millimetres; `None` where there are none.
    pub fn of(values: impl IntoIterator<Item = f64>) -> Option<Self> {
        let sorted = Sorted::new(values);
        Some(Self {
            samples: sorted.0.len(),
            mean_mm: sorted.mean()?,
            median_mm: sorted.quantile(0.5)?,
            p90_mm: sorted.quantile(0.9)?,
            p99_mm: sorted.quantile(0.99)?,
            max_mm: *sorted.0.last()?,
        })
    }
}

/// Numbers in ascending order.
pub(super) struct Sorted(Vec<f64>);

impl Sorted {
    /// Sorts `values`.
    pub(super) fn new(values: impl IntoIterator<Item = f64>) -> Self {
        let mut values: Vec<f64> = values.into_iter().collect();
        values.sort_by(f64::total_cmp);
        Self(values)
    }

    /// The mean.
    pub(super) fn mean(&self) -> Option<f64> {
        let sum: f64 = self.0.iter().sum();
        (!self.0.is_empty()).then(|| sum / self.0.len() as f64)
    }

    /// The value that a share of `q` lies below, interpolated linearly between neighbours.
    pub(super) fn quantile(&self, q: f64) -> Option<f64> {
        interpolated_quantile(&self.0, q)
    }
}

/// The share of `values` for which `is` holds; 0 of nothing.
pub(super) fn share<T>(values: &[T], is: impl Fn(&T) -> bool) -> f64 {
    values.iter().filter(|v| is(v)).count() as f64 / values.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_interpolated() {
        let summary = Summary::of((0..=10).rev().map(f64::from)).unwrap();
        assert_eq!(
            (summary.samples, summary.mean_mm, summary.median_mm),
            (11, 5.0, 5.0)
        );
        assert_eq!((summary.p90_mm, summary.max_mm), (9.0, 10.0));
        assert!((summary.p99_mm - 9.9).abs() < 1e-12);
        assert_eq!(Sorted::new([1.0, 2.0]).quantile(0.25), Some(1.25));
        assert_eq!(Summary::of([]), None);
        assert_eq!(share(&[1, 2, 3, 4], |&v| v > 1), 0.75);
        assert_eq!(share::<u8>(&[], |_| true), 0.0);
    }
}
