//! What holds now, as a stream of server-sent events: one at each change, at most ten a second, and one every four
//! seconds when nothing changes, so that a browser knows that what it shows is so now.

use super::guard::visitor;
use super::reply::{Refusal, answer, typed};
use super::{App, HttpRequest};
use crate::page::secrets::Hash;
use crate::shares::Share;
use axum::body::{Body, Bytes};
use axum::extract::State;
use axum::http::StatusCode;
use axum::response::Response;
use std::convert::Infallible;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::sync::watch;
use tokio::time::{sleep, timeout};

/// Longest time between two events of a stream.
const EVERY: Duration = Duration::from_secs(4);
/// Shortest one.
const PAUSE: Duration = Duration::from_millis(100);

/// A stream that is open, and what it needs for its next event.
struct Stream {
    app: Arc<App>,
    secret: String,
    changes: watch::Receiver<u64>,
    is_first: bool,
    _share: Share<Hash>,
}

/// The stream of what holds now.
pub(super) async fn events(State(app): State<Arc<App>>, request: HttpRequest) -> Response {
    answer(open(&app, &request))
}

fn open(app: &Arc<App>, request: &HttpRequest) -> Result<Response, Refusal> {
    let visitor = visitor(app, request)?;
    let full = || {
        let words = "too many pages are open: close some";
        Refusal::new(StatusCode::SERVICE_UNAVAILABLE, "full", words)
    };
    let share = app
        .streams
        .take(Hash::of(&visitor.secret))
        .map_err(|_| full())?;
    let stream = Stream {
        changes: app.watch.changes(),
        app: app.clone(),
        secret: visitor.secret,
        is_first: true,
        _share: share,
    };
    let stream = futures_util::stream::unfold(stream, next);
    Ok(typed("text/event-stream", Body::from_stream(stream)))
}

async fn next(mut stream: Stream) -> Option<(Result<Bytes, Infallible>, Stream)> {
    if !std::mem::take(&mut stream.is_first) {
        sleep(PAUSE).await;
        // Whether something changed or the time passed, what holds then is sent.
        let _ = timeout(EVERY, stream.changes.changed()).await;
    }
    // A session that was revoked, or is over, sees no more.
    stream.app.sessions.role(&stream.secret)?;
    stream.changes.mark_unchanged();
    let mut now = stream.app.watch.look(|now| now.snapshot(Instant::now()));
    now["clock_ms"] = stream.app.clock_ms().into();
    let event = format!("event: now\ndata: {now}\n\n");
    Some((Ok(event.into()), stream))
}
