//! The daemon as a service: what it exchanges with systemd, who may use its socket, how it reloads its
//! configuration, and how it ends. Its cameras never answer; other tests check what it does with cameras.

use crate::support::program::scand;
use crate::support::skipped::{Needed, skip};
use crate::support::wait::until_or;
use std::io::{BufRead, BufReader, Write};
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::os::unix::net::{UnixDatagram, UnixStream};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

const CONFIGURATION: &str = r#"
[rig]
calibration = "calibration.toml"
[recording]
folder = "recordings"
[socket]
path = "scand.sock"
[v4l2.defaults]
size = [1280, 960]
[v4l2.cameras.c00]
device = "/dev/none-0"
[v4l2.cameras.c01]
device = "/dev/none-1"
"#;

/// A folder with a configuration, and a daemon that may be running in it.
struct Stand {
    folder: tempfile::TempDir,
    daemon: Option<Child>,
}

impl Drop for Stand {
    fn drop(&mut self) {
        if let Some(mut daemon) = self.daemon.take() {
            let _ = daemon.kill();
            let _ = daemon.wait();
        }
    }
}

impl Stand {
    fn new(more: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let stand = Self {
            folder,
            daemon: None,
        };
        let recording = Path::new(env!("CARGO_MANIFEST_DIR")).join("recordings/cup.mcap");
        let exported = scand()
            .arg("info")
            .arg(recording)
            .arg("--calibration")
            .arg(stand.path("calibration.toml"))
            .output();
        assert!(exported.unwrap().status.success());
        stand.configure(more);
        stand
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn configure(&self, more: &str) {
        std::fs::write(self.path("rig.toml"), format!("{CONFIGURATION}{more}")).unwrap();
    }

    /// Starts the daemon, by way of `command`.
    fn start(&mut self, mut command: Command) {
        let log = std::fs::File::create(self.path("log")).unwrap();
        command.current_dir(self.folder.path()).stderr(log);
        self.daemon = Some(command.spawn().unwrap());
    }

    fn log(&self) -> String {
        std::fs::read_to_string(self.path("log")).unwrap_or_default()
    }

    fn until_logged(&self, words: &str) {
        until_or(words, || self.log(), || self.log().contains(words));
    }

    fn signal(&self, name: &str) {
        let pid = self.daemon.as_ref().unwrap().id().to_string();
        let sent = Command::new("kill").args([name, &pid]).status();
        assert!(sent.unwrap().success());
    }

    /// Ends the daemon as systemd does.
    fn end(&mut self) {
        self.signal("-TERM");
        let ended = self.daemon.take().unwrap().wait().unwrap();
        assert!(ended.success(), "{}", self.log());
    }

    /// Asks for the status; the line that comes back.
    fn ask(&self) -> String {
        let mut stream = UnixStream::connect(self.path("scand.sock")).unwrap();
        stream
            .set_read_timeout(Some(Duration::from_secs(30)))
            .unwrap();
        stream.write_all(b"{\"type\":\"status\"}\n").unwrap();
        let mut line = String::new();
        BufReader::new(stream).read_line(&mut line).unwrap();
        line
    }
}

fn run() -> Command {
    let mut command = scand();
    command.args(["run", "--config", "rig.toml"]);
    command
}

/// systemd's end of the notifications.
struct Systemd(UnixDatagram);

impl Systemd {
    fn bind(path: &Path) -> Self {
        let socket = UnixDatagram::bind(path).unwrap();
        socket
            .set_read_timeout(Some(Duration::from_millis(100)))
            .unwrap();
        Self(socket)
    }

