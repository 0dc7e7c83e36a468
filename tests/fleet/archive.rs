//! An archive made again by workers: the same bytes as here, what is there is left alone, and what cannot be made ends
//! as failed, with its reason.

use crate::test_bench::{
    Process, TestBench, finished, made_here, models, program, runtime, said, simulated, spawned,
    told,
};
use rustix::process::{Pid, Signal};
use std::path::PathBuf;
use std::process::Stdio;
use std::time::{Duration, Instant};

fn results(told: &[serde_json::Value]) -> Vec<&str> {
    told.iter()
        .map(|outcome| outcome["result"].as_str().unwrap())
        .collect()
}

#[test]
fn the_same_bytes_come_from_one_two_and_four_workers_and_are_not_made_again() {
    let Some(bench) = TestBench::start("") else {
        return;
    };
    let recording = simulated(6);
    let here = made_here(&bench, &recording);
    assert_eq!(here.len(), 6);
    for count in [1, 2, 4] {
        let names: Vec<String> = (0..count).map(|i| format!("w{count}-{i}")).collect();
        let _workers: Vec<_> = names
            .iter()
            .map(|name| bench.worker(name, &["--jobs", "2"]))
            .collect();
        let out = format!("out-{count}");
        let output = bench.by_fleet(&recording, &out, &[]).output().unwrap();
        assert!(output.status.success(), "{}", said(&output));
        assert_eq!(results(&told(&output)), ["done"; 6]);
        assert!(
            said(&output).contains("6 done, 0 unchanged, 0 failed, 0 to go"),
            "{}",
            said(&output)
        );
        assert!(models(&bench.path(&out)) == here, "{count} workers");
    }
    // Without any worker: nothing is left to be made.
    let output = bench.by_fleet(&recording, "out-2", &[]).output().unwrap();
    assert!(output.status.success(), "{}", said(&output));
    assert_eq!(results(&told(&output)), ["unchanged"; 6]);
    // What was made here is recognised, too.
    let output = bench.by_fleet(&recording, "here", &[]).output().unwrap();
    assert_eq!(
        results(&told(&output)),
        ["unchanged"; 6],
        "{}",
        said(&output)
    );
    // Nothing of it stays on the server, once a worker has acknowledged what it brought.
    let status = || -> serde_json::Value {
        let mut command = program();
        command.args(["fleet", "status", "--json", "--fleet", &bench.address()]);
        serde_json::from_slice(&command.output().unwrap().stdout).unwrap()
    };
    crate::support::wait::until("no job waits", || {
        status()["waiting"] == serde_json::json!([])
    });
    assert_eq!(status()["failed"], serde_json::json!([]));
    for stream in ["SCAND_CAPTURES", "SCAND_RESULTS"] {
        crate::support::wait::until(&format!("{stream} is empty"), || {
            stored_bytes(&bench, stream) < 20_000
        });
    }
}

/// The bytes that a stream of the server keeps. The empty message that stands for an erased one takes some, too.
fn stored_bytes(bench: &TestBench, stream: &str) -> u64 {
    let answer = runtime().block_on(async {
        let client = async_nats::connect(bench.address()).await.unwrap();
        let subject = format!("$JS.API.STREAM.INFO.{stream}");
        client.request(subject, "".into()).await.unwrap()
    });
    let answer: serde_json::Value = serde_json::from_slice(&answer.payload).unwrap();
    answer["state"]["bytes"].as_u64().unwrap()
}

