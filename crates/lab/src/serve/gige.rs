//! One GigE Vision camera of the library's own simulator, on an address of this machine: its pictures, its clock and
//! its faults. The caller decides which camera shows which pictures.
#![allow(unsafe_code)] // The simulator asks for its pictures through a C callback.

use super::pictures::{Album, Pixels, Shown};
use aravis::glib::translate::{FromGlibPtrNone, ToGlibPtr};
use aravis::{Buffer, FakeCamera, GvFakeCamera};
use parking_lot::Mutex;
use std::ffi::c_void;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

/// Registers of the simulator (`arvfakecamera.h`) and of every GigE Vision camera (GigE Vision 2.0, chapter 28).
mod register {
    pub(super) const WIDTH: u32 = 0x100;
    pub(super) const HEIGHT: u32 = 0x104;
    pub(super) const BINNING_HORIZONTAL: u32 = 0x108;
    pub(super) const BINNING_VERTICAL: u32 = 0x10c;
    pub(super) const SENSOR_HEIGHT: u32 = 0x118;
    pub(super) const SENSOR_WIDTH: u32 = 0x11c;
    pub(super) const PIXEL_FORMAT: u32 = 0x128;
    pub(super) const TRIGGER_MODE: u32 = 0x300;
    pub(super) const TRIGGER_SOURCE: u32 = 0x304;
    pub(super) const TRIGGER_SOFTWARE: u32 = 0x30c;
    pub(super) const TIMESTAMP_CONTROL: u32 = 0x944;
    pub(super) const TIMESTAMP_HIGH: u32 = 0x948;
    pub(super) const TIMESTAMP_LOW: u32 = 0x94c;
}

/// A served camera's pictures and faults; it outlives the camera's restarts.
pub(super) struct Scene {
    /// Its pictures.
    pub album: Album,
    /// The first of them, which says size and format.
    pub first: Arc<Pixels>,
    shown: Mutex<Shown>,
    served: AtomicU64,
    next: AtomicUsize,
    delay_ns: AtomicU64,
    /// Bytes a second of its link; 0 of one that is as fast as the machine.
    link: AtomicU64,
    switch_ns: AtomicU64,
    /// Pixels a side that its last picture had joined.
    joined: AtomicU32,
    loss: Mutex<f64>,
    frozen: Mutex<Option<u64>>,
    broken: AtomicBool,
    /// By its clock, when it was last triggered and when it last gave a picture.
    triggered_ns: AtomicU64,
    filled_ns: AtomicU64,
}

impl Scene {
    /// Shows an album from its first capture on.
    pub(super) fn new(album: Album, first: Arc<Pixels>) -> Self {
        Self {
            album,
            first,
            shown: Mutex::new(Shown::CapturesFrom(0)),
            served: AtomicU64::new(0),
            next: AtomicUsize::new(0),
            delay_ns: AtomicU64::new(0),
            link: AtomicU64::new(0),
            switch_ns: AtomicU64::new(0),
            joined: AtomicU32::new(1),
            loss: Mutex::new(0.0),
            frozen: Mutex::new(None),
            broken: AtomicBool::new(false),
            triggered_ns: AtomicU64::new(0),
            filled_ns: AtomicU64::new(0),
        }
    }

    /// Shows something else from the next picture on.
    pub(super) fn show(&self, shown: Shown) {
        if let Shown::CapturesFrom(capture) = shown {
            self.next.store(capture, Ordering::Relaxed);
        }
        *self.shown.lock() = shown;
    }

    /// Pictures sent since the start.
    pub(super) fn served(&self) -> u64 {
        self.served.load(Ordering::Acquire)
    }

    /// Whether a picture could not be read.
    pub(super) fn broken(&self) -> bool {
        self.broken.load(Ordering::Relaxed)
    }

    /// How long each picture is held back after its exposure.
    pub(super) fn set_delay(&self, delay: Duration) {
        self.delay_ns
            .store(delay.as_nanos() as u64, Ordering::Relaxed);
    }

    /// How many bytes of a picture its link carries in a second; 0 for no limit.
    pub(super) fn set_link(&self, bytes_per_second: u64) {
        self.link.store(bytes_per_second, Ordering::Relaxed);
    }

    /// How much later the first picture comes that joins another number of pixels than the one before.
    pub(super) fn set_switch_time(&self, time: Duration) {
        self.switch_ns
            .store(time.as_nanos() as u64, Ordering::Relaxed);
    }

