//! Finds the recordings of a session: the one that a capture is in, and its neighbours. A session whose file grew too
//! large goes on in `NAME-002` and so on.

use super::find::find;
use super::job::Job;
use crate::recording::finished_name;
use std::path::{Path, PathBuf};

/// The recordings that may have captures of the same session as the job's, its own among them; `None` where none has
/// its capture any more.
pub(super) fn of_session(folder: &Path, job: &Job) -> Option<Vec<PathBuf>> {
    let own = find(folder, job)?;
    let mut all = named(folder, session_of(&job.capture));
    all.push(own);
    // `a.mcap` before `a-002.mcap`.
    all.sort_by_cached_key(|path| (path.as_os_str().len(), path.clone()));
    all.dedup();
    Some(all)
}

/// The recordings in a folder whose names say that they are a session's, complete or not.
pub(super) fn named(folder: &Path, session: &str) -> Vec<PathBuf> {
    let files = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let is_of = |path: &PathBuf| {
        let complete = finished_name(path).unwrap_or_else(|| path.clone());
        let is_recording = complete.extension().is_some_and(|e| e == "mcap");
        let stem = complete.file_stem().unwrap_or_default().to_string_lossy();
        is_recording && is_stem_of(&stem, session)
    };
    let mut found: Vec<PathBuf> = files.map(|f| f.path()).filter(is_of).collect();
    found.sort();
    found
}

fn is_stem_of(stem: &str, session: &str) -> bool {
    let Some(rest) = stem.strip_prefix(session) else {
        return false;
    };
    let number = |digits: &str| digits.len() >= 3 && digits.bytes().all(|b| b.is_ascii_digit());
    rest.is_empty() || rest.strip_prefix('-').is_some_and(number)
}

/// The session that a capture's id names: `SESSION-0001` or `SESSION-0001.r1`.
pub(super) fn session_of(capture: &str) -> &str {
    capture
        .rsplit_once('-')
        .map_or(capture, |(session, _)| session)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_session_may_have_any_name() {
        for (capture, session) in [
            ("a-b-0003.r1", "a-b"),
            ("pot.red-0001", "pot.red"),
            ("pot.red-0001.r2", "pot.red"),
            ("cup", "cup"),
        ] {
            assert_eq!(session_of(capture), session);
        }
    }

    #[test]
    fn a_session_goes_on_in_numbered_files() {
        let folder = tempfile::tempdir().unwrap();
        let names = [
            "a.mcap",
            "a-002.mcap.part",
            "a-2.mcap",
            "b.mcap",
            "a.notes.jsonl",
        ];
        for name in names {
            std::fs::write(folder.path().join(name), "").unwrap();
        }
        let found = named(folder.path(), session_of("a-0003.r1"));
        let names: Vec<_> = found.iter().map(|p| p.file_name().unwrap()).collect();
        assert_eq!(names, ["a-002.mcap.part", "a.mcap"]);
    }
}
