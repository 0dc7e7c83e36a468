//! The whole rig on loopback: the daemon as a separate process, GigE Vision cameras over the real protocol, and a
//! depth camera through Debian's OpenNI2, all of which play a simulated recording. Each test has its own network.

#![allow(clippy::disallowed_methods, reason = "a test's channel ends with it")]

mod configuration;
mod faults;
#[path = "../gige/network.rs"]
#[allow(dead_code, reason = "what the camera's own tests want beside")]
mod network;
mod objects;
#[path = "../openni2-sensor/stage.rs"]
mod stage;
mod stand;
#[path = "../support/mod.rs"]
mod support;

use scand::frame::{CameraId, Picture};
use scand::recording::{CaptureOutcome, ColorPart, DepthPart, Recording, Topic};
use scand::trigger::Reply;
use stand::{Stand, served};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

fn color(index: usize, part: ColorPart) -> Topic {
    Topic::Color(CameraId::new(&format!("c{index:02}")).unwrap(), part)
}

fn kinect(part: DepthPart) -> Topic {
    Topic::Depth(CameraId::new("kinect").unwrap(), part)
}

/// The pixels of each message of a topic.
fn pixels(recording: &Recording, topic: &Topic) -> Vec<Vec<u8>> {
    let pictures =
        recording
            .messages(topic)
            .iter()
            .map(|m| match recording.picture(topic, m).unwrap() {
                Picture::Raw { data, .. } | Picture::Compressed { data, .. } => data.to_vec(),
            });
    pictures.collect()
}

fn recordings(folder: &Path) -> Vec<PathBuf> {
    let files = std::fs::read_dir(folder).unwrap();
    let mut files: Vec<_> = files.map(|f| f.unwrap().path()).collect();
    files.retain(|f| f.extension().is_some_and(|e| e == "mcap"));
    files.sort();
    files
}

/// F-score at 1 mm of what a recording's first capture becomes.
fn f_score(recording: &Path, truth: &Path, out: &Path) -> f64 {
    let replayed = stand::scand()
        .arg("--replay")
        .args([recording, Path::new("--out"), out])
        .arg("--quiet")
        .status();
    assert!(replayed.unwrap().success());
    let stem = out.join(recording.file_stem().unwrap());
    let capture = std::fs::read_dir(stem).unwrap().next().unwrap().unwrap();
    let measured = stand::scand()
        .arg("evaluate")
        .args([&capture.path().join("model.ply"), truth])
        .arg("--json")
        .output()
        .unwrap();
    let figures: serde_json::Value = serde_json::from_slice(&measured.stdout).unwrap();
    figures["whole"]["f_scores"][1]["f_score"].as_f64().unwrap()
}

#[test]
fn what_is_served_is_what_is_recorded_and_becomes_the_same_model() {
    network::alone(
        "what_is_served_is_what_is_recorded_and_becomes_the_same_model",
        || {
            let stand = Stand::start(&["sync.depth_frames=30"]);
            stand.tell("background");
            stand.ask_done(&scand::trigger::Request::Background {});
            stand.tell("captures");
            let Reply::Durable { recording, .. } = stand.press() else {
                panic!("{}", stand.log());
            };
            // A client that stays connected keeps no session from being completed.
            let idle = stand.client().unwrap();
            let folder = stand.end();
            drop(idle);
            let (original, truth) = served();
            let (original, kept) = (
                Recording::open(&original).unwrap(),
                Recording::open(&recording).unwrap(),
            );
            assert_eq!(kept.verify().unwrap(), []);
            // The file that it was calibrated with can be found again.
            let summed = std::process::Command::new("sha256sum")
                .arg(folder.path().join("calibration.toml"))
                .output()
                .unwrap();
            let mut records = kept.metadata().iter();
            let (_, about) = records.find(|(name, _)| name == "session").unwrap();
            assert!(
                summed
                    .stdout
                    .starts_with(about["calibration_sha256"].as_bytes())
            );
            for i in 0..11 {
                for part in [ColorPart::Image, ColorPart::Background] {
                    let topic = color(i, part);
                    assert_eq!(pixels(&kept, &topic), pixels(&original, &topic), "{topic}");
                }
            }
            // The sensor plays its frames round and round: the burst has each once, from wherever it began.
            for part in [DepthPart::Image, DepthPart::Color] {
                let topic = kinect(part);
                let [mut a, mut b] = [&kept, &original].map(|r| pixels(r, &topic));
                a.sort();
                b.sort();
                assert!(a == b, "{topic}: {} and {} frames", a.len(), b.len());
            }
            let [again, first] = [(&kept, "again"), (&original, "first")]
                .map(|(r, name)| f_score(r.path(), &truth, &folder.path().join(name)));
            assert!((again - first).abs() < 0.002, "{again} and {first}");
        },
    );
}

