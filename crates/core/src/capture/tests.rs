//! Tests loading scenes from recordings: what the format allows, and what it does not.

use super::*;
use crate::frame::{CameraSettings, CaptureId, Frame, Picture, Stream, Transfer};
use crate::image::Grid;
use crate::reconstruct::{Scene, SilhouetteSource};
use crate::recording::testing::*;
use crate::recording::{CameraInCapture, CaptureOutcome, CaptureRecord, Compression, Writer};
use crate::sync;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

/// A recording that a test writes as it likes.
struct Place {
    _folder: tempfile::TempDir,
    path: PathBuf,
}

fn write(content: impl FnOnce(&mut Writer, &Rig)) -> Place {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("session.mcap");
    let mut writer = Writer::create(&path, "scand test", Compression::None).unwrap();
    content(&mut writer, &Rig::new());
    writer.finish().unwrap();
    Place {
        _folder: folder,
        path,
    }
}

impl Place {
    fn open(&self) -> CaptureSession {
        CaptureSession::open(&self.path, &sync::Parameters::default()).unwrap()
    }

    fn load(&self, id: &str) -> Result<(Scene, CaptureFacts), Error> {
        self.open().load(&CaptureId::new(id).unwrap())
    }

    fn error(&self, id: &str) -> String {
        let error = self.load(id).unwrap_err().to_string();
        assert!(error.contains("session.mcap"), "{error}");
        error
    }
}

fn background(scene: &Scene, camera: usize) -> Arc<crate::image::RgbImage> {
    match &scene.colors[camera].silhouette {
        SilhouetteSource::Background(plate) => plate.clone(),
        SilhouetteSource::Mask(_) => panic!("no mask was recorded"),
    }
}

#[test]
fn a_capture_becomes_a_scene() {
    let place = write(|writer, rig| {
        rig.write_to(writer);
        rig.write_capture(writer, "cup", 100, 12);
    });
    let (scene, facts) = place.load("cup").unwrap();
    let rig = Rig::new();
    for (view, camera) in scene.colors.iter().zip(&rig.colors) {
        assert_eq!(view.camera.id, camera.id);
        assert_eq!(view.camera.intrinsics, camera.intrinsics);
        assert_eq!((view.image.width(), view.image.height()), (8, 6));
    }
    assert_eq!(scene.volume, rig.volume);
    let Picture::Raw { data, .. } = raw(8, 6, "rgb8", 3, 1) else {
        panic!("it is raw")
    };
    let plate = background(&scene, 0);
    assert_eq!(plate.pixels().as_flattened(), &data[..]);
    let depth = &scene.depths[0];
    assert_eq!(depth.camera.response, rig.depth.response);
    assert_eq!(depth.frames.len(), 12);
    assert_eq!(
        depth.frames[0].readings.pixels()[0],
        u16::from_le_bytes([100, 107])
    );
    assert_eq!(facts.subject.as_deref(), Some("17"));
    assert_eq!((facts.skew_ns, facts.depths[0].color_frames), (MS, 12));
    assert_eq!(facts.colors[1].delay_ns, 11 * MS as i64);
    let age_ns = 99 * MS;
    assert_eq!(
        facts.colors[0].silhouette,
        Silhouette::Background { age_ns }
    );
    assert_eq!((facts.warnings.len(), facts.left_out.len()), (0, 0));
}

#[test]
fn captures_of_a_session_share_their_backgrounds_and_fail_alone() {
    let place = write(|writer, rig| {
        rig.write_to(writer);
        rig.write_capture(writer, "a", 100, 12);
        rig.write_capture(writer, "b", 3000, 4);
        rig.write_capture(writer, "c", 6000, 12);
    });
    let session = place.open();
    let load = |id: &str| session.load(&CaptureId::new(id).unwrap());
    let (a, _) = load("a").unwrap();
    let (c, _) = load("c").unwrap();
    assert!(Arc::ptr_eq(&background(&a, 0), &background(&c, 0)));
    let error = load("b").unwrap_err().to_string();
    assert!(
        error.contains("capture b failed: depth camera kinect gave 4 frames from"),
        "{error}"
    );
    let error = load("d").unwrap_err().to_string();
    assert!(error.contains("no capture d, only a, b, c"), "{error}");
    let failures: Vec<bool> = session
        .captures()
        .iter()
        .map(|c| c.failure.is_some())
        .collect();
    assert_eq!(failures, [false, true, false]);
}

