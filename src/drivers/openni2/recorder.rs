//! A safe interface to OpenNI's own recordings (`.oni`): a file is written while its recorder exists.
#![allow(unsafe_code)] // Calls of the C library; each with the reason why it is sound.

use super::device::Device;
use super::ffi;
use super::library::{LIBRARY, OpenNiError, checked};
use super::stream::Stream;
use std::ffi::CString;
use std::rc::Rc;

/// Writes what streams give into an `.oni` file until it goes.
#[derive(Debug)]
pub struct Recorder {
    handle: ffi::RecorderHandle,
    _device: Rc<Device>,
}

impl Recorder {
    /// Starts to write streams of one device, depth and colour without loss.
    ///
    /// # Errors
    /// If the file cannot be made.
    pub fn start(path: &std::path::Path, streams: &[&Stream]) -> Result<Option<Self>, OpenNiError> {
        let Some(first) = streams.first() else {
            return Ok(None);
        };
        let shown = path.display();
        let name = CString::new(path.as_os_str().as_encoded_bytes()).map_err(|_| OpenNiError {
            doing: format!("record to {shown}"),
            words: "its name has a zero byte".into(),
        })?;
        let _held = LIBRARY.lock();
        let mut handle = std::ptr::null_mut();
        // SAFETY: the name ends in zero; the handle is written to.
        let status = unsafe { ffi::oniCreateRecorder(name.as_ptr(), &raw mut handle) };
        checked(status, format!("record to {shown}"))?;
        let recorder = Self {
            handle,
            _device: first.device.clone(),
        };
        for stream in streams {
            // SAFETY: recorder and stream are there.
            let status = unsafe { ffi::oniRecorderAttachStream(handle, stream.handle, 0) };
            checked(status, format!("record a stream to {shown}"))?;
        }
        // SAFETY: the recorder is there.
        let status = unsafe { ffi::oniRecorderStart(handle) };
        checked(status, format!("record to {shown}"))?;
        Ok(Some(recorder))
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        // Not under the lock: it waits for its writer. Made once, destroyed once.
        // SAFETY: the recorder is there; its handle is not used after.
        unsafe {
            ffi::oniRecorderStop(self.handle);
            ffi::oniRecorderDestroy(&raw mut self.handle);
        }
    }
}
