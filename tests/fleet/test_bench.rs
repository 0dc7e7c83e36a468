//! A server with a store in a temporary folder, workers, and small recordings. Everything ends with its test.

use crate::support::program::scand;
use crate::support::skipped::{Needed, skip};
use crate::support::wait::until;
use serde_json::Value;
use std::collections::BTreeMap;
use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Output, Stdio};
use std::sync::Mutex;
use std::time::{Duration, Instant};

/// The server, as Debian installs it.
const SERVER: &str = "nats-server";

/// A process that ends with its test.
pub struct Process(pub Child);

impl Process {
    pub fn signal(&self, signal: rustix::process::Signal) {
        let id = rustix::process::Pid::from_child(&self.0);
        rustix::process::kill_process(id, signal).unwrap();
    }

    /// Waits for its end, and kills it if that takes too long.
    pub fn wait(&mut self) -> ExitStatus {
        wait(&mut self.0)
    }

    /// Ends it at once.
    pub fn kill(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        self.kill();
    }
}

/// A server and a folder for all that a test makes.
pub struct TestBench {
    home: tempfile::TempDir,
    pub port: u16,
    server: Mutex<Option<Process>>,
    /// More of its configuration.
    configuration: String,
}

/// A port that nobody has now.
pub fn free_port() -> u16 {
    let listener = TcpListener::bind(("127.0.0.1", 0)).unwrap();
    listener.local_addr().unwrap().port()
}

/// Runs what a test says to the server itself, on the test's own thread.
pub fn runtime() -> tokio::runtime::Runtime {
    let mut builder = tokio::runtime::Builder::new_current_thread();
    builder.enable_all().build().unwrap()
}

/// Whether there is a server to start; says so if there is none.
pub fn has_server() -> bool {
    let found = Command::new(SERVER).arg("--version").output();
    match found {
        Ok(_) => true,
        Err(error) => {
            skip(
                Needed::NatsServer,
                format!("{SERVER} cannot be run: {error}"),
            );
            false
        }
    }
}

impl TestBench {
    /// Starts a server; `None` on a machine that has none.
    pub fn start(configuration: &str) -> Option<Self> {
        let bench = Self::without_server(configuration)?;
        bench.start_server();
        Some(bench)
    }

    /// Prepares everything and starts nothing.
    pub fn without_server(configuration: &str) -> Option<Self> {
        has_server().then(|| Self {
            home: tempfile::tempdir().unwrap(),
            port: free_port(),
            server: Mutex::default(),
            configuration: configuration.into(),
        })
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.home.path().join(name)
    }

    pub fn address(&self) -> String {
        format!("nats://127.0.0.1:{}", self.port)
    }

    pub fn start_server(&self) {
        self.start_server_with("8GB");
    }

    /// Starts a server that may store so much.
    pub fn start_server_with(&self, storage: &str) {
        let file = self.path("server.conf");
        let store = self.path("store");
        let port = self.port;
        let store = store.display();
        let text = format!(
            "listen: \"127.0.0.1:{port}\"\njetstream {{ store_dir: \"{store}\", max_file_store: {storage} }}\n{}",
            self.configuration
        );
        std::fs::write(&file, text).unwrap();
        let log = std::fs::File::options()
            .create(true)
            .append(true)
            .open(self.path("server.log"));
        let process = Command::new(SERVER)
            .arg("--config")
            .arg(&file)
            .stdout(Stdio::null())
            .stderr(log.unwrap())
            .spawn();
        *self.server.lock().unwrap() = Some(Process(process.unwrap()));
        until("the server listens", || {
            TcpStream::connect(("127.0.0.1", port)).is_ok()
        });
    }

    /// Kills the server as a power cut does.
    pub fn kill_server(&self) {
        *self.server.lock().unwrap() = None;
    }

    /// Loses all that the server has stored.
    pub fn wipe_store(&self) {
        std::fs::remove_dir_all(self.path("store")).unwrap();
    }

    /// Starts a worker.
    pub fn worker(&self, name: &str, arguments: &[&str]) -> Process {
        self.worker_in(name, &self.path("scratch"), arguments)
    }

    /// Starts a worker whose files are in a folder.
    pub fn worker_in(&self, name: &str, scratch: &Path, arguments: &[&str]) -> Process {
        let mut command = self.worker_command(name, &self.address(), arguments);
        command.arg("--scratch").arg(scratch);
        Process(self.logged(command, name).spawn().unwrap())
    }

    /// What starts a worker of the server at an address.
    pub fn worker_command(&self, name: &str, address: &str, arguments: &[&str]) -> Command {
        let mut command = program();
        command.args(["worker", "--fleet", address, "--name", name]);
        command.args(arguments);
        command
    }

    /// Sends what a process says to a file of this name.
    pub fn logged(&self, mut command: Command, name: &str) -> Command {
        let log = std::fs::File::options()
            .create(true)
            .append(true)
            .open(self.path(&format!("{name}.log")))
            .unwrap();
        command.stdout(log.try_clone().unwrap()).stderr(log);
        command
    }

