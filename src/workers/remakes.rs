//! Models that people want made again with other settings: which settings may be chosen, and a short queue in memory.
//! The queue is lost when the daemon stops; people must then ask again.

use crate::frame::CaptureId;
use parking_lot::{Condvar, Mutex};
use serde_json::Value;
use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

/// Remakes that may wait.
const MOST_WAITING: usize = 10;
/// How often something is looked for that nobody tells of.
const LOOK_AGAIN: Duration = Duration::from_millis(300);

/// A setting that may be chosen, and its values.
struct Setting {
    key: &'static str,
    values: Values,
}

enum Values {
    Between(f64, f64),
    OneOf(&'static [&'static str]),
}

/// The settings that may be chosen: those that change what a model is like, and not where anything lies.
const SETTINGS: [Setting; 6] = [
    Setting {
        key: "hull.resolution",
        values: Values::Between(40.0, 400.0),
    },
    Setting {
        key: "hull.fairing",
        values: Values::OneOf(&["none", "touch"]),
    },
    Setting {
        key: "silhouette.significance",
        values: Values::Between(1.0, 20.0),
    },
    Setting {
        key: "silhouette.darkest_shadow",
        values: Values::Between(0.0, 0.5),
    },
    Setting {
        key: "silhouette.spill",
        values: Values::Between(0.0, 0.3),
    },
    Setting {
        key: "silhouette.smallest_hole_px",
        values: Values::Between(0.0, 10_000.0),
    },
];

/// A model that is to be made again.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Remake {
    pub(super) capture: String,
    /// `KEY=VALUE` each.
    pub(super) settings: Vec<String>,
}

impl Remake {
    /// A capture's model with these settings.
    ///
    /// # Errors
    /// What is wrong, if the id is not valid, no setting is given, or one is not known or out of its range.
    pub fn new(capture: &str, settings: &BTreeMap<String, Value>) -> Result<Self, String> {
        CaptureId::new(capture).map_err(|error| error.to_string())?;
        if settings.is_empty() {
            return Err(
                "no setting was given: a model is made again only with at least one other setting"
                    .into(),
            );
        }
        let settings = settings.iter().map(|(key, value)| chosen(key, value));
        Ok(Self {
            capture: capture.into(),
            settings: settings.collect::<Result<_, _>>()?,
        })
    }
}

/// `KEY=VALUE`, if that may be chosen.
fn chosen(key: &str, value: &Value) -> Result<String, String> {
    let Some(setting) = SETTINGS.iter().find(|setting| setting.key == key) else {
        let known: Vec<&str> = SETTINGS.iter().map(|setting| setting.key).collect();
        return Err(format!(
            "{key:?} cannot be chosen, expected one of {}",
            known.join(", ")
        ));
    };
    match (&setting.values, value) {
        (Values::Between(low, high), Value::Number(number)) => {
            let found = number.as_f64().unwrap_or(f64::NAN);
            if !(*low..=*high).contains(&found) {
                return Err(format!("{key} is {number}, expected {low} to {high}"));
            }
            Ok(format!("{key}={found:?}"))
        }
        (Values::OneOf(names), Value::String(name)) if names.contains(&name.as_str()) => {
            Ok(format!("{key}={name}"))
        }
        (Values::Between(low, high), _) => {
            Err(format!("{key}: expected a number, {low} to {high}"))
        }
        (Values::OneOf(names), _) => Err(format!("{key}: expected one of {}", names.join(", "))),
    }
}

/// Those that wait.
#[derive(Default)]
pub struct Remakes {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Default)]
struct State {
    waiting: VecDeque<Remake>,
    is_running: bool,
    is_stopped: bool,
}

impl Remakes {
    /// Takes in a remake; returns how many are before it.
    ///
    /// # Errors
    /// If too many wait, the same one waits already, or the daemon is ending.
    pub fn offer(&self, remake: Remake) -> Result<usize, String> {
        let mut state = self.state.lock();
        if state.is_stopped {
            return Err("the daemon is ending".into());
        }
        if state.waiting.contains(&remake) {
            return Err("a remake with the same settings is waiting already".into());
        }
        if state.waiting.len() >= MOST_WAITING {
            return Err(format!(
                "{MOST_WAITING} remakes wait already: try again when one is done"
            ));
        }
        let before = state.waiting.len() + usize::from(state.is_running);
        state.waiting.push_back(remake);
        self.changed.notify_all();
        Ok(before)
    }

    /// How many wait or are being made.
    pub fn len(&self) -> usize {
        let state = self.state.lock();
        state.waiting.len() + usize::from(state.is_running)
    }

    /// Whether none waits and none is being made.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The next one, once `may` says so; `None` at the end.
    pub(super) fn take(&self, may: impl Fn() -> bool) -> Option<Remake> {
        let mut state = self.state.lock();
        state.is_running = false;
        loop {
            if state.is_stopped {
                return None;
            }
            if !state.waiting.is_empty() && may() {
                let taken = state.waiting.pop_front();
                state.is_running = taken.is_some();
                return taken;
            }
            self.changed.wait_for(&mut state, LOOK_AGAIN);
        }
    }

    /// Lets no further one begin.
    pub(super) fn stop(&self) {
        self.state.lock().is_stopped = true;
        self.changed.notify_all();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn settings(value: Value) -> BTreeMap<String, Value> {
        serde_json::from_value(value).unwrap()
    }

    #[test]
    fn only_settings_of_the_list_within_their_ranges_are_taken() {
        let new = |value| Remake::new("a-0001", &settings(value));
        let found = new(json!({ "hull.resolution": 120, "hull.fairing": "none" })).unwrap();
        assert_eq!(
            found.settings,
            ["hull.fairing=none", "hull.resolution=120.0"]
        );
        for (bad, words) in [
            (json!({}), "at least one"),
            (json!({ "hull.resolution": 1000 }), "expected 40 to 400"),
            (json!({ "hull.resolution": "100" }), "expected a number"),
            (
                json!({ "hull.fairing": "none\n[workers]" }),
                "expected one of none, touch",
            ),
            (json!({ "hull.fairing": 1 }), "expected one of none, touch"),
            (json!({ "workers.folder": "/etc" }), "cannot be chosen"),
            (json!({ "silhouette.spill": -1 }), "expected 0 to 0.3"),
        ] {
            let refused = new(bad.clone()).unwrap_err();
            assert!(refused.contains(words), "{bad}: {refused}");
        }
        for capture in ["", "../a", "a/b", "a\0"] {
            let one = settings(json!({ "hull.resolution": 120 }));
            assert!(Remake::new(capture, &one).is_err(), "{capture:?}");
        }
    }

    #[test]
    fn ten_wait_and_no_more_and_none_twice() {
        let remakes = Remakes::default();
        let remake = |n: usize| {
            let one = settings(json!({ "hull.resolution": 120 }));
            Remake::new(&format!("a-{n:04}"), &one).unwrap()
        };
        for n in 0..MOST_WAITING {
            assert_eq!(remakes.offer(remake(n)), Ok(n));
        }
        assert!(
            remakes
                .offer(remake(3))
                .unwrap_err()
                .contains("waiting already")
        );
        assert!(
            remakes
                .offer(remake(99))
                .unwrap_err()
                .contains("10 remakes")
        );
        assert_eq!(remakes.take(|| true), Some(remake(0)));
        assert_eq!(remakes.offer(remake(99)), Ok(MOST_WAITING));
        remakes.stop();
        assert!(remakes.take(|| true).is_none());
        assert!(remakes.offer(remake(7)).is_err());
    }
}
