//! Tests intact packages, and each way in which a package can be damaged or hostile.

use super::*;
use std::fs;
use std::path::Path;

fn bag(folder: &Path) -> PathBuf {
    let target = folder.join("bag");
    let mut bag = Bag::create(&target).unwrap();
    bag.put("a.txt", b"a").unwrap();
    bag.put("models/100 %\n/model.ply", b"ply").unwrap();
    bag.put_file("again.txt", &folder.join("file")).unwrap();
    assert!(bag.put("a.txt", b"b").is_err());
    bag.finish(&[
        ("Bagging-Date", "2026-01-31".into()),
        ("Title", "two\nlines".into()),
    ])
    .unwrap();
    target
}

fn words(folder: &Path) -> String {
    let findings = verify(folder).unwrap().findings;
    findings
        .iter()
        .map(|finding| format!("{finding}\n"))
        .collect()
}

/// What is found in a package after a change.
fn after(change: impl Fn(&Path)) -> String {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("file"), "x".repeat(600_000)).unwrap();
    let target = bag(folder.path());
    change(&target);
    words(&target)
}

#[test]
fn a_package_is_whole_and_is_never_replaced() {
    assert_eq!(after(|_| ()), "");
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("file"), "").unwrap();
    let target = bag(folder.path());
    assert!(matches!(Bag::create(&target), Err(Error::Exists(_))));
    let checked = verify(&target).unwrap();
    assert!(checked.is_all_listed());
    // Three under `data/`, and three of the four beside it: the list of tags cannot list itself.
    assert_eq!((checked.compared, checked.unchecked), (6, Vec::new()));
    let info = fs::read_to_string(target.join("bag-info.txt")).unwrap();
    assert_eq!(
        info,
        "Bagging-Date: 2026-01-31\nTitle: two lines\nPayload-Oxum: 4.3\n"
    );
}

#[test]
fn changed_missing_and_extra_files_are_named() {
    let changed = after(|bag| fs::write(bag.join("data/a.txt"), "b").unwrap());
    assert!(changed.contains("data/a.txt was changed"), "{changed}");
    let missing = after(|bag| fs::remove_file(bag.join("data/a.txt")).unwrap());
    assert!(
        missing.contains("data/a.txt is listed but missing"),
        "{missing}"
    );
    assert!(missing.contains("bag-info.txt says"), "{missing}");
    let extra = after(|bag| fs::write(bag.join("data/b.txt"), "b").unwrap());
    assert!(extra.contains("data/b.txt is not listed"), "{extra}");
    let tag = after(|bag| fs::write(bag.join("bag-info.txt"), "x").unwrap());
    assert!(tag.contains("bag-info.txt was changed"), "{tag}");
}

/// Adds a line for `path` to the list of the payload.
fn list(bag: &Path, path: &str) {
    let file = bag.join("manifest-sha512.txt");
    let text = fs::read_to_string(&file).unwrap();
    fs::write(&file, format!("{text}{}  {path}\n", "0".repeat(128))).unwrap();
}

#[test]
fn a_package_that_is_meant_to_do_harm_is_refused() {
    for path in [
        "data/../../secret",
        "/etc/passwd",
        "data//a",
        "data/./a",
        "~/secret",
        "data\\..\\secret",
        "C:/secret",
        "data/%0A/../../x",
    ] {
        let found = after(|bag| list(bag, path));
        assert!(
            found.contains("manifest-sha512.txt: line 4"),
            "{path}: {found}"
        );
    }
    for (path, named) in [
        ("data/../../secret", "leads out of the package"),
        ("data/./a.txt", "is not the plain path"),
        ("data//a.txt", "is not the plain path"),
        ("data/a.txt", "listed twice"),
        ("data/A.TXT", "ignore case"),
        ("bagit.txt", "must not be in this list"),
    ] {
        let found = after(|bag| list(bag, path));
        assert!(found.contains(named), "{path}: {found}");
    }
    let fetch =
        after(|bag| fs::write(bag.join("fetch.txt"), "http://example.org/x - data/x").unwrap());
    assert!(fetch.contains("fetch.txt"), "{fetch}");
    let link =
        after(|bag| std::os::unix::fs::symlink("/etc/passwd", bag.join("data/link")).unwrap());
    assert!(link.contains("data/link is a link"), "{link}");
    let linked = after(|bag| {
        fs::remove_file(bag.join("data/a.txt")).unwrap();
        std::os::unix::fs::symlink("/etc/passwd", bag.join("data/a.txt")).unwrap();
    });
    assert!(linked.contains("data/a.txt is a link"), "{linked}");
}

