//! Looks at scripted cameras: which client gets what, that a press waits for one picture at most, and that looking ends
//! by itself.

use super::protocol::SegmentationSettings;
use super::*;
use crate::daemon::capturing::Order;
use crate::daemon::rig::{Rig, RigLook, State};
use crate::daemon::scripted::{Behaviour, TestBench, rig, start, start_at, start_in};
use crate::daemon::{CameraKind, ReloadedSettings, Watchdog};
use crate::drivers::live::Pool;
use crate::frame::CameraId;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// A program in the place of scand, which counts its calls and says what a picture shows.
fn program(folder: &Path, script: &str) -> std::path::PathBuf {
    let program = folder.join("make-look.sh");
    let calls = folder.join("calls").display().to_string();
    let text = format!("#!/bin/sh\necho . >>{calls}\n{script}\n");
    std::fs::write(&program, text).unwrap();
    std::fs::set_permissions(&program, std::fs::Permissions::from_mode(0o755)).unwrap();
    program
}

const SHOWS: &str = r#"cat >/dev/null; printf '{"width":4,"height":3,"scale":16}\nJPEG'"#;

fn bench(script: &str, memory: usize) -> TestBench {
    let folder = tempfile::tempdir().unwrap();
    let program = program(folder.path(), script);
    start_in(folder, memory, |plan| {
        plan.look = Some(LookPlan {
            program,
            cutting: None,
        });
    })
}

/// What is seen until `wanted` holds, of all that was told.
fn look_until(bench: &TestBench, wanted: impl Fn(&[Event]) -> bool) -> Vec<Event> {
    let mut looker = bench.capturing.look().unwrap();
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .unwrap();
    runtime.block_on(async {
        let mut seen = Vec::new();
        while !wanted(&seen) {
            let next = tokio::time::timeout(Duration::from_secs(30), looker.next());
            seen.push(next.await.unwrap_or_else(|_| panic!("{seen:?}")));
        }
        seen
    })
}

fn cameras(events: &[Event], with_picture: bool) -> Vec<&str> {
    let mut cameras: Vec<&str> = events
        .iter()
        .filter_map(|event| match event {
            Event::Looked {
                camera, picture, ..
            } if picture.is_some() == with_picture => Some(camera.as_str()),
            _ => None,
        })
        .collect();
    cameras.sort_unstable();
    cameras.dedup();
    cameras
}

fn words_of(events: &[Event], of: &str) -> Vec<String> {
    let words = events.iter().filter_map(|event| match event {
        Event::Looked { camera, words, .. } if camera == of => words.clone(),
        _ => None,
    });
    words.collect()
}

#[test]
fn every_camera_is_shown_with_its_age_and_nothing_is_recorded() {
    let bench = bench(SHOWS, 4_000_000);
    let seen = look_until(&bench, |seen| cameras(seen, true).len() == 4);
    let Event::Looked {
        picture,
        seen,
        age_ms,
        ..
    } = &seen[0]
    else {
        panic!("{seen:?}");
    };
    assert_eq!(picture.as_deref(), Some("SlBFRw=="));
    assert_eq!(seen.as_ref().unwrap().scale, 16);
    assert!(*age_ms < 20_000);
    let status = bench.capturing.status();
    assert_eq!((status.session, status.late_frames), (None, 0));
    assert!(
        status
            .cameras
            .values()
            .all(|camera| camera.lost_frames == 0)
    );
    let (folder, stuck) = bench.stop();
    assert!(stuck.is_empty());
    let recordings = crate::daemon::scripted::recordings(folder.path());
    assert!(recordings.is_empty());
}

#[test]
fn looking_ends_when_nobody_looks_and_old_pictures_are_forgotten() {
    let bench = bench(SHOWS, 4_000_000);
    look_until(&bench, |seen| !seen.is_empty());
    // What was begun comes to its end.
    let calls = || {
        std::fs::read_to_string(bench.folder.path().join("calls"))
            .unwrap()
            .len()
    };
    let mut before = calls();
    loop {
        std::thread::sleep(Duration::from_millis(600));
        match calls() {
            now if now == before => break,
            now => before = now,
        }
    }
    let looker = bench.capturing.look().unwrap();
    assert!(looker.looks.0.newest.lock().is_empty());
}

#[test]
fn presses_go_on_while_somebody_looks() {
    let bench = bench(SHOWS, 4_000_000);
    let looker = bench.capturing.look().unwrap();
    for _ in 0..5 {
        let heard = bench.press();
        assert!(
            matches!(heard.last(), Some(Event::Durable { .. })),
            "{heard:?}"
        );
    }
    drop(looker);
    let status = bench.capturing.status();
    assert_eq!(
        (status.complete, status.failed, status.late_frames),
        (5, 0, 0)
    );
}