#[test]
fn the_newest_of_everything_at_or_before_the_trigger_counts() {
    let mut later = Rig::new();
    later.volume.max.x = 0.05;
    later.depth.response.uncertainty = 0.004;
    let colors = [camera("c00", 8, 6), camera("c01", 8, 6)];
    let place = write(|writer, rig| {
        // The file's order is not that of time: what is newest is written first.
        writer.volume(&later.volume, at(100)).unwrap();
        writer.volume(&rig.volume, at(101)).unwrap();
        let kinect = &rig.depth.camera.id;
        writer
            .response(kinect, &later.depth.response, at(50))
            .unwrap();
        let moved = colors[1].rig_from_camera;
        writer.pose(&colors[0].id, &moved, at(90)).unwrap();
        rig.write_to(writer);
        rig.write_capture(writer, "cup", 100, 12);
        writer
            .pose(&colors[0].id, &moved.inverse(), at(101))
            .unwrap();
        let plate = raw(8, 6, "mono8", 1, 77);
        writer.background(&colors[0].id, &plate, at(100)).unwrap();
        writer.background(&colors[1].id, &plate, at(101)).unwrap();
    });
    let (scene, facts) = place.load("cup").unwrap();
    assert_eq!(scene.volume.max.x, 0.05);
    assert_eq!(scene.depths[0].camera.response.uncertainty, 0.004);
    let pose = scene.colors[0].camera.rig_from_camera;
    let expected = colors[1].rig_from_camera;
    assert!((pose.translation.vector - expected.translation.vector).norm() < 1e-12);
    assert_eq!(background(&scene, 0)[(0, 0)], [77; 3]);
    assert_ne!(background(&scene, 1)[(0, 0)], [77; 3]);
    assert_eq!(
        facts.colors[0].silhouette,
        Silhouette::Background { age_ns: 0 }
    );
}

#[test]
fn a_mask_of_the_same_timestamp_is_used_as_it_is() {
    let mask = Grid::from_fn(8, 6, |x, y| (30 * x + y) as u8);
    let place = write(|writer, rig| {
        rig.write_to(writer);
        rig.write_capture(writer, "cup", 100, 12);
        writer.mask(&camera_id("c00"), &mask, at(110)).unwrap();
        writer.mask(&camera_id("c01"), &mask, at(110)).unwrap();
    });
    let (scene, facts) = place.load("cup").unwrap();
    let SilhouetteSource::Mask(read) = &scene.colors[0].silhouette else {
        panic!("a mask was recorded")
    };
    assert_eq!(*read, mask);
    // That of c01 is a millisecond off its frame.
    assert_ne!(facts.colors[1].silhouette, Silhouette::Mask);
}

#[test]
fn what_is_ignored_comes_with_the_frame_of_its_timestamp_and_is_part_of_the_digest() {
    let ignored = |value: u8| Grid::from_fn(8, 6, |x, _| if x < 3 { value } else { 0 });
    let loaded = |value: Option<u8>| {
        let place = write(|writer, rig| {
            rig.write_to(writer);
            rig.write_capture(writer, "cup", 100, 12);
            if let Some(value) = value {
                let (first, second) = (camera_id("c00"), camera_id("c01"));
                writer.ignore(&first, &ignored(value), at(110)).unwrap();
                writer.ignore(&second, &ignored(value), at(110)).unwrap();
            }
        });
        place.load("cup").unwrap().0
    };
    let scene = loaded(Some(200));
    assert_eq!(scene.colors[0].ignored, Some(ignored(200)));
    assert!(matches!(
        scene.colors[0].silhouette,
        SilhouetteSource::Background(_)
    ));
    // That of c01 is a millisecond off its frame.
    assert_eq!(scene.colors[1].ignored, None);
    let plain = loaded(None);
    assert_eq!(plain.colors[0].ignored, None);
    let digests = [&scene, &loaded(Some(201)), &plain].map(input_digest);
    assert!(digests[0] != digests[1] && digests[1] != digests[2] && digests[0] != digests[2]);
}

