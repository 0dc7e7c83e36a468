//! The thread that writes captures to the disk, one after the other, and reports each when it is durable.

use super::dispatcher::ReplyGuard;
use super::notes;
use super::presses::Input;
use super::systemd::Heartbeat;
use crate::frame::Timestamp;
use crate::log;
use crate::recording::{Error, FinishedCapture, Note, RecordingSession, SessionHeader};
use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, bounded};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread::JoinHandle;

/// Answers an order: words, or why not.
pub(super) type Answer = Box<dyn FnOnce(Result<String, String>) + Send>;

/// Why a piece of work is refused.
pub(super) const QUEUE_FULL: &str = "the recorder's queue is full";

/// Where a note goes.
pub(super) enum NotePlace {
    /// Into the file that the session writes, or beside the earlier one that has the capture.
    Session,
    /// Beside the complete recording in this folder that has the capture.
    Beside(PathBuf),
}

/// What is to be brought to the disk.
pub(super) enum RecorderTask {
    /// A session begins; the one before is completed.
    Begin(Box<RecordingSession>, Answer),
    /// What each file begins with has changed, or how large files become.
    Change(Box<SessionHeader>, u64, Timestamp),
    /// A capture, and what holds its press.
    Keep(Box<FinishedCapture>, ReplyGuard),
    /// What a person said, and where it goes.
    Note(Note, Timestamp, NotePlace, Answer),
    /// The session is completed.
    Close(Answer),
}

impl RecorderTask {
    /// Tells the client that waits that the work was not done.
    pub(super) fn refuse(self) {
        match self {
            Self::Change(..) => {}
            Self::Keep(kept, press) => written(press, &kept.record.id, Err(QUEUE_FULL.into())),
            Self::Begin(_, answer) | Self::Note(_, _, _, answer) | Self::Close(answer) => {
                answer(Err(QUEUE_FULL.into()));
            }
        }
    }
}

fn written(press: ReplyGuard, capture: &str, result: Result<PathBuf, String>) {
    press.end(Input::Written(capture.to_owned(), result));
}

/// The recorder's thread.
pub(super) struct Recorder {
    work: Sender<RecorderTask>,
    /// Captures that were handed over and are not on the disk.
    waiting: Arc<AtomicUsize>,
    most: usize,
    thread: JoinHandle<()>,
}

impl Recorder {
    /// Starts the thread; at most `most` captures wait.
    pub(super) fn start(most: usize, heartbeat: Heartbeat) -> std::io::Result<Self> {
        // Small pieces of work go beside the captures.
        let (work, queue) = bounded(4 * (most + 1));
        let waiting = Arc::new(AtomicUsize::new(0));
        let mut writing = Writing {
            session: None,
            unclosed: Vec::new(),
            waiting: waiting.clone(),
            heartbeat,
        };
        let thread = std::thread::Builder::new()
            .name("recorder".into())
            .spawn(move || writing.run(&queue))?;
        Ok(Self {
            work,
            waiting,
            most,
            thread,
        })
    }

    /// Captures that wait for the disk, the one that is being written among them.
    pub(super) fn waiting(&self) -> usize {
        self.waiting.load(Ordering::Acquire)
    }

    /// Whether another capture would find room.
    pub(super) fn has_room(&self) -> bool {
        self.waiting() < self.most
            && self
                .work
                .capacity()
                .is_some_and(|c| self.work.len() + 4 <= c)
    }

    /// Hands work over, or returns it if the queue is full.
    pub(super) fn hand_over(&self, work: RecorderTask) -> Result<(), RecorderTask> {
        let captures = usize::from(matches!(work, RecorderTask::Keep(..)));
        self.waiting.fetch_add(captures, Ordering::AcqRel);
        self.work.try_send(work).map_err(|refused| {
            self.waiting.fetch_sub(captures, Ordering::AcqRel);
            refused.into_inner()
        })
    }

    /// Finishes all work and completes the session.
    pub(super) fn stop(self) {
        drop(self.work);
        let _ = self.thread.join();
    }
}

struct Writing {
    session: Option<RecordingSession>,
    /// Earlier sessions that could not be completed; each close tries again.
    unclosed: Vec<RecordingSession>,
    waiting: Arc<AtomicUsize>,
    heartbeat: Heartbeat,
}

impl Writing {
    fn run(&mut self, queue: &Receiver<RecorderTask>) {
        loop {
            match self.heartbeat.wait(queue) {
                Ok(work) => self.carry_out(work),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => break,
            }
        }
        let _logged = self.close();
    }

    fn carry_out(&mut self, work: RecorderTask) {
        match work {
            RecorderTask::Begin(session, answer) => {
                // The outcome of the previous session is not an answer to the client that begins this one.
                let _logged = self.close();
                self.session = Some(*session);
                answer(Ok("done".into()));
            }
            RecorderTask::Change(header, largest_file, time) => {
                if let Some(session) = &mut self.session {
                    session.limit_files(largest_file);
                    if let Err(error) = session.change(*header, time) {
                        log::error!("{error}");
                    }
                }
            }
            RecorderTask::Keep(kept, press) => {
                let result = self.with(|session| {
                    let written = session.append(&kept);
                    if let Some(error) = session.take_unfinished() {
                        log::error!("{error}");
                    }
                    written
                });
                let capture = kept.record.id.clone();
                // The frames' memory is free again before a client hears of it.
                drop(kept);
                self.waiting.fetch_sub(1, Ordering::AcqRel);
                written(press, &capture, result);
            }
            RecorderTask::Note(note, time, NotePlace::Session, answer) => {
                let session = self.session.as_ref();
                if let Some(file) = session.and_then(|s| s.earlier_file_of(&note.capture)) {
                    return notes::write_beside_one_of(vec![file], note, time, answer);
                }
                let noted = self.with(|session| session.note(&note, time));
                if let Err(error) = &noted {
                    log::error!("{error}");
                }
                answer(noted.map(|()| "done".into()));
            }
            RecorderTask::Note(note, time, NotePlace::Beside(folder), answer) => {
                notes::write_beside(folder, note, time, answer);
            }
            RecorderTask::Close(answer) => answer(self.close().map(|()| "done".into())),
        }
    }

    fn with<T>(
        &mut self,
        write: impl FnOnce(&mut RecordingSession) -> Result<T, Error>,
    ) -> Result<T, String> {
        let words = "no recording is in progress, so the note cannot be recorded";
        let session = self.session.as_mut().ok_or(words)?;
        write(session).map_err(|error| error.to_string())
    }

    /// Completes the session and those before it that could not be completed. What fails is logged.
    fn close(&mut self) -> Result<(), String> {
        self.unclosed.extend(self.session.take());
        let mut closed = Ok(());
        self.unclosed.retain_mut(|session| {
            let Err(error) = session.close() else {
                return false;
            };
            let words = format!(
                "session {} is not completed: {error}; scand session close tries again",
                session.name()
            );
            log::error!("{words}");
            if closed.is_ok() {
                closed = Err(words);
            }
            true
        });
        closed
    }
}
