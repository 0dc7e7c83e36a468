//! Carries out a press: takes its shots and hands them to the recorder. `presses` decides what its client is
//! told.

use super::super::assemble::assemble;
use super::CaptureThread;
use super::shot::shoot;
use crate::daemon::dispatcher::ReplyGuard;
use crate::daemon::presses::{Input, Press};
use crate::daemon::recorder::RecorderTask;
use crate::frame::{CaptureId, Trigger};
use crate::recording::{CaptureOutcome, FinishedCapture};

impl CaptureThread {
    /// Takes the captures that the press is to have: one, and others if it fails.
    pub(super) fn press(&mut self, asked: &Press, guard: &ReplyGuard) {
        let press = guard.press();
        let admitted = self.check_capacity().and_then(|()| self.next_id());
        let mut next = self.dispatcher.on(match admitted {
            Ok(capture) => Input::Admitted(press, capture, self.plan.capture.retry),
            Err(reason) => Input::Refused(press, reason),
        });
        while let Some(capture) = next {
            self.heartbeat.tick();
            let written = guard.of_capture(capture.to_string());
            let kept = self.take(capture, asked);
            let result = match kept.record.outcome {
                CaptureOutcome::Complete => Ok(kept.record.skew_ns.unwrap_or(0)),
                CaptureOutcome::Failed => Err(kept.record.reason.clone().unwrap_or_default()),
            };
            let taken = Input::Taken(press, kept.trigger.time, result);
            next = self.dispatcher.on(taken);
            self.hand_over(RecorderTask::Keep(Box::new(kept), written));
        }
    }

    fn take(&mut self, id: CaptureId, asked: &Press) -> FinishedCapture {
        let time = self.end_look();
        let trigger = Trigger {
            id,
            time,
            source: asked.source.clone(),
            press_id: asked.press_id.clone(),
            subject: asked.subject.clone(),
            placement: asked.placement.clone(),
        };
        let (capture, result) = shoot(
            &mut self.rig,
            &self.plan,
            &mut self.synchronizer,
            |_| true,
            trigger,
            &self.heartbeat,
        );
        self.note_shot(&result);
        let now = self.rig.clock().timestamp();
        assemble(capture, result, self.plan.capture.largest_skew_ms, now)
    }
}
