//! All cameras' threads: sends a shot to each of them, collects their answers, and tracks their state between
//! shots. It never waits for a camera longer than a shot may take.

mod looking;

use super::systemd::Heartbeat;
use crate::clock::Clock;
use crate::drivers::live::{
    Backoff, CameraEvent, CameraInfo, Driver, Fault, Message, Shot, ShotStats, StoppingThread,
    Supervised, supervise,
};
use crate::frame::{CameraId, Frame, Timestamp};
use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, bounded};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

pub(super) use looking::RigLook;

/// What a camera contributes to a capture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum CameraKind {
    /// One colour picture.
    Color,
    /// A burst of depth frames.
    Depth,
    /// A burst of depth frames, never at the same time as another camera of this kind: their patterns would interfere.
    DepthInTurn,
}

/// A camera of the rig that has not been started yet.
pub struct RigCamera {
    /// The camera.
    pub id: CameraId,
    /// What it is to a capture.
    pub kind: CameraKind,
    /// Whether it takes its pictures only at a signal of its line, whenever that comes.
    pub needs_signal: bool,
    /// Opens it.
    pub driver: Box<dyn Driver>,
}

/// A camera's state.
#[derive(Clone, Debug)]
pub(super) enum State {
    /// It has not been opened yet.
    Opening,
    /// It works.
    Ready(Box<CameraInfo>),
    /// It does not.
    Away(Fault),
}

/// The result of a shot.
#[derive(Debug, Default)]
pub(super) struct ShotResult {
    /// Complete frames, in order of arrival.
    pub frames: Vec<Frame>,
    /// Each camera's answer: the statistics of its shot, or why it took none.
    pub answers: BTreeMap<CameraId, Result<ShotStats, Fault>>,
    /// Cameras whose state changed meanwhile.
    pub changed: BTreeSet<CameraId>,
}

/// The cameras' threads.
pub struct Rig {
    cameras: BTreeMap<CameraId, Camera>,
    events: Receiver<Message>,
    clock: Clock,
    shots: u64,
    /// Frames that arrived after their shot had ended.
    late_frames: u64,
    looking: looking::LookProgress,
}

struct Camera {
    kind: CameraKind,
    needs_signal: bool,
    thread: Supervised,
    state: State,
    /// Its last report of its health.
    health: Vec<[String; 2]>,
}

impl Rig {
    /// Starts a thread for each camera. `frames_a_shot` is the largest number of frames of all cameras together.
    ///
    /// # Errors
    /// If the system cannot start a thread.
    pub fn start(
        rig_cameras: Vec<RigCamera>,
        clock: Clock,
        frames_a_shot: usize,
        backoff: Backoff,
    ) -> std::io::Result<Self> {
        // Space for a whole shot and the reports meanwhile, so that no camera's thread waits.
        let (sender, events) = bounded(2 * frames_a_shot + 16 * rig_cameras.len() + 16);
        let mut cameras = BTreeMap::new();
        for rig_camera in rig_cameras {
            let camera = start_camera(&rig_camera.id.clone(), rig_camera, &sender, backoff)?;
            cameras.insert(camera.thread.camera().clone(), camera);
        }
        Ok(Self {
            cameras,
            events,
            clock,
            shots: 0,
            late_frames: 0,
            looking: looking::LookProgress::default(),
        })
    }

    /// The host's timeline.
    pub(super) fn clock(&self) -> Clock {
        self.clock
    }

    /// What the cameras report between shots.
    pub(super) fn events(&self) -> &Receiver<Message> {
        &self.events
    }

    /// Frames since the start that arrived after their shot had ended.
    pub(super) fn late_frames(&self) -> u64 {
        self.late_frames
    }

    /// Each camera and what is known of it.
    pub(super) fn states(&self) -> impl Iterator<Item = (&CameraId, CameraKind, &State)> {
        self.cameras.iter().map(|(id, c)| (id, c.kind, &c.state))
    }

    /// A camera's last report of its health: names and values.
    pub(super) fn health(&self, camera: &CameraId) -> &[[String; 2]] {
        self.cameras.get(camera).map_or(&[], |c| &c.health)
    }

    /// Records what a camera reports between shots; true if its state changed.
    pub(super) fn note(&mut self, message: Message) -> bool {
        if let CameraEvent::Looked { shot, outcome } = message.event {
            self.note_look(message.camera, shot, outcome);
            return false;
        }
        let Some(camera) = self.cameras.get_mut(&message.camera) else {
            return false;
        };
        match message.event {
            CameraEvent::Ready(info) => camera.state = State::Ready(info),
            CameraEvent::Away { fault, .. } => {
                // A failed attempt to reopen it changes nothing.
                let is_news = !matches!(&camera.state, State::Away(before) if *before == fault);
                camera.state = State::Away(fault);
                camera.health.clear();
                return is_news;
            }
            CameraEvent::Health(health) => {
                camera.health = health;
                return false;
            }
            CameraEvent::Frame { .. } => {
                self.late_frames += 1;
                return false;
            }
            CameraEvent::Answered { .. } | CameraEvent::Looked { .. } => return false,
        }
        true
    }

