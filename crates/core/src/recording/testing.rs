//! Small recordings for tests, which the real writer writes into a folder in memory.

use super::{Compression, Writer};
use crate::calibration::{Camera, DepthCamera, DepthResponse, Distortion, Intrinsics, Volume};
use crate::frame::{CameraId, CaptureId, Frame, Picture, Stream, Timestamp, Trigger};
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector2, Vector3};
use std::path::{Path, PathBuf};

/// Where the session's clock begins.
pub(crate) const START: u64 = 1_760_000_000_000_000_000;
/// A millisecond.
pub(crate) const MS: u64 = 1_000_000;

pub(crate) fn at(milliseconds: u64) -> Timestamp {
    Timestamp(START + milliseconds * MS)
}

pub(crate) fn camera_id(name: &str) -> CameraId {
    CameraId::new(name).unwrap()
}

/// A camera of `width` x `height` pixels with a pose and a lens of its own.
pub(crate) fn camera(name: &str, width: usize, height: usize) -> Camera {
    let number = name.bytes().map(f64::from).sum::<f64>();
    let lens = Intrinsics::new(
        width,
        height,
        Vector2::new(600.5 + number, 601.25),
        Vector2::new(3.25, 2.5),
        Distortion {
            radial: [0.01, -0.02, 0.003, 0.0, 0.0, number / 1e6],
            tangential: [1e-4, -2e-4],
        },
    );
    let pose = Isometry3::from_parts(
        Translation3::new(0.01 * number, -0.2, 0.75),
        UnitQuaternion::from_axis_angle(&Vector3::y_axis(), 0.01 * number),
    );
    Camera::new(camera_id(name), lens.unwrap(), pose)
}

pub(crate) fn raw(width: u32, height: u32, encoding: &str, bytes: u32, seed: u8) -> Picture {
    let length = width * height * bytes;
    Picture::Raw {
        width,
        height,
        encoding: encoding.into(),
        step: width * bytes,
        data: (0..length)
            .map(|i| (i as u8).wrapping_mul(7).wrapping_add(seed))
            .collect(),
    }
}

/// A rig of two colour cameras of 8 x 6 pixels and a depth camera of 6 x 4.
pub(crate) struct Rig {
    pub colors: Vec<Camera>,
    pub depth: DepthCamera,
    pub volume: Volume,
}

impl Rig {
    pub(crate) fn new() -> Self {
        Self {
            colors: vec![camera("c00", 8, 6), camera("c01", 8, 6)],
            depth: DepthCamera {
                camera: camera("kinect", 6, 4),
                response: DepthResponse {
                    slope: 0.00104,
                    intercept: -0.018,
                    scale: [1.012, -0.009, 0.0, 0.0, 0.0],
                    range: Some([0.4, 4.0]),
                    uncertainty: 0.002,
                },
            },
            volume: Volume::new(Point3::new(-0.1, -0.1, 0.0), Point3::new(0.1, 0.1, 0.2)).unwrap(),
        }
    }

    /// Writes what does not change in a session.
    pub(crate) fn write_to(&self, writer: &mut Writer) {
        for camera in &self.colors {
            writer.color_camera(camera, at(0)).unwrap();
            let plate = raw(8, 6, "rgb8", 3, 1);
            writer.background(&camera.id, &plate, at(1)).unwrap();
        }
        writer.depth_camera(&self.depth, at(0)).unwrap();
        writer.volume(&self.volume, at(0)).unwrap();
    }

    /// Writes a trigger and what the cameras give to it: colour after 10 ms, depth and its colour every 33.
    pub(crate) fn write_capture(&self, writer: &mut Writer, id: &str, ms: u64, depth: u64) {
        writer.trigger(&trigger(id, ms)).unwrap();
        for (i, camera) in self.colors.iter().enumerate() {
            let frame = frame(camera.id.clone(), Stream::Color, ms + 10 + i as u64);
            writer.frame(&frame).unwrap();
        }
        for i in 0..depth {
            for stream in [Stream::Depth, Stream::DepthColor] {
                let id = self.depth.camera.id.clone();
                writer.frame(&frame(id, stream, ms + 33 * i)).unwrap();
            }
        }
    }
}

