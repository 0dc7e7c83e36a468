//! Finds, in recordings, the captures of which an object's model is made.

use crate::capture::{CaptureSession, CaptureSummary};
use crate::frame::{CaptureId, Timestamp};

/// A capture of an object.
#[derive(Clone, Copy)]
pub struct Source<'a> {
    /// The recording that has it.
    pub session: &'a CaptureSession,
    /// The capture.
    pub id: &'a CaptureId,
}

/// Which captures show the object.
#[derive(Clone, Copy, Debug)]
pub enum Wanted<'a> {
    /// Those of this subject.
    Subject(&'a str),
    /// Those of these names, whatever their notes say.
    Captures(&'a [String]),
}

/// Captures of an object in the order of their triggers.
#[derive(Clone, Debug, Default)]
pub struct Gathered {
    /// Those that count: the number of the recording, and the name.
    pub captures: Vec<(usize, CaptureId)>,
    /// Those that a person rejected, or that failed, in words.
    pub left_out: Vec<String>,
}

/// Finds the captures that are wanted. Their order does not depend on that of the recordings.
pub fn gather(sessions: &[CaptureSession], wanted: Wanted) -> Gathered {
    let mut found: Vec<(Timestamp, CaptureId, String, usize)> = Vec::new();
    let mut left_out: Vec<(Timestamp, String)> = Vec::new();
    for (number, session) in sessions.iter().enumerate() {
        let name = session.recording().path().display().to_string();
        for capture in session.captures() {
            if !is_wanted(&capture, wanted) {
                continue;
            }
            match obstacle(&capture, wanted) {
                Some(why) => left_out.push((capture.time, format!("capture {} {why}", capture.id))),
                None => found.push((capture.time, capture.id, name.clone(), number)),
            }
        }
    }
    found.sort_by(|a, b| (a.0, &a.1, &a.2).cmp(&(b.0, &b.1, &b.2)));
    left_out.sort();
    Gathered {
        captures: found
            .into_iter()
            .map(|(_, id, _, number)| (number, id))
            .collect(),
        left_out: left_out.into_iter().map(|(_, words)| words).collect(),
    }
}

fn is_wanted(capture: &CaptureSummary, wanted: Wanted) -> bool {
    match wanted {
        Wanted::Subject(subject) => capture.subject.as_deref() == Some(subject),
        Wanted::Captures(ids) => ids.iter().any(|id| id == capture.id.as_str()),
    }
}

fn obstacle(capture: &CaptureSummary, wanted: Wanted) -> Option<String> {
    if let Some(reason) = &capture.failure {
        return Some(format!("failed: {reason}"));
    }
    let by_name = matches!(wanted, Wanted::Captures(_));
    (capture.notes.is_rejected() && !by_name).then(|| "was rejected".to_owned())
}
