//! Presses by the names that clients give them: the same name again is the same capture and hears the same answers,
//! also after a restart. A press has its answers here, once each, and whoever asks follows them. How a capture is taken
//! is not known here.

mod journal;
mod recorded;
#[cfg(test)]
mod tests;

use super::events::Event;
use crate::trigger::{Reply, Until};
use journal::Journal;
use parking_lot::{Mutex, MutexGuard};
use recorded::Recorded;
use std::collections::{BTreeMap, VecDeque};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use tokio::sync::watch;

/// Presses that are known; after them the oldest are forgotten.
const MOST: usize = 10_000;
/// Letters of a press's name.
const LONGEST_ID: usize = 64;

/// What a press was answered so far, to be followed.
pub type Following = watch::Receiver<Vec<Reply>>;

/// All presses.
pub struct Presses {
    known: Mutex<Known>,
    /// Locked on its own, so that nobody who asks waits for a disk.
    journal: Mutex<Journal>,
}

/// One press.
pub(super) struct Answers {
    id: Option<String>,
    replies: watch::Sender<Vec<Reply>>,
}

#[derive(Default)]
struct Known {
    by_id: BTreeMap<String, Arc<Answers>>,
    by_capture: BTreeMap<String, Arc<Answers>>,
    /// Those that a capture was begun for, oldest first.
    accepted: VecDeque<Arc<Answers>>,
}

/// Whether a press is to be carried out, or was before.
pub(super) enum Asked {
    /// It is the first of its name.
    New(Arc<Answers>),
    /// It is followed like any other.
    Known(Following),
}

impl Presses {
    /// Reads in a folder what was answered before, and settles what the end of the daemon cut short: `left` are the
    /// recordings that were open then.
    pub(super) fn open(folder: &Path, left: &[PathBuf]) -> Self {
        let (journal, lines) = Journal::open(folder);
        let presses = Self {
            known: Mutex::default(),
            journal: Mutex::new(journal),
        };
        for line in lines {
            let answers = presses.remembered(&line.press_id);
            presses.hear(&answers, line.reply);
        }
        let recorded = recorded::captures(left);
        for capture in &recorded {
            presses.recall(capture);
        }
        presses.settle(&recorded);
        presses
    }

    /// Asks for a press by its name, if it has one.
    ///
    /// # Errors
    /// If the name is none.
    pub(super) fn ask(&self, id: Option<&str>) -> Result<Asked, String> {
        let Some(id) = id else {
            return Ok(Asked::New(Answers::new(None)));
        };
        check_id(id)?;
        let mut known = self.known();
        if let Some(answers) = known.by_id.get(id) {
            return Ok(Asked::Known(answers.follow()));
        }
        let answers = Answers::new(Some(id.into()));
        known.by_id.insert(id.into(), answers.clone());
        Ok(Asked::New(answers))
    }

    /// Answers a press. What is on the disk stays known; what was not begun is forgotten, and its name free again.
    pub(super) fn tell(&self, answers: &Arc<Answers>, reply: Reply) {
        if let Some(id) = &answers.id
            && !was_not_begun(&reply)
        {
            self.journal.lock().append(id, &reply);
        }
        let settles = settles(&reply);
        self.hear(answers, reply);
        if settles && answers.id.is_some() {
            let file = self.journal.lock().file();
            file.iter().for_each(|file| journal::sync(file));
        }
    }

    /// What became of a model is an answer to the press of its capture.
    pub(super) fn witness(&self, event: &Event) {
        let (Event::Done { capture, .. } | Event::JobFailed { capture, .. }) = event else {
            return;
        };
        let answers = self.known().by_capture.get(capture).cloned();
        if let Some(answers) = answers.filter(|a| !a.has_end(Until::Done)) {
            self.tell(&answers, event.to_reply());
        }
    }

    /// Enters an answer, and lets everybody who follows hear it.
    fn hear(&self, answers: &Arc<Answers>, reply: Reply) {
        if answers.has_end(Until::Done) || answers.replies.borrow().contains(&reply) {
            return;
        }
        let mut known = self.known();
        match &reply {
            Reply::Accepted { capture, .. } => known.enter(capture, answers),
            reply if was_not_begun(reply) => known.free(answers),
            _ => {}
        }
        drop(known);
        answers.replies.send_modify(|replies| replies.push(reply));
    }

    fn remembered(&self, id: &str) -> Arc<Answers> {
        let mut known = self.known();
        let new = || Answers::new(Some(id.into()));
        known.by_id.entry(id.into()).or_insert_with(new).clone()
    }

