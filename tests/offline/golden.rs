//! Recordings and calibrations that released versions wrote stay readable, with the same contents; those of a later
//! version are refused by name. `tests/golden/format-N` has the files of format N, which are never changed.
//! `SCAND_WRITE_GOLDEN=FOLDER cargo test --test offline golden::` writes today's files into a folder: at the release of
//! another format, they become the next one's.

use nalgebra::{Isometry3, Point3, Vector2, Vector3};
use scand::calibration::{
    Board, Camera, DepthCamera, DepthResponse, Distortion, Intrinsics, RigCalibration, Volume,
};
use scand::capture::CaptureSession;
use scand::frame::{
    CameraId, CameraSettings, CaptureId, Frame, Picture, Stream, Timestamp, Transfer, Trigger,
};
use scand::image::Grid;
use scand::mesh;
use scand::reconstruct::{NoProgress, Parameters, reconstruct};
use scand::recording::{
    CameraInCapture, CaptureOutcome, CaptureRecord, ColorPart, Compression, DepthPart, Note,
    Recording, Topic, Writer, recover,
};
use scand::sync;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

const SIZE: usize = 12;

fn at(ms: u64) -> Timestamp {
    Timestamp(1_760_000_000_000_000_000 + ms * 1_000_000)
}

/// A camera 0.5 m away that looks at the origin.
fn camera(name: &str, from: [f64; 3]) -> Camera {
    let distortion = Distortion {
        radial: [0.01, -0.02, 0.003, 0.0, 0.0, 0.0],
        tangential: [1e-4, -2e-4],
    };
    let (focal, center) = (Vector2::new(24.0, 24.25), Vector2::new(5.5, 5.25));
    let lens = Intrinsics::new(SIZE, SIZE, focal, center, distortion);
    let eye = Point3::from(from);
    let pose = Isometry3::face_towards(&eye, &Point3::origin(), &Vector3::new(0.1, 0.2, -1.0));
    Camera::new(CameraId::new(name).unwrap(), lens.unwrap(), pose)
}

fn colors() -> Vec<Camera> {
    let from = [[0.5, 0.0, 0.1], [-0.2, 0.45, 0.1], [-0.2, -0.4, 0.2]];
    let cameras = ["c0", "c1", "c2"].iter().zip(from);
    cameras.map(|(name, from)| camera(name, from)).collect()
}

fn depth() -> DepthCamera {
    DepthCamera {
        camera: camera("d0", [0.0, 0.05, 0.5]),
        response: DepthResponse {
            slope: 0.00104,
            intercept: -0.018,
            scale: [1.012, -0.009, 0.0, 0.0, 0.0],
            range: Some([0.3, 4.0]),
            uncertainty: 0.002,
        },
    }
}

fn volume() -> Volume {
    Volume::new(Point3::from([-0.1; 3]), Point3::from([0.1; 3])).unwrap()
}

fn settings() -> CameraSettings {
    CameraSettings {
        transfer: Transfer::Linear,
        exposure: Some(0.02),
        gain_db: Some(6.0),
        white_balance: Some([1.5, 1.0, 2.0]),
        trigger: Some("software".into()),
    }
}

fn trigger() -> Trigger {
    Trigger {
        id: CaptureId::new("ball-0001").unwrap(),
        time: at(10),
        source: "pedal".into(),
        press_id: Some("p-17".into()),
        subject: Some("1884.3".into()),
        placement: None,
    }
}

fn record() -> CaptureRecord {
    let given = CameraInCapture {
        timestamps: Some(vec![at(11)]),
        ..CameraInCapture::default()
    };
    CaptureRecord {
        id: "ball-0001".into(),
        outcome: CaptureOutcome::Complete,
        reason: None,
        skew_ns: Some(1_110_000),
        cameras: BTreeMap::from([("c0".into(), given)]),
    }
}

fn note() -> Note {
    Note {
        capture: "ball-0001".into(),
        kind: "text".into(),
        text: "handle turned left – ähnlich".into(),
        author: None,
    }
}

fn about() -> BTreeMap<String, String> {
    BTreeMap::from([
        ("operator".into(), "Ann".into()),
        ("name".into(), "ball".into()),
    ])
}

fn inside(x: usize, y: usize) -> bool {
    (x as f64 - 5.5).hypot(y as f64 - 5.5) < 3.5
}

fn raw(encoding: &str, data: Vec<u8>) -> Picture {
    Picture::Raw {
        width: SIZE as u32,
        height: SIZE as u32,
        encoding: encoding.into(),
        step: (data.len() / SIZE) as u32,
        data: data.into(),
    }
}

