//! Checks the sources against ARCHITECTURE.md: reads its tables of which room may use which, and tests other rules of
//! the house.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

const ARCHITECTURE: &str = include_str!("../ARCHITECTURE.md");

/// The rows of ARCHITECTURE.md's tables whose first heading is `heading`: each name of the first column, with the names
/// of the last one, which it may use. `None` means that it may use all. What stands in parentheses is an explanation.
fn rows(heading: &str) -> BTreeMap<String, Option<Vec<String>>> {
    let names = |cell: &str| {
        let outside = cell.split('(').enumerate().map(|(i, part)| match i {
            0 => part,
            _ => part.split_once(')').unwrap().1,
        });
        let outside: String = outside.collect();
        let quoted = outside.split('`').skip(1).step_by(2);
        quoted.map(|name| name.replace("::", "/")).collect()
    };
    let mut rows = BTreeMap::new();
    let mut within = false;
    for line in ARCHITECTURE.lines() {
        let cells: Vec<&str> = line.split('|').map(str::trim).collect();
        let [_, first, .., last, _] = cells[..] else {
            within = false;
            continue;
        };
        within |= first == heading;
        let allowed: Vec<String> = names(last);
        for name in names(first).into_iter().filter(|_| within) {
            assert!(
                !allowed.is_empty() || last == "–" || last == "all",
                "{name}: {last:?} is no list of rooms"
            );
            let double = rows.insert(name, (last != "all").then(|| allowed.clone()));
            assert!(double.is_none(), "two rows of one name: {line}");
        }
    }
    rows
}

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
    ("capture", "reconstruct", SCENE),
    ("output", "reconstruct", &["Model", "Provenance", "Texture"]),
    ("output", "calibration", &["Board", "Face"]),
    ("evaluate", "reconstruct", &["Provenance"]),
    ("export", "reconstruct", &["Model", "Provenance", "Texture"]),
    (
        "dataset",
        "reconstruct",
        &["ColorView", "Model", "Provenance", "Scene", "silhouette"],
    ),
    ("lab", "reconstruct", SCENE),
    ("workers", "reconstruct", &["Method"]),
];

/// Files that are no rooms: they list the rooms, and begin the program.
const ROOTS: [&str; 2] = ["main", "lib"];

/// The packages' sources, and the room that a whole package is.
const PACKAGES: [(&str, Option<&str>); 3] = [
    ("src", None),
    ("crates/core/src", None),
    ("crates/lab/src", Some("lab")),
];

fn sources() -> Vec<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut folders: Vec<PathBuf> = PACKAGES.iter().map(|(p, _)| root.join(p)).collect();
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

/// The parts of a source's path below its package's `src`, without `.rs`.
fn place(file: &Path) -> Vec<String> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let below = |(package, room)| Some((file.strip_prefix(root.join(package)).ok()?, room));
    let (below, room) = PACKAGES.into_iter().find_map(below).unwrap();
    let below = below.with_extension("");
    let parts = below.iter().map(|part| part.to_str().unwrap());
    room.into_iter().chain(parts).map(str::to_owned).collect()
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
    let rows = rows("room");
    let mut seen = BTreeSet::new();
    for file in sources() {
        let place = place(&file);
        // A folder with a row of its own is a room within a room.
        let inner = place.get(..2).map(|two| two.join("/")).unwrap_or_default();
        let room = if rows.contains_key(&inner) {
            inner.as_str()
        } else {
            place[0].as_str()
        };
        if ROOTS.contains(&room) || is_test(&place) {
            continue;
        }
        let row = rows.get(room);
        let allowed = row.unwrap_or_else(|| panic!("{room} has no row in the table"));
        seen.insert(room.to_owned());
        let prefix = if room == "lab" {
            "scand_core::"
        } else {
            "crate::"
        };
        let code = code(&file);
        // The laboratory is a package of its own, and one room.
        let of_laboratory = paths(&code, "scand_lab::").into_iter().map(|path| {
            let lab = vec!["lab".to_owned()];
            [lab, path].concat()
        });
        for path in paths(&code, prefix).into_iter().chain(of_laboratory) {
            let other = path[0].as_str();
            let file = file.display();
            let may = allowed
                .as_ref()
                .is_none_or(|a| a.iter().any(|a| a == other));
            assert!(other == room || may, "{file} uses {other}");
            let only = ONLY.iter().find(|(a, b, _)| (*a, *b) == (room, other));
            if let (Some((_, _, names)), Some(name)) = (only, path.get(1)) {
                assert!(
                    names.contains(&name.as_str()),
                    "{file} uses {other}::{name}"
                );
            }
        }
    }
    let rows = rows.into_keys().filter(|name| !ROOTS.contains(&&name[..]));
    let rows: BTreeSet<String> = rows.collect();
    assert_eq!(seen, rows, "rooms that are there, and rows of the table");
}

