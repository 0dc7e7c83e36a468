//! A result as it travels: one file that holds the files of a model's folder, under names that are fixed, each with its
//! length, packed. Its first line says what the files are worth comparing by: the digest of all that two runs of the
//! same job have in common.

use super::subjects::is_digest;
use crate::storage::with_advice;
use crate::words::hexadecimal;
use sha2::{Digest, Sha256};
use std::fs::File;
use std::io::{BufReader, BufWriter, Read, Write};
use std::path::{Path, PathBuf};

/// The files that a bundle may hold, in their order, and the largest that each may be, in bytes.
const FILES: [(&str, u64); 4] = [
    ("model.glb", 1 << 30),
    ("model.ply", 1 << 30),
    ("preview.png", 64 << 20),
    (REPORT, 16 << 20),
];
/// The report.
pub(super) const REPORT: &str = "report.json";
/// What a report says of the run and not of the model, and what people said later.
const OF_THE_RUN: [&str; 2] = ["timing", "notes"];
const MAGIC: &[u8] = b"scand bundle 1\n";
/// Pictures are packed already, and vertices hardly shrink: faster than the fastest ordinary level, and 8 % larger.
const LEVEL: i32 = -1;

/// Whether a folder holds a model, and not the report of a failure.
pub(super) fn has_model(target: &Path) -> bool {
    target.join("model.glb").exists()
}

/// Why a bundle cannot be written or read.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum BundleError {
    /// A file cannot be read or written.
    #[error("{}", with_advice(path, cause))]
    Io {
        path: PathBuf,
        cause: std::io::Error,
    },
    /// It is no bundle, or holds what none may hold.
    #[error("{}: the file is not a valid result: {what}", path.display())]
    NotABundle { path: PathBuf, what: String },
}

/// The files of a result, by name, in their order.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Bundle {
    /// Names and contents.
    pub files: Vec<(&'static str, Vec<u8>)>,
}

impl Bundle {
    /// The files of a model's folder, as far as they may travel.
    ///
    /// # Errors
    /// If one cannot be read or is larger than it may be.
    pub fn of_folder(folder: &Path) -> Result<Self, BundleError> {
        let mut bundle = Self::default();
        for (name, most) in FILES {
            let path = folder.join(name);
            match std::fs::read(&path) {
                Ok(bytes) if bytes.len() as u64 <= most => bundle.files.push((name, bytes)),
                Ok(bytes) => {
                    let what = format!("{} bytes, expected at most {most}", bytes.len());
                    return Err(BundleError::NotABundle { path, what });
                }
                Err(cause) if cause.kind() == std::io::ErrorKind::NotFound => {}
                Err(cause) => return Err(BundleError::Io { path, cause }),
            }
        }
        Ok(bundle)
    }

    /// A file's content.
    pub fn file(&self, name: &str) -> Option<&[u8]> {
        let found = self.files.iter().find(|(known, _)| *known == name);
        found.map(|(_, bytes)| &bytes[..])
    }

    /// SHA-256 over the files, but for what a report says of its run and of people's notes.
    ///
    /// # Errors
    /// If its report is no JSON object.
    pub fn contents_sha256(&self) -> Result<String, String> {
        let mut hash = Sha256::new();
        for (name, bytes) in &self.files {
            let report;
            let bytes: &[u8] = if *name == REPORT {
                let mut json: serde_json::Map<String, serde_json::Value> =
                    serde_json::from_slice(bytes).map_err(|e| format!("{REPORT}: {e}"))?;
                OF_THE_RUN.iter().for_each(|member| {
                    json.remove(*member);
                });
                report = serde_json::to_vec(&json).map_err(|e| e.to_string())?;
                &report
            } else {
                bytes
            };
            for part in [name.as_bytes(), bytes] {
                hash.update((part.len() as u64).to_le_bytes());
                hash.update(part);
            }
        }
        Ok(hexadecimal(&hash.finalize()))
    }
}

/// SHA-256 over the files of a model's folder, as [`Bundle::contents_sha256`].
///
/// # Errors
/// If they cannot be read.
pub fn contents_sha256(folder: &Path) -> Result<String, String> {
    let bundle = Bundle::of_folder(folder).map_err(|e| e.to_string())?;
    bundle.contents_sha256()
}

