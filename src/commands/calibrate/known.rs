//! Calibrations that are there already: read from whatever file has one, and written for others.

use super::files::FileArgs;
use crate::calibration::RigCalibration;
use crate::commands::BadConfiguration;
use crate::frame::Timestamp;
use crate::job::RigAt;
use crate::recording::{Recording, Topic};
use crate::storage::write_atomically;
use std::path::Path;
use std::process::ExitCode;

/// A calibration file, or the calibration that a recording has.
pub(super) fn load(path: &Path) -> anyhow::Result<RigCalibration> {
    match is_recording(path) {
        true => recorded(path),
        false => RigCalibration::load(path).map_err(|e| BadConfiguration(e.into()).into()),
    }
}

/// The same, or what others write.
pub(super) fn import(path: &Path) -> anyhow::Result<RigCalibration> {
    match is_recording(path) {
        true => recorded(path),
        false => RigCalibration::import(path).map_err(|e| BadConfiguration(e.into()).into()),
    }
}

fn is_recording(path: &Path) -> bool {
    path.extension().is_some_and(|e| e == "mcap")
}

fn recorded(path: &Path) -> anyhow::Result<RigCalibration> {
    let recording = Recording::open(path)?;
    let found = of_recording(&recording)?;
    anyhow::ensure!(
        !found.cameras.is_empty(),
        "{}: it has no calibration, expected /color/ID/calibration or /depth/ID/calibration",
        path.display()
    );
    Ok(found)
}

/// The calibration that a recording has at its first trigger.
pub(in crate::commands) fn of_recording(recording: &Recording) -> anyhow::Result<RigCalibration> {
    let first = recording.messages(&Topic::Trigger).first();
    let time = first.map_or(Timestamp(u64::MAX), |m| m.log_time());
    Ok(RigAt::calibration(recording, time)?)
}

/// Writes a calibration that is there already for others.
pub(super) fn export(
    from: &Path,
    out: Option<&Path>,
    files: &FileArgs,
    force: bool,
    quiet: bool,
) -> anyhow::Result<ExitCode> {
    anyhow::ensure!(
        out.is_some() || files.exports(),
        "--from {}: give --ros, --kalibr or --out, where it should go",
        from.display()
    );
    let calibration = load(from)?;
    files.refuse_to_replace(calibration.cameras.keys(), force)?;
    if let Some(path) = out {
        write_atomically(path, calibration.to_toml().as_bytes())?;
    }
    files.write_exports(&calibration)?;
    if !quiet {
        say!("{}: {} cameras", from.display(), calibration.cameras.len());
    }
    Ok(ExitCode::SUCCESS)
}
