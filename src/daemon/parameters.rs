//! The settings of captures, recordings, readiness, the socket and the hooks, with their defaults and ranges. Data
//! only.

use crate::level::Level;
use crate::range::{count, milliseconds};
use std::path::PathBuf;

/// How captures are taken.
#[derive(serde::Deserialize, serde::Serialize, Clone, Debug, PartialEq)]
#[serde(deny_unknown_fields, default)]
pub struct CaptureParameters {
    /// How often a failed capture is automatically taken again, 0 to 10. Default 1.
    #[serde(deserialize_with = "count::<_, _, 0, 10>")]
    pub retry: u32,
    /// Largest spread of the colour frames' timestamps, in milliseconds, 0 to 3600000; more is a failed capture.
    /// Default 50.
    #[serde(deserialize_with = "milliseconds")]
    pub largest_skew_ms: f64,
    /// How long frames are waited for after the end of a capture's window, in milliseconds: they may be exposed in time
    /// and come late. 0 to 30000, well below the service's watchdog. Default 1000.
    #[serde(deserialize_with = "count::<_, _, 0, 30_000>")]
    pub patience_ms: u64,
    /// Memory for frames, in megabytes, 1 to 1000000. Default 1200.
    #[serde(deserialize_with = "count::<_, _, 1, 1_000_000>")]
    pub memory_mb: usize,
    /// Captures that may wait for the disk before presses are refused, 1 to 1000. Default 2.
    #[serde(deserialize_with = "count::<_, _, 1, 1000>")]
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
    /// Megabytes of pictures after which a file of a session is completed and the next one begun, 1 to 1000000. Default
    /// 4000.
    #[serde(deserialize_with = "count::<_, _, 1, 1_000_000>")]
    pub largest_file_mb: u64,
    /// Megabytes of the disk that captures never use, 0 to 1000000000. Default 1000.
    #[serde(deserialize_with = "count::<_, _, 0, 1_000_000_000>")]
    pub keep_free_mb: u64,
    /// Seconds for which the rig has nothing to do before complete recordings are packed, in place and without loss;
    /// read at the start. 0 to 86400. Default 0: they stay as they are.
    #[serde(deserialize_with = "count::<_, _, 0, 86_400>")]
    pub pack_after_idle_s: u64,
}

impl Default for RecordingParameters {
    fn default() -> Self {
        Self {
            folder: "/var/lib/scand/recordings".into(),
            largest_file_mb: 4000,
            keep_free_mb: 1000,
            pack_after_idle_s: 0,
        }
    }
}

impl RecordingParameters {
    /// Bytes of the disk that captures never use.
    pub fn keep_free_bytes(&self) -> u64 {
        self.keep_free_mb.saturating_mul(1_000_000)
    }
}

/// The rig itself.
#[derive(serde::Deserialize, serde::Serialize, Clone, Debug, Default, PartialEq)]
#[serde(deny_unknown_fields, default)]
pub struct RigParameters {
    /// Its name, which every recording carries. Default empty.
    pub name: String,
    /// The calibration of its cameras; a relative path is beside the configuration. Default empty: the rig is not
    /// calibrated yet, and no models are made.
    pub calibration: PathBuf,
    /// The box that is reconstructed, in metres of the rig's frame. Default that of the calibration.
    pub volume: Option<BoxCorners>,
}

