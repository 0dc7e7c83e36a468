//! Tests disasters at any moment: the daemon is killed, the power is cut, the disk refuses a write. A capture of which
//! a client was told `durable` exists after the next start, once and complete, and the start repairs the rest by
//! itself. `make torture` asks for more of each.

use super::scripted::{Behaviour, captures, recordings};
use super::service_tests::{
    Dice, PATIENCE, be_a_daemon, daemon, daemon_by, inside, is_durable, replies, service_over,
    times, trigger,
};
use crate::recording::{CaptureOutcome, Topic, unfinished};
use crate::support::skipped::{Needed, skip};
use crate::trigger::{Client, Reply, Request, Until};
use std::collections::BTreeMap;
use std::os::fd::AsRawFd;
use std::path::{Path, PathBuf};
use std::process::{Child, Command};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Duration;

/// All that clients were told, by the names of their presses.
type Told = BTreeMap<String, Vec<Reply>>;

fn connect(socket: &Path) -> Client {
    Client::connect(socket, Some(PATIENCE)).unwrap()
}

/// Presses with new ids until no daemon answers. Replies that arrive when it is `over` are ignored.
fn press_on(socket: &Path, names: &AtomicUsize, over: &AtomicBool) -> Told {
    let mut told = Told::new();
    let mut name = format!("p-{}", names.fetch_add(1, Ordering::Relaxed));
    while let Ok(mut client) = Client::connect(socket, Some(PATIENCE)) {
        if client.send(&trigger(Some(&name), Until::Durable)).is_err() {
            break;
        }
        let mut heard = Vec::new();
        while !heard
            .last()
            .is_some_and(|r: &Reply| r.is_end(Until::Durable))
        {
            match client.reply() {
                Ok(reply) if !over.load(Ordering::Acquire) => heard.push(reply),
                _ => break,
            }
        }
        if let [Reply::Busy | Reply::Refused { .. }] = heard[..] {
            std::thread::sleep(Duration::from_millis(1));
            continue;
        }
        if !heard.is_empty() {
            told.insert(name, heard);
        }
        name = format!("p-{}", names.fetch_add(1, Ordering::Relaxed));
    }
    told
}

/// Two clients press until the disaster, which comes after some time; what they were told before it.
fn told_until(
    socket: &Path,
    names: &AtomicUsize,
    after: Duration,
    disaster: impl FnOnce(),
) -> Told {
    let over = AtomicBool::new(false);
    std::thread::scope(|scope| {
        let clients = [(); 2].map(|()| scope.spawn(|| press_on(socket, names, &over)));
        std::thread::sleep(after);
        over.store(true, Ordering::Release);
        disaster();
        let told = clients.into_iter().map(|c| c.join().unwrap());
        told.flatten().collect()
    })
}

fn end(mut process: Child) {
    process.kill().unwrap();
    process.wait().unwrap();
}

/// What was acknowledged as durable is in the recordings, once and complete; all of them are complete, and none is left
/// unfinished.
fn check_recordings(folder: &Path, told: &Told) {
    assert_eq!(unfinished(folder).unwrap(), Vec::<PathBuf>::new());
    let mut taken = BTreeMap::<String, usize>::new();
    for recording in recordings(folder) {
        assert_eq!(recording.verify().unwrap(), [], "{:?}", recording.path());
        for (id, outcome, ..) in captures(&recording) {
            if outcome == CaptureOutcome::Complete {
                *taken.entry(id).or_default() += 1;
            }
        }
    }
    for (name, heard) in told {
        if let Some(Reply::Durable { capture, .. }) = heard.last() {
            assert_eq!(taken.get(capture), Some(&1), "{name}: {capture}");
        }
    }
}

fn durable(told: &Told) -> usize {
    told.values().filter(|heard| is_durable(heard)).count()
}

