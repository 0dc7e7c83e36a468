//! The folder of models: lists what is there and opens the files of a model, and nothing else. A name from outside must
//! be one of a recording or a capture, and the kernel resolves it below the folder, following no link.

use super::summary::{Report, Summary};
use rustix::fs::{Mode, OFlags, ResolveFlags, openat2};
use serde::Serialize;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::time::UNIX_EPOCH;

/// Recordings that are listed, the newest ones; and captures of each.
const MOST: usize = 1000;
/// Largest report that is read, in bytes.
const LARGEST_REPORT: u64 = 2 << 20;

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

/// Whether this can be the name of a recording or of a capture: letters, digits, `.`, `_` and `-`, no dot in front.
pub(super) fn is_name(name: &str) -> bool {
    let is_fine = |b: u8| b.is_ascii_alphanumeric() || b"._-".contains(&b);
    (1..=80).contains(&name.len()) && !name.starts_with('.') && name.bytes().all(is_fine)
}

/// The folder of models.
#[derive(Clone, Debug)]
pub(super) struct Models {
    folder: PathBuf,
}

impl Models {
    pub(super) fn new(folder: &Path) -> Self {
        Self {
            folder: folder.into(),
        }
    }

    /// The recordings that have models, the newest first.
    pub(super) fn recordings(&self) -> Vec<RecordingFolder> {
        let mut found: Vec<_> = folders(&self.folder)
            .map(|(name, changed_s)| RecordingFolder { name, changed_s })
            .collect();
        found.sort_by(|a, b| (b.changed_s, &b.name).cmp(&(a.changed_s, &a.name)));
        found.truncate(MOST);
        found
    }

    /// The captures of a recording, the newest first; `None` if no recording has this name.
    pub(super) fn captures(&self, recording: &str) -> Option<Vec<Summary>> {
        if !is_name(recording) {
            return None;
        }
        let mut names: Vec<_> = folders(&self.folder.join(recording))
            .map(|(name, _)| name)
            .collect();
        names.sort_by(|a, b| b.cmp(a));
        names.truncate(MOST);
        let summaries = names.iter().map(|name| self.summary(recording, name));
        Some(summaries.collect())
    }

    /// How sharp each camera's picture was in the newest capture with a green model, in percent; empty if none is among
    /// the newest 50 models of the three newest recordings.
    pub(super) fn good_sharpness(&self) -> BTreeMap<String, u32> {
        const RECORDINGS: usize = 3;
        const CAPTURES: usize = 50;
        for recording in self.recordings().into_iter().take(RECORDINGS) {
            let mut names: Vec<_> = folders(&self.folder.join(&recording.name)).collect();
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
        let has = |file| self.open(recording, capture, file).is_some();
        let mut summary = Summary {
            capture: capture.into(),
            recording: recording.into(),
            verdict: "unread".into(),
            has_preview: has(ModelFile::Preview),
            has_model: has(ModelFile::Glb),
            ..Summary::default()
        };
        if let Some(report) = self.report(recording, capture) {
            summary.add(report);
        }
        summary
    }

    fn report(&self, recording: &str, capture: &str) -> Option<Report> {
        let (file, size, _) = self.open(recording, capture, ModelFile::Report)?;
        if size > LARGEST_REPORT {
            return None;
        }
        let mut text = Vec::new();
        file.take(LARGEST_REPORT).read_to_end(&mut text).ok()?;
        serde_json::from_slice(&text).ok()
    }

    /// A file of a model, its size in bytes, and a tag that changes with it.
    pub(super) fn open(
        &self,
        recording: &str,
        capture: &str,
        file: ModelFile,
    ) -> Option<(File, u64, String)> {
        if !is_name(recording) || !is_name(capture) {
            return None;
        }
        let folder = File::open(&self.folder).ok()?;
        let path = format!("{recording}/{capture}/{}", file.name());
        let within =
            ResolveFlags::BENEATH | ResolveFlags::NO_SYMLINKS | ResolveFlags::NO_MAGICLINKS;
        // A pipe in the place of a file keeps nobody waiting.
        let flags = OFlags::RDONLY | OFlags::CLOEXEC | OFlags::NONBLOCK;
        let opened = openat2(&folder, path, flags, Mode::empty(), within).ok()?;
        let opened = File::from(opened);
        let found = opened.metadata().ok()?;
        let changed = found.modified().ok()?.duration_since(UNIX_EPOCH).ok()?;
        let tag = format!("\"{:x}-{:x}\"", changed.as_nanos(), found.len());
        found.is_file().then_some((opened, found.len(), tag))
    }
}

/// The folders in a folder, by name, and when they changed.
fn folders(folder: &Path) -> impl Iterator<Item = (String, u64)> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    entries.take(100 * MOST).filter_map(|entry| {
        let name = entry.file_name().into_string().ok()?;
        // Not of what a link leads to.
        let found = entry.metadata().ok()?;
        let changed = found.modified().ok()?.duration_since(UNIX_EPOCH).ok()?;
        (found.is_dir() && is_name(&name)).then_some((name, changed.as_secs()))
    })
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
        assert_eq!(models.recordings()[0].name, "amphora");
        let found = &models.captures("amphora").unwrap()[0];
        assert_eq!(
            (found.verdict.as_str(), found.time_s),
            ("amber", Some(1_767_225_605))
        );
        assert_eq!(found.reasons[0].words, "<b>cut</b>");
        assert_eq!(found.subject.as_deref(), Some("1884.3"));
        assert_eq!(found.decision.as_deref(), Some("rejected"));
        assert_eq!(found.notes[0].text, "a hand");
        assert!(found.has_model && !found.has_preview);
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
            assert_eq!(
                models.captures("amphora").unwrap()[0].verdict,
                "unread",
                "{text}"
            );
        }
        let huge = format!("{{\"reason\":\"{}\"}}", "x".repeat(3 << 20));
        std::fs::write(&path, huge).unwrap();
        assert_eq!(models.captures("amphora").unwrap()[0].verdict, "unread");
        let long = format!("{{\"reason\":\"{}\"}}", "ä".repeat(10_000));
        std::fs::write(&path, long).unwrap();
        let found = models.captures("amphora").unwrap().remove(0);
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
        assert_eq!(models.recordings().len(), 1);
        std::fs::create_dir(capture.join("preview.png")).unwrap();
        assert!(
            models
                .open("amphora", "amphora-0001", ModelFile::Preview)
                .is_none()
        );
    }
}
