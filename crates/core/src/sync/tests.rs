//! Tests the rules of synchronisation on made-up streams.

use super::*;
use proptest::prelude::*;

const MS: u64 = 1_000_000;
const START: u64 = 1_000_000_000_000;

fn at(ms: i64) -> Timestamp {
    Timestamp(START.saturating_add_signed(ms * MS as i64))
}

fn id(name: &str) -> CameraId {
    CameraId::new(name).unwrap()
}

fn trigger(name: &str, ms: i64) -> Trigger {
    Trigger {
        id: CaptureId::new(name).unwrap(),
        time: at(ms),
        source: "test".into(),
        press_id: None,
        subject: None,
        placement: None,
    }
}

/// Two colour cameras `a` and `b` and, if wanted, a depth camera `d` with colour.
fn cameras(depth: bool) -> Cameras {
    Cameras {
        colors: [id("a"), id("b")].into(),
        depths: depth.then(|| (id("d"), true)).into_iter().collect(),
    }
}

/// Everything that is handed in; a handle is the frame's number.
#[derive(Clone, Debug, Default)]
struct Session {
    triggers: Vec<(Trigger, Listed)>,
    frames: Vec<(CameraId, Stream, Timestamp)>,
}

impl Session {
    fn trigger(mut self, name: &str, ms: i64) -> Self {
        self.triggers.push((trigger(name, ms), Listed::new()));
        self
    }

    fn listing(mut self, camera: &str, ms: &[i64]) -> Self {
        let times = ms.iter().map(|&ms| at(ms)).collect();
        let (_, listed) = self.triggers.last_mut().unwrap();
        listed.insert(id(camera), times);
        self
    }

    fn colors(mut self, camera: &str, ms: &[i64]) -> Self {
        let frame = |&ms: &i64| (id(camera), Stream::Color, at(ms));
        self.frames.extend(ms.iter().map(frame));
        self
    }

    fn depth(mut self, count: i64, from_ms: i64, every_ms: i64, stream: Stream) -> Self {
        let frame = |i: i64| (id("d"), stream, at(from_ms + i * every_ms));
        self.frames.extend((0..count).map(frame));
        self
    }

    fn run(&self, cameras: Cameras, parameters: &Parameters) -> Vec<Capture<usize>> {
        let mut sync = Synchronizer::new(cameras, parameters.clone());
        for (i, (camera, stream, time)) in self.frames.iter().enumerate() {
            sync.push_frame(camera, *stream, *time, i);
        }
        for (trigger, listed) in &self.triggers {
            sync.push_trigger(trigger.clone(), listed.clone());
        }
        sync.finish()
    }

    fn captures(&self, depth: bool) -> Vec<Capture<usize>> {
        self.run(cameras(depth), &Parameters::default())
    }
}

fn color_ms(capture: &Capture<usize>, camera: &str) -> Option<i64> {
    let frame = capture.colors.get(&id(camera))?;
    Some((frame.timestamp.nanoseconds_since(at(0)) / i128::from(MS)) as i64)
}

#[test]
fn the_first_frame_from_the_tolerance_on_is_taken() {
    let session = Session::default()
        .trigger("x", 100)
        .colors("a", &[94, 96, 120])
        .colors("b", &[94, 130, 2000]);
    let captures = session.captures(false);
    assert!(captures[0].complete);
    assert_eq!(color_ms(&captures[0], "a"), Some(96));
    assert_eq!(color_ms(&captures[0], "b"), Some(130));
    assert_eq!(captures[0].skew_ns(), 34 * MS);
}

#[test]
fn a_free_running_camera_may_give_its_nearest_frame() {
    let session = Session::default()
        .trigger("x", 100)
        .colors("a", &[50, 90, 115])
        .colors("b", &[60, 101]);
    let parameters = Parameters {
        nearest_color: FreeRunning::All,
        ..Parameters::default()
    };
    let captures = session.run(cameras(false), &parameters);
    assert_eq!(color_ms(&captures[0], "a"), Some(90));
    assert_eq!(color_ms(&captures[0], "b"), Some(101));
}

