//! What every live camera is to the rest of the program, whatever its SDK: something that is opened, takes the frames
//! of a shot, and is asked now and then whether it is still there. No thread is started here.

use crate::clock::Clock;
use crate::frame::{CameraSettings, Frame, Timestamp};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Why a camera does not do what it should. In words for an operator; the camera's name is added by who tells it.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Fault {
    /// It is not there, or went away: unplugged, no answer, its control taken by another program.
    #[error("{0}")]
    Away(String),
    /// It did not take a setting.
    #[error("{field}: asked for {asked}, the camera has {found}")]
    Refused {
        /// Which setting, as the camera names it.
        field: String,
        /// What the configuration wants.
        asked: String,
        /// What the camera answered or was read back.
        found: String,
    },
}

/// One request for frames.
#[derive(Debug, Clone)]
pub struct Shot {
    /// Counts shots since the start; frames and answers carry it back.
    pub number: u64,
    /// When it was asked for, on the host's timeline.
    pub trigger: Timestamp,
    /// Until when frames are waited for.
    pub deadline: Instant,
    /// What the deadline is read from.
    pub clock: Clock,
    /// Set when nobody waits any more.
    pub abandoned: Arc<AtomicBool>,
}

impl Shot {
    /// How long frames may still be waited for; zero when the time is over or nobody waits.
    pub fn remaining(&self) -> Duration {
        if self.abandoned.load(Ordering::Relaxed) {
            return Duration::ZERO;
        }
        self.clock.until(self.deadline)
    }
}

/// What a shot cost beside its frames.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Tally {
    /// Frames that came damaged or not at all, each in words.
    pub lost: Vec<String>,
    /// Packets that were asked for again.
    pub resent_packets: u64,
    /// Packets that never came.
    pub missing_packets: u64,
    /// Frames that came whole and were no part of the shot.
    pub unused: u64,
    /// What an operator should know although nothing was lost, such as how far a camera's clock is off the network's.
    pub remarks: Vec<String>,
}

/// A camera as it is open, everything read back from it.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Confirmed {
    /// Vendor, model, serial number, firmware, address.
    pub identity: String,
    /// Width and height of its frames in pixels.
    pub size: [u32; 2],
    /// Pixel encoding, as a recording names it.
    pub encoding: String,
    /// Largest frame in bytes, as it crosses the link.
    pub frame_bytes: u64,
    /// How it is set, for the recording; `None` for depth cameras.
    pub settings: Option<CameraSettings>,
    /// Each setting that was asked for: its name, what was asked and what was read back.
    pub table: Vec<[String; 3]>,
    /// What an operator should know although it works, such as a clock that can only be estimated from arrivals.
    pub remarks: Vec<String>,
}

/// Opens one camera, again and again if need be.
pub trait Driver: Send {
    /// Opens the camera, sets it and reads everything back.
    ///
    /// # Errors
    /// If it is not there or did not take a setting. Nothing is held then.
    fn open(&mut self) -> Result<Box<dyn Device>, Fault>;
}

/// An open camera. It lives and dies on the thread that opened it.
pub trait Device {
    /// How it was found and set.
    fn confirmed(&self) -> &Confirmed;

    /// Takes the frames of a shot: what was exposed before is dropped, the camera is triggered where that is its way,
    /// and each whole frame is handed to `take` with its timestamp, the start of its exposure on the host's
    /// timeline. Ends when it has what the shot needs, or nothing more is waited for.
    ///
    /// # Errors
    /// If the camera is away; what is merely lost is in the tally.
    fn shoot(&mut self, shot: &Shot, take: &mut dyn FnMut(Frame)) -> Result<Tally, Fault>;

    /// Called every [`Device::idle_period`] while there is no shot: keeps frames of a free-running camera moving,
    /// its clock known, and finds out whether it is still there.
    ///
    /// # Errors
    /// If it is not.
    fn idle(&mut self) -> Result<(), Fault>;

    /// What it tells of itself now, such as its temperature and how its clock stands: names and values for a person.
    /// Called every few seconds while there is no shot.
    fn health(&mut self) -> Vec<[String; 2]> {
        Vec::new()
    }

    /// How often [`Device::idle`] wants to be called; at most 5 s.
    fn idle_period(&self) -> Duration {
        Duration::from_secs(2)
    }
}
