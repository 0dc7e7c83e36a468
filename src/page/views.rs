//! Small forms for browsers: a model in whole numbers and compressed, a thumbnail of its preview, how far it is from
//! another model, and a capture's photographs out of its recording. A confined process makes each once
//! (`scand make-view`, which has no file but its input and its output), and it lies in a cache of a bounded size, which
//! may be removed at any time. This process decodes nothing.

use super::models::{ModelFile, Models, is_name};
use super::recordings::{OpenRecording, Recordings, is_complete};
use crate::clock::Clock;
use crate::log;
use crate::process::{Cancel, Child, ChildExit, last_line};
use parking_lot::Mutex;
use sha2::{Digest, Sha256};
use std::collections::VecDeque;
use std::ffi::OsString;
use std::fs::File;
use std::io::{self, Read, Seek, Write};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant, SystemTime};

/// The command that makes a view of what it reads, and its options.
pub const COMMAND: &str = "make-view";
/// The option for the id of the process that started it.
pub const PARENT: &str = "parent";
/// The option for the view that is wanted.
pub const FORM: &str = "form";
/// The form that tells how far two models are apart.
pub const DIFFERENCE: &str = "difference";
/// The form that has a capture's photographs, or only that of one camera.
pub const PHOTOGRAPHS: &str = "photographs";
/// What that form is where there are none.
pub(super) const NO_PHOTOGRAPHS: &str = "[]\n";
/// The option for the name of the recording's file.
pub const RECORDING: &str = "recording";
/// The option for the capture.
pub const CAPTURE: &str = "capture";
/// The option for the camera.
pub const CAMERA: &str = "camera";

/// Largest file of which a view is made, in bytes.
pub const LARGEST_SOURCE: u64 = 64 << 20;
/// How long the making may take.
const PATIENCE: Duration = Duration::from_secs(30);
/// Bytes and files of the cache.
const MOST_BYTES: u64 = 512 << 20;
const MOST_FILES: usize = 4000;
/// Views that could not be made, and how long each is not tried again: what hindered may have been a moment's.
const MOST_FAILED: usize = 1000;
const AGAIN: Duration = Duration::from_secs(600);
/// How old the mark of the last use may be.
const USED: Duration = Duration::from_secs(3600);
/// Part of each name in the cache: views of other versions of scand are not used.
const VERSION: &str = env!("CARGO_PKG_VERSION");

/// A form of a model's file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum View {
    /// `model.glb` in whole numbers, compressed with gzip.
    Model,
    /// `preview.png` as a small JPEG.
    Thumbnail,
}

impl View {
    /// The view of this name in an address.
    pub(super) fn named(name: &str) -> Option<Self> {
        match name {
            "view.glb" => Some(Self::Model),
            "thumbnail.jpg" => Some(Self::Thumbnail),
            _ => None,
        }
    }

    /// The view of this name in the arguments of [`COMMAND`].
    pub fn of_form(form: &str) -> Option<Self> {
        [Self::Model, Self::Thumbnail]
            .into_iter()
            .find(|view| view.form() == form)
    }

    /// Its name in the arguments of [`COMMAND`].
    pub fn form(self) -> &'static str {
        match self {
            Self::Model => "model",
            Self::Thumbnail => "thumbnail",
        }
    }

    /// What it is made of, which serves as well where it cannot be made.
    pub(super) fn source(self) -> ModelFile {
        match self {
            Self::Model => ModelFile::Glb,
            Self::Thumbnail => ModelFile::Preview,
        }
    }

    pub(super) fn media_type(self) -> &'static str {
        match self {
            Self::Model => "model/gltf-binary",
            Self::Thumbnail => "image/jpeg",
        }
    }
}

/// A view that is open, its size in bytes, and a tag that changes with it.
pub(super) type OpenView = (File, u64, String);