/// A module of the library: where it stands, what it says, and which names it hands on from others.
struct Module {
    path: Vec<String>,
    code: String,
    handed_on: Vec<Vec<String>>,
}

/// The library's modules, without those that are compiled for tests alone.
fn modules() -> Vec<Module> {
    let files = sources().into_iter();
    let places = files.map(|file| (place(&file), file));
    let kept = places.filter(|(place, _)| !is_test(place) && place != &["main"]);
    let module = |(mut path, file): (Vec<String>, PathBuf)| {
        if path
            .last()
            .is_some_and(|name| name == "mod" || name == "lib")
        {
            path.pop();
        }
        let code = code(&file);
        let handed_on = ["pub use ", "pub(super) use ", "pub(crate) use "];
        let handed_on = handed_on.iter().flat_map(|prefix| paths(&code, prefix));
        Module {
            path,
            handed_on: handed_on.collect(),
            code,
        }
    };
    kept.map(module).collect()
}

/// A path that is written in a module, as one from the library's root; `None` if it begins with another library.
fn from_root(modules: &[Module], within: &[String], path: &[String]) -> Option<Vec<String>> {
    let first = path.first()?.as_str();
    match first {
        "crate" => {
            let package = usize::from(within.first().is_some_and(|room| room == "lab"));
            Some([&within[..package], &path[1..]].concat())
        }
        "self" => Some([within, &path[1..]].concat()),
        "super" => {
            let (_, parent) = within.split_last()?;
            match path.get(1).map(String::as_str) {
                Some("super") => from_root(modules, parent, &path[1..]),
                _ => Some([parent, &path[1..]].concat()),
            }
        }
        _ => {
            let child = [within, &path[..1]].concat();
            let is_module = modules.iter().any(|module| module.path == child);
            is_module.then(|| [within, path].concat())
        }
    }
}

/// The module that has what a path from the library's root names: where it is defined, not where it is re-exported.
fn home(modules: &[Module], path: &[String]) -> Option<Vec<String>> {
    let here = |length: usize| modules.iter().find(|module| module.path == path[..length]);
    let module = (0..=path.len()).rev().find_map(here)?;
    let Some(name) = path.get(module.path.len()) else {
        return Some(module.path.clone());
    };
    let handed_on = module.handed_on.iter();
    let origin = handed_on
        .filter(|found| found.last() == Some(name))
        .find_map(|found| from_root(modules, &module.path, found));
    match origin {
        Some(origin) => home(modules, &origin),
        None => Some(module.path.clone()),
    }
}

/// Who uses whom within a folder: for each folder, its files and folders by name. A folder's own file may use what is
/// in the folder, and what is in it may use the folder's own file: neither is listed.
fn arrows() -> BTreeMap<Vec<String>, BTreeMap<String, BTreeSet<String>>> {
    let modules = modules();
    let mut arrows: BTreeMap<_, BTreeMap<String, BTreeSet<String>>> = BTreeMap::new();
    for module in &modules {
        for prefix in ["crate", "super", "self"] {
            for path in paths(&module.code, &format!("{prefix}::")) {
                let path = [vec![prefix.to_owned()], path].concat();
                let path = from_root(&modules, &module.path, &path);
                let Some(used) = path.and_then(|path| home(&modules, &path)) else {
                    continue;
                };
                let both = module.path.iter().zip(&used);
                let shared = both.take_while(|(a, b)| a == b).count();
                if let (Some(from), Some(to)) = (module.path.get(shared), used.get(shared)) {
                    let folder = arrows.entry(used[..shared].to_vec()).or_default();
                    folder.entry(from.clone()).or_default().insert(to.clone());
                }
            }
        }
    }
    arrows
}

