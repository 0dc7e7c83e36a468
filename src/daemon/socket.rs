//! The daemon's socket: turns lines of JSON into orders for the capturing thread, and its answers into lines. A client
//! can harm only its own connection.

mod client;
mod connection_limit;
mod limits;

use super::SocketParameters;
use super::capturing::Capturing;
use super::service::Service;
use crate::log;
use crate::trigger::Reply;
use connection_limit::ConnectionLimiter;
use limits::{ClientLogThrottle, RateLimiter};
use rustix::fs::{AtFlags, CWD, Timespec, Timestamps, UTIME_NOW, utimensat};
use std::io::{ErrorKind, Write};
use std::os::unix::fs::{FileTypeExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};
use tokio::net::UnixListener;
use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::watch;

/// Why the socket cannot be served.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum SocketError {
    /// Another daemon is there.
    #[error("{}: another daemon already listens on this socket: stop that one, or set socket.path", path.display())]
    Taken { path: PathBuf },
    /// The socket cannot be created, or signals cannot be received.
    #[error("{}: {cause}", path.display())]
    Io {
        path: PathBuf,
        cause: std::io::Error,
    },
}

/// What all clients share.
struct Shared {
    capturing: Arc<Capturing>,
    /// How long a client may take to send a line, or to read a reply.
    patience: Duration,
    rate: RateLimiter,
    client_log: ClientLogThrottle,
    /// Requests that are being answered.
    in_progress: AtomicUsize,
    /// Whether nothing happens any more.
    ending: watch::Sender<bool>,
}

/// Clients that are still connected when the socket is closed: they still get their final answers.
#[must_use]
pub struct Clients(Arc<Shared>);

impl Clients {
    /// Waits until all clients have their final answers, when nothing more will happen, but at most `patience`.
    pub fn finish(self, patience: Duration) {
        self.0.ending.send_replace(true);
        let end = Instant::now() + patience;
        while self.0.in_progress.load(Ordering::Acquire) > 0 && Instant::now() < end {
            std::thread::sleep(Duration::from_millis(2));
        }
    }
}

/// Serves the socket that systemd passed, or else makes one at the path of `socket`, until SIGTERM or SIGINT; a second
/// one ends the process at once. `service` lives beside it.
///
/// # Errors
/// If the socket cannot be made.
pub fn serve(
    socket: &SocketParameters,
    handed_over: Option<std::os::unix::net::UnixListener>,
    capturing: &Arc<Capturing>,
    service: &mut Service,
) -> Result<Clients, SocketError> {
    let own = handed_over.is_none();
    let path = &socket.path;
    let shared = Arc::new(Shared {
        capturing: capturing.clone(),
        patience: Duration::from_millis(socket.patience_ms),
        rate: RateLimiter::new(),
        client_log: ClientLogThrottle::new(),
        in_progress: AtomicUsize::new(0),
        ending: watch::Sender::new(false),
    });
    let io = |cause| SocketError::Io {
        path: path.into(),
        cause,
    };
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .map_err(io)?;
    runtime.block_on(async {
        let listener = match handed_over {
            Some(listener) => adopt(listener).map_err(io)?,
            None => listen(path)?,
        };
        let mut ends = signal(SignalKind::terminate()).map_err(io)?;
        let mut interrupts = signal(SignalKind::interrupt()).map_err(io)?;
        tell_address(&listener, own, path);
        tokio::select! {
            () = accept(&listener, &shared) => {}
            () = service.attend(capturing) => {}
            _ = ends.recv() => {}
            _ = interrupts.recv() => {}
        }
        Ok(())
    })?;
    service.ending();
    // A socket that systemd made stays, so that a client that presses meanwhile waits for the next daemon.
    if own {
        let _ = std::fs::remove_file(path);
    }
    // Clients get the end of the capture in progress; a person who signals again does not want to wait for it.
    second_signal_exits(runtime);
    Ok(Clients(shared))
}

/// Clients that are answered at most where no daemon can start: as many as the system lets wait, and some more.
const MOST_REFUSED: usize = 5000;

/// Answers the clients that wait at a socket that systemd made, where no daemon can start: systemd would start one
/// again at once for those that are left. A client that only waits for a daemon hears that this one ends.
pub fn refuse_waiting(listener: &std::os::unix::net::UnixListener, reason: &str) {
    let reason = reason.to_owned();
    let replies = [Reply::Refused { reason }, Reply::Ending];
    let lines = replies.map(|reply| serde_json::to_string(&reply).unwrap_or_default() + "\n");
    if listener.set_nonblocking(true).is_err() {
        return;
    }
    for _ in 0..MOST_REFUSED {
        let Ok((mut stream, _)) = listener.accept() else {
            return;
        };
        // A connection that was just opened has room for a line, unless its client has left.
        let _ = stream.write_all(lines.concat().as_bytes());
    }
}

