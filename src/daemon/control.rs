//! The daemon's socket: lines of JSON become orders for the capturing thread, what it says becomes lines again. A client
//! can waste its own connection and nothing else.

use super::capturing::{Answer, Capturing, Order, Press};
use super::service::Service;
use crate::log;
use crate::recording::Note;
use crate::trigger::{LONGEST_LINE, Reply, Request, Until};
use std::io::ErrorKind;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;
use tokio::io::{AsyncBufReadExt, AsyncReadExt, AsyncWriteExt, BufReader};
use tokio::net::unix::{OwnedReadHalf, OwnedWriteHalf};
use tokio::net::{UnixListener, UnixStream};
use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::{Semaphore, mpsc};

/// Most clients at a time.
const MOST_CLIENTS: usize = 32;
/// How long a client may take to send a line, or to read its replies.
const PATIENCE: Duration = Duration::from_secs(60);

/// Why the socket cannot be served.
#[derive(Debug, thiserror::Error)]
pub enum ControlError {
    /// Another daemon is there.
    #[error("{}: another daemon listens there", path.display())]
    Taken {
        /// The socket.
        path: PathBuf,
    },
    /// The socket cannot be made, or signals cannot be had.
    #[error("{}: {cause}", path.display())]
    Io {
        /// The socket.
        path: PathBuf,
        /// Why.
        cause: std::io::Error,
    },
}

/// Serves the socket that was handed over, or else makes one at `path`, until SIGTERM or SIGINT; a second one ends the
/// process at once. `service` lives beside it.
///
/// # Errors
/// If the socket cannot be made.
pub fn serve(
    path: &Path,
    handed_over: Option<std::os::unix::net::UnixListener>,
    capturing: &Arc<Capturing>,
    service: &mut Service,
) -> Result<(), ControlError> {
    let own = handed_over.is_none();
    let io = |cause| ControlError::Io {
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
        log::info!("listening on {}", path.display());
        tokio::select! {
            () = accept(&listener, capturing) => {}
            () = service.attend(capturing) => {}
            _ = ends.recv() => {}
            _ = interrupts.recv() => {}
        }
        Ok(())
    })?;
    service.ending();
    // One that systemd made stays, so that who presses meanwhile waits for the next daemon.
    if own {
        let _ = std::fs::remove_file(path);
    }
    // Clients hear the end of the capture in progress; whoever signals again does not want to wait for it.
    second_signal_exits(runtime);
    Ok(())
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
                log::error!("ended at once by a second signal");
                std::process::exit(1);
            }
        });
    };
    let _ = std::thread::Builder::new()
        .name("signals".into())
        .spawn(wait);
}

/// Takes over a socket that somebody else made.
fn adopt(listener: std::os::unix::net::UnixListener) -> std::io::Result<UnixListener> {
    listener.set_nonblocking(true)?;
    UnixListener::from_std(listener)
}

/// Makes the socket, in the place of one that a daemon left which is gone.
fn listen(path: &Path) -> Result<UnixListener, ControlError> {
    let io = |cause| ControlError::Io {
        path: path.into(),
        cause,
    };
    if let Some(folder) = path.parent().filter(|p| !p.as_os_str().is_empty()) {
        std::fs::create_dir_all(folder).map_err(io)?;
    }
    match std::os::unix::net::UnixStream::connect(path) {
        Ok(_) => return Err(ControlError::Taken { path: path.into() }),
        Err(cause) if cause.kind() == ErrorKind::ConnectionRefused => {
            std::fs::remove_file(path).map_err(io)?;
        }
        Err(_) => {}
    }
    let listener = UnixListener::bind(path).map_err(io)?;
    std::fs::set_permissions(path, std::fs::Permissions::from_mode(0o660)).map_err(io)?;
    Ok(listener)
}

async fn accept(listener: &UnixListener, capturing: &Arc<Capturing>) {
    let clients = Arc::new(Semaphore::new(MOST_CLIENTS));
    loop {
        match listener.accept().await {
            Ok((stream, _)) => {
                let capturing = capturing.clone();
                // More than that are turned away rather than left waiting.
                if let Ok(permit) = clients.clone().try_acquire_owned() {
                    tokio::spawn(async move {
                        client(stream, &capturing).await;
                        drop(permit);
                    });
                }
            }
            // Out of file descriptors, for example: they come back.
            Err(_) => tokio::time::sleep(Duration::from_millis(100)).await,
        }
    }
}