#[test]
fn kills_at_random_moments_lose_nothing_that_a_client_was_told() {
    if let Some(folder) = inside() {
        be_a_daemon(&folder, Behaviour::Sound);
    }
    let test =
        "daemon::disaster_tests::kills_at_random_moments_lose_nothing_that_a_client_was_told";
    let folder = tempfile::tempdir().unwrap();
    let (kills, names) = (times(4, 60), AtomicUsize::new(0));
    let (mut told, mut dice) = (Told::new(), Dice(11));
    for _ in 0..kills {
        let (process, socket) = daemon(test, folder.path());
        let after = Duration::from_millis(1 + dice.below(200));
        let of_this = told_until(&socket, &names, after, || end(process));
        // A client that asks again gets the same, and a final answer that stays.
        let (process, socket) = daemon(test, folder.path());
        for (name, heard) in &of_this {
            let ask = || replies(&mut connect(&socket), &trigger(Some(name), Until::Durable));
            let again = ask();
            assert!(again.starts_with(heard), "{name}: {heard:?}, {again:?}");
            assert_eq!(ask(), again, "{name}");
        }
        end(process);
        told.extend(of_this);
    }
    let service = service_over(folder.path(), |_| ());
    service.stand.stop();
    check_recordings(&folder.path().join("recordings"), &told);
    let (presses, durable) = (told.len(), durable(&told));
    assert!(durable > 0, "{durable} of {presses}");
    println!(
        "shown: {kills} kills of the daemon, {presses} presses: 0 of {durable} durable captures lost, {} cut short and told \
         so",
        presses - durable
    );
}

/// A file system of its own, in a file. Gone when it is dropped.
struct Disk {
    image: PathBuf,
    at: PathBuf,
}

impl Drop for Disk {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg("-l").arg(&self.at).output();
    }
}

impl Disk {
    /// Makes and mounts it; `None` where that needs rights that this process has not.
    fn new(folder: &Path) -> Option<Self> {
        let (image, at) = (folder.join("disk"), folder.join("recordings"));
        std::fs::create_dir(&at).unwrap();
        let file = std::fs::File::create(&image).unwrap();
        file.set_len(256 << 20).unwrap();
        let made = Command::new("mkfs.ext4")
            .args(["-q", "-F"])
            .arg(&image)
            .output();
        let disk = Self { image, at };
        let done = made.is_ok_and(|m| m.status.success()) && disk.mount();
        done.then_some(disk)
    }

    fn mount(&self) -> bool {
        let mount = Command::new("mount")
            .args(["-o", "loop"])
            .args([&self.image, &self.at])
            .output();
        mount.is_ok_and(|m| m.status.success())
    }

    /// Cuts its power: from now on nothing reaches it, not even what waits in the kernel (`EXT4_IOC_SHUTDOWN` without
    /// flushing the log).
    #[allow(unsafe_code)] // The call has no safe form.
    fn cut(&self) {
        const SHUTDOWN: libc::Ioctl = 0x8004_587d_u32 as libc::Ioctl;
        let no_log_flush: u32 = 2;
        let root = std::fs::File::open(&self.at).unwrap();
        // SAFETY: the call reads one u32 behind the pointer.
        let done = unsafe { libc::ioctl(root.as_raw_fd(), SHUTDOWN, &raw const no_log_flush) };
        assert_eq!(done, 0, "{}", std::io::Error::last_os_error());
    }

    /// The machine starts again.
    fn again(&self) {
        let unmounted = Command::new("umount").arg(&self.at).output().unwrap();
        assert!(unmounted.status.success(), "{unmounted:?}");
        assert!(self.mount());
    }
}

#[test]
fn power_cuts_lose_nothing_that_was_durable() {
    if let Some(folder) = inside() {
        be_a_daemon(&folder, Behaviour::Sound);
    }
    let test = "daemon::disaster_tests::power_cuts_lose_nothing_that_was_durable";
    let folder = tempfile::tempdir().unwrap();
    let Some(disk) = Disk::new(folder.path()) else {
        return skip(
            Needed::LoopDevice,
            "no file system could be made and mounted",
        );
    };
    let (cuts, names) = (times(2, 20), AtomicUsize::new(0));
    let (mut told, mut dice) = (Told::new(), Dice(12));
    for _ in 0..cuts {
        let (process, socket) = daemon(test, folder.path());
        let after = Duration::from_millis(20 + dice.below(400));
        let mut of_this = told_until(&socket, &names, after, || {
            disk.cut();
            end(process);
        });
        of_this.retain(|_, heard| is_durable(heard));
        disk.again();
        let (process, socket) = daemon(test, folder.path());
        for (name, heard) in &of_this {
            let again = replies(&mut connect(&socket), &trigger(Some(name), Until::Durable));
            assert_eq!(again.last(), heard.last(), "{name}");
        }
        end(process);
        told.extend(of_this);
    }
    let service = service_over(folder.path(), |_| ());
    service.stand.stop();
    check_recordings(&disk.at, &told);
    let durable = durable(&told);
    assert!(durable > 0);
    println!("shown: {cuts} power cuts while recording: 0 of {durable} durable captures lost");
}

