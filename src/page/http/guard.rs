//! What holds for every request: the name under which it came, its session, its role, and where it came from if it
//! changes something. The headers that every answer carries are here too.

use super::reply::Refusal;
use super::{App, Client, HttpRequest};
use crate::page::origin::Origin;
use crate::page::secrets::{are_equal, request_token};
use crate::page::sessions::Role;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, StatusCode, header};
use axum::middleware::Next;
use axum::response::Response;
use serde::de::DeserializeOwned;
use std::net::{IpAddr, Ipv4Addr};
use std::sync::Arc;
use std::time::Duration;

/// Largest body in bytes.
const LARGEST_BODY: usize = 8 << 10;
/// How long a body may take to arrive.
const BODY: Duration = Duration::from_secs(5);
/// Longest address in bytes.
const LONGEST_ADDRESS: usize = 1024;

/// The header that carries the request token of a session.
const TOKEN: &str = "x-scand-token";

/// Which scripts, styles and pictures a browser may load, from where, and where the page may be shown.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; \
    connect-src 'self' blob:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'; \
    require-trusted-types-for 'script'; trusted-types lit-html";

/// What every answer carries.
const HEADERS: [(HeaderName, &str); 6] = [
    (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
    (header::X_FRAME_OPTIONS, "DENY"),
    (header::REFERRER_POLICY, "no-referrer"),
    (
        HeaderName::from_static("cross-origin-opener-policy"),
        "same-origin",
    ),
    (
        HeaderName::from_static("cross-origin-resource-policy"),
        "same-origin",
    ),
    (
        HeaderName::from_static("permissions-policy"),
        "camera=(), geolocation=(), microphone=(), payment=(), usb=()",
    ),
];

/// Refuses what comes under another name, or too much from one client, and puts the headers on every answer.
pub(super) async fn guard(
    State(app): State<Arc<App>>,
    mut request: HttpRequest,
    next: Next,
) -> Response {
    let client = client(&request);
    let mut response = match (origin(&app, &request), app.requests.take(client)) {
        (Ok(origin), Ok(_place)) => {
            request.extensions_mut().insert(origin);
            next.run(request).await
        }
        (Ok(_), Err(_)) => too_many().response(),
        (Err(refusal), _) => refusal.response(),
    };
    let headers = response.headers_mut();
    for (name, value) in HEADERS {
        headers.insert(name, HeaderValue::from_static(value));
    }
    let policy = HeaderValue::from_static(POLICY);
    headers
        .entry(header::CONTENT_SECURITY_POLICY)
        .or_insert(policy);
    let unstored = HeaderValue::from_static("no-store");
    headers.entry(header::CACHE_CONTROL).or_insert(unstored);
    response
}

/// By what the client of a request is counted.
pub(super) fn client(request: &HttpRequest) -> IpAddr {
    let client = request.extensions().get::<Client>();
    client.map_or(IpAddr::V4(Ipv4Addr::UNSPECIFIED), |client| client.0)
}

fn too_many() -> Refusal {
    let words = "too many requests of this address are being answered: try again";
    Refusal::new(StatusCode::SERVICE_UNAVAILABLE, "full", words)
}

/// The origin that the request's one `Host` names.
fn origin(app: &App, request: &HttpRequest) -> Result<Origin, Refusal> {
    if request.uri().to_string().len() > LONGEST_ADDRESS {
        let status = StatusCode::URI_TOO_LONG;
        return Err(Refusal::new(status, "address", "the address is too long"));
    }
    let mut hosts = request.headers().get_all(header::HOST).iter();
    let host = hosts.next().and_then(|host| host.to_str().ok());
    let stranger = || {
        let words = "the page is not served under this name: add it to `origins` in the page's configuration (docs/page.md)";
        Refusal::new(StatusCode::MISDIRECTED_REQUEST, "host", words)
    };
    let origin = host.and_then(|host| app.origins.of_host(host));
    let origin = origin.ok_or_else(stranger)?;
    let named = request.uri().authority();
    let is_other = |named: &axum::http::uri::Authority| {
        !named.as_str().eq_ignore_ascii_case(&origin.authority)
    };
    if hosts.next().is_some() || named.is_some_and(is_other) {
        return Err(stranger());
    }
    Ok(origin.clone())
}

/// The cookie's name. With TLS a browser takes a name of this kind from this host alone.
fn cookie_name(origin: &Origin) -> &'static str {
    if origin.tls { "__Host-scand" } else { "scand" }
}

/// A session's cookie, or with no time left one that removes it.
pub(super) fn cookie(
    origin: &Origin,
    secret: &str,
    lasts: Duration,
) -> Result<HeaderValue, Refusal> {
    let (name, secure) = (
        cookie_name(origin),
        if origin.tls { "; Secure" } else { "" },
    );
    let seconds = lasts.as_secs();
    let text =
        format!("{name}={secret}; Path=/; HttpOnly; SameSite=Strict; Max-Age={seconds}{secure}");
    HeaderValue::from_str(&text).map_err(|_| Refusal::bad("the session has no name"))
}

/// A session that a request carries: its secret and its role.
#[derive(Clone, Debug)]
pub(super) struct Visitor {
    pub(super) secret: String,
    pub(super) role: Role,
}

