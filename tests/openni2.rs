//! The depth camera's driver on Debian's libOpenNI2 and a simulated sensor: each test runs in a process that was
//! started with the library's folder in its environment.

#[path = "openni2-sensor/stage.rs"]
mod stage;
mod support;

use scand::clock::Clock;
use scand::drivers::live::{
    Backoff, CameraEvent, Device, Driver, Fault, Message, Pool, Shot, ShotStats, supervise,
};
use scand::drivers::openni2::{OpenNi2, Parameters};
use scand::frame::{CameraId, Frame, Picture, Stream, Timestamp};
use scand::recording::{DepthPart, Recording, Topic};
use scand_lab::serve::{SensorFile, SensorFrames, write_sensor_frames};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use support::wait::until;

const SIZE: [u32; 2] = [64, 48];
const PIXELS: usize = 64 * 48;

/// A reading that is another one at each pixel of each frame.
fn reading(frame: usize, pixel: usize) -> u16 {
    (400 + (frame * 131 + pixel * 7) % 9000) as u16
}

fn color(frame: usize, pixel: usize) -> [u8; 3] {
    [frame as u8, pixel as u8, (pixel / 256 + frame * 3) as u8]
}

fn depth_bytes(frame: usize) -> Vec<u8> {
    (0..PIXELS)
        .flat_map(|p| reading(frame, p).to_le_bytes())
        .collect()
}

fn color_bytes(frame: usize) -> Vec<u8> {
    (0..PIXELS).flat_map(|p| color(frame, p)).collect()
}

/// What a test's process works with.
struct Stand {
    folder: PathBuf,
    clock: Clock,
    pool: Pool,
}

/// Runs a test's body in a process of its own, which sees so many sensors `d0`, `d1`, … with this rate.
fn staged(name: &str, sensors: usize, rate: u32, body: fn(&Stand)) {
    let files = |folder: &Path| {
        (0..sensors)
            .map(|n| write_sensor(folder, n, rate))
            .collect()
    };
    staged_with(name, &files, body);
}

/// The same with the sensors of these files.
fn staged_with(name: &str, files: &dyn Fn(&Path) -> Vec<String>, body: fn(&Stand)) {
    if let Some(folder) = std::env::var_os("SCAND_TEST_STAGED") {
        return body(&Stand {
            folder: folder.into(),
            clock: Clock::system(),
            pool: Pool::new(64 << 20),
        });
    }
    let libraries = stage::folder();
    let folder = tempfile::tempdir().unwrap();
    let files = files(folder.path());
    let output = Command::new(std::env::current_exe().unwrap())
        .args([name, "--exact", "--nocapture", "--test-threads=1"])
        .env("SCAND_TEST_STAGED", folder.path())
        .env("SCAND_OPENNI2_FRAMES", files.join(":"))
        .env("SCAND_OPENNI2_CONTROL", folder.path().join("control"))
        .env("LD_LIBRARY_PATH", libraries)
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stdout).into_owned()
        + &String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}");
    assert!(said.contains("1 passed"), "it did not run: {said}");
}

/// A sensor of two captures: 30 frames each, the second's colour half as often.
fn write_sensor(folder: &Path, number: usize, rate: u32) -> String {
    let sensor = SensorFile {
        serial: format!("d{number}"),
        size: SIZE,
        rate,
        tenths_of_millimetres: false,
    };
    let path = folder.join(format!("{}.frames", sensor.serial));
    let mut file = SensorFrames::create(&path, &sensor, &[[30, 30], [30, 15]]).unwrap();
    for (frames, every) in [(0..30, 1), (100..130, 2)] {
        for frame in frames.clone() {
            let readings: Vec<u16> = (0..PIXELS).map(|p| reading(frame, p)).collect();
            file.depth(&readings).unwrap();
        }
        for frame in frames.step_by(every) {
            let pixels: Vec<[u8; 3]> = (0..PIXELS).map(|p| color(frame, p)).collect();
            file.color(&pixels).unwrap();
        }
    }
    file.finish().unwrap();
    path.to_str().unwrap().to_owned()
}

