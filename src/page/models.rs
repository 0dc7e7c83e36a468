//! The folder of models: lists what is there and opens the files of a model, and nothing else. A name from outside must
//! be one of a recording or a capture, and the kernel resolves it below the folder, following no link.

use super::summary::{Report, Summary};
use parking_lot::Mutex;
use rustix::fs::{AtFlags, Dir, FileType, Mode, OFlags, ResolveFlags, openat2, statat};
use serde::Serialize;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::Read;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant, UNIX_EPOCH};

/// Recordings that are listed, the newest ones; and captures of each.
const MOST: usize = 1000;
/// Models of one object that are listed of other recordings, the newest ones.
const MOST_OF_OBJECT: usize = 50;
/// Largest report that is read, in bytes.
const LARGEST_REPORT: u64 = 2 << 20;
/// Bytes of what was read from reports that are kept.
const MOST_KEPT: usize = 32 << 20;

/// A file of a model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ModelFile {
    Preview,
    Glb,
    Ply,
    Report,
}

impl ModelFile {
    /// The file of this name.
    pub(super) fn named(name: &str) -> Option<Self> {
        [Self::Preview, Self::Glb, Self::Ply, Self::Report]
            .into_iter()
            .find(|file| file.name() == name)
    }

    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Preview => "preview.png",
            Self::Glb => "model.glb",
            Self::Ply => "model.ply",
            Self::Report => "report.json",
        }
    }

    pub(super) fn media_type(self) -> &'static str {
        match self {
            Self::Preview => "image/png",
            Self::Glb => "model/gltf-binary",
            Self::Ply => "application/octet-stream",
            Self::Report => "application/json",
        }
    }

    /// Whether it becomes notably smaller when it is compressed.
    pub(super) fn is_compressible(self) -> bool {
        self != Self::Preview
    }
}

/// A recording whose captures have models.
#[derive(Clone, Debug, Serialize)]
pub(super) struct RecordingFolder {
    pub(super) name: String,
    /// When it changed last, in seconds since 1970.
    pub(super) changed_s: u64,
}

/// The newest of what a folder has, and how many there are of it.
#[derive(Clone, Debug)]
pub(super) struct Listing<T> {
    pub(super) newest: Vec<T>,
    pub(super) all: usize,
}

/// Models of one object.
#[derive(Clone, Debug)]
pub(super) struct ModelsOfObject {
    pub(super) newest: Vec<Summary>,
    /// Whether every recording was looked at that is listed.
    pub(super) is_whole: bool,
}

/// What tells one state of a file from another: when it was changed (seconds and nanoseconds), its size and its inode.
type FileState = (i64, i64, u64, u64);

/// What was read from reports, by recording and capture: a page that shows a recording asks for all of its captures at
/// each event.
#[derive(Debug, Default)]
struct ReadReports {
    summaries: BTreeMap<[String; 2], (FileState, Summary)>,
    bytes: usize,
}

impl ReadReports {
    fn get(&self, names: &[String; 2], state: FileState) -> Option<Summary> {
        let (known, summary) = self.summaries.get(names)?;
        (*known == state).then(|| summary.clone())
    }

    fn keep(&mut self, names: [String; 2], state: FileState, summary: Summary) {
        let bytes = serde_json::to_vec(&summary).map_or(0, |text| text.len());
        if self.bytes + bytes > MOST_KEPT {
            *self = Self::default();
        }
        self.bytes += bytes;
        self.summaries.insert(names, (state, summary));
    }
}

/// Whether this can be the name of a recording or of a capture: letters, digits, `.`, `_` and `-`, no dot in front.
pub(super) fn is_name(name: &str) -> bool {
    let is_fine = |b: u8| b.is_ascii_alphanumeric() || b"._-".contains(&b);
    (1..=80).contains(&name.len()) && !name.starts_with('.') && name.bytes().all(is_fine)
}

