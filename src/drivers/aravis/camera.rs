//! One GigE Vision camera: opened, polled and closed. Its settings, shots, stream and clock are in the files of this
//! folder that are named after them.

use super::action::ActionGroup;
use super::binning::{BinnedLooks, Experience};
use super::clock::CameraClock;
use super::features::Features;
use super::find::{Found, find, take_control};
use super::gvcp::identify;
use super::parameters::{Parameters, TriggerMode};
use super::precision_time::PrecisionTime;
use super::settings::{AppliedSettings, Setting};
use super::stream::{Frames, Layout};
use crate::clock::Clock;
use crate::drivers::live::{CameraInfo, Device, Driver, Fault, Pool, Shot, ShotStats};
use crate::frame::{CameraId, Frame, Timestamp};
use aravis::prelude::*;
use aravis::{Buffer, Camera, GvDevice};
use std::collections::VecDeque;
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

/// Opens one GigE Vision camera, again and again if need be.
pub struct GigeDriver {
    id: CameraId,
    parameters: Parameters,
    pool: Pool,
    clock: Clock,
    actions: ActionGroup,
    binning: Arc<Experience>,
}

impl GigeDriver {
    /// A driver for the camera `id` of the rig. All cameras of the rig share `pool`, `clock` and `actions`.
    pub fn new(
        id: CameraId,
        parameters: Parameters,
        pool: Pool,
        clock: Clock,
        actions: ActionGroup,
    ) -> Self {
        Self {
            id,
            parameters,
            pool,
            clock,
            actions,
            binning: Arc::default(),
        }
    }
}

impl Driver for GigeDriver {
    fn open(&mut self) -> Result<Box<dyn Device>, Fault> {
        Ok(Box::new(OpenedCamera(Some(OpenCamera::open(self)?))))
    }
}

/// How long a camera is asked whether it is there, at least.
const CHECK_PERIOD: Duration = Duration::from_secs(2);
/// How often the frames of a free-running camera are collected.
const KEEP_PERIOD: Duration = Duration::from_millis(20);

/// Names of a camera's temperature in degrees Celsius: of the standard (SFNC), and before it.
const TEMPERATURES: [&str; 2] = ["DeviceTemperature", "TemperatureAbs"];

/// A camera that obeys us.
pub(super) struct OpenCamera {
    pub(super) id: CameraId,
    pub(super) parameters: Parameters,
    pub(super) pool: Pool,
    pub(super) clock: Clock,
    pub(super) actions: ActionGroup,
    pub(super) found: Found,
    pub(super) info: CameraInfo,
    /// Whole frames that no shot has asked for yet, the oldest first. They go before their stream.
    pub(super) kept: VecDeque<(Timestamp, Buffer)>,
    pub(super) frames: Frames,
    pub(super) camera_clock: CameraClock,
    pub(super) precision_time: Option<PrecisionTime>,
    /// `None` where looks are not to be binned.
    pub(super) binned: Option<BinnedLooks>,
    pub(super) camera: Camera,
    pub(super) device: GvDevice,
    /// It did not answer when it was asked.
    pub(super) is_silent: bool,
    pub(super) checked: Instant,
}

impl OpenCamera {
    fn open(driver: &GigeDriver) -> Result<Self, Fault> {
        let parameters = driver.parameters.clone();
        let found = find(&parameters)?;
        let (device, camera) = take_control(&found)?;
        // By itself the library keeps the size that the camera has, and looks for another if that does not get through.
        if parameters.packet_size.is_some() {
            device.set_packet_size_adjustment(aravis::GvPacketSizeAdjustment::Never);
        }
        // A feature that cannot be written is to say so.
        camera.set_access_check_policy(aravis::AccessCheckPolicy::Enable);
        let mut features = Features::of(&camera);
        let precision_time = PrecisionTime::set_up(&mut features, &parameters)?;
        let set = Setting {
            features: &mut features,
            parameters: &parameters,
            device: &device,
        }
        .all()?;
        let table = features.table;
        let layout = Layout {
            format: set.format,
            size: set.size,
            payload: set.payload,
        };
        let binned = BinnedLooks::find(&camera, &parameters, driver.binning.clone());
        let mut frames = Frames::open(&camera, &parameters, layout)?;
        let camera_clock = CameraClock::find(&camera, &device, driver.clock);
        frames.begin();
        let info = info(&found, set, table);
        let mut open = Self {
            id: driver.id.clone(),
            parameters,
            pool: driver.pool.clone(),
            clock: driver.clock,
            actions: driver.actions.clone(),
            found,
            info,
            kept: VecDeque::new(),
            frames,
            camera_clock,
            precision_time,
            binned,
            camera,
            device,
            is_silent: false,
            checked: Instant::now(),
        };
        open.remark();
        let started = open.camera.start_acquisition();
        started.map_err(|e| Fault::Away(format!("it cannot start its stream: {}", e.message())))?;
        open.try_binned_looks()?;
        Ok(open)
    }

