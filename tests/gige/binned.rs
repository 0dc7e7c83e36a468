//! Looks for which the camera joins pixels: the camera is as it was afterwards, or is opened anew, and no capture ever
//! has a small picture.

use crate::description::{self, BINNING, HEIGHT, STUCK, WIDTH};
use crate::network::alone;
use crate::stand::{CAPTURES, Stand, id};
use crossbeam_channel::{Receiver, unbounded};
use scand::drivers::aravis::{Parameters, Region};
use scand::drivers::live::{
    Backoff, CameraEvent, Device, Driver, Fault, LookResult, Message, ShotStats, supervise,
};
use scand::frame::{Frame, Picture};
use scand_lab::serve::ColorOptions;
use std::time::{Duration, Instant};

const SIZE: [u32; 2] = [640, 480];
const SMALL: [u32; 2] = [320, 240];
/// Bytes a second of a link on which a whole picture takes 1 s and a small one 0.26 s: also a busy machine has time for
/// both changes.
const LINK: u64 = 300_000;

/// A camera with binning on a slow link.
fn stand() -> (Stand, tempfile::TempDir) {
    let folder = tempfile::tempdir().unwrap();
    let options = ColorOptions {
        features: Some(description::write_binning(folder.path())),
        ..ColorOptions::default()
    };
    let stand = Stand::with(SIZE, options);
    stand.rig.set_link(&id("c00"), LINK).unwrap();
    (stand, folder)
}

fn parameters(stand: &Stand) -> Parameters {
    Parameters {
        binned_looks: Some(true),
        region: Some(Region {
            x: 0,
            y: 0,
            width: SIZE[0],
            height: SIZE[1],
        }),
        ..stand.parameters("c00")
    }
}

fn size(frame: &Frame) -> [u32; 2] {
    match &frame.picture {
        Picture::Raw { width, height, .. } => [*width, *height],
        Picture::Compressed { .. } => panic!("not raw"),
    }
}

/// A look's picture and what is said of it.
fn look(stand: &Stand, device: &mut dyn Device) -> (Frame, ShotStats) {
    let mut frames = Vec::new();
    let shot = stand.shot(1, Duration::from_secs(3));
    let stats = device.look(&shot, &mut |frame| frames.push(frame));
    let stats = stats.unwrap();
    assert_eq!(frames.len(), 1, "{stats:?}");
    (frames.remove(0), stats)
}

fn register(stand: &Stand, address: u32) -> u32 {
    stand.rig.register(&id("c00"), address).unwrap()
}

fn is_as_it_was(stand: &Stand) -> bool {
    let now = [BINNING[0], BINNING[1], WIDTH, HEIGHT].map(|address| register(stand, address));
    now == [1, 1, SIZE[0], SIZE[1]]
}

/// Whether a frame is the last picture that the camera sent, whole.
fn is_newest(stand: &Stand, frame: &Frame) -> bool {
    let last = stand.rig.served(&id("c00")).unwrap() as usize - 1;
    stand.is_picture(frame, 0, last % CAPTURES)
}

