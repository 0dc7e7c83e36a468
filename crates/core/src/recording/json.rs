//! The JSON messages, written and read. A reader ignores an unknown member; a required member that is missing is an
//! error that names it. Times are strings of decimal nanoseconds.

use super::MessageError;
use crate::calibration::{DepthResponse, Volume};
use crate::frame::{CaptureId, Timestamp, Trigger};
use nalgebra::Point3;
use serde::de::{DeserializeOwned, Error as _, IgnoredAny};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::collections::BTreeMap;

/// How a capture ended at the rig.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum CaptureOutcome {
    /// With all its frames.
    Complete,
    /// Without.
    Failed,
}

/// `scand.Capture`: written when a capture is complete or has failed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CaptureRecord {
    /// The capture.
    pub id: String,
    /// How it ended.
    pub outcome: CaptureOutcome,
    /// Why it failed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
    /// Spread of the colour cameras' timestamps in nanoseconds.
    #[serde(
        default,
        skip_serializing_if = "Option::is_none",
        serialize_with = "write_maybe_nanoseconds",
        deserialize_with = "maybe_nanoseconds"
    )]
    pub skew_ns: Option<u64>,
    /// What each camera gave, by its id.
    #[serde(default)]
    pub cameras: BTreeMap<String, CameraInCapture>,
}

/// What one camera gave to a capture.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct CameraInCapture {
    /// Timestamps of its frames; `None` where the record does not list them.
    #[serde(
        default,
        skip_serializing_if = "Option::is_none",
        serialize_with = "write_times",
        deserialize_with = "times"
    )]
    pub timestamps: Option<Vec<Timestamp>>,
    /// What it lost; `None` if it lost nothing, or if another writer describes the loss in another form.
    #[serde(
        default,
        skip_serializing_if = "Option::is_none",
        deserialize_with = "known_loss"
    )]
    pub lost: Option<Lost>,
    /// What an operator should know although nothing was lost, in words.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub remarks: Vec<String>,
}

/// What a camera lost of a capture.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Lost {
    /// Everything: the camera failed.
    All {
        /// Why.
        fault: String,
    },
    /// Some of it, although the camera answered.
    Some(LostParts),
}

/// How much was lost on the way from a camera that answered.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct LostParts {
    /// Why each lost frame was lost.
    pub frames: Vec<String>,
    /// Packets that never came.
    pub missing_packets: u64,
    /// Packets that came only when they were asked for again.
    pub resent_packets: u64,
    /// Frames that came and were of no use.
    pub unused_frames: u64,
}

/// `scand.Note`: what a person noted about a capture.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Note {
    /// The capture.
    pub capture: String,
    /// `accept`, `reject`, `clear` (which takes either back) or `text`; what is not known is a text.
    pub kind: String,
    /// In words.
    #[serde(default)]
    pub text: String,
    /// Who said it, if that is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub author: Option<String>,
}

/// `scand.DepthResponse` as it is written.
#[derive(Serialize, Deserialize)]
struct ResponseMessage {
    slope: f64,
    intercept: f64,
    scale: Vec<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    range: Option<[f64; 2]>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    uncertainty: Option<f64>,
}

/// `scand.Volume` as it is written.
#[derive(Serialize, Deserialize)]
struct VolumeMessage {
    #[serde(default = "rig")]
    frame_id: String,
    min: [f64; 3],
    max: [f64; 3],
}

/// `scand.Trigger` as it is written.
#[derive(Serialize, Deserialize)]
struct TriggerMessage {
    id: String,
    #[serde(default = "unknown")]
    source: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    press_id: Option<Label>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    subject: Option<Label>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    placement: Option<Label>,
}

/// A name that some write as a number.
#[derive(Serialize, Deserialize)]
#[serde(untagged)]
enum Label {
    Text(String),
    Number(serde_json::Number),
}

fn rig() -> String {
    "rig".into()
}

fn unknown() -> String {
    "unknown".into()
}

/// Reads a JSON message of the given schema.
pub(super) fn read<T: DeserializeOwned>(
    schema: &'static str,
    data: &[u8],
) -> Result<T, MessageError> {
    serde_json::from_slice(data).map_err(|error| MessageError::Malformed {
        schema,
        reason: super::error::shortened(&error.to_string()),
    })
}

/// Writes a JSON message.
pub(super) fn write<T: Serialize>(message: &T) -> Vec<u8> {
    // These types hold strings, numbers and maps with text for keys: nothing that JSON cannot say.
    serde_json::to_vec(message).unwrap_or_default()
}

