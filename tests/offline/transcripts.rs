//! Mistakes that people make at the command line, and what they are told: a table of commands, exit codes and words.

use super::desk::{Desk, said};
use std::io::{BufRead, BufReader, Write};
use std::os::unix::net::UnixListener;

/// A desk with a copy of its recording that was cut off, and with files that are no recordings.
fn desk_with_mistakes() -> Desk {
    let desk = Desk::new();
    let whole = std::fs::read(desk.path("ball.mcap")).unwrap();
    std::fs::write(desk.path("cut.mcap"), &whole[..whole.len() * 6 / 10]).unwrap();
    std::fs::write(desk.path("picture.mcap"), b"\x89PNG\r\n\x1a\n").unwrap();
    std::fs::write(desk.path("model.mcap"), "ply\nformat ascii 1.0\n").unwrap();
    let mut flipped = whole.clone();
    flipped[whole.len() / 2] ^= 4;
    std::fs::write(desk.path("flipped.mcap"), flipped).unwrap();
    std::fs::write(desk.path("archive.mcap"), b"PK\x03\x04\x14\0\0\0").unwrap();
    std::fs::write(desk.path("nothing.mcap"), "").unwrap();
    std::fs::create_dir(desk.path("folder.mcap")).unwrap();
    std::fs::write(desk.path("camchain.yaml"), "cam0:\n  intrinsics: [1, 2]\n").unwrap();
    std::fs::create_dir(desk.path("empty")).unwrap();
    std::fs::create_dir(desk.path("other")).unwrap();
    std::fs::copy(desk.path("ball.mcap"), desk.path("other/ball.mcap")).unwrap();
    desk
}

/// Runs a command line and holds its exit code and what it says.
fn hold(desk: &Desk, line: &str, code: i32, words: &[&str]) -> String {
    let output = desk.run(&line.split(' ').collect::<Vec<_>>());
    let said = said(&output);
    assert_eq!(output.status.code(), Some(code), "{line}: {said}");
    for word in words {
        assert!(said.contains(word), "{line}: {word:?} is not in: {said}");
    }
    said
}

