//! Maps a camera's clock onto the host's timeline ([`crate::clock`]), by readings of both at the same moment.

use crate::frame::Timestamp;
use std::collections::VecDeque;

/// One reading of a camera's clock, with bounds on the host's time of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Reading {
    /// The camera's clock in nanoseconds.
    pub device_ns: u64,
    /// Lower bound; `None` if only the arrival is known.
    pub not_before: Option<Timestamp>,
    /// Upper bound.
    pub not_after: Timestamp,
}

/// Maps a camera's clock onto the host's timeline.
///
/// Each reading bounds the offset from both sides (a clock that is latched between two of the host's times) or from one
/// (a frame that was exposed before it came). The narrowest bounds count, made wider by what the clocks may have
/// drifted apart since. Newer readings win: an older one that contradicts them was delayed by a busy host, or precedes
/// a change of the clock, and is dropped.
#[derive(Debug, Clone, Default)]
pub struct DeviceClock {
    readings: VecDeque<Reading>,
}

/// How many readings are kept.
const KEPT: usize = 32;
/// How far two quartz clocks drift apart at most, as a part of the time that passes.
const DRIFT: f64 = 100e-6;
/// By how much readings may contradict each other, in nanoseconds.
const CONTRADICTION: i128 = 1_000_000;

impl DeviceClock {
    /// Adds a reading.
    ///
    /// # Errors
    /// If the clock stands still or jumped, as a message. The earlier readings are then dropped.
    pub fn add(&mut self, reading: Reading) -> Result<(), String> {
        let problem = self
            .readings
            .back()
            .and_then(|last| problem(*last, reading));
        if problem.is_some() {
            self.readings.clear();
        } else if self.readings.len() == KEPT {
            self.readings.pop_front();
        }
        self.readings.push_back(reading);
        while self.contradicts_itself(reading.device_ns) {
            self.readings.pop_front();
        }
        problem.map_or(Ok(()), Err)
    }

    fn contradicts_itself(&self, device_ns: u64) -> bool {
        let (low, high) = self.bounds(device_ns);
        let apart = low.zip(high).map_or(0, |(low, high)| low - high);
        self.readings.len() > 1 && apart > CONTRADICTION
    }

    /// The host's time at a moment of the camera's clock, and its uncertainty in nanoseconds (`None` if only arrivals
    /// are known). `None` before the first reading.
    pub fn host_time(&self, device_ns: u64) -> Option<(Timestamp, Option<u64>)> {
        let (low, high) = self.bounds(device_ns);
        let high = high?;
        let (offset, uncertainty) = match low {
            Some(low) => (
                (low + high).div_euclid(2),
                Some(((high - low).max(0) / 2) as u64),
            ),
            None => (high, None),
        };
        let time = (i128::from(device_ns) + offset).clamp(0, i128::from(u64::MAX));
        Some((Timestamp(time as u64), uncertainty))
    }

    /// Highest lower and lowest upper bound of host time less device time.
    fn bounds(&self, device_ns: u64) -> (Option<i128>, Option<i128>) {
        let drift = |r: &Reading| (r.device_ns.abs_diff(device_ns) as f64 * DRIFT) as i128;
        let offset = |r: &Reading, t: Timestamp| i128::from(t.0) - i128::from(r.device_ns);
        let lows = self.readings.iter();
        let low = lows
            .filter_map(|r| Some(offset(r, r.not_before?) - drift(r)))
            .max();
        let highs = self.readings.iter();
        let high = highs.map(|r| offset(r, r.not_after) + drift(r)).min();
        (low, high)
    }
}

