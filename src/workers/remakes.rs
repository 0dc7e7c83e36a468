//! Models that people want made again with other settings: which settings may be chosen, and a short queue. A file
//! holds what waits and what is being made, so that a daemon that starts again goes on with it.

use crate::frame::CaptureId;
use crate::log;
use crate::storage::{read_text, write_atomically};
use parking_lot::{Condvar, Mutex, MutexGuard};
use serde_json::Value;
use std::collections::{BTreeMap, VecDeque};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

/// Remakes that may wait.
const MOST_WAITING: usize = 10;
/// Largest file of those that wait, in bytes.
const LARGEST_FILE: u64 = 64 << 10;
/// How often something is looked for that nobody tells of.
const LOOK_AGAIN: Duration = Duration::from_millis(300);

/// The cells along the object, which count only if their size is not given.
pub(super) const RESOLUTION: &str = "hull.resolution";
/// The size of the cells in metres; 0 if it follows from the number.
pub(super) const CELL_SIZE: &str = "hull.cell_size";

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
        key: RESOLUTION,
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
    /// The same, as they were chosen.
    chosen: BTreeMap<String, Value>,
}

/// A remake as the file has it.
#[derive(serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct Saved {
    capture: String,
    settings: BTreeMap<String, Value>,
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
        let pairs = settings.iter().map(|(key, value)| chosen(key, value));
        let mut pairs: Vec<String> = pairs.collect::<Result<_, _>>()?;
        if settings.contains_key(RESOLUTION) {
            // Where the configuration gives the cells' size, their number would change nothing.
            pairs.push(format!("{CELL_SIZE}=0.0"));
        }
        Ok(Self {
            capture: capture.into(),
            settings: pairs,
            chosen: settings.clone(),
        })
    }
}

/// The names of the settings that may be chosen.
pub(super) fn keys() -> impl Iterator<Item = &'static str> {
    SETTINGS.iter().map(|setting| setting.key)
}

