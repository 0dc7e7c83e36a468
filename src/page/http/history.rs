//! What was scanned: recordings, captures, the files of their models; and the state of the rig as the daemon tells it.

use super::files::takes_gzip;
use super::guard::visitor;
use super::reply::{Refusal, answer, json, typed};
use super::{App, HttpRequest};
use crate::page::models::{ModelFile, Models};
use crate::page::now::CaptureEntry;
use crate::page::secrets::Hash;
use crate::page::views::{Missing, NO_PHOTOGRAPHS, OpenView, View, Views};
use axum::body::{Body, Bytes};
use axum::extract::{Path, State};
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::Response;
use flate2::Compression;
use flate2::write::GzEncoder;
use serde_json::json;
use std::fs::File;
use std::io::{Read, Write};
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::sync::mpsc;

/// Bytes that are read at a time.
const PIECE: usize = 64 << 10;
/// Pieces that wait for a slow reader.
const PIECES: usize = 4;

/// How long a request for a small form waits for its turn.
const WAIT: Duration = Duration::from_secs(20);

/// How long models of an object are looked for.
const SEARCH: Duration = Duration::from_secs(3);

/// A file of a model is data: as a page of its own it may run and load nothing.
const POLICY: &str = "default-src 'none'; sandbox; frame-ancestors 'none'";

/// The daemon's last status, whole.
pub(super) async fn state(State(app): State<Arc<App>>, request: HttpRequest) -> Response {
    answer(visitor(&app, &request).map(|_| {
        let at = Instant::now();
        let told = app.watch.look(|now| {
            let told = now.status(at);
            told.map(|(status, age)| json!({ "status": status, "age_ms": age.as_millis() as u64 }))
        });
        json(&told.unwrap_or(json!({ "status": null, "age_ms": null })))
    }))
}

/// Recordings that have models, and captures that this page saw and that have none yet.
pub(super) async fn recordings(State(app): State<Arc<App>>, request: HttpRequest) -> Response {
    let allowed = visitor(&app, &request).map(drop);
    let listed = async {
        allowed?;
        let (models, watch) = (app.models.clone(), app.watch.clone());
        let listed = blocking(move || {
            let listing = models.recordings();
            let seen: Vec<_> = watch.look(|now| now.captures().rev().cloned().collect());
            (listing, without_report(&models, seen))
        });
        let (recordings, seen) = listed.await?;
        let at = Instant::now();
        let seen = seen.iter().map(|seen| {
            json!({ "capture": seen.capture, "recording": seen.recording, "subject": seen.subject,
                "sign": seen.sign, "reasons": seen.reasons,
                "age_ms": at.saturating_duration_since(seen.begun).as_millis() as u64 })
        });
        let seen: Vec<_> = seen.collect();
        Ok(json(
            &json!({ "recordings": recordings.newest, "all": recordings.all, "seen": seen }),
        ))
    };
    answer(listed.await)
}

/// Without the captures of which there is a report, whether the page heard of that or not.
fn without_report(models: &Models, mut seen: Vec<CaptureEntry>) -> Vec<CaptureEntry> {
    seen.retain(|seen| {
        let recording = seen.recording.as_deref();
        !recording.is_some_and(|recording| models.has_report(recording, &seen.capture))
    });
    seen
}

/// The captures of a recording.
pub(super) async fn captures(
    State(app): State<Arc<App>>,
    Path(recording): Path<String>,
    request: HttpRequest,
) -> Response {
    let allowed = visitor(&app, &request).map(drop);
    let listed = async {
        allowed?;
        let models = app.models.clone();
        let captures = blocking(move || models.captures(&recording)).await?;
        let captures = captures.ok_or_else(no_model)?;
        Ok(json(
            &json!({ "captures": captures.newest, "all": captures.all }),
        ))
    };
    answer(listed.await)
}

/// Models of the object that a capture shows, of other recordings.
pub(super) async fn related(
    State(app): State<Arc<App>>,
    Path((recording, capture)): Path<(String, String)>,
    request: HttpRequest,
) -> Response {
    let allowed = visitor(&app, &request).map(drop);
    let listed = async {
        allowed?;
        let models = app.models.clone();
        let found = move || models.of_same_object(&recording, &capture, SEARCH);
        let found = blocking(found).await?;
        Ok(json(
            &json!({ "captures": found.newest, "whole": found.is_whole }),
        ))
    };
    answer(listed.await)
}