    /// What comes within a time, up to what will do.
    fn hear(&self, at_most: Duration, enough: impl Fn(&str) -> bool) -> Vec<String> {
        let deadline = Instant::now() + at_most;
        let (mut all, mut bytes) = (Vec::new(), [0; 4096]);
        while Instant::now() < deadline {
            if let Ok(n) = self.0.recv(&mut bytes) {
                let words = String::from_utf8_lossy(&bytes[..n]).into_owned();
                all.push(words);
                if enough(all.last().unwrap()) {
                    break;
                }
            }
        }
        all
    }
}

const LONG: Duration = Duration::from_secs(30);

#[test]
fn ready_is_what_the_policy_says_and_the_watchdog_is_fed() {
    let mut stand = Stand::new("[service]\nmissing_cameras = 2\npatience_s = 2.0\n");
    let systemd = Systemd::bind(&stand.path("notify"));
    let mut command = run();
    command
        .env("NOTIFY_SOCKET", stand.path("notify"))
        .env("WATCHDOG_USEC", "2000000");
    stand.start(command);
    let heard = systemd.hear(LONG, |words| words == "READY=1");
    assert_eq!(
        heard.last().unwrap(),
        "READY=1",
        "{heard:?}: {}",
        stand.log()
    );
    let not_ready = |words: &String| words.starts_with("STATUS=not ready: 0 of 2 cameras");
    assert!(heard.iter().any(not_ready), "{heard:?}");
    // A start that takes long and lives is not ended.
    let lives = |words: &str| words.contains("WATCHDOG=1") && words.contains("EXTEND_TIMEOUT_USEC");
    assert!(heard.iter().any(|words| lives(words)), "{heard:?}");
    let heard = systemd.hear(LONG, |words| words.contains("WATCHDOG=1"));
    assert!(heard.last().unwrap().contains("WATCHDOG=1"), "{heard:?}");
    stand.end();
    let heard = systemd.hear(LONG, |words| words.contains("STOPPING=1"));
    assert!(heard.last().unwrap().contains("STOPPING=1"), "{heard:?}");
}

#[test]
fn with_cameras_missing_it_is_not_ready_and_answers_all_the_same() {
    let mut stand = Stand::new("");
    let systemd = Systemd::bind(&stand.path("notify"));
    let mut command = run();
    command.env("NOTIFY_SOCKET", stand.path("notify"));
    stand.start(command);
    stand.until_logged("listening");
    // What decides says both at once, readiness first.
    let heard = systemd.hear(LONG, |words| words.starts_with("STATUS=not ready"));
    assert!(
        heard
            .last()
            .is_some_and(|words| words.starts_with("STATUS=not ready"))
    );
    assert!(!heard.contains(&"READY=1".to_owned()), "{heard:?}");
    assert!(stand.ask().contains("/dev/none-0"), "{}", stand.ask());
}

/// systemd's own program, which starts the daemon at the first connection.
fn activate(stand: &mut Stand, more: &[&str]) {
    let mut command = Command::new("systemd-socket-activate");
    command
        .arg("-l")
        .arg(stand.path("scand.sock"))
        .arg(env!("CARGO_BIN_EXE_scand"))
        .args(["run", "--config", "rig.toml"])
        .args(more);
    stand.start(command);
    stand.until_logged("Listening on");
}

#[test]
fn a_socket_that_systemd_made_is_served_and_left() {
    let mut stand = Stand::new("");
    activate(&mut stand, &[]);
    let socket = stand.path("scand.sock");
    let before = std::fs::symlink_metadata(&socket).unwrap();
    assert!(stand.ask().contains("\"cameras\""));
    // It became the daemon: the same process, the same socket, of which clients see that it is served.
    stand.end();
    let after = std::fs::symlink_metadata(&socket).unwrap();
    assert_eq!(before.ino(), after.ino());
    assert!(before.modified().unwrap() < after.modified().unwrap());
    let log = stand.log();
    assert!(log.contains("client connected: user"), "{log}");
    assert!(!log.contains("socket.path"), "{log}");
}

#[test]
fn where_it_listens_is_told_also_if_another_place_is_configured() {
    let mut stand = Stand::new("");
    activate(&mut stand, &["--set", "socket.path=elsewhere.sock"]);
    assert!(stand.ask().contains("\"cameras\""));
    stand.end();
    let log = stand.log();
    let address = format!("listening on {}", stand.path("scand.sock").display());
    assert!(log.contains(&address), "{log}");
    assert!(log.contains("elsewhere.sock, which has no effect"), "{log}");
    assert!(!stand.path("elsewhere.sock").exists());
}

#[test]
fn who_waits_for_a_daemon_that_cannot_start_hears_why() {
    let mut stand = Stand::new("[capture]\nretyr = 1\n");
    activate(&mut stand, &[]);
    let refused = stand.ask();
    assert!(
        refused.contains("refused") && refused.contains("retyr"),
        "{refused}"
    );
    let ended = stand.daemon.take().unwrap().wait().unwrap();
    assert_eq!(ended.code(), Some(78), "{}", stand.log());
}

#[test]
fn its_own_socket_is_for_its_group_alone_and_removed_at_the_end() {
    let mut stand = Stand::new("");
    stand.start(run());
    stand.until_logged("listening");
    let socket = stand.path("scand.sock");
    let mode = std::fs::metadata(&socket).unwrap().permissions().mode();
    assert_eq!(mode & 0o777, 0o660);
    refused_to_nobody(&stand, &socket);
    stand.end();
    assert!(!socket.exists());
}

/// Other users may not press. The test needs root to become another user.
fn refused_to_nobody(stand: &Stand, socket: &Path) {
    let open = |path: &Path, mode| {
        std::fs::set_permissions(path, std::fs::Permissions::from_mode(mode)).unwrap();
    };
    // All but the socket's own mode would let them in.
    open(stand.folder.path(), 0o755);
    let program = stand.path("scand");
    std::fs::copy(env!("CARGO_BIN_EXE_scand"), &program).unwrap();
    open(&program, 0o755);
    let ask = |user: u32| {
        let mut command = Command::new(&program);
        command.args(["status", "--socket"]).arg(socket);
        command.stdout(Stdio::null()).uid(user).gid(user).output()
    };
    let answer = match ask(65534) {
        Ok(answer) => answer,
        Err(cause) => {
            return skip(
                Needed::OtherUsers,
                format_args!("no program runs as another user: {cause}"),
            );
        }
    };
    assert_eq!(answer.status.code(), Some(1));
    let words = String::from_utf8_lossy(&answer.stderr);
    assert!(words.contains("ermission denied"), "{words}");
    assert!(ask(0).unwrap().status.success());
}

#[test]
fn sighup_reads_again_what_may_change_and_refuses_the_rest_by_name() {
    let mut stand = Stand::new("[capture]\nretry = 1\n");
    stand.start(run());
    stand.until_logged("listening");
    stand.configure("[capture]\nretry = 3\nwaiting = 5\n[v4l2.cameras.c01.controls]\nfocus = 3\n");
    stand.signal("-HUP");
    stand.until_logged(
        "capture.waiting, v4l2.cameras.c01.controls: restart the daemon to change this",
    );
    stand.configure("[capture]\nretyr = 3\n");
    stand.signal("-HUP");
    stand.until_logged("retyr");
    stand.configure("[capture]\nretry = 3\npatience_ms = 700\n[hull]\nresolution = 123\n");
    stand.signal("-HUP");
    stand.until_logged("the changed settings are in use");
    // Models from now on are made with it.
    let settings = std::fs::read_to_string(stand.path("recordings/jobs/settings.toml")).unwrap();
    assert!(settings.contains("resolution = 123"), "{settings}");
    stand.end();
}

#[test]
fn sighup_changes_what_models_leave_free() {
    let mut stand = Stand::new("");
    let recording = stand.path("recordings/cup.mcap");
    std::fs::create_dir(stand.path("recordings")).unwrap();
    let shipped = Path::new(env!("CARGO_MANIFEST_DIR")).join("recordings/cup.mcap");
    std::fs::copy(shipped, &recording).unwrap();
    let trigger = {
        let recording = scand::recording::Recording::open(&recording).unwrap();
        let triggers = recording.messages(&scand::recording::Topic::Trigger);
        recording.trigger(&triggers[0]).unwrap()
    };
    let jobs = scand::workers::Jobs::open(&stand.path("recordings")).unwrap();
    let capture = trigger.id.to_string();
    let job = scand::workers::Job::new(&recording, &capture, trigger.time.0, "test");
    jobs.enqueue(&job).unwrap();
    // The model itself is of no interest: it may fail.
    let leave_free = |stand: &Stand, mb: u32| {
        let section = format!("[recording]\nkeep_free_mb = {mb}\n");
        let text = CONFIGURATION.replace("[recording]\n", &section);
        let text = format!("{text}[workers]\ntime_limit_s = 1\n");
        std::fs::write(stand.path("rig.toml"), text).unwrap();
    };
    leave_free(&stand, 1_000_000_000);
    stand.start(run());
    stand.until_logged("no model is made until 1000000000 MB are free");
    assert!(!stand.log().contains(&capture), "{}", stand.log());
    leave_free(&stand, 1);
    stand.signal("-HUP");
    stand.until_logged(&format!("capture {capture}: "));
    stand.end();
}

/// systemd's own judgement of the units, with the program of this build in the place of the installed one.
#[test]
fn the_units_are_sound_and_closed() {
    let folder = tempfile::tempdir().unwrap();
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("systemd");
    let analyze = |arguments: &[&str], units: &[&str]| {
        let mut command = Command::new("systemd-analyze");
        command.args(arguments);
        command.args(units.iter().map(|unit| folder.path().join(unit)));
        let output = command.output().expect("systemd-analyze (package systemd)");
        let text = [output.stdout, output.stderr].concat();
        (output.status.success(), String::from_utf8(text).unwrap())
    };
    let units = [
        "scand.service",
        "scand.socket",
        "scand-fleet.service",
        "scand-page.service",
        "scand-pedal@.service",
        "scand-worker@.service",
    ];
    for unit in units {
        let text = std::fs::read_to_string(source.join(unit)).unwrap();
        let program = env!("CARGO_BIN_EXE_scand");
        let text = text.replace("/usr/bin/scand-worker", program);
        let text = text.replace("/usr/bin/scand", program);
        std::fs::write(folder.path().join(unit), text).unwrap();
    }
    let (sound, words) = analyze(&["verify"], &units);
    assert!(sound && words.is_empty(), "{words}");
    let services = [
        "scand.service",
        "scand-fleet.service",
        "scand-page.service",
        "scand-pedal@.service",
        "scand-worker@.service",
    ];
    let (closed, words) = analyze(&["security", "--offline=true", "--threshold=20"], &services);
    assert!(closed, "{words}");
    // The same command can say no.
    let (_, words) = analyze(
        &["security", "--offline=true", "--threshold=5"],
        &services[..1],
    );
    assert!(words.contains("scand.service"), "{words}");
    let strict = analyze(
        &["security", "--offline=true", "--threshold=5"],
        &services[..1],
    )
    .0;
    assert!(!strict);
}

#[test]
fn a_foot_switch_that_is_none_is_refused() {
    let output = scand()
        .args(["pedal", "--device", "/dev/null"])
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(1));
    let words = String::from_utf8_lossy(&output.stderr);
    assert!(words.contains("/dev/null"), "{words}");
    let output = scand()
        .args(["pedal", "--device", "/dev/null", "--key", "KEY_NONE_SUCH"])
        .output();
    assert!(String::from_utf8_lossy(&output.unwrap().stderr).contains("KEY_NONE_SUCH"));
}

