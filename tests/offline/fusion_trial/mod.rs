//! Sessions of one object in several poses, rendered, recorded and fused by the command, and held against the truth: no
//! pose may be stated with confidence that is wrong, and what is not one object is not fused. `make fusion-trial` runs
//! ten shapes and prints a line for each session, or only those whose name has the word in `ONLY`; the tests run
//! a few small ones.

mod bytes;
mod captures;
mod given;
mod negatives;
mod poses;
mod score;

use assert_cmd::Command;
use scand::evaluate::load::load;
use scand::mesh::volume_and_total_area;
use scand::recording::Compression;
use scand_lab::{DepthSensor, Encoding, Options, Pose, Shape, Simulation, write};
use serde_json::Value;
use std::path::PathBuf;

/// The object's number in all sessions.
const SUBJECT: &str = "17";

/// Whether a session of the trial is to be run: all are, unless `ONLY` holds a word, which then is in its name.
fn is_wanted(name: &str) -> bool {
    std::env::var("ONLY").map_or(true, |word| name.contains(&word))
}

/// Poses as words.
fn poses(words: &str) -> Vec<Pose> {
    words.split(',').map(|word| word.parse().unwrap()).collect()
}

/// A session of eleven cameras of `width` pixels whose calibration is off by 0.15 px.
fn session(shape: Shape, textured: bool, width: usize, words: &str, seed: u64) -> Options {
    let mut options = Options {
        shape,
        textured,
        seed,
        width,
        height: width * 3 / 4,
        poses: poses(words),
        subject: Some(SUBJECT.to_owned()),
        depth: DepthSensor {
            frames: 10,
            color_every: 5,
            ..DepthSensor::default()
        },
        ..Options::default()
    };
    options.color.encoding = Encoding::Jpeg;
    options.faults.calibration_px = 0.15;
    options
}

/// What became of a session.
struct Fused {
    simulation: Simulation,
    code: Option<i32>,
    /// The report of the object, if there is one.
    report: Option<Value>,
    /// What was said.
    words: String,
    /// Whether there is a model.
    has_model: bool,
    /// Its volume, in cubic metres.
    volume: Option<f64>,
}

/// Renders a session and fuses its captures.
fn fuse(options: Options) -> Fused {
    let folder = tempfile::tempdir().unwrap();
    let simulation = Simulation::new(options).unwrap();
    let recording = folder.path().join("turned.mcap");
    write(&simulation, &recording, Compression::None).unwrap();
    let mut command = Command::new(assert_cmd::cargo::cargo_bin!("scand"));
    command
        .current_dir(folder.path())
        .arg("fuse")
        .arg(&recording);
    let ended = command
        .args(["--subject", SUBJECT, "--out", "out"])
        .output()
        .unwrap();
    let object: PathBuf = folder.path().join(format!("out/turned/{SUBJECT}.object"));
    let report = std::fs::read(object.join("report.json")).ok();
    let said = [ended.stdout, ended.stderr].concat();
    let model = object.join("model.ply");
    let model = model.exists().then(|| load(&model).unwrap().mesh);
    Fused {
        volume: model.map(|mesh| volume_and_total_area(&mesh).0),
        simulation,
        code: ended.status.code(),
        report: report.map(|bytes| serde_json::from_slice(&bytes).unwrap()),
        words: String::from_utf8_lossy(&said).into_owned(),
        has_model: object.join("model.glb").exists(),
    }
}

impl Fused {
    /// The report's word of each capture, in the order of their triggers.
    fn captures(&self) -> Vec<&Value> {
        let listed = self
            .report
            .as_ref()
            .and_then(|report| report["fusion"]["captures"].as_array());
        let mut captures: Vec<&Value> = listed.into_iter().flatten().collect();
        captures.sort_by_key(|capture| capture["id"].as_str().unwrap_or_default().to_owned());
        captures
    }
}

#[test]
#[ignore = "minutes: make fusion-trial"]
fn ten_shapes_in_random_poses() {
    let count = std::env::var("N")
        .ok()
        .and_then(|n| n.parse().ok())
        .unwrap_or(10);
    let wrong = [
        poses::trial(count),
        poses::hollow_trial(),
        negatives::trial(),
    ];
    assert!(wrong.iter().all(Vec::is_empty), "{wrong:?}");
}