impl Stand {
    /// A camera that is set so, in TOML, beside its size.
    fn driver(&self, rate: u32, settings: &str) -> OpenNi2 {
        let text = format!("size = [64, 48]\nrate = {rate}\n{settings}");
        let parameters: Parameters = toml::from_str(&text).unwrap();
        parameters.checked().unwrap();
        let id = CameraId::new("d0").unwrap();
        OpenNi2::new(id, parameters, self.pool.clone(), self.clock)
    }

    fn open(&self, rate: u32, settings: &str) -> Result<Box<dyn Device>, Fault> {
        self.driver(rate, settings).open()
    }

    /// Tells the sensors something, and waits until they have heard.
    fn tell(&self, what: &str) {
        let path = self.folder.join("control");
        let new = self.folder.join("control.new");
        std::fs::write(&new, what).unwrap();
        std::fs::rename(&new, &path).unwrap();
        until("a sensor does not listen", || {
            let files = std::fs::read_dir(&self.folder).unwrap();
            let paths = files.map(|file| file.unwrap().path());
            let is_answer = |path: &PathBuf| path.to_string_lossy().contains("control.heard-");
            // One that plays no longer removes its answer.
            let is_heard =
                |path: PathBuf| std::fs::read_to_string(path).is_ok_and(|text| text == what);
            paths.filter(is_answer).all(is_heard)
        });
    }

    fn shot(&self, number: u64, seconds: f64) -> Shot {
        Shot {
            number,
            trigger: self.clock.timestamp(),
            deadline: Instant::now() + Duration::from_secs_f64(seconds),
            clock: self.clock,
            abandoned: Arc::default(),
        }
    }

    fn shoot(&self, device: &mut dyn Device) -> (Vec<Frame>, Result<ShotStats, Fault>, Timestamp) {
        let shot = self.shot(1, 5.0);
        let mut frames = Vec::new();
        let outcome = device.shoot(&shot, &mut |frame| frames.push(frame));
        (frames, outcome, shot.trigger)
    }
}

fn data(frame: &Frame) -> &[u8] {
    match &frame.picture {
        Picture::Raw { data, .. } => data,
        Picture::Compressed { .. } => panic!("{frame:?}"),
    }
}

fn of(frames: &[Frame], stream: Stream) -> Vec<&Frame> {
    frames.iter().filter(|f| f.stream == stream).collect()
}

/// Frames that the statistics say never came, and asserts that they say nothing else: OpenNI keeps the newest frame of
/// a stream alone, so on a busy machine some are missed. They are counted.
fn missed(stats: &ShotStats, of: &str) -> usize {
    let count = |line: &String| {
        assert!(line.ends_with("did not arrive"), "{stats:?}");
        let words: Vec<&str> = line.split(' ').collect();
        (words[1] == of).then(|| words[0].parse::<usize>().unwrap())
    };
    stats.lost.iter().filter_map(count).sum()
}

/// Asserts that frames are served ones in their order, whichever was first; how many were left out between them.
fn served(frames: &[&Frame], first: usize, bytes: fn(usize) -> Vec<u8>) -> usize {
    let number = |f: &&Frame| (first..first + 30).find(|&n| data(f) == bytes(n));
    let numbers = frames.iter().map(number);
    let numbers: Vec<usize> = numbers
        .map(|n| n.expect("a frame that was not served"))
        .collect();
    let gap = |pair: &[usize]| (pair[1] + 30 - pair[0] - 1) % 30;
    numbers.windows(2).map(gap).sum()
}

