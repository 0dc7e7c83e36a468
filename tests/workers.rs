//! Worker processes beside a rig: the real program on a small recording, what happens when it exceeds its memory or
//! its daemon is killed, and what its confinement denies.

#![allow(clippy::disallowed_methods, reason = "a test's channel ends with it")]

#[path = "support/mod.rs"]
mod support;

use rustix::fs::{Mode, OFlags};
use rustix::process::Pid;
use scand::config::Config;
use scand::workers::object_protocol::{self, ObjectModelRequest};
use scand::workers::protocol::Confinement;
use scand::workers::{
    FinishedJob, Job, Jobs, Limits, Parameters, Remake, WorkerPlan, Workers, confine, start_models,
    start_remakes,
};
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream, UdpSocket};
use std::os::fd::AsRawFd;
use std::os::unix::fs::PermissionsExt;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use support::program::scand;
use support::torture::times;
use support::wait::until;

/// Says to a test's own process that it is to play another part, in this folder.
const PART: &str = "SCAND_TEST_WORKERS_PART";

/// A recording of two captures, simulated once.
fn simulated() -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let path = folder.join("workers.mcap");
    static ONE: Mutex<()> = Mutex::new(());
    let _one = ONE.lock();
    if !path.exists() {
        let own = folder.join(format!("workers-{}.mcap", std::process::id()));
        let made = scand()
            .args(["simulate", "--shape", "cup", "--cameras", "5"])
            .args(["--size", "320x240", "--captures", "2", "--masks"])
            .args(["--depth-frames", "10", "--encoding", "bayer"])
            .args([Path::new("--out"), &own])
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&made.stderr);
        assert!(made.status.success(), "{said}");
        std::fs::rename(&own, &path).unwrap();
    }
    path
}

/// The triggers of its captures, in nanoseconds, by their ids.
fn captures() -> [(String, u64); 2] {
    let recording = scand::recording::Recording::open(&simulated()).unwrap();
    let triggers = recording.messages(&scand::recording::Topic::Trigger);
    let captures = triggers.iter().map(|message| {
        let trigger = recording.trigger(message).unwrap();
        (trigger.id.to_string(), trigger.time.0)
    });
    captures.collect::<Vec<_>>().try_into().unwrap()
}

fn settings() -> String {
    let config = Config::load(None, &["hull.resolution=40".to_owned()]).unwrap();
    toml::to_string(&config.of_replay()).unwrap()
}

fn plan(folder: &Path, change: impl FnOnce(&mut Parameters)) -> WorkerPlan {
    let mut parameters = Parameters {
        folder: folder.join("models"),
        ..Parameters::default()
    };
    change(&mut parameters);
    WorkerPlan {
        parameters,
        settings: settings(),
        clock: scand::clock::Clock::system(),
        method: Default::default(),
        keep_free: Arc::default(),
        command: vec![env!("CARGO_BIN_EXE_scand").into(), "make-model".into()],
    }
}

fn jobs(folder: &Path) -> Arc<Jobs> {
    Arc::new(Jobs::open(&folder.join("recordings")).unwrap())
}

fn start(jobs: &Arc<Jobs>, plan: WorkerPlan) -> (Workers, Receiver<FinishedJob>) {
    let (ended, heard) = channel();
    let workers = start_models(jobs, plan, move |e| drop(ended.send(e)));
    (workers.unwrap(), heard)
}

fn next(heard: &Receiver<FinishedJob>) -> FinishedJob {
    heard.recv_timeout(Duration::from_secs(120)).unwrap()
}

/// A report without what may differ between two runs.
fn report(folder: &Path) -> serde_json::Value {
    let text = std::fs::read(folder.join("report.json")).unwrap();
    let mut report: serde_json::Value = serde_json::from_slice(&text).unwrap();
    report.as_object_mut().unwrap().remove("timing");
    report
}

