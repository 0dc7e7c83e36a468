//! The pictures that a served camera shows: those of a recording's complete captures, in the form in which a GigE
//! Vision camera sends them. No camera is played here.

use crate::Error;
use bytes::Bytes;
use parking_lot::Mutex;
use scand_core::frame::{CameraId, Picture, Timestamp};
use scand_core::image::{RawPixels, rgb_from_file, rgb_from_raw, size_of_file};
use scand_core::recording::{ColorPart, MessageRef, Recording, Topic};
use std::sync::Arc;

/// The pictures that a rig serves to its cameras.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Shown {
    /// The captures one after the other, from this one on; after the last comes the first.
    CapturesFrom(usize),
    /// The empty rig.
    Background,
}

/// Rows of pixels without gaps.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Pixels {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Number of the format in the GenICam Pixel Format Naming Convention.
    pub code: u32,
    /// The rows.
    pub data: Bytes,
}

impl Pixels {
    /// Bytes of a pixel.
    pub(super) fn pixel_bytes(&self) -> usize {
        (self.code >> 16 & 0xff) as usize / 8
    }
}

const RGB8: u32 = 0x0218_0014;

/// Encodings that are served as they are. All others become `rgb8`: the simulator's format has no other colours, and a
/// picture that was compressed has no Bayer pattern to go back to.
const SERVED: [(&str, u32, usize); 6] = [
    ("bayer_grbg8", 0x0108_0008, 1),
    ("bayer_rggb8", 0x0108_0009, 1),
    ("bayer_gbrg8", 0x0108_000a, 1),
    ("bayer_bggr8", 0x0108_000b, 1),
    ("mono8", 0x0108_0001, 1),
    ("rgb8", RGB8, 3),
];

/// How early a frame may be stamped and still be of a trigger.
const TOLERANCE_NS: u64 = 5_000_000;

/// The complete captures of a recording: of each trigger its time, and where each camera's picture is.
pub(super) struct Captures {
    /// When each was triggered.
    pub times: Vec<Timestamp>,
    /// Of each camera the picture of each capture.
    pub cameras: Vec<(CameraId, Vec<MessageRef>)>,
}

impl Captures {
    /// Lists them. A trigger for which a colour camera has no picture is left out.
    ///
    /// # Errors
    /// If the recording cannot be read, or has no complete capture.
    pub(super) fn list(recording: &Recording) -> Result<Self, Error> {
        let ids: Vec<CameraId> = recording
            .topics()
            .filter_map(|topic| match topic {
                Topic::Color(id, ColorPart::Image) => Some(id.clone()),
                _ => None,
            })
            .collect();
        let mut listed = Self {
            times: Vec::new(),
            cameras: ids.into_iter().map(|id| (id, Vec::new())).collect(),
        };
        let triggers = recording.messages(&Topic::Trigger);
        for (i, trigger) in triggers.iter().enumerate() {
            let end = triggers
                .get(i + 1)
                .map_or(Timestamp(u64::MAX), MessageRef::log_time);
            listed.add(recording, trigger.log_time(), end);
        }
        if listed.times.is_empty() {
            return Err(Error::Unservable(format!(
                "{}: the recording has no trigger for which each colour camera has a picture",
                recording.path().display()
            )));
        }
        Ok(listed)
    }

    fn add(&mut self, recording: &Recording, trigger: Timestamp, end: Timestamp) {
        let before = Timestamp(trigger.0.saturating_sub(TOLERANCE_NS + 1));
        let first = |id: &CameraId| {
            let topic = Topic::Color(id.clone(), ColorPart::Image);
            let index = recording.messages_until(&topic, before).len();
            let message = recording.messages(&topic).get(index).copied();
            message.filter(|m| m.log_time() < end)
        };
        let found: Option<Vec<MessageRef>> = self.cameras.iter().map(|(id, _)| first(id)).collect();
        if let Some(found) = found.filter(|f| !f.is_empty()) {
            self.times.push(trigger);
            for ((_, messages), message) in self.cameras.iter_mut().zip(found) {
                messages.push(message);
            }
        }
    }
}

/// The pictures of one camera, read when they are shown.
pub(super) struct Album {
    recording: Arc<Recording>,
    id: CameraId,
    captures: Vec<MessageRef>,
    /// The last one that was shown, and which it was.
    last: Mutex<Option<(Option<usize>, Arc<Pixels>)>>,
}

impl Album {
    /// An album, and its first picture.
    ///
    /// # Errors
    /// If a picture cannot be read, or is not of the size and format of the first.
    pub(super) fn open(
        recording: Arc<Recording>,
        id: CameraId,
        captures: Vec<MessageRef>,
    ) -> Result<(Self, Arc<Pixels>), Error> {
        let album = Self {
            recording,
            id,
            captures,
            last: Mutex::new(None),
        };
        let first = album.picture(Some(0))?;
        for capture in 1..album.captures.len() {
            let (topic, message) = album.message(Some(capture))?;
            let (size, code) = form(&album.recording.picture(&topic, &message)?);
            if size != Some((first.width, first.height)) || code != first.code {
                return Err(album.unlike(capture, &first));
            }
        }
        Ok((album, first))
    }

