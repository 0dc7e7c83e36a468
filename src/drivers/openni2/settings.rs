//! Configures a depth camera: writes each setting, reads it back, and fails by the setting's name if the two differ.

use super::device::Device;
use super::ffi::{self, VideoMode};
use super::frame_check::ExpectedFrame;
use super::parameters::{Parameters, Unit, is_file};
use super::property::Properties;
use super::stream::Stream;
use crate::drivers::live::{CameraInfo, Fault};
use std::ffi::c_int;

/// What was read back of a setting, or what a person should know about it.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Readback {
    /// Name, what was asked for, what was found.
    Row([String; 3]),
    /// What an operator should know.
    Remark(String),
}

fn row(name: &str, asked: impl Into<String>, found: impl Into<String>) -> Readback {
    Readback::Row([name.into(), asked.into(), found.into()])
}

/// Adds to what is known of a camera.
pub(super) fn add(info: &mut CameraInfo, read: Vec<Readback>) {
    for one in read {
        match one {
            Readback::Row(row) => info.table.push(row),
            Readback::Remark(remark) => info.remarks.push(remark),
        }
    }
}

/// Sets what does not need running streams.
///
/// # Errors
/// If something was not taken.
pub(super) fn apply(
    p: &Parameters,
    device: &Device,
    streams: &[Stream],
) -> Result<CameraInfo, Fault> {
    let [width, height] = p.size();
    let mut read = vec![row("device", p.device(), device.uri())];
    if is_file(device.uri()) {
        read.extend(play(p, device)?);
    }
    let unit = p.unit.unwrap_or_default();
    read.push(mode(
        p,
        device,
        &streams[0],
        ffi::SENSOR_DEPTH,
        depth_format(unit),
    )?);
    if let Some(stream) = streams.get(1) {
        read.push(mode(
            p,
            device,
            stream,
            ffi::SENSOR_COLOR,
            ffi::FORMAT_RGB888,
        )?);
    }
    for (stream, name) in streams.iter().zip(["depth mirroring", "color mirroring"]) {
        read.extend(unmirror(stream, name)?);
    }
    // A frame of depth comes with one of colour, if that is open; a capture holds both.
    let pixel_bytes = expected(p).map(|frame| frame.bytes_per_pixel as u64);
    let each: u64 = pixel_bytes.iter().take(streams.len()).sum();
    let mut info = CameraInfo {
        identity: identity(device),
        size: [width, height],
        encoding: "16UC1".into(),
        frame_bytes: u64::from(width) * u64::from(height) * each,
        settings: None,
        table: Vec::new(),
        remarks: vec![format!("a raw reading counts {}", unit.words())],
    };
    add(&mut info, read);
    Ok(info)
}

fn identity(device: &Device) -> String {
    let model = device.model().filter(|m| !m.is_empty());
    let model = model.unwrap_or_else(|| "a depth camera".into());
    match device.serial_number() {
        Some(serial) => format!("{model}, serial number {serial}, {}", device.uri()),
        None => format!("{model}, {}", device.uri()),
    }
}

/// What frames of depth and of colour have to be.
pub(super) fn expected(p: &Parameters) -> [ExpectedFrame; 2] {
    let of = |format, bytes_per_pixel| ExpectedFrame {
        size: p.size(),
        format,
        bytes_per_pixel,
    };
    let depth = depth_format(p.unit.unwrap_or_default());
    [of(depth, 2), of(ffi::FORMAT_RGB888, 3)]
}

fn depth_format(unit: Unit) -> c_int {
    match unit {
        Unit::Millimetre => ffi::FORMAT_DEPTH_1_MM,
        Unit::TenthOfMillimetre => ffi::FORMAT_DEPTH_100_UM,
    }
}

/// A video mode in words.
fn words(mode: VideoMode) -> String {
    let format = match mode.pixel_format {
        ffi::FORMAT_DEPTH_1_MM => "depth in mm".into(),
        ffi::FORMAT_DEPTH_100_UM => "depth in 100 µm".into(),
        ffi::FORMAT_RGB888 => "RGB".into(),
        other => format!("format {other}"),
    };
    let VideoMode {
        resolution_x,
        resolution_y,
        fps,
        ..
    } = mode;
    format!("{resolution_x} x {resolution_y} at {fps}/s, {format}")
}

fn mode(
    p: &Parameters,
    device: &Device,
    stream: &Stream,
    sensor: c_int,
    pixel_format: c_int,
) -> Result<Readback, Fault> {
    let name = match sensor {
        ffi::SENSOR_DEPTH => "depth mode",
        _ => "color mode",
    };
    let [width, height] = p.size();
    let asked = VideoMode {
        pixel_format,
        resolution_x: width as c_int,
        resolution_y: height as c_int,
        fps: p.rate() as c_int,
    };
    // A file has the mode that it was recorded in.
    let taken = match is_file(device.uri()) {
        true => Ok(()),
        false => stream.set(ffi::STREAM_VIDEO_MODE, asked, name),
    };
    let found = stream.get::<VideoMode>(ffi::STREAM_VIDEO_MODE);
    if found == Some(asked) && taken.is_ok() {
        return Ok(row(name, words(asked), words(asked)));
    }
    let mut answer = found.map_or("no mode".into(), words);
    if let Err(failed) = taken {
        answer = format!("{answer} ({failed})");
    }
    let modes: Vec<String> = device.video_modes(sensor).into_iter().map(words).collect();
    if !modes.is_empty() {
        answer = format!("{answer}; its modes are: {}", modes.join("; "));
    }
    Err(Fault::Refused {
        field: name.into(),
        asked: words(asked),
        found: answer,
    })
}

