//! Scripted cameras for tests, and a daemon that takes captures with them.

use super::capturing::Order;
use super::recorder::Answer;
use super::*;
use crate::clock::Clock;
use crate::drivers::live::{Backoff, CameraInfo, Device, Driver, Fault, Pool, Shot, ShotStats};
use crate::frame::{CameraId, Frame, Picture, Stream, Timestamp};
use crate::recording::{CaptureOutcome, Recording, SessionHeader, Topic};
use crate::sync;
use crate::trigger::{Reply, Until};
use crossbeam_channel::{Receiver, bounded, unbounded};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

/// How a camera behaves at its shots from now on.
#[derive(Clone, Copy, PartialEq)]
#[repr(u32)]
pub(super) enum Behaviour {
    Sound,
    /// Unplugged at the next shot, and away for one attempt to open it.
    Unplugged,
    /// Never answers before the shot's end.
    Silent,
    /// A frame comes damaged.
    Loses,
    /// A frame comes damaged, and at the next shot the camera is sound.
    LosesOnce,
    /// Exposes 200 ms late.
    Late,
    /// Exposed 30 ms before the trigger was heard of, by a signal of its own.
    Early,
    /// Is sound, and takes 100 ms of its clock.
    Slow,
    /// Is sound, and takes 1.5 s of its clock.
    VerySlow,
}

const BEHAVIOURS: [Behaviour; 9] = [
    Behaviour::Sound,
    Behaviour::Unplugged,
    Behaviour::Silent,
    Behaviour::Loses,
    Behaviour::LosesOnce,
    Behaviour::Late,
    Behaviour::Early,
    Behaviour::Slow,
    Behaviour::VerySlow,
];

#[derive(Clone)]
struct ScriptedCamera {
    id: CameraId,
    depth: bool,
    clock: Clock,
    pool: Pool,
    behaviour: Arc<AtomicU32>,
    shots: Arc<AtomicU32>,
    info: CameraInfo,
    /// By how much more each shot's frames are late, so that they follow each other by a clock that stands still.
    later_ns: u64,
}

impl Driver for ScriptedCamera {
    fn open(&mut self) -> Result<Box<dyn Device>, Fault> {
        Ok(Box::new(self.clone()))
    }
}

const PIXELS: usize = 64 * 48;

impl ScriptedCamera {
    fn frame(&self, stream: Stream, timestamp: Timestamp, fill: u8) -> Option<Frame> {
        let (encoding, bytes) = match stream {
            Stream::Color => ("bayer_rggb8", 1),
            Stream::Depth => ("16UC1", 2),
            Stream::DepthColor => ("rgb8", 3),
        };
        let mut buffer = self.pool.take(PIXELS * bytes)?;
        buffer.write(&vec![fill; PIXELS * bytes]);
        Some(Frame {
            camera: self.id.clone(),
            stream,
            timestamp,
            picture: Picture::Raw {
                width: 64,
                height: 48,
                encoding: encoding.into(),
                step: 64 * bytes as u32,
                data: buffer.freeze(),
            },
        })
    }
}

impl Device for ScriptedCamera {
    fn info(&self) -> &CameraInfo {
        &self.info
    }

    fn shoot(&mut self, shot: &Shot, take: &mut dyn FnMut(Frame)) -> Result<ShotStats, Fault> {
        let behaviour = BEHAVIOURS[self.behaviour.load(Ordering::Relaxed) as usize];
        let number = self.shots.fetch_add(1, Ordering::Relaxed) + 1;
        let mut stats = ShotStats::default();
        match behaviour {
            Behaviour::Unplugged => {
                self.behaviour
                    .store(Behaviour::Sound as u32, Ordering::Relaxed);
                return Err(Fault::Away("unplugged".into()));
            }
            Behaviour::Silent => {
                while !shot.remaining().is_zero() {
                    std::thread::sleep(Duration::from_millis(1));
                }
                return Ok(stats);
            }
            Behaviour::Loses | Behaviour::LosesOnce => {
                if behaviour == Behaviour::LosesOnce {
                    self.behaviour
                        .store(Behaviour::Sound as u32, Ordering::Relaxed);
                }
                stats.lost.push("a damaged frame".into());
                return Ok(stats);
            }
            Behaviour::Sound
            | Behaviour::Late
            | Behaviour::Early
            | Behaviour::Slow
            | Behaviour::VerySlow => {}
        }
        let begin = match behaviour {
            Behaviour::Late => self.clock.timestamp().0 + 200_000_000,
            Behaviour::Early => shot.trigger.0 - 30_000_000,
            _ => self.clock.timestamp().0,
        };
        self.clock.sleep(Duration::from_millis(match behaviour {
            Behaviour::Slow => 100,
            Behaviour::VerySlow => 1500,
            _ => 0,
        }));
        let streams: &[Stream] = if self.depth {
            &[Stream::Depth, Stream::DepthColor]
        } else {
            &[Stream::Color]
        };
        for i in 0..if self.depth { 14 } else { 1 } {
            for &stream in streams {
                // So close that the next shot's are later, however soon it comes.
                let time = Timestamp(begin + u64::from(number) * self.later_ns + i * 20_000);
                match self.frame(stream, time, number as u8) {
                    Some(frame) => take(frame),
                    None => stats.lost.push("no memory".into()),
                }
            }
        }
        Ok(stats)
    }

