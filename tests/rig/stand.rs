//! The processes of a rig: the cameras and the daemon, and the requests that a test sends to them.

use super::stage;
pub use crate::support::program::scand;
use crate::support::wait::until_or;
use scand::trigger::{Client, Reply, Request, Until};
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::Mutex;
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

/// The program under test.
/// The recording that the cameras play, and the true surface of what it shows; simulated once.
pub fn served() -> (PathBuf, PathBuf) {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let (path, truth) = (folder.join("served.mcap"), folder.join("served.ply"));
    static ONE: Mutex<()> = Mutex::new(());
    let _one = ONE.lock();
    if !path.exists() || !truth.exists() {
        // Under names of this process's own first: other tests may do the same now.
        let own = |name: &str| folder.join(format!("{}-{name}", std::process::id()));
        let (own_path, own_truth) = (own("served.mcap"), own("served.ply"));
        let made = scand()
            .args([
                "simulate",
                "--shape",
                "cup",
                "--cameras",
                "11",
                "--size",
                "640x480",
            ])
            .args(["--encoding", "bayer", "--seed", "3"])
            .args([
                Path::new("--out"),
                &own_path,
                Path::new("--truth"),
                &own_truth,
            ])
            .output()
            .unwrap();
        assert!(
            made.status.success(),
            "{}",
            String::from_utf8_lossy(&made.stderr)
        );
        std::fs::rename(&own_truth, &truth).unwrap();
        std::fs::rename(&own_path, &path).unwrap();
    }
    (path, truth)
}

pub struct Stand {
    folder: Option<tempfile::TempDir>,
    cameras: Child,
    said: Mutex<(ChildStdin, Receiver<String>)>,
    daemon: Child,
    settings: Vec<String>,
    libraries: PathBuf,
    slow: Option<Duration>,
}

impl Drop for Stand {
    fn drop(&mut self) {
        let _ = self.daemon.kill();
        let _ = self.cameras.kill();
        let _ = (self.daemon.wait(), self.cameras.wait());
    }
}

impl Stand {
    /// Starts cameras and daemon, in a folder of their own, and waits until all cameras are ready.
    pub fn start(settings: &[&str]) -> Self {
        Self::start_in(tempfile::tempdir().unwrap(), settings, None)
    }

    /// The same with a disk that takes so much longer for each fdatasync.
    pub fn start_on_slow_disk(settings: &[&str], longer: Duration) -> Self {
        Self::start_in(tempfile::tempdir().unwrap(), settings, Some(longer))
    }