#[test]
fn of_cameras_of_both_kinds_each_gives_what_its_kind_gives() {
    let session = || {
        Session::default()
            .trigger("x", 100)
            .colors("a", &[50, 90, 115])
            .colors("b", &[60, 90, 120])
    };
    for (free, a, b) in [("a", 90, 120), ("b", 115, 90)] {
        let parameters = Parameters {
            nearest_color: FreeRunning::Some([CameraId::new(free).unwrap()].into()),
            ..Parameters::default()
        };
        let captures = session().run(cameras(false), &parameters);
        assert_eq!(color_ms(&captures[0], "a"), Some(a), "{free}");
        assert_eq!(color_ms(&captures[0], "b"), Some(b), "{free}");
    }
}

#[test]
fn a_missing_camera_fails_the_capture_and_is_named_with_what_it_gave() {
    let session = Session::default()
        .trigger("x", 100)
        .colors("a", &[100])
        .colors("b", &[2500])
        .depth(9, 100, 33, Stream::Depth);
    let captures = session.captures(true);
    assert!(!captures[0].complete);
    let reason = captures[0].reason();
    assert!(
        reason.contains("colour camera b gave no frame from"),
        "{reason}"
    );
    assert!(reason.contains("nearest frame is at 2400.0 ms"), "{reason}");
    assert!(
        reason.contains("depth camera d gave 9 frames from"),
        "{reason}"
    );
    assert!(!reason.contains("it has no frame"), "{reason}");
    let parameters = Parameters {
        go_on_without_missing: true,
        ..Parameters::default()
    };
    let captures = session.run(cameras(true), &parameters);
    assert!(captures[0].complete);
    assert_eq!(captures[0].shortfalls.len(), 2);
}

#[test]
fn cameras_without_any_frame_are_named_together() {
    let session = Session::default().trigger("x", 100);
    let captures = session.captures(true);
    assert!(!captures[0].complete);
    assert_eq!(
        captures[0].reason(),
        "colour camera a gave no frame from -5.0 to 2000.0 ms after the trigger, expected at least 1; it has no frame \
         that this capture could take, and neither have b, d"
    );
    let captures = session.colors("a", &[2500]).captures(false);
    let reason = captures[0].reason();
    assert!(
        reason.starts_with("colour camera b gave no frame")
            && reason.contains("could take; colour camera a gave no frame"),
        "{reason}"
    );
}

#[test]
fn a_depth_camera_gives_thirty_frames_with_the_nearest_colours() {
    let session = Session::default()
        .trigger("x", 100)
        .colors("a", &[100])
        .colors("b", &[100])
        .depth(50, 68, 33, Stream::Depth)
        .depth(20, 51, 99, Stream::DepthColor);
    let captures = session.captures(true);
    let takes = &captures[0].depths[&id("d")];
    assert_eq!(takes.len(), 30);
    assert_eq!(takes[0].depth.timestamp, at(101));
    for take in takes {
        let color = take.color.as_ref().unwrap().timestamp;
        assert!(distance(color, take.depth.timestamp) <= 50 * MS);
    }
}

#[test]
fn colour_that_was_taken_just_before_serves_a_burst() {
    let session = Session::default()
        .trigger("x", 100)
        .colors("a", &[100])
        .colors("b", &[100])
        .depth(12, 100, 33, Stream::Depth)
        .depth(1, -500, 1, Stream::DepthColor);
    let captures = session.captures(true);
    assert!(
        captures[0].depths[&id("d")]
            .iter()
            .all(|t| t.color.is_some())
    );
}

#[test]
fn the_next_trigger_ends_a_window() {
    let session = Session::default()
        .trigger("x", 0)
        .trigger("y", 500)
        .colors("a", &[10, 498])
        .colors("b", &[510, 800]);
    let captures = session.captures(false);
    assert_eq!(color_ms(&captures[0], "a"), Some(10));
    assert_eq!(color_ms(&captures[0], "b"), None);
    // 2 ms before its trigger is within the tolerance: the frame belongs to y.
    assert_eq!(color_ms(&captures[1], "a"), Some(498));
    assert_eq!(color_ms(&captures[1], "b"), Some(510));
}

