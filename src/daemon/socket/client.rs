//! Serves one client of the socket from its first line to its last: reads a request, writes its replies, reads the
//! next request.

use super::super::capturing::Order;
use super::super::dispatcher::ReplyStream;
use super::super::look::LookSubscription;
use super::super::recorder::Answer;
use super::Shared;
use crate::recording::Note;
use crate::trigger::{Event, LONGEST_REQUEST, Reply, Request, Until};
use std::io::{Error, ErrorKind};
use std::sync::atomic::Ordering;
use std::time::Duration;
use tokio::io::{AsyncBufReadExt, AsyncReadExt, AsyncWriteExt, BufReader, Interest};
use tokio::net::UnixStream;
use tokio::net::unix::{OwnedReadHalf, OwnedWriteHalf};
use tokio::sync::oneshot;
use tokio::time::{sleep, timeout};

/// How often it is looked whether a client that waits is still there.
const LOOK: Duration = Duration::from_secs(1);

pub(super) struct Client<'a> {
    write: OwnedWriteHalf,
    shared: &'a Shared,
}

/// Serves a client until it goes away, is silent for too long or sends an invalid request.
pub(super) async fn serve(stream: UnixStream, shared: &Shared) {
    let (read, write) = stream.into_split();
    let mut read = BufReader::new(read);
    let mut client = Client { write, shared };
    while let Ok(line) = timeout(shared.patience, line(&mut read)).await {
        shared.rate.acquire().await;
        shared.in_progress.fetch_add(1, Ordering::AcqRel);
        let served = client.answer(line).await;
        shared.in_progress.fetch_sub(1, Ordering::AcqRel);
        if served.is_err() {
            return;
        }
    }
}

/// The next line, without its end.
///
/// # Errors
/// What is wrong with it, as a message; none if the client has gone.
async fn line(read: &mut BufReader<OwnedReadHalf>) -> Result<Vec<u8>, Option<String>> {
    let mut line = Vec::new();
    let mut limited = read.take(LONGEST_REQUEST as u64);
    let length = limited.read_until(b'\n', &mut line).await;
    if length.is_ok_and(|l| l == LONGEST_REQUEST) && line.last() != Some(&b'\n') {
        return Err(Some(format!(
            "a line is longer than {LONGEST_REQUEST} bytes"
        )));
    }
    (line.pop() == Some(b'\n')).then_some(line).ok_or(None)
}

