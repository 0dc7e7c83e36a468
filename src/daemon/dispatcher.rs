//! Carries out what `presses` decides: answers clients, writes the journal, publishes events and enqueues jobs.
//! Each input is decided under a lock. The thread that brought it carries the effects out after the lock is
//! released, so that no client waits for a disk.

use super::events::Events;
use super::presses::journal::{self, Journal};
use super::presses::{Effect, Input, Press, PressKey, Presses, recorded};
use crate::clock::Clock;
use crate::frame::CaptureId;
use crate::log;
use crate::trigger::{Event, Reply};
use crate::workers::{Job, Jobs};
use parking_lot::{MappedMutexGuard, Mutex, MutexGuard};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use tokio::sync::watch;

/// What all threads that have to do with presses share.
pub(super) struct Dispatcher {
    state: Mutex<State>,
    /// Locked on its own, see the head of this file.
    journal: Mutex<Journal>,
    events: Events,
    jobs: Option<Arc<Jobs>>,
    clock: Clock,
}

struct State {
    presses: Presses,
    /// What each press was answered so far.
    replies: BTreeMap<PressKey, watch::Sender<Vec<Reply>>>,
}

impl Dispatcher {
    /// Reads in a folder what presses were answered before, and ends those that the end of the daemon cut short:
    /// `interrupted` are the recordings that were open then.
    pub(super) fn open(
        folder: &Path,
        interrupted: &[PathBuf],
        events: Events,
        jobs: Option<Arc<Jobs>>,
        clock: Clock,
    ) -> Arc<Self> {
        let (journal, lines) = Journal::open(folder);
        let lines = lines.into_iter().map(|line| (line.press_id, line.reply));
        let recorded = recorded::captures(interrupted);
        let (presses, effects) = Presses::restore(clock.now(), lines, &recorded);
        let state = State {
            presses,
            replies: BTreeMap::new(),
        };
        let dispatcher = Arc::new(Self {
            state: Mutex::new(state),
            journal: Mutex::new(journal),
            events,
            jobs,
            clock,
        });
        dispatcher.carry_out(effects);
        dispatcher
    }

    /// Asks for a press, or again for one that is known. Also what the capture thread gets, if it is to begin it.
    pub(super) fn ask(self: &Arc<Self>, press: Press) -> (ReplyStream, Option<ReplyGuard>) {
        let mut state = self.state.lock();
        let (key, effects) = state.presses.ask(self.clock.now(), press);
        let replies = state.replies.entry(key).or_default().subscribe();
        drop(state);
        let begins = effects.contains(&Effect::Begin(key));
        self.carry_out(effects);
        let stream = ReplyStream {
            replies,
            told: 0,
            press: key,
            dispatcher: self.clone(),
        };
        let guard = || ReplyGuard::new(self, key, Input::Abandoned(key));
        (stream, begins.then(guard))
    }

    /// Decides an input and carries out what follows from it; the capture to be taken next, if it is one.
    pub(super) fn on(&self, input: Input) -> Option<CaptureId> {
        let effects = self.presses().on(self.clock.now(), input);
        self.carry_out(effects)
    }