#[test]
fn listed_frames_are_the_captures_own() {
    let session = Session::default()
        .trigger("x", 0)
        .trigger("y", 100)
        .listing("a", &[20])
        .colors("a", &[20, 40, 110])
        .colors("b", &[30, 130]);
    let captures = session.captures(false);
    assert_eq!(color_ms(&captures[0], "a"), Some(40), "20 is promised to y");
    assert_eq!(color_ms(&captures[1], "a"), Some(20));
    assert_eq!(
        color_ms(&captures[1], "b"),
        Some(130),
        "not listed: by the rule"
    );
}

#[test]
fn a_second_trigger_of_an_id_makes_no_second_capture() {
    let session = Session::default()
        .trigger("x", 0)
        .trigger("x", 100)
        .colors("a", &[0, 100])
        .colors("b", &[0, 100]);
    assert_eq!(session.captures(false).len(), 1);
    let mut sync = Synchronizer::<usize>::new(cameras(false), Parameters::default());
    assert!(sync.push_trigger(trigger("x", 0), Listed::new()));
    assert!(!sync.push_trigger(trigger("x", 9), Listed::new()));
}

#[test]
fn ids_are_free_again_when_all_captures_are_closed() {
    let mut sync = Synchronizer::new(cameras(false), Parameters::default());
    for time in [0, 100_000] {
        assert!(sync.push_trigger(trigger("x", time), Listed::new()));
        for camera in ["a", "b"] {
            sync.push_frame(&id(camera), Stream::Color, at(time), time);
        }
        let captures = sync.finish();
        assert!(captures.len() == 1 && captures[0].complete, "{captures:?}");
    }
}

#[test]
fn a_capture_that_has_everything_is_not_kept_waiting() {
    let mut sync = Synchronizer::new(cameras(true), Parameters::default());
    sync.push_trigger(trigger("x", 0), Listed::new());
    for camera in ["a", "b"] {
        sync.push_frame(&id(camera), Stream::Color, at(3), 0);
    }
    for i in 0..30 {
        sync.push_frame(&id("d"), Stream::Depth, at(10 * i), 0);
        assert_eq!(sync.advance(at(10 * i)), []);
    }
    sync.push_frame(&id("d"), Stream::DepthColor, at(295), 0);
    assert_eq!(
        sync.advance(at(300)),
        [],
        "a trigger at 300 would open at 295"
    );
    assert_eq!(sync.advance(at(301)).len(), 1);
}

#[test]
fn times_at_the_ends_of_the_clock_do_no_harm() {
    for time in [0, 1, u64::MAX - 1, u64::MAX] {
        let mut sync = Synchronizer::new(cameras(true), Parameters::default());
        let mut trigger = trigger("x", 0);
        trigger.time = Timestamp(time);
        sync.push_trigger(trigger, Listed::new());
        for stream in [Stream::Color, Stream::Depth, Stream::DepthColor] {
            sync.push_frame(&id("a"), stream, Timestamp(u64::MAX), 0);
            sync.push_frame(&id("d"), stream, Timestamp(0), 0);
        }
        sync.advance(Timestamp(u64::MAX));
        sync.finish();
    }
}

fn session() -> impl Strategy<Value = Session> {
    let times = || prop::collection::vec(0..9000i64, 0..12);
    let depth = || prop::collection::vec(0..9000i64, 0..200);
    (
        prop::collection::vec(0..8000i64, 1..5),
        times(),
        times(),
        depth(),
        depth(),
    )
        .prop_map(|(triggers, a, b, depth, depth_color)| {
            let mut session = Session::default().colors("a", &a).colors("b", &b);
            for (i, ms) in triggers.iter().enumerate() {
                session = session.trigger(&format!("t{i}"), *ms);
            }
            for ms in depth {
                session = session.depth(1, ms, 1, Stream::Depth);
            }
            for ms in depth_color {
                session = session.depth(1, ms, 1, Stream::DepthColor);
            }
            session
        })
}

