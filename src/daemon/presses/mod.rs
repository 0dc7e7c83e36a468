//! Decides the life of each press and of its capture: inputs in, effects out. No lock, no thread, no clock and no file
//! lives here; `dispatcher` carries the effects out, on the threads that bring the inputs.
//!
//! ```text
//!   ask ──▶ its press_id is known: the client follows that press
//!    │ └──▶ another order is carried out ("busy"), or the press_id is invalid ("refused")
//!    ▼
//!  Asked ──── Refused ───▶ "refused": nothing was begun, and the press_id may be used again
//!    │
//!    │ Admitted
//!    ▼ "accepted"
//!  Taking ─── Taken: failed, may be retried ───▶ "retried", "accepted", Taking
//!    │ │
//!    │ └───── Taken: failed ───▶ Failing ─── Written ───▶ "failed", Ended
//!    │ Taken: complete
//!    ▼ "captured"
//!  Captured ─ Written: error ──▶ "failed", Ended
//!    │
//!    │ Written
//!    ▼ "durable", and a job is enqueued
//!  Durable ── JobEnded ────────▶ "done" or "job_failed", Ended
//! ```
//!
//! The daemon works on one order at a time: a press from `ask` until its last attempt is taken; [`Presses::claim`]
//! admits the other orders. If a thread panics while it holds a press, the press ends as refused or failed. After a
//! restart, [`Presses::restore`] rebuilds each press from the journal and the interrupted recordings, and ends those
//! that were cut short.

pub(super) mod journal;
mod latency;
pub(super) mod recorded;
mod restore;
mod table;
#[cfg(test)]
mod tests;

use crate::frame::{CaptureId, Timestamp};
use crate::trigger::{Event, Until};
use latency::LatencyWindow;
pub(super) use latency::Percentiles;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// Letters of a press's name.
const LONGEST_ID: usize = 64;
/// Shortest time between two events about refusals. The refused clients are always told.
const REFUSAL_INTERVAL: Duration = Duration::from_secs(1);

/// What a client says of its press.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Press {
    /// `pedal`, `socket` or another word.
    pub source: String,
    /// The client's own name of it.
    pub press_id: Option<String>,
    /// The object's number.
    pub subject: Option<String>,
    /// How the object lies, in a person's words.
    pub placement: Option<String>,
}

/// Names a press within this process; a later one has a higher number.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct PressKey(u64);

/// What happened to a press.
#[derive(Clone, Debug)]
pub(super) enum Input {
    /// A capture of this name may be begun for it, and repeated so often if it fails.
    Admitted(PressKey, String, u32),
    /// Nothing can be begun, and why.
    Refused(PressKey, String),
    /// The shot of this trigger is over: the colour frames' spread in nanoseconds, or why the capture failed.
    Taken(PressKey, Timestamp, Result<u64, String>),
    /// The recorder is done with a capture: the recording it is in, or why it is in none.
    Written(String, Result<PathBuf, String>),
    /// A model was made or cannot be: [`Event::Done`] or [`Event::JobFailed`].
    JobEnded(Event),
    /// The thread that had the press has dropped it.
    Abandoned(PressKey),
    /// A client does not follow it any more.
    Left(PressKey),
}

/// What is to be done, in this order.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Effect {
    /// Give the press to the capture thread, which admits or refuses it.
    Begin(PressKey),
    /// Take a shot of this name.
    Shoot(CaptureId),
    /// Append the answer of a named press to the journal.
    Journal { press_id: String, event: Event },
    /// Bring the journal to the disk.
    SyncJournal,
    /// Answer the clients that follow the press.
    Reply(PressKey, Event),
    /// Publish an event.
    Publish(Event),
    /// Enqueue the job of making the capture's model, and that of its object.
    Enqueue {
        recording: PathBuf,
        capture: String,
        trigger: Timestamp,
        source: String,
        subject: Option<String>,
    },
    /// Log why an attempt that was taken once more could not be written: no event says it.
    LogUnwritten { capture: String, problem: String },
    /// The press is not known any more; nothing follows for it.
    Forget(PressKey),
}

