//! Small pictures of a look: the camera joins 2x2 pixels (binning), and is brought back at once, with every value read
//! back. How a camera is switched, when it is, and why it is not stand here; `look` takes the pictures.

use super::features::{BINNING, Features, fault};
use super::parameters::{Parameters, Region};
use crate::drivers::live::Fault;
use aravis::Camera;
use aravis::glib;
use aravis::prelude::*;
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

/// Pixels that are joined in each direction.
const JOINED: u32 = 2;
/// Small pictures in a row, after which a whole one shows what small ones cannot.
const SMALL_IN_A_ROW: u32 = 3;
/// How old the last whole picture may be when a small one is taken.
const WHOLE_LASTS: Duration = Duration::from_secs(10);
/// Small pictures in a row that did not come, or took longer than a whole one, before no more are taken.
const MOST_FAILURES: u32 = 3;
/// How soon after a small picture a capture that misses its frame puts the blame on it.
const RIGHT_AFTER: Duration = Duration::from_secs(1);
/// What a capture needs as it was, of the features that a camera has; also those of the configuration.
const WATCHED: [&str; 22] = [
    "BinningHorizontal",
    "BinningVertical",
    "DecimationHorizontal",
    "DecimationVertical",
    "Width",
    "Height",
    "OffsetX",
    "OffsetY",
    "PixelFormat",
    "PayloadSize",
    "ExposureMode",
    "ExposureTime",
    "ExposureTimeAbs",
    "Gain",
    "GainAbs",
    "GainRaw",
    "AcquisitionMode",
    "TriggerMode",
    "TriggerSource",
    "BalanceRatio",
    "GevSCPSPacketSize",
    "GevSCPD",
];

/// What is known of a camera's small pictures until the daemon ends, also when the camera is opened anew: so no camera
/// is lost to looks again and again, and none that comes back sends pictures of a trial while others take a capture.
#[derive(Default)]
pub(super) struct Experience {
    /// Why it gives none, in words.
    why_whole: OnceLock<String>,
    has_passed: OnceLock<()>,
}

/// The small pictures of one open camera.
pub(super) struct BinnedLooks {
    region: Region,
    offsets: Vec<&'static str>,
    /// What the capture needs, as it was read when the camera had been set.
    needed: Vec<(String, Value)>,
    experience: Arc<Experience>,
    /// How long the fastest whole picture took: one right after a small one may be slow because of that.
    whole_took: Option<Duration>,
    whole_at: Option<Instant>,
    small_at: Option<Instant>,
    in_a_row: u32,
    failures: u32,
}

impl BinnedLooks {
    /// Reads what the capture needs from a camera that is set and not started yet; `None` where small pictures are not
    /// asked for.
    pub(super) fn find(
        camera: &Camera,
        parameters: &Parameters,
        experience: Arc<Experience>,
    ) -> Option<Self> {
        let region = parameters
            .region
            .filter(|_| parameters.has_binned_looks())?;
        let features = Features::of(camera);
        let offsets = ["OffsetX", "OffsetY"].into_iter();
        let configured = parameters.features.iter().flatten();
        let configured = configured.map(|(name, _)| name.as_str());
        let needed = WATCHED.into_iter().chain(configured);
        let needed = needed.filter(|name| features.has(name));
        let needed = needed.filter_map(|name| Some((name.to_owned(), Value::of(camera, name)?)));
        let found = Self {
            region,
            offsets: offsets.filter(|name| features.has(name)).collect(),
            needed: needed.collect(),
            experience,
            whole_took: None,
            whole_at: None,
            small_at: None,
            in_a_row: 0,
            failures: 0,
        };
        if !BINNING.iter().all(|name| features.has(name)) {
            found.give_up("it has no BinningHorizontal and BinningVertical");
        }
        Some(found)
    }

    /// Why no small pictures are taken, in words; `None` if they are.
    pub(super) fn why_whole(&self) -> Option<&str> {
        self.experience.why_whole.get().map(String::as_str)
    }

    /// Whether it is not known yet if small pictures are safe and pay.
    pub(super) fn needs_trial(&self) -> bool {
        self.why_whole().is_none() && self.experience.has_passed.get().is_none()
    }

    /// Notes that a trial is over, and forgets its pictures, so that the first one of a look is whole.
    pub(super) fn end_trial(&mut self) {
        if self.why_whole().is_none() {
            let _ = self.experience.has_passed.set(());
        }
        (self.whole_at, self.small_at) = (None, None);
        (self.in_a_row, self.failures) = (0, 0);
    }

