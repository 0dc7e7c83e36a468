//! Tests that what is written is read back.

use super::testing::*;
use super::*;
use crate::frame::{CameraSettings, Stream, Timestamp, Transfer};
use crate::image::Grid;
use std::collections::BTreeMap;
use std::path::Path;

fn folder() -> tempfile::TempDir {
    tempfile::tempdir().unwrap()
}

fn only(recording: &Recording, topic: &Topic) -> MessageRef {
    let messages = recording.messages(topic);
    assert_eq!(messages.len(), 1, "{topic}");
    messages[0]
}

#[test]
fn everything_written_is_read_back() {
    for compression in [Compression::None, Compression::Zstd] {
        let folder = folder();
        let path = folder.path().join("a.mcap");
        let mut writer = Writer::create(&path, "scand 1.2.3", compression).unwrap();
        let rig = Rig::new();
        let pairs = BTreeMap::from([("operator".to_owned(), "käte".to_owned())]);
        writer.metadata("session", &pairs).unwrap();
        writer
            .attach("rig.toml", "application/toml", at(0), b"a = 1\n")
            .unwrap();
        rig.write_to(&mut writer);
        let settings = CameraSettings {
            transfer: Transfer::Linear,
            exposure: Some(0.01),
            gain_db: Some(3.5),
            white_balance: Some([1.5, 1.0, 2.25]),
            trigger: Some("hardware".into()),
        };
        let c00 = camera_id("c00");
        writer.settings(&c00, &settings, at(2)).unwrap();
        rig.write_capture(&mut writer, "cup-1", 100, 3);
        let mask = Grid::from_fn(8, 6, |x, y| (x * 30 + y) as u8);
        writer.mask(&c00, &mask, at(110)).unwrap();
        let record = CaptureRecord {
            id: "cup-1".into(),
            outcome: CaptureOutcome::Complete,
            reason: None,
            skew_ns: Some(u64::MAX),
            cameras: BTreeMap::from([(
                "c00".to_owned(),
                CameraInCapture {
                    timestamps: Some(vec![at(110)]),
                    lost: None,
                    remarks: Vec::new(),
                },
            )]),
        };
        writer.capture(&record, at(2000)).unwrap();
        let note = Note {
            capture: "cup-1".into(),
            kind: "accept".into(),
            text: "schön".into(),
            author: None,
        };
        writer.note(&note, at(3000)).unwrap();
        assert!(!path.exists(), "not under its name before it is complete");
        writer.finish().unwrap();

        let recording = Recording::open(&path).unwrap();
        assert_eq!(recording.damage(), []);
        assert_eq!(recording.verify().unwrap(), []);
        assert_eq!(recording.written_by(), ("scand", "scand 1.2.3"));
        let names: Vec<_> = recording
            .metadata()
            .iter()
            .map(|(n, _)| n.as_str())
            .collect();
        assert_eq!(names, ["scand", "session"]);
        assert_eq!(recording.metadata()[1].1, pairs);
        let attachment = &recording.attachments()[0];
        assert_eq!(attachment.name, "rig.toml");
        assert_eq!(recording.attachment(attachment).unwrap(), b"a = 1\n");

        for camera in &rig.colors {
            let topic = Topic::Color(camera.id.clone(), ColorPart::Calibration);
            let lens = recording.intrinsics(&topic, &only(&recording, &topic));
            assert_eq!(lens.unwrap(), camera.intrinsics);
            let topic = Topic::Color(camera.id.clone(), ColorPart::Background);
            let plate = recording.picture(&topic, &only(&recording, &topic));
            assert_eq!(plate.unwrap(), raw(8, 6, "rgb8", 3, 1));
        }
        let kinect = rig.depth.camera.id.clone();
        let topic = Topic::Depth(kinect.clone(), DepthPart::Response);
        let response = recording.response(&topic, &only(&recording, &topic));
        assert_eq!(response.unwrap(), rig.depth.response);
        let volume = recording.volume(&only(&recording, &Topic::Volume));
        assert_eq!(volume.unwrap(), rig.volume);
        let poses: Vec<Pose> = recording
            .messages(&Topic::Tf)
            .iter()
            .flat_map(|m| recording.poses(m).unwrap())
            .collect();
        assert_eq!(poses.len(), 3);
        let pose = poses.iter().find(|p| p.child == "kinect").unwrap();
        assert_eq!(pose.parent, "rig");
        let back = crate::calibration::Camera::pose(pose.translation, pose.rotation_xyzw.unwrap());
        let difference = back.unwrap().inverse() * rig.depth.camera.rig_from_camera;
        assert!(difference.translation.vector.norm() < 1e-12 && difference.rotation.angle() < 1e-7);
        let topic = Topic::Color(c00.clone(), ColorPart::Settings);
        let read = recording.settings(&topic, &only(&recording, &topic));
        assert_eq!(read.unwrap(), settings);
        let read = recording.trigger(&only(&recording, &Topic::Trigger));
        assert_eq!(read.unwrap(), trigger("cup-1", 100));
        let read = recording.capture_record(&only(&recording, &Topic::Capture));
        assert_eq!(read.unwrap(), record);
        let read = recording.note(&only(&recording, &Topic::Note));
        assert_eq!(read.unwrap(), note);
        let topic = Topic::Depth(kinect.clone(), DepthPart::Image);
        for (i, message) in recording.messages(&topic).iter().enumerate() {
            let expected = frame(kinect.clone(), Stream::Depth, 100 + 33 * i as u64);
            assert_eq!(message.log_time(), expected.timestamp);
            assert_eq!(
                recording.picture(&topic, message).unwrap(),
                expected.picture
            );
        }
    }
}

