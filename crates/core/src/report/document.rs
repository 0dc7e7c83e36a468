//! The report of one capture as data; `docs/report.schema.json` describes its JSON. Only the members under `timing`
//! may differ between two runs over the same input.

use super::{
    ColorMeasures, DepthMeasures, Exchanged, Measurements, ModelMeasures, MovedCamera, Verdict,
};
use crate::capture::CaptureFacts;
use crate::description::Description;
use crate::frame::{CaptureId, Timestamp};
use crate::notes::CaptureNotes;
use crate::reconstruct::Method;
use serde::{Deserialize, Serialize};

/// Version of the report's form; it grows when a member changes its meaning or goes away. In 1, the shares of
/// `model.provenance` and `model.textured` were of vertices and of triangles; now they are of the area.
pub const VERSION: u32 = 2;

/// What may differ between runs.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Timing {
    /// Seconds of each stage, in the order they ran.
    pub stages: Vec<StageTime>,
    /// Seconds from reading to the last file.
    pub total_s: f64,
    /// Threads that worked.
    pub threads: usize,
    /// The machine's name.
    pub host: String,
}

/// How long a stage took.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StageTime {
    /// The stage: one of the reconstruction's, or another word for work around it.
    pub stage: String,
    /// Seconds.
    pub seconds: f64,
}

/// What became of a capture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ReportOutcome {
    /// There is a model.
    Done,
    /// There is no model.
    Failed,
}

/// Where a report comes from: the same for a model and for a failure.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Origin {
    /// Version of the program.
    pub program: String,
    /// The recording's file name.
    pub recording: String,
    /// Which model was asked for.
    pub method: Method,
    /// Tells inputs and parameters apart from others: the same digest, the same model.
    pub digest: String,
}

impl Origin {
    /// Of a recording, by this program.
    pub fn new(recording: &str, method: Method, digest: &str) -> Self {
        Self {
            program: format!("scand {}", env!("CARGO_PKG_VERSION")),
            recording: recording.to_owned(),
            method,
            digest: digest.to_owned(),
        }
    }
}

/// The report of a capture that became a model.
#[derive(Clone, Debug, Serialize)]
pub struct Report<'a> {
    /// [`VERSION`].
    pub version: u32,
    /// [`ReportOutcome::Done`].
    pub outcome: ReportOutcome,
    /// Where it comes from.
    #[serde(flatten)]
    pub origin: &'a Origin,
    /// How the capture was taken.
    pub capture: &'a CaptureFacts,
    /// What the model's files say of the object.
    pub description: &'a Description,
    /// People's notes on the capture until the report was written, or marked.
    pub notes: &'a CaptureNotes,
    /// How far the model can be trusted.
    pub verdict: &'a Verdict,
    /// The colour cameras.
    pub color_cameras: &'a [ColorMeasures],
    /// The camera that has moved since the calibration, if one has.
    pub moved: Option<&'a MovedCamera>,
    /// The two cameras that are exchanged, if two are.
    pub exchanged: Option<&'a Exchanged>,
    /// The median over the cameras of their silhouettes' shift, as a share of the object's longest side.
    pub common_shift_share: f64,
    /// The depth cameras.
    pub depth_cameras: &'a [DepthMeasures],
    /// The model.
    pub model: &'a ModelMeasures,
    /// What may differ between runs.
    pub timing: Timing,
}

impl<'a> Report<'a> {
    /// Joins what is known.
    pub fn new(
        (origin, description): (&'a Origin, &'a Description),
        (capture, notes): (&'a CaptureFacts, &'a CaptureNotes),
        measured: &'a Measurements,
        verdict: &'a Verdict,
        timing: Timing,
    ) -> Self {
        Self {
            version: VERSION,
            outcome: ReportOutcome::Done,
            origin,
            capture,
            description,
            notes,
            verdict,
            color_cameras: &measured.colors,
            moved: measured.moved.as_ref(),
            exchanged: measured.exchanged.as_ref(),
            common_shift_share: measured.common_shift_share,
            depth_cameras: &measured.depths,
            model: &measured.model,
            timing,
        }
    }
}

/// The report of a capture that became no model.
#[derive(Clone, Debug, Serialize)]
pub struct Failure<'a> {
    /// [`VERSION`].
    pub version: u32,
    /// [`ReportOutcome::Failed`].
    pub outcome: ReportOutcome,
    /// Where it comes from.
    #[serde(flatten)]
    pub origin: &'a Origin,
    /// The capture.
    pub capture: FailedCapture<'a>,
    /// Why there is no model, naming file, camera or topic, and value.
    pub reason: &'a str,
    /// What may differ between runs.
    pub timing: Timing,
}

/// What is known of a failed capture.
#[derive(Clone, Debug, Serialize)]
pub struct FailedCapture<'a> {
    /// Its name.
    pub id: &'a CaptureId,
    /// When it was triggered, in UTC nanoseconds.
    pub time_ns: Timestamp,
    /// What triggered it.
    pub source: &'a str,
}

impl<'a> Failure<'a> {
    /// Says why.
    pub fn new(
        origin: &'a Origin,
        capture: FailedCapture<'a>,
        reason: &'a str,
        timing: Timing,
    ) -> Self {
        Self {
            version: VERSION,
            outcome: ReportOutcome::Failed,
            origin,
            capture,
            reason,
            timing,
        }
    }
}

/// A report as the text of its file: indented JSON, and a newline at its end.
///
/// # Errors
/// If a map's key is no string, which no report has.
pub fn to_json(report: &impl Serialize) -> serde_json::Result<String> {
    Ok(serde_json::to_string_pretty(report)? + "\n")
}
