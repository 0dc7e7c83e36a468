//! The one type for everything that the daemon reports. The stream of events and the hooks get it whole; the
//! replies to a client and the journal of presses are a view of it, [`Event::to_reply`].

use super::seen::LookFigures;
use crate::level::Level;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// What a press waits for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Until {
    /// All frames are in.
    Captured,
    /// It is on the disk.
    #[default]
    Durable,
    /// Its model is made.
    Done,
}

/// What the daemon says, a line of JSON each. Members that a view leaves out are `None` there.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "type")]
pub enum Event {
    /// A capture is being taken.
    Accepted {
        /// Its id.
        capture: String,
        /// Who asked: `pedal`, `socket` or another word; not in a reply.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        source: Option<String>,
        /// The client's own name of the press; not in a reply.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        press_id: Option<String>,
        /// The object's number; not in a reply.
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
    /// It failed, and is automatically taken once more.
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
    /// Another capture is being taken; only in a reply.
    Busy,
    /// A request was rejected and nothing was begun: for a press no memory, no room, a full queue of the recorder.
    Refused {
        /// Why.
        reason: String,
    },
    /// Its model is made.
    Done {
        /// Its id.
        capture: String,
        /// The recording it is in; not in a reply.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        recording: Option<PathBuf>,
        /// How far the model can be trusted.
        verdict: Level,
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
        /// The recording it is in; not in a reply.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        recording: Option<PathBuf>,
        /// Why.
        reason: String,
    },
    /// It is known how the captures of an object lie against each other, while it still stands there.
    Registered {
        /// The object's number.
        subject: String,
        /// The newest capture.
        capture: String,
        /// How clear the evidence for its pose is; red where it has none.
        verdict: Level,
        /// How its pose was found: `silhouettes`, `colours`, `depth`, `nothing` (a turn cannot be known, and the form
        /// does not depend on it) or `frame` (the others' poses are measured against it); without it where the
        /// capture has none.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        held_by: Option<String>,
        /// The same, and what a person can do.
        words: String,
        /// Captures without a pose, by name and with the reason.
        #[serde(default)]
        left_out: Vec<String>,
        /// Percent of the surface that no camera has faced yet.
        unseen_percent: u32,
        /// Which side to show next; without it where nothing is left to show, or the capture has no pose.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        show_next: Option<String>,
    },
    /// The model of several captures of an object is made, or cannot be.
    Fused {
        /// The object's number.
        subject: String,
        /// The newest capture.
        capture: String,
        /// How far the model can be trusted; without it where there is none.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        verdict: Option<Level>,
        /// Why not further, or why there is no model.
        #[serde(default)]
        reasons: Vec<String>,
        /// Captures that the model leaves out, by name and with the reason.
        #[serde(default)]
        left_out: Vec<String>,
        /// The folder of the model; without it where there is none.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        model: Option<PathBuf>,
    },
    /// A capture's model was made again with other settings, or cannot be.
    Remade {
        /// The capture.
        capture: String,
        /// How far the new model can be trusted; without it where there is none.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        verdict: Option<Level>,
        /// Why not further, or why there is no model.
        #[serde(default)]
        reasons: Vec<String>,
        /// The folder of the new model; without it where there is none.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        model: Option<PathBuf>,
    },
    /// A request other than a press, `status` or `events` was carried out; only in a reply.
    Ok {
        /// What was done.
        words: String,
    },
    /// What the daemon knows of itself; only in a reply.
    Status {
        /// As docs/socket.md describes it.
        status: serde_json::Value,
    },
    /// Events follow from here on; only in a reply.
    Listening,
    /// Pictures follow from here on, a line of [`Event::Looked`] each; only in a reply.
    Looking,
    /// A picture of a camera that somebody looks at; only in a reply.
    Looked {
        /// The camera.
        camera: String,
        /// How long ago it was exposed, when this line was written.
        age_ms: u64,
        /// The picture, a JPEG in base64; without it where there is none.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        picture: Option<String>,
        /// What is seen in it.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        seen: Option<Box<LookFigures>>,
        /// Why there is no picture.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        words: Option<String>,
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
        /// Its name; `None` if the session was completed.
        name: Option<String>,
    },
    /// A person noted something about a capture.
    Note {
        /// The capture.
        capture: String,
        /// `accept`, `reject` or `text`.
        kind: String,
        /// In words.
        #[serde(default)]
        text: String,
    },
    /// The daemon was told to stop. A client whose press has no final answer yet gets it when it asks again.
    Ending,
    /// The listener was too slow and missed this number of events.
    Lost {
        /// How many.
        events: u64,
    },
}

/// An event as the answer to a client's request, see [`Event::to_reply`].
pub type Reply = Event;

impl Event {
    /// The view that the press's own client and the journal get: without what the client said itself, and without the
    /// recording of a model, which `durable` named.
    pub fn to_reply(&self) -> Reply {
        let mut reply = self.clone();
        match &mut reply {
            Self::Accepted {
                source,
                press_id,
                subject,
                ..
            } => (*source, *press_id, *subject) = (None, None, None),
            Self::Done { recording, .. } | Self::JobFailed { recording, .. } => *recording = None,
            _ => {}
        }
        reply
    }

    /// Whether no reply follows this one, for a client that waits `until` then.
    pub fn is_end(&self, until: Until) -> bool {
        match self {
            Self::Accepted { .. } | Self::Retried { .. } => false,
            Self::Captured { .. } => until == Until::Captured,
            Self::Durable { .. } => until != Until::Done,
            _ => true,
        }
    }

    /// Whether a press was rejected before anything was begun, so that its name may be used again.
    pub fn is_rejection(&self) -> bool {
        matches!(self, Self::Busy | Self::Refused { .. })
    }

    /// The id of the capture, if the event is about a capture.
    pub fn capture(&self) -> Option<&str> {
        match self {
            Self::Accepted { capture, .. }
            | Self::Captured { capture, .. }
            | Self::Retried { capture, .. }
            | Self::Durable { capture, .. }
            | Self::Failed { capture, .. }
            | Self::Done { capture, .. }
            | Self::JobFailed { capture, .. } => Some(capture),
            _ => None,
        }
    }
}