#[test]
fn a_recording_in_progress_gives_the_model_that_a_replay_makes_when_it_is_complete() {
    let home = tempfile::tempdir().unwrap();
    let jobs = jobs(home.path());
    let path = home.path().join("recordings/cup.mcap");
    let part = home.path().join("recordings/cup.mcap.part");
    // As it is while its writer is at it: without its end.
    let bytes = std::fs::read(simulated()).unwrap();
    std::fs::write(&part, &bytes[..bytes.len() - 20]).unwrap();
    let writer = std::fs::File::open(&part).unwrap();
    writer.lock().unwrap();
    let [(capture, trigger_ns), _] = captures();
    let job = Job::new(&path, &capture, trigger_ns, "test");
    jobs.enqueue(&job).unwrap();
    let (_workers, heard) = start(&jobs, plan(home.path(), |_| ()));
    let ended = next(&heard);
    let model = ended.model.unwrap();
    assert_eq!(
        (ended.capture, ended.recording),
        (capture.clone(), path.clone())
    );
    assert_eq!(model.folder, home.path().join("models/cup").join(&capture));

    // Complete, it is replayed by hand, and offered once more.
    std::fs::write(&part, &bytes).unwrap();
    drop(writer);
    std::fs::rename(&part, &path).unwrap();
    let configuration = home.path().join("settings.toml");
    std::fs::write(&configuration, settings()).unwrap();
    let replayed = scand()
        .args([Path::new("--replay"), &path])
        .args([Path::new("--config"), &configuration])
        .args([Path::new("--out"), &home.path().join("out")])
        .args(["--capture", &capture, "--quiet"])
        .status();
    assert!(replayed.unwrap().success());
    let by_hand = home.path().join("out/cup").join(&capture);
    for file in ["model.glb", "model.ply", "preview.png"] {
        let same = [&model.folder, &by_hand].map(|f| std::fs::read(f.join(file)).unwrap());
        assert!(same[0] == same[1], "{file}");
    }
    assert_eq!(report(&model.folder), report(&by_hand));
    let made = std::fs::metadata(model.folder.join("model.glb")).unwrap();
    until("not finished", || jobs.backlog().done == 1);
    jobs.enqueue(&job).unwrap();
    assert_eq!(next(&heard).model.unwrap(), model);
    let found = std::fs::metadata(model.folder.join("model.glb")).unwrap();
    assert_eq!(made.modified().unwrap(), found.modified().unwrap());
}

#[test]
fn one_that_eats_memory_fails_alone() {
    let home = tempfile::tempdir().unwrap();
    let jobs = jobs(home.path());
    let path = home.path().join("recordings/cup.mcap");
    std::fs::copy(simulated(), &path).unwrap();
    for (capture, trigger_ns) in captures() {
        jobs.enqueue(&Job::new(&path, &capture, trigger_ns, "test"))
            .unwrap();
    }
    let few = plan(home.path(), |parameters| parameters.memory_mb = 64);
    let (workers, heard) = start(&jobs, few);
    let ended = next(&heard);
    let reason = ended.model.unwrap_err();
    assert!(reason.contains("workers.memory_mb is 64"), "{reason}");
    let folder = home.path().join("models/cup").join(&ended.capture);
    assert_eq!(report(&folder)["outcome"], "failed");
    assert_eq!(report(&folder)["reason"], reason.as_str());
    let words = std::fs::read_to_string(folder.join("worker.log")).unwrap();
    assert!(words.contains("memory allocation"), "{words}");
    workers.stop();
    let (_workers, heard) = start(&self::jobs(home.path()), plan(home.path(), |_| ()));
    assert!(next(&heard).model.is_ok());
}

