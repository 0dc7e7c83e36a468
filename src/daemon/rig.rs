//! The cameras' threads together: a shot goes to all of them, their answers come back, and what happens between shots
//! is noted. No camera is waited for longer than a shot may take.

use super::systemd::Heart;
use crate::clock::Clock;
use crate::drivers::live::{
    Backoff, Confirmed, Driver, Ending, Event, Fault, Message, Shot, Supervised, Tally, supervise,
};
use crate::frame::{CameraId, Frame, Timestamp};
use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, bounded};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// What a camera is to a capture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// Gives a picture to each capture.
    Color,
    /// Gives a burst of depth frames.
    Depth,
    /// Gives a burst, and not at the same time as another one of its kind: their patterns disturb each other.
    DepthInTurn,
}

/// A camera of the rig, to be started.
pub struct Station {
    /// The camera.
    pub id: CameraId,
    /// What it is to a capture.
    pub kind: Kind,
    /// Opens it.
    pub driver: Box<dyn Driver>,
}

/// What is known of a camera.
#[derive(Clone, Debug)]
pub(super) enum State {
    /// It was not open yet.
    Opening,
    /// It works.
    Ready(Box<Confirmed>),
    /// It does not.
    Away(Fault),
}

/// What a shot gave.
#[derive(Debug, Default)]
pub(super) struct Shooting {
    /// Whole frames, in the order in which they came.
    pub frames: Vec<Frame>,
    /// Of each camera that was asked what it cost, or why it gave none.
    pub answers: BTreeMap<CameraId, Result<Tally, Fault>>,
    /// Cameras whose state changed meanwhile.
    pub changed: BTreeSet<CameraId>,
}

/// The cameras' threads.
pub struct Rig {
    cameras: BTreeMap<CameraId, Camera>,
    events: Receiver<Message>,
    clock: Clock,
    shots: u64,
    /// Frames that came when their shot was over.
    late_frames: u64,
}

struct Camera {
    kind: Kind,
    thread: Supervised,
    state: State,
    /// What it told of itself last.
    health: Vec<[String; 2]>,
}

impl Rig {
    /// Starts a thread for each camera. `frames_a_shot` is how many frames all of them may give to one.
    ///
    /// # Errors
    /// If the system has no thread left.
    pub fn start(
        stations: Vec<Station>,
        clock: Clock,
        frames_a_shot: usize,
        backoff: Backoff,
    ) -> std::io::Result<Self> {
        // Room for a whole shot and for what cameras say meanwhile, so that nothing waits for the other end.
        let (sender, events) = bounded(2 * frames_a_shot + 16 * stations.len() + 16);
        let mut cameras = BTreeMap::new();
        for station in stations {
            let camera = start_camera(&station.id.clone(), station, &sender, backoff)?;
            cameras.insert(camera.thread.camera().clone(), camera);
        }
        Ok(Self {
            cameras,
            events,
            clock,
            shots: 0,
            late_frames: 0,
        })
    }

    /// The host's timeline.
    pub(super) fn clock(&self) -> Clock {
        self.clock
    }

    /// Where cameras say what happens to them between shots.
    pub(super) fn events(&self) -> &Receiver<Message> {
        &self.events
    }

    /// Frames that came when their shot was over, since the start.
    pub(super) fn late_frames(&self) -> u64 {
        self.late_frames
    }

    /// Each camera and what is known of it.
    pub(super) fn states(&self) -> impl Iterator<Item = (&CameraId, Kind, &State)> {
        self.cameras.iter().map(|(id, c)| (id, c.kind, &c.state))
    }

    /// What a camera told of itself last: names and values.
    pub(super) fn health(&self, camera: &CameraId) -> &[[String; 2]] {
        self.cameras.get(camera).map_or(&[], |c| &c.health)
    }

