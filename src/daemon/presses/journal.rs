//! The journal of presses on the disk: lines of JSON that are only ever appended. When the file is full, it is
//! renamed and a new one begins, so there are never more than two. Other files decide what the lines mean.

use crate::trigger::Reply;
use crate::words::count;
use crate::{log, storage};
use std::fs::File;
use std::io::{ErrorKind, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// Bytes after which a file makes way for the next one.
const LARGEST_FILE: u64 = 4 << 20;
/// After this time a press is forgotten.
const LONGEST: Duration = Duration::from_secs(30 * 24 * 3600);

/// A press was answered.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub(in crate::daemon) struct Line {
    /// The client's own name of the press.
    pub press_id: String,
    /// When, in seconds since 1970.
    pub time: u64,
    /// What it was answered.
    pub reply: Reply,
}

/// The file that is appended to.
pub(in crate::daemon) struct Journal {
    path: PathBuf,
    /// `None` if it could not be opened (already logged).
    file: Option<Arc<File>>,
    bytes: u64,
    /// The last line was not written to its end.
    torn: bool,
}

impl Journal {
    /// Opens the journal in a folder and returns its lines, oldest first. If it cannot be opened, this is logged:
    /// presses are then known only until the daemon ends.
    pub(in crate::daemon) fn open(folder: &Path) -> (Self, Vec<Line>) {
        let path = folder.join("presses.jsonl");
        let mut lines = read(&old(&path));
        lines.append(&mut read(&path));
        let mut journal = Self {
            path,
            file: None,
            bytes: 0,
            torn: true,
        };
        let made = std::fs::create_dir_all(folder);
        journal.try_to("open", |journal| made.and_then(|()| journal.begin()));
        (journal, lines)
    }

    /// Appends a line, which survives the daemon, and with the next [`sync`] a power cut.
    pub(in crate::daemon) fn append(&mut self, press_id: &str, reply: &Reply) {
        let line = Line {
            press_id: press_id.into(),
            time: now(),
            reply: reply.clone(),
        };
        self.try_to("write", |journal| journal.write(&line));
    }

    /// The file, which another thread brings to the disk.
    pub(in crate::daemon) fn file(&self) -> Option<Arc<File>> {
        self.file.clone()
    }

    fn begin(&mut self) -> std::io::Result<()> {
        let file = File::options().append(true).create(true).open(&self.path)?;
        self.bytes = file.metadata()?.len();
        // Whatever ended an earlier run may have done so within a line.
        self.torn = self.bytes > 0;
        self.file = Some(Arc::new(file));
        Ok(())
    }

    /// Begins the next file, whatever an earlier attempt has done already.
    fn make_way(&mut self) -> std::io::Result<()> {
        match std::fs::rename(&self.path, old(&self.path)) {
            Err(error) if error.kind() != ErrorKind::NotFound => return Err(error),
            _ => {}
        }
        self.begin()?;
        storage::sync_parent(&self.path)
    }

    fn write(&mut self, line: &Line) -> std::io::Result<()> {
        if self.bytes > LARGEST_FILE {
            self.make_way()?;
        }
        let Some(file) = &self.file else {
            return Ok(());
        };
        let mut bytes = if self.torn { vec![b'\n'] } else { Vec::new() };
        serde_json::to_writer(&mut bytes, line)?;
        bytes.push(b'\n');
        self.torn = true;
        (&**file).write_all(&bytes)?;
        self.torn = false;
        self.bytes += bytes.len() as u64;
        Ok(())
    }

    fn try_to(&mut self, what: &str, work: impl FnOnce(&mut Self) -> std::io::Result<()>) {
        if let Err(error) = work(self) {
            let path = self.path.display();
            log::error!(
                "{path}: cannot {what}: {error}; after a restart, the daemon will not know these presses"
            );
        }
    }
}

/// Brings what was appended to the disk.
pub(in crate::daemon) fn sync(file: &File) {
    if let Err(error) = file.sync_data() {
        log::error!("cannot sync the journal of presses: {error}");
    }
}

fn old(path: &Path) -> PathBuf {
    path.with_extension("old.jsonl")
}

/// Seconds since 1970 by the wall clock, and not by the daemon's `Clock`: that keeps the date that it began with, which
/// may be wrong until the network is there, and a line with a wrong date would be forgotten at the next start.
fn now() -> u64 {
    let now = SystemTime::now().duration_since(UNIX_EPOCH);
    now.unwrap_or_default().as_secs()
}