impl Client<'_> {
    /// Answers a line.
    ///
    /// # Errors
    /// If the client is to be left, because it has gone or talks nonsense.
    async fn answer(&mut self, line: Result<Vec<u8>, Option<String>>) -> std::io::Result<()> {
        let parsed = match line {
            Ok(line) => serde_json::from_slice::<Request>(&line).map_err(|e| e.to_string()),
            Err(Some(problem)) => Err(problem),
            Err(None) => return Err(ErrorKind::UnexpectedEof.into()),
        };
        match parsed {
            Ok(request) => self.carry_out(request).await,
            Err(problem) => {
                self.refuse(format!("invalid request: {problem}")).await?;
                Err(ErrorKind::InvalidData.into())
            }
        }
    }

    async fn carry_out(&mut self, request: Request) -> std::io::Result<()> {
        match request {
            Request::Trigger {
                source,
                press_id,
                subject,
                placement,
                until,
            } => {
                let capturing = &self.shared.capturing;
                if until == Until::Done && !capturing.makes_models() {
                    let reason = "this daemon makes no models: press again with until = durable";
                    return self.refuse(reason.into()).await;
                }
                let replies = capturing.press(source, press_id, subject, placement);
                self.follow(replies, until).await
            }
            Request::Status {} => {
                let status = self.shared.capturing.status();
                let status = serde_json::to_value(status).unwrap_or_default();
                self.send(&Reply::Status { status }).await
            }
            Request::Events {} => self.tell_events().await,
            Request::Background {} => self.ask(Order::Background).await,
            Request::Begin { name, about } => {
                self.ask(|answer| Order::Begin(name, about, answer)).await
            }
            Request::Note {
                capture,
                kind,
                text,
                author,
            } => match note(capture, kind, text, author) {
                Ok(note) => self.ask(|answer| Order::Note(note, answer)).await,
                Err(reason) => self.refuse(reason).await,
            },
            Request::Remake { capture, settings } => {
                // It is written to the disk, for which no other client waits.
                let capturing = self.shared.capturing.clone();
                let kept = move || capturing.remake(&capture, &settings);
                match tokio::task::spawn_blocking(kept).await {
                    Ok(Ok(words)) => self.send(&Reply::Ok { words }).await,
                    Ok(Err(reason)) => self.refuse(reason).await,
                    Err(_) => {
                        self.refuse("internal error: the daemon did not accept the remake".into())
                            .await
                    }
                }
            }
            Request::Look {} => match self.shared.capturing.look() {
                Some(looker) => self.tell_looks(looker).await,
                None => self.refuse("this daemon shows no pictures".into()).await,
            },
            Request::Close {} => self.ask(Order::Close).await,
        }
    }

    /// Tells what a press was answered and will be, up to the answer that the client waits for.
    async fn follow(&mut self, mut replies: ReplyStream, until: Until) -> std::io::Result<()> {
        let mut ending = self.shared.ending.subscribe();
        loop {
            let reply = tokio::select! {
                biased;
                reply = replies.next() => reply,
                // What was answered until then comes first.
                _ = ending.wait_for(|ends| *ends) => replies.try_next(),
                () = self.gone() => return Err(ErrorKind::BrokenPipe.into()),
            };
            let reply = reply.unwrap_or(Reply::Ending);
            self.send(&reply).await?;
            if reply.is_end(until) {
                return Ok(());
            }
        }
    }

    /// Tells what happens until the client goes away or the daemon ends.
    async fn tell_events(&mut self) -> std::io::Result<()> {
        let mut events = self.shared.capturing.events().subscribe();
        let mut ending = self.shared.ending.subscribe();
        self.send(&Reply::Listening).await?;
        loop {
            let event = tokio::select! {
                biased;
                event = events.next() => event.unwrap_or(Event::Ending),
                _ = ending.wait_for(|ends| *ends) => Event::Ending,
                () = self.gone() => return Err(ErrorKind::BrokenPipe.into()),
            };
            self.send(&event).await?;
            if event == Event::Ending {
                return Err(ErrorKind::BrokenPipe.into());
            }
        }
    }

    /// Shows pictures until the client goes away, does not read any more, or the daemon ends.
    async fn tell_looks(&mut self, mut looker: LookSubscription) -> std::io::Result<()> {
        let mut ending = self.shared.ending.subscribe();
        self.send(&Reply::Looking).await?;
        loop {
            let look = tokio::select! {
                biased;
                _ = ending.wait_for(|ends| *ends) => Event::Ending,
                look = looker.next() => look,
                () = self.gone() => return Err(ErrorKind::BrokenPipe.into()),
            };
            self.send(&look).await?;
            if look == Event::Ending {
                return Err(ErrorKind::BrokenPipe.into());
            }
        }
    }

    /// Sends an order and replies with its result.
    async fn ask(&mut self, order: impl FnOnce(Answer) -> Order) -> std::io::Result<()> {
        let (answer, answered) = oneshot::channel();
        let answer = move |result: Result<String, String>| drop(answer.send(result));
        self.shared.capturing.order(order(Box::new(answer)));
        match answered.await {
            Ok(Ok(words)) => self.send(&Reply::Ok { words }).await,
            Ok(Err(reason)) => self.refuse(reason).await,
            Err(_) => self.refuse("the daemon is ending".into()).await,
        }
    }

    async fn refuse(&mut self, reason: String) -> std::io::Result<()> {
        self.send(&Reply::Refused { reason }).await
    }

    async fn send(&mut self, message: &impl serde::Serialize) -> std::io::Result<()> {
        let mut line = serde_json::to_vec(message)?;
        line.push(b'\n');
        let sent = timeout(self.shared.patience, self.write.write_all(&line)).await;
        sent.unwrap_or_else(|_| Err(ErrorKind::TimedOut.into()))
    }

    /// Ends when the client has closed its connection. A client that has only shut down its sending side still listens.
    async fn gone(&self) {
        loop {
            sleep(LOOK).await;
            let closed = self.write.ready(Interest::WRITABLE).await;
            if closed.map_or(true, |ready| ready.is_write_closed()) {
                return;
            }
        }
    }
}

fn note(
    capture: String,
    kind: String,
    text: String,
    author: Option<String>,
) -> Result<Note, String> {
    if !matches!(kind.as_str(), "accept" | "reject" | "clear" | "text") {
        return Err(format!(
            "kind is {kind:?}, expected accept, reject, clear or text"
        ));
    }
    crate::frame::CaptureId::new(&capture).map_err(|e| e.to_string())?;
    Ok(Note {
        capture,
        kind,
        text,
        author,
    })
}

/// Rejects a client beyond the limit.
pub(super) fn reject(stream: &UnixStream, reason: String) {
    let mut line = serde_json::to_vec(&Reply::Refused { reason }).unwrap_or_default();
    line.push(b'\n');
    // A connection that was just opened has room for a line, unless its client has left.
    let _: Result<usize, Error> = stream.try_write(&line);
}