/// What presses were answered and how long after the press, printed for information (`--nocapture`); a figure
/// that depends on the machine is nothing to be held.
fn tell_latencies(presses: &[Vec<(Reply, Duration)>]) {
    let name = |reply: &Reply| match reply {
        Reply::Accepted { .. } => "accepted",
        Reply::Captured { .. } => "captured",
        Reply::Durable { .. } => "durable",
        _ => "failed or retried",
    };
    let mut latencies: BTreeMap<&str, Vec<Duration>> = BTreeMap::new();
    for (reply, after) in presses.iter().flatten() {
        latencies.entry(name(reply)).or_default().push(*after);
    }
    for (name, mut all) in latencies {
        all.sort();
        let at = |part: f64| all[((all.len() - 1) as f64 * part) as usize].as_secs_f64() * 1e3;
        println!(
            "press to {name}: p50 {:.1} ms, p99 {:.1} ms",
            at(0.5),
            at(0.99)
        );
    }
    let all: Duration = presses.iter().filter_map(|p| Some(p.last()?.1)).sum();
    let rate = presses.len() as f64 / all.as_secs_f64();
    println!("{rate:.2} captures a second");
}

#[test]
fn a_hundred_presses_lose_nothing_unsaid() {
    network::alone("a_hundred_presses_lose_nothing_unsaid", || {
        let stand = Stand::start(&["sync.depth_frames=10", "recording.largest_file_mb=200"]);
        let mut ends = BTreeMap::new();
        let (mut memory, mut presses) = (0, Vec::new());
        for i in 0..100 {
            let replies = stand.press_timed();
            match replies.last().cloned().unwrap().0 {
                Reply::Durable { capture, .. } => drop(ends.insert(capture, true)),
                Reply::Failed { capture, .. } => drop(ends.insert(capture, false)),
                other => panic!("{other:?}"),
            }
            presses.push(replies);
            if i == 20 {
                memory = stand.daemon_memory();
            }
        }
        tell_latencies(&presses);
        assert_eq!(ends.len(), 100);
        let grown = stand.daemon_memory().saturating_sub(memory);
        assert!(
            grown < 60_000_000,
            "{grown} bytes more than after 20 captures"
        );
        let folder = stand.end();
        let (mut times, mut complete, mut named) = (BTreeSet::new(), 0, 0);
        for file in recordings(&folder.path().join("recordings")) {
            let recording = Recording::open(&file).unwrap();
            for message in recording.messages(&Topic::Capture) {
                let record = recording.capture_record(message).unwrap();
                let frames = record
                    .cameras
                    .values()
                    .filter_map(|c| c.timestamps.as_ref());
                match record.outcome {
                    CaptureOutcome::Complete => {
                        complete += 1;
                        assert_eq!(frames.map(Vec::len).sum::<usize>(), 11 + 10);
                    }
                    // A frame that is missing has a reason that names its camera.
                    CaptureOutcome::Failed => {
                        named += 1;
                        let reason = record.reason.unwrap();
                        let silent = record
                            .cameras
                            .iter()
                            .filter(|(_, c)| c.timestamps.as_ref().is_none_or(Vec::is_empty));
                        for (camera, _) in silent {
                            assert!(reason.contains(camera), "{camera}: {reason}");
                        }
                    }
                }
            }
            for i in 0..11 {
                for message in recording.messages(&color(i, ColorPart::Image)) {
                    assert!(times.insert((i, message.log_time())), "a frame twice");
                }
            }
        }
        let durable = ends.values().filter(|d| **d).count();
        assert_eq!(complete, durable);
        assert!(durable >= 95, "{durable} of 100 complete, {named} failed");
    });
}

