//! Which captures of an object count: those that cannot be used are left out by name and take no model away, a copy
//! counts once, and a file of poses fits whichever of them are left out.

use super::session;
use crate::desk::{Desk, said};
use crate::hostile::recording::ball as recorded_ball;
use scand::capture::CaptureSession;
use scand::config::Config;
use scand::frame::CaptureId;
use scand::make_model::{ModelMaker, ObjectOutcome, ObjectRequest, Settings, Source};
use scand::recording::Compression;
use scand_lab::{Options, Shape, Simulation, write};
use std::path::Path;

/// Records a session.
fn record(options: Options, path: &Path) {
    let simulation = Simulation::new(options).unwrap();
    write(&simulation, path, Compression::None).unwrap();
}

/// A session of one capture of a ball, or of the table without it.
fn ball(is_empty: bool) -> Options {
    let mut options = Options {
        subject: Some("17".into()),
        ..Options::small(Shape::Ball)
    };
    options.faults.empty_table = is_empty;
    options
}

#[test]
fn only_a_capture_that_is_not_there_is_said_not_to_be_there() {
    let desk = Desk::new();
    let usual = ["fuse", "ball.mcap", "--capture", "ball-000"];
    let refused = |name: &[&str], words: &str| {
        let fused = desk.run(&[&usual[..], name].concat());
        let told = said(&fused);
        assert_eq!(fused.status.code(), Some(1), "{told}");
        assert!(told.contains(words), "{told}");
    };
    refused(
        &["--capture", "bowl"],
        "there is no capture \"bowl\"; the captures here: \"ball-000\", \"ball-001\"",
    );
    refused(
        &["--upright", "ball-001"],
        "capture \"ball-001\" is not among those that can be used",
    );
}

#[test]
fn an_empty_table_that_was_taken_for_an_object_is_left_out_by_name() {
    let desk = Desk::new();
    record(
        session(Shape::Mug, false, 640, "upright,flip", 1),
        &desk.path("turned.mcap"),
    );
    record(ball(true), &desk.path("zempty.mcap"));
    let fused = desk.run(&[
        "fuse",
        "turned.mcap",
        "zempty.mcap",
        "--subject",
        "17",
        "--json",
    ]);
    let words = said(&fused);
    assert_eq!(fused.status.code(), Some(3), "{words}");
    let told: serde_json::Value = serde_json::from_slice(&fused.stdout).unwrap();
    let captures = told["fusion"]["captures"].as_array().unwrap();
    let of = |name: &str| -> Vec<String> { captures.iter().map(|c| c[name].to_string()).collect() };
    let mut refused = of("refused");
    refused.sort();
    assert_eq!(refused, ["\"unusable\"", "null", "null"], "{words}");
    assert!(words.contains("ball-000: it cannot be used: "), "{words}");
    let object = |stem: &str| desk.path(&format!("out/{stem}/17.object/model.glb"));
    assert!(object("turned").is_file() || object("zempty").is_file());
}

#[test]
fn what_cannot_be_used_takes_no_model_away() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    record(ball(false), &at("one.mcap"));
    record(ball(true), &at("two.mcap"));
    let config = Config::load(None, &[]).unwrap();
    let settings = Settings {
        reconstruction: config.reconstruction(),
        verdict: config.verdict.clone(),
        glb: config.glb.clone(),
        text: config.replay_toml().unwrap(),
    };
    let [one, two] =
        ["one.mcap", "two.mcap"].map(|name| CaptureSession::open(&at(name), &config.sync).unwrap());
    let id = CaptureId::new("ball-000").unwrap();
    let source = |session| Source { session, id: &id };
    let maker = ModelMaker {
        settings: &settings,
        calibration: None,
        force: false,
        folder: at("models"),
        on_stage: &|_, _| {},
    };
    let make = |sources: &[Source], subject: &str| {
        let request = ObjectRequest {
            subject,
            replaces: true,
            ..ObjectRequest::default()
        };
        maker.make_object(sources, &request)
    };
    let made = make(&[source(&one)], "17");
    assert!(matches!(made, ObjectOutcome::Made { .. }), "{made:?}");
    let failed = |sources: &[Source], words: [&str; 2]| {
        let ObjectOutcome::Failed { reason, .. } = make(sources, "17") else {
            panic!("a model was made");
        };
        assert!(words.iter().all(|w| reason.contains(w)), "{reason}");
        let model = at("models/17.object/model.glb");
        assert!(model.is_file(), "{reason}");
    };
    let stays = "the model that was made before stays";
    failed(&[source(&one), source(&two)], ["it cannot be used", stays]);
    failed(&[source(&two)], ["", stays]);
    failed(&[source(&one); 25], ["25 captures", stays]);
    // A model whose report was lost or broken is one, too.
    let report = at("models/17.object/report.json");
    std::fs::write(&report, "{").unwrap();
    failed(&[source(&two)], ["", stays]);
    std::fs::remove_file(&report).unwrap();
    failed(&[source(&two)], ["", stays]);
    // Poses are not looked for either.
    let request = ObjectRequest::default();
    assert!(
        maker
            .register_object(&[source(&one); 25], &request)
            .is_err()
    );
    // Where there was no model, the report says why.
    let none = make(&[source(&one), source(&two)], "18");
    assert!(matches!(none, ObjectOutcome::Failed { .. }), "{none:?}");
    let report = std::fs::read_to_string(at("models/18.object/report.json")).unwrap();
    assert!(report.contains("it cannot be used"), "{report}");
}

