//! Workers and servers that are killed, stopped, or lose what they had, all in one run; a worker that sends rubbish.

use crate::support::dice::Dice;
use crate::support::torture;
use crate::test_bench::{
    Process, TestBench, finished, made_here, models, runtime, said, simulated, told,
};
use rustix::process::Signal;
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::time::{Duration, Instant};

/// The models that have been put into place, each with the number of its folder, which a second one would not have.
#[derive(Default)]
struct Committed(BTreeMap<PathBuf, u64>);

impl Committed {
    /// Looks again; how many there are.
    fn count(&mut self, out: &Path) -> usize {
        let folders = std::fs::read_dir(out).into_iter().flatten().flatten();
        let inner = folders.filter_map(|folder| std::fs::read_dir(folder.path()).ok());
        let paths = inner.flatten().flatten().map(|entry| entry.path());
        for path in paths.filter(|path| path.join("model.glb").exists()) {
            let name = path.file_name().unwrap().to_string_lossy();
            if name.starts_with('.') {
                continue;
            }
            let number = std::fs::metadata(&path).unwrap().ino();
            let first = *self.0.entry(path.clone()).or_insert(number);
            assert_eq!(first, number, "{} was put into place twice", path.display());
        }
        self.0.len()
    }
}

/// What befalls a fleet.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Fault {
    /// A worker is killed, and another one started.
    Worker,
    /// A worker stands still for longer than the server waits for it.
    Stopped,
    /// The server is killed and started again.
    Server,
    /// So that it has nothing left.
    Store,
}

/// A hundred captures and twenty kills, or more under `SCAND_TORTURE`.
#[test]
fn whatever_is_killed_each_capture_is_committed_once_and_is_what_it_would_be_here() {
    let recording = simulated(100);
    for round in 0..torture::times(1, 1) {
        let Some(bench) = TestBench::start("") else {
            return;
        };
        let here = made_here(&bench, &recording);
        assert_eq!(here.len(), 100);
        let seed = round + u64::from(std::process::id());
        let mut dice = Dice(seed);
        // Twenty kills; the others only stand still.
        let mut faults = vec![Fault::Worker; 16];
        faults.extend([Fault::Server; 3]);
        faults.push(Fault::Store);
        faults.extend([Fault::Stopped; 2]);
        // In an order of its own each time.
        for i in (1..faults.len()).rev() {
            faults.swap(i, dice.index(i + 1));
        }
        println!("shown: round {round}, seed {seed}: {faults:?}");
        let mut workers: Vec<Process> = (0..2)
            .map(|i| bench.worker(&format!("w{i}"), &[]))
            .collect();
        let out = bench.path("out");
        let mut replay = bench.by_fleet(&recording, "out", &[]);
        replay.args(["--in-flight", "24"]);
        let log = |name: &str| std::fs::File::create(bench.path(name)).unwrap();
        replay.stdout(log("told")).stderr(log("replay.log"));
        let mut replay = Process(replay.spawn().unwrap());
        let mut stopped: Vec<(Process, Instant)> = Vec::new();
        let mut started = 2;
        let count = faults.len();
        let committed = RefCell::new(Committed::default());
        let so_many = || committed.borrow_mut().count(&out);
        for (number, fault) in faults.into_iter().enumerate() {
            let wanted = 2 + number * 90 / count;
            let so_far = || format!("{} of {wanted}\n{}", so_many(), bench.log("replay"));
            crate::support::wait::until_or("models come", so_far, || {
                so_many() >= wanted || replay.0.try_wait().unwrap().is_some()
            });
            match fault {
                Fault::Worker | Fault::Stopped => {
                    let mut worker = workers.remove(dice.index(workers.len()));
                    match fault {
                        Fault::Worker => worker.kill(),
                        _ => {
                            worker.signal(Signal::STOP);
                            stopped.push((worker, Instant::now()));
                        }
                    }
                    workers.push(bench.worker(&format!("w{started}"), &[]));
                    started += 1;
                }
                Fault::Server | Fault::Store => {
                    bench.kill_server();
                    if fault == Fault::Store {
                        bench.wipe_store();
                    }
                    std::thread::sleep(Duration::from_millis(dice.below(1500)));
                    bench.start_server();
                }
            }
            // Those that stood still for long enough go on.
            for (worker, since) in &stopped {
                if since.elapsed() > Duration::from_secs(13) {
                    worker.signal(Signal::CONT);
                }
            }
        }
        let code = replay.wait();
        assert!(code.success(), "{}", bench.log("replay"));
        let text = std::fs::read_to_string(bench.path("told")).unwrap();
        let mut done: BTreeMap<String, usize> = BTreeMap::new();
        for line in text.lines() {
            let outcome: serde_json::Value = serde_json::from_str(line).unwrap();
            assert_eq!(outcome["result"], "done", "{outcome:#}");
            *done.entry(outcome["capture"].to_string()).or_default() += 1;
        }
        assert_eq!((done.len(), done.values().max()), (100, Some(&1)));
        assert_eq!(so_many(), 100);
        assert!(models(&out) == here);
        println!("shown: round {round}: 100 models, each once, with {started} workers");
    }
}

