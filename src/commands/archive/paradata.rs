//! Makes the sheets of paradata: how, with what, how exactly and by whom an object was digitised. The parameters are
//! after those for which the EU's study of quality in 3D digitisation (VIGIE 2020/654) asks; `docs/formats.md` lists
//! them. Unknown values are marked as unknown.

use super::models::ModelInput;
use super::recording_file::RecordingFile;
use crate::capture::{CaptureSession, CaptureSummary};
use crate::notes::CaptureNotes;
use serde_json::{Map, Value, json};

/// What is not in the recording.
const UNKNOWN: &str = "not recorded";
const STUDY: &str =
    "EU study on quality in 3D digitisation of tangible cultural heritage (VIGIE 2020/654)";

/// The pairs of a session that have a place of their own in the sheet.
const PLACED: [&str; 15] = [
    "condition",
    "dimensions",
    "humidity",
    "lighting",
    "location",
    "material",
    "name",
    "operator",
    "project",
    "purpose",
    "rig",
    "rights",
    "subject",
    "temperature",
    "title",
];

/// All other pairs of a session.
fn other_pairs(session: &CaptureSession) -> Value {
    let records = session.recording().metadata().iter();
    let pairs = records.filter(|(name, _)| name == "session");
    let pairs = pairs.flat_map(|(_, pairs)| pairs);
    let others = pairs.filter(|(key, _)| !PLACED.contains(&key.as_str()));
    let others: Map<String, Value> = others
        .map(|(key, value)| (key.clone(), value.as_str().into()))
        .collect();
    others.into()
}

fn method(report: &Value) -> Value {
    json!({
        "name": report["method"],
        "source": "Jang, Park and Lee, Hybrid optical system for three-dimensional shape acquisition, Applied Optics \
                   52(16), 3680-3688, 2013",
        "program": report["program"],
        "digest": report["digest"],
    })
}

fn how_exact(verdict: &Value, model: &Value) -> Value {
    json!({
        "verdict": verdict,
        "model": model,
        "expected_error": "each vertex of the model has its expected distance to the true surface in metres, and says where \
                           it comes from",
        "measured_against_a_truth": "no: the figures are the program's own expectation",
    })
}

/// The sheet of a model of several captures, given with the notes on them; its folder is `models/PLACE`.
pub(super) fn of_object(
    report: &Value,
    captures: &[(&(String, String), CaptureNotes)],
    place: &str,
) -> Value {
    let described = |key: &str| match &report["description"][key] {
        Value::Null => json!(UNKNOWN),
        known => known.clone(),
    };
    let captures = captures.iter().map(|((recording, id), notes)| {
        json!({ "id": id, "recording": recording, "decision": notes.decision })
    });
    json!({
        "sheet": {
            "what": "paradata of one model of several captures; each capture has a sheet of its own",
            "after": STUDY,
        },
        "object": {
            "number": described("subject"),
            "title": described("title"),
            "rights": described("rights"),
        },
        "captures": captures.collect::<Vec<_>>(),
        "processing": {
            "method": method(report),
            "registration": report["fusion"],
            "description": report["description"],
        },
        "how_exact": how_exact(&report["verdict"], &report["model"]),
        "data": {
            "models": format!("models/{place}"),
            "units": "metres; the rig's frame at the capture in \"description\" has z up, the glTF has y up",
        },
    })
}

/// How a capture ended, and whether all of its pictures can still be read.
fn outcome(session: &CaptureSession, capture: &CaptureSummary, file: &RecordingFile) -> String {
    match &capture.failure {
        Some(failure) => failure.clone(),
        None => match file.unread_pictures(session, capture) {
            Some(reason) => format!("not all pictures of this capture can be read: {reason}"),
            None => "complete".into(),
        },
    }
}

/// The sheet of a capture, from its recording, and the report and input of its model, if there is one; the model's
/// folder is `models/PLACE`.
pub(super) fn of(
    session: &CaptureSession,
    capture: &CaptureSummary,
    made: Option<&(Value, ModelInput)>,
    file: &RecordingFile,
    place: &str,
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
            "after": STUDY,
        },
        "object": {
            "number": subject,
            "title": pair("title"),
            "rights": pair("rights"),
            "material": pair("material"),
            "dimensions": pair("dimensions"),
            "condition": pair("condition"),
        },
        "purpose": { "project": pair("project"), "purpose": pair("purpose") },
        "by_whom": {
            "operator": pair("operator"),
            "notes": capture.notes,
            "notes_on_the_session": session.notes().on_session(recording),
        },
        "equipment": {
            "rig": pair("rig"),
            "recorded_with": writer,
            "calibration": calibration.map_or(json!(UNKNOWN), |pairs| json!(pairs)),
            "color_cameras": of_report("color_cameras"),
            "depth_cameras": of_report("depth_cameras"),
        },
        "environment": {
            "location": pair("location"),
            "lighting": pair("lighting"),
            "temperature": pair("temperature"),
            "humidity": pair("humidity"),
        },
        "capture": {
            "id": capture.id,
            "session": pair("name"),
            "time": capture.time.iso_8601(),
            "triggered_by": capture.source,
            "placement": capture.placement.as_deref().unwrap_or(UNKNOWN),
            "outcome": outcome(session, capture, file),
            "color_pictures": capture.color_frames,
            "depth_frames": capture.depth_frames,
            "spread_of_color_pictures_ns": capture.skew_ns,
            "details": of_report("capture"),
        },
        "processing": {
            "method": report.map_or(json!("no model is in the package"), method),
            "input": made.map(|(_, input)| input.words()),
            "description": of_report("description"),
        },
        "how_exact": how_exact(&of_report("verdict"), &of_report("model")),
        "other_pairs": other_pairs(session),
        "data": {
            "recording": file.place(),
            "original_file_name": file.original_file_name,
            "cut_off": file.cut_off(),
            "rescued_bytes": file.rescued_bytes(),
            "models": report.map(|_| format!("models/{place}")),
            "units": "metres; the recording's frame has z up, the glTF has y up",
            "damage": file.damage.iter().map(ToString::to_string).collect::<Vec<_>>(),
        },
    })
}
