//! One GigE Vision camera: opened, set, and asked for the frames of a shot. How it is set, streams and keeps time stands
//! in the files beside this one.

use super::action::{ActionCommand, ActionGroup, send_action};
use super::clock::CameraClock;
use super::features::{Features, no_answer};
use super::find::{Found, find, take_control};
use super::gvcp::{self, identify};
use super::parameters::{ExposureMark, Parameters, TriggerMode};
use super::precision_time::PrecisionTime;
use super::settings::{Set, Setting};
use super::stream::{Arrival, Frames, Layout};
use crate::drivers::live::{Confirmed, Device, Driver, Fault, HostClock, Pool, Shot, Tally};
use crate::frame::{CameraId, Frame, Stream, Timestamp};
use aravis::prelude::*;
use aravis::{Buffer, Camera, GvDevice};
use std::collections::VecDeque;
use std::net::SocketAddrV4;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

/// Opens one GigE Vision camera, again and again if need be.
pub struct GigeDriver {
    id: CameraId,
    parameters: Parameters,
    pool: Pool,
    clock: HostClock,
    actions: ActionGroup,
}

impl GigeDriver {
    /// A driver for the camera `id` of the rig. All cameras of the rig share `pool`, `clock` and `actions`.
    pub fn new(
        id: CameraId,
        parameters: Parameters,
        pool: Pool,
        clock: HostClock,
        actions: ActionGroup,
    ) -> Self {
        Self {
            id,
            parameters,
            pool,
            clock,
            actions,
        }
    }
}

impl Driver for GigeDriver {
    fn open(&mut self) -> Result<Box<dyn Device>, Fault> {
        Ok(Box::new(Held(Some(OpenCamera::open(self)?))))
    }
}

/// How long a camera is asked whether it is there, at least.
const CHECK_PERIOD: Duration = Duration::from_secs(2);
/// How often frames of a camera that nobody triggers are looked after.
const KEEP_PERIOD: Duration = Duration::from_millis(20);
/// Frames that are kept of such a camera.
const KEPT: usize = 3;
/// How much earlier than the daemon's trigger a line may have started the exposure: what a signal takes through a
/// switch, USB and a socket.
const LINE_LEAD: Duration = Duration::from_millis(50);
/// How long a frame may still come after a damaged one whose stamp was lost.
const AFTER_DAMAGE: Duration = Duration::from_millis(250);

struct OpenCamera {
    id: CameraId,
    parameters: Parameters,
    pool: Pool,
    clock: HostClock,
    actions: ActionGroup,
    found: Found,
    confirmed: Confirmed,
    /// Whole frames that no shot has asked for yet, the oldest first. They go before their stream.
    kept: VecDeque<(Timestamp, Buffer)>,
    frames: Frames,
    camera_clock: CameraClock,
    precision_time: Option<PrecisionTime>,
    camera: Camera,
    device: GvDevice,
    control_lost: Arc<AtomicBool>,
    checked: Instant,
}

impl OpenCamera {
    fn open(driver: &GigeDriver) -> Result<Self, Fault> {
        let parameters = driver.parameters.clone();
        let found = find(&parameters)?;
        let (device, camera) = take_control(&found)?;
        let control_lost = Arc::new(AtomicBool::new(false));
        let lost = control_lost.clone();
        device.connect_control_lost(move |_| lost.store(true, Ordering::Relaxed));
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
        let mut frames = Frames::open(&camera, &parameters, layout)?;
        let camera_clock = CameraClock::find(&camera, &device, driver.clock);
        frames.begin();
        let confirmed = confirmed(&found, set, table);
        let mut open = Self {
            id: driver.id.clone(),
            parameters,
            pool: driver.pool.clone(),
            clock: driver.clock,
            actions: driver.actions.clone(),
            found,
            confirmed,
            kept: VecDeque::new(),
            frames,
            camera_clock,
            precision_time,
            camera,
            device,
            control_lost,
            checked: Instant::now(),
        };
        open.remark();
        let started = open.camera.start_acquisition();
        started.map_err(|e| Fault::Away(format!("it does not start: {}", e.message())))?;
        Ok(open)
    }

    fn mode(&self) -> TriggerMode {
        self.parameters.trigger_mode()
    }

    /// Notes what works and yet should be known.
    fn remark(&mut self) {
        let remarks = &mut self.confirmed.remarks;
        if !self.camera_clock.can_be_read() {
            remarks
                .push("its clock cannot be read, only estimated from when its frames come".into());
        }
        if let Some(precision_time) = &self.precision_time {
            let (Ok(words) | Err(words)) = precision_time.state(&self.camera);
            remarks.push(words);
        }
        match self.camera.gv_get_packet_size() {
            Ok(size) if size < 4_000 => remarks.push(format!(
                "its packets have {size} bytes: jumbo frames would spare the host most of its work"
            )),
            _ => {}
        }
    }

