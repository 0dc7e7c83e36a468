//! A rig that captures while others make its models: the daemon's queue, and the process of the fleet beside it.

use crate::support::wait::until;
use crate::test_bench::{Process, TestBench, models, program, runtime, said, simulated};
use scand::config::Config;
use scand::workers::handover::{self, Answer};
use scand::workers::{
    FinishedJob, FleetAddress, Job, Jobs, Parameters, WorkerPlan, Workers, start_models,
};
use serde_json::{Value, json};
use sha2::{Digest, Sha256};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, channel};
use std::time::Duration;

/// The daemon's part of a rig: its queue and its workers, as `scand run` starts them.
struct Rig {
    jobs: Arc<Jobs>,
    _workers: Workers,
    heard: Receiver<FinishedJob>,
}

fn settings() -> String {
    let config = Config::load(None, &["hull.resolution=24".to_owned()]).unwrap();
    config.replay_toml().unwrap()
}

fn rig(bench: &TestBench, change: impl FnOnce(&mut Parameters)) -> Rig {
    let recordings = bench.path("recordings");
    let jobs = Arc::new(Jobs::open(&recordings).unwrap());
    let address: FleetAddress = bench.address().parse().unwrap();
    let mut parameters = Parameters {
        folder: bench.path("models"),
        fleet: Some(address),
        ..Parameters::default()
    };
    change(&mut parameters);
    let plan = WorkerPlan {
        parameters,
        settings: settings(),
        clock: scand::clock::Clock::system(),
        method: Default::default(),
        keep_free: Arc::default(),
        command: vec![env!("CARGO_BIN_EXE_scand").into(), "make-model".into()],
    };
    let (ended, heard) = channel();
    let workers = start_models(&jobs, plan, move |e| drop(ended.send(e))).unwrap();
    Rig {
        jobs,
        _workers: workers,
        heard,
    }
}

/// The process that has the connection.
fn fleet_process(bench: &TestBench, more: &str) -> Process {
    let file = bench.path("rig.toml");
    let [recordings, models] = ["recordings", "models"].map(|name| bench.path(name));
    let text = format!(
        "[recording]\nfolder = {recordings:?}\n[workers]\nfolder = {models:?}\nfleet = \"{}\"\n{more}\n",
        bench.address()
    );
    std::fs::write(&file, text).unwrap();
    let mut command = program();
    command
        .args(["fleet", "run", "--name", "hall", "--config"])
        .arg(&file);
    Process(bench.logged(command, "fleet").spawn().unwrap())
}

/// Puts a recording among the rig's, and its captures into the queue.
fn capture(bench: &TestBench, rig: &Rig) -> PathBuf {
    let path = bench.path("recordings/cup.mcap");
    std::fs::copy(simulated(6), &path).unwrap();
    let recording = scand::recording::Recording::open(&path).unwrap();
    for message in recording.messages(&scand::recording::Topic::Trigger) {
        let trigger = recording.trigger(message).unwrap();
        let job = Job::new(&path, trigger.id.as_str(), trigger.time.0, &trigger.source);
        rig.jobs.enqueue(&job).unwrap();
    }
    path
}

fn next(rig: &Rig, bench: &TestBench) -> FinishedJob {
    let heard = rig.heard.recv_timeout(Duration::from_secs(100));
    heard.unwrap_or_else(|_| panic!("{}", bench.log("fleet")))
}

fn is_idle(bench: &TestBench, rig: &Rig) -> bool {
    let files = std::fs::read_dir(bench.path("recordings/jobs")).unwrap();
    let names = files.map(|file| file.unwrap().file_name().into_string().unwrap());
    let left = names.filter(|name| !["settings.toml", "failed"].contains(&name.as_str()));
    left.count() == 0 && rig.jobs.is_idle()
}