#[test]
fn mistakes_are_answered_with_what_to_do() {
    let desk = desk_with_mistakes();
    for (line, code, words) in [
        ("ball.mcap", 2, &["scand replay ball.mcap"][..]),
        ("help replay", 0, &["FILE|FOLDER", "Examples:"]),
        ("version", 2, &["scand --version"]),
        ("man", 2, &["scand generate man DIR"]),
        (
            "replay ball.mcap --set hull.resolutoin=100",
            78,
            &["did you mean \"resolution\"?"],
        ),
        (
            "replay ball.mcap --set hull.resolution=abc",
            78,
            &["\"abc\", expected a number"],
        ),
        (
            "replay ball.mcap --set resolution=100",
            78,
            &["did you mean hull.resolution?"],
        ),
        (
            "replay ball.mcap --method hybird",
            2,
            &["did you mean \"hybrid\"?"],
        ),
        ("replay ball.mcap --vertices x", 2, &["10000 or 10k"]),
        ("replay ball.mcap --jobs x", 2, &["expected a whole number"]),
        ("replay ball.mcap --jobs 0", 2, &["0, expected 1 to 64"]),
        (
            "replay ball.mcap --vertices -5",
            2,
            &["a number of 4 or more"],
        ),
        (
            "replay ball.mcap --vertices 1k --set hull.cell_size=4mm -q -o less",
            0,
            &[],
        ),
        ("--replay -", 1, &["-: No such file"]),
        (
            "simulate --shape ball --out ball.mcap",
            1,
            &["already exists", "another --out"],
        ),
        ("calibrate ball.mcap", 1, &["give --board"]),
        (
            "board --kind charuco --paper a4 --square 25mm --out b.pdf",
            2,
            &["more than A4 has", "would fit"],
        ),
        (
            "board --kind charuco --square 1in --out inch.pdf",
            0,
            &["25.4mm"],
        ),
        (
            "info ball.mcap",
            0,
            &[
                "2026-01-01T00:00:05.000Z",
                "[-0.0340, -0.0340, 0.0000]",
                "5 colour frames and 0 depth frames, skew 1.50 ms, complete",
            ],
        ),
        (
            "replay ball.mcap --set hull.cell_size=1 -o large",
            1,
            &["hull.cell_size is 1 m", " mm or less"],
        ),
        ("replay ball.mcap --set hull.cell_size=4mm -q", 0, &[]),
        (
            "replay ball.mcap --calibration ball.mcap",
            78,
            &["is a recording", "scand info RECORDING --calibration"],
        ),
        (
            "replay ball.mcap --calibration camchain.yaml",
            78,
            &["is YAML, expected TOML", "--fix-intrinsics FILE.yaml"],
        ),
        (
            "replay ball.mcap -o ball.mcap/out",
            1,
            &["nothing was reconstructed", "--out"],
        ),
        (
            "replay ball.mcap other/ball.mcap",
            1,
            &["the same name", "rename one of them", "--out"],
        ),
        (
            "evaluate out/ball/CAPTURE/model.ply ball.truth.ply",
            1,
            &["CAPTURE/model.ply: No such file", "out/ball has ball-000"],
        ),
        (
            "info ball.mcap --calibration c2.json",
            0,
            &["the calibration is in c2.json (TOML)"],
        ),
        ("replay empty", 1, &["has no recording"]),
        ("replay absent.mcap", 1, &["absent.mcap", "No such file"]),
        (
            "replay ball.mcap -o /proc/none",
            1,
            &["nothing was reconstructed", "--out"],
        ),
        (
            "simulate --shape ball --out ball.mcap/b.mcap",
            1,
            &["nothing was rendered", "--out"],
        ),
        ("info picture.mcap", 1, &["is a PNG picture"]),
        ("info archive.mcap", 1, &["is a ZIP"]),
        ("info nothing.mcap", 1, &["nothing.mcap", "empty"]),
        ("info folder.mcap", 1, &["folder.mcap", "folder"]),
        (
            "info ball.mcap other/ball.mcap",
            0,
            &["2 captures", "5 cameras"],
        ),
        (
            "pack cut.mcap",
            1,
            &["cut.mcap", "cut off", "was left unchanged"],
        ),
        ("info flipped.mcap", 3, &["CRC"]),
        ("pack flipped.mcap", 1, &["CRC", "was left unchanged"]),
        ("info model.mcap", 1, &["is a PLY model"]),
        (
            "evaluate other ball.truth.ply",
            1,
            &["other: the folder has no model", "its folder"],
        ),
        (
            "diff out/ball ball.truth.ply",
            2,
            &["out/ball: the folder has no model", "out/ball has ball-000"],
        ),
        (
            "archive ball -o package --recordings empty",
            1,
            &["\"ball\"", "--recordings"],
        ),
        (
            "archive nothing -o out",
            1,
            &["nothing was packed", "out already exists"],
        ),
        (
            "archive ball -o /proc/none",
            1,
            &["nothing was packed", "/proc/none"],
        ),
        (
            "archive other -o package",
            1,
            &["is a folder", "--recordings", "--models"],
        ),
        ("info empty", 1, &["empty", "has no recording"]),
        (
            "info other",
            0,
            &["Captures", "ball-001 at 2026-01-01T00:00:15.000Z"],
        ),
        (
            "pack other",
            1,
            &["is a folder, expected an MCAP recording"],
        ),
        ("verify ball.mcap", 1, &["a package is a folder"]),
        (
            "note ball-000 accept --socket none.sock",
            69,
            &["is the daemon running", "--recording FILE.mcap"],
        ),
        (
            "trigger --socket none.sock",
            69,
            &["is the daemon running", "systemctl start scand"],
        ),
    ] {
        hold(&desk, line, code, words);
    }
    let told = hold(&desk, "version", 2, &[]);
    assert!(
        !told.contains("similar"),
        "what is meant is known, and what looks alike is not said: {told}"
    );
    if !cfg!(feature = "fleet") {
        let line = "replay ball.mcap --fleet tls://rig";
        let told = hold(&desk, line, 2, &["make deb", "--features fleet"]);
        assert!(!told.contains("as a value"), "{told}");
    }
    if !cfg!(feature = "live") {
        for line in ["run", "check --json", "pedal --device /dev/null"] {
            hold(
                &desk,
                line,
                2,
                &["no cameras", "make deb", "--features rig"],
            );
        }
    }
}

