//! What is said over the daemon's socket: lines of JSON, requests one way and replies the other, and a client that
//! speaks them. Nothing of cameras or recordings lives here.

mod client;

pub use client::{Client, Error};

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
    },
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
    /// It is done; of everything but a press and a status.
    Done {
        /// What was done.
        words: String,
    },
    /// What the daemon knows of itself.
    Status {
        /// As docs/socket.md describes it.
        status: serde_json::Value,
    },
}

impl Reply {
    /// Whether nothing follows.
    pub fn is_end(&self) -> bool {
        !matches!(
            self,
            Self::Accepted { .. } | Self::Captured { .. } | Self::Retried { .. }
        )
    }
}
