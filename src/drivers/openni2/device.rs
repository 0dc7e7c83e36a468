//! A safe wrapper of an open OpenNI device: only one camera at a time can open it, and it is closed once, after its
//! streams. This needs `unsafe`.
#![allow(unsafe_code)] // Calls of the C library; each with the reason why it is sound.

use super::ffi;
use super::library::{LIBRARY, Library, OPEN, OpenNiError, checked, field, model};
use super::property::{Calls, Properties};
use std::collections::btree_map::Entry;
use std::ffi::{CString, c_char, c_int};

/// Whether a camera of this process has it.
pub(super) fn is_open(uri: &str) -> bool {
    OPEN.lock().contains_key(uri)
}

/// An open device.
#[derive(Debug)]
pub struct Device {
    pub(super) handle: ffi::DeviceHandle,
    uri: String,
}

impl Device {
    /// Opens a device by its URI, which may be the path of an `.oni` file.
    ///
    /// # Errors
    /// If it is not there, or a camera of this process has it: the library would share one device among both.
    pub fn open(_: Library, uri: &str) -> Result<Self, OpenNiError> {
        let doing = || format!("open {uri}");
        let refused = |words: &str| OpenNiError {
            doing: doing(),
            words: words.into(),
        };
        let name = CString::new(uri).map_err(|_| refused("its name has a zero byte"))?;
        let _held = LIBRARY.lock();
        // What was heard of a device that another camera has stays there.
        match OPEN.lock().entry(uri.to_owned()) {
            Entry::Occupied(_) => {
                return Err(refused("another camera of the configuration uses it"));
            }
            Entry::Vacant(free) => {
                free.insert(None);
            }
        }
        let mut handle = std::ptr::null_mut();
        // SAFETY: the name ends in zero; the handle is written to.
        let status = unsafe { ffi::oniDeviceOpen(name.as_ptr(), &raw mut handle) };
        // What it leaves in the handle where it failed must not be closed: its count of users would be wrong.
        if let Err(failed) = checked(status, doing()) {
            OPEN.lock().remove(uri);
            return Err(failed);
        }
        Ok(Self {
            handle,
            uri: uri.to_owned(),
        })
    }

    /// Where it is.
    pub fn uri(&self) -> &str {
        &self.uri
    }

    /// Why it is gone, if the library said so since it was opened.
    pub fn gone(&self) -> Option<&'static str> {
        OPEN.lock().get(&self.uri).copied().flatten()
    }

    /// Vendor and name.
    pub fn model(&self) -> Option<String> {
        let mut info = ffi::DeviceInfo {
            uri: [0; ffi::MAX_STR],
            vendor: [0; ffi::MAX_STR],
            name: [0; ffi::MAX_STR],
            usb_vendor_id: 0,
            usb_product_id: 0,
        };
        // SAFETY: the device is open; the description is written to.
        let status = unsafe { ffi::oniDeviceGetInfo(self.handle, &raw mut info) };
        (status == ffi::STATUS_OK).then(|| model(&info))
    }

    /// Its serial number, if it reports one.
    pub fn serial_number(&self) -> Option<String> {
        let mut bytes = [0 as c_char; ffi::MAX_STR];
        let mut size = size_of_val(&bytes) as c_int;
        // SAFETY: the device is open; as many bytes may be written as there are.
        let status = unsafe {
            ffi::oniDeviceGetProperty(
                self.handle,
                ffi::DEVICE_SERIAL_NUMBER,
                bytes.as_mut_ptr().cast(),
                &raw mut size,
            )
        };
        let serial = field(&bytes);
        (status == ffi::STATUS_OK && !serial.is_empty()).then_some(serial)
    }

    /// Has depth and colour exposed and handed out together. Both streams must run.
    ///
    /// # Errors
    /// If its driver has no such thing.
    pub fn synchronise(&self) -> Result<(), OpenNiError> {
        // SAFETY: the device is open.
        let status = unsafe { ffi::oniDeviceEnableDepthColorSync(self.handle) };
        checked(status, "synchronise depth and colour")
    }

    /// Ends that; to be called before a stream of the two is stopped, for the library would make a pair of one.
    pub fn stop_synchronising(&self) {
        // SAFETY: the device is open.
        unsafe { ffi::oniDeviceDisableDepthColorSync(self.handle) };
    }

    /// The video modes that a sensor has.
    pub fn video_modes(&self, sensor: c_int) -> Vec<ffi::VideoMode> {
        // SAFETY: the device is open. The library gives null or a description that stays as long as the device.
        let Some(info) = (unsafe { ffi::oniDeviceGetSensorInfo(self.handle, sensor).as_ref() })
        else {
            return Vec::new();
        };
        if info.modes.is_null() {
            return Vec::new();
        }
        let count = info.number_of_modes.clamp(0, 1000) as usize;
        // SAFETY: it describes so many.
        unsafe { std::slice::from_raw_parts(info.modes, count) }.to_vec()
    }
}

impl Drop for Device {
    fn drop(&mut self) {
        let _held = LIBRARY.lock();
        // SAFETY: opened once, closed once; its streams are gone, for each holds the device.
        unsafe { ffi::oniDeviceClose(self.handle) };
        OPEN.lock().remove(&self.uri);
    }
}

// SAFETY: the handle is a device's, which `drop` closes.
unsafe impl Properties for Device {
    const CALLS: Calls = Calls {
        is_supported: ffi::oniDeviceIsPropertySupported,
        get: ffi::oniDeviceGetProperty,
        set: ffi::oniDeviceSetProperty,
    };

    fn handle(&self) -> ffi::DeviceHandle {
        self.handle
    }
}
