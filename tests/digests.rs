//! The program writes the same bytes for the same input as before: models of the project's own recordings, and the
//! messages of a session. This shows that a change of the code that must not alter any output did not.

#[path = "digests/held.rs"]
mod held;

use nalgebra::{Isometry3, Point3, Vector2, Vector3};
use scand::calibration::{Camera, DepthCamera, DepthResponse, Distortion, Intrinsics, Volume};
use scand::frame::{
    CameraId, CameraSettings, CaptureId, Frame, Picture, Stream, Timestamp, Transfer, Trigger,
};
use scand::recording::{
    CameraInCapture, CaptureOutcome, CaptureRecord, FinishedCapture, Lost, Note, RecordingSession,
    SessionHeader,
};
use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;

const SIZE: usize = 16;

fn at(ms: u64) -> Timestamp {
    Timestamp(1_760_000_000_000_000_000 + ms * 1_000_000)
}

fn id(name: &str) -> CameraId {
    CameraId::new(name).unwrap()
}

#[test]
fn models_of_the_projects_recordings_are_what_they_were() {
    let folder = tempfile::tempdir().unwrap();
    let mut found = BTreeMap::new();
    for (name, capture) in [("cup", "cup-000"), ("bowl_with_fruit", "fruit-bowl-000")] {
        let recording =
            Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("recordings/{name}.mcap"));
        let out = folder.path();
        let mut replay = Command::new(env!("CARGO_BIN_EXE_scand"));
        replay.args(["--quiet", "--replay"]).arg(recording);
        let ended = replay.arg("--out").arg(out).output().unwrap();
        assert!(ended.status.success(), "{ended:?}");
        for file in ["model.glb", "model.ply"] {
            let bytes = std::fs::read(out.join(name).join(capture).join(file)).unwrap();
            found.insert(format!("{name}/{file}"), held::sha256(&bytes));
        }
    }
    held::hold(&found);
}

/// A camera 0.5 m away that looks at the origin.
fn camera(name: &str, from: [f64; 3]) -> Camera {
    let distortion = Distortion {
        radial: [0.01, -0.02, 0.003, 0.0, 0.0, 0.0],
        tangential: [1e-4, -2e-4],
    };
    let (focal, center) = (Vector2::new(24.0, 24.25), Vector2::new(7.5, 7.25));
    let lens = Intrinsics::new(SIZE, SIZE, focal, center, distortion);
    let (eye, up) = (Point3::from(from), Vector3::new(0.1, 0.2, -1.0));
    let pose = Isometry3::face_towards(&eye, &Point3::origin(), &up);
    Camera::new(id(name), lens.unwrap(), pose)
}

fn picture(encoding: &str, bytes_a_pixel: usize, seed: usize) -> Picture {
    let bytes = (0..SIZE * SIZE * bytes_a_pixel).map(|i| (i * 7 + seed * 31) as u8);
    Picture::Raw {
        width: SIZE as u32,
        height: SIZE as u32,
        encoding: encoding.into(),
        step: (SIZE * bytes_a_pixel) as u32,
        data: bytes.collect::<Vec<u8>>().into(),
    }
}

fn preamble() -> SessionHeader {
    let settings = CameraSettings {
        transfer: Transfer::Linear,
        exposure: Some(0.02),
        gain_db: Some(6.0),
        white_balance: Some([1.5, 1.0, 2.0]),
        trigger: Some("software".into()),
    };
    let response = DepthResponse {
        slope: 0.00104,
        intercept: -0.018,
        scale: [1.012, -0.009, 0.0, 0.0, 0.0],
        range: Some([0.3, 4.0]),
        uncertainty: 0.002,
    };
    let background = |k| (at(k as u64), picture("bayer_rggb8", 1, k));
    SessionHeader {
        colors: vec![
            camera("c0", [0.5, 0.0, 0.1]),
            camera("c1", [-0.2, 0.45, 0.1]),
        ],
        depths: vec![DepthCamera {
            camera: camera("d0", [0.0, 0.05, 0.5]),
            response,
        }],
        volume: Volume::new(Point3::from([-0.1; 3]), Point3::from([0.1; 3])).ok(),
        calibration: None,
        settings: BTreeMap::from([(id("c0"), settings.clone()), (id("c1"), settings)]),
        backgrounds: BTreeMap::from([(id("c0"), background(1)), (id("c1"), background(2))]),
        configuration: "[rig]\n".into(),
        about: BTreeMap::from([("operator".into(), "Ann".into())]),
    }
}

