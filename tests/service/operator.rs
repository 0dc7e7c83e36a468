//! The commands that an operator types, against a daemon in a separate process. Its cameras never answer: a press
//! fails, and every command says so.

use crate::support::program::scand;
use crate::support::wait::until_or;
use scand::recording::{CaptureOutcome, Recording, Topic};
use scand::trigger::Event;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

const CONFIGURATION: &str = r#"
[rig]
calibration = "calibration.toml"
[recording]
folder = "recordings"
keep_free_mb = 1
[workers]
count = 0
[socket]
path = "scand.sock"
[hooks]
failed = ["sh", "-c", "echo \"$SCAND_EVENT $SCAND_CAPTURE $SCAND_REASON\" >> failures"]
accepted = ["sh", "-c", "sleep 1000"]
[v4l2.defaults]
size = [1280, 960]
[v4l2.cameras.c00]
device = "/dev/none-0"
[v4l2.cameras.c01]
device = "/dev/none-1"
"#;

struct Stand {
    folder: tempfile::TempDir,
    daemon: Child,
}

impl Drop for Stand {
    fn drop(&mut self) {
        let _ = self.daemon.kill();
        let _ = self.daemon.wait();
    }
}

fn run(folder: &Path) -> Child {
    let log = std::fs::File::options()
        .create(true)
        .append(true)
        .open(folder.join("log"));
    let mut command = scand();
    command.args(["run", "--config", "rig.toml"]);
    command.current_dir(folder).stderr(log.unwrap());
    command.spawn().unwrap()
}

impl Stand {
    fn start() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let recording = Path::new(env!("CARGO_MANIFEST_DIR")).join("recordings/cup.mcap");
        let calibration = folder.path().join("calibration.toml");
        let mut info = scand();
        info.arg("info").arg(recording).arg("--calibration");
        let exported = info.arg(calibration).output();
        assert!(exported.unwrap().status.success());
        std::fs::write(folder.path().join("rig.toml"), CONFIGURATION).unwrap();
        let daemon = run(folder.path());
        let stand = Self { folder, daemon };
        stand.until_away();
        stand
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Waits until the daemon knows that its cameras are not there.
    fn until_away(&self) {
        self.until("both cameras away", || {
            let (words, _) = self.ask(&["status"]);
            words.matches("/dev/none-").count() == 2
        });
    }

    fn until(&self, what: &str, reached: impl Fn() -> bool) {
        let log = || std::fs::read_to_string(self.path("log")).unwrap_or_default();
        until_or(what, log, reached);
    }

    fn command(&self, arguments: &[&str]) -> Command {
        let mut command = scand();
        command.args(arguments).arg("--socket");
        command.arg(self.path("scand.sock"));
        command
    }

    /// What a command answers, and its exit code.
    fn ask(&self, arguments: &[&str]) -> (String, Option<i32>) {
        let output = self.command(arguments).output().unwrap();
        let words = [output.stdout, output.stderr].concat();
        let words = String::from_utf8(words).unwrap();
        (words, output.status.code())
    }

    fn done(&self, arguments: &[&str]) -> String {
        let (words, code) = self.ask(arguments);
        assert_eq!(code, Some(0), "{arguments:?}: {words}");
        words
    }
}

#[test]
fn a_day_at_a_rig_whose_cameras_are_away() {
    let mut stand = Stand::start();
    let mut events = stand.command(&["events", "--json"]);
    let mut events = events.stdout(Stdio::piped()).spawn().unwrap();
    let mut heard = BufReader::new(events.stdout.take().unwrap()).lines();
    let mut line = move || heard.next().unwrap().unwrap();
    assert_eq!(line(), r#"{"type":"listening"}"#);
    let mut next = move || -> Event { serde_json::from_str(&line()).unwrap() };
    stand.done(&["session", "start", "amphora", "--about", "operator=Ann"]);
    stand.done(&["session", "note", "a cloudy day"]);
    let (first, code) = stand.ask(&["trigger", "--press-id", "p-1"]);
    assert_eq!(code, Some(1), "{first}");
    assert!(
        first.contains("amphora-0001: accepted")
            && first.contains("amphora-0001.r1: failed: camera c00: "),
        "{first}"
    );
    // The same press is the same capture, here and after a kill.
    assert_eq!(stand.ask(&["trigger", "--press-id", "p-1"]).0, first);
    stand.until("a hook", || stand.path("failures").exists());
    let told = std::fs::read_to_string(stand.path("failures")).unwrap();
    assert!(
        told.starts_with("failed amphora-0001.r1 camera c00: "),
        "{told}"
    );
    let (refused, code) = stand.ask(&["trigger", "--until", "done"]);
    assert!(
        code == Some(1) && refused.contains("this daemon makes no models"),
        "{refused}"
    );
    stand.done(&["note", "amphora-0001", "reject"]);
    let status = stand.done(&["status"]);
    for words in [
        "session    amphora",
        "0 complete, 2 failed",
        "c00          away",
        "disk       room for",
    ] {
        assert!(status.contains(words), "{words}: {status}");
    }
    let status: serde_json::Value =
        serde_json::from_str(&stand.done(&["status", "--json"])).unwrap();
    assert_eq!(status["status"]["failed"], 2);
    stand.done(&["session", "close"]);
    let mut types = Vec::new();
    while types.len() < 8 {
        match next() {
            Event::Camera { .. } => {}
            event => types.push(serde_json::to_value(event).unwrap()["type"].clone()),
        }
    }
    let expected = [
        "session", "note", "accepted", "retried", "accepted", "failed", "note", "session",
    ];
    assert_eq!(types, expected);
    events.kill().unwrap();
    events.wait().unwrap();
    stand.daemon.kill().unwrap();
    stand.daemon.wait().unwrap();
    stand.daemon = run(stand.folder.path());
    stand.until_away();
    assert_eq!(stand.ask(&["trigger", "--press-id", "p-1"]).0, first);
    let recording = Recording::open(&stand.path("recordings/amphora.mcap")).unwrap();
    let records = recording.messages(&Topic::Capture).iter();
    let outcomes: Vec<_> = records
        .map(|m| recording.capture_record(m).unwrap().outcome)
        .collect();
    assert_eq!(outcomes, [CaptureOutcome::Failed; 2]);
    let notes = recording.messages(&Topic::Note).iter();
    let notes: Vec<_> = notes.map(|m| recording.note(m).unwrap()).collect();
    assert_eq!(
        (&notes[0].capture[..], &notes[0].text[..]),
        ("amphora", "a cloudy day")
    );
    assert_eq!(
        (&notes[1].capture[..], &notes[1].kind[..]),
        ("amphora-0001", "reject")
    );
}

#[test]
fn a_daemon_that_is_away_is_said_to_be() {
    let folder = tempfile::tempdir().unwrap();
    let socket = folder.path().join("none.sock");
    for arguments in [
        &["trigger"][..],
        &["status"],
        &["events"],
        &["session", "close"],
    ] {
        let output = scand()
            .args(arguments)
            .arg("--socket")
            .arg(&socket)
            .output()
            .unwrap();
        let words = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(69));
        assert!(words.contains("is the daemon running"), "{words}");
    }
}
