//! Disks that are full, at a worker and where the models go: it is said, and nothing is lost.

use crate::support::skipped::{Needed, skip};
use crate::support::wait::until;
use crate::test_bench::{
    TestBench, finished, made_here, models, said, simulated, simulated_of, spawned,
};
use scand::storage::free_bytes;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// A file system of its own size, which is gone after the test.
struct SmallDisk(PathBuf);

impl SmallDisk {
    /// `None` where this user may not mount.
    fn mount(path: &Path, size: &str) -> Option<Self> {
        std::fs::create_dir(path).unwrap();
        let options = format!("size={size}");
        let mut command = Command::new("mount");
        command.args(["-t", "tmpfs", "-o", &options, "tmpfs"]);
        let output = command.arg(path).output().unwrap();
        if output.status.success() {
            return Some(Self(path.to_owned()));
        }
        skip(
            Needed::OtherUsers,
            format!("mount: {}", said(&output).trim()),
        );
        None
    }

    fn resize(&self, size: &str) {
        let options = format!("remount,size={size}");
        let mut command = Command::new("mount");
        let status = command.args(["-o", &options]).arg(&self.0).status();
        assert!(status.unwrap().success());
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        let mut command = Command::new("umount");
        let _ = command.arg("--lazy").arg(&self.0).status();
    }
}

#[test]
fn full_disks_are_named_and_jobs_wait_for_space_or_go_to_other_workers() {
    let Some(bench) = TestBench::start("") else {
        return;
    };
    let Some(out) = SmallDisk::mount(&bench.path("out"), "50m") else {
        return;
    };
    let Some(_scratch) = SmallDisk::mount(&bench.path("full"), "50m") else {
        return;
    };
    let recording = simulated(6);
    let here = made_here(&bench, &recording);
    let full = bench.path("full");
    let _full = bench.worker_in("full", &full, &[]);
    let replay = bench
        .by_fleet(&recording, "out", &[])
        .stdout(Stdio::piped())
        .stderr(std::fs::File::create(bench.path("replay.log")).unwrap())
        .spawn()
        .unwrap();
    until("both say that there is no space", || {
        let (worker, replay) = (bench.log("full"), bench.log("replay"));
        worker.contains("this worker takes no job") && replay.contains("has less than 200 MB left")
    });
    assert!(!bench.log("full").contains("its model is being made"));
    out.resize("500m");
    let _worker = bench.worker("w", &[]);
    let output = finished(replay);
    assert!(output.status.success(), "{}", bench.log("replay"));
    assert!(models(&bench.path("out")) == here);
    assert!(!bench.log("full").contains("its model is being made"));
}

#[test]
fn space_that_a_job_gives_back_at_its_end_does_not_keep_it_from_ending() {
    const KEPT_FREE: u64 = 200_000_000;
    let Some(bench) = TestBench::start("") else {
        return;
    };
    let out = bench.path("out");
    let Some(_disk) = SmallDisk::mount(&out, "300m") else {
        return;
    };
    let recording = simulated_of(1, "320x240");
    let here = made_here(&bench, &recording);
    let of_model: usize = here.values().flatten().map(|(_, bytes)| bytes.len()).sum();
    let of_capture = std::fs::metadata(&recording).unwrap().len();
    // The model fits, but not beside the packed capture.
    let free = KEPT_FREE + of_model as u64 + of_capture / 2;
    let filler = std::fs::File::create(out.join("filler")).unwrap();
    let length = free_bytes(&out).unwrap() - free;
    rustix::fs::fallocate(&filler, rustix::fs::FallocateFlags::empty(), 0, length).unwrap();
    let _worker = bench.worker("w", &[]);
    let output = finished(spawned(bench.by_fleet(&recording, "out", &[])));
    assert!(output.status.success(), "{}", said(&output));
    assert!(!said(&output).contains("until you free some space"));
    std::fs::remove_file(out.join("filler")).unwrap();
    assert!(models(&out) == here);
}

#[test]
fn a_server_with_little_storage_gets_smaller_streams_and_one_with_hardly_any_is_named() {
    let Some(bench) = TestBench::without_server("") else {
        return;
    };
    let recording = simulated(6);
    bench.start_server_with("700MB");
    let _worker = bench.worker("w", &[]);
    let one = ["--capture", "ball-000"];
    let output = finished(spawned(bench.by_fleet(&recording, "out", &one)));
    let words = said(&output);
    assert!(output.status.success(), "{words}");
    assert!(
        words.contains("stream SCAND_CAPTURES has 500 MB instead of 4000 MB"),
        "{words}"
    );
    bench.kill_server();
    bench.wipe_store();
    bench.start_server_with("100MB");
    let mut replay = bench.by_fleet(&recording, "again", &one);
    replay.stdout(Stdio::piped());
    replay.stderr(std::fs::File::create(bench.path("replay.log")).unwrap());
    let replay = replay.spawn().unwrap();
    until("it names the storage", || {
        bench
            .log("replay")
            .contains("no space for 250 MB of stream SCAND_CAPTURES (max_file_store")
    });
    // It waits for an administrator, and then goes on.
    bench.kill_server();
    bench.start_server_with("8GB");
    let output = finished(replay);
    assert!(output.status.success(), "{}", bench.log("replay"));
}
