//! How much of the daemon clients may have: so many requests a second all together, first come first served, and so
//! many lines of its log.

use crate::log;
use parking_lot::Mutex;
use std::time::{Duration, Instant};
use tokio::net::unix::UCred;

/// Requests and connections a second that are served in the long run, by all clients together.
const RATE: f64 = 1000.0;
/// How many of them may come at once.
const BURST: f64 = 200.0;
/// Connections that the log names in each [`PERIOD`].
const NAMED: u32 = 10;
const PERIOD: Duration = Duration::from_secs(60);

/// Lets requests pass at a bounded rate. Who comes first passes first, so that one who asks seldom waits for at most
/// one request of each other client.
pub(super) struct Gate {
    state: tokio::sync::Mutex<(f64, Instant)>,
}

impl Gate {
    pub(super) fn new() -> Self {
        Self {
            state: tokio::sync::Mutex::new((BURST, Instant::now())),
        }
    }

    /// Waits until a request may pass.
    pub(super) async fn pass(&self) {
        // Held while waiting: the lock's queue is the gate's.
        let mut state = self.state.lock().await;
        loop {
            let now = Instant::now();
            let earned = now.duration_since(state.1).as_secs_f64() * RATE;
            *state = ((state.0 + earned).min(BURST), now);
            if state.0 >= 1.0 {
                state.0 -= 1.0;
                return;
            }
            let missing = Duration::from_secs_f64((1.0 - state.0) / RATE);
            tokio::time::sleep(missing).await;
        }
    }
}

/// Names the clients in the log: the first of each minute, and how many more there were.
pub(super) struct Visitors {
    state: Mutex<Visits>,
}

struct Visits {
    since: Instant,
    named: u32,
    more: u64,
}

impl Visitors {
    pub(super) fn new() -> Self {
        Self {
            state: Mutex::new(Visits {
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
            log::info!("client: user {}, group {}{pid}", who.uid(), who.gid());
        }
    }

    /// Whether the log names one more.
    fn is_named(&self, now: Instant) -> bool {
        let mut visits = self.state.lock();
        if now.duration_since(visits.since) > PERIOD {
            if visits.more > 0 {
                log::info!("client: {} more that are not named", visits.more);
            }
            *visits = Visits {
                since: now,
                named: 0,
                more: 0,
            };
        }
        let named = visits.named < NAMED;
        if named {
            visits.named += 1;
        } else {
            visits.more += 1;
        }
        named
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requests_pass_at_the_rate_after_a_burst_and_in_their_order() {
        let runtime = tokio::runtime::Builder::new_current_thread();
        let runtime = { runtime }.enable_time().build().unwrap();
        runtime.block_on(async {
            let gate = std::rc::Rc::new(Gate::new());
            let begin = Instant::now();
            for _ in 0..BURST as usize + 100 {
                gate.pass().await;
            }
            let took = begin.elapsed();
            assert!(took >= Duration::from_millis(95), "{took:?}");
        });
    }

    #[test]
    fn a_flood_of_clients_is_not_a_flood_of_lines() {
        let visitors = Visitors::new();
        let now = Instant::now();
        let named = (0..10_000).filter(|_| visitors.is_named(now)).count();
        assert_eq!(named, NAMED as usize);
        assert!(visitors.is_named(now + 2 * PERIOD));
    }
}