/// A file of a model, or a small form of one.
pub(super) async fn file(
    State(app): State<Arc<App>>,
    Path((recording, capture, name)): Path<(String, String, String)>,
    request: HttpRequest,
) -> Response {
    let visitor = visitor(&app, &request);
    let (request, _) = request.into_parts();
    let sent = async {
        let visitor = visitor?;
        let asked = Asked {
            app: &app,
            secret: &visitor.secret,
            headers: &request.headers,
        };
        if let Some(view) = View::named(&name) {
            return small(&asked, &recording, &capture, view).await;
        }
        let kind = ModelFile::named(&name).ok_or_else(no_model)?;
        let as_name = format!("{capture}.{}", kind.name());
        let is_download = request.uri.query() == Some("download");
        let name = is_download.then_some(as_name.as_str());
        whole(&asked, recording, capture, kind, name).await
    };
    answer(sent.await)
}

/// How far the surface of a capture's model is from that of another model: a line of JSON, and a picture (JPEG) behind
/// it.
pub(super) async fn difference(
    State(app): State<Arc<App>>,
    Path((recording, capture, with, other)): Path<(String, String, String, String)>,
    request: HttpRequest,
) -> Response {
    let allowed = visitor(&app, &request).map(drop);
    let headers = request.headers().clone();
    let models = app.models.clone();
    let make = move |views: &Views| {
        let one = [recording.as_str(), capture.as_str()];
        views.difference(&models, [one, [with.as_str(), other.as_str()]])
    };
    let sent = async {
        allowed?;
        made(&app, &headers, "application/octet-stream", make).await
    };
    answer(sent.await)
}

/// The photographs of a capture, small: a line of JSON that has each camera, and the pictures (JPEG) behind it.
pub(super) async fn photographs(
    State(app): State<Arc<App>>,
    Path((recording, capture)): Path<(String, String)>,
    request: HttpRequest,
) -> Response {
    let allowed = visitor(&app, &request).map(drop);
    let headers = request.headers().clone();
    let make = move |views: &Views| views.photographs(&recording, &capture, None);
    let sent = async {
        allowed?;
        let media_type = "application/octet-stream";
        let sent = made(&app, &headers, media_type, make).await;
        // A recording that is not there any more is no error: then there are none.
        match sent {
            Err(refusal) if refusal.is_not_found() => {
                Ok(typed(media_type, Body::from(NO_PHOTOGRAPHS)))
            }
            sent => sent,
        }
    };
    answer(sent.await)
}

/// One camera's photograph of a capture.
pub(super) async fn photograph(
    State(app): State<Arc<App>>,
    Path((recording, capture, camera)): Path<(String, String, String)>,
    request: HttpRequest,
) -> Response {
    let allowed = visitor(&app, &request).map(drop);
    let headers = request.headers().clone();
    let make = move |views: &Views| views.photographs(&recording, &capture, Some(&camera));
    let sent = async {
        allowed?;
        made(&app, &headers, "image/jpeg", make).await
    };
    answer(sent.await)
}

/// Sends what is made once and then lies in the cache.
async fn made(
    app: &App,
    headers: &HeaderMap,
    media_type: &'static str,
    make: impl FnOnce(&Views) -> Result<OpenView, Missing> + Send + 'static,
) -> Result<Response, Refusal> {
    let slot = tokio::time::timeout(WAIT, app.small.clone().acquire_owned()).await;
    let slot = slot.map_err(|_| full())?.map_err(|_| full())?;
    let views = app.views.clone();
    let made = move || {
        let views = views.ok_or(Missing::Unmade)?;
        make(&views)
    };
    let (made, slot) = blocking_with(slot, made).await?;
    let (file, size, tag) = made.map_err(missing)?;
    let mut response = if is_known(headers, &tag) {
        unchanged()
    } else {
        send(file, size, media_type, Coding::None, slot)
    };
    mark(&mut response, &tag, None);
    Ok(response)
}

/// Who asks for a file, and how.
struct Asked<'a> {
    app: &'a App,
    secret: &'a str,
    headers: &'a HeaderMap,
}

/// A file as it is, compressed on its way if that helps.
async fn whole(
    asked: &Asked<'_>,
    recording: String,
    capture: String,
    kind: ModelFile,
    download: Option<&str>,
) -> Result<Response, Refusal> {
    let Asked {
        app,
        secret,
        headers,
    } = asked;
    let share = app.downloads.take(Hash::of(secret)).map_err(|_| full())?;
    let models = app.models.clone();
    let opened = blocking(move || models.open(&recording, &capture, kind)).await?;
    let (file, size, tag) = opened.ok_or_else(no_model)?;
    let mut response = if is_known(headers, &tag) {
        unchanged()
    } else {
        let gzip = kind.is_compressible() && takes_gzip(headers);
        let coding = if gzip { Coding::Gzip } else { Coding::None };
        send(file, size, kind.media_type(), coding, share)
    };
    mark(&mut response, &tag, download);
    Ok(response)
}

