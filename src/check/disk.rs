//! Checks the recordings' folder: whether the daemon can write there, and its free space and speed.

use super::{Finding, State};
use crate::words::count;
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant, SystemTime};

/// Bytes written to measure a disk's speed.
const SAMPLE: usize = 64 << 20;
/// A capture should be durable within this many seconds; if it takes longer, presses wait for the disk.
const LONGEST_SECONDS: f64 = 3.0;

const FOLDER: &str = "recordings' folder";
const FOLDER_REMEDY: &str =
    "create it for the daemon's user: install -d -o scand -g scand -m 750 FOLDER";

/// Checks that the daemon can create a file in a folder; returns the finding, and whether the folder's speed can be
/// measured. Root may write everywhere and says nothing about the daemon, so it tries as the daemon's user, if the
/// package has made that.
pub fn folder(path: &Path, daemon_answers: bool) -> (Finding, bool) {
    let is_root = rustix::process::geteuid().is_root();
    match is_root.then(|| User::named("scand")).flatten() {
        Some(user) => folder_of(&user, path),
        None => folder_of_this_user(path, daemon_answers),
    }
}

/// While the daemon answers, this check's own user need not have the right to write there.
fn folder_of_this_user(path: &Path, daemon_answers: bool) -> (Finding, bool) {
    let trial = trial(path);
    let made = std::fs::File::create_new(&trial);
    let _ = std::fs::remove_file(&trial);
    let found = path.display().to_string();
    let cause = match made {
        Ok(_) => return (Finding::ok(FOLDER, found), true),
        Err(cause) => cause,
    };
    if daemon_answers && cause.kind() == std::io::ErrorKind::PermissionDenied && path.is_dir() {
        let found = format!(
            "{found}: only the daemon may write there; run `sudo scand check` to measure its speed"
        );
        return (Finding::ok(FOLDER, found), false);
    }
    let found = format!("{found}: {cause}");
    (
        Finding::not_ok(State::Wrong, FOLDER, found, FOLDER_REMEDY),
        false,
    )
}

/// Tries a folder as another user, which only root may.
fn folder_of(user: &User, path: &Path) -> (Finding, bool) {
    let trial = trial(path);
    let made = user.make(&trial);
    let _ = std::fs::remove_file(&trial);
    let (found, name) = (path.display(), &user.name);
    if let Err(cause) = made {
        let found = format!("{found}: user {name} cannot write there: {cause}");
        let finding = Finding::not_ok(State::Wrong, FOLDER, found, FOLDER_REMEDY);
        return (finding, false);
    }
    let mut found = found.to_string();
    if !path.starts_with(OPEN) {
        found += &format!(
            ": user {name} may write there; whether the sandbox of scand.service allows it was not tried \
             (docs/installing.md, \"Another disk\")"
        );
    }
    (Finding::ok(FOLDER, found), true)
}

/// Where the sandbox of `scand.service` lets the daemon write.
const OPEN: &str = "/var/lib/scand";

fn trial(folder: &Path) -> PathBuf {
    folder.join(format!(".scand-check-{}", std::process::id()))
}

/// A user of this machine.
#[derive(Debug)]
struct User {
    name: String,
    /// The numbers of the user and of its group.
    uid: String,
    gid: String,
}

impl User {
    /// The user of a name, if there is one in the machine's own list.
    fn named(name: &str) -> Option<Self> {
        let users = std::fs::read_to_string("/etc/passwd").ok()?;
        users.lines().find_map(|line| {
            let mut fields = line.split(':');
            let [found, _, uid, gid]: [&str; 4] =
                std::array::from_fn(|_| fields.next().unwrap_or_default());
            (found == name).then(|| Self {
                name: found.into(),
                uid: uid.into(),
                gid: gid.into(),
            })
        })
    }

    /// Makes an empty file with all rights of this user, and no others; or says why that is not possible.
    fn make(&self, file: &Path) -> Result<(), String> {
        let mut command = Command::new("setpriv");
        command
            .arg(format!("--reuid={}", self.uid))
            .arg(format!("--regid={}", self.gid))
            .args(["--init-groups", "--", "touch", "--"])
            .arg(file)
            .env("LC_ALL", "C");
        let ended = command.output().map_err(|e| format!("setpriv: {e}"))?;
        if ended.status.success() {
            return Ok(());
        }
        let words = String::from_utf8_lossy(&ended.stderr);
        // The cause stands last, behind the name of the file.
        let cause = words.trim().rsplit(": ").next();
        Err(cause.unwrap_or_default().to_owned())
    }
}

/// With space for fewer captures, the check advises to make space before the work begins. The operator's page, which
/// people see while they work, warns later (`ui/src/state.ts`).
const FEW_CAPTURES: u64 = 100;