#[test]
fn a_run_that_was_stopped_goes_on_where_it_was() {
    let Some(bench) = TestBench::start("") else {
        return;
    };
    let recording = simulated(12);
    let _worker = bench.worker("w", &[]);
    let started = bench
        .by_fleet(&recording, "out", &["--quiet"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let origins = || {
        let files = std::fs::read_dir(bench.path("out/fleet-12"))
            .into_iter()
            .flatten();
        files
            .filter(|f| {
                f.as_ref()
                    .unwrap()
                    .path()
                    .extension()
                    .is_some_and(|e| e == "fleet")
            })
            .count()
    };
    crate::support::wait::until("some are made", || origins() >= 3);
    let id = Pid::from_child(&started);
    // As Ctrl-C does; services get SIGTERM, which is heard in the same place.
    rustix::process::kill_process(id, Signal::INT).unwrap();
    let stopped = finished(started);
    assert_eq!(stopped.status.code(), Some(3), "{}", said(&stopped));
    assert!(
        said(&stopped).contains("left: run the same command again"),
        "{}",
        said(&stopped)
    );
    let before = told(&stopped).len();
    assert!((3..12).contains(&before), "{before}");
    let output = bench
        .by_fleet(&recording, "out", &["--quiet"])
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", said(&output));
    let told = told(&output);
    let unchanged = results(&told).iter().filter(|r| **r == "unchanged").count();
    assert!(
        unchanged >= before && unchanged < 12,
        "{unchanged} of {before}"
    );
    assert!(models(&bench.path("out")) == made_here(&bench, &recording));
}

#[test]
fn a_run_that_is_killed_again_and_again_puts_each_model_into_place_once() {
    let Some(bench) = TestBench::start("") else {
        return;
    };
    let recording = simulated(12);
    let here = made_here(&bench, &recording);
    let _workers = [bench.worker("w1", &[]), bench.worker("w2", &[])];
    let inodes = || -> std::collections::BTreeMap<PathBuf, u64> {
        use std::os::unix::fs::MetadataExt;
        let folders = std::fs::read_dir(bench.path("out/fleet-12"));
        let folders = folders.into_iter().flatten().flatten();
        // What is being put into place has another name yet.
        let placed = folders.filter(|entry| !entry.file_name().to_string_lossy().starts_with('.'));
        let models = placed.map(|entry| entry.path().join("model.glb"));
        let known = models.filter_map(|path| Some((path.clone(), path.metadata().ok()?.ino())));
        known.collect()
    };
    let mut seen = std::collections::BTreeMap::new();
    for made in [1, 4, 7, 10] {
        let mut killed = spawned(bench.by_fleet(&recording, "out", &["--quiet"]));
        crate::support::wait::until("some are made", || inodes().len() >= made);
        killed.kill().unwrap();
        killed.wait().unwrap();
        let now = inodes();
        // What is in place stays there.
        let stays = |(path, inode): (&PathBuf, &u64)| now.get(path) == Some(inode);
        assert!(seen.iter().all(stays), "{seen:?}, then {now:?}");
        seen = now;
    }
    let output = bench.by_fleet(&recording, "out", &[]).output().unwrap();
    assert!(output.status.success(), "{}", said(&output));
    let now = inodes();
    let stays = |(path, inode): (&PathBuf, &u64)| now.get(path) == Some(inode);
    assert!(seen.iter().all(stays), "{seen:?}, then {now:?}");
    assert!(models(&bench.path("out")) == here);
    assert!(!said(&output).contains("difference"), "{}", said(&output));
    let spool = bench.path("out/.fleet-spool");
    assert!(!spool.exists(), "{}", spool.display());
}

#[test]
fn models_of_other_settings_stay_and_no_machine_is_blamed() {
    let Some(bench) = TestBench::start("") else {
        return;
    };
    let recording = simulated(6);
    let worker = bench.worker("w", &[]);
    let output = bench.by_fleet(&recording, "out", &[]).output().unwrap();
    assert!(output.status.success(), "{}", said(&output));
    let before = models(&bench.path("out"));
    // Nobody is there to make them once more.
    drop(worker);
    let other = ["--set", "hull.resolution=26"];
    let output = bench.by_fleet(&recording, "out", &other).output().unwrap();
    assert_eq!(output.status.code(), Some(1), "{}", said(&output));
    assert!(!said(&output).contains("faulty"), "{}", said(&output));
    let told = told(&output);
    assert_eq!(results(&told), ["failed"; 6]);
    let reason = told[0]["reasons"][0].as_str().unwrap();
    assert!(reason.contains("give --force to replace it"), "{reason}");
    assert!(models(&bench.path("out")) == before);
    let _worker = bench.worker("w", &[]);
    let forced = [&other[..], &["--force"]].concat();
    let output = bench.by_fleet(&recording, "out", &forced).output().unwrap();
    assert!(output.status.success(), "{}", said(&output));
    assert!(models(&bench.path("out")) != before);
}

#[test]
fn a_job_whose_child_dies_each_time_ends_as_failed_with_a_report() {
    let Some(bench) = TestBench::start("") else {
        return;
    };
    let recording = simulated(6);
    let worker = bench.worker("w", &[]);
    // Fine enough that its child can be caught at it.
    let arguments = ["--capture", "ball-000", "--set", "hull.resolution=900"];
    let replay = bench
        .by_fleet(&recording, "out", &arguments)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn();
    let mut replay = replay.unwrap();
    while replay.try_wait().unwrap().is_none() {
        kill_children_that_make_models(worker.0.id());
        std::thread::sleep(Duration::from_millis(50));
    }
    let output = finished(replay);
    assert_eq!(output.status.code(), Some(1), "{}", said(&output));
    let told = told(&output);
    assert_eq!(results(&told), ["failed"]);
    let reason = told[0]["reasons"][0].as_str().unwrap();
    assert!(
        reason.contains("failed 3 times") && reason.contains("worker w"),
        "{reason}"
    );
    let report = std::fs::read(bench.path("out/fleet-6/ball-000/report.json")).unwrap();
    let report: serde_json::Value = serde_json::from_slice(&report).unwrap();
    assert_eq!(report["outcome"], "failed");
    assert_eq!(report["reason"], reason);
    let status = program()
        .args(["fleet", "status", "--fleet", &bench.address()])
        .output()
        .unwrap();
    let status = String::from_utf8_lossy(&status.stdout).into_owned();
    assert!(
        status.contains("0 waiting, 0 running, 1 failed; 1 worker"),
        "{status}"
    );
    assert!(
        status.contains("failed: ball-000 of archive (fleet-6.mcap)"),
        "{status}"
    );
}

/// Kills the children of a worker that make models.
fn kill_children_that_make_models(worker: u32) {
    for id in children_that_make_models(worker) {
        let _ = rustix::process::kill_process(id, Signal::KILL);
    }
}

#[test]
fn a_child_that_makes_a_model_has_neither_connection_nor_credentials() {
    let Some(bench) = TestBench::start("") else {
        return;
    };
    let key = bench.path("worker.key");
    let made = program().args(["fleet", "key"]).arg(&key).output().unwrap();
    assert!(made.status.success(), "{}", said(&made));
    let with_key = ["--credentials", key.to_str().unwrap()];
    let mut worker = bench.worker_command("w", &bench.address(), &with_key);
    worker.arg("--scratch").arg(bench.path("scratch"));
    worker.env("CREDENTIALS_DIRECTORY", bench.path(""));
    let worker = Process(bench.logged(worker, "w").spawn().unwrap());
    let arguments = ["--capture", "ball-000", "--set", "hull.resolution=900"];
    let _replay = Process(spawned(bench.by_fleet(&simulated(6), "out", &arguments)));
    let mut child = None;
    crate::support::wait::until("a child makes the model", || {
        child = children_that_make_models(worker.0.id()).first().copied();
        // It confines itself before it reads anything.
        child.is_some_and(|id| of_process(id, "status").contains("\nSeccomp:\t2\n"))
    });
    let id = child.unwrap();
    let environment = of_process(id, "environ");
    assert!(environment.contains("PATH=") && !environment.contains("CREDENTIALS"));
    assert!(!of_process(id, "cmdline").contains("worker.key"));
    let folder = format!("/proc/{}/fd", id.as_raw_nonzero());
    let files = std::fs::read_dir(folder).unwrap().flatten();
    let files = files.filter_map(|file| std::fs::read_link(file.path()).ok());
    let files: Vec<String> = files.map(|to| to.to_string_lossy().into_owned()).collect();
    let foreign = |to: &&String| to.starts_with("socket:") || to.contains("worker.key");
    assert!(
        !files.is_empty() && !files.iter().any(|to| foreign(&to)),
        "{files:?}"
    );
}

/// The children of a worker that make models.
fn children_that_make_models(worker: u32) -> Vec<Pid> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir("/proc").unwrap().flatten() {
        let Some(id) = entry
            .file_name()
            .to_string_lossy()
            .parse()
            .ok()
            .and_then(Pid::from_raw)
        else {
            continue;
        };
        let is_child = of_process(id, "status").contains(&format!("\nPPid:\t{worker}\n"));
        if is_child && of_process(id, "cmdline").contains("\0fleet-step\0make\0") {
            found.push(id);
        }
    }
    found
}

fn of_process(id: Pid, file: &str) -> String {
    let bytes = std::fs::read(format!("/proc/{}/{file}", id.as_raw_nonzero()));
    String::from_utf8_lossy(&bytes.unwrap_or_default()).into_owned()
}

#[test]
fn only_the_same_program_takes_a_job_and_an_unknown_one_takes_part_in_nothing() {
    let Some(bench) = TestBench::start("") else {
        return;
    };
    let recording = simulated(6);
    let mut other = program();
    other.env("SCAND_FLEET_TEST_PROGRAM", "other");
    other.args(["worker", "--fleet", &bench.address(), "--name", "other"]);
    other.arg("--scratch").arg(bench.path("scratch"));
    let _other = crate::test_bench::Process(bench.logged(other, "other").spawn().unwrap());
    let mut replay = bench.by_fleet(&recording, "out", &["--capture", "ball-000", "--quiet"]);
    let mut replay = crate::test_bench::Process(replay.stdout(Stdio::null()).spawn().unwrap());
    let end = Instant::now() + Duration::from_secs(30);
    loop {
        let status = program()
            .args(["fleet", "status", "--json", "--fleet", &bench.address()])
            .output()
            .unwrap();
        let status: serde_json::Value = serde_json::from_slice(&status.stdout).unwrap();
        if status["waiting"][0]["jobs"] == 1 {
            assert_eq!(status["waiting"][0]["has_worker"], false, "{status:#}");
            assert_eq!(status["workers"][0]["worker"], "other");
            break;
        }
        assert!(Instant::now() < end, "{status:#}");
    }
    assert!(replay.0.try_wait().unwrap().is_none());
    let _worker = bench.worker("w", &[]);
    assert!(replay.wait().success());
    assert!(
        !bench.log("other").contains("capture"),
        "{}",
        bench.log("other")
    );
}
