//! What the capturing thread does with its orders, one after the other.

mod background;
mod press;
mod room;
mod sessions;
mod shot;

use super::turn::Turn;
use super::{Answer, Ended, Order, Plan, Reread};
use crate::daemon::events::Event;
use crate::daemon::plates;
use crate::daemon::recorder::{Done, Recorder, Work};
use crate::daemon::rig::{Rig, Shooting, State};
use crate::daemon::status::{self, Status};
use crate::daemon::systemd::Heart;
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
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

pub(super) struct Worker {
    rig: Rig,
    plan: Plan,
    recorder: Recorder,
    busy: Arc<AtomicBool>,
    shared: Arc<Mutex<Status>>,
    synchronizer: Synchronizer<Frame>,
    session: Option<Naming>,
    /// Frames that each camera lost since the start.
    lost: BTreeMap<String, u64>,
    refused: u64,
    last_refusal: Option<Instant>,
    ended: Arc<Ended>,
    heart: Heart,
}

/// A session's name and how many captures it has.
struct Naming {
    name: String,
    captures: u32,
}

impl Worker {
    pub(super) fn new(
        rig: Rig,
        mut plan: Plan,
        recorder: Recorder,
        busy: Arc<AtomicBool>,
        shared: Arc<Mutex<Status>>,
        ended: Arc<Ended>,
    ) -> Self {
        // Each turn has a window of its own length.
        plan.sync.window_ms *= rig.turns() as f64;
        let cameras = cameras(&rig);
        let colors: Vec<CameraId> = cameras.colors.iter().cloned().collect();
        plan.preamble.backgrounds =
            plates::newest(&plan.recording.folder, &colors, rig.clock().timestamp());
        Self {
            synchronizer: Synchronizer::new(cameras, plan.sync.clone()),
            rig,
            heart: plan.pulse.heart("capturing"),
            plan,
            recorder,
            busy,
            shared,
            session: None,
            lost: BTreeMap::new(),
            refused: 0,
            last_refusal: None,
            ended,
        }
    }

    /// Serves until nobody can give orders any more, then completes the session and ends all threads.
    pub(super) fn run(mut self, orders: &Receiver<Order>) -> Vec<CameraId> {
        let events = self.rig.events().clone();
        let ticks = crossbeam_channel::tick(Heart::REST);
        loop {
            self.publish();
            self.heart.beat();
            select! {
                recv(orders) -> order => {
                    let Ok(order) = order else { break };
                    let turn = Turn::of(&self.busy);
                    self.carry_out(turn.ended_by_answer_to(order));
                    turn.end();
                }
                recv(events) -> message => if let Ok(message) = message {
                    self.note(message);
                },
                recv(ticks) -> _ => {}
            }
        }
        let Self { rig, recorder, .. } = self;
        recorder.stop();
        drop(events);
        rig.stop(Instant::now() + Duration::from_secs(5))
    }

    fn carry_out(&mut self, order: Order) {
        match order {
            Order::Press(press) => self.press(press),
            Order::Background(answer) => answer(self.take_plates()),
            Order::Begin(name, about, answer) => self.begin(&name, about, answer),
            Order::Note(note, answer) => self.write_down(note, answer),
            Order::Close(answer) => {
                self.session = None;
                self.plan.events.publish(Event::Session { name: None });
                self.pass_on(answer, Work::Close);
            }
            Order::Reread(reread, answer) => self.reread(*reread, answer),
        }
    }

    fn reread(&mut self, reread: Reread, answer: Answer) {
        let Plan {
            capture,
            recording,
            preamble,
            ..
        } = &mut self.plan;
        *capture = reread.capture;
        *recording = reread.recording;
        *preamble = SessionHeader {
            settings: std::mem::take(&mut preamble.settings),
            backgrounds: std::mem::take(&mut preamble.backgrounds),
            ..reread.preamble
        };
        self.preamble_changed();
        answer(Ok("what may change was read again".into()));
    }

    /// Notes what a camera says, and tells the log when that changes what can be done.
    fn note(&mut self, message: Message) {
        let id = message.camera.clone();
        if self.rig.note(message) {
            self.tell_state(id);
        }
    }

    /// Tells the log and who listens what a camera is now; what it is set to goes into the recordings.
    fn tell_state(&mut self, id: CameraId) {
        let states = self.rig.states().find(|(camera, ..)| **camera == id);
        match states.map(|(.., state)| state.clone()) {
            Some(State::Ready(confirmed)) => {
                log::notice!("camera {id}: ready, {}", confirmed.identity);
                self.tell_camera(&id, "ready", confirmed.identity);
                if let Some(settings) = confirmed.settings {
                    self.plan.preamble.settings.insert(id, settings);
                    self.preamble_changed();
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

    /// What is to be known of a shot beside its frames: cameras that came or went meanwhile, and what was lost.
    fn note_shot(&mut self, shooting: &Shooting) {
        for id in &shooting.changed {
            self.tell_state(id.clone());
        }
        for (id, answer) in &shooting.answers {
            let lost = answer.as_ref().map_or(&[][..], |tally| &tally.lost);
            for words in lost {
                log::error!("camera {id}: lost: {words}");
            }
            *self.lost.entry(id.to_string()).or_default() += lost.len() as u64;
        }
    }

    /// Gives the recorder a piece of work whose end is the answer.
    fn pass_on(&mut self, answer: Answer, work: impl FnOnce(Done) -> Work) {
        let (told, failed) = split(answer);
        let done: Done = Box::new(move |written| told(written.map(|_| "done".into())));
        if !self.recorder.hand_over(work(done)) {
            failed(Err("the disk is behind".into()));
        }
    }

    fn publish(&self) {
        let bytes = self.capture_bytes();
        let free = free_bytes(&self.plan.recording.folder).unwrap_or(0);
        let usable = free.saturating_sub(self.plan.recording.keep_free_mb * 1_000_000);
        let status = Status {
            cameras: status::cameras(&self.rig, &self.lost),
            session: self.session.as_ref().map(|s| s.name.clone()),
            complete: self.ended.complete(),
            failed: self.ended.failed(),
            takes_ms: self.ended.takes.spreads(),
            refused: self.refused,
            late_frames: self.rig.late_frames(),
            capture_bytes: bytes,
            captures_left: usable.checked_div(bytes).unwrap_or(0),
            waiting: self.recorder.waiting(),
            memory: [self.plan.pool.allocated(), self.plan.pool.limit()],
            plates_age_h: self.plates_age_h(),
            models: None,
        };
        *self.shared.lock() = status;
    }
}

/// An answer that one of two may give.
fn split(answer: Answer) -> (Answer, Answer) {
    let shared = Arc::new(Mutex::new(Some(answer)));
    let half = |shared: Arc<Mutex<Option<Answer>>>| -> Answer {
        Box::new(move |result| {
            let answer = shared.lock().take();
            if let Some(answer) = answer {
                answer(result);
            }
        })
    };
    (half(shared.clone()), half(shared))
}