    pub(super) fn mode(&self) -> TriggerMode {
        self.parameters.trigger_mode()
    }

    /// Notes what works and yet should be known.
    fn remark(&mut self) {
        let remarks = &mut self.info.remarks;
        if !self.camera_clock.can_be_read() {
            remarks.push(
                "its clock cannot be read, only estimated from when its frames arrive".into(),
            );
        }
        if let Some(precision_time) = &self.precision_time {
            let (Ok(words) | Err(words)) = precision_time.state(&self.camera);
            remarks.push(words);
        }
        match self.camera.gv_get_packet_size() {
            Ok(size) if size < 4_000 => remarks.push(format!(
                "its packets have {size} bytes: jumbo frames would save the host most of its work"
            )),
            _ => {}
        }
    }

    /// Whether it still obeys us.
    pub(super) fn in_control(&self) -> Result<(), Fault> {
        if self.is_lost() {
            return Err(Fault::Away(format!(
                "{}: the camera stopped answering, or another program took control of it",
                self.found.address
            )));
        }
        Ok(())
    }

    /// Asks the camera whether it is there. Not through the library, which would wait for a lost camera five times as
    /// long.
    pub(super) fn check(&mut self) -> Result<(), Fault> {
        self.checked = Instant::now();
        match identify(self.found.address) {
            Ok(identity) if identity.serial == self.found.identity.serial => self.in_control(),
            Ok(other) => Err(Fault::Away(format!(
                "{} is another camera now, with serial {}",
                self.found.address, other.serial
            ))),
            Err(error) => {
                self.is_silent = true;
                Err(Fault::Away(format!(
                    "the camera at {} did not answer ({error})",
                    self.found.address
                )))
            }
        }
    }
}

impl OpenCamera {
    pub(super) fn shoot(
        &mut self,
        shot: &Shot,
        take: &mut dyn FnMut(Frame),
    ) -> Result<ShotStats, Fault> {
        self.in_control()?;
        // A camera that is gone is reported now, and not when the library gives up.
        self.check()?;
        self.camera_clock.keep_known(&self.camera, &self.device);
        let mut stats = ShotStats::default();
        let outcome = match self.mode() {
            TriggerMode::Software => self.shoot_software(shot, &mut stats, take),
            TriggerMode::Action => self.shoot_action(shot, &mut stats, take),
            TriggerMode::Line => self.shoot_line(shot, &mut stats, take),
            TriggerMode::FreeRun => self.shoot_free_run(shot, &mut stats, take),
        };
        self.frames.count(&mut stats);
        if let Some(precision_time) = &self.precision_time {
            let (Ok(words) | Err(words)) = precision_time.state(&self.camera);
            stats.remarks.push(words);
        }
        outcome.map(|()| stats)
    }

    fn idle(&mut self) -> Result<(), Fault> {
        match self.mode() {
            TriggerMode::Software | TriggerMode::Action => self.drain(&mut ShotStats::default()),
            TriggerMode::Line | TriggerMode::FreeRun => self.keep_newest(&mut ShotStats::default()),
        }
        self.in_control()?;
        if self.checked.elapsed() >= CHECK_PERIOD {
            self.check()?;
            self.camera_clock.keep_known(&self.camera, &self.device);
        }
        Ok(())
    }

