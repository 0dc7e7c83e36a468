//! Tests packages for archives: what `scand archive` puts into one, and what `scand verify` says about it.

use super::desk::{Desk, files};
use serde_json::Value;
use std::collections::BTreeSet;

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
fn objects_are_found_by_the_number_of_the_press_or_else_of_the_session() {
    let desk = Desk::new();
    #[rustfmt::skip]
    desk.done(&[
        "simulate", "--shape", "ball", "--cameras", "5", "--size", "160x120", "--masks", "--depth-cameras", "0",
        "--subject", "17", "--out", "pot.mcap",
    ]);
    let session = [("name", "monday"), ("subject", "1884.3")];
    desk.tell("ball.mcap", &session);
    desk.tell("pot.mcap", &session);
    let info = desk.done(&["info", "ball.mcap"]);
    assert!(info.contains("ball-001 of object 1884.3 at 2026"), "{info}");
    let found = |number: &str| {
        desk.done(&["archive", number, "-o", number]);
        files(&desk.path(number))
    };
    // The press of the other recording named another object than its session.
    let [of_session, of_press] = ["1884.3", "17"].map(found);
    for (package, inside, outside, number) in [
        (of_session, "ball", "pot", "1884.3"),
        (of_press, "pot", "ball", "17"),
    ] {
        assert!(package.contains_key(&format!("data/recordings/{inside}.mcap")));
        assert!(!package.contains_key(&format!("data/recordings/{outside}.mcap")));
        let about = String::from_utf8_lossy(&package["bag-info.txt"]);
        let identifiers: Vec<&str> = about
            .lines()
            .filter_map(|line| line.strip_prefix("External-Identifier: "))
            .collect();
        assert_eq!(identifiers, [number]);
        let sheet = &package[&format!("data/paradata/{inside}/ball-000.json")];
        let sheet: Value = serde_json::from_slice(sheet).unwrap();
        assert_eq!(sheet["object"]["number"], number);
    }
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
    let capture = files(&desk.path("capture"));
    assert!(capture.contains_key("data/models/ball/ball-000/model.glb"));
    // Named beside its recording, it is named too.
    desk.done(&["archive", "ball.mcap", "ball-000", "-o", "both"]);
    assert!(files(&desk.path("both")).contains_key("data/models/ball/ball-000/model.glb"));
    // The model was made before the note: the copy in the package says what is known now.
    let name = |file: &str| format!("data/models/ball/ball-000/{file}");
    let report: Value = serde_json::from_slice(&capture[&name("report.json")]).unwrap();
    assert_eq!(report["notes"]["decision"], "rejected");
    let kept = |file: &str| std::fs::read(desk.path("out/ball/ball-000").join(file)).unwrap();
    assert!(capture[&name("preview.png")] != kept("preview.png"));
    assert!(capture[&name("model.glb")] == kept("model.glb"));
    let report: Value = serde_json::from_slice(&kept("report.json")).unwrap();
    assert_eq!(
        report["notes"]["decision"],
        Value::Null,
        "the model itself stays as it was"
    );
    assert!(desk.run(&["verify", "capture"]).status.success());
}

#[test]
fn the_report_of_a_failure_is_no_model() {
    let desk = Desk::new();
    let folder = desk.path("out/ball/ball-000");
    std::fs::create_dir_all(&folder).unwrap();
    let report =
        r#"{"version":1,"reason":"the memory was not enough","capture":{"id":"ball-000"}}"#;
    std::fs::write(folder.join("report.json"), report).unwrap();
    let told = desk.done(&["archive", "ball-000", "-o", "bag"]);
    assert!(
        told.contains("could not be made (the memory was not enough)"),
        "{told}"
    );
    let bag = files(&desk.path("bag"));
    assert!(!bag.keys().any(|name| name.starts_with("data/models")));
    let sheet: Value = serde_json::from_slice(&bag["data/paradata/ball/ball-000.json"]).unwrap();
    assert_eq!(sheet["processing"]["method"], "no model is in the package");
    assert_eq!(sheet["data"]["models"], Value::Null);
}