/// Serves a client until it goes away, is silent for too long or says what is no request.
async fn client(stream: UnixStream, capturing: &Capturing) {
    if let Ok(who) = stream.peer_cred() {
        let pid = who
            .pid()
            .map_or_else(String::new, |p| format!(", process {p}"));
        log::info!("client: user {}{pid}", who.uid());
    }
    let (read, mut write) = stream.into_split();
    let mut read = BufReader::new(read);
    while let Ok(Some(line)) = tokio::time::timeout(PATIENCE, line(&mut read)).await {
        let served = match serde_json::from_slice::<Request>(&line) {
            Ok(request) => carry_out(request, capturing, &mut write).await,
            Err(error) => {
                let reason = format!("no request: {error}");
                let _ = send(&mut write, &Reply::Refused { reason }).await;
                return;
            }
        };
        if served.is_err() {
            return;
        }
    }
}

/// The next line; `None` at the end, and for one that is too long or cut off.
async fn line(read: &mut BufReader<OwnedReadHalf>) -> Option<Vec<u8>> {
    let mut line = Vec::new();
    let mut limited = read.take(LONGEST_LINE as u64);
    limited.read_until(b'\n', &mut line).await.ok()?;
    (line.pop() == Some(b'\n')).then_some(line)
}

async fn carry_out(
    request: Request,
    capturing: &Capturing,
    write: &mut OwnedWriteHalf,
) -> std::io::Result<()> {
    let (said, mut replies) = mpsc::unbounded_channel();
    let mut until = Until::default();
    match request {
        Request::Events {} => return tell_events(capturing, write).await,
        Request::Status {} => {
            let status = serde_json::to_value(capturing.status()).unwrap_or_default();
            let _ = said.send(Reply::Status { status });
        }
        Request::Trigger {
            source,
            press_id,
            subject,
            until: last,
        } => {
            until = last;
            capturing.order(Order::Press(Press {
                source,
                press_id,
                subject,
                progress: Box::new(move |reply| drop(said.send(reply))),
            }));
        }
        Request::Background {} => capturing.order(Order::Background(answer(said))),
        Request::Begin { name, about } => {
            capturing.order(Order::Begin(name, about, answer(said)));
        }
        Request::Note { kind, .. } if !matches!(kind.as_str(), "accept" | "reject" | "text") => {
            let reason = format!("kind {kind:?} is none of accept, reject and text");
            let _ = said.send(Reply::Refused { reason });
        }
        Request::Note {
            capture,
            kind,
            text,
        } => {
            let note = Note {
                capture,
                kind,
                text,
            };
            capturing.order(Order::Note(note, answer(said)));
        }
        Request::Close {} => capturing.order(Order::Close(answer(said))),
    }
    while let Some(reply) = replies.recv().await {
        send(write, &reply).await?;
        if reply.is_end(until) {
            return Ok(());
        }
    }
    let reason = "the daemon is ending".into();
    send(write, &Reply::Refused { reason }).await
}

/// Tells what happens until the client goes away or the daemon ends.
async fn tell_events(capturing: &Capturing, write: &mut OwnedWriteHalf) -> std::io::Result<()> {
    let mut events = capturing.events().subscribe();
    send(write, &Reply::Listening).await?;
    while let Some(event) = events.next().await {
        send(write, &event).await?;
    }
    Ok(())
}

fn answer(said: mpsc::UnboundedSender<Reply>) -> Answer {
    Box::new(move |result| {
        let reply = match result {
            Ok(words) => Reply::Ok { words },
            Err(reason) => Reply::Refused { reason },
        };
        let _ = said.send(reply);
    })
}

async fn send(write: &mut OwnedWriteHalf, reply: &impl serde::Serialize) -> std::io::Result<()> {
    let mut line = serde_json::to_vec(reply)?;
    line.push(b'\n');
    let sent = tokio::time::timeout(PATIENCE, write.write_all(&line)).await;
    sent.unwrap_or_else(|_| Err(ErrorKind::TimedOut.into()))
}