#[test]
fn the_same_content_is_the_same_bytes() {
    let folders = [folder(), folder()];
    for compression in [Compression::None, Compression::Zstd] {
        let [a, b] = folders.each_ref().map(|f| {
            let path = write_session(f.path(), &[("a", 100, 12), ("b", 9000, 12)], compression);
            std::fs::read(path).unwrap()
        });
        assert!(a == b);
    }
}

#[test]
fn what_is_there_is_not_overwritten() {
    let folder = folder();
    let path = write_session(folder.path(), &[], Compression::None);
    let Err(Error::Io { path: named, .. }) = Writer::create(&path, "x", Compression::None) else {
        panic!("a recording is there")
    };
    assert_eq!(named, path);
    std::fs::remove_file(&path).unwrap();
    let _left_behind = Writer::create(&path, "x", Compression::None).unwrap();
    assert!(Writer::create(&path, "x", Compression::None).is_err());
}

#[test]
fn chunks_hold_sixteen_megabytes_or_one_larger_frame() {
    let folder = folder();
    let path = folder.path().join("a.mcap");
    let mut writer = Writer::create(&path, "x", Compression::None).unwrap();
    let mut picture = |side: u32, ms: u64| {
        let picture = raw(side, side, "mono8", 1, ms as u8);
        writer
            .background(&camera_id("c"), &picture, at(ms))
            .unwrap();
    };
    for (i, side) in [3000, 3000, 1000, 4500, 1000].into_iter().enumerate() {
        picture(side, i as u64);
    }
    writer.finish().unwrap();
    let recording = Recording::open(&path).unwrap();
    let topic = Topic::Color(camera_id("c"), ColorPart::Background);
    let chunks: Vec<u32> = recording
        .messages(&topic)
        .iter()
        .map(MessageRef::chunk)
        .collect();
    // 9 MB; 9 + 1 MB; 20 MB; 1 MB.
    assert_eq!(chunks, [0, 1, 1, 2, 3]);
}

#[test]
fn messages_are_sorted_by_log_time_whatever_their_place_in_the_file() {
    let folder = folder();
    let path = folder.path().join("a.mcap");
    let mut writer = Writer::create(&path, "x", Compression::None).unwrap();
    for ms in [30, 10, 20] {
        writer.trigger(&trigger(&format!("t{ms}"), ms)).unwrap();
        writer.sync().unwrap();
    }
    writer.finish().unwrap();
    let recording = Recording::open(&path).unwrap();
    let times = |m: &[MessageRef]| m.iter().map(MessageRef::log_time).collect::<Vec<_>>();
    let topic = Topic::Trigger;
    assert_eq!(times(recording.messages(&topic)), [at(10), at(20), at(30)]);
    assert_eq!(
        times(recording.messages_until(&topic, at(20))),
        [at(10), at(20)]
    );
    assert_eq!(times(recording.messages_until(&topic, at(9))), []);
    assert_eq!(times(recording.messages_at(&topic, at(20))), [at(20)]);
    assert_eq!(times(recording.messages_at(&topic, Timestamp(0))), []);
}

#[test]
fn another_format_is_refused_by_name() {
    let folder = folder();
    let path = folder.path().join("a.mcap");
    let mut writer = Writer::create(&path, "x", Compression::None).unwrap();
    let pairs = BTreeMap::from([("format".to_owned(), "2".to_owned())]);
    writer.metadata("scand", &pairs).unwrap();
    writer.finish().unwrap();
    let error = Recording::open(&path).unwrap_err().to_string();
    assert!(
        error.contains("a.mcap") && error.contains("\"2\""),
        "{error}"
    );
}

#[test]
fn what_is_no_recording_is_named() {
    let folder = folder();
    let open = |path: &Path| Recording::open(path).unwrap_err().to_string();
    let error = open(&folder.path().join("missing.mcap"));
    assert!(error.contains("missing.mcap"), "{error}");
    assert!(open(folder.path()).contains("is a folder"));
    let path = folder.path().join("a.mcap");
    std::fs::write(&path, b"").unwrap();
    assert!(open(&path).contains("it is empty"));
    std::fs::write(&path, b"PK\x03\x04 not at all").unwrap();
    assert!(open(&path).contains("is not an MCAP file"));
}

#[test]
fn the_board_of_a_calibration_session_is_read_back_and_a_bad_one_is_named() {
    use crate::calibration::Board;
    let folder = folder();
    let path = folder.path().join("a.mcap");
    let mut writer = Writer::create(&path, "", Compression::None).unwrap();
    let board = Board::charuco(11, 8, 0.025, true).unwrap();
    writer.board(&board).unwrap();
    writer.finish().unwrap();
    assert_eq!(
        Recording::open(&path).unwrap().board().unwrap(),
        Some(board)
    );

    let path = folder.path().join("b.mcap");
    let mut writer = Writer::create(&path, "", Compression::None).unwrap();
    let pairs = [("kind", "checkerboard"), ("size", "9x6"), ("square", "25")];
    let pairs = BTreeMap::from(pairs.map(|(k, v)| (k.to_owned(), v.to_owned())));
    writer.metadata("board", &pairs).unwrap();
    writer.finish().unwrap();
    let error = Recording::open(&path)
        .unwrap()
        .board()
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("b.mcap") && error.contains("board square is 25 m"),
        "{error}"
    );
}
