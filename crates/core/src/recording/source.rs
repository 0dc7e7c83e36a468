//! The file of a recording: opened once and read at given positions. Its size, and the lengths that it states, are not
//! trusted.

use super::Error;
use super::rewriting::{PART, io, lock_left};
use std::fs::{File, Metadata, TryLockError};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

/// Bytes read ahead while walking over small records.
const WINDOW: usize = 64 << 10;

/// A regular file and its length when it was opened.
#[derive(Debug)]
pub(super) struct Source {
    pub path: PathBuf,
    pub file: File,
    pub length: u64,
    /// Whether a writer is still at it: then it ends wherever the writer is, and no end is missing.
    pub being_written: bool,
}

impl Source {
    pub(super) fn open(path: &Path) -> Result<Self, Error> {
        check_is_file(path)?;
        Self::of_file(File::open(path).map_err(io(path))?, path)
    }

    /// A file that is open already; `path` names it in messages, and says by its ending whether it is unfinished.
    pub(super) fn of_file(file: File, path: &Path) -> Result<Self, Error> {
        // Before its length is known: what is completed between the two is whole, and found so.
        let being_written = path
            .as_os_str()
            .as_encoded_bytes()
            .ends_with(PART.as_bytes())
            && is_locked(&file).map_err(io(path))?;
        let about = file.metadata().map_err(io(path))?;
        check_kind(&about, path)?;
        Ok(Self {
            path: path.into(),
            file,
            length: about.len(),
            being_written,
        })
    }

    /// Opens a file to repair it, and locks it; where it ends, it was cut off.
    pub(super) fn lock(path: &Path) -> Result<Self, Error> {
        check_is_file(path)?;
        let file = File::options().read(true).write(true).open(path);
        let file = file.map_err(io(path))?;
        lock_left(&file, path)?;
        Ok(Self {
            path: path.into(),
            length: file.metadata().map_err(io(path))?.len(),
            file,
            being_written: false,
        })
    }

    /// The bytes from `offset`, as many as `length` or the file has. The caller bounds `length`.
    pub(super) fn read(&self, offset: u64, length: usize) -> Result<Vec<u8>, Error> {
        let left = self.length.saturating_sub(offset);
        let length = usize::try_from(left).map_or(length, |left| left.min(length));
        let mut bytes = vec![0; length];
        self.file
            .read_exact_at(&mut bytes, offset)
            .map_err(io(&self.path))?;
        Ok(bytes)
    }
}

/// Looked at before it is opened: opening a pipe would wait for its writer.
fn check_is_file(path: &Path) -> Result<(), Error> {
    check_kind(&std::fs::metadata(path).map_err(io(path))?, path)
}

fn check_kind(about: &Metadata, path: &Path) -> Result<(), Error> {
    let found = match (about.is_file(), about.is_dir()) {
        (true, _) => return Ok(()),
        (false, true) => "a folder",
        (false, false) => "not a regular file",
    };
    Err(Error::NotAFile {
        path: path.into(),
        found,
    })
}

/// Whether its writer holds the lock of a recording.
fn is_locked(file: &File) -> std::io::Result<bool> {
    match file.try_lock_shared() {
        Ok(()) => file.unlock().map(|()| false),
        Err(TryLockError::WouldBlock) => Ok(true),
        // A file system without locks cannot tell.
        Err(TryLockError::Error(_)) => Ok(false),
    }
}

/// Reads a file from front to back in small pieces, with one system call for many of them.
pub(super) struct Window<'a> {
    source: &'a Source,
    offset: u64,
    bytes: Vec<u8>,
}

impl<'a> Window<'a> {
    pub(super) fn new(source: &'a Source) -> Self {
        Self {
            source,
            offset: 0,
            bytes: Vec::new(),
        }
    }

    /// The bytes from `offset`, as many as `length` or the file has.
    pub(super) fn read(&mut self, offset: u64, length: usize) -> Result<&[u8], Error> {
        let inside = offset
            .checked_sub(self.offset)
            .and_then(|start| usize::try_from(start).ok())
            .filter(|start| start + length <= self.bytes.len());
        if let Some(start) = inside {
            return Ok(&self.bytes[start..start + length]);
        }
        self.bytes = self.source.read(offset, length.max(WINDOW))?;
        self.offset = offset;
        Ok(&self.bytes[..length.min(self.bytes.len())])
    }
}
