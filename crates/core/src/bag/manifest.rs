//! Lists of digests: a line for each file, with the digest, white space and the path. Lists come from outside: a path
//! that could lead out of the package is refused.

use crate::words::hexadecimal;
use sha2::{Digest, Sha256, Sha512};
use std::collections::BTreeMap;
use std::io::Read;

/// How the files of a list are digested.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Algorithm {
    Sha256,
    Sha512,
}

impl Algorithm {
    /// The algorithm of a list, by the last part of its name, such as `sha512`.
    pub(super) fn of(name: &str) -> Option<Self> {
        match name {
            "sha256" => Some(Self::Sha256),
            "sha512" => Some(Self::Sha512),
            _ => None,
        }
    }

    fn digits(self) -> usize {
        match self {
            Self::Sha256 => 64,
            Self::Sha512 => 128,
        }
    }

    /// The digest of what `from` gives.
    pub(super) fn digest(self, from: &mut impl Read) -> std::io::Result<String> {
        match self {
            Self::Sha256 => digest(Sha256::new(), from),
            Self::Sha512 => digest(Sha512::new(), from),
        }
    }
}

fn digest(mut hash: impl Digest, from: &mut impl Read) -> std::io::Result<String> {
    let mut buffer = vec![0; 1 << 18];
    loop {
        match from.read(&mut buffer)? {
            0 => return Ok(hexadecimal(&hash.finalize())),
            read => hash.update(&buffer[..read]),
        }
    }
}

/// The text of a list: paths and digests.
pub(super) fn text(files: &BTreeMap<String, String>) -> String {
    let line = |(path, digest): (&String, &String)| format!("{digest}  {}\n", encoded(path));
    files.iter().map(line).collect()
}

/// Reads a list.
///
/// # Errors
/// The number of the line and what is wrong with it.
pub(super) fn parse(text: &str, algorithm: Algorithm) -> Result<BTreeMap<String, String>, String> {
    let mut files = BTreeMap::new();
    let mut folded = BTreeMap::new();
    for (number, line) in (1..).zip(text.lines()).filter(|(_, line)| !line.is_empty()) {
        let bad = |problem: String| format!("line {number}: {problem}");
        let (digest, path) = line
            .split_once([' ', '\t'])
            .ok_or_else(|| bad("expected a digest and a path".into()))?;
        let is_digest =
            digest.len() == algorithm.digits() && digest.bytes().all(|b| b.is_ascii_hexdigit());
        if !is_digest {
            let digits = algorithm.digits();
            return Err(bad(format!(
                "expected {digits} hexadecimal digits at its beginning"
            )));
        }
        // Some programs mark binary files with a star.
        let path = path.trim_start_matches([' ', '\t']);
        let path = decoded(path.strip_prefix('*').unwrap_or(path));
        check(&path).map_err(bad)?;
        if let Some(other) = folded.insert(path.to_lowercase(), path.clone()) {
            return Err(bad(match other == path {
                true => format!("{path:?} is listed twice"),
                false => {
                    format!("{path:?} and {other:?} are the same file on disks that ignore case")
                }
            }));
        }
        files.insert(path, digest.to_lowercase());
    }
    Ok(files)
}

/// Refuses a path that could lead out of the package, or mean something else to another system.
fn check(path: &str) -> Result<(), String> {
    let shown = path.chars().take(200).collect::<String>();
    if path.starts_with('/') || path.starts_with('~') || path.contains('\\') {
        return Err(format!("{shown:?} is not a path within the package"));
    }
    let has_drive = path.as_bytes().get(1) == Some(&b':');
    if has_drive || path.split('/').any(|part| part == "..") {
        return Err(format!("{shown:?} leads out of the package"));
    }
    if path.split('/').any(|part| matches!(part, "" | ".")) {
        return Err(format!(
            "{shown:?} is not the plain path of a file: a second name for it could hide it"
        ));
    }
    if path.contains('\0') {
        return Err(format!("{shown:?} is not a path"));
    }
    Ok(())
}

/// RFC 8493, section 2.1.3: what would end a line, and the sign itself.
fn encoded(path: &str) -> String {
    path.replace('%', "%25")
        .replace('\n', "%0A")
        .replace('\r', "%0D")
}

fn decoded(path: &str) -> String {
    let path = path.replace("%0A", "\n").replace("%0a", "\n");
    path.replace("%0D", "\r")
        .replace("%0d", "\r")
        .replace("%25", "%")
}
