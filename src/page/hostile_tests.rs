//! Requests that mean no good, over real connections to the page, with a daemon that counts what it is asked.

use super::serve::HEADERS;
use super::sessions::Role;
use super::testing::Page;
use crate::support::dice::Dice;
use crate::support::torture::times;
use crate::support::wait::until;
use std::io::{BufRead, BufReader, ErrorKind, Read, Write};
use std::net::TcpStream;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

const PRESS: &str = r#"{"press_id":"page-0001","subject":"1884.3"}"#;

#[test]
fn a_press_of_an_operator_is_one_and_tells_no_path() {
    let page = Page::start();
    let operator = page.session(Role::Operator);
    let answer = page.post("/api/press", &page.own(&operator), PRESS);
    assert_eq!(answer.status, 200, "{}", answer.body);
    let told: serde_json::Value = serde_json::from_str(&answer.body).unwrap();
    let expected = serde_json::json!({ "type": "durable", "capture": "a-0001" });
    assert_eq!(told, expected, "no path of the recording");
    assert_eq!(page.daemon.presses.load(Ordering::SeqCst), 1);
}

#[test]
fn a_press_by_the_clock_of_an_earlier_process_begins_nothing() {
    let page = Page::start();
    let own = page.own(&page.session(Role::Operator));
    let press = |pressed_ms: u64| {
        let body = format!(r#"{{"press_id":"page-0001","pressed_ms":{pressed_ms}}}"#);
        page.post("/api/press", &own, &body)
    };
    let late = press(page.app.clock_ms() + 60_000);
    assert_eq!(late.status, 409);
    assert!(late.body.contains(r#""code":"late""#), "{}", late.body);
    assert_eq!(page.daemon.asked(), 0);
    assert_eq!(press(page.app.clock_ms()).status, 200);
    assert_eq!(page.daemon.presses.load(Ordering::SeqCst), 1);
}

#[test]
fn nobody_else_presses() {
    let page = Page::start();
    let operator = page.session(Role::Operator);
    let viewer = page.session(Role::Viewer);
    let bearer = page.app.sessions.metrics().unwrap();
    let (own, host) = (page.own(&operator), page.host.clone());
    let without = |name: &str| -> String {
        let kept = own.lines().filter(|line| !line.starts_with(name));
        kept.map(|line| format!("{line}\r\n")).collect()
    };
    let with = |name: &str, value: &str| format!("{}{name}: {value}\r\n", without(name));
    let cases = [
        ("no header at all", String::new(), 401),
        ("no cookie", without("Cookie"), 401),
        (
            "a guessed session",
            with("Cookie", &format!("scand={}", "0".repeat(64))),
            401,
        ),
        (
            "the token of /metrics",
            with("Cookie", &format!("scand={bearer}")),
            401,
        ),
        ("a viewer", page.own(&viewer), 403),
        ("no token", without("X-Scand-Token"), 403),
        (
            "another session's token",
            {
                let token = super::secrets::request_token(&viewer);
                with("X-Scand-Token", &token)
            },
            403,
        ),
        ("no origin", without("Origin"), 403),
        ("another site", with("Origin", "https://evil.example"), 403),
        ("null", with("Origin", "null"), 403),
        ("another port", with("Origin", "http://127.0.0.1:1"), 403),
        (
            "a longer name",
            with("Origin", &format!("http://{host}.evil.example")),
            403,
        ),
        (
            "the other scheme",
            with("Origin", &format!("https://{host}")),
            403,
        ),
        (
            "two origins",
            format!("{own}Origin: https://evil.example\r\n"),
            403,
        ),
        (
            "a form",
            with("Content-Type", "application/x-www-form-urlencoded"),
            415,
        ),
        ("text", with("Content-Type", "text/plain"), 415),
    ];
    for path in [
        "/api/press",
        "/api/plates",
        "/api/session",
        "/api/note",
        "/api/remake",
    ] {
        for (what, headers, expected) in &cases {
            let answer = page.post(path, headers, PRESS);
            assert_eq!(answer.status, *expected, "{path}, {what}: {}", answer.body);
        }
        let get = page.get(path, &own);
        assert_eq!(get.status, 405, "{path}");
    }
    let begun = page.session(Role::Operator);
    page.app.sessions.leave(&begun).unwrap();
    assert_eq!(
        page.post("/api/press", &page.own(&begun), PRESS).status,
        401
    );
    page.app.sessions.expire_all();
    assert_eq!(page.post("/api/press", &own, PRESS).status, 401);
    assert_eq!(page.daemon.asked(), 0);
}

#[test]
fn bodies_that_make_no_sense_are_refused() {
    let page = Page::start();
    let own = page.own(&page.session(Role::Operator));
    let long = format!(r#"{{"press_id":"{}"}}"#, "a".repeat(65));
    let subject = format!(
        r#"{{"press_id":"page-0001","subject":"{}"}}"#,
        "é".repeat(101)
    );
    let deep = "[".repeat(8000);
    for body in [
        "",
        "{",
        "null",
        "[]",
        "{}",
        "\u{0}",
        &long,
        &subject,
        &deep,
        r#"{"press_id":"a"}"#,
        r#"{"press_id":"page 0001"}"#,
        r#"{"press_id":"../../etc"}"#,
        r#"{"press_id":7}"#,
        r#"{"press_id":"page-0001","until":"done"}"#,
        r#"{"press_id":"page-0001","pressed_ms":-1}"#,
        r#"{"press_id":"page-0001","pressed_ms":0.5}"#,
        r#"{"press_id":"page-0001","source":"pedal"}"#,
        r#"{"press_id":"page-0001","subject":"a\nb"}"#,
        r#"{"press_id":"page-0001","subject":"a\u0000b"}"#,
        r#"{"press_id":"page-0001"}{"press_id":"page-0002"}"#,
    ] {
        let answer = page.post("/api/press", &own, body);
        assert_eq!(answer.status, 400, "{body:.80}: {}", answer.body);
    }
    for body in [
        r#"{"capture":"../../etc","kind":"text","text":"x"}"#,
        r#"{"capture":"a-0001","kind":"delete"}"#,
        r#"{"capture":"a-0001","kind":"text","text":"a\nb"}"#,
        r#"{"capture":"a-0001","kind":"text","path":"/etc/passwd"}"#,
    ] {
        assert_eq!(page.post("/api/note", &own, body).status, 400, "{body}");
    }
    for body in [
        r#"{"capture":"../../etc","settings":{"hull.resolution":100}}"#,
        r#"{"capture":"a-0001","settings":{"hull.resolution":[100]}}"#,
        r#"{"capture":"a-0001","settings":{"hull.resolution":{"a":1}}}"#,
        r#"{"capture":"a-0001","settings":{},"out":"/tmp"}"#,
        r#"{"capture":"a-0001"}"#,
    ] {
        assert_eq!(page.post("/api/remake", &own, body).status, 400, "{body}");
    }
    let about = r#"{"name":"a","about":{"rig":"another"}}"#;
    assert_eq!(page.post("/api/session", &own, about).status, 400);
    let large = format!("{{\"press_id\":\"{}\"}}", "a".repeat(10_000));
    assert_eq!(page.post("/api/press", &own, &large).status, 413);
    assert_eq!(page.daemon.asked(), 0);
}

#[test]
fn a_foreign_name_reaches_nothing() {
    let page = Page::start();
    let cookie = format!("Cookie: scand={}\r\n", page.session(Role::Operator));
    let port = page.address.port();
    let hosts = [
        "evil.example".to_owned(),
        format!("evil.example:{port}"),
        format!("{}.evil.example", page.host),
        format!("127.0.0.2:{port}"),
        "127.0.0.1".to_owned(),
        String::new(),
    ];
    for host in &hosts {
        for path in ["/", "/api/me", "/healthz", "/api/models/a/a-0001/model.glb"] {
            let text =
                format!("GET {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n{cookie}\r\n");
            let answer = page.raw(text.as_bytes());
            assert!(
                [421, 400].contains(&answer.status),
                "{host} {path}: {}",
                answer.status
            );
        }
    }
    for text in [
        "GET /api/me HTTP/1.1\r\nConnection: close\r\n".to_owned(),
        format!(
            "GET /api/me HTTP/1.1\r\nHost: {}\r\nHost: evil.example\r\nConnection: close\r\n",
            page.host
        ),
        format!(
            "GET http://evil.example/api/me HTTP/1.1\r\nHost: {}\r\nConnection: close\r\n",
            page.host
        ),
    ] {
        let answer = page.raw(format!("{text}{cookie}\r\n").as_bytes());
        assert!(
            [421, 400].contains(&answer.status),
            "{text}: {}",
            answer.status
        );
    }
    let localhost = format!(
        "GET /api/me HTTP/1.1\r\nHost: LOCALHOST:{port}\r\nConnection: close\r\n{cookie}\r\n"
    );
    assert_eq!(page.raw(localhost.as_bytes()).status, 200);
}

#[test]
fn no_path_leads_out_and_nothing_is_told_without_a_session() {
    let page = Page::start();
    let cookie = format!("Cookie: scand={}\r\n", page.session(Role::Viewer));
    let link = page.root.path().join("models/a/a-0001/model.ply");
    std::os::unix::fs::symlink(page.root.path().join("secret.txt"), link).unwrap();
    for path in [
        "/api/models/a/a-0001/../../../secret.txt",
        "/api/models/../../secret.txt",
        "/api/models/%2e%2e/%2e%2e/secret.txt",
        "/api/models/a/%2e%2e/model.glb",
        "/api/models/a%2fa-0001/x/model.glb",
        "/api/models/a/a-0001%00/model.glb",
        "/api/models/a/a-0001/model.ply",
        "/api/models/a/a-0001/secret.txt",
        "/api/models/a/%2e%2e/view.glb",
        "/api/models/../../secret.txt/view.glb",
        "/api/models/a%2fa-0001/x/thumbnail.jpg",
        "/api/models/a/a-0002/thumbnail.jpg",
        "/api/models/a/a-0001/..%2f..%2f..%2fsecret.txt",
        "/api/models//a-0001/model.glb",
        "/api/models/a/a-0001/photographs/c00",
        "/api/models/..%2fsecret.txt/a-0001/photographs/c00",
        "/api/models/a/a-0001/photographs/..%2fsecret.txt",
        "/api/models/a/a-0001/difference/..%2f../secret.txt",
        "/api/models/a/a-0001/difference/a/..%2fsecret.txt",
        "/api/recordings/%2e%2e",
        "/api/recordings/..%2f..",
        "/assets/../../Cargo.toml",
        "/assets/%2e%2e/%2e%2e/Cargo.toml",
        "//etc/passwd",
        "/state/sessions.json",
        "/api",
        "/%ff%fe",
    ] {
        let answer = page.get(path, &cookie);
        assert!(
            [400, 404].contains(&answer.status),
            "{path}: {}",
            answer.status
        );
        assert!(!answer.body.contains("secret"), "{path}");
    }
    for path in [
        "/api/me",
        "/api/events",
        "/api/state",
        "/api/recordings",
        "/api/recordings/a",
        "/api/models/a/a-0001/model.glb",
        "/api/models/a/a-0001/view.glb",
        "/api/models/a/a-0001/thumbnail.jpg",
        "/api/models/a/a-0001/related",
        "/api/models/a/a-0001/photographs",
        "/api/models/a/a-0001/photographs/c00",
        "/api/models/a/a-0001/difference/a/a-0001",
    ] {
        assert_eq!(page.get(path, "").status, 401, "{path}");
        assert_eq!(page.get(path, "Cookie: scand=\r\n").status, 401, "{path}");
    }
    // Without a recording there are no photographs, which is no error; so with a link in its place.
    let recordings = page.root.path().join("recordings");
    std::fs::create_dir(&recordings).unwrap();
    let link = recordings.join("a.mcap");
    std::os::unix::fs::symlink(page.root.path().join("secret.txt"), link).unwrap();
    for recording in ["a", "..%2fa", "b"] {
        let path = format!("/api/models/{recording}/a-0001/photographs");
        let found = page.get(&path, &cookie);
        assert_eq!((found.status, found.body.trim()), (200, "[]"), "{path}");
    }
    // One that is no recording cannot give any, and what is no model has no surface.
    std::fs::write(recordings.join("c.mcap"), "no recording").unwrap();
    for path in [
        "/api/models/c/a-0001/photographs",
        "/api/models/c/a-0001/photographs/c00",
        "/api/models/a/a-0001/difference/a/a-0001",
    ] {
        let unmade = page.get(path, &cookie);
        assert_eq!(unmade.status, 503, "{path}");
        assert!(unmade.body.contains(r#""code":"unmade""#), "{path}");
    }
    let model = page.get("/api/models/a/a-0001/model.glb", &cookie);
    assert_eq!((model.status, model.body.len()), (200, 300_000));
    assert!(
        model
            .head
            .contains("content-security-policy: default-src 'none'; sandbox")
    );
    // Where no small form can be made, the file itself is sent.
    let view = page.get("/api/models/a/a-0001/view.glb", &cookie);
    assert_eq!((view.status, view.body.len()), (200, 300_000));
    let long = format!("/{}", "a".repeat(2000));
    assert_eq!(page.get(&long, "").status, 414);
    assert_eq!(page.daemon.asked(), 0);
}

#[test]
fn metrics_want_their_token_and_health_tells_no_names() {
    let page = Page::start();
    let operator = page.session(Role::Operator);
    let bearer = page.app.sessions.metrics().unwrap();
    for headers in [
        String::new(),
        format!("Authorization: Bearer {operator}\r\n"),
        format!("Authorization: Basic {bearer}\r\n"),
        format!("Cookie: scand={bearer}\r\n"),
    ] {
        assert_eq!(page.get("/metrics", &headers).status, 401, "{headers}");
    }
    let found = page.get("/metrics", &format!("Authorization: Bearer {bearer}\r\n"));
    assert_eq!(found.status, 200);
    assert!(found.body.contains("scand_presses_total"), "{}", found.body);
    until("not healthy", || page.get("/healthz", "").status == 200);
    assert_eq!(page.get("/healthz", "").body, "ok\n");
}

#[test]
fn every_answer_carries_the_headers() {
    let page = Page::start();
    for path in ["/", "/api/me", "/nothing", "/healthz", "/metrics"] {
        let head = page.get(path, "").head;
        for line in [
            "content-security-policy: default-src 'none'",
            "frame-ancestors 'none'",
            "x-content-type-options: nosniff",
            "x-frame-options: deny",
            "referrer-policy: no-referrer",
            "cache-control: no-store",
        ] {
            assert!(head.contains(line), "{path}: {line}: {head}");
        }
        assert!(!head.contains("unsafe-inline") && !head.contains("access-control-allow"));
    }
}

#[test]
fn a_link_sets_a_cookie_that_scripts_cannot_read_and_guesses_are_limited() {
    let page = Page::start();
    let headers = format!(
        "Origin: http://{}\r\nContent-Type: application/json\r\n",
        page.host
    );
    let token = page.app.sessions.pair(Role::Viewer).unwrap();
    let body = format!(r#"{{"token":"{token}"}}"#);
    let foreign = "Origin: https://evil.example\r\nContent-Type: application/json\r\n";
    assert_eq!(page.post("/api/pair", foreign, &body).status, 403);
    let begun = page.post("/api/pair", &headers, &body);
    assert_eq!(begun.status, 200);
    assert!(
        begun
            .head
            .contains("; path=/; httponly; samesite=strict; max-age="),
        "{}",
        begun.head
    );
    assert_eq!(page.post("/api/pair", &headers, &body).status, 403);
    for n in 0..19 {
        let guess = format!(r#"{{"token":"{n}"}}"#);
        assert_eq!(page.post("/api/pair", &headers, &guess).status, 403);
    }
    let token = page.app.sessions.pair(Role::Viewer).unwrap();
    let body = format!(r#"{{"token":"{token}"}}"#);
    assert_eq!(page.post("/api/pair", &headers, &body).status, 429);
}

#[test]
fn behind_a_proxy_that_is_named_each_client_is_counted_and_nobody_else_is_believed() {
    for (proxy, limited) in [(&["127.0.0.1"][..], 403), (&[][..], 429)] {
        let page = Page::start_behind(proxy, None, HEADERS);
        let guess = |client: usize| {
            let headers = format!(
                "Origin: http://{}\r\nContent-Type: application/json\r\nX-Forwarded-For: 10.0.0.{client}\r\n",
                page.host
            );
            page.post("/api/pair", &headers, r#"{"token":"0"}"#).status
        };
        for _ in 0..20 {
            assert_eq!(guess(1), 403);
        }
        assert_eq!(guess(1), 429);
        assert_eq!(guess(2), limited, "{proxy:?}");
    }
}

#[test]
fn one_address_does_not_take_every_connection() {
    let page = Page::start_with(None, Duration::from_secs(60));
    let held: Vec<_> = (0..300).map(|_| page.connect()).collect();
    let runtime = tokio::runtime::Builder::new_current_thread();
    let runtime = { runtime }.enable_all().build().unwrap();
    let mut other = runtime.block_on(async {
        let socket = tokio::net::TcpSocket::new_v4().unwrap();
        socket.bind("127.0.0.2:0".parse().unwrap()).unwrap();
        let other = socket.connect(page.address).await.unwrap();
        other.into_std().unwrap()
    });
    other.set_nonblocking(false).unwrap();
    let host = &page.host;
    let text = format!("GET /api/me HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n");
    other.write_all(text.as_bytes()).unwrap();
    let mut found = String::new();
    other.read_to_string(&mut found).unwrap();
    assert!(found.starts_with("HTTP/1.1 401"), "{found}");
    drop(held);
}

#[test]
fn slow_clients_are_broken_off_and_a_thousand_connections_keep_nobody_out_for_long() {
    let page = Page::start_with(None, Duration::from_millis(500));
    let mut halves: Vec<TcpStream> = Vec::new();
    for n in 0..1000 {
        let Ok(mut stream) = TcpStream::connect(page.address) else {
            continue;
        };
        if n % 2 == 0 {
            let _ = stream.write_all(b"GET / HTTP/1.1\r\nHost: ");
        }
        halves.push(stream);
    }
    // Those that were taken are broken off, and then there is room again.
    until("no room", || page.get("/api/me", "").status == 401);
    let slow = page.post(
        "/api/press",
        &page.own(&page.session(Role::Operator)),
        PRESS,
    );
    assert_eq!(slow.status, 200);
    // A body that never comes.
    let own = page.own(&page.session(Role::Operator));
    let host = &page.host;
    let text = format!(
        "POST /api/press HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\nContent-Length: 50\r\n{own}\r\n{{"
    );
    assert_eq!(page.raw(text.as_bytes()).status, 408);
    // One that says nothing at all, and one that says nothing more.
    for asked in ["", "GET /healthz HTTP/1.1\r\nHost: {host}\r\n\r\n"] {
        let mut idle = page.connect();
        let asked = asked.replace("{host}", host);
        idle.write_all(asked.as_bytes()).unwrap();
        let end = idle.read_to_end(&mut Vec::new());
        let is_late = end.is_err_and(|error| error.kind() == ErrorKind::WouldBlock);
        assert!(!is_late, "{asked}: nobody breaks it off");
    }
    assert_eq!(page.daemon.presses.load(Ordering::SeqCst), 1);
}

#[test]
fn however_many_look_and_press_the_daemon_has_eight_connections() {
    let page = Arc::new(Page::start());
    let operator = page.session(Role::Operator);
    let mut looking = Vec::new();
    for n in 0..12 {
        let mut stream = page.connect();
        let session = if n < 10 {
            operator.clone()
        } else {
            page.session(Role::Viewer)
        };
        let host = &page.host;
        let text =
            format!("GET /api/events HTTP/1.1\r\nHost: {host}\r\nCookie: scand={session}\r\n\r\n");
        stream.write_all(text.as_bytes()).unwrap();
        let mut first = String::new();
        BufReader::new(stream.try_clone().unwrap())
            .read_line(&mut first)
            .unwrap();
        // One session has at most eight streams.
        let expected = if (8..10).contains(&n) { "503" } else { "200" };
        assert!(first.contains(expected), "{n}: {first}");
        looking.push(stream);
    }
    let presses = (0..30).map(|n| {
        let (page, own) = (page.clone(), page.own(&operator));
        std::thread::spawn(move || {
            let body = format!(r#"{{"press_id":"page-{n:04}"}}"#);
            page.post("/api/press", &own, &body).status
        })
    });
    let presses: Vec<_> = presses.collect();
    for press in presses {
        assert!([200, 503].contains(&press.join().unwrap()));
    }
    // Three of the eight are the page's own.
    let most = page.daemon.most.load(Ordering::SeqCst);
    assert!((2..=5).contains(&most), "{most}");
    drop(looking);
}

/// Requests of a session that lacks its token, damaged at random: whatever they become, nothing is asked of the daemon.
#[test]
fn damaged_requests_ask_nothing_and_the_page_goes_on() {
    let page = Page::start();
    let operator = page.session(Role::Operator);
    let host = &page.host;
    let seeds = [
        format!(
            "GET /api/state HTTP/1.1\r\nHost: {host}\r\nCookie: scand={operator}\r\nConnection: close\r\n\r\n"
        ),
        format!(
            "POST /api/press HTTP/1.1\r\nHost: {host}\r\nOrigin: http://{host}\r\nContent-Type: application/json\r\n\
             Cookie: scand={operator}\r\nConnection: close\r\nContent-Length: {}\r\n\r\n{PRESS}",
            PRESS.len()
        ),
        format!(
            "GET /api/models/a/a-0001/model.glb HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n"
        ),
    ];
    let pieces = [
        "\r\n",
        "\0",
        "..",
        "%2e%2e/",
        "Host: evil\r\n",
        "Transfer-Encoding: chunked\r\n",
        "\u{ff}",
    ];
    let mut dice = Dice(7);
    for n in 0..times(100, 100) {
        let mut request = seeds[dice.index(seeds.len())].clone().into_bytes();
        for _ in 0..=dice.below(4) {
            if request.is_empty() {
                break;
            }
            let place = dice.index(request.len());
            match dice.below(4) {
                0 => request[place] = dice.below(256) as u8,
                1 => drop(request.remove(place)),
                2 => {
                    let piece = pieces[dice.index(pieces.len())].as_bytes();
                    request.splice(place..place, piece.iter().copied());
                }
                _ => request.truncate(place.max(1)),
            }
        }
        let mut stream = page.connect();
        let _ = stream.write_all(&request);
        // What is cut off does not wait for the rest.
        let _ = stream.shutdown(std::net::Shutdown::Write);
        let mut found = Vec::new();
        let _ = stream.take(400_000).read_to_end(&mut found);
        let text = String::from_utf8_lossy(&found);
        assert!(
            !text.starts_with("HTTP/1.1 500"),
            "{n}: {:?}",
            String::from_utf8_lossy(&request)
        );
        assert!(!text.contains("the secret"), "{n}");
    }
    assert_eq!(page.daemon.asked(), 0);
    assert_eq!(page.get("/healthz", "").status, 200);
}

#[test]
fn a_session_that_is_revoked_sees_no_more() {
    let page = Page::start();
    let viewer = page.session(Role::Viewer);
    let mut stream = page.connect();
    let host = &page.host;
    let text = format!(
        "GET /api/events HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\nCookie: scand={viewer}\r\n\r\n"
    );
    stream.write_all(text.as_bytes()).unwrap();
    let mut lines = BufReader::new(stream).lines();
    // With the clock by which a browser tells when somebody pressed.
    let is_event = |line: &str| line.starts_with("data: {") && line.contains(r#""clock_ms":"#);
    assert!(lines.any(|line| is_event(&line.unwrap())));
    page.app.sessions.revoke(None).unwrap();
    // The stream ends.
    assert!(lines.map_while(Result::ok).count() < 100);
}