/// Why there is no view.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Missing {
    /// What it would be made of is not there.
    Source,
    /// It could not be made; the log says why, unless what it is made of is too large.
    Unmade,
}

/// The views that were made, and how others are made.
pub(super) struct Views {
    folder: PathBuf,
    /// The program that has [`COMMAND`].
    program: PathBuf,
    /// Where photographs come from.
    recordings: Recordings,
    /// Held while a view is made: one at a time, for a press comes first.
    failed: Mutex<VecDeque<(String, Instant)>>,
    again: Duration,
    /// What such a process said last although it did its work.
    warned: Mutex<String>,
    cancel: Cancel,
}

impl Views {
    /// Views in the cache of this folder, which is made if it is not there.
    ///
    /// # Errors
    /// If the folder cannot be made.
    pub(super) fn open(folder: &Path, program: &Path, recordings: Recordings) -> io::Result<Self> {
        std::fs::create_dir_all(folder)?;
        for (path, ..) in files(folder).filter(|(path, ..)| is_part(path)) {
            let _ = std::fs::remove_file(path);
        }
        Ok(Self {
            folder: folder.into(),
            program: program.into(),
            recordings,
            failed: Mutex::default(),
            again: AGAIN,
            warned: Mutex::default(),
            cancel: Cancel::new()?,
        })
    }

    /// Ends the process that makes a view, if there is one, and any that begins later.
    pub(super) fn end(&self) {
        self.cancel.cancel();
    }

    /// A view of a capture's model. It is made if it is not there yet, which takes some tenths of a second.
    ///
    /// # Errors
    /// If there is no such model, or the view cannot be made.
    pub(super) fn get(
        &self,
        models: &Models,
        recording: &str,
        capture: &str,
        view: View,
    ) -> Result<OpenView, Missing> {
        let source = models.open(recording, capture, view.source());
        let (source, size, tag) = source.ok_or(Missing::Source)?;
        let of = format!("{recording}/{capture}");
        let text = format!("{VERSION} {recording} {capture} {} {tag}", view.form());
        self.obtain(&text, &of, &[view.form()], size, || Ok(source))
    }

    /// How far the surfaces of two models are apart, each given by its recording and its name, as [`Self::get`] gives a
    /// view.
    ///
    /// # Errors
    /// As [`Self::get`].
    pub(super) fn difference(
        &self,
        models: &Models,
        [a, b]: [[&str; 2]; 2],
    ) -> Result<OpenView, Missing> {
        let open = |[recording, name]: [&str; 2]| {
            let opened = models.open(recording, name, ModelFile::Glb);
            opened.ok_or(Missing::Source)
        };
        let (of_a, size_a, tag_a) = open(a)?;
        let (of_b, size_b, tag_b) = open(b)?;
        let (a, b) = (a.join("/"), b.join("/"));
        let of = format!("{a} and {b}");
        let text = format!("{VERSION} {a} {b} {DIFFERENCE} {tag_a} {tag_b}");
        let size = size_a.saturating_add(size_b);
        self.obtain(&text, &of, &[DIFFERENCE], size, || {
            self.both([(of_a, size_a), (of_b, size_b)])
        })
    }

    /// The photographs of a capture, or that of one camera, as [`Self::get`] gives a view.
    ///
    /// # Errors
    /// If there is no such recording, or the photographs cannot be had from it.
    pub(super) fn photographs(
        &self,
        recording: &str,
        capture: &str,
        camera: Option<&str>,
    ) -> Result<OpenView, Missing> {
        let are_names = is_name(capture) && camera.is_none_or(is_name);
        if !are_names {
            return Err(Missing::Source);
        }
        let recorded = self.recordings.open(recording);
        let OpenRecording { file, name, tag } = recorded.ok_or(Missing::Source)?;
        let of = format!("{recording}/{capture}");
        let one = camera.unwrap_or("*");
        let text = format!("{VERSION} {recording} {capture} {one} {PHOTOGRAPHS} {tag}");
        let mut options = vec![
            PHOTOGRAPHS.to_owned(),
            format!("--{RECORDING}={name}"),
            format!("--{CAPTURE}={capture}"),
        ];
        options.extend(camera.map(|camera| format!("--{CAMERA}={camera}")));
        let options: Vec<&str> = options.iter().map(String::as_str).collect();
        // However large the recording is, little of it is read.
        let view = self.obtain(&text, &of, &options, 0, || Ok(file))?;
        let is_empty = camera.is_none() && view.1 == NO_PHOTOGRAPHS.len() as u64;
        if is_empty && !is_complete(&name) {
            // The capture may be taken yet. What is open can be read all the same.
            let _ = std::fs::remove_file(self.folder.join(key_of(&text)));
        }
        Ok(view)
    }

