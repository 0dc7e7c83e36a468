//! Reads picture files as a calibration session: the n-th file of each camera shows the n-th placement.

use super::error::Error;
use crate::frame::{CameraId, Picture};
use crate::storage;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// Largest picture file, in bytes.
const LARGEST_FILE: u64 = 1 << 30;
/// Most numbers of pictures that a message names for a camera.
const MOST_NAMED: usize = 10;

/// The pictures of some cameras, placement after placement.
#[derive(Clone, Debug, PartialEq)]
pub struct PictureFiles {
    cameras: BTreeMap<CameraId, Vec<PathBuf>>,
    placements: Vec<String>,
    warnings: Vec<String>,
}

impl PictureFiles {
    /// The pictures of each camera in the order of the placements.
    ///
    /// # Errors
    /// If a camera has no pictures or two files that seem to be the same one, or two cameras have unequal numbers of
    /// pictures.
    pub fn new(cameras: BTreeMap<CameraId, Vec<PathBuf>>) -> Result<Self, Error> {
        for (camera, files) in &cameras {
            if let Some(files) = same_name(files) {
                let camera = camera.clone();
                return Err(Error::SameName { camera, files });
            }
        }
        let counts: BTreeSet<usize> = cameras.values().map(Vec::len).collect();
        let count = match counts.iter().collect::<Vec<_>>()[..] {
            [&count] if count > 0 => count,
            _ => {
                let of = |(id, files): (&CameraId, &Vec<PathBuf>)| format!("{id} {}", files.len());
                let counts: Vec<String> = cameras.iter().map(of).collect();
                return Err(Error::PictureCounts {
                    counts: counts.join(", "),
                    lacking: lacking_words(&cameras).unwrap_or_default(),
                });
            }
        };
        let at = |placement: usize| -> Vec<&Path> {
            cameras
                .values()
                .map(|files| files[placement].as_path())
                .collect()
        };
        let numbers: Vec<Option<String>> = (0..count).map(|p| common_number(&at(p))).collect();
        let mixed = cameras
            .iter()
            .filter_map(|(id, files)| mixed_words(id, files));
        let unlike = (0..count).filter(|&p| numbers[p].is_none()).filter_map(|p| {
            let names: Vec<String> = at(p).into_iter().map(file_name).collect();
            let numbered = names.iter().filter_map(|name| number(name)).count();
            (numbered == names.len()).then(|| {
                format!(
                    "{} are used as one placement, but their names have different numbers: is a picture missing?",
                    names.join(" and ")
                )
            })
        });
        Ok(Self {
            warnings: mixed.chain(unlike).collect(),
            placements: names(&numbers),
            cameras,
        })
    }

    /// The placements' names.
    pub fn placements(&self) -> &[String] {
        &self.placements
    }

    /// What a person should know of the files.
    pub fn warnings(&self) -> &[String] {
        &self.warnings
    }

    /// The cameras.
    pub fn cameras(&self) -> impl Iterator<Item = &CameraId> {
        self.cameras.keys()
    }

    /// The file of each camera, placement after placement.
    pub fn files(&self) -> impl Iterator<Item = (&str, &CameraId, &Path)> {
        let all = self.placements.iter().enumerate();
        all.flat_map(|(index, placement)| {
            let files = self.cameras.iter();
            files.map(move |(id, files)| (placement.as_str(), id, files[index].as_path()))
        })
    }
}

/// A file as a camera would hand it over; what it is, its first bytes say.
///
/// # Errors
/// If it cannot be read, or is larger than any picture.
pub(super) fn read(path: &Path) -> Result<Picture, Error> {
    let failed = |cause| Error::PictureFile {
        path: path.into(),
        cause,
    };
    let data = storage::read(path, LARGEST_FILE).map_err(failed)?;
    let format = match &data[..] {
        [0xff, 0xd8, ..] => "jpeg".to_owned(),
        [0x89, b'P', b'N', b'G', ..] => "png".to_owned(),
        [b'B', b'M', ..] => "bmp".to_owned(),
        [b'P', b'1'..=b'7', b' ' | b'\t' | b'\r' | b'\n' | b'#', ..] => "pnm".to_owned(),
        [b'I', b'I', 42, 0, ..] | [b'M', b'M', 0, 42, ..] => "tiff".to_owned(),
        _ => path
            .extension()
            .unwrap_or_default()
            .to_string_lossy()
            .to_lowercase(),
    };
    Ok(Picture::Compressed {
        format,
        data: data.into(),
    })
}

/// Names placements by the number that their files have in common, if each placement has a different one; otherwise
/// counts them.
fn names(numbers: &[Option<String>]) -> Vec<String> {
    let own: BTreeSet<&String> = numbers.iter().flatten().collect();
    let digits = numbers.len().to_string().len().max(2);
    let is_numbered = own.len() == numbers.len();
    let name = |(index, number): (usize, &Option<String>)| match number {
        Some(number) if is_numbered => format!("p{number}"),
        _ => format!("p{:0digits$}", index + 1),
    };
    numbers.iter().enumerate().map(name).collect()
}

