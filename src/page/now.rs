//! What holds now at the rig, and the one sign that says it: folded from the daemon's events and status. No I/O, and
//! every age is of the monotonic clock: this file decides that nothing old is shown as if it were so now.

use super::objects::Objects;
use crate::level::Level;
use crate::trigger::Event;
use serde_json::{Value, json};
use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// A status that is older says nothing of now.
const FRESH: Duration = Duration::from_secs(5);
/// How long a failure stays, whatever becomes known of earlier captures.
const FAILURE: Duration = Duration::from_secs(6);
/// How old a capture may be that an earlier process heard of.
const OLDEST: Duration = Duration::from_secs(24 * 3600);
/// Captures that are remembered; those with models are found in the folder of models anyway.
const MOST_CAPTURES: usize = 200;

/// The large sign.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Sign {
    /// The daemon does not answer: nothing is known.
    Away,
    /// A camera that a capture needs is not there.
    NotReady,
    /// No further capture fits on the disk.
    DiskFull,
    /// The daemon carries out an order, such as background pictures: a press would not be taken now.
    Busy,
    /// The next press is taken, without cameras that are away, as the configuration allows.
    ReadyWithout,
    /// The next press is taken.
    Ready,
    /// Hold still.
    Capturing,
    /// All pictures are in.
    HandsMayMove,
    /// The capture is on the disk.
    Safe,
    /// A model was made, of this level.
    Green,
    Amber,
    Red,
    /// No capture was taken, or not a whole one: press again.
    Failed,
    /// The capture is on the disk, and its model could not be made.
    ModelFailed,
    /// Of an entry alone: this attempt failed, and another one took its place.
    Retried,
    /// Of an entry alone: the connection was lost before the capture's outcome was told.
    OutcomeUnknown,
}

impl Sign {
    /// How long it stays when nothing else happens.
    fn stays(self) -> Duration {
        Duration::from_secs(match self {
            Self::Safe => 6,
            Self::Green | Self::Amber | Self::Red | Self::ModelFailed => 30,
            // Longer than any capture: whatever became of it, this is not so any more.
            _ => 120,
        })
    }

    /// Whether its capture is being taken, or is not on the disk yet.
    fn is_in_progress(self) -> bool {
        matches!(self, Self::Capturing | Self::HandsMayMove)
    }

    fn of_level(level: Level) -> Self {
        match level {
            Level::Green => Self::Green,
            Level::Amber => Self::Amber,
            Level::Red => Self::Red,
        }
    }
}

/// What happened last that the sign speaks of.
#[derive(Clone, Debug)]
struct Shown {
    sign: Sign,
    capture: String,
    reasons: Vec<String>,
    since: Instant,
    /// Tells it from other news that say the same, such as a second press that is refused.
    number: u64,
    /// When its capture began, or its press was refused; `None` of a capture of which the beginning was not heard.
    pressed: Option<Instant>,
}

impl Shown {
    /// Whether it is still so at that time.
    fn lasts(&self, at: Instant) -> bool {
        at.saturating_duration_since(self.since) < self.sign.stays()
    }

    /// Whether it stays although another sign became known: that one is of an earlier press, and a capture is in
    /// progress, or a press failed a moment ago, to which "Safe on disk" would look like an answer.
    fn stays_before(&self, other: &Self) -> bool {
        let age = other.since.saturating_duration_since(self.since);
        let has_just_failed = self.sign == Sign::Failed && age < FAILURE;
        let is_urgent = (self.sign.is_in_progress() && self.lasts(other.since))
            || (has_just_failed && other.sign != Sign::Failed);
        is_urgent && self.capture != other.capture && other.pressed < self.pressed
    }
}

/// A capture, as far as events described it.
#[derive(Clone, Debug)]
pub(super) struct CaptureEntry {
    pub(super) capture: String,
    pub(super) recording: Option<String>,
    pub(super) subject: Option<String>,
    pub(super) sign: Sign,
    pub(super) reasons: Vec<String>,
    /// `accepted` or `rejected`, if people said so and nothing was missed since.
    pub(super) decision: Option<&'static str>,
    pub(super) begun: Instant,
    pub(super) changed: Instant,
}

/// A capture as it is kept for a process that is started later.
#[derive(Clone, Debug, serde::Serialize, serde::Deserialize)]
pub(super) struct KeptCapture {
    capture: String,
    recording: Option<String>,
    subject: Option<String>,
    sign: Sign,
    reasons: Vec<String>,
    /// How long before it was kept the capture began.
    age_ms: u64,
}