fn parameters() -> impl Strategy<Value = Parameters> {
    let free = prop_oneof![
        Just(FreeRunning::All),
        Just(FreeRunning::default()),
        Just(FreeRunning::Some([CameraId::new("a").unwrap()].into())),
    ];
    (free, 1..8usize, 1..4usize, any::<bool>()).prop_map(
        |(nearest_color, depth_frames, min_depth_frames, go_on_without_missing)| Parameters {
            nearest_color,
            depth_frames: depth_frames.max(min_depth_frames),
            min_depth_frames,
            go_on_without_missing,
            ..Parameters::default()
        },
    )
}

/// What must not depend on when and in which order things were handed in. The nearest frame of a camera
/// that gave too few is a hint for people and depends on what has been seen by then.
fn essence(captures: Vec<Capture<Timestamp>>) -> Vec<Capture<Timestamp>> {
    let mut captures = captures;
    for shortfall in captures.iter_mut().flat_map(|c| &mut c.shortfalls) {
        shortfall.nearest = None;
    }
    captures
}

proptest! {
    #[test]
    fn no_frame_serves_two_captures(session in session(), parameters in parameters()) {
        let captures = session.run(cameras(true), &parameters);
        prop_assert_eq!(captures.len(), session.triggers.len());
        let mut used = BTreeSet::new();
        for capture in &captures {
            let mut mine = BTreeSet::new();
            for (camera, frame) in &capture.colors {
                prop_assert!(mine.insert((camera, Stream::Color, frame.timestamp)));
            }
            for (camera, takes) in &capture.depths {
                for take in takes {
                    prop_assert!(mine.insert((camera, Stream::Depth, take.depth.timestamp)));
                    if let Some(color) = &take.color {
                        mine.insert((camera, Stream::DepthColor, color.timestamp));
                    }
                }
            }
            prop_assert!(used.is_disjoint(&mine));
            used.extend(mine);
        }
    }

    #[test]
    fn frames_are_sorted_within_the_window_and_as_many_as_allowed(
        session in session(), parameters in parameters(),
    ) {
        for capture in session.run(cameras(true), &parameters) {
            let start = Timestamp(capture.trigger.time.0 - 5 * MS);
            let end = Timestamp(capture.trigger.time.0 + 2000 * MS);
            for takes in capture.depths.values() {
                prop_assert!(takes.len() <= parameters.depth_frames);
                prop_assert!(takes.len() >= parameters.min_depth_frames);
                prop_assert!(takes.is_sorted_by(|a, b| a.depth.timestamp < b.depth.timestamp));
                prop_assert!(takes.iter().all(|t| (start..end).contains(&t.depth.timestamp)));
            }
            let short = capture.colors.len() + capture.depths.len() < 3;
            prop_assert_eq!(short, !capture.shortfalls.is_empty());
            prop_assert_eq!(capture.complete, !short || parameters.go_on_without_missing);
        }
    }

    #[test]
    fn neither_order_nor_timing_of_delivery_changes_a_capture(
        session in session(), parameters in parameters(), shuffle in any::<u64>(), steps in 1..9000i64,
    ) {
        let mut at_once = Synchronizer::new(cameras(true), parameters.clone());
        let mut live = Synchronizer::new(cameras(true), parameters);
        let mut frames = session.frames.clone();
        for (camera, stream, time) in &frames {
            at_once.push_frame(camera, *stream, *time, *time);
        }
        for (trigger, listed) in &session.triggers {
            at_once.push_trigger(trigger.clone(), listed.clone());
        }
        // Live: in steps of time, each step's frames in another order.
        frames.sort_by_key(|(camera, _, t)| {
            (t.0.wrapping_mul(shuffle | 1), camera.as_str().len())
        });
        let mut done = Vec::new();
        let mut now = 0;
        while now < 9000 + steps {
            let until = now + steps;
            let inside = |t: Timestamp| (at(now)..at(until)).contains(&t);
            for (camera, stream, time) in frames.iter().filter(|f| inside(f.2)) {
                live.push_frame(camera, *stream, *time, *time);
            }
            for (trigger, listed) in session.triggers.iter().filter(|t| inside(t.0.time)) {
                live.push_trigger(trigger.clone(), listed.clone());
            }
            done.extend(live.advance(at(until)));
            now = until;
        }
        done.extend(live.finish());
        prop_assert_eq!(essence(done), essence(at_once.finish()));
    }
}