#[test]
fn a_burst_is_what_was_served_byte_for_byte() {
    staged("a_burst_is_what_was_served_byte_for_byte", 1, 30, |stand| {
        let mut device = stand.open(30, "").unwrap();
        let info = device.info().clone();
        assert!(info.identity.contains("scand-sensor://d0"), "{info:?}");
        assert_eq!((info.size, info.encoding.as_str()), (SIZE, "16UC1"));
        assert!(info.remarks.iter().any(|r| r.contains("millimetres")));
        let rows: Vec<&str> = info.table.iter().map(|r| r[0].as_str()).collect();
        for name in [
            "depth mode",
            "color mode",
            "depth mirroring",
            "registration of depth to color",
        ] {
            assert!(rows.contains(&name), "{rows:?}");
        }
        for capture in [0, 1] {
            stand.tell(&format!("d0 capture {capture}"));
            device.idle().unwrap();
            let (frames, outcome, trigger) = stand.shoot(device.as_mut());
            let stats = outcome.unwrap();
            let (depth, color) = (of(&frames, Stream::Depth), of(&frames, Stream::DepthColor));
            assert_eq!((depth.len(), color.len()), (30, 30));
            let gaps = served(&depth, capture * 100, depth_bytes);
            // A frame that is missed before the first one of the burst is counted too.
            assert!(gaps <= missed(&stats, "depth"), "{gaps} {stats:?}");
            if capture == 0 {
                assert!(served(&color, 0, color_bytes) <= missed(&stats, "color"));
            }
            let times: Vec<Timestamp> = color.iter().map(|c| c.timestamp).collect();
            let together = depth
                .iter()
                .filter(|d| times.contains(&d.timestamp))
                .count();
            assert!(together >= 25, "synchronised: {together}");
            assert!(depth[0].timestamp >= trigger);
            for pair in depth.windows(2) {
                let apart = pair[1].timestamp.nanoseconds_since(pair[0].timestamp);
                let off = (apart + 16_666_667) % 33_333_333 - 16_666_667;
                assert!(apart > 0 && off.abs() < 100_000, "{apart} ns apart");
            }
        }
    });
}

#[test]
fn registration_that_does_not_take_is_refused_by_name() {
    staged(
        "registration_that_does_not_take_is_refused_by_name",
        1,
        60,
        |stand| {
            stand.tell("d0 unregistered");
            match stand.open(60, "") {
                Err(Fault::Refused {
                    field,
                    asked,
                    found,
                }) => {
                    assert_eq!((asked.as_str(), found.as_str()), ("on", "off"));
                    assert!(field.contains("registration"), "{field}");
                }
                other => panic!("{:?}", other.map(|d| d.info().clone())),
            }
            assert!(stand.open(60, "registration = false").is_ok());
            stand.tell("");
            let mut device = stand.open(60, "").unwrap();
            device.idle().unwrap();
            stand.tell("d0 unregistered");
            let lost = device.idle().unwrap_err();
            assert!(lost.to_string().contains("registration"), "{lost}");
            drop(device);
            // A mode that it has not is refused with those that it has.
            stand.tell("");
            let refused = stand.open(30, "").err().unwrap().to_string();
            assert!(
                refused.contains("depth mode: asked for 64 x 48 at 30/s"),
                "{refused}"
            );
            assert!(
                refused.contains("its modes are: 64 x 48 at 60/s"),
                "{refused}"
            );
        },
    );
}

#[test]
fn synchronisation_is_demanded_or_taken_where_there_is_one() {
    staged(
        "synchronisation_is_demanded_or_taken_where_there_is_one",
        1,
        60,
        |stand| {
            let row = |device: &dyn Device| {
                let table = &device.info().table;
                let row = table.iter().find(|r| r[0].contains("synchronisation"));
                row.unwrap()[2].clone()
            };
            assert_eq!(row(stand.open(60, "").unwrap().as_ref()), "on");
            assert_eq!(
                row(stand.open(60, "synchronise = false").unwrap().as_ref()),
                "off"
            );
            stand.tell("d0 unsynchronised");
            let mut device = stand.open(60, "").unwrap();
            assert!(row(device.as_ref()).contains("does not support it"));
            let (frames, outcome, _) = stand.shoot(device.as_mut());
            missed(&outcome.unwrap(), "depth");
            assert_eq!(frames.len(), 60);
            drop(device);
            let refused = stand.open(60, "synchronise = true").err().unwrap();
            assert!(refused.to_string().contains("synchronisation"), "{refused}");
        },
    );
}