#[test]
fn completions_and_man_pages_know_the_commands() {
    let desk = Desk::new();
    for shell in ["bash", "zsh", "fish"] {
        hold(
            &desk,
            &format!("generate completions {shell}"),
            0,
            &["replay", "archive"],
        );
    }
    hold(&desk, "generate man pages", 0, &[]);
    let page = std::fs::read_to_string(desk.path("pages/scand-replay.1")).unwrap();
    assert!(page.contains("rejected"), "{page}");
}

#[test]
fn a_calibration_in_millimetres_is_told_as_such() {
    let desk = Desk::new();
    hold(
        &desk,
        "info ball.mcap --calibration metres.toml",
        0,
        &["the calibration is in metres.toml"],
    );
    let text = std::fs::read_to_string(desk.path("metres.toml")).unwrap();
    let thousandfold = |line: &str| match line.strip_prefix("translation = [") {
        Some(numbers) => {
            let numbers = numbers.trim_end_matches(']').split(", ");
            let numbers = numbers.map(|n| format!("{:?}", 1e3 * n.parse::<f64>().unwrap()));
            let numbers: Vec<String> = numbers.collect();
            format!("translation = [{}]", numbers.join(", "))
        }
        None => line.to_owned(),
    };
    let lines: Vec<String> = text.lines().map(thousandfold).collect();
    std::fs::write(desk.path("mm.toml"), lines.join("\n")).unwrap();
    hold(
        &desk,
        "replay ball.mcap --calibration mm.toml",
        78,
        &["looks like millimetres", "m from the rig's origin"],
    );
}

#[test]
fn a_copy_that_was_cut_off_is_told_first_and_can_be_completed() {
    let desk = desk_with_mistakes();
    let before = std::fs::read(desk.path("cut.mcap")).unwrap();
    let info = hold(&desk, "info cut.mcap", 3, &["scand recover cut.mcap"]);
    assert!(info.starts_with("cut.mcap: cut off:"), "{info}");
    let replay = desk.run(&["replay", "cut.mcap", "--set", "hull.resolution=40"]);
    let said = String::from_utf8_lossy(&replay.stderr).into_owned();
    assert!(said.starts_with("cut.mcap: cut off:"), "{said}");
    // `--quiet` keeps progress back, and no error.
    let quiet = desk.run(&["replay", "cut.mcap", "-q", "--set", "hull.resolution=40"]);
    let said = String::from_utf8_lossy(&quiet.stderr).into_owned();
    assert!(said.starts_with("cut.mcap: cut off:"), "{said}");
    assert!(!said.contains("ball-000: reading"), "{said}");
    let recovered = desk.run(&["recover", "cut.mcap"]);
    let said = String::from_utf8_lossy(&recovered.stdout).into_owned();
    assert!(
        matches!(recovered.status.code(), Some(0 | 3)),
        "{recovered:?}"
    );
    assert!(said.contains("cut.recovered.mcap: recovered"), "{said}");
    assert!(
        std::fs::read(desk.path("cut.mcap")).unwrap() == before,
        "the copy itself is never touched"
    );
    hold(&desk, "info cut.recovered.mcap", 0, &["Captures"]);
    hold(&desk, "recover ball.mcap", 1, &["is not cut off"]);
    hold(&desk, "recover cut.mcap", 1, &["cut.recovered.mcap"]);
}

