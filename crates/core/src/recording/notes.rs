//! People's notes on captures: those in a recording, and those that were made after it was complete. The latter lie
//! beside it in `NAME.notes.jsonl`, one line of JSON each, because a complete recording never changes.

use super::recovery::finished_name;
use super::{Error, Note, Recording, Topic, json};
use crate::frame::Timestamp;
use crate::notes::{CaptureNote, CaptureNotes, NoteKind};
use crate::storage::sync_parent;
use rustix::fs::OFlags;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fs::OpenOptions;
use std::io::{Read, Seek, SeekFrom, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};

/// What the name of a file of notes ends with.
const ENDING: &str = ".notes.jsonl";
/// Largest file of notes that is read, in bytes.
const LARGEST: u64 = 16 << 20;
/// Most problems with notes that are reported.
const MOST_PROBLEMS: usize = 20;
/// Longest text of a note that is kept, in letters.
const LONGEST_TEXT: usize = 4096;

impl Note {
    /// What it says, as of `time`.
    pub fn said(&self, time: Timestamp) -> CaptureNote {
        CaptureNote {
            time_ns: time,
            kind: NoteKind::of(&self.kind),
            text: self.text.chars().take(LONGEST_TEXT).collect(),
            author: self.author.clone(),
        }
    }
}

/// The notes on all captures of a recording.
#[derive(Clone, Debug, Default)]
pub struct Notes {
    by_name: BTreeMap<String, Vec<CaptureNote>>,
    problems: Vec<String>,
}

impl Notes {
    /// Reads the notes in a recording and those beside it.
    pub fn of(recording: &Recording) -> Self {
        let mut notes = Self::default();
        for (message, read) in recording.read_each(&Topic::Note, |m| recording.note(m)) {
            match read {
                Ok(note) => notes.add(&note, message.log_time()),
                Err(error) => notes.problem(error.to_string()),
            }
        }
        let path = beside(recording.path());
        match lines(&path) {
            Ok(Some(text)) => notes.add_lines(recording, &path, &text),
            Ok(None) => {}
            Err(problem) => notes.problem(format!("{}: {problem}", path.display())),
        }
        notes
    }

    /// The notes on a capture, or on the session under its name.
    pub fn on(&self, name: &str) -> CaptureNotes {
        CaptureNotes::new(self.by_name.get(name).cloned().unwrap_or_default())
    }

    /// The notes on the session of a recording.
    pub fn on_session(&self, recording: &Recording) -> CaptureNotes {
        let name = recording.session_pair("name");
        name.map(|name| self.on(name)).unwrap_or_default()
    }

    /// Notes that could not be read, or that belong to another recording.
    pub fn problems(&self) -> &[String] {
        &self.problems
    }

    fn add(&mut self, note: &Note, time: Timestamp) {
        let said = note.said(time);
        self.by_name
            .entry(note.capture.clone())
            .or_default()
            .push(said);
    }

    fn problem(&mut self, problem: String) {
        if self.problems.len() < MOST_PROBLEMS {
            self.problems.push(problem);
        }
    }

    fn add_lines(&mut self, recording: &Recording, path: &Path, text: &str) {
        let named = Named::of(recording);
        for (number, line) in (1..).zip(text.lines()).filter(|(_, line)| !line.is_empty()) {
            let at = format!("{}: line {number}", path.display());
            match serde_json::from_str::<Line>(line) {
                Ok(line) if named.has(&line.note.capture, line.trigger) => {
                    self.add(&line.note, line.time);
                }
                Ok(line) => self.problem(format!(
                    "{at}: it is about capture {:?}, which {} does not have: the line belongs to another recording and \
                     is left out",
                    line.note.capture,
                    recording.path().display()
                )),
                Err(error) => self.problem(format!("{at}: it is not a note ({error}) and is left out")),
            }
        }
    }
}

/// A line of a file of notes.
#[derive(Serialize, Deserialize)]
struct Line {
    time: Timestamp,
    /// The time of the capture's trigger; none for a note on the session.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    trigger: Option<Timestamp>,
    #[serde(flatten)]
    note: Note,
}

/// The names in a recording that a note can be on.
struct Named {
    triggers: BTreeMap<String, Timestamp>,
    session: Option<String>,
}

