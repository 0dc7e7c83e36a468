//! Limits what clients may use: a rate of requests shared by all of them, served in order of arrival, and a number of
//! lines in the daemon's log. The number of clients is in `connection_limit`, the longest line in
//! `trigger::LONGEST_REQUEST`. Tasks wait here with tokio's timers, because a `Clock` wakes no task; what decides is
//! handed the time.

use crate::log;
use parking_lot::Mutex;
use std::time::{Duration, Instant};
use tokio::net::unix::UCred;

/// Requests and connections a second that are served in the long run, of all clients together.
const RATE: f64 = 1000.0;
/// How many of them are served at once after a pause.
const BURST: f64 = 200.0;
/// Connections that are logged in each [`PERIOD`].
const NAMED: u32 = 10;
const PERIOD: Duration = Duration::from_secs(60);

/// Lets requests pass at a limited rate, in order of arrival, so that a client that seldom asks waits for at most one
/// request of each other client.
pub(super) struct RateLimiter {
    earned: tokio::sync::Mutex<TokenBucket>,
}

/// A token bucket: how many requests may pass at once, as of an instant.
struct TokenBucket {
    requests: f64,
    at: Instant,
}

impl TokenBucket {
    /// Lets a request pass, or returns how long it must wait.
    fn spend(&mut self, now: Instant) -> Result<(), Duration> {
        let earned = now.saturating_duration_since(self.at).as_secs_f64() * RATE;
        self.requests = (self.requests + earned).min(BURST);
        self.at = now;
        if self.requests < 1.0 {
            return Err(Duration::from_secs_f64((1.0 - self.requests) / RATE));
        }
        self.requests -= 1.0;
        Ok(())
    }
}

impl RateLimiter {
    pub(super) fn new() -> Self {
        let earned = TokenBucket {
            requests: BURST,
            at: Instant::now(),
        };
        Self {
            earned: tokio::sync::Mutex::new(earned),
        }
    }

    /// Waits until a request may pass.
    pub(super) async fn acquire(&self) {
        // Held while waiting: the lock's queue keeps the order of arrival.
        let mut earned = self.earned.lock().await;
        while let Err(wait) = earned.spend(Instant::now()) {
            tokio::time::sleep(wait).await;
        }
    }
}

/// Logs the first clients of each minute, and how many more there were.
pub(super) struct ClientLogThrottle {
    state: Mutex<Period>,
}

struct Period {
    since: Instant,
    named: u32,
    more: u64,
}

impl ClientLogThrottle {
    pub(super) fn new() -> Self {
        Self {
            state: Mutex::new(Period {
                since: Instant::now(),
                named: 0,
                more: 0,
            }),
        }
    }

    pub(super) fn note(&self, who: &UCred) {
        if self.is_named(Instant::now()) {
            let pid = who
                .pid()
                .map_or_else(String::new, |p| format!(", process {p}"));
            log::info!(
                "a client connected: user {}, group {}{pid}",
                who.uid(),
                who.gid()
            );
        }
    }

    /// Whether one more client is logged.
    fn is_named(&self, now: Instant) -> bool {
        let mut period = self.state.lock();
        if now.duration_since(period.since) > PERIOD {
            if period.more > 0 {
                log::info!("{} more clients connected in the last minute", period.more);
            }
            *period = Period {
                since: now,
                named: 0,
                more: 0,
            };
        }
        let named = period.named < NAMED;
        if named {
            period.named += 1;
        } else {
            period.more += 1;
        }
        named
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requests_pass_at_the_rate_after_a_burst() {
        let begin = Instant::now();
        let mut earned = TokenBucket {
            requests: BURST,
            at: begin,
        };
        let mut now = begin;
        let mut passed = 0.0;
        while passed < BURST + 100.0 {
            match earned.spend(now) {
                Ok(()) => passed += 1.0,
                Err(wait) => now += wait,
            }
        }
        let took = now.duration_since(begin).as_secs_f64();
        assert!((took - 100.0 / RATE).abs() < 1e-6, "{took} s");
        // A long rest earns no more than a burst.
        now += PERIOD;
        let passed = (0..10_000).filter(|_| earned.spend(now).is_ok()).count();
        assert_eq!(passed, BURST as usize);
    }

    #[test]
    fn a_flood_of_clients_is_not_a_flood_of_lines() {
        let throttle = ClientLogThrottle::new();
        let now = Instant::now();
        let named = (0..10_000).filter(|_| throttle.is_named(now)).count();
        assert_eq!(named, NAMED as usize);
        assert!(throttle.is_named(now + 2 * PERIOD));
    }
}