#[test]
fn captures_of_an_open_session_are_named() {
    let desk = Desk::with_a_model();
    let bytes = std::fs::read(desk.path("ball.mcap")).unwrap();
    std::fs::write(desk.path("late.mcap.part"), &bytes[..bytes.len() - 9]).unwrap();
    let output = desk.run(&["archive", "ball-000", "-o", "bag"]);
    let told = super::desk::said(&output);
    assert_eq!(output.status.code(), Some(3), "{told}");
    assert!(
        told.contains("late.mcap.part has 1 capture of them") && told.contains("scand recover"),
        "{told}"
    );
    assert!(desk.run(&["verify", "bag"]).status.success());
    // Another recording's names mean nothing in it.
    desk.tell("ball.mcap", &[("name", "monday")]);
    desk.done(&["archive", "monday", "-o", "session"]);
    std::fs::remove_file(desk.path("ball.mcap")).unwrap();
    let output = desk.run(&["archive", "ball-000", "-o", "none"]);
    let told = super::desk::said(&output);
    assert_eq!(output.status.code(), Some(1), "{told}");
    assert!(
        told.contains("late.mcap.part has 1 capture of them"),
        "{told}"
    );
    let output = desk.run(&["archive", "late", "-o", "none", "--date", "2026-99-99"]);
    let told = super::desk::said(&output);
    assert_eq!(output.status.code(), Some(2), "{told}");
    assert!(told.contains("no such day"), "{told}");
}

/// The parameters that `docs/formats.md` lists in the section of this heading: `section.name`.
fn documented(heading: &str) -> BTreeSet<String> {
    let page = include_str!("../../docs/formats.md");
    let (_, after) = page.split_once(heading).expect(heading);
    let section = after.split("\n#").next().unwrap();
    let rows = section.lines().filter_map(|line| line.strip_prefix("| `"));
    let mut found = BTreeSet::new();
    for row in rows {
        let (section, rest) = row.split_once('`').unwrap();
        let names = rest.split('|').nth(1).unwrap();
        found.extend(
            names
                .split('`')
                .skip(1)
                .step_by(2)
                .map(|name| format!("{section}.{name}")),
        );
    }
    found
}

fn parameters(sheet: &Value) -> BTreeSet<String> {
    let sections = sheet.as_object().unwrap().iter();
    let of = |(section, values): (&String, &Value)| {
        let names = values.as_object().into_iter().flatten();
        names
            .map(|(name, _)| format!("{section}.{name}"))
            .collect::<Vec<_>>()
    };
    sections
        .filter(|(section, _)| *section != "other_pairs")
        .flat_map(of)
        .collect()
}