#[test]
fn why_a_cameras_looks_are_whole_is_told_once() {
    let mut scheduler = LookScheduler {
        looks: Looks::new(crate::clock::Clock::system()),
        maker: None,
        turns: Turns::default(),
        told: BTreeMap::new(),
    };
    let [c00, c01] = ["c00", "c01"].map(|id| CameraId::new(id).unwrap());
    assert_eq!(scheduler.new_reason(&c00, None), None);
    assert_eq!(scheduler.new_reason(&c00, Some("slow")), Some("slow"));
    assert_eq!(scheduler.new_reason(&c00, Some("slow")), None);
    assert_eq!(scheduler.new_reason(&c01, Some("slow")), Some("slow"));
    assert_eq!(scheduler.new_reason(&c00, Some("stuck")), Some("stuck"));
}

/// Notes what cameras report until a picture is there.
fn wait_for_look(rig: &mut Rig) -> RigLook {
    loop {
        let message = rig.events().recv_timeout(Duration::from_secs(30)).unwrap();
        rig.note(message);
        if let Some(look) = rig.take_look() {
            return look;
        }
    }
}

#[test]
fn a_shot_waits_for_the_picture_in_transfer_and_not_for_one_that_never_comes() {
    let clock = Clock::system();
    let pool = Pool::new(4_000_000);
    let cameras = [("c00", CameraKind::Color), ("c01", CameraKind::Color)];
    let (mut rig, behaviours) = rig(clock, 0, &cameras, &pool);
    while rig
        .states()
        .any(|(_, _, state)| !matches!(state, State::Ready(_)))
    {
        let message = rig.events().recv_timeout(Duration::from_secs(30)).unwrap();
        rig.note(message);
    }
    let heartbeat = Watchdog::default().heartbeat("test");
    let c01 = CameraId::new("c01").unwrap();
    let long = Duration::from_secs(600);
    assert!(rig.begin_look(&c01, long));
    assert!(!rig.begin_look(&c01, long), "one is in transfer");
    let look = wait_for_look(&mut rig);
    assert_eq!(look.outcome.unwrap().frames.len(), 1);
    // One that is in transfer is over then, and dropped.
    assert!(rig.begin_look(&c01, long));
    rig.end_look(&heartbeat);
    assert!(!rig.is_looking() && rig.take_look().is_none());
    // One that never comes is given up long before its deadline.
    behaviours["c01"].store(
        Behaviour::Silent as u32,
        std::sync::atomic::Ordering::Relaxed,
    );
    assert!(rig.begin_look(&c01, long));
    let begin = Instant::now();
    rig.end_look(&heartbeat);
    assert!(begin.elapsed() < Duration::from_secs(60));
    assert!(!rig.is_looking());
    // The camera's thread takes the next shot all the same.
    behaviours["c01"].store(
        Behaviour::Sound as u32,
        std::sync::atomic::Ordering::Relaxed,
    );
    let result = rig.shoot(
        |_| true,
        clock.timestamp(),
        Duration::from_secs(60),
        &heartbeat,
    );
    assert!(result.answers.values().all(Result::is_ok), "{result:?}");
    assert_eq!((result.frames.len(), rig.late_frames()), (2, 0));
    drop(result);
    assert!(
        rig.stop(Instant::now() + Duration::from_secs(30))
            .is_empty()
    );
    assert_eq!(pool.in_use(), 0);
}

#[test]
fn a_camera_that_is_away_or_gives_nothing_is_told_with_its_reason() {
    let bench = bench(SHOWS, 4_000_000);
    bench.behaviour("c02", Behaviour::Loses);
    let seen = look_until(&bench, |seen| {
        cameras(seen, false) == ["c02"] && cameras(seen, true).len() == 3
    });
    assert_eq!(words_of(&seen, "c02"), ["a damaged frame"]);
}

#[test]
fn a_process_that_fails_is_told_and_the_next_picture_is_tried() {
    let bench = bench("cat >/dev/null; echo no such camera >&2; exit 3", 4_000_000);
    let seen = look_until(&bench, |seen| cameras(seen, false).len() == 4);
    let words = &words_of(&seen, "c00")[0];
    assert!(words.contains("no such camera"), "{words}");
    for garbage in ["echo no json", "exit 0", "head -c 3000000 /dev/zero"] {
        let bench = self::bench(garbage, 4_000_000);
        let seen = look_until(&bench, |seen| !seen.is_empty());
        assert!(cameras(&seen, true).is_empty(), "{garbage}: {seen:?}");
    }
}

#[test]
fn a_look_leaves_the_memory_of_a_capture_alone() {
    // Three colour frames and a depth camera's twelve: no byte is left beside a capture.
    let memory = 64 * 48 * (3 + 12 * 5);
    let bench = bench(SHOWS, memory);
    let seen = look_until(&bench, |seen| cameras(seen, false).len() == 4);
    assert!(cameras(&seen, true).is_empty());
    assert!(words_of(&seen, "c00")[0].contains("capture.memory_mb"));
}

