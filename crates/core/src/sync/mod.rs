//! Joins frames and triggers to captures, complete or failed: a pure state machine with no clock, no thread and no
//! I/O. It looks only at timestamps, so a replay and a live rig give the same captures. `H` stands for a frame: a
//! reference into a recording, or the frame itself.
//!
//! A capture's window opens at its trigger less the tolerance and closes after the window's length or where the next
//! trigger's window opens, whichever comes first. The windows are disjoint, so no frame serves two captures. Frames
//! that a recording lists for a capture belong to it, whatever its window.

mod free_running;

pub use free_running::FreeRunning;

use crate::frame::{CameraId, CaptureId, Stream, Timestamp, Trigger};
use crate::words::count;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::fmt;

/// How frames are chosen.
#[derive(serde::Deserialize, serde::Serialize, Clone, Debug, PartialEq)]
#[serde(deny_unknown_fields, default)]
pub struct Parameters {
    /// How much before its trigger a frame of a capture may begin, in milliseconds.
    /// Default 5, range 0 to 3600000.
    #[serde(deserialize_with = "crate::range::milliseconds")]
    pub tolerance_ms: f64,
    /// How long after its trigger a capture takes frames, in milliseconds.
    /// Default 2000, range 0 to 3600000.
    #[serde(deserialize_with = "crate::range::milliseconds")]
    pub window_ms: f64,
    /// Which colour cameras run freely, so that the frame nearest to the trigger counts rather than the first
    /// one after it: true for all, false for none, or a list of names. Default false.
    pub nearest_color: FreeRunning,
    /// Frames of each depth camera that a capture takes.
    /// Default 30, range 0 to 1000.
    #[serde(deserialize_with = "crate::range::count::<_, usize, 0, 1000>")]
    pub depth_frames: usize,
    /// Fewest frames of each depth camera that make a capture complete.
    /// Default 10, range 0 to 1000.
    #[serde(deserialize_with = "crate::range::count::<_, usize, 0, 1000>")]
    pub min_depth_frames: usize,
    /// Whether a capture goes on without a camera that gave too few frames. Default false.
    pub go_on_without_missing: bool,
}

impl Default for Parameters {
    fn default() -> Self {
        Self {
            tolerance_ms: 5.0,
            window_ms: 2000.0,
            nearest_color: FreeRunning::default(),
            depth_frames: 30,
            min_depth_frames: 10,
            go_on_without_missing: false,
        }
    }
}

impl Parameters {
    /// Checks that the parameters agree with each other.
    ///
    /// # Errors
    /// If no capture of a depth camera could be complete, with the names of both fields.
    pub fn checked(&self) -> Result<(), String> {
        let (most, fewest) = (self.depth_frames, self.min_depth_frames);
        if fewest > most {
            return Err(format!(
                "sync.min_depth_frames is {fewest}, expected at most sync.depth_frames, which is {most}: no capture would be \
                complete"
            ));
        }
        Ok(())
    }

    fn tolerance_ns(&self) -> u64 {
        nanoseconds(self.tolerance_ms)
    }

    fn window_ns(&self) -> u64 {
        nanoseconds(self.window_ms)
    }
}

/// Milliseconds as nanoseconds; the conversion saturates, so nonsense cannot overflow.
fn nanoseconds(milliseconds: f64) -> u64 {
    (milliseconds * 1e6) as u64
}

/// The cameras whose frames make a capture.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Cameras {
    /// Colour cameras.
    pub colors: BTreeSet<CameraId>,
    /// Depth cameras, and whether they have colour pictures of their own.
    pub depths: BTreeMap<CameraId, bool>,
}

/// The frames of each camera that a recording says are a capture's.
pub type Listed = BTreeMap<CameraId, Vec<Timestamp>>;

/// A frame that was handed in.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TimedFrame<H> {
    /// When its exposure began.
    pub timestamp: Timestamp,
    /// What stands for it.
    pub handle: H,
}

/// A depth frame with the colour picture nearest in time, if there is one.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DepthWithColor<H> {
    /// The readings.
    pub depth: TimedFrame<H>,
    /// The colour picture.
    pub color: Option<TimedFrame<H>>,
}

