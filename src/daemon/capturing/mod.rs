//! The thread that turns orders into captures: it takes a shot for a press, passes the frames through `sync`, and
//! hands the capture to the recorder. It owns the cameras, and no other thread waits for it: clients that press
//! during a capture are told `busy`.

mod assemble;
mod capture_thread;

use super::dispatcher::{Dispatcher, ReplyGuard, ReplyStream};
use super::events::Events;
use super::look::protocol::SegmentationSettings;
use super::look::{LookMaker, LookPlan, LookScheduler, LookSubscription, Looks, Turns};
use super::notes::NoteEffects;
use super::presses::{Input, Press};
use super::recorder::{Answer, Recorder};
use super::rig::Rig;
use super::status::Status;
use super::systemd::Watchdog;
use super::{CaptureParameters, RecordingParameters};
use crate::drivers::live::Pool;
use crate::frame::CameraId;
use crate::log;
use crate::recording::{
    Error, Note, SessionHeader, finished_name, interrupted, recover, unfinished,
};
use crate::sync;
use crate::trigger::Event;
use crate::workers::{Jobs, Remake};
use capture_thread::CaptureThread;
use crossbeam_channel::{Sender, TrySendError, bounded};
use parking_lot::Mutex;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

/// What this thread is asked.
pub(super) enum Order {
    /// A capture.
    Press(Press, ReplyGuard),
    /// The empty rig's backgrounds.
    Background(Answer),
    /// Begin a session of this name, with pairs about it.
    Begin(String, BTreeMap<String, String>, Answer),
    /// Note something about a capture.
    Note(Note, Answer),
    /// Complete the session.
    Close(Answer),
    /// Go on with other parameters.
    Reload(Box<ReloadedSettings>, Answer),
}

/// What may change while the daemon runs.
pub struct ReloadedSettings {
    /// How captures are taken; `memory_mb` and `waiting` stay as they were.
    pub capture: CaptureParameters,
    /// Where they are kept; the folder stays as it was.
    pub recording: RecordingParameters,
    /// Where the calibration is; `None` of a rig that is not calibrated yet.
    pub calibration: Option<PathBuf>,
    /// What every recording begins with, from the next capture on.
    pub header: SessionHeader,
    /// What looks cut objects out with from now on.
    pub cutting: Option<Arc<SegmentationSettings>>,
}

/// What the thread works with.
pub struct CapturePlan {
    /// Which frames make a capture.
    pub sync: sync::Parameters,
    /// How captures are taken.
    pub capture: CaptureParameters,
    /// Where they are kept.
    pub recording: RecordingParameters,
    /// The calibration's file; `None` of a rig that is not calibrated yet.
    pub calibration: Option<PathBuf>,
    /// What every recording begins with; settings and backgrounds are added here.
    pub header: SessionHeader,
    /// Where drivers take memory from.
    pub pool: Pool,
    /// Name and version of the program.
    pub program: String,
    /// Where it publishes what happens.
    pub events: Events,
    /// Where its threads show that they live.
    pub watchdog: Watchdog,
    /// Where models of captures go; `None` where none are made, so that no press can wait for its model.
    pub models: Option<PathBuf>,
    /// Where the jobs of making models go; `None` where none are made.
    pub jobs: Option<Arc<Jobs>>,
    /// How pictures are made for those who look at the cameras; `None` where nobody can.
    pub look: Option<LookPlan>,
}

/// The thread, from outside.
pub struct Capturing {
    /// `None` once it was asked to stop.
    orders: Mutex<Option<Sender<Order>>>,
    dispatcher: Arc<Dispatcher>,
    status: Arc<Mutex<Status>>,
    /// Whether enough cameras are ready; systemd is told the same.
    ready: AtomicBool,
    models: bool,
    jobs: Option<Arc<Jobs>>,
    note_effects: Arc<NoteEffects>,
    /// `None` where nobody can look.
    looks: Option<Looks>,
    thread: Mutex<Option<JoinHandle<Vec<CameraId>>>>,
}