#[test]
fn looks_are_half_as_large_and_the_next_press_is_whole_and_set_as_before() {
    alone(
        "binned::looks_are_half_as_large_and_the_next_press_is_whole_and_set_as_before",
        || {
            let (stand, _folder) = stand();
            // As a daemon left it that was killed during a look.
            for (address, value) in [
                (BINNING[0], 2),
                (BINNING[1], 2),
                (WIDTH, SMALL[0]),
                (HEIGHT, SMALL[1]),
            ] {
                stand.rig.set_register(&id("c00"), address, value);
            }
            let mut driver = stand.driver("c00", parameters(&stand));
            let mut device = driver.open().unwrap();
            let info = device.info().clone();
            assert_eq!((info.size, info.remarks.len()), (SIZE, 0), "{info:?}");
            assert!(is_as_it_was(&stand));
            let mut sizes = Vec::new();
            for number in 0..5 {
                let (frame, stats) = look(&stand, device.as_mut());
                assert_eq!(stats.is_binned, size(&frame) == SMALL);
                assert_eq!(stats.why_whole, None);
                sizes.push(size(&frame));
                assert!(is_as_it_was(&stand), "after look {number}");
                let (_, frames, stats) = stand.shoot(device.as_mut(), number);
                assert_eq!(frames.len(), 1, "{stats:?}");
                assert!(is_newest(&stand, &frames[0]));
                let stats = stats.unwrap();
                assert!(stats.lost.is_empty() && !stats.is_binned, "{stats:?}");
            }
            assert_eq!(sizes, [SIZE, SMALL, SMALL, SMALL, SIZE]);
            assert_eq!(*device.info(), info);
            // Once is enough: what a camera sends when it is opened again could disturb a capture.
            drop(device);
            let served = || stand.rig.served(&id("c00")).unwrap();
            let before = served();
            let device = driver.open().unwrap();
            assert_eq!((served(), device.info().size), (before, SIZE));
        },
    );
}

#[test]
fn a_switch_that_takes_long_makes_looks_whole_and_says_so() {
    alone(
        "binned::a_switch_that_takes_long_makes_looks_whole_and_says_so",
        || {
            let (stand, _folder) = stand();
            // A whole picture takes 0.3 s here, and less than both changes.
            stand.rig.set_link(&id("c00"), 1_000_000).unwrap();
            stand
                .rig
                .set_switch_time(&id("c00"), Duration::from_millis(600))
                .unwrap();
            let mut device = stand.open("c00", parameters(&stand)).unwrap();
            let remarks = &device.info().remarks;
            assert!(
                remarks[0].contains("looks take whole pictures")
                    && remarks[0].contains("a small one takes"),
                "{remarks:?}"
            );
            for _ in 0..3 {
                let (frame, stats) = look(&stand, device.as_mut());
                assert_eq!((size(&frame), stats.is_binned), (SIZE, false));
                assert!(stats.why_whole.unwrap().contains("a small one takes"));
                assert!(is_as_it_was(&stand));
            }
        },
    );
}

#[test]
fn without_the_setting_nothing_is_written_to_a_cameras_binning() {
    alone(
        "binned::without_the_setting_nothing_is_written_to_a_cameras_binning",
        || {
            let (stand, _folder) = stand();
            // One direction alone, as the camera had it.
            stand.rig.set_register(&id("c00"), BINNING[1], 3);
            let mut device = stand.open("c00", stand.parameters("c00")).unwrap();
            for _ in 0..3 {
                let (frame, stats) = look(&stand, device.as_mut());
                assert_eq!((size(&frame), stats.is_binned), (SIZE, false));
                assert_eq!(stats.why_whole, None);
            }
            assert_eq!(BINNING.map(|address| register(&stand, address)), [1, 3]);
        },
    );
}

/// What is reported next that `wanted` picks.
fn until<T>(events: &Receiver<Message>, mut wanted: impl FnMut(CameraEvent) -> Option<T>) -> T {
    let end = Instant::now() + Duration::from_secs(20);
    loop {
        let message = events.recv_deadline(end).expect("an event in time");
        if let Some(found) = wanted(message.event) {
            return found;
        }
    }
}

fn looked(events: &Receiver<Message>) -> Result<LookResult, Fault> {
    until(events, |event| match event {
        CameraEvent::Looked { outcome, .. } => Some(outcome),
        _ => None,
    })
}

fn frame_of(events: &Receiver<Message>, number: u64) -> Frame {
    until(events, |event| match event {
        CameraEvent::Frame { shot, frame } if shot == number => Some(frame),
        CameraEvent::Answered { shot, outcome } if shot == number => panic!("{outcome:?}"),
        _ => None,
    })
}

