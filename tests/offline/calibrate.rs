//! Calibration by the command, from recordings of other people's pictures with published results.

use crate::support::skipped::{Needed, skip};
use assert_cmd::Command;
use scand::frame::{CameraId, CaptureId, Frame, Picture, Stream, Timestamp, Trigger};
use scand::recording::{Compression, Writer};
use serde_json::Value;
use std::path::{Path, PathBuf};

/// OpenCV's pictures of a chessboard: `left01.jpg` to `right14.jpg`.
fn opencv_pictures() -> Option<PathBuf> {
    let given = std::env::var_os("SCAND_OPENCV_STEREO").map(PathBuf::from);
    let unpacked = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/opencv");
    let debian = PathBuf::from("/usr/share/doc/opencv-doc/examples/data");
    let found = given
        .into_iter()
        .chain([unpacked, debian])
        .find(|folder| folder.join("left01.jpg").is_file());
    if found.is_none() {
        skip(
            Needed::OpencvPictures,
            "no left01.jpg in SCAND_OPENCV_STEREO, tests/opencv or Debian's opencv-doc",
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
                placement: None,
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
    // The published numbers are of the left camera by itself.
    let alone = folder.path().join("left.mcap");
    record(&pictures, &["left"], &alone);
    let board = ["--board", "checkerboard:9x6:25mm", "--json"];
    let (code, json, errors) = calibrate(&[&[alone.to_str().unwrap()], &board[..]].concat());
    assert_eq!(code, Some(0), "{errors}");
    let found: Value = serde_json::from_str(&json).unwrap();
    let left = &found["cameras"]["left"];
    let lens = [numbers(&left["focal_px"]), numbers(&left["center_px"])].concat();
    println!("left alone {lens:?}, {}", left["figures"]);
    for (ours, theirs) in lens.iter().zip([532.795, 532.919, 342.458, 233.901]) {
        assert!((ours - theirs).abs() < 1.0, "{lens:?}");
    }
    // What is there is not replaced.
    let again = scand(&command).arg(&out).output().unwrap();
    assert_eq!(again.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&again.stderr).contains("already exists"));
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
            placement: None,
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
        errors.contains("c00: it has no usable view of the board")
            && errors.contains("no board was found (1 picture)"),
        "{errors}"
    );
    let (code, _, errors) = calibrate(&[session, "--board", "checkerboard:9x6"]);
    assert_eq!(code, Some(2), "{errors}");
}

/// A recording of one camera, its calibration, and what the command says of it.
struct Alone {
    folder: tempfile::TempDir,
}

impl Alone {
    fn path(&self, name: &str) -> String {
        self.folder.path().join(name).to_str().unwrap().to_owned()
    }

    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let alone = Self { folder };
        let (session, truth) = (alone.path("session.mcap"), alone.path("truth.toml"));
        #[rustfmt::skip]
        let simulated = [
            "simulate", "--calibration-session", "--cameras", "1", "--depth-cameras", "0", "--size", "701x523",
            "--encoding", "png", "--placements", "30", "--out", &session, "--truth", &truth,
        ];
        scand(&simulated).assert().success();
        alone
    }

    /// Calibrates with more arguments; what is told as JSON.
    fn calibrated(&self, arguments: &[&str]) -> Value {
        let session = self.path("session.mcap");
        let (code, json, errors) = calibrate(&[&[session.as_str(), "--json"], arguments].concat());
        assert_eq!(code, Some(0), "{arguments:?}: {errors}");
        serde_json::from_str(&json).unwrap()
    }

    /// The error of a run that fails with this code.
    fn refused(&self, code: i32, arguments: &[&str]) -> String {
        let session = self.path("session.mcap");
        let (found, _, errors) = calibrate(&[&[session.as_str()], arguments].concat());
        assert_eq!(found, Some(code), "{arguments:?}: {errors}");
        errors
    }
}