/// A circle, as the names that it leads through.
fn circle(uses: &BTreeMap<String, BTreeSet<String>>) -> Option<Vec<String>> {
    fn walk<'a>(
        at: &'a str,
        uses: &'a BTreeMap<String, BTreeSet<String>>,
        way: &mut Vec<&'a str>,
        done: &mut BTreeSet<&'a str>,
    ) -> Option<Vec<String>> {
        if let Some(begin) = way.iter().position(|name| *name == at) {
            return Some(way[begin..].iter().map(ToString::to_string).collect());
        }
        if !done.insert(at) {
            return None;
        }
        way.push(at);
        let found = uses.get(at).into_iter().flatten();
        let found = found
            .map(|next| walk(next, uses, way, done))
            .find_map(|c| c);
        way.pop();
        found
    }
    let mut done = BTreeSet::new();
    uses.keys()
        .find_map(|name| walk(name, uses, &mut Vec::new(), &mut done))
}

/// Rooms, files and the folders within rooms have an order: none uses what uses it, however many steps lead back. Read
/// from the text: paths that begin with `crate`, `super` or `self` are seen, traits' methods and macros are not. A
/// folder's own file and what is in the folder count as one ([`arrows`]).
#[test]
fn nothing_goes_in_a_circle() {
    let circles: Vec<String> = arrows()
        .iter()
        .filter_map(|(folder, uses)| {
            Some(format!(
                "{}: {}",
                folder.join("/"),
                circle(uses)?.join(" → ")
            ))
        })
        .collect();
    assert_eq!(circles, Vec::<String>::new());
}

#[test]
fn circles_are_found_and_trees_are_not_circles() {
    let uses = |arrows: &[(&str, &str)]| {
        let mut uses: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
        for (from, to) in arrows {
            uses.entry((*from).into()).or_default().insert((*to).into());
        }
        uses
    };
    let tree = [("a", "b"), ("a", "c"), ("b", "d"), ("c", "d")];
    assert_eq!(circle(&uses(&tree)), None);
    let led_back = [("a", "b"), ("b", "c"), ("c", "d"), ("d", "b")];
    assert_eq!(circle(&uses(&led_back)).unwrap(), ["b", "c", "d"]);
}

#[test]
fn a_stage_uses_what_its_row_allows() {
    let rows = rows("stage");
    for file in sources() {
        let place = place(&file);
        if place[0] != "reconstruct" || place.len() < 3 || is_test(&place) {
            continue;
        }
        let stage = place[1].as_str();
        let row = rows.get(stage);
        let row = row.unwrap_or_else(|| panic!("{stage} has no row in the table"));
        let allowed = row.as_ref().unwrap();
        let code = code(&file);
        let up = "super::".repeat(place.len() - 1 - usize::from(place[2] == "mod"));
        let used = paths(&code, "crate::reconstruct::").into_iter();
        for path in used.chain(paths(&code, &up)) {
            let other = path[0].as_str();
            let is_stage = rows.contains_key(other) && other != stage;
            let may = allowed.iter().any(|name| name == other);
            let file = file.display();
            assert!(!is_stage || may, "{file} uses {other}");
            assert!(other != "pipeline", "{file} uses the pipeline");
        }
    }
}

/// The files below these folders, and those of the root.
fn files() -> Vec<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let named = [
        "config", "crates", "design", "docs", "python", "scripts", "src", "systemd", "tests",
        "ui/src",
    ];
    let mut folders: Vec<PathBuf> = named.iter().map(|folder| root.join(folder)).collect();
    let mut files = Vec::new();
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            match path.is_dir() {
                true => folders.push(path),
                false => files.push(path),
            }
        }
    }
    files
}

