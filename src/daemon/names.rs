//! Names of sessions.

use crate::frame::{CaptureId, Timestamp};
use std::path::Path;

/// Letters that a session's name may have, so that its captures' ids are no longer than they may be.
const LONGEST: usize = 48;

/// A name from the time in UTC, such as `20260131-235959`.
pub(super) fn of_time(time: Timestamp) -> String {
    let seconds = time.0 / 1_000_000_000;
    let (days, rest) = ((seconds / 86_400) as i64, seconds % 86_400);
    let [year, month, day] = date(days);
    let (hour, minute, second) = (rest / 3600, rest / 60 % 60, rest % 60);
    format!("{year:04}{month:02}{day:02}-{hour:02}{minute:02}{second:02}")
}

/// The same, with a number behind it where a recording of this name is in the folder already: a second is long enough
/// for two.
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

/// Year, month and day of the days since 1 January 1970: the years are counted from 1 March, so that the leap day is
/// their last, and eras of 400 years repeat.
fn date(days: i64) -> [i64; 3] {
    let days = days + 719_468;
    let era = days.div_euclid(146_097);
    let of_era = days.rem_euclid(146_097);
    let year_of_era = (of_era - of_era / 1460 + of_era / 36_524 - of_era / 146_096) / 365;
    let of_year = of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let shifted = (5 * of_year + 2) / 153;
    let day = of_year - (153 * shifted + 2) / 5 + 1;
    let month = if shifted < 10 {
        shifted + 3
    } else {
        shifted - 9
    };
    [year_of_era + era * 400 + i64::from(month <= 2), month, day]
}

/// Checks that no models of an earlier session are where those of a new one go: its recording may have been moved, and
/// captures of both have the same names.
pub(super) fn check_models(folder: &Path) -> Result<(), String> {
    let mut models = std::fs::read_dir(folder).into_iter().flatten();
    if models.next().is_none() {
        return Ok(());
    }
    let folder = folder.display();
    Err(format!(
        "{folder} has models of an earlier session of this name: move them, or take another name"
    ))
}

/// Checks a session's name.
pub(super) fn check_session(name: &str) -> Result<(), String> {
    CaptureId::new(name)
        .ok()
        .filter(|_| name.len() <= LONGEST)
        .map(drop)
        .ok_or_else(|| {
            let shown: String = name.chars().take(80).collect();
            format!("session {shown:?} is not 1 to {LONGEST} of A-Z, a-z, 0-9, ., _ and - not starting with a dot")
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
        let models = folder.path().join("amphora");
        assert_eq!(check_models(&models), Ok(()));
        std::fs::create_dir(&models).unwrap();
        assert_eq!(check_models(&models), Ok(()));
        std::fs::create_dir(models.join("amphora-0001")).unwrap();
        let refused = check_models(&models).unwrap_err();
        assert!(refused.contains(&models.display().to_string()), "{refused}");
    }

    #[test]
    fn names_that_are_none_are_refused() {
        assert!(check_session("cup 3").is_err());
        assert!(check_session("../cup").is_err());
        assert!(check_session(&"x".repeat(49)).is_err());
        assert!(check_session("cup-3").is_ok());
    }
}
