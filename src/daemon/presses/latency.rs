//! Keeps how long the last presses took, and computes their percentiles.

use crate::statistics::nearest_rank_quantile;
use std::collections::VecDeque;
use std::time::Duration;

/// Presses that count.
const LAST: usize = 100;

/// What half of the presses stay below, and 99 of 100.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Percentiles {
    /// The median.
    pub p50: f64,
    /// The 99th percentile.
    pub p99: f64,
}

/// How long each of the last presses took, in milliseconds.
#[derive(Debug, Default)]
pub(super) struct LatencyWindow(VecDeque<f64>);

impl LatencyWindow {
    /// Notes how long one took.
    pub(super) fn note(&mut self, took: Duration) {
        if self.0.len() == LAST {
            self.0.pop_front();
        }
        self.0.push_back(took.as_secs_f64() * 1e3);
    }

    /// How long they took; `None` before the first one.
    pub(super) fn percentiles(&self) -> Option<Percentiles> {
        let mut latencies: Vec<f64> = self.0.iter().copied().collect();
        Some(Percentiles {
            p50: nearest_rank_quantile(&mut latencies, 0.5)?,
            p99: nearest_rank_quantile(&mut latencies, 0.99)?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_hundred_count() {
        let mut window = LatencyWindow::default();
        assert_eq!(window.percentiles(), None);
        window.note(Duration::from_secs(3600));
        (1..=100).for_each(|ms| window.note(Duration::from_millis(ms)));
        let found = window.percentiles().unwrap();
        assert!(
            (found.p50 - 51.0).abs() < 1.5 && (found.p99 - 99.0).abs() < 1.5,
            "{found:?}"
        );
    }
}
