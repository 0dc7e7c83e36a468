//! Answers as JSON, and refusals, which have a code for the page's catalogue of words and words for people.

use axum::body::Body;
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::Response;
use serde_json::{Value, json};

/// Why a request is not carried out.
#[derive(Debug)]
pub(super) struct Refusal {
    status: StatusCode,
    code: &'static str,
    words: String,
}

impl Refusal {
    pub(super) fn new(status: StatusCode, code: &'static str, words: impl Into<String>) -> Self {
        Self {
            status,
            code,
            words: words.into(),
        }
    }

    /// A request that makes no sense.
    pub(super) fn bad(words: impl Into<String>) -> Self {
        Self::new(StatusCode::BAD_REQUEST, "bad_request", words)
    }

    /// Whether what was asked for is not there.
    pub(super) fn is_not_found(&self) -> bool {
        self.status == StatusCode::NOT_FOUND
    }

    pub(super) fn response(self) -> Response {
        let body = json!({ "code": self.code, "words": self.words });
        let mut response = json(&body);
        *response.status_mut() = self.status;
        response
    }
}

/// A value as the answer.
pub(super) fn json(value: &Value) -> Response {
    typed("application/json", Body::from(value.to_string()))
}

/// Bytes of a media type as the answer.
pub(super) fn typed(media_type: &'static str, body: Body) -> Response {
    let mut response = Response::new(body);
    let media_type = HeaderValue::from_static(media_type);
    response
        .headers_mut()
        .insert(header::CONTENT_TYPE, media_type);
    response
}

/// An answer, or the refusal.
pub(super) fn answer(result: Result<Response, Refusal>) -> Response {
    result.unwrap_or_else(Refusal::response)
}
