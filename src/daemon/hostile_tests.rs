//! Tests the socket with clients that flood it with requests, send nonsense, stop in the middle of a line, or do not
//! read.

use super::scripted::Behaviour;
use super::service_tests::{
    Dice, PATIENCE, be_a_daemon, daemon, inside, replies, service, trigger, until,
};
use crate::trigger::{Client, Event, LONGEST_REQUEST, Reply, Request, Until};
use std::io::{BufRead, Read, Write};
use std::net::Shutdown;
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

const STATUS: &[u8] = b"{\"type\":\"status\"}\n";
const TRIGGER: &[u8] = b"{\"type\":\"trigger\",\"press_id\":\"storm\"}\n";

/// All that comes until the connection ends.
fn heard(mut stream: impl Read) -> String {
    let mut bytes = Vec::new();
    let _ = stream.read_to_end(&mut bytes);
    String::from_utf8(bytes).unwrap()
}

#[test]
fn nonsense_is_answered_and_ends_one_connection_alone() {
    let service = service(|_| ());
    let deep = "[".repeat(4000);
    let long = format!("{{\"type\":\"{}\"}}", "x".repeat(LONGEST_REQUEST));
    let nonsense = [
        "",
        " ",
        "\0",
        "null",
        "1e999",
        "{}",
        "[]",
        "\"status\"",
        "{\"type\":\"status\"",
        &deep,
        &long,
        "{\"type\":\"stop\"}",
        "{\"type\":\"status\",\"more\":1}",
        "{\"type\":\"trigger\",\"press_id\":7}",
        "{\"type\":\"trigger\",\"until\":\"later\"}",
        "{\"type\":\"status\"}{\"type\":\"status\"}",
        "GET / HTTP/1.1\r",
    ];
    for line in nonsense {
        let mut stream = service.raw();
        let _ = stream.get_mut().write_all(format!("{line}\n").as_bytes());
        let answer = heard(stream);
        let reply: Reply =
            serde_json::from_str(&answer).unwrap_or_else(|_| panic!("{line}: {answer}"));
        assert!(matches!(reply, Reply::Refused { .. }), "{line}: {answer}");
    }
    // Sense without a meaning is refused, and the connection stays.
    let mut client = service.client();
    for request in [
        trigger(Some("a\u{7}"), Until::Durable),
        Request::Note {
            capture: "../a".into(),
            kind: "accept".into(),
            text: String::new(),
            author: None,
        },
        Request::Note {
            capture: "a".into(),
            kind: "maybe".into(),
            text: String::new(),
            author: None,
        },
        Request::Begin {
            name: "a/b".into(),
            about: Default::default(),
        },
        Request::Close {},
    ] {
        let answer = replies(&mut client, &request);
        let closed = request == Request::Close {};
        assert_eq!(
            matches!(answer[..], [Reply::Refused { .. }]),
            !closed,
            "{request:?}: {answer:?}"
        );
    }
    let mut dice = Dice(5);
    for _ in 0..200 {
        let mut stream = service.raw();
        let bytes: Vec<u8> = (0..dice.below(300))
            .map(|_| dice.below(256) as u8)
            .collect();
        let _ = stream.get_mut().write_all(&bytes);
        let _ = stream.get_mut().shutdown(Shutdown::Write);
        let answer = heard(stream);
        assert!(answer.is_empty() || answer.contains("refused"), "{answer}");
    }
    let last = service.press_until_taken(None);
    assert!(
        matches!(last.last(), Some(Reply::Durable { .. })),
        "{last:?}"
    );
}

