//! The page for tests: listening on a port of its own, with sessions of both roles and a daemon that counts what it is
//! asked.

use super::http::router;
use super::parameters::Parameters;
use super::serve::{HEADERS, accept, app};
use super::sessions::Role;
use super::tls::{Tls, TlsParameters};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::os::unix::net::UnixListener;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, mpsc};
use std::time::Duration;

const STATUS: &str = r#"{"type":"status","status":{"cameras":{"c00":{"kind":"color","state":"ready","words":"x","lost_frames":0}},"session":null,"captures_left":5,"capture_bytes":10,"plates_age_h":0.5,"models":null}}"#;

/// A daemon that answers as one does.
#[derive(Clone, Default)]
pub(super) struct Counted {
    pub(super) presses: Arc<AtomicUsize>,
    pub(super) others: Arc<AtomicUsize>,
    /// Presses in progress, and the most that there were at a time.
    pub(super) pressing: Arc<AtomicUsize>,
    pub(super) most: Arc<AtomicUsize>,
    /// Connections that look at the cameras now, and the most that there were at a time.
    pub(super) looking: Arc<AtomicUsize>,
    pub(super) most_looking: Arc<AtomicUsize>,
}

impl Counted {
    fn serve(&self, path: &Path) {
        let listener = UnixListener::bind(path).unwrap();
        let counted = self.clone();
        std::thread::spawn(move || {
            for stream in listener.incoming() {
                let (counted, stream) = (counted.clone(), stream.unwrap());
                std::thread::spawn(move || counted.serve_one(stream));
            }
        });
    }

    fn serve_one(&self, stream: std::os::unix::net::UnixStream) {
        let mut write = stream.try_clone().unwrap();
        for line in BufReader::new(stream).lines().map_while(Result::ok) {
            let reply = if line.contains("\"status\"") {
                STATUS.to_owned()
            } else if line.contains("\"events\"") {
                r#"{"type":"listening"}"#.into()
            } else if line.contains("\"look\"") {
                return self.show_pictures(write);
            } else if line.contains("\"trigger\"") {
                self.presses.fetch_add(1, Ordering::SeqCst);
                let pressing = self.pressing.fetch_add(1, Ordering::SeqCst) + 1;
                self.most.fetch_max(pressing, Ordering::SeqCst);
                std::thread::sleep(Duration::from_millis(100));
                self.pressing.fetch_sub(1, Ordering::SeqCst);
                let accepted = r#"{"type":"accepted","capture":"a-0001"}"#;
                let durable =
                    r#"{"type":"durable","capture":"a-0001","recording":"/secret/a.mcap"}"#;
                format!("{accepted}\n{durable}")
            } else {
                self.others.fetch_add(1, Ordering::SeqCst);
                r#"{"type":"ok","words":"done"}"#.into()
            };
            if writeln!(write, "{reply}").is_err() {
                break;
            }
        }
    }

    /// Shows pictures until nobody reads them.
    fn show_pictures(&self, mut write: std::os::unix::net::UnixStream) {
        let looking = self.looking.fetch_add(1, Ordering::SeqCst) + 1;
        self.most_looking.fetch_max(looking, Ordering::SeqCst);
        let picture = r#"{"type":"looked","camera":"c00","age_ms":7,"picture":"AAAA","seen":{"width":1,"height":1,"scale":1}}"#;
        let away = r#"{"type":"looked","camera":"c01","age_ms":0,"words":"<b>away</b>"}"#;
        let mut lines = vec![r#"{"type":"looking"}"#, away];
        while lines
            .drain(..)
            .all(|line| writeln!(write, "{line}").is_ok())
        {
            lines.push(picture);
            std::thread::sleep(Duration::from_millis(20));
        }
        self.looking.fetch_sub(1, Ordering::SeqCst);
    }

    pub(super) fn asked(&self) -> usize {
        self.presses.load(Ordering::SeqCst) + self.others.load(Ordering::SeqCst)
    }
}

/// The page, listening on a port of its own, and sessions of both roles.
pub(super) struct Page {
    pub(super) address: SocketAddr,
    pub(super) host: String,
    pub(super) daemon: Counted,
    pub(super) app: Arc<super::http::App>,
    pub(super) root: tempfile::TempDir,
}

pub(super) struct Answer {
    pub(super) status: u16,
    pub(super) head: String,
    pub(super) body: String,
}

impl Page {
    pub(super) fn start() -> Self {
        Self::start_with(None, HEADERS)
    }

