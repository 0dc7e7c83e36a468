//! Faults of cameras and networks: the driver reports each of them, and none gives a wrong picture.

use crate::network::alone;
use crate::stand::{CAPTURES, Stand, id, milliseconds_after};
use crate::support::torture::times;
use crate::support::wait::until_or;
use crossbeam_channel::{Receiver, unbounded};
use scand::drivers::live::{Backoff, CameraEvent, Fault, Message, supervise};
use std::time::{Duration, Instant};

#[test]
fn a_frame_with_lost_packets_never_looks_whole() {
    alone(
        "faults::a_frame_with_lost_packets_never_looks_whole",
        || {
            let stand = Stand::new([320, 240]);
            let mut parameters = stand.parameters("c00");
            parameters.packet_size = Some(1400);
            let mut device = stand.open("c00", parameters).unwrap();
            stand.rig.set_loss(&id("c00"), 0.02).unwrap();
            let (mut whole, mut missing) = (0, 0);
            const SHOTS: u64 = 40;
            for number in 0..SHOTS {
                let (_, frames, stats) =
                    stand.shoot_within(device.as_mut(), number, Duration::from_secs(1));
                let stats = stats.unwrap();
                missing += stats.missing_packets;
                match frames.as_slice() {
                    [frame] => {
                        assert!(stand.is_picture(frame, 0, number as usize % CAPTURES));
                        whole += 1;
                    }
                    [] => assert!(!stats.lost.is_empty(), "a frame is lost in silence"),
                    more => panic!("{} frames", more.len()),
                }
            }
            // Of 58 packets at 2 % about a third are whole.
            assert!((1..SHOTS).contains(&whole), "{whole} of {SHOTS}");
            assert!(missing > 0);
            stand.rig.set_loss(&id("c00"), 0.0).unwrap();
            let (_, frames, stats) = stand.shoot(device.as_mut(), SHOTS);
            assert_eq!(frames.len(), 1, "{stats:?}");
        },
    );
}

/// Waits for an event that `wanted` picks.
fn until<T>(
    events: &Receiver<Message>,
    patience: Duration,
    mut wanted: impl FnMut(CameraEvent) -> Option<T>,
) -> T {
    let end = Instant::now() + patience;
    loop {
        let message = events.recv_deadline(end).expect("an event in time");
        if let Some(found) = wanted(message.event) {
            return found;
        }
    }
}

#[test]
fn a_camera_that_stops_is_named_and_comes_back_as_it_was_set() {
    alone(
        "faults::a_camera_that_stops_is_named_and_comes_back_as_it_was_set",
        || {
            let stand = Stand::new([64, 48]);
            let mut parameters = stand.parameters("c00");
            parameters.exposure = Some(0.005);
            let (sender, events) = unbounded();
            let driver = Box::new(stand.driver("c00", parameters));
            let camera = supervise(id("c00"), driver, sender, Backoff::default()).unwrap();
            let ready = |event| match event {
                CameraEvent::Ready(info) => Some(info),
                _ => None,
            };
            let before = until(&events, Duration::from_secs(10), ready);
            // Nobody triggers: it is named within 10 s all the same.
            let stopped = Instant::now();
            stand.rig.stop_camera(&id("c00")).unwrap();
            let fault = until(&events, Duration::from_secs(10), |event| match event {
                CameraEvent::Away { fault, .. } => Some(fault),
                _ => None,
            });
            assert!(fault.to_string().contains("127.0.1.1"), "{fault}");
            println!("named {:.1?} after it stopped: {fault}", stopped.elapsed());
            stand.rig.start_camera(&id("c00")).unwrap();
            let after = until(&events, Duration::from_secs(10), ready);
            assert_eq!(before, after);
            assert!(
                after
                    .table
                    .iter()
                    .any(|[name, ..]| name.starts_with("ExposureTime"))
            );
            // Stopped and triggered at once: the shot says so.
            stand.rig.stop_camera(&id("c00")).unwrap();
            assert!(camera.shoot(stand.shot(7, Duration::from_secs(1))));
            let outcome = until(&events, Duration::from_secs(10), |event| match event {
                CameraEvent::Answered { shot: 7, outcome } => Some(outcome),
                _ => None,
            });
            assert!(matches!(outcome, Err(Fault::Away(_))), "{outcome:?}");
            stand.rig.start_camera(&id("c00")).unwrap();
            until(&events, Duration::from_secs(20), ready);
            assert!(camera.shoot(stand.shot(8, Duration::from_secs(2))));
            until(&events, Duration::from_secs(10), |event| match event {
                CameraEvent::Frame { shot: 8, frame } if frame.camera == id("c00") => Some(()),
                _ => None,
            });
            assert!(camera.end().wait(Instant::now() + Duration::from_secs(10)));
        },
    );
}

#[test]
fn control_that_is_taken_away_is_noticed() {
    alone("faults::control_that_is_taken_away_is_noticed", || {
        const CONTROL_CHANNEL_PRIVILEGE: u32 = 0x0a00;
        let stand = Stand::new([64, 48]);
        let mut device = stand.open("c00", stand.parameters("c00")).unwrap();
        device.idle().unwrap();
        stand
            .rig
            .set_register(&id("c00"), CONTROL_CHANNEL_PRIVILEGE, 0);
        let end = Instant::now() + Duration::from_secs(10);
        let fault = loop {
            match device.idle() {
                Err(fault) => break fault,
                Ok(()) => assert!(Instant::now() < end, "it is not noticed"),
            }
            std::thread::sleep(Duration::from_millis(50));
        };
        assert!(fault.to_string().contains("took control"), "{fault}");
    });
}

