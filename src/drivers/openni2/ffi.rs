//! The C interface of OpenNI 2.2 (`OniCAPI.h`, `OniCTypes.h`), as far as it is used: types, numbers, functions. Only
//! `library`, `device`, `stream` and `recorder` call them; these files say what they mean and how they are called
//! safely.
#![allow(unsafe_code)] // Declarations of a C library.
#![allow(missing_docs)] // Named as in the library's own headers, which document them.

use std::ffi::{c_char, c_int, c_void};

pub(super) const STATUS_OK: c_int = 0;
pub(super) const STATUS_TIME_OUT: c_int = 102;
/// `ONI_CREATE_API_VERSION(2, 2)`.
pub(super) const API_VERSION: c_int = 2002;

pub(super) const SENSOR_COLOR: c_int = 2;
pub(super) const SENSOR_DEPTH: c_int = 3;

pub(super) const FORMAT_DEPTH_1_MM: c_int = 100;
pub(super) const FORMAT_DEPTH_100_UM: c_int = 101;
pub(super) const FORMAT_RGB888: c_int = 200;

pub(super) const DEVICE_SERIAL_NUMBER: c_int = 3;
pub(super) const DEVICE_IMAGE_REGISTRATION: c_int = 5;
pub(super) const DEVICE_PLAYBACK_SPEED: c_int = 100;
pub(super) const DEVICE_PLAYBACK_REPEAT_ENABLED: c_int = 101;

pub(super) const STREAM_VIDEO_MODE: c_int = 3;
pub(super) const STREAM_MIRRORING: c_int = 7;

pub(super) const DEVICE_STATE_OK: c_int = 0;
pub(super) const DEVICE_STATE_EOF: c_int = 3;

pub(super) const MAX_STR: usize = 256;

pub(super) type DeviceHandle = *mut c_void;
pub(super) type StreamHandle = *mut c_void;
pub(super) type RecorderHandle = *mut c_void;
pub(super) type CallbackHandle = *mut c_void;

#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct VideoMode {
    pub pixel_format: c_int,
    pub resolution_x: c_int,
    pub resolution_y: c_int,
    pub fps: c_int,
}

#[repr(C)]
#[derive(Clone, Copy)]
pub(super) struct DeviceInfo {
    pub uri: [c_char; MAX_STR],
    pub vendor: [c_char; MAX_STR],
    pub name: [c_char; MAX_STR],
    pub usb_vendor_id: u16,
    pub usb_product_id: u16,
}

#[repr(C)]
pub(super) struct SensorInfo {
    pub sensor_type: c_int,
    pub number_of_modes: c_int,
    pub modes: *const VideoMode,
}

#[repr(C)]
pub struct Frame {
    pub data_size: c_int,
    pub data: *const c_void,
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

pub(super) type DeviceInfoCallback = extern "C" fn(*const DeviceInfo, *mut c_void);
pub(super) type DeviceStateCallback = extern "C" fn(*const DeviceInfo, c_int, *mut c_void);

#[repr(C)]
pub(super) struct DeviceCallbacks {
    pub connected: Option<DeviceInfoCallback>,
    pub disconnected: Option<DeviceInfoCallback>,
    pub state_changed: Option<DeviceStateCallback>,
}

#[link(name = "OpenNI2")]
unsafe extern "C" {
    pub(super) fn oniInitialize(api_version: c_int) -> c_int;
    pub(super) fn oniShutdown();
    pub(super) fn oniGetExtendedError() -> *const c_char;
    pub(super) fn oniGetDeviceList(devices: *mut *mut DeviceInfo, count: *mut c_int) -> c_int;
    pub(super) fn oniReleaseDeviceList(devices: *mut DeviceInfo) -> c_int;
    pub(super) fn oniRegisterDeviceCallbacks(
        callbacks: *mut DeviceCallbacks,
        cookie: *mut c_void,
        handle: *mut CallbackHandle,
    ) -> c_int;
    pub(super) fn oniUnregisterDeviceCallbacks(handle: CallbackHandle);
    pub(super) fn oniWaitForAnyStream(
        streams: *mut StreamHandle,
        count: c_int,
        index: *mut c_int,
        timeout_ms: c_int,
    ) -> c_int;

    pub(super) fn oniDeviceOpen(uri: *const c_char, device: *mut DeviceHandle) -> c_int;
    pub(super) fn oniDeviceClose(device: DeviceHandle) -> c_int;
    pub(super) fn oniDeviceGetInfo(device: DeviceHandle, info: *mut DeviceInfo) -> c_int;
    pub(super) fn oniDeviceGetSensorInfo(device: DeviceHandle, sensor: c_int) -> *const SensorInfo;
    pub(super) fn oniDeviceCreateStream(
        device: DeviceHandle,
        sensor: c_int,
        stream: *mut StreamHandle,
    ) -> c_int;
    pub(super) fn oniDeviceEnableDepthColorSync(device: DeviceHandle) -> c_int;
    pub(super) fn oniDeviceDisableDepthColorSync(device: DeviceHandle);
    pub(super) fn oniDeviceSetProperty(
        device: DeviceHandle,
        property: c_int,
        data: *const c_void,
        size: c_int,
    ) -> c_int;
    pub(super) fn oniDeviceGetProperty(
        device: DeviceHandle,
        property: c_int,
        data: *mut c_void,
        size: *mut c_int,
    ) -> c_int;
    pub(super) fn oniDeviceIsPropertySupported(device: DeviceHandle, property: c_int) -> c_int;

    pub(super) fn oniStreamDestroy(stream: StreamHandle);
    pub(super) fn oniStreamStart(stream: StreamHandle) -> c_int;
    pub(super) fn oniStreamStop(stream: StreamHandle);
    pub(super) fn oniStreamReadFrame(stream: StreamHandle, frame: *mut *mut Frame) -> c_int;
    pub(super) fn oniStreamSetProperty(
        stream: StreamHandle,
        property: c_int,
        data: *const c_void,
        size: c_int,
    ) -> c_int;
    pub(super) fn oniStreamGetProperty(
        stream: StreamHandle,
        property: c_int,
        data: *mut c_void,
        size: *mut c_int,
    ) -> c_int;
    pub(super) fn oniStreamIsPropertySupported(stream: StreamHandle, property: c_int) -> c_int;
    pub(super) fn oniFrameRelease(frame: *mut Frame);

    pub(super) fn oniCreateRecorder(file: *const c_char, recorder: *mut RecorderHandle) -> c_int;
    pub(super) fn oniRecorderAttachStream(
        recorder: RecorderHandle,
        stream: StreamHandle,
        lossy: c_int,
    ) -> c_int;
    pub(super) fn oniRecorderStart(recorder: RecorderHandle) -> c_int;
    pub(super) fn oniRecorderStop(recorder: RecorderHandle);
    pub(super) fn oniRecorderDestroy(recorder: *mut RecorderHandle) -> c_int;
}
