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

fn shared(name: &str) -> Option<PathBuf> {
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

/// Whole model's F-score at 1 mm and mean error of the concave part in mm; also holds it closed and without handles.
fn scores(name: &str) -> Option<(f64, f64)> {
    let out = tempfile::tempdir().unwrap();
    let model = replayed(&format!("{name}.mcap"), out.path())?.join("model.ply");
    let truth = shared(&format!("{name}.truth.ply"))?;
    let answer = Command::cargo_bin("scand")
        .unwrap()
        .args(["evaluate", "--json"])
        .args([&model, &truth])
        .output()
        .unwrap();
    let found: Value = serde_json::from_slice(&answer.stdout).unwrap();
    let model = &found["model"];
    assert_eq!(
        (&model["watertight"], &model["components"], &model["genus"]),
        (&json!(true), &json!(1), &json!(0))
    );
    let whole = &found["whole"];
    let f_score = &whole["f_scores"][1];
    assert_eq!(f_score["threshold_mm"], 1.0);
    Some((
        f_score["f_score"].as_f64()?,
        whole["concave"]["mean_mm"].as_f64()?,
    ))
}

#[test]
fn cavities_are_restored() {
    for (name, least_f_score, most_concave_mm) in
        [("cup", 0.95, 0.5), ("bowl_with_fruit", 0.76, 4.9)]
    {
        let Some((f_score, concave_mm)) = scores(name) else {
            return;
        };
        assert!(
            f_score >= least_f_score && concave_mm <= most_concave_mm,
            "{name}: {f_score} {concave_mm}"
        );
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
    assert!(cameras.len() == 16 && mean >= 0.95, "{mean}");
}
