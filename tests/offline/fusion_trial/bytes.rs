//! The bytes of fused models: the same whatever the order of arguments, the number of threads and what was killed
//! before, and those of the capture's own model where there is one.

use super::session;
use scand::recording::Compression;
use scand_lab::{Options, Shape, Simulation, write};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

struct Place(tempfile::TempDir);

impl Place {
    fn new(options: Options) -> Self {
        let place = Self(tempfile::tempdir().unwrap());
        let simulation = Simulation::new(options).unwrap();
        write(&simulation, &place.path("turned.mcap"), Compression::None).unwrap();
        place
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn scand(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(assert_cmd::cargo::cargo_bin!("scand"));
        command.current_dir(self.0.path()).args(arguments);
        command
    }

    fn run(&self, arguments: &[&str], threads: &str) {
        let mut command = self.scand(arguments);
        let ended = command.env("RAYON_NUM_THREADS", threads).output().unwrap();
        let said = String::from_utf8_lossy(&ended.stderr);
        assert!(ended.status.success(), "{arguments:?}: {said}");
    }
}

fn models(folder: &Path) -> [Vec<u8>; 2] {
    ["model.glb", "model.ply"].map(|name| std::fs::read(folder.join(name)).unwrap())
}

/// A subject that is no name of a file.
const ODD: &str = "../\u{e4} 17";

#[test]
fn of_one_capture_they_are_its_own_in_a_folder_named_after_any_subject() {
    let place = Place::new(Options {
        subject: Some(ODD.to_owned()),
        ..Options::small(Shape::Mug)
    });
    place.run(&["replay", "turned.mcap", "--out", "out", "--quiet"], "2");
    let fuse = |subject: &'static str| {
        [
            "fuse",
            "turned.mcap",
            "--subject",
            subject,
            "--out",
            "out",
            "--quiet",
        ]
    };
    place.run(&fuse(ODD), "1");
    let own = models(&place.path("out/turned/mug-000"));
    let fused = models(&place.path("out/turned/%2E.%2F%C3%A4%2017.object"));
    assert!(own == fused);
    let refused = |subject, code: i32, word: &str| {
        let ended = place.scand(&fuse(subject)).output().unwrap();
        let said = String::from_utf8_lossy(&ended.stderr);
        assert_eq!(ended.status.code(), Some(code), "{said}");
        assert!(said.contains(word), "{said}");
    };
    refused("", 2, "--subject is empty");
    let known = format!("no capture of subject \"18\"; the captures here are of {ODD:?}");
    refused("18", 1, &known);
}

#[test]
fn they_are_the_same_whatever_the_order_the_threads_and_a_kill() {
    let place = Place::new(session(Shape::Mug, false, 640, "upright,flip", 1));
    let fuse = |first: &'static str, second: &'static str, out: &'static str| {
        [
            "fuse",
            "turned.mcap",
            "--capture",
            first,
            "--capture",
            second,
            "--out",
            out,
            "--quiet",
        ]
    };
    place.run(&fuse("mug-000", "mug-001", "one"), "1");
    let again = fuse("mug-001", "mug-000", "two");
    for milliseconds in [200, 1500] {
        let mut child = place.scand(&again).spawn().unwrap();
        std::thread::sleep(Duration::from_millis(milliseconds));
        child.kill().unwrap();
        child.wait().unwrap();
        // A folder under its final name is complete.
        let object = place.path("two/turned/mug-000.object");
        assert!(!object.exists() || object.join("report.json").is_file());
    }
    place.run(&again, "2");
    let object = "turned/mug-000.object";
    let [one, two] = ["one", "two"].map(|out| models(&place.path(out).join(object)));
    assert!(one == two);
    each_vertex_says_which_captures_made_it(&one[1]);
    the_frame_is_that_of_the_capture_that_is_named(&place, &fuse("mug-000", "mug-001", "one"));
}

/// The vertices' bit sets: two captures, each of which made some of the surface.
fn each_vertex_says_which_captures_made_it(ply: &[u8]) {
    let end = b"end_header\n";
    let body = ply.windows(end.len()).position(|w| w == end).unwrap() + end.len();
    let header = std::str::from_utf8(&ply[..body]).unwrap();
    let line = |begin: &str| header.lines().find_map(|l| l.strip_prefix(begin)).unwrap();
    let vertices: usize = line("element vertex ").parse().unwrap();
    assert!(header.contains("property float expected_error\nproperty uint captures\nelement face"));
    let bytes =
        (ply.len() - body - 13 * line("element face ").parse::<usize>().unwrap()) / vertices;
    let captures = |v: usize| {
        let at = body + (v + 1) * bytes - 4;
        u32::from_le_bytes(ply[at..at + 4].try_into().unwrap())
    };
    let with = |bits: u32| (0..vertices).filter(|&v| captures(v) == bits).count();
    assert_eq!(with(1) + with(2) + with(3), vertices);
    assert!(
        with(1) > vertices / 20 && with(2) > vertices / 20,
        "{} {}",
        with(1),
        with(2)
    );
}

/// Which needs --force, because another model lies there.
fn the_frame_is_that_of_the_capture_that_is_named(place: &Place, fuse: &[&str]) {
    let upright = [fuse, &["--upright", "mug-001"]].concat();
    let refused = place.scand(&upright).output().unwrap();
    assert_eq!(refused.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&refused.stderr).contains("--force"));
    place.run(&[&upright[..], &["--force"]].concat(), "2");
    let report = std::fs::read(place.path("one/turned/mug-000.object/report.json")).unwrap();
    let report: serde_json::Value = serde_json::from_slice(&report).unwrap();
    let fusion = &report["fusion"];
    assert_eq!(fusion["frame_of"], "mug-001");
    let pose = &fusion["captures"][1]["rig_from_object"];
    assert_eq!(pose["translation"], serde_json::json!([0.0, 0.0, 0.0]));
    assert_eq!(fusion["captures"][0]["held_by"], "silhouettes");
}