#[test]
fn a_damaged_frame_never_looks_whole() {
    staged("a_damaged_frame_never_looks_whole", 1, 60, |stand| {
        let mut device = stand.open(60, "").unwrap();
        stand.tell("d0 damaged 5");
        let (frames, outcome, _) = stand.shoot(device.as_mut());
        let lost = outcome.unwrap().lost;
        assert!(
            lost.iter()
                .any(|l| l.contains("3072 of its 6144 bytes arrived")),
            "{lost:?}"
        );
        assert_eq!(of(&frames, Stream::Depth).len(), 30);
        for frame in of(&frames, Stream::Depth) {
            assert_eq!(data(frame).len(), PIXELS * 2);
        }
    });
}

#[test]
fn a_silent_camera_and_a_frozen_clock_are_named() {
    staged(
        "a_silent_camera_and_a_frozen_clock_are_named",
        1,
        60,
        |stand| {
            let mut device = stand.open(60, "").unwrap();
            stand.tell("d0 silent");
            let silent = device.idle().unwrap_err().to_string();
            assert!(silent.contains("no frame arrived for 1.0 s"), "{silent}");
            let (frames, outcome, _) = stand.shoot(device.as_mut());
            assert!(frames.is_empty() && outcome.is_err());
            stand.tell("d0 frozen");
            device.drop_and_expect("stands still", stand);
            let refused = stand.open(60, "").err().unwrap().to_string();
            assert!(refused.contains("stands still"), "{refused}");
            stand.tell("");
            assert!(stand.open(60, "").is_ok());
        },
    );
}

trait Expect {
    fn drop_and_expect(self, word: &str, stand: &Stand);
}

impl Expect for Box<dyn Device> {
    /// In a shot each frame is lost for that reason; when idle the camera is away for it.
    fn drop_and_expect(mut self, word: &str, stand: &Stand) {
        let _ = self.idle();
        let shot = stand.shot(2, 0.5);
        let mut frames = 0;
        let stats = self.shoot(&shot, &mut |_| frames += 1).unwrap();
        assert_eq!(frames, 0);
        assert!(stats.lost.len() > 5, "{stats:?}");
        assert!(
            stats
                .lost
                .iter()
                .all(|l| l.contains(word) || l.ends_with("did not arrive")),
            "{stats:?}"
        );
        let idle = self.idle().unwrap_err().to_string();
        assert!(idle.contains(word), "{idle}");
    }
}

#[test]
fn an_unplugged_camera_is_named_and_comes_back() {
    staged(
        "an_unplugged_camera_is_named_and_comes_back",
        1,
        60,
        |stand| {
            let (sender, events) = crossbeam_channel::bounded::<Message>(500);
            let driver = Box::new(stand.driver(60, "device = 'd0'"));
            let id = CameraId::new("d0").unwrap();
            let camera = supervise(id, driver, sender, Backoff::default()).unwrap();
            let next = || events.recv_timeout(Duration::from_secs(20)).unwrap().event;
            assert!(matches!(next(), CameraEvent::Ready(_)));
            stand.tell("d0 gone");
            match next() {
                CameraEvent::Away { fault, .. } => {
                    assert!(fault.to_string().contains("unplugged"), "{fault}")
                }
                other => panic!("{other:?}"),
            }
            let asked = camera.shoot(stand.shot(7, 1.0));
            let answer =
                std::iter::repeat_with(next).find(|e| matches!(e, CameraEvent::Answered { .. }));
            assert!(
                asked
                    && matches!(
                        answer,
                        Some(CameraEvent::Answered {
                            outcome: Err(_),
                            ..
                        })
                    )
            );
            stand.tell("");
            while !matches!(next(), CameraEvent::Ready(_)) {}
            assert!(camera.shoot(stand.shot(8, 5.0)));
            let mut frames = 0;
            let outcome = loop {
                match next() {
                    CameraEvent::Frame { shot: 8, .. } => frames += 1,
                    CameraEvent::Answered { shot: 8, outcome } => break outcome,
                    other => panic!("{other:?}"),
                }
            };
            missed(&outcome.unwrap(), "depth");
            assert_eq!(frames, 60);
            assert!(camera.end().wait(Instant::now() + Duration::from_secs(20)));
        },
    );
}

