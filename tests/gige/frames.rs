//! The driver receives exactly what the camera sends, whatever starts an exposure.

use crate::network::alone;
use crate::stand::{CAMERAS, CAPTURES, Stand, id, milliseconds_after};
use crossbeam_channel::unbounded;
use scand::drivers::aravis::{ExposureMark, Parameters, TriggerMode};
use scand::drivers::live::{Backoff, CameraEvent, Device, Fault, supervise};
use scand::frame::Frame;
use scand_lab::serve::Shown;
use std::time::{Duration, Instant};

#[test]
fn each_trigger_gives_the_picture_that_is_served_byte_for_byte() {
    alone(
        "frames::each_trigger_gives_the_picture_that_is_served_byte_for_byte",
        || {
            let stand = Stand::new([64, 48]);
            for (camera, (name, encoding, bytes)) in CAMERAS.iter().enumerate() {
                let mut device = stand.open(name, stand.parameters(name)).unwrap();
                let info = device.info();
                assert_eq!((info.size, info.encoding.as_str()), ([64, 48], *encoding));
                assert_eq!(info.frame_bytes, u64::from(64 * 48 * bytes));
                assert!(info.identity.contains(name), "{}", info.identity);
                assert!(info.remarks.is_empty(), "{:?}", info.remarks);
                for number in 0..2 * CAPTURES {
                    let (shot, frames, stats) = stand.shoot(device.as_mut(), number as u64);
                    let stats = stats.unwrap();
                    assert_eq!(stats, Default::default());
                    assert_eq!(frames.len(), 1);
                    assert!(
                        stand.is_picture(&frames[0], camera, number % CAPTURES),
                        "{name} {number}"
                    );
                    let after = milliseconds_after(&shot, &frames[0]);
                    assert!(after >= 0.0, "stamped {after} ms after the trigger");
                    assert!(frames[0].timestamp <= stand.clock.timestamp());
                }
                assert_eq!(stand.rig.served(&id(name)).unwrap(), 2 * CAPTURES as u64);
                stand.rig.show(Shown::Background);
                let (_, frames, _) = stand.shoot(device.as_mut(), 99);
                assert!(stand.is_picture(&frames[0], camera, 99));
                stand.rig.show(Shown::CapturesFrom(0));
            }
            let memory = stand.pool.allocated();
            assert!(
                memory <= 2 * 64 * 48 * 3,
                "{memory} bytes of the pool for one frame at a time"
            );
        },
    );
}

#[test]
fn a_frame_that_is_stamped_at_its_end_belongs_to_its_trigger() {
    alone(
        "frames::a_frame_that_is_stamped_at_its_end_belongs_to_its_trigger",
        || {
            let stand = Stand::new([64, 48]);
            // It stamps when it is triggered, by the exposure too early: as much as a clock may be off.
            let (exposure, held_back) = (0.004, Duration::from_millis(10));
            stand.rig.set_delay(&id("c00"), held_back).unwrap();
            let parameters = Parameters {
                exposure: Some(exposure),
                exposure_mark: Some(ExposureMark::End),
                ..stand.parameters("c00")
            };
            let mut device = stand.open("c00", parameters).unwrap();
            for number in 0..CAPTURES {
                let (shot, frames, stats) = stand.shoot(device.as_mut(), number as u64);
                assert_eq!(frames.len(), 1, "{stats:?}");
                assert!(stand.is_picture(&frames[0], 0, number));
                let after = milliseconds_after(&shot, &frames[0]);
                assert!(after >= 0.0, "stamped {after} ms after the trigger");
            }
        },
    );
}