    /// One file with two models: how many bytes the first has, it, and the second.
    fn both(&self, [(mut a, size_a), (mut b, _)]: [(File, u64); 2]) -> io::Result<File> {
        let path = self.folder.join("both.part");
        let mut options = File::options();
        let mut both = options
            .read(true)
            .write(true)
            .create(true)
            .truncate(true)
            .open(&path)?;
        // It has no name while it is used, so that nothing is left of it.
        std::fs::remove_file(&path)?;
        both.write_all(&size_a.to_le_bytes())?;
        for model in [&mut a, &mut b] {
            io::copy(&mut model.take(LARGEST_SOURCE), &mut both)?;
        }
        both.rewind()?;
        Ok(both)
    }

    /// What is in the cache under a text, which is made of a source if it is not there yet. `form` is the form's name
    /// and its options.
    fn obtain(
        &self,
        text: &str,
        of: &str,
        form: &[&str],
        size: u64,
        source: impl FnOnce() -> io::Result<File>,
    ) -> Result<OpenView, Missing> {
        let key = key_of(text);
        let made = self.made(&key).or_else(|| {
            if size > LARGEST_SOURCE {
                return None;
            }
            let mut failed = self.failed.lock();
            // Another request may have had it made meanwhile.
            if let Some(made) = self.made(&key) {
                return Some(made);
            }
            failed.retain(|(_, at)| at.elapsed() < self.again);
            if failed.iter().any(|(known, _)| *known == key) {
                return None;
            }
            let source = source().map_err(|error| error.to_string());
            let made = source.and_then(|source| self.make(source, &key, form));
            if let Err(words) = made {
                let name = form.first().unwrap_or(&"");
                log::warning!("{of}: cannot make its {name} for browsers: {words}");
                failed.truncate(MOST_FAILED - 1);
                failed.push_front((key.clone(), Instant::now()));
                return None;
            }
            self.made(&key)
        });
        let (file, size) = made.ok_or(Missing::Unmade)?;
        // What was made while a recording grew, and was not kept, has another size.
        let tag = format!("\"{}-{size:x}\"", &key[..32]);
        Ok((file, size, tag))
    }

    fn made(&self, key: &str) -> Option<(File, u64)> {
        let path = self.folder.join(key);
        let file = File::open(path).ok()?;
        let found = file.metadata().ok()?;
        // The oldest by use is removed first.
        let used = found.modified().ok()?.elapsed().unwrap_or_default();
        if used > USED {
            let _ = file.set_modified(SystemTime::now());
        }
        (found.is_file() && found.len() > 0).then_some((file, found.len()))
    }

    fn make(&self, source: File, key: &str, form: &[&str]) -> Result<(), String> {
        let part = self.folder.join(format!("{key}.part"));
        let made = self.fill(source, &part, form);
        let named = made.and_then(|()| {
            std::fs::rename(&part, self.folder.join(key)).map_err(|error| error.to_string())
        });
        if named.is_err() {
            let _ = std::fs::remove_file(&part);
        }
        self.make_room(key);
        named
    }

