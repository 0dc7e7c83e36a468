//! Which room of `src` may use which: the table that ARCHITECTURE.md refers to, held against the sources.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

/// Each room and the rooms it may use, itself aside.
const ROOMS: &[(&str, &[&str])] = &[
    ("array", &[]),
    ("image", &["array"]),
    ("mesh", &["array", "image"]),
    ("frame", &["image"]),
    ("calibration", &["frame"]),
    (
        "calibration/fit",
        &["calibration", "frame", "image", "statistics"],
    ),
    (
        "calibration/response",
        &["calibration", "image", "statistics"],
    ),
    (
        "calibrate",
        &["calibration", "frame", "image", "job", "recording", "sync"],
    ),
    ("recording", &["frame", "calibration", "image", "storage"]),
    ("clock", &["frame"]),
    ("drivers", &["clock", "frame", "number"]),
    ("sync", &["frame", "number"]),
    (
        "job",
        &[
            "recording",
            "sync",
            "calibration",
            "frame",
            "image",
            "reconstruct",
        ],
    ),
    (
        "reconstruct",
        &[
            "array",
            "image",
            "mesh",
            "frame",
            "calibration",
            "number",
            "statistics",
        ],
    ),
    (
        "report",
        &[
            "reconstruct",
            "job",
            "calibration",
            "frame",
            "image",
            "mesh",
            "number",
            "statistics",
        ],
    ),
    (
        "output",
        &[
            "reconstruct",
            "image",
            "mesh",
            "calibration",
            "number",
            "storage",
        ],
    ),
    ("evaluate", &["mesh", "image", "reconstruct", "statistics"]),
    (
        "simulate",
        &[
            "mesh",
            "image",
            "frame",
            "calibration",
            "recording",
            "reconstruct",
        ],
    ),
    (
        "make_model",
        &[
            "calibration",
            "frame",
            "job",
            "output",
            "reconstruct",
            "recording",
            "report",
            "storage",
        ],
    ),
    (
        "setup",
        &[
            "calibration",
            "clock",
            "config",
            "daemon",
            "drivers",
            "frame",
            "log",
            "recording",
            "workers",
        ],
    ),
    ("check", &["storage"]),
    ("log", &[]),
    ("number", &[]),
    ("process", &[]),
    ("statistics", &[]),
    ("storage", &[]),
    (
        "workers",
        &[
            "frame",
            "log",
            "make_model",
            "number",
            "process",
            "reconstruct",
            "recording",
            "report",
            "storage",
        ],
    ),
    ("pedal", &["clock", "trigger"]),
    ("queue", &[]),
    ("trigger", &[]),
    (
        "config",
        &[
            "calibration",
            "daemon",
            "drivers",
            "frame",
            "output",
            "reconstruct",
            "report",
            "sync",
            "workers",
        ],
    ),
];

/// A scene and what it is made of.
const SCENE: &[&str] = &[
    "ColorView",
    "DepthFrame",
    "DepthView",
    "Scene",
    "SilhouetteSource",
];

/// Names of another room that a room may use and no others, where it needs its types alone.
const ONLY: &[(&str, &str, &[&str])] = &[
    ("job", "reconstruct", SCENE),
    ("output", "reconstruct", &["Model", "Provenance", "Texture"]),
    ("output", "calibration", &["Board", "Face"]),
    ("evaluate", "reconstruct", &["Provenance"]),
    ("simulate", "reconstruct", SCENE),
    ("workers", "reconstruct", &["Method"]),
];

/// Stages of the reconstruction and the other stages that each may use. `pipeline` may use all.
const STAGES: &[(&str, &[&str])] = &[
    ("silhouette", &[]),
    ("surface", &[]),
    ("hull", &["surface"]),
    ("depth", &[]),
    ("region", &["depth"]),
    ("restore", &["depth", "hull", "region", "surface"]),
    ("texture", &[]),
];

/// The rooms that join all others.
const JOINERS: [&str; 4] = ["commands", "daemon", "main", "lib"];