/// What holds now.
#[derive(Default)]
pub(super) struct Now {
    listening: bool,
    status: Option<(Instant, Value)>,
    shown: Option<Shown>,
    /// The number of the newest of what was or is to be shown.
    news: u64,
    /// A failure of an earlier capture that became known while another one was in progress; it is shown after that.
    held_back: Option<Shown>,
    captures: VecDeque<CaptureEntry>,
    /// Whether captures may have been taken after the last one that was heard of.
    has_missed: bool,
    objects: Objects,
    /// Grows with each change of what the history shows.
    history: u64,
}

impl Now {
    /// Whether events arrive. What was in progress when they ended has an unknown outcome; which capture is the last
    /// one, and what people decide, is not heard meanwhile.
    pub(super) fn set_listening(&mut self, listening: bool) {
        self.history += u64::from(self.listening != listening);
        self.listening = listening;
        if listening {
            return;
        }
        self.has_missed = true;
        if self
            .shown
            .as_ref()
            .is_some_and(|shown| shown.sign.is_in_progress())
        {
            self.shown = self.held_back.take();
        }
        for seen in &mut self.captures {
            seen.decision = None;
            if seen.sign.is_in_progress() {
                seen.sign = Sign::OutcomeUnknown;
            }
        }
    }

    /// What the daemon said about itself at that time; `None` if it did not answer.
    pub(super) fn set_status(&mut self, status: Option<Value>, at: Instant) {
        self.status = status.map(|status| (at, status));
    }

    /// The last status, if it is fresh, and its age.
    pub(super) fn status(&self, at: Instant) -> Option<(&Value, Duration)> {
        let (since, status) = self.status.as_ref()?;
        let age = at.saturating_duration_since(*since);
        (self.listening && age < FRESH).then_some((status, age))
    }

    pub(super) fn captures(&self) -> impl DoubleEndedIterator<Item = &CaptureEntry> {
        self.captures.iter()
    }

    /// A number that grows with each change of what is known of captures.
    pub(super) fn history(&self) -> u64 {
        self.history
    }

    /// The captures, the oldest first, for a process that is started later.
    pub(super) fn kept(&self, at: Instant) -> Vec<KeptCapture> {
        let kept = self.captures.iter().map(|seen| KeptCapture {
            capture: seen.capture.clone(),
            recording: seen.recording.clone(),
            subject: seen.subject.clone(),
            sign: seen.sign,
            reasons: seen.reasons.clone(),
            age_ms: at.saturating_duration_since(seen.begun).as_millis() as u64,
        });
        kept.collect()
    }

    /// Takes in the captures of the last day that an earlier process kept so long ago. They say nothing of what holds
    /// now: what was in progress has an unknown outcome, what people decided since was not heard, and no sign is shown
    /// for any.
    pub(super) fn restore(&mut self, kept: Vec<KeptCapture>, ago: Duration, at: Instant) {
        let more = kept.len().saturating_sub(MOST_CAPTURES);
        for capture in kept.into_iter().skip(more) {
            let age = Duration::from_millis(capture.age_ms).saturating_add(ago);
            let Some(begun) = at.checked_sub(age).filter(|_| age < OLDEST) else {
                continue;
            };
            let sign = if capture.sign.is_in_progress() {
                Sign::OutcomeUnknown
            } else {
                capture.sign
            };
            self.captures.push_back(CaptureEntry {
                capture: capture.capture,
                recording: capture.recording,
                subject: capture.subject,
                sign,
                reasons: capture.reasons,
                decision: None,
                begun,
                changed: begun,
            });
        }
        self.has_missed = true;
        self.history += 1;
    }

    /// Takes in an event that arrived at that time.
    pub(super) fn hear(&mut self, event: &Event, at: Instant) {
        match event {
            Event::Accepted {
                capture, subject, ..
            } => {
                self.begin(capture, subject.clone(), at);
                self.show(capture, Sign::Capturing, &[], at);
            }
            Event::Captured { capture, .. } => self.show(capture, Sign::HandsMayMove, &[], at),
            // The next attempt has an id of its own.
            Event::Retried { capture, reason } => {
                let reasons = std::slice::from_ref(reason);
                self.enter(capture, Sign::Retried, reasons, at);
                self.show_sign(capture, Sign::Capturing, reasons, at);
            }
            Event::Durable { capture, recording } => {
                self.place(capture, recording);
                self.change_object(capture, "taken", at);
                self.show(capture, Sign::Safe, &[], at);
            }
            Event::Failed { capture, reason } => {
                self.show(capture, Sign::Failed, std::slice::from_ref(reason), at);
            }
            Event::Refused { reason } => {
                self.show("", Sign::Failed, std::slice::from_ref(reason), at);
            }
            Event::Done {
                capture,
                recording,
                verdict,
                reasons,
                ..
            } => {
                recording.iter().for_each(|file| self.place(capture, file));
                self.show(capture, Sign::of_level(*verdict), reasons, at);
            }
            Event::JobFailed {
                capture,
                recording,
                reason,
            } => {
                recording.iter().for_each(|file| self.place(capture, file));
                self.show(capture, Sign::ModelFailed, std::slice::from_ref(reason), at);
            }
            Event::Note { capture, kind, .. } => self.decide(capture, kind, at),
            Event::Ending => self.set_status(None, at),
            _ => self.objects.hear(event, at),
        }
        self.history += 1;
    }

