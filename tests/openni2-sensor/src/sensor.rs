//! One sensor: what it is set to, and its thread, which hands a frame of each started stream to OpenNI at its time.

use crate::abi::{self, DeviceInfo, Frame, NewFrameCallback, StreamServices, VideoMode, field};
use crate::control::{Channel, Control};
use crate::frames::Frames;
use std::ffi::{c_int, c_void};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// A pointer of OpenNI's that it gave for use on any thread.
pub struct Shared<T>(pub *mut T);

impl<T> Clone for Shared<T> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<T> Copy for Shared<T> {}

// SAFETY: OpenNI's callbacks and services are made to be used on the driver's threads.
unsafe impl<T> Send for Shared<T> {}

/// Depth is the first stream, colour the second.
pub struct Sensor {
    pub frames: Frames,
    pub info: DeviceInfo,
    channel: Channel,
    state: Mutex<State>,
    stopped: AtomicBool,
}

#[derive(Default)]
pub struct State {
    pub streams: [Stream; 2],
    pub registered: bool,
    pub control: Control,
    /// Of the capture that is played.
    step: u64,
    number: c_int,
    clock_us: u64,
    unplugged: bool,
}

#[derive(Default)]
pub struct Stream {
    /// The stream's own address, by which OpenNI knows it.
    pub address: Option<Shared<c_void>>,
    pub services: Option<Shared<StreamServices>>,
    pub new_frame: Option<(NewFrameCallback, Shared<c_void>)>,
    pub property_changed: Option<(abi::PropertyCallback, Shared<c_void>)>,
    pub started: bool,
    pub mirrored: bool,
}

/// What OpenNI wants to hear of.
#[derive(Clone, Copy)]
pub struct Listener {
    pub connected: abi::DeviceCallback,
    pub disconnected: abi::DeviceCallback,
    pub state_changed: abi::DeviceStateCallback,
    pub cookie: Shared<c_void>,
}

impl Sensor {
    pub fn new(frames: Frames, control: Option<PathBuf>) -> Self {
        let channel = Channel::new(control, &frames.serial);
        let info = DeviceInfo {
            uri: field(&format!("scand-sensor://{}", frames.serial)),
            vendor: field("scand"),
            name: field("test sensor"),
            usb_vendor_id: 0,
            usb_product_id: 0,
        };
        Self {
            frames,
            info,
            channel,
            state: Mutex::default(),
            stopped: AtomicBool::new(false),
        }
    }

    pub fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub fn stop(&self) {
        self.stopped.store(true, Ordering::Relaxed);
    }

    pub fn mode(&self, which: usize) -> VideoMode {
        VideoMode {
            pixel_format: [self.frames.depth_format as c_int, abi::FORMAT_RGB888][which],
            width: self.frames.width as c_int,
            height: self.frames.height as c_int,
            fps: self.frames.rate as c_int,
        }
    }

    /// Shows itself to OpenNI, if it is plugged in. To be called while OpenNI starts, so that it is listed then.
    pub fn connect(&self, listener: Listener) {
        let (control, text) = self.channel.read();
        let gone = control.gone;
        let mut state = self.state();
        state.unplugged = gone;
        state.control = control;
        drop(state);
        if !gone {
            (listener.connected)(&raw const self.info, listener.cookie.0);
            (listener.state_changed)(&raw const self.info, 0, listener.cookie.0);
        }
        self.channel.acknowledge(text);
    }

    /// Plays until it is stopped.
    pub fn play(&self, listener: Listener) {
        let period = Duration::from_secs(1) / self.frames.rate;
        let begin = Instant::now();
        let mut due = begin;
        while !self.stopped.load(Ordering::Relaxed) {
            self.listen(listener);
            let mut state = self.state();
            if !state.control.frozen {
                // A camera's clock begins at some time of its own.
                state.clock_us = 1_000_000 + (due - begin).as_micros() as u64;
            }
            if !state.unplugged && !state.control.silent {
                self.show(&mut state);
            }
            drop(state);
            due += period;
            std::thread::sleep(due.saturating_duration_since(Instant::now()));
        }
        self.channel.close();
    }

    /// Reads what it is told. OpenNI hears of it while nothing is locked here.
    fn listen(&self, listener: Listener) {
        let (control, text) = self.channel.read();
        let mut state = self.state();
        if control.capture != state.control.capture {
            state.step = 0;
        }
        let changed = control.gone != state.unplugged;
        state.unplugged = control.gone;
        state.control = control;
        let gone = state.unplugged;
        drop(state);
        if changed && gone {
            (listener.disconnected)(&raw const self.info, listener.cookie.0);
        } else if changed {
            (listener.connected)(&raw const self.info, listener.cookie.0);
        }
        self.channel.acknowledge(text);
    }

    pub fn is_there(&self) -> bool {
        !self.state().unplugged
    }

    /// Hands over a frame of each stream that runs.
    fn show(&self, state: &mut State) {
        if state.streams.iter().any(|s| s.started) {
            state.number += 1;
            for which in 0..2 {
                self.hand_over(state, which);
            }
            state.step += 1;
        }
    }

    fn hand_over(&self, state: &State, which: usize) -> Option<()> {
        let stream = &state.streams[which];
        let (callback, cookie) = stream.new_frame.filter(|_| stream.started)?;
        // SAFETY: OpenNI's services live as long as the stream, which is locked here.
        let services = unsafe { *stream.services?.0 };
        let frame = (services.acquire_frame)(services.services);
        // SAFETY: null, or a frame that is this thread's until it is given back.
        if let Some(filled) = unsafe { frame.as_mut() }.and_then(|f| self.fill(state, which, f)) {
            callback(stream.address?.0, filled, cookie.0);
        }
        if !frame.is_null() {
            (services.release_frame)(services.services, frame);
        }
        Some(())
    }

    fn fill<'a>(&self, state: &State, which: usize, frame: &'a mut Frame) -> Option<&'a mut Frame> {
        let mode = self.mode(which);
        let stride = mode.width * [2, 3][which];
        let size = (stride * mode.height) as usize;
        if frame.data.is_null() || (frame.data_size as usize) < size {
            return None;
        }
        // SAFETY: OpenNI allocated so many bytes for this frame.
        let bytes = unsafe { std::slice::from_raw_parts_mut(frame.data.cast::<u8>(), size) };
        let capture = state.control.capture;
        let read = self.frames.read(capture, state.step, which == 1, bytes);
        read.ok()?;
        let each = state.control.damaged;
        let damaged = each > 0 && state.step.is_multiple_of(each);
        frame.data_size = if damaged {
            size as c_int / 2
        } else {
            size as c_int
        };
        frame.sensor_type = [abi::SENSOR_DEPTH, abi::SENSOR_COLOR][which];
        frame.timestamp = state.clock_us;
        frame.frame_index = state.number;
        (frame.width, frame.height) = (mode.width, mode.height);
        frame.video_mode = mode;
        frame.cropping_enabled = 0;
        (frame.crop_origin_x, frame.crop_origin_y) = (0, 0);
        frame.stride = stride;
        Some(frame)
    }
}
