//! Makes the sheet of paradata: how, with what, how exactly and by whom an object was digitised. The sections are those
//! for which the EU's study of quality in 3D digitisation (VIGIE 2020/654) asks; unknown values are marked as unknown.

use super::models::ModelInput;
use crate::capture::{CaptureSession, CaptureSummary};
use serde_json::{Value, json};

/// What is not in the recording.
const UNKNOWN: &str = "not recorded";

/// The sheet of a capture, from its recording, and the report and input of its model, if there is one.
pub(super) fn of(
    session: &CaptureSession,
    capture: &CaptureSummary,
    made: Option<&(Value, ModelInput)>,
    name: &str,
) -> Value {
    let recording = session.recording();
    let report = made.map(|(report, _)| report);
    let pair = |key: &str| {
        recording
            .session_pair(key)
            .map_or(Value::from(UNKNOWN), Value::from)
    };
    let of_report = |key: &str| report.map_or(Value::Null, |report| report[key].clone());
    let (_, writer) = recording.written_by();
    let metadata = recording.metadata().iter();
    let calibration = metadata
        .rev()
        .find(|(name, _)| name == "calibration")
        .map(|(_, pairs)| pairs);
    let subject = capture.subject.as_deref().unwrap_or(UNKNOWN);
    json!({
        "sheet": {
            "what": "paradata of the 3-D digitisation of one object by one capture",
            "after": "EU study on quality in 3D digitisation of tangible cultural heritage (VIGIE 2020/654)",
        },
        "object": {
            "number": subject,
            "title": pair("title"),
            "rights": pair("rights"),
            "condition": UNKNOWN,
        },
        "purpose": { "project": pair("project") },
        "by_whom": {
            "operator": pair("operator"),
            "notes": capture.notes,
        },
        "equipment": {
            "rig": pair("rig"),
            "recorded_with": writer,
            "calibration": calibration.map_or(json!(UNKNOWN), |pairs| json!(pairs)),
            "color_cameras": of_report("color_cameras"),
            "depth_cameras": of_report("depth_cameras"),
        },
        "environment": { "lighting": UNKNOWN, "temperature": UNKNOWN },
        "capture": {
            "id": capture.id,
            "session": pair("name"),
            "time": capture.time.iso_8601(),
            "triggered_by": capture.source,
            "outcome": capture.failure.as_deref().unwrap_or("complete"),
            "color_pictures": capture.color_frames,
            "depth_frames": capture.depth_frames,
            "spread_of_color_pictures_ns": capture.skew_ns,
            "details": of_report("capture"),
        },
        "processing": {
            "method": report.map_or(json!("no model is in the package"), |report| json!({
                "name": report["method"],
                "source": "Jang, Park and Lee, Hybrid optical system for three-dimensional shape acquisition, \
                           Applied Optics 52(16), 3680-3688, 2013",
                "program": report["program"],
                "digest": report["digest"],
            })),
            "input": made.map(|(_, input)| input.words()),
            "description": of_report("description"),
        },
        "how_exact": {
            "verdict": of_report("verdict"),
            "model": of_report("model"),
            "expected_error": "each vertex of the model has its expected distance to the true surface in metres, and says \
                               where it comes from",
            "measured_against_a_truth": "no: the figures are the program's own expectation",
        },
        "data": {
            "recording": format!("recordings/{name}.mcap"),
            "models": report.map(|_| format!("models/{name}/{}", capture.id)),
            "units": "metres; the recording's frame has z up, the glTF has y up",
            "damage": session.damage().iter().map(ToString::to_string).collect::<Vec<_>>(),
        },
    })
}
