//! Finds captures by a capture's id, an object's number, a session's name or a recording's file.

use crate::capture::{CaptureSession, CaptureSummary};
use crate::recording::{Recording, finished_name};
use crate::sync;
use crate::words::count;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// A recording and those of its captures that are wanted.
pub(super) struct SelectedCaptures {
    pub(super) path: PathBuf,
    pub(super) session: CaptureSession,
    pub(super) captures: Vec<ChosenCapture>,
}

/// A capture that is wanted.
pub(super) struct ChosenCapture {
    pub(super) summary: CaptureSummary,
    /// Whether it was named by its own id.
    pub(super) is_named: bool,
}

/// What the words name.
pub(super) struct Selection {
    pub(super) chosen: Vec<SelectedCaptures>,
    /// Recordings of the folder that cannot be read, or are not complete: what is not in the package, and why.
    pub(super) unread: Vec<String>,
}

/// The recordings and captures that the words name.
///
/// # Errors
/// If a word names nothing, or a recording that is named is not complete or cannot be read.
pub(super) fn choose(words: &[String], folder: &Path) -> anyhow::Result<Selection> {
    if let Some(folder) = words.iter().find(|word| Path::new(word).is_dir()) {
        anyhow::bail!(
            "{folder} is a folder: name captures, objects, sessions or the files of recordings; --recordings says where \
             recordings are, and --models where their models are"
        );
    }
    let (files, names): (Vec<&String>, Vec<&String>) =
        words.iter().partition(|word| Path::new(word).is_file());
    let mut search = Search::new(names);
    for file in files {
        search.take_file(file)?;
    }
    if !search.names.is_empty() {
        for path in recordings(folder)? {
            search.look_into(&path);
        }
    }
    search.finish(folder)
}

/// A search for the captures that names mean.
struct Search<'a> {
    names: Vec<&'a String>,
    /// For each name whether something was found.
    found: Vec<bool>,
    chosen: BTreeMap<PathBuf, SelectedCaptures>,
    /// Recordings that cannot be read, in words.
    unread: Vec<String>,
    /// Recordings that are not complete and have captures that are meant, in words.
    incomplete: Vec<String>,
}

impl<'a> Search<'a> {
    fn new(names: Vec<&'a String>) -> Self {
        Self {
            found: vec![false; names.len()],
            names,
            chosen: BTreeMap::new(),
            unread: Vec::new(),
            incomplete: Vec::new(),
        }
    }

    /// Takes all captures of a recording that is named by its file.
    ///
    /// # Errors
    /// If it is not complete, cannot be read or has no capture.
    fn take_file(&mut self, file: &str) -> anyhow::Result<()> {
        let path = PathBuf::from(file);
        anyhow::ensure!(
            finished_name(&path).is_none(),
            "{file}: the recording is not complete: complete it with scand recover first"
        );
        let session = open(&path)?;
        anyhow::ensure!(
            !session.captures().is_empty(),
            "{file} has no capture that can be read: scand info {file} lists what it has"
        );
        // A name may mean one of its captures, too.
        take(&mut self.chosen, &path, session, |about, capture| {
            let named = about.is_named(&self.names, capture, &mut self.found);
            Some(named.unwrap_or(false))
        });
        Ok(())
    }

    /// Takes the captures of a recording that the names mean.
    fn look_into(&mut self, path: &Path) {
        let session = match open(path) {
            Ok(session) => session,
            Err(error) => {
                self.unread.push(format!(
                    "a recording was skipped, because it cannot be read: {error}"
                ));
                return;
            }
        };
        if finished_name(path).is_some() {
            self.note_incomplete(path, &session);
            return;
        }
        take(&mut self.chosen, path, session, |about, capture| {
            about.is_named(&self.names, capture, &mut self.found)
        });
    }

