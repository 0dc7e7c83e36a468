//! Foxglove's messages: encodes them as Protobuf and decodes them.

use super::MessageError;
use super::schemas::protobuf_schema;
use crate::calibration::{Distortion, Intrinsics};
use crate::frame::Picture;
use bytes::Bytes;
use foxglove::messages::{
    CameraCalibration, CompressedImage, FrameTransform, FrameTransforms, RawImage,
};
use mcap::Schema;
use nalgebra::{Isometry3, Vector2};
use prost::Message;
use prost::encoding::{WireType, encode_key, encode_varint};

/// Where a frame is in its parent's, as a recording has it; not checked yet.
#[derive(Debug, Clone, PartialEq)]
pub struct Pose {
    /// The frame that the pose maps into.
    pub parent: String,
    /// The frame that it maps from.
    pub child: String,
    /// Metres.
    pub translation: [f64; 3],
    /// Quaternion x, y, z, w; `None` where the message has none.
    pub rotation_xyzw: Option<[f64; 4]>,
}

fn decode<M: Message + Default>(schema: &'static str, data: Bytes) -> Result<M, MessageError> {
    M::decode(data).map_err(|error| MessageError::Malformed {
        schema,
        reason: super::error::shortened(&error.to_string()),
    })
}

/// A picture's pixels, still encoded; they share the message's memory.
pub(super) fn read_picture(schema: &str, data: Bytes) -> Result<Picture, MessageError> {
    if schema == "foxglove.CompressedImage" {
        let image: CompressedImage = decode("foxglove.CompressedImage", data)?;
        return Ok(Picture::Compressed {
            format: image.format,
            data: image.data,
        });
    }
    let image: RawImage = decode("foxglove.RawImage", data)?;
    Ok(Picture::Raw {
        width: image.width,
        height: image.height,
        encoding: image.encoding,
        step: image.step,
        data: image.data,
    })
}

pub(super) fn read_intrinsics(data: Bytes) -> Result<Intrinsics, MessageError> {
    let message: CameraCalibration = decode("foxglove.CameraCalibration", data)?;
    let k = checked_k(&message.k)?;
    check_r(&message.r)?;
    let distortion = Distortion::from_model(&message.distortion_model, &message.d)?;
    let lens = Intrinsics::new(
        message.width as usize,
        message.height as usize,
        Vector2::new(k[0], k[4]),
        Vector2::new(k[2], k[5]),
        distortion,
    )?;
    Ok(lens.checked()?)
}

/// K without skew, and with nothing in its bottom row but the 1.
fn checked_k(k: &[f64]) -> Result<&[f64; 9], MessageError> {
    let bad = |found: String| MessageError::BadField {
        field: "K",
        found,
        expected: "fx 0 cx 0 fy cy 0 0 1".into(),
    };
    let k: &[f64; 9] = k.try_into().map_err(|_| MessageError::WrongCount {
        field: "K",
        found: k.len(),
        expected: "9: fx 0 cx 0 fy cy 0 0 1",
    })?;
    let zeros = [k[1], k[3], k[6], k[7]];
    if zeros != [0.0; 4] || k[8] != 1.0 {
        return Err(bad(format!("{k:?}")));
    }
    Ok(k)
}

/// R says nothing: the identity, or empty.
fn check_r(r: &[f64]) -> Result<(), MessageError> {
    const IDENTITY: [f64; 9] = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    let same = |(a, b): (&f64, &f64)| (a - b).abs() <= 1e-9;
    if r.is_empty() || r.len() == 9 && r.iter().zip(&IDENTITY).all(same) {
        return Ok(());
    }
    Err(MessageError::BadField {
        field: "R",
        found: format!("{:?} ({} numbers)", &r[..r.len().min(9)], r.len()),
        expected: "the identity, or empty".into(),
    })
}