/// Whether this can be the name of a model's folder: that of a capture, or of an object, where other characters of
/// its number are %XX ([`crate::make_model::object_folder_name`]).
fn is_model_name(name: &str) -> bool {
    let is_fine = |b: u8| b.is_ascii_alphanumeric() || b"._%-".contains(&b);
    (1..=200).contains(&name.len()) && !name.starts_with('.') && name.bytes().all(is_fine)
}

/// The folder of models.
#[derive(Clone, Debug)]
pub(super) struct Models {
    folder: PathBuf,
    read: Arc<Mutex<ReadReports>>,
}

impl Models {
    pub(super) fn new(folder: &Path) -> Self {
        Self {
            folder: folder.into(),
            read: Arc::default(),
        }
    }

    /// The recordings that have models, the newest first.
    pub(super) fn recordings(&self) -> Listing<RecordingFolder> {
        let found = File::open(&self.folder).map(|folder| folders(&folder, is_name));
        let found = found.unwrap_or_default().into_iter();
        let mut newest: Vec<_> = found
            .map(|(name, changed_s)| RecordingFolder { name, changed_s })
            .collect();
        newest.sort_by(|a, b| (b.changed_s, &b.name).cmp(&(a.changed_s, &a.name)));
        let all = newest.len();
        newest.truncate(MOST);
        Listing { newest, all }
    }

    /// The captures of a recording, the newest first; `None` if no recording has this name.
    pub(super) fn captures(&self, recording: &str) -> Option<Listing<Summary>> {
        let found = folders(&self.open_recording(recording)?, is_model_name).into_iter();
        let mut names: Vec<_> = found.map(|(name, _)| name).collect();
        names.sort_by(|a, b| b.cmp(a));
        let all = names.len();
        names.truncate(MOST);
        let newest = names.iter().map(|name| self.summary(recording, name));
        Some(Listing {
            newest: newest.collect(),
            all,
        })
    }

    /// Models of the object that a capture shows, of other recordings, the newest recording first. They are looked for
    /// `at_most` so long: what was read by then is kept, so that the next search comes further.
    pub(super) fn of_same_object(
        &self,
        recording: &str,
        capture: &str,
        at_most: Duration,
    ) -> ModelsOfObject {
        let begun = Instant::now();
        let mut found = ModelsOfObject {
            newest: Vec::new(),
            is_whole: true,
        };
        let Some(subject) = self.reported(recording, capture).subject else {
            return found;
        };
        let others = self.recordings().newest.into_iter();
        for other in others.filter(|other| other.name != recording) {
            let folder = self.open_recording(&other.name);
            let names = folder
                .map(|folder| folders(&folder, is_model_name))
                .unwrap_or_default();
            let mut names: Vec<_> = names.into_iter().map(|(name, _)| name).collect();
            names.sort_by(|a, b| b.cmp(a));
            for name in names.into_iter().take(MOST) {
                if begun.elapsed() > at_most || found.newest.len() >= MOST_OF_OBJECT {
                    found.is_whole = false;
                    return found;
                }
                if self.reported(&other.name, &name).subject.as_ref() != Some(&subject) {
                    continue;
                }
                let summary = self.summary(&other.name, &name);
                if summary.has_model {
                    found.newest.push(summary);
                }
            }
        }
        found
    }

    /// Whether there is a report of a capture, so that the list of its recording has it.
    pub(super) fn has_report(&self, recording: &str, capture: &str) -> bool {
        self.open(recording, capture, ModelFile::Report).is_some()
    }

    /// How sharp each camera's picture was in the newest capture with a green model, in percent; empty if none is among
    /// the newest 50 models of the three newest recordings.
    pub(super) fn good_sharpness(&self) -> BTreeMap<String, u32> {
        const RECORDINGS: usize = 3;
        const CAPTURES: usize = 50;
        for recording in self.recordings().newest.into_iter().take(RECORDINGS) {
            let folder = self.open_recording(&recording.name);
            let mut names = folder
                .map(|folder| folders(&folder, is_model_name))
                .unwrap_or_default();
            names.sort_by(|a, b| (b.1, &b.0).cmp(&(a.1, &a.0)));
            for (name, _) in names.into_iter().take(CAPTURES) {
                // An object's model has cameras of several captures.
                let of_capture = !name.ends_with(".object");
                let report = of_capture
                    .then(|| self.report(&recording.name, &name))
                    .flatten();
                if let Some(found) = report.and_then(|report| report.sharpness_of_green()) {
                    return found;
                }
            }
        }
        BTreeMap::new()
    }

