//! Keeps what holds now up to date, with the two connections that the page has of its own: one for the daemon's events,
//! one for its status. Tells everybody who waits when something changed.

use super::daemon::{Connection, Daemon, Error};
use super::metrics::Metrics;
use super::now::{KeptCapture, Now};
use super::objects::folder_of;
use crate::log;
use crate::trigger::{Event, Reply, Request};
use parking_lot::Mutex;
use std::collections::VecDeque;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::sync::watch;

/// How often the status is asked for.
const EVERY: Duration = Duration::from_secs(1);
/// How long the daemon may take for its status.
const PATIENCE: Duration = Duration::from_secs(3);

/// Models that wait until somebody takes them.
const MOST_MADE: usize = 50;

/// What holds now, shared by the threads that keep it and those that show it.
pub(super) struct Watch {
    now: Mutex<Now>,
    metrics: Mutex<Metrics>,
    /// Models that were made, as recording and name, the oldest first.
    made: Mutex<VecDeque<[String; 2]>>,
    changed: watch::Sender<u64>,
}

impl Watch {
    pub(super) fn new() -> Arc<Self> {
        Arc::new(Self {
            now: Mutex::default(),
            metrics: Mutex::default(),
            made: Mutex::default(),
            changed: watch::Sender::new(0),
        })
    }

    /// Looks at what holds now.
    pub(super) fn look<T>(&self, see: impl FnOnce(&Now) -> T) -> T {
        see(&self.now.lock())
    }

    /// Takes in the captures that an earlier process kept so long ago.
    pub(super) fn restore(&self, kept: Vec<KeptCapture>, ago: Duration) {
        self.change(|now| now.restore(kept, ago, Instant::now()));
    }

    /// What was counted.
    pub(super) fn metrics(&self) -> String {
        let (now, at) = (self.now.lock(), Instant::now());
        let status = now.status(at).map(|(status, _)| status);
        self.metrics.lock().text(status)
    }

    /// Wakes at each change.
    pub(super) fn changes(&self) -> watch::Receiver<u64> {
        self.changed.subscribe()
    }

    /// The next model that was made and that nobody took yet.
    pub(super) fn take_made(&self) -> Option<[String; 2]> {
        self.made.lock().pop_front()
    }

    fn note_made(&self, event: &Event) {
        let folder = match event {
            Event::Done { model, .. } => Some(model),
            Event::Fused { model, .. } | Event::Remade { model, .. } => model.as_ref(),
            _ => None,
        };
        if let Some(named) = folder.and_then(|folder| folder_of(folder)) {
            let mut made = self.made.lock();
            while made.len() >= MOST_MADE {
                made.pop_front();
            }
            made.push_back(named);
        }
    }

    fn change(&self, change: impl FnOnce(&mut Now)) {
        change(&mut self.now.lock());
        self.changed.send_modify(|revision| *revision += 1);
    }

    /// Listens to the daemon's events, for ever.
    pub(super) async fn keep_events(&self, daemon: &Daemon) {
        let mut told = false;
        loop {
            let Err(error) = self.listen(daemon, &mut told).await;
            self.change(|now| now.set_listening(false));
            if !told {
                log::warning!("{error}");
                told = true;
            }
            tokio::time::sleep(EVERY).await;
        }
    }

    async fn listen(
        &self,
        daemon: &Daemon,
        told: &mut bool,
    ) -> Result<std::convert::Infallible, Error> {
        let mut connection = daemon.open().await?;
        match connection.ask(&Request::Events {}, PATIENCE).await? {
            Reply::Listening => {}
            reply => return Err(daemon.refused(&mut connection, reply).await),
        }
        log::notice!("the daemon answers");
        *told = false;
        self.change(|now| now.set_listening(true));
        loop {
            let event = connection.event().await?;
            if matches!(event, Event::Ending) {
                daemon.has_ended();
            }
            let at = Instant::now();
            self.metrics.lock().hear(&event, at);
            self.note_made(&event);
            self.change(|now| now.hear(&event, at));
            match event {
                Event::Ending => {
                    return Err(Error::Away(std::io::ErrorKind::ConnectionReset.into()));
                }
                // What was in progress may have ended with one of them.
                Event::Lost { events } => return Err(Error::Behind(events)),
                _ => {}
            }
        }
    }

    /// Asks the daemon for its status, for ever.
    pub(super) async fn keep_status(&self, daemon: &Daemon) {
        let mut connection = None;
        loop {
            match status(&mut connection, daemon).await {
                Ok(status) => self.change(|now| now.set_status(Some(status), Instant::now())),
                // What it said before is forgotten when it is too old.
                Err(Error::Slow) => connection = None,
                Err(_) => {
                    connection = None;
                    self.change(|now| now.set_status(None, Instant::now()));
                }
            }
            tokio::time::sleep(EVERY).await;
        }
    }
}