#[test]
fn a_late_frame_has_its_true_time_and_is_not_taken_for_the_next() {
    alone(
        "faults::a_late_frame_has_its_true_time_and_is_not_taken_for_the_next",
        || {
            let stand = Stand::new([64, 48]);
            let mut device = stand.open("c00", stand.parameters("c00")).unwrap();
            stand
                .rig
                .set_delay(&id("c00"), Duration::from_millis(400))
                .unwrap();
            let (shot, frames, stats) = stand.shoot(device.as_mut(), 0);
            assert_eq!(frames.len(), 1, "{stats:?}");
            let after = milliseconds_after(&shot, &frames[0]);
            assert!(
                (0.0..350.0).contains(&after),
                "stamped {after} ms after the trigger"
            );
            // Too late for its shot.
            let (_, frames, stats) =
                stand.shoot_within(device.as_mut(), 1, Duration::from_millis(100));
            assert!(frames.is_empty());
            assert!(stats.unwrap().lost[0].contains("no frame arrived"));
            stand.rig.set_delay(&id("c00"), Duration::ZERO).unwrap();
            let (_, frames, stats) = stand.shoot(device.as_mut(), 2);
            assert_eq!(frames.len(), 1, "{stats:?}");
            assert!(
                stand.is_picture(&frames[0], 0, 2),
                "the picture of the shot before"
            );
        },
    );
}

#[test]
fn a_frozen_clock_is_not_believed() {
    alone("faults::a_frozen_clock_is_not_believed", || {
        let stand = Stand::new([64, 48]);
        let mut device = stand.open("c00", stand.parameters("c00")).unwrap();
        assert_eq!(stand.shoot(device.as_mut(), 0).1.len(), 1);
        stand.rig.freeze_clock(&id("c00"), true);
        std::thread::sleep(Duration::from_millis(50));
        for number in 1..4 {
            let (_, frames, stats) =
                stand.shoot_within(device.as_mut(), number, Duration::from_millis(300));
            assert!(frames.is_empty(), "shot {number}");
            let lost = stats.unwrap().lost;
            assert!(lost[0].contains("stands still"), "{lost:?}");
        }
        stand.rig.freeze_clock(&id("c00"), false);
        // It went on meanwhile: a jump, and then it is known again.
        let last = (4..7)
            .map(|n| stand.shoot(device.as_mut(), n).1.len())
            .last();
        assert_eq!(last, Some(1));
    });
}

/// Kilobytes of memory and open files of this process.
fn held() -> (u64, usize) {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = status
        .lines()
        .find(|line| line.starts_with("VmRSS:"))
        .unwrap();
    let kilobytes = line.split_whitespace().nth(1).unwrap().parse().unwrap();
    (
        kilobytes,
        std::fs::read_dir("/proc/self/fd").unwrap().count(),
    )
}

#[test]
fn nothing_leaks_over_many_reconnects() {
    alone("faults::nothing_leaks_over_many_reconnects", || {
        let stand = Stand::new([64, 48]);
        let rounds = times(200, 1000);
        let round = |number| {
            let mut device = stand.open("c00", stand.parameters("c00")).unwrap();
            assert_eq!(stand.shoot(device.as_mut(), number).1.len(), 1);
        };
        (0..rounds / 4).for_each(round);
        let before = held();
        (0..rounds).for_each(round);
        let after = held();
        println!("shown: {rounds} reconnects: {before:?} kB and files before, {after:?} after");
        assert!(after.1 <= before.1 + 2, "{before:?} {after:?}");
        assert!(after.0 <= before.0 + 2_000, "{before:?} {after:?}");
    });
}

fn threads() -> usize {
    std::fs::read_dir("/proc/self/task").unwrap().count()
}

#[test]
fn a_camera_that_is_lost_leaves_nothing_behind() {
    alone(
        "faults::a_camera_that_is_lost_leaves_nothing_behind",
        || {
            let stand = Stand::new([64, 48]);
            let lose = || {
                let mut device = stand.open("c00", stand.parameters("c00")).unwrap();
                stand.rig.stop_camera(&id("c00")).unwrap();
                let (_, frames, outcome) = stand.shoot(device.as_mut(), 1);
                assert!(frames.is_empty() && matches!(outcome, Err(Fault::Away(_))));
                drop(device);
                stand.rig.start_camera(&id("c00")).unwrap();
            };
            // What is made once stays, and what watched the lost camera ends a little later.
            lose();
            settle(threads() - 3);
            let before = (threads(), held().1);
            (0..4).for_each(|_| lose());
            let now = || (threads(), held().1);
            until_or(
                &format!("threads and files, {before:?} before"),
                || format!("{:?}", now()),
                || now().0 <= before.0 && now().1 <= before.1,
            );
        },
    );
}

/// Waits until there are no more threads than this, if ever.
fn settle(count: usize) {
    let until = Instant::now() + Duration::from_secs(20);
    while threads() > count && Instant::now() < until {
        std::thread::sleep(Duration::from_millis(100));
    }
}
