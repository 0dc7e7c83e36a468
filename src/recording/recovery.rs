//! What a crash or a power cut left behind, made a complete recording: all that can be read of `NAME.mcap.part` is in
//! `NAME.mcap` then, what cannot be read in `NAME.mcap.tail`. A recording that is as it was written up to where it is cut
//! off or damaged is given an end where it is; of another one a copy is made. Nothing is removed before what is to stay
//! is on the disk.

use super::completing::{Unended, unended};
use super::entries::{Entry, each_entry};
use super::rewriting::{dress, io, lock, remove_stale, with_ending};
use super::writer::{Compression, PART, Writer};
use super::{Error, Recording};
use crate::storage::{rename_noreplace, sync_parent};
use sha2::{Digest, Sha256};
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

/// Completes a recording that was cut off. It is read from front to back up to the first damage; where there is
/// no room for a copy, or anything else fails, the `.part` stays as it is.
///
/// # Errors
/// If the file is none that was cut off, is being written, is no recording, or another one has its name; or the copy
/// cannot be written.
pub fn recover(part: &Path) -> Result<Recovered, Error> {
    let path = finished_name(part).ok_or_else(|| Error::NotUnfinished { path: part.into() })?;
    match complete(part, &path)? {
        Some(recovered) => Ok(recovered),
        None => recover_by_copy(part, path),
    }
}

/// Gives a recording its end where it is cut off or damaged, and its name; `None` if what is before that is not as the
/// writer makes it, or it cannot be written to, or the name is taken.
///
/// What was whole is never written over, and the rest is cut away when it is on the disk under its own name. So at any
/// moment a power cut leaves a file of which nothing is lost, and which can be completed.
fn complete(part: &Path, path: &Path) -> Result<Option<Recovered>, Error> {
    let Ok(mut file) = File::options().read(true).write(true).open(part) else {
        return Ok(None);
    };
    lock(&file, part)?;
    if path.try_exists().map_err(io(path))? {
        return Ok(None);
    }
    let Some(found) = unended(&file).map_err(io(part))? else {
        return Ok(None);
    };
    // Of an earlier attempt to copy it.
    remove_stale(&with_ending(path, "recovering"))?;
    let Unended { sound, .. } = found;
    let tail = match found.rest() {
        0 => None,
        rest => Some((keep_tail(&mut file, part, sound, path)?, rest)),
    };
    found
        .complete(&file)
        .and_then(|()| file.sync_all())
        .and_then(|()| rename_noreplace(part, path))
        .and_then(|()| sync_parent(path))
        .map_err(io(part))?;
    Ok(Some(Recovered {
        path: path.into(),
        messages: found.messages,
        tail,
    }))
}

/// Completes a copy of what can be read of it. Where a crash came between the recording's getting its name and the removal
/// of its `.part`, it is there already; another recording is never touched.
pub(super) fn recover_by_copy(part: &Path, path: PathBuf) -> Result<Recovered, Error> {
    let mut file = File::open(part).map_err(io(part))?;
    lock(&file, part)?;
    let found = readable(&file, part)?;
    let staged = with_ending(&path, "recovering");
    remove_stale(&staged)?;
    let (messages, tail) = if path.try_exists().map_err(io(&path))? {
        let messages = messages_if_equal(&mut file, part, found.bytes, &path)?;
        (messages, found.keep_rest(&mut file, part, &path)?)
    } else {
        let done = put_into_place(&mut file, part, &found, &path, &staged);
        // What was begun and not put into place is of no use, and may be what filled the disk.
        let removed = remove_stale(&staged);
        let done = done?;
        removed?;
        done
    };
    std::fs::remove_file(part)
        .and_then(|()| sync_parent(part))
        .map_err(io(part))?;
    Ok(Recovered {
        path,
        messages,
        tail,
    })
}

/// Copies what can be read, first into `staged`, and keeps the rest; how many messages there were, and where the rest is.
fn put_into_place(
    file: &mut File,
    part: &Path,
    found: &Readable,
    path: &Path,
    staged: &Path,
) -> Result<(u64, Option<Tail>), Error> {
    let mut writer = Writer::create_at(path, staged, &found.program, Compression::None)?;
    let messages = each_copied(file, part, (found.bytes, true), |entry| {
        entry.write_to(&mut writer)
    })?;
    let tail = found.keep_rest(file, part, path)?;
    // Who may not give it away keeps it: an owner is no reason to leave a recording cut off.
    let copy = File::options().write(true).open(staged);
    let _ = copy.and_then(|copy| dress(&copy, &file.metadata()?));
    writer.finish()?;
    Ok((messages, tail))
}

