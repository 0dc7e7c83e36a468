//! A safe interface to a video device of the kernel: its controls as 32-bit values, and frames in memory that it shares
//! with us. Each buffer belongs either to the kernel or to us. The stream is our own, because that of the `v4l` crate
//! hands a buffer to the kernel twice after a timeout.
#![allow(unsafe_code)] // System calls on memory of ours; each with the reason why it is sound.

use std::ffi::{c_int, c_void};
use std::io;
use std::os::fd::BorrowedFd;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;
use v4l::device::Handle;
use v4l::v4l_sys::{v4l2_buffer, v4l2_control, v4l2_queryctrl, v4l2_requestbuffers};
use v4l::v4l2::{ioctl, mmap, munmap, vidioc};

const CAPTURE: u32 = 1;
const MEMORY_MMAP: u32 = 1;
const NEXT_CONTROL: u32 = 0x8000_0000;
const CONTROL_DISABLED: u32 = 1;
const CONTROL_CLASS: u32 = 6;
const POLLIN: i16 = 1;
const READ: c_int = 1;
const SHARED: c_int = 1;

/// A control as the driver describes it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Control {
    /// The kernel's number.
    pub id: u32,
    /// As `v4l2-ctl` writes it.
    pub name: String,
    /// Smallest and largest value and their step.
    pub range: [i64; 3],
}

/// Opens a device. The caller adds the name of the file to errors.
///
/// # Errors
/// If it cannot be opened.
pub(super) fn open(path: &Path) -> io::Result<v4l::Device> {
    let device = v4l::Device::with_path(path)?;
    // `v4l` leaves it open for programs that are run meanwhile, which would hold the camera.
    let handle = device.handle();
    // SAFETY: the device holds the descriptor during the call.
    let descriptor = unsafe { BorrowedFd::borrow_raw(handle.fd()) };
    rustix::io::fcntl_setfd(descriptor, rustix::io::FdFlags::CLOEXEC)?;
    Ok(device)
}

/// Lists the controls that have a plain value.
pub(super) fn controls(handle: &Handle) -> Vec<Control> {
    let mut found = Vec::new();
    let mut id = 0;
    loop {
        // SAFETY: all zeros are a valid query.
        let mut query: v4l2_queryctrl = unsafe { std::mem::zeroed() };
        query.id = id | NEXT_CONTROL;
        // SAFETY: the request's own type, which lives during the call.
        let answered = unsafe { call(handle, vidioc::VIDIOC_QUERYCTRL, &mut query) };
        // A driver that does not go on would be asked for ever.
        if answered.is_err() || query.id <= id || found.len() > 1000 {
            return found;
        }
        id = query.id;
        if query.flags & CONTROL_DISABLED == 0 && query.type_ != CONTROL_CLASS {
            let name: Vec<u8> = query.name.iter().copied().take_while(|&c| c != 0).collect();
            found.push(Control {
                id,
                name: plain(&String::from_utf8_lossy(&name)),
                range: [
                    query.minimum.into(),
                    query.maximum.into(),
                    query.step.into(),
                ],
            });
        }
    }
}

/// A control's name as `v4l2-ctl` writes it: small letters and digits, all else as one `_`.
pub(super) fn plain(name: &str) -> String {
    let words = name.split(|c: char| !c.is_ascii_alphanumeric());
    let words: Vec<&str> = words.filter(|w| !w.is_empty()).collect();
    words.join("_").to_ascii_lowercase()
}

/// A control's value.
///
/// # Errors
/// If the driver does not tell it.
pub(super) fn control(handle: &Handle, id: u32) -> io::Result<i64> {
    let mut found = v4l2_control { id, value: 0 };
    // SAFETY: the request's own type, which lives during the call.
    unsafe { call(handle, vidioc::VIDIOC_G_CTRL, &mut found)? };
    Ok(found.value.into())
}

/// Sets a control.
///
/// # Errors
/// If the driver does not take it.
pub(super) fn set_control(handle: &Handle, id: u32, value: i64) -> io::Result<()> {
    let value = i32::try_from(value).map_err(|_| io::ErrorKind::InvalidInput)?;
    let mut asked = v4l2_control { id, value };
    // SAFETY: the request's own type, which lives during the call.
    unsafe { call(handle, vidioc::VIDIOC_S_CTRL, &mut asked) }
}

/// # Safety
/// `T` is the type that the request reads and writes.
unsafe fn call<T>(handle: &Handle, request: vidioc::_IOC_TYPE, with: &mut T) -> io::Result<()> {
    // SAFETY: as the caller promises; the descriptor is open as long as its handle.
    unsafe {
        ioctl(
            handle.fd(),
            request,
            std::ptr::from_mut(with).cast::<c_void>(),
        )
    }
}

/// A filled buffer, ours until it is given back.
#[derive(Debug)]
pub(super) struct FilledBuffer {
    index: u32,
    /// Bytes that were filled.
    pub used: u32,
    /// The kernel's flags (`V4L2_BUF_FLAG_…`).
    pub flags: u32,
    /// By the clock that the flags name.
    pub time: Duration,
    /// Counts frames, also those that were dropped.
    pub sequence: u32,
}

/// A queue of buffers that the kernel fills.
pub(super) struct Queue {
    handle: Arc<Handle>,
    maps: Vec<Map>,
    runs: bool,
}

#[derive(Debug)]
struct Map {
    at: *mut c_void,
    length: usize,
}