    /// Notes a recording that is not complete, if it has captures that the names mean.
    fn note_incomplete(&mut self, path: &Path, session: &CaptureSession) {
        let about = About::of(path, session);
        let mut nowhere = vec![false; self.names.len()];
        let captures = session.captures();
        let named = |c: &&CaptureSummary| about.is_named(&self.names, c, &mut nowhere).is_some();
        let named = captures.iter().filter(named).count();
        if named > 0 {
            self.incomplete.push(format!(
                "{} has {} of them, but is not complete and not in the package: close its session, or complete it \
                 with scand recover",
                path.display(),
                count(named, "capture")
            ));
        }
    }

    /// # Errors
    /// If a name means nothing.
    fn finish(self, folder: &Path) -> anyhow::Result<Selection> {
        let mut unread = self.unread;
        unread.extend(self.incomplete);
        if let Some((word, _)) = self
            .names
            .iter()
            .zip(&self.found)
            .find(|(_, found)| !**found)
        {
            let unread: String = unread.iter().map(|line| format!("\n  {line}")).collect();
            anyhow::bail!(
                "no capture, object or session in the recordings of {} is named {word:?}: give another folder with \
                 --recordings, or a recording's file{unread}",
                folder.display()
            );
        }
        Ok(Selection {
            chosen: self.chosen.into_values().collect(),
            unread,
        })
    }
}

/// The names by which a recording can be meant.
struct About {
    stem: String,
    session: Option<String>,
}

impl About {
    fn of(path: &Path, session: &CaptureSession) -> Self {
        let complete = finished_name(path).unwrap_or_else(|| path.to_owned());
        let stem = complete.file_stem().unwrap_or_default().to_string_lossy();
        Self {
            stem: stem.into_owned(),
            session: session.recording().session_pair("name").map(str::to_owned),
        }
    }

    /// `None` if no name means a capture; else whether its own id does. Enters the names that mean it as found.
    fn is_named(
        &self,
        names: &[&String],
        capture: &CaptureSummary,
        found: &mut [bool],
    ) -> Option<bool> {
        let mut is_named = None;
        for (word, found) in names.iter().zip(found) {
            let by_id = capture.id.as_str() == *word;
            let by_object = capture.subject.as_ref() == Some(*word);
            let by_session = self.session.as_ref() == Some(*word) || self.stem == word.as_str();
            if by_id || by_object || by_session {
                *found = true;
                is_named = Some(is_named.unwrap_or(false) || by_id);
            }
        }
        is_named
    }
}

/// Adds the captures of a recording that are wanted: `Some(true)` for one that is named by its id.
fn take(
    chosen: &mut BTreeMap<PathBuf, SelectedCaptures>,
    path: &Path,
    session: CaptureSession,
    mut wanted: impl FnMut(&About, &CaptureSummary) -> Option<bool>,
) {
    let about = About::of(path, &session);
    let captures = session.captures().into_iter();
    let captures: Vec<ChosenCapture> = captures
        .filter_map(|summary| {
            let is_named = wanted(&about, &summary)?;
            Some(ChosenCapture { summary, is_named })
        })
        .collect();
    let key = path.canonicalize().unwrap_or_else(|_| path.to_owned());
    if !captures.is_empty() && !chosen.contains_key(&key) {
        let path = path.to_owned();
        chosen.insert(
            key,
            SelectedCaptures {
                path,
                session,
                captures,
            },
        );
    }
}

fn open(path: &Path) -> anyhow::Result<CaptureSession> {
    Ok(CaptureSession::of_any(
        Recording::open(path)?,
        &sync::Parameters::default(),
    )?)
}

/// The recordings in a folder, complete or not, in the order of their names.
fn recordings(folder: &Path) -> anyhow::Result<Vec<PathBuf>> {
    let at = |error: std::io::Error| anyhow::anyhow!("{}: {error}", folder.display());
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(at)? {
        let path = entry.map_err(at)?.path();
        let is_recording = path.extension().is_some_and(|ending| ending == "mcap");
        if (is_recording || finished_name(&path).is_some()) && path.is_file() {
            found.push(path);
        }
    }
    found.sort();
    Ok(found)
}