    pub fn log(&self, name: &str) -> String {
        std::fs::read_to_string(self.path(&format!("{name}.log"))).unwrap_or_default()
    }

    /// A replay by the fleet, or here.
    pub fn replay(&self, recording: &Path, out: &str, arguments: &[&str]) -> Command {
        let mut command = program();
        command
            .arg("--replay")
            .arg(recording)
            .args(["--set", "hull.resolution=24"]);
        command
            .arg("--out")
            .arg(self.path(out))
            .arg("--json")
            .args(arguments);
        command
    }

    pub fn by_fleet(&self, recording: &Path, out: &str, arguments: &[&str]) -> Command {
        let mut command = self.replay(recording, out, arguments);
        command.args(["--fleet", &self.address(), "--name", "archive"]);
        command
    }
}

/// The program, under the name that tests give it.
pub fn program() -> Command {
    let mut command = scand();
    command.env("SCAND_FLEET_TEST_PROGRAM", "one");
    command
}

/// A recording of small captures, simulated once for each number of them.
pub fn simulated(captures: usize) -> PathBuf {
    simulated_of(captures, "96x72")
}

/// The same of pictures of another size.
pub fn simulated_of(captures: usize, size: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let size_of_name = if size == "96x72" {
        String::new()
    } else {
        format!("-{size}")
    };
    let path = folder.join(format!("fleet-{captures}{size_of_name}.mcap"));
    static ONE: Mutex<()> = Mutex::new(());
    let _one = ONE.lock();
    if !path.exists() {
        let own = folder.join(format!("making-{captures}-{}.mcap", std::process::id()));
        let made = scand()
            .args([
                "simulate",
                "--shape",
                "ball",
                "--cameras",
                "4",
                "--size",
                size,
            ])
            .args([
                "--captures",
                &captures.to_string(),
                "--masks",
                "--depth-cameras",
                "0",
            ])
            .args([Path::new("--out"), &own])
            .output()
            .unwrap();
        assert!(made.status.success(), "{}", said(&made));
        std::fs::rename(&own, &path).unwrap();
    }
    path
}

/// How long any process of a test may take.
const LIMIT: Duration = Duration::from_secs(600);

fn wait(child: &mut Child) -> ExitStatus {
    let end = Instant::now() + LIMIT;
    loop {
        if let Some(status) = child.try_wait().unwrap() {
            return status;
        }
        if Instant::now() > end {
            child.kill().unwrap();
        }
        std::thread::sleep(Duration::from_millis(50));
    }
}

/// The output of a process that says no more than a pipe holds.
pub fn finished(mut child: Child) -> Output {
    wait(&mut child);
    child.wait_with_output().unwrap()
}

pub fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// What was told of each capture.
pub fn told(output: &Output) -> Vec<Value> {
    let text = String::from_utf8_lossy(&output.stdout);
    text.lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect()
}

/// All models below a folder by capture, but for what their reports say of the run.
pub fn models(out: &Path) -> BTreeMap<String, BTreeMap<String, Vec<u8>>> {
    let mut models = BTreeMap::new();
    for of in std::fs::read_dir(out).unwrap() {
        let of = of.unwrap().path();
        if !of.is_dir() || of.file_name().unwrap().to_string_lossy().starts_with('.') {
            continue;
        }
        for model in std::fs::read_dir(of).unwrap() {
            let folder = model.unwrap().path();
            let name = folder.file_name().unwrap().to_string_lossy().into_owned();
            if !folder.is_dir() {
                let is_origin = name.starts_with('.') && name.ends_with(".fleet");
                assert!(is_origin, "{name} is left over");
                continue;
            }
            assert!(!name.starts_with('.'), "{name} is unfinished");
            models.insert(name, files(&folder));
        }
    }
    models
}

fn files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut files = BTreeMap::new();
    for file in std::fs::read_dir(folder).unwrap() {
        let path = file.unwrap().path();
        let mut bytes = std::fs::read(&path).unwrap();
        if path.ends_with("report.json") {
            let mut report: Value = serde_json::from_slice(&bytes).unwrap();
            report.as_object_mut().unwrap().remove("timing");
            bytes = report.to_string().into_bytes();
        }
        files.insert(
            path.file_name().unwrap().to_string_lossy().into_owned(),
            bytes,
        );
    }
    files
}

/// The models of a recording as they are made here.
pub fn made_here(
    bench: &TestBench,
    recording: &Path,
) -> BTreeMap<String, BTreeMap<String, Vec<u8>>> {
    let output = bench
        .replay(recording, "here", &["--quiet"])
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", said(&output));
    models(&bench.path("here"))
}

/// Starts a command whose output is read at its end, by [`finished`].
pub fn spawned(mut command: Command) -> Child {
    command.stdout(Stdio::piped()).stderr(Stdio::piped());
    command.spawn().unwrap()
}