#[test]
fn a_client_that_stops_in_the_middle_is_left_after_its_time() {
    // In real time, for it is the runtime's timer that is tested, over real connections. A busy machine only makes the
    // client wait for longer.
    let service = service(|_| ());
    let begin = Instant::now();
    let mut half = service.raw();
    half.get_mut().write_all(b"{\"type\":\"sta").unwrap();
    // A byte now and then is no line either.
    let mut drop_by_drop = service.raw();
    std::thread::scope(|scope| {
        scope.spawn(|| {
            for byte in STATUS.iter().cycle() {
                std::thread::sleep(Duration::from_millis(200));
                if drop_by_drop.get_mut().write_all(&[*byte]).is_err() {
                    return;
                }
            }
        });
        assert_eq!(heard(half), "");
        assert!(begin.elapsed() >= Duration::from_millis(1900));
        let mut whole = service.raw();
        whole.get_mut().write_all(STATUS).unwrap();
        whole.get_mut().shutdown(Shutdown::Write).unwrap();
        // One that has said all that it had to say hears its answer.
        assert!(heard(whole).contains("\"cameras\""));
    });
}

#[test]
fn one_who_does_not_listen_keeps_nobody_waiting_and_is_left() {
    let service = service(|_| ());
    let mut deaf = service.raw();
    let stream = deaf.get_mut();
    stream.set_write_timeout(Some(PATIENCE)).unwrap();
    std::thread::scope(|scope| {
        let deaf = scope.spawn(move || {
            // Its replies fill the connection, then its requests do, then it is left.
            while stream.write_all(STATUS).is_ok() {}
        });
        let heard = service.press_until_taken(None);
        assert!(
            matches!(heard.last(), Some(Reply::Durable { .. })),
            "{heard:?}"
        );
        deaf.join().unwrap();
    });
}

#[test]
fn a_slow_listener_loses_whole_events_and_is_told_how_many() {
    let service = service(|_| ());
    let events = service.stand.capturing.events().clone();
    let mut slow = service.raw();
    slow.get_mut()
        .write_all(b"{\"type\":\"events\"}\n")
        .unwrap();
    let mut line = String::new();
    slow.read_line(&mut line).unwrap();
    assert!(line.contains("listening"), "{line}");
    // If publishing waited for a listener that does not read, this would not end.
    let count = 5000;
    for number in 0..count {
        let reason = format!("{number} {}", "x".repeat(500));
        events.publish(Event::Refused { reason });
    }
    let (mut heard, mut lost) = (0, 0);
    while heard + lost < count {
        line.clear();
        slow.read_line(&mut line).unwrap();
        match serde_json::from_str(&line).unwrap() {
            Event::Refused { reason } => {
                assert!(
                    reason.starts_with(&format!("{} ", heard + lost)),
                    "{reason:.20}"
                );
                heard += 1;
            }
            Event::Lost { events } => lost += events,
            other => panic!("{other:?}"),
        }
    }
    assert!(lost > 0 && heard >= 1024, "{heard} heard, {lost} lost");
}

#[test]
fn a_press_is_told_to_all_who_listen() {
    let service = service(|_| ());
    let mut listener = service.client();
    listener.send(&Request::Events {}).unwrap();
    assert_eq!(listener.reply().unwrap(), Reply::Listening);
    service.press_until_taken(Some("p-9"));
    let mut types = Vec::new();
    while types.last() != Some(&"durable") {
        types.push(match listener.event().unwrap() {
            Event::Accepted { press_id, .. } => {
                assert_eq!(press_id.as_deref(), Some("p-9"));
                "accepted"
            }
            Event::Captured { .. } => "captured",
            Event::Durable { .. } => "durable",
            Event::Session { .. } => "session",
            other => panic!("{other:?}"),
        });
    }
    assert_eq!(types, ["session", "accepted", "captured", "durable"]);
}

#[test]
fn a_user_of_too_many_clients_is_told_that_there_is_no_room() {
    let service = service(|plan| plan.models = Some(plan.recording.folder.join("models")));
    let request = Request::Status {};
    // The permits of clients that have just disconnected are free a moment later.
    let served = || {
        let mut client = service.client();
        client.send(&request).ok()?;
        matches!(client.reply(), Ok(Reply::Status { .. })).then_some(client)
    };
    let mut clients: Vec<Client> = (0..24).map(|_| until(served)).collect();
    let answer = heard(service.raw());
    assert!(
        answer.contains("24 clients of user") && answer.contains("are connected"),
        "{answer}"
    );
    // One that waits for something and goes away makes room, whatever it waits for.
    let mut waiting = clients.pop().unwrap();
    waiting.send(&trigger(Some("p"), Until::Done)).unwrap();
    while !matches!(waiting.reply().unwrap(), Reply::Durable { .. }) {}
    drop(waiting);
    let mut next = until(served);
    replies(&mut next, &request);
    drop(clients);
}

