//! Makes and checks the names of sessions.

use crate::frame::{CaptureId, Timestamp};
use std::path::Path;

/// Longest name of a session, in letters: its captures' ids must fit their own limit.
const LONGEST: usize = 48;

/// A name from the time in UTC, such as `20260131-235959`.
pub(super) fn of_time(time: Timestamp) -> String {
    let seconds = time.0 / 1_000_000_000;
    let rest = seconds % 86_400;
    let [year, month, day] = time.date();
    let (hour, minute, second) = (rest / 3600, rest / 60 % 60, rest % 60);
    format!("{year:04}{month:02}{day:02}-{hour:02}{minute:02}{second:02}")
}

/// A name from the time, with a number appended if the folder has a recording of this name already: two sessions may
/// begin within one second.
pub(super) fn free(folder: &Path, time: Timestamp) -> String {
    let name = of_time(time);
    let taken = |name: &String| {
        let file = |ending: &str| folder.join(format!("{name}.mcap{ending}")).exists();
        file("") || file(".part")
    };
    let numbered = (2..100).map(|n| format!("{name}-{n}"));
    let mut names = std::iter::once(name.clone()).chain(numbered);
    names.find(|name| !taken(name)).unwrap_or(name)
}

/// Checks that no models of an earlier session lie where those of a new one go: captures of both have the same names if
/// the earlier recordings were moved away. While `NAME-002.mcap` is still there, the new session skips that name.
pub(super) fn check_models(models: &Path, recordings: &Path, name: &str) -> Result<(), String> {
    let is_in_the_way = |folder: &Path| {
        let stem = folder.file_name().unwrap_or_default().to_string_lossy();
        let recording = |ending| recordings.join(format!("{stem}.mcap{ending}"));
        is_of(&stem, name)
            && !["", ".part"]
                .map(recording)
                .iter()
                .any(|file| file.exists())
            && std::fs::read_dir(folder).is_ok_and(|mut models| models.next().is_some())
    };
    let folders = std::fs::read_dir(models).into_iter().flatten().flatten();
    let mut folders = folders.map(|folder| folder.path());
    match folders.find(|folder| is_in_the_way(folder)) {
        Some(folder) => Err(format!(
            "{} has models of an earlier session of this name: move them away, or choose another name",
            folder.display()
        )),
        None => Ok(()),
    }
}

/// Whether a name is that of a session, or of one of the captures that it has so far, or of a retry of one.
pub(super) fn has_capture(session: &str, captures: u32, name: &str) -> bool {
    let number = |rest: &str| {
        let rest = rest.strip_prefix('-')?;
        let digits = rest.split_once(".r").map_or(rest, |(digits, _)| digits);
        let is_number = digits.len() >= 4 && digits.bytes().all(|b| b.is_ascii_digit());
        digits.parse::<u32>().ok().filter(|_| is_number)
    };
    let rest = name.strip_prefix(session);
    let is_of = |rest: &str| number(rest).is_some_and(|number| (1..=captures).contains(&number));
    rest.is_some_and(|rest| rest.is_empty() || is_of(rest))
}

/// The session that a capture's id names, as far as it is of the form `SESSION-0001` or `SESSION-0001.r1`.
pub(super) fn session_of(capture: &str) -> &str {
    capture
        .rsplit_once('-')
        .map_or(capture, |(session, _)| session)
}

/// Whether a recording of this stem could be a session's: `NAME`, `NAME-002` and so on.
pub(super) fn is_of(stem: &str, session: &str) -> bool {
    let number = |rest: &str| {
        let digits = rest.strip_prefix('-').unwrap_or_default();
        digits.len() >= 3 && digits.bytes().all(|b| b.is_ascii_digit())
    };
    let rest = stem.strip_prefix(session);
    rest.is_some_and(|rest| rest.is_empty() || number(rest))
}

/// Checks a session's name.
pub(super) fn check_session(name: &str) -> Result<(), String> {
    CaptureId::new(name)
        .ok()
        .filter(|_| name.len() <= LONGEST)
        .map(drop)
        .ok_or_else(|| {
            let shown: String = name.chars().take(80).collect();
            format!("{shown:?} is not a valid name for a session: expected 1 to {LONGEST} characters of A-Z, a-z, 0-9, ., _ and -, the first one not a dot")
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_have_their_dates() {
        for (seconds, name) in [
            (0, "19700101-000000"),
            (951_782_400, "20000229-000000"),
            (1_767_225_599, "20251231-235959"),
            (4_107_542_400, "21000301-000000"),
        ] {
            assert_eq!(of_time(Timestamp(seconds * 1_000_000_000)), name);
        }
    }

    #[test]
    fn a_session_has_its_captures_and_no_others() {
        for (name, has) in [
            ("a", true),
            ("a-0001", true),
            ("a-0003.r1", true),
            ("a-0004", false),
            ("a-0000", false),
            ("a-1", false),
            ("a-0001-0001", false),
            ("b-0001", false),
        ] {
            assert_eq!(has_capture("a", 3, name), has, "{name}");
        }
        for (capture, session) in [
            ("a-b-0001", "a-b"),
            ("a-b-0001.r2", "a-b"),
            ("pot.red-0001", "pot.red"),
            ("pot.red-0001.r2", "pot.red"),
            ("cup", "cup"),
        ] {
            assert_eq!(session_of(capture), session);
        }
    }

    #[test]
    fn a_second_name_of_one_second_has_a_number() {
        let folder = tempfile::tempdir().unwrap();
        let name = || free(folder.path(), Timestamp(0));
        assert_eq!(name(), "19700101-000000");
        std::fs::write(folder.path().join("19700101-000000.mcap.part"), "").unwrap();
        assert_eq!(name(), "19700101-000000-2");
        std::fs::write(folder.path().join("19700101-000000-2.mcap"), "").unwrap();
        assert_eq!(name(), "19700101-000000-3");
    }

    #[test]
    fn a_name_is_refused_where_models_of_an_earlier_session_are() {
        let folder = tempfile::tempdir().unwrap();
        let (models, recordings) = (folder.path().join("models"), folder.path().join("r"));
        let check = || check_models(&models, &recordings, "amphora");
        assert_eq!(check(), Ok(()));
        std::fs::create_dir_all(models.join("amphora")).unwrap();
        std::fs::create_dir_all(models.join("amphora-2/amphora-2-0001")).unwrap();
        std::fs::create_dir_all(&recordings).unwrap();
        assert_eq!(check(), Ok(()));
        for stem in ["amphora", "amphora-002", "amphora-1000"] {
            let of_it = models.join(stem);
            std::fs::create_dir_all(of_it.join("amphora-0001")).unwrap();
            let refused = check().unwrap_err();
            assert!(refused.contains(of_it.to_str().unwrap()), "{refused}");
            let recording = recordings.join(format!("{stem}.mcap"));
            std::fs::write(recording, "").unwrap();
            assert_eq!(check(), Ok(()), "its recording is there");
        }
    }

    #[test]
    fn names_that_are_none_are_refused() {
        assert!(check_session("cup 3").is_err());
        assert!(check_session("../cup").is_err());
        assert!(check_session(&"x".repeat(49)).is_err());
        assert!(check_session("cup-3").is_ok());
    }
}