fn no_session() -> Refusal {
    let words = "there is no session: open a link from `scand page pair`";
    Refusal::new(StatusCode::UNAUTHORIZED, "no_session", words)
}

fn origin_of(request: &HttpRequest) -> Result<&Origin, Refusal> {
    request.extensions().get::<Origin>().ok_or_else(no_session)
}

/// The session of a request that looks at something.
pub(super) fn visitor(app: &App, request: &HttpRequest) -> Result<Visitor, Refusal> {
    let name = cookie_name(origin_of(request)?);
    let cookies = request.headers().get_all(header::COOKIE).iter();
    let pairs = cookies.filter_map(|line| line.to_str().ok());
    let mut pairs = pairs.flat_map(|line| line.split(';'));
    let secret = pairs.find_map(|pair| pair.trim().strip_prefix(name)?.strip_prefix('='));
    let secret = secret.ok_or_else(no_session)?;
    match app.sessions.role(secret) {
        Some(role @ (Role::Viewer | Role::Operator)) => Ok(Visitor {
            secret: secret.into(),
            role,
        }),
        _ => Err(no_session()),
    }
}

/// Whether a request has a bearer's token for `/metrics`.
pub(super) fn is_bearer(app: &App, headers: &HeaderMap) -> bool {
    let value = headers.get(header::AUTHORIZATION);
    let token = value
        .and_then(|value| value.to_str().ok())
        .and_then(|value| value.strip_prefix("Bearer "));
    token.is_some_and(|token| app.sessions.role(token) == Some(Role::Metrics))
}

/// The body of a request that changes something, from the page itself.
pub(super) async fn body<T: DeserializeOwned>(
    request: HttpRequest,
) -> Result<(T, Origin), Refusal> {
    let origin = origin_of(&request)?.clone();
    check_source(&request, &origin)?;
    let read = axum::body::to_bytes(request.into_body(), LARGEST_BODY);
    let too_large = |_| {
        let status = StatusCode::PAYLOAD_TOO_LARGE;
        Refusal::new(
            status,
            "too_large",
            "the request is too large, or broke off",
        )
    };
    let slow = |_| {
        Refusal::new(
            StatusCode::REQUEST_TIMEOUT,
            "slow",
            "the request took too long",
        )
    };
    let bytes = tokio::time::timeout(BODY, read).await.map_err(slow)?;
    let body = serde_json::from_slice(&bytes.map_err(too_large)?);
    let body = body.map_err(|error| Refusal::bad(format!("the request is refused: {error}")))?;
    Ok((body, origin))
}

/// The session and the body of a request that changes something, from the page of an operator.
pub(super) async fn operator<T: DeserializeOwned>(
    app: &App,
    request: HttpRequest,
) -> Result<(Visitor, T), Refusal> {
    let visitor = confirmed(app, &request)?;
    if visitor.role != Role::Operator {
        let words = "this is a viewer's session, which cannot change anything: open an operator's link (scand page pair)";
        return Err(Refusal::new(StatusCode::FORBIDDEN, "viewer", words));
    }
    let (body, _) = body(request).await?;
    Ok((visitor, body))
}

/// The session of a request that changes something: it carries the session's request token.
pub(super) fn confirmed(app: &App, request: &HttpRequest) -> Result<Visitor, Refusal> {
    let visitor = visitor(app, request)?;
    check_source(request, origin_of(request)?)?;
    let token = request.headers().get(TOKEN);
    let token = token.and_then(|token| token.to_str().ok()).unwrap_or("");
    if !are_equal(token, &request_token(&visitor.secret)) {
        let words = "the request does not carry the session's token: load the page again";
        return Err(Refusal::new(StatusCode::FORBIDDEN, "token", words));
    }
    Ok(visitor)
}

/// Refuses what does not come from the page itself, or not as JSON.
fn check_source(request: &HttpRequest, origin: &Origin) -> Result<(), Refusal> {
    let headers = request.headers();
    let one = |name: HeaderName| {
        let mut values = headers.get_all(name).iter();
        let value = values.next().and_then(|value| value.to_str().ok());
        value.filter(|_| values.next().is_none())
    };
    let source = one(header::ORIGIN);
    if source.is_none_or(|source| !source.eq_ignore_ascii_case(&origin.text)) {
        let words = "the request does not come from the page itself";
        return Err(Refusal::new(StatusCode::FORBIDDEN, "origin", words));
    }
    let media_type = one(header::CONTENT_TYPE);
    if request.method() != Method::POST || media_type != Some("application/json") {
        let status = StatusCode::UNSUPPORTED_MEDIA_TYPE;
        return Err(Refusal::new(status, "json", "the request is not JSON"));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cookie_of_a_name_with_tls_is_sent_over_tls_alone() {
        let of = |tls| {
            let origin = Origin {
                text: "https://rig.example".into(),
                authority: "rig.example".into(),
                tls,
            };
            let cookie = cookie(&origin, "abc", Duration::from_secs(60)).unwrap();
            cookie.to_str().unwrap().to_owned()
        };
        let rest = "=abc; Path=/; HttpOnly; SameSite=Strict; Max-Age=60";
        assert_eq!(of(true), format!("__Host-scand{rest}; Secure"));
        assert_eq!(of(false), format!("scand{rest}"));
    }
}
