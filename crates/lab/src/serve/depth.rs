//! Writes the file that the test sensor for OpenNI2 plays: depth and colour frames of a recording's captures. The
//! sensor defines its format (`tests/openni2-sensor/src/frames.rs`).

use scand_core::frame::{CameraId, Picture, Timestamp};
use scand_core::image::{readings_from_raw, rgb_from_file, rgb_from_raw};
use scand_core::recording::{self, DepthPart, MessageRef, Recording, Topic};
use scand_core::statistics::upper_median;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

/// A sensor, as its file begins.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SensorFile {
    /// Serial number, of at most 31 bytes.
    pub serial: String,
    /// Width and height in pixels.
    pub size: [u32; 2],
    /// Frames in a second.
    pub rate: u32,
    /// Whether a reading counts tenths of a millimetre rather than millimetres.
    pub tenths_of_millimetres: bool,
}

/// Why a sensor's file is not written.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum Error {
    /// It cannot be written.
    #[error("{}: {cause}", path.display())]
    Write {
        path: PathBuf,
        cause: std::io::Error,
    },
    /// The recording cannot be read.
    #[error(transparent)]
    Recording(#[from] recording::Error),
    /// The recording lacks something that a depth sensor needs.
    #[error("depth camera {camera}: {what}")]
    Unfit {
        camera: CameraId,
        /// What is missing or wrong.
        what: String,
    },
}

/// A sensor's file as it is written: each capture's depth frames, then its colour frames.
#[derive(Debug)]
pub struct SensorFrames {
    path: PathBuf,
    file: BufWriter<File>,
    pixels: usize,
}

impl SensorFrames {
    /// Begins a file for captures with this many depth and colour frames.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn create(path: &Path, sensor: &SensorFile, captures: &[[u32; 2]]) -> Result<Self, Error> {
        let failed = |cause| Error::Write {
            path: path.into(),
            cause,
        };
        let mut frames = Self {
            path: path.into(),
            file: BufWriter::new(File::create(path).map_err(failed)?),
            pixels: sensor.size.iter().map(|&n| n as usize).product(),
        };
        let mut serial = [0; 32];
        for (to, from) in serial.iter_mut().zip(sensor.serial.bytes()).take(31) {
            *to = from;
        }
        let [width, height] = sensor.size;
        let format = if sensor.tenths_of_millimetres {
            101
        } else {
            100
        };
        frames.write(b"SCANDDP1")?;
        frames.write(&serial)?;
        for number in [width, height, sensor.rate, format, captures.len() as u32] {
            frames.write(&number.to_le_bytes())?;
        }
        for number in captures.iter().flatten() {
            frames.write(&number.to_le_bytes())?;
        }
        Ok(frames)
    }

    /// Adds a depth frame, its readings row by row.
    ///
    /// # Errors
    /// If it cannot be written, or has another size than the sensor's.
    pub fn depth(&mut self, readings: &[u16]) -> Result<(), Error> {
        self.sized(readings.len(), self.pixels)?;
        let bytes: Vec<u8> = readings.iter().flat_map(|r| r.to_le_bytes()).collect();
        self.write(&bytes)
    }

    /// Adds a colour frame.
    ///
    /// # Errors
    /// If it cannot be written, or has another size than the sensor's.
    pub fn color(&mut self, pixels: &[[u8; 3]]) -> Result<(), Error> {
        self.sized(pixels.len(), self.pixels)?;
        self.write(pixels.as_flattened())
    }

    /// Ends the file.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn finish(mut self) -> Result<(), Error> {
        let flushed = self.file.flush();
        flushed.map_err(|cause| self.failed(cause))
    }

    fn sized(&self, found: usize, expected: usize) -> Result<(), Error> {
        if found == expected {
            return Ok(());
        }
        let words = format!("a frame has {found} pixels, expected {expected}");
        Err(self.failed(std::io::Error::new(std::io::ErrorKind::InvalidInput, words)))
    }

    fn write(&mut self, bytes: &[u8]) -> Result<(), Error> {
        let written = self.file.write_all(bytes);
        written.map_err(|cause| self.failed(cause))
    }

    fn failed(&self, cause: std::io::Error) -> Error {
        Error::Write {
            path: self.path.clone(),
            cause,
        }
    }
}

