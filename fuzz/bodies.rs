//! The bodies of the fuzzer's targets: each takes arbitrary bytes, must not panic, and must read back what it read.
//! Shared by the fuzzer's targets and by `tests/offline/fuzzing.rs`, which runs the same on stable Rust.

use nalgebra::{Isometry3, Point3, Vector2, Vector3};
use scand::calibration::{
    Camera, DepthCamera, DepthResponse, Distortion, Intrinsics, RigCalibration, Volume,
};
use scand::capture::CaptureSession;
use scand::config::Config;
use scand::frame::CameraId;
use scand::image::{
    Grid, RgbImage, grey_from_file, grey_of_used_bits, orientation_of_file, rgb_from_file,
};
use scand::mesh::check;
use scand::reconstruct::{
    ColorView, DepthFrame, DepthView, NoProgress, Parameters, Scene, SilhouetteSource, reconstruct,
};
use scand::recording::Recording;
use scand::sync;
use scand::trigger::{Event, LONGEST_REQUEST, Reply, Request};
use std::path::PathBuf;
use std::sync::Arc;

/// A target's name and what it does with bytes.
pub type Target = (&'static str, fn(&[u8]));

/// All targets.
pub const TARGETS: [Target; 6] = [
    ("calibration", calibration),
    ("configuration", configuration),
    ("picture", picture),
    ("recording", recording),
    ("socket", socket),
    ("solid", solid),
];

/// A file of these bytes.
fn file(name: &str, bytes: &[u8]) -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().expect("room for a folder");
    let path = folder.path().join(name);
    std::fs::write(&path, bytes).expect("room for a file");
    (folder, path)
}

/// As a calibration of ours, and as one of ROS or Kalibr. What is accepted can be written and read back.
pub fn calibration(bytes: &[u8]) {
    for name in ["rig.toml", "rig.yaml"] {
        let (_folder, path) = file(name, bytes);
        match RigCalibration::import(&path) {
            Ok(read) => {
                let (_folder, again) = file("again.toml", read.to_toml().as_bytes());
                let again = RigCalibration::load(&again);
                assert!(again.is_ok(), "{:?}", again.err());
            }
            Err(error) => assert!(error.to_string().contains(name), "{error}"),
        }
    }
}

/// As a configuration. What is accepted can be written and read back.
pub fn configuration(bytes: &[u8]) {
    let (_folder, path) = file("rig.toml", bytes);
    match Config::load(Some(&path), &[]) {
        Ok(config) => {
            let text = toml::to_string(&config).expect("a configuration has a text");
            let (_folder, again) = file("again.toml", text.as_bytes());
            let again = Config::load(Some(&again), &[]);
            assert_eq!(again.ok().as_ref(), Some(&config), "{text}");
        }
        Err(error) => assert!(error.to_string().contains("rig.toml"), "{error}"),
    }
}

/// As a picture file of 64 x 48 pixels. What is read has that size.
pub fn picture(bytes: &[u8]) {
    for format in ["jpeg", "png", "tiff"] {
        if let Ok(picture) = rgb_from_file(format, bytes, (64, 48)) {
            assert_eq!((picture.width(), picture.height()), (64, 48));
        }
        let _grey = grey_from_file(format, bytes, (64, 48));
        let _of_board = grey_of_used_bits(format, bytes, (64, 48));
        assert!((1..=8).contains(&orientation_of_file(format, bytes)));
    }
}

/// As a recording: opened, assembled into captures, each of them loaded.
pub fn recording(bytes: &[u8]) {
    let (_folder, path) = file("any.mcap", bytes);
    let Ok(recording) = Recording::open(&path) else {
        return;
    };
    let _damage = recording.verify();
    let parameters = sync::Parameters {
        go_on_without_missing: true,
        min_depth_frames: 1,
        ..sync::Parameters::default()
    };
    if let Ok(session) = CaptureSession::of(recording, &parameters) {
        for capture in session.captures().into_iter().take(4) {
            let _scene = session.load(&capture.id);
        }
    }
}

/// As a line that a client sends, and as one that it receives. What is understood is written again as it was.
pub fn socket(bytes: &[u8]) {
    let line = &bytes[..bytes.len().min(LONGEST_REQUEST)];
    if let Ok(request) = serde_json::from_slice::<Request>(line) {
        let text = serde_json::to_vec(&request).expect("a request has a text");
        let again: Request = serde_json::from_slice(&text).expect("it can be read again");
        assert_eq!(again, request);
    }
    if let Ok(reply) = serde_json::from_slice::<Reply>(line) {
        let _line = serde_json::to_vec(&reply);
    }
    if let Ok(event) = serde_json::from_slice::<Event>(line) {
        let _line = serde_json::to_vec(&event);
    }
}

const SIZE: usize = 12;

/// As masks and readings of a small rig. A model that is made of them is closed and manifold.
pub fn solid(bytes: &[u8]) {
    let mut bytes = bytes
        .iter()
        .copied()
        .cycle()
        .take(if bytes.is_empty() { 0 } else { 1 << 12 });
    let Some(first) = bytes.next() else { return };
    let mut next = || bytes.next().unwrap_or(0);
    let eyes = [[0.5, 0.0, 0.1], [-0.2, 0.45, 0.1], [-0.2, -0.4, 0.2]];
    let colors = eyes.iter().enumerate().map(|(i, eye)| ColorView {
        camera: camera(&format!("c{i}"), *eye),
        image: RgbImage::filled(SIZE, SIZE, [90, 120, 150]),
        // Some masks have greys, some have two values alone.
        silhouette: SilhouetteSource::Mask(Grid::from_fn(SIZE, SIZE, |_, _| match first & 1 {
            0 => u8::from(next() > 100) * 255,
            _ => next(),
        })),
        ignored: (first & 2 != 0).then(|| Grid::from_fn(SIZE, SIZE, |_, _| next())),
    });
    let colors = colors.collect();
    let color = Some(Arc::new(RgbImage::filled(SIZE, SIZE, [90, 120, 150])));
    let readings = Grid::from_fn(SIZE, SIZE, |_, _| 400 + u16::from(next()));
    let depth = DepthView {
        camera: DepthCamera {
            camera: camera("d0", [0.0, 0.05, 0.5]),
            response: DepthResponse::default(),
        },
        frames: vec![DepthFrame { readings, color }],
    };
    let volume = Volume::new(Point3::from([-0.1; 3]), Point3::from([0.1; 3])).expect("a box");
    let scene = Scene {
        colors,
        depths: vec![depth],
        volume,
    };
    let mut parameters = Parameters::default();
    parameters.hull.resolution = 20.0;
    if let Ok(made) = reconstruct(&scene, &parameters, &NoProgress) {
        for mesh in [&made.hull, &made.model.mesh] {
            assert!(!mesh.triangles.is_empty());
            let report = check(mesh);
            assert!(report.is_watertight(), "{report:?}");
        }
    }
}

/// A camera that looks at the origin.
fn camera(name: &str, from: [f64; 3]) -> Camera {
    let lens = Intrinsics::new(
        SIZE,
        SIZE,
        Vector2::new(24.0, 24.0),
        Vector2::new(5.5, 5.5),
        Distortion::default(),
    );
    let eye = Point3::from(from);
    let pose = Isometry3::face_towards(&eye, &Point3::origin(), &Vector3::new(0.1, 0.2, -1.0));
    Camera::new(
        CameraId::new(name).expect("a name"),
        lens.expect("a lens"),
        pose,
    )
}