#[test]
fn a_model_that_is_made_again_lies_beside_the_first() {
    let home = tempfile::tempdir().unwrap();
    let jobs = jobs(home.path());
    let path = home.path().join("recordings/cup.mcap");
    std::fs::copy(simulated(), &path).unwrap();
    let [(capture, trigger_ns), _] = captures();
    jobs.enqueue(&Job::new(&path, &capture, trigger_ns, "test"))
        .unwrap();
    let (remade, heard_remade) = channel();
    let settings = std::collections::BTreeMap::from([("hull.resolution".into(), 60.into())]);
    let remake = Remake::new(&capture, &settings).unwrap();
    // It is asked for first, and made last.
    jobs.remakes().enqueue(remake).unwrap();
    let (_workers, heard) = start(&jobs, plan(home.path(), |_| ()));
    let tell = move |news| drop(remade.send(news));
    let _remaking = start_remakes(&jobs, plan(home.path(), |_| ()), tell).unwrap();
    let first = next(&heard).model.unwrap();
    let before = std::fs::read(first.folder.join("model.glb")).unwrap();
    let second = heard_remade.recv_timeout(Duration::from_secs(120)).unwrap();
    assert_eq!(second.capture, capture);
    let folder = second.model.unwrap().folder;
    let expected = format!("{capture}.remake-1");
    assert_eq!(folder, home.path().join("models/cup").join(expected));
    let again = std::fs::read(folder.join("model.glb")).unwrap();
    assert!(again.len() > before.len());
    assert!(before == std::fs::read(first.folder.join("model.glb")).unwrap());
    let unknown = Remake::new("cup-999", &settings).unwrap();
    jobs.remakes().enqueue(unknown).unwrap();
    let none = heard_remade.recv_timeout(Duration::from_secs(120)).unwrap();
    assert!(none.model.unwrap_err().contains("no recording in"));
    assert!(!home.path().join("models/.remake").exists());
    until("not finished", || jobs.backlog().remakes == 0);
}

/// Makes the model of object 17 from a session's two recordings, as the daemon does, or finds poses alone: whether that
/// says that it worked, and its words.
fn make_object(home: &Path, registers: bool) -> (bool, String) {
    let recordings = ["a.mcap", "a-002.mcap"].map(|name| home.join(name));
    let (models, config) = (home.join("models"), home.join("settings.toml"));
    let request = ObjectModelRequest {
        confinement: Confinement {
            memory_mb: 2000,
            nice: 10,
        },
        recordings: &recordings,
        subject: "17",
        newest: "cup-000",
        registers,
        models: &models,
        config: &config,
    };
    let mut command = scand();
    command.arg(object_protocol::COMMAND);
    let made = command.args(request.arguments()).output().unwrap();
    let words = String::from_utf8_lossy(&made.stderr).into_owned();
    (made.status.success(), words)
}

#[test]
fn a_recording_that_cannot_be_read_takes_no_model_of_its_captures_away() {
    let home = tempfile::tempdir().unwrap();
    let [first, second] = ["a.mcap", "a-002.mcap"].map(|name| home.path().join(name));
    let simulated = scand()
        .args(["simulate", "--shape", "cup", "--cameras", "5", "--masks"])
        .args(["--size", "320x240", "--subject", "17"])
        .args([Path::new("--out"), &second])
        .status();
    assert!(simulated.unwrap().success());
    std::fs::write(&first, "no recording").unwrap();
    std::fs::write(home.path().join("settings.toml"), settings()).unwrap();
    let folder = home.path().join("models/a/17.object");
    std::fs::create_dir_all(&folder).unwrap();
    let earlier = |captures: &[&str]| {
        let of = |id: &&str| serde_json::json!({"id": id, "is_fused": true});
        let captures: Vec<serde_json::Value> = captures.iter().map(of).collect();
        let verdict = serde_json::json!({"level": "green", "reasons": []});
        let fusion = serde_json::json!({"captures": captures});
        let report = serde_json::json!({"outcome": "done", "verdict": verdict, "fusion": fusion});
        std::fs::write(folder.join("report.json"), report.to_string()).unwrap();
        std::fs::write(folder.join("model.glb"), "as it was").unwrap();
    };
    let model = || std::fs::read(folder.join("model.glb")).unwrap();

    earlier(&["a-0001", "cup-000"]);
    let (is_made, words) = make_object(home.path(), false);
    assert!(!is_made && model() == b"as it was", "{words}");
    assert!(words.contains("a.mcap is not an MCAP file"), "{words}");
    assert!(words.contains("made before stays"), "{words}");
    // It gets its final name just before it is opened: the daemon starts all of it again.
    let renamed = home.path().join("renamed");
    std::fs::rename(&first, &renamed).unwrap();
    for registers in [true, false] {
        let (is_done, words) = make_object(home.path(), registers);
        assert!(!is_done && model() == b"as it was", "{words}");
        assert!(!words.contains("scand: found:"), "{words}");
    }
    std::fs::rename(&renamed, &first).unwrap();

    // A model of other captures is made anew, and its report says what is missing.
    earlier(&["cup-000"]);
    let (is_made, words) = make_object(home.path(), false);
    assert!(is_made && model() != b"as it was", "{words}");
    let missing = serde_json::json!(["recording a.mcap cannot be read"]);
    assert_eq!(report(&folder)["fusion"]["not_used"], missing);
}

