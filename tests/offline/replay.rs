//! What `scand --replay` prints, and where it writes.

use crate::desk::Desk;
use assert_cmd::Command;
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

fn scand() -> Command {
    Command::cargo_bin("scand").unwrap()
}

/// Two captures of a ball by small cameras, one of which has been turned since it was calibrated, and a folder for what
/// is made of them.
struct Ball {
    folder: tempfile::TempDir,
}

impl Ball {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let ball = Self { folder };
        let mut simulate = scand();
        #[rustfmt::skip]
        simulate.args([
            "simulate", "--shape", "ball", "--cameras", "5", "--size", "160x120", "--masks", "--depth-cameras", "0",
            "--captures", "2", "--turned", "c01=1.5", "--out",
        ]);
        simulate.arg(ball.path("ball.mcap")).assert().success();
        ball
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn replay(&self, arguments: &[&str]) -> Command {
        let mut command = scand();
        command.arg("--replay").arg(self.path("ball.mcap"));
        command.args(["--set", "hull.resolution=40"]);
        command.args(arguments);
        command
    }

    /// The exit code, and what was told of each capture as JSON.
    fn told(&self, arguments: &[&str]) -> (Option<i32>, Value) {
        let mut command = self.replay(&["--json", "--quiet"]);
        let command = command.args(arguments).arg("--out").arg(self.path("out"));
        let output = command.output().unwrap();
        let told = String::from_utf8(output.stdout).unwrap();
        let lines = told.lines().map(|line| serde_json::from_str(line).unwrap());
        (output.status.code(), Value::Array(lines.collect()))
    }
}

#[test]
fn a_red_verdict_is_one_the_second_time_as_well() {
    let ball = Ball::new();
    let (code, first) = ball.told(&["--strict"]);
    assert_eq!(code, Some(1), "{first:#}");
    let (code, second) = ball.told(&["--strict"]);
    assert_eq!(code, Some(1), "{second:#}");
    for (before, after) in [0, 1].map(|k| (&first[k], &second[k])) {
        assert_eq!(before["result"], "done");
        assert_eq!(after["result"], "unchanged");
        assert_eq!(after["verdict"], "red");
        assert_eq!(before["verdict"], after["verdict"]);
        assert_eq!(before["reasons"], after["reasons"]);
        assert!(!after["reasons"].as_array().unwrap().is_empty());
    }
    assert_eq!(ball.told(&[]).0, Some(0), "only --strict makes it fail");
}

#[test]
fn a_capture_that_is_named_twice_is_made_once() {
    let ball = Ball::new();
    let twice = ["ball-001", "ball-000", "ball-001"];
    let arguments = twice.iter().flat_map(|id| ["--capture", id]);
    let arguments: Vec<&str> = arguments.chain(["--jobs", "3"]).collect();
    let (code, told) = ball.told(&arguments);
    assert_eq!(code, Some(0), "{told:#}");
    // Each is told as soon as it has ended.
    let made = told.as_array().unwrap().iter();
    let made: BTreeSet<&str> = made.map(|c| c["capture"].as_str().unwrap()).collect();
    assert_eq!(told.as_array().unwrap().len(), 2, "{told:#}");
    assert_eq!(made, BTreeSet::from(["ball-000", "ball-001"]));
}