    /// How long a picture of so many bytes takes, with `joined` pixels a side joined.
    fn time_to_send(&self, bytes: usize, joined: u32) -> Duration {
        let mut ns = self.delay_ns.load(Ordering::Relaxed);
        let link = self.link.load(Ordering::Relaxed);
        ns += (bytes as u64 * 1_000_000_000)
            .checked_div(link)
            .unwrap_or(0);
        if self.joined.swap(joined, Ordering::Relaxed) != joined {
            ns += self.switch_ns.load(Ordering::Relaxed);
        }
        Duration::from_nanos(ns)
    }

    /// It was seen to be triggered. Only the first time since the last picture counts.
    fn trigger(&self, now_ns: u64) {
        if self.triggered_ns.load(Ordering::Relaxed) <= self.filled_ns.load(Ordering::Relaxed) {
            self.triggered_ns.store(now_ns, Ordering::Relaxed);
        }
    }

    /// When the picture that is filled now was exposed: when it was triggered, for the simulator comes to it later.
    fn exposed(&self, now_ns: u64) -> u64 {
        let triggered = self.triggered_ns.load(Ordering::Relaxed);
        let last = self.filled_ns.swap(now_ns, Ordering::Relaxed);
        if triggered > last { triggered } else { now_ns }
    }

    /// Which part of its packets is lost.
    pub(super) fn set_loss(&self, ratio: f64) {
        *self.loss.lock() = ratio;
    }

    fn picture(&self) -> Option<Arc<Pixels>> {
        let which = match *self.shown.lock() {
            Shown::Background => None,
            Shown::CapturesFrom(_) => {
                Some(self.next.fetch_add(1, Ordering::Relaxed) % self.album.len())
            }
        };
        let picture = self.album.picture(which).ok();
        self.broken.fetch_or(picture.is_none(), Ordering::Relaxed);
        picture
    }
}

/// The clock of a camera: runs from when it was switched on, and may stand still.
#[derive(Clone)]
struct Clock {
    begin: Instant,
    scene: Arc<Scene>,
}

/// The time of a camera's clock when it is switched on: far from the host's, so that the two cannot be confused.
const AT_BEGIN_NS: u64 = 3_600_000_000_000;

impl Clock {
    fn now_ns(&self) -> u64 {
        let frozen = *self.scene.frozen.lock();
        frozen.unwrap_or(AT_BEGIN_NS + self.begin.elapsed().as_nanos() as u64)
    }
}

/// A camera that is switched on.
pub(super) struct Player {
    // Goes first: its thread uses what follows.
    simulator: GvFakeCamera,
    registers: FakeCamera,
    clock: Clock,
    _context: Box<Context>,
}

/// What the callback is given.
struct Context {
    clock: Clock,
    registers: FakeCamera,
}

impl Context {
    /// Pixels a side that are joined: 1 unless both directions are set to the same number.
    fn joined(&self) -> u32 {
        let read = |register| self.registers.read_register(register).unwrap_or(1);
        let [across, down] = [register::BINNING_HORIZONTAL, register::BINNING_VERTICAL].map(read);
        if across == down { across.max(1) } else { 1 }
    }
}

impl Player {
    /// Switches a camera on; `None` if the simulator does not start.
    pub(super) fn start(
        address: &str,
        serial: &str,
        features: Option<&str>,
        polls_per_second: f64,
        scene: Arc<Scene>,
    ) -> Option<Self> {
        let simulator = GvFakeCamera::new_full(Some(address), Some(serial), features);
        let registers = simulator.fake_camera().filter(|_| simulator.is_running())?;
        let clock = Clock {
            begin: Instant::now(),
            scene,
        };
        // Its clock begins anew.
        clock.scene.triggered_ns.store(0, Ordering::Relaxed);
        clock.scene.filled_ns.store(0, Ordering::Relaxed);
        let context = Box::new(Context {
            clock: clock.clone(),
            registers: registers.clone(),
        });
        // SAFETY: the callback's signature is the library's; the context lives as long as the simulator, whose thread
        // is joined when it is dropped, before the context is.
        unsafe {
            aravis_sys::arv_fake_camera_set_fill_pattern(
                registers.to_glib_none().0,
                Some(fill),
                (&raw const *context).cast_mut().cast(),
            );
        }
        let first = clock.scene.first.clone();
        for (register, value) in [
            (register::SENSOR_WIDTH, first.width),
            (register::SENSOR_HEIGHT, first.height),
            (register::WIDTH, first.width),
            (register::HEIGHT, first.height),
            (register::PIXEL_FORMAT, first.code),
            (register::BINNING_HORIZONTAL, 1),
            (register::BINNING_VERTICAL, 1),
        ] {
            registers.write_register(register, value);
        }
        registers.set_trigger_frequency(polls_per_second);
        Some(Self {
            simulator,
            registers,
            clock,
            _context: context,
        })
    }

