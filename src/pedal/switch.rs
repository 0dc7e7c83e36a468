//! Debounces keys and maps them to actions. Contacts bounce when they close and when they open, so a press counts only
//! if its key was quiet before.

use std::collections::{BTreeMap, BTreeSet};
use std::time::{Duration, SystemTime};

/// What the operator wants.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Action {
    /// Take a capture.
    Trigger,
    /// Reject the last capture.
    Reject,
}

/// Which keys do what, by the kernel's codes.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Keys {
    /// Keys that ask for a capture; if empty, every key that does not reject.
    pub trigger: BTreeSet<u16>,
    /// Keys that reject the last capture.
    pub reject: BTreeSet<u16>,
}

impl Keys {
    fn action(&self, code: u16) -> Option<Action> {
        if self.reject.contains(&code) {
            Some(Action::Reject)
        } else if self.trigger.is_empty() || self.trigger.contains(&code) {
            Some(Action::Trigger)
        } else {
            None
        }
    }
}

/// A foot switch.
#[derive(Clone, Debug)]
pub struct Switch {
    keys: Keys,
    quiet: Duration,
    /// When each key last went down or up.
    edges: BTreeMap<u16, SystemTime>,
}

impl Switch {
    /// A switch with these keys; a key must have been quiet for `quiet` before a press of it counts.
    pub fn new(keys: Keys, quiet: Duration) -> Self {
        Self {
            keys,
            quiet,
            edges: BTreeMap::new(),
        }
    }

    /// Handles a key that went up (0) or down (1), or repeats (2), at a time of the device's clock. No press is lost
    /// when that clock is set back.
    pub fn edge(&mut self, code: u16, value: i32, time: SystemTime) -> Option<Action> {
        let action = self.keys.action(code)?;
        if value != 0 && value != 1 {
            return None;
        }
        let before = self.edges.insert(code, time);
        let since = before.and_then(|before| time.duration_since(before).ok());
        let bounces = since.is_some_and(|since| since < self.quiet);
        (value == 1 && !bounces).then_some(action)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const B: u16 = 48;
    const C: u16 = 46;
    const QUIET: Duration = Duration::from_millis(50);

    fn at(ms: u64) -> SystemTime {
        SystemTime::UNIX_EPOCH + Duration::from_millis(1_000_000 + ms)
    }

    fn switch() -> Switch {
        let keys = Keys {
            trigger: [B].into(),
            reject: [C].into(),
        };
        Switch::new(keys, QUIET)
    }

    #[test]
    fn a_press_counts_and_neither_its_repeats_nor_its_end() {
        let mut switch = switch();
        assert_eq!(switch.edge(B, 1, at(0)), Some(Action::Trigger));
        for ms in (250..2000).step_by(33) {
            assert_eq!(switch.edge(B, 2, at(ms)), None);
        }
        assert_eq!(switch.edge(B, 0, at(2000)), None);
        assert_eq!(switch.edge(C, 1, at(2010)), Some(Action::Reject));
        assert_eq!(switch.edge(30, 1, at(2020)), None);
        assert_eq!(switch.edge(B, 1, at(2050)), Some(Action::Trigger));
    }

    #[test]
    fn without_keys_of_its_own_any_key_triggers() {
        let keys = Keys {
            reject: [C].into(),
            ..Keys::default()
        };
        let mut switch = Switch::new(keys, QUIET);
        assert_eq!(switch.edge(30, 1, at(0)), Some(Action::Trigger));
        assert_eq!(switch.edge(C, 1, at(1)), Some(Action::Reject));
    }

    #[test]
    fn a_clock_that_was_set_back_loses_no_press() {
        let mut switch = switch();
        assert!(switch.edge(B, 1, at(10_000)).is_some());
        assert!(switch.edge(B, 0, at(10_100)).is_none());
        assert!(switch.edge(B, 1, at(10_099)).is_some());
    }

    proptest! {
        /// However a contact bounces when it closes and when it opens, a press is one press.
        #[test]
        fn bounces_are_no_presses(
            presses in prop::collection::vec(
                (
                    prop::collection::vec(1u64..50, 0..12),
                    50u64..3000,
                    prop::collection::vec(1u64..50, 0..12),
                    50u64..3000,
                ),
                1..10,
            )
        ) {
            let mut switch = switch();
            let (mut ms, mut counted) = (0, 0);
            let mut level = 0;
            let mut edge = |level: &mut i32, ms: u64| {
                *level = 1 - *level;
                switch.edge(B, *level, at(ms)).map_or(0, |_| 1)
            };
            for (closing, held, opening, pause) in &presses {
                counted += edge(&mut level, ms);
                // Ends closed, and then open.
                for (bounces, closed, rest) in [(closing, 1, held), (opening, 0, pause)] {
                    for gap in bounces {
                        ms += gap;
                        counted += edge(&mut level, ms);
                    }
                    if level != closed {
                        ms += 1;
                        counted += edge(&mut level, ms);
                    }
                    ms += rest;
                    if closed == 1 {
                        counted += edge(&mut level, ms);
                    }
                }
            }
            prop_assert_eq!(counted, presses.len());
        }
    }
}