/// This test's own process again, in another part.
fn again(test: &str, folder: &Path) -> Command {
    let mut command = Command::new(std::env::current_exe().unwrap());
    command
        .args(["--exact", test, "--nocapture"])
        .env(PART, folder);
    command
}

/// The processes that work on a recording in a folder.
fn processes(folder: &Path) -> Vec<String> {
    let of_ours = |pid: &String| {
        let line = std::fs::read(Path::new("/proc").join(pid).join("cmdline"));
        let line = line.unwrap_or_default();
        let line = String::from_utf8_lossy(&line);
        line.contains("\0make-model\0") && line.contains(folder.to_str().unwrap())
    };
    let all = std::fs::read_dir("/proc").unwrap();
    all.filter_map(|p| p.unwrap().file_name().into_string().ok())
        .filter(of_ours)
        .collect()
}

struct Killed(Child);

impl Drop for Killed {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn a_killed_daemon_takes_its_processes_along_and_loses_no_job() {
    const NAME: &str = "a_killed_daemon_takes_its_processes_along_and_loses_no_job";
    if let Some(folder) = std::env::var_os(PART) {
        let folder = PathBuf::from(folder);
        let (_workers, heard) = start(&jobs(&folder), plan(&folder, |_| ()));
        heard.iter().for_each(drop);
        return;
    }
    let home = tempfile::tempdir().unwrap();
    let jobs = jobs(home.path());
    let path = home.path().join("recordings/cup.mcap");
    std::fs::copy(simulated(), &path).unwrap();
    for (capture, trigger_ns) in captures() {
        jobs.enqueue(&Job::new(&path, &capture, trigger_ns, "test"))
            .unwrap();
    }
    drop(jobs);
    let mut daemon = Killed(
        again(NAME, home.path())
            .stdout(Stdio::null())
            .spawn()
            .unwrap(),
    );
    until("nothing runs", || !processes(home.path()).is_empty());
    daemon.0.kill().unwrap();
    daemon.0.wait().unwrap();
    until("it goes on", || processes(home.path()).is_empty());
    let jobs = self::jobs(home.path());
    let waiting = jobs.backlog().waiting;
    assert!(waiting > 0);
    let (_workers, heard) = start(&jobs, plan(home.path(), |_| ()));
    for _ in 0..waiting {
        assert!(next(&heard).model.is_ok());
    }
    for (capture, _) in captures() {
        let folder = home.path().join("models/cup").join(&capture);
        assert_eq!(report(&folder)["outcome"], "done", "{capture}");
    }
}

#[test]
fn a_killed_worker_fails_its_job_alone_and_leaves_no_half_model() {
    let home = tempfile::tempdir().unwrap();
    let jobs = jobs(home.path());
    let path = home.path().join("recordings/cup.mcap");
    std::fs::copy(simulated(), &path).unwrap();
    let [(capture, trigger_ns), _] = captures();
    let job = Job::new(&path, &capture, trigger_ns, "test");
    let target = home.path().join("models/cup").join(&capture);
    let (_workers, heard) = start(&jobs, plan(home.path(), |_| ()));
    let (kills, mut killed) = (times(3, 20), 0);
    for kill in 0..kills {
        jobs.enqueue(&job).unwrap();
        until("nothing runs", || !processes(home.path()).is_empty());
        std::thread::sleep(Duration::from_millis(kill * 173 % 1500));
        for process in processes(home.path()) {
            let pid = rustix::process::Pid::from_raw(process.parse().unwrap()).unwrap();
            let _ = rustix::process::kill_process(pid, rustix::process::Signal::KILL);
        }
        match next(&heard).model {
            Ok(_) => {}
            Err(reason) => {
                assert!(reason.contains("signal 9"), "{reason}");
                assert_eq!(report(&target)["reason"], reason.as_str());
                assert!(!target.join("model.glb").exists());
                killed += 1;
            }
        }
        until("not finished", || {
            jobs.backlog().waiting == 0 && jobs.backlog().running.is_empty()
        });
        std::fs::remove_dir_all(&target).unwrap();
    }
    assert!(killed > 0, "no kill came in time");
    // The pool is as large as before.
    jobs.enqueue(&job).unwrap();
    assert!(next(&heard).model.is_ok());
    println!(
        "shown: {kills} kills of a worker: {killed} jobs failed with a report, 0 half models, the next one is made"
    );
}

/// A command about a file, by `fcntl` or `ioctl`, whose argument is a number or where numbers are; whether it was done.
#[allow(
    unsafe_code,
    reason = "no safe library says who gets the signals of a file"
)]
fn command(call: libc::c_long, file: &UnixStream, command: u32, argument: Argument) -> bool {
    let file = file.as_raw_fd();
    // SAFETY: the numbers outlive the call, which reads two of them at most.
    let done = unsafe {
        match argument {
            Argument::Number(number) => libc::syscall(call, file, command, number),
            Argument::At(numbers) => libc::syscall(call, file, command, numbers.as_ptr()),
        }
    };
    done == 0
}

