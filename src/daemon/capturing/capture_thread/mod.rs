//! The capturing thread's loop: it carries out the requests that reach it (`Order`), one after the other.

mod admission;
mod background;
mod looking;
mod press;
mod sessions;
mod shot;

use super::{CapturePlan, Order, ReloadedSettings};
use crate::daemon::backgrounds;
use crate::daemon::dispatcher::Dispatcher;
use crate::daemon::events::Event;
use crate::daemon::look::{LookMaker, LookScheduler};
use crate::daemon::notes::NoteEffects;
use crate::daemon::recorder::{Answer, Recorder, RecorderTask};
use crate::daemon::rig::{Rig, ShotResult, State};
use crate::daemon::status::{self, Status};
use crate::daemon::systemd::Heartbeat;
use crate::drivers::live::Message;
use crate::frame::{CameraId, Frame};
use crate::log;
use crate::recording::SessionHeader;
use crate::storage::free_bytes;
use crate::sync::Synchronizer;
use crossbeam_channel::{Receiver, select};
use parking_lot::Mutex;
use shot::cameras;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Since how many hours a file has its content.
fn age_h(path: &Path) -> Option<f64> {
    let written = path.metadata().and_then(|file| file.modified()).ok()?;
    Some(written.elapsed().unwrap_or_default().as_secs_f64() / 3600.0)
}

pub(super) struct CaptureThread {
    rig: Rig,
    plan: CapturePlan,
    recorder: Recorder,
    dispatcher: Arc<Dispatcher>,
    shared: Arc<Mutex<Status>>,
    synchronizer: Synchronizer<Frame>,
    session: Option<SessionNaming>,
    note_effects: Arc<NoteEffects>,
    /// Frames that each camera lost since the start.
    lost: BTreeMap<String, u64>,
    looking: LookScheduler,
    heartbeat: Heartbeat,
}

/// A session's name and how many captures it has.
struct SessionNaming {
    name: String,
    captures: u32,
}

impl CaptureThread {
    pub(super) fn new(
        rig: Rig,
        mut plan: CapturePlan,
        recorder: Recorder,
        dispatcher: Arc<Dispatcher>,
        note_effects: Arc<NoteEffects>,
        shared: Arc<Mutex<Status>>,
        looking: LookScheduler,
    ) -> Self {
        // Each turn has a window of its own length.
        plan.sync.window_ms *= rig.turns() as f64;
        let cameras = cameras(&rig);
        let colors: Vec<CameraId> = cameras.colors.iter().cloned().collect();
        plan.header.backgrounds =
            backgrounds::newest(&plan.recording.folder, &colors, rig.clock().timestamp());
        Self {
            synchronizer: Synchronizer::new(cameras, plan.sync.clone()),
            rig,
            heartbeat: plan.watchdog.heartbeat("capturing"),
            plan,
            recorder,
            dispatcher,
            shared,
            note_effects,
            session: None,
            lost: BTreeMap::new(),
            looking,
        }
    }

    /// Serves until no thread can send orders any more, then completes the session and ends all threads.
    pub(super) fn run(mut self, orders: &Receiver<Order>) -> Vec<CameraId> {
        let events = self.rig.events().clone();
        let ticks = crossbeam_channel::tick(Heartbeat::INTERVAL);
        self.publish();
        let look_made = self
            .looking
            .maker
            .as_ref()
            .map(|maker| maker.done().clone());
        let look_made = look_made.unwrap_or_else(crossbeam_channel::never);
        loop {
            self.heartbeat.tick();
            let look = self.next_look();
            select! {
                recv(orders) -> order => {
                    let Ok(order) = order else { break };
                    self.carry_out(order);
                    self.publish();
                }
                recv(events) -> message => if message.is_ok_and(|message| self.note(message)) {
                    self.publish();
                },
                recv(ticks) -> _ => self.publish(),
                recv(look_made) -> _ => self.looking.maker.iter_mut().for_each(LookMaker::finished),
                recv(look) -> _ => {}
            }
            self.look_on(!orders.is_empty());
        }
        let Self {
            rig,
            recorder,
            looking,
            ..
        } = self;
        looking.maker.into_iter().for_each(LookMaker::stop);
        recorder.stop();
        drop(events);
        rig.stop(Instant::now() + Duration::from_secs(5))
    }

