//! OpenNI itself, made safe: started once for all cameras of the process, ended with the last, and listened to. What it
//! holds once per process is held behind one lock here.
#![allow(unsafe_code)] // Calls of the C library; each with the reason why it is sound.

use super::ffi;
use crate::drivers::live::Fault;
use std::collections::BTreeMap;
use std::ffi::{CStr, c_char, c_int, c_void};
use std::marker::PhantomData;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// What the library refused or could not do, in its own words.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{doing}: {words}")]
pub struct Failed {
    pub(super) doing: String,
    pub(super) words: String,
}

impl From<Failed> for Fault {
    fn from(failed: Failed) -> Self {
        Self::Away(failed.to_string())
    }
}

/// Opening, closing, starting the library and ending it: its lists are not made for two at once.
pub(super) static LIBRARY: Mutex<Users> = Mutex::new(Users {
    count: 0,
    callbacks: None,
});

pub(super) struct Users {
    count: usize,
    callbacks: Option<Callbacks>,
}

struct Callbacks(ffi::CallbackHandle);

// SAFETY: a handle that the library gives out and takes back on any thread; it is used under the lock alone.
unsafe impl Send for Callbacks {}

/// The devices that are open, and what was heard of each: why it is gone. Its own lock, since the library calls back
/// while it is being started and ended.
pub(super) static OPEN: Mutex<BTreeMap<String, Option<&'static str>>> = Mutex::new(BTreeMap::new());

pub(super) fn lock<T>(mutex: &'static Mutex<T>) -> MutexGuard<'static, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

pub(super) fn checked(status: c_int, doing: impl Into<String>) -> Result<(), Failed> {
    if status == ffi::STATUS_OK {
        return Ok(());
    }
    // SAFETY: the library returns a string that ends in zero and is this thread's own until its next call.
    let words = unsafe { text(ffi::oniGetExtendedError()) };
    let words: Vec<&str> = words.split_whitespace().collect();
    Err(Failed {
        doing: doing.into(),
        words: match words.is_empty() {
            true => format!("OpenNI says no more than status {status}"),
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

/// OpenNI, started; it ends with the last one.
#[derive(Debug)]
pub struct Library(PhantomData<*const ()>);

impl Library {
    /// Starts OpenNI, or shares it where it runs. It finds its cameras' drivers then.
    ///
    /// # Errors
    /// If it finds no driver.
    pub fn start() -> Result<Self, Failed> {
        let mut users = lock(&LIBRARY);
        if users.count == 0 {
            // SAFETY: under the lock; ended again below, or with the last user.
            let status = unsafe { ffi::oniInitialize(ffi::API_VERSION) };
            if let Err(failed) = checked(status, "starting OpenNI") {
                // It counts starts that failed as well, and would take the next one for a second.
                // SAFETY: as above.
                unsafe { ffi::oniShutdown() };
                return Err(failed);
            }
            users.callbacks = register();
        }
        users.count += 1;
        Ok(Self(PhantomData))
    }

    /// The devices that are plugged in: each one's URI, and its vendor and name.
    ///
    /// # Errors
    /// If the library has no list.
    pub fn devices(&self) -> Result<Vec<(String, String)>, Failed> {
        let _held = lock(&LIBRARY);
        let (mut list, mut count) = (std::ptr::null_mut(), 0);
        // SAFETY: both are written to; the list is given back below.
        let status = unsafe { ffi::oniGetDeviceList(&raw mut list, &raw mut count) };
        checked(status, "listing devices")?;
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

impl Drop for Library {
    fn drop(&mut self) {
        let mut users = lock(&LIBRARY);
        users.count -= 1;
        if users.count == 0 {
            if let Some(Callbacks(handle)) = users.callbacks.take() {
                // SAFETY: registered once, taken back once.
                unsafe { ffi::oniUnregisterDeviceCallbacks(handle) };
            }
            // SAFETY: every device was closed before, for each holds a `Library`.
            unsafe { ffi::oniShutdown() };
        }
    }
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
        ffi::DEVICE_STATE_EOF => note(info, "its file is at its end"),
        _ => note(info, "its driver reports an error or that it is not ready"),
    }
}

fn note(info: *const ffi::DeviceInfo, why: &'static str) {
    // SAFETY: the library passes null or a description that is valid during the call.
    let Some(info) = (unsafe { info.as_ref() }) else {
        return;
    };
    if let Some(heard) = lock(&OPEN).get_mut(&field(&info.uri)) {
        *heard = heard.or(Some(why));
    }
}