    /// Loses as many of its packets as its scene says.
    pub(super) fn follow_loss(&self) {
        let ratio = *self.clock.scene.loss.lock();
        self.simulator.set_gvsp_lost_ratio(ratio);
    }

    /// Stops its clock, or lets it go on.
    pub(super) fn freeze_clock(&self, frozen: bool) {
        let now = frozen.then(|| self.clock.now_ns());
        *self.clock.scene.frozen.lock() = now;
    }

    /// What its clock shows, in nanoseconds.
    pub(super) fn clock_ns(&self) -> u64 {
        self.clock.now_ns()
    }

    /// Does what a camera's hardware does at once: latches the clock where that was asked for, and notes a trigger.
    pub(super) fn look(&self) {
        let now = self.clock.now_ns();
        let read = |register| self.registers.read_register(register).unwrap_or(0);
        let write = |register, value| self.registers.write_register(register, value);
        if read(register::TRIGGER_SOFTWARE) == 1 {
            self.clock.scene.trigger(now);
        }
        if read(register::TIMESTAMP_CONTROL) & LATCH != 0 {
            // Not before it was asked for.
            let now = self.clock.now_ns();
            write(register::TIMESTAMP_HIGH, (now >> 32) as u32);
            write(register::TIMESTAMP_LOW, now as u32);
            write(register::TIMESTAMP_CONTROL, 0);
        }
    }

    /// Its line, which can be pulsed while the camera goes on.
    pub(super) fn line(&self) -> Line {
        Line {
            registers: self.registers.clone(),
            scene: self.clock.scene.clone(),
        }
    }

    /// A register's value.
    pub(super) fn read_register(&self, address: u32) -> Option<u32> {
        self.registers.read_register(address)
    }

    /// Writes a register, as if the camera did.
    pub(super) fn write_register(&self, address: u32, value: u32) {
        self.registers.write_register(address, value);
    }
}

/// The bit that asks for the clock.
const LATCH: u32 = 2;
/// The trigger source that is software.
const SOFTWARE: u32 = 1;

/// The line of a camera.
pub(super) struct Line {
    registers: FakeCamera,
    scene: Arc<Scene>,
}

impl Line {
    /// Gives a pulse; whether it took a picture. The simulator has no lines, so the pulse is a software trigger that
    /// the client knows nothing of.
    pub(super) fn pulse(&self) -> bool {
        let read = |register| self.registers.read_register(register).unwrap_or(0);
        let source = read(register::TRIGGER_SOURCE);
        if read(register::TRIGGER_MODE) != 1 || source == SOFTWARE {
            return false;
        }
        let before = self.scene.served();
        self.registers.write_register(register::TRIGGER_SOFTWARE, 1);
        self.registers
            .write_register(register::TRIGGER_SOURCE, SOFTWARE);
        let until = Instant::now() + Duration::from_secs(1);
        while self.scene.served() == before && Instant::now() < until {
            std::thread::sleep(Duration::from_micros(200));
        }
        self.registers
            .write_register(register::TRIGGER_SOURCE, source);
        self.scene.served() > before
    }
}

/// Fills a picture, on the simulator's thread.
unsafe extern "C" fn fill(
    buffer: *mut aravis_sys::ArvBuffer,
    context: *mut c_void,
    _exposure: u32,
    _gain: u32,
    format: u32,
) {
    let _ = catch_unwind(AssertUnwindSafe(|| {
        // SAFETY: the context that was registered with this callback; see `Player::start`.
        let context = unsafe { &*context.cast::<Context>() };
        // SAFETY: the library lends its buffer for the time of this call.
        let buffer = unsafe { Buffer::from_glib_none(buffer) };
        let now = context.clock.now_ns();
        buffer.set_timestamp(context.clock.scene.exposed(now));
        let (width, height) = (buffer.image_width(), buffer.image_height());
        let bits = (format >> 16 & 0xff) as usize;
        let length = width.max(0) as usize * height.max(0) as usize * bits / 8;
        // SAFETY: before it calls, the library checks that the buffer has room for width x height pixels of the format
        // in its registers (arv_fake_camera_fill_buffer), which are what is read here, on the same thread.
        let pixels = unsafe { std::slice::from_raw_parts_mut(buffer.data().0, length) };
        let scene = &context.clock.scene;
        let offset = (buffer.image_x(), buffer.image_y());
        let by = context.joined();
        match scene.picture().filter(|picture| picture.code == format) {
            Some(picture) if by > 1 => crop(&joined(&picture, by), offset, width, pixels),
            Some(picture) => crop(&picture, offset, width, pixels),
            None => pixels.fill(0),
        }
        std::thread::sleep(scene.time_to_send(length, by));
        scene.served.fetch_add(1, Ordering::Release);
    }));
}

