//! Listens and serves: a bounded number of connections, each with limits on its headers, its idle time and how long it
//! may refuse to read.

use super::control;
use super::daemon::Daemon;
use super::http::{App, CONNECTIONS, CONNECTIONS_OF_ONE, Client, READERS, router};
use super::kept;
use super::models::Models;
use super::parameters::{self, Parameters};
use super::recordings::Recordings;
use super::sessions::{self, Sessions};
use super::tls::Tls;
use super::views::{View, Views};
use super::watch::Watch;
use crate::log;
use crate::shares::Shares;
use axum::Router;
use hyper::body::Incoming;
use hyper::service::{Service, service_fn};
use hyper::{HeaderMap, Request};
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use rustix::net::sockopt;
use std::future::Future;
use std::net::{IpAddr, Ipv6Addr};
use std::path::{Path, PathBuf};
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll, ready};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{TcpListener, TcpStream};
use tokio::signal::unix::{SignalKind, signal};
use tokio::time::Sleep;

/// The header in which a reverse proxy says for whom it asks.
const FORWARDED: &str = "x-forwarded-for";
/// How long the headers of a request may take, and a connection may be idle.
pub(super) const HEADERS: Duration = Duration::from_secs(5);
/// How long the other side may refuse to read.
const STALL: Duration = Duration::from_secs(20);
/// How long, in milliseconds, the other side may acknowledge nothing of what was sent: a tablet that left the network
/// without a word does not keep its streams open.
const UNACKNOWLEDGED_MS: u32 = 20_000;
/// Most headers of a request, and bytes that are read ahead.
const MOST_HEADERS: usize = 64;
const BUFFER: usize = 16 << 10;

/// Why the page cannot be served.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum Error {
    #[error(transparent)]
    Parameters(#[from] parameters::Error),
    #[error("this program was built without the page's files: run `make ui`, and build it again")]
    NoFiles,
    #[error("cannot set up TLS: {0}")]
    Tls(String),
    #[error("cannot read the sessions: {0}")]
    Sessions(String),
    #[error("{what}: {cause}")]
    Io { what: String, cause: std::io::Error },
}

/// Serves the page until SIGTERM or Ctrl-C.
///
/// # Errors
/// If the configuration is refused, an address or socket is taken, or the state cannot be read.
pub fn run(parameters: &Parameters) -> Result<(), Error> {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .max_blocking_threads(READERS)
        .build();
    let failed = |cause| Error::Io {
        what: "the page's runtime".into(),
        cause,
    };
    runtime.map_err(failed)?.block_on(serve(parameters))
}

async fn serve(parameters: &Parameters) -> Result<(), Error> {
    if super::assets::assets().is_empty() {
        return Err(Error::NoFiles);
    }
    let at = |path: &PathBuf| {
        let what = path.display().to_string();
        move |cause| Error::Io { what, cause }
    };
    std::fs::create_dir_all(&parameters.state).map_err(at(&parameters.state))?;
    let app = app(parameters)?;
    let tls = parameters.tls.as_ref().map(Tls::open).transpose();
    let tls = tls.map_err(Error::Tls)?;
    let renewal = tls.clone();
    let renewal = async {
        match renewal {
            Some(tls) => tls.renew().await,
            None => std::future::pending().await,
        }
    };
    let listener = TcpListener::bind(parameters.listen).await;
    let listener = listener.map_err(|cause| Error::Io {
        what: parameters.listen.to_string(),
        cause,
    })?;
    let control = control::listen(&parameters.control).map_err(at(&parameters.control))?;
    let proxies = parameters.proxies()?;
    let origins = parameters.origins()?;
    let origin = origins.for_links().map(|origin| origin.text.clone());
    let origin = origin.unwrap_or_default();
    log::notice!("the page is at {origin}: `scand page pair` prints a link that begins a session");
    let sessions = app.sessions.clone();
    tokio::select! {
        () = control::serve(control, sessions, origin) => {}
        () = app.watch.keep_events(&app.daemon) => {}
        () = app.watch.keep_status(&app.daemon) => {}
        () = app.look.keep(&app.daemon, &app.models) => {}
        () = accept(listener, tls, router(app.clone()), proxies, HEADERS) => {}
        () = renewal => {}
        () = prepare(&app) => {}
        () = kept::keep(&parameters.state, &app.watch) => {}
        () = told_to_end() => {}
    }
    // The runtime does not end before its threads, and one of them may wait for a process.
    if let Some(views) = &app.views {
        views.end();
    }
    let _ = kept::store(&parameters.state, &app.watch);
    let _ = std::fs::remove_file(&parameters.control);
    Ok(())
}

