//! Medians and quantiles, each with its convention in its name (which of two middle values is taken, and whether
//! values are interpolated), and estimates that are drawn towards zero. The bytes of models depend on it. Values are
//! ordered as by `total_cmp`.

use std::cmp::Ordering;

/// A number that can be put in order.
pub trait Number: Copy {
    /// Its order; of floating point numbers the one that IEEE 754 gives to all their values.
    fn order(&self, other: &Self) -> Ordering;
}

impl Number for f32 {
    fn order(&self, other: &Self) -> Ordering {
        self.total_cmp(other)
    }
}

impl Number for f64 {
    fn order(&self, other: &Self) -> Ordering {
        self.total_cmp(other)
    }
}

impl Number for usize {
    fn order(&self, other: &Self) -> Ordering {
        self.cmp(other)
    }
}

impl Number for i128 {
    fn order(&self, other: &Self) -> Ordering {
        self.cmp(other)
    }
}

/// The median; of an even number of values the upper of the two in the middle, `None` of none. Puts the values in
/// another order.
pub fn upper_median<T: Number>(values: &mut [T]) -> Option<T> {
    ranked(values, values.len() / 2)
}

/// The median; of an even number of values the lower of the two in the middle, `None` of none. Puts the values in
/// another order.
pub fn lower_median<T: Number>(values: &mut [T]) -> Option<T> {
    ranked(values, values.len().checked_sub(1)? / 2)
}

/// The value that at least a `share` of the values lies below, 0 to 1; a share of a half gives the upper median. `None`
/// of none, and of a share that no value is above. Puts the values in another order.
pub fn upper_quantile<T: Number>(values: &mut [T], share: f64) -> Option<T> {
    ranked(values, (share * values.len() as f64) as usize)
}

/// The value whose rank is nearest to that below which a `share` of the values lies, 0 to 1; of two ranks that are as
/// near the upper one. `None` of none. Puts the values in another order.
pub fn nearest_rank_quantile<T: Number>(values: &mut [T], share: f64) -> Option<T> {
    let last = values.len().checked_sub(1)?;
    ranked(values, (share * last as f64).round() as usize)
}

/// The value below which a `share` of the values lies, 0 to 1, interpolated linearly between neighbours; `None` of
/// none. The values are in ascending order.
pub fn interpolated_quantile(ascending: &[f64], share: f64) -> Option<f64> {
    let last = ascending.len().checked_sub(1)?;
    let at = share.clamp(0.0, 1.0) * last as f64;
    let below = at.floor() as usize;
    let above = (below + 1).min(last);
    Some(ascending[below] + (ascending[above] - ascending[below]) * at.fract())
}

/// An estimate drawn towards zero by as much as its standard error makes it doubtful: the positive part of James and
/// Stein's estimator. An estimate within its error counts as zero.
pub fn shrunk(estimate: f64, error: f64) -> f64 {
    if estimate == 0.0 {
        return 0.0;
    }
    estimate * (1.0 - (error / estimate).powi(2)).max(0.0)
}

/// The value that has this place in ascending order, counted from 0.
fn ranked<T: Number>(values: &mut [T], rank: usize) -> Option<T> {
    (rank < values.len()).then(|| *values.select_nth_unstable_by(rank, T::order).1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn conventions_differ_where_the_number_of_values_is_even() {
        assert_eq!(upper_median(&mut [4.0, 1.0, 3.0, 2.0]), Some(3.0));
        assert_eq!(lower_median(&mut [4.0, 1.0, 3.0, 2.0]), Some(2.0));
        assert_eq!(upper_median(&mut [3.0f32, 1.0, 2.0]), Some(2.0));
        assert_eq!(lower_median(&mut [3.0f32, 1.0, 2.0]), Some(2.0));
        assert_eq!(interpolated_quantile(&[1.0, 2.0, 3.0, 4.0], 0.5), Some(2.5));
        assert_eq!(
            nearest_rank_quantile(&mut [4.0, 1.0, 3.0, 2.0], 0.5),
            Some(3.0)
        );
    }

    #[test]
    fn quantiles_reach_from_the_least_to_the_greatest() {
        let mut values: Vec<f64> = (0..=10).rev().map(f64::from).collect();
        assert_eq!(nearest_rank_quantile(&mut values, 0.0), Some(0.0));
        assert_eq!(nearest_rank_quantile(&mut values, 0.98), Some(10.0));
        assert_eq!(upper_quantile(&mut values, 0.0), Some(0.0));
        assert_eq!(upper_quantile(&mut values, 0.5), upper_median(&mut values));
        assert_eq!(upper_quantile(&mut values, 0.8), Some(8.0));
        assert_eq!(upper_quantile(&mut values, 1.0), None);
        assert_eq!(interpolated_quantile(&[1.0, 2.0], 0.25), Some(1.25));
        assert_eq!(interpolated_quantile(&[1.0, 2.0], 7.0), Some(2.0));
    }

    #[test]
    fn nothing_has_none() {
        assert_eq!(upper_median::<f32>(&mut []), None);
        assert_eq!(lower_median::<f64>(&mut []), None);
        assert_eq!(nearest_rank_quantile::<f32>(&mut [], 0.5), None);
        assert_eq!(upper_quantile::<f32>(&mut [], 0.5), None);
        assert_eq!(interpolated_quantile(&[], 0.5), None);
    }

    #[test]
    fn a_doubtful_estimate_is_none_and_a_clear_one_stays() {
        assert_eq!(shrunk(0.2e-3, 0.3e-3), 0.0);
        assert_eq!(shrunk(0.0, 0.3e-3), 0.0);
        assert!((shrunk(-8e-3, 0.3e-3) + 8e-3).abs() < 2e-5);
    }

    /// Tenths have no exact binary form; their ranks are those of whole numbers all the same.
    #[test]
    fn ranks_of_tenths_are_exact() {
        for length in 1..5000usize {
            let mut values: Vec<usize> = (0..length).collect();
            for tenths in [1, 2, 8] {
                let found = upper_quantile(&mut values, tenths as f64 / 10.0);
                assert_eq!(found, Some(length * tenths / 10), "{length} {tenths}");
            }
        }
    }
}