#[test]
fn captures_of_a_rig_come_back_as_models_and_are_told_as_done() {
    let Some(bench) = TestBench::start("") else {
        return;
    };
    let rig = rig(&bench, |_| ());
    let path = capture(&bench, &rig);
    let _fleet = fleet_process(&bench, "recheck = 1.0");
    let _workers = ["w0", "w1"].map(|name| bench.worker(name, &[]));
    for _ in 0..6 {
        let ended = next(&rig, &bench);
        let model = ended.model.unwrap();
        assert_eq!(ended.recording, path);
        assert_eq!(model.folder, bench.path("models/cup").join(&ended.capture));
    }
    until("nothing is left of the jobs", || is_idle(&bench, &rig));
    let here = bench.replay(&path, "here", &["--quiet"]).output().unwrap();
    assert!(here.status.success(), "{}", said(&here));
    assert!(models(&bench.path("models")) == models(&bench.path("here")));
    assert!(
        !bench.log("fleet").contains("made a model that differs"),
        "{}",
        bench.log("fleet")
    );
}

#[test]
fn without_a_server_models_are_made_here_if_that_is_wanted() {
    if let Some(bench) = TestBench::without_server("") {
        are_made_here(&bench);
    }
}

#[test]
fn without_a_worker_models_are_made_here_if_that_is_wanted_and_no_job_stays_on_the_server() {
    let Some(bench) = TestBench::start("") else {
        return;
    };
    // One of them failed before, and a person wanted it to be offered again.
    say_failure(&bench.address(), "cup.mcap", "ball-000");
    assert_eq!(failed(&bench).len(), 1);
    let _fleet = are_made_here(&bench);
    until("the failure is taken back", || failed(&bench).is_empty());
    let waiting = || -> Value {
        let mut status = program();
        status.args(["fleet", "status", "--json", "--fleet", &bench.address()]);
        serde_json::from_slice(&status.output().unwrap().stdout).unwrap()
    };
    until("nothing waits on the server", || {
        waiting()["waiting"].as_array().unwrap().is_empty()
    });
}

/// The process of the fleet goes on.
fn are_made_here(bench: &TestBench) -> Process {
    let rig = rig(bench, |parameters| {
        parameters.fleet_or_local = true;
        parameters.fleet_wait_s = 2;
    });
    capture(bench, &rig);
    let fleet = fleet_process(bench, "fleet_or_local = true");
    for _ in 0..6 {
        next(&rig, bench).model.unwrap();
    }
    until("nothing is left of the jobs", || is_idle(bench, &rig));
    fleet
}

#[test]
fn a_rig_that_is_ended_and_started_again_loses_no_job_and_a_failed_one_is_retried() {
    let Some(bench) = TestBench::start("") else {
        return;
    };
    let first = rig(&bench, |_| ());
    capture(&bench, &first);
    // One of them has failed, as the process of the fleet says it.
    let one = handover::offered(&bench.path("recordings"))
        .unwrap()
        .remove(2);
    let failed = Answer::Failed {
        reason: "no worker could do it".into(),
        words: "words".into(),
    };
    handover::answer(&one.file, &failed).unwrap();
    let ended = next(&first, &bench);
    assert_eq!(ended.capture, one.job.capture);
    assert_eq!(ended.model, Err("no worker could do it".into()));
    let report = bench
        .path("models/cup")
        .join(&ended.capture)
        .join("report.json");
    assert!(
        std::fs::read_to_string(report)
            .unwrap()
            .contains("no worker could do it")
    );
    drop(first);
    let again = rig(&bench, |_| ());
    let mut fleet = fleet_process(&bench, "");
    let _worker = bench.worker("w", &[]);
    let mut made = std::collections::BTreeSet::new();
    until("the others are made", || {
        while let Ok(ended) = again.heard.try_recv() {
            if ended.model.is_ok() {
                made.insert(ended.capture);
            }
        }
        is_idle(&bench, &again)
    });
    let failed = bench.path("recordings/jobs/failed");
    let count = |folder: &Path| std::fs::read_dir(folder).into_iter().flatten().count();
    let before = count(&failed);
    assert!(
        before >= 1 && made.len() + before == 6,
        "{made:?}, {before}"
    );
    let words = retry(&bench);
    assert!(
        words.contains(&format!("{before} offered again")),
        "{words}"
    );
    for _ in 0..before {
        made.insert({
            let ended = next(&again, &bench);
            ended.model.unwrap();
            ended.capture
        });
    }
    assert_eq!(made.len(), 6);
    assert_eq!(count(&failed), 0);
    fleet.kill();
}

