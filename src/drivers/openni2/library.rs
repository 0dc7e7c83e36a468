//! OpenNI itself behind a safe interface: started once for all cameras of the process, and its callbacks received. One
//! lock protects what the library has only once per process.
#![allow(unsafe_code)] // Calls of the C library; each with the reason why it is sound.

use super::ffi;
use crate::drivers::live::Fault;
use parking_lot::Mutex;
use std::collections::BTreeMap;
use std::ffi::{CStr, c_char, c_int, c_void};
use std::path::Path;
use std::time::{Duration, Instant};

/// What the library refused or could not do, in its own words.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("cannot {doing}: {words}")]
pub struct OpenNiError {
    /// What it could not do, with its verb first.
    pub(super) doing: String,
    pub(super) words: String,
}

impl From<OpenNiError> for Fault {
    fn from(failed: OpenNiError) -> Self {
        Self::Away(failed.to_string())
    }
}

/// Serialises opening and closing devices and starting and stopping the library, which is not thread-safe there.
pub(super) static LIBRARY: Mutex<State> = Mutex::new(State {
    started: None,
    callbacks: None,
});

pub(super) struct State {
    /// When it was started last.
    started: Option<Instant>,
    callbacks: Option<Callbacks>,
}

struct Callbacks(ffi::CallbackHandle);

// SAFETY: a handle that the library gives out and takes back on any thread; it is used under the lock alone.
unsafe impl Send for Callbacks {}

/// The devices that are open, and what was heard of each: why it is gone. Its own lock, since the library calls back
/// while it is being started and ended.
pub(super) static OPEN: Mutex<BTreeMap<String, Option<&'static str>>> = Mutex::new(BTreeMap::new());

pub(super) fn checked(status: c_int, doing: impl Into<String>) -> Result<(), OpenNiError> {
    if status == ffi::STATUS_OK {
        return Ok(());
    }
    // SAFETY: the library returns a string that ends in zero and is this thread's own until its next call.
    let words = unsafe { text(ffi::oniGetExtendedError()) };
    let words: Vec<&str> = words.split_whitespace().collect();
    Err(OpenNiError {
        doing: doing.into(),
        words: match words.is_empty() {
            true => format!("OpenNI reports only status {status}"),
            false => format!("{} (OpenNI's status {status})", words.join(" ")),
        },
    })
}

/// # Safety
/// `at` is null or points to a string that ends in zero.
unsafe fn text(at: *const c_char) -> String {
    if at.is_null() {
        return String::new();
    }
    // SAFETY: as the caller promises.
    let found = unsafe { CStr::from_ptr(at) };
    found.to_string_lossy().into_owned()
}

/// A string in a field of fixed length, which need not end in zero.
pub(super) fn field(bytes: &[c_char]) -> String {
    let bytes = bytes.iter().map(|&c| c as u8).take_while(|&c| c != 0);
    String::from_utf8_lossy(&bytes.collect::<Vec<u8>>()).into_owned()
}

/// OpenNI, started. It stays so until the process ends: each start and end of it loses memory (135 KiB with the drivers
/// that Debian ships), and a camera that is away is looked for again and again.
#[derive(Debug, Clone, Copy)]
pub struct Library(());

impl Library {
    /// Starts OpenNI, if it does not run.
    ///
    /// # Errors
    /// If it finds no driver.
    pub fn start() -> Result<Self, OpenNiError> {
        let mut state = LIBRARY.lock();
        if state.started.is_none() {
            start(&mut state)?;
        }
        Ok(Self(()))
    }

    /// Restarts OpenNI if that can bring back a camera: the Kinect's driver looks for cameras only when it starts, and
    /// forgets a camera that was closed. It does so only while a Kinect is plugged in and no camera is open, and not
    /// twice in a short time. Returns whether it did.
    ///
    /// # Errors
    /// If it finds no driver any more.
    pub fn renew(self) -> Result<bool, OpenNiError> {
        let mut state = LIBRARY.lock();
        let recent = state
            .started
            .is_some_and(|at| at.elapsed() < RENEWED_AT_MOST_EACH);
        if recent || !OPEN.lock().is_empty() || !kinect_is_plugged_in(Path::new(USB_DEVICES)) {
            return Ok(false);
        }
        if let Some(Callbacks(handle)) = state.callbacks.take() {
            // SAFETY: registered once, taken back once.
            unsafe { ffi::oniUnregisterDeviceCallbacks(handle) };
        }
        state.started = None;
        // SAFETY: no device is open, and none can be opened while the lock is held.
        unsafe { ffi::oniShutdown() };
        start(&mut state)?;
        Ok(true)
    }

