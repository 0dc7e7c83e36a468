//! The streams on the server: their limits, how they come to be, and single messages in them by subject. A message that
//! is not needed any more is overwritten by an empty one, which permissions by subject allow where deleting would need
//! more.

use super::connection::FleetClient;
use super::subjects::{CAPTURES, FAILURES, JOBS, RESULTS};
use crate::log;
use async_nats::jetstream::context::{CreateStreamError, CreateStreamErrorKind};
use async_nats::jetstream::stream::{Config, DiscardPolicy, RetentionPolicy};
use async_nats::jetstream::{Context, ErrorCode};
use async_nats::{Request, StatusCode};
use bytes::Bytes;
use std::time::Duration;
use tokio::time::timeout;

const DAY: Duration = Duration::from_secs(86_400);
const MEGABYTE: i64 = 1_000_000;
/// How often a stream's size is halved at most where the server has no storage for it.
const HALVINGS: u32 = 4;
/// How long the server is waited for that answers to a piece of a file, which may have to cross a slow link.
const PIECE_TIMEOUT: Duration = Duration::from_secs(30);
/// How often it is checked, while an answer is waited for, whether it can still come.
const CONNECTION_CHECK: Duration = Duration::from_millis(200);
/// How long the end of a process waits for the server.
const FLUSH: Duration = Duration::from_secs(2);

/// Why the server did not do what it was asked. The caller waits and asks again.
#[derive(Clone, Debug, thiserror::Error)]
#[error("the fleet's server failed to {doing}: {cause}")]
pub(super) struct ServerError {
    pub(super) doing: &'static str,
    pub(super) cause: String,
}

impl ServerError {
    /// Whether its storage for this kind of message is full.
    pub(super) fn is_full(&self) -> bool {
        self.cause.contains("maximum bytes exceeded")
    }

    pub(super) fn error_while(
        doing: &'static str,
    ) -> impl FnOnce(&dyn std::fmt::Display) -> Self + Copy {
        move |cause| Self {
            doing,
            cause: cause.to_string(),
        }
    }
}

/// Each stream keeps one message a subject: the last.
fn stream(name: &str, subjects: &[&str], megabytes: i64, age: Duration) -> Config {
    Config {
        name: name.into(),
        subjects: subjects.iter().map(|s| (*s).to_owned()).collect(),
        max_messages_per_subject: 1,
        max_bytes: megabytes * MEGABYTE,
        max_age: age,
        // A full server refuses what is new, and the rig keeps it, rather than throwing away what somebody waits for.
        discard: DiscardPolicy::New,
        allow_direct: true,
        duplicate_window: Duration::from_secs(120),
        ..Config::default()
    }
}

/// What was erased stays as an empty message until its age is reached, so what comes most often becomes least old. A
/// capture that is gone when a worker comes is sent again.
fn streams() -> [Config; 4] {
    // The largest first: where it has to be smaller, the others become so too.
    [
        stream(CAPTURES, &["scand.capture.>"], 4000, 2 * DAY),
        stream(RESULTS, &["scand.result.>", "scand.part.>"], 2000, 7 * DAY),
        Config {
            retention: RetentionPolicy::WorkQueue,
            ..stream(JOBS, &["scand.job.>"], 200, 14 * DAY)
        },
        stream(FAILURES, &["scand.failure.>"], 50, 60 * DAY),
    ]
}

/// Whether the server has less storage left than a stream may take.
fn lacks_storage(error: &CreateStreamError) -> bool {
    match error.kind() {
        CreateStreamErrorKind::JetStream(error) => {
            error.error_code() == ErrorCode::STORAGE_RESOURCES_EXCEEDED
        }
        _ => false,
    }
}

impl FleetClient {
    /// What is sent while the server is away would wait in memory, and arrive once more for each time it was tried.
    pub(super) fn is_there(&self) -> Result<(), ServerError> {
        if self.is_connected() {
            Ok(())
        } else {
            Err(ServerError::error_while("answer")(&"it is away"))
        }
    }

    /// Makes the streams that are not there.
    pub(super) async fn make_streams(&self) -> Result<(), ServerError> {
        self.is_there()?;
        let mut halved = 0;
        for config in streams() {
            halved = self.make_stream(config, halved).await?;
        }
        Ok(())
    }