#[test]
fn a_worker_whose_models_are_wrong_is_stopped_and_what_it_made_is_marked() {
    let Some(bench) = TestBench::start("") else {
        return;
    };
    let rig = rig(&bench, |_| ());
    // A rig that says to have other settings than it rechecks with is not to be had; so the worker itself is wrong: it
    // answers with the model of a rig that reads coarser settings.
    let path = capture(&bench, &rig);
    let coarse = bench
        .replay(&path, "coarse", &["--set", "hull.resolution=20", "--quiet"])
        .output()
        .unwrap();
    assert!(coarse.status.success(), "{}", said(&coarse));
    // Models of earlier days: one of the same worker, one of another.
    for worker in ["wrong", "right"] {
        let folder = bench.path("models/earlier").join(worker);
        std::fs::create_dir_all(&folder).unwrap();
        let origin =
            json!({"digest": "d", "contents_sha256": "c", "worker": worker, "made_of": "m"});
        let file = bench.path(&format!("models/earlier/.{worker}.fleet"));
        std::fs::write(file, origin.to_string()).unwrap();
    }
    // The real process of that name, which has another program, so that it takes none of these jobs, and hears all the
    // same that it is to stop.
    let mut told = bench.worker_command("wrong", &bench.address(), &[]);
    told.env("SCAND_FLEET_TEST_PROGRAM", "other");
    told.arg("--scratch").arg(bench.path("scratch"));
    let mut told = Process(bench.logged(told, "wrong").spawn().unwrap());
    let _fleet = fleet_process(&bench, "recheck = 1.0");
    let address = bench.address();
    let made_wrong = bench.path("coarse/cup");
    let bundle = bench.path("bundle");
    let wrong =
        std::thread::spawn(move || runtime().block_on(answer_with(&address, &made_wrong, &bundle)));
    let ended = next(&rig, &bench);
    let reason = ended.model.unwrap_err();
    assert!(
        reason.contains("made a model that differs from the one that this machine makes"),
        "{reason}"
    );
    assert_eq!(
        wrong.join().unwrap(),
        "rig hall, capture ".to_owned() + &ended.capture
    );
    let is_marked = |model: &str| {
        let mark = bench.path("models").join(model).join("distrusted.txt");
        std::fs::read_to_string(mark).is_ok_and(|words| words.contains("The worker wrong made"))
    };
    assert!(is_marked(&format!("cup/{}", ended.capture)));
    assert!(is_marked("earlier/wrong") && !is_marked("earlier/right"));
    assert!(!told.wait().success());
    let log = bench.log("wrong");
    assert!(log.contains("check this machine's memory"), "{log}");
    // A worker that makes what this machine makes does the others.
    let _right = bench.worker("right", &[]);
    for _ in 0..5 {
        let ended = next(&rig, &bench);
        let model = ended.model.unwrap();
        assert!(!model.folder.join("distrusted.txt").exists());
    }
    // And, when a person wants it, the one that was wrong; nothing is said to have failed then.
    assert_eq!(failed(&bench).len(), 1);
    retry(&bench);
    let again = next(&rig, &bench);
    assert_eq!(again.capture, ended.capture);
    let model = again.model.unwrap();
    assert!(!model.folder.join("distrusted.txt").exists());
    until("the failure is taken back", || failed(&bench).is_empty());
    let here = bench.replay(&path, "here", &["--quiet"]).output().unwrap();
    assert!(here.status.success(), "{}", said(&here));
    let (there, here) = (models(&bench.path("models")), models(&bench.path("here")));
    assert!(there[&ended.capture] == here[&ended.capture]);
}