/// A camera that gave too few frames.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Shortfall {
    /// The camera.
    pub camera: CameraId,
    /// `Color` or `Depth`.
    pub stream: Stream,
    /// Frames it gave.
    pub found: usize,
    /// Fewest that would do.
    pub needed: usize,
    /// Time of the trigger.
    pub trigger: Timestamp,
    /// Where frames were looked for.
    pub window: [Timestamp; 2],
    /// Time of the frame nearest to the trigger that is no other capture's.
    pub nearest: Option<Timestamp>,
}

impl fmt::Display for Shortfall {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ms = |t: Timestamp| t.nanoseconds_since(self.trigger) as f64 / 1e6;
        let kind = match self.stream {
            Stream::Color => "colour",
            Stream::Depth | Stream::DepthColor => "depth",
        };
        let found = match self.found {
            0 => "no frame".to_owned(),
            found => count(found, "frame"),
        };
        write!(
            f,
            "{kind} camera {} gave {found} from {:.1} to {:.1} ms after the trigger, expected at least {}",
            self.camera,
            ms(self.window[0]),
            ms(self.window[1]),
            self.needed,
        )?;
        match self.nearest {
            Some(t) => write!(f, "; its nearest frame is at {:.1} ms", ms(t)),
            None if self.found == 0 => write!(f, "; it has no frame that this capture could take"),
            None => Ok(()),
        }
    }
}

/// What came of a trigger.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Capture<H> {
    /// What asked for it.
    pub trigger: Trigger,
    /// The frame of each colour camera that gave one.
    pub colors: BTreeMap<CameraId, TimedFrame<H>>,
    /// The frames of each depth camera that gave enough, oldest first.
    pub depths: BTreeMap<CameraId, Vec<DepthWithColor<H>>>,
    /// Cameras that gave too few.
    pub shortfalls: Vec<Shortfall>,
    /// Whether the capture goes on with what it has.
    pub complete: bool,
}

impl<H> Capture<H> {
    /// Spread of the colour frames' timestamps in nanoseconds.
    pub fn skew_ns(&self) -> u64 {
        let times = || self.colors.values().map(|c| c.timestamp.0);
        times().max().unwrap_or(0) - times().min().unwrap_or(0)
    }

    /// Why it failed, in words; empty when nothing was short. Cameras without any frame, as where a recording was cut
    /// off, are named together.
    pub fn reason(&self) -> String {
        let all = self.shortfalls.iter();
        let (without, short): (Vec<&Shortfall>, Vec<&Shortfall>) =
            all.partition(|shortfall| shortfall.found == 0 && shortfall.nearest.is_none());
        let told = short.iter().take(MOST_TOLD).map(ToString::to_string);
        let mut reasons: Vec<String> = without_frames(&without).into_iter().chain(told).collect();
        if let Some(more) = short.len().checked_sub(MOST_TOLD).filter(|n| *n > 0) {
            reasons.push(format!("and {more} more cameras"));
        }
        reasons.join("; ")
    }
}

/// Most cameras that a reason names.
const MOST_TOLD: usize = 20;

/// The reason of cameras that have no frame for a capture: that of the first, and the names of the others.
fn without_frames(shortfalls: &[&Shortfall]) -> Option<String> {
    let (first, others) = shortfalls.split_first()?;
    let named = others.iter().take(MOST_TOLD);
    let named: Vec<&str> = named.map(|other| other.camera.as_str()).collect();
    let names = named.join(", ");
    Some(match others.len() - named.len() {
        _ if named.is_empty() => first.to_string(),
        0 => format!("{first}, and neither have {names}"),
        more => format!("{first}, and neither have {names} and {more} more cameras"),
    })
}

/// A trigger whose capture is still open.
struct Open {
    trigger: Trigger,
    listed: Listed,
}