    /// The same with recordings on a disk of so many megabytes. Needs a mount namespace, in which a test in a network
    /// of its own is root.
    pub fn start_on_small_disk(settings: &[&str], megabytes: u32) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let disk = folder.path().join("recordings");
        std::fs::create_dir(&disk).unwrap();
        let mounted = Command::new("mount")
            .args(["-t", "tmpfs", "-o", &format!("size={megabytes}m"), "tmpfs"])
            .arg(&disk)
            .status();
        assert!(
            mounted.unwrap().success(),
            "a small disk (mount namespaces)"
        );
        Self::start_in(folder, settings, None)
    }

    fn start_in(folder: tempfile::TempDir, settings: &[&str], slow: Option<Duration>) -> Self {
        let (recording, _) = served();
        let path = folder.path();
        let config = include_str!("../../config/loopback.toml");
        std::fs::write(path.join("rig.toml"), config).unwrap();
        let info = scand()
            .arg("info")
            .args([
                &recording,
                Path::new("--calibration"),
                &path.join("calibration.toml"),
            ])
            .output();
        assert!(info.unwrap().status.success());
        let mut cameras = scand()
            .args(["simulate", "--serve"])
            .arg(&recording)
            .args([Path::new("--sensor-frames"), &path.join("frames")])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let (lines, said) = channel();
        let output = BufReader::new(cameras.stdout.take().unwrap());
        std::thread::spawn(move || {
            output
                .lines()
                .map_while(Result::ok)
                .try_for_each(|l| lines.send(l))
        });
        while said.recv_timeout(Duration::from_secs(60)).unwrap() != "serving" {}
        let input = cameras.stdin.take().unwrap();
        let libraries = stage::folder();
        let settings: Vec<String> = settings.iter().map(ToString::to_string).collect();
        let daemon = run(path, &libraries, &settings, slow);
        let stand = Self {
            folder: Some(folder),
            cameras,
            said: Mutex::new((input, said)),
            daemon,
            settings,
            libraries,
            slow,
        };
        stand.until_ready();
        stand
    }

    fn path(&self) -> &Path {
        self.folder.as_ref().unwrap().path()
    }

    /// What the daemon said.
    pub fn log(&self) -> String {
        std::fs::read_to_string(self.path().join("daemon.log")).unwrap_or_default()
    }

    fn until(&self, what: &str, reached: impl Fn() -> bool) {
        until_or(what, || self.log(), reached);
    }

    fn until_ready(&self) {
        self.until("the cameras are not ready", || {
            let status = self.try_status();
            let cameras = status.as_ref().and_then(|s| s["cameras"].as_object());
            cameras.is_some_and(|c| c.len() == 12 && c.values().all(|c| c["state"] == "ready"))
        });
    }

    /// Says something to the cameras and waits until it is done.
    pub fn tell(&self, words: &str) {
        let mut said = self.said.lock().unwrap();
        writeln!(said.0, "{words}").unwrap();
        let answer = said.1.recv_timeout(Duration::from_secs(60)).unwrap();
        assert_eq!(answer, "ok", "{words}");
    }

    /// A connection to the daemon.
    pub fn client(&self) -> Result<Client, scand::trigger::Error> {
        Client::connect(
            &self.path().join("scand.sock"),
            Some(Duration::from_secs(60)),
        )
    }

    fn try_status(&self) -> Option<serde_json::Value> {
        let mut client = self.client().ok()?;
        client.send(&Request::Status {}).ok()?;
        match client.reply().ok()? {
            Reply::Status { status } => Some(status),
            _ => None,
        }
    }

    pub fn status(&self) -> serde_json::Value {
        self.try_status().unwrap()
    }

    /// Asks for a capture without waiting for anything.
    pub fn begin_press(&self) -> Client {
        self.begin_press_of(None)
    }

    /// The same for an object.
    pub fn begin_press_of(&self, subject: Option<&str>) -> Client {
        let mut client = self.client().unwrap();
        let trigger = Request::Trigger {
            source: "test".into(),
            press_id: None,
            subject: subject.map(str::to_owned),
            placement: None,
            until: Until::Durable,
        };
        client.send(&trigger).unwrap();
        client
    }

    /// Asks for a capture of an object until one is durable; its name.
    pub fn press_of(&self, subject: &str) -> String {
        loop {
            let mut client = self.begin_press_of(Some(subject));
            let last = loop {
                let reply = client.reply();
                let reply = reply.unwrap_or_else(|e| panic!("{e}: {}", self.log()));
                if reply.is_end(Until::Durable) {
                    break reply;
                }
            };
            match last {
                Reply::Durable { capture, .. } => return capture,
                // The thread that took the one before may not have said yet that it is free.
                Reply::Busy => std::thread::sleep(Duration::from_millis(5)),
                other => panic!("{other:?}: {}", self.log()),
            }
        }
    }

    /// A connection that hears all events.
    pub fn listen(&self) -> Client {
        const LONGEST: Duration = Duration::from_secs(600);
        let mut client = Client::connect(&self.path().join("scand.sock"), Some(LONGEST)).unwrap();
        client.send(&Request::Events {}).unwrap();
        assert_eq!(client.reply().unwrap(), Reply::Listening);
        client
    }

    /// Asks for a capture; how that ended.
    pub fn press(&self) -> Reply {
        self.press_timed().pop().unwrap().0
    }

    /// Asks for a capture; all that was answered, and how long after the press.
    pub fn press_timed(&self) -> Vec<(Reply, Duration)> {
        loop {
            let begin = Instant::now();
            let mut client = self.begin_press();
            let mut replies = Vec::new();
            while !replies
                .last()
                .is_some_and(|(r, _): &(Reply, _)| r.is_end(Until::Durable))
            {
                let reply = client.reply();
                let reply = reply.unwrap_or_else(|e| panic!("{e}: {}", self.log()));
                replies.push((reply, begin.elapsed()));
            }
            // The thread that took the one before may not have said yet that it is free.
            if replies[0].0 != Reply::Busy {
                return replies;
            }
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    /// Presses until a capture is whole again, as it must be within a while.
    pub fn until_durable(&self) {
        self.until("no capture is whole", || {
            matches!(self.press(), Reply::Durable { .. })
        });
    }

    /// Asks for what is no capture, which must be done.
    pub fn ask_done(&self, request: &Request) {
        let mut client = self.client().unwrap();
        client.send(request).unwrap();
        let reply = client.reply().unwrap();
        assert!(
            matches!(reply, Reply::Ok { .. }),
            "{reply:?}: {}",
            self.log()
        );
    }

    /// Waits until the status of the models is so.
    pub fn until_models(&self, what: &str, reached: impl Fn(&serde_json::Value) -> bool) {
        self.until(what, || {
            self.try_status()
                .is_some_and(|status| reached(&status["models"]))
        });
    }

    /// Bytes of memory that the daemon has.
    pub fn daemon_memory(&self) -> u64 {
        let statm = format!("/proc/{}/statm", self.daemon.id());
        let statm = std::fs::read_to_string(statm).unwrap();
        let pages: u64 = statm.split_whitespace().nth(1).unwrap().parse().unwrap();
        pages * 4096
    }

    /// Bytes of memory, open files and threads that the daemon has.
    pub fn daemon_holds(&self) -> (u64, usize, usize) {
        let count = |what: &str| {
            let folder = format!("/proc/{}/{what}", self.daemon.id());
            std::fs::read_dir(folder).unwrap().count()
        };
        (self.daemon_memory(), count("fd"), count("task"))
    }

    /// Where it records.
    pub fn recordings(&self) -> PathBuf {
        self.path().join("recordings")
    }

    /// Fills the disk but for `left` bytes while a capture is being taken; how that ended.
    pub fn fill_disk_while_capturing(&self, left: u64) -> Reply {
        let filler = self.path().join("recordings/filler");
        let file = std::fs::File::create(&filler).unwrap();
        let free = || scand::storage::free_bytes(&self.path().join("recordings")).unwrap();
        let zeros = vec![0; 1 << 20];
        let fill = |left| while free() > left && (&file).write_all(&zeros).is_ok() {};
        // What a press is accepted with stays until it is: the rest must be gone before its frames are there.
        fill(left + 32_000_000);
        let mut client = self.begin_press();
        let accepted = client.reply().unwrap();
        assert!(matches!(accepted, Reply::Accepted { .. }), "{accepted:?}");
        fill(left);
        loop {
            let reply = client.reply().unwrap();
            if reply.is_end(Until::Durable) {
                return reply;
            }
        }
    }

    pub fn remove_filler(&self) {
        std::fs::remove_file(self.path().join("recordings/filler")).unwrap();
    }

    /// Kills the daemon as a power cut would, starts it again and waits for its cameras.
    pub fn kill_and_restart(&mut self) {
        self.daemon.kill().unwrap();
        self.daemon.wait().unwrap();
        self.daemon = run(self.path(), &self.libraries, &self.settings, self.slow);
        self.until_ready();
    }

    /// Ends the daemon as systemd does, and the cameras; what was recorded.
    pub fn end(mut self) -> tempfile::TempDir {
        self.terminate();
        self.ended()
    }

    /// The same while a press is being carried out: what its client hears last.
    pub fn end_during(mut self, mut press: Client) -> (Reply, tempfile::TempDir) {
        self.terminate();
        let end = loop {
            let reply = press.reply();
            let reply = reply.unwrap_or_else(|e| panic!("{e}: {}", self.log()));
            if reply.is_end(Until::Durable) {
                break reply;
            }
        };
        (end, self.ended())
    }

    fn terminate(&self) {
        let pid = self.daemon.id().to_string();
        let sent = Command::new("kill").args(["-TERM", &pid]).status();
        assert!(sent.unwrap().success());
    }

    fn ended(&mut self) -> tempfile::TempDir {
        let ended = self.daemon.wait().unwrap();
        assert!(ended.success(), "{}", self.log());
        self.folder.take().unwrap()
    }
}

fn run(folder: &Path, libraries: &Path, settings: &[String], slow: Option<Duration>) -> Child {
    let log = std::fs::File::options()
        .append(true)
        .create(true)
        .open(folder.join("daemon.log"))
        .unwrap();
    let mut command = slow.map_or_else(scand, traced);
    command
        .args(["run", "--config", "rig.toml"])
        .current_dir(folder);
    // Models cost time; a test that wants them says so.
    command.args(["--set", "workers.count=0"]);
    for setting in settings {
        command.args(["--set", setting]);
    }
    command
        .env("LD_LIBRARY_PATH", libraries)
        .env("SCAND_OPENNI2_FRAMES", folder.join("frames"))
        .stderr(log)
        .spawn()
        .unwrap()
}

/// The program, traced by a grandchild that delays each fdatasync.
fn traced(longer: Duration) -> Command {
    let mut strace = Command::new("strace");
    strace
        .args(["-D", "-f", "--seccomp-bpf", "-qq", "-o", "/dev/null"])
        .args(["-e", "trace=fdatasync", "-e"])
        .arg(format!(
            "inject=fdatasync:delay_enter={}",
            longer.as_micros()
        ))
        .arg(env!("CARGO_BIN_EXE_scand"));
    strace
}