/// Checks that there is space for captures of this size, in addition to the space that is kept free.
pub fn space(free: std::io::Result<u64>, capture_bytes: u64, keep_free_bytes: u64) -> Finding {
    let subject = "disk: space";
    let free = match free {
        Ok(free) => free,
        Err(cause) => {
            return Finding::not_ok(
                State::Wrong,
                subject,
                cause.to_string(),
                "check that the disk is mounted",
            );
        }
    };
    let usable = free.saturating_sub(keep_free_bytes);
    let mut found = format!("{} GB free", free / 1_000_000_000);
    let Some(captures) = usable.checked_div(capture_bytes) else {
        return Finding::ok(subject, found);
    };
    found += &format!(", space for {}", count(captures as usize, "capture"));
    let remedy = "move old recordings elsewhere; recording.keep_free_mb sets the space that captures never use";
    match captures {
        0 => Finding::not_ok(State::Wrong, subject, found, remedy),
        1..FEW_CAPTURES => Finding::not_ok(State::Advice, subject, found, remedy),
        _ => Finding::ok(subject, found),
    }
}

/// Measures how fast a folder's disk makes data durable, and how long a capture takes. Writes 64 MiB and removes them.
pub fn speed(path: &Path, capture_bytes: u64) -> Finding {
    let subject = "disk: speed";
    let trial = trial(path);
    let measured = write(&trial);
    let _ = std::fs::remove_file(&trial);
    match measured {
        Ok(took) => judge_speed(SAMPLE as f64 / took.as_secs_f64().max(1e-6), capture_bytes),
        Err(cause) => {
            let found = format!("{}: {cause}", path.display());
            Finding::not_ok(
                State::Wrong,
                subject,
                found,
                "captures cannot be recorded until this folder can be written: check the disk and \
                the folder's owner",
            )
        }
    }
}

fn write(path: &Path) -> std::io::Result<Duration> {
    // Data that the disk cannot compress.
    let mut seed = 0x9e37_79b9_7f4a_7c15_u64;
    let block: Vec<u8> = std::iter::repeat_with(|| {
        seed ^= seed << 13;
        seed ^= seed >> 7;
        seed ^= seed << 17;
        seed.to_le_bytes()
    })
    .take((4 << 20) / 8)
    .flatten()
    .collect();
    let mut file = std::fs::File::create_new(path)?;
    let begin = Instant::now();
    for _ in 0..SAMPLE / block.len() {
        file.write_all(&block)?;
    }
    file.sync_data()?;
    Ok(begin.elapsed())
}

fn judge_speed(bytes_a_second: f64, capture_bytes: u64) -> Finding {
    let seconds = capture_bytes as f64 / bytes_a_second;
    let found = format!(
        "{:.0} MB/s: a capture of {} MB takes {seconds:.1} s",
        bytes_a_second / 1e6,
        capture_bytes / 1_000_000
    );
    if seconds <= LONGEST_SECONDS {
        return Finding::ok("disk: speed", found);
    }
    let remedy = "use a faster disk or press more slowly: at most capture.waiting captures wait for the disk";
    Finding::not_ok(State::Advice, "disk: speed", found, remedy)
}

/// Hours after which backgrounds are advice, whatever the configuration says: the light of another day may differ.
const OLD_PLATES_H: u64 = 12;

