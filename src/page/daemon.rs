//! The page's client of the daemon's socket: at most eight connections, however many people look. Three are the page's
//! own (the events and the status, see `watch`, and the cameras' pictures, see `look`), the others carry people's
//! requests.

use crate::trigger::{Event, LONGEST_REPLY, Reply, Request, Until};
use parking_lot::Mutex;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use tokio::io::{AsyncBufReadExt, AsyncReadExt, AsyncWriteExt, BufReader};
use tokio::net::UnixStream;
use tokio::net::unix::{OwnedReadHalf, OwnedWriteHalf};
use tokio::sync::{Semaphore, SemaphorePermit};
use tokio::time::timeout;

/// Connections for people's requests.
const REQUESTS: usize = 5;
/// How long a request waits for one of the connections.
const QUEUE: Duration = Duration::from_secs(2);
/// How long a press may wait until it is accepted; later, hands are in the picture again.
const BEGIN: Duration = Duration::from_secs(2);
/// How long the outcome of a press that was accepted is asked for.
const END: Duration = Duration::from_secs(60);
/// How long plates, sessions and notes may take.
const PATIENCE: Duration = Duration::from_secs(60);
const PAUSE: Duration = Duration::from_millis(200);

/// Why the daemon did not answer.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub(super) enum Error {
    #[error("the daemon does not answer: {0}")]
    Away(std::io::Error),
    #[error("the daemon does not answer in time")]
    Slow,
    #[error(
        "the daemon sent {0:?}, which is not a reply that this page knows: check that both have the same version"
    )]
    Senseless(String),
    #[error(
        "the daemon did not say in time what became of the press: look at the history before you press again"
    )]
    Unsure,
    #[error("{0}")]
    Refused(String),
    #[error(
        "the page was too slow to hear {0} of the daemon's events, and asks anew what holds now"
    )]
    Behind(u64),
    #[error(
        "{REQUESTS} requests of this page are already waiting for the daemon: try again in a moment"
    )]
    Full,
}

impl From<std::io::Error> for Error {
    fn from(cause: std::io::Error) -> Self {
        Self::Away(cause)
    }
}

/// How far a press got.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Progress {
    /// The daemon knows nothing of it.
    Unsent,
    /// Whether the daemon took it is not known.
    Sent,
    /// A capture began.
    Accepted,
}

/// A connection to the daemon.
pub(super) struct Connection {
    read: BufReader<OwnedReadHalf>,
    write: OwnedWriteHalf,
}

impl Connection {
    pub(super) async fn open(path: &Path) -> Result<Self, Error> {
        let (read, write) = UnixStream::connect(path).await?.into_split();
        Ok(Self {
            read: BufReader::new(read),
            write,
        })
    }

    pub(super) async fn send(&mut self, request: &Request) -> Result<(), Error> {
        let line = serde_json::to_string(request).unwrap_or_default() + "\n";
        Ok(self.write.write_all(line.as_bytes()).await?)
    }

    /// The next line, whenever it comes.
    pub(super) async fn event(&mut self) -> Result<Event, Error> {
        let mut line = Vec::new();
        let mut bounded = (&mut self.read).take(LONGEST_REPLY);
        if bounded.read_until(b'\n', &mut line).await? == 0 {
            return Err(Error::Away(std::io::ErrorKind::UnexpectedEof.into()));
        }
        serde_json::from_slice(&line).map_err(|_| {
            let begin = String::from_utf8_lossy(&line[..line.len().min(200)]);
            Error::Senseless(begin.into_owned())
        })
    }

    /// Sends a request and waits for its first reply.
    pub(super) async fn ask(
        &mut self,
        request: &Request,
        patience: Duration,
    ) -> Result<Reply, Error> {
        let both = async {
            self.send(request).await?;
            self.event().await
        };
        timeout(patience, both).await.map_err(|_| Error::Slow)?
    }
}

/// What tells a socket from another one, and from itself before a daemon took it over.
type SocketState = (u64, u64, i64, i64);

fn socket_state(path: &Path) -> Option<SocketState> {
    let found = std::fs::metadata(path).ok()?;
    Some((found.dev(), found.ino(), found.ctime(), found.ctime_nsec()))
}

/// The daemon, as people's requests see it.
pub(super) struct Daemon {
    path: PathBuf,
    slots: Semaphore,
    /// The socket when the daemon was told to stop; `None` as long as it may run.
    stopped: Mutex<Option<SocketState>>,
}

impl Daemon {
    pub(super) fn new(path: &Path) -> Self {
        Self {
            path: path.into(),
            slots: Semaphore::new(REQUESTS),
            stopped: Mutex::default(),
        }
    }

    /// Takes in that the daemon was told to stop.
    pub(super) fn has_ended(&self) {
        *self.stopped.lock() = socket_state(&self.path);
    }