fn color_picture() -> Picture {
    raw(
        "bayer_rggb8",
        (0..SIZE * SIZE).map(|i| (i * 7) as u8).collect(),
    )
}

fn readings() -> Picture {
    let of = |i: usize| -> u16 {
        if inside(i % SIZE, i / SIZE) {
            440 + i as u16 % 7
        } else {
            600
        }
    };
    raw(
        "16UC1",
        (0..SIZE * SIZE).flat_map(|i| of(i).to_le_bytes()).collect(),
    )
}

/// Writes a message of every kind.
fn write(path: &Path, compression: Compression) -> Writer {
    let mut writer = Writer::create(path, "scand 0.1.0", compression).unwrap();
    writer.metadata("session", &about()).unwrap();
    writer
        .board(&Board::charuco(11, 8, 0.025, true).unwrap())
        .unwrap();
    writer
        .attach("rig.toml", "application/toml", at(0), b"[rig]\n")
        .unwrap();
    for camera in colors() {
        writer.color_camera(&camera, at(0)).unwrap();
        writer.settings(&camera.id, &settings(), at(0)).unwrap();
        writer
            .background(&camera.id, &color_picture(), at(1))
            .unwrap();
    }
    writer.depth_camera(&depth(), at(0)).unwrap();
    writer.volume(&volume(), at(0)).unwrap();
    writer.trigger(&trigger()).unwrap();
    let mask = Grid::from_fn(SIZE, SIZE, |x, y| u8::from(inside(x, y)) * 255);
    let frame = |camera: &CameraId, stream, ms, picture| Frame {
        camera: camera.clone(),
        stream,
        timestamp: at(ms),
        picture,
    };
    for camera in colors() {
        writer.mask(&camera.id, &mask, at(11)).unwrap();
        writer
            .frame(&frame(&camera.id, Stream::Color, 11, color_picture()))
            .unwrap();
    }
    let id = depth().camera.id;
    writer
        .frame(&frame(&id, Stream::Depth, 12, readings()))
        .unwrap();
    let rgb = raw("rgb8", vec![90; SIZE * SIZE * 3]);
    writer
        .frame(&frame(&id, Stream::DepthColor, 12, rgb))
        .unwrap();
    writer.capture(&record(), at(20)).unwrap();
    writer.note(&note(), at(30)).unwrap();
    writer.sync().unwrap();
    writer
}

fn calibration() -> RigCalibration {
    let depth = depth();
    let mut cameras: BTreeMap<_, _> = colors()
        .into_iter()
        .map(|c| (c.id.clone(), (c, None)))
        .collect();
    cameras.insert(
        depth.camera.id.clone(),
        (depth.camera, Some(depth.response)),
    );
    RigCalibration {
        volume: Some(volume()),
        verdict: None,
        at_object_mm: None,
        cameras,
    }
}

/// Writes files as this version does.
fn write_all(folder: &Path) {
    for (name, compression) in [("plain", Compression::None), ("packed", Compression::Zstd)] {
        write(&folder.join(format!("{name}.mcap")), compression)
            .finish()
            .unwrap();
    }
    // As a kill leaves it: synced, and without its end, which dropping the writer would give it.
    let writer = write(&folder.join("cut.mcap"), Compression::None);
    let part = folder.join("cut.mcap.part");
    std::fs::copy(&part, folder.join("cut-off.mcap")).unwrap();
    drop(writer);
    std::fs::remove_file(part).unwrap();
    std::fs::write(folder.join("calibration.toml"), calibration().to_toml()).unwrap();
}

fn golden(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/golden/format-1")
        .join(name)
}

/// What the only message of a topic says.
fn only<T>(
    recording: &Recording,
    topic: &Topic,
    read: impl Fn(&scand::recording::MessageRef) -> T,
) -> T {
    let [message] = recording.messages(topic) else {
        panic!("{topic}: {} messages", recording.messages(topic).len());
    };
    read(message)
}