#[test]
fn linear_pictures_are_encoded() {
    let settings = CameraSettings {
        transfer: Transfer::Linear,
        ..CameraSettings::default()
    };
    let place = write(|writer, rig| {
        rig.write_to(writer);
        writer
            .settings(&camera_id("c01"), &settings, at(5))
            .unwrap();
        rig.write_capture(writer, "cup", 100, 12);
    });
    let (scene, _) = place.load("cup").unwrap();
    let (plain, linear) = (background(&scene, 0), background(&scene, 1));
    assert_eq!(plain[(2, 0)], [43, 50, 57]);
    assert_eq!(linear[(2, 0)], [114, 122, 130]);
}

#[test]
fn cameras_without_images_or_calibration_are_left_out() {
    let place = write(|writer, rig| {
        rig.write_to(writer);
        writer.color_camera(&camera("c02", 8, 6), at(0)).unwrap();
        let frame = frame(camera_id("c03"), Stream::Color, 110);
        writer.frame(&frame).unwrap();
        rig.write_capture(writer, "cup", 100, 12);
    });
    let (scene, facts) = place.load("cup").unwrap();
    assert_eq!(scene.colors.len(), 2);
    let reasons: Vec<&str> = facts.left_out.iter().map(|l| l.reason.as_str()).collect();
    assert_eq!(
        reasons,
        [
            "colour camera c02 has a calibration and no images",
            "colour camera c03 has images and no calibration"
        ]
    );
}

#[test]
fn depth_without_colour_has_no_colour_pictures() {
    let place = write(|writer, rig| {
        rig.write_to(writer);
        rig.write_capture(writer, "cup", 100, 0);
        for i in 0..12 {
            let id = rig.depth.camera.id.clone();
            writer
                .frame(&frame(id, Stream::Depth, 100 + 33 * i))
                .unwrap();
        }
    });
    let (mut scene, facts) = place.load("cup").unwrap();
    let digest = input_digest(&scene);
    for frame in &mut scene.depths[0].frames {
        // In the digest it counts as a grey picture.
        let grey = Arc::new(Grid::filled(6, 4, [128; 3]));
        assert!(frame.color.replace(grey).is_none());
    }
    assert_eq!(input_digest(&scene), digest);
    assert!(
        facts.warnings[0].contains("kinect has no colour"),
        "{:?}",
        facts.warnings
    );
}

#[test]
fn rarer_colour_is_shared() {
    let place = write(|writer, rig| {
        rig.write_to(writer);
        rig.write_capture(writer, "cup", 100, 0);
        let id = || rig.depth.camera.id.clone();
        for i in 0..12 {
            writer
                .frame(&frame(id(), Stream::Depth, 100 + 33 * i))
                .unwrap();
        }
        for ms in [100, 300] {
            writer.frame(&frame(id(), Stream::DepthColor, ms)).unwrap();
        }
    });
    let (scene, facts) = place.load("cup").unwrap();
    let frames = &scene.depths[0].frames;
    let share = |a: usize, b: usize| {
        let [a, b] = [a, b].map(|i| frames[i].color.as_ref().unwrap());
        Arc::ptr_eq(a, b)
    };
    assert!(share(0, 3), "199 ms");
    assert!(share(4, 11), "232 and 463 ms");
    assert!(!share(3, 4));
    assert_eq!(facts.depths[0].color_frames, 2);
    assert_eq!(facts.depths[0].largest_color_lag_ns, 163 * MS);
}