enum Argument<'a> {
    Number(i32),
    At(&'a [i32; 2]),
}

/// What a process does to another one of its user without sending a signal by itself: it lets files send them, and
/// moves the other to other processors.
fn reach_for(process: Pid) -> Vec<(&'static str, bool)> {
    use Argument::{At, Number};
    const F_SETOWN: u32 = 8;
    const F_SETSIG: u32 = 10;
    const F_SETOWN_EX: u32 = 15;
    const FIOSETOWN: u32 = 0x8901;
    const SIOCSPGRP: u32 = 0x8902;
    const F_OWNER_PID: i32 = 1;
    let (file, _other_end) = UnixStream::pair().unwrap();
    let pid = process.as_raw_nonzero().get();
    let fcntl = |number, argument| command(libc::SYS_fcntl, &file, number, argument);
    let ioctl = |number| command(libc::SYS_ioctl, &file, number, At(&[pid, 0]));
    let processors = rustix::thread::sched_getaffinity(Some(process)).unwrap();
    let moved = rustix::thread::sched_setaffinity(Some(process), &processors);
    vec![
        ("fcntl F_SETOWN", fcntl(F_SETOWN, Number(pid))),
        (
            "fcntl F_SETOWN_EX",
            fcntl(F_SETOWN_EX, At(&[F_OWNER_PID, pid])),
        ),
        ("fcntl F_SETSIG", fcntl(F_SETSIG, Number(libc::SIGURG))),
        ("ioctl FIOSETOWN", ioctl(FIOSETOWN)),
        ("ioctl SIOCSPGRP", ioctl(SIOCSPGRP)),
        ("move its daemon to other processors", moved.is_ok()),
    ]
}