#[test]
fn parts_that_share_the_work_make_each_capture_once() {
    let folder = tempfile::tempdir().unwrap();
    let sessions = folder.path().join("sessions");
    std::fs::create_dir(&sessions).unwrap();
    for name in ["a.mcap", "b.mcap"] {
        let mut simulate = scand();
        #[rustfmt::skip]
        simulate.args([
            "simulate", "--shape", "ball", "--cameras", "4", "--size", "96x72", "--masks", "--depth-cameras", "0",
            "--captures", "3", "--out",
        ]);
        simulate.arg(sessions.join(name)).assert().success();
    }
    std::fs::write(sessions.join("c.mcap"), b"no recording").unwrap();
    let run = |part: &str, out: &Path| {
        let mut command = scand();
        command.arg("--replay").arg(&sessions).arg("--out").arg(out);
        command.args([
            "--set",
            "hull.resolution=40",
            "--quiet",
            "--json",
            "--shard",
            part,
        ]);
        let output = command.output().unwrap();
        let told = String::from_utf8(output.stdout).unwrap();
        let told = told
            .lines()
            .map(|line| serde_json::from_str::<Value>(line).unwrap());
        let of = |told: Value| (told["recording"].to_string(), told["capture"].to_string());
        (output.status.code(), told.map(of).collect::<Vec<_>>())
    };
    let [whole, parts] = ["whole", "parts"].map(|name| folder.path().join(name));
    let (code, all) = run("1/1", &whole);
    assert_eq!((code, all.len()), (Some(3), 7), "{all:?}");
    let mut together = Vec::new();
    for part in ["1/3", "2/3", "3/3"] {
        together.extend(run(part, &parts).1);
    }
    together.sort();
    let mut all = all;
    all.sort();
    assert_eq!(together, all, "each once, the unreadable recording too");
    let models = |out: &Path| {
        let ids = ["a/ball", "b/ball"]
            .iter()
            .flat_map(|of| (0..3).map(move |i| format!("{of}-00{i}")));
        let of = |id: String| {
            let files =
                ["model.glb", "model.ply", "preview.png"].map(|file| out.join(&id).join(file));
            files.map(|file| std::fs::read(file).unwrap())
        };
        ids.map(of).collect::<Vec<_>>()
    };
    assert!(models(&whole) == models(&parts));
    // A part without a capture has done all that there was.
    let (codes, told): (Vec<_>, Vec<_>) = (1..=40).map(|i| run(&format!("{i}/40"), &parts)).unzip();
    for (code, told) in codes.iter().zip(&told) {
        assert_eq!(
            *code == Some(0),
            told.iter().all(|(of, _)| !of.contains("c.mcap"))
        );
    }
    assert_eq!(told.concat().len(), 7);
}

#[test]
fn a_model_of_a_doubtful_calibration_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let simulate = |name: &str, more: &[&str]| {
        let mut command = scand();
        #[rustfmt::skip]
        command.args([
            "simulate", "--shape", "ball", "--cameras", "4", "--size", "96x72", "--masks", "--depth-cameras", "0",
        ]);
        command.args(more).arg("--out").arg(path(name));
        command.assert().success();
    };
    let reason = "camera c02 moved by 0.70°";
    simulate("sound.mcap", &[]);
    simulate("doubtful.mcap", &["--doubtful-calibration", reason]);
    let model = |name: &str, more: &[&str]| -> (Option<String>, String) {
        let out = tempfile::tempdir().unwrap();
        let mut command = scand();
        command
            .arg("--replay")
            .arg(path(name))
            .arg("--out")
            .arg(out.path());
        command.args(["--quiet", "--set", "hull.resolution=20"]);
        command.args(["--set", "verdict.hull_is_wanted=true"]);
        command.args(more).assert().success();
        let folder = out.path().join(Path::new(name).file_stem().unwrap());
        let report = std::fs::read(folder.join("ball-000/report.json")).unwrap();
        let report: Value = serde_json::from_slice(&report).unwrap();
        let reasons = report["verdict"]["reasons"].as_array().unwrap();
        let mut told = reasons
            .iter()
            .filter(|r| r["code"] == "calibration_doubtful");
        let told = told
            .next()
            .map(|r| format!("{} {}", r["level"], r["words"]));
        (told, report["digest"].to_string())
    };
    let (said, digest) = model("sound.mcap", &[]);
    assert_eq!(said, None);
    let (said, doubted) = model("doubtful.mcap", &[]);
    let words = format!("\"amber\" \"the calibration is doubtful: {reason}\"");
    assert_eq!(said, Some(words));
    assert_ne!(digest, doubted, "the verdict is part of the digest");
    // The calibration of the same cameras that does not say what it is worth takes the doubt away; exported, it stays.
    let export = |name: &str, file: &str| {
        let mut command = scand();
        command
            .args(["calibrate", "--quiet", "--from"])
            .arg(path(name));
        command.arg("--out").arg(path(file)).assert().success();
        path(file).to_str().unwrap().to_owned()
    };
    let unknown = export("sound.mcap", "unknown.toml");
    let known = export("doubtful.mcap", "known.toml");
    assert_eq!(
        model("doubtful.mcap", &["--calibration", &unknown]),
        (None, digest)
    );
    let (said, again) = model("sound.mcap", &["--calibration", &known]);
    assert!(said.unwrap().contains(reason));
    assert_eq!(again, doubted);
}

/// Refuses a text that tells the system's reason more than once.
fn told_once(output: &std::process::Output, file: &Path) {
    let words = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success(), "{words}");
    assert!(words.contains(file.to_str().unwrap()), "{words}");
    let told = words.lines().filter(|line| line.contains("os error"));
    let told: Vec<usize> = told.map(|line| line.matches("os error").count()).collect();
    assert!(!told.is_empty() && told.iter().all(|&n| n == 1), "{words}");
}

