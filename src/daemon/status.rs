//! The daemon's status, as clients see it. This file only gathers it.

use super::presses::Percentiles;
use super::rig::{CameraKind, Rig, State};
use crate::workers::Backlog;
use std::collections::BTreeMap;

/// A camera's status.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct CameraStatus {
    /// What it contributes to a capture.
    pub kind: CameraKind,
    /// `ready`, `opening` or `away`.
    pub state: &'static str,
    /// Its identity, or why it is away.
    pub words: String,
    /// Each setting: its name, the value asked for, and the value read back.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub settings: Vec<[String; 3]>,
    /// What it reports about itself, such as its temperature and its clock's offset: names and values.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub health: Vec<[String; 2]>,
    /// Advice about a camera that works.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub remarks: Vec<String>,
    /// Frames that it lost since the start.
    pub lost_frames: u64,
}

/// The daemon's status.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub struct Status {
    /// The daemon's version.
    pub version: &'static str,
    /// Whether as many cameras are ready as `service.missing_cameras` wants.
    pub ready: bool,
    /// Whether a capture is taken although cameras are missing (`sync.go_on_without_missing`).
    pub goes_on_without_missing: bool,
    /// Whether an order is being carried out, such as a capture or background pictures: a press is `busy` now.
    pub busy: bool,
    /// Each camera's status by its id.
    pub cameras: BTreeMap<String, CameraStatus>,
    /// The session that is being recorded.
    pub session: Option<String>,
    /// Complete captures since the start that are durable.
    pub complete: u64,
    /// Captures since the start that failed.
    pub failed: u64,
    /// How long recent presses took until they were `captured` and `durable`, in milliseconds.
    pub takes_ms: BTreeMap<&'static str, Percentiles>,
    /// Presses that were refused for lack of memory or disk space, or because the recorder's queue was full.
    pub refused: u64,
    /// Clients that look at the cameras.
    pub looking: usize,
    /// Frames that arrived after their capture had ended.
    pub late_frames: u64,
    /// Bytes of one capture with the cameras' present settings.
    pub capture_bytes: u64,
    /// How many captures fit on the disk.
    pub captures_left: u64,
    /// Captures that wait to be written.
    pub waiting: usize,
    /// Memory for frames in bytes: allocated, and the limit.
    pub memory: [usize; 2],
    /// Age of the oldest background in hours; `None` if a colour camera has none.
    pub plates_age_h: Option<f64>,
    /// Age of the calibration's file in hours; `None` if the rig has none.
    pub calibration_age_h: Option<f64>,
    /// Models in progress and queued; `None` if this daemon makes none.
    pub models: Option<Backlog>,
}

/// The cameras' part of the status; `lost` is how many frames each camera lost.
pub(super) fn cameras(rig: &Rig, lost: &BTreeMap<String, u64>) -> BTreeMap<String, CameraStatus> {
    let one = |(id, kind, state): (&crate::frame::CameraId, CameraKind, &State)| {
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
            State::Ready(info) => {
                (camera.state, camera.words) = ("ready", info.identity.clone());
                camera.settings.clone_from(&info.table);
                camera.remarks.clone_from(&info.remarks);
            }
        }
        (id.to_string(), camera)
    };
    rig.states().map(one).collect()
}