/// `KEY=VALUE`, if that may be chosen.
fn chosen(key: &str, value: &Value) -> Result<String, String> {
    let Some(setting) = SETTINGS.iter().find(|setting| setting.key == key) else {
        let known: Vec<&str> = keys().collect();
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
pub struct Remakes {
    file: PathBuf,
    state: Mutex<State>,
    /// How many wait or are being made. It can be read while the state is locked to write them to the disk.
    count: AtomicUsize,
    changed: Condvar,
}

#[derive(Default)]
struct State {
    waiting: VecDeque<Remake>,
    running: Option<Remake>,
    is_stopped: bool,
}

impl Remakes {
    /// Those that a file has, the one that was being made first. Without the file, or with one that cannot be read,
    /// there are none.
    pub(super) fn open(file: &Path) -> Self {
        let waiting = load(file).unwrap_or_else(|why| {
            log::warning!(
                "cannot read the waiting remakes in {}: {why}; ask for them again",
                file.display()
            );
            VecDeque::new()
        });
        let state = State {
            waiting,
            ..State::default()
        };
        Self {
            file: file.into(),
            count: AtomicUsize::new(state.count()),
            state: Mutex::new(state),
            changed: Condvar::new(),
        }
    }

    /// Takes in a remake, and writes it to the disk; returns how many are before it.
    ///
    /// # Errors
    /// If too many wait, the same one waits already, it cannot be written, or the daemon is ending.
    pub fn enqueue(&self, remake: Remake) -> Result<usize, String> {
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
        let before = state.count();
        state.waiting.push_back(remake);
        if let Err(error) = self.save(&state) {
            state.waiting.pop_back();
            return Err(format!("the remake cannot be kept: {error}"));
        }
        self.count.store(state.count(), Ordering::Release);
        self.changed.notify_all();
        Ok(before)
    }

    /// How many wait or are being made.
    pub fn len(&self) -> usize {
        self.count.load(Ordering::Acquire)
    }

    /// Whether none waits and none is being made.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The next one, once `may` says so, which may wait for other locks; `None` at the end. It counts as running until
    /// [`Self::finish`].
    pub(super) fn take(&self, may: impl Fn() -> bool) -> Option<Remake> {
        let mut state = self.state.lock();
        loop {
            let begins = !state.waiting.is_empty() && MutexGuard::unlocked(&mut state, &may);
            if state.is_stopped {
                return None;
            }
            if begins {
                // The file stays as it is: it has this one first until it is made.
                state.running = state.waiting.pop_front();
                return state.running.clone();
            }
            self.changed.wait_for(&mut state, LOOK_AGAIN);
        }
    }

    /// Forgets the one that was running, for it has ended and that was told.
    pub(super) fn finish(&self) {
        let mut state = self.state.lock();
        state.running = None;
        self.save_or_warn(&state);
        self.count.store(state.count(), Ordering::Release);
    }

    /// Lets no further one begin.
    pub(super) fn stop(&self) {
        self.state.lock().is_stopped = true;
        self.changed.notify_all();
    }

    fn save(&self, state: &State) -> Result<(), String> {
        let saved: Vec<Saved> = state.all().map(Saved::from).collect();
        let text = serde_json::to_vec(&saved).map_err(|error| error.to_string())?;
        write_atomically(&self.file, &text).map_err(|error| error.to_string())
    }

    fn save_or_warn(&self, state: &State) {
        if let Err(error) = self.save(state) {
            log::warning!(
                "cannot update the list of remakes ({error}): a finished one may be repeated after the next start"
            );
        }
    }
}

impl State {
    /// What is being made, and then what waits.
    fn all(&self) -> impl Iterator<Item = &Remake> {
        self.running.iter().chain(&self.waiting)
    }

    fn count(&self) -> usize {
        self.all().count()
    }
}

impl From<&Remake> for Saved {
    fn from(remake: &Remake) -> Self {
        Self {
            capture: remake.capture.clone(),
            settings: remake.chosen.clone(),
        }
    }
}

fn load(file: &Path) -> Result<VecDeque<Remake>, String> {
    if !file.exists() {
        return Ok(VecDeque::new());
    }
    let text = read_text(file, LARGEST_FILE).map_err(|error| error.to_string())?;
    let saved: Vec<Saved> = serde_json::from_str(&text).map_err(|error| error.to_string())?;
    let remakes = saved
        .iter()
        .map(|saved| Remake::new(&saved.capture, &saved.settings));
    remakes.collect()
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
            [
                "hull.fairing=none",
                "hull.resolution=120.0",
                "hull.cell_size=0.0"
            ]
        );
        let other = new(json!({ "silhouette.spill": 0.1 })).unwrap();
        assert_eq!(other.settings, ["silhouette.spill=0.1"]);
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
        let folder = tempfile::tempdir().unwrap();
        let remakes = Remakes::open(&folder.path().join("remakes.json"));
        let remake = |n: usize| {
            let one = settings(json!({ "hull.resolution": 120 }));
            Remake::new(&format!("a-{n:04}"), &one).unwrap()
        };
        for n in 0..MOST_WAITING {
            assert_eq!(remakes.enqueue(remake(n)), Ok(n));
        }
        assert!(
            remakes
                .enqueue(remake(3))
                .unwrap_err()
                .contains("waiting already")
        );
        assert!(
            remakes
                .enqueue(remake(99))
                .unwrap_err()
                .contains("10 remakes")
        );
        assert_eq!(remakes.take(|| true), Some(remake(0)));
        assert_eq!(remakes.enqueue(remake(99)), Ok(MOST_WAITING));
        remakes.stop();
        assert!(remakes.take(|| true).is_none());
        assert!(remakes.enqueue(remake(7)).is_err());
    }

    #[test]
    fn how_many_there_are_is_told_while_the_list_is_being_written() {
        let folder = tempfile::tempdir().unwrap();
        let remakes = Remakes::open(&folder.path().join("remakes.json"));
        let chosen = settings(json!({ "hull.resolution": 120 }));
        remakes
            .enqueue(Remake::new("a-0001", &chosen).unwrap())
            .unwrap();
        let (told, answer) = std::sync::mpsc::channel();
        let written = remakes.state.lock();
        let found = std::thread::scope(|scope| {
            scope.spawn(|| told.send(remakes.len()));
            let found = answer.recv_timeout(Duration::from_secs(10));
            drop(written);
            found
        });
        assert_eq!(found, Ok(1));
    }

    #[test]
    fn what_waits_and_what_is_being_made_is_there_after_the_next_start() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("remakes.json");
        let remake = |capture: &str| {
            let one = settings(json!({ "hull.resolution": 120, "hull.fairing": "none" }));
            Remake::new(capture, &one).unwrap()
        };
        let remakes = Remakes::open(&file);
        for capture in ["a-0001", "a-0002", "a-0003"] {
            remakes.enqueue(remake(capture)).unwrap();
        }
        assert_eq!(remakes.take(|| true), Some(remake("a-0001")));
        remakes.finish();
        assert_eq!(remakes.take(|| true), Some(remake("a-0002")));
        // Killed while the second one is being made.
        drop(remakes);
        let remakes = Remakes::open(&file);
        assert_eq!(remakes.len(), 2);
        assert_eq!(remakes.take(|| true), Some(remake("a-0002")));
        remakes.finish();
        assert_eq!(remakes.take(|| true), Some(remake("a-0003")));
        remakes.finish();
        remakes.stop();
        assert_eq!(remakes.take(|| true), None);
        assert!(Remakes::open(&file).is_empty());
    }

    #[test]
    fn a_file_that_makes_no_sense_and_a_disk_that_takes_none_are_told() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("remakes.json");
        for bad in [
            "[",
            "[{\"capture\":\"../a\",\"settings\":{\"hull.resolution\":120}}]",
        ] {
            std::fs::write(&file, bad).unwrap();
            assert!(load(&file).is_err(), "{bad}");
            assert!(Remakes::open(&file).is_empty());
        }
        // No folder can be where a file is.
        let remakes = Remakes::open(&file.join("remakes.json"));
        let one = settings(json!({ "hull.resolution": 120 }));
        let refused = remakes
            .enqueue(Remake::new("a-0001", &one).unwrap())
            .unwrap_err();
        assert!(refused.contains("cannot be kept"), "{refused}");
        assert!(remakes.is_empty());
    }
}
