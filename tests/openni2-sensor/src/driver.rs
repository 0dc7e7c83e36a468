//! The 33 functions that OpenNI looks for in a driver (`OniDriverAPI.h`).

use crate::abi::{
    self, BAD_PARAMETER, ERROR, NOT_SUPPORTED, OK, SensorInfo, StreamServices, VideoMode,
};
use crate::frames::Frames;
use crate::properties;
use crate::sensor::{Listener, Sensor, Shared};
use std::ffi::{CStr, c_char, c_int, c_void};
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// The sensors that play, with their threads.
static SENSORS: Mutex<Vec<(Arc<Sensor>, JoinHandle<()>)>> = Mutex::new(Vec::new());

/// An open device, as OpenNI holds it.
struct Device {
    sensor: Arc<Sensor>,
    /// Of depth and of colour, to which `infos` points.
    _modes: Box<[VideoMode; 2]>,
    infos: Vec<SensorInfo>,
}

impl Device {
    fn open(sensor: &Arc<Sensor>) -> Self {
        let mut modes = Box::new([sensor.mode(0), sensor.mode(1)]);
        let kinds = [abi::SENSOR_DEPTH, abi::SENSOR_COLOR];
        let count = if sensor.frames.has_color() { 2 } else { 1 };
        let infos = kinds.into_iter().zip(modes.iter_mut()).take(count);
        let infos = infos.map(|(sensor_type, mode)| SensorInfo {
            sensor_type,
            number_of_modes: 1,
            modes: mode,
        });
        let infos = infos.collect();
        Self {
            sensor: sensor.clone(),
            _modes: modes,
            infos,
        }
    }
}

/// A stream, as OpenNI holds it.
struct Stream {
    sensor: Arc<Sensor>,
    which: usize,
}

/// # Safety
/// `at` is what `oniDriverDeviceOpen` gave and was not closed.
unsafe fn device<'a>(at: *mut c_void) -> &'a Device {
    // SAFETY: as the caller promises.
    unsafe { &*at.cast::<Device>() }
}

/// # Safety
/// `at` is what `oniDriverDeviceCreateStream` gave and was not destroyed.
unsafe fn stream<'a>(at: *mut c_void) -> &'a Stream {
    // SAFETY: as the caller promises.
    unsafe { &*at.cast::<Stream>() }
}

fn play_all(listener: Listener) {
    let control = std::env::var_os("SCAND_OPENNI2_CONTROL").map(PathBuf::from);
    let files = std::env::var("SCAND_OPENNI2_FRAMES").unwrap_or_default();
    let mut sensors = SENSORS.lock().unwrap_or_else(PoisonError::into_inner);
    for file in files.split(':').filter(|f| !f.is_empty()) {
        let frames = match Frames::open(file.as_ref()) {
            Ok(frames) => frames,
            Err(why) => {
                eprintln!("test sensor: {file}: {why}");
                continue;
            }
        };
        let sensor = Arc::new(Sensor::new(frames, control.clone()));
        sensor.connect(listener);
        let player = sensor.clone();
        let listener = Moved(listener);
        sensors.push((
            sensor,
            std::thread::spawn(move || {
                let listener = listener;
                player.play(listener.0);
            }),
        ));
    }
}

struct Moved(Listener);
// SAFETY: OpenNI's callbacks are made to be called on the driver's threads.
unsafe impl Send for Moved {}

#[unsafe(no_mangle)]
extern "C" fn oniDriverCreate(_: *mut c_void) {}

#[unsafe(no_mangle)]
extern "C" fn oniDriverDestroy() {
    let sensors = std::mem::take(&mut *SENSORS.lock().unwrap_or_else(PoisonError::into_inner));
    for (sensor, thread) in sensors {
        sensor.stop();
        // A thread that is just telling OpenNI of its sensor waits for a lock that OpenNI holds now.
        let patience = Instant::now() + Duration::from_secs(1);
        while !thread.is_finished() && Instant::now() < patience {
            std::thread::sleep(Duration::from_millis(1));
        }
        if thread.is_finished() {
            let _ = thread.join();
        }
    }
}

