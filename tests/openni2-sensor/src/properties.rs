//! Properties of a stream and of a device: what OpenNI asks for and what it may set.

use crate::abi::{self, BAD_PARAMETER, NOT_SUPPORTED, OK, VideoMode};
use std::ffi::{c_int, c_void};

pub const DEVICE_SERIAL_NUMBER: c_int = 3;
pub const DEVICE_IMAGE_REGISTRATION: c_int = 5;

const CROPPING: c_int = 0;
const HORIZONTAL_FOV: c_int = 1;
const VERTICAL_FOV: c_int = 2;
const VIDEO_MODE: c_int = 3;
const MAX_VALUE: c_int = 4;
const MIN_VALUE: c_int = 5;
const STRIDE: c_int = 6;
const MIRRORING: c_int = 7;

/// The properties that a stream has.
pub const OF_A_STREAM: [c_int; 8] = [
    CROPPING,
    HORIZONTAL_FOV,
    VERTICAL_FOV,
    VIDEO_MODE,
    MAX_VALUE,
    MIN_VALUE,
    STRIDE,
    MIRRORING,
];

/// A property's bytes.
pub fn of_stream(property: c_int, mode: VideoMode, mirrored: bool) -> Option<Vec<u8>> {
    let int = |n: c_int| Some(n.to_ne_bytes().to_vec());
    let color = mode.pixel_format == abi::FORMAT_RGB888;
    match property {
        CROPPING => Some(vec![0; 20]),
        HORIZONTAL_FOV => Some(1.02_f32.to_ne_bytes().to_vec()),
        VERTICAL_FOV => Some(0.8_f32.to_ne_bytes().to_vec()),
        VIDEO_MODE => Some(mode_bytes(mode)),
        MAX_VALUE => int(if color { 255 } else { 50_000 }),
        MIN_VALUE => int(0),
        STRIDE => int(mode.width * if color { 3 } else { 2 }),
        MIRRORING => int(mirrored.into()),
        _ => None,
    }
}

fn mode_bytes(mode: VideoMode) -> Vec<u8> {
    let fields = [mode.pixel_format, mode.width, mode.height, mode.fps];
    fields.iter().flat_map(|f| f.to_ne_bytes()).collect()
}

/// Sets a stream's property. It has one mode, which it may be told.
///
/// # Safety
/// `data` points to `size` bytes.
pub unsafe fn set_of_stream(
    property: c_int,
    data: *const c_void,
    size: c_int,
    mode: VideoMode,
    mirrored: &mut bool,
) -> c_int {
    // SAFETY: as the caller promises.
    let bytes = unsafe { bytes(data, size) };
    match property {
        VIDEO_MODE if bytes == mode_bytes(mode) => OK,
        VIDEO_MODE => NOT_SUPPORTED,
        MIRRORING => match <[u8; 4]>::try_from(bytes) {
            Ok(value) => {
                *mirrored = c_int::from_ne_bytes(value) != 0;
                OK
            }
            Err(_) => BAD_PARAMETER,
        },
        _ => NOT_SUPPORTED,
    }
}

/// # Safety
/// `data` is null or points to `size` bytes.
pub unsafe fn bytes<'a>(data: *const c_void, size: c_int) -> &'a [u8] {
    if data.is_null() || size <= 0 {
        return &[];
    }
    // SAFETY: as the caller promises.
    unsafe { std::slice::from_raw_parts(data.cast(), size as usize) }
}

/// Hands a property over, or says that there is none.
///
/// # Safety
/// `data` points to `*size` bytes that may be written.
pub unsafe fn hand_over(found: Option<Vec<u8>>, data: *mut c_void, size: *mut c_int) -> c_int {
    let Some(found) = found else {
        return NOT_SUPPORTED;
    };
    // SAFETY: as the caller promises.
    unsafe {
        if data.is_null() || size.is_null() || (*size as usize) < found.len() {
            return BAD_PARAMETER;
        }
        std::ptr::copy_nonoverlapping(found.as_ptr(), data.cast(), found.len());
        *size = found.len() as c_int;
    }
    OK
}