/// The program by way of strace, which lets a call fail at its `number`th time for a file of the session `t` or their
/// folder.
fn refusing(folder: &Path, call: &str, error: &str, number: u64) -> Command {
    let recordings = folder.join("recordings");
    let part = recordings.join("t.mcap.part");
    refusing_of(&[recordings, part], call, error, number)
}

/// The same for any files.
fn refusing_of(paths: &[PathBuf], call: &str, error: &str, number: u64) -> Command {
    let mut strace = Command::new("strace");
    // Traced by a grandchild: the process that is started is the daemon.
    strace.args(["-D", "-f", "--seccomp-bpf", "-qq", "-o", "/dev/null"]);
    strace.arg("-e").arg(format!("trace={call}"));
    strace
        .arg("-e")
        .arg(format!("inject={call}:error={error}:when={number}"));
    for path in paths {
        strace.arg("-P").arg(path);
    }
    strace.arg(std::env::current_exe().unwrap());
    strace
}

/// Presses three times in a session of such a daemon, which is then asked to end; returns the replies.
fn press_thrice(test: &str, folder: &Path, command: Command) -> Told {
    let (mut process, socket) = daemon_by(command, test, folder);
    let begin = Request::Begin {
        name: "t".into(),
        about: BTreeMap::new(),
    };
    let begun = replies(&mut connect(&socket), &begin);
    assert!(matches!(begun[..], [Reply::Ok { .. }]), "{begun:?}");
    let press = |number| {
        let name = format!("p-{number}");
        loop {
            let heard = replies(&mut connect(&socket), &trigger(Some(&name), Until::Durable));
            if heard != [Reply::Busy] {
                return (name, heard);
            }
        }
    };
    let told = (0..3).map(press).collect();
    let pid = rustix::process::Pid::from_child(&process);
    rustix::process::kill_process(pid, rustix::process::Signal::TERM).unwrap();
    assert!(process.wait().unwrap().success());
    told
}

/// Each call that writing a recording makes, in turn, at its first, second and so on time. The capture that it hits has
/// failed, with the file's name in its reason, or is safe all the same; the others are not touched.
#[test]
fn a_disk_that_refuses_any_one_call_fails_at_most_one_capture_and_says_so() {
    if let Some(folder) = inside() {
        be_a_daemon(&folder, Behaviour::Sound);
    }
    let test = "daemon::disaster_tests::a_disk_that_refuses_any_one_call_fails_at_most_one_capture_and_says_so";
    let (runs, mut dice) = (times(1, 8), Dice(13));
    let (mut count, mut failed) = (0, 0);
    for (call, error, most) in [
        ("writev", "ENOSPC", 12),
        ("writev", "EIO", 12),
        ("pwrite64", "EIO", 6),
        ("fdatasync", "EIO", 3),
        ("fsync", "EIO", 3),
        ("linkat", "ENOSPC", 1),
        ("unlink", "EIO", 1),
    ] {
        // Where there are few, each.
        let numbers: Vec<u64> = match most.cmp(&runs) {
            std::cmp::Ordering::Greater => (0..runs).map(|_| 1 + dice.below(most)).collect(),
            _ => (1..=most).collect(),
        };
        for number in numbers {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path();
            let told = press_thrice(test, path, refusing(path, call, error, number));
            let place = format!("{call} {number}: {error}");
            for heard in told.values().filter(|heard| !is_durable(heard)) {
                let Some(Reply::Failed { reason, .. }) = heard.last() else {
                    panic!("{place}: {heard:?}");
                };
                assert!(reason.contains("t.mcap"), "{place}: {reason}");
            }
            let lost = told.len() - durable(&told);
            assert!(lost <= 1, "{place}: {told:?}");
            failed += lost;
            count += 1;
            // What is left unfinished is completed at the next start.
            let service = service_over(path, |_| ());
            for (name, heard) in &told {
                assert_eq!(service.press_until_taken(Some(name)), *heard, "{place}");
            }
            service.stand.stop();
            check_recordings(&path.join("recordings"), &told);
        }
    }
    assert!(failed > 0, "nothing was refused");
    println!(
        "shown: {count} refused calls (writev, pwrite64, fdatasync, fsync, linkat, unlink; ENOSPC, EIO): {failed} captures failed and \
         said so, 0 falsely acknowledged, all others kept"
    );
}

/// What stands between a program and the wall clock (package libfaketime).
fn wall_clock_library() -> PathBuf {
    let architectures = std::fs::read_dir("/usr/lib").unwrap();
    let mut libraries = architectures.map(|a| a.unwrap().path().join("faketime/libfaketime.so.1"));
    libraries
        .find(|library| library.exists())
        .expect("package libfaketime")
}