    fn carry_out(&mut self, order: Order) {
        // Only shots keep others waiting. All other orders are done at once, so that a client that hears the answer and
        // asks again finds the daemon free.
        if !matches!(order, Order::Press(..) | Order::Background(_)) {
            self.dispatcher.presses().release();
        }
        match order {
            Order::Press(press, guard) => self.press(&press, &guard),
            Order::Background(answer) => {
                let taken = self.take_backgrounds();
                self.dispatcher.presses().release();
                answer(taken);
            }
            Order::Begin(name, about, answer) => self.begin(&name, about, answer),
            Order::Note(note, answer) => self.write_down(note, answer),
            Order::Close(answer) => {
                self.session = None;
                let events = self.plan.events.clone();
                let answer: Answer = Box::new(move |closed| {
                    if closed.is_ok() {
                        events.publish(Event::Session { name: None });
                    }
                    answer(closed);
                });
                self.hand_over(RecorderTask::Close(answer));
            }
            Order::Reload(settings, answer) => {
                self.reload(*settings);
                answer(Ok("the changed settings are in use".into()));
            }
        }
    }

    fn reload(&mut self, reloaded: ReloadedSettings) {
        let CapturePlan {
            capture,
            recording,
            calibration,
            header,
            look,
            ..
        } = &mut self.plan;
        *capture = reloaded.capture;
        *recording = reloaded.recording;
        *calibration = reloaded.calibration;
        if let Some(look) = look {
            look.cutting = reloaded.cutting;
        }
        *header = SessionHeader {
            settings: std::mem::take(&mut header.settings),
            backgrounds: std::mem::take(&mut header.backgrounds),
            ..reloaded.header
        };
        self.header_changed();
    }

    /// Records a camera's new state, and logs it if the camera becomes ready or away. Returns whether it does.
    fn note(&mut self, message: Message) -> bool {
        let id = message.camera.clone();
        let changed = self.rig.note(message);
        if changed {
            self.tell_state(id);
        }
        changed
    }

    /// Logs and publishes a camera's new state; its settings go into the recordings.
    fn tell_state(&mut self, id: CameraId) {
        let states = self.rig.states().find(|(camera, ..)| **camera == id);
        match states.map(|(.., state)| state.clone()) {
            Some(State::Ready(info)) => {
                log::notice!("camera {id} is ready: {}", info.identity);
                self.tell_camera(&id, "ready", info.identity);
                if let Some(settings) = info.settings {
                    self.plan.header.settings.insert(id, settings);
                    self.header_changed();
                }
            }
            Some(State::Away(fault)) => {
                log::warning!("camera {id}: {fault}");
                self.tell_camera(&id, "away", fault.to_string());
            }
            _ => {}
        }
    }

    fn tell_camera(&self, id: &CameraId, state: &str, words: String) {
        self.plan.events.publish(Event::Camera {
            id: id.to_string(),
            state: state.into(),
            words,
        });
    }

    /// Logs what happened during a shot apart from its frames: cameras that became ready or away, and what was lost.
    fn note_shot(&mut self, result: &ShotResult) {
        for id in &result.changed {
            self.tell_state(id.clone());
        }
        for (id, answer) in &result.answers {
            let lost = answer.as_ref().map_or(&[][..], |stats| &stats.lost);
            for words in lost {
                log::error!("camera {id} lost data: {words}");
            }
            *self.lost.entry(id.to_string()).or_default() += lost.len() as u64;
        }
    }

    /// Gives the recorder a piece of work. If its queue is full, the client that waits gets an answer that says so.
    fn hand_over(&mut self, work: RecorderTask) -> bool {
        let refused = self.recorder.hand_over(work).err();
        let handed = refused.is_none();
        refused.into_iter().for_each(RecorderTask::refuse);
        handed
    }

    /// Shows how the rig and the disk are. The presses' figures are added when a client asks for the status.
    fn publish(&self) {
        let bytes = self.capture_bytes();
        let free = free_bytes(&self.plan.recording.folder).unwrap_or(0);
        let usable = self.usable(free).unwrap_or(0);
        let status = Status {
            cameras: status::cameras(&self.rig, &self.lost),
            session: self.session.as_ref().map(|s| s.name.clone()),
            late_frames: self.rig.late_frames(),
            capture_bytes: bytes,
            captures_left: usable.checked_div(bytes).unwrap_or(0),
            waiting: self.recorder.waiting(),
            memory: [self.plan.pool.allocated(), self.plan.pool.limit()],
            plates_age_h: self.backgrounds_age_h(),
            calibration_age_h: self.plan.calibration.as_deref().and_then(age_h),
            goes_on_without_missing: self.plan.sync.go_on_without_missing,
            ..Status::default()
        };
        *self.shared.lock() = status;
    }
}