#[unsafe(no_mangle)]
extern "C" fn oniDriverInitialize(
    connected: abi::DeviceCallback,
    disconnected: abi::DeviceCallback,
    state_changed: abi::DeviceStateCallback,
    cookie: *mut c_void,
) -> c_int {
    play_all(Listener {
        connected,
        disconnected,
        state_changed,
        cookie: Shared(cookie),
    });
    OK
}

#[unsafe(no_mangle)]
extern "C" fn oniDriverTryDevice(_: *const c_char) -> c_int {
    ERROR
}

#[unsafe(no_mangle)]
extern "C" fn oniDriverDeviceOpen(uri: *const c_char, _: *const c_char) -> *mut c_void {
    // SAFETY: OpenNI passes a string that ends in zero.
    let uri = unsafe { CStr::from_ptr(uri) }.to_bytes().to_vec();
    let sensors = SENSORS.lock().unwrap_or_else(PoisonError::into_inner);
    let wanted = |sensor: &Sensor| {
        let own = sensor.info.uri.iter().map(|&c| c as u8);
        own.take_while(|&c| c != 0).eq(uri.iter().copied())
    };
    let found = sensors.iter().find(|(s, _)| wanted(s) && s.is_there());
    match found {
        Some((sensor, _)) => Box::into_raw(Box::new(Device::open(sensor))).cast(),
        None => std::ptr::null_mut(),
    }
}

#[unsafe(no_mangle)]
extern "C" fn oniDriverDeviceClose(at: *mut c_void) {
    // SAFETY: given by `oniDriverDeviceOpen`, closed once.
    drop(unsafe { Box::from_raw(at.cast::<Device>()) });
}

#[unsafe(no_mangle)]
extern "C" fn oniDriverDeviceGetSensorInfoList(
    at: *mut c_void,
    infos: *mut *mut SensorInfo,
    count: *mut c_int,
) -> c_int {
    // SAFETY: OpenNI passes an open device and two places to write to; the list stays as long as the device.
    unsafe {
        let list = &device(at).infos;
        *count = list.len() as c_int;
        *infos = list.as_ptr().cast_mut();
    }
    OK
}

#[unsafe(no_mangle)]
extern "C" fn oniDriverDeviceCreateStream(at: *mut c_void, sensor_type: c_int) -> *mut c_void {
    // SAFETY: an open device.
    let sensor = unsafe { device(at) }.sensor.clone();
    let which = match sensor_type {
        abi::SENSOR_DEPTH => 0,
        abi::SENSOR_COLOR if sensor.frames.has_color() => 1,
        _ => return std::ptr::null_mut(),
    };
    let made = Box::into_raw(Box::new(Stream {
        sensor: sensor.clone(),
        which,
    }));
    let mut state = sensor.state();
    state.streams[which] = crate::sensor::Stream::default();
    state.streams[which].address = Some(Shared(made.cast()));
    made.cast()
}

#[unsafe(no_mangle)]
extern "C" fn oniDriverDeviceDestroyStream(_: *mut c_void, at: *mut c_void) {
    // SAFETY: given by `oniDriverDeviceCreateStream`, destroyed once.
    let gone = unsafe { Box::from_raw(at.cast::<Stream>()) };
    gone.sensor.state().streams[gone.which] = crate::sensor::Stream::default();
}

#[unsafe(no_mangle)]
extern "C" fn oniDriverDeviceSetProperty(
    at: *mut c_void,
    property: c_int,
    data: *const c_void,
    size: c_int,
) -> c_int {
    if property != properties::DEVICE_IMAGE_REGISTRATION {
        return NOT_SUPPORTED;
    }
    // SAFETY: an open device, and as many bytes as are said.
    let (sensor, bytes) = unsafe { (&device(at).sensor, properties::bytes(data, size)) };
    let Ok(value) = <[u8; 4]>::try_from(bytes) else {
        return BAD_PARAMETER;
    };
    let mut state = sensor.state();
    // As real ones do: what is set while nothing runs is taken and forgotten.
    let runs = state.streams.iter().any(|s| s.started);
    let forgets = state.control.unregistered || !runs;
    state.registered = c_int::from_ne_bytes(value) != 0 && !forgets;
    OK
}

