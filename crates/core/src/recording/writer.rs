//! Writes recordings. A recording is written as `NAME.part` in its folder and gets its final name when it is complete
//! and on the disk.

use super::container::{Compression, Container};
use super::json::{self, CaptureRecord, Note};
use super::rewriting::{io, with_ending};
use super::schemas;
use super::{ColorPart, DepthPart, Error, MessageError, Topic, proto};
use crate::calibration::{
    Board, CalibrationRecord, Camera, DepthCamera, DepthResponse, Intrinsics, Volume,
};
use crate::frame::{CameraId, CameraSettings, Frame, Picture, Stream, Timestamp, Trigger};
use crate::image::Mask;
use crate::storage::{rename_noreplace, sync_parent};
use mcap::Schema;
use mcap::records::{MessageHeader, Metadata};
use nalgebra::Isometry3;
use std::collections::BTreeMap;
use std::fs::File;
use std::path::{Path, PathBuf};

/// Largest chunk that holds more than one message, in bytes before compression.
const LARGEST_CHUNK: usize = 16 << 20;
/// Bytes that a message takes in a chunk beside its data.
const MESSAGE_OVERHEAD: usize = 31;

/// A recording that is being written.
pub struct Writer {
    path: PathBuf,
    part: PathBuf,
    /// The same file, to bring what was written to the disk.
    file: File,
    container: Container,
    channels: BTreeMap<String, Channel>,
    chunk: Chunk,
}

/// A channel that was added, and how many messages it has.
#[derive(Clone, Copy)]
struct Channel {
    id: u16,
    messages: u32,
}

/// What the open chunk holds.
#[derive(Clone, Copy, Default, PartialEq)]
struct Chunk {
    bytes: usize,
    pictures: bool,
}

impl Writer {
    /// Starts a recording that will be found at `path`; `program` is the name and version of what writes it.
    ///
    /// # Errors
    /// If there is something at `path` already, or its `.part` that an earlier run left, or the folder
    /// cannot be written to.
    pub fn create(path: &Path, program: &str, compression: Compression) -> Result<Self, Error> {
        if path.try_exists().map_err(io(path))? {
            return Err(io(path)(std::io::ErrorKind::AlreadyExists.into()));
        }
        let part = with_ending(path, "part");
        let file = File::create_new(&part).map_err(io(&part))?;
        let begun = Self::begin(file, path, &part, program, compression);
        if begun.is_err() {
            // It holds nothing. The error that matters is the first one.
            let _ = std::fs::remove_file(&part);
        }
        begun
    }

    fn begin(
        file: File,
        path: &Path,
        part: &Path,
        program: &str,
        compression: Compression,
    ) -> Result<Self, Error> {
        // The lock tells recovery that the file is still being written. Some file systems have no locks.
        let _ = file.try_lock();
        sync_parent(part).map_err(io(part))?;
        let same = file.try_clone().map_err(io(part))?;
        let container = Container::begin(same, "scand", program, compression);
        let mut writer = Self {
            path: path.into(),
            file,
            container: container.map_err(io(part))?,
            part: part.into(),
            channels: BTreeMap::new(),
            chunk: Chunk::default(),
        };
        let format = [("format", "1"), ("writer", program)];
        writer.metadata("scand", &format.map(|(k, v)| (k.into(), v.into())).into())?;
        // Whatever happens from here on leaves a recording, not an empty file.
        writer.finish_chunk()?;
        Ok(writer)
    }

    /// Writes a metadata record: a name and pairs. `session`, `board` and `calibration` are of the
    /// format.
    ///
    /// # Errors
    /// If the file cannot be written; so for all that follow.
    pub fn metadata(&mut self, name: &str, pairs: &BTreeMap<String, String>) -> Result<(), Error> {
        self.chunk = Chunk::default();
        let written = self.container.metadata(&Metadata {
            name: name.into(),
            metadata: pairs.clone(),
        });
        written.map_err(|cause| self.failed(cause))
    }

    /// Writes which board a calibration session shows.
    pub fn board(&mut self, board: &Board) -> Result<(), Error> {
        self.metadata("board", &board.pairs())
    }

    /// Writes what the calibration that the recording carries is worth.
    pub fn calibration_record(&mut self, record: &CalibrationRecord) -> Result<(), Error> {
        self.metadata("calibration", &record.pairs())
    }

    /// Attaches a file, such as `rig.toml`.
    pub fn attach(
        &mut self,
        name: &str,
        media_type: &str,
        time: Timestamp,
        data: &[u8],
    ) -> Result<(), Error> {
        self.chunk = Chunk::default();
        let written = self.container.attach(&mcap::Attachment {
            log_time: time.0,
            create_time: time.0,
            name: name.into(),
            media_type: media_type.into(),
            data: data.into(),
        });
        written.map_err(|cause| self.failed(cause))
    }

    /// Writes a colour camera: its lens and its pose.
    pub fn color_camera(&mut self, camera: &Camera, time: Timestamp) -> Result<(), Error> {
        let topic = Topic::Color(camera.id.clone(), ColorPart::Calibration);
        self.lens(&topic, &camera.id, &camera.intrinsics, time)?;
        self.pose(&camera.id, &camera.rig_from_camera, time)
    }

