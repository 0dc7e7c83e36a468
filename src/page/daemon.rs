//! The page's client of the daemon's socket: at most eight connections, however many people look. Three are the page's
//! own (the events and the status, see `watch`, and the cameras' pictures, see `look`), the others carry people's
//! requests.

use crate::trigger::{Event, LONGEST_REPLY, Reply, Request, Until};
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
    #[error("{0}")]
    Refused(String),
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

/// The daemon, as people's requests see it.
pub(super) struct Daemon {
    path: PathBuf,
    slots: Semaphore,
}

impl Daemon {
    pub(super) fn new(path: &Path) -> Self {
        Self {
            path: path.into(),
            slots: Semaphore::new(REQUESTS),
        }
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    async fn slot(&self) -> Result<SemaphorePermit<'_>, Error> {
        let slot = timeout(QUEUE, self.slots.acquire()).await;
        slot.map_err(|_| Error::Full)?.map_err(|_| Error::Full)
    }

    /// Sends a request that has one reply.
    pub(super) async fn ask(&self, request: &Request) -> Result<Reply, Error> {
        let _slot = self.slot().await?;
        let mut connection = Connection::open(&self.path).await?;
        connection.ask(request, PATIENCE).await
    }

    /// Takes a capture and waits until it is on the disk. A connection that breaks is made again under the same
    /// `press_id`, so that it stays one press; one that is not accepted within two seconds is given up.
    pub(super) async fn press(
        &self,
        press_id: &str,
        subject: Option<String>,
        placement: Option<String>,
    ) -> Result<Reply, Error> {
        let _slot = self.slot().await?;
        let request = Request::Trigger {
            source: "page".into(),
            press_id: Some(press_id.into()),
            subject,
            placement,
            until: Until::Durable,
        };
        let begin = Instant::now();
        let mut accepted = false;
        loop {
            let at_most = if accepted { END } else { BEGIN };
            let left = at_most.saturating_sub(begin.elapsed()).max(PAUSE);
            let attempt = self.attempt(&request, left, &mut accepted).await;
            let error = match attempt {
                Ok(reply) => return Ok(reply),
                Err(error) => error,
            };
            let at_most = if accepted { END } else { BEGIN };
            if begin.elapsed() >= at_most {
                return Err(error);
            }
            tokio::time::sleep(PAUSE).await;
        }
    }

    /// Asks for the capture once the daemon has answered a request for its status within `left`: a press that waits in
    /// the socket of a daemon that is not there yet would be taken late.
    async fn attempt(
        &self,
        request: &Request,
        left: Duration,
        accepted: &mut bool,
    ) -> Result<Reply, Error> {
        let opened = timeout(left, Connection::open(&self.path)).await;
        let mut connection = opened.map_err(|_| Error::Slow)??;
        let status = connection.ask(&Request::Status {}, left).await?;
        if !matches!(status, Reply::Status { .. }) {
            return Ok(status);
        }
        connection.send(request).await?;
        loop {
            let reply = timeout(END, connection.event()).await;
            let reply = reply.map_err(|_| Error::Slow)??;
            *accepted |= matches!(reply, Reply::Accepted { .. });
            if reply.is_end(Until::Durable) {
                return Ok(reply);
            }
        }
    }
}