#[test]
fn what_was_heard_of_a_camera_stays_when_another_asks_for_it() {
    staged(
        "what_was_heard_of_a_camera_stays_when_another_asks_for_it",
        1,
        60,
        |stand| {
            let mut device = stand.open(60, "device = 'd0'").unwrap();
            stand.tell("d0 gone");
            let mut is_unplugged = || {
                let idle = device.idle();
                idle.is_err_and(|fault| fault.to_string().contains("unplugged"))
            };
            assert!((0..20).any(|_| is_unplugged()));
            let taken = stand
                .open(60, "device = 'scand-sensor://d0'")
                .err()
                .unwrap();
            assert!(taken.to_string().contains("another camera"), "{taken}");
            assert!(is_unplugged());
        },
    );
}

#[test]
fn sensors_are_told_apart_and_take_turns() {
    staged("sensors_are_told_apart_and_take_turns", 2, 60, |stand| {
        let mut second = stand
            .open(60, "device = 'd1'\ntake_turns = true\nburst = 12")
            .unwrap();
        assert!(second.info().identity.contains("d1"));
        let mut first = stand.open(60, "take_turns = true\nburst = 12").unwrap();
        assert!(first.info().identity.contains("d0"), "the free one");
        for wanted in [
            "",
            "device = 'd0'",
            "device = 'scand-sensor://d1'",
            "device = 'x9'",
        ] {
            let fault = stand.open(60, wanted).err().unwrap().to_string();
            assert!(!fault.is_empty());
            if wanted.contains("x9") {
                assert!(
                    fault.contains("x9") && fault.contains("scand-sensor://d0"),
                    "{fault}"
                );
            }
        }
        for _ in 0..3 {
            for device in [&mut first, &mut second] {
                let (frames, outcome, trigger) = stand.shoot(device.as_mut());
                missed(&outcome.unwrap(), "depth");
                assert_eq!(frames.len(), 24);
                assert!(frames.iter().all(|f| f.timestamp >= trigger));
                device.idle().unwrap();
            }
        }
    });
}

#[test]
fn an_oni_file_is_a_device_that_gives_every_frame_once() {
    staged(
        "an_oni_file_is_a_device_that_gives_every_frame_once",
        1,
        60,
        |stand| {
            let path = stand.folder.join("recorded.oni");
            let live = stand.driver(60, "burst = 40").open_camera();
            let mut live = live.unwrap();
            let recorder = live.record(&path).unwrap();
            let (frames, outcome, _) = stand.shoot(&mut live);
            missed(&outcome.unwrap(), "depth");
            assert_eq!(frames.len(), 80);
            drop((recorder, live));
            let wanted = format!("device = '{}'\nrepeat = false\nburst = 10", path.display());
            let mut file = stand.open(60, &wanted).unwrap();
            let mut played = Vec::new();
            let end = loop {
                if let Err(end) = file.idle() {
                    break end.to_string();
                }
                let shot = stand.shot(1, 3.0);
                match file.shoot(&shot, &mut |frame| played.push(frame)) {
                    Ok(stats) => assert_eq!(stats.lost, Vec::<String>::new()),
                    Err(end) => break end.to_string(),
                }
            };
            assert!(end.contains("end") || end.contains("no frame"), "{end}");
            let depth = of(&played, Stream::Depth);
            assert!(depth.len() >= 40, "{} frames", depth.len());
            served(&depth, 0, depth_bytes);
            served(&of(&played, Stream::DepthColor), 0, color_bytes);
            for pair in depth.windows(2) {
                assert!(pair[0].timestamp < pair[1].timestamp);
            }
            let missing = stand.open(60, "device = '/nowhere/cup.oni'").err().unwrap();
            assert!(
                missing.to_string().contains("/nowhere/cup.oni"),
                "{missing}"
            );
        },
    );
}

fn cup() -> Recording {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("recordings/cup.mcap");
    Recording::open(&path).unwrap()
}