    fn begin(&mut self, capture: &str, subject: Option<String>, at: Instant) {
        if self.captures.len() == MOST_CAPTURES {
            self.captures.pop_front();
        }
        self.captures.push_back(CaptureEntry {
            capture: capture.into(),
            recording: None,
            subject,
            sign: Sign::Capturing,
            reasons: Vec::new(),
            decision: None,
            begun: at,
            changed: at,
        });
        self.has_missed = false;
    }

    fn place(&mut self, capture: &str, recording: &std::path::Path) {
        let stem = recording.file_stem().unwrap_or_default().to_string_lossy();
        let mut captures = self.captures.iter_mut().rev();
        if let Some(seen) = captures.find(|seen| seen.capture == capture) {
            seen.recording = Some(stem.into_owned());
        }
    }

    fn decide(&mut self, capture: &str, kind: &str, at: Instant) {
        let decision = match kind {
            "accept" => Some("accepted"),
            "reject" => Some("rejected"),
            "clear" => None,
            _ => return,
        };
        let mut captures = self.captures.iter_mut().rev();
        if let Some(seen) = captures.find(|seen| seen.capture == capture) {
            seen.decision = decision;
        }
        self.change_object(capture, decision.unwrap_or("cleared"), at);
    }

    /// What was told of a capture's object does not take into account what became of that capture now.
    fn change_object(&mut self, capture: &str, what: &'static str, at: Instant) {
        let mut captures = self.captures.iter().rev();
        let seen = captures.find(|seen| seen.capture == capture);
        if let Some(subject) = seen.and_then(|seen| seen.subject.as_deref()) {
            self.objects.change(subject, capture, what, at);
        }
    }

    /// Shows what became of a capture, in its entry and, unless something is more urgent, as the sign.
    fn show(&mut self, capture: &str, sign: Sign, reasons: &[String], at: Instant) {
        self.enter(capture, sign, reasons, at);
        self.show_sign(capture, sign, reasons, at);
    }

    fn enter(&mut self, capture: &str, sign: Sign, reasons: &[String], at: Instant) {
        let mut captures = self.captures.iter_mut().rev();
        if let Some(seen) = captures.find(|seen| seen.capture == capture) {
            (seen.sign, seen.changed) = (sign, at);
            seen.reasons = reasons.to_vec();
        }
    }

    fn show_sign(&mut self, capture: &str, sign: Sign, reasons: &[String], at: Instant) {
        self.news += 1;
        let new = Shown {
            sign,
            capture: capture.into(),
            reasons: reasons.to_vec(),
            since: at,
            number: self.news,
            pressed: self.pressed(capture, at),
        };
        let is_urgent = |shown: &Shown| shown.stays_before(&new);
        if self.shown.as_ref().is_some_and(is_urgent) {
            if sign == Sign::Failed {
                self.held_back = Some(new);
            }
            return;
        }
        let has_ended = !sign.is_in_progress() && sign != Sign::Failed;
        let held_back = self.held_back.take_if(|_| has_ended);
        let held_back = held_back.filter(|failed| failed.lasts(at));
        self.shown = Some(held_back.unwrap_or(new));
    }

    /// When the press of a capture was heard of. A refusal has no capture, and is news of the last press.
    fn pressed(&self, capture: &str, at: Instant) -> Option<Instant> {
        if capture.is_empty() {
            return Some(at);
        }
        let mut captures = self.captures.iter().rev();
        let seen = captures.find(|seen| seen.capture == capture);
        seen.map(|seen| seen.begun)
    }

    /// Whether the daemon answered a moment ago, and events arrive.
    pub(super) fn is_there(&self, at: Instant) -> bool {
        self.status(at).is_some()
    }