#[test]
fn cameras_that_fail_are_named_and_come_back() {
    network::alone("cameras_that_fail_are_named_and_come_back", || {
        let stand = Stand::start(&["sync.depth_frames=10", "capture.retry=0"]);
        let failed = |reply: Reply| match reply {
            Reply::Failed { reason, .. } => reason,
            other => panic!("{other:?}: {}", stand.log()),
        };
        // A camera that is switched off is named, and is back by itself when it is switched on.
        stand.tell("stop c03");
        let reason = failed(stand.press());
        assert!(reason.contains("c03"), "{reason}");
        stand.tell("start c03");
        stand.until_durable();
        // Lost packets never make a frame that looks whole.
        stand.tell("loss c05 0.2");
        let reason = failed(stand.press());
        assert!(reason.contains("c05"), "{reason}");
        stand.tell("loss c05 0");
        stand.until_durable();
        // A clock that stands still is not believed.
        stand.tell("freeze c07");
        let end = Instant::now() + Duration::from_secs(20);
        let reason = loop {
            if let Reply::Failed { reason, .. } = stand.press() {
                break reason;
            }
            assert!(Instant::now() < end, "a frozen clock is believed");
        };
        assert!(reason.contains("c07"), "{reason}");
        stand.tell("thaw c07");
        stand.until_durable();
        let folder = stand.end();
        for file in recordings(&folder.path().join("recordings")) {
            assert_eq!(Recording::open(&file).unwrap().verify().unwrap(), []);
        }
    });
}

#[test]
fn what_was_acknowledged_survives_a_kill_at_any_moment() {
    network::alone(
        "what_was_acknowledged_survives_a_kill_at_any_moment",
        || {
            let mut stand = Stand::start(&["sync.depth_frames=10"]);
            let mut acknowledged = BTreeSet::new();
            let rounds = support::torture::times(6, 15);
            for round in 0..rounds {
                if let Reply::Durable { capture, .. } = stand.press() {
                    acknowledged.insert(capture);
                }
                // The next one is killed in its middle, each round at another place.
                stand.begin_press();
                std::thread::sleep(Duration::from_millis(40 * round % 500));
                stand.kill_and_restart();
            }
            assert!(acknowledged.len() as u64 >= rounds - 1, "{}", stand.log());
            let folder = stand.end();
            let mut found = BTreeSet::new();
            for file in recordings(&folder.path().join("recordings")) {
                let recording = Recording::open(&file).unwrap();
                assert_eq!(recording.verify().unwrap(), []);
                for message in recording.messages(&Topic::Capture) {
                    found.insert(recording.capture_record(message).unwrap().id);
                }
            }
            let lost: Vec<_> = acknowledged.difference(&found).collect();
            assert!(lost.is_empty(), "{lost:?}");
            let kept = acknowledged.len();
            println!(
                "shown: {rounds} kills of a rig of twelve cameras: 0 of {kept} durable captures lost"
            );
        },
    );
}

#[test]
fn a_daemon_that_is_told_to_end_finishes_the_capture_first() {
    network::alone(
        "a_daemon_that_is_told_to_end_finishes_the_capture_first",
        || {
            let stand = Stand::start(&["sync.depth_frames=10"]);
            let mut press = stand.begin_press();
            let accepted = press.reply().unwrap();
            assert!(matches!(accepted, Reply::Accepted { .. }), "{accepted:?}");
            let (end, folder) = stand.end_during(press);
            let (Reply::Durable { capture, .. } | Reply::Failed { capture, .. }) = &end else {
                panic!("{end:?}");
            };
            // Complete under its final name, whichever it was.
            let files = recordings(&folder.path().join("recordings"));
            let recording = Recording::open(&files[0]).unwrap();
            assert_eq!(recording.damage(), []);
            let records = recording.messages(&Topic::Capture).iter();
            let ids: Vec<String> = records
                .map(|m| recording.capture_record(m).unwrap().id)
                .collect();
            assert!(ids.contains(capture), "{end:?}: {ids:?}");
        },
    );
}

