//! What people say of captures of a complete recording: `scand note --recording`, and what `info` and `replay` make
//! of it.

use super::desk::{Desk, said};
use assert_cmd::Command;
use serde_json::Value;
use sha2::{Digest, Sha256};
use std::path::PathBuf;

/// Two captures of a ball, and a folder for what is made of them.
struct Ball {
    folder: tempfile::TempDir,
}

impl Ball {
    fn new() -> Self {
        let ball = Self {
            folder: tempfile::tempdir().unwrap(),
        };
        #[rustfmt::skip]
        ball.scand(&[
            "simulate", "--shape", "ball", "--cameras", "5", "--size", "160x120", "--masks", "--depth-cameras", "0",
            "--captures", "2", "--out", "ball.mcap",
        ]);
        ball
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::cargo_bin("scand").unwrap();
        command.current_dir(self.folder.path()).args(arguments);
        command
    }

    /// What a command that succeeds prints.
    fn scand(&self, arguments: &[&str]) -> String {
        let output = self.command(arguments).output().unwrap();
        assert!(output.status.success(), "{arguments:?}: {output:?}");
        String::from_utf8(output.stdout).unwrap()
    }

    fn note(&self, capture: &str, words: &[&str]) -> String {
        let arguments = [&["note", capture], words, &["--recording", "ball.mcap"]].concat();
        self.scand(&arguments)
    }

    /// The captures of a replay as their lines say: id, how it ended, and the decision.
    fn replay(&self, more: &[&str]) -> Vec<[String; 3]> {
        let arguments = [
            "replay",
            "ball.mcap",
            "--json",
            "-q",
            "--set",
            "hull.resolution=40",
        ];
        let told = self.scand(&[&arguments[..], more].concat());
        let lines = told.lines().map(|line| serde_json::from_str(line).unwrap());
        let word = |value: &Value| value.as_str().unwrap_or("-").to_owned();
        let line = |line: Value| {
            [
                &line["capture"],
                &line["result"],
                &line["notes"]["decision"],
            ]
            .map(word)
        };
        lines.map(line).collect()
    }

    fn report(&self, capture: &str) -> Value {
        let bytes = std::fs::read(self.path("out/ball").join(capture).join("report.json")).unwrap();
        serde_json::from_slice(&bytes).unwrap()
    }

    fn digest(&self) -> Vec<u8> {
        Sha256::digest(std::fs::read(self.path("ball.mcap")).unwrap()).to_vec()
    }
}

#[test]
fn a_rejected_capture_is_left_out_until_that_is_taken_back() {
    let ball = Ball::new();
    let before = ball.digest();
    let told = ball.note(
        "ball-000",
        &["reject", "a hand is in it", "--author", "Ann"],
    );
    assert!(told.contains("ball.notes.jsonl"), "{told}");
    let info = ball.scand(&["info", "ball.mcap"]);
    let of_capture = |line: &&str| line.contains("ball-000 at");
    let line = info.lines().skip_while(|line| !of_capture(line)).nth(1);
    let line = line.unwrap();
    assert!(
        line.contains("rejected by Ann on 20") && line.contains("a hand is in it"),
        "{line}"
    );
    let line = |id: &str, result: &str, decision: &str| [id, result, decision].map(str::to_owned);
    let rejected = line("ball-000", "rejected", "rejected");
    assert_eq!(
        ball.replay(&[]),
        [rejected.clone(), line("ball-001", "done", "-")]
    );
    assert!(!ball.path("out/ball/ball-000").exists());
    let words = ball.scand(&["replay", "ball.mcap", "--set", "hull.resolution=40"]);
    assert!(
        words.contains("left out, because it was rejected"),
        "{words}"
    );
    assert!(
        words.contains("1 done, 0 failed, 1 rejected and left out"),
        "{words}"
    );
    // A text changes nothing of that, and who wants the capture gets it.
    ball.note("ball-000", &["the light was late"]);
    let all = ball.replay(&["--rejected"]);
    assert_eq!(all[0], line("ball-000", "done", "rejected"));
    let report = ball.report("ball-000");
    assert_eq!(report["notes"]["decision"], "rejected");
    assert_eq!(report["notes"]["said"][1]["text"], "the light was late");
    let files = || {
        ["model.glb", "model.ply"].map(|name| {
            let path = ball.path("out/ball/ball-000").join(name);
            std::fs::read(path).unwrap()
        })
    };
    let model = files();
    // Taken back: the model that is there says so, and is otherwise what it was.
    ball.note("ball-000", &["clear"]);
    assert_eq!(ball.replay(&[])[0], line("ball-000", "unchanged", "-"));
    let report = ball.report("ball-000");
    assert_eq!(report["notes"]["decision"], Value::Null);
    assert!(files() == model);
    // No note and no decision goes into a model: made again, it has the same bytes.
    let again = ball.replay(&["--force", "--capture", "ball-000"]);
    assert_eq!(again, [line("ball-000", "done", "-")]);
    assert!(files() == model, "a note has changed a model's bytes");
    // A model that was made before its capture is rejected stays and is marked.
    let preview = std::fs::read(ball.path("out/ball/ball-001/preview.png")).unwrap();
    ball.note("ball-001", &["reject"]);
    assert_eq!(ball.replay(&[])[1..], [line("ball-000", "unchanged", "-")]);
    assert_eq!(ball.report("ball-001")["notes"]["decision"], "rejected");
    assert_ne!(
        std::fs::read(ball.path("out/ball/ball-001/preview.png")).unwrap(),
        preview
    );
    assert_eq!(ball.digest(), before, "the recording never changes");
    // Packing takes nothing from the notes.
    ball.scand(&["pack", "ball.mcap"]);
    assert_eq!(
        ball.replay(&["--capture", "ball-001"]),
        [line("ball-001", "unchanged", "rejected")]
    );
}