    /// Whether it still obeys us.
    fn in_control(&self) -> Result<(), Fault> {
        if self.control_lost.load(Ordering::Relaxed) {
            return Err(Fault::Away(format!(
                "{}: it does not answer any more, or another program took control of it",
                self.found.address
            )));
        }
        Ok(())
    }

    /// Asks the camera whether it is there. Not through the library, which would wait for a lost camera five times as
    /// long.
    fn check(&mut self) -> Result<(), Fault> {
        self.checked = Instant::now();
        match identify(self.found.address) {
            Ok(identity) if identity.serial == self.found.identity.serial => self.in_control(),
            Ok(other) => Err(Fault::Away(format!(
                "{} is another camera now, with serial {}",
                self.found.address, other.serial
            ))),
            Err(error) => {
                self.control_lost.store(true, Ordering::Relaxed);
                Err(Fault::Away(format!(
                    "no answer from {} ({error})",
                    self.found.address
                )))
            }
        }
    }

    /// When the exposure of a frame began, on the host's timeline.
    fn begin_of(
        &mut self,
        stamp_ns: u64,
        not_before: Option<Timestamp>,
    ) -> Result<Timestamp, String> {
        let time = self.camera_clock.host_time(stamp_ns, not_before)?;
        match self.parameters.exposure_mark.unwrap_or_default() {
            ExposureMark::Start => Ok(time),
            ExposureMark::End => {
                let settings = self.confirmed.settings.as_ref();
                let exposure = settings.and_then(|s| s.exposure).unwrap_or(0.0);
                Ok(Timestamp(time.0.saturating_sub((exposure * 1e9) as u64)))
            }
        }
    }

    /// Drops every frame that has come.
    fn drain(&mut self, tally: &mut Tally) {
        while let Some(arrival) = self.frames.next() {
            if let Arrival::Whole(buffer) = arrival {
                self.frames.give_back(buffer);
                tally.unused += 1;
            }
        }
    }

    /// Keeps the newest of the frames that have come.
    fn keep_newest(&mut self, tally: &mut Tally) {
        while let Some(arrival) = self.frames.next() {
            match arrival {
                Arrival::Whole(buffer) => self.keep(buffer, tally),
                // Nobody has asked for it.
                Arrival::Damaged(..) | Arrival::Nothing => {}
            }
        }
    }

    fn keep(&mut self, buffer: Buffer, tally: &mut Tally) {
        match self.begin_of(buffer.timestamp(), None) {
            Ok(time) => self.kept.push_back((time, buffer)),
            Err(why) => {
                self.frames.give_back(buffer);
                tally.lost.push(why);
            }
        }
        while self.kept.len() > KEPT {
            if let Some((_, oldest)) = self.kept.pop_front() {
                self.frames.give_back(oldest);
                tally.unused += 1;
            }
        }
    }

    /// Hands a frame over.
    fn deliver(
        &self,
        time: Timestamp,
        buffer: Buffer,
        tally: &mut Tally,
        take: &mut dyn FnMut(Frame),
    ) {
        match self.frames.copy(buffer, &self.pool) {
            Some(picture) => take(Frame {
                camera: self.id.clone(),
                stream: Stream::Color,
                timestamp: time,
                picture,
            }),
            None => tally.lost.push(format!(
                "no room for a frame: {} of the {} bytes for frames are in use",
                self.pool.allocated(),
                self.pool.limit()
            )),
        }
    }

    /// Waits for the frame of a trigger that was given at `triggered` or soon after, and hands it over; false if none came.
    fn await_triggered(
        &mut self,
        shot: &Shot,
        triggered: Timestamp,
        tally: &mut Tally,
        take: &mut dyn FnMut(Frame),
    ) -> Result<bool, Fault> {
        let mut until = shot.deadline;
        while let Some(arrival) = self.next_arrival(shot, until)? {
            match arrival {
                Arrival::Nothing => {}
                Arrival::Damaged(why, stamp) => {
                    let time = stamp.and_then(|ns| self.camera_clock.host_of(ns));
                    if time.is_some_and(|t| triggered.nanoseconds_since(t) > STALE_NS) {
                        // Of a trigger before.
                        continue;
                    }
                    tally.lost.push(why);
                    until = until.min(Instant::now() + AFTER_DAMAGE);
                }
                Arrival::Whole(buffer) => {
                    match self.begin_of(buffer.timestamp(), Some(triggered)) {
                        Ok(time) => {
                            self.deliver(time, buffer, tally, take);
                            return Ok(true);
                        }
                        Err(why) => {
                            self.frames.give_back(buffer);
                            tally.lost.push(why);
                        }
                    }
                }
            }
        }
        Ok(false)
    }

