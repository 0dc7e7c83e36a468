//! The thread that turns orders into captures: a press becomes a shot, its frames go through `sync`, and what comes out
//! is handed to the recorder. It holds the cameras and nothing else waits for it; while it takes a capture, others who
//! press are told so.

mod assemble;
mod offer;
mod takes;
mod turn;
mod worker;

use super::events::Events;
use super::presses::{Asked, Following, Presses, Promise};
use super::recorder::Recorder;
use super::rig::Rig;
use super::status::Status;
use super::systemd::Pulse;
use super::{CaptureParameters, RecordingParameters};
use crate::drivers::live::Pool;
use crate::frame::CameraId;
use crate::log;
use crate::recording::{Error, Note, SessionHeader, finished_name, left, recover, unfinished};
use crate::sync;
use crate::trigger::Reply;
use crate::workers::Jobs;
use crossbeam_channel::{Sender, TrySendError, bounded};
use parking_lot::Mutex;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;
use takes::Takes;
use worker::Worker;

/// Someone asks for a capture.
pub struct Press {
    /// `pedal`, `socket` or another word.
    pub source: String,
    /// The client's own name of it.
    pub press_id: Option<String>,
    /// The object's number.
    pub subject: Option<String>,
    /// Hears how it goes on.
    pub progress: Box<dyn Fn(Reply) + Send + Sync>,
}

/// Answers an order: words, or why not.
pub type Answer = Box<dyn FnOnce(Result<String, String>) + Send>;

/// What this thread is asked.
pub enum Order {
    /// A capture.
    Press(Press),
    /// The empty rig's plates.
    Background(Answer),
    /// Begin a session of this name, with pairs about it.
    Begin(String, BTreeMap<String, String>, Answer),
    /// Note something about a capture.
    Note(Note, Answer),
    /// Complete the session.
    Close(Answer),
    /// Go on with other parameters.
    Reread(Box<Reread>, Answer),
}

/// What may change while the daemon runs.
pub struct Reread {
    /// How captures are taken; `memory_mb` and `waiting` stay as they were.
    pub capture: CaptureParameters,
    /// Where they are kept; the folder stays as it was.
    pub recording: RecordingParameters,
    /// What every recording begins with, from the next capture on.
    pub preamble: SessionHeader,
}

/// What the thread works with.
pub struct Plan {
    /// Which frames make a capture.
    pub sync: sync::Parameters,
    /// How captures are taken.
    pub capture: CaptureParameters,
    /// Where they are kept.
    pub recording: RecordingParameters,
    /// What every recording begins with; settings and backgrounds are added here.
    pub preamble: SessionHeader,
    /// Where drivers take memory from.
    pub pool: Pool,
    /// Name and version of the program.
    pub program: String,
    /// Where it is told what happens.
    pub events: Events,
    /// Where its threads show that they live.
    pub pulse: Pulse,
    /// Where models of captures go; `None` where none are made, so that no press can wait for its model.
    pub models: Option<PathBuf>,
    /// Where the jobs of making models go; `None` where none are made.
    pub jobs: Option<Arc<Jobs>>,
}

/// Captures since the start, counted when they are on the disk or cannot be.
#[derive(Debug, Default)]
struct Ended {
    complete: AtomicU64,
    failed: AtomicU64,
    takes: Takes,
}

impl Ended {
    fn count(&self, complete: bool) {
        let counter = if complete {
            &self.complete
        } else {
            &self.failed
        };
        counter.fetch_add(1, Ordering::AcqRel);
    }

    fn complete(&self) -> u64 {
        self.complete.load(Ordering::Acquire)
    }

    fn failed(&self) -> u64 {
        self.failed.load(Ordering::Acquire)
    }
}

/// The thread, from outside.
pub struct Capturing {
    /// `None` once it is told to stop.
    orders: Mutex<Option<Sender<Order>>>,
    ended: Arc<Ended>,
    busy: Arc<AtomicBool>,
    status: Arc<Mutex<Status>>,
    events: Events,
    presses: Arc<Presses>,
    models: bool,
    jobs: Option<Arc<Jobs>>,
    thread: Mutex<Option<JoinHandle<Vec<CameraId>>>>,
}

impl Capturing {
    /// Settles the presses of what an earlier run `left`, finds its plates and starts the thread.
    ///
    /// # Errors
    /// If the system has no thread left.
    pub fn start(rig: Rig, plan: Plan, left: &Left) -> Result<Self, Error> {
        let folder = plan.recording.folder.clone();
        let io = |cause| Error::Io {
            path: folder.clone(),
            cause,
        };
        let presses = Presses::open(&presses_of(&folder), left.recordings());
        let presses = Arc::new(presses);
        let models = plan.models.is_some();
        let (orders, queue) = bounded(1);
        let (busy, status) = (Arc::default(), Arc::default());
        let recorder =
            Recorder::start(plan.capture.waiting, plan.pulse.heart("recorder")).map_err(io)?;
        let ended: Arc<Ended> = Arc::default();
        let (events, jobs) = (plan.events.clone(), plan.jobs.clone());
        let witness = presses.clone();
        events.witnessed_by(move |event| witness.witness(event));
        let worker = Worker::new(
            rig,
            plan,
            recorder,
            Arc::clone(&busy),
            Arc::clone(&status),
            ended.clone(),
        );
        let thread = std::thread::Builder::new().name("capturing".into());
        let thread = thread.spawn(move || worker.run(&queue));
        Ok(Self {
            orders: Mutex::new(Some(orders)),
            ended,
            busy,
            status,
            events,
            presses,
            models,
            jobs,
            thread: Mutex::new(Some(thread.map_err(io)?)),
        })
    }

