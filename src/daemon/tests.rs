//! Tests the daemon's threads with scripted cameras: presses, failures, a full queue, sessions.

use super::capturing::Order;
use super::packing::Packer;
use super::scripted::{
    Behaviour, CAMERAS, TestBench, captures, recordings, start, start_at, start_in,
};
use super::*;
use crate::clock::Clock;
use crate::frame::{CameraId, Timestamp};
use crate::recording::{CaptureOutcome, ColorPart, Recording, Topic, interrupted, unfinished_name};
use crate::trigger::{Event, Reply, Until};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

#[test]
fn one_press_is_one_durable_capture() {
    let stand = start(|_| ());
    let heard = stand.press();
    assert!(matches!(&heard[0], Reply::Accepted { .. }), "{heard:?}");
    assert!(matches!(&heard[1], Reply::Captured { .. }), "{heard:?}");
    let Reply::Durable { capture, recording } = &heard[2] else {
        panic!("{heard:?}");
    };
    assert!(recording.with_extension("mcap.part").exists());
    let (folder, stuck) = stand.stop();
    assert_eq!(stuck, []);
    let found = &recordings(folder.path())[0];
    assert_eq!(found.path(), recording);
    assert_eq!(found.verify().unwrap(), []);
    let all = captures(found);
    assert_eq!(
        all,
        [(capture.clone(), CaptureOutcome::Complete, 3 + 12, None)]
    );
    let depth = Topic::Depth(
        CameraId::new("k0").unwrap(),
        crate::recording::DepthPart::Image,
    );
    // Two of the burst's fourteen frames were not the capture's.
    assert_eq!(found.messages(&depth).len(), 12);
    let trigger = found.messages(&Topic::Trigger)[0];
    let trigger = found.trigger(&trigger).unwrap();
    assert_eq!(trigger.press_id.as_deref(), Some("p1"));
}

#[test]
fn depth_cameras_that_take_turns_have_a_window_each() {
    let cameras = [
        ("c00", CameraKind::Color),
        ("k0", CameraKind::DepthInTurn),
        ("k1", CameraKind::DepthInTurn),
    ];
    let folder = tempfile::tempdir().unwrap();
    // The first camera's turn is longer than one window.
    let clock = Clock::by_hand(Timestamp(1_760_000_000_000_000_000));
    let stand = start_at(clock, &cameras, folder, 4_000_000, |plan| {
        plan.sync.window_ms = 80.0;
        plan.capture.patience_ms = 1000;
        plan.capture.retry = 0;
    });
    stand.behaviour("k0", Behaviour::Slow);
    stand.behaviour("k1", Behaviour::Slow);
    let heard = stand.press();
    assert!(
        matches!(heard.last(), Some(Reply::Durable { .. })),
        "{heard:?}"
    );
}

#[test]
fn what_the_rig_says_of_itself_is_not_said_by_who_begins_a_session() {
    let stand = start(|plan| drop(plan.header.about.insert("rig".into(), "a".into())));
    let about = BTreeMap::from([("rig".into(), "b".into())]);
    let refused = stand.ask(|answer| Order::Begin("s".into(), about.clone(), answer));
    assert!(refused.unwrap_err().contains("\"rig\""));
}

/// What a press with a name was answered up to its being on the disk.
fn named_press(stand: &TestBench) -> Vec<Reply> {
    let mut pressed = stand
        .capturing
        .press("test".into(), Some("p9".into()), None, None);
    let mut replies = Vec::new();
    while !replies
        .last()
        .is_some_and(|r: &Reply| r.is_end(Until::Durable))
    {
        replies.extend(pressed.try_next());
        std::thread::sleep(Duration::from_millis(1));
    }
    replies
}

#[test]
fn a_press_is_known_from_a_recording_that_somebody_completed_after_a_crash() {
    let stand = start(|_| ());
    let before = named_press(&stand);
    let (folder, _) = stand.stop();
    // As after a power cut that took the journal's last lines, and `scand recover`.
    std::fs::remove_file(folder.path().join("presses/presses.jsonl")).unwrap();
    let recording = recordings(folder.path())[0].path().to_owned();
    interrupted::enter(folder.path(), &[recording]).unwrap();
    let stand = start_in(folder, 4_000_000, |_| ());
    let after = named_press(&stand);
    assert_eq!(before.last(), after.last());
    assert_eq!(stand.capturing.status().complete, 0, "no second capture");
    let (folder, _) = stand.stop();
    assert!(interrupted::all(folder.path()).is_empty());
}