#[test]
fn a_recordings_depth_is_played_to_the_driver() {
    let files = |folder: &Path| {
        let path = folder.join("kinect.frames");
        let camera = CameraId::new("kinect").unwrap();
        let sensor = write_sensor_frames(&cup(), &camera, 30, &path).unwrap();
        assert_eq!((sensor.serial.as_str(), sensor.rate), ("kinect", 30));
        let missing = CameraId::new("d9").unwrap();
        let unfit = write_sensor_frames(&cup(), &missing, 30, &folder.join("x")).unwrap_err();
        assert!(unfit.to_string().contains("d9"), "{unfit}");
        vec![path.to_str().unwrap().to_owned()]
    };
    staged_with(
        "a_recordings_depth_is_played_to_the_driver",
        &files,
        |stand| {
            let recording = cup();
            let topic = Topic::Depth(CameraId::new("kinect").unwrap(), DepthPart::Image);
            let messages = recording.messages(&topic).iter();
            let recorded: Vec<Picture> = messages
                .map(|m| recording.picture(&topic, m).unwrap())
                .collect();
            let Picture::Raw { width, height, .. } = recorded[0] else {
                panic!("{:?}", recorded[0]);
            };
            let parameters = Parameters {
                device: Some("kinect".into()),
                size: Some([width, height]),
                ..Parameters::default()
            };
            let id = CameraId::new("kinect").unwrap();
            let mut driver = OpenNi2::new(id, parameters, Pool::new(200 << 20), stand.clock);
            let mut device = driver.open().unwrap();
            let (frames, outcome, _) = stand.shoot(device.as_mut());
            missed(&outcome.unwrap(), "depth");
            let depth = of(&frames, Stream::Depth);
            for (i, frame) in depth.iter().enumerate() {
                let same = recorded.contains(&frame.picture);
                assert!(same, "frame {i} is not the recording's");
            }
            assert_eq!((recorded.len(), depth.len()), (30, 30));
        },
    );
}

#[test]
fn starting_moves_no_other_threads_directory() {
    staged(
        "starting_moves_no_other_threads_directory",
        1,
        240,
        |stand| {
            let here = std::env::current_dir().unwrap();
            let done = AtomicBool::new(false);
            std::thread::scope(|scope| {
                let watcher = scope.spawn(|| {
                    let mut looks = 0;
                    while !done.load(Ordering::Relaxed) {
                        assert_eq!(std::env::current_dir().unwrap(), here);
                        looks += 1;
                    }
                    looks
                });
                let opener = scope.spawn(|| {
                    for _ in 0..20 {
                        drop(stand.open(240, "").unwrap());
                    }
                });
                opener.join().unwrap();
                done.store(true, Ordering::Relaxed);
                assert!(watcher.join().unwrap() > 1000);
            });
        },
    );
}

#[test]
fn two_hundred_reopenings_leave_nothing_behind() {
    staged(
        "two_hundred_reopenings_leave_nothing_behind",
        1,
        240,
        |stand| {
            let mut at_first = None;
            for count in 0..200 {
                let mut device = stand.open(240, "burst = 2").unwrap();
                let (frames, outcome, _) = stand.shoot(device.as_mut());
                missed(&outcome.unwrap(), "depth");
                assert_eq!(frames.len(), 4);
                drop(device);
                if count == 40 {
                    at_first = Some(held());
                }
            }
            let (first, last) = (at_first.unwrap(), held());
            println!("memory in KiB, descriptors, threads: {first:?} after 40, {last:?} after 200");
            assert_eq!((first.1, first.2), (last.1, last.2));
            assert!(
                last.0 < first.0 + 512,
                "memory grew from {} to {} KiB",
                first.0,
                last.0
            );
        },
    );
}

/// Resident memory in KiB, file descriptors, threads.
fn held() -> (u64, usize, usize) {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find(|l| l.starts_with("VmRSS:")).unwrap();
    let memory = line.split_whitespace().nth(1).unwrap().parse().unwrap();
    let count = |folder: &str| std::fs::read_dir(folder).unwrap().count();
    (memory, count("/proc/self/fd"), count("/proc/self/task"))
}