/// Checks the age of the newest backgrounds of the empty rig, which lie below the recordings' folder. Beyond `limit_h`
/// hours a model has their age as a reason.
pub fn plates(recordings: &Path, limit_h: f64) -> Finding {
    let subject = "backgrounds";
    let folder = recordings.join("plates");
    let files = match std::fs::read_dir(&folder) {
        Err(cause) if cause.kind() != ErrorKind::NotFound => {
            let found = format!("{}: {cause}", folder.display());
            let remedy = "whether there are backgrounds cannot be seen until this folder can be read: check its owner";
            return Finding::not_ok(State::Wrong, subject, found, remedy);
        }
        files => files.into_iter().flatten().flatten(),
    };
    let plates = files.filter(|f| f.path().extension().is_some_and(|e| e == "mcap"));
    let newest = plates
        .filter_map(|f| f.metadata().ok()?.modified().ok())
        .max();
    let remedy = "clear the rig and run `scand background`";
    let Some(newest) = newest else {
        return Finding::not_ok(State::Wrong, subject, "no backgrounds were taken", remedy);
    };
    let age = SystemTime::now().duration_since(newest);
    let ahead = age.as_ref().err().map(|ahead| ahead.duration().as_secs());
    if let Some(seconds) = ahead.filter(|&seconds| seconds > 60) {
        let found =
            format!("dated {seconds} s in the future: the clock was wrong when they were taken");
        return Finding::not_ok(State::Wrong, subject, found, remedy);
    }
    let seconds = age.unwrap_or_default().as_secs();
    let hours = seconds / 3600;
    let found = format!("{} old", count(hours as usize, "hour"));
    if seconds as f64 / 3600.0 > limit_h {
        let found = format!("{found}, and models have that as a reason");
        return Finding::not_ok(State::Advice, subject, found, remedy);
    }
    if hours < OLD_PLATES_H {
        return Finding::ok(subject, found);
    }
    Finding::not_ok(State::Advice, subject, found, remedy)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::support::skipped::{Needed, skip};
    use std::os::unix::fs::PermissionsExt;

    #[test]
    fn room_is_counted_in_captures() {
        let of = |free| space(Ok(free), 100_000_000, 1_000_000_000);
        assert_eq!(of(100_000_000_000).state, State::Ok);
        assert_eq!(of(5_000_000_000).state, State::Advice);
        assert!(of(5_000_000_000).found.contains("space for 40 captures"));
        assert_eq!(of(1_050_000_000).state, State::Wrong);
        assert_eq!(space(Ok(7), 0, 0).state, State::Ok);
        assert_eq!(
            space(Err(std::io::ErrorKind::NotFound.into()), 1, 1).state,
            State::Wrong
        );
    }

    #[test]
    fn a_slow_disk_is_told_by_what_a_capture_takes() {
        assert_eq!(judge_speed(400e6, 100_000_000).state, State::Ok);
        let slow = judge_speed(20e6, 100_000_000);
        assert_eq!(slow.state, State::Advice);
        assert!(slow.found.contains("takes 5.0 s"), "{slow:?}");
    }

    #[test]
    fn a_folder_is_tried_and_left_as_it_was() {
        let at = tempfile::tempdir().unwrap();
        let folder = folder_of_this_user;
        assert_eq!(folder(at.path(), false).0.state, State::Ok);
        assert_eq!(speed(at.path(), 1).state, State::Ok);
        assert_eq!(std::fs::read_dir(at.path()).unwrap().count(), 0);
        let missing = at.path().join("none");
        assert_eq!(folder(&missing, true).0.state, State::Wrong);
        assert_eq!(speed(&missing, 1).state, State::Wrong);
    }

    #[test]
    fn root_tries_a_folder_as_the_daemons_user() {
        if !rustix::process::geteuid().is_root() {
            return skip(Needed::OtherUsers, "this user is not root");
        }
        let nobody = User::named("nobody").unwrap();
        // Where every user may go.
        let at = tempfile::tempdir_in("/tmp").unwrap();
        let (closed, is_writable) = folder_of(&nobody, at.path());
        assert_eq!((closed.state, is_writable), (State::Wrong, false));
        let cause = "user nobody cannot write there: Permission denied";
        assert!(closed.found.ends_with(cause), "{closed:?}");
        std::fs::set_permissions(at.path(), PermissionsExt::from_mode(0o777)).unwrap();
        let (open, is_writable) = folder_of(&nobody, at.path());
        assert_eq!((open.state, is_writable), (State::Ok, true));
        assert!(open.found.contains("sandbox"), "{open:?}");
        assert_eq!(std::fs::read_dir(at.path()).unwrap().count(), 0);
        assert!(User::named("nobody-such").is_none());
    }

    #[test]
    fn plates_have_an_age() {
        let at = tempfile::tempdir().unwrap();
        let plates = |at| plates(at, 24.0);
        assert_eq!(plates(at.path()).state, State::Wrong);
        // What is there is no folder, which is not the same as nothing.
        std::fs::write(at.path().join("plates"), "").unwrap();
        let unread = plates(at.path());
        assert_eq!(unread.state, State::Wrong);
        assert!(unread.found.contains("plates: "), "{unread:?}");
        std::fs::remove_file(at.path().join("plates")).unwrap();
        assert_eq!(plates(at.path()).found, "no backgrounds were taken");
        std::fs::create_dir(at.path().join("plates")).unwrap();
        let file = std::fs::File::create(at.path().join("plates/a.mcap")).unwrap();
        assert_eq!(plates(at.path()).state, State::Ok);
        let yesterday = SystemTime::now() - Duration::from_secs(86_400);
        file.set_modified(yesterday).unwrap();
        assert_eq!(plates(at.path()).state, State::Advice);
        // A rig where models have a lower age as a reason, and one where none is.
        file.set_modified(SystemTime::now() - Duration::from_secs(3 * 3600))
            .unwrap();
        assert_eq!(plates(at.path()).state, State::Ok);
        let strict = super::plates(at.path(), 2.5);
        assert_eq!(strict.state, State::Advice);
        assert_eq!(
            strict.found,
            "3 hours old, and models have that as a reason"
        );
        let lax = super::plates(at.path(), f64::INFINITY);
        assert_eq!(lax.state, State::Ok);
        let tomorrow = SystemTime::now() + Duration::from_secs(86_400);
        file.set_modified(tomorrow).unwrap();
        assert_eq!(plates(at.path()).state, State::Wrong);
    }
}