/// Why two successive readings cannot come from a clock that works; `None` if they can.
fn problem(last: Reading, next: Reading) -> Option<String> {
    let passed = i128::from(next.device_ns) - i128::from(last.device_ns);
    let at_most = next.not_before.map_or(0, |_| {
        next.not_after
            .nanoseconds_since(last.not_before.unwrap_or(last.not_after))
    });
    let at_least = next.not_before.map(|t| t.nanoseconds_since(last.not_after));
    const SLACK_NS: i128 = 5_000_000;
    if let Some(at_least) = at_least.filter(|&ns| ns > SLACK_NS) {
        if passed == 0 {
            return Some(format!(
                "its clock stands still: {} ns at two times {:.1} ms apart",
                next.device_ns,
                at_least as f64 / 1e6
            ));
        }
        let slack = SLACK_NS + at_most / 100;
        if passed < at_least - slack || passed > at_most + slack {
            return Some(format!(
                "its clock jumped: {:.1} ms passed for it, {:.1} ms for the host",
                passed as f64 / 1e6,
                at_most as f64 / 1e6
            ));
        }
    } else if passed < 0 {
        return Some(format!(
            "its clock went back by {:.1} ms",
            -passed as f64 / 1e6
        ));
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    const HOST: u64 = 1_700_000_000_000_000_000;

    fn latched(device_ns: u64, host_ns: u64, width_ns: u64) -> Reading {
        Reading {
            device_ns,
            not_before: Some(Timestamp(HOST + host_ns - width_ns / 2)),
            not_after: Timestamp(HOST + host_ns + width_ns / 2),
        }
    }

    #[test]
    fn the_narrowest_reading_gives_the_offset() {
        let mut clock = DeviceClock::default();
        assert_eq!(clock.host_time(5), None);
        clock.add(latched(1_000, 1_000_000, 400_000)).unwrap();
        clock.add(latched(3_000_000, 3_999_100, 2_000)).unwrap();
        let (time, uncertainty) = clock.host_time(4_000_000).unwrap();
        assert!(time.0.abs_diff(HOST + 4_999_100) < 1_000, "{time:?}");
        assert!(uncertainty.unwrap() < 1_200);
    }

    #[test]
    fn arrivals_bound_from_one_side_and_the_earliest_counts() {
        let mut clock = DeviceClock::default();
        for (device, late) in [
            (0, 9_000_000),
            (100_000_000, 4_000_000),
            (200_000_000, 7_000_000),
        ] {
            let arrival = Reading {
                device_ns: device,
                not_before: None,
                not_after: Timestamp(HOST + device + late),
            };
            clock.add(arrival).unwrap();
        }
        let (time, uncertainty) = clock.host_time(100_000_000).unwrap();
        assert_eq!((time, uncertainty), (Timestamp(HOST + 104_000_000), None));
    }

    #[test]
    fn a_reading_that_was_wrong_is_corrected_by_the_next() {
        for wrong_ns in [0, 30_000_000] {
            let mut clock = DeviceClock::default();
            // Some milliseconds after each other, as a camera is opened: the first shows a value that had been latched
            // before, or is later than it seems.
            let first = latched(1_000_000_000 + wrong_ns, 1_015_000_000, 1_000);
            clock.add(first).unwrap();
            for ms in [18, 21, 24] {
                let _ = clock.add(latched(
                    1_000_000_000 + ms * 1_000_000,
                    1_000_000_000 + ms * 1_000_000,
                    400_000,
                ));
            }
            let (time, uncertainty) = clock.host_time(1_030_000_000).unwrap();
            assert!(
                time.0.abs_diff(HOST + 1_030_000_000) < 250_000,
                "{wrong_ns}: {time:?}"
            );
            assert!(uncertainty.unwrap() < 250_000);
        }
    }

    #[test]
    fn a_clock_that_stands_still_or_jumps_is_told_and_then_known_anew() {
        let mut clock = DeviceClock::default();
        clock
            .add(latched(1_000_000_000, 1_000_000_000, 1_000))
            .unwrap();
        let still = clock.add(latched(1_000_000_000, 2_000_000_000, 1_000));
        assert!(still.unwrap_err().contains("stands still"));
        let jumped = clock.add(latched(90_000_000_000, 3_000_000_000, 1_000));
        assert!(jumped.unwrap_err().contains("jumped"));
        clock
            .add(latched(91_000_000_000, 4_000_000_000, 1_000))
            .unwrap();
        let (time, _) = clock.host_time(91_000_000_000).unwrap();
        assert!(time.0.abs_diff(HOST + 4_000_000_000) < 200_000);
    }
}
