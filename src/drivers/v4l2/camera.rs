//! An open V4L2 camera: its stream, its shots, and polling between them.

use super::device::{self, FilledBuffer, Queue};
use super::frame::{self, ExpectedFrame, WholeFrame};
use super::parameters::{Parameters, TriggerMode};
use super::{jpeg, settings};
use crate::clock::Clock;
use crate::drivers::live::{
    CameraInfo, Device, Driver, Fault, LINE_LEAD, NO_SIGNAL, Pool, Shot, ShotStats,
};
use crate::frame::{CameraId, Frame, Picture, Stream, Timestamp};
use crate::words::count;
use std::collections::VecDeque;
use std::io;
use std::path::Path;
use std::time::{Duration, Instant};

/// Opens one camera.
#[derive(Debug, Clone)]
pub struct V4l2Driver {
    id: CameraId,
    parameters: Parameters,
    pool: Pool,
    clock: Clock,
}

impl V4l2Driver {
    /// A driver with these settings; frames use memory of `pool` and are stamped by `clock`.
    pub fn new(id: CameraId, parameters: Parameters, pool: Pool, clock: Clock) -> Self {
        Self {
            id,
            parameters,
            pool,
            clock,
        }
    }
}

impl Driver for V4l2Driver {
    fn open(&mut self) -> Result<Box<dyn Device>, Fault> {
        let path = Path::new(self.parameters.device());
        let away = |why: io::Error| Fault::Away(format!("{}: {why}", path.display()));
        let device = device::open(path).map_err(away)?;
        let (info, expected) = settings::apply(&self.parameters, &device)?;
        let buffers = self.parameters.buffers.unwrap_or(6);
        let queue = Queue::start(device.handle(), buffers).map_err(away)?;
        Ok(Box::new(Camera {
            driver: self.clone(),
            info,
            expected,
            queue,
            kept: VecDeque::new(),
            newest: None,
            heard: Instant::now(),
            damage: None,
        }))
    }
}

/// An open camera.
struct Camera {
    driver: V4l2Driver,
    info: CameraInfo,
    expected: ExpectedFrame,
    queue: Queue,
    /// The newest whole frames, at most two, in the kernel's memory: one of them may be the last before a trigger.
    kept: VecDeque<KeptFrame>,
    /// Number and time of the newest frame.
    newest: Option<(u32, Duration)>,
    /// When a whole frame last came, and what was wrong with the ones since.
    heard: Instant,
    damage: Option<String>,
}

#[derive(Debug)]
struct KeptFrame {
    time: Timestamp,
    whole: WholeFrame,
    filled: FilledBuffer,
}

/// Frames that are kept from the kernel.
const KEPT: usize = 2;

impl Device for Camera {
    fn info(&self) -> &CameraInfo {
        &self.info
    }

    fn shoot(&mut self, shot: &Shot, take: &mut dyn FnMut(Frame)) -> Result<ShotStats, Fault> {
        // What was damaged before is of no shot.
        self.drain(&mut ShotStats::default())?;
        let mut stats = ShotStats::default();
        let earliest = self.earliest(shot);
        while self.kept.back().is_none_or(|k| k.time < earliest) {
            let left = shot.remaining();
            if left.is_zero() {
                break;
            }
            self.not_silent()?;
            if self.wait(left)? {
                self.receive(&mut stats)?;
            }
        }
        self.hand_over(shot, &mut stats, take)?;
        Ok(stats)
    }

    fn look(&mut self, shot: &Shot, take: &mut dyn FnMut(Frame)) -> Result<ShotStats, Fault> {
        if self.driver.parameters.trigger() == TriggerMode::FreeRun {
            return self.shoot(shot, take);
        }
        self.drain(&mut ShotStats::default())?;
        let mut stats = ShotStats::default();
        // What the newest signal exposed; it stays where the next shot finds it.
        match self.kept.back() {
            Some(newest) => self.hand_copy(newest, &mut stats, take),
            None => stats.lost.push(NO_SIGNAL.into()),
        }
        Ok(stats)
    }

    fn idle(&mut self) -> Result<(), Fault> {
        self.drain(&mut ShotStats::default())?;
        self.not_silent()
    }