    fn idle(&mut self) -> Result<(), Fault> {
        Ok(())
    }

    fn idle_period(&self) -> Duration {
        Duration::from_millis(50)
    }

    fn health(&mut self) -> Vec<[String; 2]> {
        vec![["temperature".into(), "40.0 °C".into()]]
    }
}

pub(super) struct TestBench {
    pub(super) folder: tempfile::TempDir,
    pub(super) capturing: Arc<Capturing>,
    behaviours: Behaviours,
    pub(super) pool: Pool,
    presses: AtomicU32,
}

pub(super) fn plan(folder: &Path, pool: &Pool) -> CapturePlan {
    CapturePlan {
        sync: sync::Parameters {
            window_ms: 400.0,
            depth_frames: 12,
            ..sync::Parameters::default()
        },
        capture: CaptureParameters {
            patience_ms: 100,
            largest_skew_ms: 100.0,
            ..CaptureParameters::default()
        },
        recording: RecordingParameters {
            folder: folder.into(),
            keep_free_mb: 1,
            ..RecordingParameters::default()
        },
        calibration: None,
        header: SessionHeader {
            configuration: "# a test".into(),
            ..SessionHeader::default()
        },
        pool: pool.clone(),
        program: "scand test".into(),
        events: events::Events::default(),
        models: None,
        jobs: None,
        look: None,
        watchdog: Watchdog::default(),
    }
}

pub(super) const CAMERAS: [(&str, CameraKind); 4] = [
    ("c00", CameraKind::Color),
    ("c01", CameraKind::Color),
    ("c02", CameraKind::Color),
    ("k0", CameraKind::Depth),
];

pub(super) fn start_in(
    folder: tempfile::TempDir,
    memory: usize,
    change: impl FnOnce(&mut CapturePlan),
) -> TestBench {
    start_on(Clock::system(), 0, &CAMERAS, folder, memory, change)
}

/// With a clock that stands still until it is advanced.
pub(super) fn start_at(
    clock: Clock,
    cameras: &[(&str, CameraKind)],
    folder: tempfile::TempDir,
    memory: usize,
    change: impl FnOnce(&mut CapturePlan),
) -> TestBench {
    start_on(clock, 1_000_000, cameras, folder, memory, change)
}

/// How each camera behaves, by its name.
type Behaviours = BTreeMap<String, Arc<AtomicU32>>;

/// The cameras alone.
pub(super) fn rig(
    clock: Clock,
    later_ns: u64,
    cameras: &[(&str, CameraKind)],
    pool: &Pool,
) -> (Rig, Behaviours) {
    let mut behaviours = BTreeMap::new();
    let mut rig_cameras = Vec::new();
    for &(name, kind) in cameras {
        let depth = kind != CameraKind::Color;
        let behaviour: Arc<AtomicU32> = Arc::default();
        behaviours.insert(name.to_owned(), behaviour.clone());
        let id = CameraId::new(name).unwrap();
        let driver = ScriptedCamera {
            id: id.clone(),
            depth,
            clock,
            pool: pool.clone(),
            behaviour,
            shots: Arc::default(),
            later_ns,
            info: CameraInfo {
                identity: "played".into(),
                frame_bytes: (PIXELS * if depth { 5 } else { 1 }) as u64,
                ..CameraInfo::default()
            },
        };
        rig_cameras.push(RigCamera {
            id,
            kind,
            needs_signal: name.starts_with("line"),
            driver: Box::new(driver),
        });
    }
    let backoff = Backoff {
        first: Duration::from_millis(20),
        longest: Duration::from_millis(40),
    };
    (
        Rig::start(rig_cameras, clock, 64, backoff).unwrap(),
        behaviours,
    )
}