impl Capturing {
    /// Settles the presses of `interrupted` recordings, finds the backgrounds and starts the thread.
    ///
    /// # Errors
    /// If the system has no thread left.
    pub fn start(
        rig: Rig,
        plan: CapturePlan,
        interrupted: &InterruptedRecordings,
    ) -> Result<Self, Error> {
        let folder = plan.recording.folder.clone();
        let io = |cause| Error::Io {
            path: folder.clone(),
            cause,
        };
        let jobs = plan.jobs.clone();
        let dispatcher = Dispatcher::open(
            &presses_of(&folder),
            interrupted.recordings(),
            plan.events.clone(),
            jobs.clone(),
            rig.clock(),
        );
        let models = plan.models.is_some();
        let note_effects = Arc::new(NoteEffects {
            jobs: jobs.clone(),
            models: plan.models.clone(),
            late: Mutex::default(),
            dispatcher: dispatcher.clone(),
            marking: Mutex::default(),
        });
        let (orders, queue) = bounded(1);
        let status: Arc<Mutex<Status>> = Arc::default();
        let recorder = Recorder::start(plan.capture.waiting, plan.watchdog.heartbeat("recorder"))
            .map_err(io)?;
        let looks = Looks::new(rig.clock());
        let start = |plan: &LookPlan| LookMaker::start(plan.clone(), looks.clone());
        let looking = LookScheduler {
            maker: plan.look.as_ref().map(start).transpose().map_err(io)?,
            looks: looks.clone(),
            turns: Turns::default(),
            told: std::collections::BTreeMap::new(),
        };
        let can_look = looking.maker.is_some();
        let capture_thread = CaptureThread::new(
            rig,
            plan,
            recorder,
            dispatcher.clone(),
            note_effects.clone(),
            status.clone(),
            looking,
        );
        let thread = std::thread::Builder::new().name("capturing".into());
        let thread = thread.spawn(move || capture_thread.run(&queue));
        Ok(Self {
            orders: Mutex::new(Some(orders)),
            dispatcher,
            status,
            ready: AtomicBool::new(false),
            models,
            jobs,
            note_effects,
            looks: can_look.then_some(looks),
            thread: Mutex::new(Some(thread.map_err(io)?)),
        })
    }

    /// Presses for a capture, or follows the press of the same name that there was before.
    pub fn press(
        &self,
        source: String,
        press_id: Option<String>,
        subject: Option<String>,
        placement: Option<String>,
    ) -> ReplyStream {
        let press = Press {
            source,
            press_id,
            subject,
            placement,
        };
        let (replies, begins) = self.dispatcher.ask(press.clone());
        if let Some(guard) = begins
            && let Err(order) = self.send(Order::Press(press, guard))
        {
            order.decline(ENDING);
        }
        replies
    }

    /// Sends an order that is not a press, unless another order is being carried out.
    pub(super) fn order(&self, order: Order) {
        if !self.dispatcher.presses().claim() {
            return order.decline(
                "another order is being carried out, such as a capture: try again in a moment",
            );
        }
        if let Err(order) = self.send(order) {
            self.dispatcher.presses().release();
            order.decline(ENDING);
        }
    }

    fn send(&self, order: Order) -> Result<(), Order> {
        match &*self.orders.lock() {
            Some(orders) => orders.try_send(order).map_err(TrySendError::into_inner),
            None => Err(order),
        }
    }

    /// Answers a capture's press, and tells every client that listens, what became of its model.
    pub fn job_ended(&self, event: Event) {
        self.note_effects.job_ended(&event);
        self.dispatcher.on(Input::JobEnded(event));
    }

    /// Where it publishes what happens.
    pub fn events(&self) -> &Events {
        self.dispatcher.events()
    }

    /// Looks at the cameras, until what is returned is dropped; `None` where nobody can.
    pub(super) fn look(&self) -> Option<LookSubscription> {
        self.looks.as_ref().map(Looks::begin)
    }

    /// Whether an order is being carried out.
    pub(super) fn is_busy(&self) -> bool {
        self.dispatcher.presses().is_busy()
    }

    /// Whether there is nothing to do: no order, no capture that waits for the disk, no model to be made.
    pub(super) fn is_idle(&self) -> bool {
        let jobs = || self.jobs.as_ref().is_none_or(|jobs| jobs.is_idle());
        self.dispatcher.presses().is_idle() && jobs()
    }

