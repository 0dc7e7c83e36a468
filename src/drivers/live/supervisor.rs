//! The thread of one live camera: opens it, takes its shots, polls it while idle, and reopens it with growing pauses
//! when it is away. Only its own camera can block this thread: when the queue is full, frames are dropped and counted.

use super::{CameraInfo, Device, Driver, Fault, LookResult, Shot, ShotStats};
use crate::frame::{CameraId, Frame, Stream, Timestamp};
use crate::queue;
use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, TrySendError, bounded};
use std::collections::BTreeMap;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// A command for a camera's thread.
#[derive(Debug)]
pub enum Command {
    /// Take the frames of a shot.
    Shoot(Shot),
    /// Take a picture that is looked at and not recorded.
    Look(Shot),
}

/// What a camera's thread reports.
#[derive(Debug)]
pub enum CameraEvent {
    /// The camera is open and configured.
    Ready(Box<CameraInfo>),
    /// A complete frame of a shot.
    Frame {
        /// The shot's number.
        shot: u64,
        /// The frame.
        frame: Frame,
    },
    /// A shot has ended; all its frames were reported before.
    Answered {
        /// The shot's number.
        shot: u64,
        /// Its result, or why the camera took none.
        outcome: Result<ShotStats, Fault>,
    },
    /// A look has ended.
    Looked {
        /// The number of its shot.
        shot: u64,
        /// What it gave, or why the camera took none.
        outcome: Result<LookResult, Fault>,
    },
    /// What the camera reports about itself while idle: names and values.
    Health(Vec<[String; 2]>),
    /// The camera is away.
    Away {
        /// Why.
        fault: Fault,
        /// The pause until the next attempt.
        again_in: Duration,
    },
}

/// An event, and the camera that it concerns.
#[derive(Debug)]
pub struct Message {
    /// The camera.
    pub camera: CameraId,
    /// What a camera's thread reports.
    pub event: CameraEvent,
}

/// Pauses between attempts to open a camera; each is twice the one before, up to a limit.
#[derive(Debug, Clone, Copy)]
pub struct Backoff {
    /// The first pause.
    pub first: Duration,
    /// The longest.
    pub longest: Duration,
}

impl Default for Backoff {
    fn default() -> Self {
        Self {
            first: Duration::from_millis(250),
            // A camera releases a client after three seconds without its heartbeat.
            longest: Duration::from_secs(3),
        }
    }
}

/// A camera's thread.
#[derive(Debug)]
pub struct Supervised {
    camera: CameraId,
    commands: Sender<Command>,
    thread: JoinHandle<()>,
}

impl Supervised {
    /// The camera.
    pub fn camera(&self) -> &CameraId {
        &self.camera
    }

    /// Asks for a shot; false if the thread is still busy with the previous one, or has ended.
    pub fn shoot(&self, shot: Shot) -> bool {
        self.commands.try_send(Command::Shoot(shot)).is_ok()
    }

    /// Asks for a picture that is not recorded; false as for [`Self::shoot`].
    pub fn look(&self, shot: Shot) -> bool {
        self.commands.try_send(Command::Look(shot)).is_ok()
    }

    /// Asks the thread to stop after its current work; does not join it.
    pub fn end(self) -> StoppingThread {
        StoppingThread {
            camera: self.camera,
            thread: self.thread,
        }
    }
}

/// A camera's thread that was asked to stop.
#[derive(Debug)]
pub struct StoppingThread {
    camera: CameraId,
    thread: JoinHandle<()>,
}

impl StoppingThread {
    /// The camera.
    pub fn camera(&self) -> &CameraId {
        &self.camera
    }

    /// Joins the thread; false if it has not ended by `deadline`.
    pub fn wait(self, deadline: Instant) -> bool {
        while !self.thread.is_finished() && Instant::now() < deadline {
            std::thread::sleep(Duration::from_millis(2));
        }
        self.thread.is_finished() && self.thread.join().is_ok()
    }
}

/// Starts a camera's thread. `events` should have space for all frames of a shot: frames are dropped when it is full.
///
/// # Errors
/// If the system cannot start a thread.
pub fn supervise(
    camera: CameraId,
    driver: Box<dyn Driver>,
    events: Sender<Message>,
    backoff: Backoff,
) -> std::io::Result<Supervised> {
    let (sender, commands) = bounded(1);
    let name = format!("camera {camera}");
    let supervisor = Supervisor {
        camera: camera.clone(),
        driver,
        commands,
        events,
        backoff,
        newest: BTreeMap::new(),
    };
    let thread = std::thread::Builder::new()
        .name(name.chars().take(15).collect())
        .spawn(move || supervisor.run())?;
    Ok(Supervised {
        camera,
        commands: sender,
        thread,
    })
}

struct Supervisor {
    camera: CameraId,
    driver: Box<dyn Driver>,
    commands: Receiver<Command>,
    events: Sender<Message>,
    backoff: Backoff,
    /// The last frame's timestamp of each stream, to detect a clock that stands still.
    newest: BTreeMap<Stream, Timestamp>,
}

/// The daemon has stopped, or asks this thread to.
struct Stop;

impl Supervisor {
    fn run(mut self) {
        let mut pause = self.backoff.first;
        loop {
            let (fault, worked) = match self.open_and_serve() {
                Ok(Stop) => return,
                Err(broken) => broken,
            };
            if worked {
                pause = self.backoff.first;
            }
            self.report(CameraEvent::Away {
                fault: fault.clone(),
                again_in: pause,
            });
            if self.refuse_shots(&fault, pause).is_err() {
                return;
            }
            pause = (pause * 2).min(self.backoff.longest);
        }
    }