/// Assembles captures. Hand in frames and triggers in any order, and say with [`Self::advance`] until when
/// they are all there: what comes out depends on the timestamps alone.
pub struct Synchronizer<H> {
    parameters: Parameters,
    cameras: Cameras,
    streams: BTreeMap<(CameraId, Stream), VecDeque<TimedFrame<H>>>,
    open: VecDeque<Open>,
    seen: BTreeSet<CaptureId>,
    /// Where the window of the last closed capture ended.
    closed_until: Timestamp,
}

impl<H: Clone> Synchronizer<H> {
    /// Starts with no frames.
    pub fn new(cameras: Cameras, parameters: Parameters) -> Self {
        Self {
            parameters,
            cameras,
            streams: BTreeMap::new(),
            open: VecDeque::new(),
            seen: BTreeSet::new(),
            closed_until: Timestamp(0),
        }
    }

    /// Takes a frame. Frames of cameras that are not the rig's are dropped, and so is a second frame of one
    /// camera with the same timestamp.
    pub fn push_frame(
        &mut self,
        camera: &CameraId,
        stream: Stream,
        timestamp: Timestamp,
        handle: H,
    ) {
        let known = match stream {
            Stream::Color => self.cameras.colors.contains(camera),
            Stream::Depth | Stream::DepthColor => self.cameras.depths.contains_key(camera),
        };
        if !known {
            return;
        }
        let frames = self.streams.entry((camera.clone(), stream)).or_default();
        let at = frames.partition_point(|f| f.timestamp < timestamp);
        if frames.get(at).is_none_or(|f| f.timestamp != timestamp) {
            frames.insert(at, TimedFrame { timestamp, handle });
        }
    }

    /// Takes a trigger, and the frames that a recording lists for it. Returns false, and makes no capture,
    /// when there was a trigger of this id before.
    pub fn push_trigger(&mut self, trigger: Trigger, mut listed: Listed) -> bool {
        if !self.seen.insert(trigger.id.clone()) {
            return false;
        }
        let at = self
            .open
            .partition_point(|o| (o.trigger.time, &o.trigger.id) < (trigger.time, &trigger.id));
        // Sorted, because each of a camera's frames is looked for in it.
        listed.values_mut().for_each(|times| times.sort_unstable());
        self.open.insert(at, Open { trigger, listed });
        true
    }

    /// Closes every capture that nothing later than `complete_until` can change: its window has passed, or
    /// it has all it may take. All frames and triggers before that time must have been handed in.
    pub fn advance(&mut self, complete_until: Timestamp) -> Vec<Capture<H>> {
        let mut done = Vec::new();
        // A trigger that is not known yet opens its window at the earliest here.
        let settled = complete_until
            .0
            .saturating_sub(self.parameters.tolerance_ns());
        while let Some(first) = self.open.front() {
            let window = self.window_of_first(first);
            if window[1].0 > settled && !self.has_all(first, window, Timestamp(settled)) {
                break;
            }
            done.extend(self.close_first(window));
        }
        self.forget(complete_until);
        done
    }

    /// Whether every camera has given all that the oldest open capture may take, before `settled`.
    fn has_all(&self, open: &Open, window: [Timestamp; 2], settled: Timestamp) -> bool {
        let nothing = VecDeque::new();
        let frames = |camera: &CameraId, stream| {
            let key = (camera.clone(), stream);
            self.streams.get(&key).unwrap_or(&nothing)
        };
        let satisfied = |camera: &CameraId, stream, wanted: usize| {
            let frames = frames(camera, stream);
            let chosen = self.chosen(camera, stream, frames, open, window);
            let wanted = open.listed.get(camera).map_or(wanted, Vec::len);
            let last = chosen.last().map(|&i| frames[i].timestamp);
            (chosen.len() >= wanted && last.is_some_and(|t| t < settled)).then_some(last)
        };
        let later = |camera: &CameraId, stream, than: Timestamp| {
            let last = frames(camera, stream).back();
            last.is_some_and(|f| than <= f.timestamp && f.timestamp < settled)
        };
        let colors = self.cameras.colors.iter().all(|camera| {
            let runs_freely = self.parameters.nearest_color.contains(camera);
            let nearest = runs_freely && !open.listed.contains_key(camera);
            let decided = !nearest || later(camera, Stream::Color, open.trigger.time);
            decided && satisfied(camera, Stream::Color, 1).is_some()
        });
        let depth_frames = self.parameters.depth_frames;
        colors
            && self.cameras.depths.iter().all(|(camera, &has_color)| {
                let last = satisfied(camera, Stream::Depth, depth_frames).flatten();
                last.is_some_and(|t| !has_color || later(camera, Stream::DepthColor, t))
            })
    }

