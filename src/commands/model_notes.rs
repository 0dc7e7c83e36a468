//! Finds the notes on the captures that a model is made of: in their recordings, where they may be newer than in the
//! model's report, else in the report.

use crate::capture::CaptureSession;
use crate::frame::CaptureId;
use crate::notes::CaptureNotes;
use crate::recording::{Recording, finished_name};
use crate::sync;
use crate::words::{count, printable};
use serde_json::Value;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// What people said of a model's captures.
#[derive(Default)]
pub(super) struct FoundNotes {
    /// The notes that the model's page may show.
    pub(super) notes: CaptureNotes,
    /// Whether one of the captures was rejected.
    pub(super) is_rejected: bool,
    /// Recordings that were not found, so that only the report's notes are known.
    pub(super) not_found: Vec<String>,
}

/// Says of recordings that were not found that their notes were not read.
pub(super) fn tell_not_found(not_found: &BTreeSet<String>, recordings: &Path) {
    let Some(first) = not_found.first() else {
        return;
    };
    let others = match not_found.len() - 1 {
        0 => String::new(),
        n => format!(" and {}", count(n, "other recording")),
    };
    eprintln!(
        "scand: notes that are newer than the reports were not read, because the folder {} does not have {}{others}: give \
         the right folder with --recordings",
        recordings.display(),
        printable(first)
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
        match of_recording(&recordings.join(&name), &id, time) {
            Some(notes) if is_single => {
                found.is_rejected = notes.is_rejected();
                found.notes = notes;
            }
            Some(notes) => found.is_rejected |= notes.is_rejected(),
            None => found.not_found.push(name),
        }
    }
    found.not_found.dedup();
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

/// The notes on a capture in its recording; `None` if there is no such recording, or it has no capture of this id that
/// was triggered at `time`.
fn of_recording(path: &Path, id: &str, time: Option<&str>) -> Option<CaptureNotes> {
    if !path.is_file() {
        return None;
    }
    let recording = Recording::open(path).ok()?;
    let session = CaptureSession::of_any(recording, &sync::Parameters::default()).ok()?;
    let capture = session.capture(&CaptureId::new(id).ok()?)?;
    let is_same = time.is_none_or(|time| time == capture.time.0.to_string());
    is_same.then_some(capture.notes)
}
