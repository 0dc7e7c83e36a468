//! Workers that do not come back, or not in time: one that stands still, one that is cut off, one that is told to stop,
//! and a job that takes its workers with it.

use crate::support::wait::until;
use crate::test_bench::{
    Process, TestBench, finished, made_here, models, program, runtime, said, simulated,
    simulated_of, spawned, told,
};
use crate::wire::Wire;
use rustix::process::{Pid, Signal};
use std::path::Path;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

/// One capture, fine enough that its worker can be caught at it.
const ONE: [&str; 5] = [
    "--capture",
    "ball-000",
    "--set",
    "hull.resolution=260",
    "--quiet",
];

/// Waits until the one job of a replay is on the server.
fn until_offered(bench: &TestBench, replay: &mut Child) {
    let waiting = || -> serde_json::Value {
        let mut command = program();
        command.args(["fleet", "status", "--json", "--fleet", &bench.address()]);
        serde_json::from_slice(&command.output().unwrap().stdout).unwrap_or_default()
    };
    until("the job is offered", || {
        waiting()["waiting"][0]["jobs"] == 1 || replay.try_wait().unwrap().is_some()
    });
}

/// What befalls the worker `first` in its job moves the job to another one within 15 s; when it is over, both have made
/// it, and the model is the one that is made here.
fn moves_elsewhere(bench: &TestBench, befall: impl FnOnce(), undo: impl FnOnce()) {
    let recording = simulated(6);
    let local = bench.replay(&recording, "here", &ONE).output().unwrap();
    assert!(local.status.success(), "{}", said(&local));
    let replay = spawned(bench.by_fleet(&recording, "out", &ONE));
    let started = |log: &str| bench.log(log).contains("its model is being made");
    until("a worker begins", || started("first"));
    befall();
    let since = Instant::now();
    let _second = bench.worker("second", &[]);
    until("another worker begins", || started("second"));
    let moved = since.elapsed();
    println!(
        "shown: the job was elsewhere {:.1} s after the last sign of life",
        moved.as_secs_f64()
    );
    assert!(moved < Duration::from_secs(15), "{moved:?}");
    undo();
    let output = finished(replay);
    assert!(output.status.success(), "{}", said(&output));
    assert_eq!(told(&output).len(), 1);
    assert!(models(&bench.path("out")) == models(&bench.path("here")));
    // The first one, too, comes to its end, and nobody minds.
    until("both have made it", || {
        bench.log("first").contains("sent") && bench.log("second").contains("sent")
    });
}

/// A link on which pieces that many jobs send at a time would all come too late.
#[test]
fn over_a_slow_link_jobs_go_one_after_the_other_and_all_are_made() {
    let Some(bench) = TestBench::start("") else {
        return;
    };
    let recording = simulated_of(6, "640x480");
    let here = made_here(&bench, &recording);
    let wire = Wire::to(bench.port);
    // Two pieces take 4 s.
    wire.slow_down(250_000);
    let slow = format!("nats://127.0.0.1:{}", wire.port);
    let _worker = bench.worker("w", &[]);
    let mut replay = bench.replay(&recording, "out", &[]);
    replay.args(["--fleet", &slow, "--name", "archive"]);
    let output = finished(spawned(replay));
    assert!(output.status.success(), "{}", said(&output));
    assert!(models(&bench.path("out")) == here);
    assert!(!said(&output).contains("store"), "{}", said(&output));
}

#[test]
fn a_worker_that_stands_still_loses_its_job_and_its_late_result_changes_nothing() {
    let Some(bench) = TestBench::start("") else {
        return;
    };
    let first = bench.worker("first", &[]);
    moves_elsewhere(
        &bench,
        || first.signal(Signal::STOP),
        || first.signal(Signal::CONT),
    );
}

#[test]
fn a_worker_that_is_cut_off_loses_its_job_and_its_late_result_changes_nothing() {
    let Some(bench) = TestBench::start("") else {
        return;
    };
    let wire = Wire::to(bench.port);
    let address = format!("nats://127.0.0.1:{}", wire.port);
    let mut first = bench.worker_command("first", &address, &[]);
    first.arg("--scratch").arg(bench.path("far"));
    let _first = Process(bench.logged(first, "first").spawn().unwrap());
    moves_elsewhere(&bench, || wire.cut(), || wire.mend());
}

/// Nothing new is offered then, so nothing but the job that waits can notice that the streams are gone.
#[test]
fn a_server_that_loses_everything_when_all_is_offered_gets_it_again() {
    let Some(bench) = TestBench::start("") else {
        return;
    };
    let recording = simulated(6);
    let mut replay = spawned(bench.by_fleet(&recording, "out", &["--capture", "ball-000"]));
    until_offered(&bench, &mut replay);
    bench.kill_server();
    bench.wipe_store();
    bench.start_server();
    let _worker = bench.worker("w", &[]);
    let output = finished(replay);
    assert!(output.status.success(), "{}", said(&output));
    assert_eq!(told(&output)[0]["result"], "done");
}

/// The process in which a worker of this bench makes a model.
fn making(bench: &TestBench) -> Option<Pid> {
    let scratch = bench.path("scratch").display().to_string();
    let processes = std::fs::read_dir("/proc").unwrap().flatten();
    let mut numbers = processes.filter_map(|entry| entry.file_name().to_str()?.parse().ok());
    let makes_it = |number: &i32| {
        let said = std::fs::read(format!("/proc/{number}/cmdline")).unwrap_or_default();
        let said = String::from_utf8_lossy(&said);
        said.contains("fleet-step\0make\0") && said.contains(&scratch)
    };
    numbers.find(makes_it).and_then(Pid::from_raw)
}

