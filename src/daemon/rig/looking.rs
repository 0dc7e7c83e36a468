//! Pictures that are taken to be looked at, one camera at a time and never recorded. A shot waits for the picture that
//! is in transfer, and for no other. Cameras that a signal triggers do not wait, so beside them only depth cameras are
//! asked for pictures: the signal's frames are kept until the shot comes, and a burst may begin later.

use super::{CameraKind, Rig, State};
use crate::daemon::systemd::Heartbeat;
use crate::drivers::live::{Fault, LookResult, Shot};
use crate::frame::{CameraId, Timestamp};
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// How much longer than its camera's last ones a picture may take while a press waits for it.
const GRACE: Duration = Duration::from_millis(100);
/// How long a picture may take where a signal triggers cameras. A capture's window runs meanwhile, and no second signal
/// would come.
const LONGEST_BESIDE_SIGNALS: Duration = Duration::from_millis(500);

/// How many of a camera's last pictures say how long the next one takes: some are small, and every fourth is whole.
const LAST_PICTURES: usize = 4;

/// What came of a look at a camera.
#[derive(Debug)]
pub(in crate::daemon) struct RigLook {
    /// The camera.
    pub(in crate::daemon) camera: CameraId,
    /// What it gave, or why there is nothing.
    pub(in crate::daemon) outcome: Result<LookResult, Fault>,
}

/// The picture that is in transfer, and what became of the last one.
#[derive(Default)]
pub(super) struct LookProgress {
    now: Option<InTransfer>,
    done: Option<RigLook>,
    /// How long each camera's last pictures took, the newest last.
    took: BTreeMap<CameraId, VecDeque<Duration>>,
}

struct InTransfer {
    camera: CameraId,
    begun: Instant,
    shot: Shot,
}

impl LookProgress {
    /// How long the longest of a camera's last pictures took; `None` before the first.
    fn longest(&self, camera: &CameraId) -> Option<Duration> {
        self.took.get(camera)?.iter().max().copied()
    }

    fn note_time(&mut self, camera: &CameraId, took: Duration) {
        let last = self.took.entry(camera.clone()).or_default();
        last.push_back(took);
        if last.len() > LAST_PICTURES {
            last.pop_front();
        }
    }
}

impl Rig {
    /// Why no picture of a camera can be taken for a look now, in words; `None` if one can.
    pub(in crate::daemon) fn cannot_look(&self, id: &CameraId) -> Option<String> {
        let camera = self.cameras.get(id)?;
        match (&camera.state, camera.kind) {
            (State::Opening, _) => Some("it has not been opened yet".into()),
            (State::Away(fault), _) => Some(fault.to_string()),
            (State::Ready(_), CameraKind::DepthInTurn) => Some(
                "it runs only while a capture is taken, because depth cameras take turns (take_turns)".into(),
            ),
            (State::Ready(_), CameraKind::Color) if !camera.needs_signal => {
                let (signalled, _) = self.cameras.iter().find(|(_, c)| c.needs_signal)?;
                Some(format!(
                    "the signal on the line of camera {signalled} does not wait for a look, and then this camera would \
                     expose too late: press to see pictures"
                ))
            }
            (State::Ready(_), CameraKind::Color | CameraKind::Depth) => None,
        }
    }

    fn has_signals(&self) -> bool {
        self.cameras.values().any(|camera| camera.needs_signal)
    }

    /// Asks a camera for a picture, which is there `at_most` so long later; false if one is in transfer already, or the
    /// camera is busy.
    pub(in crate::daemon) fn begin_look(&mut self, id: &CameraId, at_most: Duration) -> bool {
        if self.looking.now.is_some() {
            return false;
        }
        let Some(camera) = self.cameras.get(id) else {
            return false;
        };
        let longest = match self.has_signals() {
            true => LONGEST_BESIDE_SIGNALS,
            false => Duration::MAX,
        };
        self.shots += 1;
        let begun = self.clock.now();
        let shot = Shot {
            number: self.shots,
            trigger: self.clock.timestamp(),
            deadline: begun + at_most.min(longest),
            clock: self.clock,
            abandoned: Arc::new(AtomicBool::new(false)),
        };
        if !camera.thread.look(shot.clone()) {
            return false;
        }
        let camera = id.clone();
        self.looking.now = Some(InTransfer {
            camera,
            begun,
            shot,
        });
        true
    }

    /// Whether a picture is in transfer. One that has not come by its deadline is given up.
    pub(in crate::daemon) fn is_looking(&mut self) -> bool {
        let overdue = self.looking.now.as_ref();
        if overdue.is_some_and(|look| self.clock.until(look.shot.deadline).is_zero()) {
            self.abandon_look();
        }
        self.looking.now.is_some()
    }

    /// What became of the last picture, once.
    pub(in crate::daemon) fn take_look(&mut self) -> Option<RigLook> {
        self.looking.done.take()
    }

    /// Waits until no picture is in transfer: until the end of the one that is, with the way back from a small one, but
    /// not much longer than the camera took for those before, for it may never come. The picture itself is dropped.
    /// Returns the time of the trigger that waits, and the cameras whose state changed meanwhile. Where a signal
    /// triggers cameras, the trigger is as old as the wait is long, so that what the signal exposed still belongs to
    /// it.
    pub(in crate::daemon) fn end_look(
        &mut self,
        heartbeat: &Heartbeat,
    ) -> (Timestamp, BTreeSet<CameraId>) {
        let heard = self.clock.timestamp();
        let mut changed = BTreeSet::new();
        while let Some(look) = &self.looking.now {
            heartbeat.tick();
            let took = self.looking.longest(&look.camera);
            let expected = took.map(|took| look.begun + 2 * took + GRACE);
            let until = expected.map_or(look.shot.deadline, |e| e.min(look.shot.deadline));
            let left = self.clock.until(until);
            let wait = left.min(Heartbeat::INTERVAL);
            match self.clock.recv_timeout(&self.events, wait) {
                Ok(message) => {
                    let camera = message.camera.clone();
                    if self.note(message) {
                        changed.insert(camera);
                    }
                }
                Err(_) if left.is_zero() => self.abandon_look(),
                Err(_) => {}
            }
        }
        self.looking.done = None;
        let trigger = match self.has_signals() {
            true => heard,
            false => self.clock.timestamp(),
        };
        (trigger, changed)
    }

    /// Notes the end of a look, if it is the one that is in transfer.
    pub(super) fn note_look(
        &mut self,
        camera: CameraId,
        number: u64,
        outcome: Result<LookResult, Fault>,
    ) {
        let Some(look) = self.looking.now.take_if(|look| look.shot.number == number) else {
            return;
        };
        if outcome.as_ref().is_ok_and(|found| !found.frames.is_empty()) {
            let took = self.clock.elapsed(look.begun);
            self.looking.note_time(&camera, took);
        }
        self.looking.done = Some(RigLook { camera, outcome });
    }

    fn abandon_look(&mut self) {
        if let Some(look) = self.looking.now.take() {
            look.shot.abandoned.store(true, Ordering::Relaxed);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_whole_picture_may_take_as_long_as_the_last_whole_one_also_after_small_ones() {
        let camera = CameraId::new("c00").unwrap();
        let mut progress = LookProgress::default();
        assert_eq!(progress.longest(&camera), None);
        let ms = Duration::from_millis;
        for took in [500, 130, 130, 130] {
            progress.note_time(&camera, ms(took));
            assert_eq!(progress.longest(&camera), Some(ms(500)));
        }
        progress.note_time(&camera, ms(400));
        assert_eq!(progress.longest(&camera), Some(ms(400)));
    }
}