#[test]
fn rubbish_that_a_worker_sends_is_refused_three_times_and_never_put_into_place() {
    let Some(bench) = TestBench::start("") else {
        return;
    };
    let recording = simulated(6);
    let one = ["--capture", "ball-000"];
    let replay = bench
        .by_fleet(&recording, "out", &one)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn();
    let replay = replay.unwrap();
    let address = bench.address();
    let hostile = std::thread::spawn(move || {
        runtime().block_on(send_rubbish(&address));
    });
    let output = finished(replay);
    hostile.join().unwrap();
    assert_eq!(output.status.code(), Some(1), "{}", said(&output));
    let reason = told(&output)[0]["reasons"][0].to_string();
    assert!(
        reason.contains("failed 3 times") && reason.contains("was refused"),
        "{reason}"
    );
    let folder = bench.path("out/fleet-6/ball-000");
    let files: Vec<_> = std::fs::read_dir(&folder)
        .unwrap()
        .map(|f| f.unwrap().file_name())
        .collect();
    assert!(
        files
            .iter()
            .all(|name| name == "report.json" || name == "worker.log"),
        "{files:?}"
    );
    assert!(!bench.path("evil").exists());
    // Whose model it would have been is taken back.
    let beside = std::fs::read_dir(folder.parent().unwrap()).unwrap();
    let beside: Vec<_> = beside.map(|f| f.unwrap().file_name()).collect();
    assert_eq!(beside, ["ball-000"]);
}

/// Plays a worker that answers each offer with what is no result.
async fn send_rubbish(address: &str) {
    use futures_util::StreamExt;
    let client = async_nats::connect(address).await.unwrap();
    let context = async_nats::jetstream::new(client.clone());
    let mut offers = client.subscribe("scand.job.>").await.unwrap();
    let rubbish = b"scand bundle 1\n0000000000000000000000000000000000000000000000000000000000000000\n../../evil";
    for number in 0..3 {
        let subject = loop {
            match tokio::time::timeout(Duration::from_secs(1), offers.next()).await {
                Ok(message) => break message.unwrap().subject.to_string(),
                // The first offer may have come before this one listened.
                Err(_) if number == 0 => {
                    let asked = r#"{"last_by_subj":"scand.job.>"}"#;
                    let found = client
                        .request("$JS.API.STREAM.MSG.GET.SCAND_JOBS", asked.into())
                        .await;
                    let found = found.map(|found| found.payload).unwrap_or_default();
                    let found: serde_json::Value =
                        serde_json::from_slice(&found).unwrap_or_default();
                    if let Some(subject) = found["message"]["subject"].as_str() {
                        break subject.to_owned();
                    }
                }
                Err(_) => {}
            }
        };
        let digest = subject.rsplit('.').next().unwrap();
        let instance = format!("evil-{number}");
        let piece = format!("scand.part.archive.{digest}.evil.{instance}.0");
        context
            .publish(piece, rubbish.to_vec().into())
            .await
            .unwrap()
            .await
            .unwrap();
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), rubbish).unwrap();
        let sum = scand::fleet::FileSum::of(file.path()).unwrap();
        let said = serde_json::json!({
            "outcome": "result", "worker": "evil", "instance": instance, "bytes": sum.bytes,
            "crc32": sum.crc32, "pieces": 1, "contents_sha256": "0".repeat(64),
        });
        let result = format!("scand.result.archive.{digest}");
        context
            .publish(result, said.to_string().into())
            .await
            .unwrap()
            .await
            .unwrap();
    }
}