    /// Writes a depth camera: its lens, its pose and its response.
    pub fn depth_camera(&mut self, depth: &DepthCamera, time: Timestamp) -> Result<(), Error> {
        let DepthCamera { camera, response } = depth;
        let topic = Topic::Depth(camera.id.clone(), DepthPart::Calibration);
        self.lens(&topic, &camera.id, &camera.intrinsics, time)?;
        self.pose(&camera.id, &camera.rig_from_camera, time)?;
        self.response(&camera.id, response, time)
    }

    fn lens(
        &mut self,
        topic: &Topic,
        id: &CameraId,
        lens: &Intrinsics,
        time: Timestamp,
    ) -> Result<(), Error> {
        let message = proto::write_intrinsics(id.as_str(), lens, time.0);
        self.protobuf(topic, &message, time)
    }

    /// Writes a camera's pose alone.
    pub fn pose(
        &mut self,
        id: &CameraId,
        rig_from_camera: &Isometry3<f64>,
        time: Timestamp,
    ) -> Result<(), Error> {
        let message = proto::write_pose(id.as_str(), rig_from_camera, time.0);
        self.protobuf(&Topic::Tf, &message, time)
    }

    /// Writes what a depth camera's readings mean.
    pub fn response(
        &mut self,
        id: &CameraId,
        response: &DepthResponse,
        time: Timestamp,
    ) -> Result<(), Error> {
        let topic = Topic::Depth(id.clone(), DepthPart::Response);
        let checked = response.checked().map_err(|e| self.unwritable(&topic, e))?;
        self.json(&topic, &json::write_response(&checked), time)
    }

    /// Writes the box that is reconstructed.
    pub fn volume(&mut self, volume: &Volume, time: Timestamp) -> Result<(), Error> {
        let checked = Volume::new(volume.min, volume.max);
        let checked = checked.map_err(|e| self.unwritable(&Topic::Volume, e))?;
        self.json(&Topic::Volume, &json::write_volume(&checked), time)
    }

    /// Writes how a colour camera was set.
    pub fn settings(
        &mut self,
        id: &CameraId,
        settings: &CameraSettings,
        time: Timestamp,
    ) -> Result<(), Error> {
        let topic = Topic::Color(id.clone(), ColorPart::Settings);
        self.json(&topic, &json::write(settings), time)
    }

    /// Writes a trigger.
    pub fn trigger(&mut self, trigger: &Trigger) -> Result<(), Error> {
        let message = json::write_trigger(trigger);
        self.json(&Topic::Trigger, &message, trigger.time)
    }

    /// Writes what became of a capture.
    pub fn capture(&mut self, capture: &CaptureRecord, time: Timestamp) -> Result<(), Error> {
        self.json(&Topic::Capture, &json::write(capture), time)
    }

    /// Writes what a person noted about a capture.
    pub fn note(&mut self, note: &Note, time: Timestamp) -> Result<(), Error> {
        self.json(&Topic::Note, &json::write(note), time)
    }

    /// Writes a frame of any camera.
    pub fn frame(&mut self, frame: &Frame) -> Result<(), Error> {
        let camera = frame.camera.clone();
        let topic = match frame.stream {
            Stream::Color => Topic::Color(camera, ColorPart::Image),
            Stream::Depth => Topic::Depth(camera, DepthPart::Image),
            Stream::DepthColor => Topic::Depth(camera, DepthPart::Color),
        };
        self.picture(&topic, &frame.camera, &frame.picture, frame.timestamp)
    }

    /// Writes a colour camera's view of the rig with no object in it.
    pub fn background(
        &mut self,
        id: &CameraId,
        picture: &Picture,
        time: Timestamp,
    ) -> Result<(), Error> {
        let topic = Topic::Color(id.clone(), ColorPart::Background);
        self.picture(&topic, id, picture, time)
    }

    /// Writes the silhouette of a colour camera's frame with this timestamp.
    pub fn mask(&mut self, id: &CameraId, mask: &Mask, time: Timestamp) -> Result<(), Error> {
        self.grey(ColorPart::Mask, id, mask, time)
    }

    /// Writes which pixels of a colour camera's frame with this timestamp are not to be looked at: 128 and up.
    pub fn ignore(&mut self, id: &CameraId, ignored: &Mask, time: Timestamp) -> Result<(), Error> {
        self.grey(ColorPart::Ignore, id, ignored, time)
    }

    fn grey(
        &mut self,
        part: ColorPart,
        id: &CameraId,
        mask: &Mask,
        time: Timestamp,
    ) -> Result<(), Error> {
        let picture = Picture::Raw {
            width: mask.width() as u32,
            height: mask.height() as u32,
            encoding: "mono8".into(),
            step: mask.width() as u32,
            data: mask.pixels().to_vec().into(),
        };
        let topic = Topic::Color(id.clone(), part);
        self.picture(&topic, id, &picture, time)
    }

