//! An open device of OpenNI's, made safe: opened by one camera at a time, closed once and after its streams.
#![allow(unsafe_code)] // Calls of the C library; each with the reason why it is sound.

use super::ffi;
use super::library::{Failed, LIBRARY, Library, OPEN, checked, field, model};
use std::ffi::{CString, c_char, c_int};

/// Whether a camera of this process has it.
pub fn is_open(uri: &str) -> bool {
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
    pub fn open(_: Library, uri: &str) -> Result<Self, Failed> {
        let doing = || format!("opening {uri}");
        let refused = |words: &str| Failed {
            doing: doing(),
            words: words.into(),
        };
        let name = CString::new(uri).map_err(|_| refused("a zero byte in its name"))?;
        let _held = LIBRARY.lock();
        if OPEN.lock().insert(uri.to_owned(), None).is_some() {
            return Err(refused("another camera of the configuration has it"));
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

    /// Its serial number, if it tells one.
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

    /// Whether it knows a property.
    pub fn has(&self, property: c_int) -> bool {
        // SAFETY: the device is open.
        unsafe { ffi::oniDeviceIsPropertySupported(self.handle, property) != 0 }
    }

    /// A property of the device; `T` is the type that the library's headers give it.
    pub fn get<T: Value>(&self, property: c_int) -> Option<T> {
        let mut value = T::default();
        let mut size = size_of::<T>() as c_int;
        // SAFETY: the device is open; as many bytes may be written as there are, and any are a `T`.
        let status = unsafe {
            ffi::oniDeviceGetProperty(
                self.handle,
                property,
                (&raw mut value).cast(),
                &raw mut size,
            )
        };
        (status == ffi::STATUS_OK && size == size_of::<T>() as c_int).then_some(value)
    }

    /// Sets a property of the device.
    ///
    /// # Errors
    /// If it does not take it.
    pub fn set<T: Value>(&self, property: c_int, value: T, name: &str) -> Result<(), Failed> {
        let size = size_of::<T>() as c_int;
        // SAFETY: the device is open; the value is read during the call alone.
        let status = unsafe {
            ffi::oniDeviceSetProperty(self.handle, property, (&raw const value).cast(), size)
        };
        checked(status, format!("setting {name}"))
    }

    /// Has depth and colour exposed and handed out together. Both streams must run.
    ///
    /// # Errors
    /// If its driver has no such thing.
    pub fn synchronise(&self) -> Result<(), Failed> {
        // SAFETY: the device is open.
        let status = unsafe { ffi::oniDeviceEnableDepthColorSync(self.handle) };
        checked(status, "synchronising depth and colour")
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

/// A value of a property: plain bytes, any of which are one.
pub trait Value: Copy + Default {}
impl Value for c_int {}
impl Value for f32 {}
impl Value for ffi::VideoMode {}