/// A foot switch of the kernel's own making that bounces, and a daemon of the test's.
#[test]
fn a_foot_switch_that_bounces_is_one_press() {
    use evdev::{AttributeSet, InputEvent, KeyCode, uinput::VirtualDevice};
    let keys = AttributeSet::from_iter([KeyCode::KEY_B]);
    let made =
        VirtualDevice::builder().and_then(|b| b.name("scand test").with_keys(&keys)?.build());
    let mut switch = match made {
        Ok(switch) => switch,
        Err(cause) => {
            return skip(
                Needed::InputDevices,
                format_args!("the kernel makes no input device: {cause}"),
            );
        }
    };
    let folder = tempfile::tempdir().unwrap();
    let socket = folder.path().join("scand.sock");
    let listener = std::os::unix::net::UnixListener::bind(&socket).unwrap();
    let (sender, requests) = std::sync::mpsc::sync_channel(16);
    std::thread::spawn(move || {
        for stream in listener.incoming() {
            let mut line = String::new();
            BufReader::new(stream.unwrap())
                .read_line(&mut line)
                .unwrap();
            sender.send(line).unwrap();
        }
    });
    let node = switch
        .enumerate_dev_nodes_blocking()
        .unwrap()
        .flatten()
        .next();
    let mut pedal = scand()
        .args(["pedal", "--device"])
        .arg(node.unwrap())
        .arg("--socket")
        .arg(&socket)
        .spawn()
        .unwrap();
    // It listens once it holds the device.
    assert!(requests.recv_timeout(LONG).unwrap().contains("events"));
    for value in [1, 0, 1, 0, 1] {
        let edge = InputEvent::new(evdev::EventType::KEY.0, KeyCode::KEY_B.code(), value);
        switch.emit(&[edge]).unwrap();
        std::thread::sleep(Duration::from_millis(10));
    }
    let mut presses = std::collections::BTreeSet::new();
    while let Ok(request) = requests.recv_timeout(Duration::from_secs(3)) {
        if request.contains("trigger") {
            presses.insert(request);
        }
    }
    assert_eq!(presses.len(), 1, "{presses:?}");
    drop(switch);
    // Its unit starts again when it is plugged in.
    assert!(pedal.wait().unwrap().success());
}

