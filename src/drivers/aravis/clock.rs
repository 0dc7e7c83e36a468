//! Maps a GigE Vision camera's clock onto the host's timeline: by reading a latch if the camera has one, otherwise
//! by bounds from the arrival of its frames. No frame is taken here.

use crate::clock::Clock;
use crate::drivers::live::{DeviceClock, Reading};
use crate::frame::Timestamp;
use aravis::prelude::*;
use aravis::{Camera, GvDevice};
use std::time::{Duration, Instant};

/// How a camera's clock can be read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Latch {
    /// `TimestampLatch` (SFNC 2), in nanoseconds.
    Standard,
    /// `GevTimestampControlLatch` (SFNC 1), in ticks.
    Older,
    /// The registers that every GigE Vision camera with a clock has (GigE Vision 2.0, 27.1), in ticks.
    Registers,
}

/// Timestamp Control and what it latches.
const CONTROL: u64 = 0x0944;
const VALUE_HIGH: u64 = 0x0948;
const VALUE_LOW: u64 = 0x094c;
const LATCH_BIT: u32 = 2;
/// How long a camera may take to do it.
const LATCH_TIME: Duration = Duration::from_millis(20);
/// How often a latch is looked for: a busy host or camera misses one. The pauses between grow by this.
const ATTEMPTS: u32 = 4;
const ATTEMPT_PAUSE: Duration = Duration::from_millis(20);
/// Readings when a camera is opened, at most, and the uncertainty that ends them.
const READINGS: usize = 16;
const SHARP_NS: u64 = 500_000;
/// Time between two readings that can show that a clock stands still.
const APART: Duration = Duration::from_millis(7);
/// How old a reading may become.
const STALE: Duration = Duration::from_secs(2);
/// How far a frame's stamp may contradict what is known, beyond the uncertainty.
const SLACK_NS: i128 = 5_000_000;

/// A camera's clock.
pub(super) struct CameraClock {
    host: Clock,
    clock: DeviceClock,
    latch: Option<Latch>,
    /// Whether the bit that asks for a latch was seen to fall back.
    bit_falls: bool,
    ticks_per_second: u64,
    newest_ns: u64,
    read_at: Option<Instant>,
    /// What was wrong with it at the last reading.
    problem: Option<String>,
}

impl CameraClock {
    /// Finds out how the clock can be read, and reads it some times.
    pub(super) fn find(camera: &Camera, device: &GvDevice, host: Clock) -> Self {
        let mut clock = Self {
            host,
            clock: DeviceClock::default(),
            latch: None,
            bit_falls: false,
            ticks_per_second: device.timestamp_tick_frequency().unwrap_or(0),
            newest_ns: 0,
            read_at: None,
            problem: None,
        };
        let candidates = [Latch::Standard, Latch::Older, Latch::Registers];
        clock.latch = (0..ATTEMPTS).find_map(|attempt| {
            std::thread::sleep(ATTEMPT_PAUSE * attempt);
            let mut candidates = candidates.into_iter();
            candidates.find(|latch| clock.runs(*latch, camera, device))
        });
        // A busy host makes readings vague: the narrowest counts.
        for count in 0..READINGS {
            clock.read(camera, device);
            let known = clock.clock.host_time(clock.newest_ns);
            if count >= 3 && known.is_none_or(|(_, vague)| vague.is_some_and(|ns| ns < SHARP_NS)) {
                break;
            }
        }
        clock
    }

    /// Whether the clock can be latched: that is, shows two times, one after the other.
    fn runs(&mut self, latch: Latch, camera: &Camera, device: &GvDevice) -> bool {
        let mut value = || self.latched(latch, camera, device).map(|r| r.device_ns);
        let first = value();
        std::thread::sleep(Duration::from_millis(1));
        matches!((first, value()), (Some(a), Some(b)) if b > a)
    }

    /// Whether it can be read at all.
    pub(super) fn can_be_read(&self) -> bool {
        self.latch.is_some()
    }

    /// Reads the clock if the last reading is old, or was doubtful.
    pub(super) fn keep_known(&mut self, camera: &Camera, device: &GvDevice) {
        let fresh = self.read_at.is_some_and(|at| at.elapsed() < STALE);
        if !fresh || self.problem.is_some() {
            self.read_anew(camera, device);
        }
    }

    /// Reads the clock, and what is new about it.
    fn read_anew(&mut self, camera: &Camera, device: &GvDevice) {
        self.read(camera, device);
        if self.problem.is_some() {
            // A clock that jumped goes on from there; one that stands still shows it now.
            std::thread::sleep(APART);
            self.read(camera, device);
        }
    }

    fn read(&mut self, camera: &Camera, device: &GvDevice) {
        self.read_at = Some(Instant::now());
        let reading = self
            .latch
            .and_then(|latch| self.latched(latch, camera, device));
        self.problem = reading.and_then(|reading| self.add(reading).err());
    }

    fn add(&mut self, reading: Reading) -> Result<(), String> {
        self.newest_ns = reading.device_ns;
        self.clock.add(reading)
    }