/// Writes a bundle to `path`.
///
/// # Errors
/// If it cannot be written.
pub fn write_bundle(bundle: &Bundle, path: &Path) -> Result<(), BundleError> {
    let io = |cause| BundleError::Io {
        path: path.to_owned(),
        cause,
    };
    let contents = bundle.contents_sha256();
    let contents = contents.map_err(|what| BundleError::NotABundle {
        path: path.to_owned(),
        what,
    })?;
    let write = || -> std::io::Result<()> {
        let mut file = BufWriter::new(File::create(path)?);
        file.write_all(MAGIC)?;
        file.write_all(contents.as_bytes())?;
        file.write_all(b"\n")?;
        let mut packed = zstd::Encoder::new(file, LEVEL)?;
        for (name, bytes) in &bundle.files {
            let place = FILES.iter().position(|(known, _)| known == name);
            packed.write_all(&[place.unwrap_or(FILES.len()) as u8])?;
            packed.write_all(&(bytes.len() as u64).to_le_bytes())?;
            packed.write_all(bytes)?;
        }
        packed.finish()?.flush()
    };
    write().map_err(io)
}

/// What the first line of a bundle says; nothing else is read.
///
/// # Errors
/// If it does not begin as a bundle does.
pub(super) fn stated_contents(path: &Path) -> Result<String, BundleError> {
    let io = |cause| BundleError::Io {
        path: path.to_owned(),
        cause,
    };
    let mut head = vec![0; MAGIC.len() + 65];
    File::open(path)
        .and_then(|mut file| file.read_exact(&mut head))
        .map_err(io)?;
    let said = head
        .strip_prefix(MAGIC)
        .and_then(|rest| rest.strip_suffix(b"\n"));
    let said = said.and_then(|said| std::str::from_utf8(said).ok());
    match said.filter(|said| is_digest(said)) {
        Some(said) => Ok(said.to_owned()),
        None => Err(BundleError::NotABundle {
            path: path.to_owned(),
            what: "it does not begin with the first line of a result".into(),
        }),
    }
}