/// How far a press is.
#[derive(Clone, Debug, PartialEq, Eq)]
enum PressState {
    Asked,
    Taking,
    Captured,
    /// Its last attempt failed for this reason; the frames that came are being written.
    Failing(String),
    Durable,
    Ended,
}

/// A press, and how far it is.
struct TrackedPress {
    press: Press,
    asked: Instant,
    state: PressState,
    /// The id of the first attempt's capture; the others' begin with it.
    first: String,
    /// The id of the last attempt's capture.
    capture: String,
    attempts: u32,
    retries: u32,
    trigger: Timestamp,
    followers: usize,
}

/// Figures for the status, since the start.
#[derive(Clone, Debug, Default)]
pub(super) struct Figures {
    /// Captures that are on the disk and complete.
    pub complete: u64,
    /// Captures that failed.
    pub failed: u64,
    /// Presses that were refused.
    pub refused: u64,
    /// How long the last presses took, in milliseconds, until they were `captured` and `durable`.
    pub latency_ms: BTreeMap<&'static str, Percentiles>,
}

/// All presses, see the head of this file.
pub(super) struct Presses {
    presses: BTreeMap<PressKey, TrackedPress>,
    by_id: BTreeMap<String, PressKey>,
    by_capture: BTreeMap<String, PressKey>,
    next: u64,
    /// Whether an order is being carried out.
    busy: bool,
    /// Presses whose last attempt is being written.
    writing: usize,
    last_refusal: Option<Instant>,
    figures: Figures,
    latency: BTreeMap<&'static str, LatencyWindow>,
    /// When the input came that is being decided, and what follows from it.
    now: Instant,
    effects: Vec<Effect>,
}

impl Presses {
    /// A client asks for a press, or again for one that is known; it follows the press of this key.
    pub(super) fn ask(&mut self, now: Instant, press: Press) -> (PressKey, Vec<Effect>) {
        self.now = now;
        let id = press.press_id.as_deref();
        let known = id.and_then(|id| self.by_id.get(id)).copied();
        let key = known.unwrap_or_else(|| self.asked(press));
        if let Some(tracked) = self.presses.get_mut(&key) {
            tracked.followers += 1;
        }
        (key, std::mem::take(&mut self.effects))
    }

    /// What follows from an input. One that cannot come in the state that its press is in changes nothing.
    pub(super) fn on(&mut self, now: Instant, input: Input) -> Vec<Effect> {
        self.now = now;
        match input {
            Input::Admitted(press, capture, retries) => self.admitted(press, capture, retries),
            Input::Refused(press, reason) => self.refused(press, reason),
            Input::Taken(press, trigger, result) => self.taken(press, trigger, result),
            Input::Written(capture, result) => self.written(capture, result),
            Input::JobEnded(event) => self.job_ended(event),
            Input::Abandoned(press) => self.abandoned(press),
            Input::Left(press) => {
                let tracked = self.presses.get_mut(&press);
                tracked.into_iter().for_each(|r| r.followers -= 1);
            }
        }
        std::mem::take(&mut self.effects)
    }

    /// Begins an order that is not a press, if no other order is in progress; [`Self::release`] ends it.
    pub(super) fn claim(&mut self) -> bool {
        !std::mem::replace(&mut self.busy, true)
    }

    /// The order that [`Self::claim`] let through keeps no other waiting any more.
    pub(super) fn release(&mut self) {
        self.busy = false;
    }

    /// Whether an order is being carried out.
    pub(super) fn is_busy(&self) -> bool {
        self.busy
    }

    /// Whether no order is in progress and no capture waits for the disk.
    pub(super) fn is_idle(&self) -> bool {
        !self.busy && self.writing == 0
    }

