//! Reads `--pictures left='left/*.png' right=right`: which picture files each camera has, in the order of their names.

use crate::frame::CameraId;
use std::cmp::Ordering;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Endings of the files that a folder's pictures have.
const ENDINGS: [&str; 10] = [
    "png", "jpg", "jpeg", "tif", "tiff", "bmp", "pnm", "pbm", "pgm", "ppm",
];

/// The files of each camera: of `NAME=PATTERN`, and of what follows it without a name, as a shell leaves it that
/// expanded a pattern. A pattern is a file, a folder, or a path whose last part has `*` or `?`.
///
/// # Errors
/// If an argument names no camera, or a pattern finds nothing.
pub(super) fn files(arguments: &[String]) -> Result<BTreeMap<CameraId, Vec<PathBuf>>, String> {
    let mut cameras: BTreeMap<CameraId, Vec<PathBuf>> = BTreeMap::new();
    let mut camera: Option<CameraId> = None;
    for argument in arguments {
        let (named, pattern) = match argument.split_once('=') {
            Some((name, pattern)) if !name.contains(['/', '.']) => (
                Some(CameraId::new(name).map_err(|e| e.to_string())?),
                pattern,
            ),
            _ => (None, argument.as_str()),
        };
        camera = named.or(camera);
        let id = camera.clone().ok_or_else(|| {
            format!(
                "{argument:?} does not name a camera: expected NAME=PATTERN, such as left='left/*.png'"
            )
        })?;
        let found = found(pattern)?;
        if found.is_empty() {
            return Err(format!(
                "camera {id}: no picture matches {pattern}, expected PNG, JPEG, TIFF, BMP or PNM files"
            ));
        }
        cameras.entry(id).or_default().extend(found);
    }
    for files in cameras.values_mut() {
        files.sort_by(|a, b| in_order(a, b));
        files.dedup();
    }
    Ok(cameras)
}

/// The files that match a pattern.
fn found(pattern: &str) -> Result<Vec<PathBuf>, String> {
    let path = Path::new(pattern);
    if path.is_dir() {
        let is_picture = |name: &str| {
            let ending = Path::new(name)
                .extension()
                .unwrap_or_default()
                .to_string_lossy();
            ENDINGS.contains(&&*ending.to_lowercase())
        };
        return listed(path, is_picture);
    }
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    if !name.contains(['*', '?']) || path.is_file() {
        return match path.is_file() {
            true => Ok(vec![path.to_owned()]),
            false => Err(format!(
                "picture {pattern}: there is no such file or folder"
            )),
        };
    }
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty());
    listed(folder.unwrap_or(Path::new(".")), |other| {
        !other.starts_with('.') && matches(name.as_bytes(), other.as_bytes())
    })
}

/// The files of a folder whose names are wanted.
fn listed(folder: &Path, is_wanted: impl Fn(&str) -> bool) -> Result<Vec<PathBuf>, String> {
    let failed = |e: std::io::Error| format!("folder {}: {e}", folder.display());
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        let name = path
            .file_name()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned();
        if is_wanted(&name) && path.is_file() {
            files.push(path);
        }
    }
    Ok(files)
}

/// Whether a name matches a pattern: `*` stands for any number of letters, `?` for one.
fn matches(pattern: &[u8], name: &[u8]) -> bool {
    let (mut p, mut n) = (0, 0);
    // Where the last star is, and how much of the name it stands for.
    let mut star: Option<(usize, usize)> = None;
    while n < name.len() {
        if pattern.get(p) == Some(&b'*') {
            star = Some((p, n));
            p += 1;
        } else if pattern.get(p).is_some_and(|&c| c == b'?' || c == name[n]) {
            (p, n) = (p + 1, n + 1);
        } else if let Some((at, taken)) = star {
            star = Some((at, taken + 1));
            (p, n) = (at + 1, taken + 1);
        } else {
            return false;
        }
    }
    pattern[p..].iter().all(|&c| c == b'*')
}

/// By name, numbers in it by what they are: `9.png` before `10.png`.
fn in_order(a: &Path, b: &Path) -> Ordering {
    let parts = |path: &Path| -> Vec<(u128, String)> {
        let text = path.to_string_lossy().into_owned();
        let is_digit = |c: char| c.is_ascii_digit();
        let mut parts = Vec::new();
        let mut rest = text.as_str();
        while !rest.is_empty() {
            let words = rest.find(is_digit).unwrap_or(rest.len());
            let (word, after) = rest.split_at(words);
            let digits = after.find(|c: char| !is_digit(c)).unwrap_or(after.len());
            let (number, after) = after.split_at(digits);
            parts.push((0, word.to_owned()));
            parts.push((number.parse().unwrap_or(u128::MAX), String::new()));
            rest = after;
        }
        parts
    };
    parts(a).cmp(&parts(b)).then_with(|| a.cmp(b))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stars_and_question_marks_stand_for_letters() {
        for (pattern, name, is_match) in [
            ("*.png", "a.png", true),
            ("*.png", "a.jpg", false),
            ("l*t??.jpg", "left01.jpg", true),
            ("l*t??.jpg", "left1.jpg", false),
            ("*a*b", "xaxbxab", true),
            ("*a*b", "xaxbxa", false),
            ("?", "", false),
            ("*", "", true),
        ] {
            assert_eq!(
                matches(pattern.as_bytes(), name.as_bytes()),
                is_match,
                "{pattern} {name}"
            );
        }
    }

    #[test]
    fn files_are_found_by_pattern_folder_and_name_in_the_order_of_their_numbers() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
        for name in ["l10.png", "l9.png", "l2.txt", "r09.jpg", ".l1.png", "m.PGM"] {
            std::fs::write(at(name), "").unwrap();
        }
        let names = |arguments: &[String]| {
            let found = files(arguments).unwrap();
            let name = |p: &PathBuf| p.file_name().unwrap().to_str().unwrap().to_owned();
            let of = |(id, files): (&CameraId, &Vec<PathBuf>)| {
                (id.to_string(), files.iter().map(name).collect::<Vec<_>>())
            };
            found.iter().map(of).collect::<Vec<_>>()
        };
        let left = (
            "left".to_owned(),
            vec!["l9.png".to_owned(), "l10.png".to_owned()],
        );
        let right = ("right".to_owned(), vec!["r09.jpg".to_owned()]);
        let by_pattern = [
            format!("left={}", at("l*.png")),
            format!("right={}", at("r??.jpg")),
        ];
        assert_eq!(names(&by_pattern), [left.clone(), right]);
        // As a shell leaves a pattern that it expanded.
        let expanded = [format!("left={}", at("l10.png")), at("l9.png")];
        assert_eq!(names(&expanded), [left]);
        let whole = names(&[format!("a={}", folder.path().display())]);
        assert_eq!(whole[0].1.len(), 5, "{whole:?}");
        for (bad, named) in [
            (at("l9.png"), "does not name a camera"),
            (format!("Left={}", at("l9.png")), "camera id"),
            (format!("left={}", at("x*.png")), "no picture matches"),
            (format!("left={}", at("l8.png")), "no such file"),
        ] {
            let message = files(&[bad]).unwrap_err();
            assert!(message.contains(named), "{message}");
        }
    }
}
