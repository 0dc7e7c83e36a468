//! Checks a package, made by scand or by another program. Nothing outside its folder is read: a list that names a path
//! outside, a link and a list of files to fetch are refused before any digest is computed.

use super::Error;
use super::manifest::{Algorithm, parse};
use crate::words::printable;
use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File};
use std::io::Read;
use std::path::{Path, PathBuf};

/// Largest list that is read, in bytes.
const LARGEST_LIST: u64 = 64 << 20;
/// Deepest folder that is looked into.
const DEEPEST: usize = 32;
/// The file that says that a folder is a package.
const DECLARATION: &str = "bagit.txt";
/// The file that describes a package.
const INFO: &str = "bag-info.txt";
/// Most files that a package may have.
const MOST_FILES: usize = 1_000_000;

/// What is wrong with a package.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, serde::Serialize)]
#[serde(rename_all = "snake_case", tag = "problem")]
pub enum Finding {
    /// The package must not be trusted to be read at all.
    Refused {
        /// What it has, and why that is refused.
        words: String,
    },
    /// A file that is listed is not there.
    Missing {
        /// Its path.
        path: String,
    },
    /// A file under `data/` is not listed.
    Extra {
        /// Its path.
        path: String,
    },
    /// A file is not what it was.
    Changed {
        /// Its path.
        path: String,
    },
    /// The package has more or less in it than its description says.
    Oxum {
        /// What is there and what should be.
        words: String,
    },
}

impl std::fmt::Display for Finding {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Refused { words } | Self::Oxum { words } => f.write_str(&printable(words)),
            Self::Missing { path } => write!(f, "{} is listed but missing", printable(path)),
            Self::Extra { path } => write!(f, "{} is not listed", printable(path)),
            Self::Changed { path } => write!(
                f,
                "{} was changed: its digest does not match",
                printable(path)
            ),
        }
    }
}

fn refused(words: impl Into<String>) -> Finding {
    Finding::Refused {
        words: words.into(),
    }
}

/// What a check of a package found.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Checked {
    /// What is wrong with it; nothing if it is whole.
    pub findings: Vec<Finding>,
    /// What was not checked, and why.
    pub unchecked: Vec<String>,
    /// How many files were compared with their digests.
    pub compared: usize,
    /// Files outside `data/` of which no list has a digest: nothing shows whether somebody changed or added them.
    pub unlisted: Vec<String>,
    /// Whether there is a list of the files outside `data/` whose digests were computed. Without one, anybody can have
    /// removed such files, or changed the list of the payload together with the payload.
    pub has_tag_manifest: bool,
}

impl Checked {
    /// Whether lists vouch for all files of the package, and for the lists of the payload.
    pub fn is_all_listed(&self) -> bool {
        self.has_tag_manifest && self.unlisted.is_empty()
    }
}

/// Checks the package in a folder.
///
/// # Errors
/// If the folder or a file in it cannot be read.
pub fn verify(folder: &Path) -> Result<Checked, Error> {
    let of = |findings| Checked {
        findings,
        ..Checked::default()
    };
    let mut tree = Tree::default();
    tree.walk(folder, "", 0)?;
    if !tree.findings.is_empty() {
        return Ok(of(tree.findings));
    }
    let lists = match lists(folder, &tree.files)? {
        Ok(lists) => lists,
        Err(finding) => return Ok(of(vec![finding])),
    };
    let unlisted = unlisted(&tree.files, &lists);
    let unchecked = unchecked(&tree.files, &lists, &unlisted);
    let mut findings = Vec::new();
    let mut compared = BTreeSet::new();
    for path in tree.files.keys().filter(|path| path.starts_with("data/")) {
        let is_listed = |list: &List| !list.of_payload || list.files.contains_key(path);
        if !lists.iter().all(is_listed) {
            findings.push(Finding::Extra { path: path.clone() });
        }
    }
    for list in &lists {
        for (path, digest) in &list.files {
            if !tree.files.contains_key(path) {
                findings.push(Finding::Missing { path: path.clone() });
                continue;
            }
            let member = folder.join(path);
            let mut file = File::open(&member).map_err(Error::io(&member))?;
            let found = list
                .algorithm
                .digest(&mut file)
                .map_err(Error::io(&member))?;
            compared.insert(path);
            if found != *digest {
                findings.push(Finding::Changed { path: path.clone() });
            }
        }
    }
    findings.extend(oxum(folder, &tree.files)?);
    findings.sort();
    findings.dedup();
    Ok(Checked {
        findings,
        unchecked,
        compared: compared.len(),
        unlisted,
        has_tag_manifest: lists.iter().any(|list| !list.of_payload),
    })
}

