//! Recordings that other programs wrote must load, and their models must be as good as promised. They are not part
//! of scand: these tests find them through SCAND_SHARED_RECORDINGS, or beside the repository, and are skipped
//! without them.

use crate::support::skipped::{Needed, skip};
use assert_cmd::Command;
use scand::capture::{CaptureSession, Silhouette};
use scand::reconstruct::{Scene, SilhouetteSource};
use scand::sync;
use serde_json::{Value, json};
use std::path::PathBuf;

pub fn shared(name: &str) -> Option<PathBuf> {
    let folder = std::env::var_os("SCAND_SHARED_RECORDINGS").map_or_else(
        || PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared/recordings"),
        PathBuf::from,
    );
    let path = folder.join(name);
    if path.is_file() {
        return Some(path);
    }
    skip(
        Needed::OtherRecordings,
        format_args!("{} is not there", path.display()),
    );
    None
}

/// The only capture of a recording.
fn load(name: &str) -> Option<(Scene, scand::capture::CaptureFacts)> {
    let session = CaptureSession::open(&shared(name)?, &sync::Parameters::default()).unwrap();
    assert_eq!(session.damage(), []);
    let captures = session.captures();
    assert_eq!(captures.len(), 1);
    assert_eq!(captures[0].failure, None);
    Some(session.load(&captures[0].id).unwrap())
}

#[test]
fn a_raw_bayer_recording_loads() {
    let Some((scene, facts)) = load("cup.mcap") else {
        return;
    };
    assert_eq!(scene.colors.len(), 11);
    assert_eq!(facts.warnings, Vec::<String>::new());
    assert_eq!(facts.left_out, []);
    assert_eq!(facts.depths[0].color_frames, 30);
    assert_eq!(scene.depths[0].frames.len(), 30);
    let first = &scene.colors[0];
    assert_eq!(first.image.width(), first.camera.intrinsics.width);
    assert!(matches!(
        facts.colors[0].silhouette,
        Silhouette::Background { .. }
    ));
    let readings = scene.depths[0].frames[0].readings.pixels();
    let seen = readings.iter().filter(|&&r| r > 0);
    let mean = seen.clone().map(|&r| f64::from(r)).sum::<f64>() / seen.clone().count() as f64;
    assert!(
        seen.count() > 30_000 && (mean - 890.8).abs() < 0.1,
        "{mean}"
    );
}

#[test]
fn a_jpeg_recording_loads() {
    let Some((scene, _)) = load("bowl_with_fruit.mcap") else {
        return;
    };
    assert_eq!((scene.colors.len(), scene.depths.len()), (11, 1));
    assert_eq!(scene.depths[0].frames.len(), 30);
    assert!((scene.depths[0].camera.response.slope - 0.00104).abs() < 1e-12);
}

#[test]
fn a_recording_of_masks_without_depth_loads() {
    let Some((scene, facts)) = load("dino.mcap") else {
        return;
    };
    assert_eq!((scene.colors.len(), scene.depths.len()), (16, 0));
    assert!(
        facts
            .colors
            .iter()
            .all(|c| c.silhouette == Silhouette::Mask)
    );
    for color in &scene.colors {
        let SilhouetteSource::Mask(mask) = &color.silhouette else {
            panic!("a mask was recorded")
        };
        let inside = mask.pixels().iter().filter(|&&m| m >= 128).count();
        assert!(inside > 1000, "{}", color.camera.id);
    }
}

/// Replays a recording as a user would, and returns the folder of its only capture.
fn replayed(name: &str, out: &std::path::Path) -> Option<PathBuf> {
    let path = shared(name)?;
    Command::cargo_bin("scand")
        .unwrap()
        .args(["--quiet", "--out"])
        .arg(out)
        .arg("--replay")
        .arg(&path)
        .assert()
        .success();
    let mut captures = std::fs::read_dir(out.join(path.file_stem()?)).unwrap();
    Some(captures.next().unwrap().unwrap().path())
}

/// What `scand evaluate` finds of a recording's whole model; also holds it closed and without handles.
fn evaluated(name: &str) -> Option<Value> {
    let out = tempfile::tempdir().unwrap();
    let model = replayed(&format!("{name}.mcap"), out.path())?.join("model.ply");
    let truth = shared(&format!("{name}.truth.ply"))?;
    let answer = Command::cargo_bin("scand")
        .unwrap()
        .args(["evaluate", "--json"])
        .args([&model, &truth])
        .output()
        .unwrap();
    let mut found: Value = serde_json::from_slice(&answer.stdout).unwrap();
    let model = &found["model"];
    assert_eq!(
        (&model["watertight"], &model["components"], &model["genus"]),
        (&json!(true), &json!(1), &json!(0))
    );
    Some(found["whole"].take())
}

/// A recording, the least F-scores of its model at 0.5 and 1 mm, and the most of other figures.
type Floors = (&'static str, [f64; 2], &'static [(&'static str, f64)]);

const FLOORS: [Floors; 3] = [
    (
        "cup",
        [0.88, 0.975],
        &[
            ("/outside_normals/mean_degrees", 3.0),
            ("/concave/mean_mm", 0.36),
        ],
    ),
    (
        "bowl_with_fruit",
        [0.64, 0.82],
        &[
            ("/outside_normals/mean_degrees", 3.5),
            ("/concave/mean_mm", 4.7),
        ],
    ),
    (
        "box",
        [0.9, 0.9],
        &[
            ("/outside_normals/mean_degrees", 4.0),
            ("/edges/mean_mm", 0.15),
            ("/dented_share", 0.005),
        ],
    ),
];

#[test]
fn models_are_as_good_as_promised() {
    for (name, least, most) in FLOORS {
        let Some(found) = evaluated(name) else {
            return;
        };
        let number = |pointer: &str| found.pointer(pointer).and_then(Value::as_f64).unwrap();
        for (i, (least, threshold)) in least.into_iter().zip([0.5, 1.0]).enumerate() {
            assert_eq!(number(&format!("/f_scores/{i}/threshold_mm")), threshold);
            let score = number(&format!("/f_scores/{i}/f_score"));
            assert!(score >= least, "{name} at {threshold} mm: {score}");
        }
        for (pointer, most) in most {
            let value = number(pointer);
            assert!(value <= *most, "{name}{pointer}: {value}");
        }
    }
}

#[test]
fn rough_masks_and_their_hull_agree() {
    let out = tempfile::tempdir().unwrap();
    let Some(folder) = replayed("dino.mcap", out.path()) else {
        return;
    };
    let report = std::fs::read(folder.join("report.json")).unwrap();
    let report: Value = serde_json::from_slice(&report).unwrap();
    let cameras = report["color_cameras"].as_array().unwrap();
    let ious = cameras
        .iter()
        .map(|c| c["consistency"]["iou"].as_f64().unwrap());
    let mean = ious.sum::<f64>() / cameras.len() as f64;
    assert!(cameras.len() == 16 && mean >= 0.961, "{mean}");
}
