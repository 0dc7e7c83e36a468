//! Arguments that cannot be satisfied: exit code 2, and a message about what was found and what was expected.

use crate::desk::{Desk, files, said};
use assert_cmd::Command;
use std::fs::File;
use std::process::Stdio;

/// The error of a call that is refused as wrong usage; it writes nothing.
fn refused(arguments: &str) -> String {
    let folder = tempfile::tempdir().unwrap();
    let output = Command::cargo_bin("scand")
        .unwrap()
        .current_dir(folder.path())
        .args(arguments.split(' '))
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(2), "{arguments}: {output:?}");
    assert_eq!(folder.path().read_dir().unwrap().count(), 0, "{arguments}");
    String::from_utf8(output.stderr).unwrap()
}

#[test]
fn simulations_that_cannot_be_are_wrong_usage() {
    for (options, named) in [
        ("--spacing-mm 0", "spacing is 0, expected 0.1 to 50 mm"),
        ("--size 0x0", "0x0"),
        ("--depth-distance 0", "depth distance is 0, expected 0.4"),
        ("--cameras 1", "cameras is 1, expected 2 to 99"),
        ("--captures 0", "captures is 0, expected at least 1"),
        ("--jpeg-quality 0", "JPEG quality is 0, expected 1 to 100"),
        (
            "--jpeg-quality 101",
            "JPEG quality is 101, expected 1 to 100",
        ),
        (
            "--turned kinect=5",
            "turned camera is the depth camera kinect",
        ),
        (
            "--calibration-session --turned kinect=5",
            "depth camera kinect",
        ),
        ("--calibration-session --board charuco:1x1:25mm", "1x1"),
        ("--calibration-session --textured", "cannot be used with"),
    ] {
        let words = refused(&format!("simulate --shape ball --out a.mcap {options}"));
        assert!(words.contains(named), "{options}: {words}");
    }
}

#[test]
fn what_happens_to_an_object_or_a_calibration_is_wrong_usage_with_a_board() {
    for options in [
        "--chip 0=5mm",
        "--pit 0=5mm",
        "--exchanged 0=ball",
        "--prop 0=20mm",
        "--props-ignored",
        "--lost-piece 0=5mm",
        "--calibration-px 0.2",
        "--calibration-scale-percent 1",
        "--doubtful-calibration old",
    ] {
        let words = refused(&format!(
            "simulate --calibration-session --out a.mcap {options}"
        ));
        assert!(words.contains("cannot be used with"), "{options}: {words}");
    }
}

#[test]
fn boards_that_cannot_be_are_wrong_usage() {
    for (options, named) in [
        ("checkerboard --size 0x0", "0x0"),
        (
            "checkerboard --square 25",
            "expected a length with its unit",
        ),
        ("checkerboard --square 90mm --paper a4", "A4"),
        (
            "charuco --size 99x99",
            "5000 that 99x99 inner corners need, expected a larger dictionary, fewer corners",
        ),
    ] {
        let words = refused(&format!("board --out a.pdf --kind {options}"));
        assert!(words.contains(named), "{options}: {words}");
    }
}

#[test]
fn the_version_tells_the_commit_and_the_features() {
    let output = Command::cargo_bin("scand")
        .unwrap()
        .arg("--version")
        .output();
    let words = String::from_utf8(output.unwrap().stdout).unwrap();
    // Of a checkout, its commit; an unpacked archive has none, also within another project's repository.
    let asked = |arguments: &[&str]| {
        let output = std::process::Command::new("git").args(arguments).output();
        let output = output.ok().filter(|output| output.status.success());
        output.map(|output| String::from_utf8(output.stdout).unwrap().trim().to_owned())
    };
    let is_ours = asked(&["rev-parse", "--show-toplevel"])
        .and_then(|top| std::fs::canonicalize(top).ok())
        == std::fs::canonicalize(env!("CARGO_MANIFEST_DIR")).ok();
    let commit = asked(&["rev-parse", "--short=12", "HEAD"]).filter(|_| is_ours);
    let commit = commit.unwrap_or_else(|| "unknown".to_owned());
    let version = env!("CARGO_PKG_VERSION");
    let start = format!("scand {version} (commit {commit}; features: ");
    assert!(words.starts_with(&start), "{words} does not begin {start}");
    let has_live = words.contains(" live");
    assert_eq!(has_live, cfg!(feature = "live"), "{words}");
}