    /// Its temperature, under the standard's name or an older one, and how its clock follows the network's.
    fn health(&self) -> Vec<[String; 2]> {
        let mut health = Vec::new();
        let temperature = |name: &&str| self.camera.float(name).ok();
        if let Some(celsius) = TEMPERATURES.iter().find_map(temperature) {
            health.push(["temperature".into(), format!("{celsius:.1} °C")]);
        }
        if let Some(precision_time) = &self.precision_time {
            let (Ok(words) | Err(words)) = precision_time.state(&self.camera);
            let words = words.strip_prefix("PTP: ").unwrap_or(&words);
            health.push(["PTP".into(), words.into()]);
        }
        health
    }

    fn idle_period(&self) -> Duration {
        match self.mode() {
            TriggerMode::Software | TriggerMode::Action => CHECK_PERIOD,
            TriggerMode::Line | TriggerMode::FreeRun => KEEP_PERIOD,
        }
    }

    /// Whether it has stopped answering, or the library's heartbeat found that we no longer control it.
    ///
    /// The heartbeat's result is asked for, not awaited as the library's signal `control-lost`: while a signal has a
    /// handler, the heartbeat's thread holds a reference to the device. If that is the last one, the thread closes the
    /// device and joins itself, whereupon GLib aborts the process (seen with Aravis 0.8.26 and GLib 2.74).
    fn is_lost(&self) -> bool {
        self.is_silent || !self.device.is_controller()
    }
}

impl Drop for OpenCamera {
    fn drop(&mut self) {
        // One that is away would only hold us up.
        if !self.is_lost() {
            let _ = self.camera.stop_acquisition();
        }
    }
}

/// An open camera as its thread has it; there is always one until it is dropped.
struct OpenedCamera(Option<OpenCamera>);

/// What cannot be: the camera is taken out when it is dropped alone.
fn nobody() -> Fault {
    Fault::Away("the camera was closed".into())
}

impl Device for OpenedCamera {
    fn info(&self) -> &CameraInfo {
        static NONE: OnceLock<CameraInfo> = OnceLock::new();
        let open = self.0.as_ref().map(|camera| &camera.info);
        open.unwrap_or_else(|| NONE.get_or_init(CameraInfo::default))
    }

    fn shoot(&mut self, shot: &Shot, take: &mut dyn FnMut(Frame)) -> Result<ShotStats, Fault> {
        self.0.as_mut().ok_or_else(nobody)?.capture(shot, take)
    }

    fn look(&mut self, shot: &Shot, take: &mut dyn FnMut(Frame)) -> Result<ShotStats, Fault> {
        self.0.as_mut().ok_or_else(nobody)?.look(shot, take)
    }

    fn idle(&mut self) -> Result<(), Fault> {
        self.0.as_mut().ok_or_else(nobody)?.idle()
    }

    fn health(&mut self) -> Vec<[String; 2]> {
        self.0.as_ref().map_or_else(Vec::new, OpenCamera::health)
    }

    fn idle_period(&self) -> Duration {
        self.0
            .as_ref()
            .map_or(CHECK_PERIOD, OpenCamera::idle_period)
    }
}

impl Drop for OpenedCamera {
    /// When the library closes a camera, it sends three messages and waits for the answers. A lost camera is therefore
    /// closed on its own thread, so that scand can search for it meanwhile.
    fn drop(&mut self) {
        if let Some(camera) = self.0.take().filter(OpenCamera::is_lost) {
            let thread = std::thread::Builder::new().name("lost camera".into());
            let _ = thread.spawn(move || drop(camera));
        }
    }
}

fn info(found: &Found, set: AppliedSettings, table: Vec<[String; 3]>) -> CameraInfo {
    let identity = &found.identity;
    CameraInfo {
        identity: format!(
            "{} {}, serial {}, firmware {}, at {}",
            identity.vendor, identity.model, identity.serial, identity.version, found.address
        ),
        size: set.size,
        encoding: set.format.encoding().into(),
        frame_bytes: set.payload as u64,
        settings: Some(set.settings),
        table,
        remarks: Vec::new(),
    }
}
