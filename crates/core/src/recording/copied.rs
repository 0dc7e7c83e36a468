//! Completes copies of recordings: the copy that was cut off stays, and another one is completed. The notes beside it
//! go along.

use super::notes::{beside, notes_to_copy};
use super::recovery::{Recovered, recover, unfinished_name};
use super::rewriting::{copy_ownership, io, remove_stale};
use super::{Error, Recording};
use std::fs::File;
use std::io::{Read, Write};
use std::os::unix::fs::PermissionsExt;
use std::path::Path;

/// Bytes that are copied at a time.
const BLOCK: usize = 1 << 20;

/// Completes a copy of a recording that has its final name and was cut off, as an interrupted copy from a stick is. The
/// copy is `NAME.recovered.mcap`, and gets a copy of the notes beside the recording; the files themselves are never
/// touched. Both copies belong to whom the originals belong, as far as this process may give them away.
///
/// # Errors
/// If the file is not cut off, the copy's name is taken, or there is no room for the copy.
pub fn recover_copy(cut: &Path) -> Result<Recovered, Error> {
    let recording = Recording::open(cut)?;
    if !recording.is_cut_off()? {
        return Err(Error::NotCutOff { path: cut.into() });
    }
    let copied = cut.with_extension("recovered.mcap");
    let part = unfinished_name(&copied);
    let notes = notes_to_copy(cut).map_err(io(&beside(cut)))?;
    let copied_notes = beside(&copied);
    for taken in [&copied, &part, &copied_notes] {
        if taken.try_exists().map_err(io(taken))? {
            return Err(io(taken)(std::io::ErrorKind::AlreadyExists.into()));
        }
    }
    // The notes come first: a recording of rejected captures must not be complete without them.
    let copied = match &notes {
        Some(notes) => copy(notes, &copied_notes),
        None => Ok(()),
    };
    let recovered = copied
        .and_then(|()| copy(cut, &part))
        .and_then(|()| recover(&part));
    if recovered.is_err() {
        remove_stale(&part)?;
        if notes.is_some() {
            remove_stale(&copied_notes)?;
        }
    }
    recovered
}

/// Copies a file durably to a name that nothing has.
fn copy(from: &Path, to: &Path) -> Result<(), Error> {
    let source = File::open(from).map_err(io(from))?;
    let original = source.metadata().map_err(io(from))?;
    let mut target = File::create_new(to).map_err(io(to))?;
    let mut block = Vec::with_capacity(BLOCK);
    // Block by block, because an error of `io::copy` does not tell which of the two files it is about.
    loop {
        block.clear();
        let read = (&source).take(BLOCK as u64).read_to_end(&mut block);
        if read.map_err(io(from))? == 0 {
            break;
        }
        target.write_all(&block).map_err(io(to))?;
    }
    // Only root can give a file away, and some file systems know no owners.
    let _ = copy_ownership(&target, &original).and_then(|()| let_owner_write(&target));
    target.sync_all().map_err(io(to))
}

/// The copy is completed, and notes are appended to it, even if the original can only be read.
fn let_owner_write(file: &File) -> std::io::Result<()> {
    let mut permissions = file.metadata()?.permissions();
    permissions.set_mode(permissions.mode() | 0o600);
    file.set_permissions(permissions)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_names_the_file_that_it_is_about() {
        let [from, to] = [(); 2].map(|()| tempfile::tempdir().unwrap());
        // A folder can be opened, but not read.
        let error = copy(from.path(), &to.path().join("copy")).unwrap_err();
        let named = from.path().to_str().unwrap();
        assert!(error.to_string().starts_with(named), "{error}");
        let nowhere = to.path().join("no/copy");
        let file = to.path().join("file");
        std::fs::write(&file, "x").unwrap();
        let error = copy(&file, &nowhere).unwrap_err();
        let named = nowhere.to_str().unwrap();
        assert!(error.to_string().starts_with(named), "{error}");
    }
}