#[test]
fn what_the_system_says_is_told_once() {
    let ball = Ball::new();
    let none = ball.path("none");
    for option in ["--calibration", "--config"] {
        let mut replay = ball.replay(&[option]);
        told_once(&replay.arg(&none).output().unwrap(), &none);
    }
    let file = ball.path("file");
    std::fs::write(&file, "").unwrap();
    let mut replay = ball.replay(&["--quiet", "--out"]);
    let below_a_file = replay.arg(file.join("out")).output().unwrap();
    told_once(&below_a_file, &file);
    let mut evaluate = scand();
    let model = ball.path("none.ply");
    let evaluated = evaluate.arg("evaluate").args([&model, &model]).output();
    told_once(&evaluated.unwrap(), &model);
}

/// All that is made, by its path below `out`, but for what reports say of time.
fn made(out: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut made = BTreeMap::new();
    for id in ["ball-000", "ball-001"] {
        for file in std::fs::read_dir(out.join("ball").join(id)).unwrap() {
            let path = file.unwrap().path();
            let mut bytes = std::fs::read(&path).unwrap();
            if path.ends_with("report.json") {
                let mut report: Value = serde_json::from_slice(&bytes).unwrap();
                assert!(report.as_object_mut().unwrap().remove("timing").is_some());
                bytes = report.to_string().into_bytes();
            }
            made.insert(path.strip_prefix(out).unwrap().into(), bytes);
        }
    }
    made
}

#[test]
fn the_same_bytes_whatever_the_number_of_jobs() {
    let ball = Ball::new();
    let of = |jobs: &str, threads: &str| {
        let out = ball.path(&format!("out-{jobs}-{threads}"));
        let mut replay = ball.replay(&["--quiet", "--jobs", jobs, "--out"]);
        replay.env("RAYON_NUM_THREADS", threads);
        replay.arg(&out).assert().success();
        made(&out)
    };
    let one = of("1", "1");
    for file in ["model.glb", "model.ply", "preview.png", "report.json"] {
        assert!(
            one.contains_key(&Path::new("ball/ball-001").join(file)),
            "{file}"
        );
    }
    for (jobs, threads) in [("2", "2"), ("3", "5")] {
        assert!(of(jobs, threads) == one, "{jobs} jobs, {threads} threads");
    }
}

#[test]
fn what_is_there_is_replaced_with_force_alone() {
    let ball = Ball::new();
    assert_eq!(ball.told(&[]).0, Some(0));
    let model = ball.path("out/ball/ball-000/model.ply");
    let before = std::fs::read(&model).unwrap();
    let fewer = ["--vertices", "200"];
    let (code, told) = ball.told(&fewer);
    assert_eq!(code, Some(1), "{told:#}");
    assert_eq!(std::fs::read(&model).unwrap(), before);
    let (code, told) = ball.told(&[&fewer[..], &["--force"]].concat());
    assert_eq!(code, Some(0), "{told:#}");
    assert!(std::fs::read(&model).unwrap().len() < before.len() / 2);
}

#[test]
fn two_recordings_of_one_name_are_refused_before_anything_is_made() {
    let ball = Ball::new();
    let other = ball.path("other/ball.mcap");
    std::fs::create_dir(other.parent().unwrap()).unwrap();
    std::fs::copy(ball.path("ball.mcap"), &other).unwrap();
    let mut replay = ball.replay(&["--out"]);
    let refused = replay.arg(ball.path("out")).arg("--replay").arg(&other);
    let refused = refused.output().unwrap();
    let words = String::from_utf8_lossy(&refused.stderr);
    assert!(!refused.status.success());
    assert!(
        words.contains("other/ball.mcap") && words.contains("the same name"),
        "{words}"
    );
    assert!(!ball.path("out").exists());
}

/// Multiplies the places of all cameras, as a calibration does whose board was told too large.
fn scaled(calibration: &toml::Table, times: f64) -> toml::Table {
    let mut scaled = calibration.clone();
    let cameras = scaled["cameras"].as_table_mut().unwrap();
    for (_, camera) in cameras.iter_mut() {
        for length in camera["translation"].as_array_mut().unwrap() {
            *length = toml::Value::Float(times * length.as_float().unwrap());
        }
    }
    scaled
}

