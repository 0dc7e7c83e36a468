//! Tests notes on captures of sessions that are closed, as clients make them through the socket.

use super::service_tests::{Service, is_durable, replies, service};
use crate::recording::{Notes, Recording, Topic, beside};
use crate::trigger::{Reply, Request};
use crate::workers::Jobs;
use serde_json::{Value, json};
use sha2::{Digest, Sha256};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A capture whose session is closed, and whose model waits to be made.
struct ClosedSession {
    service: Service,
    capture: String,
    recording: PathBuf,
}

impl ClosedSession {
    fn new() -> Self {
        let service = service(|plan| {
            let jobs = Jobs::open(&plan.recording.folder);
            plan.jobs = Some(Arc::new(jobs.unwrap()));
        });
        let heard = service.press_until_taken(None);
        assert!(is_durable(&heard), "{heard:?}");
        let Some(Reply::Durable { capture, recording }) = heard.last().cloned() else {
            unreachable!()
        };
        let closed = Self {
            service,
            capture,
            recording,
        };
        closed.ask(&Request::Close {});
        assert!(closed.recording.exists(), "the recording is complete");
        closed.wait_for_jobs(1);
        closed
    }

    /// What the daemon says to a request that it carries out.
    fn ask(&self, request: &Request) -> String {
        match &replies(&mut self.service.client(), request)[..] {
            [Reply::Ok { words }] => words.clone(),
            other => panic!("{request:?}: {other:?}"),
        }
    }

    fn note(&self, kind: &str, text: &str) -> String {
        self.ask(&note_on(&self.capture, kind, text))
    }

    /// Waits until as many jobs are waiting, and compares with the files of jobs on the disk.
    fn wait_for_jobs(&self, expected: usize) {
        let stand = &self.service.stand;
        stand.until(|s| s.models.as_ref().is_some_and(|m| m.waiting == expected));
        let jobs = std::fs::read_dir(self.recording.with_file_name("jobs")).unwrap();
        let of_capture = format!("{}.job", self.capture);
        let names = jobs.map(|job| job.unwrap().file_name().into_string().unwrap());
        let waiting = names.filter(|name| name.ends_with(&of_capture)).count();
        assert_eq!(waiting, expected);
    }

    /// The lines of the file of notes.
    fn lines(&self) -> Vec<Value> {
        let text = std::fs::read_to_string(beside(&self.recording)).unwrap();
        let lines = text.lines().map(serde_json::from_str);
        lines.collect::<Result<_, _>>().unwrap()
    }
}

fn note_on(capture: &str, kind: &str, text: &str) -> Request {
    Request::Note {
        capture: capture.into(),
        kind: kind.into(),
        text: text.into(),
        author: Some("Ann".into()),
    }
}

fn digest(path: &Path) -> Vec<u8> {
    Sha256::digest(std::fs::read(path).unwrap()).to_vec()
}

#[test]
fn a_note_on_a_closed_session_lies_beside_its_recording_and_takes_effect() {
    let closed = ClosedSession::new();
    let before = digest(&closed.recording);
    let told = closed.note("reject", "a hand");
    let sidecar = beside(&closed.recording);
    assert!(told.contains(sidecar.to_str().unwrap()), "{told}");
    closed.wait_for_jobs(0);
    let recording = Recording::open(&closed.recording).unwrap();
    let trigger = recording.messages(&Topic::Trigger)[0];
    let trigger = recording.trigger(&trigger).unwrap().time;
    let [line] = &closed.lines()[..] else {
        panic!("{:?}", closed.lines());
    };
    let without_time = |line: &Value| {
        let mut line = line.clone();
        let time = line.as_object_mut().unwrap().remove("time").unwrap();
        assert!(time.as_str().unwrap().parse::<u64>().unwrap() > trigger.0);
        line
    };
    let expected = json!({
        "trigger": trigger.0.to_string(), "capture": closed.capture, "kind": "reject", "text": "a hand", "author": "Ann",
    });
    assert_eq!(without_time(line), expected);
    assert!(Notes::of(&recording).on(&closed.capture).is_rejected());
    // Text changes nothing of that.
    closed.note("text", "the light was late");
    closed.wait_for_jobs(0);
    closed.note("clear", "");
    closed.wait_for_jobs(1);
    assert_eq!(closed.lines().len(), 3);
    let notes = Notes::of(&recording);
    assert_eq!(notes.problems(), [""; 0]);
    assert_eq!(notes.on(&closed.capture).decision, None);
    assert!(
        digest(&closed.recording) == before,
        "the recording never changes"
    );
}

#[test]
fn a_note_on_a_capture_that_no_recording_has_changes_nothing() {
    let closed = ClosedSession::new();
    let mut client = closed.service.client();
    let session = closed.capture.rsplit_once('-').unwrap().0;
    for unknown in [format!("{session}-0099"), "nothing-0001".to_owned()] {
        let answer = replies(&mut client, &note_on(&unknown, "reject", ""));
        let [Reply::Refused { reason }] = &answer[..] else {
            panic!("{unknown}: {answer:?}");
        };
        assert!(reason.contains(&unknown), "{reason}");
    }
    closed.wait_for_jobs(1);
    assert!(!beside(&closed.recording).exists());
}

#[test]
fn a_session_is_noted_and_never_rejected() {
    let service = service(|_| ());
    let heard = service.press_until_taken(None);
    let Some(Reply::Durable { capture, .. }) = heard.last() else {
        panic!("{heard:?}");
    };
    let session = capture.rsplit_once('-').unwrap().0;
    let mut client = service.client();
    let mut ask = |kind| replies(&mut client, &note_on(session, kind, "the lamp"));
    let refused = ask("reject");
    let [Reply::Refused { reason }] = &refused[..] else {
        panic!("{refused:?}");
    };
    assert!(reason.contains("is the session"), "{reason}");
    assert!(matches!(ask("text")[..], [Reply::Ok { .. }]));
}

#[test]
fn a_note_on_a_capture_of_an_earlier_file_of_the_open_session_lies_beside_that_file() {
    // Each capture has a file of its own.
    let service = service(|plan| plan.recording.largest_file_mb = 0);
    let taken: Vec<(String, PathBuf)> = (0..2)
        .map(|_| match service.press_until_taken(None).pop() {
            Some(Reply::Durable { capture, recording }) => (capture, recording),
            other => panic!("{other:?}"),
        })
        .collect();
    let [(first, earlier), (second, open)] = &taken[..] else {
        unreachable!()
    };
    assert_ne!(earlier, open);
    let mut client = service.client();
    for capture in [first, second] {
        let answer = replies(&mut client, &note_on(capture, "reject", "a hand"));
        assert!(matches!(answer[..], [Reply::Ok { .. }]), "{answer:?}");
    }
    assert!(beside(earlier).exists() && !beside(open).exists());
    replies(&mut client, &Request::Close {});
    for (capture, path) in [(first, earlier), (second, open)] {
        let notes = Notes::of(&Recording::open(path).unwrap());
        assert!(notes.on(capture).is_rejected(), "{capture}");
    }
}
