//! A simulated rig, calibrated by the command from a recording: what is found against what is true, the depth cameras'
//! response, the report, and files for others.

use assert_cmd::Command;
use nalgebra::{Matrix3, Point3, Vector3};
use scand::calibration::{Camera, RigCalibration};
use scand::recording::Compression;
use scand::simulate::{BoardOptions, BoardSession, Options, write_board_session};
use std::path::Path;

fn session() -> BoardSession {
    let mut options = Options {
        width: 800,
        height: 600,
        cameras: 7,
        ..Options::for_boards()
    };
    options.depth.bias_mm = 20.0;
    let boards = BoardOptions {
        placements: 19,
        ..BoardOptions::default()
    };
    BoardSession::new(options, boards).unwrap()
}

fn scand(arguments: &[&str]) -> String {
    let output = Command::new(env!("CARGO_BIN_EXE_scand"))
        .args(arguments)
        .output()
        .unwrap();
    let words = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{arguments:?}: {words}");
    String::from_utf8(output.stdout).unwrap()
}

/// The camera in the frame of the truth: the fit's origin is the first corner of the board on the table.
fn moved(camera: &Camera, origin: Vector3<f64>) -> Camera {
    let mut pose = camera.rig_from_camera;
    pose.translation.vector += origin;
    Camera::new(camera.id.clone(), camera.intrinsics, pose)
}

/// Points in the volume.
fn points() -> impl Iterator<Item = Point3<f64>> {
    (0..125).map(|k| {
        let at = [k % 5, k / 5 % 5, k / 25].map(|v| f64::from(v) / 4.0);
        Point3::new(0.12 * (at[0] - 0.5), 0.12 * (at[1] - 0.5), 0.10 * at[2])
    })
}

/// Where the rays of all cameras that see a point come nearest to each other.
fn triangulated(p: Point3<f64>, truth: &[&Camera], found: &[Camera]) -> Point3<f64> {
    let (mut matrix, mut right) = (Matrix3::zeros(), Vector3::zeros());
    for (truth, found) in truth.iter().zip(found) {
        let Some((pixel, _)) = truth.project(p) else {
            continue;
        };
        let ray = found.ray(pixel).unwrap();
        let across = Matrix3::identity() - ray * ray.transpose();
        matrix += across;
        right += across * found.center().coords;
    }
    Point3::from(matrix.try_inverse().unwrap() * right)
}

#[test]
fn a_simulated_rig_is_found_again() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let session = session();
    write_board_session(
        &session,
        Path::new(&path("session.mcap")),
        Compression::None,
    )
    .unwrap();
    let (out, report) = (path("calibration.toml"), path("report.html"));
    #[rustfmt::skip]
    let words = scand(&[
        "calibrate", &path("session.mcap"), "--out", &out, "--report", &report,
        "--ros", &path("ros"), "--kalibr", &path("camchain.yaml"),
    ]);
    assert!(words.contains("depth of kinect: z = "), "{words}");

    let (truth, found) = (
        session.truth(),
        RigCalibration::load(Path::new(&out)).unwrap(),
    );
    assert_eq!(found.cameras.len(), 8, "{words}");
    let board = session.board();
    let first = session.placements()[0].rig_from_board * board.corner_position(0, 0);
    let colors: Vec<&Camera> = session.rig().colors.iter().map(|s| &s.actual).collect();
    let moved: Vec<Camera> = colors
        .iter()
        .map(|c| moved(&found.cameras[&c.id].0, first.coords))
        .collect();
    let (mut sum, mut count, mut worst) = (0.0, 0.0, 0.0_f64);
    for (truth, found) in colors.iter().zip(&moved) {
        let focal = found.intrinsics.focal_px.x / truth.intrinsics.focal_px.x - 1.0;
        assert!(
            focal.abs() < 1e-3,
            "{}: focal length {focal:.5} off",
            truth.id
        );
        for p in points() {
            let [a, b] = [truth, found].map(|camera| camera.project(p).unwrap().0);
            let off = (a - b).norm();
            (sum, count, worst) = (sum + off, count + 1.0, worst.max(off));
        }
    }
    assert!(
        sum / count < 0.05 && worst < 0.2,
        "{} px, {worst} px at most",
        sum / count
    );
    for p in points() {
        let q = p + Vector3::new(0.06, 0.08, 0.0);
        let length = (triangulated(p, &colors, &moved) - triangulated(q, &colors, &moved)).norm();
        assert!(
            (length - 0.1).abs() < 5e-5,
            "100 mm are {} mm",
            1e3 * length
        );
    }

    let id = &session.rig().depths[0].actual.camera.id;
    let (actual, response) = (truth.cameras[id].1.unwrap(), found.cameras[id].1.unwrap());
    for z in [0.7, 1.0, 1.3] {
        let raw = (z - actual.intercept) / actual.slope;
        let bias = response.slope * raw + response.intercept - z;
        assert!(bias.abs() < 2e-3, "{bias} m of bias at {z} m");
    }

    let page = std::fs::read_to_string(&report).unwrap();
    for words in [
        "What each camera saw",
        "The rig from above",
        "Views that cameras share",
        "held out",
        "bias mm",
    ] {
        assert!(page.contains(words), "{words}");
    }
    let ros = RigCalibration::import(Path::new(&path("ros"))).unwrap();
    for (id, (camera, _)) in &ros.cameras {
        assert_eq!(camera.intrinsics, found.cameras[id].0.intrinsics);
    }
    let kalibr = RigCalibration::import(Path::new(&path("camchain.yaml"))).unwrap();
    assert_eq!(kalibr.cameras.len(), 8);
    // Lenses that are known are kept, wherever they come from.
    let again = path("again.toml");
    scand(&[
        "calibrate",
        &path("session.mcap"),
        "--fix-intrinsics",
        &path("ros"),
        "--out",
        &again,
    ]);
    let again = RigCalibration::load(Path::new(&again)).unwrap();
    for (id, (camera, _)) in &again.cameras {
        assert_eq!(camera.intrinsics, found.cameras[id].0.intrinsics);
    }
}
