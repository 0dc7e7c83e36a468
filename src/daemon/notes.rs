//! Carries out notes: a note on a capture of a closed session is written beside its recording, and a note takes effect
//! when it is on the disk. A reject removes the capture's job from the queue if no worker has begun it; a clear or an
//! accept puts it back. An existing model stays and is marked with the note; that of an object is made again without
//! the capture, or with it.

use super::dispatcher::Dispatcher;
use super::names;
use super::presses::Input;
use crate::frame::Timestamp;
use crate::log;
use crate::make_model::mark_also;
use crate::notes::{CaptureNote, NoteKind};
use crate::recording::{Error, Note, Recording, note_beside};
use crate::trigger::Event;
use crate::workers::Jobs;
use parking_lot::Mutex;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Writes a note beside the complete recording that has its capture, and answers. A recording is opened on its own
/// thread, because a large damaged one has to be read completely.
pub(super) fn write_beside(
    folder: PathBuf,
    note: Note,
    time: Timestamp,
    answer: impl FnOnce(Result<String, String>) + Send + 'static,
) {
    let candidates = candidates(&folder, &note.capture);
    if candidates.is_empty() {
        let capture = &note.capture;
        return answer(Err(format!(
            "no recording in {} is named after capture {capture:?}: if its recording was renamed, name that file with \
             scand note --recording",
            folder.display()
        )));
    }
    write_beside_one_of(candidates, note, time, answer);
}

/// Writes a note beside the first of these recordings that has its capture, and answers.
pub(super) fn write_beside_one_of(
    candidates: Vec<PathBuf>,
    note: Note,
    time: Timestamp,
    answer: impl FnOnce(Result<String, String>) + Send + 'static,
) {
    let write = move || answer(write_to_one(&candidates, &note, time));
    if let Err(error) = std::thread::Builder::new().name("note".into()).spawn(write) {
        log::error!(
            "cannot start a thread to store the note, so the note is lost: {error}; repeat the note"
        );
    }
}

/// Complete recordings whose names say that they are of the session of a capture, or of the session itself.
fn candidates(folder: &Path, name: &str) -> Vec<PathBuf> {
    let files = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let is_of = |path: &PathBuf| {
        let stem = path.file_stem().unwrap_or_default().to_string_lossy();
        let is_complete = path.extension().is_some_and(|ending| ending == "mcap");
        is_complete
            && [name, names::session_of(name)]
                .iter()
                .any(|session| names::is_of(&stem, session))
    };
    let mut found: Vec<PathBuf> = files.map(|file| file.path()).filter(is_of).collect();
    found.sort();
    found
}

fn write_to_one(candidates: &[PathBuf], note: &Note, time: Timestamp) -> Result<String, String> {
    let (mut refused, mut without) = (None, None);
    for path in candidates {
        let written =
            Recording::open(path).and_then(|recording| note_beside(&recording, note, time));
        match written {
            Ok(written) => return Ok(written.words()),
            Err(error @ Error::NothingToNote { .. }) => without = Some(error),
            Err(error) => refused = refused.or(Some(error)),
        }
    }
    // That another file does not have the capture explains nothing if the note could not be written.
    Err(refused
        .or(without)
        .map_or_else(String::new, |e| e.to_string()))
}

/// Lets notes take effect.
pub(super) struct NoteEffects {
    pub(super) jobs: Option<Arc<Jobs>>,
    /// Where models go.
    pub(super) models: Option<PathBuf>,
    /// Notes on captures whose models are being made, which may not have read them.
    pub(super) late: Mutex<BTreeMap<String, Vec<CaptureNote>>>,
    pub(super) dispatcher: Arc<Dispatcher>,
    /// Held while a model is marked: its report is read, changed and written, and notes come on several threads.
    pub(super) marking: Mutex<()>,
}