    /// The presses themselves: whether there is room for another order, and their figures.
    pub(super) fn presses(&self) -> MappedMutexGuard<'_, Presses> {
        MutexGuard::map(self.state.lock(), |state| &mut state.presses)
    }

    /// Where it publishes what happens.
    pub(super) fn events(&self) -> &Events {
        &self.events
    }

    fn carry_out(&self, effects: Vec<Effect>) -> Option<CaptureId> {
        let mut next = None;
        for effect in effects {
            match effect {
                // Its guard is handed out.
                Effect::Begin(_) => {}
                Effect::Shoot(capture) => next = Some(capture),
                Effect::Journal { press_id, event } => {
                    self.journal.lock().append(&press_id, &event.to_reply());
                }
                Effect::SyncJournal => {
                    let file = self.journal.lock().file();
                    file.iter().for_each(|file| journal::sync(file));
                }
                Effect::Reply(press, event) => {
                    let mut state = self.state.lock();
                    let replies = state.replies.entry(press).or_default();
                    replies.send_modify(|replies| replies.push(event.to_reply()));
                }
                Effect::Publish(event) => {
                    log_event(&event);
                    self.events.publish(event);
                }
                Effect::Enqueue {
                    recording,
                    capture,
                    trigger,
                    source,
                    subject,
                } => {
                    let job = Job::new(&recording, &capture, trigger.0, &source);
                    self.enqueue(recording, capture, job, subject.as_deref());
                }
                Effect::LogUnwritten { capture, problem } => log::error!(
                    "capture {capture} was taken once more, and its frames could not be written: \
                     {problem}"
                ),
                Effect::Forget(press) => drop(self.state.lock().replies.remove(&press)),
            }
        }
        next
    }

    fn enqueue(&self, recording: PathBuf, capture: String, job: Job, subject: Option<&str>) {
        let Some(jobs) = &self.jobs else {
            return;
        };
        jobs.objects()
            .captured(job.clone(), subject.unwrap_or_default());
        if let Err(error) = jobs.enqueue(&job) {
            log::error!("capture {capture}: no model will be made: {error}");
            self.on(Input::JobEnded(Event::JobFailed {
                capture,
                recording: Some(recording),
                reason: error.to_string(),
            }));
        }
    }
}

fn log_event(event: &Event) {
    match event {
        Event::Retried { capture, reason } => {
            log::warning!("capture {capture} failed and is taken once more: {reason}");
        }
        Event::Durable { capture, recording } => {
            log::info!("capture {capture}: durable in {}", recording.display());
        }
        Event::Failed { capture, reason } => log::error!("capture {capture} failed: {reason}"),
        Event::Refused { reason } => log::warning!("a press was refused: {reason}"),
        _ => {}
    }
}

/// What a press was answered and will be, from its first answer on.
pub struct ReplyStream {
    replies: watch::Receiver<Vec<Reply>>,
    told: usize,
    press: PressKey,
    dispatcher: Arc<Dispatcher>,
}

impl ReplyStream {
    /// The next answer; `None` when none will come any more. May be dropped at any time without losing one.
    pub async fn next(&mut self) -> Option<Reply> {
        loop {
            if let Some(reply) = self.try_next() {
                return Some(reply);
            }
            self.replies.changed().await.ok()?;
        }
    }

    /// The next answer, if it is there.
    pub fn try_next(&mut self) -> Option<Reply> {
        let reply = self.replies.borrow_and_update().get(self.told).cloned();
        self.told += usize::from(reply.is_some());
        reply
    }
}

impl Drop for ReplyStream {
    fn drop(&mut self) {
        self.dispatcher.on(Input::Left(self.press));
    }
}

/// What a thread holds while a press is its own. Dropped without a word, because that thread broke, it still brings an
/// input, so that the press gets its end.
pub(super) struct ReplyGuard {
    dispatcher: Arc<Dispatcher>,
    press: PressKey,
    otherwise: Option<Input>,
}

impl ReplyGuard {
    fn new(dispatcher: &Arc<Dispatcher>, press: PressKey, otherwise: Input) -> Self {
        Self {
            dispatcher: dispatcher.clone(),
            press,
            otherwise: Some(otherwise),
        }
    }

    /// The press.
    pub(super) fn press(&self) -> PressKey {
        self.press
    }

    /// One for the thread that writes a capture of this press.
    pub(super) fn of_capture(&self, capture: String) -> Self {
        let result = Err("internal error: the recorder's thread has ended".into());
        let otherwise = Input::Written(capture, result);
        Self::new(&self.dispatcher, self.press, otherwise)
    }

    /// Ends what is held with an input.
    pub(super) fn end(mut self, input: Input) {
        self.otherwise = None;
        self.dispatcher.on(input);
    }
}

impl Drop for ReplyGuard {
    fn drop(&mut self) {
        if let Some(input) = self.otherwise.take() {
            self.dispatcher.on(input);
        }
    }
}