/// Focal lengths and centre.
fn lens(told: &Value) -> Vec<f64> {
    let camera = &told["cameras"]["c00"];
    [numbers(&camera["focal_px"]), numbers(&camera["center_px"])].concat()
}

fn rms(told: &Value) -> f64 {
    told["figures"]["rms_px"].as_f64().unwrap()
}

#[test]
fn what_would_be_ignored_is_refused() {
    let check = ["SESSION.mcap", "--check", "--against", "rig.toml"];
    #[rustfmt::skip]
    let ignored = [
        ["--report", "a.html"], ["--ros", "a"], ["--kalibr", "a.yaml"], ["--depth-table", "a.txt"],
        ["--depth-response", "none"], ["--model", "rational"],
    ];
    for more in ignored {
        let (code, _, errors) = calibrate(&[&check[..], &more].concat());
        assert!(
            code == Some(2) && errors.contains("cannot be used with"),
            "{more:?}: {errors}"
        );
    }
    let export = ["--from", "rig.toml", "--kalibr", "a.yaml"];
    let pictures = ["--pictures", "left=left"];
    let ignored: [(&[&str], &[&str]); 4] = [
        (&export, &["--config", "a.toml"]),
        (&export, &["--set", "calibration.limits.good_px=0.2"]),
        (&export, &["--nearest"]),
        (&pictures, &["--nearest"]),
    ];
    for (asked, more) in ignored {
        let (code, _, errors) = calibrate(&[asked, more].concat());
        assert!(
            code == Some(2) && errors.contains("cannot be used with"),
            "{asked:?} {more:?}: {errors}"
        );
    }
    // Forced, a session would be replaced with its calibration.
    for from in ["--from", "--force"] {
        let (code, _, errors) = calibrate(&[from, "SESSION.mcap", "--out", "SESSION.mcap"]);
        assert!(
            code == Some(2) && errors.contains("is read as a recording"),
            "{errors}"
        );
    }
    for method in ["plane", "none"] {
        let table = ["--depth-table", "a.txt", "--depth-response", method];
        let (code, _, errors) = calibrate(&[&["SESSION.mcap"], &table[..]].concat());
        assert!(
            code == Some(1) && errors.contains("only --depth-response paper takes a table"),
            "{errors}"
        );
    }
}

/// Tests of more than ten seconds: `make check` leaves them to `make test`.
mod long {
    use super::*;

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
        // A camera is missing: that is doubtful, and the file says so by its name.
        let arguments = [session, "--json", "--out", out.to_str().unwrap()];
        let (code, json, errors) = calibrate(&arguments);
        assert_eq!(code, Some(3), "{errors}");
        let aside = path("calibration.doubtful.toml");
        assert!(
            !out.exists() && errors.contains("calibration.doubtful.toml"),
            "{errors}"
        );
        let written = scand::calibration::RigCalibration::load(&aside).unwrap();
        let verdict = written.verdict.unwrap();
        assert_eq!(verdict.level.name(), "doubtful");
        assert!(
            verdict.reasons.iter().any(|r| r.contains("c02")),
            "{verdict:?}"
        );
        // Accepted, it has the name that was asked for, and the same verdict.
        let (code, _, errors) = calibrate(&[&arguments[..], &["--accept-doubtful"]].concat());
        assert_eq!(code, Some(0), "{errors}");
        assert_eq!(std::fs::read(&out).unwrap(), std::fs::read(&aside).unwrap());
        let found: Value = serde_json::from_str(&json).unwrap();
        let left_out = found["left_out"].to_string();
        for named in [
            "placement-005",
            "placement-009",
            "\"c02\"",
            "the board may have moved during the capture",
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
        let not_checked = found["not_checked"].as_array().unwrap();
        assert!(not_checked.contains(&"c02".into()), "{json}");

        let still = path("still.mcap");
        simulate(&["--placements", "1"], &still);
        let check = ["--check", still.to_str().unwrap(), "--against"];
        let (code, words, errors) = calibrate(&[&check[..], &[out.to_str().unwrap()]].concat());
        assert_eq!(code, Some(3), "a camera was not checked: {errors}");
        let summary = words.lines().last().unwrap();
        let expected = "no camera that saw the board moved; not checked: ";
        assert!(
            summary.starts_with(expected) && summary.contains("c02"),
            "{words}"
        );
    }