    /// Notes what a camera says between shots; true if its state changed.
    pub(super) fn note(&mut self, message: Message) -> bool {
        let Some(camera) = self.cameras.get_mut(&message.camera) else {
            return false;
        };
        match message.event {
            Event::Ready(confirmed) => camera.state = State::Ready(confirmed),
            Event::Away { fault, .. } => {
                // It is tried again and again, and that is no news.
                let is_news = !matches!(&camera.state, State::Away(before) if *before == fault);
                camera.state = State::Away(fault);
                camera.health.clear();
                return is_news;
            }
            Event::Health(health) => {
                camera.health = health;
                return false;
            }
            Event::Frame { .. } => {
                self.late_frames += 1;
                return false;
            }
            Event::Answered { .. } => return false,
        }
        true
    }

    /// Takes a shot with the cameras of these kinds and waits for it. Depth cameras that disturb each other take turns.
    pub(super) fn shoot(
        &mut self,
        wanted: impl Fn(Kind) -> bool,
        trigger: Timestamp,
        at_most: Duration,
        heart: &Heart,
    ) -> Shooting {
        let mut shooting = Shooting::default();
        for group in self.groups(wanted) {
            self.shoot_group(&group, trigger, at_most, heart, &mut shooting);
        }
        shooting
    }

    /// How many shots follow each other in a capture, because depth cameras take turns.
    pub(super) fn turns(&self) -> usize {
        self.groups(|_| true).len()
    }

    /// The cameras that are asked at the same time.
    fn groups(&self, wanted: impl Fn(Kind) -> bool) -> Vec<Vec<CameraId>> {
        let of = |in_turn: bool| {
            let cameras = self.cameras.iter();
            cameras.filter(move |(_, c)| (c.kind == Kind::DepthInTurn) == in_turn)
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
        heart: &Heart,
        shooting: &mut Shooting,
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
                Err(fault) => drop(shooting.answers.insert(id.clone(), Err(fault))),
            }
        }
        self.collect(&shot, heart, &mut waiting, shooting);
        shot.abandoned.store(true, Ordering::Relaxed);
        for id in waiting {
            let fault = Fault::Away(format!("no answer within {} ms", at_most.as_millis()));
            shooting.answers.insert(id, Err(fault));
        }
    }

    fn ask(&self, id: &CameraId, shot: &Shot) -> Result<(), Fault> {
        let camera = &self.cameras[id];
        match &camera.state {
            State::Opening => Err(Fault::Away("it has not been opened yet".into())),
            State::Away(fault) => Err(fault.clone()),
            State::Ready(_) if camera.thread.shoot(shot.clone()) => Ok(()),
            State::Ready(_) => Err(Fault::Away("still busy with the shot before".into())),
        }
    }

    fn collect(
        &mut self,
        shot: &Shot,
        heart: &Heart,
        waiting: &mut BTreeSet<CameraId>,
        shooting: &mut Shooting,
    ) {
        while !waiting.is_empty() {
            // All patience has an end, so who waits lives.
            heart.beat();
            let left = shot.remaining();
            let message = match self.clock.recv_timeout(&self.events, left.min(Heart::REST)) {
                Ok(message) => message,
                Err(RecvTimeoutError::Timeout) if !left.is_zero() => continue,
                Err(_) => return,
            };
            match message.event {
                Event::Frame {
                    shot: number,
                    frame,
                } if number == shot.number => shooting.frames.push(frame),
                Event::Answered {
                    shot: number,
                    outcome,
                } if number == shot.number => {
                    waiting.remove(&message.camera);
                    shooting.answers.insert(message.camera, outcome);
                }
                _ => {
                    let camera = message.camera.clone();
                    if self.note(message) {
                        shooting.changed.insert(camera);
                    }
                }
            }
        }
    }

    /// Ends all threads; the cameras whose threads did not end by the deadline.
    pub(super) fn stop(self, deadline: Instant) -> Vec<CameraId> {
        // Nobody listens from here on, so that no thread waits to be heard; all end side by side.
        drop(self.events);
        let ending: Vec<Ending> = self.cameras.into_values().map(|c| c.thread.end()).collect();
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
    station: Station,
    events: &Sender<Message>,
    backoff: Backoff,
) -> std::io::Result<Camera> {
    let thread = supervise(id.clone(), station.driver, events.clone(), backoff)?;
    Ok(Camera {
        kind: station.kind,
        thread,
        state: State::Opening,
        health: Vec::new(),
    })
}
