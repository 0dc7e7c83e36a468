//! A small recording, the cameras that serve it, and one camera opened by the driver.

use scand::clock::Clock;
use scand::drivers::aravis::{ActionGroup, GigeDriver, Parameters};
use scand::drivers::live::{Device, Driver, Fault, Pool, Shot, ShotStats};
use scand::frame::{CameraId, CaptureId, Frame, Picture, Stream, Timestamp, Trigger};
use scand::recording::{Compression, Recording, Writer};
use scand_lab::serve::{ColorOptions, ColorRig};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Of each camera the encoding and the bytes of a pixel.
pub const CAMERAS: [(&str, &str, u32); 3] = [
    ("c00", "bayer_grbg8", 1),
    ("c01", "rgb8", 3),
    ("c02", "mono8", 1),
];
pub const CAPTURES: usize = 4;

/// Pixels that no other camera and capture has.
pub fn pixels(camera: usize, capture: usize, size: [u32; 2], bytes: u32) -> Vec<u8> {
    let mut state = (camera * 1000 + capture + 1) as u32;
    let length = size[0] * size[1] * bytes;
    let next = |_| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 24) as u8
    };
    (0..length).map(next).collect()
}

pub fn id(name: &str) -> CameraId {
    CameraId::new(name).unwrap()
}

/// A recording of all cameras and captures, and a background of each camera (capture 99).
pub fn recording(size: [u32; 2]) -> (tempfile::TempDir, Arc<Recording>) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("served.mcap");
    let mut writer = Writer::create(&path, "test", Compression::None).unwrap();
    let picture = |camera: usize, capture| {
        let (_, encoding, bytes) = CAMERAS[camera];
        Picture::Raw {
            width: size[0],
            height: size[1],
            encoding: encoding.into(),
            step: size[0] * bytes,
            data: pixels(camera, capture, size, bytes).into(),
        }
    };
    let second = |s: usize| Timestamp(1_760_000_000_000_000_000 + s as u64 * 1_000_000_000);
    for (camera, (name, ..)) in CAMERAS.iter().enumerate() {
        writer
            .background(&id(name), &picture(camera, 99), second(0))
            .unwrap();
    }
    for capture in 0..CAPTURES {
        let time = second(capture + 1);
        let name = CaptureId::new(&format!("k{capture}")).unwrap();
        let source = "pedal".into();
        let trigger = Trigger {
            id: name,
            time,
            source,
            press_id: None,
            subject: None,
            placement: None,
        };
        writer.trigger(&trigger).unwrap();
        for (camera, (name, ..)) in CAMERAS.iter().enumerate() {
            let frame = Frame {
                camera: id(name),
                stream: Stream::Color,
                timestamp: Timestamp(time.0 + 1_000_000),
                picture: picture(camera, capture),
            };
            writer.frame(&frame).unwrap();
        }
    }
    writer.finish().unwrap();
    let recording = Recording::open(&path).unwrap();
    (folder, Arc::new(recording))
}

/// Cameras that are served.
pub struct Stand {
    pub rig: ColorRig,
    pub clock: Clock,
    pub pool: Pool,
    pub actions: ActionGroup,
    pub size: [u32; 2],
    _folder: tempfile::TempDir,
}

impl Stand {
    pub fn new(size: [u32; 2]) -> Self {
        Self::with(size, ColorOptions::default())
    }

    pub fn with(size: [u32; 2], options: ColorOptions) -> Self {
        let (folder, recording) = recording(size);
        Self {
            rig: ColorRig::start(recording, options).unwrap(),
            clock: Clock::system(),
            pool: Pool::new(64 << 20),
            actions: ActionGroup::default(),
            size,
            _folder: folder,
        }
    }

    /// Parameters of a camera, by its address.
    pub fn parameters(&self, name: &str) -> Parameters {
        let camera = self
            .rig
            .cameras()
            .find(|(camera, ..)| camera.as_str() == name);
        Parameters {
            address: Some(camera.unwrap().1),
            packet_size: Some(8000),
            ..Parameters::default()
        }
    }

    pub fn driver(&self, name: &str, parameters: Parameters) -> GigeDriver {
        GigeDriver::new(
            id(name),
            parameters,
            self.pool.clone(),
            self.clock,
            self.actions.clone(),
        )
    }

    pub fn open(&self, name: &str, parameters: Parameters) -> Result<Box<dyn Device>, Fault> {
        self.driver(name, parameters).open()
    }

    pub fn shot(&self, number: u64, patience: Duration) -> Shot {
        Shot {
            number,
            trigger: self.clock.timestamp(),
            deadline: Instant::now() + patience,
            clock: self.clock,
            abandoned: Arc::default(),
        }
    }

    /// Takes a shot with a patience of 2 s.
    pub fn shoot(
        &self,
        device: &mut dyn Device,
        number: u64,
    ) -> (Shot, Vec<Frame>, Result<ShotStats, Fault>) {
        self.shoot_within(device, number, Duration::from_secs(2))
    }

    pub fn shoot_within(
        &self,
        device: &mut dyn Device,
        number: u64,
        patience: Duration,
    ) -> (Shot, Vec<Frame>, Result<ShotStats, Fault>) {
        let shot = self.shot(number, patience);
        let mut frames = Vec::new();
        let outcome = device.shoot(&shot, &mut |frame| frames.push(frame));
        (shot, frames, outcome)
    }

    /// Whether a frame is the picture of a camera in a capture, byte for byte.
    pub fn is_picture(&self, frame: &Frame, camera: usize, capture: usize) -> bool {
        let (_, encoding, bytes) = CAMERAS[camera];
        let expected = pixels(camera, capture, self.size, bytes);
        let is_it = matches!(&frame.picture, Picture::Raw { encoding: e, data, width, height, step }
            if e == encoding && data[..] == expected[..] && [*width, *height] == self.size
                && *step == width * bytes);
        is_it && frame.camera == id(CAMERAS[camera].0) && frame.stream == Stream::Color
    }
}

/// By how many milliseconds a frame is stamped later than its shot was asked for.
pub fn milliseconds_after(shot: &Shot, frame: &Frame) -> f64 {
    frame.timestamp.nanoseconds_since(shot.trigger) as f64 / 1e6
}
