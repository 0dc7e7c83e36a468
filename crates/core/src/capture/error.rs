//! Why a capture cannot be reconstructed. Each variant names the file, and the topic, camera or capture in it.

use crate::frame::{CameraId, CaptureId, Timestamp};
use crate::image::DecodeError;
use crate::recording;
use crate::words::count;
use std::path::PathBuf;

/// Why a capture cannot be reconstructed.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum Error {
    /// The recording, or a message in it.
    #[error(transparent)]
    Recording(#[from] recording::Error),
    /// A picture that cannot be decoded.
    #[error("{path}: {topic} at {}: {problem}", timestamp.iso_8601())]
    Picture {
        path: PathBuf,
        topic: String,
        timestamp: Timestamp,
        /// What is wrong with it.
        problem: DecodeError,
    },
    /// A picture file that cannot be read.
    #[error("picture {}: {cause}", path.display())]
    PictureFile {
        path: PathBuf,
        cause: std::io::Error,
    },
    /// A picture file that cannot be decoded.
    #[error("picture {}: {problem}", path.display())]
    BadPictureFile {
        path: PathBuf,
        /// What is wrong with it.
        problem: DecodeError,
    },
    /// Cameras with unequal numbers of picture files.
    #[error(
        "the cameras have unequal numbers of pictures: {counts}. The n-th picture of each camera shows the n-th placement, \
         so each needs one picture or more, and as many as the others{lacking}"
    )]
    PictureCounts {
        /// Each camera, and how many it has.
        counts: String,
        /// Which pictures are without a counterpart; empty if their names do not show it.
        lacking: String,
    },
    /// Two files of a camera that seem to be one picture.
    #[error(
        "camera {camera}: {} and {} have names that differ only in zeros or the ending, so they may be the same picture: \
         give only one of them, such as {camera}='FOLDER/*.png', or rename one",
        files[0].display(), files[1].display()
    )]
    SameName {
        camera: CameraId,
        files: [PathBuf; 2],
    },
    /// No captures.
    #[error("{path} has no /trigger that can be read, expected one for each capture{details}")]
    NoTrigger {
        path: PathBuf,
        /// What may be the reason.
        details: String,
    },
    /// More than a rig gives in a session.
    #[error(
        "{path} has {} on /trigger and /capture and {}, expected at most {most} as their product",
        count(*triggers, "message"), count(*cameras, "camera")
    )]
    TooMany {
        path: PathBuf,
        /// Triggers and records of captures.
        triggers: usize,
        /// Cameras with pictures and a calibration.
        cameras: usize,
        /// Most of both multiplied.
        most: usize,
    },
    /// Pictures that take far more memory than their file.
    #[error(
        "{path}: the {pictures} pictures of the capture at {}, the largest {} of {}x{} pixels, take {bytes} \
         bytes, expected at most {most} for a file of this length",
        trigger.iso_8601(), largest.0, largest.1.0, largest.1.1
    )]
    TooLarge {
        path: PathBuf,
        /// Time of the trigger.
        trigger: Timestamp,
        /// How many pictures it needs.
        pictures: usize,
        /// Topic, width and height of the largest one.
        largest: (String, (usize, usize)),
        /// Bytes that they take.
        bytes: u64,
        /// Bytes that they may take.
        most: u64,
    },
    /// A capture that cannot be taken out of its recording.
    #[error("{path}: capture {id} cannot be taken out of the recording: {reason}")]
    NotExtracted {
        path: PathBuf,
        id: CaptureId,
        reason: String,
    },
    /// No capture of this name.
    #[error("{path} has no capture {id}, only {known}")]
    NoSuchCapture {
        path: PathBuf,
        /// The name that was asked for.
        id: CaptureId,
        /// Names that there are.
        known: String,
    },
    /// A capture that is not complete.
    #[error("{path}: capture {id} failed: {reason}")]
    Failed {
        path: PathBuf,
        id: CaptureId,
        /// Why, naming the cameras.
        reason: String,
    },
    /// Too few colour cameras.
    #[error("{path}: capture {id} has {}, expected at least 2{details}", count(*found, "colour camera"))]
    TooFewCameras {
        path: PathBuf,
        id: CaptureId,
        /// How many there are.
        found: usize,
        /// Which were left out, and why.
        details: String,
    },
    /// A message that is needed and not there, or not yet.
    #[error("{path}: {topic} has no message{}{}", until(*trigger),
            first.map_or_else(String::new, |t| format!(", its first is at {}", t.iso_8601())))]
    NothingYet {
        path: PathBuf,
        topic: String,
        /// Time of the trigger.
        trigger: Timestamp,
        /// Time of the first message, if there is any.
        first: Option<Timestamp>,
    },
    /// A pose that is missing or that no camera has.
    #[error("{path}: /tf: pose of camera {camera}: {problem}")]
    Pose {
        path: PathBuf,
        camera: CameraId,
        /// What is wrong with it.
        problem: String,
    },
    /// A camera whose silhouette cannot be found.
    #[error(
        "{path}: colour camera {camera} has neither a mask of the frame at {} nor a background at or \
         before the trigger, expected one of them", timestamp.iso_8601()
    )]
    NoSilhouette {
        path: PathBuf,
        camera: CameraId,
        /// Timestamp of its frame.
        timestamp: Timestamp,
    },
}

/// Until when a message was looked for; nothing where it was looked for in the whole recording.
pub(super) fn until(trigger: Timestamp) -> String {
    match trigger {
        Timestamp(u64::MAX) => String::new(),
        time => format!(" at or before the trigger at {}", time.iso_8601()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_dates_that_people_read() {
        let time = Timestamp(1_767_225_605_000_000_000);
        let path = || PathBuf::from("cup.mcap");
        let camera = CameraId::new("c00").unwrap();
        for error in [
            Error::Picture {
                path: path(),
                topic: "/color/c00/image".into(),
                timestamp: time,
                problem: DecodeError::Encoding {
                    found: "gif".into(),
                    expected: "png",
                },
            },
            Error::TooLarge {
                path: path(),
                trigger: time,
                pictures: 9,
                largest: ("/color/c00/image".into(), (9, 9)),
                bytes: 9,
                most: 1,
            },
            Error::NothingYet {
                path: path(),
                topic: "/volume".into(),
                trigger: time,
                first: Some(time),
            },
            Error::NoSilhouette {
                path: path(),
                camera,
                timestamp: time,
            },
        ] {
            let words = error.to_string();
            assert!(words.contains("at 2026-01-01T00:00:05.000Z"), "{words}");
            assert!(!words.contains("1767225605"), "{words}");
        }
    }
}