#[test]
fn a_camera_is_found_by_its_serial_number_and_no_other_is_taken_for_it() {
    alone(
        "frames::a_camera_is_found_by_its_serial_number_and_no_other_is_taken_for_it",
        || {
            let stand = Stand::new([64, 48]);
            let by_serial = |serial: &str| Parameters {
                serial: Some(serial.into()),
                packet_size: Some(8000),
                ..Parameters::default()
            };
            let mut device = stand.open("c01", by_serial("c01")).unwrap();
            let (_, frames, _) = stand.shoot(device.as_mut(), 1);
            assert!(stand.is_picture(&frames[0], 1, 0));
            let second = stand.open("c01", stand.parameters("c01")).err().unwrap();
            assert!(
                matches!(&second, Fault::Away(why) if why.contains("another program")),
                "{second}"
            );
            let nobody = stand.open("c09", by_serial("c09")).err().unwrap();
            assert!(
                matches!(&nobody, Fault::Away(why) if why.contains("c00, c01, c02")),
                "{nobody}"
            );
            let wrong = Parameters {
                serial: Some("c02".into()),
                ..stand.parameters("c00")
            };
            let wrong = stand.open("c02", wrong).err().unwrap();
            assert!(matches!(wrong, Fault::Refused { .. }), "{wrong}");
            let absent = Parameters {
                address: Some([127, 0, 1, 9].into()),
                ..Parameters::default()
            };
            let absent = stand.open("c09", absent).err().unwrap();
            assert!(
                matches!(&absent, Fault::Away(why) if why.contains("127.0.1.9")),
                "{absent}"
            );
        },
    );
}

/// Within which a press comes shortly after a signal.
const SHORTLY: Duration = Duration::from_millis(40);

/// Raises the signal of the first camera's line, for the `number`-th time (from 1) that a test tries to act shortly
/// after it; the picture that this exposes.
fn pulse(stand: &Stand, number: u64) -> usize {
    assert!(number < 20, "no two lines of this test within {SHORTLY:?}");
    assert!(stand.rig.pulse_line(&id("c00")));
    newest_picture(stand)
}

/// The picture that the first camera has sent last.
fn newest_picture(stand: &Stand) -> usize {
    (stand.rig.served(&id("c00")).unwrap() as usize - 1) % CAPTURES
}

#[test]
fn a_line_exposes_without_the_daemon() {
    alone("frames::a_line_exposes_without_the_daemon", || {
        let stand = Stand::new([64, 48]);
        let parameters = Parameters {
            trigger: Some(TriggerMode::Line),
            trigger_source: Some("Line0".into()),
            ..stand.parameters("c00")
        };
        let mut device = stand.open("c00", parameters).unwrap();
        // A pulse that nobody asked for, long before.
        assert!(stand.rig.pulse_line(&id("c00")));
        device.idle().unwrap();
        std::thread::sleep(Duration::from_millis(120));
        // The pulse comes shortly before the daemon hears of it; on a busy machine perhaps not so shortly.
        for number in 1.. {
            let begin = Instant::now();
            let picture = pulse(&stand, number);
            let is_quick = begin.elapsed() < SHORTLY;
            let (shot, frames, stats) =
                stand.shoot_within(device.as_mut(), number, Duration::from_millis(500));
            if is_quick {
                assert_eq!(frames.len(), 1, "{stats:?}");
                assert!(stand.is_picture(&frames[0], 0, picture));
                assert!((-50.0..1.0).contains(&milliseconds_after(&shot, &frames[0])));
                break;
            }
        }
        // And after it.
        std::thread::scope(|scope| {
            scope.spawn(|| {
                std::thread::sleep(Duration::from_millis(100));
                assert!(stand.rig.pulse_line(&id("c00")));
            });
            let (shot, frames, stats) = stand.shoot(device.as_mut(), 30);
            assert_eq!(frames.len(), 1, "{stats:?}");
            assert!(stand.is_picture(&frames[0], 0, newest_picture(&stand)));
            assert!(milliseconds_after(&shot, &frames[0]) > 80.0);
        });
        let (_, frames, stats) = stand.shoot_within(device.as_mut(), 3, Duration::from_millis(200));
        assert!(frames.is_empty());
        assert!(stats.unwrap().lost[0].contains("no frame arrived"));
    });
}

