//! Makes a complete recording of what a crash or a power cut left: `NAME.mcap` gets everything readable in
//! `NAME.mcap.part` up to the first damage, and `NAME.mcap.tail` gets the rest. The file is repaired in place, so only
//! the tail needs space. Nothing is cut off before it is on the disk elsewhere.

use super::Error;
use super::repair::{Truncated, find_end};
use super::rewriting::{PART, copy_ownership, io, remove_stale, with_ending};
use super::source::Source;
use crate::storage::{rename_noreplace, sync_parent};
use std::fs::File;
use std::io::{BufRead, BufReader, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// What became of a recording that was cut off.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Recovered {
    /// The complete recording.
    pub path: PathBuf,
    /// Its messages.
    pub messages: u64,
    /// Where what could not be read is kept, and its bytes; `None` where all could be read.
    pub tail: Option<Tail>,
}

/// Where bytes are kept, and how many.
type Tail = (PathBuf, u64);

/// The recordings in a folder that were not completed, in the order of their names.
///
/// # Errors
/// If the folder cannot be read.
pub fn unfinished(folder: &Path) -> Result<Vec<PathBuf>, Error> {
    let entries = std::fs::read_dir(folder).map_err(io(folder))?;
    let mut parts = Vec::new();
    for entry in entries {
        let path = entry.map_err(io(folder))?.path();
        if finished_name(&path).is_some() {
            parts.push(path);
        }
    }
    parts.sort();
    Ok(parts)
}

/// Completes a recording that was cut off. Intact bytes are never overwritten, and the rest is cut off when it is on
/// the disk under its own name: at any moment a power cut leaves a file that has lost nothing and can be
/// completed. Where a crash came between the recording's getting its name and the loss of its old one, the old one
/// goes; another recording is never touched.
///
/// # Errors
/// If the file is not a `.part`, is still being written, is not a recording, or its final name is taken; or there is no
/// room for what cannot be read. The `.part` then stays as it is.
pub fn recover(part: &Path) -> Result<Recovered, Error> {
    let path = finished_name(part).ok_or_else(|| Error::NotUnfinished { path: part.into() })?;
    let source = Source::lock(part)?;
    let found = find_end(&source)?;
    let is_there = path.try_exists().map_err(io(&path))?;
    if is_there {
        let other = File::open(&path).map_err(io(&path))?;
        if !found.is_completed_in(&source, &other)? {
            return Err(io(&path)(std::io::ErrorKind::AlreadyExists.into()));
        }
    }
    let tail = match found.rest {
        0 => None,
        rest => Some((keep_tail(&source.file, part, found.sound, &path)?, rest)),
    };
    let done = if is_there {
        std::fs::remove_file(part)
    } else {
        complete(&found, &source.file, part, &path)
    };
    done.and_then(|()| sync_parent(&path)).map_err(io(part))?;
    Ok(Recovered {
        path,
        messages: found.messages,
        tail,
    })
}

fn complete(found: &Truncated, file: &File, part: &Path, path: &Path) -> std::io::Result<()> {
    found.complete(file)?;
    file.sync_all()?;
    rename_noreplace(part, path)
}

/// The ending of the file with what could not be read. Those of later recoveries have a number behind it.
const TAIL: &str = "tail";

/// The files beside a complete recording that keep what could not be read when it was completed, in the order in which
/// they were made: the endings that they have behind the recording's name, and their paths.
///
/// # Errors
/// If the folder cannot be read.
pub fn tails(recording: &Path) -> Result<Vec<(String, PathBuf)>, Error> {
    let folder = match recording.parent() {
        Some(folder) if folder != Path::new("") => folder,
        _ => Path::new("."),
    };
    let name = recording.file_name().unwrap_or_default().to_string_lossy();
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(io(folder))? {
        let entry = entry.map_err(io(folder))?.file_name();
        let entry = entry.to_string_lossy();
        let ending = entry
            .strip_prefix(&*name)
            .and_then(|rest| rest.strip_prefix('.'));
        if let Some((number, ending)) = ending.and_then(|ending| Some((number(ending)?, ending))) {
            found.push((number, ending.to_owned()));
        }
    }
    found.sort();
    let tail = |(_, ending): (u64, String)| {
        let path = with_ending(recording, &ending);
        (ending, path)
    };
    Ok(found.into_iter().map(tail).collect())
}

/// How many tails were there before one with this ending, and itself; `None` if it is no tail's.
fn number(ending: &str) -> Option<u64> {
    match ending.strip_prefix(TAIL)? {
        "" => Some(1),
        rest => {
            let number = rest.strip_prefix('-')?;
            let is_plain = number.bytes().all(|b| b.is_ascii_digit());
            number.parse().ok().filter(|&n| is_plain && n > 1)
        }
    }
}

/// Copies what could not be read into a file beside the recording, durably, and returns its path. The file of an
/// earlier recovery stays.
fn keep_tail(mut file: &File, part: &Path, from: u64, path: &Path) -> Result<PathBuf, Error> {
    let mut tail = with_ending(path, TAIL);
    let mut number = 1;
    while tail.try_exists().map_err(io(&tail))? {
        if is_kept(file, from, &tail).map_err(io(&tail))? {
            return Ok(tail);
        }
        number += 1;
        tail = with_ending(path, &format!("{TAIL}-{number}"));
    }
    let staged = with_ending(&tail, "recovering");
    remove_stale(&staged)?;
    let mut copied = || {
        file.seek(SeekFrom::Start(from))?;
        let mut copy = File::create_new(&staged)?;
        std::io::copy(&mut file, &mut copy)?;
        let _ = copy_ownership(&copy, &file.metadata()?);
        copy.sync_all()?;
        rename_noreplace(&staged, &tail)?;
        sync_parent(&tail)
    };
    copied().map_err(io(part))?;
    Ok(tail)
}

/// Whether a tail holds all of the file from `from` on: a recovery that was cut off itself has got so far.
fn is_kept(mut file: &File, from: u64, tail: &Path) -> std::io::Result<bool> {
    let tail = File::open(tail)?;
    if tail.metadata()?.len() != file.metadata()?.len() - from {
        return Ok(false);
    }
    file.seek(SeekFrom::Start(from))?;
    let (mut kept, mut rest) = (BufReader::new(tail), BufReader::new(file));
    loop {
        let (a, b) = (kept.fill_buf()?, rest.fill_buf()?);
        let length = a.len().min(b.len());
        if length == 0 {
            return Ok(a.len() == b.len());
        }
        if a[..length] != b[..length] {
            return Ok(false);
        }
        kept.consume(length);
        rest.consume(length);
    }
}

/// The name that a recording gets when it is complete, of one that is not: `NAME.mcap` of `NAME.mcap.part`. NAME also
/// names a folder, so it is neither `.` nor `..`.
pub fn finished_name(part: &Path) -> Option<PathBuf> {
    let name = part.file_name()?.to_str()?.strip_suffix(PART)?;
    let stem = name.strip_suffix(".mcap")?;
    (!matches!(stem, "." | "..")).then(|| part.with_file_name(name))
}

/// The name that a recording has until it is complete: `NAME.mcap.part` of `NAME.mcap`.
pub fn unfinished_name(path: &Path) -> PathBuf {
    with_ending(path, "part")
}