    /// The sign at a time, what it is about, and for how long it has been so, if that is known.
    pub(super) fn sign(&self, at: Instant) -> (Sign, String, Vec<String>, Option<Duration>) {
        let Some((status, _)) = self.status(at) else {
            return (Sign::Away, String::new(), Vec::new(), None);
        };
        let (rest, reasons) = self.at_rest(status);
        // Where no press can succeed, "press again" would be wrong.
        let is_in_vain = matches!(rest, Sign::NotReady | Sign::DiskFull | Sign::Busy);
        let is_true =
            |shown: &&Shown| shown.lasts(at) && !(shown.sign == Sign::Failed && is_in_vain);
        if let Some(shown) = self.shown.as_ref().filter(is_true) {
            let age = at.saturating_duration_since(shown.since);
            let capture = shown.capture.clone();
            return (shown.sign, capture, shown.reasons.clone(), Some(age));
        }
        (rest, String::new(), reasons, None)
    }

    /// The sign while nothing happens, and the cameras that are missing.
    fn at_rest(&self, status: &Value) -> (Sign, Vec<String>) {
        let missing = missing(status);
        let is_enough = status["ready"] == true && status["goes_on_without_missing"] == true;
        if status["ready"] == false || (!missing.is_empty() && !is_enough) {
            return (Sign::NotReady, missing);
        }
        if captures_left(status) == 0 {
            return (Sign::DiskFull, Vec::new());
        }
        if self.is_busy(status) {
            return (Sign::Busy, Vec::new());
        }
        if !missing.is_empty() {
            return (Sign::ReadyWithout, missing);
        }
        (Sign::Ready, Vec::new())
    }

    /// Whether the daemon is carrying out an order. A status from before the last event may speak of the capture that
    /// ended with that event.
    fn is_busy(&self, status: &Value) -> bool {
        let told = self.status.as_ref().map(|(since, _)| *since);
        let last = self.shown.as_ref().map(|shown| shown.since);
        status["busy"] == true && told > last
    }

    /// What holds at a time, for browsers: every age in milliseconds.
    pub(super) fn snapshot(&self, at: Instant) -> Value {
        let (sign, capture, reasons, age) = self.sign(at);
        let ms = |age: Duration| u64::try_from(age.as_millis()).unwrap_or(u64::MAX);
        let since = |then: Instant| ms(at.saturating_duration_since(then));
        let last = self.captures.back().map(|seen| {
            json!({ "capture": seen.capture, "recording": seen.recording, "subject": seen.subject,
                "sign": seen.sign, "reasons": seen.reasons, "decision": seen.decision,
                "is_last": !self.has_missed, "age_ms": since(seen.begun) })
        });
        let told = self.status(at).map(|(status, age)| {
            json!({ "age_ms": ms(age), "session": status["session"], "captures_left": captures_left(status),
                "models": status["models"], "plates_age_h": status["plates_age_h"] })
        });
        let mut captures = self.captures.iter().rev();
        let shown = captures.find(|seen| seen.capture == capture);
        let recording = shown.and_then(|seen| seen.recording.as_deref());
        // A sign that has an age is what was shown last.
        let news = age.and(self.shown.as_ref()).map(|shown| shown.number);
        json!({ "sign": sign, "capture": capture, "recording": recording, "reasons": reasons, "age_ms": age.map(ms),
            "news": news, "last": last, "daemon": told, "history": self.history, "remade": self.objects.remade(at),
            "object": self.captures.back().and_then(|seen| self.objects.of(seen.subject.as_deref()?, at)) })
    }
}

/// How many captures fit on the disk, by the daemon's status; null while no camera has told its settings, for then a
/// capture has no size.
pub(super) fn captures_left(status: &Value) -> Value {
    let is_known = status["capture_bytes"].as_u64() > Some(0);
    is_known.then(|| status["captures_left"].clone()).into()
}

/// The cameras that are not ready, each with why.
fn missing(status: &Value) -> Vec<String> {
    let cameras = status["cameras"].as_object().into_iter().flatten();
    let away = cameras.filter(|(_, camera)| camera["state"] != "ready");
    let words = |camera: &Value| match camera["words"].as_str() {
        Some(words) if !words.is_empty() => words.to_owned(),
        _ => camera["state"].as_str().unwrap_or("away").to_owned(),
    };
    away.map(|(id, camera)| format!("{id}: {}", words(camera)))
        .collect()
}

#[cfg(test)]
#[path = "now_tests.rs"]
mod tests;
