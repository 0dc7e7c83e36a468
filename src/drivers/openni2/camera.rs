//! An open depth camera: found, configured, started and stopped. `settings.rs` configures it, `shoot.rs` takes its
//! shots.

use super::clock::{SETTLING, StreamClock};
use super::device::{Device, is_open};
use super::ffi;
use super::frame_check::ExpectedFrame;
use super::library::{Library, OpenNiError};
use super::parameters::{Parameters, is_file};
use super::recorder::Recorder;
use super::settings::{self, Readback};
use super::stream::{self, Stream};
use crate::clock::Clock;
use crate::drivers::live::{CameraInfo, Fault, Pool};
use crate::frame::{CameraId, Timestamp};
use std::path::Path;
use std::rc::Rc;
use std::time::{Duration, Instant};

/// An open depth camera with its streams.
#[derive(Debug)]
pub struct Camera {
    pub(super) id: CameraId,
    pub(super) parameters: Parameters,
    pub(super) pool: Pool,
    pub(super) host: Clock,
    pub(super) info: CameraInfo,
    /// Of depth and of colour.
    pub(super) expected: [ExpectedFrame; 2],
    pub(super) clock: StreamClock,
    pub(super) runs: bool,
    synchronised: bool,
    /// Depth, and colour if it is taken. They go before the device does.
    pub(super) streams: Vec<Stream>,
    pub(super) device: Rc<Device>,
}

/// How long a camera that was started may take to its first frame: motors of light and focus settle.
const FIRST_FRAME: Duration = Duration::from_secs(5);

impl Camera {
    /// Opens, sets and starts a camera, and reads everything back.
    ///
    /// # Errors
    /// If it is not there or did not take a setting; it is closed again then.
    pub fn open(
        id: CameraId,
        parameters: Parameters,
        pool: Pool,
        host: Clock,
    ) -> Result<Self, Fault> {
        let library = Library::start()?;
        let device = match find(library, parameters.device()) {
            Err(_) if library.renew()? => find(library, parameters.device()),
            found => found,
        };
        let device = Rc::new(device?);
        let mut streams = vec![Stream::create(&device, ffi::SENSOR_DEPTH)?];
        if parameters.color() {
            streams.push(Stream::create(&device, ffi::SENSOR_COLOR)?);
        }
        let info = settings::apply(&parameters, &device, &streams)?;
        let mut camera = Self {
            id,
            expected: settings::expected(&parameters),
            parameters,
            pool,
            host,
            info,
            clock: StreamClock::by_arrival(),
            runs: false,
            synchronised: false,
            streams,
            device,
        };
        let read = camera.start()?;
        settings::add(&mut camera.info, read);
        if camera.parameters.take_turns() {
            camera.stop();
        }
        Ok(camera)
    }

    /// Whether it is an `.oni` file: it gives every frame once, when it is asked to.
    pub(super) fn is_file(&self) -> bool {
        is_file(self.device.uri())
    }

    /// Starts the streams, registers them, and sees how its clock runs.
    pub(super) fn start(&mut self) -> Result<Vec<Readback>, Fault> {
        self.runs = true;
        for stream in &mut self.streams {
            stream.start()?;
        }
        // Some drivers take it and leave it at that where the streams do not run yet.
        let mut read = vec![settings::register(&self.parameters, &self.device)?];
        if !self.is_file() {
            let (clock, remark) = self.settle()?;
            self.clock = clock;
            read.extend(remark.map(Readback::Remark));
        }
        if self.streams.len() == 2 {
            let (synchronised, said) = settings::synchronise(&self.parameters, &self.device)?;
            self.synchronised = synchronised;
            read.push(said);
        }
        Ok(read)
    }

    /// Stops the streams.
    pub(super) fn stop(&mut self) {
        if std::mem::take(&mut self.synchronised) {
            self.await_a_pause();
            self.device.stop_synchronising();
        }
        for stream in &mut self.streams {
            stream.stop();
        }
        self.runs = false;
    }