#[test]
fn a_wall_clock_that_steps_by_an_hour_moves_no_timestamp() {
    if let Some(folder) = inside() {
        be_a_daemon(&folder, Behaviour::Sound);
    }
    let test = "daemon::disaster_tests::a_wall_clock_that_steps_by_an_hour_moves_no_timestamp";
    let folder = tempfile::tempdir().unwrap();
    let offset = folder.path().join("offset");
    let step = |words: &str| std::fs::write(&offset, words).unwrap();
    step("+0");
    let library = wall_clock_library();
    let stepping = |program: &Path| {
        let mut command = Command::new(program);
        command
            .env("LD_PRELOAD", &library)
            .env("FAKETIME_TIMESTAMP_FILE", &offset);
        command
            .env("FAKETIME_NO_CACHE", "1")
            .env("DONT_FAKE_MONOTONIC", "1");
        command.env("NO_FAKE_STAT", "1");
        command
    };
    let seconds = || {
        let date = stepping(Path::new("/bin/date"))
            .arg("+%s")
            .output()
            .unwrap();
        String::from_utf8(date.stdout)
            .unwrap()
            .trim()
            .parse::<u64>()
            .unwrap()
    };
    let program = std::env::current_exe().unwrap();
    let (mut process, socket) = daemon_by(stepping(&program), test, folder.path());
    let begin = seconds();
    let mut ends = Vec::new();
    for (number, words) in ["+0", "+3600", "+0", "-3600"].iter().enumerate() {
        step(words);
        let name = format!("p-{number}");
        ends.push(replies(
            &mut connect(&socket),
            &trigger(Some(&name), Until::Durable),
        ));
    }
    assert!(seconds() < begin - 3000, "the clock did not step");
    assert!(ends.iter().all(|heard| is_durable(heard)), "{ends:?}");
    let pid = rustix::process::Pid::from_child(&process);
    rustix::process::kill_process(pid, rustix::process::Signal::TERM).unwrap();
    assert!(process.wait().unwrap().success());
    let found = recordings(&folder.path().join("recordings"));
    let mut times = Vec::new();
    for recording in &found {
        for message in recording.messages(&Topic::Trigger) {
            times.push(recording.trigger(message).unwrap().time.0);
        }
    }
    assert_eq!(times.len(), ends.len());
    let apart = times.windows(2).map(|pair| pair[1].saturating_sub(pair[0]));
    let apart: Vec<u64> = apart.collect();
    let real = 1..20_000_000_000;
    assert!(apart.iter().all(|ns| real.contains(ns)), "{apart:?}");
    println!(
        "shown: steps of the wall clock by an hour, forth and back twice: captures are apart by what passed"
    );
}

/// The journal of presses holds no capture: where the disk refuses it, every capture is kept all the same and told
/// truly, and the log says what is not known after a restart.
#[test]
fn a_disk_that_refuses_the_journal_of_presses_fails_no_capture_and_is_told_of() {
    if let Some(folder) = inside() {
        be_a_daemon(&folder, Behaviour::Sound);
    }
    let test = "daemon::disaster_tests::a_disk_that_refuses_the_journal_of_presses_fails_no_capture_and_is_told_of";
    let (mut count, mut said) = (0, 0);
    for (call, error, numbers) in [
        ("openat", "EACCES", 1..=1),
        ("write", "ENOSPC", 1..=times(2, 9)),
        ("write", "EIO", 3..=times(3, 9)),
        ("fdatasync", "EIO", 1..=times(1, 3)),
    ] {
        for number in numbers {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path();
            let journal = path.join("recordings/presses/presses.jsonl");
            let told = press_thrice(test, path, refusing_of(&[journal], call, error, number));
            let place = format!("{call} {number}: {error}");
            assert_eq!(durable(&told), 3, "{place}: {told:?}");
            let log = std::fs::read_to_string(path.join("log")).unwrap();
            let is_said =
                log.contains("presses.jsonl: cannot") || log.contains("the journal of presses");
            said += usize::from(is_said);
            count += 1;
            let service = service_over(path, |_| ());
            service.stand.stop();
            check_recordings(&path.join("recordings"), &told);
        }
    }
    assert!(said * 2 > count, "{said} of {count} were told of");
    println!(
        "shown: {count} refused calls of the journal of presses (openat, write, fdatasync): no capture failed, {said} times \
         said"
    );
}