#[test]
fn a_calibration_that_cannot_be_written_is_refused_before_any_work() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("file"), "").unwrap();
    let out = folder.path().join("file/calibration.toml");
    let found = Command::cargo_bin("scand")
        .unwrap()
        .args(["calibrate", "--board", "checkerboard:11x8:25mm", "--out"])
        .arg(&out)
        .arg(concat!(env!("CARGO_MANIFEST_DIR"), "/recordings/cup.mcap"))
        .output()
        .unwrap();
    let words = String::from_utf8_lossy(&found.stderr).into_owned();
    assert!(!found.status.success());
    assert!(words.contains("nothing was calibrated"), "{words}");
}

#[test]
fn the_digests_of_a_recording_are_those_that_its_model_states() {
    let desk = super::desk::Desk::with_a_model();
    let report = std::fs::read(desk.path("out/ball/ball-000/report.json")).unwrap();
    let words = desk.done(&["info", "ball.mcap", "--digests", "--json"]);
    let info: serde_json::Value = serde_json::from_str(&words).unwrap();
    let report: serde_json::Value = serde_json::from_slice(&report).unwrap();
    let stated = &report["description"];
    let found = &info["digests"][0]["sha256"];
    assert_eq!(found["input"], stated["input_sha256"], "{words}");
    assert_eq!(found["calibration"], stated["calibration_sha256"]);
    assert!(found["input"].is_string());
}

#[test]
fn several_captures_are_fused_with_the_calibration_that_is_given() {
    let desk = super::desk::Desk::new();
    let pose = "[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]";
    let poses = format!("{{\"rig_from_object\":[{pose},{pose}]}}");
    std::fs::write(desk.path("poses.json"), poses).unwrap();
    desk.done(&["info", "ball.mcap", "--calibration", "other.toml"]);
    let text = std::fs::read_to_string(desk.path("other.toml")).unwrap();
    let start = text.find("center_px = [").unwrap() + "center_px = [".len();
    let end = start + text[start..].find(',').unwrap();
    let moved = text[start..end].parse::<f64>().unwrap() + 0.25;
    let text = format!("{}{moved:?}{}", &text[..start], &text[end..]);
    std::fs::write(desk.path("other.toml"), text).unwrap();
    #[rustfmt::skip]
    let fuse = [
        "fuse", "ball.mcap", "--capture", "ball-000", "--capture", "ball-001", "--poses", "poses.json",
        "--set", "hull.resolution=40", "-q",
    ];
    let digest = |more: &[&str]| {
        desk.done(&[&fuse[..], more].concat());
        let report = desk.path("out/ball/ball-000.object/report.json");
        let report: serde_json::Value =
            serde_json::from_slice(&std::fs::read(report).unwrap()).unwrap();
        report["description"]["calibration_sha256"].clone()
    };
    let recorded = digest(&[]);
    let other = digest(&["--calibration", "other.toml", "--force"]);
    assert!(recorded.is_string() && other != recorded);
}

/// The end of a call, in an empty folder.
fn ended(arguments: &[&str], output: Stdio) -> (Option<i32>, String) {
    let folder = tempfile::tempdir().unwrap();
    let ended = std::process::Command::new(env!("CARGO_BIN_EXE_scand"))
        .current_dir(folder.path())
        .args(arguments)
        .stdout(output)
        .stderr(Stdio::piped())
        .output()
        .unwrap();
    let words = String::from_utf8(ended.stderr).unwrap();
    (ended.status.code(), words)
}

#[test]
fn results_that_cannot_be_printed_are_a_failure_but_a_closed_pipe_is_none() {
    let arguments = ["generate", "completions", "bash"];
    let full = File::options().write(true).open("/dev/full").unwrap();
    let (code, words) = ended(&arguments, full.into());
    assert_eq!(code, Some(1), "{words}");
    let begin = "scand: cannot write to standard output: ";
    assert!(
        words.starts_with(begin) && words.contains("No space left"),
        "{words}"
    );
    let (reader, writer) = std::io::pipe().unwrap();
    drop(reader);
    let (code, words) = ended(&arguments, writer.into());
    assert_eq!((code, words.as_str()), (Some(0), ""));
}

