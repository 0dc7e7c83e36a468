//! Writes recordings in their plainest form. A recording is written as `NAME.part` beside its place; it gets
//! its name when it is complete and on the disk.

use super::container::Container;
use super::encoding::MessageHead;
use super::json::{self, CaptureRecord, Note};
use super::records::{ChannelText, SchemaText};
use super::schemas;
use super::{ColorPart, DepthPart, Error, MessageError, Topic, proto};
use crate::calibration::{Board, Camera, DepthCamera, DepthResponse, Intrinsics, Volume};
use crate::frame::{CameraId, CameraSettings, Frame, Picture, Stream, Timestamp, Trigger};
use crate::image::Mask;
use crate::storage::{rename_noreplace, sync_parent};
use nalgebra::Isometry3;
use std::collections::BTreeMap;
use std::fs::File;
use std::path::{Path, PathBuf};

/// Largest chunk that holds more than one message, in bytes before compression.
const LARGEST_CHUNK: usize = 16 << 20;
/// Bytes that a message takes in a chunk beside its data.
const MESSAGE_OVERHEAD: usize = 31;

/// What the name of a recording ends with while it is written.
pub(super) const PART: &str = ".part";

/// How a recording's chunks are packed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Compression {
    /// Not at all, as a rig does it: pictures of real sensors hardly shrink.
    #[default]
    None,
    /// With zstd at its default level.
    Zstd,
}