    fn picture(
        &mut self,
        topic: &Topic,
        id: &CameraId,
        picture: &Picture,
        time: Timestamp,
    ) -> Result<(), Error> {
        let (schema, head, data) = proto::picture(id.as_str(), picture, time.0);
        self.write(topic, schema, "protobuf", [&head, data], time)
    }

    /// Writes a message of another recording as it is, with the schema that it has there.
    pub(super) fn copy(
        &mut self,
        topic: &Topic,
        schema: Schema<'static>,
        data: &[u8],
        time: Timestamp,
    ) -> Result<(), Error> {
        let encoding = if schema.encoding == "jsonschema" {
            "json"
        } else {
            "protobuf"
        };
        self.write(topic, schema, encoding, [data, &[]], time)
    }

    /// Brings everything written so far to the disk: what is a capture by then survives a power cut.
    pub fn sync(&mut self) -> Result<(), Error> {
        self.finish_chunk()?;
        let synced = self.file.sync_data();
        synced.map_err(io(&self.part))
    }

    /// Makes every later write fail.
    #[cfg(test)]
    pub(super) fn break_container(&mut self) {
        self.container.give_up();
    }

    /// Completes the recording and gives it its name.
    pub fn finish(self) -> Result<(), Error> {
        let Self {
            path,
            part,
            file,
            container,
            ..
        } = self;
        let finished = container.finish();
        finished.map_err(|cause| Error::Write {
            path: part.clone(),
            cause,
        })?;
        let renamed = file
            .sync_all()
            .and_then(|()| rename_noreplace(&part, &path))
            .and_then(|()| sync_parent(&path));
        renamed.map_err(io(&path))
    }

    fn json(&mut self, topic: &Topic, data: &[u8], time: Timestamp) -> Result<(), Error> {
        self.write(
            topic,
            schemas::json_schema(topic),
            "json",
            [data, &[]],
            time,
        )
    }

    fn protobuf<M: foxglove::Encode + prost::Message>(
        &mut self,
        topic: &Topic,
        message: &M,
        time: Timestamp,
    ) -> Result<(), Error> {
        let schema = schemas::protobuf_schema::<M>();
        let data = prost::Message::encode_to_vec(message);
        self.write(topic, schema, "protobuf", [&data, &[]], time)
    }

    /// Writes a message, whose data are in two parts, into a new chunk when the open one is full or of the other kind:
    /// small messages stay apart from pictures, so that a reader finds the captures without reading every picture.
    fn write(
        &mut self,
        topic: &Topic,
        schema: Schema<'static>,
        encoding: &str,
        data: [&[u8]; 2],
        time: Timestamp,
    ) -> Result<(), Error> {
        self.make_room(&schema.name, data[0].len() + data[1].len())?;
        let channel = self.channel(topic, schema, encoding)?;
        let header = MessageHeader {
            channel_id: channel.id,
            sequence: channel.messages,
            log_time: time.0,
            publish_time: time.0,
        };
        let written = self.container.message(&header, data);
        written.map_err(|cause| self.failed(cause))
    }

    /// Ends the open chunk if a message of `length` bytes has no place in it.
    fn make_room(&mut self, schema: &str, length: usize) -> Result<(), Error> {
        let bytes = length + MESSAGE_OVERHEAD;
        let pictures = schema.ends_with("Image");
        let open = self.chunk;
        let fits = open.pictures == pictures && open.bytes + bytes <= LARGEST_CHUNK;
        if open.bytes > 0 && !fits {
            let ended = self.container.flush();
            ended.map_err(|cause| self.failed(cause))?;
            self.chunk = Chunk::default();
        }
        self.chunk.pictures = pictures;
        self.chunk.bytes += bytes;
        Ok(())
    }

    /// The channel of a topic and schema, with its next message's number.
    fn channel(
        &mut self,
        topic: &Topic,
        schema: Schema<'static>,
        encoding: &str,
    ) -> Result<Channel, Error> {
        let key = format!("{topic} {}", schema.name);
        if let Some(channel) = self.channels.get_mut(&key) {
            channel.messages += 1;
            return Ok(*channel);
        }
        // The open chunk holds the definitions too.
        self.chunk.bytes += schema.data.len() + 256;
        let id = self.container.schema(&schema).and_then(|schema| {
            let topic = topic.to_string();
            self.container
                .channel(schema, &topic, encoding, &BTreeMap::new())
        });
        let channel = Channel {
            id: id.map_err(|cause| self.failed(cause))?,
            messages: 0,
        };
        self.channels.insert(key, channel);
        Ok(channel)
    }

    fn finish_chunk(&mut self) -> Result<(), Error> {
        self.chunk = Chunk::default();
        let flushed = self.container.flush();
        flushed.map_err(|cause| self.failed(cause))
    }

    fn failed(&self, cause: std::io::Error) -> Error {
        Error::Write {
            path: self.part.clone(),
            cause,
        }
    }

    fn unwritable(&self, topic: &Topic, problem: impl Into<MessageError>) -> Error {
        Error::Unwritable {
            path: self.path.clone(),
            topic: topic.to_string(),
            problem: problem.into(),
        }
    }
}