/// A daemon that gives one answer to the request of this kind.
fn answering(desk: &Desk, kind: &'static str, answer: &'static str) -> std::thread::JoinHandle<()> {
    let _ = std::fs::remove_file(desk.path("s.sock"));
    let listener = UnixListener::bind(desk.path("s.sock")).unwrap();
    std::thread::spawn(move || {
        let (stream, _) = listener.accept().unwrap();
        let mut line = String::new();
        BufReader::new(&stream).read_line(&mut line).unwrap();
        assert!(line.contains(kind), "{line}");
        writeln!(&stream, "{answer}").unwrap();
    })
}

#[test]
fn what_became_of_a_press_is_in_the_exit_code() {
    let desk = Desk::new();
    for (answer, code, word) in [
        (r#"{"type":"busy"}"#, 75, "busy"),
        (r#"{"type":"ending"}"#, 75, "ending"),
        (
            r#"{"type":"failed","capture":"a-0001","reason":"camera c03: away"}"#,
            1,
            "c03",
        ),
        (
            r#"{"type":"refused","reason":"the disk is full"}"#,
            1,
            "full",
        ),
        (
            r#"{"type":"durable","capture":"a-0001","recording":"/a.mcap"}"#,
            0,
            "durable",
        ),
    ] {
        let daemon = answering(&desk, "trigger", answer);
        hold(&desk, "trigger --socket s.sock", code, &[word]);
        daemon.join().unwrap();
    }
}

#[test]
fn settings_that_make_another_model_replace_nothing_unasked() {
    let desk = Desk::new();
    let line = "replay ball.mcap -q --capture ball-000 --set hull.resolution";
    hold(&desk, &format!("{line}=40"), 0, &[]);
    hold(
        &desk,
        &format!("{line}=50"),
        1,
        &["other inputs or settings", "--force", "--out"],
    );
    hold(&desk, &format!("{line}=50 --out other"), 0, &[]);
    hold(
        &desk,
        "evaluate out/ball/ball-000 other/ball/ball-000",
        0,
        &["accuracy"],
    );
}

#[test]
fn a_calibration_with_another_focal_length_is_told_with_the_volume() {
    let desk = Desk::new();
    hold(&desk, "info ball.mcap --calibration good.toml", 0, &[]);
    let text = std::fs::read_to_string(desk.path("good.toml")).unwrap();
    // As if somebody had written a thousandth of it.
    let shortened = |line: &str| match line.starts_with("focal_px = ") {
        true => "focal_px = [1.5, 1.5]".to_owned(),
        false => line.to_owned(),
    };
    let lines: Vec<String> = text.lines().map(shortened).collect();
    std::fs::write(desk.path("short.toml"), lines.join("\n")).unwrap();
    let said = hold(
        &desk,
        "replay ball.mcap --calibration short.toml",
        1,
        &["a pixel of camera c0", "check the focal lengths"],
    );
    let digits = said
        .split(|c: char| !c.is_ascii_digit())
        .map(str::len)
        .max();
    assert!(digits < Some(15), "{said}");
}

#[test]
fn a_replay_that_a_person_stops_says_how_to_go_on() {
    let desk = Desk::new();
    #[rustfmt::skip]
    desk.done(&[
        "simulate", "--shape", "ball", "--cameras", "5", "--size", "320x240", "--masks", "--depth-cameras", "0",
        "--captures", "4", "--out", "many.mcap",
    ]);
    let mut child = std::process::Command::new(assert_cmd::cargo::cargo_bin("scand"))
        .args(["replay", "many.mcap"])
        .current_dir(desk.path("."))
        .stdout(std::process::Stdio::null())
        .stderr(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    // The first model is complete when its folder has its name.
    while !desk.path("out/many/ball-000").exists() {
        assert!(
            child.try_wait().unwrap().is_none(),
            "it ends after the models"
        );
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    let stopped = std::process::Command::new("kill")
        .args(["-INT", &child.id().to_string()])
        .status();
    assert!(stopped.unwrap().success());
    let output = child.wait_with_output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(130), "{said}");
    assert!(
        said.contains("stopped after ") && said.contains("run the same command again"),
        "{said}"
    );
    let again = hold(&desk, "replay many.mcap", 0, &["unchanged"]);
    assert!(again.contains("done"), "{again}");
}

#[test]
fn every_line_of_the_readme_that_begins_with_cargo_is_a_command_line() {
    use clap::Parser;
    let readme = include_str!("../../README.md");
    let prefix = "cargo run --release -- ";
    let lines: Vec<&str> = readme
        .lines()
        .filter_map(|line| line.trim().strip_prefix(prefix))
        .collect();
    assert!(lines.len() >= 3, "{lines:?}");
    for line in lines {
        let words = std::iter::once("scand").chain(line.split(' '));
        let parsed = scand::commands::Cli::try_parse_from(words.clone());
        assert!(parsed.is_ok(), "{line}: {}", parsed.unwrap_err());
        for file in words.filter(|word| word.starts_with("recordings/")) {
            let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
            assert!(root.join(file).is_file(), "{file}");
        }
    }
}

#[test]
fn a_status_that_is_not_understood_is_no_empty_table() {
    let desk = Desk::new();
    for (answer, code, word) in [
        (
            r#"{"type":"status","status":{"session":"a","cameras":[{"id":"c00"}]}}"#,
            1,
            "this scand cannot read the daemon's reply",
        ),
        (
            r#"{"type":"status","status":{"calibration_age_h":30.0,"cameras":{"c00":{"state":"ready"}}}}"#,
            0,
            "calibrated 1 day ago",
        ),
    ] {
        let daemon = answering(&desk, "status", answer);
        hold(&desk, "status --socket s.sock", code, &[word]);
        daemon.join().unwrap();
    }
}

#[test]
fn one_file_configures_the_rig_and_the_replay() {
    let desk = Desk::new();
    let config = concat!(env!("CARGO_MANIFEST_DIR"), "/config/rig.toml");
    #[rustfmt::skip]
    desk.done(&["replay", "ball.mcap", "-q", "--config", config, "--set", "hull.resolution=40"]);
    assert!(desk.path("out/ball/ball-001/model.glb").is_file());
}

#[test]
fn a_damaged_recording_is_never_called_packed() {
    let desk = Desk::new();
    let told = desk.done(&["pack", "ball.mcap", "--json"]);
    let line: serde_json::Value = serde_json::from_str(&told).unwrap();
    assert_eq!(line["result"], "packed", "{told}");
    assert!(
        line["bytes_after"].as_u64() < line["bytes_before"].as_u64(),
        "{told}"
    );
    hold(&desk, "pack ball.mcap", 0, &["is already packed"]);
    assert_eq!(desk.done(&["pack", "ball.mcap", "-q"]), "");
    let mut packed = std::fs::read(desk.path("ball.mcap")).unwrap();
    let middle = packed.len() / 2;
    packed[middle] ^= 4;
    std::fs::write(desk.path("ball.mcap"), &packed).unwrap();
    let said = hold(
        &desk,
        "pack ball.mcap --quiet",
        1,
        &["Copy it again", "was left unchanged"],
    );
    assert!(!said.contains("already packed"), "{said}");
    assert!(std::fs::read(desk.path("ball.mcap")).unwrap() == packed);
}

#[test]
fn a_capture_whose_frames_are_lost_is_not_complete() {
    let desk = Desk::new();
    let whole = std::fs::read(desk.path("ball.mcap")).unwrap();
    let mut seen = [0; 2];
    for tenths in 2..10 {
        std::fs::write(desk.path("cut.mcap"), &whole[..whole.len() * tenths / 10]).unwrap();
        let output = desk.run(&["info", "cut.mcap", "--json"]);
        let info: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        for capture in info["captures"].as_array().unwrap() {
            let has_frames = capture["color_frames"] != 0;
            seen[usize::from(has_frames)] += 1;
            assert_eq!(capture["failure"].is_null(), has_frames, "{capture}");
        }
    }
    println!("shown: captures without and with frames: {seen:?}");
    assert!(seen.iter().all(|count| *count > 0), "{seen:?}");
}

#[test]
fn lengths_of_the_command_line_may_have_any_unit() {
    let desk = Desk::with_a_model();
    let model = "out/ball/ball-000";
    let told = ["2", "2mm", "0.2cm", "0.002m"].map(|length| {
        let output = desk.done(&["evaluate", model, model, "--floor-mm", length, "--json"]);
        let same = desk.run(&["diff", model, model, "--tolerance-mm", length]);
        assert!(same.status.success(), "{same:?}");
        output
    });
    assert!(told.iter().all(|text| *text == told[0]), "{told:?}");
    let inch = desk.done(&["evaluate", model, model, "--floor-mm", "1in", "--json"]);
    assert_eq!(
        inch,
        desk.done(&["evaluate", model, model, "--floor-mm", "25.4", "--json"])
    );
    assert_ne!(inch, told[0]);
}

#[test]
fn nothing_is_left_of_a_recording_that_is_not_there() {
    let desk = Desk::new();
    hold(&desk, "replay absent.mcap", 1, &["absent.mcap"]);
    assert!(!desk.path("out").exists());
    hold(
        &desk,
        "replay absent.mcap ball.mcap --set hull.resolution=40 -q",
        3,
        &["absent.mcap"],
    );
    assert!(desk.path("out/ball").is_dir() && !desk.path("out/absent").exists());
}

#[test]
fn a_file_that_cannot_be_written_is_found_before_the_work() {
    let desk = Desk::new();
    std::fs::write(desk.path("file"), "").unwrap();
    let simulate = "simulate --shape ball --out new.mcap";
    for (line, option) in [
        (format!("{simulate} --truth file/t.ply"), "--truth"),
        (
            format!("{simulate} --poses upright --poses-truth file/p.json"),
            "--poses-truth",
        ),
        (
            "calibrate ball.mcap --report file/r.html".into(),
            "--report",
        ),
        (
            "calibrate ball.mcap --kalibr file/k.yaml".into(),
            "--kalibr",
        ),
        ("calibrate ball.mcap --ros file/ros".into(), "--ros"),
    ] {
        hold(&desk, &line, 1, &["file", "nothing was", option]);
    }
    assert!(!desk.path("new.mcap").exists());
    hold(
        &desk,
        "board --kind checkerboard --square 25 -o b.pdf",
        2,
        &["25mm"],
    );
    assert!(!desk.path("b.pdf").exists());
}

#[test]
fn of_several_recordings_one_that_cannot_be_read_has_a_line_too() {
    let desk = Desk::new();
    std::fs::write(desk.path("bad.mcap"), "no recording").unwrap();
    let output = desk.run(&["info", "--json", "bad.mcap", "ball.mcap"]);
    assert_eq!(output.status.code(), Some(3));
    let lines = String::from_utf8(output.stdout).unwrap();
    let lines: Vec<serde_json::Value> = lines
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    assert_eq!(lines[0]["file"], "bad.mcap");
    assert!(lines[0]["error"].as_str().unwrap().contains("bad.mcap"));
    assert_eq!(lines[1]["captures"].as_array().unwrap().len(), 2);
    assert_eq!(desk.run(&["info", "bad.mcap"]).status.code(), Some(1));
}
