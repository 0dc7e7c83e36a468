//! Finds presses by their press ids and by their captures, and decides which ones to forget.

use super::{Effect, Press, PressKey, PressState, Presses, TrackedPress};
use crate::frame::Timestamp;
use crate::trigger::Event;

/// Presses that are remembered; the oldest beyond them are forgotten.
pub(super) const MOST_PRESSES: usize = 10_000;

impl Presses {
    /// Adds a press. If there are too many, forgets the oldest one that has its final answer and that no client
    /// follows.
    pub(super) fn insert(&mut self, press: Press) -> PressKey {
        let key = PressKey(self.next);
        self.next += 1;
        if let Some(id) = &press.press_id {
            self.by_id.insert(id.clone(), key);
        }
        let tracked = TrackedPress {
            press,
            asked: self.now,
            state: PressState::Asked,
            first: String::new(),
            capture: String::new(),
            attempts: 0,
            retries: 0,
            trigger: Timestamp(0),
            followers: 0,
        };
        self.presses.insert(key, tracked);
        if self.presses.len() > MOST_PRESSES {
            let oldest = self.presses.iter().find(|(_, r)| r.is_forgettable());
            if let Some(key) = oldest.map(|(key, _)| *key) {
                self.forget(key);
            }
        }
        key
    }

    pub(super) fn get_or_insert(&mut self, press_id: String) -> PressKey {
        let known = self.by_id.get(&press_id).copied();
        known.unwrap_or_else(|| {
            self.insert(Press {
                press_id: Some(press_id),
                ..Press::default()
            })
        })
    }

    pub(super) fn forget(&mut self, key: PressKey) {
        let Some(tracked) = self.presses.remove(&key) else {
            return;
        };
        if let Some(id) = &tracked.press.press_id {
            self.by_id.remove(id);
        }
        if !tracked.capture.is_empty() {
            self.by_capture.retain(|_, press| *press != key);
        }
        self.effects.push(Effect::Forget(key));
    }

    /// Brings a press into the state in which an answer leaves it.
    pub(super) fn advance(&mut self, press: PressKey, event: &Event) {
        let Some(tracked) = self.presses.get_mut(&press) else {
            return;
        };
        if let Some(capture) = event.capture() {
            capture.clone_into(&mut tracked.capture);
            self.by_capture.insert(capture.into(), press);
        }
        tracked.state = match event {
            Event::Accepted { .. } => PressState::Taking,
            // Another attempt follows.
            Event::Retried { .. } => PressState::Asked,
            Event::Captured { .. } => PressState::Captured,
            Event::Durable { .. } => PressState::Durable,
            _ => PressState::Ended,
        };
    }

    pub(super) fn in_state(
        &mut self,
        press: PressKey,
        state: &PressState,
    ) -> Option<&mut TrackedPress> {
        let tracked = self.presses.get_mut(&press);
        tracked.filter(|tracked| tracked.state == *state)
    }

    pub(super) fn of_capture(&self, capture: &str) -> Option<(PressKey, &TrackedPress)> {
        let press = self.by_capture.get(capture)?;
        Some((*press, self.presses.get(press)?))
    }
}

impl TrackedPress {
    fn is_forgettable(&self) -> bool {
        let has_end = matches!(self.state, PressState::Durable | PressState::Ended);
        has_end && self.followers == 0
    }
}