    fn latched(&mut self, latch: Latch, camera: &Camera, device: &GvDevice) -> Option<Reading> {
        let host = self.host;
        let feature = |command: &str, value: &str| {
            let before = host.timestamp();
            camera.execute_command(command).ok()?;
            let after = host.timestamp();
            Some((before, after, camera.integer(value).ok()?.max(0) as u64))
        };
        let (before, after, value) = match latch {
            Latch::Standard => feature("TimestampLatch", "TimestampLatchValue")?,
            Latch::Older => feature("GevTimestampControlLatch", "GevTimestampValue")?,
            Latch::Registers => self.latch_registers(device)?,
        };
        let device_ns = match latch {
            Latch::Standard => value,
            Latch::Older | Latch::Registers => self.nanoseconds(value)?,
        };
        Some(Reading {
            device_ns,
            not_before: Some(before),
            not_after: after,
        })
    }

    /// A value that was latched between two of the host's times; `None` if it is that of an earlier latch, because the
    /// camera or the host was busy.
    fn latch_registers(&mut self, device: &GvDevice) -> Option<(Timestamp, Timestamp, u64)> {
        let read = |register| device.read_register(register).ok().map(|(_, value)| value);
        let value = || Some(u64::from(read(VALUE_HIGH)?) << 32 | u64::from(read(VALUE_LOW)?));
        let is_done = || Some(read(CONTROL)? & LATCH_BIT == 0);
        // What was asked for before and took too long would be taken for the answer.
        if !wait_until(is_done)? && self.bit_falls {
            return None;
        }
        let shown = value()?;
        let before = self.host.timestamp();
        device.write_register(CONTROL, LATCH_BIT).ok()?;
        let done = wait_until(is_done)?;
        let after = self.host.timestamp();
        self.bit_falls |= done;
        let latched = value()?;
        // There are cameras whose bit stays.
        let is_new = done || !self.bit_falls && latched != shown;
        let after = if done { after } else { self.host.timestamp() };
        is_new.then_some((before, after, latched))
    }

    fn nanoseconds(&self, ticks: u64) -> Option<u64> {
        let ns = u128::from(ticks) * 1_000_000_000;
        let ns = ns.checked_div(u128::from(self.ticks_per_second))?;
        u64::try_from(ns).ok()
    }

    /// The host's time of a frame's stamp. `not_before` is what is known otherwise, such as when it was triggered.
    /// Where the stamp contradicts what is known of the clock, that may be what is wrong: it is read anew.
    ///
    /// # Errors
    /// In words, if the stamp contradicts that too: the clock stands still, went back or jumped.
    pub(super) fn host_time(
        &mut self,
        stamp_ns: u64,
        not_before: Option<Timestamp>,
        (camera, device): (&Camera, &GvDevice),
    ) -> Result<Timestamp, String> {
        let not_after = self.host.timestamp();
        let judged = self.judge(stamp_ns, not_before, not_after);
        if judged.is_ok() || self.latch.is_none() || self.problem.is_some() {
            return judged;
        }
        // Twice, and apart: one that stands still fits any single reading.
        self.read(camera, device);
        std::thread::sleep(APART);
        self.read(camera, device);
        self.judge(stamp_ns, not_before, not_after)
    }

    fn judge(
        &mut self,
        stamp_ns: u64,
        not_before: Option<Timestamp>,
        not_after: Timestamp,
    ) -> Result<Timestamp, String> {
        if self.latch.is_none() {
            self.add(Reading {
                device_ns: stamp_ns,
                not_before,
                not_after,
            })?;
        }
        if let Some(problem) = &self.problem {
            return Err(problem.clone());
        }
        let (time, uncertainty) = self
            .clock
            .host_time(stamp_ns)
            .ok_or("its clock was never read")?;
        let slack = SLACK_NS + i128::from(uncertainty.unwrap_or(0));
        let late = time.nanoseconds_since(not_after);
        let early = not_before.map_or(0, |t| t.nanoseconds_since(time));
        let (ns, what) = if late > slack {
            (late, "after it arrived")
        } else if early > slack {
            (early, "before its trigger")
        } else {
            // What is known otherwise is known for certain.
            let earliest = not_before.unwrap_or(time);
            return Ok(time.max(earliest).min(not_after));
        };
        Err(format!(
            "a frame is stamped {:.1} ms {what}: its clock stands still or jumped",
            ns as f64 / 1e6
        ))
    }

    /// The camera's time at a moment of the host's, in nanoseconds; `None` before it was ever read.
    pub(super) fn device_time(&self, host: Timestamp) -> Option<u64> {
        let (known, _) = self.clock.host_time(self.newest_ns)?;
        let time = i128::from(self.newest_ns) + host.nanoseconds_since(known);
        u64::try_from(time).ok()
    }

    /// The host's time at a moment of the camera's, unchecked; `None` before it was ever read.
    pub(super) fn host_of(&self, device_ns: u64) -> Option<Timestamp> {
        self.clock.host_time(device_ns).map(|(time, _)| time)
    }
}

/// Whether a condition becomes true within the time that a latch may take; `None` if it cannot be read.
fn wait_until(mut is_so: impl FnMut() -> Option<bool>) -> Option<bool> {
    let until = Instant::now() + LATCH_TIME;
    loop {
        let so = is_so()?;
        if so || Instant::now() >= until {
            return Some(so);
        }
    }
}
