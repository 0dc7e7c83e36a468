//! For a fixed script of presses, with a clock that stands still between them, the capturing thread always records
//! the same messages: topics, times and payloads.

use super::capturing::Order;
use super::recorder::Answer;
use super::scripted::{Behaviour, CAMERAS, TestBench, start_at};
use crate::clock::Clock;
use crate::frame::Timestamp;
use crate::recording::Note;
use crate::trigger::Reply;
use std::collections::BTreeMap;
use std::path::Path;
use std::time::Duration;

#[path = "../../tests/digests/held.rs"]
mod held;

/// The clock and what is pressed by it: each step is 10 s after the one before.
struct Script {
    clock: Clock,
    stand: TestBench,
}

impl Script {
    /// The final answer to a press.
    fn press(&self) -> Reply {
        self.clock.advance(Duration::from_secs(10));
        self.stand.press().pop().unwrap()
    }

    fn ask(&self, order: impl Fn(Answer) -> Order) {
        self.clock.advance(Duration::from_secs(10));
        self.stand.ask(order).unwrap();
    }
}

/// Presses that succeed at once, when they are retried, and not at all; a session with notes; backgrounds before it and
/// while it is recorded.
fn play(folder: tempfile::TempDir) -> tempfile::TempDir {
    let clock = Clock::by_hand(Timestamp(1_760_000_000_000_000_000));
    let stand = start_at(clock, &CAMERAS, folder, 4_000_000, |plan| {
        plan.capture.retry = 1;
        plan.header.about.insert("rig".into(), "a test's".into());
    });
    let script = Script { clock, stand };
    assert!(matches!(script.press(), Reply::Durable { .. }));
    script.stand.behaviour("c01", Behaviour::LosesOnce);
    let Reply::Durable { capture, .. } = script.press() else {
        panic!("the second attempt succeeds");
    };
    assert!(capture.ends_with("-0002.r1"), "{capture}");
    script.stand.behaviour("c01", Behaviour::Loses);
    assert!(matches!(script.press(), Reply::Failed { .. }));
    script.stand.behaviour("c01", Behaviour::Sound);
    script.ask(Order::Background);
    let about = BTreeMap::from([("operator".to_owned(), "Ann".to_owned())]);
    script.ask(|answer| Order::Begin("amphora".into(), about.clone(), answer));
    assert!(matches!(script.press(), Reply::Durable { .. }));
    let note = Note {
        capture: "amphora-0001".into(),
        kind: "reject".into(),
        text: "a hand".into(),
        author: None,
    };
    script.ask(|answer| Order::Note(note.clone(), answer));
    script.ask(Order::Background);
    script.stand.behaviour("c02", Behaviour::Late);
    assert!(matches!(script.press(), Reply::Failed { .. }));
    script.stand.behaviour("c02", Behaviour::Sound);
    assert!(matches!(script.press(), Reply::Durable { .. }));
    script.ask(Order::Close);
    let (folder, stuck) = script.stand.stop();
    assert_eq!(stuck, []);
    folder
}

/// Digests of the recordings in a folder, by their names in `daemon`.
fn digests(folder: &Path, of: &str) -> BTreeMap<String, String> {
    let entries = std::fs::read_dir(folder).unwrap();
    let paths = entries.map(|entry| entry.unwrap().path());
    let recordings = paths.filter(|path| path.extension().is_some_and(|e| e == "mcap"));
    let named = recordings.map(|path| {
        let name = path.file_name().unwrap().to_string_lossy();
        (format!("{of}/{name}"), held::messages(&path))
    });
    named.collect()
}

#[test]
fn messages_of_a_script_of_presses_are_what_they_were() {
    let folder = play(tempfile::tempdir().unwrap());
    let mut found = digests(folder.path(), "daemon");
    found.extend(digests(&folder.path().join("plates"), "daemon/plates"));
    assert_eq!(found.len(), 4, "{found:?}");
    held::hold(&found);
}