#[test]
fn a_folder_that_refuses_the_presses_does_not_keep_the_daemon_from_starting() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("presses"), "in the way").unwrap();
    std::fs::write(folder.path().join("a.mcap.part"), "no recording").unwrap();
    let stand = start_in(folder, 4_000_000, |_| ());
    assert!(matches!(stand.press().last(), Some(Reply::Durable { .. })));
}

#[test]
fn a_file_that_is_no_socket_is_not_removed() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    std::fs::write(&path, "a recording").unwrap();
    let refused = socket::listen(&path).unwrap_err().to_string();
    assert!(
        refused.contains("a.mcap") && refused.contains("not a socket"),
        "{refused}"
    );
    assert!(path.exists());
}

#[test]
fn a_camera_that_fails_is_named_and_the_capture_taken_once_more() {
    let stand = start(|_| ());
    stand.behaviour("c01", Behaviour::Loses);
    let heard = stand.press();
    let Some(Reply::Failed { capture, reason }) = heard.last() else {
        panic!("{heard:?}");
    };
    assert!(capture.ends_with(".r1"), "{capture}");
    assert!(
        reason.contains("c01") && reason.contains("a damaged frame"),
        "{reason}"
    );
    assert!(matches!(&heard[1], Reply::Retried { .. }), "{heard:?}");
    stand.behaviour("c01", Behaviour::Sound);
    assert!(matches!(stand.press().last(), Some(Reply::Durable { .. })));
    stand.until(|s| s.failed == 2 && s.complete == 1);
    assert_eq!(stand.capturing.status().cameras["c01"].lost_frames, 2);
    let (folder, _) = stand.stop();
    let all = captures(&recordings(folder.path())[0]);
    let outcomes: Vec<_> = all.iter().map(|(_, outcome, ..)| *outcome).collect();
    assert_eq!(
        outcomes,
        [
            CaptureOutcome::Failed,
            CaptureOutcome::Failed,
            CaptureOutcome::Complete
        ]
    );
    // What the other cameras gave is kept: two pictures and the whole burst.
    assert_eq!(all[0].2, 2 + 14);
}

#[test]
fn an_unplugged_camera_comes_back_and_a_retry_saves_the_press() {
    let stand = start(|plan| plan.capture.retry = 3);
    stand.behaviour("c02", Behaviour::Unplugged);
    let heard = stand.press();
    let Reply::Retried { reason, .. } = &heard[1] else {
        panic!("{heard:?}");
    };
    assert!(reason.contains("camera c02: unplugged"), "{reason}");
    stand.until(|s| s.cameras["c02"].state == "ready");
    assert!(matches!(stand.press().last(), Some(Reply::Durable { .. })));
}

#[test]
fn a_camera_that_comes_back_while_others_are_shot_is_told() {
    let stand = start(|plan| plan.capture.retry = 0);
    let mut events = stand.capturing.events().subscribe();
    stand.behaviour("c02", Behaviour::Unplugged);
    stand.behaviour("c00", Behaviour::Silent);
    assert!(matches!(stand.press().last(), Some(Reply::Failed { .. })));
    let told = std::iter::from_fn(|| events.wait())
        .take_while(|event| !matches!(event, Event::Failed { .. }))
        .any(|event| {
            matches!(event, Event::Camera { id, state, .. } if id == "c02" && state == "ready")
        });
    assert!(told);
}

#[test]
fn a_silent_camera_holds_nobody_up_for_longer_than_a_shot() {
    let stand = start(|plan| plan.capture.retry = 0);
    stand.behaviour("c00", Behaviour::Silent);
    let heard = stand.press();
    let Some(Reply::Failed { reason, .. }) = heard.last() else {
        panic!("{heard:?}");
    };
    assert!(reason.contains("c00"), "{reason}");
    stand.behaviour("c00", Behaviour::Sound);
    stand.until(|_| matches!(stand.press().last(), Some(Reply::Durable { .. })));
}

