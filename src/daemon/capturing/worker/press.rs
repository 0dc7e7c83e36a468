//! A press: its capture, taken once more if it fails and is to be retried, handed to the recorder; and every answer that
//! the press gets until then.

use super::super::Press;
use super::super::assemble::assemble;
use super::super::offer::offer;
use super::Worker;
use super::shot::shoot;
use crate::daemon::events::{Event, Events};
use crate::daemon::recorder::{Done, Work};
use crate::frame::{CaptureId, Trigger};
use crate::log;
use crate::recording::{FinishedCapture, Outcome};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

impl Worker {
    /// Takes a capture, and once more if it fails and is to be retried.
    pub(super) fn press(&mut self, press: Press) {
        let (press, begin) = (Arc::new(press), self.rig.clock().now());
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
            let accepted = Event::Accepted {
                capture: name.clone(),
                source: Some(press.source.clone()),
                press_id: press.press_id.clone(),
                subject: press.subject.clone(),
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
        (press.progress)(Event::Refused {
            reason: reason.clone(),
        });
        let clock = self.rig.clock();
        let recent = |last: Instant| clock.elapsed(last) < Duration::from_secs(1);
        if !self.last_refusal.is_some_and(recent) {
            self.last_refusal = Some(clock.now());
            log::warning!("refused: {reason}");
            self.plan.events.publish(Event::Refused { reason });
        }
    }

    fn take(&mut self, id: CaptureId, press: &Press) -> FinishedCapture {
        let trigger = Trigger {
            id,
            time: self.rig.clock().timestamp(),
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
            &self.heart,
        );
        self.note_shot(&shooting);
        let now = self.rig.clock().timestamp();
        assemble(capture, shooting, self.plan.capture.largest_skew_ms, now)
    }

    /// Gives a capture to the recorder. True if the press has its end: it is complete, or was the last attempt.
    fn hand_over(
        &mut self,
        kept: FinishedCapture,
        press: &Arc<Press>,
        begin: Instant,
        last: bool,
    ) -> bool {
        let clock = self.rig.clock();
        let capture = kept.record.id.clone();
        let reason = kept.record.reason.clone().unwrap_or_default();
        let complete = kept.record.outcome == Outcome::Complete;
        if complete {
            let captured = Event::Captured {
                capture: capture.clone(),
                skew_ns: kept.record.skew_ns.unwrap_or(0),
            };
            tell(&self.plan.events, press, captured);
            self.ended.takes.note("captured", clock.elapsed(begin));
        } else if !last {
            let retried = Event::Retried {
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
                ended.takes.note("durable", clock.elapsed(begin));
            }
            let recording = written.as_ref().ok().filter(|_| complete).cloned();
            let end = end(name, complete, reason, written);
            match &end {
                Event::Failed { capture, reason } => {
                    log::error!("capture {capture} failed: {reason}");
                }
                Event::Durable { capture, recording } => {
                    log::info!("capture {capture}: durable in {}", recording.display());
                }
                _ => {}
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
            tell(&self.plan.events, press, Event::Failed { capture, reason });
            return true;
        }
        ends
    }
}

/// Tells a press's client how it goes on, and everybody else.
fn tell(events: &Events, press: &Press, event: Event) {
    (press.progress)(event.to_reply());
    events.publish(event);
}

/// The end of a press.
fn end(capture: String, complete: bool, reason: String, written: Result<PathBuf, String>) -> Event {
    match written {
        Ok(recording) if complete => Event::Durable { capture, recording },
        Ok(_) => Event::Failed { capture, reason },
        Err(problem) => Event::Failed {
            capture,
            reason: format!("it is not on the disk: {problem}"),
        },
    }
}