    fn idle_period(&self) -> Duration {
        // Before the kernel runs out of buffers: it would keep old frames and drop new ones.
        Duration::from_millis(50)
    }
}

impl Camera {
    fn away(&self, why: impl std::fmt::Display) -> Fault {
        Fault::Away(format!("{}: {why}", self.driver.parameters.device()))
    }

    fn broken(&self, why: &io::Error) -> Fault {
        // ENODEV: there is no kind for it.
        match why.raw_os_error() {
            Some(19) => self.away("it was unplugged"),
            _ => self.away(why),
        }
    }

    fn wait(&self, left: Duration) -> Result<bool, Fault> {
        let short = Duration::from_millis(50);
        self.queue
            .wait(left.min(short))
            .map_err(|why| self.broken(&why))
    }

    /// A free-running camera gives frames.
    fn not_silent(&self) -> Result<(), Fault> {
        let limit = self.driver.parameters.silence();
        let runs = self.driver.parameters.trigger() == TriggerMode::FreeRun;
        if runs && self.heard.elapsed() > limit {
            let damage = self
                .damage
                .iter()
                .map(|why| format!(", but damaged ones: {why}"));
            let damage: String = damage.collect();
            let seconds = limit.as_secs_f64();
            return Err(self.away(format!(
                "no complete frame arrived for {seconds:.1} s{damage}"
            )));
        }
        Ok(())
    }

    /// Takes all frames that have arrived.
    fn drain(&mut self, stats: &mut ShotStats) -> Result<(), Fault> {
        // As often as there are buffers at the most: a fast camera fills them again meanwhile.
        for _ in 0..32 {
            if !self.receive(stats)? {
                break;
            }
        }
        Ok(())
    }

    /// Takes a frame, if one has come, and keeps it if it is whole.
    fn receive(&mut self, stats: &mut ShotStats) -> Result<bool, Fault> {
        let arrival = self.driver.clock.timestamp();
        let taken = self.queue.take().map_err(|why| self.broken(&why))?;
        let Some(filled) = taken else {
            return Ok(false);
        };
        let judged = self.follow(&filled, stats).and_then(|()| {
            let bytes = self.queue.bytes(&filled);
            frame::whole(&self.expected, filled.flags, bytes)
        });
        match judged {
            Ok(whole) => {
                self.heard = Instant::now();
                self.damage = None;
                let time = self.exposed(&filled, arrival);
                self.kept.push_back(KeptFrame {
                    time,
                    whole,
                    filled,
                });
                if self.kept.len() > KEPT
                    && let Some(old) = self.kept.pop_front()
                {
                    self.give_back(old.filled)?;
                }
            }
            Err(why) => {
                let lost = format!("frame {}: {why}", filled.sequence);
                self.damage = Some(lost.clone());
                stats.lost.push(lost);
                self.give_back(filled)?;
            }
        }
        Ok(true)
    }

    /// Compares a frame's number and time with those of the one before.
    fn follow(&mut self, filled: &FilledBuffer, stats: &mut ShotStats) -> Result<(), String> {
        let before = self.newest.replace((filled.sequence, filled.time));
        let Some((sequence, time)) = before else {
            return Ok(());
        };
        let missed = filled.sequence.wrapping_sub(sequence).wrapping_sub(1);
        if (1..1000).contains(&missed) {
            let next = filled.sequence;
            stats.lost.push(format!(
                "{} before number {next} did not arrive",
                count(missed as usize, "frame")
            ));
        }
        if filled.time <= time && !filled.time.is_zero() {
            let at = filled.time.as_secs_f64();
            return Err(format!(
                "its timestamp of {at:.6} s is not after the previous frame's"
            ));
        }
        Ok(())
    }

    /// The start of a frame's exposure; by its arrival where its time is of another clock.
    fn exposed(&self, filled: &FilledBuffer, arrival: Timestamp) -> Timestamp {
        match frame::exposed(&self.expected, filled.flags, filled.time) {
            Some(time) => self.driver.clock.of_monotonic(time),
            None => {
                let age = frame::age(&self.expected).as_nanos() as u64;
                Timestamp(arrival.0.saturating_sub(age))
            }
        }
    }