/// A small form of a file; where there is none, the file itself.
async fn small(
    asked: &Asked<'_>,
    recording: &str,
    capture: &str,
    view: View,
) -> Result<Response, Refusal> {
    let Asked { app, headers, .. } = asked;
    let slot = tokio::time::timeout(WAIT, app.small.clone().acquire_owned()).await;
    let slot = slot.map_err(|_| full())?.map_err(|_| full())?;
    let (models, views) = (app.models.clone(), app.views.clone());
    let (recording, capture) = (recording.to_owned(), capture.to_owned());
    let names = (recording.clone(), capture.clone());
    let is_gzip = view == View::Model;
    // Where gzip is not taken, the cache has nothing to give.
    let views = views.filter(|_| !is_gzip || takes_gzip(headers));
    let make = move || views?.get(&models, &names.0, &names.1, view).ok();
    let (made, slot) = blocking_with(slot, make).await?;
    let Some((file, size, tag)) = made else {
        drop(slot);
        return whole(asked, recording, capture, view.source(), None).await;
    };
    let mut response = if is_known(headers, &tag) {
        unchanged()
    } else {
        let coding = if is_gzip {
            Coding::IsGzip
        } else {
            Coding::None
        };
        send(file, size, view.media_type(), coding, slot)
    };
    mark(&mut response, &tag, None);
    Ok(response)
}

fn unchanged() -> Response {
    let mut response = Response::new(Body::empty());
    *response.status_mut() = StatusCode::NOT_MODIFIED;
    response
}

fn full() -> Refusal {
    let words = "too many files are being sent: try again";
    Refusal::new(StatusCode::SERVICE_UNAVAILABLE, "full", words)
}

fn no_model() -> Refusal {
    let words = "there is no such capture or file";
    Refusal::new(StatusCode::NOT_FOUND, "not_found", words)
}

fn missing(why: Missing) -> Refusal {
    match why {
        Missing::Source => no_model(),
        Missing::Unmade => {
            let words = "it could not be made: the page's log says why, unless its files have more than 64 MB";
            Refusal::new(StatusCode::SERVICE_UNAVAILABLE, "unmade", words)
        }
    }
}

fn is_known(headers: &HeaderMap, tag: &str) -> bool {
    let known = headers.get(header::IF_NONE_MATCH);
    known.is_some_and(|known| known.as_bytes() == tag.as_bytes())
}

/// Marks an answer with the file's tag, what it may do in a browser, and a name if it is to be stored.
fn mark(response: &mut Response, tag: &str, download: Option<&str>) {
    let mut headers = vec![
        (header::ETAG, tag.to_owned()),
        (header::CACHE_CONTROL, "private, no-cache".into()),
        (header::CONTENT_SECURITY_POLICY, POLICY.into()),
        (header::VARY, "Accept-Encoding".into()),
    ];
    let attached = download.map(|name| format!("attachment; filename=\"{name}\""));
    headers.extend(attached.map(|value| (header::CONTENT_DISPOSITION, value)));
    for (name, value) in headers {
        if let Ok(value) = HeaderValue::from_str(&value) {
            response.headers_mut().insert(name, value);
        }
    }
}

/// How a file goes over the wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Coding {
    /// As it is.
    None,
    /// Compressed on its way.
    Gzip,
    /// As it is, and it is compressed already.
    IsGzip,
}

/// Sends a file piece by piece; no more of it is in memory than a few pieces. `place` is held until it is sent.
fn send(
    file: File,
    size: u64,
    media_type: &'static str,
    coding: Coding,
    place: impl Send + 'static,
) -> Response {
    let (sender, receiver) = mpsc::channel(PIECES);
    let pieces = Pieces {
        sender,
        full: Vec::with_capacity(PIECE),
    };
    tokio::task::spawn_blocking(move || {
        // A client that went away needs no more.
        let _ = copy(file, size, pieces, coding == Coding::Gzip);
        drop(place);
    });
    let stream = futures_util::stream::unfold(receiver, |mut receiver| async {
        receiver.recv().await.map(|piece| (piece, receiver))
    });
    let mut response = typed(media_type, Body::from_stream(stream));
    let headers = response.headers_mut();
    if coding != Coding::None {
        let gzip = HeaderValue::from_static("gzip");
        headers.insert(header::CONTENT_ENCODING, gzip);
    }
    if coding != Coding::Gzip {
        headers.insert(header::CONTENT_LENGTH, size.into());
    }
    response
}