#[test]
fn a_full_disk_fails_a_capture_and_no_other() {
    network::alone("a_full_disk_fails_a_capture_and_no_other", || {
        let settings = [
            "sync.depth_frames=10",
            "capture.retry=0",
            "recording.keep_free_mb=0",
        ];
        // Room for many captures of 18 MB, also for those that fail until all cameras are well. Another program fills
        // it while nobody looks.
        let stand = Stand::start_on_small_disk(&settings, 400);
        assert!(matches!(stand.press(), Reply::Durable { .. }));
        let reply = stand.fill_disk_while_capturing(9_000_000);
        let (Reply::Failed { reason, .. } | Reply::Refused { reason }) = &reply else {
            panic!("{reply:?}");
        };
        assert!(
            reason.contains("space") || reason.contains("MB left"),
            "{reason}"
        );
        stand.remove_filler();
        stand.until_durable();
        let status = stand.status();
        assert!(status["complete"].as_u64() >= Some(2), "{status}");
    });
}

#[test]
fn a_late_frame_is_its_own_captures_or_nobodys() {
    network::alone("a_late_frame_is_its_own_captures_or_nobodys", || {
        let stand = Stand::start(&[
            "sync.depth_frames=10",
            "sync.window_ms=1500",
            "capture.patience_ms=1500",
            "capture.retry=0",
        ]);
        // Late, and in time: a capture waits for it.
        stand.tell("delay c04 800");
        let reply = stand.press();
        assert!(matches!(reply, Reply::Durable { .. }), "{reply:?}");
        // Later than anybody waits: the capture is not whole, and the next one does not take the frame for its own.
        stand.tell("delay c04 4500");
        let Reply::Failed { reason, .. } = stand.press() else {
            panic!("{}", stand.log());
        };
        assert!(reason.contains("c04"), "{reason}");
        stand.tell("delay c04 0");
        stand.until_durable();
        let folder = stand.end();
        for file in recordings(&folder.path().join("recordings")) {
            let recording = Recording::open(&file).unwrap();
            let records = recording.messages(&Topic::Capture);
            let mut seen = BTreeSet::new();
            for record in records.iter().map(|m| recording.capture_record(m).unwrap()) {
                for (camera, given) in &record.cameras {
                    for time in given.timestamps.iter().flatten() {
                        assert!(seen.insert((camera.clone(), *time)), "{camera}: twice");
                    }
                }
                if record.outcome == CaptureOutcome::Complete {
                    let skew_ns = record.skew_ns.unwrap();
                    assert!(
                        skew_ns < 500_000_000,
                        "{skew_ns} ns: another capture's frame"
                    );
                }
            }
        }
    });
}

#[test]
fn a_rig_without_a_calibration_records_the_session_that_it_is_calibrated_from() {
    network::alone(
        "a_rig_without_a_calibration_records_the_session_that_it_is_calibrated_from",
        || {
            let stand = Stand::start(&["rig.calibration=", "sync.depth_frames=10"]);
            assert!(
                stand.log().contains("no models are made"),
                "{}",
                stand.log()
            );
            let Reply::Durable { recording, .. } = stand.press() else {
                panic!("{}", stand.log());
            };
            let _folder = stand.end();
            let kept = Recording::open(&recording).unwrap();
            assert_eq!(kept.verify().unwrap(), []);
            // Nobody has shown a board, and this is what is missing.
            let calibrated = stand::scand()
                .args(["calibrate", "--board", "checkerboard:9x6:25mm"])
                .arg(&recording)
                .output()
                .unwrap();
            let words = String::from_utf8_lossy(&calibrated.stderr).into_owned();
            assert_eq!(calibrated.status.code(), Some(1), "{words}");
            assert!(words.contains("board"), "{words}");
        },
    );
}

