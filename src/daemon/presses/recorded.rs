//! Reads from recordings that a crash left open which presses their captures belong to, and how these ended.

use crate::log;
use crate::recording::{CaptureOutcome, Error, Recording, Topic, unfinished_name};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// A capture that is on the disk.
#[derive(Clone, Debug)]
pub(in crate::daemon) struct Recorded {
    /// Its id.
    pub capture: String,
    /// The client's own name of the press.
    pub press_id: Option<String>,
    /// Its colour frames' spread in nanoseconds and its recording, under the name that it has when it is complete; or
    /// why it failed.
    pub end: Result<(u64, PathBuf), String>,
}

/// The captures of recordings, named as if they were complete, in their order; what cannot be read is logged and left
/// out.
pub(in crate::daemon) fn captures(files: &[PathBuf]) -> Vec<Recorded> {
    let mut found = Vec::new();
    for file in files {
        if let Err(error) = add(file, &mut found) {
            log::warning!(
                "{error}; the daemon cannot repeat its answers to the presses of this recording"
            );
        }
    }
    found
}

fn add(file: &Path, found: &mut Vec<Recorded>) -> Result<(), Error> {
    let recording = Recording::open(&as_it_is(file))?;
    let mut presses = BTreeMap::new();
    for message in recording.messages(&Topic::Trigger) {
        let trigger = recording.trigger(message)?;
        presses.insert(trigger.id.to_string(), trigger.press_id);
    }
    for message in recording.messages(&Topic::Capture) {
        let record = recording.capture_record(message)?;
        found.push(Recorded {
            press_id: presses.remove(&record.id).flatten(),
            capture: record.id,
            end: match record.outcome {
                CaptureOutcome::Complete => Ok((record.skew_ns.unwrap_or(0), file.into())),
                CaptureOutcome::Failed => Err(record.reason.unwrap_or_default()),
            },
        });
    }
    Ok(())
}

/// The name that it has: it may not have been completed.
fn as_it_is(file: &Path) -> PathBuf {
    let part = unfinished_name(file);
    if part.exists() { part } else { file.into() }
}