#[test]
fn the_sheet_has_each_parameter_and_what_the_session_says_of_it() {
    let desk = Desk::with_a_model();
    let pairs = [
        ("name", "monday"),
        ("lighting", "two D65 panels"),
        ("temperature", "21 °C"),
        ("humidity", "45 %"),
        ("location", "store 3"),
        ("condition", "a crack in the base"),
        ("material", "clay"),
        ("dimensions", "8 cm"),
        ("purpose", "loan"),
        ("conservator", "Ben <b>"),
    ];
    desk.tell("ball.mcap", &pairs);
    desk.done(&["archive", "ball-000", "-o", "bag"]);
    let bag = files(&desk.path("bag"));
    let sheet: Value = serde_json::from_slice(&bag["data/paradata/ball/ball-000.json"]).unwrap();
    for (section, key) in [
        ("environment", "lighting"),
        ("environment", "temperature"),
        ("environment", "humidity"),
        ("environment", "location"),
        ("object", "condition"),
        ("object", "material"),
        ("object", "dimensions"),
        ("purpose", "purpose"),
        ("other_pairs", "conservator"),
    ] {
        let expected = pairs.iter().find(|pair| pair.0 == key).unwrap().1;
        assert_eq!(sheet[section][key], expected, "{section}.{key}");
    }
    assert_eq!(
        sheet["other_pairs"].get("lighting"),
        None,
        "each pair has one place"
    );
    assert_eq!(parameters(&sheet), documented("### Sheets of paradata"));
    let page = String::from_utf8_lossy(&bag["data/paradata/ball/ball-000.html"]);
    assert!(page.contains("Ben &lt;b&gt;") && page.contains("two D65 panels"));
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

#[test]
fn a_package_says_of_each_model_whether_it_was_made_of_its_recording() {
    let desk = Desk::with_a_model();
    let sheet = |package: &str| -> Value {
        let path = desk.path(package).join("data/paradata/ball/ball-000.json");
        serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
    };
    let told = desk.done(&["archive", "ball-000", "-o", "same"]);
    assert!(!told.contains("made from"), "{told}");
    let input = sheet("same")["processing"]["input"].clone();
    assert!(input.as_str().unwrap().contains("digest was compared"));
    // The calibration with which a model was made is not that of the recording.
    desk.done(&["info", "ball.mcap", "--calibration", "other.toml"]);
    let text = std::fs::read_to_string(desk.path("other.toml")).unwrap();
    let start = text.find("center_px = [").unwrap() + "center_px = [".len();
    let end = start + text[start..].find(',').unwrap();
    let moved = text[start..end].parse::<f64>().unwrap() + 0.25;
    let text = format!("{}{moved:?}{}", &text[..start], &text[end..]);
    std::fs::write(desk.path("other.toml"), text).unwrap();
    #[rustfmt::skip]
    desk.done(&[
        "replay", "ball.mcap", "--capture", "ball-000", "--set", "hull.resolution=40", "-q", "--force",
        "--calibration", "other.toml",
    ]);
    let told = desk.done(&["archive", "ball-000", "-o", "calibrated"]);
    assert!(told.contains("with another calibration"), "{told}");
    let input = sheet("calibrated")["processing"]["input"].clone();
    assert!(input.as_str().unwrap().contains("another calibration"));
    // A model of a capture that has the same name in another recording.
    let report = "out/ball/ball-000/report.json";
    let text = std::fs::read_to_string(desk.path(report)).unwrap();
    let time = "\"time_ns\": \"";
    let at = text.find(time).unwrap() + time.len();
    let text = format!("{}9{}", &text[..at], &text[at + 1..]);
    std::fs::write(desk.path(report), text).unwrap();
    let told = desk.done(&["archive", "ball-000", "-o", "foreign"]);
    assert!(told.contains("of another recording"), "{told}");
    let foreign = files(&desk.path("foreign"));
    assert!(!foreign.keys().any(|name| name.starts_with("data/models")));
    assert_eq!(
        sheet("foreign")["processing"]["method"],
        "no model is in the package"
    );
}

/// Makes a model of both captures, which lie in the same way.
fn fuse(desk: &Desk) {
    let pose = "[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]";
    let poses = format!("{{\"rig_from_object\":[{pose},{pose}]}}");
    std::fs::write(desk.path("poses.json"), poses).unwrap();
    #[rustfmt::skip]
    desk.done(&[
        "fuse", "ball.mcap", "--capture", "ball-000", "--capture", "ball-001", "--poses", "poses.json",
        "--set", "hull.resolution=40", "-q",
    ]);
}

#[test]
fn a_model_of_several_captures_goes_with_them() {
    let desk = Desk::new();
    fuse(&desk);
    let model = "data/models/ball/ball-000.object/model.glb";
    desk.done(&["archive", "ball", "-o", "both"]);
    let both = files(&desk.path("both"));
    assert!(both.contains_key(model));
    let sheet = &both["data/paradata/ball/ball-000.object.json"];
    let sheet: Value = serde_json::from_slice(sheet).unwrap();
    assert_eq!(sheet["captures"][1]["id"], "ball-001");
    assert_eq!(sheet["data"]["models"], "models/ball/ball-000.object");
    assert!(sheet["how_exact"]["verdict"]["level"].is_string());
    assert!(both.contains_key("data/paradata/ball/ball-000.object.html"));
    assert_eq!(
        parameters(&sheet),
        documented("#### Models of several captures")
    );
    let told = desk.done(&["archive", "ball-001", "-o", "one"]);
    assert!(
        told.contains("does not have ball-000 of ball.mcap"),
        "{told}"
    );
    assert!(!files(&desk.path("one")).contains_key(model));
    // Beside the models of its captures it has a name and a page of its own.
    desk.done(&["replay", "ball.mcap", "--set", "hull.resolution=40", "-q"]);
    desk.done(&["export", "out", "--format", "stl"]);
    for name in ["ball-000", "ball-001", "ball-000.object"] {
        let file = desk.path("export").join(format!("{name}.stl"));
        assert!(file.is_file(), "{}", file.display());
    }
    let told = desk.done(&["publish", "out", "-o", "site"]);
    assert!(told.contains("3 objects"), "{told}");
    // What is made of a rejected capture is not published, either.
    desk.done(&["note", "ball-001", "reject", "--recording", "ball.mcap"]);
    let told = desk.done(&["publish", "out", "-o", "fewer"]);
    assert!(told.contains("1 object;"), "{told}");
    let told = desk.done(&["publish", "out", "-o", "blind", "--recordings", "site"]);
    assert!(
        told.contains("were not read, because the folder site does not have ball.mcap"),
        "{told}"
    );
}

#[test]
fn a_link_leads_nothing_into_a_package() {
    let desk = Desk::with_a_model();
    std::fs::write(desk.path("secret"), "the secret").unwrap();
    let link = |name: &str| {
        let _ = std::fs::remove_file(desk.path(name));
        std::os::unix::fs::symlink(desk.path("secret"), desk.path(name)).unwrap();
    };
    link("ball.notes.jsonl");
    link("out/ball/ball-000/model.ply");
    let packed = |name: &str| {
        let output = desk.run(&["archive", "ball-000", "-o", name]);
        assert_eq!(output.status.code(), Some(3), "{output:?}");
        for (name, bytes) in files(&desk.path(name)) {
            assert!(!bytes.ends_with(b"the secret"), "{name}");
        }
        super::desk::said(&output)
    };
    let told = packed("one");
    for name in ["ball.notes.jsonl", "model.ply"] {
        assert!(told.contains(&format!("{name}: it is a link")), "{told}");
    }
    assert!(files(&desk.path("one")).contains_key("data/models/ball/ball-000/model.glb"));
    link("out/ball/ball-000/model.glb");
    let told = packed("two");
    assert!(told.contains("out/ball/ball-000 is a link"), "{told}");
    assert!(desk.run(&["verify", "two"]).status.success());
}

#[test]
fn a_preview_that_cannot_be_marked_keeps_nothing_else_out() {
    let desk = Desk::with_a_model();
    desk.done(&["note", "ball-000", "accept", "--recording", "ball.mcap"]);
    let preview = desk.path("out/ball/ball-000/preview.png");
    let picture = std::fs::read(&preview).unwrap();
    let name = |file: &str| format!("data/models/ball/ball-000/{file}");
    let packed = |package: &str, words: &str| {
        let output = desk.run(&["archive", "ball-000", "-o", package]);
        let told = super::desk::said(&output);
        assert_eq!(output.status.code(), Some(3), "{told}");
        assert!(
            told.contains(&format!("preview.png: {words}")) && told.contains("does not have it"),
            "{told}"
        );
        let bag = files(&desk.path(package));
        assert!(!bag.contains_key(&name("preview.png")));
        assert!(bag.contains_key(&name("model.glb")));
        let report: Value = serde_json::from_slice(&bag[&name("report.json")]).unwrap();
        assert_eq!(report["notes"]["decision"], "accepted");
        assert!(desk.run(&["verify", package]).status.success());
    };
    std::fs::write(&preview, &picture[..picture.len() / 2]).unwrap();
    packed("damaged", "it cannot be marked with the notes");
    // The link leads to a picture that could be marked.
    std::fs::write(desk.path("elsewhere.png"), &picture).unwrap();
    std::fs::remove_file(&preview).unwrap();
    std::os::unix::fs::symlink(desk.path("elsewhere.png"), &preview).unwrap();
    packed("linked", "it is a link");
}

#[test]
fn a_recording_that_cannot_be_read_hides_no_other_and_is_told() {
    let desk = Desk::new();
    std::fs::write(desk.path("another.mcap"), "#ROSBAG V2.0\n").unwrap();
    let output = desk.run(&["archive", "ball-000", "-o", "bag"]);
    let told = super::desk::said(&output);
    assert_eq!(output.status.code(), Some(3), "{told}");
    assert!(
        told.contains("a recording was skipped, because it cannot be read: ./another.mcap")
            && told.contains("ROS bag"),
        "{told}"
    );
    assert!(desk.run(&["verify", "bag"]).status.success());
    let output = desk.run(&["archive", "1884.3", "-o", "none"]);
    let told = super::desk::said(&output);
    assert_eq!(output.status.code(), Some(1), "{told}");
    assert!(told.contains("another.mcap"), "{told}");
    // Nothing to keep is no package.
    std::fs::write(desk.path("magic.mcap"), b"\x89MCAP0\r\n").unwrap();
    let output = desk.run(&["archive", "magic.mcap", "-o", "empty"]);
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    assert!(!desk.path("empty").exists());
}

/// Packs the model of `ball-000`, which is not whole: it must stay out, and be told with these words.
fn is_left_out(desk: &Desk, package: &str, words: &[&str]) {
    let output = desk.run(&["archive", "ball-000", "-o", package]);
    let told = super::desk::said(&output);
    assert_eq!(output.status.code(), Some(3), "{package}: {told}");
    for words in words {
        assert!(told.contains(words), "{package}: {words}: {told}");
    }
    let bag = files(&desk.path(package));
    assert!(!bag.keys().any(|name| name.starts_with("data/models")));
    let sheet: Value = serde_json::from_slice(&bag["data/paradata/ball/ball-000.json"]).unwrap();
    assert_eq!(sheet["processing"]["method"], "no model is in the package");
    assert!(desk.run(&["verify", package]).status.success());
}

#[test]
fn a_model_that_cannot_be_read_or_contradicts_its_report_is_left_out() {
    let desk = Desk::with_a_model();
    #[rustfmt::skip]
    desk.done(&["replay", "ball.mcap", "--capture", "ball-001", "--set", "hull.resolution=40", "-q"]);
    let folder = desk.path("out/ball/ball-000");
    let [glb, ply, report] = ["model.glb", "model.ply", "report.json"].map(|f| folder.join(f));
    let kept = [&glb, &ply, &report].map(|path| (path.clone(), std::fs::read(path).unwrap()));
    let restore = || {
        for (path, bytes) in &kept {
            std::fs::write(path, bytes).unwrap();
        }
    };
    for (path, file) in [(&glb, "model.glb: "), (&ply, "model.ply: ")] {
        let bytes = std::fs::read(path).unwrap();
        std::fs::write(path, &bytes[..bytes.len() / 2]).unwrap();
        let package = format!("short-{}", &file[6..9]);
        is_left_out(&desk, &package, &[file, "the model is left out"]);
        restore();
        std::fs::copy(desk.path("out/ball/ball-001").join(&file[..9]), path).unwrap();
        let package = format!("foreign-{}", &file[6..9]);
        let words = [file, "its capture is \"ball-001\", expected \"ball-000\""];
        is_left_out(&desk, &package, &words);
        restore();
    }
    let changed = |from: &str, to: &str| {
        let text = std::fs::read_to_string(&report).unwrap();
        assert!(text.contains(from), "{from}");
        std::fs::write(&report, text.replacen(from, to, 1)).unwrap();
    };
    changed("\"triangles\": ", "\"triangles\": 1");
    is_left_out(
        &desk,
        "counted",
        &["model.glb: it has ", " triangles, expected 1"],
    );
    restore();
    changed("\"input_sha256\": \"", "\"input_sha256\": \"0");
    is_left_out(&desk, "digested", &["model.glb: its input_sha256 is "]);
    restore();
    // As it was, it is packed.
    let told = desk.done(&["archive", "ball-000", "-o", "whole"]);
    assert!(!told.contains("left out"), "{told}");
    assert!(files(&desk.path("whole")).contains_key("data/models/ball/ball-000/model.ply"));
}

#[test]
fn a_folder_with_a_part_of_a_model_is_not_called_empty() {
    let desk = Desk::with_a_model();
    let folder = desk.path("out/ball/ball-000");
    for name in ["model.glb", "model.ply", "report.json"] {
        let bytes = std::fs::read(folder.join(name)).unwrap();
        std::fs::remove_file(folder.join(name)).unwrap();
        let words = format!("{name}: the file is missing; the model is left out");
        is_left_out(&desk, &format!("without-{name}"), &[words.as_str()]);
        std::fs::write(folder.join(name), bytes).unwrap();
    }
    let report = std::fs::read(folder.join("report.json")).unwrap();
    for (package, bytes, words) in [
        (
            "torn",
            &report[..report.len() / 2],
            "expected a report in JSON",
        ),
        ("empty", &b"{}"[..], "neither the verdict on a model nor"),
    ] {
        std::fs::write(folder.join("report.json"), bytes).unwrap();
        is_left_out(&desk, package, &["report.json: ", words]);
    }
    std::fs::remove_dir_all(&folder).unwrap();
    std::fs::create_dir(&folder).unwrap();
    let told = desk.done(&["archive", "ball-000", "-o", "nothing"]);
    assert!(told.contains("no model is in out/ball/ball-000"), "{told}");
}

#[test]
fn a_model_of_several_captures_that_is_not_whole_is_left_out() {
    let desk = Desk::new();
    fuse(&desk);
    let folder = desk.path("out/ball/ball-000.object");
    for (file, words) in [
        ("model.glb", "model.glb: the file is missing"),
        ("report.json", "report.json: expected a report in JSON"),
    ] {
        let bytes = std::fs::read(folder.join(file)).unwrap();
        match file {
            "model.glb" => std::fs::remove_file(folder.join(file)).unwrap(),
            _ => std::fs::write(folder.join(file), &bytes[..99]).unwrap(),
        }
        let output = desk.run(&["archive", "ball", "-o", file]);
        let told = super::desk::said(&output);
        assert_eq!(output.status.code(), Some(3), "{told}");
        assert!(told.contains(words), "{told}");
        let end = "the model of several captures is left out";
        assert!(told.contains(end), "{told}");
        let bag = files(&desk.path(file));
        assert!(!bag.keys().any(|name| name.contains("ball-000.object")));
        std::fs::write(folder.join(file), bytes).unwrap();
    }
    desk.done(&["archive", "ball", "-o", "whole"]);
}

#[test]
fn the_sheet_of_a_damaged_recording_says_what_the_terminal_says() {
    let desk = Desk::new();
    let path = desk.path("ball.mcap");
    let mut bytes = std::fs::read(&path).unwrap();
    let at = bytes.len() / 3;
    bytes[at..at + 64].iter_mut().for_each(|byte| *byte ^= 0xff);
    std::fs::write(&path, bytes).unwrap();
    let output = desk.run(&["archive", "ball.mcap", "-o", "bag"]);
    let told = super::desk::said(&output);
    assert_eq!(output.status.code(), Some(3), "{told}");
    let bag = files(&desk.path("bag"));
    let sheets = ["ball-000", "ball-001"].map(|id| -> Value {
        serde_json::from_slice(&bag[&format!("data/paradata/ball/{id}.json")]).unwrap()
    });
    for sheet in &sheets {
        let damage = sheet["data"]["damage"].as_array().unwrap();
        assert!(!damage.is_empty());
        for words in damage {
            assert!(told.contains(words.as_str().unwrap()), "{words}: {told}");
        }
    }
    let unread = sheets
        .iter()
        .map(|sheet| sheet["capture"]["outcome"].as_str().unwrap())
        .filter(|outcome| outcome.starts_with("not all pictures of this capture can be read: "));
    let unread: Vec<&str> = unread.collect();
    assert!(!unread.is_empty(), "{sheets:?}");
    for words in unread {
        assert!(words.contains("damaged at byte"), "{words}");
    }
}

#[test]
fn what_a_recovery_could_not_use_goes_with_its_recording() {
    let desk = Desk::new();
    let bytes = std::fs::read(desk.path("ball.mcap")).unwrap();
    let whole = desk.run(&["archive", "ball.mcap", "-o", "whole"]);
    assert_eq!(whole.status.code(), Some(0), "{whole:?}");
    let sheet = |package: &str, name: &str| -> Value {
        let path = desk
            .path(package)
            .join(format!("data/paradata/{name}/ball-000.json"));
        serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
    };
    assert_eq!(sheet("whole", "ball")["data"]["cut_off"], Value::Null);
    assert_eq!(
        sheet("whole", "ball")["data"]["rescued_bytes"],
        serde_json::json!([])
    );
    std::fs::write(desk.path("cut.mcap.part"), &bytes[..bytes.len() * 3 / 4]).unwrap();
    assert_eq!(
        desk.run(&["recover", "cut.mcap.part"]).status.code(),
        Some(3)
    );
    let tail = std::fs::read(desk.path("cut.mcap.tail")).unwrap();
    assert!(!tail.is_empty());
    let told = desk.done(&["archive", "cut.mcap", "-o", "bag"]);
    assert!(
        told.contains(&format!("cut.mcap.tail: {} bytes", tail.len())),
        "{told}"
    );
    let bag = files(&desk.path("bag"));
    assert!(bag["data/recordings/cut.mcap.tail"] == tail);
    let read_me = String::from_utf8_lossy(&bag["data/README.txt"]);
    assert!(read_me.contains("NAME.mcap.tail"), "{read_me}");
    let data = &sheet("bag", "cut")["data"];
    let rescued = serde_json::json!([{ "file": "recordings/cut.mcap.tail", "bytes": tail.len() }]);
    assert_eq!(data["rescued_bytes"], rescued);
    let words = data["cut_off"].as_str().unwrap();
    assert!(words.contains("scand recover completed"), "{words}");
    let lost: Value = serde_json::from_slice(&bag["data/paradata/cut/ball-001.json"]).unwrap();
    let outcome = lost["capture"]["outcome"].as_str().unwrap();
    assert!(outcome.contains("no frame"), "{outcome}");
    // Where a link leads, nobody knows.
    std::fs::remove_file(desk.path("cut.mcap.tail")).unwrap();
    std::os::unix::fs::symlink("ball.mcap", desk.path("cut.mcap.tail")).unwrap();
    let output = desk.run(&["archive", "cut.mcap", "-o", "linked"]);
    let told = super::desk::said(&output);
    assert_eq!(output.status.code(), Some(3), "{told}");
    assert!(told.contains("cut.mcap.tail: it is a link"), "{told}");
    let words = sheet("linked", "cut")["data"]["cut_off"].clone();
    assert!(words.as_str().unwrap().contains("not all bytes"), "{words}");
}

#[test]
fn a_package_is_called_intact_only_if_lists_vouch_for_all_of_it() {
    let desk = Desk::new();
    desk.done(&["archive", "ball-000", "-o", "bag"]);
    let verified = |code: i32, words: &[&str]| -> Value {
        let output = desk.run(&["verify", "bag"]);
        let told = super::desk::said(&output);
        assert_eq!(output.status.code(), Some(code), "{told}");
        for words in words {
            assert!(told.contains(words), "{words}: {told}");
        }
        assert_eq!(told.contains("intact"), code == 0, "{told}");
        let json = desk.run(&["verify", "bag", "--json"]);
        assert_eq!(json.status.code(), Some(code));
        serde_json::from_slice(&json.stdout).unwrap()
    };
    let line = verified(
        0,
        &["bag: intact: each file that the lists name is as listed ("],
    );
    assert_eq!(line["whole"], true);
    assert_eq!(line["tag_manifest"], true);
    assert_eq!(line["unlisted"], serde_json::json!([]));
    let compared = line["compared"].as_u64().unwrap();
    assert_eq!(compared + 1, files(&desk.path("bag")).len() as u64);
    // More than BagIt asks for is allowed, and nothing vouches for it.
    std::fs::create_dir(desk.path("bag/more")).unwrap();
    std::fs::write(desk.path("bag/more/word.txt"), "trust me").unwrap();
    let extra = "more/word.txt was not checked, because no list has its digest; BagIt allows";
    let line = verified(3, &["each file that the lists name is as listed", extra]);
    assert_eq!(line["whole"], true);
    assert_eq!(line["unlisted"], serde_json::json!(["more/word.txt"]));
    std::fs::remove_dir_all(desk.path("bag/more")).unwrap();
    for name in ["bag-info.txt", "tagmanifest-sha512.txt"] {
        std::fs::remove_file(desk.path("bag").join(name)).unwrap();
    }
    let line = verified(3, &["no tagmanifest-sha512.txt", "no bag-info.txt"]);
    assert_eq!(line["whole"], true);
    assert_eq!(line["tag_manifest"], false);
    // What the lists name is damaged: this counts more.
    std::fs::write(desk.path("bag/data/README.txt"), "").unwrap();
    assert_eq!(
        verified(1, &["data/README.txt was changed"])["whole"],
        false
    );
}

#[test]
fn the_sheet_has_the_name_of_which_the_package_replaces_letters() {
    let desk = Desk::new();
    let name = "Schüssel 17.mcap";
    std::fs::rename(desk.path("ball.mcap"), desk.path(name)).unwrap();
    desk.done(&["archive", name, "-o", "bag"]);
    let bag = files(&desk.path("bag"));
    let is_sheet = |path: &&String| path.ends_with("/ball-000.json");
    let path = bag.keys().find(is_sheet).unwrap();
    assert!(path.is_ascii(), "{path}");
    let sheet: Value = serde_json::from_slice(&bag[path]).unwrap();
    assert_eq!(sheet["data"]["original_file_name"], name);
    let place = sheet["data"]["recording"].as_str().unwrap();
    assert!(bag.contains_key(&format!("data/{place}")), "{place}");
}

#[test]
fn objects_whose_names_become_the_same_keep_a_folder_each() {
    let desk = Desk::new();
    fuse(&desk);
    let made = desk.path("out/ball/ball-000.object");
    let report = std::fs::read_to_string(made.join("report.json")).unwrap();
    for (folder, digest) in [("A%3C.object", "first"), ("A_3C.object", "second")] {
        let folder = desk.path("out/ball").join(folder);
        std::fs::create_dir(&folder).unwrap();
        for file in ["model.glb", "model.ply", "preview.png"] {
            std::fs::copy(made.join(file), folder.join(file)).unwrap();
        }
        let report = report.replacen("\"digest\": \"", &format!("\"digest\": \"{digest} "), 1);
        std::fs::write(folder.join("report.json"), report).unwrap();
    }
    desk.done(&["archive", "ball", "-o", "bag"]);
    let bag = files(&desk.path("bag"));
    for (name, digest) in [("A_3C", "first"), ("A_3C-2", "second")] {
        let path = format!("data/models/ball/{name}.object/report.json");
        let report: Value = serde_json::from_slice(&bag[&path]).unwrap();
        assert!(report["digest"].as_str().unwrap().starts_with(digest));
        let path = format!("data/paradata/ball/{name}.object.json");
        let sheet: Value = serde_json::from_slice(&bag[&path]).unwrap();
        assert_eq!(
            sheet["data"]["models"],
            format!("models/ball/{name}.object")
        );
        assert_eq!(sheet["processing"]["method"]["digest"], report["digest"]);
    }
    assert!(desk.run(&["verify", "bag"]).status.success());
}

#[test]
fn captures_whose_ids_differ_only_in_case_keep_a_folder_each() {
    let desk = Desk::new();
    desk.rename_capture("ball.mcap", "ball-001", "Ball-000");
    desk.done(&["replay", "ball.mcap", "--set", "hull.resolution=40", "-q"]);
    desk.done(&["archive", "ball.mcap", "-o", "bag"]);
    let bag = files(&desk.path("bag"));
    let read = |path: String| -> Value { serde_json::from_slice(&bag[&path]).unwrap() };
    for (name, id) in [("ball-000", "ball-000"), ("Ball-000-2", "Ball-000")] {
        let sheet = read(format!("data/paradata/ball/{name}.json"));
        assert_eq!(sheet["capture"]["id"], id);
        assert_eq!(sheet["data"]["models"], format!("models/ball/{name}"));
        let report = read(format!("data/models/ball/{name}/report.json"));
        assert_eq!(report["description"]["capture"], id);
    }
    // A disk that ignores case would have one file of two.
    let verified = desk.run(&["verify", "bag"]);
    assert!(verified.status.success(), "{verified:?}");
}