#[test]
fn a_slow_disk_refuses_presses_and_disturbs_no_camera() {
    network::alone("a_slow_disk_refuses_presses_and_disturbs_no_camera", || {
        // Each fdatasync takes three seconds more; two captures may wait for it.
        let stand = Stand::start_on_slow_disk(&["sync.depth_frames=10"], Duration::from_secs(3));
        let (mut pressed, mut refused, mut most) = (Vec::new(), 0, 0);
        let end = Instant::now() + Duration::from_secs(6);
        while Instant::now() < end {
            let mut client = stand.begin_press();
            loop {
                match client.reply().unwrap() {
                    Reply::Captured { .. } => break pressed.push(client),
                    Reply::Refused { reason } => {
                        assert!(reason.contains("the recorder's queue is full"), "{reason}");
                        refused += 1;
                        break std::thread::sleep(Duration::from_millis(50));
                    }
                    Reply::Busy => break std::thread::sleep(Duration::from_millis(5)),
                    Reply::Accepted { .. } => {}
                    other => panic!("{other:?}"),
                }
            }
            most = most.max(stand.status()["memory"][0].as_u64().unwrap());
        }
        assert!(refused > 0, "{} captures, none refused", pressed.len());
        let status = stand.status();
        assert!(
            most <= status["memory"][1].as_u64().unwrap(),
            "{most}: {status}"
        );
        // A camera whose thread waits for the disk misses three seconds, which are 90 depth frames; a busy machine
        // misses some of them by itself.
        let undisturbed = |camera: &serde_json::Value| {
            let lost = camera["lost_frames"].as_u64();
            camera["state"] == "ready" && lost.is_some_and(|lost| lost < 30)
        };
        let mut cameras = status["cameras"].as_object().unwrap().values();
        assert!(cameras.all(undisturbed), "{status}");
        // What was captured becomes durable, however long it takes.
        for mut client in pressed {
            let reply = client.reply().unwrap();
            assert!(matches!(reply, Reply::Durable { .. }), "{reply:?}");
        }
        stand.end();
    });
}

#[test]
fn a_press_becomes_a_model_and_what_an_end_interrupts_is_made_after_the_next_start() {
    network::alone(
        "a_press_becomes_a_model_and_what_an_end_interrupts_is_made_after_the_next_start",
        || {
            let mut stand = Stand::start(&[
                "sync.depth_frames=10",
                "workers.count=1",
                "hull.resolution=60",
            ]);
            stand.tell("background");
            stand.ask_done(&scand::trigger::Request::Background {});
            stand.tell("captures");
            let press = |stand: &Stand| match stand.press() {
                Reply::Durable { capture, recording } => {
                    let stem = recording.file_stem().unwrap().to_owned();
                    Path::new(&stem).join(capture)
                }
                other => panic!("{other:?}: {}", stand.log()),
            };
            let is_running =
                |m: &serde_json::Value| m["running"].as_array().is_some_and(|r| !r.is_empty());
            let first = press(&stand);
            stand.until_models("no end of the first", |m| {
                m["done"] == 1 || m["failed"] == 1
            });
            let second = press(&stand);
            stand.until_models("nothing runs", is_running);
            stand.kill_and_restart();
            stand.until_models("no model after a kill", |m| m["done"] == 1);
            let third = press(&stand);
            stand.until_models("nothing runs", is_running);
            let log = stand.log();
            let folder = stand.end();
            let outcome = |model: &Path| {
                let report = folder.path().join("models").join(model).join("report.json");
                let text = std::fs::read(report).ok()?;
                let report: serde_json::Value = serde_json::from_slice(&text).unwrap();
                report["outcome"].as_str().map(str::to_owned)
            };
            let outcomes = [first, second, third].map(|model| outcome(&model));
            assert_eq!(
                outcomes,
                [Some("done".into()), Some("done".into()), None],
                "{log}"
            );
            let jobs = std::fs::read_dir(folder.path().join("recordings/jobs")).unwrap();
            let jobs =
                jobs.filter(|j| j.as_ref().unwrap().path().extension() == Some("job".as_ref()));
            assert_eq!(jobs.count(), 1);
        },
    );
}
