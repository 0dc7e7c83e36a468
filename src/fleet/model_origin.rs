//! What is known of a model that came from elsewhere, beside its folder: which job it is the result of, who made it,
//! and from which state of which recording. It saves a second run from reading the recording again.

use super::bundle::contents_sha256;
use crate::storage::{self, write_atomically};
use crate::words::hexadecimal;
use crate::workers::distrusted::origin_path;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

/// What is known of one model.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ModelOrigin {
    /// The job's digest.
    pub digest: String,
    /// The digest of the result's contents.
    pub contents_sha256: String,
    /// The worker that made it.
    pub worker: String,
    /// What the job was made of, as far as it is seen without opening the recording.
    pub made_of: String,
}

impl ModelOrigin {
    /// Where it is, for a model's folder.
    pub fn path(target: &Path) -> PathBuf {
        origin_path(target)
    }

    /// What is known of the model in a folder.
    pub fn read(target: &Path) -> Option<Self> {
        let bytes = std::fs::read(Self::path(target)).ok()?;
        serde_json::from_slice(&bytes).ok()
    }

    /// Notes what is known.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn write(&self, target: &Path) -> Result<(), storage::Error> {
        let bytes = serde_json::to_vec(self).unwrap_or_default();
        write_atomically(&Self::path(target), &bytes)?;
        Self::withdraw(target);
        Ok(())
    }

    /// Takes back what was announced: no model was put into place.
    pub fn withdraw(target: &Path) {
        let _ = std::fs::remove_file(Self::announced_path(target));
    }

    /// Notes what will be known of a model that is about to be put into place.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn announce(&self, target: &Path) -> Result<(), storage::Error> {
        let bytes = serde_json::to_vec(self).unwrap_or_default();
        write_atomically(&Self::announced_path(target), &bytes)
    }

    /// Ends what a process announced that was killed then: if the announced model is in place, it is noted. What such a
    /// process left half written goes.
    pub fn settle(target: &Path) {
        let path = Self::announced_path(target);
        for written in [&path, &Self::path(target)] {
            let _ = storage::remove_abandoned_parts(written);
        }
        let Ok(bytes) = std::fs::read(&path) else {
            return;
        };
        let announced = serde_json::from_slice::<Self>(&bytes).ok();
        let there = contents_sha256(target).ok();
        match announced.filter(|origin| there.as_ref() == Some(&origin.contents_sha256)) {
            Some(origin) => drop(origin.write(target)),
            None => Self::withdraw(target),
        }
    }

    fn announced_path(target: &Path) -> PathBuf {
        Self::path(target).with_extension("fleet-announced")
    }

    /// What a job is made of: the recording's file as it is now, the capture, the settings and the program. `None`
    /// where there is no such file.
    pub fn made_of(recording: &Path, parts: &[&str]) -> Option<String> {
        let file = std::fs::metadata(recording).ok()?;
        let seen = format!("{} {} {}", file.len(), file.mtime(), file.mtime_nsec());
        let mut hash = Sha256::new();
        for part in [seen.as_str()].iter().chain(parts) {
            hash.update((part.len() as u64).to_le_bytes());
            hash.update(part);
        }
        Some(hexadecimal(&hash.finalize()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_noted_is_read_and_a_changed_recording_is_another_one() {
        let home = tempfile::tempdir().unwrap();
        let target = home.path().join("a1");
        assert_eq!(ModelOrigin::read(&target), None);
        let recording = home.path().join("a.mcap");
        std::fs::write(&recording, b"one").unwrap();
        let made_of = ModelOrigin::made_of(&recording, &["a1", "settings"]).unwrap();
        assert_ne!(
            ModelOrigin::made_of(&recording, &["a1", "other"]).unwrap(),
            made_of
        );
        std::fs::write(&recording, b"other").unwrap();
        assert_ne!(
            ModelOrigin::made_of(&recording, &["a1", "settings"]).unwrap(),
            made_of
        );
        let origin = ModelOrigin {
            digest: "d".into(),
            contents_sha256: "c".into(),
            worker: "w".into(),
            made_of,
        };
        origin.write(&target).unwrap();
        assert_eq!(ModelOrigin::read(&target), Some(origin));
    }

    #[test]
    fn a_process_that_was_killed_at_a_commit_leaves_whose_model_it_is() {
        let home = tempfile::tempdir().unwrap();
        let target = home.path().join("cup").join("a1");
        let origin = |contents: String| ModelOrigin {
            digest: "d".into(),
            contents_sha256: contents,
            worker: "w".into(),
            made_of: "m".into(),
        };
        // Killed before the model was in place.
        origin("c".into()).announce(&target).unwrap();
        let half = ["..a1.fleet.part-1-0", "..a1.fleet-announced.part-1-1"];
        let half = half.map(|name| home.path().join("cup").join(name));
        half.iter()
            .for_each(|path| std::fs::write(path, "{").unwrap());
        ModelOrigin::settle(&target);
        assert!(half.iter().all(|path| !path.exists()));
        assert_eq!(ModelOrigin::read(&target), None);
        // Killed after that.
        std::fs::create_dir(&target).unwrap();
        std::fs::write(target.join("report.json"), b"{}").unwrap();
        let contents = contents_sha256(&target).unwrap();
        origin(contents.clone()).announce(&target).unwrap();
        // What is announced is not known yet.
        assert_eq!(ModelOrigin::read(&target), None);
        ModelOrigin::settle(&target);
        assert_eq!(ModelOrigin::read(&target), Some(origin(contents)));
        let left = std::fs::read_dir(home.path().join("cup")).unwrap().count();
        assert_eq!(left, 2);
    }
}