    /// Takes a shot with the cameras of these kinds and waits for it. Depth cameras that would interfere take turns.
    pub(super) fn shoot(
        &mut self,
        wanted: impl Fn(CameraKind) -> bool,
        trigger: Timestamp,
        at_most: Duration,
        heartbeat: &Heartbeat,
    ) -> ShotResult {
        let mut result = ShotResult::default();
        for group in self.groups(wanted) {
            self.shoot_group(&group, trigger, at_most, heartbeat, &mut result);
        }
        result
    }

    /// How many shots a capture consists of, because depth cameras take turns.
    pub(super) fn turns(&self) -> usize {
        self.groups(|_| true).len()
    }

    /// The cameras of each shot.
    fn groups(&self, wanted: impl Fn(CameraKind) -> bool) -> Vec<Vec<CameraId>> {
        let of = |in_turn: bool| {
            let cameras = self.cameras.iter();
            cameras.filter(move |(_, c)| (c.kind == CameraKind::DepthInTurn) == in_turn)
        };
        let together = of(false).filter(|(_, c)| wanted(c.kind));
        let mut groups = vec![together.map(|(id, _)| id.clone()).collect::<Vec<_>>()];
        for (i, (id, camera)) in of(true).enumerate() {
            match (i, wanted(camera.kind)) {
                (_, false) => {}
                (0, true) => groups[0].push(id.clone()),
                (_, true) => groups.push(vec![id.clone()]),
            }
        }
        groups
    }

    fn shoot_group(
        &mut self,
        group: &[CameraId],
        trigger: Timestamp,
        at_most: Duration,
        heartbeat: &Heartbeat,
        result: &mut ShotResult,
    ) {
        self.shots += 1;
        let shot = Shot {
            number: self.shots,
            trigger,
            deadline: self.clock.now() + at_most,
            clock: self.clock,
            abandoned: Arc::new(AtomicBool::new(false)),
        };
        let mut waiting = BTreeSet::new();
        for id in group {
            match self.ask(id, &shot) {
                Ok(()) => drop(waiting.insert(id.clone())),
                Err(fault) => drop(result.answers.insert(id.clone(), Err(fault))),
            }
        }
        self.collect(&shot, heartbeat, &mut waiting, result);
        shot.abandoned.store(true, Ordering::Relaxed);
        for id in waiting {
            let fault = Fault::Away(format!(
                "it did not answer within {} ms",
                at_most.as_millis()
            ));
            result.answers.insert(id, Err(fault));
        }
    }

    fn ask(&self, id: &CameraId, shot: &Shot) -> Result<(), Fault> {
        let camera = &self.cameras[id];
        match &camera.state {
            State::Opening => Err(Fault::Away("it has not been opened yet".into())),
            State::Away(fault) => Err(fault.clone()),
            State::Ready(_) if camera.thread.shoot(shot.clone()) => Ok(()),
            State::Ready(_) => Err(Fault::Away(
                "it is still busy with the previous shot".into(),
            )),
        }
    }

    fn collect(
        &mut self,
        shot: &Shot,
        heartbeat: &Heartbeat,
        waiting: &mut BTreeSet<CameraId>,
        result: &mut ShotResult,
    ) {
        while !waiting.is_empty() {
            // The wait has a deadline, so this thread is not stuck.
            heartbeat.tick();
            let left = shot.remaining();
            let message = match self
                .clock
                .recv_timeout(&self.events, left.min(Heartbeat::INTERVAL))
            {
                Ok(message) => message,
                Err(RecvTimeoutError::Timeout) if !left.is_zero() => continue,
                Err(_) => return,
            };
            match message.event {
                CameraEvent::Frame {
                    shot: number,
                    frame,
                } if number == shot.number => result.frames.push(frame),
                CameraEvent::Answered {
                    shot: number,
                    outcome,
                } if number == shot.number => {
                    waiting.remove(&message.camera);
                    result.answers.insert(message.camera, outcome);
                }
                _ => {
                    let camera = message.camera.clone();
                    if self.note(message) {
                        result.changed.insert(camera);
                    }
                }
            }
        }
    }

    /// Stops all threads; returns the cameras whose threads had not ended by the deadline.
    pub(super) fn stop(self, deadline: Instant) -> Vec<CameraId> {
        // Closing the channel frees threads that wait for space in it; all stop concurrently.
        drop(self.events);
        let ending: Vec<StoppingThread> =
            self.cameras.into_values().map(|c| c.thread.end()).collect();
        let mut stuck = Vec::new();
        for thread in ending {
            let camera = thread.camera().clone();
            if !thread.wait(deadline) {
                stuck.push(camera);
            }
        }
        stuck
    }
}

fn start_camera(
    id: &CameraId,
    rig_camera: RigCamera,
    events: &Sender<Message>,
    backoff: Backoff,
) -> std::io::Result<Camera> {
    let thread = supervise(id.clone(), rig_camera.driver, events.clone(), backoff)?;
    Ok(Camera {
        kind: rig_camera.kind,
        needs_signal: rig_camera.needs_signal,
        thread,
        state: State::Opening,
        health: Vec::new(),
    })
}
