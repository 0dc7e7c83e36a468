//! Tests that every JSON message that is written matches the schema in the recording. For this test the schemas are
//! closed: a member that they do not name is an error here, although a reader ignores it.

use super::testing::*;
use super::*;
use crate::calibration::DepthResponse;
use crate::frame::{CameraSettings, CaptureId, Transfer, Trigger};
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// Values without any optional member, and values with all of them. They are written out in full, so that a new member
/// has to be given a value here, and with it a place in the schema.
fn write_all(path: &Path) {
    let mut writer = Writer::create(path, "scand 1.2.3", Compression::None).unwrap();
    let rig = Rig::new();
    rig.write_to(&mut writer);
    let kinect = &rig.depth.camera.id;
    let plain = DepthResponse {
        slope: 0.001,
        intercept: 0.0,
        scale: [1.0, 0.0, 0.0, 0.0, 0.0],
        range: None,
        uncertainty: 0.0,
    };
    writer.response(kinect, &plain, at(0)).unwrap();
    for settings in settings() {
        writer
            .settings(&rig.colors[0].id, &settings, at(0))
            .unwrap();
    }
    for trigger in triggers() {
        writer.trigger(&trigger).unwrap();
    }
    for capture in captures() {
        writer.capture(&capture, at(200)).unwrap();
    }
    for kind in ["accept", "reject", "clear", "text"] {
        let note = Note {
            capture: "cup-1".into(),
            kind: kind.into(),
            text: "schön".into(),
            author: (kind == "clear").then(|| "Ann".into()),
        };
        writer.note(&note, at(300)).unwrap();
    }
    writer.finish().unwrap();
}

fn settings() -> Vec<CameraSettings> {
    let with = |transfer| CameraSettings {
        transfer,
        exposure: Some(0.02),
        gain_db: Some(6.0),
        white_balance: Some([1.5, 1.0, 2.0]),
        trigger: Some("software".into()),
    };
    // A match, so that a new variant is missed here by the compiler.
    let every = [Transfer::Srgb, Transfer::Linear].map(|transfer| match transfer {
        Transfer::Srgb | Transfer::Linear => with(transfer),
    });
    [&[CameraSettings::default()][..], &every].concat()
}

fn triggers() -> [Trigger; 2] {
    let with = |word: Option<&str>| Trigger {
        id: CaptureId::new("cup-1").unwrap(),
        time: at(100),
        source: "pedal".into(),
        press_id: word.map(Into::into),
        subject: word.map(Into::into),
        placement: word.map(Into::into),
    };
    [with(None), with(Some("17"))]
}

fn captures() -> Vec<CaptureRecord> {
    let camera = |lost: Option<Lost>| CameraInCapture {
        timestamps: Some(vec![at(110)]),
        lost,
        remarks: vec!["its clock is ahead".into()],
    };
    let all = Lost::All {
        fault: "it is gone".into(),
    };
    let some = Lost::Some(LostParts {
        frames: vec!["a damaged frame".into()],
        missing_packets: 3,
        resent_packets: 4,
        unused_frames: 1,
    });
    let losses = [all, some].map(|lost| match lost {
        Lost::All { .. } | Lost::Some(_) => camera(Some(lost)),
    });
    let cameras = || {
        let [all, some] = losses.clone();
        BTreeMap::from([
            ("c00".to_owned(), camera(None)),
            ("c01".to_owned(), all),
            ("c02".to_owned(), some),
            ("c03".to_owned(), CameraInCapture::default()),
        ])
    };
    let empty = |outcome| CaptureRecord {
        id: "cup-1".into(),
        outcome,
        reason: None,
        skew_ns: None,
        cameras: BTreeMap::new(),
    };
    let full = |outcome| CaptureRecord {
        id: "cup-1".into(),
        outcome,
        reason: Some("camera c01: it is gone".into()),
        skew_ns: Some(u64::MAX),
        cameras: cameras(),
    };
    let both = [CaptureOutcome::Complete, CaptureOutcome::Failed].map(|outcome| match outcome {
        CaptureOutcome::Complete | CaptureOutcome::Failed => [empty(outcome), full(outcome)],
    });
    both.concat()
}

/// The JSON messages of a recording, each with the schema that its channel carries.
fn messages(path: &Path) -> Vec<(String, Value, Value)> {
    let bytes = std::fs::read(path).unwrap();
    let stream = mcap::MessageStream::new(&bytes).unwrap();
    let json = stream.map(Result::unwrap).filter_map(|message| {
        let schema = message.channel.schema.clone()?;
        let of = |bytes: &[u8]| serde_json::from_slice(bytes).unwrap();
        let is_json = message.channel.message_encoding == "json";
        is_json.then(|| (schema.name.clone(), of(&schema.data), of(&message.data)))
    });
    json.collect()
}

/// Refuses members that the schema does not name.
fn close(schema: &mut Value) {
    match schema {
        Value::Object(members) => {
            if members.contains_key("properties") {
                members.insert("additionalProperties".into(), false.into());
            }
            members.values_mut().for_each(close);
        }
        Value::Array(items) => items.iter_mut().for_each(close),
        _ => {}
    }
}

fn problems(schema: &Value, message: &Value) -> Vec<String> {
    let validator = jsonschema::validator_for(schema).unwrap();
    let problems = validator.iter_errors(message);
    problems.map(|p| p.to_string()).collect()
}

#[test]
fn every_json_message_holds_to_the_schema_that_the_recording_carries() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    write_all(&path);
    let mut seen = BTreeSet::new();
    for (name, schema, message) in messages(&path) {
        assert!(jsonschema::meta::is_valid(&schema), "{name}");
        let mut closed = schema.clone();
        close(&mut closed);
        assert_eq!(problems(&closed, &message), [""; 0], "{name}: {message}");
        // A message that does not follow its schema is found: these tests could fail.
        assert_ne!(problems(&schema, &Value::Null), [""; 0]);
        let mut more = message;
        more["unheard of"] = 1.into();
        assert_ne!(problems(&closed, &more), [""; 0]);
        assert_eq!(problems(&schema, &more), [""; 0]);
        seen.insert(name);
    }
    let expected = [
        "scand.CameraSettings",
        "scand.Capture",
        "scand.DepthResponse",
        "scand.Note",
        "scand.Trigger",
        "scand.Volume",
    ];
    assert!(seen.iter().map(String::as_str).eq(expected), "{seen:?}");
}

#[test]
fn a_loss_in_another_writers_words_is_no_reason_to_refuse_a_capture() {
    for lost in ["3", "null", "\"much\"", "{\"frames\": 2}", "[]"] {
        let text = format!(
            r#"{{"id": "cup-1", "outcome": "failed", "cameras": {{"c00": {{"lost": {lost}}}}}}}"#
        );
        let record: CaptureRecord = serde_json::from_str(&text).unwrap();
        assert_eq!(record.cameras["c00"], CameraInCapture::default(), "{lost}");
    }
    for record in captures() {
        let written = serde_json::to_string(&record).unwrap();
        assert_eq!(
            serde_json::from_str::<CaptureRecord>(&written).unwrap(),
            record
        );
    }
}