/// Whether a file of a package is a list of digests, and of the payload.
fn is_list(name: &str) -> Option<bool> {
    let name = name.strip_suffix(".txt")?;
    if name.contains('/') {
        None
    } else if name.starts_with("tagmanifest-") {
        Some(false)
    } else {
        name.starts_with("manifest-").then_some(true)
    }
}

/// The files outside `data/` of which no list with digests that can be computed here has one. A list of tags cannot
/// list itself.
fn unlisted(files: &BTreeMap<String, u64>, lists: &[List]) -> Vec<String> {
    let is_tag = |name: &&String| !name.starts_with("data/") && is_list(name) != Some(false);
    let is_vouched_for = |name: &String| lists.iter().any(|list| list.files.contains_key(name));
    let tags = files.keys().filter(is_tag);
    tags.filter(|name| !is_vouched_for(name)).cloned().collect()
}

/// What was not checked, in words.
fn unchecked(files: &BTreeMap<String, u64>, lists: &[List], unlisted: &[String]) -> Vec<String> {
    let mut words = Vec::new();
    for name in files.keys().filter(|name| is_list(name).is_some()) {
        if !lists.iter().any(|list| list.name == *name) {
            words.push(format!(
                "the digests in {} were not computed: scand computes SHA-512 and SHA-256",
                printable(name)
            ));
        }
    }
    if lists.iter().all(|list| list.of_payload) {
        words.push(
            "there is no tagmanifest-sha512.txt or tagmanifest-sha256.txt: nothing shows whether files beside data/ were \
             removed, or whether the list of the files in data/ was changed with them; BagIt allows that"
                .into(),
        );
    }
    if !files.contains_key(INFO) {
        words.push(format!(
            "there is no {INFO}: the amount of the files in data/ was not compared with it; BagIt allows that"
        ));
    }
    for name in unlisted {
        let is_of_bagit = [DECLARATION, INFO].contains(&name.as_str()) || is_list(name).is_some();
        let allowed = match is_of_bagit {
            true => "",
            false => "; BagIt allows more files beside data/",
        };
        words.push(format!(
            "{} was not checked, because no list has its digest{allowed}",
            printable(name)
        ));
    }
    words
}

/// Everything in a package's folder.
#[derive(Default)]
struct Tree {
    /// Lengths of the files, by their paths.
    files: BTreeMap<String, u64>,
    findings: Vec<Finding>,
}

impl Tree {
    fn walk(&mut self, root: &Path, below: &str, depth: usize) -> Result<(), Error> {
        let folder = root.join(below);
        let mut entries = Vec::new();
        for entry in fs::read_dir(&folder).map_err(Error::io(&folder))? {
            entries.push(entry.map_err(Error::io(&folder))?);
        }
        entries.sort_by_key(fs::DirEntry::file_name);
        for entry in entries {
            let name = entry.file_name();
            let Some(name) = name.to_str() else {
                self.findings
                    .push(refused(format!("{:?} has no name in UTF-8", entry.path())));
                continue;
            };
            let path = match below {
                "" => name.to_owned(),
                below => format!("{below}/{name}"),
            };
            let about = entry
                .path()
                .symlink_metadata()
                .map_err(Error::io(&folder))?;
            if about.is_dir() && depth < DEEPEST {
                self.walk(root, &path, depth + 1)?;
            } else if about.is_file() && self.files.len() < MOST_FILES {
                self.files.insert(path, about.len());
            } else if about.is_symlink() {
                self.findings.push(refused(format!(
                    "{path} is a link, which a package must not have"
                )));
            } else {
                self.findings.push(refused(format!(
                    "{path} is neither a file nor a folder, lies too deep, or is one of too many"
                )));
            }
        }
        Ok(())
    }
}

/// A list of digests.
struct List {
    name: String,
    of_payload: bool,
    algorithm: Algorithm,
    files: BTreeMap<String, String>,
}

