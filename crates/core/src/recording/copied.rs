//! Completes copies of recordings: the copy that was cut off stays, and another one is completed. The notes beside it
//! go along.

use super::notes::{beside, notes_to_copy};
use super::recovery::{Recovered, recover, unfinished_name};
use super::rewriting::{io, remove_stale};
use super::{Error, Recording};
use std::fs::File;
use std::path::Path;

/// Completes a copy of a recording that has its final name and was cut off, as an interrupted copy from a stick is. The
/// copy is `NAME.recovered.mcap`, and gets a copy of the notes beside the recording; the files themselves are never
/// touched.
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
    let mut source = File::open(from).map_err(io(from))?;
    let copied = File::create_new(to).and_then(|mut to| {
        std::io::copy(&mut source, &mut to)?;
        to.sync_all()
    });
    copied.map_err(io(to))
}
