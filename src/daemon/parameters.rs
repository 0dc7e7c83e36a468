//! What can be configured about capturing and recording.

use std::path::PathBuf;

/// How captures are taken.
#[derive(serde::Deserialize, serde::Serialize, Clone, Debug, PartialEq)]
#[serde(deny_unknown_fields, default)]
pub struct CaptureParameters {
    /// How often a capture that failed is taken again by itself. Default 1.
    pub retry: u32,
    /// Largest spread of the colour frames' timestamps, in milliseconds; more is a failed capture. Default 50.
    pub largest_skew_ms: f64,
    /// How long frames are waited for after the end of a capture's window, in milliseconds: they may be exposed in time
    /// and come late. Default 1000.
    pub patience_ms: u64,
    /// Memory for frames, in megabytes. Default 1200.
    pub memory_mb: usize,
    /// Captures that may wait for the disk before presses are refused. Default 2.
    pub waiting: usize,
}

impl Default for CaptureParameters {
    fn default() -> Self {
        Self {
            retry: 1,
            largest_skew_ms: 50.0,
            patience_ms: 1000,
            memory_mb: 1200,
            waiting: 2,
        }
    }
}

/// Where and how captures are kept.
#[derive(serde::Deserialize, serde::Serialize, Clone, Debug, PartialEq)]
#[serde(deny_unknown_fields, default)]
pub struct RecordingParameters {
    /// The folder of recordings. Default `/var/lib/scand/recordings`.
    pub folder: PathBuf,
    /// Megabytes of pictures after which a file of a session is completed and the next one begun. Default 4000.
    pub largest_file_mb: u64,
    /// Megabytes of the disk that captures never use. Default 1000.
    pub keep_free_mb: u64,
}

impl Default for RecordingParameters {
    fn default() -> Self {
        Self {
            folder: "/var/lib/scand/recordings".into(),
            largest_file_mb: 4000,
            keep_free_mb: 1000,
        }
    }
}

/// The rig itself.
#[derive(serde::Deserialize, serde::Serialize, Clone, Debug, Default, PartialEq)]
#[serde(deny_unknown_fields, default)]
pub struct RigParameters {
    /// Its name, which every recording carries.
    pub name: String,
    /// The calibration of its cameras; a relative path is beside the configuration. Needed.
    pub calibration: PathBuf,
    /// The box that is reconstructed, in metres of the rig's frame.
    pub volume: Option<Box>,
}

/// When the daemon is ready for work.
#[derive(serde::Deserialize, serde::Serialize, Clone, Debug, PartialEq)]
#[serde(deny_unknown_fields, default)]
pub struct ServiceParameters {
    /// Cameras that may be missing once all were waited for. Default 0: not ready before all have answered.
    pub missing_cameras: usize,
    /// How long all cameras are waited for before fewer are enough, in seconds. Default 60.
    pub patience_s: f64,
}

impl Default for ServiceParameters {
    fn default() -> Self {
        Self {
            missing_cameras: 0,
            patience_s: 60.0,
        }
    }
}

/// Two corners of a box, in metres.
#[derive(serde::Deserialize, serde::Serialize, Clone, Copy, Debug, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct Box {
    /// Smallest x, y and z.
    pub min: [f64; 3],
    /// Largest x, y and z.
    pub max: [f64; 3],
}

/// Where the daemon listens.
#[derive(serde::Deserialize, serde::Serialize, Clone, Debug, PartialEq)]
#[serde(deny_unknown_fields, default)]
pub struct SocketParameters {
    /// The socket. Default `/run/scand/scand.sock`.
    pub path: PathBuf,
}

impl Default for SocketParameters {
    fn default() -> Self {
        Self {
            path: crate::trigger::SOCKET.into(),
        }
    }
}
