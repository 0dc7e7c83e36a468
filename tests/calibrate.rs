//! Calibration by the command, from recordings: other people's pictures with published results.

use assert_cmd::Command;
use scand::frame::{CameraId, CaptureId, Frame, Picture, Stream, Timestamp, Trigger};
use scand::recording::{Compression, Writer};
use serde_json::Value;
use std::path::{Path, PathBuf};

/// OpenCV's pictures of a chessboard: `left01.jpg` to `right14.jpg`.
fn opencv_pictures() -> Option<PathBuf> {
    let beside = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data/opencv-stereo");
    let given = std::env::var_os("SCAND_OPENCV_STEREO").map(PathBuf::from);
    let debian = PathBuf::from("/usr/share/doc/opencv-doc/examples/data");
    let places = given.into_iter().chain([beside, debian]);
    let found = places
        .into_iter()
        .find(|place| place.join("left01.jpg").is_file());
    if found.is_none() {
        println!(
            "skipped: no left01.jpg of OpenCV in ../shared/data/opencv-stereo, SCAND_OPENCV_STEREO or Debian's \
             opencv-doc"
        );
    }
    found
}

/// A recording of numbered pictures, `NAME01.jpg` and on, as cameras of their names.
fn record(pictures: &Path, cameras: &[&str], path: &Path) {
    let mut writer = Writer::create(path, "test", Compression::None).unwrap();
    for number in 1..=14_u64 {
        let time = Timestamp(1_000_000_000 * number);
        let files: Vec<_> = cameras
            .iter()
            .map(|c| (c, pictures.join(format!("{c}{number:02}.jpg"))))
            .collect();
        if files.iter().any(|(_, file)| !file.is_file()) {
            continue;
        }
        let id = CaptureId::new(&format!("p{number:02}")).unwrap();
        writer
            .trigger(&Trigger {
                id,
                time,
                source: "test".into(),
                subject: None,
            })
            .unwrap();
        for (camera, file) in files {
            let picture = Picture::Compressed {
                format: "jpeg".into(),
                data: std::fs::read(file).unwrap().into(),
            };
            let camera = CameraId::new(camera).unwrap();
            writer
                .frame(&Frame {
                    camera,
                    stream: Stream::Color,
                    timestamp: time,
                    picture,
                })
                .unwrap();
        }
    }
    writer.finish().unwrap();
}

fn scand(arguments: &[&str]) -> Command {
    let mut command = Command::cargo_bin("scand").unwrap();
    command.args(arguments);
    command
}

fn numbers(value: &Value) -> Vec<f64> {
    value
        .as_array()
        .unwrap()
        .iter()
        .map(|n| n.as_f64().unwrap())
        .collect()
}

#[test]
fn opencvs_stereo_pairs_give_the_published_lenses_and_baseline() {
    let Some(pictures) = opencv_pictures() else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let session = folder.path().join("stereo.mcap");
    record(&pictures, &["left", "right"], &session);
    let out = folder.path().join("calibration.toml");
    let command = [
        "calibrate",
        session.to_str().unwrap(),
        "--board",
        "checkerboard:9x6:25mm",
        "--json",
        "--out",
    ];
    let output = scand(&command).arg(&out).output().unwrap();
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let found: Value = serde_json::from_slice(&output.stdout).unwrap();
    let left = &found["cameras"]["left"];
    let lens = [numbers(&left["focal_px"]), numbers(&left["center_px"])].concat();
    println!("left {lens:?}");
    let centers = ["left", "right"].map(|c| numbers(&found["cameras"][c]["translation"]));
    let baseline: f64 = centers[0]
        .iter()
        .zip(&centers[1])
        .map(|(a, b)| (a - b).powi(2))
        .sum::<f64>()
        .sqrt();
    println!("baseline {:.3} mm", 1e3 * baseline);
    // The tutorial's published result.
    for (ours, theirs) in lens.iter().zip([532.795, 532.919, 342.458, 233.901]) {
        assert!((ours - theirs).abs() < 1.0, "{lens:?}");
    }
    for camera in ["left", "right"] {
        let rms = found["cameras"][camera]["figures"]["rms_px"]
            .as_f64()
            .unwrap();
        println!(
            "{camera} rms {rms:.3} px, {} views",
            found["cameras"][camera]["views"]
        );
        assert!(rms < 0.25, "{camera}: {rms}");
        assert_eq!(found["cameras"][camera]["views"], 13);
    }
    assert!((1e3 * baseline - 83.2).abs() < 0.5, "{baseline}");
    let written = scand::calibration::RigCalibration::load(&out).unwrap();
    assert_eq!(written.cameras.len(), 2);
    // What is there is not replaced.
    let again = scand(&command).arg(&out).output().unwrap();
    assert_eq!(again.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&again.stderr).contains("is there already"));
}