/// Holds a recording against what was written.
fn check(recording: &Recording) {
    let r = recording;
    for camera in colors() {
        let topic = |part| Topic::Color(camera.id.clone(), part);
        let lens = topic(ColorPart::Calibration);
        assert_eq!(
            only(r, &lens, |m| r.intrinsics(&lens, m).unwrap()),
            camera.intrinsics
        );
        let set = topic(ColorPart::Settings);
        assert_eq!(only(r, &set, |m| r.settings(&set, m).unwrap()), settings());
        for part in [ColorPart::Image, ColorPart::Background] {
            let topic = topic(part);
            assert_eq!(
                only(r, &topic, |m| r.picture(&topic, m).unwrap()),
                color_picture()
            );
        }
    }
    let id = depth().camera.id;
    let response = Topic::Depth(id.clone(), DepthPart::Response);
    assert_eq!(
        only(r, &response, |m| r.response(&response, m).unwrap()),
        depth().response
    );
    let image = Topic::Depth(id, DepthPart::Image);
    assert_eq!(
        only(r, &image, |m| r.picture(&image, m).unwrap()),
        readings()
    );
    assert_eq!(only(r, &Topic::Volume, |m| r.volume(m).unwrap()), volume());
    assert_eq!(
        only(r, &Topic::Trigger, |m| r.trigger(m).unwrap()),
        trigger()
    );
    assert_eq!(
        only(r, &Topic::Capture, |m| r.capture_record(m).unwrap()),
        record()
    );
    assert_eq!(only(r, &Topic::Note, |m| r.note(m).unwrap()), note());
    assert_eq!(r.messages(&Topic::Tf).len(), 4);
    assert_eq!(
        r.board().unwrap(),
        Some(Board::charuco(11, 8, 0.025, true).unwrap())
    );
    assert!(r.metadata().contains(&("session".into(), about())));
    let [attached] = r.attachments() else {
        panic!("{:?}", r.attachments())
    };
    assert_eq!(r.attachment(attached).unwrap(), b"[rig]\n");
}

#[test]
fn recordings_of_every_released_version_say_what_they_said() {
    if let Some(folder) = std::env::var_os("SCAND_WRITE_GOLDEN") {
        return write_all(Path::new(&folder));
    }
    for name in ["plain.mcap", "packed.mcap"] {
        let recording = Recording::open(&golden(name)).unwrap();
        assert_eq!(recording.verify().unwrap(), []);
        check(&recording);
    }
    // One that a kill had cut off is completed.
    let folder = tempfile::tempdir().unwrap();
    let part = folder.path().join("cut.mcap.part");
    std::fs::copy(golden("cut-off.mcap"), &part).unwrap();
    assert!(!Recording::open(&part).unwrap().damage().is_empty());
    let recovered = recover(&part).unwrap();
    assert_eq!(recovered.tail, None);
    check(&Recording::open(&recovered.path).unwrap());
    println!("shown: 3 recordings of format 1 (plain, packed, cut off) read as they were written");
}

#[test]
fn a_recording_of_a_released_version_becomes_a_model() {
    let parameters = sync::Parameters {
        min_depth_frames: 1,
        ..sync::Parameters::default()
    };
    let session = CaptureSession::of(
        Recording::open(&golden("packed.mcap")).unwrap(),
        &parameters,
    )
    .unwrap();
    let (scene, facts) = session.load(&trigger().id).unwrap();
    assert_eq!(facts.id.to_string(), "ball-0001");
    let mut parameters = Parameters::default();
    parameters.hull.resolution = 24.0;
    let made = reconstruct(&scene, &parameters, &NoProgress).unwrap();
    assert!(mesh::check(&made.model.mesh).is_watertight());
}

#[test]
fn calibrations_of_every_released_version_say_what_they_said() {
    assert_eq!(
        RigCalibration::load(&golden("calibration.toml")).unwrap(),
        calibration()
    );
}

#[test]
fn what_a_later_version_wrote_is_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let text = std::fs::read_to_string(golden("calibration.toml")).unwrap();
    let path = folder.path().join("later.toml");
    std::fs::write(&path, text.replace("format = 1", "format = 2")).unwrap();
    let error = RigCalibration::load(&path).unwrap_err().to_string();
    assert!(
        error.contains("later.toml") && error.contains("format is 2"),
        "{error}"
    );

    let path = folder.path().join("later.mcap");
    let mut writer = Writer::create(&path, "scand 9", Compression::None).unwrap();
    let later = BTreeMap::from([("format".to_owned(), "2".to_owned())]);
    writer.metadata("scand", &later).unwrap();
    writer.finish().unwrap();
    let before = std::fs::read(&path).unwrap();
    let mut replay = std::process::Command::new(env!("CARGO_BIN_EXE_scand"));
    let out = folder.path().join("out");
    let ended = replay
        .arg("--replay")
        .arg(&path)
        .arg("--out")
        .arg(&out)
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&ended.stderr);
    assert_eq!(ended.status.code(), Some(1), "{said}");
    assert!(
        said.contains("later.mcap") && said.contains("unknown format \"2\""),
        "{said}"
    );
    assert_eq!(std::fs::read(&path).unwrap(), before);
    println!(
        "shown: a recording and a calibration of a later format are refused by name and left as they are"
    );
}