#[test]
fn a_look_at_a_line_shows_what_the_newest_signal_exposed_and_leaves_it_to_a_press() {
    alone(
        "frames::a_look_at_a_line_shows_what_the_newest_signal_exposed_and_leaves_it_to_a_press",
        || {
            let stand = Stand::new([64, 48]);
            let parameters = Parameters {
                trigger: Some(TriggerMode::Line),
                trigger_source: Some("Line0".into()),
                ..stand.parameters("c00")
            };
            let mut device = stand.open("c00", parameters).unwrap();
            // A look raises no signal, and does not wait for one.
            let begin = Instant::now();
            let (seen, lost) = look(&stand, device.as_mut());
            assert!(seen.is_empty() && begin.elapsed() < Duration::from_secs(1));
            assert!(lost[0].contains("no signal came"), "{lost:?}");
            assert_eq!(stand.rig.served(&id("c00")).unwrap(), 0);
            // A press right after a signal has the frame that a look has shown.
            for number in 1.. {
                let begin = Instant::now();
                let picture = pulse(&stand, number);
                let seen = loop {
                    let (seen, _) = look(&stand, device.as_mut());
                    if !seen.is_empty() {
                        break seen;
                    }
                    assert!(begin.elapsed() < Duration::from_secs(10));
                };
                assert!(stand.is_picture(&seen[0], 0, picture));
                let is_quick = begin.elapsed() < SHORTLY;
                let patience = Duration::from_millis(500);
                let (_, frames, stats) = stand.shoot_within(device.as_mut(), number, patience);
                if is_quick {
                    assert_eq!(frames.len(), 1, "{stats:?}");
                    assert!(stand.is_picture(&frames[0], 0, picture));
                    assert_eq!(frames[0].timestamp, seen[0].timestamp);
                    break;
                }
            }
            let (seen, lost) = look(&stand, device.as_mut());
            assert!(
                seen.is_empty() && lost[0].contains("no signal came"),
                "{lost:?}"
            );
        },
    );
}

/// What a look at a camera gives, and what it says is missing.
fn look(stand: &Stand, device: &mut dyn Device) -> (Vec<Frame>, Vec<String>) {
    let mut seen = Vec::new();
    let shot = stand.shot(1, Duration::from_secs(2));
    let stats = device.look(&shot, &mut |frame| seen.push(frame));
    (seen, stats.unwrap().lost)
}

#[test]
fn a_free_running_camera_gives_the_frames_around_a_trigger() {
    alone(
        "frames::a_free_running_camera_gives_the_frames_around_a_trigger",
        || {
            let stand = Stand::new([64, 48]);
            let parameters = Parameters {
                trigger: Some(TriggerMode::FreeRun),
                frame_rate: Some(25.0),
                ..stand.parameters("c00")
            };
            let mut device = stand.open("c00", parameters).unwrap();
            for number in 0..5 {
                let until = Instant::now() + Duration::from_millis(300);
                while Instant::now() < until {
                    std::thread::sleep(device.idle_period());
                    device.idle().unwrap();
                }
                let (shot, frames, stats) = stand.shoot(device.as_mut(), number);
                assert_eq!(frames.len(), 2, "{stats:?}");
                let times: Vec<f64> = frames
                    .iter()
                    .map(|f| milliseconds_after(&shot, f))
                    .collect();
                // 40 ms apart, but for a host that is busy: the camera is a thread of this process. That none is
                // missing between them the pictures show.
                assert!(times[0] < 0.0 && times[0] > -200.0, "{times:?}");
                assert!(times[1] >= 0.0 && times[1] < 200.0, "{times:?}");
                let first = (0..CAPTURES)
                    .find(|&k| stand.is_picture(&frames[0], 0, k))
                    .unwrap();
                assert!(stand.is_picture(&frames[1], 0, (first + 1) % CAPTURES));
            }
        },
    );
}

