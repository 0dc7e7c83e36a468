//! What the daemon knows of itself, for whoever asks.

use super::rig::{Kind, Rig, State};
use crate::workers::Backlog;
use std::collections::BTreeMap;

/// One camera.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct CameraStatus {
    /// What it is to a capture.
    pub kind: Kind,
    /// `ready`, `opening` or `away`.
    pub state: &'static str,
    /// What it is, or why it is away.
    pub words: String,
    /// Each setting: its name, what was asked for and what was read back.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub settings: Vec<[String; 3]>,
    /// What it tells of itself, such as its temperature and how its clock stands: names and values.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub health: Vec<[String; 2]>,
    /// What to know although it works.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub remarks: Vec<String>,
    /// Frames it lost since the start.
    pub lost_frames: u64,
}

/// What half of something stays below, and 99 of 100.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Spread {
    /// The median.
    pub p50: f64,
    /// The 99th percentile.
    pub p99: f64,
}

/// The daemon.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub struct Status {
    /// The cameras by their ids.
    pub cameras: BTreeMap<String, CameraStatus>,
    /// The session that is recorded.
    pub session: Option<String>,
    /// Captures since the start that are on the disk and complete.
    pub complete: u64,
    /// Captures since the start that failed.
    pub failed: u64,
    /// How long presses took of late, in milliseconds, until they were `captured` and `durable`.
    pub takes_ms: BTreeMap<&'static str, Spread>,
    /// Presses that were refused: no memory, no room, a disk that is behind.
    pub refused: u64,
    /// Frames that came when their capture was over.
    pub late_frames: u64,
    /// Bytes of a capture, as the cameras are set.
    pub capture_bytes: u64,
    /// Captures that the disk has room for.
    pub captures_left: u64,
    /// Captures that wait for the disk.
    pub waiting: usize,
    /// Bytes of memory for frames that exist, and most that there may be.
    pub memory: [usize; 2],
    /// Hours since the oldest of the background plates was taken; `None` where a colour camera has none.
    pub plates_age_h: Option<f64>,
    /// Models that are made and to be made; `None` where none are.
    pub models: Option<Backlog>,
}

/// The cameras' part of the status; frames that each lost are counted elsewhere.
pub(super) fn cameras(rig: &Rig, lost: &BTreeMap<String, u64>) -> BTreeMap<String, CameraStatus> {
    let one = |(id, kind, state): (&crate::frame::CameraId, Kind, &State)| {
        let mut camera = CameraStatus {
            kind,
            state: "opening",
            words: String::new(),
            settings: Vec::new(),
            health: rig.health(id).to_vec(),
            remarks: Vec::new(),
            lost_frames: lost.get(id.as_str()).copied().unwrap_or(0),
        };
        match state {
            State::Opening => {}
            State::Away(fault) => (camera.state, camera.words) = ("away", fault.to_string()),
            State::Ready(confirmed) => {
                (camera.state, camera.words) = ("ready", confirmed.identity.clone());
                camera.settings.clone_from(&confirmed.table);
                camera.remarks.clone_from(&confirmed.remarks);
            }
        }
        (id.to_string(), camera)
    };
    rig.states().map(one).collect()
}
