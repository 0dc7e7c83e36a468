//! The socket on which `scand page pair` and its neighbours ask the running page. Its mode lets root and the group of
//! the page's process connect. A request is a line of JSON, and so is its answer.

use super::sessions::{self, Listed, Role, Sessions};
use serde::{Deserialize, Serialize};
use std::io::{BufRead, BufReader, Read, Write};
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;
use tokio::io::{AsyncBufReadExt, AsyncReadExt, AsyncWriteExt};
use tokio::net::{UnixListener, UnixStream};
use tokio::sync::Semaphore;

/// Longest line in bytes, either way.
const LONGEST: u64 = 64 << 10;
/// How long one may take to ask or to answer.
const PATIENCE: Duration = Duration::from_secs(5);
/// Connections that are served at a time; others wait.
const MOST: usize = 4;

/// What is asked of the running page.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "type", deny_unknown_fields)]
pub enum ControlRequest {
    /// A link that begins one session.
    Pair {
        /// What that session may do.
        role: Role,
    },
    /// A token for `/metrics`.
    Token {},
    /// The sessions that last.
    Sessions {},
    /// Ends sessions.
    Revoke {
        /// The short name of one; without it all of them, and all links.
        id: Option<String>,
    },
}

/// What the page answers.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "type")]
pub enum Answer {
    /// A link; its token is behind `#`, which no browser sends to a server.
    Link {
        /// The whole link.
        link: String,
    },
    /// A token for `/metrics`.
    Token {
        /// The token.
        token: String,
    },
    /// The sessions that last.
    Sessions {
        /// One by one.
        sessions: Vec<Listed>,
    },
    /// So many sessions were ended.
    Revoked {
        /// How many.
        sessions: usize,
    },
    /// It could not be done.
    Refused {
        /// Why.
        reason: String,
    },
}

/// Asks the page that listens on this socket.
///
/// # Errors
/// If none listens there, or it does not answer in time.
pub fn ask(path: &Path, ask: &ControlRequest) -> std::io::Result<Answer> {
    let mut stream = std::os::unix::net::UnixStream::connect(path)?;
    stream.set_read_timeout(Some(PATIENCE))?;
    stream.set_write_timeout(Some(PATIENCE))?;
    let line = serde_json::to_string(ask)? + "\n";
    stream.write_all(line.as_bytes())?;
    let mut line = String::new();
    BufReader::new(stream).take(LONGEST).read_line(&mut line)?;
    Ok(serde_json::from_str(&line)?)
}

/// Makes the socket, for its owner and group.
pub(super) fn listen(path: &Path) -> std::io::Result<UnixListener> {
    // One that an earlier run left; where a page still answers, this one has no business.
    if std::os::unix::net::UnixStream::connect(path).is_ok() {
        return Err(std::io::ErrorKind::AddrInUse.into());
    }
    match std::fs::remove_file(path) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => return Err(error),
        _ => {}
    }
    let listener = UnixListener::bind(path)?;
    std::fs::set_permissions(path, std::fs::Permissions::from_mode(0o660))?;
    Ok(listener)
}

/// Answers each client, for ever.
pub(super) async fn serve(listener: UnixListener, sessions: Arc<Sessions>, origin: String) {
    let slots = Arc::new(Semaphore::new(MOST));
    loop {
        let Ok(slot) = slots.clone().acquire_owned().await else {
            return;
        };
        let Ok((stream, _)) = listener.accept().await else {
            tokio::time::sleep(Duration::from_millis(100)).await;
            continue;
        };
        let (sessions, origin) = (sessions.clone(), origin.clone());
        tokio::spawn(async move {
            let served = serve_one(stream, &sessions, &origin);
            let _ = tokio::time::timeout(PATIENCE, served).await;
            drop(slot);
        });
    }
}

async fn serve_one(
    mut stream: UnixStream,
    sessions: &Sessions,
    origin: &str,
) -> std::io::Result<()> {
    let (read, mut write) = stream.split();
    let mut line = String::new();
    let mut read = tokio::io::BufReader::new(read).take(LONGEST);
    read.read_line(&mut line).await?;
    let answer = match serde_json::from_str::<ControlRequest>(&line) {
        Ok(ask) => answer(ask, sessions, origin).unwrap_or_else(|error| Answer::Refused {
            reason: error.to_string(),
        }),
        Err(error) => Answer::Refused {
            reason: error.to_string(),
        },
    };
    let line = serde_json::to_string(&answer)? + "\n";
    write.write_all(line.as_bytes()).await
}

fn answer(
    ask: ControlRequest,
    sessions: &Sessions,
    origin: &str,
) -> Result<Answer, sessions::Error> {
    Ok(match ask {
        ControlRequest::Pair { role } => Answer::Link {
            link: format!("{origin}/#pair={}", sessions.pair(role)?),
        },
        ControlRequest::Token {} => Answer::Token {
            token: sessions.metrics()?,
        },
        ControlRequest::Sessions {} => Answer::Sessions {
            sessions: sessions.list(),
        },
        ControlRequest::Revoke { id } => Answer::Revoked {
            sessions: sessions.revoke(id.as_deref())?,
        },
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::ErrorKind;

    fn runtime() -> tokio::runtime::Runtime {
        let mut builder = tokio::runtime::Builder::new_current_thread();
        builder.enable_all().build().unwrap()
    }

    /// Answers on a socket in this folder from now on; the socket.
    fn serve_in(folder: &Path) -> std::path::PathBuf {
        let path = folder.join("control.sock");
        let own = path.clone();
        let hour = Duration::from_secs(3600);
        let sessions = Arc::new(Sessions::open(folder, hour, hour).unwrap());
        let (ready, is_ready) = std::sync::mpsc::channel();
        std::thread::spawn(move || {
            runtime().block_on(async {
                let listener = listen(&own).unwrap();
                ready.send(()).unwrap();
                serve(listener, sessions, "http://rig".into()).await;
            });
        });
        is_ready.recv().unwrap();
        path
    }

    #[test]
    fn the_socket_is_for_its_owner_and_group_and_for_one_page() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("control.sock");
        let runtime = runtime();
        let _inside = runtime.enter();
        let listener = listen(&path).unwrap();
        let mode = std::fs::metadata(&path).unwrap().permissions().mode();
        assert_eq!(mode & 0o777, 0o660);
        let second = listen(&path).err().map(|error| error.kind());
        assert_eq!(second, Some(ErrorKind::AddrInUse));
        // What a page that was killed left is in nobody's way.
        drop(listener);
        listen(&path).unwrap();
    }

    #[test]
    fn what_is_no_request_is_refused_and_the_next_one_is_answered() {
        let folder = tempfile::tempdir().unwrap();
        let path = serve_in(folder.path());
        for bad in ["\n", "{\"type\":\"open\"}\n", "\u{0}\u{1}[\n"] {
            let mut stream = std::os::unix::net::UnixStream::connect(&path).unwrap();
            stream.write_all(bad.as_bytes()).unwrap();
            let mut line = String::new();
            BufReader::new(stream).read_line(&mut line).unwrap();
            let answer: Answer = serde_json::from_str(&line).unwrap();
            assert!(matches!(answer, Answer::Refused { .. }), "{bad:?}: {line}");
        }
        let role = Role::Viewer;
        match ask(&path, &ControlRequest::Pair { role }).unwrap() {
            Answer::Link { link } => assert!(link.starts_with("http://rig/#pair="), "{link}"),
            other => panic!("{other:?}"),
        }
    }
}