#[test]
fn a_copy_of_a_recording_adds_no_capture() {
    let desk = Desk::new();
    std::fs::copy(desk.path("ball.mcap"), desk.path("copy.mcap")).unwrap();
    #[rustfmt::skip]
    let fuse = |recordings: &[&str], out: &str| {
        let last = ["--capture", "ball-000", "--set", "hull.resolution=40", "-q", "--out", out];
        desk.done(&[&["fuse"][..], recordings, &last].concat());
        let folder = desk.path(out).join("ball/ball-000.object");
        let report = std::fs::read_to_string(folder.join("report.json")).unwrap();
        (std::fs::read(folder.join("model.glb")).unwrap(), report)
    };
    let (alone, _) = fuse(&["ball.mcap"], "alone");
    let (both, report) = fuse(&["copy.mcap", "ball.mcap"], "both");
    assert!(alone == both);
    assert!(
        report.contains("capture ball-000 of copy.mcap is the same as that of ball.mcap"),
        "{report}"
    );
}

#[test]
fn a_file_of_poses_fits_whether_or_not_a_capture_was_rejected() {
    let desk = Desk::new();
    desk.tell("ball.mcap", &[("subject", "17")]);
    let pose = "[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]";
    let far = "[[1,0,0,5],[0,1,0,0],[0,0,1,0],[0,0,0,1]]";
    let fuse = |poses: &[&str]| {
        let poses = format!("{{\"rig_from_object\":[{}]}}", poses.join(","));
        std::fs::write(desk.path("poses.json"), poses).unwrap();
        #[rustfmt::skip]
        let fused = desk.run(&[
            "fuse", "ball.mcap", "--subject", "17", "--poses", "poses.json", "--set", "hull.resolution=40", "-q", "-f",
        ]);
        (fused.status.code(), said(&fused))
    };
    // The pose of the second one is not right: nothing else was tried.
    let (code, words) = fuse(&[pose, far]);
    assert_eq!(code, Some(1), "{words}");
    assert!(words.contains("in the pose that was given"), "{words}");
    desk.done(&["note", "ball-001", "reject", "--recording", "ball.mcap"]);
    for poses in [&[pose, far][..], &[pose]] {
        let (code, words) = fuse(poses);
        assert_eq!(code, Some(0), "{words}");
    }
    let (code, words) = fuse(&[pose, pose, pose]);
    assert_eq!(code, Some(1), "{words}");
    assert!(
        words.contains("3 poses for 2 captures of the object") && words.contains("each of the 1 "),
        "{words}"
    );
}

/// Records one capture of a ball, which has this name and this subject.
fn record_as(path: &Path, id: &str, subject: &str) {
    let recorded = recorded_ball().with_json("/trigger", |trigger| {
        trigger["id"] = id.into();
        trigger["subject"] = subject.into();
    });
    recorded.write(path, None);
}

#[test]
fn a_subject_of_any_length_has_a_folder_but_never_that_of_a_capture() {
    let desk = Desk::new();
    let fuse = |recording: &str, subject: &str| {
        #[rustfmt::skip]
        let arguments = ["fuse", recording, "--subject", subject, "--set", "hull.resolution=40", "-q"];
        let ended = desk.run(&arguments);
        (ended.status.code(), said(&ended))
    };
    let long = "../".repeat(1366);
    record_as(&desk.path("long.mcap"), "ball-000", &long);
    let (code, words) = fuse("long.mcap", &long);
    assert_eq!(code, Some(0), "{words}");
    let entries = std::fs::read_dir(desk.path("out/long")).unwrap();
    let names = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap());
    let names: Vec<String> = names.filter(|name| !name.starts_with('.')).collect();
    let [name] = &names[..] else {
        panic!("{names:?}");
    };
    assert!(name.len() == 200 && name.ends_with(".object"), "{name}");
    assert!(desk.path(&format!("out/long/{name}/model.glb")).is_file());
    // One that begins alike is another object.
    let (code, words) = fuse("long.mcap", &long[3..]);
    assert_eq!(code, Some(1), "{words}");
    assert!(words.contains("no capture of subject"), "{words}");

    record_as(&desk.path("taken.mcap"), "17.object", "17");
    let (code, words) = fuse("taken.mcap", "17");
    assert_eq!(code, Some(1), "{words}");
    let why = "a capture of this recording has this name";
    assert!(words.contains(why), "{words}");
    assert!(!desk.path("out/taken/17.object").exists());
}