    /// Waits for the next frame; `None` when the time is over.
    fn next_arrival(&self, shot: &Shot, until: Instant) -> Result<Option<Arrival>, Fault> {
        const SLICE: Duration = Duration::from_millis(50);
        loop {
            let left = shot
                .remaining()
                .min(until.saturating_duration_since(Instant::now()));
            let arrival = match left.is_zero() {
                true => self.frames.next(),
                false => self.frames.wait(left.min(SLICE)),
            };
            if arrival.is_some() || left.is_zero() {
                return Ok(arrival);
            }
            self.in_control()?;
        }
    }

    fn shoot_software(
        &mut self,
        shot: &Shot,
        tally: &mut Tally,
        take: &mut dyn FnMut(Frame),
    ) -> Result<(), Fault> {
        self.drain(tally);
        let triggered = self.clock.now();
        if let Err(error) = self.camera.software_trigger() {
            if no_answer(&error) {
                self.control_lost.store(true, Ordering::Relaxed);
                let (address, why) = (self.found.address, error.message());
                return Err(Fault::Away(format!(
                    "{address}: no answer to a trigger: {why}"
                )));
            }
            tally.lost.push(format!(
                "the camera declined the trigger: {}",
                error.message()
            ));
            return Ok(());
        }
        let came = self.await_triggered(shot, triggered, tally, take)?;
        self.miss(came, shot, tally)
    }

    fn shoot_action(
        &mut self,
        shot: &Shot,
        tally: &mut Tally,
        take: &mut dyn FnMut(Frame),
    ) -> Result<(), Fault> {
        self.drain(tally);
        let scheduled = match self.schedule(shot) {
            Ok(scheduled) => scheduled,
            Err(why) => {
                tally.lost.push(why);
                return Ok(());
            }
        };
        let came = self.await_triggered(shot, scheduled, tally, take)?;
        self.miss(came, shot, tally)
    }

    /// Tells the camera when to expose; the host's time of that.
    fn schedule(&mut self, shot: &Shot) -> Result<Timestamp, String> {
        if let Some(precision_time) = &self.precision_time {
            precision_time.state(&self.camera)?;
        }
        let lead = (self.parameters.action_lead.unwrap_or(0.02) * 1e9) as u64;
        let proposed = Timestamp(self.clock.now().0 + lead);
        let proposed = self.camera_clock.device_time(proposed);
        let proposed =
            proposed.ok_or("its clock cannot be read, so that nothing can be scheduled")?;
        let at_ns = self.actions.agree(shot.number, proposed);
        let command = ActionCommand {
            device_key: self.parameters.action_device_key.unwrap_or(0),
            group_key: self.parameters.action_group_key.unwrap_or(1),
            group_mask: self.parameters.action_group_mask.unwrap_or(1),
            at_ns: Some(at_ns),
        };
        // 0 is no request.
        let request = (shot.number % 0xffff) as u16 + 1;
        send_action(
            SocketAddrV4::new(self.found.address, gvcp::PORT),
            &command,
            request,
        )?;
        let host = self.camera_clock.host_of(at_ns);
        host.ok_or_else(|| "its clock was never read".into())
    }

    /// A line started the exposure, perhaps before the daemon heard of the trigger.
    fn shoot_line(
        &mut self,
        shot: &Shot,
        tally: &mut Tally,
        take: &mut dyn FnMut(Frame),
    ) -> Result<(), Fault> {
        let earliest = Timestamp(shot.trigger.0.saturating_sub(LINE_LEAD.as_nanos() as u64));
        self.keep_newest(tally);
        let mut came = false;
        while let Some((time, buffer)) = self.kept.pop_front() {
            if time >= earliest && !came {
                self.deliver(time, buffer, tally, take);
                came = true;
            } else {
                self.frames.give_back(buffer);
                tally.unused += 1;
            }
        }
        let came = came || self.await_triggered(shot, earliest, tally, take)?;
        self.miss(came, shot, tally)
    }

    /// The last frame before the trigger and the first from then on.
    fn shoot_free_run(
        &mut self,
        shot: &Shot,
        tally: &mut Tally,
        take: &mut dyn FnMut(Frame),
    ) -> Result<(), Fault> {
        self.keep_newest(tally);
        while self
            .kept
            .back()
            .is_none_or(|(time, _)| *time < shot.trigger)
        {
            match self.next_arrival(shot, shot.deadline)? {
                Some(Arrival::Whole(buffer)) => self.keep(buffer, tally),
                Some(Arrival::Damaged(why, _)) => tally.lost.push(why),
                Some(Arrival::Nothing) => {}
                None => break,
            }
        }
        let after = self.kept.iter().position(|(time, _)| *time >= shot.trigger);
        let before = after.map_or(self.kept.len().checked_sub(1), |i| i.checked_sub(1));
        let kept = std::mem::take(&mut self.kept);
        for (i, (time, buffer)) in kept.into_iter().enumerate() {
            if Some(i) == before || Some(i) == after {
                self.deliver(time, buffer, tally, take);
            } else {
                self.frames.give_back(buffer);
                tally.unused += 1;
            }
        }
        self.miss(after.is_some(), shot, tally)
    }