#[test]
fn frames_too_far_apart_are_no_capture() {
    let stand = start(|plan| plan.capture.retry = 0);
    stand.behaviour("c01", Behaviour::Late);
    let heard = stand.press();
    let Some(Reply::Failed { reason, .. }) = heard.last() else {
        panic!("{heard:?}");
    };
    assert!(
        reason.contains("to c01") && reason.contains("at most 100 ms"),
        "{reason}"
    );
}

#[test]
fn a_signal_that_was_faster_than_the_press_makes_a_capture_where_that_is_tolerated() {
    for (tolerance_ms, is_taken) in [(5.0, false), (50.0, true)] {
        let stand = start(|plan| {
            plan.capture.retry = 0;
            plan.sync.tolerance_ms = tolerance_ms;
        });
        for camera in ["c00", "c01", "c02"] {
            stand.behaviour(camera, Behaviour::Early);
        }
        let heard = stand.press();
        let taken = matches!(heard.last(), Some(Reply::Durable { .. }));
        assert_eq!(taken, is_taken, "{tolerance_ms} ms: {heard:?}");
    }
}

#[test]
fn a_press_during_a_capture_is_told_so() {
    let stand = start(|plan| plan.capture.retry = 0);
    stand.behaviour("c00", Behaviour::Silent);
    let first = stand.begin_press();
    assert!(matches!(first.recv().unwrap(), Reply::Accepted { .. }));
    let second: Vec<_> = stand.begin_press().iter().collect();
    assert_eq!(second, [Reply::Busy]);
    assert!(stand.capturing.status().busy);
    assert!(matches!(first.iter().last(), Some(Reply::Failed { .. })));
    assert!(!stand.capturing.status().busy);
}

#[test]
fn a_hundred_presses_are_a_hundred_captures_and_memory_stays() {
    let stand = start(|plan| plan.recording.largest_file_mb = 1);
    let mut ids = BTreeSet::new();
    let mut allocated = 0;
    for i in 0..100 {
        match stand.press().last() {
            Some(Reply::Durable { capture, .. }) => assert!(ids.insert(capture.clone())),
            other => panic!("{other:?}"),
        }
        if i == 10 {
            allocated = stand.pool.allocated();
        }
    }
    assert!(stand.pool.allocated() <= 3 * allocated, "{allocated}");
    assert_eq!(stand.pool.in_use(), 0);
    let (folder, _) = stand.stop();
    let files = recordings(folder.path());
    assert!(files.len() > 10, "{}", files.len());
    let mut times = BTreeSet::new();
    let mut recorded = BTreeSet::new();
    for file in &files {
        recorded.extend(captures(file).into_iter().map(|(id, ..)| id));
        let topic = Topic::Color(CameraId::new("c00").unwrap(), ColorPart::Image);
        for message in file.messages(&topic) {
            assert!(times.insert(message.log_time()), "a frame twice");
        }
    }
    assert_eq!((recorded, times.len()), (ids, 100));
}

/// Systemd's end of a watchdog that wants to be fed each 800 ms.
struct Systemd {
    _folder: tempfile::TempDir,
    socket: std::os::unix::net::UnixDatagram,
    clock: Clock,
}

impl Systemd {
    fn start(clock: Clock) -> (Self, Watchdog) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("notify");
        let socket = std::os::unix::net::UnixDatagram::bind(&path).unwrap();
        socket.set_nonblocking(true).unwrap();
        let notifier = Notifier::to(&path.into_os_string(), Some(Duration::from_millis(800)));
        let watchdog = Watchdog::new(Arc::new(notifier.unwrap()), clock);
        let systemd = Self {
            _folder: folder,
            socket,
            clock,
        };
        (systemd, watchdog)
    }

    /// How often it was fed since this was asked last.
    fn fed(&self) -> usize {
        let mut bytes = [0; 100];
        std::iter::from_fn(|| self.socket.recv(&mut bytes).ok()).count()
    }

    /// Lets time pass until it is fed.
    fn until_fed(&self) {
        let deadline = Instant::now() + Duration::from_secs(30);
        while self.fed() == 0 {
            assert!(Instant::now() < deadline, "it is not fed");
            self.clock.advance(Duration::from_millis(20));
            std::thread::sleep(Duration::from_millis(1));
        }
    }
}