    /// Closes all captures: nothing more will come for them. Their ids are free again: a session of the daemon may
    /// be named like one whose recording has been moved away.
    pub fn finish(&mut self) -> Vec<Capture<H>> {
        let mut done = Vec::new();
        while let Some(first) = self.open.front() {
            let window = self.window_of_first(first);
            done.extend(self.close_first(window));
        }
        self.seen.clear();
        done
    }

    /// Where the frames of the oldest open capture are looked for.
    fn window_of_first(&self, first: &Open) -> [Timestamp; 2] {
        let time = first.trigger.time.0;
        let tolerance = self.parameters.tolerance_ns();
        let start = time.saturating_sub(tolerance);
        let mut end = time.saturating_add(self.parameters.window_ns());
        if let Some(next) = self.open.get(1) {
            end = end.min(next.trigger.time.0.saturating_sub(tolerance));
        }
        [Timestamp(start), Timestamp(end.max(start))]
    }

    fn close_first(&mut self, window: [Timestamp; 2]) -> Option<Capture<H>> {
        let open = self.open.pop_front()?;
        let mut capture = Capture {
            trigger: open.trigger.clone(),
            colors: BTreeMap::new(),
            depths: BTreeMap::new(),
            shortfalls: Vec::new(),
            complete: false,
        };
        for camera in self.cameras.colors.clone() {
            let taken = self.take(&camera, Stream::Color, &open, window);
            match taken.into_iter().next() {
                Some(frame) => drop(capture.colors.insert(camera, frame)),
                None => {
                    let shortfall = self.shortfall(camera, Stream::Color, 0, &open, window);
                    capture.shortfalls.push(shortfall);
                }
            }
        }
        for camera in self.cameras.depths.clone().into_keys() {
            let taken = self.take(&camera, Stream::Depth, &open, window);
            if taken.len() >= self.parameters.min_depth_frames.max(1) {
                let takes = self.with_colors(&camera, taken, window);
                capture.depths.insert(camera, takes);
            } else {
                let shortfall = self.shortfall(camera, Stream::Depth, taken.len(), &open, window);
                capture.shortfalls.push(shortfall);
            }
        }
        capture.complete = capture.shortfalls.is_empty() || self.parameters.go_on_without_missing;
        self.closed_until = window[1];
        Some(capture)
    }

    /// Takes a camera's frames for a capture out of its stream.
    fn take(
        &mut self,
        camera: &CameraId,
        stream: Stream,
        open: &Open,
        window: [Timestamp; 2],
    ) -> Vec<TimedFrame<H>> {
        let key = (camera.clone(), stream);
        let Some(frames) = self.streams.get(&key) else {
            return Vec::new();
        };
        let chosen = self.chosen(camera, stream, frames, open, window);
        let frames = self.streams.entry(key).or_default();
        let taken = chosen.iter().map(|&i| frames[i].clone()).collect();
        for i in chosen.into_iter().rev() {
            frames.remove(i);
        }
        taken
    }

    /// A camera's frames for a capture, as indices in the order of time.
    fn chosen(
        &self,
        camera: &CameraId,
        stream: Stream,
        frames: &VecDeque<TimedFrame<H>>,
        open: &Open,
        window: [Timestamp; 2],
    ) -> Vec<usize> {
        match open.listed.get(camera) {
            Some(listed) => (0..frames.len())
                .filter(|&i| listed.binary_search(&frames[i].timestamp).is_ok())
                .collect(),
            None => self.chosen_by_rule(camera, stream, frames, open, window),
        }
    }

