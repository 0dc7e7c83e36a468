//! What happens at the rig, as it is told to everybody who listens, whoever asked for it.

use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// How far a model can be trusted, in a word.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// As it should be.
    Green,
    /// To be looked at.
    Amber,
    /// Not to be used.
    Red,
}

/// Something that happened. Each is a line of the stream that `events` asks for.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "type")]
pub enum Event {
    /// A capture is being taken.
    Accepted {
        /// Its id.
        capture: String,
        /// Who asked: `pedal`, `socket` or another word.
        source: String,
        /// The client's own name of the press.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        press_id: Option<String>,
        /// The object's number.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        subject: Option<String>,
    },
    /// All its frames are in: hands may move.
    Captured {
        /// Its id.
        capture: String,
        /// Spread of the colour frames' timestamps in nanoseconds.
        skew_ns: u64,
    },
    /// It failed, and is taken once more by itself.
    Retried {
        /// The id of the one that failed.
        capture: String,
        /// Why.
        reason: String,
    },
    /// It is on the disk.
    Durable {
        /// Its id.
        capture: String,
        /// The recording it is in, under the name that it has when it is complete.
        recording: PathBuf,
    },
    /// It is not whole. The frames that came are kept.
    Failed {
        /// Its id.
        capture: String,
        /// Why, naming the cameras.
        reason: String,
    },
    /// A press that nothing was begun for: no memory, no room, a disk that is behind.
    Refused {
        /// Why.
        reason: String,
    },
    /// Its model is made.
    Done {
        /// Its id.
        capture: String,
        /// The recording it is in.
        recording: PathBuf,
        /// How far the model can be trusted.
        verdict: Verdict,
        /// Why not further.
        #[serde(default)]
        reasons: Vec<String>,
        /// The folder of the model.
        model: PathBuf,
    },
    /// Its model could not be made. The capture is safe.
    JobFailed {
        /// Its id.
        capture: String,
        /// The recording it is in.
        recording: PathBuf,
        /// Why.
        reason: String,
    },
    /// A camera came, or went away.
    Camera {
        /// The camera.
        id: String,
        /// `ready` or `away`.
        state: String,
        /// What it is, or why it is away.
        words: String,
    },
    /// Plates of the empty rig were taken.
    Plates {
        /// How many, and where they are.
        words: String,
    },
    /// A session began, or the last one was completed.
    Session {
        /// Its name; none where there is no session now.
        name: Option<String>,
    },
    /// A person said something of a capture.
    Note {
        /// The capture.
        capture: String,
        /// `accept`, `reject` or `text`.
        kind: String,
        /// In words.
        #[serde(default)]
        text: String,
    },
    /// The daemon ends as it was told to: nothing follows.
    Ending,
    /// The listener was too slow, and so many events are lost to it.
    Lost {
        /// How many.
        events: u64,
    },
}
