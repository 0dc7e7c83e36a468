//! The thread that brings captures to the disk, one after the other, and says of each when it is safe.

use super::systemd::Heart;
use crate::frame::Timestamp;
use crate::log;
use crate::recording::{Error, FinishedCapture, Note, RecordingSession, SessionHeader};
use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, bounded};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread::JoinHandle;

/// Called once with what became of a piece of work: where it is, or why it is not.
pub(super) type Done = Box<dyn FnOnce(Result<PathBuf, String>) + Send>;

/// What is to be brought to the disk.
pub(super) enum Work {
    /// A session begins; the one before is completed.
    Begin(Box<RecordingSession>, Done),
    /// What each file begins with has changed, or how large files become.
    Change(Box<SessionHeader>, u64, Timestamp),
    /// A capture.
    Keep(Box<FinishedCapture>, Done),
    /// What a person said.
    Note(Note, Timestamp, Done),
    /// The session is completed.
    Close(Done),
}

/// The recorder's thread.
pub(super) struct Recorder {
    work: Sender<Work>,
    /// Captures that were handed over and are not on the disk.
    waiting: Arc<AtomicUsize>,
    most: usize,
    thread: JoinHandle<()>,
}

impl Recorder {
    /// Starts the thread; at most `most` captures wait.
    pub(super) fn start(most: usize, heart: Heart) -> std::io::Result<Self> {
        // Small pieces of work go beside the captures.
        let (work, queue) = bounded(4 * (most + 1));
        let waiting = Arc::new(AtomicUsize::new(0));
        let mut writing = Writing {
            session: None,
            waiting: waiting.clone(),
            heart,
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

    /// Hands work over; false where there is no room for it, and then it was not done.
    pub(super) fn hand_over(&self, work: Work) -> bool {
        let capture = matches!(work, Work::Keep(..));
        if capture {
            self.waiting.fetch_add(1, Ordering::AcqRel);
        }
        let handed = self.work.try_send(work).is_ok();
        if capture && !handed {
            self.waiting.fetch_sub(1, Ordering::AcqRel);
        }
        handed
    }

    /// Finishes all work and completes the session.
    pub(super) fn stop(self) {
        drop(self.work);
        let _ = self.thread.join();
    }
}

struct Writing {
    session: Option<RecordingSession>,
    waiting: Arc<AtomicUsize>,
    heart: Heart,
}

impl Writing {
    fn run(&mut self, queue: &Receiver<Work>) {
        loop {
            match self.heart.wait(queue) {
                Ok(work) => self.carry_out(work),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => break,
            }
        }
        if let Err(error) = self.close() {
            log::error!("{error}");
        }
    }

    fn carry_out(&mut self, work: Work) {
        match work {
            Work::Begin(session, done) => {
                // What became of the session before is no answer to who begins this one.
                if let Err(error) = self.close() {
                    log::error!("{error}");
                }
                self.session = Some(*session);
                done(Ok(PathBuf::new()));
            }
            Work::Change(preamble, largest_file, time) => {
                if let Some(session) = &mut self.session {
                    session.limit_files(largest_file);
                    if let Err(error) = session.change(*preamble, time) {
                        log::error!("{error}");
                    }
                }
            }
            Work::Keep(kept, done) => {
                let written = self.with(|session| {
                    let written = session.append(&kept);
                    if let Some(error) = session.take_unfinished() {
                        log::error!("{error}");
                    }
                    written
                });
                // The frames' memory is free again before anybody hears of it.
                drop(kept);
                self.waiting.fetch_sub(1, Ordering::AcqRel);
                done(written);
            }
            Work::Note(note, time, done) => {
                done(self.with(|session| session.note(&note, time).map(|()| PathBuf::new())));
            }
            Work::Close(done) => done(self.close()),
        }
    }

    fn with(
        &mut self,
        write: impl FnOnce(&mut RecordingSession) -> Result<PathBuf, Error>,
    ) -> Result<PathBuf, String> {
        let words = "there is no session: a note goes into the recording in progress";
        let session = self.session.as_mut().ok_or(words)?;
        write(session).map_err(|error| error.to_string())
    }

    fn close(&mut self) -> Result<PathBuf, String> {
        let closed = self.session.take().map_or(Ok(()), RecordingSession::close);
        closed
            .map(|()| PathBuf::new())
            .map_err(|error| error.to_string())
    }
}