    fn chosen_by_rule(
        &self,
        camera: &CameraId,
        stream: Stream,
        frames: &VecDeque<TimedFrame<H>>,
        open: &Open,
        window: [Timestamp; 2],
    ) -> Vec<usize> {
        let trigger = open.trigger.time;
        let promised = |t: &Timestamp| {
            let lists = |o: &Open| {
                let listed = o.listed.get(camera);
                listed.is_some_and(|l| l.binary_search(t).is_ok())
            };
            self.open.iter().any(lists)
        };
        let nearest = stream == Stream::Color && self.parameters.nearest_color.contains(camera);
        let back = trigger.0.saturating_sub(self.parameters.window_ns());
        let start = if nearest { Timestamp(back) } else { window[0] };
        let first = frames.partition_point(|f| f.timestamp < start);
        let end = frames.partition_point(|f| f.timestamp < window[1]);
        let mut free = (first..end).filter(|&i| !promised(&frames[i].timestamp));
        match stream {
            Stream::Color if nearest => free
                .min_by_key(|&i| distance(frames[i].timestamp, trigger))
                .into_iter()
                .collect(),
            Stream::Color => free.next().into_iter().collect(),
            _ => free.take(self.parameters.depth_frames).collect(),
        }
    }

    /// Gives each depth frame the colour frame nearest in time, the earlier one of two.
    fn with_colors(
        &mut self,
        camera: &CameraId,
        taken: Vec<TimedFrame<H>>,
        window: [Timestamp; 2],
    ) -> Vec<DepthWithColor<H>> {
        let colors = self
            .streams
            .entry((camera.clone(), Stream::DepthColor))
            .or_default();
        // Not from the window before; but frames that were listed may lie outside their window.
        let first = taken
            .first()
            .map_or(window[0], |f| f.timestamp.min(window[0]));
        let listed_until = taken.last().map_or(0, |f| f.timestamp.0.saturating_add(1));
        let end = window[1].max(Timestamp(listed_until));
        let back = first.0.saturating_sub(self.parameters.window_ns());
        let start = Timestamp(back).max(self.closed_until.min(first));
        let near: Vec<TimedFrame<H>> = colors
            .iter()
            .filter(|c| start <= c.timestamp && c.timestamp < end)
            .cloned()
            .collect();
        let nearest = |t: Timestamp| near.iter().min_by_key(|c| distance(c.timestamp, t));
        taken
            .into_iter()
            .map(|depth| DepthWithColor {
                color: nearest(depth.timestamp).cloned(),
                depth,
            })
            .collect()
    }

    fn shortfall(
        &self,
        camera: CameraId,
        stream: Stream,
        found: usize,
        open: &Open,
        window: [Timestamp; 2],
    ) -> Shortfall {
        let trigger = open.trigger.time;
        let frames = self.streams.get(&(camera.clone(), stream));
        let times = frames.into_iter().flatten().map(|f| f.timestamp);
        Shortfall {
            needed: match stream {
                Stream::Color => 1,
                _ => self.parameters.min_depth_frames.max(1),
            },
            nearest: times.min_by_key(|&t| distance(t, trigger)),
            camera,
            stream,
            found,
            trigger,
            window,
        }
    }

    /// Drops frames that no capture can want any more.
    fn forget(&mut self, complete_until: Timestamp) {
        let oldest_trigger = self.open.front().map_or(complete_until, |o| o.trigger.time);
        let listed = self.open.iter().flat_map(|o| o.listed.values().flatten());
        let oldest = listed.copied().min().unwrap_or(oldest_trigger);
        let wanted = oldest.min(oldest_trigger).min(complete_until).0;
        let (window, tolerance) = (self.parameters.window_ns(), self.parameters.tolerance_ns());
        let keep_from = Timestamp(wanted.saturating_sub(window.saturating_add(tolerance)));
        for frames in self.streams.values_mut() {
            let drop = frames.partition_point(|f| f.timestamp < keep_from);
            frames.drain(..drop);
        }
    }
}

fn distance(a: Timestamp, b: Timestamp) -> u64 {
    a.0.abs_diff(b.0)
}

#[cfg(test)]
mod tests;