/// The number that all of these files have, as the first one's name writes it: 1 and 01 are one number.
fn common_number(files: &[&Path]) -> Option<String> {
    let numbers: Vec<_> = files.iter().map(|file| number(&file_name(file))).collect();
    let first = numbers.first().cloned().flatten()?;
    let value = |number: &str| number.trim_start_matches('0').to_owned();
    let is_common = numbers
        .iter()
        .all(|other| other.as_deref().map(value) == Some(value(&first)));
    (is_common && first.len() <= 32).then_some(first)
}

/// The last digits of a file's name before its ending.
fn number(name: &str) -> Option<String> {
    let stem = name.rsplit_once('.').map_or(name, |(stem, _)| stem);
    let end = stem.trim_end_matches(|c: char| !c.is_ascii_digit());
    let start = end.trim_end_matches(|c: char| c.is_ascii_digit());
    let digits = &end[start.len()..];
    (!digits.is_empty()).then(|| digits.to_owned())
}

/// Two files of one folder whose names differ only by zeros before their number, and by their ending.
fn same_name(files: &[PathBuf]) -> Option<[PathBuf; 2]> {
    let mut known: BTreeMap<(Option<&Path>, String), &PathBuf> = BTreeMap::new();
    for file in files {
        let name = (file.parent(), without_zeros(&stem(file)));
        if let Some(other) = known.insert(name, file) {
            return Some([other.clone(), file.clone()]);
        }
    }
    None
}

/// A file's name with a single zero before its number, if it has one.
fn without_zeros(stem: &str) -> String {
    let end = stem.trim_end_matches(|c: char| !c.is_ascii_digit());
    let prefix = end.trim_end_matches(|c: char| c.is_ascii_digit());
    let (number, rest) = (&end[prefix.len()..], &stem[end.len()..]);
    match number.is_empty() {
        true => stem.to_owned(),
        false => format!("{prefix}0{}{rest}", number.trim_start_matches('0')),
    }
}

/// That a camera's files seem to be of two cameras, because two names occur with several numbers each.
fn mixed_words(camera: &CameraId, files: &[PathBuf]) -> Option<String> {
    let mut named: BTreeMap<String, Vec<&PathBuf>> = BTreeMap::new();
    for file in files {
        let mut name = stem(file);
        name.retain(|c| !c.is_ascii_digit());
        named.entry(name).or_default().push(file);
    }
    let several: Vec<&PathBuf> = (named.values().filter(|files| files.len() > 1))
        .filter_map(|files| files.first().copied())
        .collect();
    let [one, other, ..] = several.as_slice() else {
        return None;
    };
    Some(format!(
        "camera {camera}: its files have different names, such as {} and {}: are all of them pictures of this camera?",
        file_name(one),
        file_name(other)
    ))
}

/// Which numbers of pictures some cameras lack; `None` if not every file has a number that no other file of its camera
/// has.
fn lacking_words(cameras: &BTreeMap<CameraId, Vec<PathBuf>>) -> Option<String> {
    let value = |file: &PathBuf| number(&file_name(file))?.parse::<u64>().ok();
    let mut numbers: BTreeMap<&CameraId, BTreeSet<u64>> = BTreeMap::new();
    for (camera, files) in cameras {
        let own: BTreeSet<u64> = files.iter().map(value).collect::<Option<_>>()?;
        if own.len() < files.len() {
            return None;
        }
        numbers.insert(camera, own);
    }
    let all: BTreeSet<u64> = numbers.values().flatten().copied().collect();
    let lacking = numbers.iter().filter_map(|(camera, own)| {
        let lacking: Vec<String> = all.difference(own).map(u64::to_string).collect();
        let shown = match lacking.len() {
            0 => return None,
            1..=MOST_NAMED => lacking.join(", "),
            more => format!("{}, … ({more} in all)", lacking[..MOST_NAMED].join(", ")),
        };
        Some(format!("; {camera} has no picture with the number {shown}"))
    });
    Some(lacking.collect())
}

/// A file's name without its ending.
fn stem(path: &Path) -> String {
    let stem = path.file_stem().unwrap_or_default();
    stem.to_string_lossy().into_owned()
}