/// Reads a bundle from outside. Its files may have the known names alone, each once, in their order, and be no larger
/// than such a file may be; what its first line says of them, the SHA-256 that is returned with it, has to be true.
///
/// # Errors
/// If it cannot be read, or is not a bundle.
pub fn read_bundle(path: &Path) -> Result<(Bundle, String), BundleError> {
    let io = |cause| BundleError::Io {
        path: path.to_owned(),
        cause,
    };
    let bad = |what: String| BundleError::NotABundle {
        path: path.to_owned(),
        what,
    };
    let said = stated_contents(path)?;
    let mut file = BufReader::new(File::open(path).map_err(io)?);
    let mut head = vec![0; MAGIC.len() + 65];
    file.read_exact(&mut head).map_err(io)?;
    let mut packed = zstd::Decoder::with_buffer(file).map_err(io)?;
    // A bundle cannot ask for more memory than its packing needs at the level that we write.
    packed.window_log_max(27).map_err(io)?;
    let mut bundle = Bundle::default();
    let mut next = 0;
    loop {
        let mut place = [0];
        match packed.read(&mut place) {
            Ok(0) => break,
            Ok(_) => {}
            Err(cause) => return Err(bad(cause.to_string())),
        }
        let place = usize::from(place[0]);
        let Some((name, most)) = FILES.get(place).filter(|_| place >= next) else {
            return Err(bad(format!(
                "file number {place} is unknown or out of order"
            )));
        };
        next = place + 1;
        let mut length = [0; 8];
        packed
            .read_exact(&mut length)
            .map_err(|cause| bad(cause.to_string()))?;
        let length = u64::from_le_bytes(length);
        if length > *most {
            return Err(bad(format!(
                "{name} has {length} bytes, expected at most {most}"
            )));
        }
        let mut bytes = Vec::new();
        let read = packed.by_ref().take(length).read_to_end(&mut bytes);
        read.map_err(|cause| bad(cause.to_string()))?;
        if bytes.len() as u64 != length {
            return Err(bad(format!("{name} ends before its {length} bytes")));
        }
        bundle.files.push((name, bytes));
    }
    let contents = bundle.contents_sha256().map_err(bad)?;
    if contents != said {
        return Err(bad(
            "its files are not those that its first line names".into()
        ));
    }
    Ok((bundle, said))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bundle(timing: u32) -> Bundle {
        let report = format!(r#"{{"outcome":"done","timing":{{"total_s":{timing}}}}}"#);
        Bundle {
            files: vec![
                ("model.glb", vec![7; 3000]),
                ("model.ply", b"ply".to_vec()),
                ("preview.png", Vec::new()),
                (REPORT, report.into_bytes()),
            ],
        }
    }

    #[test]
    fn what_was_written_is_read_and_two_runs_of_a_job_have_one_digest() {
        let home = tempfile::tempdir().unwrap();
        let path = home.path().join("bundle");
        write_bundle(&bundle(1), &path).unwrap();
        assert_eq!(read_bundle(&path).unwrap().0, bundle(1));
        let said = stated_contents(&path).unwrap();
        assert_eq!(said, bundle(2).contents_sha256().unwrap());
        let mut other = bundle(1);
        other.files[1].1.push(b' ');
        assert_ne!(said, other.contents_sha256().unwrap());
        for (name, bytes) in bundle(1).files {
            std::fs::write(home.path().join(name), bytes).unwrap();
        }
        std::fs::write(home.path().join("other.txt"), b"stays").unwrap();
        assert_eq!(Bundle::of_folder(home.path()).unwrap(), bundle(1));
        assert_eq!(contents_sha256(home.path()).unwrap(), said);
    }

    #[test]
    fn a_full_disk_comes_with_advice() {
        let full = BundleError::Io {
            path: "bundle".into(),
            cause: std::io::ErrorKind::StorageFull.into(),
        };
        let told = full.to_string();
        assert!(told.starts_with("bundle: "), "{told}");
        assert!(
            told.ends_with("free some space there, and try again"),
            "{told}"
        );
    }

    /// A bundle whose packed part is this.
    fn hostile(content: &[u8]) -> Result<Bundle, BundleError> {
        let home = tempfile::tempdir().unwrap();
        let path = home.path().join("bundle");
        let empty = Bundle::default().contents_sha256().unwrap();
        let packed = zstd::encode_all(content, LEVEL).unwrap();
        let bytes = [MAGIC, empty.as_bytes(), b"\n", &packed].concat();
        std::fs::write(&path, bytes).unwrap();
        read_bundle(&path).map(|(bundle, _)| bundle)
    }

    #[test]
    fn other_names_lengths_and_orders_are_refused() {
        assert_eq!(hostile(b"").unwrap(), Bundle::default());
        let file = |place: u8, length: u64, bytes: &[u8]| {
            [&[place][..], &length.to_le_bytes(), bytes].concat()
        };
        let ends = hostile(&file(0, 10, b"short")).unwrap_err().to_string();
        assert!(ends.contains("ends before"), "{ends}");
        let large = hostile(&file(2, u64::MAX, b"")).unwrap_err().to_string();
        assert!(large.contains("at most"), "{large}");
        for place in [4, 5, 255] {
            let unknown = hostile(&file(place, 0, b"")).unwrap_err().to_string();
            assert!(unknown.contains("unknown or out of order"), "{unknown}");
        }
        let twice = [file(1, 1, b"a"), file(1, 1, b"a")].concat();
        assert!(hostile(&twice).is_err());
        let backwards = [file(1, 1, b"a"), file(0, 1, b"a")].concat();
        assert!(hostile(&backwards).is_err());
        let lie = hostile(&file(0, 1, b"a")).unwrap_err().to_string();
        assert!(lie.contains("first line"), "{lie}");
        hostile(&file(3, 4, b"none")).unwrap_err();
    }

    #[test]
    fn what_is_no_bundle_and_what_is_cut_off_is_refused() {
        let home = tempfile::tempdir().unwrap();
        let path = home.path().join("bundle");
        write_bundle(&bundle(1), &path).unwrap();
        let whole = std::fs::read(&path).unwrap();
        let contents = bundle(1).contents_sha256().unwrap();
        for length in 0..whole.len() {
            std::fs::write(&path, &whole[..length]).unwrap();
            read_bundle(&path).unwrap_err();
        }
        for place in 0..whole.len() {
            let mut spoilt = whole.clone();
            spoilt[place] ^= 0x10;
            std::fs::write(&path, &spoilt).unwrap();
            if let Ok((read, _)) = read_bundle(&path) {
                // The report's timing is not in the digest of the contents.
                assert_eq!(read.contents_sha256().unwrap(), contents, "byte {place}");
            }
        }
    }
}
