//! How long the last presses took.

use super::super::status::Spread;
use parking_lot::Mutex;
use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

/// Presses that count.
const LAST: usize = 100;

/// Of the last presses how long each took until it was captured, durable and so on.
#[derive(Debug, Default)]
pub(super) struct Takes {
    milliseconds: Mutex<BTreeMap<&'static str, VecDeque<f64>>>,
}

impl Takes {
    /// Notes how long a press took until it was `what`.
    pub(super) fn note(&self, what: &'static str, took: Duration) {
        let mut all = self.milliseconds.lock();
        let last = all.entry(what).or_default();
        if last.len() == LAST {
            last.pop_front();
        }
        last.push_back(took.as_secs_f64() * 1e3);
    }

    /// How long they took.
    pub(super) fn spreads(&self) -> BTreeMap<&'static str, Spread> {
        let all = self.milliseconds.lock();
        all.iter()
            .map(|(what, last)| (*what, spread(last)))
            .collect()
    }
}

/// At least one of them is there.
fn spread(last: &VecDeque<f64>) -> Spread {
    let mut sorted: Vec<f64> = last.iter().copied().collect();
    sorted.sort_by(f64::total_cmp);
    let at = |part: f64| sorted[((sorted.len() - 1) as f64 * part).round() as usize];
    Spread {
        p50: at(0.5),
        p99: at(0.99),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_hundred_count() {
        let takes = Takes::default();
        assert!(takes.spreads().is_empty());
        takes.note("durable", Duration::from_secs(3600));
        (1..=100).for_each(|ms| takes.note("durable", Duration::from_millis(ms)));
        let spread = takes.spreads()["durable"];
        assert!(
            (spread.p50 - 51.0).abs() < 1.5 && (spread.p99 - 99.0).abs() < 1.5,
            "{spread:?}"
        );
    }
}