    /// Takes no small pictures from now on; the first reason stays.
    pub(super) fn give_up(&self, why: &str) {
        let why = format!("looks take whole pictures although binned_looks is set: {why}");
        let _ = self.experience.why_whole.set(why);
    }

    /// Width and height of small pictures in pixels.
    pub(super) fn small_size(&self) -> [u32; 2] {
        [self.region.width / JOINED, self.region.height / JOINED]
    }

    /// Width and height of whole pictures in pixels.
    pub(super) fn whole_size(&self) -> [u32; 2] {
        [self.region.width, self.region.height]
    }

    /// Whether the next picture is a small one.
    pub(super) fn is_next(&self, now: Instant) -> bool {
        let lasts = |at| now.saturating_duration_since(at) < WHOLE_LASTS;
        self.why_whole().is_none()
            && self.in_a_row < SMALL_IN_A_ROW
            && self.whole_at.is_some_and(lasts)
    }

    /// Notes a whole picture and how long it took.
    pub(super) fn took_whole(&mut self, took: Duration, now: Instant) {
        self.whole_took = Some(self.whole_took.map_or(took, |before| before.min(took)));
        self.whole_at = Some(now);
        self.in_a_row = 0;
        self.small_at = None;
    }

    /// Notes a small picture, and how long it took with the way there and back; `None` if it did not come.
    pub(super) fn took_small(&mut self, took: Option<Duration>, now: Instant) {
        self.in_a_row += 1;
        self.small_at = Some(now);
        match self.does_not_pay(took) {
            None => self.failures = 0,
            Some(why) => {
                self.failures += 1;
                if self.failures >= MOST_FAILURES {
                    self.give_up(&why);
                }
            }
        }
    }

    /// Why a small picture that took so long is worse for a press than a whole one; `None` if it is not.
    pub(super) fn does_not_pay(&self, small: Option<Duration>) -> Option<String> {
        let ms = |took: Duration| took.as_secs_f64() * 1e3;
        match (small, self.whole_took) {
            (None, _) => Some("small ones did not arrive".into()),
            (Some(small), Some(whole)) if small > whole => Some(format!(
                "a small one takes {:.0} ms with the way there and back, and a whole one {:.0} ms",
                ms(small),
                ms(whole)
            )),
            _ => None,
        }
    }

    /// Whether a small picture was taken just before, once.
    pub(super) fn was_small(&mut self, now: Instant) -> bool {
        let at = self.small_at.take();
        at.is_some_and(|at| now.saturating_duration_since(at) < RIGHT_AFTER)
    }

    /// Sets a running camera to small pictures.
    ///
    /// # Errors
    /// If it does not take that, or is away. Its mode is in doubt then, until it is back.
    pub(super) fn enter(&self, camera: &Camera) -> Result<(), Fault> {
        let Region {
            x,
            y,
            width,
            height,
        } = self.region;
        let [x, y, width, height] = [x, y, width, height].map(|side| side / JOINED);
        let small = Region {
            x,
            y,
            width,
            height,
        };
        self.set(camera, small, JOINED)?;
        start(camera)
    }

    /// Brings a camera back to what the capture needs, and compares all of it.
    ///
    /// # Errors
    /// If it did not come back as it was, or is away.
    pub(super) fn leave(&self, camera: &Camera) -> Result<(), Fault> {
        self.set(camera, self.region, 1)?;
        for (name, needed) in &self.needed {
            let asked = needed.words();
            let found = needed.again(camera, name);
            let found = found.map_err(|error| fault(name, &asked, &error))?;
            if found != *needed {
                return Err(Fault::Refused {
                    field: name.clone(),
                    asked,
                    found: found.words(),
                });
            }
        }
        start(camera)
    }

    /// Stops a camera, for size and binning are locked while it runs, and sets both. A large picture has no room for an
    /// offset, so that goes first, and comes last.
    fn set(&self, camera: &Camera, region: Region, joined: u32) -> Result<(), Fault> {
        let stopped = camera.stop_acquisition();
        stopped.map_err(|error| fault("AcquisitionStop", "a stop", &error))?;
        let mut features = Features::of(camera);
        for name in &self.offsets {
            features.integer_unbounded(name, 0)?;
        }
        for name in BINNING {
            features.integer_unbounded(name, joined.into())?;
        }
        features.integer_unbounded("Width", region.width.into())?;
        features.integer_unbounded("Height", region.height.into())?;
        for name in &self.offsets {
            let offset = if *name == "OffsetX" {
                region.x
            } else {
                region.y
            };
            if offset != 0 {
                features.integer_unbounded(name, offset.into())?;
            }
        }
        Ok(())
    }
}

