//! What scand says first about a damaged recording, in one line: what is missing, and what to do.

use crate::recording::{Damage, Error, Recording};
use crate::words::{count, shell_word};
use std::path::Path;

/// The line about a recording, all of which is read; `None` if nothing is wrong with it.
///
/// # Errors
/// If it cannot be read at all.
pub(super) fn first_aid(recording: &Recording) -> Result<Option<String>, Error> {
    let is_cut_off = recording.is_cut_off()?;
    let damage = recording.verify()?;
    Ok(words(
        recording.path(),
        recording.file_length(),
        is_cut_off,
        &damage,
    ))
}

/// The same, of what is known already.
pub(super) fn words(
    file: &Path,
    bytes: u64,
    is_cut_off: bool,
    damage: &[Damage],
) -> Option<String> {
    let word = shell_word(file);
    let file = file.display();
    if is_cut_off {
        return Some(format!(
            "{file}: cut off: its end is missing, and scand cannot know how much that is. Copy it again from its source, or \
             complete a copy of what is there with `scand recover {word}`"
        ));
    }
    let lost: u64 = damage.iter().map(|damage| damage.length).sum();
    (!damage.is_empty()).then(|| {
        format!(
            "{file}: damaged in {} ({lost} of {bytes} bytes). Copy it again from its source; what is intact can be replayed",
            count(damage.len(), "place"),
        )
    })
}