#[test]
fn what_is_missing_is_named() {
    let place = write(|writer, rig| {
        rig.write_to(writer);
    });
    let error = CaptureSession::open(&place.path, &sync::Parameters::default());
    let error = error.unwrap_err().to_string();
    assert!(error.contains("no /trigger"), "{error}");

    let without = |leave_out: &str| {
        write(|writer, rig| {
            for camera in &rig.colors {
                writer
                    .color_camera(camera, at(if leave_out == "early" { 200 } else { 0 }))
                    .unwrap();
                if leave_out != "background" {
                    let plate = raw(8, 6, "rgb8", 3, 1);
                    writer.background(&camera.id, &plate, at(1)).unwrap();
                }
            }
            if leave_out != "volume" {
                writer.volume(&rig.volume, at(0)).unwrap();
            }
            rig.write_capture(writer, "cup", 100, 0);
        })
    };
    assert!(without("nothing").load("cup").is_ok());
    let error = without("volume").error("cup");
    assert!(
        error.contains("/volume has no message at or before the trigger"),
        "{error}"
    );
    let error = without("background").error("cup");
    assert!(error.contains("c00 has neither a mask"), "{error}");
    let error = without("early").error("cup");
    assert!(
        error.contains("/color/c00/calibration") && error.contains("its first is at"),
        "{error}"
    );
}

#[test]
fn a_picture_of_another_size_or_encoding_is_named() {
    let with = |picture: Picture| {
        write(|writer, rig| {
            rig.write_to(writer);
            writer.trigger(&trigger("cup", 100)).unwrap();
            for camera in &rig.colors {
                let frame = Frame {
                    picture: picture.clone(),
                    ..frame(camera.id.clone(), Stream::Color, 100)
                };
                writer.frame(&frame).unwrap();
            }
            let id = rig.depth.camera.id.clone();
            for i in 0..12 {
                writer
                    .frame(&frame(id.clone(), Stream::Depth, 100 + i))
                    .unwrap();
            }
        })
    };
    assert!(with(raw(8, 6, "yuyv", 2, 0)).load("cup").is_ok());
    let error = with(raw(8, 5, "rgb8", 3, 0)).error("cup");
    assert!(
        error.contains("/color/c00/image at 2025-10-09T08:53:20.1"),
        "{error}"
    );
    assert!(error.contains("size is 8x5, expected 8x6"), "{error}");
    let error = with(raw(8, 6, "rgb10", 3, 0)).error("cup");
    assert!(error.contains("\"rgb10\", expected bayer_rggb8"), "{error}");
    let jpeg = Picture::Compressed {
        format: "jpeg".into(),
        data: b"no jpeg".as_slice().into(),
    };
    assert!(
        with(jpeg)
            .error("cup")
            .contains("the jpeg data is broken: ")
    );
}

#[test]
fn poses_in_millimetres_are_told_as_such() {
    let mut in_millimetres = Rig::new();
    let translation = &mut in_millimetres.colors[0].rig_from_camera.translation.vector;
    *translation = translation.normalize() * 450.0;
    let place = write(|writer, rig| {
        in_millimetres.write_to(writer);
        rig.write_capture(writer, "cup", 100, 12);
    });
    let error = place.error("cup");
    assert!(
        error.contains("pose of camera c00: it is 450 m from the rig's origin"),
        "{error}"
    );
    assert!(error.contains("looks like millimetres"), "{error}");
}

#[test]
fn poses_must_be_the_rigs() {
    let mut bad = Rig::new();
    bad.colors[0].rig_from_camera.translation.vector.x = f64::NAN;
    let place = write(|writer, rig| {
        bad.write_to(writer);
        rig.write_capture(writer, "cup", 100, 12);
    });
    let error = place.error("cup");
    assert!(
        error.contains("pose of camera c00: translation is [NaN"),
        "{error}"
    );
}