#[test]
fn a_camera_that_does_not_come_back_is_opened_anew_and_the_press_after_that_is_whole() {
    alone(
        "binned::a_camera_that_does_not_come_back_is_opened_anew_and_the_press_after_that_is_whole",
        || {
            let (stand, _folder) = stand();
            let (sender, events) = unbounded();
            let driver = Box::new(stand.driver("c00", parameters(&stand)));
            let camera = supervise(id("c00"), driver, sender, Backoff::default()).unwrap();
            let ready = |event| match event {
                CameraEvent::Ready(info) => Some(info),
                _ => None,
            };
            let away = |event| match event {
                CameraEvent::Away { fault, .. } => Some(fault.to_string()),
                _ => None,
            };
            until(&events, ready);
            let patience = Duration::from_secs(3);
            assert!(camera.look(stand.shot(1, patience)));
            assert!(!looked(&events).unwrap().is_binned);
            // It acknowledges the way back, and stays where it is.
            stand.rig.set_register(&id("c00"), STUCK, 1);
            assert!(camera.look(stand.shot(2, patience)));
            let fault = looked(&events).unwrap_err().to_string();
            assert!(fault.contains("did not come back"), "{fault}");
            let fault = until(&events, away);
            assert!(fault.contains("asked for 1, found 2"), "{fault}");
            // While its mode is in doubt, nothing is recorded.
            let again = until(&events, away);
            assert!(again.contains("BinningHorizontal"), "{again}");
            assert!(camera.shoot(stand.shot(3, patience)));
            let outcome = until(&events, |event| match event {
                CameraEvent::Answered { shot: 3, outcome } => Some(outcome),
                CameraEvent::Frame { .. } => panic!("a frame in doubt"),
                _ => None,
            });
            assert!(outcome.is_err(), "{outcome:?}");
            stand.rig.set_register(&id("c00"), STUCK, 0);
            let info = until(&events, ready);
            assert_eq!(info.size, SIZE);
            assert!(info.remarks[0].contains("did not come back"), "{info:?}");
            assert!(camera.shoot(stand.shot(4, patience)));
            let frame = frame_of(&events, 4);
            assert!(is_newest(&stand, &frame) && is_as_it_was(&stand));
            // It is not tried again, so that no press finds the camera away because of looks.
            for number in 5..7 {
                assert!(camera.look(stand.shot(number, patience)));
                let found = looked(&events).unwrap();
                assert!(!found.is_binned && found.why_whole.is_some(), "{found:?}");
            }
            assert!(camera.end().wait(Instant::now() + Duration::from_secs(10)));
        },
    );
}

#[test]
fn a_press_during_a_small_picture_waits_no_longer_than_for_a_whole_one() {
    alone(
        "binned::a_press_during_a_small_picture_waits_no_longer_than_for_a_whole_one",
        || {
            let (stand, _folder) = stand();
            let (sender, events) = unbounded();
            let driver = Box::new(stand.driver("c00", parameters(&stand)));
            let camera = supervise(id("c00"), driver, sender, Backoff::default()).unwrap();
            until(&events, |event| match event {
                CameraEvent::Ready(_) => Some(()),
                _ => None,
            });
            let patience = Duration::from_secs(3);
            let begun = Instant::now();
            assert!(camera.look(stand.shot(1, patience)));
            assert!(!looked(&events).unwrap().is_binned);
            let whole = begun.elapsed();
            for number in [2, 4, 6] {
                let begun = Instant::now();
                assert!(camera.look(stand.shot(number, patience)));
                // The thread has to have begun with it before it has room for the shot.
                while !camera.shoot(stand.shot(number + 1, patience)) {
                    assert!(begun.elapsed() < patience);
                    std::thread::sleep(Duration::from_millis(1));
                }
                let found = looked(&events).unwrap();
                let waited = begun.elapsed();
                assert!(found.is_binned && size(&found.frames[0]) == SMALL);
                assert!(waited <= whole, "{waited:?}, for a whole one {whole:?}");
                let frame = frame_of(&events, number + 1);
                assert!(is_newest(&stand, &frame));
                println!("a press waited {waited:.0?}, for a whole picture {whole:.0?}");
            }
            assert!(camera.end().wait(Instant::now() + Duration::from_secs(10)));
        },
    );
}