pub(super) fn app(parameters: &Parameters) -> Result<Arc<App>, Error> {
    let hours = |hours: u32| Duration::from_secs(3600 * u64::from(hours));
    let sessions = Sessions::open(
        &parameters.state,
        hours(parameters.operator_hours),
        hours(parameters.viewer_hours),
    );
    let sessions = sessions.map_err(|error: sessions::Error| Error::Sessions(error.to_string()))?;
    let watch = Watch::new();
    if let Some((captures, ago)) = kept::load(&parameters.state) {
        watch.restore(captures, ago);
    }
    Ok(Arc::new(App::new(
        parameters.origins()?,
        parameters.rig.clone(),
        Arc::new(sessions),
        Arc::new(Daemon::new(&parameters.socket)),
        watch,
        Models::new(&parameters.models),
        views(parameters),
    )))
}

/// The cache of small forms; without one, files are sent as they are.
fn views(parameters: &Parameters) -> Option<Views> {
    let cache = &parameters.cache;
    let recordings = Recordings::new(&parameters.recordings);
    // Also after an upgrade it is this program, whatever the file is called now.
    let views = Views::open(cache, Path::new("/proc/self/exe"), recordings);
    views
        .map_err(|error| {
            log::warning!(
                "cannot use the cache {}, so the page sends model files in full size: {error}",
                cache.display()
            )
        })
        .ok()
}

/// Has small forms of each new model made before somebody asks for them, for ever.
async fn prepare(app: &App) {
    let mut changes = app.watch.changes();
    loop {
        while let Some([recording, capture]) = app.watch.take_made() {
            let (models, views) = (app.models.clone(), app.views.clone());
            let make = move || {
                let views = views?;
                for view in [View::Model, View::Thumbnail] {
                    let _ = views.get(&models, &recording, &capture, view);
                }
                Some(())
            };
            let _ = tokio::task::spawn_blocking(make).await;
        }
        if changes.changed().await.is_err() {
            return std::future::pending().await;
        }
    }
}

async fn told_to_end() {
    let Ok(mut terminate) = signal(SignalKind::terminate()) else {
        return std::future::pending().await;
    };
    tokio::select! {
        _ = terminate.recv() => {}
        _ = tokio::signal::ctrl_c() => {}
    }
}

/// Accepts connections, for ever; one for which there is no place is closed at once. `patience` is how long the headers
/// of a request may take, and how long a connection may be idle.
pub(super) async fn accept(
    listener: TcpListener,
    tls: Option<Arc<Tls>>,
    router: Router,
    proxies: Arc<[IpAddr]>,
    patience: Duration,
) {
    let places = Shares::new(CONNECTIONS, CONNECTIONS_OF_ONE);
    loop {
        let Ok((stream, address)) = listener.accept().await else {
            // No file descriptors are left, for example.
            tokio::time::sleep(Duration::from_millis(50)).await;
            continue;
        };
        let peer = address.ip().to_canonical();
        // A proxy stands for many clients, whose requests are counted.
        let place = if proxies.contains(&peer) {
            places.take_any(counted(peer))
        } else {
            places.take(counted(peer))
        };
        let Ok(place) = place else {
            continue;
        };
        let router = router.clone();
        let proxies = proxies.clone();
        let acceptor = tls.as_ref().map(|tls| tls.acceptor());
        let stream = StallGuard::new(stream);
        tokio::spawn(async move {
            let client = move |headers: &HeaderMap| client_of(peer, &proxies, headers);
            match acceptor {
                None => serve_one(stream, client, router, patience).await,
                Some(acceptor) => {
                    // One that greets too slowly, or not at all, is left as one with slow headers is.
                    let greeted = tokio::time::timeout(patience, acceptor.accept(stream)).await;
                    if let Ok(Ok(stream)) = greeted {
                        serve_one(stream, client, router, patience).await;
                    }
                }
            }
            drop(place);
        });
    }
}

/// Who asks: the other side of the connection, or whom a proxy names last that the configuration names. What stands in
/// front of that, anybody may have written.
fn client_of(peer: IpAddr, proxies: &[IpAddr], headers: &HeaderMap) -> Client {
    let forwarded = || -> Option<IpAddr> {
        let last = headers.get_all(FORWARDED).iter().next_back()?;
        let last = last.to_str().ok()?.rsplit(',').next()?;
        last.trim().parse().ok()
    };
    let forwarded = proxies.contains(&peer).then(forwarded).flatten();
    Client(counted(forwarded.unwrap_or(peer)))
}