#[test]
fn a_recorder_that_hangs_starves_the_watchdog() {
    let clock = Clock::by_hand(Timestamp(0));
    let (systemd, watchdog) = Systemd::start(clock);
    let stand = start(|plan| plan.watchdog = watchdog);
    systemd.until_fed();
    let hearing = stand.hold_recorder();
    // The capturing thread lives: it answers, and shows itself before it takes the next order.
    let long_after = || {
        clock.advance(Duration::from_secs(10));
        for _ in 0..2 {
            let begin = |answer| Order::Begin("no/name".into(), BTreeMap::new(), answer);
            stand.ask(begin).unwrap_err();
        }
    };
    long_after();
    // The recorder's last sign of life may still have counted once.
    systemd.fed();
    (0..3).for_each(|_| long_after());
    assert_eq!(systemd.fed(), 0);
    hearing.recv().unwrap();
    systemd.until_fed();
}

#[test]
fn a_camera_that_is_waited_for_does_not_starve_the_watchdog() {
    let clock = Clock::by_hand(Timestamp(1_760_000_000_000_000_000));
    let (systemd, watchdog) = Systemd::start(clock);
    let folder = tempfile::tempdir().unwrap();
    let stand = start_at(clock, &CAMERAS, folder, 4_000_000, |plan| {
        plan.watchdog = watchdog;
        plan.capture.patience_ms = 4000;
        plan.capture.retry = 0;
    });
    stand.behaviour("c00", Behaviour::Silent);
    let heard = stand.begin_press();
    assert!(matches!(heard.recv(), Ok(Reply::Accepted { .. })));
    systemd.fed();
    let deadline = Instant::now() + Duration::from_secs(60);
    let (mut fed, mut unfed) = (0, Duration::ZERO);
    while heard.is_empty() {
        assert!(Instant::now() < deadline, "not fed for {unfed:?}");
        // The clock stands still until it is fed, so that threads of a busy machine keep up with it.
        if unfed < Duration::from_secs(2) {
            clock.advance(Duration::from_millis(20));
            unfed += Duration::from_millis(20);
        }
        std::thread::sleep(Duration::from_millis(1));
        let now = systemd.fed();
        if now > 0 {
            (fed, unfed) = (fed + now, Duration::ZERO);
        }
    }
    assert!(fed > 2, "fed {fed} times");
}

#[test]
fn a_disk_that_is_behind_refuses_presses_and_loses_nothing_that_was_accepted() {
    let stand = start(|_| ());
    let hearing = stand.hold_recorder();
    let mut accepted = Vec::new();
    let refused = loop {
        let progress = stand.begin_press();
        match progress.recv().unwrap() {
            Reply::Refused { reason } => break reason,
            Reply::Accepted { .. } => accepted.push(progress),
            _ => {}
        }
        assert!(accepted.len() < 10);
    };
    assert!(
        refused.contains("2 captures must still be written"),
        "{refused}"
    );
    assert_eq!(accepted.len(), 2);
    hearing.recv().unwrap();
    for progress in accepted {
        assert!(matches!(
            progress.iter().last(),
            Some(Reply::Durable { .. })
        ));
    }
    assert!(stand.capturing.status().refused >= 1);
}

#[test]
fn a_capture_that_finds_no_room_is_not_begun() {
    let stand = start(|plan| plan.recording.keep_free_mb = 1 << 40);
    let [Reply::Refused { reason }] = &stand.press()[..] else {
        panic!();
    };
    assert!(reason.contains("recording.keep_free_mb"), "{reason}");
    assert_eq!(stand.capturing.status().captures_left, 0);
    drop(stand.stop());
    let folder = tempfile::tempdir().unwrap();
    let stand = start_in(folder, 10_000, |_| ());
    let [Reply::Refused { reason }] = &stand.press()[..] else {
        panic!();
    };
    assert!(reason.contains("capture.memory_mb"), "{reason}");
}

#[test]
fn a_recording_that_was_moved_keeps_its_models() {
    let folder = tempfile::tempdir().unwrap();
    let models = folder.path().join("models");
    std::fs::create_dir_all(models.join("amphora/amphora-0001")).unwrap();
    let stand = start_in(folder, 4_000_000, |plan| plan.models = Some(models.clone()));
    let begin = |name: &'static str| {
        stand.ask(move |answer| Order::Begin(name.into(), BTreeMap::new(), answer))
    };
    let refused = begin("amphora").unwrap_err();
    assert!(
        refused.contains("models of an earlier session"),
        "{refused}"
    );
    begin("krater").unwrap();
    std::fs::rename(models.join("amphora"), models.join("kept")).unwrap();
    begin("amphora").unwrap();
}