    #[test]
    fn blurred_placements_are_solved_or_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        let (session, truth) = (path("session.mcap"), path("truth.toml"));
        #[rustfmt::skip]
        let faults = [
            "--blurred-placement", "4=2", "--blurred-placement", "7=6", "--blurred-placement", "9=20",
            "--placements", "24", "--truth", truth.to_str().unwrap(),
        ];
        simulate(&faults, &session);
        let out = path("calibration.toml");
        let command = [
            session.to_str().unwrap(),
            "--json",
            "--out",
            out.to_str().unwrap(),
            "--accept-doubtful",
        ];
        let (code, json, errors) = calibrate(&command);
        // A camera that sees too little beside them is missing, and named.
        assert!(matches!(code, Some(0 | 3)), "{errors}");
        let found: Value = serde_json::from_str(&json).unwrap();
        let named = |what: &str| found["left_out"].to_string().contains(what);
        for placement in found["placements"].as_array().unwrap() {
            let name = placement["name"].as_str().unwrap();
            let rms = placement["figures"]["rms_px"].as_f64().unwrap();
            println!("{name}: {rms:.3} px, named {}", named(name));
            assert!(rms < 0.25 || named(name), "{name}: {rms}");
        }
        // Nobody can see a board through such a blur.
        assert!(named("placement-009"), "{}", found["left_out"]);
        let [fitted, truth] =
            [&out, &truth].map(|p| scand::calibration::RigCalibration::load(p).unwrap());
        let is_told = |id: &CameraId| fitted.cameras.contains_key(id) || named(id.as_str());
        assert!(truth.cameras.keys().all(is_told) && fitted.cameras.len() >= 10);
        let center = |of: &scand::calibration::RigCalibration, id| of.cameras[id].0.center();
        let first = fitted.cameras.keys().next().unwrap();
        for (id, (camera, _)) in &fitted.cameras {
            let ratio = camera.intrinsics.focal_px.x / truth.cameras[id].0.intrinsics.focal_px.x;
            assert!((ratio - 1.0).abs() < 3e-3, "{id}: {ratio}");
            let apart = |of| (center(of, id) - center(of, first)).norm();
            let off = apart(&fitted) - apart(&truth);
            assert!(off.abs() < 1.5e-3, "{id}: {off} m");
        }
    }

    #[test]
    fn a_depth_camera_without_a_response_is_told() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
        let [session, table, out] = ["session.mcap", "table.txt", "calibration.toml"].map(path);
        simulate(
            &["--cameras", "3", "--placements", "14"],
            Path::new(&session),
        );
        let response = |arguments: &[&str], expected: i32| {
            let all = [
                &[
                    session.as_str(),
                    "--json",
                    "--force",
                    "--accept-doubtful",
                    "--out",
                    &out,
                ],
                arguments,
            ]
            .concat();
            let (code, json, errors) = calibrate(&all);
            assert_eq!(code, Some(expected), "{arguments:?}: {errors}");
            let told: Value = serde_json::from_str(&json).unwrap();
            let written = scand::calibration::RigCalibration::load(Path::new(&out)).unwrap();
            let kinect = &written.cameras[&CameraId::new("kinect").unwrap()];
            (told, kinect.1)
        };
        let (told, found) = response(&["--set", "calibration.plane.min_views=50"], 0);
        assert_eq!(told["verdict"]["level"], "doubtful", "{told:#}");
        for place in [&told["lost"], &told["verdict"]["reasons"]] {
            let words = place.to_string();
            assert!(
                words.contains("depth camera kinect has no response")
                    && words.contains("expected 50 or more"),
                "{words}"
            );
        }
        assert_eq!(found, None);

        let (told, found) = response(&["--set", "calibration.limits.depth_bias_mm=0"], 0);
        assert_eq!(told["verdict"]["level"], "doubtful", "{told:#}");
        let reasons = told["verdict"]["reasons"].to_string();
        assert!(reasons.contains("kinect: a bias of"), "{reasons}");
        assert!(found.is_some());

        // A table by itself says which way is meant.
        std::fs::write(&table, "0.7 702\n1.0 1001\n1.3 1299\n").unwrap();
        let (told, found) = response(&["--depth-table", &table], 0);
        assert_eq!(told["depth"]["table"]["method"], "paper", "{told:#}");
        assert!((found.unwrap().slope - 1e-3).abs() < 1e-5);
        // The boards contradict one whose distances were measured from 40 mm before the lens.
        std::fs::write(&table, "0.74 702\n1.04 1001\n1.34 1299\n").unwrap();
        let (told, found) = response(&["--depth-table", &table], 0);
        assert_eq!(told["verdict"]["level"], "doubtful", "{told:#}");
        let reasons = told["verdict"]["reasons"].to_string();
        assert!(reasons.contains("kinect: a bias of"), "{reasons}");
        let stated = found.unwrap().uncertainty;
        assert!((stated - 0.04).abs() < 0.005, "{stated}");
        // One that no sensor's readings make ends the run before anything is looked for.
        std::fs::write(&table, "0.7 1.00007\n1.0 1.0001\n1.3 1.00013\n").unwrap();
        let (code, _, errors) = calibrate(&[&session, "--depth-table", &table]);
        assert!(
            code == Some(1) && errors.contains("table.txt: depth response slope"),
            "{errors}"
        );
    }

    #[test]
    fn one_camera_by_itself_is_calibrated_from_any_start_and_with_either_model() {
        let alone = Alone::new();
        let [toml, ros, kalibr] =
            ["calibration.toml", "ros", "camchain.yaml"].map(|n| alone.path(n));
        let plain = alone.calibrated(&["--out", &toml, "--ros", &ros, "--kalibr", &kalibr]);
        let truth = scand::calibration::RigCalibration::load(Path::new(&alone.path("truth.toml")));
        let truth = truth.unwrap().cameras.into_values().next().unwrap().0;
        let found = lens(&plain);
        let truth = truth.intrinsics;
        assert!(rms(&plain) < 0.1, "{plain:#}");
        assert!(
            (found[0] / truth.focal_px.x - 1.0).abs() < 3e-3,
            "{found:?}, {truth:?}"
        );
        assert!(
            (found[2] - truth.center_px.x).abs() < 5.0,
            "{found:?}, {truth:?}"
        );

        // What others write is a start, and leads to the same lens.
        for file in [&ros, &kalibr, &toml] {
            let started = lens(&alone.calibrated(&["--start", file]));
            for (a, b) in found.iter().zip(&started) {
                assert!((a - b).abs() < 0.05, "{file}: {found:?} {started:?}");
            }
        }
        // It is read: of another camera's pictures it is refused, and so is nonsense.
        let text = std::fs::read_to_string(Path::new(&ros).join("c00.yaml")).unwrap();
        let other = alone.path("other.yaml");
        std::fs::write(&other, text.replace("image_width: 701", "image_width: 640")).unwrap();
        let errors = alone.refused(1, &["--start", &other]);
        assert!(
            errors.contains("camera c00") && errors.contains("640x523"),
            "{errors}"
        );
        std::fs::write(&other, "cam0:\n  intrinsics: [1, 2]\n").unwrap();
        let errors = alone.refused(78, &["--start", &other]);
        assert!(
            errors.contains("other.yaml") && errors.contains("cam0"),
            "{errors}"
        );
        // Lenses that are kept are kept to the last bit.
        let kept = alone.calibrated(&["--fix-intrinsics", &ros]);
        assert_eq!(lens(&kept), found);

        let rational = alone.calibrated(&["--model", "rational"]);
        let camera = &rational["cameras"]["c00"];
        assert_eq!(camera["distortion_model"], "rational_polynomial");
        assert_eq!(numbers(&camera["distortion"]).len(), 8);
        // More terms never fit worse, and the true lens is one of theirs.
        assert!(rms(&rational) < 1.001 * rms(&plain), "{rational:#}");
        assert!((lens(&rational)[0] / truth.focal_px.x - 1.0).abs() < 5e-3);
        let configured = alone.calibrated(&["--set", "calibration.fit.model=rational"]);
        assert_eq!(lens(&configured), lens(&rational));
    }

    #[test]
    fn limits_are_configured_and_exports_need_no_fit() {
        let alone = Alone::new();
        let path = |name: &str| alone.path(name);
        let [toml, ros, kalibr] = ["calibration.toml", "ros", "camchain.yaml"].map(path);
        alone.calibrated(&["--out", &toml, "--ros", &ros, "--kalibr", &kalibr]);

        // A verdict is held against what the configuration says.
        let config = path("rig.toml");
        let limits =
            "[calibration.limits]\ngood_px = 0.001\naccepted_px = 0.001\nrefused_px = 0.001\n";
        std::fs::write(&config, limits).unwrap();
        let unwritten = path("unwritten.toml");
        let errors = alone.refused(1, &["--config", &config, "--out", &unwritten]);
        assert!(
            errors.contains("is refused") && !Path::new(&unwritten).exists(),
            "{errors}"
        );
        let less = [
            "--config",
            &config,
            "--set",
            "calibration.limits.refused_px=0.6",
        ];
        let told = alone.calibrated(&[&less[..], &["--accept-doubtful"]].concat());
        assert_eq!(told["verdict"]["level"], "doubtful", "{told:#}");
        // Doubtful, nothing is exported, and no file has the name that was asked for.
        let unexported = path("unexported.yaml");
        let asked = ["--kalibr", &unexported, "--out", &unwritten];
        alone.refused(3, &[&less[..], &asked].concat());
        assert!(!Path::new(&unexported).exists() && !Path::new(&unwritten).exists());
        assert!(Path::new(&path("unwritten.doubtful.toml")).exists());
        let errors = alone.refused(1, &[&less[..], &asked].concat());
        assert!(
            errors.contains("unwritten.doubtful.toml already exists"),
            "{errors}"
        );
        // Nor is it exported from that file, unless it is accepted.
        let aside = path("unwritten.doubtful.toml");
        let export = ["--from", &aside, "--kalibr", &unexported];
        let (code, _, errors) = calibrate(&export);
        assert!(
            code == Some(3) && errors.contains("--accept-doubtful exports it"),
            "{errors}"
        );
        assert!(!Path::new(&unexported).exists());
        let (code, _, errors) = calibrate(&[&export[..], &["--accept-doubtful"]].concat());
        assert!(
            code == Some(0) && Path::new(&unexported).exists(),
            "{errors}"
        );
        // A later calibration that is not doubtful leaves it, and names it.
        let session = path("session.mcap");
        let (code, _, errors) = calibrate(&[&session, "--force", "--out", &unwritten]);
        assert!(
            code == Some(0)
                && errors.contains("unwritten.doubtful.toml is of an earlier calibration"),
            "{errors}"
        );
        // What was measured between cameras that are not there is refused.
        let measured = ["--distance", "c00", "c99", "1200mm"];
        let errors = alone.refused(1, &measured);
        assert!(
            errors.contains("the session has no camera c99, expected one of c00"),
            "{errors}"
        );
        let told = alone.calibrated(&["--set", "calibration.wanted.views=99"]);
        assert!(
            told["missing"].to_string().contains("expected 99 or more"),
            "{told:#}"
        );
        let errors = alone.refused(78, &["--set", "calibration.limits.coverage=20"]);
        assert!(
            errors.contains("calibration.limits.coverage=20: the value is 20, expected 0 to 1"),
            "{errors}"
        );
        std::fs::write(&config, "[calibration.limits]\ngod_px = 1\n").unwrap();
        let errors = alone.refused(78, &["--config", &config]);
        assert!(
            errors.contains("line 2") && errors.contains("god_px"),
            "{errors}"
        );

        // From a calibration file come the same files as from the fit.
        let [ros_again, kalibr_again, toml_again] =
            ["ros2", "camchain2.yaml", "again.toml"].map(path);
        let (code, _, errors) = calibrate(&[
            "--from",
            &toml,
            "--ros",
            &ros_again,
            "--kalibr",
            &kalibr_again,
            "--out",
            &toml_again,
        ]);
        assert_eq!(code, Some(0), "{errors}");
        let text = |path: &str| std::fs::read_to_string(path).unwrap();
        assert_eq!(text(&toml), text(&toml_again));
        assert_eq!(text(&kalibr), text(&kalibr_again));
        assert_eq!(
            text(&format!("{ros}/c00.yaml")),
            text(&format!("{ros_again}/c00.yaml"))
        );
        let (code, _, errors) = calibrate(&["--from", &toml]);
        assert!(code == Some(1) && errors.contains("give --ros"), "{errors}");

        // And from a recording, with a depth camera whose response no format of others holds.
        let (scan, out) = (path("scan.mcap"), path("scan.toml"));
        #[rustfmt::skip]
        let simulated = [
            "simulate", "--shape", "ball", "--cameras", "2", "--size", "160x120", "--masks", "--depth-frames", "1",
            "--depth-response", "written", "--out", &scan,
        ];
        scand(&simulated).assert().success();
        let folder = path("scan-ros");
        let (code, _, errors) = calibrate(&["--from", &scan, "--ros", &folder, "--out", &out]);
        assert_eq!(code, Some(0), "{errors}");
        let info = path("info.toml");
        scand(&["info", &scan, "--calibration", &info])
            .assert()
            .success();
        assert_eq!(text(&out), text(&info));
        // Nothing that is there is replaced unasked, whatever it is.
        let recorded = std::fs::read(&scan).unwrap();
        let [session, other] = ["session.mcap", "other.mcap"].map(path);
        #[rustfmt::skip]
        let unasked: [&[&str]; 6] = [
            &["info", &scan, "--calibration", &info],
            &["info", &scan, "--calibration", &scan],
            &["calibrate", "--from", &scan, "--ros", &folder],
            &["calibrate", "--from", &scan, "--kalibr", &scan],
            &["calibrate", &session, "--report", &scan],
            &["simulate", "--shape", "ball", "--truth", &scan, "--out", &other],
        ];
        for arguments in unasked {
            let output = scand(arguments).output().unwrap();
            let errors = String::from_utf8_lossy(&output.stderr);
            assert!(
                output.status.code() == Some(1) && errors.contains("already exists: give --force"),
                "{arguments:?}: {errors}"
            );
        }
        assert!(!Path::new(&other).exists());
        for asked in [unasked[0], unasked[2]] {
            scand(asked).arg("--force").assert().success();
        }
        assert_eq!(std::fs::read(&scan).unwrap(), recorded);
        let kinect = text(&format!("{folder}/kinect.yaml"));
        assert!(
            kinect.starts_with("# a reading r is 0.00104 * r + -0.018 metres"),
            "{kinect}"
        );
        let read = scand::calibration::RigCalibration::import(Path::new(&folder)).unwrap();
        assert_eq!(read.cameras.len(), 3);
        let (code, _, errors) = calibrate(&["--from", &session, "--ros", &folder]);
        assert!(
            code == Some(1) && errors.contains("it has no calibration"),
            "{errors}"
        );
    }
}
