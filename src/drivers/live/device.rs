//! The interface of every live camera, whatever its SDK: it is opened, takes the frames of a shot, and is polled while
//! idle. No thread is started here.

use crate::clock::Clock;
use crate::frame::{CameraSettings, Frame, Timestamp};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Why a camera does not work, in words for an operator. The caller adds the camera's name.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Fault {
    /// It cannot be reached: unplugged, no answer, or controlled by another program.
    #[error("{0}")]
    Away(String),
    /// It refused a setting.
    #[error("{field}: asked for {asked}, found {found}")]
    Refused {
        /// The setting, by the camera's own name.
        field: String,
        /// The value in the configuration.
        asked: String,
        /// The camera's answer, or the value read back.
        found: String,
    },
}

/// One request for frames.
#[derive(Debug, Clone)]
pub struct Shot {
    /// The shot's number since the start, which frames and answers repeat.
    pub number: u64,
    /// The time of the trigger, on the host's timeline.
    pub trigger: Timestamp,
    /// Frames that arrive after this instant are not waited for.
    pub deadline: Instant,
    /// The clock of the deadline.
    pub clock: Clock,
    /// Set when the caller has stopped waiting.
    pub abandoned: Arc<AtomicBool>,
}

impl Shot {
    /// The time left to wait for frames; zero after the deadline, or when the caller has stopped waiting.
    pub fn remaining(&self) -> Duration {
        if self.abandoned.load(Ordering::Relaxed) {
            return Duration::ZERO;
        }
        self.clock.until(self.deadline)
    }
}

/// The result of a shot, apart from its frames.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct ShotStats {
    /// Frames that were damaged or did not arrive, each in words.
    pub lost: Vec<String>,
    /// Packets that were requested again.
    pub resent_packets: u64,
    /// Packets that never arrived.
    pub missing_packets: u64,
    /// Complete frames that did not belong to the shot.
    pub unused: u64,
    /// Advice although nothing was lost, such as a clock that is far off the network's.
    pub remarks: Vec<String>,
    /// Of a look: whether the camera joined 2x2 pixels for it. A shot's frames are always whole.
    pub is_binned: bool,
    /// Of a look: why the camera does not join pixels although it was to, in words.
    pub why_whole: Option<String>,
}

/// What a look at a camera gave.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct LookResult {
    /// The newest frame of each stream.
    pub frames: Vec<Frame>,
    /// What was lost, in words.
    pub lost: Vec<String>,
    /// Whether the camera joined 2x2 pixels for it.
    pub is_binned: bool,
    /// Why the camera does not join pixels although it was to, in words.
    pub why_whole: Option<String>,
}

/// An open camera: its identity and its settings as they were read back.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct CameraInfo {
    /// Vendor, model, serial number, firmware, address.
    pub identity: String,
    /// Width and height of its frames in pixels.
    pub size: [u32; 2],
    /// Pixel encoding, as a recording names it.
    pub encoding: String,
    /// Largest frame in bytes, as it crosses the link; a depth camera's colours, which come with it, are part of it.
    pub frame_bytes: u64,
    /// Its settings for the recording; `None` for depth cameras.
    pub settings: Option<CameraSettings>,
    /// Each setting: its name, the value asked for, and the value read back.
    pub table: Vec<[String; 3]>,
    /// Advice although it works, such as a clock that can only be estimated from arrivals.
    pub remarks: Vec<String>,
}

/// Opens one camera, as often as it is asked to.
pub trait Driver: Send {
    /// Opens the camera, sets it and reads everything back.
    ///
    /// # Errors
    /// If it cannot be reached or refused a setting. It is closed again then.
    fn open(&mut self) -> Result<Box<dyn Device>, Fault>;
}

/// An open camera. It lives and dies on the thread that opened it.
pub trait Device {
    /// Its identity and settings.
    fn info(&self) -> &CameraInfo;

    /// Takes the frames of a shot: what was exposed before is dropped, the camera is triggered where that is its way,
    /// and each whole frame is handed to `take` with its timestamp, the start of its exposure on the host's
    /// timeline. Ends when it has what the shot needs, or nothing more is waited for.
    ///
    /// # Errors
    /// If the camera is away. Lost frames are no error; they are counted in the result.
    fn shoot(&mut self, shot: &Shot, take: &mut dyn FnMut(Frame)) -> Result<ShotStats, Fault>;

    /// Takes a picture for a look: as [`Device::shoot`], but a depth camera gives one frame instead of a burst, and a
    /// camera that waits for a signal of its line gives a copy of what the newest one exposed, which the next shot
    /// still finds. A camera may join pixels if it is as it was when this ends. It is called between shots, and nothing
    /// that it takes is recorded.
    ///
    /// # Errors
    /// If the camera is away.
    fn look(&mut self, shot: &Shot, take: &mut dyn FnMut(Frame)) -> Result<ShotStats, Fault> {
        self.shoot(shot, take)
    }

    /// Called every [`Device::idle_period`] between shots: drains the frames of a free-running camera, keeps its clock
    /// mapped, and detects that it is away.
    ///
    /// # Errors
    /// If the camera is away.
    fn idle(&mut self) -> Result<(), Fault>;

    /// What it reports about itself, such as its temperature and its clock's offset: names and values for a person.
    /// Called every few seconds between shots.
    fn health(&mut self) -> Vec<[String; 2]> {
        Vec::new()
    }

    /// How often to call [`Device::idle`]; at most 5 s.
    fn idle_period(&self) -> Duration {
        Duration::from_secs(2)
    }
}