impl Queue {
    /// Makes a queue of `count` buffers and starts the stream.
    ///
    /// # Errors
    /// If the driver does not stream from memory, or another program has it.
    pub(super) fn start(handle: Arc<Handle>, count: u32) -> io::Result<Self> {
        let mut queue = Self {
            handle,
            maps: Vec::new(),
            runs: false,
        };
        let given = queue.request(count)?;
        for index in 0..given {
            let map = queue.map(index)?;
            queue.maps.push(map);
            queue.hand_to_kernel(index)?;
        }
        let mut kind = CAPTURE as c_int;
        // SAFETY: the request's own type, which lives during the call.
        unsafe { call(&queue.handle, vidioc::VIDIOC_STREAMON, &mut kind)? };
        queue.runs = true;
        Ok(queue)
    }

    fn request(&self, count: u32) -> io::Result<u32> {
        // SAFETY: all zeros are a valid request.
        let mut request: v4l2_requestbuffers = unsafe { std::mem::zeroed() };
        request.count = count;
        request.type_ = CAPTURE;
        request.memory = MEMORY_MMAP;
        // SAFETY: the request's own type, which lives during the call.
        unsafe { call(&self.handle, vidioc::VIDIOC_REQBUFS, &mut request)? };
        Ok(request.count)
    }

    fn map(&self, index: u32) -> io::Result<Map> {
        let mut buffer = blank(index);
        // SAFETY: the request's own type; what it fills in for memory of this kind is an offset.
        let (length, offset) = unsafe {
            call(&self.handle, vidioc::VIDIOC_QUERYBUF, &mut buffer)?;
            (buffer.length as usize, buffer.m.offset)
        };
        // SAFETY: a new mapping, at a place of the kernel's choice, of the buffer that it just described.
        let at = unsafe {
            mmap(
                std::ptr::null_mut(),
                length,
                READ,
                SHARED,
                self.handle.fd(),
                offset.into(),
            )?
        };
        Ok(Map { at, length })
    }

    fn hand_to_kernel(&self, index: u32) -> io::Result<()> {
        let mut buffer = blank(index);
        // SAFETY: the request's own type; the buffer's memory stays mapped until the stream has ended.
        unsafe { call(&self.handle, vidioc::VIDIOC_QBUF, &mut buffer) }
    }

    /// Waits for a filled buffer; false when the time is over.
    ///
    /// # Errors
    /// If the device is gone.
    pub(super) fn wait(&self, timeout: Duration) -> io::Result<bool> {
        let milliseconds = timeout.as_millis().clamp(1, 60_000) as i32;
        match self.handle.poll(POLLIN, milliseconds) {
            Err(interrupted) if interrupted.kind() == io::ErrorKind::Interrupted => Ok(false),
            outcome => Ok(outcome? > 0),
        }
    }

    /// Takes a filled buffer, if there is one.
    ///
    /// # Errors
    /// If the device is gone.
    pub(super) fn take(&self) -> io::Result<Option<FilledBuffer>> {
        let mut buffer = blank(0);
        // SAFETY: the request's own type, which lives during the call.
        let taken = unsafe { call(&self.handle, vidioc::VIDIOC_DQBUF, &mut buffer) };
        match taken {
            Err(none) if none.kind() == io::ErrorKind::WouldBlock => return Ok(None),
            outcome => outcome?,
        }
        let seconds = u64::try_from(buffer.timestamp.tv_sec).unwrap_or(0);
        let micros = u64::try_from(buffer.timestamp.tv_usec).unwrap_or(0);
        Ok(Some(FilledBuffer {
            index: buffer.index,
            used: buffer.bytesused,
            flags: buffer.flags,
            time: Duration::from_secs(seconds) + Duration::from_micros(micros),
            sequence: buffer.sequence,
        }))
    }

    /// What the kernel filled in.
    pub(super) fn bytes(&self, filled: &FilledBuffer) -> &[u8] {
        let Some(map) = self.maps.get(filled.index as usize) else {
            return &[];
        };
        let length = (filled.used as usize).min(map.length);
        // SAFETY: mapped for as long as the queue is, and the kernel's no more: it gave the buffer out and gets it back
        // by value, for which nothing may borrow it.
        unsafe { std::slice::from_raw_parts(map.at.cast(), length) }
    }

    /// Gives a buffer back to be filled again.
    ///
    /// # Errors
    /// If the device is gone.
    pub(super) fn give_back(&mut self, filled: FilledBuffer) -> io::Result<()> {
        self.hand_to_kernel(filled.index)
    }
}

impl Drop for Queue {
    fn drop(&mut self) {
        if self.runs {
            let mut kind = CAPTURE as c_int;
            // SAFETY: the request's own type. All buffers are ours after it.
            let _ = unsafe { call(&self.handle, vidioc::VIDIOC_STREAMOFF, &mut kind) };
        }
        for map in self.maps.drain(..) {
            // SAFETY: mapped once, unmapped once; no slice of it lives, for each borrows the queue.
            let _ = unsafe { munmap(map.at, map.length) };
        }
        let _ = self.request(0);
    }
}

fn blank(index: u32) -> v4l2_buffer {
    // SAFETY: all zeros are a valid buffer.
    let mut buffer: v4l2_buffer = unsafe { std::mem::zeroed() };
    buffer.index = index;
    buffer.type_ = CAPTURE;
    buffer.memory = MEMORY_MMAP;
    buffer
}