    /// Tells of a frame that did not come, and finds out whether the camera is still there.
    fn miss(&mut self, came: bool, shot: &Shot, tally: &mut Tally) -> Result<(), Fault> {
        if came || shot.abandoned.load(Ordering::Relaxed) {
            return Ok(());
        }
        if tally.lost.is_empty() {
            let waited = self.clock.now().nanoseconds_since(shot.trigger) as f64 / 1e9;
            tally
                .lost
                .push(format!("no frame came within {waited:.2} s of the trigger"));
        }
        self.check()
    }
}

/// How much older than its trigger a damaged frame is that belongs to another one.
const STALE_NS: i128 = 50_000_000;

impl OpenCamera {
    fn shoot(&mut self, shot: &Shot, take: &mut dyn FnMut(Frame)) -> Result<Tally, Fault> {
        self.in_control()?;
        // A camera that is gone is told now, and not when the library gives up.
        self.check()?;
        self.camera_clock.keep_known(&self.camera, &self.device);
        let mut tally = Tally::default();
        let outcome = match self.mode() {
            TriggerMode::Software => self.shoot_software(shot, &mut tally, take),
            TriggerMode::Action => self.shoot_action(shot, &mut tally, take),
            TriggerMode::Line => self.shoot_line(shot, &mut tally, take),
            TriggerMode::FreeRun => self.shoot_free_run(shot, &mut tally, take),
        };
        self.frames.count(&mut tally);
        if let Some(precision_time) = &self.precision_time {
            let (Ok(words) | Err(words)) = precision_time.state(&self.camera);
            tally.remarks.push(words);
        }
        outcome.map(|()| tally)
    }

    fn idle(&mut self) -> Result<(), Fault> {
        match self.mode() {
            TriggerMode::Software | TriggerMode::Action => self.drain(&mut Tally::default()),
            TriggerMode::Line | TriggerMode::FreeRun => self.keep_newest(&mut Tally::default()),
        }
        self.in_control()?;
        if self.checked.elapsed() >= CHECK_PERIOD {
            self.check()?;
            self.camera_clock.keep_known(&self.camera, &self.device);
        }
        Ok(())
    }

    fn idle_period(&self) -> Duration {
        match self.mode() {
            TriggerMode::Software | TriggerMode::Action => CHECK_PERIOD,
            TriggerMode::Line | TriggerMode::FreeRun => KEEP_PERIOD,
        }
    }

    fn is_lost(&self) -> bool {
        self.control_lost.load(Ordering::Relaxed)
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
struct Held(Option<OpenCamera>);

/// What cannot be: the camera is taken out when it is dropped alone.
fn nobody() -> Fault {
    Fault::Away("the camera was closed".into())
}

impl Device for Held {
    fn confirmed(&self) -> &Confirmed {
        static NONE: OnceLock<Confirmed> = OnceLock::new();
        let open = self.0.as_ref().map(|camera| &camera.confirmed);
        open.unwrap_or_else(|| NONE.get_or_init(Confirmed::default))
    }

    fn shoot(&mut self, shot: &Shot, take: &mut dyn FnMut(Frame)) -> Result<Tally, Fault> {
        self.0.as_mut().ok_or_else(nobody)?.shoot(shot, take)
    }

    fn idle(&mut self) -> Result<(), Fault> {
        self.0.as_mut().ok_or_else(nobody)?.idle()
    }

    fn idle_period(&self) -> Duration {
        self.0
            .as_ref()
            .map_or(CHECK_PERIOD, OpenCamera::idle_period)
    }
}

impl Drop for Held {
    /// The library says good-bye to a camera three times and waits for its answer; one that is lost is buried on a thread
    /// of its own, so that the camera can be looked for meanwhile.
    fn drop(&mut self) {
        if let Some(camera) = self.0.take().filter(OpenCamera::is_lost) {
            let thread = std::thread::Builder::new().name("lost camera".into());
            let _ = thread.spawn(move || drop(camera));
        }
    }
}

fn confirmed(found: &Found, set: Set, table: Vec<[String; 3]>) -> Confirmed {
    let identity = &found.identity;
    Confirmed {
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
