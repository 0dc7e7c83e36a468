//! The bytes of fused models: the same whatever the order of arguments, the number of threads and what was killed
//! before, and those of the capture's own model where there is one.

use super::{SUBJECT, session};
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

#[test]
fn of_one_capture_they_are_its_own() {
    let place = Place::new(Options {
        subject: Some(SUBJECT.to_owned()),
        ..Options::small(Shape::Mug)
    });
    place.run(&["replay", "turned.mcap", "--out", "out", "--quiet"], "2");
    place.run(
        &[
            "fuse",
            "turned.mcap",
            "--subject",
            SUBJECT,
            "--out",
            "out",
            "--quiet",
        ],
        "1",
    );
    let own = models(&place.path("out/turned/mug-000"));
    let fused = models(&place.path(&format!("out/turned/{SUBJECT}.object")));
    assert!(own == fused);
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
}