/// Bytes of memory that a process has.
fn memory(process: u32) -> u64 {
    let statm = std::fs::read_to_string(format!("/proc/{process}/statm")).unwrap();
    statm.split(' ').nth(1).unwrap().parse::<u64>().unwrap() * 4096
}

/// Sends as much as it can, in whole lines, over connections that it opens again when they are closed.
fn storm(socket: &Path, line: &[u8], over: &AtomicBool, sent: &AtomicU64) {
    let batch = line.repeat(64);
    while !over.load(Ordering::Relaxed) {
        let Ok(mut stream) = UnixStream::connect(socket) else {
            continue;
        };
        let _ = stream.set_write_timeout(Some(Duration::from_millis(50)));
        let _ = stream.set_nonblocking(false);
        let mut listener = stream.try_clone().unwrap();
        let _ = listener.set_read_timeout(Some(Duration::from_millis(50)));
        std::thread::scope(|scope| {
            scope.spawn(move || {
                let mut sink = vec![0; 1 << 16];
                while listener.read(&mut sink).is_ok_and(|n| n > 0) {}
            });
            while !over.load(Ordering::Relaxed) {
                // Counted as offered whether there is room for it or not.
                sent.fetch_add(64, Ordering::Relaxed);
                if stream.write_all(&batch).is_err() {
                    break;
                }
            }
            let _ = stream.shutdown(Shutdown::Both);
        });
    }
}

#[test]
fn a_storm_harms_neither_the_capture_nor_the_memory_nor_the_log() {
    if let Some(folder) = inside() {
        be_a_daemon(&folder, Behaviour::VerySlow);
    }
    let name =
        "daemon::hostile_tests::a_storm_harms_neither_the_capture_nor_the_memory_nor_the_log";
    let folder = tempfile::tempdir().unwrap();
    let (mut daemon, socket) = daemon(name, folder.path());
    let mut client = Client::connect(&socket, Some(PATIENCE)).unwrap();
    client
        .send(&trigger(Some("storm"), Until::Durable))
        .unwrap();
    assert!(matches!(client.reply().unwrap(), Reply::Accepted { .. }));
    let before = memory(daemon.id());
    let (over, sent) = (AtomicBool::new(false), AtomicU64::new(0));
    let begin = Instant::now();
    let (took, end) = std::thread::scope(|scope| {
        for line in [STATUS, TRIGGER, b"nonsense\n", STATUS, TRIGGER, b"{\n"] {
            let (socket, over, sent) = (&socket, &over, &sent);
            scope.spawn(move || storm(socket, line, over, sent));
        }
        let end = loop {
            let reply = client.reply().unwrap();
            if reply.is_end(Until::Durable) {
                break reply;
            }
        };
        let took = begin.elapsed();
        for _ in 0..25 {
            // Somebody with one request is served meanwhile, as often as it asks.
            let mut client = Client::connect(&socket, Some(PATIENCE)).unwrap();
            let status = client
                .send(&Request::Status {})
                .and_then(|()| client.reply());
            assert!(matches!(status, Ok(Reply::Status { .. })), "{status:?}");
        }
        over.store(true, Ordering::Relaxed);
        (took, end)
    });
    let rate = sent.load(Ordering::Relaxed) as f64 / begin.elapsed().as_secs_f64();
    let after = memory(daemon.id());
    let log = std::fs::read_to_string(folder.path().join("log")).unwrap();
    println!(
        "shown: offered {rate:.0} requests a second; memory {before} to {after}; the capture's end after {took:?}; {} lines",
        log.lines().count()
    );
    let _ = daemon.kill();
    daemon.wait().unwrap();
    assert!(matches!(end, Reply::Durable { .. }), "{end:?}");
    assert!(after < before + 16_000_000, "{before} to {after}");
    assert!(log.lines().count() < 60, "{log}");
}
