//! Pictures of the cameras, for operators and viewers: what is newer than what the browser has already.

use super::guard::visitor;
use super::reply::{Refusal, answer, json};
use super::{App, HttpRequest};
use axum::extract::State;
use axum::http::StatusCode;
use axum::response::Response;
use std::sync::Arc;
use std::time::Duration;

/// How long a request waits for a new picture.
const WAIT: Duration = Duration::from_secs(2);

/// What the cameras show, from the number after `since=`.
pub(super) async fn look(State(app): State<Arc<App>>, request: HttpRequest) -> Response {
    let asked = since(&app, &request);
    answer(match asked {
        Ok(since) => newer(&app, since).await,
        Err(refusal) => Err(refusal),
    })
}

/// The number of what the browser has, if it may look.
fn since(app: &App, request: &HttpRequest) -> Result<u64, Refusal> {
    visitor(app, request)?;
    let query = request.uri().query().unwrap_or_default();
    let since = query
        .strip_prefix("since=")
        .and_then(|number| number.parse().ok());
    since.ok_or_else(|| Refusal::bad("expected since= and a number"))
}

async fn newer(app: &App, since: u64) -> Result<Response, Refusal> {
    let full = |_| {
        let words = "too many people look at the cameras: close some pages";
        Refusal::new(StatusCode::SERVICE_UNAVAILABLE, "full", words)
    };
    let _slot = app.looking.try_acquire().map_err(full)?;
    Ok(json(&app.look.after(since, WAIT).await))
}