    /// A capture of a press whose journal did not survive, as a recording has it.
    fn recall(&self, capture: &Recorded) {
        let Some(id) = capture
            .press_id
            .as_deref()
            .filter(|id| check_id(id).is_ok())
        else {
            return;
        };
        let answers = self.remembered(id);
        let accepted = Reply::Accepted {
            capture: capture.capture.clone(),
            source: None,
            press_id: None,
            subject: None,
        };
        let known = answers.replies.borrow().contains(&accepted);
        if !known && !answers.has_end(Until::Durable) {
            self.tell(&answers, accepted);
        }
    }

    /// Every press that was accepted and has no end gets it: what the recordings say, or that it is lost.
    fn settle(&self, recorded: &[Recorded]) {
        let open: Vec<Arc<Answers>> = self.known().by_id.values().cloned().collect();
        for answers in open.iter().filter(|a| !a.has_end(Until::Durable)) {
            let capture = answers.last_capture().unwrap_or_default();
            let found = recorded.iter().rfind(|r| r.capture == capture);
            let lost = || {
                let reason = "the daemon ended before it was on the disk".to_owned();
                vec![Reply::Failed { capture, reason }]
            };
            for reply in found.map_or_else(lost, Recorded::answers) {
                self.tell(answers, reply);
            }
        }
    }

    fn known(&self) -> MutexGuard<'_, Known> {
        self.known.lock()
    }
}

impl Known {
    /// Enters a press that a capture is begun for, and forgets the oldest that nobody follows.
    fn enter(&mut self, capture: &str, answers: &Arc<Answers>) {
        let retried = !answers.replies.borrow().is_empty();
        self.by_capture.insert(capture.into(), answers.clone());
        if retried {
            return;
        }
        self.accepted.push_back(answers.clone());
        if self.accepted.len() > MOST {
            let forgotten = self.accepted.iter().position(|a| !a.is_followed());
            if let Some(answers) = forgotten.and_then(|i| self.accepted.remove(i)) {
                self.forget(&answers);
            }
        }
    }

    fn forget(&mut self, answers: &Arc<Answers>) {
        self.free(answers);
        for reply in answers.replies.borrow().iter() {
            if let Reply::Accepted { capture, .. } = reply {
                let own = |found: &Arc<Answers>| Arc::ptr_eq(found, answers);
                if self.by_capture.get(capture).is_some_and(own) {
                    self.by_capture.remove(capture);
                }
            }
        }
    }

    /// Frees a press's name.
    fn free(&mut self, answers: &Arc<Answers>) {
        let own = |found: &Arc<Answers>| Arc::ptr_eq(found, answers);
        if let Some(id) = &answers.id
            && self.by_id.get(id).is_some_and(own)
        {
            self.by_id.remove(id);
        }
    }
}

impl Answers {
    fn new(id: Option<String>) -> Arc<Self> {
        let replies = watch::Sender::default();
        Arc::new(Self { id, replies })
    }

    /// Follows what it is answered, from its first answer on.
    pub(super) fn follow(&self) -> Following {
        self.replies.subscribe()
    }

    fn is_followed(&self) -> bool {
        self.replies.receiver_count() > 0
    }

    fn has_end(&self, until: Until) -> bool {
        self.replies.borrow().iter().any(|r| r.is_end(until))
    }

    /// The capture that was begun last for it.
    fn last_capture(&self) -> Option<String> {
        let replies = self.replies.borrow();
        replies.iter().rev().find_map(|reply| match reply {
            Reply::Accepted { capture, .. } => Some(capture.clone()),
            _ => None,
        })
    }
}

/// What hears how a press goes on. A press that is dropped without an end, because whoever took it broke, gets one.
pub(super) struct Promise {
    /// Where it is answered.
    pub presses: Arc<Presses>,
    /// The press.
    pub answers: Arc<Answers>,
}

impl Promise {
    /// Answers it.
    pub(super) fn tell(&self, reply: Reply) {
        self.presses.tell(&self.answers, reply);
    }
}

impl Drop for Promise {
    fn drop(&mut self) {
        if self.answers.has_end(Until::Durable) {
            return;
        }
        let reason = "internal error: nobody ended it".to_owned();
        self.tell(match self.answers.last_capture() {
            Some(capture) => Reply::Failed { capture, reason },
            None => Reply::Refused { reason },
        });
    }
}

/// Whether nothing was begun, so that the same name may be tried again.
fn was_not_begun(reply: &Reply) -> bool {
    matches!(reply, Reply::Busy | Reply::Refused { .. })
}

/// Whether a client may rely on it for good.
fn settles(reply: &Reply) -> bool {
    reply.is_end(Until::Durable) && !was_not_begun(reply)
}

fn check_id(id: &str) -> Result<(), String> {
    let letters = id.chars().count();
    if (1..=LONGEST_ID).contains(&letters) && !id.chars().any(char::is_control) {
        return Ok(());
    }
    let shown: String = id.chars().take(LONGEST_ID + 16).collect();
    Err(format!(
        "press_id {shown:?} is not 1 to {LONGEST_ID} letters without control characters"
    ))
}
