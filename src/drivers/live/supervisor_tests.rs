//! Scripted cameras that open late, vanish, fall silent, panic or stamp frames wrongly.

use super::*;
use crate::clock::Clock;
use crate::frame::{CameraId, Frame, Picture, Stream, Timestamp};
use crossbeam_channel::{Receiver, unbounded};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

/// What a camera of the tests does at each shot.
type Script = fn(u64, &mut dyn FnMut(Frame)) -> Result<ShotStats, Fault>;

struct Scripted {
    opened: Arc<AtomicUsize>,
    fails_to_open: usize,
    plugged: Arc<AtomicBool>,
    script: Script,
}

struct Open {
    info: CameraInfo,
    plugged: Arc<AtomicBool>,
    script: Script,
}

impl Driver for Scripted {
    fn open(&mut self) -> Result<Box<dyn Device>, Fault> {
        let count = self.opened.fetch_add(1, Ordering::Relaxed);
        if count < self.fails_to_open || !self.plugged.load(Ordering::Relaxed) {
            return Err(Fault::Away("no answer from 127.0.0.9".into()));
        }
        Ok(Box::new(Open {
            info: CameraInfo {
                identity: "scripted".into(),
                ..CameraInfo::default()
            },
            plugged: self.plugged.clone(),
            script: self.script,
        }))
    }
}

impl Device for Open {
    fn info(&self) -> &CameraInfo {
        &self.info
    }
    fn shoot(&mut self, shot: &Shot, take: &mut dyn FnMut(Frame)) -> Result<ShotStats, Fault> {
        (self.script)(shot.number, take)
    }
    fn idle(&mut self) -> Result<(), Fault> {
        if self.plugged.load(Ordering::Relaxed) {
            Ok(())
        } else {
            Err(Fault::Away("unplugged".into()))
        }
    }
    fn idle_period(&self) -> Duration {
        Duration::from_millis(5)
    }
}

struct TestBench {
    opened: Arc<AtomicUsize>,
    plugged: Arc<AtomicBool>,
    events: Receiver<Message>,
    camera: Supervised,
}

fn stand(script: Script, fails_to_open: usize) -> TestBench {
    let opened = Arc::new(AtomicUsize::new(0));
    let plugged = Arc::new(AtomicBool::new(true));
    let driver = Box::new(Scripted {
        opened: opened.clone(),
        fails_to_open,
        plugged: plugged.clone(),
        script,
    });
    let (sender, events) = unbounded();
    let backoff = Backoff {
        first: Duration::from_millis(1),
        longest: Duration::from_millis(8),
    };
    let camera = supervise(CameraId::new("c00").unwrap(), driver, sender, backoff).unwrap();
    TestBench {
        opened,
        plugged,
        events,
        camera,
    }
}

impl TestBench {
    fn next(&self) -> CameraEvent {
        self.events
            .recv_timeout(Duration::from_secs(20))
            .unwrap()
            .event
    }

    fn ready(&self) {
        while !matches!(self.next(), CameraEvent::Ready(_)) {}
    }

    fn shoot(&self, number: u64) -> (Vec<Timestamp>, Result<ShotStats, Fault>) {
        let shot = Shot {
            number,
            trigger: Timestamp(0),
            deadline: Instant::now() + Duration::from_secs(1),
            clock: Clock::system(),
            abandoned: Arc::default(),
        };
        while !self.camera.shoot(shot.clone()) {
            std::thread::yield_now();
        }
        let mut frames = Vec::new();
        loop {
            match self.next() {
                CameraEvent::Frame { shot, frame } if shot == number => {
                    frames.push(frame.timestamp)
                }
                CameraEvent::Answered { shot, outcome } if shot == number => {
                    return (frames, outcome);
                }
                _ => {}
            }
        }
    }
}

fn frame(time: u64) -> Frame {
    Frame {
        camera: CameraId::new("c00").unwrap(),
        stream: Stream::Color,
        timestamp: Timestamp(time),
        picture: Picture::Compressed {
            format: "jpeg".into(),
            data: bytes::Bytes::new(),
        },
    }
}

fn sound(number: u64, take: &mut dyn FnMut(Frame)) -> Result<ShotStats, Fault> {
    take(frame(number));
    Ok(ShotStats::default())
}

#[test]
fn a_camera_that_is_not_there_yet_is_opened_later_and_named_meanwhile() {
    let stand = stand(sound, 5);
    match stand.next() {
        CameraEvent::Away { fault, .. } => assert!(fault.to_string().contains("127.0.0.9")),
        other => panic!("{other:?}"),
    }
    stand.ready();
    assert_eq!(stand.opened.load(Ordering::Relaxed), 6);
    assert_eq!(
        stand.shoot(1),
        (vec![Timestamp(1)], Ok(ShotStats::default()))
    );
    assert!(
        stand
            .camera
            .end()
            .wait(Instant::now() + Duration::from_secs(20))
    );
}

#[test]
fn an_unplugged_camera_is_named_when_idle_and_comes_back_each_time() {
    let rounds = crate::support::torture::times(100, 1000);
    let stand = stand(sound, 0);
    stand.ready();
    for round in 0..rounds {
        stand.plugged.store(false, Ordering::Relaxed);
        while !matches!(stand.next(), CameraEvent::Away { fault, .. } if fault == Fault::Away("unplugged".into()))
        {
        }
        let (frames, outcome) = stand.shoot(2 * round + 1);
        assert!(frames.is_empty() && outcome.is_err(), "{outcome:?}");
        stand.plugged.store(true, Ordering::Relaxed);
        stand.ready();
        assert!(stand.shoot(2 * round + 2).1.is_ok());
    }
    println!("shown: {rounds} times away and back");
    assert!(
        stand
            .camera
            .end()
            .wait(Instant::now() + Duration::from_secs(20))
    );
}

#[test]
fn a_panic_in_a_driver_costs_one_shot() {
    let stand = stand(
        |number, take| {
            assert!(number != 1, "the library lost its mind");
            sound(number, take)
        },
        0,
    );
    stand.ready();
    let (_, outcome) = stand.shoot(1);
    assert!(outcome.unwrap_err().to_string().contains("lost its mind"));
    stand.ready();
    assert!(stand.shoot(2).1.is_ok());
}

#[test]
fn a_frozen_clock_is_not_believed() {
    let stand = stand(
        |_, take| {
            take(frame(77));
            Ok(ShotStats::default())
        },
        0,
    );
    stand.ready();
    assert_eq!(stand.shoot(1).0.len(), 1);
    let (frames, outcome) = stand.shoot(2);
    assert!(frames.is_empty());
    assert!(outcome.unwrap().lost[0].contains("stands still"));
}