#[test]
fn what_the_rig_wrote_of_a_capture_counts() {
    let record = |id: &str, outcome, times: Option<u64>| CaptureRecord {
        id: id.into(),
        outcome,
        reason: Some("the lamp went out".into()),
        skew_ns: None,
        cameras: BTreeMap::from([(
            "c00".to_owned(),
            CameraInCapture {
                timestamps: times.map(|ms| vec![at(ms)]),
                lost: None,
                remarks: Vec::new(),
            },
        )]),
    };
    let place = write(|writer, rig| {
        rig.write_to(writer);
        rig.write_capture(writer, "a", 100, 12);
        writer
            .frame(&frame(camera_id("c00"), Stream::Color, 150))
            .unwrap();
        writer
            .capture(&record("a", CaptureOutcome::Complete, Some(150)), at(900))
            .unwrap();
        rig.write_capture(writer, "b", 3000, 12);
        writer
            .capture(&record("b", CaptureOutcome::Failed, None), at(3900))
            .unwrap();
        // A trigger that was lost: its record stands for it.
        for camera in &rig.colors {
            writer
                .frame(&frame(camera.id.clone(), Stream::Color, 6000))
                .unwrap();
        }
        for i in 0..12 {
            let id = rig.depth.camera.id.clone();
            writer
                .frame(&frame(id, Stream::Depth, 6000 + 33 * i))
                .unwrap();
        }
        writer
            .capture(&record("c", CaptureOutcome::Complete, Some(6000)), at(6900))
            .unwrap();
        // The same id again.
        writer.trigger(&trigger("a", 8000)).unwrap();
    });
    let (_, facts) = place.load("a").unwrap();
    assert_eq!(facts.colors[0].delay_ns, 50 * MS as i64);
    assert!(
        place
            .error("b")
            .contains("it failed at the rig: the lamp went out")
    );
    let session = place.open();
    assert_eq!(session.captures().len(), 3);
    assert!(place.load("c").is_ok());
    assert_eq!(session.warnings().len(), 2, "{:?}", session.warnings());
}

#[test]
fn frames_that_are_listed_are_the_captures_own_however_old_they_are() {
    let listed = |times: &[u64]| CameraInCapture {
        timestamps: Some(times.iter().map(|ms| at(*ms)).collect()),
        lost: None,
        remarks: Vec::new(),
    };
    let depth: Vec<u64> = (0..12).map(|i| 3100 + 33 * i).collect();
    let cameras = [("c00", listed(&[905])), ("kinect", listed(&depth))];
    let record = CaptureRecord {
        id: "b".into(),
        outcome: CaptureOutcome::Complete,
        reason: None,
        skew_ns: None,
        cameras: cameras.map(|(id, camera)| (id.to_owned(), camera)).into(),
    };
    let place = write(|writer, rig| {
        rig.write_to(writer);
        rig.write_capture(writer, "a", 900, 12);
        // After the trigger of a, before those of its frames that the rule takes.
        let early = frame(camera_id("c00"), Stream::Color, 905);
        writer.frame(&early).unwrap();
        for ms in depth {
            for stream in [Stream::Depth, Stream::DepthColor] {
                let id = rig.depth.camera.id.clone();
                writer.frame(&frame(id, stream, ms)).unwrap();
            }
        }
        rig.write_capture(writer, "b", 7000, 0);
        writer.capture(&record, at(7900)).unwrap();
    });
    let (_, facts) = place.load("a").unwrap();
    assert_eq!(facts.colors[0].delay_ns, 10 * MS as i64);
    let (_, facts) = place.load("b").unwrap();
    let delays = [0, 1].map(|i| facts.colors[i].delay_ns);
    assert_eq!(delays, [-6095 * MS as i64, 11 * MS as i64]);
    let depth = &facts.depths[0];
    assert_eq!((depth.frames, depth.color_frames), (12, 12));
    assert_eq!(depth.largest_color_lag_ns, 0);
    assert_eq!(place.open().captures().len(), 2);
}

