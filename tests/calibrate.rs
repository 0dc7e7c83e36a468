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
                press_id: None,
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

/// A small rig's calibration session.
fn simulate(arguments: &[&str], out: &Path) {
    let common = [
        "simulate",
        "--calibration-session",
        "--size",
        "612x512",
        "--blur-px",
        "0.6",
    ];
    let common = [
        common.as_slice(),
        &["--board", "checkerboard:9x7:25mm", "--out"],
    ]
    .concat();
    scand(&common).arg(out).args(arguments).assert().success();
}

fn calibrate(arguments: &[&str]) -> (Option<i32>, String, String) {
    let output = scand(&[&["calibrate"], arguments].concat())
        .output()
        .unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    (
        output.status.code(),
        text(output.stdout),
        text(output.stderr),
    )
}

#[test]
fn faults_are_named_and_what_is_left_is_right() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let (session, truth) = (path("session.mcap"), path("truth.toml"));
    let faults = [
        "--moved-placement",
        "5=3",
        "--duplicate-placement",
        "9",
        "--blind",
        "c02",
        "--turned-over-placement",
        "4",
    ];
    let with_truth = ["--placements", "18", "--truth", truth.to_str().unwrap()];
    simulate(&[faults.as_slice(), &with_truth].concat(), &session);
    let (session, out) = (session.to_str().unwrap(), path("calibration.toml"));
    let (code, json, errors) = calibrate(&[session, "--json", "--out", out.to_str().unwrap()]);
    assert_eq!(code, Some(3), "a camera is missing: {errors}");
    let found: Value = serde_json::from_str(&json).unwrap();
    let left_out = found["left_out"].to_string();
    for named in [
        "placement-005",
        "placement-009",
        "\"c02\"",
        "it moved during the capture",
        "placement-008",
    ] {
        assert!(left_out.contains(named), "{named}: {left_out}");
    }
    assert!(!left_out.contains("placement-004"), "{left_out}");
    assert!(found["figures"]["rms_px"].as_f64().unwrap() < 0.1, "{json}");
    assert!(found["held_out"]["ratio"].as_f64().unwrap() < 1.3);
    let [fitted, truth] =
        [&out, &truth].map(|p| scand::calibration::RigCalibration::load(p).unwrap());
    assert!(fitted.cameras.len() >= 9, "{left_out}");
    for (id, (camera, _)) in &fitted.cameras {
        let true_one = &truth.cameras[id].0;
        let ratio = camera
            .intrinsics
            .focal_px
            .component_div(&true_one.intrinsics.focal_px);
        assert!(
            ratio.iter().all(|r| (r - 1.0).abs() < 3e-3),
            "{id}: {ratio}"
        );
    }

    let (code, _, errors) = calibrate(&[session, "--board", "checkerboard:8x6:25mm"]);
    assert_eq!(code, Some(1));
    assert!(errors.contains("has 9x7 inner corners"), "{errors}");

    let bumped = path("bumped.mcap");
    simulate(&["--placements", "1", "--turned", "c07=0.1"], &bumped);
    let check = [
        "--check",
        bumped.to_str().unwrap(),
        "--against",
        out.to_str().unwrap(),
        "--json",
    ];
    let (code, json, errors) = calibrate(&check);
    assert_eq!(code, Some(1), "{errors}");
    let found: Value = serde_json::from_str(&json).unwrap();
    let moved = found["cameras"]
        .as_array()
        .unwrap()
        .iter()
        .filter(|c| !c["motion"].is_null());
    let moved: Vec<_> = moved.collect();
    assert_eq!(moved.len(), 1, "{json}");
    assert_eq!(moved[0]["camera"], "c07");
    assert!(
        (moved[0]["motion"]["turn_degrees"].as_f64().unwrap() - 0.1).abs() < 0.01,
        "{json}"
    );
}

#[test]
fn what_cannot_be_calibrated_says_why() {
    let folder = tempfile::tempdir().unwrap();
    let session = folder.path().join("session.mcap");
    let mut writer = Writer::create(&session, "test", Compression::None).unwrap();
    let time = Timestamp(1_000_000_000);
    let id = CaptureId::new("p1").unwrap();
    writer
        .trigger(&Trigger {
            id,
            time,
            source: "test".into(),
            press_id: None,
            subject: None,
        })
        .unwrap();
    let grey = Picture::Raw {
        width: 320,
        height: 240,
        encoding: "mono8".into(),
        step: 320,
        data: vec![90; 320 * 240].into(),
    };
    let camera = CameraId::new("c00").unwrap();
    writer
        .frame(&Frame {
            camera,
            stream: Stream::Color,
            timestamp: time,
            picture: grey,
        })
        .unwrap();
    writer.finish().unwrap();
    let session = session.to_str().unwrap();
    let (code, _, errors) = calibrate(&[session]);
    assert_eq!(code, Some(1));
    assert!(errors.contains("give --board"), "{errors}");
    let (code, _, errors) = calibrate(&[session, "--board", "checkerboard:9x6:25mm"]);
    assert_eq!(code, Some(1));
    assert!(
        errors.contains("c00: it saw no board")
            && errors.contains("no board was found (1 pictures)"),
        "{errors}"
    );
    let (code, _, errors) = calibrate(&[session, "--board", "checkerboard:9x6"]);
    assert_eq!(code, Some(2), "{errors}");
}
