//! What recordings that a crash left open say of the presses that they are of.

use crate::log;
use crate::recording::{CaptureRecord, Error, Outcome, Recording, Topic, unfinished_name};
use crate::trigger::Reply;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// A capture that is on the disk.
#[derive(Clone, Debug)]
pub(super) struct Recorded {
    /// Its id.
    pub capture: String,
    /// The client's own name of the press.
    pub press_id: Option<String>,
    /// What became of it.
    record: CaptureRecord,
    /// The recording, under the name that it has when it is complete.
    recording: PathBuf,
}

impl Recorded {
    /// What its client is answered when it has heard that it was accepted.
    pub(super) fn answers(&self) -> Vec<Reply> {
        let (capture, record) = (self.capture.clone(), &self.record);
        match record.outcome {
            Outcome::Complete => vec![
                Reply::Captured {
                    capture: capture.clone(),
                    skew_ns: record.skew_ns.unwrap_or(0),
                },
                Reply::Durable {
                    capture,
                    recording: self.recording.clone(),
                },
            ],
            Outcome::Failed => vec![Reply::Failed {
                capture,
                reason: record.reason.clone().unwrap_or_default(),
            }],
        }
    }
}

/// The captures of recordings, named as if they were complete, in their order; what cannot be read is said and left out.
pub(super) fn captures(files: &[PathBuf]) -> Vec<Recorded> {
    let mut found = Vec::new();
    for file in files {
        if let Err(error) = add(file, &mut found) {
            log::warning!("{error}: what its presses were answered is not known");
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
            capture: record.id.clone(),
            press_id: presses.remove(&record.id).flatten(),
            record,
            recording: file.into(),
        });
    }
    Ok(())
}

/// The name that it has: it may not have been completed.
fn as_it_is(file: &Path) -> PathBuf {
    let part = unfinished_name(file);
    if part.exists() { part } else { file.into() }
}