    /// Makes a stream if it is not there; a smaller one, as often `halved` or more often, on a server whose storage is
    /// small. Returns how often.
    async fn make_stream(&self, wanted: Config, halved: u32) -> Result<u32, ServerError> {
        let failed = ServerError::error_while("create a stream");
        let (name, most) = (&wanted.name, wanted.max_bytes);
        for halved in halved..=HALVINGS {
            let config = Config {
                max_bytes: most >> halved,
                ..wanted.clone()
            };
            match self.context.get_or_create_stream(config).await {
                Ok(made) => {
                    let size = made.cached_info().config.max_bytes;
                    let bytes = u64::try_from(size).unwrap_or(u64::MAX);
                    self.capacities.lock().insert(wanted.name.clone(), bytes);
                    if halved > 0 && size < most {
                        let [size, most] = [size, most].map(|bytes| bytes / MEGABYTE);
                        log::notice!(
                            "the server has little storage, so stream {name} has {size} MB instead of {most} MB; give \
                             the server more (max_file_store in its configuration, or a larger disk)"
                        );
                    }
                    return Ok(halved);
                }
                Err(error) if lacks_storage(&error) => {}
                Err(error) => return Err(failed(&error)),
            }
        }
        Err(failed(&format!(
            "its storage has no space for {} MB of stream {name} (max_file_store in its configuration, or its disk)",
            (most >> HALVINGS) / MEGABYTE
        )))
    }

    /// Bytes that a stream may hold at most, once that is known.
    pub(super) fn capacity(&self, stream: &str) -> Option<u64> {
        self.capacities.lock().get(stream).copied()
    }

    /// Stores a message; it is on the server when this returns.
    pub(super) async fn store(&self, subject: String, bytes: Bytes) -> Result<(), ServerError> {
        self.store_by(&self.context, subject, bytes).await
    }

    /// Stores a piece of a file.
    pub(super) async fn store_piece(
        &self,
        subject: String,
        bytes: Bytes,
    ) -> Result<(), ServerError> {
        let mut context = self.context.clone();
        context.set_timeout(PIECE_TIMEOUT);
        self.store_by(&context, subject, bytes).await
    }

    async fn store_by(
        &self,
        context: &Context,
        subject: String,
        bytes: Bytes,
    ) -> Result<(), ServerError> {
        self.is_there()?;
        let failed = ServerError::error_while("store the message");
        let stored = async {
            let sent = context
                .publish(subject, bytes)
                .await
                .map_err(|e| failed(&e))?;
            sent.await.map(drop).map_err(|e| failed(&e))
        };
        self.unless_lost(stored).await
    }

    /// Ends when the connection is lost: what was under way is not answered then.
    async fn unless_lost<T>(
        &self,
        answer: impl Future<Output = Result<T, ServerError>>,
    ) -> Result<T, ServerError> {
        let connections = self.connections();
        let lost = async {
            while self.is_connected() && self.connections() == connections {
                tokio::time::sleep(CONNECTION_CHECK).await;
            }
        };
        tokio::select! {
            answer = answer => answer,
            () = lost => Err(ServerError::error_while("answer")(&"the connection was lost")),
        }
    }

    /// The last message of a subject; `None` if there is none, or an empty one in its place.
    pub(super) async fn stored(
        &self,
        stream: &str,
        subject: &str,
    ) -> Result<Option<Bytes>, ServerError> {
        self.stored_by(stream, subject, Request::new()).await
    }

    /// As [`Self::stored`], of a piece of a file.
    pub(super) async fn stored_patiently(
        &self,
        stream: &str,
        subject: &str,
    ) -> Result<Option<Bytes>, ServerError> {
        let patient = Request::new().timeout(Some(PIECE_TIMEOUT));
        self.stored_by(stream, subject, patient).await
    }

    async fn stored_by(
        &self,
        stream: &str,
        subject: &str,
        request: Request,
    ) -> Result<Option<Bytes>, ServerError> {
        self.is_there()?;
        let asked = format!("$JS.API.DIRECT.GET.{stream}.{subject}");
        let answer = async {
            let answer = self.client.send_request(asked, request).await;
            answer.map_err(|e| ServerError::error_while("answer")(&e))
        };
        let answer = self.unless_lost(answer).await?;
        match answer.status {
            None | Some(StatusCode::OK) => Ok(Some(answer.payload).filter(|p| !p.is_empty())),
            Some(StatusCode::NOT_FOUND) => Ok(None),
            Some(status) => Err(ServerError::error_while("answer")(&status)),
        }
    }

    /// Overwrites a message by an empty one. Nobody waits for it: what it leaves behind ends by its age.
    pub(super) async fn erase(&self, subject: String) {
        if self.is_there().is_err() {
            return;
        }
        let _ = self.client.publish(subject, Bytes::new()).await;
    }

    /// Waits until the server has what was sent, for two seconds at most. A process that ends without it leaves there
    /// what it has just erased.
    pub(super) async fn flush(&self) {
        let _ = timeout(FLUSH, self.client.flush()).await;
    }
}
