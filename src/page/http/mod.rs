//! What the page answers over HTTP: routes, and which client may ask for what. Every request goes through `guard`
//! first.

mod act;
mod files;
mod guard;
mod history;
mod look;
mod reply;
mod stream;

use super::assets::{Asset, assets};
use super::daemon::Daemon;
use super::look::Look;
use super::models::Models;
use super::origin::Origins;
use super::secrets::Hash;
use super::sessions::Sessions;
use super::views::Views;
use super::watch::Watch;
use crate::shares::Shares;
use axum::Router;
use axum::http::{Request, StatusCode};
use axum::response::Response;
use axum::routing::{get, post};
use reply::Refusal;
use std::collections::BTreeMap;
use std::net::IpAddr;
use std::sync::Arc;
use std::time::Instant;
use tokio::sync::Semaphore;

/// A request as the server hands it over.
pub(super) type HttpRequest = Request<axum::body::Body>;

/// What a client is counted by: the address that the connection tells, or that a reverse proxy names which the
/// configuration names.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Client(pub(super) IpAddr);

/// Files of models that are sent at a time, and to one session: a browser asks for six things at a time.
const DOWNLOADS: usize = 12;
const DOWNLOADS_OF_ONE: usize = 6;

/// Small forms of them that are made and sent at a time; others wait.
const SMALL: usize = 4;

/// Threads that read files. Each of those that are sent to a slow client keeps one for as long as that takes, and lists
/// do not wait for them.
pub(super) const READERS: usize = DOWNLOADS + SMALL + 16;

/// Streams of events that are open at a time, and of one session.
const STREAMS: usize = 64;
const STREAMS_OF_ONE: usize = 8;

/// Requests for pictures of the cameras that wait at a time.
const LOOKING: usize = 16;

/// Connections at a time, and of one address: more than there are streams, for behind a reverse proxy that is not named
/// all clients have one address. As many requests are answered at a time.
pub(super) const CONNECTIONS: usize = 256;
pub(super) const CONNECTIONS_OF_ONE: usize = 96;

/// What all requests share.
pub(super) struct App {
    pub(super) origins: Origins,
    pub(super) rig: String,
    pub(super) sessions: Arc<Sessions>,
    pub(super) daemon: Arc<Daemon>,
    pub(super) watch: Arc<Watch>,
    pub(super) look: Look,
    pub(super) models: Models,
    pub(super) views: Option<Arc<Views>>,
    assets: BTreeMap<&'static str, Asset>,
    requests: Arc<Shares<IpAddr>>,
    downloads: Arc<Shares<Hash>>,
    small: Arc<Semaphore>,
    looking: Semaphore,
    streams: Arc<Shares<Hash>>,
    begun: Instant,
}

impl App {
    pub(super) fn new(
        origins: Origins,
        rig: String,
        sessions: Arc<Sessions>,
        daemon: Arc<Daemon>,
        watch: Arc<Watch>,
        models: Models,
        views: Option<Views>,
    ) -> Self {
        Self {
            origins,
            rig,
            sessions,
            daemon,
            watch,
            look: Look::new(),
            models,
            views: views.map(Arc::new),
            assets: assets(),
            requests: Shares::new(CONNECTIONS, CONNECTIONS_OF_ONE),
            downloads: Shares::new(DOWNLOADS, DOWNLOADS_OF_ONE),
            small: Arc::new(Semaphore::new(SMALL)),
            looking: Semaphore::new(LOOKING),
            streams: Shares::new(STREAMS, STREAMS_OF_ONE),
            begun: Instant::now(),
        }
    }

    /// Milliseconds since this process began to serve, by which a browser tells when somebody pressed.
    pub(super) fn clock_ms(&self) -> u64 {
        u64::try_from(self.begun.elapsed().as_millis()).unwrap_or(u64::MAX)
    }
}

/// All routes.
pub(super) fn router(app: Arc<App>) -> Router {
    Router::new()
        .route("/", get(files::index))
        .route("/assets/{*name}", get(files::asset))
        .route("/licences.txt", get(files::licences))
        .route("/favicon.svg", get(files::icon))
        .route("/healthz", get(files::health))
        .route("/metrics", get(files::metrics))
        .route("/api/me", get(act::me))
        .route("/api/pair", post(act::pair))
        .route("/api/leave", post(act::leave))
        .route("/api/press", post(act::press))
        .route("/api/plates", post(act::plates))
        .route("/api/session", post(act::session))
        .route("/api/note", post(act::note))
        .route("/api/remake", post(act::remake))
        .route("/api/events", get(stream::events))
        .route("/api/look", get(look::look))
        .route("/api/state", get(history::state))
        .route("/api/recordings", get(history::recordings))
        .route("/api/recordings/{recording}", get(history::captures))
        .route(
            "/api/models/{recording}/{capture}/difference/{with}/{other}",
            get(history::difference),
        )
        .route(
            "/api/models/{recording}/{capture}/related",
            get(history::related),
        )
        .route(
            "/api/models/{recording}/{capture}/photographs",
            get(history::photographs),
        )
        .route(
            "/api/models/{recording}/{capture}/photographs/{camera}",
            get(history::photograph),
        )
        .route(
            "/api/models/{recording}/{capture}/{file}",
            get(history::file),
        )
        .fallback(nothing)
        .method_not_allowed_fallback(no_method)
        .layer(axum::middleware::from_fn_with_state(
            app.clone(),
            guard::guard,
        ))
        .with_state(app)
}

async fn nothing() -> Response {
    Refusal::new(StatusCode::NOT_FOUND, "not_found", "there is no such page").response()
}

async fn no_method() -> Response {
    let status = StatusCode::METHOD_NOT_ALLOWED;
    Refusal::new(
        status,
        "method",
        "this address does not accept this HTTP method",
    )
    .response()
}
