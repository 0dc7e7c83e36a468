//! What a press asks the daemon, and whether the daemon is there. A press whose connection breaks is sent again under
//! its own name, which makes it the same press; one that could not be begun at once is given up, because hands come back
//! into the picture. That a connection can be had says nothing: where systemd holds the socket it takes what is written
//! for a daemon that is yet to start.

use crate::clock::Clock;
use crate::trigger::{Client, Error, Event, Reply, Request, Until};
use parking_lot::Mutex;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// How long a press may wait to be begun: a daemon that systemd starts again is there by then.
const BEGIN: Duration = Duration::from_secs(2);
/// How long the end of a capture that was begun is asked for again.
const END: Duration = Duration::from_secs(30);
/// How long a reply is waited for.
const PATIENCE: Duration = Duration::from_secs(120);
/// Pause before an attempt is repeated.
const PAUSE: Duration = Duration::from_millis(200);
/// How often it is looked whether a daemon that has ended is there again.
const LOOK: Duration = Duration::from_secs(1);

/// The daemon, from a foot switch.
#[derive(Clone, Debug)]
pub struct Daemon {
    socket: PathBuf,
    clock: Clock,
    /// How long a press may wait to be begun.
    begin: Duration,
    /// The last capture that came to the disk, whoever asked for it.
    last: Arc<Mutex<Option<String>>>,
    /// Whether a press was answered since this was last looked at.
    answered: Arc<AtomicBool>,
}

/// What watching the daemon found.
#[derive(Debug)]
pub enum Watch {
    /// It is there.
    There,
    /// It is not, and why.
    Away(Error),
    /// It has ended as it was told to.
    Ended,
}

/// Why listening is over.
enum Heard {
    /// Nobody wants to hear more.
    Enough,
    /// The daemon is ending.
    Ending,
}

impl Daemon {
    /// The one that listens there.
    pub fn new(socket: &Path, clock: Clock) -> Self {
        Self {
            socket: socket.into(),
            clock,
            begin: BEGIN,
            last: Arc::default(),
            answered: Arc::default(),
        }
    }

    /// Asks for a capture and waits for its end, `progress` hearing of it.
    ///
    /// # Errors
    /// If the daemon is away, or does not answer, and that stays so.
    pub fn press(&self, press_id: &str, progress: &mut dyn FnMut(&Reply)) -> Result<Reply, Error> {
        let request = Request::Trigger {
            source: "pedal".into(),
            press_id: Some(press_id.into()),
            subject: None,
            until: Until::Durable,
        };
        let begin = self.clock.now();
        let mut begun = false;
        loop {
            let at_most = if begun { END } else { self.begin };
            let left = at_most.saturating_sub(self.clock.elapsed(begin)).max(PAUSE);
            let error = match self.attempt(&request, left, &mut begun, progress) {
                Ok(reply) => return Ok(reply),
                Err(error) => error,
            };
            let at_most = if begun { END } else { self.begin };
            if self.clock.elapsed(begin) >= at_most {
                return Err(error);
            }
            self.clock.sleep(PAUSE);
        }
    }

    /// Asks for the capture once the daemon has shown, within `left`, that it answers.
    fn attempt(
        &self,
        request: &Request,
        left: Duration,
        begun: &mut bool,
        progress: &mut dyn FnMut(&Reply),
    ) -> Result<Reply, Error> {
        let mut client = Client::connect(&self.socket, Some(left))?;
        client.send(&Request::Status {})?;
        let reply = client.reply()?;
        self.answered.store(true, Ordering::Release);
        if !matches!(reply, Reply::Status { .. }) {
            progress(&reply);
            return Ok(reply);
        }
        client.set_patience(PATIENCE)?;
        client.send(request)?;
        loop {
            let reply = client.reply()?;
            *begun |= matches!(reply, Reply::Accepted { .. });
            progress(&reply);
            if reply.is_end(Until::Durable) {
                if let Reply::Durable { capture, .. } = &reply {
                    self.remember(capture);
                }
                return Ok(reply);
            }
        }
    }