    fn summary(&self, recording: &str, capture: &str) -> Summary {
        let model = self.open(recording, capture, ModelFile::Glb);
        let preview = self.open(recording, capture, ModelFile::Preview);
        Summary {
            has_preview: preview.is_some(),
            has_model: model.is_some(),
            model_tag: model.map(|(_, _, tag)| tag),
            ..self.reported(recording, capture)
        }
    }

    /// What a capture's report says; it is read once, as long as it does not change.
    fn reported(&self, recording: &str, capture: &str) -> Summary {
        let mut summary = Summary {
            capture: capture.into(),
            recording: recording.into(),
            verdict: "unread".into(),
            ..Summary::default()
        };
        let opened = self.open(recording, capture, ModelFile::Report);
        let Some((file, size, _)) = opened else {
            return summary;
        };
        let Ok(found) = file.metadata() else {
            return summary;
        };
        let state = (found.mtime(), found.mtime_nsec(), size, found.ino());
        let names = [recording, capture].map(str::to_owned);
        if let Some(known) = self.read.lock().get(&names, state) {
            return known;
        }
        if let Some(report) = read_report(file, size) {
            summary.add(report);
        }
        self.read.lock().keep(names, state, summary.clone());
        summary
    }

    fn report(&self, recording: &str, capture: &str) -> Option<Report> {
        let (file, size, _) = self.open(recording, capture, ModelFile::Report)?;
        read_report(file, size)
    }

    /// The folder of a recording's models, if it is one and no link.
    fn open_recording(&self, recording: &str) -> Option<File> {
        is_name(recording)
            .then(|| self.open_below(recording, OFlags::DIRECTORY))
            .flatten()
    }

    /// A file of a model, its size in bytes, and a tag that changes with it.
    pub(super) fn open(
        &self,
        recording: &str,
        capture: &str,
        file: ModelFile,
    ) -> Option<(File, u64, String)> {
        if !is_name(recording) || !is_model_name(capture) {
            return None;
        }
        let path = format!("{recording}/{capture}/{}", file.name());
        // A pipe in the place of a file keeps nobody waiting.
        let opened = self.open_below(&path, OFlags::NONBLOCK)?;
        let found = opened.metadata().ok()?;
        let changed = found.modified().ok()?.duration_since(UNIX_EPOCH).ok()?;
        let tag = format!("\"{:x}-{:x}\"", changed.as_nanos(), found.len());
        found.is_file().then_some((opened, found.len(), tag))
    }

    fn open_below(&self, path: &str, flags: OFlags) -> Option<File> {
        open_below(&self.folder, path, flags)
    }
}

/// Opens for reading what lies below a folder, through no link.
pub(super) fn open_below(folder: &Path, path: &str, flags: OFlags) -> Option<File> {
    let folder = File::open(folder).ok()?;
    let within = ResolveFlags::BENEATH | ResolveFlags::NO_SYMLINKS | ResolveFlags::NO_MAGICLINKS;
    let flags = OFlags::RDONLY | OFlags::CLOEXEC | flags;
    let opened = openat2(&folder, path, flags, Mode::empty(), within);
    opened.ok().map(File::from)
}

/// What an open report says, if it is one and not too large.
fn read_report(file: File, size: u64) -> Option<Report> {
    if size > LARGEST_REPORT {
        return None;
    }
    let mut text = Vec::new();
    file.take(LARGEST_REPORT).read_to_end(&mut text).ok()?;
    serde_json::from_slice(&text).ok()
}

