//! What the confined children of a replay by a fleet do: one lists the captures of a recording, one makes models that
//! cannot travel. Each writes what it found as JSON, for the process that started it.

use super::outcome::ReplayOutcome;
use super::{Args, Prepared, prepare};
use crate::capture::CaptureSession;
use crate::frame::CaptureId;
use crate::notes::CaptureNotes;
use serde::{Deserialize, Serialize};

/// The captures of a recording.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Listing {
    /// Those that are wanted.
    pub(super) wanted: Vec<ListedCapture>,
    /// The outcomes of those that are left out.
    pub(super) left_out: Vec<ReplayOutcome>,
}

/// A capture that is wanted.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct ListedCapture {
    pub(super) id: String,
    /// When it was triggered, in nanoseconds since 1970.
    pub(super) time_ns: u64,
    /// What triggered it.
    pub(super) source: String,
    /// People's notes on it.
    pub(super) notes: CaptureNotes,
}

/// Lists a recording's captures, as JSON, and marks the models of those that were rejected.
///
/// # Errors
/// If the recording cannot be read.
pub(in crate::commands) fn list(args: Args) -> anyhow::Result<String> {
    let prepared = prepare(args)?;
    let mut listing = Listing {
        wanted: Vec::new(),
        left_out: Vec::new(),
    };
    for (path, stem) in &prepared.recordings {
        let replay = prepared.replay(stem, &|_, _| ());
        let (session, ids, left_out) = replay.open(path)?;
        let listed = ids.iter().filter_map(|id| listed(&session, id));
        listing.wanted.extend(listed);
        listing.left_out.extend(left_out);
    }
    Ok(serde_json::to_string(&listing)?)
}

fn listed(session: &CaptureSession, id: &CaptureId) -> Option<ListedCapture> {
    let summary = session.capture(id)?;
    Some(ListedCapture {
        id: id.to_string(),
        time_ns: summary.time.0,
        source: summary.source,
        notes: summary.notes,
    })
}

/// Replays, and returns the outcomes as JSON.
///
/// # Errors
/// As those of a replay.
pub(in crate::commands) fn outcomes(args: Args) -> anyhow::Result<String> {
    let prepared: Prepared = prepare(args)?;
    Ok(serde_json::to_string(&prepared.outcomes())?)
}