#[test]
fn a_broken_picture_costs_its_own_capture() {
    let place = write(|writer, rig| {
        rig.write_to(writer);
        for (id, ms) in [("a", 100), ("b", 3000)] {
            rig.write_capture(writer, id, ms, 12);
            writer.sync().unwrap();
        }
    });
    let mut bytes = std::fs::read(&place.path).unwrap();
    let pixels: Vec<u8> = match frame(camera_id("c01"), Stream::Color, 3011).picture {
        Picture::Raw { data, .. } => data.to_vec(),
        Picture::Compressed { .. } => panic!("it is raw"),
    };
    let found = bytes.windows(pixels.len()).rposition(|w| w == pixels);
    bytes[found.unwrap() + 20] ^= 4;
    std::fs::write(&place.path, bytes).unwrap();
    assert!(place.load("a").is_ok());
    assert!(place.error("b").contains("CRC"));
}

#[test]
fn a_capture_in_a_recording_of_its_own_is_the_same_scene_and_the_same_facts() {
    let place = write(|writer, rig| {
        rig.write_to(writer);
        let frame = frame(camera_id("c03"), Stream::Color, 110);
        writer.frame(&frame).unwrap();
        rig.write_capture(writer, "a", 100, 12);
        rig.write_capture(writer, "b", 3000, 4);
        rig.write_capture(writer, "c", 6000, 12);
    });
    let session = place.open();
    let parameters = sync::Parameters::default();
    let small = |id: &str, name: &str| {
        let path = place.path.with_file_name(name);
        let id = CaptureId::new(id).unwrap();
        let extract = session.extract(&id, &path, "scand test", &parameters);
        extract.map(|extract| (path, extract.content_sha256))
    };
    for id in ["a", "c"] {
        let (path, content) = small(id, &format!("{id}.mcap")).unwrap();
        let own = CaptureSession::open(&path, &parameters).unwrap();
        let id = CaptureId::new(id).unwrap();
        let (scene, facts) = session.load(&id).unwrap();
        let (own_scene, own_facts) = own.load(&id).unwrap();
        assert_eq!(input_digest(&own_scene), input_digest(&scene));
        assert_eq!(format!("{own_facts:?}"), format!("{facts:?}"));
        assert_eq!(facts.left_out.len(), 1);
        let recording = own.recording();
        assert_eq!((own.captures().len(), recording.is_packed()), (1, true));
        // The digest is that of what the file holds, whichever program computes it, and tells captures apart.
        assert_eq!(recording.content_sha256().unwrap(), content);
        let again = small(id.as_str(), &format!("{id}-again.mcap")).unwrap();
        assert_eq!(again.1, content);
        assert_ne!(
            small("a", &format!("{id}-a.mcap")).unwrap().1 == content,
            id.as_str() != "a"
        );
    }
    let failed = small("b", "b.mcap").unwrap_err().to_string();
    assert!(failed.contains("capture b failed"), "{failed}");
    // Where it goes on without its depth camera, it is told why it cannot travel, and nothing is written.
    let without_missing = sync::Parameters {
        go_on_without_missing: true,
        ..parameters
    };
    let session = CaptureSession::open(&place.path, &without_missing).unwrap();
    let (id, path) = (CaptureId::new("b").unwrap(), place.path.with_file_name("d"));
    assert!(session.load(&id).is_ok());
    let lacking = session.extract(&id, &path, "scand test", &without_missing);
    let lacking = lacking.unwrap_err().to_string();
    assert!(
        lacking.contains("lacks a camera: depth camera kinect gave 4 frames"),
        "{lacking}"
    );
    assert!(!path.exists());
}
