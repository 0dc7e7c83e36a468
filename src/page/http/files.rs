//! The page's own files, its health and its metrics.

use super::guard::is_bearer;
use super::reply::{Refusal, typed};
use super::{App, HttpRequest};
use axum::body::Body;
use axum::extract::{Path, State};
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::Response;
use std::sync::Arc;
use std::time::Instant;

/// Whether the other side takes bytes compressed with gzip.
pub(super) fn takes_gzip(headers: &HeaderMap) -> bool {
    let accepted = headers.get_all(header::ACCEPT_ENCODING).iter();
    let accepted = accepted.filter_map(|value| value.to_str().ok());
    let mut codings = accepted.flat_map(|value| value.split(','));
    codings.any(|coding| {
        let (name, weight) = coding.split_once(';').unwrap_or((coding, ""));
        name.trim() == "gzip" && !["q=0", "q=0.0"].contains(&weight.trim())
    })
}

/// The page.
pub(super) async fn index(State(app): State<Arc<App>>, headers: HeaderMap) -> Response {
    send(&app, "index.html", &headers)
}

/// Who made what the page is built from, under which licences.
pub(super) async fn licences(State(app): State<Arc<App>>, headers: HeaderMap) -> Response {
    send(&app, "licences.txt", &headers)
}

pub(super) async fn icon(State(app): State<Arc<App>>, headers: HeaderMap) -> Response {
    send(&app, "favicon.svg", &headers)
}

/// A script, a style or a picture of the page.
pub(super) async fn asset(
    State(app): State<Arc<App>>,
    Path(name): Path<String>,
    headers: HeaderMap,
) -> Response {
    send(&app, &format!("assets/{name}"), &headers)
}

fn send(app: &App, name: &str, headers: &HeaderMap) -> Response {
    let Some(asset) = app.assets.get(name) else {
        let words = "the page has no such file";
        return Refusal::new(StatusCode::NOT_FOUND, "not_found", words).response();
    };
    let compressed = takes_gzip(headers) && !asset.compressed.is_empty();
    let body = if compressed {
        Body::from(asset.compressed.clone())
    } else {
        Body::from(asset.plain)
    };
    let mut response = typed(asset.media_type, body);
    let headers = response.headers_mut();
    let vary = HeaderValue::from_static("Accept-Encoding");
    headers.insert(header::VARY, vary);
    if compressed {
        let gzip = HeaderValue::from_static("gzip");
        headers.insert(header::CONTENT_ENCODING, gzip);
    }
    if asset.is_hashed {
        let for_ever = HeaderValue::from_static("public, max-age=31536000, immutable");
        headers.insert(header::CACHE_CONTROL, for_ever);
    }
    response
}

/// Whether the page and the daemon answer; tells no names.
pub(super) async fn health(State(app): State<Arc<App>>) -> Response {
    let plain = "text/plain; charset=utf-8";
    if app.watch.look(|now| now.is_there(Instant::now())) {
        return typed(plain, Body::from("ok\n"));
    }
    let mut response = typed(plain, Body::from("the daemon does not answer\n"));
    *response.status_mut() = StatusCode::SERVICE_UNAVAILABLE;
    response
}

/// Figures for a program that watches, which has a token for them.
pub(super) async fn metrics(State(app): State<Arc<App>>, request: HttpRequest) -> Response {
    if !is_bearer(&app, request.headers()) {
        let words = "/metrics needs a token: `scand page token` makes one";
        let refusal = Refusal::new(StatusCode::UNAUTHORIZED, "no_token", words);
        let mut response = refusal.response();
        let bearer = HeaderValue::from_static("Bearer");
        response
            .headers_mut()
            .insert(header::WWW_AUTHENTICATE, bearer);
        return response;
    }
    let media_type = "application/openmetrics-text; version=1.0.0; charset=utf-8";
    typed(media_type, Body::from(app.watch.metrics()))
}
