//! Takes pictures for those who look at the cameras, one camera after the other, while nobody presses. Nothing of it is
//! recorded.

use super::CaptureThread;
use crate::daemon::look::{CameraLook, LookTask};
use crate::daemon::rig::{RigLook, State};
use crate::drivers::live::LookResult;
use crate::frame::{CameraId, Stream, Timestamp};
use crate::log;
use crossbeam_channel::{Receiver, after, never};
use std::time::{Duration, Instant};

impl CaptureThread {
    /// When the next picture of a look is due; never while nobody looks, or one is in transfer or being made.
    pub(super) fn next_look(&mut self) -> Receiver<Instant> {
        let Some((_, due)) = self.due_look() else {
            return never();
        };
        let clock = self.rig.clock();
        after(clock.wait_at_most(clock.until(due)))
    }

    /// Shows what came of the last picture, and begins the next one if it is due and nothing else is to be done.
    pub(super) fn look_on(&mut self, is_asked: bool) {
        if let Some(look) = self.rig.take_look() {
            self.show_look(look);
        }
        let Some((camera, due)) = self.due_look() else {
            return;
        };
        let now = self.rig.clock().now();
        // A press that waits here waits for one picture, and not for a second one.
        if due > now || is_asked || self.dispatcher.presses().is_busy() {
            return;
        }
        self.looking.turns.note(camera.clone(), now);
        let patience = self.plan.sync.window_ms + self.plan.capture.patience_ms as f64;
        if !self.has_memory_for_look(&camera) {
            let words =
                "a look would take memory that the next capture needs: raise capture.memory_mb";
            self.show_reason(&camera, words.into());
        } else if !self
            .rig
            .begin_look(&camera, Duration::from_secs_f64(patience / 1e3))
        {
            self.show_reason(&camera, "it is busy".into());
        }
    }

    /// Waits for the end of the picture that is in transfer, if one is; the time of the trigger that waits.
    pub(super) fn end_look(&mut self) -> Timestamp {
        let (trigger, changed) = self.rig.end_look(&self.heartbeat);
        for camera in changed {
            self.tell_state(camera);
        }
        trigger
    }

    /// Whose turn is next, and when.
    fn due_look(&mut self) -> Option<(CameraId, Instant)> {
        let is_free = self
            .looking
            .maker
            .as_ref()
            .is_some_and(|maker| !maker.is_busy());
        if !is_free || self.looking.looks.count() == 0 || self.rig.is_looking() {
            return None;
        }
        let cameras: Vec<CameraId> = self.rig.states().map(|(id, ..)| id.clone()).collect();
        let mut able = Vec::new();
        for camera in cameras {
            match self.rig.cannot_look(&camera) {
                None => able.push(camera),
                Some(words) => self.show_reason(&camera, words),
            }
        }
        self.looking.turns.next(able.iter(), self.rig.clock().now())
    }

    /// Whether a look leaves enough of the memory for frames to a capture.
    fn has_memory_for_look(&self, camera: &CameraId) -> bool {
        let of_camera = self.rig.states().find(|(id, ..)| *id == camera);
        let frame = match of_camera {
            Some((.., State::Ready(info))) => info.frame_bytes,
            _ => 0,
        };
        let pool = &self.plan.pool;
        pool.in_use() as u64 + frame + self.capture_bytes() <= pool.limit() as u64
    }

    fn show_look(&mut self, look: RigLook) {
        let RigLook { camera, outcome } = look;
        let LookResult {
            frames,
            lost,
            is_binned,
            why_whole,
        } = match outcome {
            Ok(found) => found,
            Err(fault) => return self.show_reason(&camera, fault.to_string()),
        };
        if let Some(why) = self.looking.new_reason(&camera, why_whole.as_deref()) {
            log::notice!("camera {camera}: {why}");
        }
        // A depth camera's own colours are no part of a model.
        let frame = frames.into_iter().find(|f| f.stream != Stream::DepthColor);
        let Some(frame) = frame else {
            let words = lost.into_iter().next();
            let words = words.unwrap_or_else(|| "no frame arrived in time".into());
            return self.show_reason(&camera, words);
        };
        let background = self.plan.header.backgrounds.get(&camera);
        let background = background.map(|(_, picture)| picture.clone());
        let plan = self.plan.look.as_ref();
        let cutting = plan.and_then(|plan| plan.cutting.clone());
        if let Some(maker) = &mut self.looking.maker {
            maker.make(LookTask {
                frame,
                background,
                cutting,
                is_binned,
                why_whole,
            });
        }
    }

    fn show_reason(&self, camera: &CameraId, words: String) {
        let look = CameraLook {
            time: self.rig.clock().timestamp(),
            outcome: Err(words),
        };
        self.looking.looks.show(camera.as_str(), look);
    }
}