    /// The devices that are plugged in: each one's URI, and its vendor and name.
    ///
    /// # Errors
    /// If the library has no list.
    pub fn devices(self) -> Result<Vec<(String, String)>, OpenNiError> {
        let _held = LIBRARY.lock();
        let (mut list, mut count) = (std::ptr::null_mut(), 0);
        // SAFETY: both are written to; the list is given back below.
        let status = unsafe { ffi::oniGetDeviceList(&raw mut list, &raw mut count) };
        checked(status, "list devices")?;
        if list.is_null() {
            return Ok(Vec::new());
        }
        // SAFETY: the library made a list of so many.
        let infos = unsafe { std::slice::from_raw_parts(list, count.max(0) as usize) };
        let named = infos.iter().map(|info| (field(&info.uri), model(info)));
        let devices = named.collect();
        // SAFETY: it is not used after.
        unsafe { ffi::oniReleaseDeviceList(list) };
        Ok(devices)
    }
}

const RENEWED_AT_MOST_EACH: Duration = Duration::from_secs(10);
const USB_DEVICES: &str = "/sys/bus/usb/devices";

fn start(state: &mut State) -> Result<(), OpenNiError> {
    keep_directory();
    // SAFETY: under the lock; ended again below, or when it is renewed.
    let status = unsafe { ffi::oniInitialize(ffi::API_VERSION) };
    if let Err(failed) = checked(status, "start OpenNI") {
        // It counts starts that failed as well, and would take the next one for a second.
        // SAFETY: as above.
        unsafe { ffi::oniShutdown() };
        return Err(failed);
    }
    state.callbacks = register();
    state.started = Some(Instant::now());
    Ok(())
}

/// Whether the kernel lists the camera of a Kinect v1 among its USB devices.
fn kinect_is_plugged_in(devices: &Path) -> bool {
    let read = |path: &Path, name: &str| std::fs::read_to_string(path.join(name)).ok();
    let is = |path: &Path| {
        let vendor = read(path, "idVendor");
        let product = read(path, "idProduct");
        vendor.is_some_and(|v| v.trim() == "045e") && product.is_some_and(|p| p.trim() == "02ae")
    };
    let entries = std::fs::read_dir(devices).into_iter().flatten().flatten();
    entries.map(|e| e.path()).any(|path| is(&path))
}

/// OpenNI changes into its drivers' folder while it starts, and back: for the whole process, in which other threads may
/// open files just then. So this thread, and those that OpenNI starts from it, get a working directory of their own.
fn keep_directory() {
    // SAFETY: it concerns this thread's directory, root and umask alone. Where it is not allowed, nothing has changed.
    unsafe { libc::unshare(libc::CLONE_FS) };
}

pub(super) fn model(info: &ffi::DeviceInfo) -> String {
    format!("{} {}", field(&info.vendor), field(&info.name))
        .trim()
        .to_owned()
}

/// Without them a camera that is unplugged is found out by its silence.
fn register() -> Option<Callbacks> {
    let mut callbacks = ffi::DeviceCallbacks {
        connected: Some(connected),
        disconnected: Some(disconnected),
        state_changed: Some(state_changed),
    };
    let mut handle = std::ptr::null_mut();
    // SAFETY: the library copies the three functions; the cookie is not used.
    let status = unsafe {
        ffi::oniRegisterDeviceCallbacks(&raw mut callbacks, std::ptr::null_mut(), &raw mut handle)
    };
    (status == ffi::STATUS_OK && !handle.is_null()).then_some(Callbacks(handle))
}

extern "C" fn connected(_: *const ffi::DeviceInfo, _: *mut c_void) {}

extern "C" fn disconnected(info: *const ffi::DeviceInfo, _: *mut c_void) {
    note(info, "it was unplugged");
}

extern "C" fn state_changed(info: *const ffi::DeviceInfo, state: c_int, _: *mut c_void) {
    match state {
        ffi::DEVICE_STATE_OK => {}
        ffi::DEVICE_STATE_EOF => note(info, "its file has ended"),
        _ => note(
            info,
            "its driver reports an error, or that the camera is not ready",
        ),
    }
}

fn note(info: *const ffi::DeviceInfo, why: &'static str) {
    // SAFETY: the library passes null or a description that is valid during the call.
    let Some(info) = (unsafe { info.as_ref() }) else {
        return;
    };
    if let Some(heard) = OPEN.lock().get_mut(&field(&info.uri)) {
        *heard = heard.or(Some(why));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_kinect_is_known_by_its_numbers() {
        let folder = tempfile::tempdir().unwrap();
        assert!(!kinect_is_plugged_in(&folder.path().join("missing")));
        for (name, vendor, product, plugged) in [
            ("usb1", "1d6b\n", "0002\n", false),
            // Its motor alone, which has a plug of its own.
            ("1-1.1", "045e\n", "02b0\n", false),
            ("1-1.3", "045e\n", "02ae\n", true),
        ] {
            let device = folder.path().join(name);
            std::fs::create_dir(&device).unwrap();
            std::fs::write(device.join("idVendor"), vendor).unwrap();
            std::fs::write(device.join("idProduct"), product).unwrap();
            assert_eq!(kinect_is_plugged_in(folder.path()), plugged, "{name}");
        }
    }
}