/// The lines of a file that are not too old; what makes no sense is left out, and logged.
fn read(path: &Path) -> Vec<Line> {
    let mut bytes = Vec::new();
    let all = File::open(path).and_then(|f| f.take(2 * LARGEST_FILE).read_to_end(&mut bytes));
    match all {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            log::warning!("{}: {error}", path.display());
        }
        _ => {}
    }
    let texts = bytes.split(|b| *b == b'\n').filter(|text| !text.is_empty());
    let parsed: Vec<_> = texts.map(serde_json::from_slice::<Line>).collect();
    let unparsable = parsed.iter().filter(|line| line.is_err()).count();
    if unparsable > 0 {
        log::warning!(
            "{}: scand ignores {}, which it cannot parse",
            path.display(),
            count(unparsable, "line")
        );
    }
    let oldest = now().saturating_sub(LONGEST.as_secs());
    let recent = |line: &Line| line.time >= oldest;
    parsed.into_iter().flatten().filter(recent).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn accepted(number: usize) -> Reply {
        Reply::Accepted {
            capture: format!("a-{number:04}"),
            source: None,
            press_id: None,
            subject: None,
        }
    }

    #[test]
    fn what_was_appended_is_read_again_but_for_what_was_torn_or_is_too_old() {
        let folder = tempfile::tempdir().unwrap();
        let (mut journal, lines) = Journal::open(folder.path());
        assert_eq!(lines, []);
        journal.append("p-1", &accepted(1));
        drop(journal);
        let path = folder.path().join("presses.jsonl");
        let mut file = File::options().append(true).open(&path).unwrap();
        file.write_all(b"{\"press_id\":\"p-0\",\"time\":1000,\"reply\":{\"type\":\"busy\"}}\n")
            .unwrap();
        file.write_all(b"{\"press_id\":\"p-2\",\"ti").unwrap();
        let (mut journal, lines) = Journal::open(folder.path());
        assert_eq!(lines.len(), 1);
        journal.append("p-3", &accepted(3));
        let (_, lines) = Journal::open(folder.path());
        let ids: Vec<_> = lines.iter().map(|l| &l.press_id[..]).collect();
        assert_eq!(ids, ["p-1", "p-3"]);
        assert_eq!(lines[1].reply, accepted(3));
    }

    #[test]
    fn after_a_rotation_that_failed_half_way_the_next_press_begins_a_file() {
        let folder = tempfile::tempdir().unwrap();
        let (mut journal, _) = Journal::open(folder.path());
        journal.append("p-1", &accepted(1));
        // As if the first file had been renamed, and none had been left to open the next one.
        let path = folder.path().join("presses.jsonl");
        std::fs::rename(&path, old(&path)).unwrap();
        journal.bytes = LARGEST_FILE + 1;
        journal.append("p-2", &accepted(2));
        journal.append("p-3", &accepted(3));
        let (_, lines) = Journal::open(folder.path());
        let ids: Vec<_> = lines.iter().map(|l| &l.press_id[..]).collect();
        assert_eq!(ids, ["p-1", "p-2", "p-3"]);
    }

    #[test]
    fn the_lines_of_every_released_version_say_what_they_said() {
        let released = include_str!("../../../tests/golden/format-1/presses.jsonl");
        let read = |line: &str| serde_json::from_str::<Line>(line).unwrap();
        let lines: Vec<Line> = released.lines().map(read).collect();
        assert_eq!(lines.len(), 10);
        let written: Vec<String> = lines
            .iter()
            .map(|line| serde_json::to_string(line).unwrap())
            .collect();
        assert_eq!(written.join("\n"), released.trim_end());
        let done = Reply::Done {
            capture: "a-0001".into(),
            recording: None,
            verdict: crate::level::Level::Amber,
            reasons: vec!["plates are 9 days old".into()],
            model: "/var/lib/scand/models/a/a-0001".into(),
        };
        assert_eq!(
            (lines[3].press_id.as_str(), &lines[3].reply),
            ("pedal-1", &done)
        );
    }

    #[test]
    fn a_write_that_the_disk_refuses_costs_its_own_line_alone() {
        let folder = tempfile::tempdir().unwrap();
        let (mut journal, _) = Journal::open(folder.path());
        journal.append("p-1", &accepted(1));
        let full = File::options().write(true).open("/dev/full").unwrap();
        let sound = journal.file.replace(Arc::new(full));
        journal.append("p-2", &accepted(2));
        journal.file = sound;
        // As far as a disk got with it that filled up meanwhile.
        let mut torn = journal.file.as_deref().unwrap();
        torn.write_all(b"{\"press_id\":\"p-2\",").unwrap();
        journal.append("p-3", &accepted(3));
        let (_, lines) = Journal::open(folder.path());
        let ids: Vec<_> = lines.iter().map(|l| &l.press_id[..]).collect();
        assert_eq!(ids, ["p-1", "p-3"]);
    }

    #[test]
    fn it_stays_small_and_keeps_the_newest() {
        let folder = tempfile::tempdir().unwrap();
        let (mut journal, _) = Journal::open(folder.path());
        let reply = Reply::Failed {
            capture: "a".into(),
            reason: "x".repeat(1000),
        };
        let count = 3 * LARGEST_FILE as usize / 1000;
        for i in 0..count {
            journal.append(&i.to_string(), &reply);
        }
        let files = std::fs::read_dir(folder.path()).unwrap();
        let sizes: Vec<u64> = files
            .map(|f| f.unwrap().metadata().unwrap().len())
            .collect();
        assert!(sizes.len() == 2 && sizes.iter().sum::<u64>() < 3 * LARGEST_FILE);
        let (_, lines) = Journal::open(folder.path());
        assert!(lines.len() > count / 3, "{}", lines.len());
        assert_eq!(lines.last().unwrap().press_id, (count - 1).to_string());
    }

    #[test]
    fn a_journal_that_cannot_be_had_stops_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a file");
        std::fs::write(&path, "").unwrap();
        let (mut journal, lines) = Journal::open(&path);
        journal.append("p-1", &accepted(1));
        assert!(lines.is_empty() && journal.file().is_none());
    }
}
