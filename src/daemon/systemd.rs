//! Talks to systemd: takes over the listening socket, reports that the daemon is ready or stopping, a status line, and
//! that its threads still work. The watchdog has no timer of its own: it is fed only when every working thread has
//! shown a sign of life, so that one thread that hangs starves it.

use crate::clock::Clock;
use crate::log;
use crossbeam_channel::{Receiver, RecvTimeoutError};
use parking_lot::Mutex;
use std::ffi::OsString;
use std::io::ErrorKind;
use std::os::linux::net::SocketAddrExt;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::net::{SocketAddr, UnixDatagram, UnixListener};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Takes the listening socket that systemd opened, if any. Call it once, before other threads start: it removes
/// `LISTEN_FDS` from the environment, so that no child process uses it.
///
/// # Errors
/// If systemd handed over more than one socket, or one that does not listen.
pub fn handed_over() -> std::io::Result<Option<UnixListener>> {
    let mut sockets = listenfd::ListenFd::from_env();
    if sockets.len() > 1 {
        let words = format!(
            "systemd handed over {} sockets, expected one",
            sockets.len()
        );
        return Err(std::io::Error::new(ErrorKind::InvalidInput, words));
    }
    sockets.take_unix_listener(0)
}

/// The connection to systemd; without one, messages are dropped.
#[derive(Debug, Default)]
pub struct Notifier {
    way: Option<(UnixDatagram, SocketAddr)>,
    /// Systemd kills the daemon after so long without a sign of life.
    watchdog: Option<Duration>,
}

impl Notifier {
    /// Reads the environment that systemd sets (`NOTIFY_SOCKET`, `WATCHDOG_USEC`).
    pub fn from_environment() -> Self {
        let number = |name: &str| std::env::var(name).ok()?.parse::<u64>().ok();
        let own = number("WATCHDOG_PID").is_none_or(|pid| pid == u64::from(std::process::id()));
        let watchdog = number("WATCHDOG_USEC").filter(|_| own);
        let Some(address) = std::env::var_os("NOTIFY_SOCKET") else {
            return Self::default();
        };
        Self::to(&address, watchdog.map(Duration::from_micros)).unwrap_or_else(|error| {
            log::warning!(
                "cannot report to systemd at NOTIFY_SOCKET {}: {error}",
                address.display()
            );
            Self::default()
        })
    }

    /// Connects to a socket of this name; a name that starts with `@` is abstract.
    pub(super) fn to(address: &OsString, watchdog: Option<Duration>) -> std::io::Result<Self> {
        let address = match address.as_bytes() {
            [b'@', name @ ..] => SocketAddr::from_abstract_name(name)?,
            path => SocketAddr::from_pathname(std::ffi::OsStr::from_bytes(path))?,
        };
        let socket = UnixDatagram::unbound()?;
        // No thread waits for systemd.
        socket.set_nonblocking(true)?;
        Ok(Self {
            way: Some((socket, address)),
            watchdog: watchdog.filter(|w| !w.is_zero()),
        })
    }

    /// Sends assignments as `sd_notify(3)` defines them, one a line.
    pub fn notify(&self, words: &str) {
        if let Some((socket, address)) = &self.way {
            // If the queue is full, this message is lost; there is space for a later one.
            let _ = socket.send_to_addr(words.as_bytes(), address);
        }
    }
}

/// The signs of life of all threads that work; shared by them.
#[derive(Clone, Debug)]
pub struct Watchdog {
    notifier: Arc<Notifier>,
    clock: Clock,
    beats: Arc<Mutex<Heartbeats>>,
}

#[derive(Debug)]
struct Heartbeats {
    /// Each thread, and whether it has shown a sign of life since the watchdog was fed.
    threads: Vec<(&'static str, bool)>,
    fed: Instant,
    /// Whether the silent threads were logged.
    told: bool,
}

/// How much longer systemd lets the start take with each sign of life.
const START: Duration = Duration::from_secs(60);

impl Default for Watchdog {
    fn default() -> Self {
        Self::new(Arc::default(), Clock::system())
    }
}

impl Watchdog {
    /// A watchdog that knows no threads yet.
    pub fn new(notifier: Arc<Notifier>, clock: Clock) -> Self {
        let beats = Heartbeats {
            threads: Vec::new(),
            fed: clock.now(),
            told: false,
        };
        Self {
            notifier,
            clock,
            beats: Arc::new(Mutex::new(beats)),
        }
    }

    /// A heartbeat for a thread that must live from now on. One that is dropped, because its thread panicked, is
    /// silent.
    pub fn heartbeat(&self, thread: &'static str) -> Heartbeat {
        let mut beats = self.beats.lock();
        beats.threads.push((thread, false));
        Heartbeat {
            index: beats.threads.len() - 1,
            watchdog: self.clone(),
        }
    }

    /// Lets the start take so much longer from now on.
    pub fn extend_start_timeout(&self, more: Duration) {
        let more = more.as_micros();
        self.notifier.notify(&format!("EXTEND_TIMEOUT_USEC={more}"));
    }

