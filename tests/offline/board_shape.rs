//! Tests boards that are bent or stretched, in rendered pictures: the shape that is found, and the errors that remain.

use assert_cmd::Command;
use scand::calibration::RigCalibration;
use serde_json::Value;
use std::path::Path;

/// Two neighbouring cameras of the ring see the board.
fn simulate(folder: &Path, arguments: &[&str]) {
    #[rustfmt::skip]
    let common = [
        "simulate", "--calibration-session", "--size", "1280x960", "--depth-cameras", "0", "--placements", "24",
        "--out", "session.mcap", "--truth", "truth.toml",
    ];
    let mut command = Command::new(env!("CARGO_BIN_EXE_scand"));
    command.current_dir(folder).args(common).args(arguments);
    for k in (0..11).filter(|k| ![0, 2].contains(k)) {
        command.args(["--missing", &format!("c{k:02}")]);
    }
    command.assert().success();
}

/// What is found, and its errors: the largest of the focal lengths as a part, and of the distance of the cameras in
/// metres.
fn calibrated(arguments: &[&str]) -> (Value, f64, f64) {
    let folder = tempfile::tempdir().unwrap();
    simulate(folder.path(), arguments);
    let output = Command::new(env!("CARGO_BIN_EXE_scand"))
        .current_dir(folder.path())
        .args([
            "calibrate",
            "session.mcap",
            "--json",
            "--out",
            "found.toml",
            "--accept-doubtful",
        ])
        .output()
        .unwrap();
    let words = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{words}");
    let told: Value = serde_json::from_slice(&output.stdout).unwrap();
    let load = |name: &str| RigCalibration::load(&folder.path().join(name)).unwrap();
    let (found, truth) = (load("found.toml"), load("truth.toml"));
    assert_eq!(found.cameras.len(), 2);
    let mut focal = 0.0_f64;
    for (id, (camera, _)) in &found.cameras {
        let true_one = truth.cameras[id].0.intrinsics.focal_px;
        let ratio = camera.intrinsics.focal_px.component_div(&true_one);
        focal = ratio.iter().map(|r| (r - 1.0).abs()).fold(focal, f64::max);
    }
    // Where the second camera is in the first one's frame.
    let place = |of: &RigCalibration| {
        let poses: Vec<_> = found
            .cameras
            .keys()
            .map(|id| of.cameras[id].0.rig_from_camera)
            .collect();
        (poses[0].inverse() * poses[1]).translation.vector
    };
    let apart = (place(&found) - place(&truth)).norm();
    println!(
        "{arguments:?}: focal lengths {:.3} %, places {:.2} mm, {}",
        1e2 * focal,
        1e3 * apart,
        told["shape"]
    );
    (told, focal, apart)
}

fn reasons(told: &Value) -> String {
    told["verdict"]["reasons"].to_string()
}

/// Tests of more than ten seconds: `make check` leaves them to `make test`.
mod long {
    use super::*;

    #[test]
    fn a_print_that_is_longer_one_way_is_found_and_doubted() {
        // Twice 0.2 % between the rows and the columns.
        let (told, focal, apart) = calibrated(&["--board-stretch-percent", "0.2"]);
        assert!(focal < 1.5e-3 && apart < 1e-3, "{focal} {apart}");
        let stretch = told["shape"]["stretch"]["value"].as_f64().unwrap();
        assert!((1e2 * stretch - 0.2).abs() < 0.02, "{stretch}");
        assert!(
            reasons(&told).contains("longer along its rows than down its columns"),
            "{told}"
        );
        assert_eq!(told["verdict"]["level"], "doubtful");
    }

    #[test]
    fn a_bent_board_is_found_and_spoils_neither_lenses_nor_places() {
        let (told, focal, apart) = calibrated(&["--board-bend-mm", "0.5,0"]);
        assert!(focal < 1.5e-3 && apart < 1e-3, "{focal} {apart}");
        let bend = told["shape"]["bend"][0]["value"].as_f64().unwrap();
        assert!((1e3 * bend - 0.5).abs() < 0.05, "{bend}");
        assert!(
            reasons(&told).contains("the board is bent by 0.5"),
            "{told}"
        );
        assert_ne!(told["verdict"]["level"], "good");
    }

    #[test]
    fn a_flat_board_is_taken_for_flat() {
        let (told, focal, apart) = calibrated(&[]);
        assert!(focal < 1.5e-3 && apart < 1e-3, "{focal} {apart}");
        for term in [
            &told["shape"]["bend"][0],
            &told["shape"]["bend"][1],
            &told["shape"]["stretch"],
        ] {
            assert_eq!(
                (&term["value"], &term["fate"]),
                (&Value::from(0.0), &Value::from("not_needed"))
            );
        }
        assert!(!reasons(&told).contains("the board"), "{told}");
    }
}