#[test]
fn a_calibration_of_another_size_gives_a_red_model() {
    let desk = Desk::new();
    let recording = concat!(env!("CARGO_MANIFEST_DIR"), "/recordings/cup.mcap");
    desk.done(&["info", recording, "--calibration", "own.toml"]);
    let own = std::fs::read_to_string(desk.path("own.toml")).unwrap();
    let own: toml::Table = own.parse().unwrap();
    for times in [0.97, 1.04, 1.08, 2.0] {
        let (file, out) = (format!("{times}.toml"), format!("out-{times}"));
        let text = scaled(&own, times).to_string();
        assert_ne!(text, own.to_string());
        std::fs::write(desk.path(&file), text).unwrap();
        #[rustfmt::skip]
        desk.done(&["replay", recording, "-q", "--calibration", &file, "--out", &out, "--set", "hull.resolution=80"]);
        let report = std::fs::read(desk.path(&out).join("cup/cup-000/report.json")).unwrap();
        let report: serde_json::Value = serde_json::from_slice(&report).unwrap();
        let verdict = &report["verdict"];
        assert_eq!(verdict["level"], "red", "{times}: {verdict:#}");
        let reasons = verdict["reasons"].as_array().unwrap();
        let is_named = reasons
            .iter()
            .any(|reason| reason["code"] == "depth_biased");
        assert!(is_named, "{times}: {verdict:#}");
    }
}

/// Makes a model of a recording with focal lengths of some cameras that are `times` as long, and returns the reasons of
/// its verdict.
fn reasons_with_focal(
    desk: &Desk,
    recording: &str,
    times: f64,
    is_wrong: fn(&str) -> bool,
) -> Vec<Value> {
    let (file, out) = (format!("{times}.toml"), format!("out-{times}"));
    desk.done(&["info", recording, "--calibration", &file]);
    let mut calibration: toml::Table = std::fs::read_to_string(desk.path(&file))
        .unwrap()
        .parse()
        .unwrap();
    let cameras = calibration["cameras"].as_table_mut().unwrap();
    for (_, camera) in cameras.iter_mut().filter(|(name, _)| is_wrong(name)) {
        for length in camera["focal_px"].as_array_mut().unwrap() {
            *length = toml::Value::Float(times * length.as_float().unwrap());
        }
    }
    std::fs::write(desk.path(&file), calibration.to_string()).unwrap();
    #[rustfmt::skip]
    desk.done(&["replay", recording, "-q", "--calibration", &file, "--out", &out, "--set", "hull.resolution=80"]);
    let name = Path::new(recording).file_stem().unwrap();
    let model = std::fs::read_dir(desk.path(&out).join(name))
        .unwrap()
        .next()
        .unwrap()
        .unwrap();
    let report = std::fs::read(model.path().join("report.json")).unwrap();
    let report: Value = serde_json::from_slice(&report).unwrap();
    report["verdict"]["reasons"].as_array().unwrap().clone()
}

/// Holds that a reason is there, and amber, exactly if it has to be.
fn hold_amber(reasons: &[Value], code: &str, is_expected: bool) {
    let found = reasons.iter().find(|reason| reason["code"] == code);
    assert_eq!(found.is_some(), is_expected, "{code}: {reasons:#?}");
    if let Some(found) = found {
        assert_eq!(found["level"], "amber");
        assert_eq!(found["cameras"][0], "kinect");
    }
}

#[test]
fn a_depth_camera_of_another_focal_length_is_named() {
    let desk = Desk::new();
    let recording = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/recordings/bowl_with_fruit.mcap"
    );
    for (times, is_wrong) in [(0.94, true), (1.0, false), (1.06, true)] {
        let reasons = reasons_with_focal(&desk, recording, times, |name| name == "kinect");
        hold_amber(&reasons, "depth_outline", is_wrong);
    }
}

#[test]
fn colour_cameras_of_other_focal_lengths_are_told_by_where_depth_has_the_surface() {
    let desk = Desk::new();
    let path = desk.path("egg.mcap");
    let recording = path.to_str().unwrap();
    #[rustfmt::skip]
    desk.done(&["simulate", "--shape", "egg", "--size", "640x480", "--seed", "4", "--out", recording]);
    for (times, is_wrong) in [(0.92, true), (1.0, false), (1.05, true)] {
        let reasons = reasons_with_focal(&desk, recording, times, |name| name != "kinect");
        hold_amber(&reasons, "depth_elsewhere", is_wrong);
    }
}