/// A recording that is being written.
pub struct Writer {
    path: PathBuf,
    part: PathBuf,
    /// The same file, to bring what was written to the disk.
    file: File,
    container: Container,
    channels: BTreeMap<String, Channel>,
    /// Of a recording that is copied: its channels' numbers, and what they are here.
    copied: BTreeMap<u16, u16>,
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
        let there = |cause| Error::Io {
            path: path.into(),
            cause,
        };
        if path.try_exists().map_err(there)? {
            return Err(there(std::io::ErrorKind::AlreadyExists.into()));
        }
        Self::create_at(path, &part_of(path), program, compression)
    }

    /// Starts a recording that is written at `part`, and locked there, until it gets its name.
    pub(super) fn create_at(
        path: &Path,
        part: &Path,
        program: &str,
        compression: Compression,
    ) -> Result<Self, Error> {
        let mut writer = Self::bare(path, part, program, compression)?;
        let format = [("format", "1"), ("writer", program)];
        writer.metadata("scand", &format.map(|(k, v)| (k.into(), v.into())).into())?;
        // Whatever happens from here on leaves a recording, not an empty file.
        writer.finish_chunk()?;
        Ok(writer)
    }

    /// The same without the metadata record `scand`: for a copy of a recording that has its own.
    pub(super) fn bare(
        path: &Path,
        part: &Path,
        program: &str,
        compression: Compression,
    ) -> Result<Self, Error> {
        let part = part.to_owned();
        let io = |path: &Path| {
            let path = path.to_owned();
            move |cause| Error::Io { path, cause }
        };
        let file = File::create_new(&part).map_err(io(&part))?;
        // Tells who would recover it that it is not lost. A file system without locks does without.
        let _ = file.try_lock();
        sync_parent(&part).map_err(io(&part))?;
        let same = file.try_clone().map_err(io(&part))?;
        Ok(Self {
            path: path.into(),
            part,
            file,
            container: Container::begin(same, "scand", program, compression),
            channels: BTreeMap::new(),
            copied: BTreeMap::new(),
            chunk: Chunk::default(),
        })
    }

    /// Writes a metadata record: a name and pairs. `session` and `board` are of the format.
    ///
    /// # Errors
    /// If the file cannot be written; so for all that follow.
    pub fn metadata(&mut self, name: &str, pairs: &BTreeMap<String, String>) -> Result<(), Error> {
        self.chunk = Chunk::default();
        let written = self.container.metadata(name, pairs);
        written.map_err(|cause| self.failed(cause))
    }

    /// Writes which board a calibration session shows.
    pub fn board(&mut self, board: &Board) -> Result<(), Error> {
        self.metadata("board", &board.pairs())
    }

    /// Attaches a file, such as `rig.toml`.
    pub fn attach(
        &mut self,
        name: &str,
        media_type: &str,
        time: Timestamp,
        data: &[u8],
    ) -> Result<(), Error> {
        self.copy_attachment(&mcap::Attachment {
            log_time: time.0,
            create_time: time.0,
            name: name.into(),
            media_type: media_type.into(),
            data: data.into(),
        })
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

    /// Writes what a person said of a capture.
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
        let picture = Picture::Raw {
            width: mask.width() as u32,
            height: mask.height() as u32,
            encoding: "mono8".into(),
            step: mask.width() as u32,
            data: mask.pixels().to_vec().into(),
        };
        let topic = Topic::Color(id.clone(), ColorPart::Mask);
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

    /// Brings everything written so far to the disk: what is a capture by then survives a power cut.
    pub fn sync(&mut self) -> Result<(), Error> {
        self.finish_chunk()?;
        let synced = self.file.sync_data();
        synced.map_err(|cause| Error::Io {
            path: self.part.clone(),
            cause,
        })
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
        let io = |path: &Path, cause| Error::Io {
            path: path.into(),
            cause,
        };
        let finished = container.finish();
        finished.map_err(|cause| Error::Write {
            path: part.clone(),
            cause,
        })?;
        let renamed = file
            .sync_all()
            .and_then(|()| rename_noreplace(&part, &path))
            .and_then(|()| sync_parent(&path));
        renamed.map_err(|cause| io(&path, cause))
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
        schema: SchemaText,
        encoding: &str,
        data: [&[u8]; 2],
        time: Timestamp,
    ) -> Result<(), Error> {
        self.make_room(&schema.name, data[0].len() + data[1].len())?;
        let channel = self.channel(topic, schema, encoding)?;
        let head = MessageHead {
            channel: channel.id,
            sequence: channel.messages,
            log_time: time.0,
            publish_time: time.0,
        };
        let written = self.container.message(&head, data);
        written.map_err(|cause| self.failed(cause))
    }

    /// Writes a message of another recording as it is; all that are copied are of the same one.
    pub(super) fn copy(&mut self, message: &mcap::Message) -> Result<(), Error> {
        let schema = message.channel.schema.as_ref();
        self.make_room(schema.map_or("", |s| &s.name), message.data.len())?;
        let written = self.copied_channel(&message.channel).and_then(|channel| {
            let head = MessageHead {
                channel,
                sequence: message.sequence,
                log_time: message.log_time,
                publish_time: message.publish_time,
            };
            self.container.message(&head, [&message.data, &[]])
        });
        written.map_err(|cause| self.failed(cause))
    }

    /// The channel that stands for another recording's.
    fn copied_channel(&mut self, of: &mcap::Channel) -> std::io::Result<u16> {
        if let Some(&known) = self.copied.get(&of.id) {
            return Ok(known);
        }
        let schema = match &of.schema {
            None => 0,
            Some(schema) => self.container.schema(SchemaText {
                name: schema.name.clone(),
                encoding: schema.encoding.clone(),
                data: schema.data.to_vec().into(),
            })?,
        };
        let id = self.container.channel(ChannelText {
            schema,
            topic: of.topic.clone(),
            encoding: of.message_encoding.clone(),
            metadata: of.metadata.clone(),
        })?;
        self.copied.insert(of.id, id);
        Ok(id)
    }

    /// Writes an attachment of another recording as it is.
    pub(super) fn copy_attachment(&mut self, attachment: &mcap::Attachment) -> Result<(), Error> {
        self.chunk = Chunk::default();
        let written = self.container.attach(attachment);
        written.map_err(|cause| self.failed(cause))
    }

    /// Ends the open chunk if a message of `length` bytes has no place in it.
    fn make_room(&mut self, schema: &str, length: usize) -> Result<(), Error> {
        let bytes = length + MESSAGE_OVERHEAD;
        let pictures = schema.ends_with("Image");
        let open = self.chunk;
        let fits = open.pictures == pictures && open.bytes + bytes <= LARGEST_CHUNK;
        if open.bytes > 0 && !fits {
            let ended = self.container.end_chunk();
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
        schema: SchemaText,
        encoding: &str,
    ) -> Result<Channel, Error> {
        let key = format!("{topic} {}", schema.name);
        if let Some(channel) = self.channels.get_mut(&key) {
            channel.messages += 1;
            return Ok(*channel);
        }
        // The open chunk holds the definitions too.
        self.chunk.bytes += schema.data.len() + 256;
        let id = self.container.schema(schema).and_then(|schema| {
            self.container.channel(ChannelText {
                schema,
                topic: topic.to_string(),
                encoding: encoding.into(),
                metadata: BTreeMap::new(),
            })
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

/// The name of a recording while it is written.
pub(super) fn part_of(path: &Path) -> PathBuf {
    let mut part = path.as_os_str().to_owned();
    part.push(PART);
    part.into()
}