    /// Feeds the watchdog if all threads have shown a sign of life since it was fed last.
    fn tick(&self, index: usize, now: Instant) {
        let Some(watchdog) = self.notifier.watchdog else {
            return;
        };
        let mut beats = self.beats.lock();
        beats.threads[index].1 = true;
        let hungry = now.saturating_duration_since(beats.fed);
        if beats.threads.iter().all(|(_, heard)| *heard) {
            if hungry < watchdog / 4 {
                return;
            }
            beats
                .threads
                .iter_mut()
                .for_each(|(_, heard)| *heard = false);
            (beats.fed, beats.told) = (now, false);
            // The start may take as long as the cameras need, provided that the threads work.
            let start = START.as_micros();
            self.notifier
                .notify(&format!("WATCHDOG=1\nEXTEND_TIMEOUT_USEC={start}"));
        } else if hungry > watchdog / 2 && !beats.told {
            beats.told = true;
            let silent = beats.threads.iter().filter(|(_, heard)| !heard);
            let silent: Vec<&str> = silent.map(|(name, _)| *name).collect();
            let (silent, ms) = (silent.join(", "), hungry.as_millis());
            log::error!(
                "these threads have not reported for {ms} ms: {silent}; systemd will restart the daemon"
            );
        }
    }
}

/// A thread's own sign of life.
#[derive(Debug)]
pub struct Heartbeat {
    index: usize,
    watchdog: Watchdog,
}

impl Heartbeat {
    /// How long a thread may wait for work before it must show a sign of life.
    pub const INTERVAL: Duration = Duration::from_millis(500);

    /// Shows that the thread works, or waits for work.
    pub fn tick(&self) {
        self.watchdog.tick(self.index, self.watchdog.clock.now());
    }

    /// Shows that the thread lives, and waits for a message until it has to show it again.
    ///
    /// # Errors
    /// If none came meanwhile, or none can come any more.
    pub(super) fn wait<T>(&self, messages: &Receiver<T>) -> Result<T, RecvTimeoutError> {
        self.tick();
        self.watchdog.clock.recv_timeout(messages, Self::INTERVAL)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A notifier and systemd's end of it.
    fn systemd(watchdog_ms: u64) -> (tempfile::TempDir, UnixDatagram, Arc<Notifier>) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("notify");
        let end = UnixDatagram::bind(&path).unwrap();
        end.set_nonblocking(true).unwrap();
        let watchdog = Duration::from_millis(watchdog_ms);
        let notifier = Notifier::to(&path.into_os_string(), Some(watchdog)).unwrap();
        (folder, end, Arc::new(notifier))
    }

    fn heard(end: &UnixDatagram) -> Vec<String> {
        let mut bytes = [0; 4096];
        let words = |n: usize, bytes: &[u8]| String::from_utf8_lossy(&bytes[..n]).into_owned();
        std::iter::from_fn(|| end.recv(&mut bytes).ok().map(|n| words(n, &bytes))).collect()
    }

    #[test]
    fn the_watchdog_is_fed_while_all_threads_beat_and_starves_when_one_does_not() {
        let (_folder, end, notifier) = systemd(1000);
        let clock = Clock::system();
        let watchdog = Watchdog::new(notifier, clock);
        let (_a, _b) = (
            watchdog.heartbeat("capturing"),
            watchdog.heartbeat("recorder"),
        );
        let begin = clock.now();
        let at = |ms: u64| begin + Duration::from_millis(ms);
        for ms in [300, 310] {
            watchdog.tick(0, at(ms));
            assert_eq!(heard(&end), [""; 0], "one alone does not feed it");
        }
        watchdog.tick(1, at(320));
        assert_eq!(heard(&end).len(), 1);
        assert!(heard(&end).is_empty());
        // Both beat at once again: it is not hungry yet.
        watchdog.tick(0, at(330));
        watchdog.tick(1, at(330));
        assert_eq!(heard(&end), [""; 0]);
        watchdog.tick(0, at(600));
        let fed = heard(&end);
        assert!(
            fed[0].starts_with("WATCHDOG=1\nEXTEND_TIMEOUT_USEC="),
            "{fed:?}"
        );
        // From here on the recorder hangs.
        for ms in 601..5000 {
            watchdog.tick(0, at(ms));
        }
        assert_eq!(heard(&end), [""; 0]);
    }

    #[test]
    fn without_systemd_nothing_is_said_and_nothing_fails() {
        let watchdog = Watchdog::default();
        watchdog.heartbeat("capturing").tick();
        Notifier::default().notify("READY=1");
    }

    #[test]
    fn a_queue_that_nobody_empties_holds_nobody_up() {
        let (_folder, _end, notifier) = systemd(1);
        // If `tell` blocked, this would never end.
        for _ in 0..5000 {
            notifier.notify("STATUS=…");
        }
    }

    #[test]
    fn an_abstract_socket_will_do() {
        let name = format!("scand-test-{}", std::process::id());
        let address = SocketAddr::from_abstract_name(&name).unwrap();
        let end = UnixDatagram::bind_addr(&address).unwrap();
        end.set_nonblocking(true).unwrap();
        let notifier = Notifier::to(&format!("@{name}").into(), None).unwrap();
        notifier.notify("READY=1");
        assert_eq!(heard(&end), ["READY=1"]);
    }
}