    /// A connection that nobody asked for. Systemd would start a daemon that a person stopped, so there is none until
    /// the socket changes, which a daemon does that takes it over, or until the daemon answered somebody's request.
    pub(super) async fn open(&self) -> Result<Connection, Error> {
        if self.is_stopped() {
            return Err(Error::Away(std::io::ErrorKind::ConnectionReset.into()));
        }
        Connection::open(&self.path).await
    }

    /// What it means that the page was answered so over a connection that nobody asked for. A daemon that cannot start
    /// also says that it ends.
    pub(super) async fn refused(&self, connection: &mut Connection, reply: Reply) -> Error {
        let Reply::Refused { reason } = reply else {
            return Error::Senseless(format!("{reply:?}"));
        };
        let next = timeout(PAUSE, connection.event()).await;
        if matches!(next, Ok(Ok(Event::Ending))) {
            self.has_ended();
        }
        Error::Refused(reason)
    }

    pub(super) fn is_stopped(&self) -> bool {
        let mut stopped = self.stopped.lock();
        *stopped = stopped.filter(|before| socket_state(&self.path) == Some(*before));
        stopped.is_some()
    }

    /// Takes in that a request was answered that began when [`Self::stopped`] was as `before`: a daemon that was told
    /// to stop meanwhile may have answered it.
    fn has_answered(&self, before: Option<SocketState>) {
        let mut stopped = self.stopped.lock();
        *stopped = stopped.filter(|now| before != Some(*now));
    }

    async fn slot(&self) -> Result<SemaphorePermit<'_>, Error> {
        let slot = timeout(QUEUE, self.slots.acquire()).await;
        slot.map_err(|_| Error::Full)?.map_err(|_| Error::Full)
    }

    /// Sends a request that has one reply.
    pub(super) async fn ask(&self, request: &Request) -> Result<Reply, Error> {
        let _slot = self.slot().await?;
        let stopped = *self.stopped.lock();
        let mut connection = Connection::open(&self.path).await?;
        let reply = connection.ask(request, PATIENCE).await?;
        if !matches!(reply, Reply::Refused { .. }) {
            self.has_answered(stopped);
        }
        Ok(reply)
    }

    /// Takes a capture and waits until it is on the disk. A connection that breaks is made again under the same
    /// `press_id`, so that it stays one press; one that is not accepted within two seconds, in which it may have waited
    /// for a connection, is given up.
    ///
    /// # Errors
    /// [`Error::Unsure`] if the press was sent and its outcome is not known; otherwise nothing was begun.
    pub(super) async fn press(
        &self,
        press_id: &str,
        subject: Option<String>,
        placement: Option<String>,
    ) -> Result<Reply, Error> {
        let begin = Instant::now();
        let _slot = self.slot().await?;
        let request = Request::Trigger {
            source: "page".into(),
            press_id: Some(press_id.into()),
            subject,
            placement,
            until: Until::Durable,
        };
        let mut progress = Progress::Unsent;
        loop {
            let attempt = self.attempt(&request, begin, &mut progress).await;
            let error = match attempt {
                Ok(reply) => return Ok(reply),
                Err(error) => error,
            };
            if left(begin, progress) <= PAUSE {
                let is_unsent = progress == Progress::Unsent;
                return Err(if is_unsent { error } else { Error::Unsure });
            }
            tokio::time::sleep(PAUSE).await;
        }
    }

    /// Asks for the capture once the daemon has answered a request for its status: a press that waits in the socket of
    /// a daemon that is not there yet would be taken late. `begin` is when the press began.
    async fn attempt(
        &self,
        request: &Request,
        begin: Instant,
        progress: &mut Progress,
    ) -> Result<Reply, Error> {
        let stopped = *self.stopped.lock();
        let opened = timeout(left(begin, *progress), Connection::open(&self.path)).await;
        let mut connection = opened.map_err(|_| Error::Slow)??;
        let patience = left(begin, *progress);
        let status = connection.ask(&Request::Status {}, patience).await?;
        if !matches!(status, Reply::Status { .. }) {
            // It answers this connection, and not the press that may have begun over an earlier one.
            let is_unsent = *progress == Progress::Unsent;
            return if is_unsent {
                Ok(status)
            } else {
                Err(Error::Unsure)
            };
        }
        self.has_answered(stopped);
        if *progress == Progress::Unsent {
            *progress = Progress::Sent;
        }
        connection.send(request).await?;
        loop {
            let reply = timeout(left(begin, *progress), connection.event()).await;
            let reply = reply.map_err(|_| Error::Slow)??;
            if matches!(reply, Reply::Accepted { .. }) {
                *progress = Progress::Accepted;
            }
            if reply.is_end(Until::Durable) {
                return Ok(reply);
            }
        }
    }
}

