//! Finds, in recordings, the captures of which an object's model is made.

use crate::capture::{self, CaptureSession, CaptureSummary};
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
    /// The place of each of these among all captures of the object, those that are left out included.
    pub places: Vec<usize>,
    /// How many captures the object has, those that are left out included.
    pub all: usize,
    /// Those that a person rejected, that failed, or that are a copy of another, in words.
    pub left_out: Vec<String>,
}

/// A capture of the object, and where it is.
struct Found {
    time: Timestamp,
    id: CaptureId,
    /// The path of its recording, and its last part.
    path: String,
    file: String,
    /// The number of its recording.
    recording: usize,
    /// Why it does not count.
    obstacle: Option<String>,
}

/// Finds the captures that are wanted. Their order does not depend on that of the recordings. A capture that a copy of
/// its recording has as well counts once, and not at all if it was rejected in one of them.
pub fn gather(sessions: &[CaptureSession], wanted: Wanted) -> Gathered {
    let mut all: Vec<Found> = Vec::new();
    let mut left_out: Vec<(Timestamp, String)> = Vec::new();
    for mut found in found(sessions, wanted) {
        let same = all
            .iter_mut()
            .find(|known| is_same(sessions, known, &found));
        let Some(same) = same else {
            all.push(found);
            continue;
        };
        left_out.push((
            found.time,
            format!(
                "capture {} of {} is the same as that of {}",
                found.id, found.file, same.file
            ),
        ));
        same.obstacle = same.obstacle.take().or(found.obstacle.take());
    }
    let obstacles = all.iter().filter_map(|f| {
        let obstacle = f.obstacle.as_ref()?;
        Some((f.time, format!("capture {} {obstacle}", f.id)))
    });
    left_out.extend(obstacles);
    left_out.sort();
    let counts = |(_, f): &(usize, &Found)| f.obstacle.is_none();
    let counting = || all.iter().enumerate().filter(counts);
    Gathered {
        captures: counting()
            .map(|(_, f)| (f.recording, f.id.clone()))
            .collect(),
        places: counting().map(|(place, _)| place).collect(),
        all: all.len(),
        left_out: left_out.into_iter().map(|(_, words)| words).collect(),
    }
}

/// Whether two recordings have one capture: the same name, time and pictures. What cannot be read is not the same.
fn is_same(sessions: &[CaptureSession], a: &Found, b: &Found) -> bool {
    let digest = |found: &Found| {
        let (scene, _) = sessions[found.recording].load(&found.id).ok()?;
        Some(capture::input_digest(&scene))
    };
    let is_named_alike = a.recording != b.recording && (a.time, &a.id) == (b.time, &b.id);
    is_named_alike && digest(a).is_some_and(|of_a| digest(b) == Some(of_a))
}

/// All captures that are wanted, in the order of their triggers.
fn found(sessions: &[CaptureSession], wanted: Wanted) -> Vec<Found> {
    let mut all: Vec<Found> = Vec::new();
    for (recording, session) in sessions.iter().enumerate() {
        let path = session.recording().path();
        let file = path.file_name().unwrap_or_default().to_string_lossy();
        let captures = session.captures().into_iter();
        all.extend(captures.filter(|c| is_wanted(c, wanted)).map(|c| Found {
            time: c.time,
            obstacle: obstacle(&c, wanted),
            id: c.id,
            path: path.display().to_string(),
            file: file.clone().into_owned(),
            recording,
        }));
    }
    all.sort_by(|a, b| (a.time, &a.id, &a.path).cmp(&(b.time, &b.id, &b.path)));
    all
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