/// What the names of files end in, as opposed to those of settings.
const ENDINGS: [&str; 8] = ["conf", "json", "md", "py", "rs", "service", "sh", "toml"];

/// What ARCHITECTURE.md says of where to change what is found there: files by their paths, and names in some file.
#[test]
fn the_places_of_changes_exist() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let bases = ["", "src", "crates/core/src"].map(|base| root.join(base));
    let files = files();
    let texts: Vec<String> = files
        .iter()
        .filter_map(|file| fs::read_to_string(file).ok())
        .collect();
    let (_, table) = ARCHITECTURE
        .split_once("## Where to add or change things")
        .unwrap();
    let cells = table.lines().filter(|line| line.starts_with('|'));
    let quoted = cells.flat_map(|line| line.split('`').skip(1).step_by(2));
    let mut missing: Vec<&str> = quoted
        .filter(|name| !name.contains("NAME"))
        .filter(|name| {
            let ending = Path::new(name).extension().map(|e| e.to_str().unwrap());
            let is_file = ending.is_some_and(|e| ENDINGS.contains(&e));
            let exists = bases.iter().any(|base| base.join(name).exists());
            let last = name.rsplit(['.', ':']).next().unwrap();
            match is_file || name.contains('/') {
                true => !exists && !files.iter().any(|file| file.ends_with(name)),
                false => !exists && !texts.iter().any(|text| text.contains(last)),
            }
        })
        .collect();
    missing.sort_unstable();
    assert_eq!(missing, Vec::<&str>::new());
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

/// Files that have `unsafe`, and in how many lines: blocks, functions, traits and their implementations, and what a C
/// library declares. design/security.md says why each has it.
const UNSAFE: &[(&str, usize)] = &[
    ("lab/serve/gige", 5),
    ("drivers/aravis/stream", 1),
    ("drivers/openni2/device", 9),
    ("drivers/openni2/ffi", 1),
    ("drivers/openni2/library", 14),
    ("drivers/openni2/property", 7),
    ("drivers/openni2/recorder", 4),
    ("drivers/openni2/stream", 10),
    ("drivers/v4l2/device", 18),
    ("process/system", 3),
];

#[test]
fn unsafe_stands_where_the_list_says() {
    let mut found = Vec::new();
    for file in sources().iter().filter(|f| !is_test(&place(f))) {
        let between = |c: char| !c.is_alphanumeric() && c != '_';
        let keyword = |line: &&str| line.split(between).any(|word| word == "unsafe");
        let count = code(file).lines().filter(keyword).count();
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
    "lab/serve/color",
];

/// The one file that listens: the operator's page, a process of its own, on loopback or with TLS (`page::Parameters`).
const LISTENS: &str = "page/serve";

#[test]
fn nothing_listens_on_a_network() {
    for file in sources().iter().filter(|f| !is_test(&place(f))) {
        let code = code(file);
        let place = place(file).join("/");
        assert_eq!(code.contains("TcpListener"), place == LISTENS, "{place}");
        let known = NETWORK.contains(&place.as_str());
        assert_eq!(known, code.contains("UdpSocket::bind"), "{place}");
    }
}

/// While the library's thread tells a signal to somebody, it holds the camera; if the camera is closed meanwhile, that
/// thread waits for its own end, and GLib ends the process.
#[test]
fn nobody_listens_to_signals_of_cameras() {
    let drivers = sources()
        .into_iter()
        .filter(|file| place(file).starts_with(&["drivers".into(), "aravis".into()]));
    let code: Vec<String> = drivers.map(|file| code(&file)).collect();
    assert!(code.len() > 5, "{} files", code.len());
    assert!(!code.concat().contains(".connect_"));
}

#[test]
fn paths_are_found_in_any_form() {
    let code =
        "use crate::{a, b::{self, C}, d::E as F};\nfn f(x: crate::g::H<i32>) {}\nuse xcrate::no;";
    let names = |path: &Vec<String>| path.join("::");
    let found: Vec<String> = paths(code, "crate::").iter().map(names).collect();
    assert_eq!(found, ["a", "b::C", "b::self", "d::E", "g::H"]);
}