#[test]
fn what_is_no_package_says_so() {
    let empty = tempfile::tempdir().unwrap();
    assert!(words(empty.path()).contains("not a BagIt package"));
    let version = after(|bag| fs::write(bag.join("bagit.txt"), "BagIt-Version: 2.0\n").unwrap());
    assert!(version.contains("version"), "{version}");
    let none = after(|bag| {
        let list = bag.join("manifest-sha512.txt");
        fs::rename(list, bag.join("manifest-md5.txt")).unwrap();
    });
    assert!(none.contains("no manifest-sha512.txt"), "{none}");
    let torn = after(|bag| fs::write(bag.join("manifest-sha512.txt"), "abc  data/a.txt").unwrap());
    assert!(torn.contains("128 hexadecimal digits"), "{torn}");
    assert!(verify(Path::new("/nonexistent")).is_err());
}

#[test]
fn packages_of_other_programs_are_checked_as_far_as_possible() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("file"), "x").unwrap();
    let target = bag(folder.path());
    let md5 = "0".repeat(32);
    fs::write(
        target.join("manifest-md5.txt"),
        format!("{md5}  data/a.txt\n"),
    )
    .unwrap();
    fs::write(
        target.join("tagmanifest-md5.txt"),
        format!("{md5}  bagit.txt\n"),
    )
    .unwrap();
    fs::write(target.join("thumbs.db"), "x").unwrap();
    let mut file = fs::File::open(target.join("data/a.txt")).unwrap();
    let digest = manifest::Algorithm::Sha256.digest(&mut file).unwrap();
    let sha256 = target.join("manifest-sha256.txt");
    fs::write(&sha256, format!("{digest}  data/a.txt\n")).unwrap();
    let checked = verify(&target).unwrap();
    let unchecked = checked.unchecked.join("\n");
    for name in [
        "in manifest-md5.txt",
        "in tagmanifest-md5.txt",
        "thumbs.db was not checked",
    ] {
        assert!(unchecked.contains(name), "{name}: {unchecked}");
    }
    // Each list of the payload that can be checked must have all of it.
    let extra: Vec<String> = checked.findings.iter().map(ToString::to_string).collect();
    assert!(
        extra.contains(&"data/again.txt is not listed".into()),
        "{extra:?}"
    );
    assert_eq!(
        checked.unlisted,
        ["manifest-md5.txt", "manifest-sha256.txt", "thumbs.db"]
    );
    assert!(checked.has_tag_manifest && !checked.is_all_listed());
    fs::remove_file(&sha256).unwrap();
    assert_eq!(verify(&target).unwrap().findings, []);
    // Lines may end as they did on old machines.
    for name in ["manifest-sha512.txt", "bagit.txt", "bag-info.txt"] {
        let text = fs::read_to_string(target.join(name)).unwrap();
        fs::write(target.join(name), text.replace('\n', "\r")).unwrap();
    }
    fs::remove_file(target.join("tagmanifest-sha512.txt")).unwrap();
    let checked = verify(&target).unwrap();
    assert_eq!(checked.findings, []);
    let unchecked = checked.unchecked.join("\n");
    assert!(
        unchecked.contains("bag-info.txt was not checked"),
        "{unchecked}"
    );
    assert!(
        unchecked.contains("no tagmanifest-sha512.txt"),
        "{unchecked}"
    );
    assert!(!checked.has_tag_manifest && !checked.is_all_listed());
    assert_eq!(checked.compared, 3);
}

#[test]
fn no_terminal_obeys_a_name_in_a_package() {
    let hostile = "data/a\nb\u{1b}[2J";
    let extra = after(|bag| fs::write(bag.join(hostile), "").unwrap());
    assert!(
        extra.contains(r"data/a\nb\u{1b}[2J is not listed"),
        "{extra}"
    );
    let missing = after(|bag| list(bag, "data/a%0Ab\u{1b}[2J"));
    assert!(
        missing.contains(r"data/a\nb\u{1b}[2J is listed but missing"),
        "{missing}"
    );
    let link = after(|bag| std::os::unix::fs::symlink("x", bag.join(hostile)).unwrap());
    assert!(link.contains(r"data/a\nb\u{1b}[2J is a link"), "{link}");
}