impl Named {
    fn of(recording: &Recording) -> Self {
        let triggers = recording.read_each(&Topic::Trigger, |m| recording.trigger(m));
        let triggers = triggers.into_iter().rev();
        let triggers = triggers.filter_map(|(_, read)| read.ok());
        Self {
            // Of several triggers with one id the first one makes the capture.
            triggers: triggers.map(|t| (t.id.to_string(), t.time)).collect(),
            session: recording.session_pair("name").map(Into::into),
        }
    }

    fn has(&self, name: &str, trigger: Option<Timestamp>) -> bool {
        match self.triggers.get(name) {
            Some(time) => trigger == Some(*time),
            None => trigger.is_none() && self.session.as_deref() == Some(name),
        }
    }
}

/// The file of notes beside a recording, whether that is complete or not.
pub fn beside(recording: &Path) -> PathBuf {
    let complete = finished_name(recording).unwrap_or_else(|| recording.to_owned());
    let stem = complete.file_stem().unwrap_or_default().to_string_lossy();
    complete.with_file_name(format!("{stem}{ENDING}"))
}

/// The recording that a file of notes is about; `None` if the path is that of no such file.
pub fn noted_recording(path: &Path) -> Option<PathBuf> {
    let stem = path.file_name()?.to_str()?.strip_suffix(ENDING)?;
    (!stem.is_empty()).then(|| path.with_file_name(format!("{stem}.mcap")))
}

/// The file of notes beside a recording, to be copied; `None` if there is none.
///
/// # Errors
/// If it is a link or no regular file: whoever supplied the recording may have let it lead to anything.
pub fn notes_to_copy(recording: &Path) -> std::io::Result<Option<PathBuf>> {
    let path = beside(recording);
    match path.symlink_metadata() {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(error),
        Ok(about) if about.is_file() => Ok(Some(path)),
        Ok(about) if about.is_symlink() => Err(std::io::Error::other(IS_LINK)),
        Ok(_) => Err(std::io::Error::other(NO_FILE)),
    }
}

/// Why a file of notes is neither written nor copied.
const IS_LINK: &str = "it is a link, which may lead to anything: put the file itself there";
const NO_FILE: &str = "it is not a regular file";

/// A note that is on the disk.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WrittenNote {
    /// The file that has it.
    pub file: PathBuf,
    /// The time of a decision that is later, and so wins: a clock was wrong.
    pub later: Option<Timestamp>,
}

impl WrittenNote {
    /// For a person.
    pub fn words(&self) -> String {
        let file = self.file.display();
        match self.later {
            None => format!("the note is in {file}"),
            Some(later) => format!(
                "the note is in {file}, but changes nothing: a decision of {}, which is later than this machine's clock, \
                 stays valid; set the clock and repeat the note",
                later.iso_8601()
            ),
        }
    }
}

/// Adds a note to the file beside a complete recording. When this returns, the note survives a power cut.
///
/// # Errors
/// If the recording has neither the capture nor a session of that name, the note decides something about a session, or
/// the file cannot be written.
pub fn note_beside(
    recording: &Recording,
    note: &Note,
    time: Timestamp,
) -> Result<WrittenNote, Error> {
    let named = Named::of(recording);
    let trigger = named.triggers.get(&note.capture).copied();
    if !named.has(&note.capture, trigger) {
        return Err(Error::NothingToNote {
            path: recording.path().into(),
            name: super::error::shortened(&note.capture),
        });
    }
    let decides = NoteKind::of(&note.kind).decides();
    if decides && trigger.is_none() {
        return Err(Error::DecisionOnSession {
            path: recording.path().into(),
            name: super::error::shortened(&note.capture),
        });
    }
    let before = Notes::of(recording).on(&note.capture).said;
    let later = before.into_iter().rfind(|said| said.kind.decides());
    let later = later.filter(|said| decides && said.time_ns > time);
    let path = beside(recording.path());
    let line = Line {
        time,
        trigger,
        note: note.clone(),
    };
    append(&path, json::write(&line)).map_err(|cause| Error::Io {
        path: path.clone(),
        cause,
    })?;
    Ok(WrittenNote {
        file: path,
        later: later.map(|said| said.time_ns),
    })
}

