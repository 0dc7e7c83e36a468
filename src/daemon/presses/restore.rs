//! Restores the presses of earlier runs from the journal's lines and from the captures of interrupted recordings.

use super::recorded::Recorded;
use super::{Effect, Figures, PressState, Presses, check_id};
use crate::trigger::Event;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Instant;

impl Presses {
    /// The presses of earlier runs: from the journal's lines, and from the captures of the recordings that were open
    /// when the last run ended. Each has its end, and the effects bring it to its client and into the journal.
    pub(in crate::daemon) fn restore(
        now: Instant,
        journal: impl IntoIterator<Item = (String, Event)>,
        recorded: &[Recorded],
    ) -> (Self, Vec<Effect>) {
        let mut presses = Self {
            presses: BTreeMap::new(),
            by_id: BTreeMap::new(),
            by_capture: BTreeMap::new(),
            next: 0,
            busy: false,
            writing: 0,
            last_refusal: None,
            figures: Figures::default(),
            latency: BTreeMap::new(),
            now,
            effects: Vec::new(),
        };
        for (press_id, event) in journal {
            presses.restore_from_journal(press_id, event);
        }
        for capture in recorded {
            presses.restore_from_recording(capture, recorded);
        }
        presses.resolve_interrupted(recorded);
        let effects = std::mem::take(&mut presses.effects);
        (presses, effects)
    }

    fn restore_from_journal(&mut self, press_id: String, event: Event) {
        let press = self.get_or_insert(press_id);
        let tracked = self.presses.get(&press);
        if tracked.is_some_and(|r| r.state.may_become(&r.capture, &event)) {
            self.advance(press, &event);
            self.effects.push(Effect::Reply(press, event));
        }
    }

    /// A power cut may take the journal's last lines: a capture that is newer than the last one that they name is
    /// added.
    fn restore_from_recording(&mut self, capture: &Recorded, recorded: &[Recorded]) {
        let id = capture.press_id.as_deref();
        let Some(id) = id.filter(|id| check_id(id).is_ok()) else {
            return;
        };
        let press = self.get_or_insert(id.into());
        let Some(tracked) = self.presses.get(&press) else {
            return;
        };
        let position = |id: &str| recorded.iter().position(|r| r.capture == id);
        let is_newer = position(&tracked.capture) < position(&capture.capture);
        let is_taking = tracked.state == PressState::Taking;
        if !is_newer || !(is_taking || tracked.state == PressState::Asked) {
            return;
        }
        if is_taking {
            let failed = tracked.capture.clone();
            let reason = end_of(recorded, &failed).err().unwrap_or_default();
            let capture = failed;
            self.reply(press, Event::Retried { capture, reason });
        }
        let accepted = Event::Accepted {
            capture: capture.capture.clone(),
            source: None,
            press_id: None,
            subject: None,
        };
        self.reply(press, accepted);
    }

    /// Every press that was cut short gets its end: what the recordings say of its last capture, or that it is lost.
    fn resolve_interrupted(&mut self, recorded: &[Recorded]) {
        use PressState::{Asked, Captured, Taking};
        let open = self.presses.iter();
        let open = open.filter(|(_, r)| matches!(r.state, Asked | Taking | Captured));
        let open: Vec<_> = open
            .map(|(press, r)| (*press, r.capture.clone(), r.state == Captured))
            .collect();
        for (press, capture, is_captured) in open {
            if capture.is_empty() {
                self.forget(press);
                continue;
            }
            match end_of(recorded, &capture) {
                Ok((skew_ns, recording)) => {
                    if !is_captured {
                        let capture = capture.clone();
                        self.reply(press, Event::Captured { capture, skew_ns });
                    }
                    self.reply(press, Event::Durable { capture, recording });
                }
                Err(reason) => self.reply(press, Event::Failed { capture, reason }),
            }
        }
    }
}

/// What the recordings say of a capture.
fn end_of(recorded: &[Recorded], capture: &str) -> Result<(u64, PathBuf), String> {
    let found = recorded.iter().rfind(|r| r.capture == capture);
    let lost = || Err("the daemon ended before the capture was on the disk".to_owned());
    found.map_or_else(lost, |recorded| recorded.end.clone())
}

impl PressState {
    /// Whether a line of the journal adds something to a press in this state, whose last capture is `capture`.
    fn may_become(&self, capture: &str, event: &Event) -> bool {
        let is_open = matches!(self, Self::Asked | Self::Taking);
        match event {
            Event::Accepted { capture: new, .. } => is_open && new != capture,
            Event::Captured { .. } | Event::Retried { .. } => is_open,
            Event::Durable { .. } | Event::Failed { .. } => is_open || *self == Self::Captured,
            Event::Done { .. } | Event::JobFailed { .. } => *self != Self::Ended,
            _ => false,
        }
    }
}