fn start_on(
    clock: Clock,
    later_ns: u64,
    cameras: &[(&str, CameraKind)],
    folder: tempfile::TempDir,
    memory: usize,
    change: impl FnOnce(&mut CapturePlan),
) -> TestBench {
    let pool = Pool::new(memory);
    let (rig, behaviours) = rig(clock, later_ns, cameras, &pool);
    let mut plan = plan(folder.path(), &pool);
    change(&mut plan);
    let interrupted =
        InterruptedRecordings::recover(&plan.recording.folder, &plan.watchdog).unwrap();
    let capturing = Arc::new(Capturing::start(rig, plan, &interrupted).unwrap());
    interrupted.forget();
    let stand = TestBench {
        folder,
        capturing,
        behaviours,
        pool,
        presses: AtomicU32::new(0),
    };
    stand.until(|status| {
        let ready = status.cameras.values().filter(|c| c.state == "ready");
        ready.count() == cameras.len()
    });
    stand
}

pub(super) fn start(change: impl FnOnce(&mut CapturePlan)) -> TestBench {
    start_in(tempfile::tempdir().unwrap(), 4_000_000, change)
}

impl TestBench {
    pub(super) fn until(&self, reached: impl Fn(&Status) -> bool) {
        let deadline = Instant::now() + Duration::from_secs(30);
        while !reached(&self.capturing.status()) {
            assert!(Instant::now() < deadline, "{:?}", self.capturing.status());
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    pub(super) fn behaviour(&self, camera: &str, behaviour: Behaviour) {
        self.behaviours[camera].store(behaviour as u32, Ordering::Relaxed);
    }

    /// Presses by a new name; what is heard, up to the capture's being on the disk.
    pub(super) fn begin_press(&self) -> Receiver<Reply> {
        self.begin_press_of(self.new_name())
    }

    fn new_name(&self) -> String {
        format!("p{}", self.presses.fetch_add(1, Ordering::Relaxed) + 1)
    }

    fn begin_press_of(&self, name: String) -> Receiver<Reply> {
        let mut replies = self
            .capturing
            .press("test".into(), Some(name), Some("17".into()), None);
        let (sender, progress) = unbounded();
        std::thread::spawn(move || {
            loop {
                let Some(reply) = replies.try_next() else {
                    std::thread::sleep(Duration::from_micros(100));
                    continue;
                };
                let is_end = reply.is_end(Until::Durable);
                if sender.send(reply).is_err() || is_end {
                    return;
                }
            }
        });
        progress
    }

    /// Makes the recorder's thread wait until the receiver that is returned takes its answer.
    pub(super) fn hold_recorder(&self) -> Receiver<()> {
        let (heard, hearing) = bounded(0);
        let note = crate::recording::Note {
            capture: "a".into(),
            kind: "text".into(),
            text: String::new(),
            author: None,
        };
        let answer = Box::new(move |_| {
            let _ = heard.send(());
        });
        self.capturing.order(Order::Note(note, answer));
        hearing
    }

    /// Presses, and again while another order is being carried out; all that is heard.
    pub(super) fn press(&self) -> Vec<Reply> {
        let name = self.new_name();
        loop {
            let mut heard = Vec::new();
            for progress in self.begin_press_of(name.clone()) {
                let end = progress.is_end(Until::Durable);
                heard.push(progress);
                if end {
                    break;
                }
            }
            if heard != [Reply::Busy] {
                return heard;
            }
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    pub(super) fn ask(&self, order: impl Fn(Answer) -> Order) -> Result<String, String> {
        loop {
            let (sender, answer) = bounded(1);
            let tell = move |result| drop(sender.send(result));
            self.capturing.order(order(Box::new(tell)));
            match answer.recv().unwrap() {
                Err(words) if words.starts_with("another order is being carried out") => {
                    std::thread::yield_now();
                }
                other => return other,
            }
        }
    }

    pub(super) fn stop(self) -> (tempfile::TempDir, Vec<CameraId>) {
        let stuck = self.capturing.stop();
        (self.folder, stuck)
    }
}

pub(super) fn recordings(folder: &Path) -> Vec<Recording> {
    let mut files: Vec<_> = std::fs::read_dir(folder)
        .unwrap()
        .map(|f| f.unwrap().path())
        .filter(|f| f.is_file() && f.extension().is_some_and(|e| e == "mcap"))
        .collect();
    files.sort();
    files.iter().map(|f| Recording::open(f).unwrap()).collect()
}

/// Id, outcome and number of listed frames of each capture.
pub(super) fn captures(
    recording: &Recording,
) -> Vec<(String, CaptureOutcome, usize, Option<String>)> {
    let records = recording.messages(&Topic::Capture).iter();
    records
        .map(|m| {
            let record = recording.capture_record(m).unwrap();
            let listed = record
                .cameras
                .values()
                .filter_map(|c| c.timestamps.as_ref());
            let frames = listed.map(Vec::len).sum();
            (record.id, record.outcome, frames, record.reason)
        })
        .collect()
}