/// Appends a line and brings it to the disk. A line that a power cut left unfinished is ended first. Nothing is written
/// to where a link leads.
fn append(path: &Path, mut line: Vec<u8>) -> std::io::Result<()> {
    if path.is_symlink() {
        return Err(std::io::Error::other(IS_LINK));
    }
    let flags = OFlags::NOFOLLOW | OFlags::NONBLOCK;
    let mut file = OpenOptions::new()
        .read(true)
        .append(true)
        .create(true)
        .custom_flags(flags.bits() as i32)
        .open(path)?;
    if !file.metadata()?.is_file() {
        return Err(std::io::Error::other(NO_FILE));
    }
    file.lock()?;
    let length = file.metadata()?.len();
    if length > 0 {
        let mut last = [0];
        file.seek(SeekFrom::Start(length - 1))?;
        file.read_exact(&mut last)?;
        if last != *b"\n" {
            line.insert(0, b'\n');
        }
    }
    line.push(b'\n');
    file.write_all(&line)?;
    file.sync_data()?;
    if length == 0 {
        sync_parent(path)
    } else {
        Ok(())
    }
}

/// The text of a file of notes; `None` if there is none.
fn lines(path: &Path) -> Result<Option<String>, String> {
    // Opening a pipe would wait for its writer.
    let flags = OFlags::NONBLOCK.bits() as i32;
    let opened = OpenOptions::new().read(true).custom_flags(flags).open(path);
    let file = match opened {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        opened => opened.map_err(|error| error.to_string())?,
    };
    let about = file.metadata().map_err(|error| error.to_string())?;
    if !about.is_file() {
        return Err(NO_FILE.into());
    }
    if about.len() > LARGEST {
        let bytes = about.len();
        return Err(format!("it has {bytes} bytes, expected at most {LARGEST}"));
    }
    let mut bytes = Vec::new();
    file.take(LARGEST)
        .read_to_end(&mut bytes)
        .map_err(|error| error.to_string())?;
    Ok(Some(String::from_utf8_lossy(&bytes).into_owned()))
}

#[cfg(test)]
mod tests {
    use super::super::testing::noted_recording as recording_of;
    use super::super::{Compression, Writer};
    use super::*;
    use crate::notes::Decision;

    fn note(kind: &str, text: &str) -> Note {
        Note {
            capture: "cup-1".into(),
            kind: kind.into(),
            text: text.into(),
            author: Some("Ann".into()),
        }
    }

    #[test]
    fn nothing_is_written_to_where_a_link_leads_and_no_pipe_is_waited_for() {
        let folder = tempfile::tempdir().unwrap();
        let path = recording_of(folder.path(), &[]);
        let open = || Recording::open(&path).unwrap();
        let reject = || note_beside(&open(), &note("reject", ""), Timestamp(500));
        let other = folder.path().join("other");
        std::fs::write(&other, "precious\n").unwrap();
        std::os::unix::fs::symlink(&other, beside(&path)).unwrap();
        let refused = reject().unwrap_err().to_string();
        assert!(refused.contains("it is a link"), "{refused}");
        assert_eq!(std::fs::read_to_string(&other).unwrap(), "precious\n");
        assert!(notes_to_copy(&path).is_err());
        std::fs::remove_file(beside(&path)).unwrap();
        assert_eq!(notes_to_copy(&path).unwrap(), None);
        let made = std::process::Command::new("mkfifo")
            .arg(beside(&path))
            .status();
        assert!(made.unwrap().success());
        let notes = Notes::of(&open());
        assert!(notes.problems()[0].contains(NO_FILE), "{notes:?}");
        let refused = reject().unwrap_err().to_string();
        assert!(refused.contains(NO_FILE), "{refused}");
    }