/// What a confined process tries, with what came of it: `may` or `may not`.
fn tries(folder: &Path, port: u16) -> Vec<(&'static str, bool)> {
    let (outside, recording) = (folder.join("outside"), folder.join("recording"));
    let inside = folder.join("inside");
    let parent = rustix::process::getppid().unwrap();
    let append = |path: &Path| {
        let file = std::fs::File::options().append(true).open(path);
        file.and_then(|mut file| file.write_all(b"x"))
    };
    // Opened for reading, and cut off on the way.
    let cutting = OFlags::RDONLY | OFlags::TRUNC;
    let shut = std::fs::Permissions::from_mode(0o777);
    let mut tries = vec![
        ("read its recording", std::fs::read(&recording).is_ok()),
        (
            "write its output",
            std::fs::write(inside.join("a"), "a").is_ok(),
        ),
        (
            "make a folder in it",
            std::fs::create_dir(inside.join("b")).is_ok(),
        ),
        (
            "rename in it",
            std::fs::rename(inside.join("b"), inside.join("c")).is_ok(),
        ),
        (
            "start a thread",
            std::thread::Builder::new().spawn(|| ()).is_ok(),
        ),
        (
            "ask how a file is open",
            rustix::fs::fcntl_getfl(std::io::stdin()).is_ok(),
        ),
        ("change its recording", append(&recording).is_ok()),
        (
            "remove its recording",
            std::fs::remove_file(&recording).is_ok(),
        ),
        (
            "cut a file off",
            rustix::fs::open(&recording, cutting, Mode::empty()).is_ok(),
        ),
        (
            "change rights",
            std::fs::set_permissions(&recording, shut).is_ok(),
        ),
        (
            "write elsewhere",
            std::fs::write(outside.join("a"), "a").is_ok(),
        ),
        (
            "make a folder elsewhere",
            std::fs::create_dir(outside.join("b")).is_ok(),
        ),
        (
            "move its output elsewhere",
            std::fs::rename(inside.join("a"), outside.join("a")).is_ok(),
        ),
        (
            "link to elsewhere",
            std::os::unix::fs::symlink(&outside, inside.join("l")).is_ok(),
        ),
        (
            "read other files",
            std::fs::read(outside.join("secret")).is_ok(),
        ),
        ("list other folders", std::fs::read_dir(&outside).is_ok()),
        ("speak TCP", TcpStream::connect(("127.0.0.1", port)).is_ok()),
        ("speak UDP", UdpSocket::bind("127.0.0.1:0").is_ok()),
        (
            "speak to a socket",
            UnixStream::connect(folder.join("socket")).is_ok(),
        ),
        (
            "start a program",
            Command::new("/bin/true").status().is_ok(),
        ),
        (
            "signal its daemon",
            rustix::process::test_kill_process(parent).is_ok(),
        ),
        (
            "take more memory",
            Vec::<u8>::new().try_reserve_exact(400 << 20).is_ok(),
        ),
        (
            "be nicer to itself",
            rustix::process::setpriority_process(None, 0).is_ok(),
        ),
    ];
    tries.extend(reach_for(parent));
    tries
}

