//! The schemas that a recording's channels carry, so that any MCAP tool can read it.

use super::Topic;
use mcap::Schema;

/// The schema of a Foxglove message: its FileDescriptorSet.
pub(super) fn protobuf_schema<M: foxglove::Encode>() -> Schema<'static> {
    let (name, data) = M::get_schema().map_or_else(Default::default, |s| (s.name, s.data));
    Schema {
        // The writer gives it its number.
        id: 0,
        name,
        encoding: "protobuf".into(),
        data,
    }
}

/// The schema of a topic's JSON messages.
pub(super) fn json_schema(topic: &Topic) -> Schema<'static> {
    let name = topic.schemas()[0];
    let data = match name {
        "scand.CameraSettings" => CAMERA_SETTINGS,
        "scand.DepthResponse" => DEPTH_RESPONSE,
        "scand.Volume" => VOLUME,
        "scand.Trigger" => TRIGGER,
        "scand.Capture" => CAPTURE,
        "scand.Note" => NOTE,
        other => unreachable!("no schema is written down for {other}"),
    };
    Schema {
        // The writer gives it its number.
        id: 0,
        name: name.into(),
        encoding: "jsonschema".into(),
        data: data.as_bytes().into(),
    }
}

const CAMERA_SETTINGS: &str = r#"{
  "title": "scand.CameraSettings",
  "description": "How a colour camera was set, as read back from it",
  "type": "object",
  "properties": {
    "transfer": {"enum": ["srgb", "linear"]},
    "exposure": {"type": "number", "description": "seconds"},
    "gain_db": {"type": "number"},
    "white_balance": {"type": "array", "items": {"type": "number"}, "minItems": 3, "maxItems": 3},
    "trigger": {"type": "string"}
  }
}"#;

const DEPTH_RESPONSE: &str = r#"{
  "title": "scand.DepthResponse",
  "description": "A reading r > 0 is z = slope r + intercept metres, X = x z s(z), Y = y z s(z)",
  "type": "object",
  "properties": {
    "slope": {"type": "number"},
    "intercept": {"type": "number"},
    "scale": {"type": "array", "items": {"type": "number"}, "minItems": 1, "maxItems": 5},
    "range": {"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 2},
    "uncertainty": {"type": "number", "description": "metres"}
  },
  "required": ["slope", "intercept", "scale"]
}"#;

const VOLUME: &str = r#"{
  "title": "scand.Volume",
  "description": "The box that is reconstructed, in metres",
  "type": "object",
  "properties": {
    "frame_id": {"const": "rig"},
    "min": {"type": "array", "items": {"type": "number"}, "minItems": 3, "maxItems": 3},
    "max": {"type": "array", "items": {"type": "number"}, "minItems": 3, "maxItems": 3}
  },
  "required": ["frame_id", "min", "max"]
}"#;

const TRIGGER: &str = r#"{
  "title": "scand.Trigger",
  "description": "A capture was asked for",
  "type": "object",
  "properties": {
    "id": {"type": "string", "pattern": "^[A-Za-z0-9_-][A-Za-z0-9._-]{0,63}$"},
    "source": {"type": "string"},
    "press_id": {"type": "string"},
    "subject": {"type": "string"},
    "placement": {"type": "string"}
  },
  "required": ["id", "source"]
}"#;

const CAPTURE: &str = r#"{
  "title": "scand.Capture",
  "description": "A capture is complete or has failed",
  "type": "object",
  "properties": {
    "id": {"type": "string"},
    "outcome": {"enum": ["complete", "failed"]},
    "reason": {"type": "string"},
    "skew_ns": {"type": "string", "description": "decimal nanoseconds"},
    "cameras": {
      "type": "object",
      "additionalProperties": {
        "type": "object",
        "properties": {
          "timestamps": {"type": "array", "items": {"type": "string"}},
          "lost": {
            "anyOf": [
              {
                "description": "the camera failed",
                "type": "object",
                "properties": {"fault": {"type": "string"}},
                "required": ["fault"]
              },
              {
                "description": "the camera answered, and not everything came",
                "type": "object",
                "properties": {
                  "frames": {"type": "array", "items": {"type": "string"}},
                  "missing_packets": {"type": "integer", "minimum": 0},
                  "resent_packets": {"type": "integer", "minimum": 0},
                  "unused_frames": {"type": "integer", "minimum": 0}
                },
                "required": ["frames", "missing_packets", "resent_packets", "unused_frames"]
              }
            ]
          },
          "remarks": {"type": "array", "items": {"type": "string"}}
        }
      }
    }
  },
  "required": ["id", "outcome"]
}"#;

const NOTE: &str = r#"{
  "title": "scand.Note",
  "description": "What a person said of a capture",
  "type": "object",
  "properties": {
    "capture": {"type": "string"},
    "kind": {"enum": ["accept", "reject", "clear", "text"]},
    "text": {"type": "string"},
    "author": {"type": "string"}
  },
  "required": ["capture", "kind"]
}"#;