    /// With TLS, if its files are given; a connection may take so long for its headers.
    pub(super) fn start_with(tls: Option<TlsParameters>, patience: Duration) -> Self {
        Self::start_behind(&[], tls, patience)
    }

    /// Behind these proxies.
    pub(super) fn start_behind(
        proxy: &[&str],
        tls: Option<TlsParameters>,
        patience: Duration,
    ) -> Self {
        let root = tempfile::tempdir().unwrap();
        let daemon = Counted::default();
        daemon.serve(&root.path().join("scand.sock"));
        let folder = root.path().join("models/a/a-0001");
        std::fs::create_dir_all(&folder).unwrap();
        std::fs::write(folder.join("model.glb"), vec![7; 300_000]).unwrap();
        std::fs::write(root.path().join("secret.txt"), "the secret").unwrap();
        let free = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = free.local_addr().unwrap();
        drop(free);
        let parameters = Parameters {
            listen: address,
            proxy: proxy.iter().map(|&name| name.into()).collect(),
            socket: root.path().join("scand.sock"),
            models: root.path().join("models"),
            recordings: root.path().join("recordings"),
            state: root.path().join("state"),
            cache: root.path().join("cache"),
            origins: match &tls {
                Some(_) => vec![format!("https://localhost:{}", address.port())],
                None => Vec::new(),
            },
            ..Parameters::default()
        };
        std::fs::create_dir_all(&parameters.state).unwrap();
        let tls = tls.map(|tls| Tls::open(&tls).unwrap());
        let app = app(&parameters).unwrap();
        let served = app.clone();
        let proxies = parameters.proxies().unwrap();
        let (ready, is_ready) = mpsc::sync_channel(1);
        std::thread::spawn(move || {
            let runtime = tokio::runtime::Builder::new_current_thread();
            let runtime = { runtime }.enable_all().build().unwrap();
            runtime.block_on(async {
                let listener = tokio::net::TcpListener::bind(address).await.unwrap();
                ready.send(()).unwrap();
                tokio::select! {
                    () = served.watch.keep_events(&served.daemon) => {}
                    () = served.watch.keep_status(&served.daemon) => {}
                    () = served.look.keep(&served.daemon, &served.models) => {}
                    () = accept(listener, tls, router(served.clone()), proxies, patience) => {}
                }
            });
        });
        is_ready.recv().unwrap();
        Self {
            host: address.to_string(),
            address,
            daemon,
            app,
            root,
        }
    }

    pub(super) fn session(&self, role: Role) -> String {
        let token = self.app.sessions.pair(role).unwrap();
        let client = self.address.ip();
        self.app.sessions.begin(&token, client).unwrap().0
    }

    pub(super) fn connect(&self) -> TcpStream {
        let stream = TcpStream::connect(self.address).unwrap();
        stream
            .set_read_timeout(Some(Duration::from_secs(30)))
            .unwrap();
        stream
    }

    /// Sends bytes as they are, and reads the one answer.
    pub(super) fn raw(&self, bytes: &[u8]) -> Answer {
        let mut stream = self.connect();
        // A server that has refused reads no more.
        let _ = stream.write_all(bytes);
        let mut found = Vec::new();
        let _ = stream.read_to_end(&mut found);
        let text = String::from_utf8_lossy(&found).into_owned();
        let (head, body) = text.split_once("\r\n\r\n").unwrap_or((&text, ""));
        let status = head.get(9..12).and_then(|code| code.parse().ok());
        Answer {
            status: status.unwrap_or(0),
            head: head.to_ascii_lowercase(),
            body: body.into(),
        }
    }

    pub(super) fn get(&self, path: &str, headers: &str) -> Answer {
        let host = &self.host;
        let text =
            format!("GET {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n{headers}\r\n");
        self.raw(text.as_bytes())
    }

    pub(super) fn post(&self, path: &str, headers: &str, body: &str) -> Answer {
        let (host, length) = (&self.host, body.len());
        let text = format!(
            "POST {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\nContent-Length: {length}\r\n{headers}\r\n{body}"
        );
        self.raw(text.as_bytes())
    }

    /// The headers with which the page itself asks.
    pub(super) fn own(&self, secret: &str) -> String {
        let (host, token) = (&self.host, super::secrets::request_token(secret));
        format!(
            "Origin: http://{host}\r\nContent-Type: application/json\r\nCookie: scand={secret}\r\nX-Scand-Token: {token}\r\n"
        )
    }
}
