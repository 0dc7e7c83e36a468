//! The thread of one live camera: it opens the camera, takes its shots, asks while idle whether it is still there, and
//! opens it again with growing pauses when it is not. No camera can block another, and nothing can block this thread
//! but its own camera: frames that nobody takes are lost and counted.

use super::{Confirmed, Device, Driver, Fault, Shot, Tally};
use crate::frame::{CameraId, Frame, Stream, Timestamp};
use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, TrySendError, bounded};
use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// What a camera's thread is asked.
#[derive(Debug)]
pub enum Command {
    /// Take the frames of a shot.
    Shoot(Shot),
}

/// What it says.
#[derive(Debug)]
pub enum Event {
    /// The camera is open, and set as it should be.
    Ready(Box<Confirmed>),
    /// A whole frame of a shot.
    Frame {
        /// The shot's number.
        shot: u64,
        /// The frame.
        frame: Frame,
    },
    /// A shot is over; all its frames were handed over before.
    Answered {
        /// The shot's number.
        shot: u64,
        /// What it cost, or why there could be none.
        outcome: Result<Tally, Fault>,
    },
    /// What the camera tells of itself while it is idle: names and values.
    Health(Vec<[String; 2]>),
    /// The camera is away.
    Away {
        /// Why.
        fault: Fault,
        /// When it is tried again.
        again_in: Duration,
    },
}

/// An event with the camera it is of.
#[derive(Debug)]
pub struct Message {
    /// The camera.
    pub camera: CameraId,
    /// What it says.
    pub event: Event,
}

/// Pauses between attempts to open a camera: doubled each time, up to a limit.
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
            // A camera that another one held lets go after three seconds without a sign of it.
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

    /// Asks for a shot; false when the thread is still busy with the one before, or is gone.
    pub fn shoot(&self, shot: Shot) -> bool {
        self.commands.try_send(Command::Shoot(shot)).is_ok()
    }

    /// Ends the thread when it has done what it is at. Nobody waits for it yet.
    pub fn end(self) -> Ending {
        Ending {
            camera: self.camera,
            thread: self.thread,
        }
    }
}

/// A camera's thread that has been told to end.
#[derive(Debug)]
pub struct Ending {
    camera: CameraId,
    thread: JoinHandle<()>,
}

impl Ending {
    /// The camera.
    pub fn camera(&self) -> &CameraId {
        &self.camera
    }

    /// Waits for the thread until `deadline`; false if it does not end.
    pub fn wait(self, deadline: Instant) -> bool {
        while !self.thread.is_finished() && Instant::now() < deadline {
            std::thread::sleep(Duration::from_millis(2));
        }
        self.thread.is_finished() && self.thread.join().is_ok()
    }
}

/// Starts a camera's thread. `events` should hold all frames of a shot, for a full one loses frames.
///
/// # Errors
/// If the system has no thread left.
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
    /// Of each stream the timestamp of the last frame: a camera whose clock stands still is not believed.
    newest: BTreeMap<Stream, Timestamp>,
}

/// The daemon has ended, or wants this thread to.
struct Ended;

impl Supervisor {
    fn run(mut self) {
        let mut pause = self.backoff.first;
        loop {
            let (fault, worked) = match self.open_and_serve() {
                Ok(Ended) => return,
                Err(broken) => broken,
            };
            if worked {
                pause = self.backoff.first;
            }
            self.tell(Event::Away {
                fault: fault.clone(),
                again_in: pause,
            });
            if self.refuse_shots(&fault, pause).is_err() {
                return;
            }
            pause = (pause * 2).min(self.backoff.longest);
        }
    }

    /// Serves until the camera breaks: why, and whether it had worked.
    fn open_and_serve(&mut self) -> Result<Ended, (Fault, bool)> {
        let mut device = guarded(|| self.driver.open()).map_err(|fault| (fault, false))?;
        self.tell(Event::Ready(Box::new(device.confirmed().clone())));
        let served = guarded(|| self.serve(device.as_mut()));
        // A device that panicked may panic again while it is closed.
        let _ = catch_unwind(AssertUnwindSafe(|| drop(device)));
        served.map_err(|fault| (fault, true))
    }

    fn serve(&mut self, device: &mut dyn Device) -> Result<Ended, Fault> {
        let longest = Duration::from_secs(5);
        let mut asked: Option<Instant> = None;
        loop {
            let period = device.idle_period().min(longest);
            match self.commands.recv_timeout(period) {
                Ok(Command::Shoot(shot)) => self.shoot(device, &shot)?,
                Err(RecvTimeoutError::Timeout) => {
                    device.idle()?;
                    if asked.is_none_or(|asked| asked.elapsed() >= longest) {
                        asked = Some(Instant::now());
                        self.tell_health(device);
                    }
                }
                Err(RecvTimeoutError::Disconnected) => return Ok(Ended),
            }
        }
    }

    /// Tells how the camera is. Where there is no room for that, nothing is lost.
    fn tell_health(&self, device: &mut dyn Device) {
        let health = device.health();
        if !health.is_empty() {
            let message = Message {
                camera: self.camera.clone(),
                event: Event::Health(health),
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
        self.tell(Event::Answered {
            shot: shot.number,
            outcome: outcome.map(|mut tally| {
                tally.lost.append(&mut not_taken);
                tally
            }),
        });
        fault.map_or(Ok(()), Err)
    }

    fn hand_over(&mut self, shot: u64, frame: Frame) -> Result<(), String> {
        let time = frame.timestamp;
        let newest = self.newest.insert(frame.stream, time);
        if newest.is_some_and(|newest| time <= newest) {
            return Err(format!(
                "a frame is stamped {} ns, which is not after the one before: its clock stands still or ran back",
                time.0
            ));
        }
        let message = Message {
            camera: self.camera.clone(),
            event: Event::Frame { shot, frame },
        };
        match self.events.try_send(message) {
            Ok(()) => Ok(()),
            Err(TrySendError::Full(_)) => Err("nobody had room for a frame".into()),
            Err(TrySendError::Disconnected(_)) => Err("nobody wanted a frame".into()),
        }
    }

    /// Waits, and answers meanwhile that the camera is away.
    fn refuse_shots(&self, fault: &Fault, pause: Duration) -> Result<(), Ended> {
        let until = Instant::now() + pause;
        loop {
            match self.commands.recv_deadline(until) {
                Ok(Command::Shoot(shot)) => self.tell(Event::Answered {
                    shot: shot.number,
                    outcome: Err(fault.clone()),
                }),
                Err(RecvTimeoutError::Timeout) => return Ok(()),
                Err(RecvTimeoutError::Disconnected) => return Err(Ended),
            }
        }
    }

    /// Says what must not be lost: waits for room, but not for ever.
    fn tell(&self, event: Event) {
        let message = Message {
            camera: self.camera.clone(),
            event,
        };
        let _ = self.events.send_timeout(message, Duration::from_secs(1));
    }
}

/// A panic in an SDK's room is a fault of that camera alone.
fn guarded<T>(work: impl FnOnce() -> Result<T, Fault>) -> Result<T, Fault> {
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|cause| {
        let words = cause.downcast_ref::<String>().map(String::as_str);
        let words = words.or_else(|| cause.downcast_ref::<&str>().copied());
        Err(Fault::Away(format!(
            "internal error in its driver: {}",
            words.unwrap_or("a panic")
        )))
    })
}