#[test]
fn a_name_serves_again_when_its_recording_was_moved() {
    let stand = start(|_| ());
    let path = stand.folder.path().join("amphora.mcap");
    for moved in ["kept.mcap", "too.mcap"] {
        stand
            .ask(|answer| Order::Begin("amphora".into(), BTreeMap::new(), answer))
            .unwrap();
        let heard = stand.press();
        assert!(
            matches!(heard.last(), Some(Reply::Durable { capture, .. }) if capture == "amphora-0001"),
            "{heard:?}"
        );
        stand.ask(Order::Close).unwrap();
        std::fs::rename(&path, path.with_file_name(moved)).unwrap();
    }
}

#[test]
fn sessions_begin_are_noted_and_close() {
    let stand = start(|_| ());
    let begin = |name: &'static str| {
        let about = BTreeMap::from([("operator".to_owned(), "Ann".to_owned())]);
        stand.ask(move |answer| Order::Begin(name.into(), about.clone(), answer))
    };
    begin("amphora").unwrap();
    let heard = stand.press();
    let Some(Reply::Durable { capture, .. }) = heard.last() else {
        panic!("{heard:?}");
    };
    assert_eq!(capture, "amphora-0001");
    let note = crate::recording::Note {
        capture: capture.clone(),
        kind: "reject".into(),
        text: "a hand".into(),
        author: None,
    };
    stand
        .ask(|answer| Order::Note(note.clone(), answer))
        .unwrap();
    let refused = begin("amphora").unwrap_err();
    assert!(refused.contains("amphora.mcap"), "{refused}");
    assert!(begin("a/b").unwrap_err().contains("a/b"));
    stand.ask(Order::Close).unwrap();
    let path = stand.folder.path().join("amphora.mcap");
    let recording = Recording::open(&path).unwrap();
    let message = recording.messages(&Topic::Note)[0];
    assert_eq!(recording.note(&message).unwrap(), note);
    begin("krater").unwrap();
    assert!(
        matches!(stand.press().last(), Some(Reply::Durable { capture, .. }) if capture == "krater-0001")
    );
}

#[test]
fn what_cameras_tell_and_how_long_presses_take_is_in_the_status() {
    let stand = start(|_| ());
    let told = [["temperature".to_owned(), "40.0 °C".to_owned()]];
    stand.until(|s| s.cameras.values().all(|c| c.health == told));
    assert!(stand.capturing.status().takes_ms.is_empty());
    assert!(matches!(stand.press().last(), Some(Reply::Durable { .. })));
    let takes = stand.capturing.status().takes_ms;
    assert!(takes["captured"].p50 > 0.0 && takes["captured"].p99 < takes["durable"].p99);
}

#[test]
fn a_durable_capture_becomes_a_job_and_a_failed_one_does_not() {
    let stand = start(|plan| {
        plan.capture.retry = 0;
        let jobs = crate::workers::Jobs::open(&plan.recording.folder);
        plan.jobs = Some(Arc::new(jobs.unwrap()));
    });
    stand.behaviour("c01", Behaviour::Loses);
    assert!(matches!(stand.press().last(), Some(Reply::Failed { .. })));
    stand.behaviour("c01", Behaviour::Sound);
    let heard = stand.press();
    let Some(Reply::Durable { capture, .. }) = heard.last() else {
        panic!("{heard:?}");
    };
    stand.until(|s| s.models.as_ref().is_some_and(|models| models.waiting == 1));
    let (folder, _) = stand.stop();
    let mut jobs = std::fs::read_dir(folder.path().join("jobs")).unwrap();
    let text = std::fs::read_to_string(jobs.next().unwrap().unwrap().path()).unwrap();
    assert!(
        text.contains(&format!("{capture:?}")) && text.contains("test"),
        "{text}"
    );
    assert!(jobs.next().is_none());
}

