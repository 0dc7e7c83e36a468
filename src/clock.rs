//! The time. Code that waits, judges an age or stamps an event gets a [`Clock`] from its caller, so that a test can
//! pass one that stands still until the test advances it. The clocks of cameras, which run on their own, are in
//! `drivers::live`.

use crate::frame::Timestamp;
use crossbeam_channel::{Receiver, RecvTimeoutError};
#[cfg(test)]
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant, SystemTime};

/// The host's timeline: the monotonic clock, with the offset to UTC taken once, so that a step of the wall clock moves
/// nothing.
#[derive(Debug, Clone, Copy)]
pub struct Clock {
    begin: Instant,
    begin_utc_ns: u64,
    /// By how many nanoseconds a test has advanced its clock; `None` for one that runs by itself. It is leaked, so that
    /// a clock can be copied like a number.
    #[cfg(test)]
    advanced_ns: Option<&'static AtomicU64>,
}

impl Clock {
    /// The system's clock, with today's offset between monotonic clock and UTC.
    pub fn system() -> Self {
        let begin = Instant::now();
        Self {
            begin,
            begin_utc_ns: Timestamp::from(SystemTime::now()).0,
            #[cfg(test)]
            advanced_ns: None,
        }
    }

    /// A clock that shows `begin` until it is advanced.
    #[cfg(test)]
    pub(crate) fn by_hand(begin: Timestamp) -> Self {
        Self {
            begin: Instant::now(),
            begin_utc_ns: begin.0,
            advanced_ns: Some(Box::leak(Box::default())),
        }
    }

    /// Advances a clock that was made by [`Self::by_hand`], and every copy of it.
    #[cfg(test)]
    pub(crate) fn advance(&self, by: Duration) {
        let advanced = self.advanced_ns.expect("a clock that is advanced by hand");
        advanced.fetch_add(by.as_nanos() as u64, Ordering::AcqRel);
    }

    /// The monotonic time.
    pub fn now(&self) -> Instant {
        #[cfg(test)]
        if let Some(advanced) = self.advanced_ns {
            return self.begin + Duration::from_nanos(advanced.load(Ordering::Acquire));
        }
        Instant::now()
    }

    /// The time now, in nanoseconds of UTC that run as the monotonic clock does.
    pub fn timestamp(&self) -> Timestamp {
        self.at(self.now())
    }

    /// How long ago an instant was.
    pub fn elapsed(&self, since: Instant) -> Duration {
        self.now().saturating_duration_since(since)
    }

    /// How long it is until an instant; zero if it has passed.
    pub fn until(&self, instant: Instant) -> Duration {
        instant.saturating_duration_since(self.now())
    }

    /// The timestamp of an instant.
    pub fn at(&self, instant: Instant) -> Timestamp {
        match instant.checked_duration_since(self.begin) {
            Some(later) => Timestamp(self.begin_utc_ns + later.as_nanos() as u64),
            None => {
                let earlier = self.begin.duration_since(instant).as_nanos() as u64;
                Timestamp(self.begin_utc_ns.saturating_sub(earlier))
            }
        }
    }

    /// The timestamp of a reading of the monotonic clock (`CLOCK_MONOTONIC`), as V4L2 stamps its frames.
    pub fn of_monotonic(&self, reading: Duration) -> Timestamp {
        let now = self.now();
        let monotonic = monotonic_now();
        let age = monotonic.as_nanos() as i128 - reading.as_nanos() as i128;
        Timestamp((i128::from(self.at(now).0) - age).max(0) as u64)
    }

    /// Waits for this time. A clock by hand is advanced instead, because no other thread would advance it.
    pub fn sleep(&self, duration: Duration) {
        #[cfg(test)]
        if self.advanced_ns.is_some() {
            self.advance(duration);
            return std::thread::sleep(LOOK);
        }
        std::thread::sleep(duration);
    }

    /// How long a thread that the system wakes may wait: all of `left` or, on a clock by hand, until it checks again
    /// whether the clock was advanced.
    pub fn wait_at_most(&self, left: Duration) -> Duration {
        #[cfg(test)]
        if self.advanced_ns.is_some() {
            return left.min(LOOK);
        }
        left
    }

    /// Waits for a message, at most for so long.
    ///
    /// # Errors
    /// If none came, or none can come any more.
    pub fn recv_timeout<T>(
        &self,
        receiver: &Receiver<T>,
        at_most: Duration,
    ) -> Result<T, RecvTimeoutError> {
        #[cfg(test)]
        if self.advanced_ns.is_some() {
            let end = self.now() + at_most;
            loop {
                match receiver.recv_timeout(LOOK) {
                    Err(RecvTimeoutError::Timeout) if self.now() < end => {}
                    received => return received,
                }
            }
        }
        receiver.recv_timeout(at_most)
    }
}

/// How often a thread that waits looks whether a clock by hand was advanced.
#[cfg(test)]
const LOOK: Duration = Duration::from_millis(1);

/// `CLOCK_MONOTONIC`, which is what [`Instant`] reads on Linux.
fn monotonic_now() -> Duration {
    let now = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
    Duration::new(now.tv_sec as u64, now.tv_nsec as u32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_monotonic_clock_is_the_hosts_timeline() {
        let clock = Clock::system();
        let before = clock.timestamp();
        let mapped = clock.of_monotonic(monotonic_now());
        let after = clock.timestamp();
        // The two clocks are read one after the other.
        let slack = after.0 - before.0;
        assert!(mapped.0 + slack >= before.0 && mapped.0 <= after.0 + slack);
    }

    #[test]
    fn a_clock_by_hand_stands_until_it_is_advanced_and_all_its_copies_with_it() {
        let clock = Clock::by_hand(Timestamp(5_000));
        let copy = clock;
        let begin = copy.now();
        assert_eq!(copy.timestamp(), Timestamp(5_000));
        clock.advance(Duration::from_secs(3));
        assert_eq!(copy.timestamp(), Timestamp(3_000_005_000));
        assert_eq!(copy.elapsed(begin), Duration::from_secs(3));
        assert_eq!(copy.until(begin + Duration::from_secs(4)).as_secs(), 1);
        clock.sleep(Duration::from_secs(2));
        assert_eq!(copy.elapsed(begin), Duration::from_secs(5));
    }

    #[test]
    fn who_waits_by_hand_waits_until_the_clock_is_advanced_or_a_message_comes() {
        let clock = Clock::by_hand(Timestamp(0));
        let (sender, receiver) = crossbeam_channel::bounded(1);
        std::thread::scope(|scope| {
            let hour = Duration::from_secs(3600);
            let waits = scope.spawn(move || clock.recv_timeout::<u8>(&receiver, hour));
            sender.send(7).unwrap();
            assert_eq!(waits.join().unwrap(), Ok(7));
        });
        let (_sender, receiver) = crossbeam_channel::bounded::<u8>(1);
        let begin = clock.now();
        std::thread::scope(|scope| {
            let waits = scope.spawn(|| clock.recv_timeout(&receiver, Duration::from_secs(1)));
            while !waits.is_finished() {
                clock.advance(Duration::from_millis(500));
                std::thread::yield_now();
            }
            assert_eq!(waits.join().unwrap(), Err(RecvTimeoutError::Timeout));
        });
        assert!(clock.elapsed(begin) >= Duration::from_secs(1));
    }
}
