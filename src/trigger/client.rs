//! A client of a running daemon: sends a request and reads the replies.

use super::{Event, Reply, Request};
use std::io::{BufRead, BufReader, ErrorKind, Read, Write};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Longest line that a client reads from the daemon, in bytes.
pub const LONGEST_REPLY: u64 = 4 << 20;

/// Why the daemon could not be asked.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum Error {
    /// Nobody listens, or this user may not ask.
    #[error("{}: {cause}: {}", path.display(), advice(cause))]
    Away {
        path: PathBuf,
        cause: std::io::Error,
    },
    /// The connection broke, or took too long.
    #[error("{}: {}", path.display(), how_it_broke(cause))]
    Broken {
        path: PathBuf,
        cause: std::io::Error,
    },
    /// The daemon ended the connection.
    #[error("{}: the daemon ended the connection", .0.display())]
    Ended(PathBuf),
    /// It says what no daemon says.
    #[error("{}: found {line:?}, expected {expected}", path.display())]
    Senseless {
        path: PathBuf,
        /// What it said, shortened.
        line: String,
        /// What should have come.
        expected: &'static str,
    },
}

/// What to do about a socket that cannot be connected to.
fn advice(cause: &std::io::Error) -> &'static str {
    match cause.kind() {
        ErrorKind::PermissionDenied => {
            "join the group that may use it: `sudo adduser YOU scand` on an installed rig, which takes effect at the next \
             login"
        }
        _ => {
            "is the daemon running? Start it with `systemctl start scand` on an installed rig, otherwise with `scand run`"
        }
    }
}

/// How a connection broke. What the system says of a time that is over names neither the time nor who let it pass.
fn how_it_broke(cause: &std::io::Error) -> String {
    match cause.kind() {
        ErrorKind::WouldBlock | ErrorKind::TimedOut => {
            "the daemon does not answer: it is starting, or hangs; ask again in a minute".into()
        }
        _ => cause.to_string(),
    }
}

/// A connection to the daemon.
#[derive(Debug)]
pub struct Client {
    path: PathBuf,
    stream: BufReader<UnixStream>,
}

impl Client {
    /// Connects; replies are waited for as long as `patience`, or for ever.
    ///
    /// # Errors
    /// If no process listens.
    pub fn connect(path: &Path, patience: Option<Duration>) -> Result<Self, Error> {
        let away = |cause| Error::Away {
            path: path.into(),
            cause,
        };
        let stream = UnixStream::connect(path).map_err(away)?;
        stream.set_read_timeout(patience).map_err(away)?;
        stream.set_write_timeout(patience).map_err(away)?;
        Ok(Self {
            path: path.into(),
            stream: BufReader::new(stream),
        })
    }

    /// Waits so long for what is sent and read from now on.
    ///
    /// # Errors
    /// If the system refuses that.
    pub fn set_patience(&mut self, patience: Duration) -> Result<(), Error> {
        let stream = self.stream.get_ref();
        let set = stream.set_read_timeout(Some(patience));
        set.and_then(|()| stream.set_write_timeout(Some(patience)))
            .map_err(|cause| self.broken(cause))
    }

    /// Sends a request; its replies follow, see [`Self::reply`].
    ///
    /// # Errors
    /// If the connection breaks, or the daemon takes longer than was to be waited.
    pub fn send(&mut self, request: &Request) -> Result<(), Error> {
        let mut line = serde_json::to_string(request).unwrap_or_default();
        line.push('\n');
        let written = self.stream.get_mut().write_all(line.as_bytes());
        written.map_err(|cause| self.broken(cause))
    }

    /// Waits for the next reply. No reply follows the one for which [`Reply::is_end`] is true.
    ///
    /// # Errors
    /// As for [`Self::send`], or if the line is not a reply.
    pub fn reply(&mut self) -> Result<Reply, Error> {
        self.line("a reply")
    }

    /// Waits for the next event; they come after [`Reply::Listening`].
    ///
    /// # Errors
    /// As for [`Self::reply`].
    pub fn event(&mut self) -> Result<Event, Error> {
        self.line("an event")
    }

    fn line<T: serde::de::DeserializeOwned>(&mut self, expected: &'static str) -> Result<T, Error> {
        let mut line = String::new();
        let read = (&mut self.stream).take(LONGEST_REPLY).read_line(&mut line);
        if read.map_err(|cause| self.broken(cause))? == 0 {
            return Err(Error::Ended(self.path.clone()));
        }
        serde_json::from_str(&line).map_err(|_| Error::Senseless {
            path: self.path.clone(),
            line: line.chars().take(200).collect(),
            expected,
        })
    }

    fn broken(&self, cause: std::io::Error) -> Error {
        Error::Broken {
            path: self.path.clone(),
            cause,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::net::UnixListener;

    #[test]
    fn who_may_not_use_the_socket_is_told_the_group() {
        let away = |kind: ErrorKind| {
            let error = Error::Away {
                path: "s".into(),
                cause: kind.into(),
            };
            error.to_string()
        };
        let denied = away(ErrorKind::PermissionDenied);
        assert!(denied.contains("sudo adduser YOU scand"), "{denied}");
        assert!(!denied.contains("running"), "{denied}");
        let nobody = away(ErrorKind::ConnectionRefused);
        assert!(nobody.contains("is the daemon running"), "{nobody}");
    }

    #[test]
    fn a_daemon_that_lets_the_time_pass_is_said_to_do_so() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("s");
        let _listener = UnixListener::bind(&path).unwrap();
        let mut client = Client::connect(&path, Some(Duration::from_millis(20))).unwrap();
        client.send(&Request::Status {}).unwrap();
        let words = client.reply().unwrap_err().to_string();
        assert!(words.contains("it is starting, or hangs"), "{words}");
    }
}