fn sources() -> Vec<PathBuf> {
    let mut folders = vec![Path::new(env!("CARGO_MANIFEST_DIR")).join("src")];
    let mut files = Vec::new();
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            match path.extension() {
                None => folders.push(path),
                Some(_) if path.extension().is_some_and(|e| e == "rs") => files.push(path),
                Some(_) => {}
            }
        }
    }
    files.sort();
    files
}

/// The parts of a source's path below `src`, without `.rs`.
fn place(file: &Path) -> Vec<String> {
    let below = file.strip_prefix(Path::new(env!("CARGO_MANIFEST_DIR")).join("src"));
    let below = below.unwrap().with_extension("");
    let parts = below.iter().map(|part| part.to_str().unwrap().to_owned());
    parts.collect()
}

/// A source without comments and without what is compiled for tests alone.
fn code(file: &Path) -> String {
    let text = fs::read_to_string(file).unwrap();
    let mut kept = String::new();
    let mut test_module = false;
    for line in text.lines() {
        // Test modules stand at the end of a file; those in files of their own are known by their names.
        if line.starts_with("mod tests {") {
            test_module = true;
        }
        let line = line.split("//").next().unwrap_or_default();
        if !test_module {
            kept.push_str(line);
            kept.push('\n');
        }
    }
    kept
}

fn is_test(place: &[String]) -> bool {
    let name = place.last().unwrap();
    name.starts_with("tests") || name.ends_with("_tests") || name == "testing"
}

/// Every path that begins with `prefix`, as its segments; groups in braces are taken apart.
fn paths(code: &str, prefix: &str) -> BTreeSet<Vec<String>> {
    let mut found = BTreeSet::new();
    for (at, _) in code.match_indices(prefix) {
        let before = code[..at].chars().next_back();
        if before.is_none_or(|c| !c.is_alphanumeric() && c != '_' && c != ':') {
            take_path(&code[at + prefix.len()..], Vec::new(), &mut found);
        }
    }
    found
}

/// Reads a path, or a group of them, from the front of `text`; returns what is left behind it.
fn take_path<'a>(
    text: &'a str,
    mut path: Vec<String>,
    found: &mut BTreeSet<Vec<String>>,
) -> &'a str {
    let text = text.trim_start();
    if let Some(mut group) = text.strip_prefix('{') {
        loop {
            group = group.trim_start_matches([',', ' ', '\n']);
            if let Some(rest) = group.strip_prefix('}') {
                return rest;
            }
            let rest = take_path(group, path.clone(), found);
            assert!(rest.len() < group.len(), "cannot read {group:.60}");
            group = rest;
        }
    }
    let end = text.find(|c: char| !c.is_alphanumeric() && c != '_' && c != '*');
    let (name, rest) = text.split_at(end.unwrap_or(text.len()));
    path.push(name.to_owned());
    if let Some(rest) = rest.strip_prefix("::") {
        if rest.starts_with('<') {
            found.insert(path);
            return rest;
        }
        return take_path(rest, path, found);
    }
    found.insert(path);
    let renamed = rest.trim_start().strip_prefix("as ");
    renamed.map_or(rest, |rest| {
        rest.trim_start_matches(|c: char| c.is_alphanumeric() || c == '_')
    })
}

#[test]
fn a_room_uses_what_its_row_allows() {
    let mut seen = BTreeSet::new();
    for file in sources() {
        let place = place(&file);
        // A folder with a row of its own is a room within a room.
        let inner = place.get(..2).map(|two| two.join("/")).unwrap_or_default();
        let has_row = ROOMS.iter().any(|(name, _)| *name == inner);
        let room = if has_row {
            inner.as_str()
        } else {
            place[0].as_str()
        };
        if JOINERS.contains(&room) || is_test(&place) {
            continue;
        }
        let row = ROOMS.iter().find(|(name, _)| *name == room);
        let (_, allowed) = row.unwrap_or_else(|| panic!("{room} has no row in the table"));
        seen.insert(room.to_owned());
        for path in paths(&code(&file), "crate::") {
            let other = path[0].as_str();
            let file = file.display();
            assert!(
                other == room || allowed.contains(&other),
                "{file} uses {other}"
            );
            let only = ONLY.iter().find(|(a, b, _)| (*a, *b) == (room, other));
            if let (Some((_, _, names)), Some(name)) = (only, path.get(1)) {
                assert!(
                    names.contains(&name.as_str()),
                    "{file} uses {other}::{name}"
                );
            }
        }
    }
    let rows: BTreeSet<String> = ROOMS.iter().map(|(room, _)| (*room).to_owned()).collect();
    assert_eq!(seen, rows, "rooms that are there, and rows of the table");
}