/// The lists of a package, whose declaration is checked.
fn lists(
    folder: &Path,
    files: &BTreeMap<String, u64>,
) -> Result<Result<Vec<List>, Finding>, Error> {
    if files.contains_key("fetch.txt") {
        let words = "fetch.txt names files on other machines, which are never fetched";
        return Ok(Err(refused(words)));
    }
    if let Some(words) = problem_of_declaration(text(folder, files, DECLARATION)?.as_deref()) {
        return Ok(Err(refused(words)));
    }
    let mut lists = Vec::new();
    for name in files.keys() {
        let Some(of_payload) = is_list(name) else {
            continue;
        };
        // Beside a list that is checked there may be others.
        let (_, algorithm) = name.split_once('-').unwrap_or_default();
        let Some(algorithm) = algorithm.strip_suffix(".txt").and_then(Algorithm::of) else {
            continue;
        };
        let Some(text) = text(folder, files, name)? else {
            return Ok(Err(refused(format!(
                "{name} is larger than {LARGEST_LIST} bytes, or not UTF-8"
            ))));
        };
        match List::parse(name, of_payload, algorithm, &text) {
            Ok(list) => lists.push(list),
            Err(problem) => return Ok(Err(refused(format!("{name}: {problem}")))),
        }
    }
    if !lists.iter().any(|list| list.of_payload) {
        return Ok(Err(refused(
            "there is no manifest-sha512.txt or manifest-sha256.txt: scand checks no other digests",
        )));
    }
    Ok(Ok(lists))
}

impl List {
    fn parse(
        name: &str,
        of_payload: bool,
        algorithm: Algorithm,
        text: &str,
    ) -> Result<Self, String> {
        let files = parse(text, algorithm)?;
        let is_elsewhere = |path: &&String| path.starts_with("data/") != of_payload;
        if let Some(path) = files.keys().find(is_elsewhere) {
            return Err(format!("{path:?} must not be in this list"));
        }
        Ok(Self {
            name: name.to_owned(),
            of_payload,
            algorithm,
            files,
        })
    }
}

/// What is wrong with the text of `bagit.txt`; `None` if scand can check such a package.
fn problem_of_declaration(text: Option<&str>) -> Option<&'static str> {
    let Some(text) = text else {
        return Some("bagit.txt is missing or too large: this is not a BagIt package");
    };
    let text = text.trim_start_matches('\u{feff}');
    let has = |wanted: &[&str]| text.lines().any(|line| wanted.contains(&line.trim_end()));
    if !has(&["BagIt-Version: 1.0", "BagIt-Version: 0.97"]) {
        return Some("bagit.txt does not say that its version is 1.0 or 0.97");
    }
    if !has(&["Tag-File-Character-Encoding: UTF-8"]) {
        return Some("bagit.txt does not say that its encoding is UTF-8");
    }
    None
}

/// The text of a file of the package, whose lines may end in any of the three ways that RFC 8493 allows; `None` if it
/// is not there, too large or not UTF-8.
fn text(folder: &Path, files: &BTreeMap<String, u64>, name: &str) -> Result<Option<String>, Error> {
    if files.get(name).is_none_or(|&length| length > LARGEST_LIST) {
        return Ok(None);
    }
    let path: PathBuf = folder.join(name);
    let mut bytes = Vec::new();
    let file = File::open(&path).map_err(Error::io(&path))?;
    file.take(LARGEST_LIST)
        .read_to_end(&mut bytes)
        .map_err(Error::io(&path))?;
    let text = String::from_utf8(bytes).ok();
    Ok(text.map(|text| text.replace("\r\n", "\n").replace('\r', "\n")))
}

/// Whether the bytes and files under `data/` are as many as `bag-info.txt` says.
fn oxum(folder: &Path, files: &BTreeMap<String, u64>) -> Result<Option<Finding>, Error> {
    let info = text(folder, files, INFO)?.unwrap_or_default();
    let Some(said) = info
        .lines()
        .find_map(|line| line.strip_prefix("Payload-Oxum:"))
    else {
        return Ok(None);
    };
    let payload = files.iter().filter(|(path, _)| path.starts_with("data/"));
    let (bytes, count) = payload.fold((0, 0), |(bytes, count), (_, length)| {
        (bytes + length, count + 1)
    });
    let found = format!("{bytes}.{count}");
    let said = said.trim();
    Ok((said != found).then(|| Finding::Oxum {
        words: format!("data/ has {found} (bytes.files), but {INFO} says {said:?}"),
    }))
}