    /// Has a capture's model made again with other settings, when nothing else waits for one; says so in words.
    ///
    /// # Errors
    /// Why it is not: no models are made, a setting is refused, or too many wait.
    pub(super) fn remake(
        &self,
        capture: &str,
        settings: &BTreeMap<String, serde_json::Value>,
    ) -> Result<String, String> {
        let jobs = self.jobs.as_ref().ok_or("this daemon makes no models")?;
        let before = jobs.remakes().enqueue(Remake::new(capture, settings)?)?;
        let words = format!("the model of {capture} is made again when no other waits");
        Ok(match before {
            0 => words,
            n => format!("{words}; {n} are before it"),
        })
    }

    /// Whether a press may wait for its model.
    pub fn makes_models(&self) -> bool {
        self.models
    }

    /// Notes whether enough cameras are ready, for the status.
    pub(super) fn set_ready(&self, ready: bool) {
        self.ready.store(ready, Ordering::Relaxed);
    }

    /// What is known now.
    pub fn status(&self) -> Status {
        let status = self.status.lock().clone();
        let figures = self.dispatcher.presses().figures();
        Status {
            version: env!("CARGO_PKG_VERSION"),
            ready: self.ready.load(Ordering::Relaxed),
            busy: self.is_busy(),
            complete: figures.complete,
            failed: figures.failed,
            refused: figures.refused,
            takes_ms: figures.latency_ms,
            looking: self.looks.as_ref().map_or(0, Looks::count),
            models: self.jobs.as_ref().map(|jobs| jobs.backlog()),
            ..status
        }
    }

    /// Takes no more orders: from now on each is declined. The one in progress goes on.
    pub fn close(&self) {
        drop(self.orders.lock().take());
    }

    /// Finishes the order in progress, completes the session and ends all threads, even if others still hold this.
    /// Returns the cameras whose threads hang.
    pub fn stop(&self) -> Vec<CameraId> {
        self.close();
        let thread = self.thread.lock().take();
        let stuck = thread.and_then(|thread| thread.join().ok());
        stuck.unwrap_or_default()
    }
}

/// Why an order is declined at the end.
const ENDING: &str = "the daemon is ending";

impl Order {
    /// Answers an order that is not carried out.
    fn decline(self, reason: &str) {
        let reason = reason.to_owned();
        match self {
            Self::Press(_, guard) => {
                let refused = Input::Refused(guard.press(), reason);
                guard.end(refused);
            }
            Self::Background(answer)
            | Self::Begin(_, _, answer)
            | Self::Note(_, answer)
            | Self::Close(answer)
            | Self::Reload(_, answer) => answer(Err(reason)),
        }
    }
}

/// The folder of the journal of presses.
fn presses_of(recordings: &Path) -> PathBuf {
    recordings.join("presses")
}

/// The recordings that were open when an earlier run ended.
pub struct InterruptedRecordings {
    folder: PathBuf,
    recordings: Vec<PathBuf>,
}

impl InterruptedRecordings {
    /// Completes the recordings that an earlier run left in a folder, which is made if it is not there. What cannot be
    /// completed or kept is logged and left unchanged. The start may take as long as a slow disk needs for each.
    ///
    /// # Errors
    /// If the folder cannot be made or read.
    pub fn recover(folder: &Path, watchdog: &Watchdog) -> Result<Self, Error> {
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
        if let Err(error) = interrupted::enter(folder, &complete) {
            log::error!("{error}");
        }
        for part in parts {
            recover_one(&part, watchdog);
        }
        Ok(Self {
            folder: folder.into(),
            recordings: interrupted::all(folder),
        })
    }

    /// Its recordings, under the names that they have when they are complete.
    pub fn recordings(&self) -> &[PathBuf] {
        &self.recordings
    }

    /// Removes the list of them, because all their presses and jobs were handled.
    pub fn forget(self) {
        if let Err(error) = interrupted::forget(&self.folder) {
            log::warning!("{error}");
        }
    }
}

fn recover_one(part: &Path, watchdog: &Watchdog) {
    const SLOWEST_BYTES_A_SECOND: u64 = 5_000_000;
    const BESIDE: Duration = Duration::from_secs(60);
    let bytes = part.metadata().map_or(0, |part| part.len());
    watchdog.extend_start_timeout(BESIDE + Duration::from_secs(bytes / SLOWEST_BYTES_A_SECOND));
    match recover(part) {
        Ok(recovered) => log::notice!("recovered {}", recovered.path.display()),
        Err(error) => log::error!("{error}; {} was left unchanged", part.display()),
    }
}
