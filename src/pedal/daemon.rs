//! The foot switch's client of the daemon: sends presses and watches whether the daemon runs. A press whose connection
//! breaks is sent again under the same name, so that it stays one press. A press that cannot start within two seconds
//! is given up, because by then the operator's hands may be in the picture again. That a connection succeeds does not
//! mean that the daemon runs: with socket activation systemd accepts it first.

use crate::clock::Clock;
use crate::trigger::{Client, Error, Event, Reply, Request, Until};
use parking_lot::Mutex;
use std::collections::VecDeque;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// How long a press may wait until it is accepted: by then systemd has restarted a daemon that crashed.
const BEGIN: Duration = Duration::from_secs(2);
/// How long the client keeps asking for the outcome of a capture after it was accepted.
const END: Duration = Duration::from_secs(30);
/// How long the client waits for a reply.
const PATIENCE: Duration = Duration::from_secs(120);
/// Pause before the next attempt.
const PAUSE: Duration = Duration::from_millis(200);
/// How often the watch checks whether a daemon that was stopped is back.
const LOOK: Duration = Duration::from_secs(1);
/// Captures that are remembered: more than can be on their way to the disk at once.
const REMEMBERED: usize = 64;

/// The daemon, as a foot switch sees it.
#[derive(Clone, Debug)]
pub struct Daemon {
    socket: PathBuf,
    clock: Clock,
    /// How long a press may wait until it is accepted.
    begin: Duration,
    /// The last captures in the order in which they were taken, whichever client asked for them.
    taken: Arc<Mutex<VecDeque<String>>>,
    /// Whether a press was answered since this was last read.
    answered: Arc<AtomicBool>,
}

/// A press whose outcome is not known.
#[derive(Debug, thiserror::Error)]
#[error("{error}")]
pub struct Unanswered {
    /// Whether the daemon was asked for the capture, so that it may have taken it.
    pub was_asked: bool,
    /// Why there is no outcome.
    pub error: Error,
}

/// How far a press has come.
struct Pressed {
    was_asked: bool,
    was_accepted: bool,
    /// Since when the outcome is waited for, and how long at most: first that it begins, then that it ends.
    since: Instant,
    at_most: Duration,
}

/// What the watch found.
#[derive(Debug)]
pub enum DaemonState {
    /// The daemon answers.
    There,
    /// The daemon does not answer, and why.
    Away(Error),
    /// The daemon was told to stop, and has stopped; or it cannot start.
    Ended,
}

/// Why listening ended.
#[derive(Debug)]
enum ListeningEnd {
    /// The caller wants no more events.
    Enough,
    /// The daemon is stopping, or cannot start.
    Ending,
}

impl Daemon {
    /// A client of the daemon that listens on `socket`.
    pub fn new(socket: &Path, clock: Clock) -> Self {
        Self {
            socket: socket.into(),
            clock,
            begin: BEGIN,
            taken: Arc::default(),
            answered: Arc::default(),
        }
    }

    /// Asks for a capture and waits for its outcome; `progress` is called with every reply.
    ///
    /// # Errors
    /// If the daemon cannot be reached, or does not answer in time.
    pub fn press(
        &self,
        press_id: &str,
        progress: &mut dyn FnMut(&Reply),
    ) -> Result<Reply, Unanswered> {
        let request = Request::Trigger {
            source: "pedal".into(),
            press_id: Some(press_id.into()),
            subject: None,
            placement: None,
            until: Until::Durable,
        };
        let mut pressed = Pressed {
            was_asked: false,
            was_accepted: false,
            since: self.clock.now(),
            at_most: self.begin,
        };
        loop {
            let error = match self.attempt(&request, &mut pressed, progress) {
                Ok(reply) => return Ok(reply),
                Err(error) => error,
            };
            if self.clock.elapsed(pressed.since) >= pressed.at_most {
                let was_asked = pressed.was_asked;
                return Err(Unanswered { was_asked, error });
            }
            self.clock.sleep(PAUSE);
        }
    }

