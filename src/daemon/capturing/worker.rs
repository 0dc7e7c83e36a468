//! What the capturing thread does with its orders, one after the other.

use super::super::events::{Event, Events};
use super::super::plates::{self, Plates};
use super::super::recorder::{Done, Recorder, Work};
use super::super::rig::{Kind, Rig, Shooting, State};
use super::super::status::{self, Status};
use super::super::systemd::Heart;
use super::super::{free_bytes, names};
use super::assemble::assemble;
use super::offer::offer;
use super::{Answer, Ended, Order, Plan, Press, Reread};
use crate::drivers::live::Message;
use crate::frame::{CameraId, CaptureId, Frame, Timestamp, Trigger};
use crate::log;
use crate::recording::{Kept, Note, Outcome, Preamble, Session};
use crate::sync::{self, Capture, Listed, Synchronizer};
use crate::trigger::Reply;
use crossbeam_channel::{Receiver, select};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
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
        let cameras = cameras(&rig);
        let colors: Vec<CameraId> = cameras.colors.iter().cloned().collect();
        plan.preamble.backgrounds = plates::newest(&plan.recording.folder, &colors);
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
                    self.carry_out(order);
                    self.busy.store(false, Ordering::Release);
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
        *preamble = Preamble {
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
        if !self.rig.note(message) {
            return;
        }
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

    /// Takes a capture, and once more if it fails and is to be retried.
    fn press(&mut self, press: Press) {
        let (press, begin) = (Arc::new(press), Instant::now());
        let id = self.ready_for_a_capture().and_then(|()| self.next_id());
        let id = match id {
            Ok(id) => id,
            Err(reason) => return self.refuse(&press, reason),
        };
        let mut name = id.clone();
        for attempt in 1..=self.plan.capture.retry.saturating_add(1) {
            let Ok(capture) = CaptureId::new(&name) else {
                let reason = format!("{name:?} is too long for a capture's id");
                return self.refuse(&press, reason);
            };
            let accepted = Reply::Accepted {
                capture: name.clone(),
            };
            tell(&self.plan.events, &press, accepted);
            self.heart.beat();
            let kept = self.take(capture, &press);
            name = format!("{id}.r{attempt}");
            // A name that the last attempt's would be too long for ends the attempts.
            let last = attempt > self.plan.capture.retry || CaptureId::new(&name).is_err();
            if self.hand_over(kept, &press, begin, last) {
                return;
            }
        }
    }

    /// Refuses a press. Who merely listens hears of one refusal a second.
    fn refuse(&mut self, press: &Press, reason: String) {
        self.refused += 1;
        (press.progress)(Reply::Refused {
            reason: reason.clone(),
        });
        let recent = |last: Instant| last.elapsed() < Duration::from_secs(1);
        if !self.last_refusal.is_some_and(recent) {
            self.last_refusal = Some(Instant::now());
            log::warning!("refused: {reason}");
            self.plan.events.publish(Event::Refused { reason });
        }
    }

    /// Whether a capture can be begun; if not, why.
    fn ready_for_a_capture(&self) -> Result<(), String> {
        if !self.recorder.has_room() {
            return Err(format!(
                "the disk is behind: {} captures wait for it",
                self.recorder.waiting()
            ));
        }
        let bytes = self.capture_bytes();
        let pool = &self.plan.pool;
        if pool.in_use() as u64 + bytes > pool.limit() as u64 {
            return Err(format!(
                "a capture takes {} MB of memory, {} of {} MB are in use (capture.memory_mb)",
                bytes / 1_000_000,
                pool.in_use() / 1_000_000,
                pool.limit() / 1_000_000
            ));
        }
        let folder = &self.plan.recording.folder;
        let free = free_bytes(folder).map_err(|e| format!("{}: {e}", folder.display()))?;
        let kept_free = self.plan.recording.keep_free_mb * 1_000_000;
        // Room for what the recording has beside the pictures, and for the plates of a file that begins.
        if free < kept_free + bytes + bytes / 10 + 1_000_000 {
            return Err(format!(
                "{} has {} MB left, a capture takes {} MB and {} MB stay free (recording.keep_free_mb)",
                folder.display(),
                free / 1_000_000,
                bytes / 1_000_000,
                self.plan.recording.keep_free_mb
            ));
        }
        Ok(())
    }

    /// Bytes of a capture, as the cameras are set.
    fn capture_bytes(&self) -> u64 {
        let frames = |kind| match kind {
            Kind::Color => 1,
            Kind::Depth | Kind::DepthInTurn => self.plan.sync.depth_frames as u64,
        };
        let bytes = self.rig.states().map(|(_, kind, state)| match state {
            State::Ready(confirmed) => confirmed.frame_bytes * frames(kind),
            State::Opening | State::Away(_) => 0,
        });
        bytes.sum()
    }

    /// The next capture's id; begins a session, named by the time, where there is none.
    fn next_id(&mut self) -> Result<String, String> {
        if self.session.is_none() {
            let now = self.rig.clock().now();
            let name = names::free(&self.plan.recording.folder, now);
            self.begin_session(&name, BTreeMap::new(), Box::new(log_error))?;
        }
        let session = self.session.as_mut().ok_or("there is no session")?;
        session.captures += 1;
        Ok(format!("{}-{:04}", session.name, session.captures))
    }

    fn take(&mut self, id: CaptureId, press: &Press) -> Kept {
        let trigger = Trigger {
            id,
            time: self.rig.clock().now(),
            source: press.source.clone(),
            press_id: press.press_id.clone(),
            subject: press.subject.clone(),
        };
        let (capture, shooting) = shoot(
            &mut self.rig,
            &self.plan,
            &mut self.synchronizer,
            |_| true,
            trigger,
        );
        self.count_lost(&shooting);
        let now = self.rig.clock().now();
        assemble(capture, shooting, self.plan.capture.largest_skew_ms, now)
    }

    fn count_lost(&mut self, shooting: &Shooting) {
        for (id, answer) in &shooting.answers {
            let lost = answer.as_ref().map_or(&[][..], |tally| &tally.lost);
            for words in lost {
                log::error!("camera {id}: lost: {words}");
            }
            *self.lost.entry(id.to_string()).or_default() += lost.len() as u64;
        }
    }

    /// Gives a capture to the recorder. True if the press has its end: it is complete, or was the last attempt.
    fn hand_over(&mut self, kept: Kept, press: &Arc<Press>, begin: Instant, last: bool) -> bool {
        let capture = kept.record.id.clone();
        let reason = kept.record.reason.clone().unwrap_or_default();
        let complete = kept.record.outcome == Outcome::Complete;
        if complete {
            let captured = Reply::Captured {
                capture: capture.clone(),
                skew_ns: kept.record.skew_ns.unwrap_or(0),
            };
            tell(&self.plan.events, press, captured);
            self.ended.takes.note("captured", begin.elapsed());
        } else if !last {
            let retried = Reply::Retried {
                capture: capture.clone(),
                reason: reason.clone(),
            };
            tell(&self.plan.events, press, retried);
        }
        let ends = complete || last;
        let ended = self.ended.clone();
        let told = press.clone();
        let events = self.plan.events.clone();
        let name = capture.clone();
        let (jobs, trigger) = (self.plan.jobs.clone(), kept.trigger.clone());
        let done: Done = Box::new(move |written| {
            let durable = complete && written.is_ok();
            ended.count(durable);
            if durable {
                ended.takes.note("durable", begin.elapsed());
            }
            let recording = written.as_ref().ok().filter(|_| complete).cloned();
            let end = end(name, complete, reason, written);
            if let Reply::Failed { capture, reason } = &end {
                log::error!("capture {capture} failed: {reason}");
            }
            if ends {
                tell(&events, &told, end);
            }
            if let (Some(jobs), Some(recording)) = (jobs, recording) {
                offer(&jobs, &events, recording, &trigger);
            }
        });
        if !self.recorder.hand_over(Work::Keep(Box::new(kept), done)) {
            let reason = "the disk is behind and the capture is lost".to_owned();
            log::error!("capture {capture}: {reason}");
            tell(&self.plan.events, press, Reply::Failed { capture, reason });
            return true;
        }
        ends
    }

    /// Takes the empty rig's plates and keeps them.
    fn take_plates(&mut self) -> Result<String, String> {
        self.ready_for_a_capture()?;
        let trigger = Trigger {
            id: CaptureId::new("background").map_err(|e| e.to_string())?,
            time: self.rig.clock().now(),
            source: "background".into(),
            press_id: None,
            subject: None,
        };
        let colors = sync::Cameras {
            depths: BTreeMap::new(),
            ..cameras(&self.rig)
        };
        let mut synchronizer = Synchronizer::new(colors, self.plan.sync.clone());
        let only_colors = |kind| kind == Kind::Color;
        let (capture, shooting) = shoot(
            &mut self.rig,
            &self.plan,
            &mut synchronizer,
            only_colors,
            trigger,
        );
        self.count_lost(&shooting);
        let now = self.rig.clock().now();
        let kept = assemble(capture, shooting, f64::INFINITY, now);
        if kept.record.outcome == Outcome::Failed {
            return Err(kept.record.reason.unwrap_or_default());
        }
        let plates: Plates = kept
            .frames
            .into_iter()
            .map(|f| (f.camera, (f.timestamp, f.picture)))
            .collect();
        let plan = &self.plan;
        let path = plates::save(&plan.recording.folder, now, &plates, &plan.program)
            .map_err(|e| e.to_string())?;
        let words = format!("{} plates in {}", plates.len(), path.display());
        self.plan.preamble.backgrounds = plates::detached(plates);
        self.preamble_changed();
        let told = words.clone();
        self.plan.events.publish(Event::Plates { words: told });
        Ok(words)
    }

    fn preamble_changed(&mut self) {
        let preamble = Box::new(self.plan.preamble.clone());
        let time = self.rig.clock().now();
        if self.session.is_some() && !self.recorder.hand_over(Work::Change(preamble, time)) {
            // Rather a session of its own than one whose later captures have old plates.
            log::warning!("the disk is behind: the next capture begins a session");
            self.session = None;
        }
    }

    fn begin(&mut self, name: &str, about: BTreeMap<String, String>, answer: Answer) {
        let (told, failed) = split(answer);
        let words = format!("session {name}");
        let done: Done = Box::new(move |closed| told(closed.map(|_| words)));
        if let Err(reason) = self.begin_session(name, about, done) {
            failed(Err(reason));
        }
    }

    fn begin_session(
        &mut self,
        name: &str,
        about: BTreeMap<String, String>,
        done: Done,
    ) -> Result<(), String> {
        names::check_session(name)?;
        let mut preamble = self.plan.preamble.clone();
        preamble.about.extend(about);
        let session = Session::begin(
            &self.plan.recording.folder,
            name,
            &self.plan.program,
            self.rig.clock().now(),
            self.plan.recording.largest_file_mb * 1_000_000,
            preamble,
        );
        let session = Box::new(session.map_err(|e| e.to_string())?);
        if let Some(models) = &self.plan.models {
            names::check_models(&models.join(name))?;
        }
        if !self.recorder.hand_over(Work::Begin(session, done)) {
            return Err("the disk is behind".into());
        }
        self.session = Some(Naming {
            name: name.into(),
            captures: 0,
        });
        let name = Some(name.to_owned());
        self.plan.events.publish(Event::Session { name });
        Ok(())
    }

    fn write_down(&mut self, note: Note, answer: Answer) {
        let time = self.rig.clock().now();
        let events = self.plan.events.clone();
        let event = Event::Note {
            capture: note.capture.clone(),
            kind: note.kind.clone(),
            text: note.text.clone(),
        };
        let answer: Answer = Box::new(move |written| {
            if written.is_ok() {
                events.publish(event);
            }
            answer(written);
        });
        self.pass_on(answer, |done| Work::Note(note, time, done));
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
        *self.shared.lock().unwrap_or_else(PoisonError::into_inner) = status;
    }

    /// Hours since the oldest plate; `None` where a camera has none.
    fn plates_age_h(&self) -> Option<f64> {
        let plates = &self.plan.preamble.backgrounds;
        let colors = self.rig.states().filter(|(_, k, _)| *k == Kind::Color);
        let times: Option<Vec<Timestamp>> = colors
            .map(|(id, ..)| plates.get(id).map(|(time, _)| *time))
            .collect();
        let oldest = times?.into_iter().min()?;
        let age_ns = self.rig.clock().now().nanoseconds_since(oldest);
        Some(age_ns as f64 / 3.6e12)
    }
}