#[test]
fn one_that_is_confined_reads_its_recording_writes_its_output_and_no_more() {
    const NAME: &str = "one_that_is_confined_reads_its_recording_writes_its_output_and_no_more";
    if let Some(folder) = std::env::var_os(PART) {
        let folder = PathBuf::from(folder);
        let port = std::fs::read_to_string(folder.join("port")).unwrap();
        let limits = Limits {
            memory_mb: 300,
            nice: 7,
        };
        let reads = [folder.join("recording")];
        let missing = confine(limits, &reads, &[folder.join("inside")]).unwrap();
        println!("\nmissing: {missing:?}");
        for (what, may) in tries(&folder, port.parse().unwrap()) {
            println!("{}: {what}", if may { "may" } else { "may not" });
        }
        println!("tried");
        // Waits to be looked at.
        let _ = std::io::stdin().read(&mut [0]);
        return;
    }
    let home = tempfile::tempdir().unwrap();
    for name in ["inside", "outside"] {
        std::fs::create_dir(home.path().join(name)).unwrap();
    }
    std::fs::write(home.path().join("recording"), "pictures").unwrap();
    std::fs::write(home.path().join("outside/secret"), "secret").unwrap();
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    std::fs::write(home.path().join("port"), port.to_string()).unwrap();
    let _socket = UnixListener::bind(home.path().join("socket")).unwrap();
    // An unconfined process may do all of it.
    assert!(TcpStream::connect(("127.0.0.1", port)).is_ok());
    assert!(UnixStream::connect(home.path().join("socket")).is_ok());
    for (what, may) in reach_for(rustix::process::getpid()) {
        assert!(may, "{what}");
    }

    let mut process = again(NAME, home.path())
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut output = std::io::BufReader::new(process.stdout.take().unwrap());
    let mut said = Vec::<String>::new();
    while said.last().is_none_or(|line| line != "tried") {
        let mut line = String::new();
        std::io::BufRead::read_line(&mut output, &mut line).unwrap();
        assert!(!line.is_empty(), "{said:?}");
        said.push(line.trim_end().to_owned());
    }
    let stat = std::fs::read_to_string(format!("/proc/{}/stat", process.id())).unwrap();
    let threads = format!("/proc/{}/task", process.id());
    // What was set is the thread's that confined itself. A thread that ended meanwhile, as the one of the trial does,
    // has no file any more.
    let of_threads: Vec<String> = std::fs::read_dir(threads)
        .unwrap()
        .filter_map(|thread| std::fs::read_to_string(thread.ok()?.path().join("stat")).ok())
        .collect();
    drop(process.stdin.take());
    assert!(process.wait().unwrap().success(), "{said:?}");
    let field = |stat: &String, number: usize| {
        let (_, rest) = stat.rsplit_once(") ").unwrap();
        rest.split(' ').nth(number - 3).unwrap().to_owned()
    };
    const BATCH: &str = "3";
    let niced = |stat: &String| field(stat, 19) == "7" && field(stat, 41) == BATCH;
    assert!(of_threads.iter().any(niced), "{stat}");

    let of = |prefix: &str| {
        let tried = said.iter().filter_map(|line| line.strip_prefix(prefix));
        tried.map(str::to_owned).collect::<Vec<_>>()
    };
    assert_eq!(of("missing: "), ["[]"], "this kernel");
    let may = [
        "read its recording",
        "write its output",
        "make a folder in it",
        "rename in it",
        "start a thread",
        "ask how a file is open",
    ];
    assert_eq!(of("may: "), may);
    assert_eq!(of("may not: ").len(), 23, "{said:?}");
    assert_eq!(
        std::fs::read(home.path().join("recording")).unwrap(),
        b"pictures"
    );
}

/// Whether `execve` of the x32 ABI comes as far as the kernel, which need not have it.
#[cfg(target_arch = "x86_64")]
#[allow(unsafe_code, reason = "no library makes this call")]
fn x32_is_open() -> bool {
    const EXECVE: libc::c_long = 0x4000_0000 | 520;
    let nothing = std::ptr::null::<u8>();
    // SAFETY: no program has no name: the call fails in any case, and reads nothing.
    let failed = unsafe { libc::syscall(EXECVE, nothing, nothing, nothing) } < 0;
    assert!(failed);
    std::io::Error::last_os_error().raw_os_error() != Some(libc::EPERM)
}

#[cfg(target_arch = "x86_64")]
#[test]
fn one_that_is_confined_has_no_way_around_by_the_numbers_of_another_abi() {
    const NAME: &str = "one_that_is_confined_has_no_way_around_by_the_numbers_of_another_abi";
    if std::env::var_os(PART).is_some() {
        let limits = Limits {
            memory_mb: 300,
            nice: 7,
        };
        confine(limits, &[], &[]).unwrap();
        assert!(!x32_is_open());
        return;
    }
    assert!(x32_is_open());
    let home = tempfile::tempdir().unwrap();
    let process = again(NAME, home.path()).output().unwrap();
    let said = String::from_utf8_lossy(&process.stdout);
    assert!(
        process.status.success() && said.contains("1 passed"),
        "{said}"
    );
}
