//! Finds the notes on the captures that a model is made of: in their recordings, where they may be newer than in the
//! model's report, else in the report.

use crate::capture::{self, CaptureSession};
use crate::frame::CaptureId;
use crate::notes::CaptureNotes;
use crate::recording::{Recording, finished_name, unfinished_name};
use crate::sync;
use crate::words::{count, printable};
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// What people said of a model's captures.
#[derive(Default)]
pub(super) struct FoundNotes {
    /// The notes that the model's page may show.
    pub(super) notes: CaptureNotes,
    /// Whether one of the captures was rejected.
    pub(super) is_rejected: bool,
    /// The recordings whose notes were not read, so that only the report's are known.
    pub(super) unread: Unread,
}

/// Names of recordings, and why their notes were not read.
pub(super) type Unread = BTreeMap<String, String>;

/// Says why notes of recordings were not read.
pub(super) fn tell_unread(unread: &Unread) {
    let Some(why) = unread.values().next() else {
        return;
    };
    let others = match unread.len() - 1 {
        0 => String::new(),
        n => format!(
            "; those of {} were not read, either",
            count(n, "other recording")
        ),
    };
    eprintln!(
        "scand: notes that are newer than the reports were not read, because {}{others}",
        printable(why)
    );
}

/// Reads the notes on the captures of a model with this report and capture.
pub(super) fn find(report: &Value, capture: &str, recordings: &Path) -> FoundNotes {
    let mut found = FoundNotes::default();
    let reported: CaptureNotes =
        serde_json::from_value(report["notes"].clone()).unwrap_or_default();
    found.is_rejected = reported.is_rejected();
    found.notes = reported;
    let fused = fused(report);
    let is_single = fused.is_empty();
    let single = || Some((recording_name(&report["recording"])?, capture.to_owned()));
    for (name, id) in fused.into_iter().chain(single().filter(|_| is_single)) {
        let time = report["capture"]["time_ns"].as_str().filter(|_| is_single);
        match of_recording(recordings, &name, &id, time) {
            Ok(notes) if is_single => {
                found.is_rejected = notes.is_rejected();
                found.notes = notes;
            }
            Ok(notes) => found.is_rejected |= notes.is_rejected(),
            Err(why) => {
                found.unread.entry(name).or_insert(why);
            }
        }
    }
    found
}

/// The captures of a model of several: the names of their recordings, and their ids.
fn fused(report: &Value) -> Vec<(String, String)> {
    let captures = report["fusion"]["captures"].as_array();
    let fused = captures.into_iter().flatten();
    let fused = fused.filter(|capture| capture["is_fused"] == true);
    fused
        .filter_map(|capture| {
            let name = recording_name(&capture["recording"])?;
            Some((name, capture["id"].as_str()?.to_owned()))
        })
        .collect()
}

/// The name of a complete recording, and never a path: a report from elsewhere leads to no other folder.
fn recording_name(path: &Value) -> Option<String> {
    let path = PathBuf::from(path.as_str()?);
    let path = finished_name(&path).unwrap_or(path);
    Some(path.file_name()?.to_string_lossy().into_owned())
}

/// The notes on a capture that was triggered at `time`, in its recording, which may not be complete yet.
///
/// # Errors
/// Why they were not read, and what to do.
fn of_recording(
    recordings: &Path,
    name: &str,
    id: &str,
    time: Option<&str>,
) -> Result<CaptureNotes, String> {
    let complete = recordings.join(name);
    let unfinished = unfinished_name(&complete);
    let mut paths = [complete, unfinished].into_iter();
    let path = paths.find(|path| path.is_file()).ok_or_else(|| {
        let folder = recordings.display();
        format!("the folder {folder} does not have {name}: give the right folder with --recordings")
    })?;
    let session = session(&path).map_err(|error| {
        format!("{error}: see what scand info says of it, or give another folder with --recordings")
    })?;
    let other = |what: &str| {
        let path = path.display();
        format!("{path} {what}: give the folder of the model's own recording with --recordings")
    };
    let capture = CaptureId::new(id).ok().and_then(|id| session.capture(&id));
    let capture = capture.ok_or_else(|| other(&format!("has no capture {id}")))?;
    match time {
        Some(time) if time != capture.time.0.to_string() => Err(other(&format!(
            "is another recording, in which capture {id} was triggered at another time"
        ))),
        _ => Ok(capture.notes),
    }
}

fn session(path: &Path) -> Result<CaptureSession, capture::Error> {
    CaptureSession::of_any(Recording::open(path)?, &sync::Parameters::default())
}