/// Numbers of the formats with a Bayer pattern (GenICam Pixel Format Naming Convention).
const BAYER: std::ops::RangeInclusive<u32> = 0x0108_0008..=0x0108_000b;

/// A picture whose pixels are the means of squares of `by` pixels a side; with a Bayer pattern, each of one colour.
fn joined(picture: &Pixels, by: u32) -> Pixels {
    let bytes = picture.pixel_bytes();
    let by = by as usize;
    let period = if BAYER.contains(&picture.code) { 2 } else { 1 };
    let (width, height) = (picture.width as usize / by, picture.height as usize / by);
    let from = |at: usize, i: usize| at / period * period * by + at % period + period * i;
    let last = (picture.width as usize - 1, picture.height as usize - 1);
    let mut data = Vec::with_capacity(width * height * bytes);
    for y in 0..height {
        for x in 0..width {
            for channel in 0..bytes {
                let value = |i: usize| {
                    let column = from(x, i % by).min(last.0);
                    let row = from(y, i / by).min(last.1);
                    let at = (row * picture.width as usize + column) * bytes + channel;
                    u32::from(picture.data[at])
                };
                let count = (by * by) as u32;
                let sum: u32 = (0..by * by).map(value).sum();
                data.push(((sum + count / 2) / count) as u8);
            }
        }
    }
    Pixels {
        width: width as u32,
        height: height as u32,
        code: picture.code,
        data: data.into(),
    }
}

/// Copies the part of a picture that a client asked for; beyond its edges it is black.
fn crop(picture: &Pixels, offset: (i32, i32), width: i32, out: &mut [u8]) {
    let bytes = picture.pixel_bytes();
    let row = picture.width as usize * bytes;
    let begin = (offset.0.max(0) as usize * bytes).min(row);
    let rows = picture
        .data
        .chunks_exact(row)
        .skip(offset.1.max(0) as usize);
    let mut rows = rows.map(|row| &row[begin..]);
    for out in out.chunks_exact_mut((width.max(1) as usize) * bytes) {
        let from = rows.next().unwrap_or_default();
        let shown = from.len().min(out.len());
        out[..shown].copy_from_slice(&from[..shown]);
        out[shown..].fill(0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixels_of_one_colour_are_joined() {
        let picture = |code, data: Vec<u8>| Pixels {
            width: 4,
            height: 4,
            code,
            data: data.into(),
        };
        // Each colour of the pattern has a value of its own.
        let row = |a: u8, b: u8| [a, b, a, b];
        let bayer = [row(1, 2), row(3, 4), row(1, 2), row(3, 4)].concat();
        let small = joined(&picture(0x0108_0008, bayer), 2);
        assert_eq!((small.width, small.height), (2, 2));
        assert_eq!(small.data[..], [1, 2, 3, 4]);
        let grey = (0..16).collect();
        assert_eq!(
            joined(&picture(0x0108_0001, grey), 2).data[..],
            [3, 5, 11, 13]
        );
    }

    #[test]
    fn a_region_is_cut_out_and_black_beyond_the_picture() {
        let picture = Pixels {
            width: 3,
            height: 2,
            code: 0x0108_0001,
            data: vec![1, 2, 3, 4, 5, 6].into(),
        };
        let mut out = [9; 4];
        crop(&picture, (1, 1), 2, &mut out);
        assert_eq!(out, [5, 6, 0, 0]);
        crop(&picture, (2, 0), 2, &mut out);
        assert_eq!(out, [3, 0, 6, 0]);
        crop(&picture, (7, 7), 2, &mut out);
        assert_eq!(out, [0; 4]);
    }
}
