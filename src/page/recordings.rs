//! The folder of recordings: opens one by its name, for a confined process that reads it, and reads nothing of it. The
//! kernel resolves the name below the folder, following no link.

use super::models::{is_name, open_below};
use rustix::fs::OFlags;
use std::fs::File;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::time::UNIX_EPOCH;

/// Endings of a complete recording, and of one that is being written.
const ENDINGS: [&str; 2] = [".mcap", ".mcap.part"];

/// Whether nothing is added to a file of this name any more.
pub(super) fn is_complete(name: &str) -> bool {
    name.ends_with(ENDINGS[0])
}

/// The folder of recordings.
#[derive(Clone, Debug)]
pub(super) struct Recordings {
    folder: PathBuf,
}

/// A recording that is open.
#[derive(Debug)]
pub(super) struct OpenRecording {
    pub(super) file: File,
    /// The name of its file.
    pub(super) name: String,
    /// Differs between one file and another, and not between two states of one: what it has of a capture stays.
    pub(super) tag: String,
}

impl Recordings {
    pub(super) fn new(folder: &Path) -> Self {
        Self {
            folder: folder.into(),
        }
    }

    /// Opens a recording, complete or not.
    pub(super) fn open(&self, recording: &str) -> Option<OpenRecording> {
        if !is_name(recording) {
            return None;
        }
        ENDINGS.into_iter().find_map(|ending| {
            let name = format!("{recording}{ending}");
            // A pipe in the place of a file keeps nobody waiting.
            let file = open_below(&self.folder, &name, OFlags::NONBLOCK)?;
            let found = file.metadata().ok()?;
            // A file system may give a new file the number of one that was removed.
            let made = found.created().ok();
            let made = made.and_then(|made| made.duration_since(UNIX_EPOCH).ok());
            let made_ns = made.map_or(0, |made| made.as_nanos());
            let tag = format!("{:x}-{made_ns:x}", found.ino());
            found.is_file().then_some(OpenRecording { file, name, tag })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_recording_is_the_same_when_it_grows_and_when_it_is_complete() {
        let root = tempfile::tempdir().unwrap();
        let recordings = Recordings::new(root.path());
        assert!(recordings.open("a").is_none());
        let part = root.path().join("a.mcap.part");
        std::fs::write(&part, "one").unwrap();
        let open = || recordings.open("a").unwrap();
        let begun = open();
        assert_eq!(begun.name, "a.mcap.part");
        let more = File::options().append(true).open(&part).unwrap();
        std::io::Write::write_all(&mut &more, b"two").unwrap();
        assert_eq!(open().tag, begun.tag);
        std::fs::rename(&part, root.path().join("a.mcap")).unwrap();
        let complete = open();
        assert_eq!(
            (complete.name.as_str(), &complete.tag),
            ("a.mcap", &begun.tag)
        );
        std::fs::write(root.path().join("b.mcap"), "other").unwrap();
        assert_ne!(recordings.open("b").unwrap().tag, begun.tag);
    }

    #[test]
    fn no_name_and_no_link_leads_out() {
        let root = tempfile::tempdir().unwrap();
        let folder = root.path().join("recordings");
        std::fs::create_dir(&folder).unwrap();
        std::fs::write(root.path().join("secret.mcap"), "secret").unwrap();
        std::os::unix::fs::symlink(root.path().join("secret.mcap"), folder.join("link.mcap"))
            .unwrap();
        std::fs::create_dir(folder.join("folder.mcap")).unwrap();
        let recordings = Recordings::new(&folder);
        for name in [
            "link",
            "folder",
            "../secret",
            "..",
            "",
            ".hidden",
            "a/b",
            "a\0",
        ] {
            assert!(recordings.open(name).is_none(), "{name:?}");
        }
    }
}
