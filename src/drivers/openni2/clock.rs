//! Computes when a depth camera's frames were exposed. If its clock counts microseconds, that clock is mapped by the
//! frames' arrivals; otherwise the arrivals themselves are used.

use crate::drivers::live::{DeviceClock, Reading};
use crate::frame::Timestamp;

/// The clock of a camera's streams.
#[derive(Debug, Default)]
pub(super) struct StreamClock {
    /// `None` where arrivals count.
    device: Option<DeviceClock>,
    /// Of each stream the newest time by the camera's own clock, in microseconds.
    newest_us: [Option<u64>; 2],
}

/// A moment by the camera's clock and by the host's, which holds for one shot: within it frames keep the distances in
/// time that the camera gave them.
#[derive(Debug, Clone, Copy)]
pub(super) struct Anchor {
    device_ns: u64,
    host: Timestamp,
}

/// Frames that show how fast a clock runs.
pub(super) const SETTLING: usize = 8;

impl StreamClock {
    /// Judges a clock by the first frames of a stream: the camera's time in microseconds and the arrival of each.
    ///
    /// # Errors
    /// If it stands still.
    pub(super) fn judge(seen: &[(u64, Timestamp)]) -> Result<(Self, Option<String>), String> {
        let (Some(first), Some(last)) = (seen.first(), seen.last()) else {
            return Ok((Self::default(), None));
        };
        let passed_us = last.0 as f64 - first.0 as f64;
        let real_us = (last.1.nanoseconds_since(first.1) as f64 / 1e3).max(1.0);
        if passed_us == 0.0 && seen.len() > 1 {
            return Err(format!(
                "its clock stands still: {} µs in each of {} frames",
                first.0,
                seen.len()
            ));
        }
        // Arrivals are late by a few milliseconds, of some hundreds.
        let speed = passed_us / real_us;
        if !(0.7..1.4).contains(&speed) {
            let remark = format!(
                "its clock does not count microseconds ({speed:.2} in each): scand uses the time at which each frame arrives"
            );
            return Ok((Self::by_arrival(), Some(remark)));
        }
        let mut clock = Self {
            device: Some(DeviceClock::default()),
            newest_us: [None; 2],
        };
        for &(device_us, arrival) in seen {
            clock.see(0, device_us, arrival)?;
        }
        Ok((clock, None))
    }

    /// A clock for which arrivals alone count.
    pub(super) fn by_arrival() -> Self {
        Self::default()
    }

    /// Adds a frame of a stream; the clock is estimated from the first stream.
    ///
    /// # Errors
    /// If the clock stands still or jumped.
    pub(super) fn see(
        &mut self,
        stream: usize,
        device_us: u64,
        arrival: Timestamp,
    ) -> Result<(), String> {
        let Some(clock) = &mut self.device else {
            return Ok(());
        };
        let newest = self.newest_us[stream].replace(device_us);
        if newest == Some(device_us) {
            return Err(format!(
                "its clock stands still: {device_us} µs in two frames"
            ));
        }
        if stream == 0 {
            clock.add(Reading {
                device_ns: device_us.saturating_mul(1000),
                not_before: None,
                not_after: arrival,
            })?;
        }
        Ok(())
    }

    /// What holds for a shot that begins with a frame of this time.
    pub(super) fn anchor(&self, device_us: u64) -> Option<Anchor> {
        let device_ns = device_us.saturating_mul(1000);
        let (host, _) = self.device.as_ref()?.host_time(device_ns)?;
        Some(Anchor { device_ns, host })
    }
}

impl Anchor {
    /// When a frame arrived at the latest, had all been as quick as the quickest.
    pub(super) fn arrival(&self, device_us: u64) -> Timestamp {
        let later = i128::from(device_us) * 1000 - i128::from(self.device_ns);
        let time = (i128::from(self.host.0) + later).clamp(0, i128::from(u64::MAX));
        Timestamp(time as u64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HOST: u64 = 1_700_000_000_000_000_000;

    /// Frames of a camera at 30 in a second, whose clock makes `ticks` in a microsecond.
    fn frames(ticks: f64, late_us: &[u64]) -> Vec<(u64, Timestamp)> {
        let frame = |(i, late): (usize, &u64)| {
            let us = i as u64 * 33_333;
            let device = 5_000_000 + (us as f64 * ticks) as u64;
            (device, Timestamp(HOST + (us + late) * 1000))
        };
        late_us.iter().enumerate().map(frame).collect()
    }

    #[test]
    fn the_quickest_arrival_counts_and_distances_stay() {
        let seen = frames(1.0, &[9000, 4000, 7000, 12_000, 5000, 6000, 4500, 8000]);
        let (clock, remark) = StreamClock::judge(&seen).unwrap();
        assert_eq!(remark, None);
        let anchor = clock.anchor(seen[2].0).unwrap();
        let expected = HOST + (2 * 33_333 + 4000) * 1000;
        assert!(anchor.arrival(seen[2].0).0.abs_diff(expected) < 50_000);
        let apart = anchor.arrival(seen[5].0).0 - anchor.arrival(seen[2].0).0;
        assert_eq!(apart, 3 * 33_333_000);
    }

    #[test]
    fn a_clock_of_other_ticks_is_not_believed_and_said() {
        // Kinects count 60 in a microsecond.
        let seen = frames(60.0, &[5000; 8]);
        let (clock, remark) = StreamClock::judge(&seen).unwrap();
        assert!(remark.unwrap().contains("60.0"), "the speed is named");
        assert!(clock.anchor(seen[0].0).is_none());
    }

    #[test]
    fn a_clock_that_stands_still_is_an_error_at_the_start_and_later() {
        let still = StreamClock::judge(&frames(0.0, &[5000; 8])).unwrap_err();
        assert!(still.contains("stands still"), "{still}");
        let seen = frames(1.0, &[5000; 8]);
        let (mut clock, _) = StreamClock::judge(&seen).unwrap();
        let (last, arrival) = seen[7];
        let later = Timestamp(arrival.0 + 33_333_000);
        assert!(
            clock
                .see(0, last, later)
                .unwrap_err()
                .contains("stands still")
        );
        assert!(clock.see(0, last + 66_666, later).is_ok());
    }
}