/// A capture of two colour cameras and a depth camera at `ms`; a failed one lacks the second.
fn capture(number: usize, ms: u64, outcome: CaptureOutcome) -> FinishedCapture {
    let trigger = Trigger {
        id: CaptureId::new(&format!("amphora-{number:04}")).unwrap(),
        time: at(ms),
        source: "pedal".into(),
        press_id: Some(format!("p-{number}")),
        subject: (number == 1).then(|| "1884.3".into()),
        placement: None,
    };
    let frame = |camera, stream, after, encoding, bytes| Frame {
        camera: id(camera),
        stream,
        timestamp: at(ms + after),
        picture: picture(encoding, bytes, number),
    };
    let mut frames = vec![
        frame("c0", Stream::Color, 1, "bayer_rggb8", 1),
        frame("c1", Stream::Color, 2, "bayer_rggb8", 1),
        frame("d0", Stream::Depth, 3, "16UC1", 2),
        frame("d0", Stream::DepthColor, 3, "rgb8", 3),
    ];
    let failed = outcome == CaptureOutcome::Failed;
    frames.retain(|frame| !failed || frame.camera != id("c1"));
    let given = |after| CameraInCapture {
        timestamps: Some(vec![at(ms + after)]),
        ..CameraInCapture::default()
    };
    let missing = CameraInCapture {
        timestamps: Some(Vec::new()),
        lost: Some(Lost::All {
            fault: "unplugged".into(),
        }),
        remarks: vec!["its clock is 3 ms off".into()],
    };
    let second = if failed { missing } else { given(2) };
    let record = CaptureRecord {
        id: trigger.id.to_string(),
        outcome,
        reason: failed.then(|| "camera c1: unplugged".into()),
        skew_ns: Some(1_000_000),
        cameras: BTreeMap::from([
            ("c0".into(), given(1)),
            ("c1".into(), second),
            ("d0".into(), given(3)),
        ]),
    };
    FinishedCapture {
        trigger,
        frames,
        record,
        time: at(ms + 20),
    }
}

/// Captures, a note, a background that was taken anew and the largest file's end, at fixed times.
fn write_session(folder: &Path) {
    let mut session =
        RecordingSession::begin(folder, "amphora", "scand", at(0), 6_000, preamble()).unwrap();
    session
        .append(&capture(1, 100, CaptureOutcome::Complete))
        .unwrap();
    let note = Note {
        capture: "amphora-0001".into(),
        kind: "text".into(),
        text: "handle turned left – ähnlich".into(),
        author: None,
    };
    session.note(&note, at(200)).unwrap();
    let mut later = preamble();
    let taken_anew = (at(250), picture("bayer_rggb8", 1, 9));
    later.backgrounds.insert(id("c1"), taken_anew);
    session.change(later, at(260)).unwrap();
    session
        .append(&capture(2, 300, CaptureOutcome::Failed))
        .unwrap();
    session
        .append(&capture(3, 400, CaptureOutcome::Complete))
        .unwrap();
    session
        .append(&capture(4, 500, CaptureOutcome::Complete))
        .unwrap();
    session.close().unwrap();
}

#[test]
fn messages_of_a_session_are_what_they_were() {
    let folder = tempfile::tempdir().unwrap();
    write_session(folder.path());
    let mut found = BTreeMap::new();
    for entry in std::fs::read_dir(folder.path()).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy();
        found.insert(format!("session/{name}"), held::messages(&path));
    }
    assert_eq!(found.len(), 2, "{found:?}");
    held::hold(&found);
}
