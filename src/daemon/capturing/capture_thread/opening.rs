//! Lets what needs all cameras wait until each was tried once: the daemon takes presses as soon as it runs, and opening
//! a camera takes seconds.

use super::CaptureThread;
use crate::daemon::rig::State;
use crate::daemon::systemd::Heartbeat;
use std::time::Duration;

/// How long after the daemon's start a press waits for cameras that are being opened.
pub(super) const OPENING: Duration = Duration::from_secs(10);

impl CaptureThread {
    /// Returns when no camera is being opened for the first time any more, or [`OPENING`] after the start.
    pub(super) fn wait_for_opening(&mut self) {
        let events = self.rig.events().clone();
        let clock = self.rig.clock();
        loop {
            self.heartbeat.tick();
            let left = clock.until(self.opening_until);
            if left.is_zero() || !self.is_opening() {
                return;
            }
            let message = clock.recv_timeout(&events, left.min(Heartbeat::INTERVAL));
            if message.is_ok_and(|message| self.note(message)) {
                self.publish();
            }
        }
    }

    fn is_opening(&self) -> bool {
        let mut states = self.rig.states();
        states.any(|(.., state)| matches!(state, State::Opening))
    }
}