    fn fill(&self, source: File, part: &Path, form: &[&str]) -> Result<(), String> {
        let said = |error: io::Error| error.to_string();
        let output = File::create(part).map_err(said)?;
        let mut command = Command::new(&self.program);
        command.args(arguments(form));
        let child = Child::start_between(&mut command, source, output).map_err(said)?;
        let ended = child.wait(PATIENCE, Clock::system(), &self.cancel);
        match ended.map_err(said)? {
            (ChildExit::Ended(status), words) if status.success() => {
                self.warn(words);
                match part.metadata() {
                    Ok(made) if (1..=LARGEST_SOURCE).contains(&made.len()) => Ok(()),
                    Ok(made) => Err(format!("it made {} bytes", made.len())),
                    Err(error) => Err(said(error)),
                }
            }
            (ChildExit::Ended(status), words) => Err(format!("{status}: {}", last_line(&words))),
            (ChildExit::TimedOut, _) => Err("it took too long".into()),
            (ChildExit::Cancelled, _) => Err("the page is ending".into()),
        }
    }

    /// Logs what the process said although it made its view, such as that it could not lower its priority, unless that
    /// was logged last.
    fn warn(&self, words: String) {
        let mut warned = self.warned.lock();
        if *warned != words {
            for line in words.lines() {
                log::warning!("the process that makes small forms says: {line}");
            }
            *warned = words;
        }
    }

    /// Removes what was used longest ago, until the rest is within the limits.
    fn make_room(&self, newest: &str) {
        let mut all: Vec<_> = files(&self.folder).collect();
        all.sort_by(|a, b| (b.1, &b.0).cmp(&(a.1, &a.0)));
        let mut bytes = 0;
        for (n, (path, _, size)) in all.into_iter().enumerate() {
            bytes += size;
            let is_newest = path.file_name().is_some_and(|name| name == newest);
            if (bytes > MOST_BYTES || n >= MOST_FILES) && !is_newest {
                let _ = std::fs::remove_file(path);
            }
        }
    }
}

impl Drop for Views {
    fn drop(&mut self) {
        self.end();
    }
}

/// What [`COMMAND`] is called with, for a form and its options.
fn arguments(form: &[&str]) -> Vec<OsString> {
    let option = |name: &str| OsString::from(format!("--{name}"));
    let mut arguments = vec![
        COMMAND.into(),
        option(PARENT),
        std::process::id().to_string().into(),
        option(FORM),
    ];
    arguments.extend(form.iter().map(OsString::from));
    arguments
}

/// The name in the cache of what is made of a text.
fn key_of(text: &str) -> String {
    format!("{:x}", Sha256::digest(text))
}

fn is_part(path: &Path) -> bool {
    path.extension().is_some_and(|ending| ending == "part")
}