    /// Asks for the capture once the daemon has answered a request for its status within the time that is left.
    fn attempt(
        &self,
        request: &Request,
        pressed: &mut Pressed,
        progress: &mut dyn FnMut(&Reply),
    ) -> Result<Reply, Error> {
        let passed = self.clock.elapsed(pressed.since);
        let left = pressed.at_most.saturating_sub(passed).max(PAUSE);
        let mut client = Client::connect(&self.socket, Some(left))?;
        client.send(&Request::Status {})?;
        let reply = client.reply()?;
        if !matches!(reply, Reply::Status { .. }) {
            progress(&reply);
            return Ok(reply);
        }
        self.answered.store(true, Ordering::Release);
        client.set_patience(PATIENCE)?;
        pressed.was_asked = true;
        client.send(request)?;
        loop {
            let reply = client.reply()?;
            if matches!(reply, Reply::Accepted { .. }) && !pressed.was_accepted {
                pressed.was_accepted = true;
                (pressed.since, pressed.at_most) = (self.clock.now(), END);
            }
            if let Reply::Accepted { capture, .. }
            | Reply::Captured { capture, .. }
            | Reply::Durable { capture, .. }
            | Reply::Failed { capture, .. } = &reply
            {
                self.remember(capture);
            }
            progress(&reply);
            if reply.is_end(Until::Durable) {
                return Ok(reply);
            }
        }
    }

    /// Marks the capture that was taken last as rejected, also if it failed or is on its way to the disk; `None` if
    /// there was none since this program started, or since a daemon was last told to stop.
    ///
    /// # Errors
    /// If the daemon cannot be reached.
    pub fn reject_last(&self) -> Result<Option<(String, Reply)>, Error> {
        let taken = self.taken.lock();
        let Some(capture) = taken.back().cloned() else {
            return Ok(None);
        };
        drop(taken);
        let request = Request::Note {
            capture: capture.clone(),
            kind: "reject".into(),
            text: "foot switch".into(),
            author: None,
        };
        let mut client = Client::connect(&self.socket, Some(PATIENCE))?;
        client.send(&request)?;
        Ok(Some((capture, client.reply()?)))
    }

    /// Follows the daemon's events for as long as `go_on` returns true; reconnects when the daemon is away. A daemon
    /// that was told to stop is not contacted until its socket changes or a press was answered: a connect would start
    /// it.
    pub fn watch(&self, mut go_on: impl FnMut(DaemonState) -> bool) {
        let longest = Duration::from_secs(5);
        let mut pause = PAUSE;
        loop {
            let mut was_there = false;
            let listened = self.listen(&mut || {
                was_there = true;
                go_on(DaemonState::There)
            });
            pause = if was_there {
                PAUSE
            } else {
                (pause * 2).min(longest)
            };
            let goes_on = match listened {
                Ok(ListeningEnd::Enough) => false,
                Ok(ListeningEnd::Ending) => {
                    self.answered.store(false, Ordering::Release);
                    // Captures that the next daemon takes for other clients may not be heard of.
                    self.taken.lock().clear();
                    let goes_on = go_on(DaemonState::Ended);
                    self.wait_for_another();
                    goes_on
                }
                Err(error) => go_on(DaemonState::Away(error)),
            };
            if !goes_on {
                return;
            }
            self.clock.sleep(pause);
        }
    }

    /// Waits until a press was answered, or until the socket was removed or replaced.
    fn wait_for_another(&self) {
        let socket = || std::fs::metadata(&self.socket).map(|m| (m.dev(), m.ino(), m.ctime_nsec()));
        let before = socket().ok();
        while before.is_some() && socket().ok() == before {
            self.clock.sleep(LOOK);
            if self.answered.swap(false, Ordering::AcqRel) {
                return;
            }
        }
    }

