//! Sessions: how they begin, how their captures are named, and what is noted in them.

use super::super::Answer;
use super::{Naming, Worker, split};
use crate::daemon::events::Event;
use crate::daemon::names;
use crate::daemon::recorder::{Done, Work};
use crate::log;
use crate::recording::{Note, RecordingSession};
use std::collections::BTreeMap;
use std::path::PathBuf;

impl Worker {
    /// The next capture's id; begins a session, named by the time, where there is none.
    pub(super) fn next_id(&mut self) -> Result<String, String> {
        if self.session.is_none() {
            let now = self.rig.clock().timestamp();
            let name = names::free(&self.plan.recording.folder, now);
            self.begin_session(&name, BTreeMap::new(), Box::new(log_error))?;
        }
        let session = self.session.as_mut().ok_or("there is no session")?;
        session.captures += 1;
        Ok(format!("{}-{:04}", session.name, session.captures))
    }

    pub(super) fn begin(&mut self, name: &str, about: BTreeMap<String, String>, answer: Answer) {
        let (told, failed) = split(answer);
        let words = format!("session {name}");
        let done: Done = Box::new(move |closed| told(closed.map(|_| words)));
        if let Err(reason) = self.begin_session(name, about, done) {
            failed(Err(reason));
        }
    }

    fn begin_session(
        &mut self,
        name: &str,
        about: BTreeMap<String, String>,
        done: Done,
    ) -> Result<(), String> {
        names::check_session(name)?;
        let mut preamble = self.plan.preamble.clone();
        if let Some(key) = about.keys().find(|key| preamble.about.contains_key(*key)) {
            return Err(format!("{key:?} is what the rig says of itself"));
        }
        preamble.about.extend(about);
        let folder = &self.plan.recording.folder;
        let session = RecordingSession::begin(
            folder,
            name,
            &self.plan.program,
            self.rig.clock().timestamp(),
            self.largest_file(),
            preamble,
        );
        let session = Box::new(session.map_err(|e| e.to_string())?);
        if let Some(models) = &self.plan.models {
            names::check_models(models, folder, name)?;
        }
        if let Some(jobs) = &self.plan.jobs
            && jobs.has_of(name)
        {
            return Err(format!(
                "models of an earlier session {name} are still to be made: take another name, or wait for them"
            ));
        }
        if !self.recorder.hand_over(Work::Begin(session, done)) {
            return Err("the disk is behind".into());
        }
        log::info!("session {name}");
        self.session = Some(Naming {
            name: name.into(),
            captures: 0,
        });
        let name = Some(name.to_owned());
        self.plan.events.publish(Event::Session { name });
        Ok(())
    }

    pub(super) fn write_down(&mut self, note: Note, answer: Answer) {
        let time = self.rig.clock().timestamp();
        let events = self.plan.events.clone();
        let event = Event::Note {
            capture: note.capture.clone(),
            kind: note.kind.clone(),
            text: note.text.clone(),
        };
        let answer: Answer = Box::new(move |written| {
            if written.is_ok() {
                events.publish(event);
            }
            answer(written);
        });
        self.pass_on(answer, |done| Work::Note(note, time, done));
    }

    /// Bytes after which a recording is completed and the next one begun.
    fn largest_file(&self) -> u64 {
        self.plan.recording.largest_file_mb * 1_000_000
    }

    pub(super) fn preamble_changed(&mut self) {
        let preamble = Box::new(self.plan.preamble.clone());
        let work = Work::Change(preamble, self.largest_file(), self.rig.clock().timestamp());
        if self.session.is_some() && !self.recorder.hand_over(work) {
            // Rather a session of its own than one whose later captures have old plates.
            log::warning!("the disk is behind: the next capture begins a session");
            self.session = None;
        }
    }
}

fn log_error(done: Result<PathBuf, String>) {
    if let Err(error) = done {
        log::error!("{error}");
    }
}