/// When the daemon is ready for work.
#[derive(serde::Deserialize, serde::Serialize, Clone, Debug, PartialEq)]
#[serde(deny_unknown_fields, default)]
pub struct ServiceParameters {
    /// Cameras that may be missing once all were waited for, 0 or more. Default 0: not ready before all have answered.
    pub missing_cameras: usize,
    /// How long all cameras are waited for before fewer are enough, in seconds, 0 to 86400. Default 60.
    #[serde(deserialize_with = "crate::range::seconds_of_a_day")]
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
pub struct BoxCorners {
    /// Smallest x, y and z.
    pub min: [f64; 3],
    /// Largest x, y and z.
    pub max: [f64; 3],
}

/// Where the daemon listens.
#[derive(serde::Deserialize, serde::Serialize, Clone, Debug, PartialEq)]
#[serde(deny_unknown_fields, default)]
pub struct SocketParameters {
    /// The socket; where systemd made it, its own path counts instead. Default `/run/scand/scand.sock`.
    pub path: PathBuf,
    /// How long a client may take to send a line or to read one, in milliseconds, 1 to 3600000. Default 60000.
    #[serde(deserialize_with = "count::<_, _, 1, 3_600_000>")]
    pub patience_ms: u64,
}

impl Default for SocketParameters {
    fn default() -> Self {
        Self {
            path: crate::trigger::SOCKET.into(),
            patience_ms: 60_000,
        }
    }
}

/// What is run when something happens: a program and its arguments, without a shell; empty where nothing is to be run,
/// which is the default of each. What happened is in the environment, `SCAND_EVENT`, `SCAND_CAPTURE` and so on.
#[derive(serde::Deserialize, serde::Serialize, Clone, Debug, PartialEq)]
#[serde(deny_unknown_fields, default)]
pub struct HooksParameters {
    /// A capture is being taken.
    pub accepted: Vec<String>,
    /// All its frames are in: hands may move.
    pub captured: Vec<String>,
    /// It is on the disk.
    pub durable: Vec<String>,
    /// Its model is as it should be.
    pub green: Vec<String>,
    /// Its model is to be looked at.
    pub amber: Vec<String>,
    /// Its model is not to be used.
    pub red: Vec<String>,
    /// A capture is not whole, a press was refused, or a model could not be made.
    pub failed: Vec<String>,
    /// How long a command may run, in milliseconds, 1 to 60000; then it is killed with its children. Default 5000.
    #[serde(deserialize_with = "count::<_, _, 1, 60_000>")]
    pub timeout_ms: u64,
    /// How many may run at a time, 1 to 16. Default 4.
    #[serde(deserialize_with = "count::<_, _, 1, 16>")]
    pub at_most: usize,
}

impl Default for HooksParameters {
    fn default() -> Self {
        Self {
            accepted: Vec::new(),
            captured: Vec::new(),
            durable: Vec::new(),
            green: Vec::new(),
            amber: Vec::new(),
            red: Vec::new(),
            failed: Vec::new(),
            timeout_ms: 5000,
            at_most: 4,
        }
    }
}

impl HooksParameters {
    /// Each hook's name and its command.
    pub fn each(&self) -> impl Iterator<Item = (&'static str, &[String])> {
        let all = [
            ("accepted", &self.accepted),
            ("captured", &self.captured),
            ("durable", &self.durable),
            (Level::Green.name(), &self.green),
            (Level::Amber.name(), &self.amber),
            (Level::Red.name(), &self.red),
            ("failed", &self.failed),
        ];
        all.into_iter().map(|(name, command)| (name, &command[..]))
    }

    /// Checks what a file's form does not show.
    ///
    /// # Errors
    /// With the field and what was expected.
    pub fn checked(&self) -> Result<(), String> {
        for (name, command) in self.each() {
            if command.first().is_some_and(String::is_empty) {
                return Err(format!("hooks.{name}: the program's name is empty"));
            }
            if command.iter().any(|word| word.contains('\0')) {
                return Err(format!("hooks.{name}: expected no zero byte"));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hooks_that_cannot_be_are_refused_by_name() {
        let with = |change: fn(&mut HooksParameters)| {
            let mut hooks = HooksParameters::default();
            change(&mut hooks);
            hooks.checked()
        };
        assert_eq!(with(|h| h.red = vec!["beep".into()]), Ok(()));
        for (refused, named) in [
            (with(|h| h.red = vec![String::new()]), "hooks.red"),
            (with(|h| h.green = vec!["a\0".into()]), "hooks.green"),
        ] {
            let refused = refused.unwrap_err();
            assert!(refused.contains(named), "{refused}");
        }
    }

    #[test]
    fn hooks_have_a_time_and_a_number_within_bounds() {
        for refused in ["timeout_ms = 0", "at_most = 17"] {
            let read = toml::from_str::<HooksParameters>(refused).unwrap_err();
            let name = refused.split(' ').next().unwrap();
            assert!(read.to_string().contains(name), "{read}");
        }
    }
}