/// Pictures as the camera sees them, not as a mirror would.
fn unmirror(stream: &Stream, name: &str) -> Result<Option<Readback>, Fault> {
    if !stream.has(ffi::STREAM_MIRRORING) {
        return Ok(None);
    }
    let taken = stream.set::<c_int>(ffi::STREAM_MIRRORING, 0, name);
    match stream.get::<c_int>(ffi::STREAM_MIRRORING) {
        Some(0) => Ok(Some(row(name, "off", "off"))),
        found => Err(refused(name, "off", found.map(|_| "on"), taken.err())),
    }
}

/// Every frame once and in order, and then again if it is to.
fn play(p: &Parameters, device: &Device) -> Result<Vec<Readback>, Fault> {
    // It counts as asking for a frame at a time.
    const BY_REQUEST: f32 = -1.0;
    device.set(ffi::DEVICE_PLAYBACK_SPEED, BY_REQUEST, "playback speed")?;
    let repeat = p.repeat.unwrap_or(true);
    let asked = c_int::from(repeat);
    device.set(ffi::DEVICE_PLAYBACK_REPEAT_ENABLED, asked, "repeat")?;
    let found = device.get::<c_int>(ffi::DEVICE_PLAYBACK_REPEAT_ENABLED);
    if found != Some(asked) {
        return Err(refused(
            "repeat",
            on(repeat),
            found.map(|f| on(f != 0)),
            None,
        ));
    }
    Ok(vec![
        row(
            "playback",
            "each frame when it is asked for",
            "each frame when it is asked for",
        ),
        row("repeat", on(repeat), on(repeat)),
        Readback::Remark("a file of OpenNI's: its frames are stamped when they are read".into()),
    ])
}

fn on(is: bool) -> &'static str {
    if is { "on" } else { "off" }
}

fn refused(
    name: &str,
    asked: &str,
    found: Option<&str>,
    failed: Option<super::library::OpenNiError>,
) -> Fault {
    let found = found.unwrap_or("no answer");
    Fault::Refused {
        field: name.into(),
        asked: asked.into(),
        found: match failed {
            Some(failed) => format!("{found} ({failed})"),
            None => found.into(),
        },
    }
}

const REGISTRATION: &str = "registration of depth to color";

/// Registers depth to colour, or does not, and reads back what became of it. The streams must run: some drivers take it
/// and forget it where they do not (OpenNI2, issue 55).
///
/// # Errors
/// If it was not taken.
pub(super) fn register(p: &Parameters, device: &Device) -> Result<Readback, Fault> {
    let wanted = p.registration();
    let property = ffi::DEVICE_IMAGE_REGISTRATION;
    if is_file(device.uri()) && registration(device).is_none() {
        let remark = "the file does not tell whether its depth was registered to its color";
        return Ok(Readback::Remark(remark.into()));
    }
    let mut failed = None;
    if registration(device) != Some(wanted) || !is_file(device.uri()) {
        failed = device
            .set(property, c_int::from(wanted), REGISTRATION)
            .err();
    }
    match registration(device) {
        Some(found) if found == wanted => Ok(row(REGISTRATION, on(wanted), on(found))),
        None if !wanted => Ok(row(REGISTRATION, "off", "its driver has no such setting")),
        found => Err(refused(REGISTRATION, on(wanted), found.map(on), failed)),
    }
}

/// Whether it registers, if it says so.
fn registration(device: &Device) -> Option<bool> {
    let known = device.has(ffi::DEVICE_IMAGE_REGISTRATION);
    let found = known.then(|| device.get::<c_int>(ffi::DEVICE_IMAGE_REGISTRATION));
    found.flatten().map(|mode| mode != 0)
}

/// Whether it still registers as it should.
///
/// # Errors
/// If it does not.
pub(super) fn still_registered(p: &Parameters, device: &Device) -> Result<(), Fault> {
    match registration(device) {
        Some(found) if found != p.registration() => Err(refused(
            REGISTRATION,
            on(p.registration()),
            Some(on(found)),
            None,
        )),
        _ => Ok(()),
    }
}

/// Has depth and colour exposed together where the camera can: whether it does.
///
/// # Errors
/// If it cannot and should.
pub(super) fn synchronise(p: &Parameters, device: &Device) -> Result<(bool, Readback), Fault> {
    const NAME: &str = "synchronisation of depth and color";
    let asked = match p.synchronise {
        Some(false) => return Ok((false, row(NAME, "off", "off"))),
        Some(true) => "on",
        None => "on, if the driver supports it",
    };
    if is_file(device.uri()) {
        return Ok((false, row(NAME, asked, "as it was recorded")));
    }
    match device.synchronise() {
        Ok(()) => Ok((true, row(NAME, asked, "on"))),
        Err(failed) if p.synchronise == Some(true) => {
            Err(refused(NAME, asked, Some("off"), Some(failed)))
        }
        Err(_) => Ok((
            false,
            row(NAME, asked, "off, because the driver does not support it"),
        )),
    }
}
