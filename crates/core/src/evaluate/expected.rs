//! Compares the errors that a model states with the actual ones, for any set of samples.

use super::statistics::{Sorted, share};
use serde::Serialize;

/// Stated errors against actual ones. They are true if the ratio is 1 and few samples are far worse than stated; they
/// are more than a constant if they rank as the actual ones do.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Expected {
    /// Samples.
    pub samples: usize,
    /// Mean of what the model expects.
    pub expected_mean_mm: f64,
    /// Mean of what it is.
    pub actual_mean_mm: f64,
    /// Mean of what it is over the mean of what the model expects; `None` where the model expects no error at all.
    pub actual_over_expected: Option<f64>,
    /// One of ten is below.
    pub actual_p10_mm: f64,
    /// Half are below.
    pub actual_median_mm: f64,
    /// Nine of ten are below.
    pub actual_p90_mm: f64,
    /// The actual errors' 90th percentile over their 10th: how far they spread; `None` where the latter is 0.
    pub actual_spread: Option<f64>,
    /// Share of samples whose error is at most what was expected there.
    pub within_share: f64,
    /// Share of samples whose error is at most twice what was expected there.
    pub within_twice_share: f64,
    /// Share of samples whose error is more than three times what was expected there.
    pub beyond_thrice_share: f64,
    /// Spearman's correlation of the ranks of expected and actual errors; `None` where one of them is the same
    /// everywhere.
    pub rank_correlation: Option<f64>,
}

impl Expected {
    /// Sums up pairs of an expected and an actual error, in millimetres; `None` where there are none.
    pub fn of(pairs: &[(f64, f64)]) -> Option<Self> {
        let stated: Vec<f64> = pairs.iter().map(|p| p.0).collect();
        let errors: Vec<f64> = pairs.iter().map(|p| p.1).collect();
        let actual = Sorted::new(errors.iter().copied());
        let expected_mean_mm = Sorted::new(stated.iter().copied()).mean()?;
        let actual_mean_mm = actual.mean()?;
        let (p10, p90) = (actual.quantile(0.1)?, actual.quantile(0.9)?);
        let ratio = |part: f64, whole: f64| (whole > 0.0).then(|| part / whole);
        Some(Self {
            samples: pairs.len(),
            expected_mean_mm,
            actual_mean_mm,
            actual_over_expected: ratio(actual_mean_mm, expected_mean_mm),
            actual_p10_mm: p10,
            actual_median_mm: actual.quantile(0.5)?,
            actual_p90_mm: p90,
            actual_spread: ratio(p90, p10),
            within_share: share(pairs, |p| p.1 <= p.0),
            within_twice_share: share(pairs, |p| p.1 <= 2.0 * p.0),
            beyond_thrice_share: share(pairs, |p| p.1 > 3.0 * p.0),
            rank_correlation: correlation(&ranks(&stated), &ranks(&errors)),
        })
    }
}

/// The rank of each value, counted from 0; equal values share the mean of theirs.
fn ranks(values: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|&a, &b| values[a].total_cmp(&values[b]));
    let mut ranks = vec![0.0; values.len()];
    let mut first = 0;
    for equal in order.chunk_by(|&a, &b| values[a] == values[b]) {
        let mean = first as f64 + 0.5 * (equal.len() - 1) as f64;
        equal.iter().for_each(|&i| ranks[i] = mean);
        first += equal.len();
    }
    ranks
}

/// Pearson's correlation; `None` where one of them does not vary.
fn correlation(a: &[f64], b: &[f64]) -> Option<f64> {
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    let (mean_a, mean_b) = (mean(a), mean(b));
    let (mut both, mut of_a, mut of_b) = (0.0, 0.0, 0.0);
    for (a, b) in a.iter().zip(b) {
        let (a, b) = (a - mean_a, b - mean_b);
        both += a * b;
        of_a += a * a;
        of_b += b * b;
    }
    (of_a > 0.0 && of_b > 0.0).then(|| both / (of_a * of_b).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stated_errors_that_are_true_are_told_from_a_constant_and_from_ones_that_are_too_small() {
        let line: Vec<f64> = (1..=101).map(|i| 0.01 * f64::from(i)).collect();
        let of = |stated: fn(f64) -> f64| {
            let pairs: Vec<_> = line
                .iter()
                .map(|&actual| (stated(actual), actual))
                .collect();
            Expected::of(&pairs).unwrap()
        };
        let right = of(|actual| actual);
        assert_eq!((right.within_share, right.beyond_thrice_share), (1.0, 0.0));
        assert!((right.actual_over_expected.unwrap() - 1.0).abs() < 1e-12);
        assert!((right.rank_correlation.unwrap() - 1.0).abs() < 1e-12);
        assert!((right.actual_spread.unwrap() - 0.91 / 0.11).abs() < 1e-9);
        let constant = of(|_| 0.2);
        assert_eq!(constant.rank_correlation, None);
        assert!((constant.beyond_thrice_share - 41.0 / 101.0).abs() < 1e-12);
        let small = of(|actual| 0.25 * actual);
        assert!((small.actual_over_expected.unwrap() - 4.0).abs() < 1e-12);
        assert_eq!((small.within_share, small.beyond_thrice_share), (0.0, 1.0));
        let reversed = of(|actual| 2.0 - actual);
        assert!((reversed.rank_correlation.unwrap() + 1.0).abs() < 1e-12);
    }

    #[test]
    fn equal_values_share_a_rank_and_what_cannot_be_divided_is_left_out() {
        assert_eq!(ranks(&[3.0, 1.0, 3.0, 2.0, 3.0]), [3.0, 0.0, 3.0, 1.0, 3.0]);
        let certain = Expected::of(&[(0.0, 0.0), (0.0, 1.0)]).unwrap();
        assert_eq!(
            (certain.actual_over_expected, certain.rank_correlation),
            (None, None)
        );
        assert_eq!(Expected::of(&[]), None);
    }
}
