//! Sessions of one object in several poses, rendered, recorded and fused by the command, and held against the truth: no
//! pose may be stated with confidence that is wrong, and what is not one object is not fused. `make fusion-trial` runs
//! ten shapes and prints a line for each session, or only those whose name has the word in `ONLY`; the tests run
//! a few small ones. `shared` does the same with sessions of another renderer.

mod bytes;
mod calibrations;
mod captures;
mod gain;
mod gaps;
mod given;
mod lids;
mod many_views;
mod negatives;
mod outputs;
mod poses;
mod rings;
mod score;
mod shared;
mod surface;

use assert_cmd::Command;
use gaps::Gaps;
use nalgebra::Isometry3;
use scand::evaluate::load::load;
use scand::mesh::Mesh;
use scand::recording::Compression;
use scand_lab::{DepthSensor, Encoding, Options, Pose, Shape, Simulation, write};
use serde_json::Value;
use std::path::PathBuf;
use std::sync::Arc;
use surface::Scores;
use tempfile::TempDir;

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

/// A session that was rendered, with its recording.
struct Recorded {
    folder: TempDir,
    simulation: Arc<Simulation>,
}

/// What became of a session.
struct Fused {
    simulation: Arc<Simulation>,
    code: Option<i32>,
    /// The report of the object, if there is one.
    report: Option<Value>,
    /// What was said.
    words: String,
    /// Whether there is a model.
    has_model: bool,
    /// Its surface.
    model: Option<Mesh>,
}

impl Recorded {
    /// Renders a session and records it as `turned.mcap`.
    fn new(options: Options) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let simulation = Simulation::new(options).unwrap();
        write(
            &simulation,
            &folder.path().join("turned.mcap"),
            Compression::None,
        )
        .unwrap();
        Self {
            folder,
            simulation: Arc::new(simulation),
        }
    }

    /// Fuses what is wanted into the folder `out`, where the object is called `name`.
    fn fuse(&self, out: &str, name: &str, wanted: &[&str]) -> Fused {
        let mut command = Command::new(assert_cmd::cargo::cargo_bin!("scand"));
        command.current_dir(self.folder.path());
        command.args(["fuse", "turned.mcap", "--out", out]);
        let ended = command.args(wanted).output().unwrap();
        let object: PathBuf = self.folder.path().join(out).join("turned");
        let object = object.join(format!("{name}.object"));
        let report = std::fs::read(object.join("report.json")).ok();
        let said = [ended.stdout, ended.stderr].concat();
        let model = object.join("model.ply");
        Fused {
            simulation: Arc::clone(&self.simulation),
            code: ended.status.code(),
            report: report.map(|bytes| serde_json::from_slice(&bytes).unwrap()),
            words: String::from_utf8_lossy(&said).into_owned(),
            has_model: object.join("model.glb").exists(),
            model: model.exists().then(|| load(&model).unwrap().mesh),
        }
    }

    /// Fuses all captures, whose poses are to be found.
    fn found(&self) -> Fused {
        self.fuse("out", SUBJECT, &["--subject", SUBJECT])
    }
}

/// Renders a session and fuses its captures.
fn fuse(options: Options) -> Fused {
    Recorded::new(options).found()
}

impl Fused {
    /// A report of a mug, made up.
    fn told(report: Value) -> Self {
        Self {
            simulation: Arc::new(Simulation::new(Options::small(Shape::Mug)).unwrap()),
            code: Some(0),
            report: Some(report),
            words: String::new(),
            has_model: false,
            model: None,
        }
    }

    /// How good the model is, if there is one.
    fn scores(&self) -> Option<Scores> {
        let model = self.model.as_ref()?;
        Some(Scores::of(model, &self.truth_in_frame()))
    }

    /// The object's true surface in the model's frame: the rig's at the capture that the report names, which is not the
    /// first one where that was left out.
    fn truth_in_frame(&self) -> Mesh {
        let named = self
            .report
            .as_ref()
            .map(|report| &report["fusion"]["frame_of"]);
        let is_named = |capture: &&Value| Some(&capture["id"]) == named;
        let index = self.captures().iter().position(is_named).unwrap_or(0);
        let pose: Isometry3<f32> = self.simulation.rig_from_object(index).cast();
        let truth = self.simulation.truth();
        Mesh {
            vertices: truth.vertices.iter().map(|v| pose * v).collect(),
            triangles: truth.triangles.clone(),
        }
    }

    /// The largest own noise of its captures.
    fn own_noise_mm(&self) -> f64 {
        let captures = self.captures();
        let noises = captures.iter().filter_map(|c| c["own_noise_mm"].as_f64());
        noises.fold(0.0, f64::max)
    }

    /// The last line of what was said.
    fn last_words(&self) -> &str {
        self.words.lines().last().unwrap_or_default()
    }

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
    let mut gaps = Gaps::default();
    let wrong = [
        poses::trial(count, &mut gaps),
        poses::large_trial(),
        poses::hollow_trial(),
        negatives::trial(&mut gaps),
        rings::trial(),
        calibrations::trial(),
        gain::trial(),
    ];
    gaps.print();
    let wrong = wrong.concat();
    println!("not as they must be: {wrong:?}");
    assert!(wrong.is_empty(), "{wrong:?}");
}