fn file_name(path: &Path) -> String {
    path.file_name()
        .unwrap_or_default()
        .to_string_lossy()
        .into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn files(cameras: &[(&str, &[&str])]) -> Result<PictureFiles, Error> {
        let of = |(id, files): &(&str, &[&str])| {
            let files = files.iter().map(PathBuf::from).collect();
            (CameraId::new(id).unwrap(), files)
        };
        PictureFiles::new(cameras.iter().map(of).collect())
    }

    #[test]
    fn placements_are_named_by_the_number_of_their_files() {
        let numbered = files(&[
            ("left", &["l09.jpg", "l11.jpg"]),
            ("right", &["r09.jpg", "r11.jpg"]),
        ]);
        let numbered = numbered.unwrap();
        assert_eq!(numbered.placements(), ["p09", "p11"]);
        assert!(numbered.warnings().is_empty());
        let all: Vec<_> = numbered
            .files()
            .map(|(p, id, f)| (p, id.as_str(), f.to_str().unwrap()))
            .collect();
        assert_eq!(all[2], ("p11", "left", "l11.jpg"));
        let unnumbered = files(&[("a", &["one.png", "two.png"])]).unwrap();
        assert_eq!(unnumbered.placements(), ["p01", "p02"]);
        assert!(unnumbered.warnings().is_empty());
        // Zeros before a number change nothing.
        let padded = files(&[("left", &["l9.png"]), ("right", &["r09.png"])]).unwrap();
        assert_eq!(padded.placements(), ["p9"]);
        assert!(padded.warnings().is_empty());
        // The same number twice names nothing.
        let twice = files(&[("a", &["x/1.png", "y/1.png"])]).unwrap();
        assert_eq!(twice.placements(), ["p01", "p02"]);
    }

    #[test]
    fn files_that_do_not_belong_together_are_named() {
        let shifted = files(&[
            ("left", &["l1.jpg", "l2.jpg"]),
            ("right", &["r1.jpg", "r3.jpg"]),
        ])
        .unwrap();
        assert_eq!(shifted.warnings().len(), 1);
        assert!(
            shifted.warnings()[0].starts_with("l2.jpg and r3.jpg are used"),
            "{:?}",
            shifted.warnings()
        );
        let message = files(&[("left", &["1", "2"]), ("right", &["1"])])
            .unwrap_err()
            .to_string();
        assert!(message.contains("left 2, right 1"), "{message}");
        let message = files(&[("left", &[])]).unwrap_err().to_string();
        assert!(message.contains("left 0"), "{message}");
    }

    #[test]
    fn the_pictures_that_a_camera_lacks_are_named() {
        let message = |left: &[&str], right: &[&str]| {
            let error = files(&[("left", left), ("right", right)]).unwrap_err();
            error.to_string()
        };
        let told = message(&["l01.png", "l02.png", "l03.png"], &["r01.png", "r3.png"]);
        assert!(
            told.ends_with("as many as the others; right has no picture with the number 2"),
            "{told}"
        );
        let told = message(&["l01.png", "l02.png", "l03.png"], &["a.png"]);
        assert!(told.ends_with("as many as the others"), "{told}");
        let many: Vec<String> = (1..=30).map(|k| format!("l{k}.png")).collect();
        let many: Vec<&str> = many.iter().map(String::as_str).collect();
        let told = message(&many, &["r30.png"]);
        assert!(
            told.ends_with("1, 2, 3, 4, 5, 6, 7, 8, 9, 10, … (29 in all)"),
            "{told}"
        );
    }

    #[test]
    fn one_picture_in_two_files_is_refused() {
        for [a, b] in [["l/1.jpg", "l/1.png"], ["l/left01.png", "l/left1.png"]] {
            let message = files(&[("left", &[a, b])]).unwrap_err().to_string();
            let words = format!("camera left: {a} and {b} have names that differ only in zeros");
            assert!(message.starts_with(&words), "{message}");
        }
        for [a, b] in [
            ["l/1.png", "r/1.png"],
            ["1a.png", "1b.png"],
            ["a0.png", "a.png"],
        ] {
            assert!(files(&[("left", &[a, b])]).is_ok(), "{a} {b}");
        }
    }

    #[test]
    fn files_of_two_cameras_under_one_name_are_asked_about() {
        let mixed = files(&[("a", &["left1.png", "left2.png", "right1.png", "right2.png"])]);
        let words = "camera a: its files have different names, such as left1.png and right1.png: are all of them \
                     pictures of this camera?";
        assert_eq!(mixed.unwrap().warnings(), [words]);
        for names in [
            ["one.png", "two.png", "three.png"],
            ["IMG_0401_1.png", "IMG_0401_2.png", "IMG_0402_1.png"],
            ["l1.png", "l2.png", "last.png"],
        ] {
            assert!(
                files(&[("a", &names)]).unwrap().warnings().is_empty(),
                "{names:?}"
            );
        }
    }

    #[test]
    fn what_a_file_is_its_first_bytes_say() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.dat");
        for (bytes, expected) in [
            (&[0xff, 0xd8, 0xff][..], "jpeg"),
            (b"BM\x00\x00", "bmp"),
            (b"P5 2 1 255\n\x00\xff", "pnm"),
            (b"II*\0", "tiff"),
            (b"Paris", "dat"),
        ] {
            std::fs::write(&path, bytes).unwrap();
            let Picture::Compressed { format, .. } = read(&path).unwrap() else {
                panic!("files are compressed pictures")
            };
            assert_eq!(format, expected);
        }
        let message = read(&folder.path().join("none.png"))
            .unwrap_err()
            .to_string();
        assert!(message.contains("none.png"), "{message}");
    }
}
