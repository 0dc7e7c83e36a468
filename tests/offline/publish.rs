//! `scand publish`: what is in the folder, what stays out of it, and that no text of a recording becomes markup.

use super::desk::{Desk, files, said};
use scand::description::Description;
use scand::export::{describe, read};
use serde_json::{Value, json};
use std::path::Path;

/// Texts as a recording from elsewhere may have them.
const MARKUP: &str = "\"><img src=x onerror=alert(1)><script>alert(2)</script>";

/// A desk with a model whose description has every name, each with markup in it.
fn desk_with_a_hostile_model() -> Desk {
    let desk = Desk::with_a_model();
    let model = desk.path("out/ball/ball-000/model.glb");
    let found = read(&model).unwrap();
    let text = |name: &str| Some(format!("{name} {MARKUP}"));
    let about = Description {
        subject: text("number"),
        title: text("title"),
        operator: text("Zacharias"),
        project: text("project"),
        rights: text("rights"),
        session: text("session"),
        rig: text("serial-4711"),
        ..found.about
    };
    std::fs::write(&model, describe(&found.bytes, &about).unwrap()).unwrap();
    let report = desk.path("out/ball/ball-000/report.json");
    let mut parsed: Value = serde_json::from_slice(&std::fs::read(&report).unwrap()).unwrap();
    parsed["recording"] = format!("/home/zacharias/{MARKUP}.mcap").into();
    parsed["verdict"]["reasons"] =
        json!([{ "level": "amber", "code": "skew", "words": format!("camera 4711 {MARKUP}") }]);
    parsed["notes"] = json!({ "decision": null, "said": [
        { "time_ns": "1", "kind": "text", "text": format!("Beatrix {MARKUP}"), "author": "Zacharias" },
    ] });
    std::fs::write(&report, parsed.to_string()).unwrap();
    desk
}

/// The values of `src` and `href` in a page.
fn addresses(page: &str) -> Vec<&str> {
    let after = [" src=\"", " href=\""]
        .into_iter()
        .flat_map(|mark| page.split(mark).skip(1));
    after.filter_map(|rest| rest.split('"').next()).collect()
}

#[test]
fn a_published_folder_is_whole_and_the_same_again() {
    let desk = desk_with_a_hostile_model();
    let line = [
        "publish",
        "out",
        "--address",
        "https://museum.example/3d",
        "-o",
    ];
    let told = desk.done(&[&line[..], &["site"]].concat());
    assert!(told.contains("1 object"), "{told}");
    let site = files(&desk.path("site"));
    let page = site
        .keys()
        .find(|name| name.ends_with("/index.html"))
        .unwrap()
        .clone();
    let place = page.strip_suffix("index.html").unwrap();
    for name in [
        "high.glb",
        "picture.jpg",
        "thumbnail.jpg",
        "scene.svx.json",
        "manifest.json",
    ] {
        assert!(
            site.contains_key(&format!("{place}{name}")),
            "{name}: {:?}",
            site.keys()
        );
    }
    for (name, bytes) in site.iter().filter(|(name, _)| name.ends_with(".html")) {
        let page = String::from_utf8(bytes.clone()).unwrap();
        for address in addresses(&page) {
            assert!(!address.contains("//"), "{name}: {address}");
            let folder = Path::new(name).parent().unwrap();
            let target = desk.path("site").join(folder).join(address);
            assert!(target.is_file(), "{name}: {address}");
        }
    }
    let manifest: Value = serde_json::from_slice(&site[&format!("{place}manifest.json")]).unwrap();
    let expected = format!("https://museum.example/3d/{place}high.glb");
    assert_eq!(manifest["rendering"][0]["id"], expected);
    desk.done(&[&line[..], &["again"]].concat());
    assert!(
        files(&desk.path("again")) == site,
        "the same models make the same folder"
    );
    if !cfg!(feature = "page") {
        assert!(
            told.contains("no viewer") && told.contains("make deb"),
            "{told}"
        );
        assert!(!site.contains_key("viewer.js"));
    }
}

#[test]
fn names_notes_and_serial_numbers_stay_out_and_nothing_is_markup() {
    let desk = desk_with_a_hostile_model();
    let hidden = [
        "Zacharias",
        "Beatrix",
        "4711",
        "/home",
        "project ",
        "session ",
        "ball-000",
    ];
    desk.done(&[
        "publish",
        "out",
        "-o",
        "site",
        "-a",
        "https://museum.example",
    ]);
    for (name, bytes) in files(&desk.path("site"))
        .iter()
        .filter(|(name, _)| *name != "viewer.js")
    {
        let text = String::from_utf8_lossy(bytes);
        for word in hidden {
            assert!(!text.contains(word), "{name}: {word}");
            assert!(!name.contains(word), "{name}");
        }
    }
    desk.done(&[
        "publish",
        "out",
        "-o",
        "all",
        "--with",
        "operator,session,project,rig,notes,reasons",
        "-t",
        MARKUP,
    ]);
    let all = files(&desk.path("all"));
    let mut shown = String::new();
    for (name, bytes) in all
        .iter()
        .filter(|(name, _)| name.ends_with(".html") || name.ends_with("json"))
    {
        let text = String::from_utf8(bytes.clone()).unwrap();
        for tag in ["<img src=x", "<script>"] {
            assert!(!text.contains(tag), "{name}: {tag}");
        }
        shown += &text;
    }
    for word in hidden.into_iter().filter(|word| *word != "/home") {
        assert!(shown.contains(word), "{word} was named");
    }
    assert!(!shown.contains("/home"), "a path is never published");
}

#[test]
fn rejected_captures_and_foreign_folders_are_left_alone() {
    let desk = Desk::new();
    #[rustfmt::skip]
    desk.done(&["replay", "ball.mcap", "--set", "hull.resolution=40", "-q"]);
    // The note is newer than the report, and only beside the recording.
    desk.done(&["note", "ball-001", "reject", "--recording", "ball.mcap"]);
    let told = desk.done(&["publish", "out", "-o", "site"]);
    assert!(
        told.contains("ball-001") && told.contains("rejected"),
        "{told}"
    );
    assert!(
        told.contains("1 object") && told.contains("--address"),
        "{told}"
    );
    let told = desk.done(&["publish", "out", "-o", "both", "--rejected"]);
    assert!(told.contains("2 objects"), "{told}");
    for (line, code, words) in [
        ("publish out -o site", 1, "--force"),
        (
            "publish out -o other --force",
            1,
            "was not published by scand",
        ),
        ("publish out out -o twice", 2, "named before"),
        (
            "publish out -o x --with operater",
            2,
            "did you mean operator?",
        ),
        (
            "publish out -o x --address museum",
            2,
            "https://museum.example/3d",
        ),
        ("publish ball.mcap -o x", 1, "scand replay"),
    ] {
        std::fs::create_dir_all(desk.path("other/precious")).unwrap();
        let output = desk.run(&line.split(' ').collect::<Vec<_>>());
        let said = said(&output);
        assert_eq!(output.status.code(), Some(code), "{line}: {said}");
        assert!(said.contains(words), "{line}: {said}");
        assert!(desk.path("other/precious").is_dir());
        assert!(
            !desk.path("x").exists() && !desk.path("twice").exists(),
            "{line}"
        );
    }
    desk.done(&["publish", "out", "-o", "site", "--force", "--rejected"]);
    assert_eq!(
        std::fs::read_dir(desk.path("site/objects"))
            .unwrap()
            .count(),
        2
    );
}