#[test]
fn a_look_cuts_objects_out_with_what_a_reload_brings() {
    let folder = tempfile::tempdir().unwrap();
    let heads = folder.path().join("heads");
    let script = format!("head -n 1 >>{}; {SHOWS}", heads.display());
    let program = program(folder.path(), &script);
    let mut kept = None;
    let bench = start_in(folder, 4_000_000, |plan| {
        let (capture, recording) = (plan.capture.clone(), plan.recording.clone());
        kept = Some((capture, recording, plan.header.clone()));
        plan.look = Some(LookPlan {
            program,
            cutting: None,
        });
    });
    look_until(&bench, |seen| !cameras(seen, true).is_empty());
    let before = std::fs::read_to_string(&heads).unwrap();
    assert!(before.contains("\"cutting\":null"), "{before}");
    let (capture, recording, header) = kept.unwrap();
    let reloaded = ReloadedSettings {
        capture,
        recording,
        calibration: None,
        header,
        cutting: Some(Arc::new(SegmentationSettings {
            calibration: "what a reload brought".into(),
            silhouette: serde_json::Value::Null,
        })),
    };
    let (tell, told) = std::sync::mpsc::channel();
    let answer = Box::new(move |result| drop(tell.send(result)));
    let order = Order::Reload(Box::new(reloaded), answer);
    bench.capturing.order(order);
    told.recv_timeout(Duration::from_secs(30)).unwrap().unwrap();
    let is_used = || {
        let heads = std::fs::read_to_string(&heads).unwrap();
        heads.contains("what a reload brought")
    };
    look_until(&bench, |_| is_used());
}

#[test]
fn beside_cameras_that_wait_for_a_signal_only_depth_cameras_are_asked_for_pictures() {
    let folder = tempfile::tempdir().unwrap();
    let program = program(folder.path(), SHOWS);
    let cameras_of_the_rig = [
        ("line0", CameraKind::Color),
        ("c01", CameraKind::Color),
        ("k0", CameraKind::Depth),
        ("k1", CameraKind::DepthInTurn),
    ];
    let bench = start_at(
        Clock::system(),
        &cameras_of_the_rig,
        folder,
        4_000_000,
        |plan| {
            plan.look = Some(LookPlan {
                program,
                cutting: None,
            });
        },
    );
    let seen = look_until(&bench, |seen| {
        cameras(seen, false).len() == 2 && cameras(seen, true).len() == 2
    });
    assert_eq!(cameras(&seen, true), ["k0", "line0"]);
    assert!(words_of(&seen, "c01")[0].contains("line0"), "{seen:?}");
    assert!(words_of(&seen, "k1")[0].contains("take_turns"), "{seen:?}");
}

/// Begins a look that gives nothing, and waits for its end as a trigger does: by how many milliseconds the trigger is
/// later than the look, and how long the wait was.
fn milliseconds_of_a_trigger(cameras: &[(&str, CameraKind)], at_most: Duration) -> (f64, f64) {
    let clock = Clock::system();
    let pool = Pool::new(4_000_000);
    let (mut rig, behaviours) = rig(clock, 0, cameras, &pool);
    while rig
        .states()
        .any(|(_, _, state)| !matches!(state, State::Ready(_)))
    {
        let message = rig.events().recv_timeout(Duration::from_secs(30)).unwrap();
        rig.note(message);
    }
    let silent = Behaviour::Silent as u32;
    behaviours["k0"].store(silent, std::sync::atomic::Ordering::Relaxed);
    let begun = clock.timestamp();
    assert!(rig.begin_look(&CameraId::new("k0").unwrap(), at_most));
    let (trigger, _) = rig.end_look(&Watchdog::default().heartbeat("test"));
    let ended = clock.timestamp();
    let after = |time: Timestamp| time.nanoseconds_since(begun) as f64 / 1e6;
    (after(trigger), after(ended))
}

#[test]
fn what_a_signal_exposed_while_a_picture_was_in_transfer_belongs_to_the_trigger_that_waited() {
    // One trigger waits for the picture, and its cameras with it.
    let free = [("c00", CameraKind::Color), ("k0", CameraKind::Depth)];
    let (trigger, waited) = milliseconds_of_a_trigger(&free, Duration::from_millis(60));
    assert!(trigger >= 60.0 && waited >= trigger, "{trigger} {waited}");
    // A signal does not wait: the trigger is as old as the wait, which is shorter than was allowed.
    let signalled = [("line0", CameraKind::Color), ("k0", CameraKind::Depth)];
    let (trigger, waited) = milliseconds_of_a_trigger(&signalled, Duration::from_secs(600));
    assert!(
        trigger < 500.0 && (500.0..60_000.0).contains(&waited),
        "{trigger} {waited}"
    );
}

#[test]
fn a_daemon_without_a_program_shows_none() {
    assert!(start(|_| ()).capturing.look().is_none());
}