/// Writes the captures of a recording's depth camera for a sensor of the same name to play, in the order of their
/// triggers: of each the first `burst` depth frames from its trigger on, and the colour frames between them. Returns
/// the sensor.
///
/// # Errors
/// If the recording cannot be read, lacks such a camera or has a capture without its frames, or the file cannot be
/// written.
pub fn write_sensor_frames(
    recording: &Recording,
    camera: &CameraId,
    burst: usize,
    path: &Path,
) -> Result<SensorFile, Error> {
    let unfit = |what: String| Error::Unfit {
        camera: camera.clone(),
        what,
    };
    let depth = Topic::Depth(camera.clone(), DepthPart::Image);
    let color = Topic::Depth(camera.clone(), DepthPart::Color);
    let captures = captures(recording, &depth, &color, burst);
    let first = captures.first().and_then(|(depths, _)| depths.first());
    let first = first.ok_or_else(|| unfit("no capture has frames from it".into()))?;
    let size = size(&recording.picture(&depth, first)?)
        .ok_or_else(|| unfit("its depth is not a raw picture".into()))?;
    let sensor = SensorFile {
        serial: camera.to_string(),
        size: size.map(|n| n as u32),
        rate: rate(&captures[0].0),
        tenths_of_millimetres: false,
    };
    let counts = captures
        .iter()
        .map(|(d, c)| [d.len() as u32, c.len() as u32]);
    let counts: Vec<[u32; 2]> = counts.collect();
    if let Some(number) = counts.iter().position(|c| c[0] == 0) {
        return Err(unfit(format!("capture {} has no depth frames", number + 1)));
    }
    let mut file = SensorFrames::create(path, &sensor, &counts)?;
    let [width, height] = size;
    for (depths, colors) in &captures {
        for message in depths {
            let picture = recording.picture(&depth, message)?;
            let readings = readings_from_raw(&(&picture).into(), (width, height));
            file.depth(readings.map_err(|e| unfit(e.to_string()))?.pixels())?;
        }
        for message in colors {
            let picture = recording.picture(&color, message)?;
            let pixels = match &picture {
                Picture::Raw { .. } => rgb_from_raw(&(&picture).into(), (width, height)),
                Picture::Compressed { format, data } => {
                    rgb_from_file(format, data, (width, height))
                }
            };
            file.color(pixels.map_err(|e| unfit(e.to_string()))?.pixels())?;
        }
    }
    file.finish()?;
    Ok(sensor)
}

/// Depth and colour messages of a capture.
type Messages = (Vec<MessageRef>, Vec<MessageRef>);

/// A frame may begin so much before its trigger.
const TOLERANCE_NS: u64 = 5_000_000;

fn captures(recording: &Recording, depth: &Topic, color: &Topic, burst: usize) -> Vec<Messages> {
    let triggers = recording.messages(&Topic::Trigger);
    let mut begins: Vec<u64> = triggers.iter().map(|m| m.log_time().0).collect();
    begins.sort_unstable();
    begins.dedup();
    let ends = begins.iter().skip(1).copied().chain([u64::MAX]);
    let windows = begins.iter().zip(ends);
    let within = |topic: &Topic, from: u64, to: u64| -> Vec<MessageRef> {
        let messages = recording.messages(topic).iter().copied();
        let mut found: Vec<_> = messages
            .filter(|m| (from..to).contains(&m.log_time().0))
            .collect();
        found.sort_by_key(|m| m.log_time());
        found
    };
    let capture = |(begin, end): (&u64, u64)| {
        let from = begin.saturating_sub(TOLERANCE_NS);
        let mut depths = within(depth, from, end.saturating_sub(TOLERANCE_NS));
        depths.truncate(burst);
        let last = depths.last().map_or(from, |m| m.log_time().0);
        let colors = within(color, from, last.saturating_add(TOLERANCE_NS));
        (depths, colors)
    };
    windows.map(capture).collect()
}

/// Frames in a second, from the time between them.
fn rate(depths: &[MessageRef]) -> u32 {
    let times: Vec<Timestamp> = depths.iter().map(MessageRef::log_time).collect();
    let mut apart: Vec<i128> = times
        .windows(2)
        .map(|t| t[1].nanoseconds_since(t[0]))
        .collect();
    let median = upper_median(&mut apart).unwrap_or(33_333_333);
    (1e9 / median.max(1) as f64).round().clamp(1.0, 240.0) as u32
}

fn size(picture: &Picture) -> Option<[usize; 2]> {
    match picture {
        Picture::Raw { width, height, .. } => Some([*width as usize, *height as usize]),
        Picture::Compressed { .. } => None,
    }
}
