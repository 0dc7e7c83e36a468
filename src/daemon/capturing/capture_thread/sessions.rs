//! Sessions: begins them, names their captures, and records notes in them.

use super::{CaptureThread, SessionNaming};
use crate::daemon::events::Event;
use crate::daemon::names;
use crate::daemon::recorder::{Answer, NotePlace, QUEUE_FULL, RecorderTask};
use crate::log;
use crate::notes::NoteKind;
use crate::recording::{Note, RecordingSession};
use std::collections::BTreeMap;

impl CaptureThread {
    /// The next capture's id. If no session is open, begins one that is named by the time.
    pub(super) fn next_id(&mut self) -> Result<String, String> {
        if self.session.is_none() {
            let now = self.rig.clock().timestamp();
            let name = names::free(&self.plan.recording.folder, now);
            let session = self.open_session(&name, BTreeMap::new())?;
            self.enter_session(name, session, Box::new(|_| ()));
        }
        let session = self.session.as_mut().ok_or(QUEUE_FULL)?;
        session.captures += 1;
        Ok(format!("{}-{:04}", session.name, session.captures))
    }

    pub(super) fn begin(&mut self, name: &str, about: BTreeMap<String, String>, answer: Answer) {
        match self.open_session(name, about) {
            Ok(session) => self.enter_session(name.into(), session, answer),
            Err(reason) => answer(Err(reason)),
        }
    }

    /// A new session's file, which nothing is in the way of.
    fn open_session(
        &self,
        name: &str,
        about: BTreeMap<String, String>,
    ) -> Result<Box<RecordingSession>, String> {
        names::check_session(name)?;
        let mut header = self.plan.header.clone();
        if let Some(key) = about.keys().find(|key| header.about.contains_key(*key)) {
            return Err(format!(
                "scand itself writes {key:?} about a session: use another key"
            ));
        }
        header.about.extend(about);
        let folder = &self.plan.recording.folder;
        let session = RecordingSession::begin(
            folder,
            name,
            &self.plan.program,
            self.rig.clock().timestamp(),
            self.largest_file(),
            header,
        );
        let session = session.map_err(|e| e.to_string())?;
        if let Some(models) = &self.plan.models {
            names::check_models(models, folder, name)?;
        }
        if let Some(jobs) = &self.plan.jobs
            && jobs.has_jobs_of_session(name)
        {
            return Err(format!(
                "models of an earlier session {name} are not made yet, or its captures were rejected before that: \
                choose another name"
            ));
        }
        Ok(Box::new(session))
    }

    /// Lets captures go into a session from now on; answered when the one before is completed.
    fn enter_session(&mut self, name: String, session: Box<RecordingSession>, answer: Answer) {
        let words = format!("session {name}");
        let answer: Answer = Box::new(move |done| answer(done.map(|_| words)));
        if !self.hand_over(RecorderTask::Begin(session, answer)) {
            return;
        }
        log::info!("session {name} began");
        self.plan.events.publish(Event::Session {
            name: Some(name.clone()),
        });
        self.session = Some(SessionNaming { name, captures: 0 });
    }

    /// Writes a note to the disk: into the recording in progress if that has the capture, otherwise beside the
    /// recording that has it. The note takes effect only when it is on the disk.
    pub(super) fn write_down(&mut self, note: Note, answer: Answer) {
        let time = self.rig.clock().timestamp();
        let decides = NoteKind::of(&note.kind).decides();
        let is_session = |session: &SessionNaming| session.name == note.capture;
        if decides && self.session.as_ref().is_some_and(is_session) {
            return answer(Err(format!(
                "{:?} is the session: accept, reject and clear decide about a capture; give the capture's id, or a text",
                note.capture
            )));
        }
        let is_of = |session: &SessionNaming| {
            names::has_capture(&session.name, session.captures, &note.capture)
        };
        let place = match self.session.as_ref().is_some_and(is_of) {
            true => NotePlace::Session,
            false => NotePlace::Beside(self.plan.recording.folder.clone()),
        };
        let effects = self.note_effects.clone();
        let said = note.said(time);
        let events = self.plan.events.clone();
        let capture = note.capture.clone();
        let event = Event::Note {
            capture: note.capture.clone(),
            kind: note.kind.clone(),
            text: note.text.clone(),
        };
        let answer: Answer = Box::new(move |written| {
            if written.is_ok() {
                effects.carry_out(capture, said);
                events.publish(event);
            }
            answer(written);
        });
        self.hand_over(RecorderTask::Note(note, time, place, answer));
    }

    /// Bytes after which a recording is completed and the next one begun.
    fn largest_file(&self) -> u64 {
        self.plan.recording.largest_file_mb * 1_000_000
    }

    pub(super) fn header_changed(&mut self) {
        let header = Box::new(self.plan.header.clone());
        let work = RecorderTask::Change(header, self.largest_file(), self.rig.clock().timestamp());
        if self.session.is_some() && !self.hand_over(work) {
            // A session of its own, so that no capture has a background that is older than its session.
            log::warning!(
                "{QUEUE_FULL}, so the new settings or backgrounds start a new session at the next capture"
            );
            self.session = None;
        }
    }
}