#[unsafe(no_mangle)]
extern "C" fn oniDriverDeviceGetProperty(
    at: *mut c_void,
    property: c_int,
    data: *mut c_void,
    size: *mut c_int,
) -> c_int {
    // SAFETY: an open device.
    let sensor = &unsafe { device(at) }.sensor;
    let found = match property {
        properties::DEVICE_SERIAL_NUMBER => {
            let text = sensor.frames.serial.bytes().chain([0]);
            Some(text.collect())
        }
        properties::DEVICE_IMAGE_REGISTRATION => {
            let state = sensor.state();
            let registered = state.registered && !state.control.unregistered;
            Some(c_int::from(registered).to_ne_bytes().to_vec())
        }
        _ => None,
    };
    // SAFETY: OpenNI passes its caller's memory and how much there is.
    unsafe { properties::hand_over(found, data, size) }
}

#[unsafe(no_mangle)]
extern "C" fn oniDriverDeviceIsPropertySupported(_: *mut c_void, property: c_int) -> c_int {
    let known = [
        properties::DEVICE_SERIAL_NUMBER,
        properties::DEVICE_IMAGE_REGISTRATION,
    ];
    known.contains(&property).into()
}

#[unsafe(no_mangle)]
extern "C" fn oniDriverDeviceSetPropertyChangedCallback(
    _: *mut c_void,
    _: Option<abi::PropertyCallback>,
    _: *mut c_void,
) {
}

#[unsafe(no_mangle)]
extern "C" fn oniDriverDeviceNotifyAllProperties(_: *mut c_void) {}

#[unsafe(no_mangle)]
extern "C" fn oniDriverDeviceInvoke(_: *mut c_void, _: c_int, _: *mut c_void, _: c_int) -> c_int {
    NOT_SUPPORTED
}

#[unsafe(no_mangle)]
extern "C" fn oniDriverDeviceIsCommandSupported(_: *mut c_void, _: c_int) -> c_int {
    0
}

#[unsafe(no_mangle)]
extern "C" fn oniDriverDeviceTryManualTrigger(_: *mut c_void) -> c_int {
    OK
}

#[unsafe(no_mangle)]
extern "C" fn oniDriverDeviceIsImageRegistrationModeSupported(
    _: *mut c_void,
    mode: c_int,
) -> c_int {
    (0..=1).contains(&mode).into()
}

#[unsafe(no_mangle)]
extern "C" fn oniDriverStreamSetServices(at: *mut c_void, services: *mut StreamServices) {
    // SAFETY: a stream that is there.
    let Stream { sensor, which } = unsafe { stream(at) };
    sensor.state().streams[*which].services = Some(Shared(services));
}

#[unsafe(no_mangle)]
extern "C" fn oniDriverStreamSetProperty(
    at: *mut c_void,
    property: c_int,
    data: *const c_void,
    size: c_int,
) -> c_int {
    // SAFETY: a stream that is there, and as many bytes as are said.
    unsafe {
        let Stream { sensor, which } = stream(at);
        let mode = sensor.mode(*which);
        let mut state = sensor.state();
        let mirrored = &mut state.streams[*which].mirrored;
        properties::set_of_stream(property, data, size, mode, mirrored)
    }
}

fn property(at: &Stream, property: c_int) -> Option<Vec<u8>> {
    let mirrored = at.sensor.state().streams[at.which].mirrored;
    properties::of_stream(property, at.sensor.mode(at.which), mirrored)
}

#[unsafe(no_mangle)]
extern "C" fn oniDriverStreamGetProperty(
    at: *mut c_void,
    number: c_int,
    data: *mut c_void,
    size: *mut c_int,
) -> c_int {
    // SAFETY: a stream that is there; OpenNI passes its caller's memory and how much there is.
    unsafe { properties::hand_over(property(stream(at), number), data, size) }
}

