//! What people do: begin and end their session, press, take plates, begin and close sessions, note, have models made
//! again. Each becomes one request to the daemon; none names a path.

use super::guard::{body, client, confirmed, cookie, operator, visitor};
use super::reply::{Refusal, answer, json};
use super::{App, HttpRequest};
use crate::log;
use crate::page::daemon;
use crate::page::models::is_name;
use crate::page::origin::Origin;
use crate::page::secrets::request_token;
use crate::page::sessions;
use crate::trigger::{LONGEST_REQUEST, Reply, Request};
use axum::extract::State;
use axum::http::{StatusCode, header};
use axum::response::Response;
use serde::Deserialize;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

/// Longest number of an object, name of a person or of a project, in characters.
const LONGEST_NAME: usize = 100;
/// Longest note in characters.
const LONGEST_NOTE: usize = 500;
/// How long before its arrival somebody may have pressed, in milliseconds: later, hands are in the picture again.
const LATEST_MS: u64 = 10_000;
/// How far after it, in milliseconds: a browser's clock runs a little faster than this one.
const AHEAD_MS: u64 = 1000;
/// What a session may say of itself.
const ABOUT: [&str; 4] = ["operator", "project", "title", "rights"];

/// Who asks, what they may do, and what the page is called.
pub(super) async fn me(State(app): State<Arc<App>>, request: HttpRequest) -> Response {
    answer(visitor(&app, &request).map(|visitor| {
        json(
            &json!({ "role": visitor.role, "token": request_token(&visitor.secret), "rig": app.rig,
            "version": env!("CARGO_PKG_VERSION") }),
        )
    }))
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Pair {
    token: String,
}

/// Takes the token of a link for a session.
pub(super) async fn pair(State(app): State<Arc<App>>, request: HttpRequest) -> Response {
    answer(begin(&app, request).await)
}

async fn begin(app: &App, request: HttpRequest) -> Result<Response, Refusal> {
    let client = client(&request);
    let (asked, origin): (Pair, _) = body(request).await?;
    let begun = app.sessions.begin(&asked.token, client);
    let (secret, role, lasts) = begun.map_err(|error| {
        let (status, code) = match error {
            sessions::Error::Unknown => (StatusCode::FORBIDDEN, "link"),
            sessions::Error::TooManyTries => (StatusCode::TOO_MANY_REQUESTS, "tries"),
            _ => (StatusCode::SERVICE_UNAVAILABLE, "session"),
        };
        // Who tries on and on does not fill the log.
        if code != "tries" {
            log::warning!("a session was refused: {error}");
        }
        Refusal::new(status, code, error.to_string())
    })?;
    log::notice!("a session began: {role:?}");
    let mut response = json(&json!({ "role": role }));
    let cookie = cookie(&origin, &secret, lasts)?;
    response.headers_mut().insert(header::SET_COOKIE, cookie);
    Ok(response)
}

/// Ends the session that asks.
pub(super) async fn leave(State(app): State<Arc<App>>, request: HttpRequest) -> Response {
    answer(end(&app, &request))
}

fn end(app: &App, request: &HttpRequest) -> Result<Response, Refusal> {
    let visitor = confirmed(app, request)?;
    let failed = |error: sessions::Error| {
        let status = StatusCode::SERVICE_UNAVAILABLE;
        Refusal::new(status, "session", error.to_string())
    };
    app.sessions.leave(&visitor.secret).map_err(failed)?;
    let mut response = json(&json!({}));
    if let Some(origin) = request.extensions().get::<Origin>() {
        let removed = cookie(origin, "", Duration::ZERO)?;
        response.headers_mut().insert(header::SET_COOKIE, removed);
    }
    Ok(response)
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct PressBody {
    press_id: String,
    #[serde(default)]
    subject: Option<String>,
    #[serde(default)]
    placement: Option<String>,
    /// When somebody pressed, by [`App::clock_ms`].
    #[serde(default)]
    pressed_ms: Option<u64>,
}

/// Whether a press that arrives now is none any more, or is by the clock of an earlier process.
fn is_late(pressed_ms: u64, now_ms: u64) -> bool {
    let pressed = now_ms.saturating_sub(LATEST_MS)..=now_ms.saturating_add(AHEAD_MS);
    !pressed.contains(&pressed_ms)
}

fn late() -> Refusal {
    let words = "the press arrived more than ten seconds late and began nothing: look whether there is a new capture \
         before you press again";
    Refusal::new(StatusCode::CONFLICT, "late", words)
}

/// Takes a capture; answered when it is on the disk.
pub(super) async fn press(State(app): State<Arc<App>>, request: HttpRequest) -> Response {
    let pressed = async {
        let (_, asked): (_, PressBody) = operator(&app, request).await?;
        let is_fine = |b: u8| b.is_ascii_alphanumeric() || b == b'-';
        if !(8..=64).contains(&asked.press_id.len()) || !asked.press_id.bytes().all(is_fine) {
            return Err(Refusal::bad(
                "press_id: expected 8 to 64 letters, digits and hyphens",
            ));
        }
        let named = |name: &str, text: Option<String>| {
            let text = text.filter(|text| !text.trim().is_empty());
            text.map(|text| line(name, &text, LONGEST_NAME)).transpose()
        };
        let subject = named("subject", asked.subject)?;
        let placement = named("placement", asked.placement)?;
        let now_ms = app.clock_ms();
        let pressed = asked.pressed_ms;
        if pressed.is_some_and(|pressed_ms| is_late(pressed_ms, now_ms)) {
            return Err(late());
        }
        let reply = app.daemon.press(&asked.press_id, subject, placement);
        told(reply.await)
    };
    answer(pressed.await)
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct EmptyBody {}

/// Takes background pictures of the empty rig.
pub(super) async fn plates(State(app): State<Arc<App>>, request: HttpRequest) -> Response {
    let taken = async {
        let (_, EmptyBody {}) = operator(&app, request).await?;
        ask(&app, Request::Background {}).await
    };
    answer(taken.await)
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Session {
    /// None to close the one that is open.
    name: Option<String>,
    #[serde(default)]
    about: BTreeMap<String, String>,
}

/// Begins a session of captures, or closes it.
pub(super) async fn session(State(app): State<Arc<App>>, request: HttpRequest) -> Response {
    let begun = async {
        let (_, asked): (_, Session) = operator(&app, request).await?;
        let Some(name) = asked.name else {
            return ask(&app, Request::Close {}).await;
        };
        let mut about = BTreeMap::new();
        for (key, value) in asked.about {
            if !ABOUT.contains(&key.as_str()) {
                return Err(Refusal::bad(format!(
                    "about: the page does not accept the key {key:?}, expected operator, project, title or rights"
                )));
            }
            let value = line(&key, &value, LONGEST_NAME)?;
            if !value.is_empty() {
                about.insert(key, value);
            }
        }
        ask(&app, Request::Begin { name, about }).await
    };
    answer(begun.await)
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Note {
    capture: String,
    kind: String,
    #[serde(default)]
    text: String,
    #[serde(default)]
    author: Option<String>,
}

/// Accepts or rejects a capture, takes that back, or notes something about it.
pub(super) async fn note(State(app): State<Arc<App>>, request: HttpRequest) -> Response {
    let noted = async {
        let (_, asked): (_, Note) = operator(&app, request).await?;
        let kinds = ["accept", "reject", "clear", "text"];
        if !is_name(&asked.capture) || !kinds.contains(&asked.kind.as_str()) {
            return Err(Refusal::bad(
                "a note needs a capture's name and a kind: accept, reject, clear or text",
            ));
        }
        let author = asked.author.filter(|author| !author.trim().is_empty());
        let author = author.map(|author| line("author", &author, LONGEST_NAME));
        let request = Request::Note {
            capture: asked.capture,
            kind: asked.kind,
            text: line("text", &asked.text, LONGEST_NOTE)?,
            author: author.transpose()?,
        };
        ask(&app, request).await
    };
    answer(noted.await)
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Remake {
    capture: String,
    /// The daemon has their list, and refuses what is not in it.
    settings: BTreeMap<String, Value>,
}

/// Has a capture's model made again with other settings.
pub(super) async fn remake(State(app): State<Arc<App>>, request: HttpRequest) -> Response {
    let asked = async {
        let (_, asked): (_, Remake) = operator(&app, request).await?;
        let is_value = |value: &Value| value.is_number() || value.is_string();
        if !is_name(&asked.capture) || !asked.settings.values().all(is_value) {
            return Err(Refusal::bad(
                "a remake needs a capture's name, and settings whose values are numbers or words",
            ));
        }
        let request = Request::Remake {
            capture: asked.capture,
            settings: asked.settings,
        };
        ask(&app, request).await
    };
    answer(asked.await)
}

/// A text of one line, trimmed.
fn line(name: &str, text: &str, longest: usize) -> Result<String, Refusal> {
    let text = text.trim();
    if text.chars().count() > longest || text.chars().any(char::is_control) {
        return Err(Refusal::bad(format!(
            "{name}: expected at most {longest} characters in one line"
        )));
    }
    Ok(text.into())
}

async fn ask(app: &App, request: Request) -> Result<Response, Refusal> {
    let length = serde_json::to_string(&request).map_or(usize::MAX, |line| line.len());
    if length >= LONGEST_REQUEST {
        return Err(Refusal::bad("the request is too long for the daemon"));
    }
    told(app.daemon.ask(&request).await)
}

/// The daemon's answer, with the members that the page shows. A reason may name a folder, so only a client
/// that may press gets it.
fn told(reply: Result<Reply, daemon::Error>) -> Result<Response, Refusal> {
    let reply = reply.map_err(|error| {
        let code = match error {
            daemon::Error::Full => "full",
            daemon::Error::Unsure => "unsure",
            _ => "away",
        };
        Refusal::new(StatusCode::SERVICE_UNAVAILABLE, code, error.to_string())
    })?;
    let mut value = serde_json::to_value(reply).unwrap_or(Value::Null);
    if let Some(members) = value.as_object_mut() {
        members.retain(|key, _| ["type", "capture", "reason", "words"].contains(&key.as_str()));
    }
    Ok(json(&value))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_press_counts_for_ten_seconds_by_the_clock_of_this_process() {
        for (pressed_ms, now_ms, expected) in [
            (0, 0, false),
            (0, 10_000, false),
            (0, 10_001, true),
            (70_000, 80_000, false),
            (69_999, 80_000, true),
            // The browser's clock is a little ahead.
            (80_500, 80_000, false),
            // What the browser knows is of before this process began.
            (90_000, 80_000, true),
            (u64::MAX, 80_000, true),
        ] {
            let found = is_late(pressed_ms, now_ms);
            assert_eq!(found, expected, "{pressed_ms} at {now_ms}");
        }
    }
}