/// The files of a folder, when they were changed, and their sizes.
fn files(folder: &Path) -> impl Iterator<Item = (PathBuf, SystemTime, u64)> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    entries.filter_map(|entry| {
        let found = entry.metadata().ok()?;
        let changed = found.modified().ok()?;
        found
            .is_file()
            .then(|| (entry.path(), changed, found.len()))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::support::wait::until;
    use std::os::unix::fs::PermissionsExt;

    /// A cache whose program is a script, and a folder of models with one model.
    fn stand(script: &str) -> (tempfile::TempDir, Views, Models) {
        let root = tempfile::tempdir().unwrap();
        let capture = root.path().join("models/a/a-0001");
        std::fs::create_dir_all(&capture).unwrap();
        std::fs::write(capture.join("model.glb"), "glTF").unwrap();
        let program = root.path().join("program");
        std::fs::write(
            &program,
            format!(
                "#!/bin/sh\necho . >>{}/count\n{script}\n",
                root.path().display()
            ),
        )
        .unwrap();
        std::fs::set_permissions(&program, std::fs::Permissions::from_mode(0o755)).unwrap();
        let recordings = Recordings::new(&root.path().join("recordings"));
        let views = Views::open(&root.path().join("cache"), &program, recordings).unwrap();
        let models = Models::new(&root.path().join("models"));
        (root, views, models)
    }

    fn text(found: Result<OpenView, Missing>) -> Option<String> {
        let (mut file, size, _) = found.ok()?;
        let mut text = String::new();
        file.read_to_string(&mut text).unwrap();
        assert_eq!(text.len() as u64, size);
        Some(text)
    }

    fn runs(root: &tempfile::TempDir) -> usize {
        let count = std::fs::read_to_string(root.path().join("count"));
        count.unwrap_or_default().lines().count()
    }

    #[test]
    fn a_view_is_made_once_and_anew_when_the_model_changes() {
        let (root, views, models) = stand("cat; echo \"$5\"");
        let get = || views.get(&models, "a", "a-0001", View::Model);
        assert_eq!(text(get()).unwrap(), "glTFmodel\n");
        let tag = get().unwrap().2;
        assert_eq!(runs(&root), 1);
        std::fs::write(root.path().join("models/a/a-0001/model.glb"), "glTF2").unwrap();
        assert_eq!(text(get()).unwrap(), "glTF2model\n");
        assert_ne!(get().unwrap().2, tag);
        assert_eq!(runs(&root), 2);
        for (recording, view) in [("a", View::Thumbnail), ("..", View::Model)] {
            let found = views.get(&models, recording, "a-0001", view);
            assert_eq!(found.err(), Some(Missing::Source), "{recording}");
        }
        assert_eq!(runs(&root), 2);
    }

    #[test]
    fn a_difference_is_made_of_both_models_and_once() {
        let (root, views, models) = stand("cat; echo \"$5\"");
        let other = root.path().join("models/a/a-0002");
        std::fs::create_dir_all(&other).unwrap();
        std::fs::write(other.join("model.glb"), "glTFother").unwrap();
        let get = |a, b| text(views.difference(&models, [["a", a], ["a", b]]));
        let expected = "\u{4}\0\0\0\0\0\0\0glTFglTFotherdifference\n";
        assert_eq!(get("a-0001", "a-0002").unwrap(), expected);
        assert_eq!(get("a-0001", "a-0002").unwrap(), expected);
        assert_eq!(runs(&root), 1);
        assert!(get("a-0001", "a-0003").is_none());
        assert!(get("a-0001", "../a-0002").is_none());
        assert_eq!(files(&root.path().join("cache")).count(), 1);
    }

    #[test]
    fn photographs_are_made_of_the_recording_and_once_while_it_grows() {
        let (root, views, _) = stand("cat; echo \"$5 $6 $7 $8\"");
        let folder = root.path().join("recordings");
        std::fs::create_dir(&folder).unwrap();
        let get = |capture, camera| text(views.photographs("a", capture, camera));
        assert!(get("a-0001", None).is_none());
        std::fs::write(folder.join("a.mcap.part"), "MCAP").unwrap();
        let all = "MCAPphotographs --recording=a.mcap.part --capture=a-0001 \n";
        assert_eq!(get("a-0001", None).unwrap(), all);
        std::fs::rename(folder.join("a.mcap.part"), folder.join("a.mcap")).unwrap();
        assert_eq!(get("a-0001", None).unwrap(), all);
        assert_eq!(runs(&root), 1);
        let one = get("a-0001", Some("c00")).unwrap();
        let expected = "MCAPphotographs --recording=a.mcap --capture=a-0001 --camera=c00\n";
        assert_eq!(one, expected);
        assert!(get("../a", None).is_none() && get("a-0001", Some("../c00")).is_none());
        assert_eq!(runs(&root), 2);
    }

    #[test]
    fn that_there_are_no_photographs_is_kept_of_a_complete_recording_alone() {
        let (root, views, _) = stand("[ $(wc -c) -gt 4 ] && echo photographs || echo '[]'");
        let folder = root.path().join("recordings");
        std::fs::create_dir(&folder).unwrap();
        let get = || views.photographs("a", "a-0001", None);
        std::fs::write(folder.join("a.mcap.part"), "MCAP").unwrap();
        assert_eq!(text(get()).unwrap(), NO_PHOTOGRAPHS);
        let tag = get().unwrap().2;
        assert_eq!(runs(&root), 2);
        // The capture is taken, in the same file.
        let grown = File::options()
            .append(true)
            .open(folder.join("a.mcap.part"));
        grown.unwrap().write_all(b"MCAP").unwrap();
        assert_eq!(text(get()).unwrap(), "photographs\n");
        assert_ne!(get().unwrap().2, tag, "a browser would keep what it has");
        assert_eq!(runs(&root), 3);
        std::fs::write(folder.join("b.mcap"), "MCAP").unwrap();
        for _ in 0..2 {
            let none = views.photographs("b", "b-0001", None);
            assert_eq!(text(none).unwrap(), NO_PHOTOGRAPHS);
        }
        assert_eq!(runs(&root), 4);
    }

    #[test]
    fn one_that_cannot_be_made_is_tried_once_and_leaves_nothing() {
        for script in ["echo half; exit 1", "kill -9 $$", "exit 0"] {
            let (root, views, models) = stand(script);
            for _ in 0..3 {
                let found = views.get(&models, "a", "a-0001", View::Model);
                assert_eq!(found.err(), Some(Missing::Unmade), "{script}");
            }
            assert_eq!(files(&root.path().join("cache")).count(), 0, "{script}");
            assert_eq!(runs(&root), 1, "{script}");
        }
    }

    #[test]
    fn one_that_could_not_be_made_is_tried_again_later() {
        let script = "[ $(wc -l <$(dirname $0)/count) -gt 1 ] || exit 1; cat; echo slow >&2";
        let (root, mut views, models) = stand(script);
        let get = |views: &Views| text(views.get(&models, "a", "a-0001", View::Model));
        assert!(get(&views).is_none());
        assert!(get(&views).is_none());
        assert_eq!(runs(&root), 1);
        views.again = Duration::ZERO;
        assert_eq!(get(&views).unwrap(), "glTF");
        // What the process said although it did its work is not lost.
        assert_eq!(*views.warned.lock(), "slow\n");
    }

    #[test]
    fn one_that_is_being_made_is_not_waited_for_when_the_page_ends() {
        let (root, views, models) = stand("sleep 600");
        std::thread::scope(|scope| {
            let made = scope.spawn(|| views.get(&models, "a", "a-0001", View::Model).is_ok());
            until("nothing is being made", || runs(&root) == 1);
            let ended = Instant::now();
            views.end();
            assert!(!made.join().unwrap());
            assert!(ended.elapsed() < PATIENCE / 2, "{:?}", ended.elapsed());
        });
    }

    #[test]
    fn the_cache_is_bounded_and_what_was_half_made_goes_at_the_start() {
        let (root, views, models) = stand("cat");
        let cache = root.path().join("cache");
        let sparse = |name: &str, age_s: u64| {
            let file = File::create(cache.join(name)).unwrap();
            file.set_len(300 << 20).unwrap();
            file.set_modified(SystemTime::now() - Duration::from_secs(age_s))
                .unwrap();
        };
        sparse("old", 900);
        sparse("new", 600);
        sparse("x.part", 0);
        let views = {
            drop(views);
            let recordings = Recordings::new(root.path());
            Views::open(&cache, &root.path().join("program"), recordings).unwrap()
        };
        assert!(!cache.join("x.part").exists());
        views.get(&models, "a", "a-0001", View::Model).unwrap();
        assert!(!cache.join("old").exists());
        assert!(cache.join("new").exists());
        assert_eq!(files(&cache).count(), 2);
    }
}
