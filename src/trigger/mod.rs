//! The messages on the daemon's socket, as lines of JSON (requests one way, replies and events the other), and a
//! client. Nothing of cameras or recordings lives here.

mod client;
mod event;
mod seen;

pub use client::{Client, Error, LONGEST_REPLY};
pub use event::{Event, Reply, Until};
pub use seen::{LookFigures, Polygon};

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Where the daemon listens unless it is configured otherwise.
pub const SOCKET: &str = "/run/scand/scand.sock";

/// Longest line that the daemon reads from a client, in bytes, with its end. [`LONGEST_REPLY`] limits the replies.
pub const LONGEST_REQUEST: usize = 4096;

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
        /// How the object lies, in a person's words, for the report.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        placement: Option<String>,
        /// Which answer is the last one that is waited for.
        #[serde(default)]
        until: Until,
    },
    /// What happens from now on: `listening`, and then a line of [`Event`] each.
    Events {},
    /// Take background pictures of the empty rig.
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
        /// `accept`, `reject`, `clear` (which takes either back) or `text`.
        kind: String,
        /// In words.
        #[serde(default)]
        text: String,
        /// Who says it.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        author: Option<String>,
    },
    /// Make a capture's model again with other settings, beside the first.
    Remake {
        /// The capture.
        capture: String,
        /// Settings of a list, each within its range, as docs/socket.md has them.
        settings: BTreeMap<String, serde_json::Value>,
    },
    /// Show pictures of the cameras: `looking`, and then a line of [`Event::Looked`] each, until the client goes away.
    Look {},
    /// Complete the session.
    Close {},
}

fn socket() -> String {
    "socket".into()
}