#[test]
fn a_note_beside_a_recording_is_answered_in_json() {
    let ball = Ball::new();
    let told = ball.note("ball-000", &["accept", "--json"]);
    let told: Value = serde_json::from_str(&told).unwrap();
    assert_eq!(told["type"], "ok");
    let words = told["words"].as_str().unwrap();
    assert!(words.contains("ball.notes.jsonl"), "{words}");
}

#[test]
fn a_note_is_one_line_that_no_terminal_obeys() {
    let ball = Ball::new();
    let hostile = "a hand\nFAKED: green\u{1b}[2J\u{1b}]0;title\u{7}\r\u{9b}1A";
    let author = "Ann\nFAKED\u{1b}[8m";
    ball.note("ball-000", &["reject", hostile, "--author", author]);
    ball.note("ball-000", &[hostile, "--text", "--author", author]);
    let shown = [
        ball.scand(&["info", "ball.mcap"]),
        ball.scand(&["info", "ball.mcap", "ball.mcap"]),
        ball.scand(&[
            "replay",
            "ball.mcap",
            "--rejected",
            "--set",
            "hull.resolution=40",
        ]),
    ];
    for words in shown {
        let obeyed = |c: char| c.is_control() && c != '\n';
        assert!(!words.contains(obeyed), "{words:?}");
        assert!(!words.lines().any(|l| l.starts_with("FAKED")), "{words}");
    }
    // The report is for programs: it has the text as it was written.
    assert_eq!(ball.report("ball-000")["notes"]["said"][1]["text"], hostile);
}