    #[test]
    fn notes_of_both_places_count_and_the_recording_does_not_change() {
        let folder = tempfile::tempdir().unwrap();
        let path = recording_of(folder.path(), &[("accept", 300)]);
        let before = std::fs::read(&path).unwrap();
        let open = || Recording::open(&path).unwrap();
        assert_eq!(
            Notes::of(&open()).on("cup-1").decision,
            Some(Decision::Accepted)
        );
        let file = note_beside(&open(), &note("reject", "a hand\nin it"), Timestamp(400)).unwrap();
        assert_eq!(file.file, folder.path().join("cup.notes.jsonl"));
        let notes = Notes::of(&open());
        assert_eq!(notes.problems(), [""; 0]);
        let on = notes.on("cup-1");
        assert!(on.is_rejected(), "{on:?}");
        let words = ["rejected by Ann on 1970-01-01T00:00:00.000Z: a hand in it"];
        assert_eq!(on.lines(), words);
        note_beside(&open(), &note("clear", ""), Timestamp(500)).unwrap();
        let on = Notes::of(&open()).on("cup-1");
        assert_eq!((on.decision, on.said.len()), (None, 3));
        assert_eq!(std::fs::read(&path).unwrap(), before);
    }

    #[test]
    fn an_earlier_note_beside_the_recording_does_not_win() {
        let folder = tempfile::tempdir().unwrap();
        let path = recording_of(folder.path(), &[("accept", 300)]);
        let recording = Recording::open(&path).unwrap();
        let written = note_beside(&recording, &note("reject", ""), Timestamp(200)).unwrap();
        assert_eq!(written.later, Some(Timestamp(300)));
        let words = written.words();
        assert!(words.contains("changes nothing"), "{words}");
        let text = note_beside(&recording, &note("text", "seen"), Timestamp(200)).unwrap();
        assert_eq!(text.later, None);
        assert_eq!(
            Notes::of(&recording).on("cup-1").decision,
            Some(Decision::Accepted)
        );
    }

    #[test]
    fn notes_of_another_recording_and_torn_lines_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = recording_of(folder.path(), &[]);
        let recording = Recording::open(&path).unwrap();
        let file = beside(&path);
        let other = r#"{"time":"9","trigger":"8","capture":"cup-1","kind":"reject","text":""}"#;
        std::fs::write(&file, format!("{other}\n{{\"time\":\"1")).unwrap();
        note_beside(&recording, &note("text", "whole"), Timestamp(10)).unwrap();
        let notes = Notes::of(&recording);
        let [first, second] = notes.problems() else {
            panic!("{:?}", notes.problems());
        };
        assert!(first.contains("cup.notes.jsonl: line 1") && first.contains("another recording"));
        assert!(second.contains("line 2"), "{second}");
        let on = notes.on("cup-1");
        assert_eq!((on.decision, on.said.len()), (None, 1));
        let unknown = Note {
            capture: "cup-9".into(),
            ..note("accept", "")
        };
        let refused = note_beside(&recording, &unknown, Timestamp(1)).unwrap_err();
        assert!(refused.to_string().contains("cup-9"), "{refused}");
    }

    #[test]
    fn a_note_on_the_session_is_a_text() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("monday.mcap");
        let mut writer = Writer::create(&path, "scand test", Compression::None).unwrap();
        let pairs = [("name".to_owned(), "monday".to_owned())].into();
        writer.metadata("session", &pairs).unwrap();
        writer.finish().unwrap();
        let recording = Recording::open(&path).unwrap();
        let on_session = |kind| Note {
            capture: "monday".into(),
            ..note(kind, "the lamp was changed")
        };
        for kind in ["accept", "reject", "clear"] {
            let refused = note_beside(&recording, &on_session(kind), Timestamp(1)).unwrap_err();
            assert!(refused.to_string().contains("is the session"), "{refused}");
        }
        note_beside(&recording, &on_session("text"), Timestamp(1)).unwrap();
        let on = Notes::of(&recording).on_session(&recording);
        assert_eq!(on.said.len(), 1);
    }

    #[test]
    fn a_file_of_notes_names_its_recording_and_the_other_way_round() {
        for recording in ["a/cup.mcap", "a/cup.mcap.part"] {
            assert_eq!(beside(Path::new(recording)), Path::new("a/cup.notes.jsonl"));
        }
        let noted = |path| noted_recording(Path::new(path));
        assert_eq!(noted("a/cup.notes.jsonl"), Some("a/cup.mcap".into()));
        assert_eq!(noted("a/.notes.jsonl").or(noted("a/cup.jsonl")), None);
    }
}