    /// Serves until the camera fails; returns why, and whether it had been open.
    fn open_and_serve(&mut self) -> Result<Stop, (Fault, bool)> {
        let mut device = guarded(|| self.driver.open()).map_err(|fault| (fault, false))?;
        self.report(CameraEvent::Ready(Box::new(device.info().clone())));
        let served = guarded(|| self.serve(device.as_mut()));
        // A device that panicked may panic again while it is closed.
        let _ = queue::guarded(|| drop(device));
        served.map_err(|fault| (fault, true))
    }

    fn serve(&mut self, device: &mut dyn Device) -> Result<Stop, Fault> {
        let longest = Duration::from_secs(5);
        let mut asked: Option<Instant> = None;
        let mut rests_since = Instant::now();
        loop {
            let period = device.idle_period().min(longest);
            let left = period.saturating_sub(rests_since.elapsed());
            match self.commands.recv_timeout(left) {
                Ok(Command::Shoot(shot)) => {
                    self.shoot(device, &shot)?;
                    rests_since = Instant::now();
                }
                // However often somebody looks, what has to be done between shots is done.
                Ok(Command::Look(shot)) => self.look(device, &shot)?,
                Err(RecvTimeoutError::Timeout) => {
                    rests_since = Instant::now();
                    device.idle()?;
                    if asked.is_none_or(|asked| asked.elapsed() >= longest) {
                        asked = Some(Instant::now());
                        self.tell_health(device);
                    }
                }
                Err(RecvTimeoutError::Disconnected) => return Ok(Stop),
            }
        }
    }

    /// Reports the camera's health; skips it if the queue is full.
    fn tell_health(&self, device: &mut dyn Device) {
        let health = device.health();
        if !health.is_empty() {
            let message = Message {
                camera: self.camera.clone(),
                event: CameraEvent::Health(health),
            };
            let _ = self.events.try_send(message);
        }
    }

    fn shoot(&mut self, device: &mut dyn Device, shot: &Shot) -> Result<(), Fault> {
        let mut not_taken = Vec::new();
        let outcome = guarded(|| {
            device.shoot(shot, &mut |frame| {
                if let Err(why) = self.hand_over(shot.number, frame) {
                    not_taken.push(why);
                }
            })
        });
        let fault = outcome.as_ref().err().cloned();
        self.report(CameraEvent::Answered {
            shot: shot.number,
            outcome: outcome.map(|mut stats| {
                stats.lost.append(&mut not_taken);
                stats
            }),
        });
        fault.map_or(Ok(()), Err)
    }

    fn look(&mut self, device: &mut dyn Device, shot: &Shot) -> Result<(), Fault> {
        let mut newest: BTreeMap<Stream, Frame> = BTreeMap::new();
        let outcome = guarded(|| {
            device.look(shot, &mut |frame| {
                newest.insert(frame.stream, frame);
            })
        });
        let fault = outcome.as_ref().err().cloned();
        self.report(CameraEvent::Looked {
            shot: shot.number,
            outcome: outcome.map(|stats| LookResult {
                frames: newest.into_values().collect(),
                lost: stats.lost,
                is_binned: stats.is_binned,
                why_whole: stats.why_whole,
            }),
        });
        fault.map_or(Ok(()), Err)
    }

    fn hand_over(&mut self, shot: u64, frame: Frame) -> Result<(), String> {
        let time = frame.timestamp;
        let newest = self.newest.insert(frame.stream, time);
        if newest.is_some_and(|newest| time <= newest) {
            return Err(format!(
                "a frame's timestamp of {} ns is not after the previous one: the camera's clock stands still or went back",
                time.0
            ));
        }
        let message = Message {
            camera: self.camera.clone(),
            event: CameraEvent::Frame { shot, frame },
        };
        match self.events.try_send(message) {
            Ok(()) => Ok(()),
            Err(TrySendError::Full(_)) => {
                Err("a frame was dropped, because the queue to the capturing thread is full".into())
            }
            Err(TrySendError::Disconnected(_)) => {
                Err("a frame was dropped, because the capturing thread has stopped".into())
            }
        }
    }

    /// Waits; answers shots meanwhile that the camera is away.
    fn refuse_shots(&self, fault: &Fault, pause: Duration) -> Result<(), Stop> {
        let until = Instant::now() + pause;
        loop {
            match self.commands.recv_deadline(until) {
                Ok(Command::Shoot(shot)) => self.report(CameraEvent::Answered {
                    shot: shot.number,
                    outcome: Err(fault.clone()),
                }),
                Ok(Command::Look(shot)) => self.report(CameraEvent::Looked {
                    shot: shot.number,
                    outcome: Err(fault.clone()),
                }),
                Err(RecvTimeoutError::Timeout) => return Ok(()),
                Err(RecvTimeoutError::Disconnected) => return Err(Stop),
            }
        }
    }

    /// Reports an event that must not be lost: waits until the queue has space, but not for ever.
    fn report(&self, event: CameraEvent) {
        let message = Message {
            camera: self.camera.clone(),
            event,
        };
        let _ = self.events.send_timeout(message, Duration::from_secs(1));
    }
}

/// Turns a panic in an SDK's code into a fault of its camera.
fn guarded<T>(work: impl FnOnce() -> Result<T, Fault>) -> Result<T, Fault> {
    queue::guarded(work).unwrap_or_else(|panicked| {
        let words = panicked.0;
        Err(Fault::Away(format!(
            "internal error in its driver: {words}"
        )))
    })
}