type Piece = Result<Bytes, std::io::Error>;

/// Writes into the channel that an answer reads from.
struct Pieces {
    sender: mpsc::Sender<Piece>,
    full: Vec<u8>,
}

impl Write for Pieces {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.full.extend_from_slice(bytes);
        if self.full.len() >= PIECE {
            self.flush()?;
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        if self.full.is_empty() {
            return Ok(());
        }
        let piece = Bytes::from(std::mem::take(&mut self.full));
        let sent = self.sender.blocking_send(Ok(piece));
        sent.map_err(|_| std::io::ErrorKind::BrokenPipe.into())
    }
}

fn copy(file: File, size: u64, mut pieces: Pieces, gzip: bool) -> std::io::Result<()> {
    let sender = pieces.sender.clone();
    let mut file = file.take(size);
    let copied = if gzip {
        // A higher level takes longer and makes models no smaller.
        let mut encoder = GzEncoder::new(&mut pieces, Compression::fast());
        std::io::copy(&mut file, &mut encoder).and_then(|_| encoder.finish().map(|_| ()))
    } else {
        std::io::copy(&mut file, &mut pieces).map(|_| ())
    };
    let copied = copied.and_then(|()| pieces.flush());
    if let Err(error) = &copied {
        let broken = std::io::Error::from(error.kind());
        // The answer ends as broken, not as if it were whole.
        let _ = sender.blocking_send(Err(broken));
    }
    copied
}

/// Runs what reads from the disk beside the threads that serve.
async fn blocking<T: Send + 'static>(
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, Refusal> {
    let done = tokio::task::spawn_blocking(work).await;
    done.map_err(|_| {
        let status = StatusCode::INTERNAL_SERVER_ERROR;
        Refusal::new(status, "internal", "the page failed to read the models")
    })
}

/// The same for what needs one of a few places. The work goes on when nobody waits for it any more, and has its place
/// until it is done; otherwise clients that leave and ask anew would take every thread.
async fn blocking_with<P: Send + 'static, T: Send + 'static>(
    place: P,
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<(T, P), Refusal> {
    blocking(move || (work(), place)).await
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::page::http::{DOWNLOADS, READERS, SMALL};
    use crate::page::parameters::Parameters;
    use crate::page::serve;
    use parking_lot::Mutex;

    fn runtime() -> tokio::runtime::Runtime {
        let mut builder = tokio::runtime::Builder::new_current_thread();
        let builder = builder.enable_all().max_blocking_threads(READERS);
        builder.build().unwrap()
    }

    #[test]
    fn requests_for_small_forms_that_were_abandoned_keep_no_list_waiting() {
        let root = tempfile::tempdir().unwrap();
        let at = |name: &str| root.path().join(name);
        let parameters = Parameters {
            models: at("models"),
            recordings: at("recordings"),
            state: at("state"),
            cache: at("cache"),
            ..Parameters::default()
        };
        std::fs::create_dir_all(&parameters.state).unwrap();
        let app = serve::app(&parameters).unwrap();
        assert!(app.views.is_some());
        let runtime = runtime();
        // No form is made until this is let go.
        let gate = Arc::new(Mutex::new(()));
        let held = gate.lock();
        runtime.block_on(async {
            for _ in 0..READERS + 8 {
                let gate = gate.clone();
                let make = move |_: &Views| {
                    drop(gate.lock());
                    Err(Missing::Source)
                };
                let headers = HeaderMap::new();
                let abandoned = made(&app, &headers, "image/jpeg", make);
                let _ = tokio::time::timeout(Duration::from_millis(20), abandoned).await;
            }
            let listed = tokio::time::timeout(Duration::from_secs(20), blocking(|| 7)).await;
            assert!(matches!(listed, Ok(Ok(7))));
        });
        drop(held);
    }

    #[test]
    fn clients_that_do_not_read_their_files_keep_no_list_waiting() {
        let file = tempfile::tempfile().unwrap();
        file.set_len(64 << 20).unwrap();
        runtime().block_on(async {
            let unread: Vec<_> = (0..DOWNLOADS + SMALL)
                .map(|_| {
                    let file = file.try_clone().unwrap();
                    send(file, 64 << 20, "model/gltf-binary", Coding::None, ())
                })
                .collect();
            // All of them have begun to read, and wait for their clients.
            tokio::time::sleep(Duration::from_millis(300)).await;
            let listed = tokio::time::timeout(Duration::from_secs(20), blocking(|| 7));
            assert!(matches!(listed.await, Ok(Ok(7))));
            drop(unread);
        });
    }
}