    /// Presses for a capture, or follows the press of the same name that there was before.
    ///
    /// # Errors
    /// If `press_id` is no name; nothing is begun then.
    pub fn press(
        &self,
        source: String,
        press_id: Option<String>,
        subject: Option<String>,
    ) -> Result<Following, String> {
        let answers = match self.presses.ask(press_id.as_deref())? {
            Asked::Known(following) => return Ok(following),
            Asked::New(answers) => answers,
        };
        let following = answers.follow();
        let presses = self.presses.clone();
        let promise = Promise { presses, answers };
        self.order(Order::Press(Press {
            source,
            press_id,
            subject,
            progress: Box::new(move |reply| promise.tell(reply)),
        }));
        Ok(following)
    }

    /// Gives an order, unless one is being carried out: then a press hears `Busy`, and others that they may try again.
    pub fn order(&self, order: Order) {
        if self.busy.swap(true, Ordering::AcqRel) {
            return decline(order, Reply::Busy, "a capture is being taken");
        }
        let declined = match &*self.orders.lock() {
            Some(orders) => orders.try_send(order).err().map(TrySendError::into_inner),
            None => Some(order),
        };
        if let Some(order) = declined {
            self.busy.store(false, Ordering::Release);
            let reason = "the daemon is ending";
            let refused = Reply::Refused {
                reason: reason.into(),
            };
            decline(order, refused, reason);
        }
    }

    /// Where it is told what happens.
    pub fn events(&self) -> &Events {
        &self.events
    }

    /// Whether an order is being carried out.
    pub(super) fn is_busy(&self) -> bool {
        self.busy.load(Ordering::Acquire)
    }

    /// Whether there is nothing to do: no order, no capture that waits for the disk, no model to be made.
    pub(super) fn is_idle(&self) -> bool {
        let jobs = || self.jobs.as_ref().is_none_or(|jobs| jobs.is_idle());
        !self.is_busy() && self.status.lock().waiting == 0 && jobs()
    }

    /// Whether a press may wait for its model.
    pub fn makes_models(&self) -> bool {
        self.models
    }

    /// What is known now.
    pub fn status(&self) -> Status {
        let status = self.status.lock();
        Status {
            // The recorder counts after the capturing thread has gone on.
            complete: self.ended.complete(),
            failed: self.ended.failed(),
            takes_ms: self.ended.takes.spreads(),
            models: self.jobs.as_ref().map(|jobs| jobs.backlog()),
            ..status.clone()
        }
    }

    /// Finishes the order that is being carried out, completes the session and ends all threads, whoever else holds
    /// this; the cameras whose threads hang.
    pub fn stop(&self) -> Vec<CameraId> {
        drop(self.orders.lock().take());
        let thread = self.thread.lock().take();
        let stuck = thread.and_then(|thread| thread.join().ok());
        stuck.unwrap_or_default()
    }
}

/// Answers an order that is not carried out: a press with the reply, all others with the words.
fn decline(order: Order, reply: Reply, words: &str) {
    match order {
        Order::Press(press) => (press.progress)(reply),
        Order::Background(answer)
        | Order::Begin(_, _, answer)
        | Order::Note(_, answer)
        | Order::Close(answer)
        | Order::Reread(_, answer) => answer(Err(words.to_owned())),
    }
}

/// Where it is kept what presses were answered.
fn presses_of(recordings: &Path) -> PathBuf {
    recordings.join("presses")
}

/// What an earlier run left.
pub struct Left {
    folder: PathBuf,
    recordings: Vec<PathBuf>,
}

impl Left {
    /// Completes the recordings that an earlier run left in a folder, which is made if it is not there. What cannot be
    /// completed or kept is said and stays as it is. The start may take as long as a slow disk needs for each.
    ///
    /// # Errors
    /// If the folder cannot be made or read.
    pub fn recover(folder: &Path, pulse: &Pulse) -> Result<Self, Error> {
        let io = |cause| Error::Io {
            path: folder.into(),
            cause,
        };
        std::fs::create_dir_all(folder).map_err(io)?;
        // Where nothing can be written, the start goes on: each press says why it is refused.
        let _ = std::fs::create_dir_all(presses_of(folder));
        let parts = unfinished(folder)?;
        let complete: Vec<PathBuf> = parts
            .iter()
            .filter_map(|part| finished_name(part))
            .collect();
        if let Err(error) = left::enter(folder, &complete) {
            log::error!("{error}");
        }
        for part in parts {
            recover_one(&part, pulse);
        }
        Ok(Self {
            folder: folder.into(),
            recordings: left::all(folder),
        })
    }

    /// Its recordings, under the names that they have when they are complete.
    pub fn recordings(&self) -> &[PathBuf] {
        &self.recordings
    }

    /// Forgets them: presses and jobs are settled.
    pub fn settled(self) {
        if let Err(error) = left::settled(&self.folder) {
            log::warning!("{error}");
        }
    }
}

fn recover_one(part: &Path, pulse: &Pulse) {
    const SLOWEST_BYTES_A_SECOND: u64 = 5_000_000;
    const BESIDE: Duration = Duration::from_secs(60);
    let bytes = part.metadata().map_or(0, |part| part.len());
    pulse.start_takes(BESIDE + Duration::from_secs(bytes / SLOWEST_BYTES_A_SECOND));
    match recover(part) {
        Ok(recovered) => log::notice!("recovered {}", recovered.path.display()),
        Err(error) => log::error!("{error}; {} stays as it is", part.display()),
    }
}
