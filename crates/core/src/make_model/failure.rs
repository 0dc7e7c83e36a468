//! The report of a capture whose model could not be made.

use super::Error;
use crate::reconstruct::Method;
use crate::report::{self, FailedCapture, Origin};
use crate::{output, recording};
use std::path::Path;

/// What is known of a capture without a model.
#[derive(Clone, Debug)]
pub struct FailedJob<'a> {
    /// Its recording.
    pub recording: &'a Path,
    /// The model that was asked for.
    pub method: Method,
    /// The capture.
    pub capture: FailedCapture<'a>,
}

/// Writes the report of the failure into the model's folder, with the `log` of the process that should have made the
/// model. An existing model stays unless `force` is given.
///
/// # Errors
/// If it cannot be written.
pub fn report_failure(
    folder: &Path,
    job: FailedJob,
    reason: &str,
    log: Option<&[u8]>,
    force: bool,
) -> Result<(), Error> {
    let origin = origin(job.recording, job.method, "");
    let report = report::Failure::new(&origin, job.capture, reason, report::Timing::default());
    let report = report::to_json(&report)?;
    Ok(output::write_failure(
        folder,
        report.as_bytes(),
        log,
        force,
    )?)
}

/// Where a report comes from. The same capture has the same report, whether its recording is complete or not.
pub(super) fn origin(recording: &Path, method: Method, digest: &str) -> Origin {
    let path = recording::finished_name(recording).unwrap_or_else(|| recording.to_owned());
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    Origin::new(&name, method, digest)
}
