//! Tests packages for archives: what `scand archive` puts into one, and what `scand verify` says about it.

use super::desk::{Desk, files};
use serde_json::Value;

#[test]
fn a_package_holds_all_that_is_known_and_is_the_same_again() {
    let desk = Desk::with_a_model();
    desk.done(&[
        "note",
        "ball-000",
        "accept",
        "--author",
        "Ann",
        "--recording",
        "ball.mcap",
    ]);
    let told = desk.done(&["archive", "ball.mcap", "-o", "one", "--date", "2026-01-31"]);
    assert!(told.contains("2 captures of 1 recording"), "{told}");
    assert!(told.contains("ball-001: no model"), "{told}");
    let verified = desk.done(&["verify", "one"]);
    assert!(verified.contains("one: intact"), "{verified}");
    let one = files(&desk.path("one"));
    for name in [
        "bagit.txt",
        "data/README.txt",
        "data/recordings/ball.mcap",
        "data/recordings/ball.notes.jsonl",
        "data/calibration/ball.toml",
        "data/models/ball/ball-000/model.glb",
        "data/models/ball/ball-000/report.json",
        "data/paradata/ball/ball-000.html",
        "data/paradata/ball/ball-001.json",
        "data/documentation/formats.md",
        "data/licences/documentation-MIT.txt",
    ] {
        assert!(one.contains_key(name), "{name}");
    }
    assert!(one["data/recordings/ball.mcap"] == std::fs::read(desk.path("ball.mcap")).unwrap());
    let sheet: Value = serde_json::from_slice(&one["data/paradata/ball/ball-000.json"]).unwrap();
    assert_eq!(sheet["by_whom"]["notes"]["decision"], "accepted");
    assert_eq!(sheet["environment"]["lighting"], "not recorded");
    assert!(sheet["how_exact"]["verdict"]["level"].is_string());
    let absent: Value = serde_json::from_slice(&one["data/paradata/ball/ball-001.json"]).unwrap();
    assert_eq!(absent["processing"]["method"], "no model is in the package");
    desk.done(&[
        "archive",
        "ball.mcap",
        "-o",
        "again",
        "--date",
        "2026-01-31",
    ]);
    assert!(
        files(&desk.path("again")) == one,
        "the same files make the same package"
    );
    let refused = desk.run(&["archive", "ball.mcap", "-o", "one"]);
    assert_eq!(refused.status.code(), Some(1));
}

#[test]
fn captures_and_sessions_are_found_by_their_names() {
    let desk = Desk::with_a_model();
    desk.done(&["archive", "ball-000", "-o", "capture"]);
    let capture = files(&desk.path("capture"));
    assert!(capture.contains_key("data/paradata/ball/ball-000.json"));
    assert!(!capture.contains_key("data/paradata/ball/ball-001.json"));
    desk.done(&["archive", "ball", "-o", "session"]);
    assert!(files(&desk.path("session")).contains_key("data/paradata/ball/ball-001.json"));
    let unknown = desk.run(&["archive", "1884.3", "-o", "none"]);
    let words = String::from_utf8(unknown.stderr).unwrap();
    assert!(
        words.contains("\"1884.3\"") && words.contains("--recordings"),
        "{words}"
    );
    assert!(!desk.path("none").exists());
}

#[test]
fn a_rejected_model_stays_out_unless_its_capture_is_named() {
    let desk = Desk::with_a_model();
    desk.done(&["note", "ball-000", "reject", "--recording", "ball.mcap"]);
    let told = desk.done(&["archive", "ball", "-o", "session"]);
    assert!(
        told.contains("is left out, because the capture was rejected"),
        "{told}"
    );
    assert!(!files(&desk.path("session")).contains_key("data/models/ball/ball-000/model.glb"));
    desk.done(&["archive", "ball-000", "-o", "capture"]);
    assert!(files(&desk.path("capture")).contains_key("data/models/ball/ball-000/model.glb"));
}

#[test]
fn a_package_that_is_not_whole_is_told_so() {
    let desk = Desk::with_a_model();
    desk.done(&["archive", "ball-000", "-o", "bag"]);
    std::fs::write(desk.path("bag/data/extra"), "").unwrap();
    std::fs::remove_file(desk.path("bag/data/README.txt")).unwrap();
    let output = desk.run(&["verify", "bag"]);
    let words = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{words}");
    assert!(words.contains("data/extra is not listed"), "{words}");
    assert!(
        words.contains("data/README.txt is listed but missing"),
        "{words}"
    );
    let json = desk.run(&["verify", "bag", "--json"]);
    let line: Value = serde_json::from_slice(&json.stdout).unwrap();
    assert_eq!(line["whole"], false);
    assert!(line["findings"].as_array().unwrap().len() >= 2);
    assert_eq!(desk.run(&["verify", "nowhere"]).status.code(), Some(1));
}
