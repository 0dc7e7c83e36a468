//! The colour pictures of a capture, as its recording has them.

use super::picture_limit::checked;
use crate::frame::{CameraId, Picture, Transfer};
use crate::image::{
    RawPixels, RgbImage, encode_linear_as_srgb, rgb_from_file, rgb_from_raw, size_of_file,
};
use crate::recording::{ColorPart, MessageRef, Recording, Topic};
use std::collections::BTreeMap;

/// Most cameras of a capture that are looked at.
const MOST_CAMERAS: usize = 64;

/// The first picture of each colour camera in a capture, by what the rig recorded when the capture was complete or had
/// failed. Empty if the recording has no such capture, or does not list its frames.
pub(super) fn pictures_of(recording: &Recording, capture: &str) -> BTreeMap<CameraId, MessageRef> {
    let records = recording.messages(&Topic::Capture).iter().rev();
    let mut records = records.filter_map(|message| recording.capture_record(message).ok());
    let record = records.find(|record| record.id == capture);
    let cameras = record.into_iter().flat_map(|record| record.cameras);
    let found = cameras.filter_map(|(name, camera)| {
        let id = CameraId::new(&name).ok()?;
        let times = camera.timestamps?;
        let topic = Topic::Color(id.clone(), ColorPart::Image);
        let message = *recording.messages_at(&topic, *times.first()?).last()?;
        Some((id, message))
    });
    found.take(MOST_CAMERAS).collect()
}

/// A colour camera's picture, decoded, as a screen shows it.
///
/// # Errors
/// If it cannot be read or decoded, or is larger than any camera's.
pub(super) fn decoded(
    recording: &Recording,
    camera: &CameraId,
    message: &MessageRef,
) -> anyhow::Result<RgbImage> {
    let topic = Topic::Color(camera.clone(), ColorPart::Image);
    let picture = recording.picture(&topic, message)?;
    let mut pixels = match &picture {
        Picture::Raw { width, height, .. } => {
            let size = checked((*width as usize, *height as usize))?;
            rgb_from_raw(&RawPixels::from(&picture), size)?
        }
        Picture::Compressed { format, data } => {
            let size = checked(size_of_file(format, data)?)?;
            rgb_from_file(format, data, size)?
        }
    };
    let settings = Topic::Color(camera.clone(), ColorPart::Settings);
    let newest = recording.messages_until(&settings, message.log_time());
    let newest = newest
        .last()
        .and_then(|message| recording.settings(&settings, message).ok());
    if newest.is_some_and(|settings| settings.transfer == Transfer::Linear) {
        encode_linear_as_srgb(&mut pixels);
    }
    Ok(pixels)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::frame::{CameraSettings, Frame, Stream, Timestamp};
    use crate::output::encode_jpeg;
    use crate::recording::{CameraInCapture, CaptureOutcome, CaptureRecord, Compression, Writer};
    use std::path::Path;

    fn id(name: &str) -> CameraId {
        CameraId::new(name).unwrap()
    }

    /// A recording of two captures, `a-1` and `a-2`: in each, `c00` gave a JPEG of 640x480 pixels whose grey tells the
    /// captures apart, `c01` linear raw rows of 4x2 pixels, and `c02` something broken.
    pub(in crate::commands) fn record(path: &Path) {
        let mut writer = Writer::create(path, "test", Compression::None).unwrap();
        let linear = CameraSettings {
            transfer: Transfer::Linear,
            ..CameraSettings::default()
        };
        writer.settings(&id("c01"), &linear, Timestamp(1)).unwrap();
        for (name, at, grey) in [("a-1", 1000, 40), ("a-2", 2000, 200)] {
            let file = encode_jpeg(&RgbImage::filled(640, 480, [grey; 3]), 90).unwrap();
            let compressed = |data: Vec<u8>| Picture::Compressed {
                format: "jpeg".into(),
                data: data.into(),
            };
            let raw = Picture::Raw {
                width: 4,
                height: 2,
                encoding: "mono8".into(),
                step: 4,
                data: vec![55_u8; 8].into(),
            };
            let pictures = [
                ("c00", compressed(file)),
                ("c01", raw),
                ("c02", compressed(vec![0xff, 0xd8, 1, 2, 3])),
            ];
            let mut cameras = BTreeMap::new();
            for (n, (camera, picture)) in (0..).zip(pictures) {
                let timestamp = Timestamp(at + n);
                let frame = Frame {
                    camera: id(camera),
                    stream: Stream::Color,
                    timestamp,
                    picture,
                };
                writer.frame(&frame).unwrap();
                let given = CameraInCapture {
                    timestamps: Some(vec![timestamp]),
                    ..CameraInCapture::default()
                };
                cameras.insert(camera.to_owned(), given);
            }
            let record = CaptureRecord {
                id: name.into(),
                outcome: CaptureOutcome::Complete,
                reason: None,
                skew_ns: None,
                cameras,
            };
            writer.capture(&record, Timestamp(at + 10)).unwrap();
        }
        writer.finish().unwrap();
    }

    #[test]
    fn pictures_are_those_of_the_capture_and_linear_ones_are_made_brighter() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        record(&path);
        let recording = Recording::open(&path).unwrap();
        for (capture, grey) in [("a-1", 40), ("a-2", 200)] {
            let found = pictures_of(&recording, capture);
            let names: Vec<_> = found.keys().map(CameraId::as_str).collect();
            assert_eq!(names, ["c00", "c01", "c02"]);
            let picture = |name: &str| decoded(&recording, &id(name), &found[&id(name)]);
            let first = picture("c00").unwrap();
            assert_eq!((first.width(), first.height()), (640, 480));
            let [red, ..] = first.row(100)[100];
            assert!(red.abs_diff(grey) < 4, "{capture}: {red}");
            let linear = picture("c01").unwrap();
            assert_eq!(linear.width(), 4);
            assert!(linear.row(0)[0][0] > 100, "{:?}", linear.row(0)[0]);
            picture("c02").unwrap_err();
        }
        assert!(pictures_of(&recording, "a-3").is_empty());
    }
}