/// How many messages can be read, if they and all else are what the recording under the name holds.
fn messages_if_equal(
    file: &mut File,
    part: &Path,
    readable: u64,
    path: &Path,
) -> Result<u64, Error> {
    let (mut ours, mut theirs) = (Sha256::new(), Sha256::new());
    let mut other = File::open(path).map_err(io(path))?;
    let length = other.metadata().map_err(io(path))?.len();
    each_copied(&mut other, path, (length, false), |entry| {
        entry.add_to(&mut theirs);
        Ok(())
    })?;
    let messages = each_copied(file, part, (readable, true), |entry| {
        entry.add_to(&mut ours);
        Ok(())
    })?;
    if ours.finalize() == theirs.finalize() {
        return Ok(messages);
    }
    Err(io(path)(std::io::ErrorKind::AlreadyExists.into()))
}

/// Hands out what a copy takes over of the first `readable` bytes; how many messages there were.
fn each_copied(
    file: &mut File,
    path: &Path,
    (readable, is_checked): (u64, bool),
    mut each: impl FnMut(&Entry) -> Result<(), Error>,
) -> Result<u64, Error> {
    let mut messages = 0;
    if readable == 0 {
        return Ok(messages);
    }
    each_entry(file, path, (readable, is_checked), |entry| {
        match entry {
            // The writer writes its own, which is the same.
            Entry::Metadata(metadata) if metadata.name == "scand" => return Ok(true),
            Entry::Message(_) => messages += 1,
            _ => {}
        }
        each(entry).map(|()| true)
    })?;
    Ok(messages)
}

/// What can be read of a recording that was cut off.
struct Readable {
    /// Up to the first damage.
    bytes: u64,
    length: u64,
    /// Name and version of what wrote it.
    program: String,
}

impl Readable {
    /// Keeps what could not be read beside the recording.
    fn keep_rest(&self, file: &mut File, part: &Path, path: &Path) -> Result<Option<Tail>, Error> {
        Ok(match self.length - self.bytes {
            0 => None,
            rest => Some((keep_tail(file, part, self.bytes, path)?, rest)),
        })
    }
}

fn readable(file: &File, part: &Path) -> Result<Readable, Error> {
    // Cut off before its first byte was on the disk.
    if file.metadata().map_err(io(part))?.len() == 0 {
        return Ok(Readable {
            bytes: 0,
            length: 0,
            program: String::new(),
        });
    }
    let recording = Recording::open_cut_off(part)?;
    let damage = recording.verify()?;
    let length = recording.file_length();
    // Damage of no length, such as a name defined twice, makes nothing unreadable.
    let first = damage.iter().find(|d| d.length > 0);
    Ok(Readable {
        bytes: first.map_or(length, |d| d.offset),
        length,
        program: recording.written_by().1.to_owned(),
    })
}

/// Copies what could not be read beside the recording, durably; where it is kept. What an earlier recovery has kept there
/// stays.
fn keep_tail(file: &mut File, part: &Path, from: u64, path: &Path) -> Result<PathBuf, Error> {
    let mut tail = with_ending(path, "tail");
    let mut number = 1;
    while tail.try_exists().map_err(io(&tail))? {
        if is_kept(file, from, &tail).map_err(io(&tail))? {
            return Ok(tail);
        }
        number += 1;
        tail = with_ending(path, &format!("tail-{number}"));
    }
    let staged = with_ending(&tail, "recovering");
    remove_stale(&staged)?;
    let mut copied = || {
        file.seek(SeekFrom::Start(from))?;
        let mut copy = File::create_new(&staged)?;
        std::io::copy(file, &mut copy)?;
        let _ = dress(&copy, &file.metadata()?);
        copy.sync_all()?;
        rename_noreplace(&staged, &tail)?;
        sync_parent(&tail)
    };
    copied().map_err(io(part))?;
    Ok(tail)
}

/// Whether a tail holds all of the file from `from` on: a recovery that was cut off itself has got so far.
fn is_kept(file: &mut File, from: u64, tail: &Path) -> std::io::Result<bool> {
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

/// The name that a recording gets when it is complete, of one that is not: `NAME.mcap` of `NAME.mcap.part`.
pub fn finished_name(part: &Path) -> Option<PathBuf> {
    let name = part.file_name()?.to_str()?.strip_suffix(PART)?;
    name.ends_with(".mcap").then(|| part.with_file_name(name))
}

/// The name that a recording has until it is complete: `NAME.mcap.part` of `NAME.mcap`.
pub fn unfinished_name(path: &Path) -> PathBuf {
    super::writer::part_of(path)
}
