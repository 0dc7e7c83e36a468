//! Waiting for what other threads and processes do.

use std::time::{Duration, Instant};

/// More than anything takes, on a machine that has other things to do.
const LONGEST: Duration = Duration::from_secs(300);

/// Waits until something is so.
///
/// # Panics
/// If it is not so after five minutes, with `what` and `seen()`.
pub fn until_or<S: std::fmt::Display>(
    what: &str,
    seen: impl Fn() -> S,
    mut reached: impl FnMut() -> bool,
) {
    let end = Instant::now() + LONGEST;
    while !reached() {
        assert!(Instant::now() < end, "{what}: {}", seen());
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// The same, with nothing to be seen.
pub fn until(what: &str, reached: impl FnMut() -> bool) {
    until_or(what, || "waited for five minutes", reached);
}