#[test]
fn a_part_of_the_sensor_is_read_where_that_is_asked_for() {
    alone(
        "frames::a_part_of_the_sensor_is_read_where_that_is_asked_for",
        || {
            use scand::drivers::aravis::Region;
            use scand::frame::Picture;
            let stand = Stand::new([64, 48]);
            let region = Region {
                x: 8,
                y: 4,
                width: 16,
                height: 12,
            };
            let parameters = Parameters {
                region: Some(region),
                ..stand.parameters("c02")
            };
            let mut device = stand.open("c02", parameters).unwrap();
            assert_eq!(device.info().size, [16, 12]);
            let (_, frames, _) = stand.shoot(device.as_mut(), 1);
            let whole = crate::stand::pixels(2, 0, [64, 48], 1);
            let expected: Vec<u8> = (4..16)
                .flat_map(|y| whole[y * 64 + 8..y * 64 + 24].to_vec())
                .collect();
            let Picture::Raw { data, .. } = &frames[0].picture else {
                panic!("not raw")
            };
            assert_eq!(data[..], expected[..]);
        },
    );
}

#[test]
fn triggers_may_be_rare() {
    alone("frames::triggers_may_be_rare", || {
        let stand = Stand::new([64, 48]);
        let mut device = stand.open("c00", stand.parameters("c00")).unwrap();
        // A camera lets go of who sends it nothing for three seconds: that is its own time, and no clock of ours.
        let until = Instant::now() + Duration::from_secs(4);
        while Instant::now() < until {
            std::thread::sleep(device.idle_period());
            device.idle().unwrap();
        }
        let (_, frames, stats) = stand.shoot(device.as_mut(), 0);
        assert_eq!((frames.len(), stats), (1, Ok(Default::default())));
    });
}

#[test]
fn cameras_are_shot_together_and_each_gives_its_own() {
    alone(
        "frames::cameras_are_shot_together_and_each_gives_its_own",
        || {
            let stand = Stand::new([640, 480]);
            let (sender, events) = unbounded();
            let start = |name: &&str| {
                let driver = Box::new(stand.driver(name, stand.parameters(name)));
                supervise(id(name), driver, sender.clone(), Backoff::default()).unwrap()
            };
            let names: Vec<&str> = CAMERAS.iter().map(|c| c.0).collect();
            let cameras: Vec<_> = names.iter().map(start).collect();
            let next = || events.recv_timeout(Duration::from_secs(20)).unwrap();
            (0..cameras.len()).for_each(|_| assert!(matches!(next().event, CameraEvent::Ready(_))));
            let mut spreads = Vec::new();
            for number in 0..30 {
                let shot = stand.shot(number, Duration::from_secs(3));
                assert!(cameras.iter().all(|camera| camera.shoot(shot.clone())));
                let (mut times, mut answers) = (Vec::new(), 0);
                while answers < cameras.len() {
                    let message = next();
                    let camera = names
                        .iter()
                        .position(|n| *n == message.camera.as_str())
                        .unwrap();
                    match message.event {
                        CameraEvent::Frame { frame, .. } => {
                            assert!(stand.is_picture(&frame, camera, number as usize % CAPTURES));
                            times.push(frame.timestamp.0);
                        }
                        CameraEvent::Answered { outcome, .. } => {
                            assert_eq!(outcome, Ok(Default::default()));
                            answers += 1;
                        }
                        other => panic!("{other:?}"),
                    }
                }
                assert_eq!(times.len(), cameras.len());
                spreads
                    .push((times.iter().max().unwrap() - times.iter().min().unwrap()) as f64 / 1e6);
            }
            spreads.sort_by(f64::total_cmp);
            println!(
                "spread of the stamps: median {:.2} ms, most {:.2} ms",
                spreads[15], spreads[29]
            );
            for camera in cameras {
                assert!(camera.end().wait(Instant::now() + Duration::from_secs(10)));
            }
        },
    );
}