/// What is said to have failed.
fn failed(bench: &TestBench) -> Vec<Value> {
    let mut status = program();
    status.args(["fleet", "status", "--json", "--fleet", &bench.address()]);
    let output = status.output().unwrap();
    let status: Value = serde_json::from_slice(&output.stdout).unwrap();
    status["failed"].as_array().unwrap().clone()
}

/// Says that a job of the rig failed, on a server that has nothing yet.
fn say_failure(address: &str, recording: &str, capture: &str) {
    let digest = Sha256::digest(format!("{recording} {capture}"));
    let subject = format!("scand.failure.hall.{digest:x}");
    let failed = json!({
        "rig": "hall", "capture": capture, "recording": recording, "reason": "no light", "time_s": 1,
    });
    let stream = async_nats::jetstream::stream::Config {
        name: "SCAND_FAILURES".into(),
        subjects: vec!["scand.failure.>".into()],
        max_messages_per_subject: 1,
        allow_direct: true,
        ..Default::default()
    };
    runtime().block_on(async {
        let client = async_nats::connect(address).await.unwrap();
        let context = async_nats::jetstream::new(client);
        context.get_or_create_stream(stream).await.unwrap();
        let published = context.publish(subject, failed.to_string().into()).await;
        published.unwrap().await.unwrap();
    });
}

/// Lets the rig offer its failed jobs again; what the command says.
fn retry(bench: &TestBench) -> String {
    let address = bench.address();
    let mut retried = program();
    retried.args(["fleet", "retry", "--rig", "hall", "--fleet", &address]);
    let retried = retried.output().unwrap();
    assert!(retried.status.success(), "{}", said(&retried));
    String::from_utf8_lossy(&retried.stdout).into_owned()
}

#[test]
fn a_second_result_is_equal_or_told_as_a_defect_also_after_a_restart() {
    let Some(bench) = TestBench::start("") else {
        return;
    };
    let rig = rig(&bench, |_| ());
    capture(&bench, &rig);
    let mut fleet = fleet_process(&bench, "");
    let worker = bench.worker("w", &[]);
    let made: Vec<String> = (0..6).map(|_| next(&rig, &bench).capture).collect();
    until("nothing is left of the jobs", || is_idle(&bench, &rig));
    drop(worker);
    let origin = |capture: &str| -> Value {
        let file = bench.path(&format!("models/cup/.{capture}.fleet"));
        serde_json::from_slice(&std::fs::read(file).unwrap()).unwrap()
    };
    let say = |capture: &str, contents: &str| {
        let digest = origin(capture)["digest"].as_str().unwrap().to_owned();
        say_result(&bench.address(), &digest, contents);
    };
    let told = |capture: &str| {
        let digest = origin(capture)["digest"].as_str().unwrap().to_owned();
        bench.log("fleet").lines().any(|line| {
            line.contains(&digest)
                && line.contains("made a model that differs from the existing one")
        })
    };
    let same = origin(&made[0])["contents_sha256"]
        .as_str()
        .unwrap()
        .to_owned();
    say(&made[0], &same);
    say(&made[1], &"0".repeat(64));
    until("a different result is told", || told(&made[1]));
    // While nobody hears of it.
    fleet.kill();
    say(&made[2], &"0".repeat(64));
    let same = origin(&made[3])["contents_sha256"]
        .as_str()
        .unwrap()
        .to_owned();
    say(&made[3], &same);
    let _fleet = fleet_process(&bench, "");
    until("a different result is told after a restart", || {
        told(&made[2])
    });
    assert!(!told(&made[0]) && !told(&made[3]), "{}", bench.log("fleet"));
}