    /// Figures for the status.
    pub(super) fn figures(&self) -> Figures {
        let latency = self.latency.iter();
        let percentiles = latency.filter_map(|(what, last)| Some((*what, last.percentiles()?)));
        Figures {
            latency_ms: percentiles.collect(),
            ..self.figures.clone()
        }
    }

    fn asked(&mut self, press: Press) -> PressKey {
        let valid = press.press_id.as_deref().map_or(Ok(()), check_id);
        let key = self.insert(press);
        match valid {
            Err(reason) => self.reject(key, Event::Refused { reason }),
            Ok(()) if self.busy => self.reject(key, Event::Busy),
            Ok(()) => {
                self.busy = true;
                self.effects.push(Effect::Begin(key));
            }
        }
        key
    }

    fn admitted(&mut self, press: PressKey, capture: String, retries: u32) {
        let Some(tracked) = self.in_state(press, &PressState::Asked) else {
            return;
        };
        match CaptureId::new(&capture) {
            Ok(id) => {
                (tracked.first, tracked.retries) = (capture, retries);
                self.attempt(press, id);
            }
            Err(_) => {
                let reason = format!("{capture:?} is too long for a capture's id");
                self.refused(press, reason);
            }
        }
    }

    fn attempt(&mut self, press: PressKey, id: CaptureId) {
        let Some(tracked) = self.presses.get_mut(&press) else {
            return;
        };
        tracked.attempts += 1;
        let asked = tracked.press.clone();
        let accepted = Event::Accepted {
            capture: id.to_string(),
            source: Some(asked.source),
            press_id: asked.press_id,
            subject: asked.subject,
        };
        self.answer_and_publish(press, accepted);
        self.effects.push(Effect::Shoot(id));
    }

    fn refused(&mut self, press: PressKey, reason: String) {
        if self.in_state(press, &PressState::Asked).is_none() {
            return;
        }
        self.busy = false;
        self.figures.refused += 1;
        let event = Event::Refused { reason };
        self.reject(press, event.clone());
        let recent = |last| self.now.saturating_duration_since(last) < REFUSAL_INTERVAL;
        if !self.last_refusal.is_some_and(recent) {
            self.last_refusal = Some(self.now);
            self.effects.push(Effect::Publish(event));
        }
    }

    fn taken(&mut self, press: PressKey, trigger: Timestamp, result: Result<u64, String>) {
        let Some(tracked) = self.in_state(press, &PressState::Taking) else {
            return;
        };
        tracked.trigger = trigger;
        let capture = tracked.capture.clone();
        match (result, tracked.next_attempt()) {
            (Err(reason), Some(id)) => {
                self.answer_and_publish(press, Event::Retried { capture, reason });
                return self.attempt(press, id);
            }
            (Err(reason), None) => tracked.state = PressState::Failing(reason),
            (Ok(skew_ns), _) => {
                self.note_latency(press, "captured");
                self.answer_and_publish(press, Event::Captured { capture, skew_ns });
            }
        }
        self.busy = false;
        self.writing += 1;
    }

    fn written(&mut self, capture: String, result: Result<PathBuf, String>) {
        let Some((press, tracked)) = self.of_capture(&capture) else {
            return;
        };
        if tracked.capture != capture {
            return self.retried_was_written(capture, result.err());
        }
        let end = match (tracked.state.clone(), result) {
            (PressState::Captured, Ok(recording)) => Ok(recording),
            (PressState::Failing(reason), Ok(_)) => Err(reason),
            (PressState::Captured | PressState::Failing(_), Err(problem)) => {
                Err(format!("it could not be written: {problem}"))
            }
            _ => return,
        };
        self.writing -= 1;
        match end {
            Ok(recording) => self.durable(press, capture, recording),
            Err(reason) => {
                self.figures.failed += 1;
                self.answer_and_publish(press, Event::Failed { capture, reason });
            }
        }
    }