    fn give_back(&mut self, filled: FilledBuffer) -> Result<(), Fault> {
        let given = self.queue.give_back(filled);
        given.map_err(|why| self.broken(&why))
    }

    /// When the exposure of a shot's frame may have begun: a signal may have been there before the daemon heard of it.
    fn earliest(&self, shot: &Shot) -> Timestamp {
        match self.driver.parameters.trigger() {
            TriggerMode::FreeRun => shot.trigger,
            TriggerMode::Line => {
                Timestamp(shot.trigger.0.saturating_sub(LINE_LEAD.as_nanos() as u64))
            }
        }
    }

    /// The last frame before the trigger and the first from then on: which counts, others decide.
    fn hand_over(
        &mut self,
        shot: &Shot,
        stats: &mut ShotStats,
        take: &mut dyn FnMut(Frame),
    ) -> Result<(), Fault> {
        let earliest = self.earliest(shot);
        let came = self.kept.back().is_some_and(|k| k.time >= earliest);
        if !came && stats.lost.is_empty() {
            stats.lost.push("no frame arrived in time".into());
        }
        let first = self.kept.iter().position(|k| k.time >= earliest);
        for (i, kept) in std::mem::take(&mut self.kept).into_iter().enumerate() {
            // Two frames may have come since the trigger: the second is of no use.
            if first.is_none_or(|first| i <= first) {
                self.hand_copy(&kept, stats, take);
            } else {
                stats.unused += 1;
            }
            self.give_back(kept.filled)?;
        }
        Ok(())
    }

    /// Hands a copy of a frame over.
    fn hand_copy(&self, kept: &KeptFrame, stats: &mut ShotStats, take: &mut dyn FnMut(Frame)) {
        match self.picture(kept) {
            Some(picture) => take(Frame {
                camera: self.driver.id.clone(),
                stream: Stream::Color,
                timestamp: kept.time,
                picture,
            }),
            None => stats
                .lost
                .push("no memory for a frame: raise capture.memory_mb".into()),
        }
    }

    /// The one copy of a frame: from the kernel's memory into the pool's.
    fn picture(&self, kept: &KeptFrame) -> Option<Picture> {
        let bytes = self.queue.bytes(&kept.filled);
        let parts = match &kept.whole {
            WholeFrame::Rows(length) => [&bytes[..*length], &[], &[]],
            WholeFrame::File(file) => jpeg::parts(bytes, file),
        };
        let mut buffer = self.driver.pool.take(parts.iter().map(|p| p.len()).sum())?;
        for part in parts {
            buffer.write(part);
        }
        let data = buffer.freeze();
        let encoding = self.expected.format.encoding().to_owned();
        let [width, height] = self.expected.size;
        Some(match kept.whole {
            WholeFrame::Rows(_) => Picture::Raw {
                width,
                height,
                encoding,
                step: self.expected.stride,
                data,
            },
            WholeFrame::File(_) => Picture::Compressed {
                format: encoding,
                data,
            },
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn open(device: &str) -> String {
        let text = format!("device = '{device}'\nsize = [640, 480]");
        let parameters: Parameters = toml::from_str(&text).unwrap();
        parameters.checked().unwrap();
        let id = CameraId::new("c00").unwrap();
        let mut driver = V4l2Driver::new(id, parameters, Pool::new(1 << 20), Clock::system());
        driver.open().err().unwrap().to_string()
    }

    #[test]
    fn what_is_no_camera_is_named_and_nothing_is_held() {
        let before = std::fs::read_dir("/proc/self/fd").unwrap().count();
        let missing = open("/dev/v4l/by-id/usb-none-video-index0");
        assert!(
            missing.contains("usb-none") && missing.contains("No such file"),
            "{missing}"
        );
        for _ in 0..50 {
            let other = open("/dev/null");
            assert!(
                other.contains("/dev/null") && other.contains("not a video device"),
                "{other}"
            );
        }
        let after = std::fs::read_dir("/proc/self/fd").unwrap().count();
        // Other tests of this process open and close files of their own.
        assert!(
            after < before + 40,
            "{before} descriptors before, {after} after"
        );
    }
}