#[test]
fn a_stage_uses_what_its_row_allows() {
    let stages: Vec<&str> = STAGES.iter().map(|(stage, _)| *stage).collect();
    for file in sources() {
        let place = place(&file);
        if place[0] != "reconstruct" || place.len() < 3 || is_test(&place) {
            continue;
        }
        let stage = place[1].as_str();
        let row = STAGES.iter().find(|(name, _)| *name == stage);
        let (_, allowed) = row.unwrap_or_else(|| panic!("{stage} has no row in the table"));
        let code = code(&file);
        let up = "super::".repeat(place.len() - 1 - usize::from(place[2] == "mod"));
        let used = paths(&code, "crate::reconstruct::").into_iter();
        for path in used.chain(paths(&code, &up)) {
            let other = path[0].as_str();
            let is_stage = stages.contains(&other) && other != stage;
            let file = file.display();
            assert!(!is_stage || allowed.contains(&other), "{file} uses {other}");
            assert!(other != "pipeline", "{file} uses the pipeline");
        }
    }
}

#[test]
fn mcap_and_foxglove_are_named_in_one_room() {
    for file in sources() {
        let place = place(&file);
        if place[0] != "recording" {
            for library in ["mcap::", "foxglove::", "prost::"] {
                let found = paths(&code(&file), library);
                assert!(found.is_empty(), "{}: {found:?}", file.display());
            }
        }
    }
}

/// Files that have `unsafe`, and how often. design/security.md says why each has it.
const UNSAFE: &[(&str, usize)] = &[
    ("drivers/aravis/stream", 1),
    ("drivers/openni2/device", 11),
    ("drivers/openni2/library", 13),
    ("drivers/openni2/recorder", 4),
    ("drivers/openni2/stream", 12),
    ("drivers/v4l2/device", 17),
    ("process/system", 3),
    ("simulate/serve/gige", 4),
];

#[test]
fn unsafe_stands_where_the_list_says() {
    let mut found = Vec::new();
    for file in sources().iter().filter(|f| !is_test(&place(f))) {
        let blocks = |line: &&str| line.contains("unsafe {") || line.contains("unsafe impl");
        let count = code(file).lines().filter(blocks).count();
        if count > 0 {
            found.push((place(file).join("/"), count));
        }
    }
    let listed: Vec<_> = UNSAFE
        .iter()
        .map(|(name, n)| ((*name).to_owned(), *n))
        .collect();
    assert_eq!(found, listed);
}

/// Files that have sockets of the network, which are clients' or of cameras that are played.
const NETWORK: [&str; 3] = [
    "drivers/aravis/find",
    "drivers/aravis/gvcp",
    "simulate/serve/color",
];

#[test]
fn nothing_listens_on_a_network() {
    for file in sources().iter().filter(|f| !is_test(&place(f))) {
        let code = code(file);
        assert!(!code.contains("TcpListener"), "{}", file.display());
        let place = place(file).join("/");
        let known = NETWORK.contains(&place.as_str());
        assert_eq!(known, code.contains("UdpSocket::bind"), "{place}");
    }
}

#[test]
fn paths_are_found_in_any_form() {
    let code =
        "use crate::{a, b::{self, C}, d::E as F};\nfn f(x: crate::g::H<i32>) {}\nuse xcrate::no;";
    let names = |path: &Vec<String>| path.join("::");
    let found: Vec<String> = paths(code, "crate::").iter().map(names).collect();
    assert_eq!(found, ["a", "b::C", "b::self", "d::E", "g::H"]);
}