    /// Listens until the connection breaks or the caller wants no more events.
    fn listen(&self, there: &mut dyn FnMut() -> bool) -> Result<ListeningEnd, Error> {
        let mut client = Client::connect(&self.socket, None)?;
        client.send(&Request::Events {})?;
        if matches!(client.reply()?, Reply::Refused { .. }) {
            // One that cannot start says that it ends; the connection to another one breaks.
            while client.event()? != Event::Ending {}
            return Ok(ListeningEnd::Ending);
        }
        if !there() {
            return Ok(ListeningEnd::Enough);
        }
        loop {
            match client.event()? {
                // One that fails is told as such only when it is on the disk.
                Event::Accepted { capture, .. }
                | Event::Captured { capture, .. }
                | Event::Durable { capture, .. }
                | Event::Failed { capture, .. } => self.remember(&capture),
                Event::Ending => return Ok(ListeningEnd::Ending),
                _ => {}
            }
        }
    }

    /// Remembers a capture when it is first heard of: an earlier one may reach the disk after a later one was taken.
    fn remember(&self, capture: &str) {
        let mut taken = self.taken.lock();
        if taken.iter().any(|known| known == capture) {
            return;
        }
        if taken.len() == REMEMBERED {
            taken.pop_front();
        }
        taken.push_back(capture.to_owned());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::{BufRead, BufReader, Write};
    use std::os::unix::net::UnixListener;
    use std::sync::mpsc::{Receiver, channel};

    fn by_hand() -> Clock {
        Clock::by_hand(crate::frame::Timestamp(0))
    }

    const STATUS: &str = r#"{"type":"status","status":{}}"#;

    /// Serves one connection after the other: answers a request for the status, passes the next request on to the test,
    /// and sends that connection's lines.
    fn serve(path: &Path, connections: &[&[&str]]) -> Receiver<String> {
        let listener = UnixListener::bind(path).unwrap();
        let (sender, requests) = channel();
        let connections: Vec<Vec<String>> = connections
            .iter()
            .map(|lines| lines.iter().map(ToString::to_string).collect())
            .collect();
        std::thread::spawn(move || {
            for lines in connections {
                let (mut stream, _) = listener.accept().unwrap();
                let mut asked = BufReader::new(stream.try_clone().unwrap()).lines();
                let mut request = asked.next().unwrap().unwrap();
                if request.contains("status") {
                    writeln!(stream, "{STATUS}").unwrap();
                    request = asked.next().unwrap().unwrap();
                }
                sender.send(request).unwrap();
                for line in lines {
                    writeln!(stream, "{line}").unwrap();
                }
            }
        });
        requests
    }

    const ACCEPTED: &str = r#"{"type":"accepted","capture":"a-0001"}"#;
    const DURABLE: &str = r#"{"type":"durable","capture":"a-0001","recording":"/r/a.mcap"}"#;

    #[test]
    fn a_press_whose_connection_breaks_is_sent_again_under_its_own_name() {
        let folder = tempfile::tempdir().unwrap();
        let socket = folder.path().join("s");
        let requests = serve(
            &socket,
            &[
                &[],
                &[ACCEPTED],
                &[ACCEPTED, DURABLE],
                &[r#"{"type":"ok","words":"done"}"#],
            ],
        );
        let clock = by_hand();
        let daemon = Daemon::new(&socket, clock);
        let mut heard = 0;
        let end = daemon.press("pedal-7", &mut |_| heard += 1).unwrap();
        assert!(matches!(end, Reply::Durable { .. }), "{end:?}");
        assert_eq!(heard, 3);
        let sent: Vec<String> = requests.iter().take(3).collect();
        assert!(
            sent[0].contains("pedal-7") && sent[0].contains("\"pedal\""),
            "{sent:?}"
        );
        assert!(sent[0] == sent[1] && sent[1] == sent[2], "{sent:?}");
        let (capture, _) = daemon.reject_last().unwrap().unwrap();
        assert_eq!(capture, "a-0001");
        let note = requests.recv().unwrap();
        assert!(note.contains("reject") && note.contains("a-0001"), "{note}");
    }

    #[test]
    fn a_press_that_cannot_be_begun_is_given_up_soon() {
        let folder = tempfile::tempdir().unwrap();
        let clock = by_hand();
        let daemon = Daemon::new(&folder.path().join("none"), clock);
        let begin = clock.now();
        let error = daemon.press("p", &mut |_| ()).unwrap_err();
        assert!(
            error.to_string().contains("is the daemon running"),
            "{error}"
        );
        assert!(!error.was_asked);
        assert_eq!(clock.elapsed(begin), BEGIN);
        assert!(daemon.reject_last().unwrap().is_none());
    }

    #[test]
    fn a_press_is_not_left_with_a_socket_that_nobody_serves() {
        let folder = tempfile::tempdir().unwrap();
        let socket = folder.path().join("s");
        let listener = UnixListener::bind(&socket).unwrap();
        // The kernel ends the wait for an answer, and it knows only real time.
        let daemon = Daemon {
            begin: Duration::from_millis(50),
            ..Daemon::new(&socket, Clock::system())
        };
        daemon.press("p", &mut |_| ()).unwrap_err();
        // A daemon that starts now finds no request for a capture.
        listener.set_nonblocking(true).unwrap();
        let mut left = 0;
        while let Ok((stream, _)) = listener.accept() {
            let mut lines = BufReader::new(stream).lines();
            assert_eq!(lines.next().unwrap().unwrap(), r#"{"type":"status"}"#);
            assert!(lines.next().is_none());
            left += 1;
        }
        assert!(left > 0);
    }

    #[test]
    fn a_daemon_that_was_told_to_end_is_not_called_again_before_a_press_or_another_socket() {
        let folder = tempfile::tempdir().unwrap();
        let socket = folder.path().join("s");
        let (listening, ending) = (r#"{"type":"listening"}"#, r#"{"type":"ending"}"#);
        let requests = serve(
            &socket,
            &[
                &[listening, ending],
                &[ACCEPTED, DURABLE],
                &[listening, ending],
            ],
        );
        let clock = by_hand();
        let daemon = Daemon::new(&socket, clock);
        let (sender, found) = channel();
        let watching = daemon.clone();
        std::thread::spawn(move || {
            watching.watch(|watch| sender.send(format!("{watch:?}")).is_ok());
        });
        assert_eq!(
            [found.recv().unwrap(), found.recv().unwrap()],
            ["There", "Ended"]
        );
        assert!(requests.recv().unwrap().contains("events"));
        // A connect would succeed; the watch has checked the socket about 20 times and must not have connected.
        let ended = clock.now();
        while clock.elapsed(ended) < 20 * LOOK {
            std::thread::yield_now();
        }
        assert!(requests.try_recv().is_err());
        daemon.press("p", &mut |_| ()).unwrap();
        assert!(requests.recv().unwrap().contains("trigger"));
        assert!(requests.recv().unwrap().contains("events"));
        assert_eq!(
            [found.recv().unwrap(), found.recv().unwrap()],
            ["There", "Ended"]
        );
        std::fs::remove_file(&socket).unwrap();
        let away = found.recv().unwrap();
        assert!(away.contains("Away"), "{away}");
    }

    #[test]
    fn what_a_daemon_took_before_it_was_told_to_end_is_not_rejected_afterwards() {
        let folder = tempfile::tempdir().unwrap();
        let socket = folder.path().join("s");
        let captured = r#"{"type":"captured","capture":"a-0001","skew_ns":0}"#;
        let (listening, ending) = (r#"{"type":"listening"}"#, r#"{"type":"ending"}"#);
        let _requests = serve(&socket, &[&[listening, captured, ending]]);
        let daemon = Daemon::new(&socket, by_hand());
        daemon.watch(|state| {
            let has_ended = matches!(state, DaemonState::Ended);
            if has_ended {
                // The watch waits for another socket before it returns.
                std::fs::remove_file(&socket).unwrap();
            } else {
                assert!(matches!(state, DaemonState::There), "{state:?}");
            }
            !has_ended
        });
        assert!(daemon.reject_last().unwrap().is_none());
    }

    #[test]
    fn a_daemon_that_cannot_start_is_not_called_again() {
        let folder = tempfile::tempdir().unwrap();
        let socket = folder.path().join("s");
        let refused = r#"{"type":"refused","reason":"the daemon cannot start"}"#;
        let _requests = serve(&socket, &[&[refused, r#"{"type":"ending"}"#]]);
        let mut found = Vec::new();
        Daemon::new(&socket, by_hand()).watch(|state| {
            found.push(format!("{state:?}"));
            // The watch waits for another socket before it returns.
            std::fs::remove_file(&socket).unwrap();
            false
        });
        assert_eq!(found, ["Ended"]);
    }

    #[test]
    fn who_watches_hears_that_the_daemon_is_away_and_back() {
        let folder = tempfile::tempdir().unwrap();
        let socket = folder.path().join("s");
        let clock = by_hand();
        let daemon = Daemon::new(&socket, clock);
        let mut found = Vec::new();
        let mut requests = None;
        daemon.watch(|watch| {
            found.push(matches!(watch, DaemonState::There));
            if found.len() == 1 {
                let listening = r#"{"type":"listening"}"#;
                requests = Some(serve(&socket, &[&[listening, DURABLE], &[listening]]));
            }
            found.len() < 4
        });
        assert_eq!(found, [false, true, false, true]);
        assert_eq!(*daemon.taken.lock(), ["a-0001"]);
    }

    #[test]
    fn what_is_rejected_is_what_was_taken_last_and_not_what_is_on_the_disk_last() {
        let folder = tempfile::tempdir().unwrap();
        let socket = folder.path().join("s");
        const LISTENING: &str = r#"{"type":"listening"}"#;
        const CAPTURED: &str = r#"{"type":"captured","capture":"a-0002","skew_ns":0}"#;
        const FAILED: &str = r#"{"type":"failed","capture":"a-0003","reason":"c00 gave no frame"}"#;
        let daemon = Daemon::new(&socket, by_hand());
        let last = |requests: &Receiver<String>| {
            let (capture, _) = daemon.reject_last().unwrap().unwrap();
            assert!(requests.iter().any(|asked| asked.contains(&capture)));
            capture
        };
        const OK: &str = r#"{"type":"ok","words":"done"}"#;
        // The second is taken while the first is on its way to the disk.
        const FIRST: &str = r#"{"type":"captured","capture":"a-0001","skew_ns":0}"#;
        let requests = serve(&socket, &[&[LISTENING, FIRST, CAPTURED, DURABLE], &[OK]]);
        daemon.listen(&mut || true).unwrap_err();
        assert_eq!(last(&requests), "a-0002");
        std::fs::remove_file(&socket).unwrap();
        let requests = serve(&socket, &[&[ACCEPTED, FAILED], &[OK]]);
        daemon.press("q", &mut |_| ()).unwrap();
        assert_eq!(last(&requests), "a-0003");
        // One that fails is heard of before it is on the disk, whoever asked for it.
        const FOURTH: &str = r#"{"type":"accepted","capture":"a-0004"}"#;
        std::fs::remove_file(&socket).unwrap();
        let requests = serve(&socket, &[&[LISTENING, FOURTH], &[OK]]);
        daemon.listen(&mut || true).unwrap_err();
        assert_eq!(last(&requests), "a-0004");
        const FIFTH: &str = r#"{"type":"accepted","capture":"a-0005"}"#;
        std::fs::remove_file(&socket).unwrap();
        let _requests = serve(&socket, &[&[FIFTH]]);
        daemon.press("r", &mut |_| ()).unwrap_err();
        std::fs::remove_file(&socket).unwrap();
        let requests = serve(&socket, &[&[OK]]);
        assert_eq!(last(&requests), "a-0005");
    }

    #[test]
    fn a_press_that_was_sent_and_not_answered_may_have_taken_a_capture() {
        let folder = tempfile::tempdir().unwrap();
        let socket = folder.path().join("s");
        let _requests = serve(&socket, &[&[ACCEPTED]]);
        let daemon = Daemon::new(&socket, by_hand());
        let unanswered = daemon.press("p", &mut |_| ()).unwrap_err();
        assert!(unanswered.was_asked, "{unanswered}");
    }
}