/// The folders in an open folder whose names are fine, and when they changed, in seconds since 1970; not what a link
/// leads to.
fn folders(folder: &File, is_fine: impl Fn(&str) -> bool) -> Vec<(String, u64)> {
    let entries = Dir::read_from(folder).into_iter().flatten().flatten();
    let entries = entries.take(100 * MOST).filter_map(|entry| {
        let name = entry.file_name().to_str().ok()?;
        let found = statat(folder, entry.file_name(), AtFlags::SYMLINK_NOFOLLOW).ok()?;
        let is_folder = FileType::from_raw_mode(found.st_mode) == FileType::Directory;
        let changed_s = u64::try_from(found.st_mtime).ok()?;
        (is_folder && is_fine(name)).then(|| (name.to_owned(), changed_s))
    });
    entries.collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::page::summary::LONGEST_TEXT;

    fn models() -> (tempfile::TempDir, Models) {
        let root = tempfile::tempdir().unwrap();
        let folder = root.path().join("models/amphora/amphora-0001");
        std::fs::create_dir_all(&folder).unwrap();
        let report = r#"{"version":1,"outcome":"done","verdict":{"level":"amber","reasons":[{"level":"amber",
            "code":"frame_cut","cameras":["c03"],"words":"<b>cut</b>"}]},"capture":{"id":"amphora-0001",
            "time_ns":"1767225605000000000","subject":"1884.3"},"notes":{"decision":"rejected","said":[
            {"time_ns":"1","kind":"reject","text":"a hand"}]}}"#;
        std::fs::write(folder.join("report.json"), report).unwrap();
        std::fs::write(folder.join("model.glb"), "glTF").unwrap();
        std::fs::write(root.path().join("secret"), "secret").unwrap();
        let models = Models::new(&root.path().join("models"));
        (root, models)
    }

    /// The newest capture of the recording that is there.
    fn first(models: &Models) -> Summary {
        models.captures("amphora").unwrap().newest.remove(0)
    }

    #[test]
    fn the_last_good_sharpness_is_that_of_the_newest_green_model() {
        let (root, models) = models();
        assert!(models.good_sharpness().is_empty());
        let write = |name: &str, level: &str, sharpness: u32| {
            let folder = root.path().join("models/amphora").join(name);
            std::fs::create_dir_all(&folder).unwrap();
            let report = format!(
                r#"{{"verdict":{{"level":"{level}"}},"color_cameras":[{{"camera":"c00","sharpness_percent":{sharpness}}},
                {{"camera":"c01","sharpness_percent":null}}]}}"#
            );
            std::fs::write(folder.join("report.json"), report).unwrap();
        };
        write("amphora-0002", "green", 61);
        write("amphora-0003", "amber", 20);
        write("amphora.object", "green", 10);
        let good = models.good_sharpness();
        assert_eq!(
            good.into_iter().collect::<Vec<_>>(),
            [("c00".to_owned(), 61)]
        );
    }

    #[test]
    fn a_report_is_summed_up() {
        let (_root, models) = models();
        assert_eq!(models.recordings().newest[0].name, "amphora");
        let found = &models.captures("amphora").unwrap().newest[0];
        assert_eq!(
            (found.verdict.as_str(), found.time_s),
            ("amber", Some(1_767_225_605))
        );
        assert_eq!(found.reasons[0].words, "<b>cut</b>");
        assert_eq!(found.subject.as_deref(), Some("1884.3"));
        assert_eq!(found.decision.as_deref(), Some("rejected"));
        assert_eq!(found.notes[0].text, "a hand");
        assert!(found.has_model && !found.has_preview);
        assert!(models.has_report("amphora", "amphora-0001"));
        assert!(!models.has_report("amphora", "amphora-0002"));
    }

    #[test]
    fn an_object_is_listed_and_opened_whatever_characters_its_number_has() {
        let (root, models) = models();
        let name = crate::make_model::object_folder_name("Inv. 12/ä");
        let folder = root.path().join("models/amphora").join(&name);
        std::fs::create_dir_all(&folder).unwrap();
        std::fs::write(folder.join("model.glb"), "glTF").unwrap();
        let listed = models.captures("amphora").unwrap().newest;
        assert!(
            listed
                .iter()
                .any(|found| found.capture == name && found.has_model)
        );
        assert!(models.open("amphora", &name, ModelFile::Glb).is_some());
        for hostile in ["..", "a%2fb/c", "a b", "%00\0", ""] {
            assert!(
                models.open("amphora", hostile, ModelFile::Glb).is_none(),
                "{hostile:?}"
            );
        }
    }

    #[test]
    fn a_recording_that_is_not_there_has_no_list_and_one_behind_a_link_has_none() {
        let (root, models) = models();
        assert!(models.captures("bowl").is_none());
        std::fs::create_dir(root.path().join("models/bowl")).unwrap();
        assert!(models.captures("bowl").unwrap().newest.is_empty());
        let elsewhere = root.path().join("elsewhere/secret-0001");
        std::fs::create_dir_all(&elsewhere).unwrap();
        let link = root.path().join("models/jug");
        std::os::unix::fs::symlink(elsewhere.parent().unwrap(), link).unwrap();
        assert!(models.captures("jug").is_none());
    }

    #[test]
    fn a_list_that_is_cut_says_how_many_there_are() {
        let (root, models) = models();
        for n in 0..=MOST {
            let folder = root.path().join(format!("models/many/a-{n:04}"));
            std::fs::create_dir_all(folder).unwrap();
        }
        let found = models.captures("many").unwrap();
        assert_eq!((found.newest.len(), found.all), (MOST, MOST + 1));
        assert_eq!(found.newest[0].capture, format!("a-{MOST:04}"));
    }

    #[test]
    fn a_report_is_read_again_when_it_was_replaced_and_a_model_has_another_tag_then() {
        let (root, models) = models();
        let folder = root.path().join("models/amphora/amphora-0001");
        let before = first(&models);
        assert_eq!(before.verdict, "amber");
        // As the daemon replaces it: the same size and time, another file.
        let report = folder.join("report.json");
        let time = report.metadata().unwrap().modified().unwrap();
        let text = std::fs::read_to_string(&report).unwrap();
        let replace = |text: &str| {
            let new = folder.join("new");
            std::fs::write(&new, text).unwrap();
            let file = File::options().write(true).open(&new).unwrap();
            file.set_modified(time).unwrap();
            std::fs::rename(&new, &report).unwrap();
        };
        replace(&text.replace("\"amber\"", "\"green\""));
        assert_eq!(first(&models).verdict, "green");
        assert_eq!(first(&models).model_tag, before.model_tag);
        std::fs::write(folder.join("model.glb"), "glTF, again").unwrap();
        assert_ne!(first(&models).model_tag, before.model_tag);
    }

    #[test]
    fn models_of_an_object_are_found_in_other_recordings() {
        let (root, models) = models();
        let write = |recording: &str, name: &str, subject: &str, has_model: bool| {
            let folder = root.path().join("models").join(recording).join(name);
            std::fs::create_dir_all(&folder).unwrap();
            let report = format!(
                r#"{{"verdict":{{"level":"green"}},"capture":{{"id":"{name}","subject":"{subject}"}}}}"#
            );
            std::fs::write(folder.join("report.json"), report).unwrap();
            if has_model {
                std::fs::write(folder.join("model.glb"), "glTF").unwrap();
            }
        };
        write("amphora", "amphora-0002", "1884.3", true);
        write("monday", "monday-0001", "1884.3", true);
        write("monday", "monday-0002", "1884.4", true);
        write("monday", "monday-0003", "1884.3", true);
        write("monday", "monday-0004", "1884.3", false);
        let find = |recording: &str, capture: &str, at_most| {
            let found = models.of_same_object(recording, capture, at_most);
            let names = found.newest.into_iter().map(|summary| summary.capture);
            (names.collect::<Vec<_>>(), found.is_whole)
        };
        let long = Duration::from_secs(60);
        let found = find("amphora", "amphora-0001", long);
        let expected = ["monday-0003", "monday-0001"].map(str::to_owned);
        assert_eq!(found, (expected.to_vec(), true));
        let found = find("monday", "monday-0001", long);
        let expected = ["amphora-0002", "amphora-0001"].map(str::to_owned);
        assert_eq!(found, (expected.to_vec(), true));
        let nothing = (Vec::new(), true);
        assert_eq!(find("monday", "monday-0002", long), nothing);
        assert_eq!(find("monday", "../amphora", long), nothing);
        let (_, is_whole) = find("amphora", "amphora-0001", Duration::ZERO);
        assert!(!is_whole);
    }

    #[test]
    fn what_is_kept_of_reports_is_bounded() {
        let mut kept = ReadReports::default();
        let state = (0, 0, 0, 0);
        let summary = Summary {
            subject: Some("x".repeat(MOST_KEPT / 4)),
            ..Summary::default()
        };
        for n in 0..10 {
            let names = ["a".to_owned(), n.to_string()];
            kept.keep(names.clone(), state, summary.clone());
            assert!(kept.get(&names, state).is_some());
            assert!(kept.get(&names, (1, 0, 0, 0)).is_none());
            assert!(kept.summaries.len() <= 4 && kept.bytes <= MOST_KEPT);
        }
    }

    #[test]
    fn a_report_that_cannot_be_read_or_is_huge_is_said_so() {
        let (root, models) = models();
        let path = root.path().join("models/amphora/amphora-0001/report.json");
        for text in [
            "",
            "{",
            "[]",
            r#"{"verdict":{"level":"<script>","reasons":[]}}"#,
        ] {
            std::fs::write(&path, text).unwrap();
            assert_eq!(first(&models).verdict, "unread", "{text}");
        }
        let huge = format!("{{\"reason\":\"{}\"}}", "x".repeat(3 << 20));
        std::fs::write(&path, huge).unwrap();
        assert_eq!(first(&models).verdict, "unread");
        let long = format!("{{\"reason\":\"{}\"}}", "ä".repeat(10_000));
        std::fs::write(&path, long).unwrap();
        let found = first(&models);
        assert_eq!(
            (
                found.verdict.as_str(),
                found.reasons[0].words.chars().count()
            ),
            ("failed", LONGEST_TEXT)
        );
    }

    #[test]
    fn no_name_and_no_link_leads_out() {
        let (root, models) = models();
        assert!(
            models
                .open("amphora", "amphora-0001", ModelFile::Glb)
                .is_some()
        );
        for name in [
            "..",
            ".",
            "",
            "a/b",
            "../amphora",
            "a\0",
            "ä",
            "/etc",
            "a b",
            &"a".repeat(81),
        ] {
            assert!(models.captures(name).is_none(), "{name:?}");
            assert!(models.open(name, "amphora-0001", ModelFile::Glb).is_none());
            assert!(models.open("amphora", name, ModelFile::Glb).is_none());
        }
        let capture = root.path().join("models/amphora/amphora-0001");
        std::os::unix::fs::symlink(root.path().join("secret"), capture.join("model.ply")).unwrap();
        assert!(
            models
                .open("amphora", "amphora-0001", ModelFile::Ply)
                .is_none()
        );
        std::os::unix::fs::symlink(root.path(), root.path().join("models/link")).unwrap();
        assert!(
            models
                .open("link", "amphora-0001", ModelFile::Glb)
                .is_none()
        );
        assert_eq!(models.recordings().all, 1);
        assert!(models.captures("link").is_none());
        std::fs::create_dir(capture.join("preview.png")).unwrap();
        assert!(
            models
                .open("amphora", "amphora-0001", ModelFile::Preview)
                .is_none()
        );
    }
}