#[test]
fn a_word_close_to_a_decision_is_asked_about() {
    let ball = Ball::new();
    for (what, close) in [
        ("accpt", "accept"),
        ("Reject", "reject"),
        ("rejected: a hand", "reject"),
        ("cleer", "clear"),
        ("accepted", "accept"),
    ] {
        let mut note = ball.command(&["note", "ball-000", what, "--recording", "ball.mcap"]);
        let output = note.output().unwrap();
        let words = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(2), "{what}: {words}");
        assert!(
            words.contains(&format!("close to {close:?}")) && words.contains("--text"),
            "{words}"
        );
        assert!(!ball.path("ball.notes.jsonl").exists(), "{what}");
    }
    // What merely begins like a decision is a text.
    for text in [
        "object was turned left",
        "project 12",
        "clean",
        "except the handle",
    ] {
        ball.note("ball-000", &[text]);
        let notes = std::fs::read_to_string(ball.path("ball.notes.jsonl")).unwrap();
        assert!(
            notes.contains(&format!(r#""kind":"text","text":"{text}""#)),
            "{notes}"
        );
    }
    ball.note("ball-000", &["rejcet", "--text"]);
    let notes = std::fs::read_to_string(ball.path("ball.notes.jsonl")).unwrap();
    assert!(
        notes.contains(r#""kind":"text","text":"rejcet""#),
        "{notes}"
    );
    let unknown = ball
        .command(&["note", "ball-7", "accept", "--recording", "ball.mcap"])
        .output()
        .unwrap();
    let words = String::from_utf8(unknown.stderr).unwrap();
    assert!(
        words.contains("ball.mcap") && words.contains("ball-7"),
        "{words}"
    );
}

#[test]
fn notes_of_another_recording_and_without_one_are_named() {
    let ball = Ball::new();
    ball.note("ball-000", &["reject"]);
    let notes = ball.path("ball.notes.jsonl");
    let text = std::fs::read_to_string(&notes).unwrap();
    let at = text.find("\"trigger\":\"").unwrap() + 11;
    std::fs::write(&notes, format!("{}9{}", &text[..at], &text[at + 1..])).unwrap();
    let info = ball.scand(&["info", "ball.mcap"]);
    assert!(
        info.contains("ball.notes.jsonl: line 1") && info.contains("another recording"),
        "{info}"
    );
    assert_eq!(ball.replay(&[])[0][1], "done");
    std::fs::write(ball.path("gone.notes.jsonl"), "").unwrap();
    let replay = ball
        .command(&["replay", ".", "--set", "hull.resolution=40"])
        .output()
        .unwrap();
    let words = String::from_utf8(replay.stderr).unwrap();
    assert!(
        words.contains("gone.notes.jsonl") && words.contains("gone.mcap does not exist"),
        "{words}"
    );
}

#[test]
fn notes_on_a_session_are_shown_and_decide_nothing() {
    let desk = Desk::with_a_model();
    desk.tell("ball.mcap", &[("name", "monday")]);
    let on_session = [
        "note",
        "monday",
        "the lamp was changed",
        "--author",
        "Ann",
        "--recording",
        "ball.mcap",
    ];
    desk.done(&on_session);
    let info = desk.done(&["info", "ball.mcap"]);
    let line = "note by Ann on ";
    let (_, after) = info.split_once("Notes on the session\n").expect(&info);
    assert!(after.trim_start().starts_with(line), "{info}");
    assert!(info.contains("the lamp was changed"), "{info}");
    let refused = desk.run(&["note", "monday", "reject", "--recording", "ball.mcap"]);
    let words = said(&refused);
    assert_eq!(refused.status.code(), Some(1), "{words}");
    assert!(
        words.contains("\"monday\" is the session") && words.contains("capture's id"),
        "{words}"
    );
    desk.done(&["archive", "ball-000", "-o", "bag"]);
    let sheet = std::fs::read(desk.path("bag/data/paradata/ball/ball-000.json")).unwrap();
    let sheet: Value = serde_json::from_slice(&sheet).unwrap();
    let noted = &sheet["by_whom"]["notes_on_the_session"]["said"][0]["text"];
    assert_eq!(noted, "the lamp was changed");
}

#[test]
fn a_copy_that_is_recovered_takes_the_notes_along() {
    let desk = Desk::new();
    desk.done(&["note", "ball-000", "reject", "--recording", "ball.mcap"]);
    let bytes = std::fs::read(desk.path("ball.mcap")).unwrap();
    std::fs::write(desk.path("cut.mcap"), &bytes[..bytes.len() - 9]).unwrap();
    let noted = |name: &str| desk.path(&format!("{name}.notes.jsonl"));
    std::fs::copy(noted("ball"), noted("cut")).unwrap();
    let told = said(&desk.run(&["recover", "cut.mcap"]));
    assert!(
        told.contains("cut.recovered.notes.jsonl: a copy of the notes"),
        "{told}"
    );
    assert_eq!(
        std::fs::read(noted("cut.recovered")).unwrap(),
        std::fs::read(noted("cut")).unwrap()
    );
    let info = desk.done(&["info", "cut.recovered.mcap"]);
    assert!(info.contains("rejected on 20"), "{info}");
    // Notes of that name may be about something else.
    std::fs::remove_file(desk.path("cut.recovered.mcap")).unwrap();
    let refused = desk.run(&["recover", "cut.mcap"]);
    assert_eq!(refused.status.code(), Some(1), "{refused:?}");
    assert!(said(&refused).contains("cut.recovered.notes.jsonl"));
    assert!(!desk.path("cut.recovered.mcap").exists());
}

#[test]
fn each_note_and_each_pair_has_a_line_and_long_ones_end_visibly() {
    let desk = Desk::new();
    let long = "ä".repeat(900);
    desk.tell("ball.mcap", &[("title", &long), ("zebra", "last")]);
    for text in [&long, "the second"] {
        desk.done(&["note", "ball-001", text, "--recording", "ball.mcap"]);
    }
    let info = desk.done(&["info", "ball.mcap"]);
    assert!(
        info.contains(&format!("title = {}…\n", "ä".repeat(399))),
        "{info}"
    );
    assert!(info.contains("    zebra = last\n"), "{info}");
    assert!(
        info.contains(&format!(": {}…\n", "ä".repeat(400))),
        "{info}"
    );
    assert!(info.contains(": the second\n"), "{info}");
}

#[test]
fn a_note_with_a_clock_that_is_slow_says_that_it_changes_nothing() {
    let ball = Ball::new();
    let later = format!(
        "{{\"time\":\"9{}\",\"trigger\":\"TRIGGER\",\"capture\":\"ball-000\",\"kind\":\"accept\",\"text\":\"\"}}\n",
        "0".repeat(18)
    );
    ball.note("ball-000", &["seen"]);
    let notes = std::fs::read_to_string(ball.path("ball.notes.jsonl")).unwrap();
    let line: Value = serde_json::from_str(notes.trim()).unwrap();
    let later = later.replace("TRIGGER", line["trigger"].as_str().unwrap());
    std::fs::write(ball.path("ball.notes.jsonl"), later).unwrap();
    let told = ball.note("ball-000", &["reject"]);
    assert!(
        told.contains("changes nothing") && told.contains("set the clock"),
        "{told}"
    );
    assert!(ball.scand(&["info", "ball.mcap"]).contains("accepted on"));
}