fn check(stand: &Stand, more: &[&str]) -> (Option<i32>, String) {
    let mut command = scand();
    command
        .args(["check", "--config", "rig.toml", "--no-speed"])
        .args(more);
    let output = command.current_dir(stand.folder.path()).output().unwrap();
    let words = String::from_utf8(output.stdout).unwrap();
    (output.status.code(), words)
}

#[test]
fn a_check_names_what_is_wrong_with_and_without_a_daemon() {
    let mut stand = Stand::new("");
    std::fs::create_dir(stand.path("recordings")).unwrap();
    let (code, words) = check(&stand, &[]);
    assert_eq!(code, Some(1), "{words}");
    for expected in [
        "ok     configuration: rig.toml, 2 cameras",
        "no daemon runs",
        "WRONG  camera c00: ",
        "/dev/none-1",
        "ok     recordings' folder",
        "WRONG  backgrounds: no backgrounds were taken\n       → clear the rig",
    ] {
        assert!(words.contains(expected), "{expected}: {words}");
    }
    let (code, words) = check(&stand, &["--json", "--set", "capture.retyr=1"]);
    let json: serde_json::Value = serde_json::from_str(&words).unwrap();
    assert_eq!(code, Some(78));
    assert_eq!(json["wrong"], true);
    assert!(
        json["findings"][0]["found"]
            .as_str()
            .unwrap()
            .contains("retyr"),
        "{json}"
    );
    let twice = ["--set", "v4l2.cameras.c01.device=/dev/none-0"];
    let (code, words) = check(&stand, &twice);
    assert_eq!(code, Some(78), "{words}");
    let named = "v4l2.cameras.c01: device \"/dev/none-0\" is already used by c00";
    assert!(words.contains(named), "{words}");
    stand.start(run());
    stand.until_logged("listening");
    let (code, words) = check(&stand, &["--bundle", "bundle.tar.zst"]);
    assert_eq!(code, Some(1));
    assert!(words.contains("ok     daemon: it answers on"), "{words}");
    assert!(words.contains("WRONG  camera c01: "), "{words}");
    let packed = std::fs::File::open(stand.path("bundle.tar.zst")).unwrap();
    let tar = zstd::decode_all(packed).unwrap();
    let holds = |text: &[u8]| tar.windows(text.len()).any(|window| window == text);
    for expected in [
        "check.txt",
        "status.json",
        "rig.toml",
        "calibration.toml",
        "/dev/none-0",
        "(commit ",
    ] {
        assert!(holds(expected.as_bytes()), "{expected}");
    }
}