    /// OpenNI takes away what holds the frames of streams that it synchronises, whether or not its driver is just
    /// putting one in. Right behind a frame it is not: the next one comes a frame's period later.
    fn await_a_pause(&self) {
        let patience = Instant::now() + Duration::from_millis(100);
        while let Some(left) = patience.checked_duration_since(Instant::now()) {
            match self.wait(left) {
                Ok(Some(which)) => {
                    let _ = self.streams[which].read();
                    if which == 0 {
                        return;
                    }
                }
                Ok(None) => {}
                Err(_) => return,
            }
        }
    }

    /// The first depth frames tell how the camera's clock runs; nothing else is wanted of them.
    fn settle(&self) -> Result<(StreamClock, Option<String>), Fault> {
        let mut seen: Vec<(u64, Timestamp)> = Vec::with_capacity(SETTLING);
        let mut newest = Instant::now();
        while seen.len() < SETTLING {
            let limit = match seen.is_empty() {
                true => FIRST_FRAME,
                false => self.parameters.silence(),
            };
            let left = limit.saturating_sub(newest.elapsed());
            if left.is_zero() {
                return Err(self.silent(limit));
            }
            let Some(which) = self.wait(left)? else {
                continue;
            };
            let arrival = self.host.timestamp();
            let frame = self.streams[which].read()?;
            if let (0, Some(frame)) = (which, frame) {
                seen.push((frame.facts().timestamp, arrival));
                newest = Instant::now();
            }
        }
        StreamClock::judge(&seen).map_err(Fault::Away)
    }

    /// Waits until a stream has a frame, for a time that is short enough to notice what else happens.
    pub(super) fn wait(&self, timeout: Duration) -> Result<Option<usize>, Fault> {
        if let Some(why) = self.device.gone() {
            return Err(Fault::Away(format!("{}: {why}", self.device.uri())));
        }
        let short = Duration::from_millis(50);
        let found = match self.streams.as_slice() {
            [depth, color] => stream::wait(&[depth, color], timeout.min(short)),
            [depth] => stream::wait(&[depth], timeout.min(short)),
            _ => Ok(None),
        };
        Ok(found?)
    }

    pub(super) fn silent(&self, limit: Duration) -> Fault {
        Fault::Away(format!(
            "{}: no frame arrived for {:.1} s",
            self.device.uri(),
            limit.as_secs_f64()
        ))
    }

    /// Writes what the camera gives into an `.oni` file until the recorder goes.
    ///
    /// # Errors
    /// If the file cannot be made.
    pub fn record(&self, path: &Path) -> Result<Option<Recorder>, OpenNiError> {
        let streams: Vec<&Stream> = self.streams.iter().collect();
        Recorder::start(path, &streams)
    }
}

impl Drop for Camera {
    fn drop(&mut self) {
        self.stop();
    }
}

/// Opens the configured device: by its URI, its file, its serial number, or the first one that is free.
fn find(library: Library, wanted: &str) -> Result<Device, Fault> {
    if is_file(wanted) || wanted.contains("://") || wanted.contains('@') {
        return Ok(Device::open(library, wanted)?);
    }
    let listed = library.devices()?;
    let free = listed.iter().filter(|(uri, _)| !is_open(uri));
    for (uri, _) in free {
        match Device::open(library, uri) {
            Ok(device) if wanted == "any" || device.serial_number().as_deref() == Some(wanted) => {
                return Ok(device);
            }
            Err(failed) if wanted == "any" => return Err(failed.into()),
            // Another camera, or one that cannot tell its identity.
            Ok(_) | Err(_) => {}
        }
    }
    Err(Fault::Away(missing(wanted, &listed)))
}

fn missing(wanted: &str, listed: &[(String, String)]) -> String {
    let name = |(uri, model): &(String, String)| {
        let used = if is_open(uri) { ", in use" } else { "" };
        format!("{uri} ({model}{used})")
    };
    let there: Vec<String> = listed.iter().map(name).collect();
    let what = match wanted {
        "any" => "no depth camera is free".to_owned(),
        serial => format!("no depth camera has the serial number {serial}"),
    };
    match there.is_empty() {
        true => format!("{what}: OpenNI lists no camera"),
        false => format!("{what}: OpenNI lists {}", there.join(", ")),
    }
}