/// The cameras whose frames make a capture.
fn cameras(rig: &Rig) -> sync::Cameras {
    let mut cameras = sync::Cameras::default();
    for (id, kind, _) in rig.states() {
        match kind {
            Kind::Color => drop(cameras.colors.insert(id.clone())),
            Kind::Depth | Kind::DepthInTurn => drop(cameras.depths.insert(id.clone(), true)),
        }
    }
    cameras
}

/// Takes a shot and lets `sync` choose from its frames.
fn shoot(
    rig: &mut Rig,
    plan: &Plan,
    synchronizer: &mut Synchronizer<Frame>,
    wanted: impl Fn(Kind) -> bool,
    trigger: Trigger,
) -> (Capture<Frame>, Shooting) {
    let patience = plan.sync.window_ms + plan.capture.patience_ms as f64;
    let at_most = Duration::from_secs_f64(patience / 1e3);
    let shooting = rig.shoot(wanted, trigger.time, at_most);
    synchronizer.push_trigger(trigger.clone(), Listed::new());
    for frame in &shooting.frames {
        synchronizer.push_frame(&frame.camera, frame.stream, frame.timestamp, frame.clone());
    }
    // All cameras have answered, or nobody waits for them any more.
    let mut captures = synchronizer.finish();
    // What they gave beyond the capture is of no use to a later one: its memory is.
    synchronizer.advance(Timestamp(u64::MAX));
    let capture = captures.pop().unwrap_or_else(|| Capture {
        trigger,
        colors: BTreeMap::new(),
        depths: BTreeMap::new(),
        shortfalls: Vec::new(),
        complete: false,
    });
    (capture, shooting)
}