#[test]
fn a_job_that_takes_longer_than_its_limit_is_given_to_the_next_one() {
    let Some(bench) = TestBench::start("") else {
        return;
    };
    let recording = simulated(6);
    let mut arguments = ONE.to_vec();
    arguments.extend(["--set", "workers.time_limit_s=15"]);
    // Problems are told where progress is.
    arguments.retain(|argument| *argument != "--quiet");
    let mut replay = bench.by_fleet(&recording, "out", &arguments);
    let log = std::fs::File::create(bench.path("replay.log")).unwrap();
    replay.stdout(Stdio::piped()).stderr(log);
    let replay = replay.spawn().unwrap();
    let _worker = bench.worker("w", &[]);
    until("a model is being made", || making(&bench).is_some());
    let child = making(&bench).expect("it takes longer than this");
    rustix::process::kill_process(child, Signal::STOP).unwrap();
    let since = Instant::now();
    let output = finished(replay);
    assert!(output.status.success(), "{}", bench.log("replay"));
    assert_eq!(told(&output)[0]["result"], "done");
    assert!(since.elapsed() > Duration::from_secs(13));
    let log = bench.log("replay") + &bench.log("w");
    assert!(log.contains("it did not finish within 15 s"), "{log}");
}

#[test]
fn a_worker_that_is_told_to_stop_says_why_and_ends_as_failed() {
    let Some(bench) = TestBench::start("") else {
        return;
    };
    let mut worker = bench.worker("w", &[]);
    runtime().block_on(async {
        let client = async_nats::connect(bench.address()).await.unwrap();
        while worker.0.try_wait().unwrap().is_none() {
            let reason = "rig hall, capture vase-3".into();
            client.publish("scand.stop.w", reason).await.unwrap();
            client.flush().await.unwrap();
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
    });
    assert_eq!(worker.wait().code(), Some(1), "{}", bench.log("w"));
    let log = bench.log("w");
    assert!(
        log.contains("rig hall, capture vase-3") && log.contains("check this machine's memory"),
        "{log}"
    );
}

/// Ten workers begin a job and are never heard of again. This takes as long as a rig waits for a lost worker.
#[test]
fn a_job_whose_workers_go_away_for_ever_ends_as_failed() {
    let Some(bench) = TestBench::start("") else {
        return;
    };
    let one = ["--capture", "ball-000"];
    let mut replay = spawned(bench.by_fleet(&simulated(6), "out", &one));
    until_offered(&bench, &mut replay);
    runtime().block_on(begin_and_go_away(&bench.address()));
    let output = finished(replay);
    assert_eq!(output.status.code(), Some(1), "{}", said(&output));
    let reason = told(&output)[0]["reasons"][0].to_string();
    assert!(
        reason.contains("10 workers disappeared during this job"),
        "{reason}"
    );
    assert!(Path::new(&bench.path("out/fleet-6/ball-000/report.json")).exists());
}

/// What is left on the server of a crash says nothing of the job that was offered since.
#[test]
fn a_job_that_the_server_loses_after_a_crash_is_offered_again_also_if_the_crash_is_told_twice() {
    let Some(bench) = TestBench::start("") else {
        return;
    };
    let one = ["--capture", "ball-000"];
    let mut replay = spawned(bench.by_fleet(&simulated(6), "out", &one));
    until_offered(&bench, &mut replay);
    runtime().block_on(crash_twice_and_lose_the_job(&bench.address()));
    let _worker = bench.worker("w", &[]);
    let output = finished(replay);
    assert!(output.status.success(), "{}", said(&output));
    assert_eq!(told(&output)[0]["result"], "done");
}

async fn crash_twice_and_lose_the_job(address: &str) {
    use futures_util::StreamExt;
    let client = async_nats::connect(address).await.unwrap();
    let context = async_nats::jetstream::new(client.clone());
    let job = offered_job(&client).await;
    let digest = job.rsplit('.').next().unwrap();
    let mut offers = client.subscribe("scand.job.>").await.unwrap();
    client.flush().await.unwrap();
    let crashed = serde_json::json!({
        "outcome": "crashed", "worker": "w", "instance": "i", "attempt": "1-1", "reason": "no memory", "words": "",
    });
    let crashed = crashed.to_string();
    let store = async |subject: String, text: String| {
        let stored = context.publish(subject, text.into()).await.unwrap();
        stored.await.unwrap();
    };
    let result = format!("scand.result.archive.{digest}");
    store(result.clone(), crashed.clone()).await;
    let limit = Duration::from_secs(60);
    let again = tokio::time::timeout(limit, offers.next()).await.unwrap();
    assert_eq!(again.unwrap().subject.as_str(), job);
    store(result, crashed).await;
    store(job, String::new()).await;
}

/// The subject of a job that waits.
async fn offered_job(client: &async_nats::Client) -> String {
    let asked = r#"{"last_by_subj":"scand.job.>"}"#;
    let subject = "$JS.API.STREAM.MSG.GET.SCAND_JOBS";
    let found = client.request(subject, asked.into()).await.unwrap();
    let found: serde_json::Value = serde_json::from_slice(&found.payload).unwrap();
    found["message"]["subject"].as_str().unwrap().to_owned()
}

async fn begin_and_go_away(address: &str) {
    let client = async_nats::connect(address).await.unwrap();
    let job = offered_job(&client).await;
    let digest = job.rsplit('.').next().unwrap();
    for number in 0..10 {
        let started = serde_json::json!({"worker": "w", "instance": format!("i{number}")});
        let subject = format!("scand.started.archive.{digest}.w");
        let published = client.publish(subject, started.to_string().into()).await;
        published.unwrap();
    }
    client.flush().await.unwrap();
}