#[test]
fn one_limit_of_a_verdict_leaves_the_other_as_it_is() {
    let (code, words) = ended(
        &["replay", "none.mcap", "--set", "verdict.displaced.red=0.01"],
        Stdio::null(),
    );
    assert_ne!(code, Some(78), "{words}");
    let (code, words) = ended(
        &[
            "replay",
            "none.mcap",
            "--set",
            "verdict.displaced.red=0.001",
        ],
        Stdio::null(),
    );
    assert_eq!(code, Some(78), "{words}");
    for field in ["displaced.amber", "displaced.red"] {
        assert!(words.contains(field), "{words}");
    }
}

#[test]
fn an_empty_text_is_wrong_usage() {
    for arguments in [
        &["note", "cup-0001", ""][..],
        &["session", "note", " "],
        &["trigger", "--subject", ""],
    ] {
        let (code, words) = ended(arguments, Stdio::null());
        assert_eq!(code, Some(2), "{words}");
        assert!(words.contains("expected a text"), "{words}");
    }
}

#[test]
fn what_has_no_end_is_not_read_for_ever() {
    let desk = Desk::new();
    #[rustfmt::skip]
    let calls = [
        (&["export", "/dev/zero", "--format", "obj"][..], "it is not a regular file"),
        (&["archive", "ball.mcap", "--licence", "/dev/zero", "-o", "package"], "expected at most"),
        (
            &["fuse", "ball.mcap", "--capture", "ball-000", "--capture", "ball-001", "--poses", "/dev/zero"],
            "expected at most",
        ),
    ];
    for (arguments, words) in calls {
        let ended = desk.run(arguments);
        let told = said(&ended);
        assert_eq!(ended.status.code(), Some(1), "{told}");
        assert!(told.contains("/dev/zero") && told.contains(words), "{told}");
    }
    assert!(!desk.path("package").exists());
}

#[test]
fn a_recording_whose_name_leads_out_of_the_folder_makes_no_model() {
    let desk = Desk::new();
    std::fs::rename(desk.path("ball.mcap"), desk.path("...mcap")).unwrap();
    for arguments in [
        &["replay", "...mcap"][..],
        &[
            "fuse",
            "...mcap",
            "--capture",
            "ball-000",
            "--capture",
            "ball-001",
        ],
    ] {
        let ended = desk.run(arguments);
        let told = said(&ended);
        assert_eq!(ended.status.code(), Some(1), "{told}");
        assert!(
            told.contains("...mcap") && told.contains("expected a recording's name"),
            "{told}"
        );
        assert_eq!(files(&desk.path("")).len(), 1, "{told}");
    }
}

#[test]
fn a_folder_without_the_model_of_a_capture_is_named_with_what_was_expected_in_it() {
    let desk = Desk::new();
    std::fs::create_dir(desk.path("models")).unwrap();
    let ended = desk.run(&[
        "export",
        "ball.mcap",
        "--dataset",
        "colmap",
        "--model",
        "models",
    ]);
    let told = said(&ended);
    assert_eq!(ended.status.code(), Some(1), "{told}");
    let words = "models: the folder has no model of capture ball-000: expected ball/ball-000/model.glb in it";
    assert!(told.contains(words), "{told}");
}

#[test]
fn man_pages_are_written_whole() {
    let folder = tempfile::tempdir().unwrap();
    let pages = folder.path().join("man");
    let (code, words) = ended(&["generate", "man", pages.to_str().unwrap()], Stdio::null());
    assert_eq!(code, Some(0), "{words}");
    for (page, name) in [("scand.1", "scand"), ("scand-session-close.1", "close")] {
        let text = std::fs::read_to_string(pages.join(page)).unwrap();
        assert!(text.contains(".SH NAME") && text.contains(name), "{page}");
    }
    // A page that cannot be written stays as it was.
    let page = pages.join("scand.1");
    std::fs::remove_file(&page).unwrap();
    std::fs::create_dir(&page).unwrap();
    let (code, words) = ended(&["generate", "man", pages.to_str().unwrap()], Stdio::null());
    assert_eq!(code, Some(1), "{words}");
    assert!(words.contains("scand.1"), "{words}");
}