/// Tells a press's client how it goes on, and everybody else.
fn tell(events: &Events, press: &Press, reply: Reply) {
    let event = match reply.clone() {
        Reply::Accepted { capture } => Some(Event::Accepted {
            capture,
            source: press.source.clone(),
            press_id: press.press_id.clone(),
            subject: press.subject.clone(),
        }),
        Reply::Captured { capture, skew_ns } => Some(Event::Captured { capture, skew_ns }),
        Reply::Retried { capture, reason } => Some(Event::Retried { capture, reason }),
        Reply::Durable { capture, recording } => Some(Event::Durable { capture, recording }),
        Reply::Failed { capture, reason } => Some(Event::Failed { capture, reason }),
        _ => None,
    };
    (press.progress)(reply);
    if let Some(event) = event {
        events.publish(event);
    }
}

/// The end of a press.
fn end(capture: String, complete: bool, reason: String, written: Result<PathBuf, String>) -> Reply {
    match written {
        Ok(recording) if complete => Reply::Durable { capture, recording },
        Ok(_) => Reply::Failed { capture, reason },
        Err(problem) => Reply::Failed {
            capture,
            reason: format!("it is not on the disk: {problem}"),
        },
    }
}

/// An answer that one of two may give.
fn split(answer: Answer) -> (Answer, Answer) {
    let shared = Arc::new(Mutex::new(Some(answer)));
    let half = |shared: Arc<Mutex<Option<Answer>>>| -> Answer {
        Box::new(move |result| {
            let answer = shared.lock().unwrap_or_else(PoisonError::into_inner).take();
            if let Some(answer) = answer {
                answer(result);
            }
        })
    };
    (half(shared.clone()), half(shared))
}

fn log_error(done: Result<PathBuf, String>) {
    if let Err(error) = done {
        log::error!("{error}");
    }
}