/// What an address is counted as: of an IPv6 address its network, for whoever has one address of it may have all.
fn counted(address: IpAddr) -> IpAddr {
    match address.to_canonical() {
        IpAddr::V6(address) => {
            let network = u128::from(address) & !u128::from(u64::MAX);
            IpAddr::V6(Ipv6Addr::from(network))
        }
        address @ IpAddr::V4(_) => address,
    }
}

async fn serve_one(
    stream: impl AsyncRead + AsyncWrite + Unpin + Send + 'static,
    client: impl Fn(&HeaderMap) -> Client,
    router: Router,
    patience: Duration,
) {
    let routes = TowerToHyperService::new(router);
    let service = service_fn(move |mut request: Request<Incoming>| {
        let client = client(request.headers());
        request.extensions_mut().insert(client);
        routes.call(request)
    });
    let connection = hyper::server::conn::http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(patience)
        .max_headers(MOST_HEADERS)
        .max_buf_size(BUFFER)
        .serve_connection(TokioIo::new(stream), service);
    // A connection that breaks, or is broken off, is its other side's affair.
    let _ = connection.await;
}

/// A stream that is broken off when the other side has not read for [`STALL`].
struct StallGuard {
    stream: TcpStream,
    stalled: Option<Pin<Box<Sleep>>>,
}

impl StallGuard {
    fn new(stream: TcpStream) -> Self {
        let _ = stream.set_nodelay(true);
        // Where it is refused, the system's own limit holds, a quarter of an hour.
        let _ = sockopt::set_tcp_user_timeout(&stream, UNACKNOWLEDGED_MS);
        Self {
            stream,
            stalled: None,
        }
    }

    fn wait(&mut self, context: &mut Context<'_>) -> Poll<std::io::Error> {
        let stalled = self
            .stalled
            .get_or_insert_with(|| Box::pin(tokio::time::sleep(STALL)));
        ready!(stalled.as_mut().poll(context));
        Poll::Ready(std::io::ErrorKind::TimedOut.into())
    }
}

impl AsyncRead for StallGuard {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<std::io::Result<()>> {
        Pin::new(&mut self.stream).poll_read(context, buffer)
    }
}

impl AsyncWrite for StallGuard {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<std::io::Result<usize>> {
        match Pin::new(&mut self.stream).poll_write(context, bytes) {
            Poll::Pending => self.wait(context).map(Err),
            written => {
                self.stalled = None;
                written
            }
        }
    }

    fn poll_flush(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<std::io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(context)
    }

    fn poll_shutdown(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<std::io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(context)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use hyper::header::HeaderValue;

    #[test]
    fn forwarded_headers_count_only_from_a_proxy_that_is_named() {
        let address = |text: &str| text.parse::<IpAddr>().unwrap();
        let named = [address("127.0.0.1"), address("::1")];
        let of = |peer: &str, lines: &[&'static str]| {
            let mut headers = HeaderMap::new();
            for line in lines {
                headers.append(FORWARDED, HeaderValue::from_static(line));
            }
            client_of(address(peer), &named, &headers).0.to_string()
        };
        for (peer, lines, expected) in [
            ("127.0.0.1", &["10.0.0.7"][..], "10.0.0.7"),
            ("127.0.0.1", &["1.2.3.4, 10.0.0.7"][..], "10.0.0.7"),
            (
                "127.0.0.1",
                &["1.2.3.4", "5.6.7.8, 10.0.0.7"][..],
                "10.0.0.7",
            ),
            ("::1", &["2001:db8:1:2:3::4"][..], "2001:db8:1:2::"),
            ("::1", &["::ffff:10.0.0.7"][..], "10.0.0.7"),
            ("127.0.0.1", &[][..], "127.0.0.1"),
            ("127.0.0.1", &["10.0.0.7, unknown"][..], "127.0.0.1"),
            ("127.0.0.1", &["rig.example"][..], "127.0.0.1"),
            ("10.0.0.9", &["10.0.0.7"][..], "10.0.0.9"),
            ("2001:db8::5", &["10.0.0.7"][..], "2001:db8::"),
        ] {
            assert_eq!(of(peer, lines), expected, "{peer} {lines:?}");
        }
    }

    #[test]
    fn a_connection_whose_other_side_acknowledges_nothing_is_given_up() {
        let runtime = tokio::runtime::Builder::new_current_thread();
        let runtime = { runtime }.enable_all().build().unwrap();
        runtime.block_on(async {
            let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
            let address = listener.local_addr().unwrap();
            let _client = TcpStream::connect(address).await.unwrap();
            let (stream, _) = listener.accept().await.unwrap();
            let guard = StallGuard::new(stream);
            let limit = sockopt::tcp_user_timeout(&guard.stream);
            assert_eq!(limit.unwrap(), UNACKNOWLEDGED_MS);
        });
    }
}