    /// The recorder is done with an attempt that was taken once more, or could not write it.
    fn retried_was_written(&mut self, capture: String, problem: Option<String>) {
        self.figures.failed += 1;
        let unwritten = problem.map(|problem| Effect::LogUnwritten { capture, problem });
        self.effects.extend(unwritten);
    }

    fn durable(&mut self, press: PressKey, capture: String, recording: PathBuf) {
        let Some(tracked) = self.presses.get(&press) else {
            return;
        };
        let enqueue = Effect::Enqueue {
            recording: recording.clone(),
            capture: capture.clone(),
            trigger: tracked.trigger,
            source: tracked.press.source.clone(),
            subject: tracked.press.subject.clone(),
        };
        self.figures.complete += 1;
        self.note_latency(press, "durable");
        self.answer_and_publish(press, Event::Durable { capture, recording });
        self.effects.push(enqueue);
    }

    fn job_ended(&mut self, event: Event) {
        let capture = event.capture().unwrap_or_default();
        match self.of_capture(capture) {
            Some((press, tracked)) if tracked.state == PressState::Durable => {
                // An earlier attempt has no job.
                if tracked.capture == capture {
                    self.answer_and_publish(press, event);
                }
            }
            // It is not known any more; or its job ended twice, as a kill came in between.
            None => self.effects.push(Effect::Publish(event)),
            Some((_, tracked)) if tracked.state == PressState::Ended => {
                self.effects.push(Effect::Publish(event));
            }
            Some(_) => {}
        }
    }

    fn abandoned(&mut self, press: PressKey) {
        let reason = "internal error: the thread that took it has ended".to_owned();
        let Some(tracked) = self.in_state(press, &PressState::Taking) else {
            return self.refused(press, reason);
        };
        let capture = tracked.capture.clone();
        self.busy = false;
        self.figures.failed += 1;
        self.answer_and_publish(press, Event::Failed { capture, reason });
    }

    /// Answers a press, and publishes the event.
    fn answer_and_publish(&mut self, press: PressKey, event: Event) {
        self.reply(press, event.clone());
        self.effects.push(Effect::Publish(event));
    }

    /// Answers a press: in the journal first, then to its client. The final answer is synced to the disk.
    fn reply(&mut self, press: PressKey, event: Event) {
        self.advance(press, &event);
        let tracked = self.presses.get(&press);
        let press_id = tracked.and_then(|tracked| tracked.press.press_id.clone());
        let settles = press_id.is_some() && event.is_end(Until::Durable);
        let line = press_id.map(|press_id| Effect::Journal {
            press_id,
            event: event.clone(),
        });
        self.effects.extend(line);
        self.effects.push(Effect::Reply(press, event));
        self.effects.extend(settles.then_some(Effect::SyncJournal));
    }

    /// Answers a press that nothing is begun for. It is forgotten, so that its name may be used again.
    fn reject(&mut self, press: PressKey, event: Event) {
        self.effects.push(Effect::Reply(press, event));
        self.forget(press);
    }

    fn note_latency(&mut self, press: PressKey, what: &'static str) {
        if let Some(tracked) = self.presses.get(&press) {
            let took = self.now.saturating_duration_since(tracked.asked);
            self.latency.entry(what).or_default().note(took);
        }
    }
}

impl TrackedPress {
    /// The name of another attempt; `None` if there were enough attempts, or if the name would be too long.
    fn next_attempt(&self) -> Option<CaptureId> {
        let id = CaptureId::new(&format!("{}.r{}", self.first, self.attempts)).ok();
        id.filter(|_| self.attempts <= self.retries)
    }
}

/// Checks a client's name for a press.
fn check_id(id: &str) -> Result<(), String> {
    let letters = id.chars().count();
    if (1..=LONGEST_ID).contains(&letters) && !id.chars().any(char::is_control) {
        return Ok(());
    }
    let shown: String = id.chars().take(LONGEST_ID + 16).collect();
    Err(format!(
        "press_id {shown:?} is not 1 to {LONGEST_ID} letters without control characters"
    ))
}