impl NoteEffects {
    /// Does what a note that is on the disk asks for.
    pub(super) fn carry_out(&self, capture: String, said: CaptureNote) {
        if let Some(jobs) = &self.jobs {
            match said.kind {
                NoteKind::Reject => self.withdraw(jobs, &capture),
                NoteKind::Accept | NoteKind::Clear => jobs.offer_again(&capture),
                NoteKind::Text => {}
            }
            if said.kind != NoteKind::Text {
                fuse_again(jobs, &capture);
            }
            if jobs.is_running(&capture) {
                self.late
                    .lock()
                    .entry(capture.clone())
                    .or_default()
                    .push(said.clone());
            }
        }
        let folders = self
            .models
            .iter()
            .flat_map(|models| folders(models, &capture));
        let _alone = self.marking.lock();
        for folder in folders {
            log_failure(mark_also(&folder, std::slice::from_ref(&said)), &capture);
        }
    }

    /// Withdraws a waiting job; its press gets the answer that there will be no model.
    fn withdraw(&self, jobs: &Jobs, capture: &str) {
        if let Some(recording) = jobs.withdraw(capture) {
            log::notice!("capture {capture}: rejected before its model was made");
            self.dispatcher.on(Input::JobEnded(Event::JobFailed {
                capture: capture.into(),
                recording: Some(recording),
                reason: "the capture was rejected before its model was made".into(),
            }));
        }
    }

    /// Marks a model that was just made with the notes that were made meanwhile.
    pub(super) fn job_ended(&self, event: &Event) {
        let (Event::Done { capture, .. } | Event::JobFailed { capture, .. }) = event else {
            return;
        };
        let said = self.late.lock().remove(capture);
        let _alone = self.marking.lock();
        if let (Some(said), Event::Done { model, .. }) = (said, event) {
            log_failure(mark_also(model, &said), capture);
        }
    }
}

/// Has the model of a capture's object made again. Recordings of an earlier session have to be read, on a thread of its
/// own; the end of the daemon does not wait for it, and the next start repeats it.
fn fuse_again(jobs: &Arc<Jobs>, capture: &str) {
    if jobs.objects().noted_in_progress(capture) {
        return;
    }
    jobs.objects().keep_noted(capture);
    let (jobs, name) = (jobs.clone(), capture.to_owned());
    let noted = move || jobs.objects().noted(&name);
    if let Err(error) = std::thread::Builder::new()
        .name("object".into())
        .spawn(noted)
    {
        log::error!(
            "capture {capture}: its object's model stays as it is until the daemon's next start: {error}"
        );
    }
}

/// The folders of a capture's models.
fn folders(models: &Path, capture: &str) -> Vec<PathBuf> {
    let session = names::session_of(capture);
    let stems = std::fs::read_dir(models).into_iter().flatten().flatten();
    let is_of = |path: &PathBuf| {
        names::is_of(
            &path.file_name().unwrap_or_default().to_string_lossy(),
            session,
        )
    };
    let of_session = stems.map(|stem| stem.path()).filter(is_of);
    // Beside a model lie those that were made again with other settings.
    let remade = format!("{capture}.remake-");
    let is_of_capture = |path: &PathBuf| {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        name == capture || name.starts_with(&remade)
    };
    let inside =
        of_session.flat_map(|stem| std::fs::read_dir(stem).into_iter().flatten().flatten());
    let mut found: Vec<PathBuf> = inside
        .map(|entry| entry.path())
        .filter(|path| is_of_capture(path) && path.join("report.json").is_file())
        .collect();
    found.sort();
    found
}

fn log_failure(marked: Result<(), crate::make_model::Error>, capture: &str) {
    if let Err(error) = marked {
        log::error!("capture {capture}: cannot mark its model with the note: {error}");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_note_is_of_the_first_model_and_of_those_that_were_made_again() {
        let models = tempfile::tempdir().unwrap();
        let names = [
            "a/a-0001",
            "a/a-0001.remake-1",
            "a/a-00011",
            "a/17.object",
            "b/a-0001",
        ];
        for folder in names.map(|name| models.path().join(name)) {
            std::fs::create_dir_all(&folder).unwrap();
            std::fs::write(folder.join("report.json"), "{}").unwrap();
        }
        std::fs::create_dir_all(models.path().join("a/a-0001.remake-2")).unwrap();
        let expected = [names[0], names[1]].map(|name| models.path().join(name));
        assert_eq!(folders(models.path(), "a-0001"), expected);
    }
}