fn start(camera: &Camera) -> Result<(), Fault> {
    let started = camera.start_acquisition();
    started.map_err(|error| fault("AcquisitionStart", "a start", &error))
}

/// A feature's value, in the form in which the camera gives it.
#[derive(Clone, Debug, PartialEq)]
enum Value {
    Integer(i64),
    Float(f64),
    Boolean(bool),
    Text(String),
}

impl Value {
    /// A feature's value in the first form in which it can be read; `None` if it cannot.
    fn of(camera: &Camera, name: &str) -> Option<Self> {
        let forms = [
            Self::Integer(0),
            Self::Float(0.0),
            Self::Boolean(false),
            Self::Text(String::new()),
        ];
        forms.iter().find_map(|form| form.again(camera, name).ok())
    }

    /// What the feature has now, in the same form.
    fn again(&self, camera: &Camera, name: &str) -> Result<Self, glib::Error> {
        Ok(match self {
            Self::Integer(_) => Self::Integer(camera.integer(name)?),
            Self::Float(_) => Self::Float(camera.float(name)?),
            Self::Boolean(_) => Self::Boolean(camera.boolean(name)?),
            Self::Text(_) => Self::Text(camera.string(name)?.to_string()),
        })
    }

    fn words(&self) -> String {
        match self {
            Self::Integer(value) => value.to_string(),
            Self::Float(value) => value.to_string(),
            Self::Boolean(value) => value.to_string(),
            Self::Text(value) => value.clone(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn looks() -> BinnedLooks {
        BinnedLooks {
            region: Region {
                x: 8,
                y: 4,
                width: 640,
                height: 480,
            },
            offsets: Vec::new(),
            needed: Vec::new(),
            experience: Arc::default(),
            whole_took: None,
            whole_at: None,
            small_at: None,
            in_a_row: 0,
            failures: 0,
        }
    }

    const MS: Duration = Duration::from_millis(1);

    #[test]
    fn every_fourth_picture_is_whole_and_so_is_the_first() {
        let mut looks = looks();
        let mut now = Instant::now();
        let mut small = Vec::new();
        for _ in 0..9 {
            now += 500 * MS;
            small.push(looks.is_next(now));
            match looks.is_next(now) {
                true => looks.took_small(Some(60 * MS), now),
                false => looks.took_whole(100 * MS, now),
            }
        }
        let expected = [false, true, true, true, false, true, true, true, false];
        assert_eq!(small, expected);
        // After a pause nothing that is known is new enough.
        assert!(!looks.is_next(now + WHOLE_LASTS));
        assert_eq!(looks.small_size(), [320, 240]);
        assert!(looks.why_whole().is_none());
    }

    #[test]
    fn small_pictures_that_are_slow_or_lost_three_times_in_a_row_end() {
        for took in [Some(101 * MS), None] {
            let mut looks = looks();
            let now = Instant::now();
            looks.took_whole(100 * MS, now);
            looks.took_small(took, now);
            looks.took_small(took, now);
            looks.took_small(Some(100 * MS), now);
            looks.took_whole(100 * MS, now);
            looks.took_small(took, now);
            looks.took_small(took, now);
            assert!(looks.why_whole().is_none() && looks.is_next(now));
            looks.took_small(took, now);
            let why = looks.why_whole().unwrap().to_owned();
            assert!(
                why.contains("101 ms") || why.contains("did not arrive"),
                "{why}"
            );
            looks.took_whole(100 * MS, now);
            assert!(!looks.is_next(now));
        }
    }

    #[test]
    fn a_capture_right_after_a_small_picture_is_told_apart() {
        let mut looks = looks();
        let now = Instant::now();
        assert!(!looks.was_small(now));
        looks.took_small(Some(MS), now);
        assert!(looks.was_small(now + 20 * MS) && !looks.was_small(now + 20 * MS));
        looks.took_small(Some(MS), now);
        assert!(!looks.was_small(now + RIGHT_AFTER));
        looks.took_small(Some(MS), now);
        looks.took_whole(MS, now);
        assert!(!looks.was_small(now));
    }
}
