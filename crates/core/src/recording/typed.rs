//! Reads a recording's messages as the types of `frame` and `calibration`.

use super::{CaptureRecord, Error, MessageError, MessageRef, Note, Pose, Recording, Topic};
use super::{json, proto};
use crate::calibration::{DepthResponse, Intrinsics, Volume};
use crate::frame::{CameraSettings, Picture, Trigger};
use bytes::Bytes;

impl Recording {
    /// Reads a message and makes a `T` of it; an error names the message.
    fn typed<T>(
        &self,
        topic: &Topic,
        message: &MessageRef,
        make: impl FnOnce(&str, Bytes) -> Result<T, MessageError>,
    ) -> Result<T, Error> {
        let (data, schema) = self.read(topic, message)?;
        make(schema, data).map_err(|problem| self.message_error(topic, message, problem))
    }

    /// A picture, its pixels still encoded.
    ///
    /// # Errors
    /// As for [`Self::read`], or if the message cannot be decoded; so for all that follow.
    pub fn picture(&self, topic: &Topic, message: &MessageRef) -> Result<Picture, Error> {
        self.typed(topic, message, proto::read_picture)
    }

    /// A camera's lens.
    pub fn intrinsics(&self, topic: &Topic, message: &MessageRef) -> Result<Intrinsics, Error> {
        self.typed(topic, message, |_, data| proto::read_intrinsics(data))
    }

    /// The poses that one message holds, not checked yet.
    pub fn poses(&self, message: &MessageRef) -> Result<Vec<Pose>, Error> {
        self.typed(&Topic::Tf, message, proto::read_poses)
    }

    /// What a depth camera's readings mean.
    pub fn response(&self, topic: &Topic, message: &MessageRef) -> Result<DepthResponse, Error> {
        self.typed(topic, message, |_, data| json::read_response(&data))
    }

    /// The box that is reconstructed.
    pub fn volume(&self, message: &MessageRef) -> Result<Volume, Error> {
        self.typed(&Topic::Volume, message, |_, data| json::read_volume(&data))
    }

    /// How a camera was set.
    pub fn settings(&self, topic: &Topic, message: &MessageRef) -> Result<CameraSettings, Error> {
        self.typed(topic, message, |_, data| {
            json::read("scand.CameraSettings", &data)
        })
    }

    /// A capture's trigger, at the message's log time.
    pub fn trigger(&self, message: &MessageRef) -> Result<Trigger, Error> {
        self.typed(&Topic::Trigger, message, |_, data| {
            json::read_trigger(&data, message.log_time())
        })
    }

    /// What the rig wrote when a capture was complete or had failed.
    pub fn capture_record(&self, message: &MessageRef) -> Result<CaptureRecord, Error> {
        self.typed(&Topic::Capture, message, |_, data| {
            json::read("scand.Capture", &data)
        })
    }

    /// What a person noted about a capture.
    pub fn note(&self, message: &MessageRef) -> Result<Note, Error> {
        self.typed(&Topic::Note, message, |_, data| {
            json::read("scand.Note", &data)
        })
    }
}
