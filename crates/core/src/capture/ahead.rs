//! Frames that a recording lists for a capture and that are older than its trigger, as where a turntable is
//! photographed all around before. They wait for the trigger: until it comes, the synchronisation would forget them, or
//! give them to another capture.

use super::replay::ReplayEvent;
use crate::frame::{CameraId, CaptureId, Stream, Timestamp};
use crate::recording::MessageRef;
use std::collections::BTreeMap;

/// A frame of a recording.
#[derive(Clone, Debug)]
pub(super) struct ReplayedFrame {
    pub(super) camera: CameraId,
    pub(super) stream: Stream,
    pub(super) timestamp: Timestamp,
    pub(super) message: MessageRef,
}

/// The frames that wait for their captures' triggers.
#[derive(Debug, Default)]
pub(super) struct FramesAhead {
    /// The captures, numbered in the order of their triggers.
    numbers: BTreeMap<CaptureId, usize>,
    /// For each listed frame of a camera the time of the trigger, and the number, of the first capture that lists it.
    listed: BTreeMap<CameraId, BTreeMap<Timestamp, (Timestamp, usize)>>,
    /// For each capture what waits for its trigger.
    waiting: BTreeMap<usize, Vec<ReplayedFrame>>,
}

impl FramesAhead {
    /// None yet, of a recording in which this happens.
    pub(super) fn of(events: &[(Timestamp, ReplayEvent)]) -> Self {
        let mut ahead = Self::default();
        for (time, event) in events {
            let ReplayEvent::Trigger(replayed) = event else {
                continue;
            };
            let id = &replayed.trigger.id;
            // A second trigger of an id makes no capture.
            if ahead.numbers.contains_key(id) {
                continue;
            }
            let number = ahead.numbers.len();
            ahead.numbers.insert(id.clone(), number);
            for (camera, times) in &replayed.listed {
                let of_camera = ahead.listed.entry(camera.clone()).or_default();
                for listed in times {
                    of_camera.entry(*listed).or_insert((*time, number));
                }
            }
        }
        ahead
    }

    /// Takes a frame in, and gives it back unless it is to wait.
    pub(super) fn keep(&mut self, frame: ReplayedFrame) -> Option<ReplayedFrame> {
        let Some(listed) = self.listed.get(&frame.camera) else {
            return Some(frame);
        };
        if frame.stream == Stream::DepthColor {
            // No capture lists these, but one may need what is nearest in time to its depth: that comes again.
            let before = listed.range(..frame.timestamp).next_back();
            let after = listed.range(frame.timestamp..).next();
            for (at, (trigger, number)) in before.into_iter().chain(after) {
                if at.max(&frame.timestamp) < trigger {
                    let waiting = self.waiting.entry(*number).or_default();
                    waiting.push(frame.clone());
                }
            }
            return Some(frame);
        }
        match listed.get(&frame.timestamp) {
            Some((trigger, number)) if frame.timestamp < *trigger => {
                self.waiting.entry(*number).or_default().push(frame);
                None
            }
            _ => Some(frame),
        }
    }

    /// What waited for the trigger of a capture.
    pub(super) fn release(&mut self, id: &CaptureId) -> Vec<ReplayedFrame> {
        let waited = self.numbers.get(id).and_then(|n| self.waiting.remove(n));
        waited.unwrap_or_default()
    }
}