/// Leaves a thread that serves the clients that are connected, and ends the process at the next signal.
fn second_signal_exits(runtime: tokio::runtime::Runtime) {
    let wait = move || {
        runtime.block_on(async {
            let ends = signal(SignalKind::terminate());
            let interrupts = signal(SignalKind::interrupt());
            if let (Ok(mut ends), Ok(mut interrupts)) = (ends, interrupts) {
                tokio::select! {
                    _ = ends.recv() => {}
                    _ = interrupts.recv() => {}
                }
                log::error!("a second signal ended the daemon at once");
                std::process::exit(1);
            }
        });
    };
    let _ = std::thread::Builder::new()
        .name("signals".into())
        .spawn(wait);
}

/// Logs where the daemon listens. Who made a socket that was handed over may have another place than `configured`; its
/// clients see then that a daemon has it.
fn tell_address(listener: &UnixListener, is_own: bool, configured: &Path) {
    let address = listener.local_addr().ok();
    let path = address.as_ref().and_then(|address| address.as_pathname());
    log::info!("listening on {}", path.unwrap_or(configured).display());
    let Some(path) = path.filter(|_| !is_own) else {
        return;
    };
    let place = |path: &Path| std::fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    if place(path) != place(configured) {
        log::warning!(
            "socket.path is {}, which has no effect, because systemd made the socket: give it the \
             path of ListenStream in scand.socket, so that scand check asks there",
            configured.display()
        );
    }
    if let Err(error) = touch(path) {
        log::warning!(
            "{}: cannot set its time: {error}; a page that saw a daemon end does not see that \
             this one runs before somebody presses there: allow it with ReadWritePaths",
            path.display()
        );
    }
}

/// Sets the times of a socket to the present. Clients that wait for a daemon look at them, because a connect would
/// start one.
fn touch(socket: &Path) -> std::io::Result<()> {
    let now = Timespec {
        tv_sec: 0,
        tv_nsec: UTIME_NOW,
    };
    let times = Timestamps {
        last_access: now,
        last_modification: now,
    };
    Ok(utimensat(CWD, socket, &times, AtFlags::empty())?)
}

/// Takes over a socket that somebody else made.
fn adopt(listener: std::os::unix::net::UnixListener) -> std::io::Result<UnixListener> {
    listener.set_nonblocking(true)?;
    UnixListener::from_std(listener)
}

/// Makes the socket. It replaces one that a daemon left when it ended.
pub(super) fn listen(path: &Path) -> Result<UnixListener, SocketError> {
    let io = |cause| SocketError::Io {
        path: path.into(),
        cause,
    };
    if let Some(folder) = path.parent().filter(|p| !p.as_os_str().is_empty()) {
        std::fs::create_dir_all(folder).map_err(io)?;
    }
    match std::os::unix::net::UnixStream::connect(path) {
        Ok(_) => return Err(SocketError::Taken { path: path.into() }),
        Err(cause) if cause.kind() == ErrorKind::ConnectionRefused => {
            // What is no socket refuses connections as well.
            let found = path.symlink_metadata().map_err(io)?;
            if !found.file_type().is_socket() {
                return Err(io(std::io::Error::other("it exists and is not a socket")));
            }
            std::fs::remove_file(path).map_err(io)?;
        }
        Err(_) => {}
    }
    let listener = UnixListener::bind(path).map_err(io)?;
    std::fs::set_permissions(path, std::fs::Permissions::from_mode(0o660)).map_err(io)?;
    Ok(listener)
}

async fn accept(listener: &UnixListener, shared: &Arc<Shared>) {
    let limiter = ConnectionLimiter::new();
    loop {
        shared.rate.acquire().await;
        match listener.accept().await {
            Ok((stream, _)) => {
                // The kernel knows the client, unless the connection has no other end.
                let Ok(who) = stream.peer_cred() else {
                    continue;
                };
                shared.client_log.note(&who);
                match limiter.acquire(who.uid()) {
                    Ok(permit) => {
                        let shared = shared.clone();
                        tokio::spawn(async move {
                            client::serve(stream, &shared).await;
                            drop(permit);
                        });
                    }
                    // Rather than left waiting.
                    Err(reason) => client::reject(&stream, reason),
                }
            }
            // Out of file descriptors, for example: they come back.
            Err(_) => tokio::time::sleep(Duration::from_millis(100)).await,
        }
    }
}
