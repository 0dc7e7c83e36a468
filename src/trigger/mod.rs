//! What is said over the daemon's socket: lines of JSON, requests one way and replies the other, and a client that
//! speaks them. Nothing of cameras or recordings lives here.

mod client;
mod event;

pub use client::{Client, Error};
pub use event::{Event, Verdict};

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Where the daemon listens unless it is configured otherwise.
pub const SOCKET: &str = "/run/scand/scand.sock";

/// Longest line that is read, in bytes.
pub const LONGEST_LINE: usize = 4096;

/// What a client asks.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "type", deny_unknown_fields)]
pub enum Request {
    /// A capture.
    Trigger {
        /// `pedal`, `socket` or another word.
        #[serde(default = "socket")]
        source: String,
        /// The client's own name of the press.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        press_id: Option<String>,
        /// The object's number.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        subject: Option<String>,
        /// Which answer is the last one that is waited for.
        #[serde(default)]
        until: Until,
    },
    /// What happens from now on: `listening`, and then a line of [`Event`] each.
    Events {},
    /// Plates of the empty rig.
    Background {},
    /// What the daemon knows of itself.
    Status {},
    /// Begin a session.
    Begin {
        /// Its name, which its recording gets.
        name: String,
        /// Pairs about it: subject, operator, note.
        #[serde(default)]
        about: BTreeMap<String, String>,
    },
    /// Note something about a capture.
    Note {
        /// The capture.
        capture: String,
        /// `accept`, `reject` or `text`.
        kind: String,
        /// In words.
        #[serde(default)]
        text: String,
    },
    /// Complete the session.
    Close {},
}

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

fn socket() -> String {
    "socket".into()
}

/// What the daemon answers. A press hears several; the last of them is the one of [`Reply::is_end`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "type")]
pub enum Reply {
    /// The capture is being taken.
    Accepted {
        /// Its id.
        capture: String,
    },
    /// All frames are in: hands may move.
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
    /// It was taken and is not whole. The frames that came are kept.
    Failed {
        /// Its id.
        capture: String,
        /// Why, naming the cameras.
        reason: String,
    },
    /// Another capture is being taken.
    Busy,
    /// It was not begun, or not done.
    Refused {
        /// Why.
        reason: String,
    },
    /// Its model is made.
    Done {
        /// Its id.
        capture: String,
        /// How far the model can be trusted.
        verdict: Verdict,
        /// Why not further.
        #[serde(default)]
        reasons: Vec<String>,
        /// The folder of the model.
        model: PathBuf,
    },
    /// It is on the disk, and its model could not be made.
    JobFailed {
        /// Its id.
        capture: String,
        /// Why.
        reason: String,
    },
    /// It is done; of everything but a press, a status and events.
    Ok {
        /// What was done.
        words: String,
    },
    /// What the daemon knows of itself.
    Status {
        /// As docs/socket.md describes it.
        status: serde_json::Value,
    },
    /// What happens is told from here on.
    Listening,
    /// The daemon is ending before the press has its end: who asks for the same press again hears it.
    Ending,
}

impl Reply {
    /// Whether nothing follows for who waits for this.
    pub fn is_end(&self, until: Until) -> bool {
        match self {
            Self::Accepted { .. } | Self::Retried { .. } => false,
            Self::Captured { .. } => until == Until::Captured,
            Self::Durable { .. } => until != Until::Done,
            _ => true,
        }
    }
}