    /// How many captures there are.
    pub(super) fn len(&self) -> usize {
        self.captures.len()
    }

    fn unlike(&self, capture: usize, first: &Pixels) -> Error {
        Error::Unservable(format!(
            "{}: camera {}: the picture of capture {capture} is not of {}x{} pixels and the format of the first",
            self.recording.path().display(),
            self.id,
            first.width,
            first.height
        ))
    }

    /// Where the picture of a capture is, or of the empty rig.
    fn message(&self, capture: Option<usize>) -> Result<(Topic, MessageRef), Error> {
        let part = match capture {
            Some(_) => ColorPart::Image,
            None => ColorPart::Background,
        };
        let topic = Topic::Color(self.id.clone(), part);
        let message = match capture {
            Some(i) => self.captures.get(i).copied(),
            None => self.recording.messages(&topic).last().copied(),
        };
        let message = message.ok_or_else(|| {
            let path = self.recording.path().display();
            Error::Unservable(format!(
                "{path}: camera {}: the recording has no message on {topic}",
                self.id
            ))
        })?;
        Ok((topic, message))
    }

    /// The picture of a capture, or of the empty rig.
    ///
    /// # Errors
    /// If it cannot be read or decoded.
    pub(super) fn picture(&self, capture: Option<usize>) -> Result<Arc<Pixels>, Error> {
        let mut last = self.last.lock();
        if let Some((_, pixels)) = last.as_ref().filter(|(which, _)| *which == capture) {
            return Ok(pixels.clone());
        }
        let (topic, message) = self.message(capture)?;
        let picture = self.recording.picture(&topic, &message)?;
        let pixels = pixels(&picture).map_err(|e| {
            let path = self.recording.path().display();
            Error::Unservable(format!("{path}: {topic}: {e}"))
        })?;
        let pixels = Arc::new(pixels);
        *last = Some((capture, pixels.clone()));
        Ok(pixels)
    }
}

/// Size and format in which a picture is served, without decoding it.
fn form(picture: &Picture) -> (Option<(u32, u32)>, u32) {
    match picture {
        Picture::Raw {
            width,
            height,
            encoding,
            ..
        } => {
            let served = SERVED.iter().find(|(name, ..)| name == encoding);
            (Some((*width, *height)), served.map_or(RGB8, |s| s.1))
        }
        Picture::Compressed { format, data } => {
            let size = size_of_file(format, data).ok();
            (size.map(|(w, h)| (w as u32, h as u32)), RGB8)
        }
    }
}

fn pixels(picture: &Picture) -> Result<Pixels, scand_core::image::DecodeError> {
    let rgb = match picture {
        Picture::Raw {
            width,
            height,
            encoding,
            data,
            ..
        } => {
            let raw = RawPixels::from(picture);
            let (columns, rows, step) = (raw.width, raw.height, raw.step);
            // Decoding also checks that the data is there.
            let rgb = rgb_from_raw(&raw, (columns, rows))?;
            if let Some(&(_, code, bytes)) = SERVED.iter().find(|(name, ..)| name == encoding) {
                return Ok(Pixels {
                    width: *width,
                    height: *height,
                    code,
                    data: packed(data, columns * bytes, step, rows),
                });
            }
            rgb
        }
        Picture::Compressed { format, data } => {
            rgb_from_file(format, data, size_of_file(format, data)?)?
        }
    };
    Ok(Pixels {
        width: rgb.width() as u32,
        height: rgb.height() as u32,
        code: RGB8,
        data: rgb.pixels().as_flattened().to_vec().into(),
    })
}

/// Rows without the gaps between them.
fn packed(data: &Bytes, row: usize, step: usize, rows: usize) -> Bytes {
    if step == row {
        return data.slice(..row * rows);
    }
    let rows = (0..rows).flat_map(|y| &data[y * step..y * step + row]);
    rows.copied().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_camera_can_send_is_served_as_it_is_and_the_rest_as_colours() {
        let raw = |encoding: &str, step, data: &'static [u8]| Picture::Raw {
            width: 2,
            height: 2,
            encoding: encoding.into(),
            step,
            data: Bytes::from_static(data),
        };
        let bayer = pixels(&raw("bayer_gbrg8", 3, &[1, 2, 0, 3, 4])).unwrap();
        assert_eq!(
            (bayer.code, &bayer.data[..]),
            (0x0108_000a, &[1, 2, 3, 4][..])
        );
        let swapped = pixels(&raw("bgr8", 6, &[1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12])).unwrap();
        assert_eq!(swapped.code, RGB8);
        assert_eq!(swapped.data[..6], [3, 2, 1, 6, 5, 4]);
        assert!(pixels(&raw("bayer_gbrg8", 2, &[1, 2, 3])).is_err());
    }
}