/// Plays a worker that has sent one more result of a job.
fn say_result(address: &str, digest: &str, contents: &str) {
    runtime().block_on(async {
        let client = async_nats::connect(address).await.unwrap();
        let context = async_nats::jetstream::new(client);
        let said = json!({
            "outcome": "result", "worker": "late", "instance": "i", "bytes": 1, "crc32": 0, "pieces": 1,
            "contents_sha256": contents,
        });
        let subject = format!("scand.result.hall.{digest}");
        let published = context.publish(subject, said.to_string().into()).await;
        published.unwrap().await.unwrap();
    });
}

#[test]
fn a_recording_that_became_another_file_is_found_and_its_models_are_named_after_it() {
    let Some(bench) = TestBench::start("") else {
        return;
    };
    let rig = rig(&bench, |_| ());
    let path = capture(&bench, &rig);
    let renamed = path.with_file_name("renamed.mcap");
    std::fs::copy(&path, &renamed).unwrap();
    std::fs::remove_file(&path).unwrap();
    let _fleet = fleet_process(&bench, "");
    let _worker = bench.worker("w", &[]);
    for _ in 0..6 {
        let ended = next(&rig, &bench);
        assert_eq!(ended.recording, renamed);
        let folder = bench.path("models/renamed").join(&ended.capture);
        assert_eq!(ended.model.unwrap().folder, folder);
        assert!(folder.join("model.glb").exists());
    }
}

/// Plays a worker that answers one offer with a model of other settings; what it is told then.
async fn answer_with(address: &str, models: &Path, bundle: &Path) -> String {
    use futures_util::StreamExt;
    let client = async_nats::connect(address).await.unwrap();
    let context = async_nats::jetstream::new(client.clone());
    let mut stop = client.subscribe("scand.stop.wrong").await.unwrap();
    let found = loop {
        let asked = r#"{"last_by_subj":"scand.job.>"}"#;
        let found = client
            .request("$JS.API.STREAM.MSG.GET.SCAND_JOBS", asked.into())
            .await;
        let found = found.map(|found| found.payload).unwrap_or_default();
        let found: serde_json::Value = serde_json::from_slice(&found).unwrap_or_default();
        match found["message"]["subject"].as_str() {
            Some(subject) => break subject.to_owned(),
            None => tokio::time::sleep(Duration::from_millis(100)).await,
        }
    };
    let digest = found.rsplit('.').next().unwrap();
    let asked = format!("$JS.API.DIRECT.GET.SCAND_JOBS.{found}");
    let offer = client.request(asked, "".into()).await.unwrap();
    let offer: serde_json::Value = serde_json::from_slice(&offer.payload).unwrap();
    let made =
        scand::fleet::Bundle::of_folder(&models.join(offer["capture"].as_str().unwrap())).unwrap();
    scand::fleet::write_bundle(&made, bundle).unwrap();
    let bytes = std::fs::read(bundle).unwrap();
    let pieces: Vec<&[u8]> = bytes.chunks(512 << 10).collect();
    for (number, piece) in pieces.iter().enumerate() {
        let subject = format!("scand.part.hall.{digest}.wrong.i.{number}");
        context
            .publish(subject, piece.to_vec().into())
            .await
            .unwrap()
            .await
            .unwrap();
    }
    let sum = scand::fleet::FileSum::of(bundle).unwrap();
    let said = serde_json::json!({
        "outcome": "result", "worker": "wrong", "instance": "i", "bytes": sum.bytes, "crc32": sum.crc32,
        "pieces": pieces.len(), "contents_sha256": made.contents_sha256().unwrap(),
    });
    let result = format!("scand.result.hall.{digest}");
    context
        .publish(result, said.to_string().into())
        .await
        .unwrap()
        .await
        .unwrap();
    let told = tokio::time::timeout(Duration::from_secs(60), stop.next())
        .await
        .unwrap()
        .unwrap();
    String::from_utf8(told.payload.to_vec()).unwrap()
}
