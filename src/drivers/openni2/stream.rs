//! A safe interface to a device's streams and their frames: every wait ends, and no frame outlives its stream.
#![allow(unsafe_code)] // Calls of the C library; each with the reason why it is sound.

use super::device::Device;
use super::ffi;
use super::library::{LIBRARY, OpenNiError, checked};
use super::property::{Calls, Properties};
use std::ffi::c_int;
use std::marker::PhantomData;
use std::rc::Rc;
use std::time::Duration;

/// A stream of an open device.
#[derive(Debug)]
pub struct Stream {
    pub(super) handle: ffi::StreamHandle,
    pub(super) device: Rc<Device>,
    runs: bool,
}

impl Stream {
    /// Makes the stream of a sensor.
    ///
    /// # Errors
    /// If the device has no such sensor.
    pub fn create(device: &Rc<Device>, sensor: c_int) -> Result<Self, OpenNiError> {
        let _held = LIBRARY.lock();
        let mut handle = std::ptr::null_mut();
        // SAFETY: the device is open; the handle is written to.
        let status = unsafe { ffi::oniDeviceCreateStream(device.handle, sensor, &raw mut handle) };
        checked(status, format!("make a stream of {}", device.uri()))?;
        Ok(Self {
            handle,
            device: device.clone(),
            runs: false,
        })
    }

    /// Starts it.
    ///
    /// # Errors
    /// If the device does not.
    pub fn start(&mut self) -> Result<(), OpenNiError> {
        // SAFETY: the stream is there.
        let status = unsafe { ffi::oniStreamStart(self.handle) };
        checked(status, format!("start a stream of {}", self.device.uri()))?;
        self.runs = true;
        Ok(())
    }

    /// Stops it.
    pub fn stop(&mut self) {
        if std::mem::take(&mut self.runs) {
            // SAFETY: the stream is there.
            unsafe { ffi::oniStreamStop(self.handle) };
        }
    }

    /// The newest frame. To be called when [`wait`] said that there is one: the library waits for ever otherwise.
    ///
    /// # Errors
    /// If the stream is broken.
    pub fn read(&self) -> Result<Option<Frame<'_>>, OpenNiError> {
        let mut frame = std::ptr::null_mut();
        // SAFETY: the stream is there; the frame is written to and given back when its guard goes.
        let status = unsafe { ffi::oniStreamReadFrame(self.handle, &raw mut frame) };
        checked(status, format!("read a frame of {}", self.device.uri()))?;
        Ok((!frame.is_null()).then_some(Frame {
            frame,
            stream: PhantomData,
        }))
    }
}

// SAFETY: the handle is a stream's, which `drop` destroys.
unsafe impl Properties for Stream {
    const CALLS: Calls = Calls {
        is_supported: ffi::oniStreamIsPropertySupported,
        get: ffi::oniStreamGetProperty,
        set: ffi::oniStreamSetProperty,
    };

    fn handle(&self) -> ffi::StreamHandle {
        self.handle
    }
}

impl Drop for Stream {
    fn drop(&mut self) {
        let _held = LIBRARY.lock();
        self.stop();
        // SAFETY: the stream is made once and destroyed once. Frames borrow it, so no frame exists now.
        unsafe { ffi::oniStreamDestroy(self.handle) };
    }
}

/// Waits until one of at most two streams has a frame: which; `None` when the time is over.
///
/// # Errors
/// If a stream is broken.
pub(super) fn wait(streams: &[&Stream], timeout: Duration) -> Result<Option<usize>, OpenNiError> {
    let mut handles = [std::ptr::null_mut(); 2];
    let count = streams.len().min(handles.len());
    for (handle, stream) in handles.iter_mut().zip(streams) {
        *handle = stream.handle;
    }
    let mut index = -1;
    let milliseconds = timeout.as_millis().clamp(1, 60_000) as c_int;
    // SAFETY: so many streams are there; the index is written to.
    let status = unsafe {
        ffi::oniWaitForAnyStream(
            handles.as_mut_ptr(),
            count as c_int,
            &raw mut index,
            milliseconds,
        )
    };
    if status == ffi::STATUS_TIME_OUT {
        return Ok(None);
    }
    checked(status, "wait for a frame")?;
    Ok(usize::try_from(index).ok().filter(|&i| i < count))
}

/// A frame in the library's memory; given back when it goes.
#[derive(Debug)]
pub struct Frame<'a> {
    frame: *mut ffi::Frame,
    stream: PhantomData<&'a Stream>,
}

impl Frame<'_> {
    /// What the library says of it.
    pub fn facts(&self) -> &ffi::Frame {
        // SAFETY: not null, and the library's own until it is given back.
        unsafe { &*self.frame }
    }

    /// Its bytes, as many as the library says.
    pub fn bytes(&self) -> &[u8] {
        let facts = self.facts();
        if facts.data.is_null() || facts.data_size <= 0 {
            return &[];
        }
        // SAFETY: the library allocated and filled so many, and writes no more to them.
        unsafe { std::slice::from_raw_parts(facts.data.cast(), facts.data_size as usize) }
    }
}

impl Drop for Frame<'_> {
    fn drop(&mut self) {
        // SAFETY: read once, given back once.
        unsafe { ffi::oniFrameRelease(self.frame) };
    }
}