pub(super) fn read_response(data: &[u8]) -> Result<DepthResponse, MessageError> {
    let message: ResponseMessage = read("scand.DepthResponse", data)?;
    let mut scale = [0.0; 5];
    let count = message.scale.len();
    if !(1..=scale.len()).contains(&count) {
        return Err(MessageError::BadField {
            field: "scale",
            found: format!("{count} coefficients"),
            expected: "1 to 5 coefficients s0 … s4".into(),
        });
    }
    scale[..count].copy_from_slice(&message.scale);
    let response = DepthResponse {
        slope: message.slope,
        intercept: message.intercept,
        scale,
        range: message.range,
        uncertainty: message.uncertainty.unwrap_or(0.0),
    };
    Ok(response.checked()?)
}

pub(super) fn write_response(response: &DepthResponse) -> Vec<u8> {
    write(&ResponseMessage {
        slope: response.slope,
        intercept: response.intercept,
        scale: response.scale.to_vec(),
        range: response.range,
        uncertainty: Some(response.uncertainty),
    })
}

pub(super) fn read_volume(data: &[u8]) -> Result<Volume, MessageError> {
    let message: VolumeMessage = read("scand.Volume", data)?;
    if message.frame_id != "rig" {
        return Err(MessageError::BadField {
            field: "frame_id",
            found: format!("{:?}", super::error::shortened(&message.frame_id)),
            expected: "\"rig\"".into(),
        });
    }
    Ok(Volume::new(
        Point3::from(message.min),
        Point3::from(message.max),
    )?)
}

pub(super) fn write_volume(volume: &Volume) -> Vec<u8> {
    write(&VolumeMessage {
        frame_id: rig(),
        min: volume.min.into(),
        max: volume.max.into(),
    })
}

pub(super) fn read_trigger(data: &[u8], time: Timestamp) -> Result<Trigger, MessageError> {
    let message: TriggerMessage = read("scand.Trigger", data)?;
    Ok(Trigger {
        id: CaptureId::new(&message.id)?,
        time,
        source: message.source,
        press_id: message.press_id.map(Label::text),
        subject: message.subject.map(Label::text),
        placement: message.placement.map(Label::text),
    })
}

pub(super) fn write_trigger(trigger: &Trigger) -> Vec<u8> {
    write(&TriggerMessage {
        id: trigger.id.to_string(),
        source: trigger.source.clone(),
        press_id: trigger.press_id.clone().map(Label::Text),
        subject: trigger.subject.clone().map(Label::Text),
        placement: trigger.placement.clone().map(Label::Text),
    })
}

impl Label {
    fn text(self) -> String {
        match self {
            Self::Text(text) => text,
            Self::Number(number) => number.to_string(),
        }
    }
}

/// Nanoseconds as a string, or as a number where a writer was careless.
#[derive(Deserialize)]
#[serde(untagged)]
enum Nanoseconds {
    Text(String),
    Number(u64),
}

/// A loss in the form that this program writes; any other form is ignored and does not make the capture unreadable.
fn known_loss<'de, D: Deserializer<'de>>(from: D) -> Result<Option<Lost>, D::Error> {
    #[derive(Deserialize)]
    #[serde(untagged)]
    enum Loss {
        Known(Lost),
        Unknown(IgnoredAny),
    }
    Ok(match Loss::deserialize(from)? {
        Loss::Known(lost) => Some(lost),
        Loss::Unknown(_) => None,
    })
}

impl Nanoseconds {
    fn value<E: serde::de::Error>(self) -> Result<u64, E> {
        match self {
            Self::Number(value) => Ok(value),
            Self::Text(text) => text.parse().map_err(|_| {
                let found = super::error::shortened(&text);
                E::custom(format!("{found:?} is not a string of decimal nanoseconds"))
            }),
        }
    }
}

fn times<'de, D: Deserializer<'de>>(from: D) -> Result<Option<Vec<Timestamp>>, D::Error> {
    let Some(all) = Option::<Vec<Nanoseconds>>::deserialize(from)? else {
        return Ok(None);
    };
    let times: Result<_, D::Error> = all.into_iter().map(|n| n.value().map(Timestamp)).collect();
    times.map(Some).map_err(D::Error::custom)
}

fn write_times<S: Serializer>(times: &Option<Vec<Timestamp>>, to: S) -> Result<S::Ok, S::Error> {
    let times = times.as_deref().unwrap_or_default();
    to.collect_seq(times.iter().map(|t| t.0.to_string()))
}

fn maybe_nanoseconds<'de, D: Deserializer<'de>>(from: D) -> Result<Option<u64>, D::Error> {
    Option::<Nanoseconds>::deserialize(from)?
        .map(Nanoseconds::value)
        .transpose()
}

fn write_maybe_nanoseconds<S: Serializer>(time: &Option<u64>, to: S) -> Result<S::Ok, S::Error> {
    time.map(|t| t.to_string()).serialize(to)
}