async fn status(
    connection: &mut Option<Connection>,
    daemon: &Daemon,
) -> Result<serde_json::Value, Error> {
    let open = match connection.take() {
        Some(open) => open,
        None => daemon.open().await?,
    };
    let open = connection.insert(open);
    match open.ask(&Request::Status {}, PATIENCE).await? {
        Reply::Status { status } => Ok(status),
        reply => Err(daemon.refused(open, reply).await),
    }
}

#[cfg(test)]
mod tests {
    use super::super::now::Sign;
    use super::*;
    use std::io::{BufRead, BufReader, Write};
    use std::os::unix::net::UnixListener;
    use std::sync::atomic::{AtomicUsize, Ordering};

    /// A daemon whose first listener hears these lines, and all later ones nothing; how many listened.
    fn serve(path: &std::path::Path, lines: &'static str) -> Arc<AtomicUsize> {
        let listener = UnixListener::bind(path).unwrap();
        let listeners = Arc::new(AtomicUsize::new(0));
        let counted = listeners.clone();
        std::thread::spawn(move || {
            let mut kept = Vec::new();
            for mut stream in listener.incoming().map_while(Result::ok) {
                let asked = BufReader::new(stream.try_clone().unwrap()).lines().next();
                assert!(asked.unwrap().unwrap().contains("events"));
                let is_first = counted.fetch_add(1, Ordering::SeqCst) == 0;
                let heard = if is_first { lines } else { "" };
                let _ = write!(stream, "{{\"type\":\"listening\"}}\n{heard}");
                kept.push(stream);
            }
        });
        listeners
    }

    #[test]
    fn a_listener_that_missed_events_listens_anew_and_takes_nothing_for_still_in_progress() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scand.sock");
        let accepted = r#"{"type":"accepted","capture":"a-0001"}"#;
        let lost = r#"{"type":"lost","events":7}"#;
        let listeners = serve(&path, format!("{accepted}\n{lost}\n").leak());
        let (watch, daemon) = (Watch::new(), Daemon::new(&path));
        let signs = || watch.look(|now| now.captures().map(|seen| seen.sign).collect::<Vec<_>>());
        let mut builder = tokio::runtime::Builder::new_current_thread();
        let runtime = builder.enable_all().build().unwrap();
        runtime.block_on(async {
            let heard_anew = async {
                while listeners.load(Ordering::SeqCst) < 2 {
                    tokio::time::sleep(Duration::from_millis(10)).await;
                }
            };
            tokio::select! {
                () = watch.keep_events(&daemon) => {}
                in_time = tokio::time::timeout(Duration::from_secs(60), heard_anew) => in_time.unwrap(),
            }
        });
        assert_eq!(signs(), [Sign::OutcomeUnknown]);
    }

    #[test]
    fn a_daemon_that_ends_or_cannot_start_is_not_called_again_before_it_is_seen_to_run() {
        is_called_once("{\"type\":\"listening\"}\n{\"type\":\"ending\"}\n");
        is_called_once("{\"type\":\"refused\",\"reason\":\"x\"}\n{\"type\":\"ending\"}\n");
    }

    /// Asks a daemon that answers with these lines for its events and its status, as often as the page would.
    fn is_called_once(lines: &'static str) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scand.sock");
        let listener = UnixListener::bind(&path).unwrap();
        let served = std::thread::spawn(move || {
            let (mut stream, _) = listener.accept().unwrap();
            let asked = BufReader::new(stream.try_clone().unwrap()).lines().next();
            assert!(asked.unwrap().unwrap().contains("events"));
            stream.write_all(lines.as_bytes()).unwrap();
            listener
        });
        let runtime = tokio::runtime::Builder::new_current_thread();
        let runtime = { runtime }.enable_all().build().unwrap();
        let daemon = Daemon::new(&path);
        runtime.block_on(async {
            let watch = Watch::new();
            for _ in 0..2 {
                watch.listen(&daemon, &mut false).await.unwrap_err();
            }
            status(&mut None, &daemon).await.unwrap_err();
        });
        let listener = served.join().unwrap();
        listener.set_nonblocking(true).unwrap();
        assert!(listener.accept().is_err(), "it was called again");
    }

    #[test]
    fn of_too_many_models_that_wait_the_oldest_are_dropped() {
        let watch = Watch::new();
        for n in 0..=MOST_MADE {
            let done = format!(
                r#"{{"type":"done","capture":"a-{n}","verdict":"green","model":"/m/a/a-{n}"}}"#
            );
            watch.note_made(&serde_json::from_str(&done).unwrap());
        }
        let made: Vec<_> = std::iter::from_fn(|| watch.take_made()).collect();
        let (first, last) = (&made[0][1], &made[MOST_MADE - 1][1]);
        assert_eq!(
            (first.as_str(), last.clone()),
            ("a-1", format!("a-{MOST_MADE}"))
        );
    }
}
