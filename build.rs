//! Passes what the program is built from to the compiler: the commit that is checked out (`unknown` without git)
//! and the features. Only `scand --version` prints them: a model and its digest are the same whatever the commit. With
//! the feature `page` it also lists the files of the operator's page, which `make ui` makes.

use std::path::{Path, PathBuf};
use std::process::Command;

/// What git answers, or `None` if it cannot.
fn git(arguments: &[&str]) -> Option<String> {
    let output = Command::new("git").args(arguments).output().ok()?;
    let text = String::from_utf8(output.stdout).ok()?;
    let text = text.trim().to_owned();
    (output.status.success() && !text.is_empty()).then_some(text)
}

/// Whether the sources, where cargo runs this, are a checkout of their own, not an unpacked archive in somebody else's.
fn is_checkout() -> bool {
    let top = git(&["rev-parse", "--show-toplevel"]).map(std::fs::canonicalize);
    let here = std::env::current_dir().and_then(std::fs::canonicalize);
    matches!((top, here), (Some(Ok(top)), Ok(here)) if top == here)
}

/// Files that the program is made of: with a change in them that is not committed, it has no commit.
const SOURCES: [&str; 6] = [
    "src",
    "crates",
    "build.rs",
    "Cargo.toml",
    "Cargo.lock",
    "docs/report.schema.json",
];

/// The commit that the sources are, for programs that have to be the same on many machines; or why they are none.
fn sources(commit: Option<&str>) -> String {
    // Each of them may change without a new commit. A build that needs this is made anew then anyway.
    for path in SOURCES {
        println!("cargo::rerun-if-changed={path}");
    }
    let changes = ["status", "--porcelain", "--untracked-files=all", "--"];
    let changes: Vec<&str> = changes.into_iter().chain(SOURCES).collect();
    match commit {
        None => "unknown".into(),
        Some(_) if git(&changes).is_some() => "uncommitted".into(),
        Some(commit) => commit.into(),
    }
}

/// Files that change with the commit that is checked out. The log of `HEAD` alone changes with each commit of this work
/// tree and of no other one; a repository may be told to keep none.
fn watched() -> Vec<String> {
    let path = |name: &str| git(&["rev-parse", "--git-path", name]);
    let present = |path: &String| Path::new(path).exists();
    let head = path("HEAD").filter(present);
    let log = path("logs/HEAD").filter(present);
    if log.is_some() {
        return head.into_iter().chain(log).collect();
    }
    let branch = git(&["rev-parse", "--symbolic-full-name", "HEAD"]).and_then(|name| path(&name));
    let packed = path("packed-refs");
    let references = [branch, packed].into_iter().flatten().filter(present);
    head.into_iter().chain(references).collect()
}

/// The features that are switched on, by name, or `none`.
fn features() -> String {
    let prefix = "CARGO_FEATURE_";
    let mut names: Vec<String> = std::env::vars()
        .filter_map(|(key, _)| key.strip_prefix(prefix).map(str::to_lowercase))
        .filter(|name| name != "default")
        .collect();
    names.sort();
    if names.is_empty() {
        names.push("none".to_owned());
    }
    names.join(" ")
}

/// The files below a folder, sorted.
fn files(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut files = Vec::new();
    for path in entries.map(|entry| entry.path()) {
        if path.is_dir() {
            files.extend(self::files(&path));
        } else {
            files.push(path);
        }
    }
    files.sort();
    files
}

/// Writes the table of the page's files for `src/page/assets.rs`. Without them it is empty, and `scand page` says so.
fn list_page_files() -> std::io::Result<()> {
    let root = std::env::current_dir()?.join("ui/dist");
    // Cargo would run this again each time for a folder that is not there; `make ui` touches the other file.
    let watched = if root.is_dir() {
        "ui/dist"
    } else {
        "ui/index.html"
    };
    println!("cargo::rerun-if-changed={watched}");
    let mut table = String::from("const EMBEDDED: &[(&str, &[u8])] = &[\n");
    for file in files(&root) {
        println!("cargo::rerun-if-changed={}", file.display());
        let name = file.strip_prefix(&root).unwrap_or(&file);
        table += &format!(
            "    ({:?}, include_bytes!({:?})),\n",
            name.display().to_string(),
            file.display().to_string()
        );
    }
    let target = std::env::var("OUT_DIR").unwrap_or_default();
    std::fs::write(Path::new(&target).join("page_files.rs"), table + "];\n")
}

fn main() -> std::io::Result<()> {
    if std::env::var_os("CARGO_FEATURE_PAGE").is_some() {
        list_page_files()?;
    }
    // Without any such line cargo would run this again at each change of any file.
    println!("cargo::rerun-if-changed=build.rs");
    let mut commit = None;
    if is_checkout() {
        watched()
            .iter()
            .for_each(|path| println!("cargo::rerun-if-changed={path}"));
        commit = git(&["rev-parse", "--short=12", "HEAD"]);
    }
    if std::env::var_os("CARGO_FEATURE_FLEET").is_some() {
        let sources = sources(commit.as_deref());
        println!("cargo::rustc-env=SCAND_SOURCES={sources}");
    }
    let commit = commit.as_deref().unwrap_or("unknown");
    println!("cargo::rustc-env=SCAND_COMMIT={commit}");
    println!("cargo::rustc-env=SCAND_FEATURES={}", features());
    Ok(())
}