    /// Notes that the last capture is not to be used; `None` where there was none since this program began.
    ///
    /// # Errors
    /// If the daemon is away.
    pub fn reject_last(&self) -> Result<Option<(String, Reply)>, Error> {
        let last = self.last.lock();
        let Some(capture) = last.clone() else {
            return Ok(None);
        };
        drop(last);
        let request = Request::Note {
            capture: capture.clone(),
            kind: "reject".into(),
            text: "foot switch".into(),
        };
        let mut client = Client::connect(&self.socket, Some(PATIENCE))?;
        client.send(&request)?;
        Ok(Some((capture, client.reply()?)))
    }

    /// Listens to what happens, as long as `go_on` says so of what was found; connects again when the daemon is away. One
    /// that was told to end is left alone until it is there again, or a press wants it: to connect would start it.
    pub fn watch(&self, mut go_on: impl FnMut(Watch) -> bool) {
        let longest = Duration::from_secs(5);
        let mut pause = PAUSE;
        loop {
            let mut was_there = false;
            let listened = self.listen(&mut || {
                was_there = true;
                go_on(Watch::There)
            });
            pause = if was_there {
                PAUSE
            } else {
                (pause * 2).min(longest)
            };
            let goes_on = match listened {
                Ok(Heard::Enough) => false,
                Ok(Heard::Ending) => {
                    self.answered.store(false, Ordering::Release);
                    let goes_on = go_on(Watch::Ended);
                    self.wait_for_another();
                    goes_on
                }
                Err(error) => go_on(Watch::Away(error)),
            };
            if !goes_on {
                return;
            }
            self.clock.sleep(pause);
        }
    }

    /// Waits until a press was answered, or the socket is gone or another one.
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

    /// Listens until the connection breaks, or nobody wants to.
    fn listen(&self, there: &mut dyn FnMut() -> bool) -> Result<Heard, Error> {
        let mut client = Client::connect(&self.socket, None)?;
        client.send(&Request::Events {})?;
        client.reply()?;
        if !there() {
            return Ok(Heard::Enough);
        }
        loop {
            match client.event()? {
                Event::Durable { capture, .. } => self.remember(&capture),
                Event::Ending => return Ok(Heard::Ending),
                _ => {}
            }
        }
    }

    fn remember(&self, capture: &str) {
        let mut last = self.last.lock();
        *last = Some(capture.to_owned());
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

    /// Serves one connection after the other with the lines of each, after its status where it is asked for that first;
    /// a request is handed over as it came.
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
        assert_eq!(clock.elapsed(begin), BEGIN);
        assert!(daemon.reject_last().unwrap().is_none());
    }

    #[test]
    fn a_press_is_not_left_with_a_socket_that_nobody_serves() {
        let folder = tempfile::tempdir().unwrap();
        let socket = folder.path().join("s");
        let listener = UnixListener::bind(&socket).unwrap();
        // It is the kernel that ends the wait for an answer, by the time that really passes.
        let daemon = Daemon {
            begin: Duration::from_millis(50),
            ..Daemon::new(&socket, Clock::system())
        };
        daemon.press("p", &mut |_| ()).unwrap_err();
        // A daemon that starts now finds nobody who wants a capture.
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
        // Systemd's socket would take a connection. The watch looks each second of its clock whether it may.
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
    fn who_watches_hears_that_the_daemon_is_away_and_back() {
        let folder = tempfile::tempdir().unwrap();
        let socket = folder.path().join("s");
        let clock = by_hand();
        let daemon = Daemon::new(&socket, clock);
        let mut found = Vec::new();
        let mut requests = None;
        daemon.watch(|watch| {
            found.push(matches!(watch, Watch::There));
            if found.len() == 1 {
                let listening = r#"{"type":"listening"}"#;
                requests = Some(serve(&socket, &[&[listening, DURABLE], &[listening]]));
            }
            found.len() < 4
        });
        assert_eq!(found, [false, true, false, true]);
        assert_eq!(daemon.last.lock().as_deref(), Some("a-0001"));
    }
}