pub(crate) fn trigger(id: &str, ms: u64) -> Trigger {
    Trigger {
        id: CaptureId::new(id).unwrap(),
        time: at(ms),
        source: "pedal".into(),
        press_id: Some("press-4".into()),
        subject: Some("17".into()),
        placement: None,
    }
}

pub(crate) fn frame(camera: CameraId, stream: Stream, ms: u64) -> Frame {
    Frame {
        camera,
        stream,
        timestamp: at(ms),
        picture: match stream {
            Stream::Color => raw(8, 6, "bayer_rggb8", 1, ms as u8),
            Stream::Depth => raw(6, 4, "16UC1", 2, ms as u8),
            Stream::DepthColor => raw(6, 4, "rgb8", 3, ms as u8),
        },
    }
}

/// Writes a recording of these captures (id, milliseconds, depth frames) and returns where it is.
pub(crate) fn write_session(
    folder: &Path,
    captures: &[(&str, u64, u64)],
    compression: Compression,
) -> PathBuf {
    let path = folder.join(format!("session-{compression:?}.mcap"));
    let mut writer = Writer::create(&path, "scand test", compression).unwrap();
    let rig = Rig::new();
    rig.write_to(&mut writer);
    for &(id, ms, depth) in captures {
        rig.write_capture(&mut writer, id, ms, depth);
        writer.sync().unwrap();
    }
    writer.finish().unwrap();
    path
}

/// Where each record of a file begins, and how long its body is.
pub(crate) fn records_of(bytes: &[u8]) -> Vec<(u8, usize, usize)> {
    let mut found = Vec::new();
    let mut at = 8;
    while at + 9 <= bytes.len() {
        let length = u64::from_le_bytes(bytes[at + 1..at + 9].try_into().unwrap()) as usize;
        found.push((bytes[at], at, length));
        at += 9 + length;
    }
    found
}

/// Writes a recording as another program may: 50 notes, in chunks of 20.
pub(crate) fn write_as_another(path: &Path, options: mcap::WriteOptions) {
    let file = std::fs::File::create_new(path).unwrap();
    let mut writer = options.create(std::io::BufWriter::new(file)).unwrap();
    let own = [("format", "1"), ("writer", "other 7"), ("more", "words")];
    let own = own.map(|(k, v)| (k.to_owned(), v.to_owned()));
    let metadata = mcap::records::Metadata {
        name: "scand".into(),
        metadata: own.into(),
    };
    writer.write_metadata(&metadata).unwrap();
    let schema = writer.add_schema("scand.Note", "jsonschema", b"{}");
    let pairs = [("k".to_owned(), "v".to_owned())].into();
    let channel = writer.add_channel(schema.unwrap(), "/note", "json", &pairs);
    let channel_id = channel.unwrap();
    let text = "schön ".repeat(100);
    let note = format!(r#"{{"capture": "cup-1", "kind": "text", "text": "{text}"}}"#);
    for sequence in 0..50 {
        let header = mcap::records::MessageHeader {
            channel_id,
            sequence,
            log_time: at(u64::from(sequence)).0,
            publish_time: 7,
        };
        let written = writer.write_to_known_channel(&header, note.as_bytes());
        written.unwrap();
        if sequence % 20 == 19 {
            writer.flush().unwrap();
        }
    }
    writer.finish().unwrap();
}

/// Writes a recording `cup.mcap` of one trigger, `cup-1` at 100 ns, and of notes on it: kind, and time in nanoseconds.
pub(crate) fn noted_recording(folder: &Path, notes: &[(&str, u64)]) -> PathBuf {
    let path = folder.join("cup.mcap");
    let mut writer = Writer::create(&path, "scand test", Compression::None).unwrap();
    let mut trigger = trigger("cup-1", 0);
    trigger.time = Timestamp(100);
    writer.trigger(&trigger).unwrap();
    for (kind, time) in notes {
        let note = super::Note {
            capture: "cup-1".into(),
            kind: (*kind).into(),
            text: String::new(),
            author: None,
        };
        writer.note(&note, Timestamp(*time)).unwrap();
    }
    writer.finish().unwrap();
    path
}