#[unsafe(no_mangle)]
extern "C" fn oniDriverStreamIsPropertySupported(_: *mut c_void, property: c_int) -> c_int {
    properties::OF_A_STREAM.contains(&property).into()
}

#[unsafe(no_mangle)]
extern "C" fn oniDriverStreamSetPropertyChangedCallback(
    at: *mut c_void,
    handler: Option<abi::PropertyCallback>,
    cookie: *mut c_void,
) {
    // SAFETY: a stream that is there.
    let Stream { sensor, which } = unsafe { stream(at) };
    let callback = handler.map(|h| (h, Shared(cookie)));
    sensor.state().streams[*which].property_changed = callback;
}

#[unsafe(no_mangle)]
extern "C" fn oniDriverStreamNotifyAllProperties(at: *mut c_void) {
    // SAFETY: a stream that is there.
    let known = unsafe { stream(at) };
    let callback = known.sensor.state().streams[known.which].property_changed;
    let Some((callback, cookie)) = callback else {
        return;
    };
    for number in properties::OF_A_STREAM {
        if let Some(bytes) = property(known, number) {
            let size = bytes.len() as c_int;
            callback(at, number, bytes.as_ptr().cast(), size, cookie.0);
        }
    }
}

#[unsafe(no_mangle)]
extern "C" fn oniDriverStreamInvoke(_: *mut c_void, _: c_int, _: *mut c_void, _: c_int) -> c_int {
    NOT_SUPPORTED
}

#[unsafe(no_mangle)]
extern "C" fn oniDriverStreamIsCommandSupported(_: *mut c_void, _: c_int) -> c_int {
    0
}

#[unsafe(no_mangle)]
extern "C" fn oniDriverStreamStart(at: *mut c_void) -> c_int {
    // SAFETY: a stream that is there.
    let Stream { sensor, which } = unsafe { stream(at) };
    sensor.state().streams[*which].started = true;
    OK
}

#[unsafe(no_mangle)]
extern "C" fn oniDriverStreamStop(at: *mut c_void) {
    // SAFETY: a stream that is there.
    let Stream { sensor, which } = unsafe { stream(at) };
    let mut state = sensor.state();
    state.streams[*which].started = false;
    // Registration ends with the streams, as in real ones.
    state.registered &= state.streams.iter().any(|s| s.started);
}

#[unsafe(no_mangle)]
extern "C" fn oniDriverStreamGetRequiredFrameSize(at: *mut c_void) -> c_int {
    // SAFETY: a stream that is there.
    let Stream { sensor, which } = unsafe { stream(at) };
    let mode = sensor.mode(*which);
    mode.width * mode.height * [2, 3][*which]
}

#[unsafe(no_mangle)]
extern "C" fn oniDriverStreamSetNewFrameCallback(
    at: *mut c_void,
    handler: Option<abi::NewFrameCallback>,
    cookie: *mut c_void,
) {
    // SAFETY: a stream that is there.
    let Stream { sensor, which } = unsafe { stream(at) };
    let callback = handler.map(|h| (h, Shared(cookie)));
    sensor.state().streams[*which].new_frame = callback;
}

#[unsafe(no_mangle)]
extern "C" fn oniDriverStreamConvertDepthToColorCoordinates(
    _: *mut c_void,
    _: *mut c_void,
    _: c_int,
    _: c_int,
    _: u16,
    _: *mut c_int,
    _: *mut c_int,
) -> c_int {
    NOT_SUPPORTED
}

#[unsafe(no_mangle)]
extern "C" fn oniDriverEnableFrameSync(streams: *mut *mut c_void, count: c_int) -> *mut c_void {
    if streams.is_null() || count < 1 {
        return std::ptr::null_mut();
    }
    // SAFETY: so many streams that are there.
    let first = unsafe { stream(*streams) };
    match first.sensor.state().control.unsynchronised {
        true => std::ptr::null_mut(),
        // Anything but null: there is nothing to undo.
        false => Arc::as_ptr(&first.sensor).cast_mut().cast(),
    }
}

#[unsafe(no_mangle)]
extern "C" fn oniDriverDisableFrameSync(_: *mut c_void) {}
