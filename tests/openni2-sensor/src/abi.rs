//! Types of OpenNI 2.2 that its drivers share with it (`OniCTypes.h`, `OniDriverTypes.h`).

use std::ffi::{c_char, c_int, c_void};

pub const OK: c_int = 0;
pub const ERROR: c_int = 1;
pub const NOT_SUPPORTED: c_int = 3;
pub const BAD_PARAMETER: c_int = 4;

pub const SENSOR_COLOR: c_int = 2;
pub const SENSOR_DEPTH: c_int = 3;
pub const FORMAT_RGB888: c_int = 200;
pub const MAX_STR: usize = 256;

#[repr(C)]
#[derive(Clone, Copy, Default, PartialEq)]
pub struct VideoMode {
    pub pixel_format: c_int,
    pub width: c_int,
    pub height: c_int,
    pub fps: c_int,
}

#[repr(C)]
pub struct SensorInfo {
    pub sensor_type: c_int,
    pub number_of_modes: c_int,
    pub modes: *mut VideoMode,
}

#[repr(C)]
#[derive(Clone)]
pub struct DeviceInfo {
    pub uri: [c_char; MAX_STR],
    pub vendor: [c_char; MAX_STR],
    pub name: [c_char; MAX_STR],
    pub usb_vendor_id: u16,
    pub usb_product_id: u16,
}

#[repr(C)]
pub struct Frame {
    pub data_size: c_int,
    pub data: *mut c_void,
    pub sensor_type: c_int,
    pub timestamp: u64,
    pub frame_index: c_int,
    pub width: c_int,
    pub height: c_int,
    pub video_mode: VideoMode,
    pub cropping_enabled: c_int,
    pub crop_origin_x: c_int,
    pub crop_origin_y: c_int,
    pub stride: c_int,
}

#[repr(C)]
#[derive(Clone, Copy)]
pub struct StreamServices {
    pub services: *mut c_void,
    pub default_required_frame_size: extern "C" fn(*mut c_void) -> c_int,
    pub acquire_frame: extern "C" fn(*mut c_void) -> *mut Frame,
    pub add_frame_reference: extern "C" fn(*mut c_void, *mut Frame),
    pub release_frame: extern "C" fn(*mut c_void, *mut Frame),
}

pub type DeviceCallback = extern "C" fn(*const DeviceInfo, *mut c_void);
pub type DeviceStateCallback = extern "C" fn(*const DeviceInfo, c_int, *mut c_void);
pub type NewFrameCallback = extern "C" fn(*mut c_void, *mut Frame, *mut c_void);
pub type PropertyCallback = extern "C" fn(*mut c_void, c_int, *const c_void, c_int, *mut c_void);

/// A text in a field of fixed length.
pub fn field(text: &str) -> [c_char; MAX_STR] {
    let mut bytes = [0; MAX_STR];
    for (to, from) in bytes.iter_mut().zip(text.bytes()).take(MAX_STR - 1) {
        *to = from as c_char;
    }
    bytes
}