/// A daemon whose session is complete, and what packs its recordings after a second's rest; nothing rests yet.
fn packable(keep_free_bytes: Arc<AtomicU64>) -> (Clock, TestBench, Packer) {
    let clock = Clock::by_hand(Timestamp(1_760_000_000_000_000_000));
    let folder = tempfile::tempdir().unwrap();
    let stand = start_at(clock, &CAMERAS, folder, 4_000_000, |_| ());
    let parameters = RecordingParameters {
        folder: stand.folder.path().into(),
        pack_after_idle_s: 1,
        ..RecordingParameters::default()
    };
    for _ in 0..3 {
        assert!(matches!(stand.press().last(), Some(Reply::Durable { .. })));
    }
    stand.ask(Order::Close).unwrap();
    stand.until(|status| status.waiting == 0);
    let packer = Packer::new(&stand.capturing, &parameters, keep_free_bytes, clock);
    (clock, stand, packer)
}

#[test]
fn complete_recordings_are_packed_while_there_is_nothing_to_do_and_only_then() {
    let (clock, stand, mut packer) = packable(Arc::default());
    let second = Duration::from_secs(1);
    let path = recordings(stand.folder.path())[0].path().to_owned();
    let recording = || Recording::open(&path).unwrap();
    let is_packed = || recording().is_packed();
    let before = captures(&recording());
    assert_eq!(before.len(), 3);
    assert!(!packer.step(), "nothing has rested yet");
    // An order is being carried out for longer than the rest that is asked for.
    stand.behaviour("c00", Behaviour::Silent);
    let begin = clock.now();
    let pressed = stand.begin_press();
    while !pressed.try_iter().any(|reply| reply.is_end(Until::Durable)) {
        assert!(!packer.step() && !is_packed());
        clock.advance(second / 50);
        std::thread::sleep(Duration::from_millis(1));
    }
    assert!(clock.elapsed(begin) > second / 2);
    stand.behaviour("c00", Behaviour::Sound);
    stand.ask(Order::Close).unwrap();
    stand.until(|status| status.waiting == 0);
    assert!(!packer.step() && !is_packed());
    clock.advance(second);
    while packer.step() {}
    assert!(is_packed());
    assert_eq!(captures(&recording()), before);
    // The session that is being recorded is not packed.
    assert!(matches!(stand.press().last(), Some(Reply::Durable { .. })));
    clock.advance(second);
    assert!(!packer.step());
    let (folder, _) = stand.stop();
    let all = recordings(folder.path());
    let packed = all.iter().filter(|recording| recording.is_packed());
    assert_eq!((all.len(), packed.count()), (3, 2));
}

#[test]
fn nothing_is_packed_while_there_is_no_room_for_a_copy() {
    let keep_free_bytes = Arc::new(AtomicU64::new(u64::MAX));
    let (clock, stand, mut packer) = packable(keep_free_bytes.clone());
    let is_packed = || recordings(stand.folder.path())[0].is_packed();
    clock.advance(Duration::from_secs(1));
    assert!(!packer.step() && !is_packed());
    keep_free_bytes.store(0, Ordering::Relaxed);
    clock.advance(Duration::from_secs(1));
    assert!(packer.step() && is_packed());
}

#[test]
fn a_thread_of_its_own_packs_and_ends() {
    let (clock, stand, packer) = packable(Arc::default());
    let packing = packer.start().unwrap();
    let deadline = Instant::now() + Duration::from_secs(30);
    while !recordings(stand.folder.path())[0].is_packed() {
        assert!(Instant::now() < deadline);
        clock.advance(Duration::from_secs(1));
        std::thread::sleep(Duration::from_millis(5));
    }
    drop(packing);
}

#[test]
fn nothing_is_packed_unless_it_is_asked_for() {
    let stand = start(|_| ());
    let parameters = RecordingParameters::default();
    assert!(
        Packing::start(
            &stand.capturing,
            &parameters,
            Arc::default(),
            Clock::system()
        )
        .unwrap()
        .is_none()
    );
}

#[test]
fn a_session_that_cannot_be_completed_is_never_called_done() {
    let stand = start(|_| ());
    let replies = stand.press();
    let Some(Reply::Durable { recording, .. }) = replies.last() else {
        panic!("{replies:?}");
    };
    let part = unfinished_name(recording);
    std::fs::write(recording, "in the way").unwrap();
    for _ in 0..2 {
        let error = stand.ask(Order::Close).unwrap_err();
        assert!(error.contains("is not completed"), "{error}");
        assert!(part.exists());
    }
    std::fs::remove_file(recording).unwrap();
    stand.ask(Order::Close).unwrap();
    assert!(recording.exists() && !part.exists());
    stand.stop();
}
