//! One job, as it is stored on the disk: a capture and the recording that holds it.

use crate::frame::CaptureId;
use crate::recording::{CaptureOutcome, Notes, Recording, Topic};
use crate::storage;
use std::path::Path;
use std::time::UNIX_EPOCH;

/// A capture whose model is to be made. The capture's id and the time of its trigger identify it. The recording was
/// known when the job was enqueued, and may have been moved since.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Job {
    /// File name of its recording when that is complete.
    pub recording: String,
    /// The identity of that file when the job was enqueued; empty if the file system has none.
    pub file: String,
    /// Its id.
    pub capture: String,
    /// Time of its trigger in UTC nanoseconds.
    pub trigger_ns: u64,
    /// What triggered it.
    pub source: String,
    /// How often the job was begun, and neither ended nor was given back.
    #[serde(default)]
    pub begun: u32,
}

impl Job {
    /// The job of a capture in a recording that is, or will be, at `recording`.
    pub fn new(recording: &Path, capture: &str, trigger_ns: u64, source: &str) -> Self {
        let unfinished = crate::recording::unfinished_name(recording);
        let file = identity(&unfinished).or_else(|| identity(recording));
        let name = recording.file_name().unwrap_or_default();
        Self {
            recording: name.to_string_lossy().into_owned(),
            file: file.unwrap_or_default(),
            capture: capture.into(),
            trigger_ns,
            source: source.into(),
            begun: 0,
        }
    }

    /// The jobs of all complete captures of a recording that are not rejected; the recording is at `path` when it is
    /// complete.
    pub(super) fn of_recording(recording: &Recording, path: &Path) -> Vec<Self> {
        let records = recording.messages(&Topic::Capture).iter();
        let notes = Notes::of(recording);
        let complete: Vec<String> = records
            .filter_map(|m| recording.capture_record(m).ok())
            .filter(|record| record.outcome == CaptureOutcome::Complete)
            .map(|record| record.id)
            .filter(|id| !notes.on(id).is_rejected())
            .collect();
        let triggers = recording.messages(&Topic::Trigger).iter();
        triggers
            .filter_map(|m| recording.trigger(m).ok())
            .filter(|t| complete.iter().any(|id| id == t.id.as_str()))
            .map(|t| Self::new(path, t.id.as_str(), t.time.0, &t.source))
            .collect()
    }

    /// The name of its file: the oldest capture's comes first, and a capture has but one.
    pub(super) fn file_name(&self) -> String {
        format!("{:020}-{}.{ENDING}", self.trigger_ns, self.capture)
    }

    /// Reads the job that a file holds.
    ///
    /// # Errors
    /// If it cannot be read, or holds no job.
    pub fn read(file: &Path) -> std::io::Result<Self> {
        Self::parse(&std::fs::read(file)?).map_err(std::io::Error::other)
    }

    /// Reads what a file holds.
    pub(super) fn parse(bytes: &[u8]) -> Result<Self, String> {
        let job: Self = serde_json::from_slice(bytes).map_err(|e| e.to_string())?;
        CaptureId::new(&job.capture).map_err(|e| e.to_string())?;
        let plain = Path::new(&job.recording).file_name() == Some(job.recording.as_ref());
        if !plain {
            return Err(format!("{:?} is not a file name", job.recording));
        }
        Ok(job)
    }
}

/// What the names of jobs end with.
pub(super) const ENDING: &str = "job";

/// Renames a file that is not a job, so that it is not read again, or else removes it: what became of it, in words.
pub(super) fn set_aside(path: &Path) -> String {
    let aside = path.with_extension("bad");
    let Err(error) = storage::rename_durably(path, &aside) else {
        return format!("it was renamed to {}", aside.display());
    };
    match std::fs::remove_file(path) {
        Ok(()) => format!("it was removed, because it could not be renamed: {error}"),
        Err(_) => format!("it could not be renamed ({error}) or removed"),
    }
}

/// Tells a file from all others of its disk, under whatever name: numbers of files are given again, but not at the same
/// time.
pub(super) fn identity(path: &Path) -> Option<String> {
    use std::os::unix::fs::MetadataExt;
    let file = std::fs::metadata(path).ok()?;
    let made = file.created().ok()?.duration_since(UNIX_EPOCH).ok()?;
    Some(format!("{}-{}", file.ino(), made.as_nanos()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_job_of_every_released_version_says_what_it_said() {
        let released = include_bytes!("../../tests/golden/format-1/offered.job");
        let offered = Job {
            recording: "a.mcap".into(),
            file: "1835023-1760000000000000000".into(),
            capture: "a-0001".into(),
            trigger_ns: 1_760_000_000_000_000_000,
            source: "pedal".into(),
            begun: 0,
        };
        assert_eq!(Job::parse(released).unwrap(), offered);
        assert_eq!(offered.file_name(), "01760000000000000000-a-0001.job");
        // A job of a later version cannot be read, and is set aside rather than begun.
        let later = br#"{"recording":"a.mcap","file":"","capture":"a","trigger_ns":1,"source":"x","priority":3}"#;
        assert!(Job::parse(later).unwrap_err().contains("priority"));
    }
}
