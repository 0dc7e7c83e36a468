//! Reads a calibration from a calibration file, a recording, or the files of ROS and Kalibr.

use super::Error;
use crate::calibration::RigCalibration;
use crate::capture::RigAt;
use crate::frame::Timestamp;
use crate::recording::{Recording, Topic};
use std::path::Path;

/// Reads a calibration file, or the calibration that a recording has.
///
/// # Errors
/// If it cannot be read, or a recording has none.
pub fn load(path: &Path) -> Result<RigCalibration, Error> {
    match is_recording(path) {
        true => recorded(path),
        false => Ok(RigCalibration::load(path)?),
    }
}

/// The same, or what others write: ROS camera_info, a Kalibr camchain, or a folder of them.
///
/// # Errors
/// As [`load`].
pub fn import(path: &Path) -> Result<RigCalibration, Error> {
    match is_recording(path) {
        true => recorded(path),
        false => Ok(RigCalibration::import(path)?),
    }
}

fn is_recording(path: &Path) -> bool {
    path.extension().is_some_and(|e| e == "mcap")
}

fn recorded(path: &Path) -> Result<RigCalibration, Error> {
    let recording = Recording::open(path)?;
    let found = of_recording(&recording)?;
    match found.cameras.is_empty() {
        true => Err(Error::NoCalibration(path.into())),
        false => Ok(found),
    }
}

/// The calibration that a recording has at its first trigger.
///
/// # Errors
/// If one of its cameras cannot be read.
pub fn of_recording(recording: &Recording) -> Result<RigCalibration, Error> {
    let first = recording.messages(&Topic::Trigger).first();
    let time = first.map_or(Timestamp(u64::MAX), |m| m.log_time());
    Ok(RigAt::calibration(recording, time)?)
}
