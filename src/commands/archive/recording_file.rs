//! What is known of a recording's file when all of it was read: its damage, whether its end is missing, the bytes that
//! a recovery could not use, and which pictures of a capture cannot be read. Nothing is written here.

use super::model_files::no_file;
use crate::capture::{CaptureSession, CaptureSummary};
use crate::recording::{Damage, Error, Recording, tails};
use serde_json::{Value, json};
use std::path::PathBuf;

/// A recording's file.
pub(super) struct RecordingFile {
    /// Its name in the package, without the ending.
    pub(super) name: String,
    /// Its own name, which may have letters that the package's names do without.
    pub(super) original_file_name: String,
    /// All damage in it.
    pub(super) damage: Vec<Damage>,
    /// Whether its end is missing.
    pub(super) is_cut_off: bool,
    /// What its recoveries could not use.
    pub(super) rescued: Vec<RescuedBytes>,
}

/// A file beside a recording with bytes that a recovery could not use.
pub(super) struct RescuedBytes {
    pub(super) path: PathBuf,
    /// The ending behind the recording's name.
    ending: String,
    pub(super) bytes: u64,
    /// Why it stays out of the package, if it does.
    pub(super) problem: Option<String>,
}

impl RecordingFile {
    /// Reads all of a recording.
    ///
    /// # Errors
    /// If the file, or its folder, cannot be read.
    pub(super) fn of(recording: &Recording, name: String) -> Result<Self, Error> {
        let rescued = tails(recording.path())?.into_iter();
        let rescued = rescued.map(|(ending, path)| RescuedBytes {
            bytes: path.metadata().map_or(0, |about| about.len()),
            problem: no_file(&path),
            ending,
            path,
        });
        let original = recording.path().file_name().unwrap_or_default();
        Ok(Self {
            name,
            original_file_name: original.to_string_lossy().into_owned(),
            damage: recording.verify()?,
            is_cut_off: recording.is_cut_off()?,
            rescued: rescued.collect(),
        })
    }

    /// The path of the recording below the package's `data`.
    pub(super) fn place(&self) -> String {
        format!("recordings/{}.mcap", self.name)
    }

    /// The path of what a recovery could not use.
    pub(super) fn place_of(&self, rescued: &RescuedBytes) -> String {
        format!("{}.{}", self.place(), rescued.ending)
    }

    /// The files of what recoveries could not use, for the sheet of paradata.
    pub(super) fn rescued_bytes(&self) -> Value {
        let packed = self.rescued.iter().filter(|file| file.problem.is_none());
        packed
            .map(|file| json!({ "file": self.place_of(file), "bytes": file.bytes }))
            .collect()
    }

    /// What is known of an interruption, for the sheet of paradata; nothing if nothing is.
    pub(super) fn cut_off(&self) -> Option<&'static str> {
        let was_packed = |file: &RescuedBytes| file.problem.is_none();
        match &self.rescued[..] {
            _ if self.is_cut_off => Some("yes: the end of the file is missing"),
            [] => None,
            all if all.iter().all(was_packed) => Some(
                "yes: scand recover completed the recording; the bytes that it could not use are in the files of \
                 \"rescued_bytes\"",
            ),
            _ => Some(
                "yes: scand recover completed the recording; not all bytes that it could not use are in the package",
            ),
        }
    }

    /// Why not all pictures of a capture can be read. Only a recording that is damaged, or was cut off, is asked: the
    /// pictures of another one are as they were recorded.
    pub(super) fn unread_pictures(
        &self,
        session: &CaptureSession,
        capture: &CaptureSummary,
    ) -> Option<String> {
        if self.damage.is_empty() && self.cut_off().is_none() {
            return None;
        }
        match session.load(&capture.id) {
            Err(error) => Some(self.without_path(session, &error.to_string())),
            Ok((_, facts)) => {
                let missing = facts
                    .left_out
                    .iter()
                    .filter(|c| !session.left_out().contains(c));
                let reasons: Vec<&str> = missing.map(|c| c.reason.as_str()).collect();
                (!reasons.is_empty()).then(|| reasons.join("; "))
            }
        }
    }

    /// A message in which the file is called as in the package, wherever it was packed from.
    fn without_path(&self, session: &CaptureSession, message: &str) -> String {
        let path = session.recording().path().display().to_string();
        message.replacen(&path, &self.place(), 1)
    }
}