/// How long a press that began at that time is waited for yet, at least a moment.
fn left(begin: Instant, progress: Progress) -> Duration {
    let at_most = if progress == Progress::Accepted {
        END
    } else {
        BEGIN
    };
    at_most.saturating_sub(begin.elapsed()).max(PAUSE)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::support::wait::until;
    use std::io::{BufRead, Write};
    use std::sync::Arc;
    use std::sync::atomic::{AtomicUsize, Ordering};

    /// A daemon that answers requests for its status, and a press with these lines alone.
    fn serve(path: &Path, lines: &'static str) {
        let listener = std::os::unix::net::UnixListener::bind(path).unwrap();
        std::thread::spawn(move || {
            for stream in listener.incoming().map_while(Result::ok) {
                let mut write = stream.try_clone().unwrap();
                std::thread::spawn(move || {
                    let asked = std::io::BufReader::new(stream).lines();
                    for line in asked.map_while(Result::ok) {
                        let is_press = line.contains("trigger");
                        let status = "{\"type\":\"status\",\"status\":{}}\n";
                        let reply = if is_press { lines } else { status };
                        let _ = write.write_all(reply.as_bytes());
                    }
                });
            }
        });
    }

    /// A daemon that answers requests for its status, and ends each connection over which a press comes; how many came.
    fn serve_breaking(path: &Path) -> Arc<AtomicUsize> {
        let listener = std::os::unix::net::UnixListener::bind(path).unwrap();
        let presses = Arc::new(AtomicUsize::new(0));
        let counted = presses.clone();
        std::thread::spawn(move || {
            for mut stream in listener.incoming().map_while(Result::ok) {
                let asked = std::io::BufReader::new(stream.try_clone().unwrap()).lines();
                for line in asked.map_while(Result::ok) {
                    if line.contains("trigger") {
                        counted.fetch_add(1, Ordering::SeqCst);
                        break;
                    }
                    let _ = stream.write_all(b"{\"type\":\"status\",\"status\":{}}\n");
                }
            }
        });
        presses
    }

    fn runtime() -> tokio::runtime::Runtime {
        let mut builder = tokio::runtime::Builder::new_current_thread();
        builder.enable_all().build().unwrap()
    }

    fn press(lines: &'static str) -> Result<Reply, Error> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scand.sock");
        serve(&path, lines);
        let runtime = runtime();
        let daemon = Daemon::new(&path);
        let pressed =
            async { timeout(Duration::from_secs(30), daemon.press("p", None, None)).await };
        runtime.block_on(pressed).expect("it is not given up")
    }

    #[test]
    fn a_daemon_that_was_stopped_is_left_alone_until_its_socket_changes_or_it_answers_somebody() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scand.sock");
        serve(&path, "");
        let runtime = tokio::runtime::Builder::new_current_thread();
        let runtime = { runtime }.enable_all().build().unwrap();
        runtime.block_on(async {
            let daemon = Daemon::new(&path);
            daemon.open().await.unwrap();
            daemon.has_ended();
            assert!(daemon.open().await.is_err());
            // Somebody's request starts it.
            daemon.ask(&Request::Status {}).await.unwrap();
            daemon.open().await.unwrap();
            daemon.has_ended();
            assert!(daemon.open().await.is_err());
            // Somebody else's request does, and the daemon takes the socket over.
            let before = socket_state(&path);
            until("the socket changes", || {
                let mode = std::os::unix::fs::PermissionsExt::from_mode(0o660);
                std::fs::set_permissions(&path, mode).unwrap();
                socket_state(&path) != before
            });
            daemon.open().await.unwrap();
        });
    }

    #[test]
    fn a_press_that_is_not_accepted_in_time_is_given_up_and_its_outcome_is_not_known() {
        assert!(matches!(press(""), Err(Error::Unsure)));
        let busy = press("{\"type\":\"busy\"}\n");
        assert!(matches!(busy, Ok(Reply::Busy)));
    }

    #[test]
    fn a_press_that_waited_for_a_connection_is_asked_for_less_often() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scand.sock");
        let presses = serve_breaking(&path);
        let daemon = Daemon::new(&path);
        runtime().block_on(async {
            let all = daemon.slots.acquire_many(REQUESTS as u32).await.unwrap();
            let wait = async {
                tokio::time::sleep(BEGIN / 4).await;
                drop(all);
            };
            let (pressed, ()) = tokio::join!(daemon.press("p", None, None), wait);
            assert!(matches!(pressed, Err(Error::Unsure)), "{pressed:?}");
        });
        // In three of four half seconds; in all of them it would be more.
        let at_most = (BEGIN.as_millis() * 3 / 4 / PAUSE.as_millis()) as usize + 1;
        assert!((1..=at_most).contains(&presses.load(Ordering::SeqCst)));
    }
}