pub(super) fn write_intrinsics(id: &str, lens: &Intrinsics, log_time: u64) -> CameraCalibration {
    let (f, c) = (lens.focal_px, lens.center_px);
    let (model, coefficients) = lens.distortion.to_model();
    CameraCalibration {
        timestamp: Some(timestamp(log_time)),
        frame_id: id.into(),
        width: lens.width as u32,
        height: lens.height as u32,
        distortion_model: model.into(),
        d: coefficients,
        k: vec![f.x, 0.0, c.x, 0.0, f.y, c.y, 0.0, 0.0, 1.0],
        r: vec![1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        p: vec![f.x, 0.0, c.x, 0.0, 0.0, f.y, c.y, 0.0, 0.0, 0.0, 1.0, 0.0],
    }
}

/// The poses of a FrameTransform or FrameTransforms message.
pub(super) fn read_poses(schema: &str, data: Bytes) -> Result<Vec<Pose>, MessageError> {
    let transforms = if schema == "foxglove.FrameTransforms" {
        decode::<FrameTransforms>("foxglove.FrameTransforms", data)?.transforms
    } else {
        vec![decode::<FrameTransform>("foxglove.FrameTransform", data)?]
    };
    Ok(transforms.into_iter().map(pose).collect())
}

fn pose(transform: FrameTransform) -> Pose {
    let t = transform.translation.unwrap_or_default();
    Pose {
        parent: transform.parent_frame_id,
        child: transform.child_frame_id,
        translation: [t.x, t.y, t.z],
        rotation_xyzw: transform.rotation.map(|q| [q.x, q.y, q.z, q.w]),
    }
}

/// A camera's pose in the rig.
pub(super) fn write_pose(
    id: &str,
    rig_from_camera: &Isometry3<f64>,
    log_time: u64,
) -> FrameTransform {
    let (t, q) = (
        rig_from_camera.translation.vector,
        rig_from_camera.rotation.coords,
    );
    FrameTransform {
        timestamp: Some(timestamp(log_time)),
        parent_frame_id: "rig".into(),
        child_frame_id: id.into(),
        translation: Some(foxglove::messages::Vector3 {
            x: t.x,
            y: t.y,
            z: t.z,
        }),
        rotation: Some(foxglove::messages::Quaternion {
            x: q.x,
            y: q.y,
            z: q.z,
            w: q.w,
        }),
    }
}

/// A picture's message in two parts, the second of which is the picture's own memory, and its schema. The order of a
/// message's fields is free: the data are the last.
pub(super) fn picture<'a>(
    id: &str,
    picture: &'a Picture,
    log_time: u64,
) -> (Schema<'static>, Vec<u8>, &'a [u8]) {
    let time = Some(timestamp(log_time));
    match picture {
        Picture::Raw {
            width,
            height,
            encoding,
            step,
            data,
        } => {
            let message = RawImage {
                timestamp: time,
                frame_id: id.into(),
                width: *width,
                height: *height,
                encoding: encoding.clone(),
                step: *step,
                data: Bytes::new(),
            };
            (protobuf_schema::<RawImage>(), head(&message, 6, data), data)
        }
        Picture::Compressed { format, data } => {
            let message = CompressedImage {
                timestamp: time,
                frame_id: id.into(),
                format: format.clone(),
                data: Bytes::new(),
            };
            let schema = protobuf_schema::<CompressedImage>();
            (schema, head(&message, 2, data), data)
        }
    }
}

/// A message that lacks its data, and what announces those: the number of their field and their length.
fn head(message: &impl Message, data_field: u32, data: &[u8]) -> Vec<u8> {
    let mut bytes = message.encode_to_vec();
    encode_key(data_field, WireType::LengthDelimited, &mut bytes);
    encode_varint(data.len() as u64, &mut bytes);
    bytes
}

/// Nanoseconds as seconds and the rest; seconds end in the year 2106.
pub(super) fn timestamp(nanoseconds: u64) -> foxglove::messages::Timestamp {
    let seconds = u32::try_from(nanoseconds / 1_000_000_000).unwrap_or(u32::MAX);
    foxglove::messages::Timestamp::new(seconds, (nanoseconds % 1_000_000_000) as u32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_in_two_parts_is_the_message_that_it_was() {
        let data = Bytes::from(vec![7; 300]);
        let raw = Picture::Raw {
            width: 20,
            height: 15,
            encoding: "mono8".into(),
            step: 20,
            data: data.clone(),
        };
        let compressed = Picture::Compressed {
            format: "jpeg".into(),
            data,
        };
        for original in [raw, compressed] {
            let (schema, head, data) = picture("c00", &original, 3_000_000_005);
            let message = Bytes::from([&head, data].concat());
            assert_eq!(
                read_picture(&schema.name, message.clone()).unwrap(),
                original
            );
            let (id, time) = match &original {
                Picture::Raw { .. } => {
                    let message = RawImage::decode(message).unwrap();
                    (message.frame_id, message.timestamp)
                }
                Picture::Compressed { .. } => {
                    let message = CompressedImage::decode(message).unwrap();
                    (message.frame_id, message.timestamp)
                }
            };
            assert_eq!((id.as_str(), time), ("c00", Some(timestamp(3_000_000_005))));
        }
    }
}
