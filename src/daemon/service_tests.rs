//! Tests the socket as clients see it, with scripted cameras: presses and their ids, kills, disconnects.

use super::scripted::{Behaviour, TestBench, captures, recordings, start_in};
use super::*;
use crate::clock::Clock;
use crate::recording::{CaptureOutcome, Topic};
pub(super) use crate::support::{dice::Dice, torture::times};
use crate::trigger::{Client, Event, Reply, Request, Until};
use std::collections::{BTreeMap, BTreeSet};
use std::io::BufReader;
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

pub(super) const PATIENCE: Duration = Duration::from_secs(20);

/// A daemon that listens in its stand's folder.
pub(super) struct Service {
    pub(super) stand: TestBench,
    pub(super) socket: PathBuf,
}

pub(super) fn service(change: impl FnOnce(&mut CapturePlan)) -> Service {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().to_owned();
    service_at(start_in(folder, 4_000_000, change), &path)
}

/// A daemon over recordings that outlive it.
pub(super) fn service_over(folder: &Path, change: impl FnOnce(&mut CapturePlan)) -> Service {
    let stand = start_in(tempfile::tempdir().unwrap(), 4_000_000, |plan| {
        plan.recording.folder = folder.join("recordings");
        change(plan);
    });
    service_at(stand, folder)
}

fn service_at(stand: TestBench, folder: &Path) -> Service {
    static SOCKETS: AtomicUsize = AtomicUsize::new(0);
    let number = SOCKETS.fetch_add(1, Ordering::Relaxed);
    let socket = folder.join(format!("{number}.sock"));
    let (path, capturing) = (socket.clone(), Arc::clone(&stand.capturing));
    // Ends with the process, whose signals it waits for.
    std::thread::spawn(move || drop(listen(path, &capturing)));
    until(|| UnixStream::connect(&socket).ok());
    Service { stand, socket }
}

/// Serves a socket until this process is asked to end.
fn listen(path: PathBuf, capturing: &Arc<Capturing>) -> Clients {
    let parameters = SocketParameters {
        path,
        patience_ms: 2000,
    };
    let (notifier, watchdog) = (Notifier::from_environment(), Watchdog::default());
    let reload = Box::new(|| Err("nothing is read again".to_owned()));
    let policy = ServiceParameters::default();
    let mut service = super::Service::new(
        Arc::new(notifier),
        &watchdog,
        policy,
        reload,
        Clock::system(),
    );
    serve(&parameters, None, capturing, &mut service).unwrap()
}

pub(super) fn trigger(press_id: Option<&str>, until: Until) -> Request {
    Request::Trigger {
        source: "test".into(),
        press_id: press_id.map(Into::into),
        subject: None,
        placement: None,
        until,
    }
}

impl Service {
    pub(super) fn client(&self) -> Client {
        Client::connect(&self.socket, Some(PATIENCE)).unwrap()
    }

    /// A connection for what no client of ours would say.
    pub(super) fn raw(&self) -> BufReader<UnixStream> {
        raw(&self.socket)
    }

    fn press(&self, press_id: Option<&str>) -> Vec<Reply> {
        replies(&mut self.client(), &trigger(press_id, Until::Durable))
    }

    /// Presses, and again while another capture is being finished.
    pub(super) fn press_until_taken(&self, press_id: Option<&str>) -> Vec<Reply> {
        until(|| Some(self.press(press_id)).filter(|heard| *heard != [Reply::Busy]))
    }
}

pub(super) fn raw(socket: &Path) -> BufReader<UnixStream> {
    let stream = UnixStream::connect(socket).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    BufReader::new(stream)
}

/// All replies to a request.
pub(super) fn replies(client: &mut Client, request: &Request) -> Vec<Reply> {
    client.send(request).unwrap();
    let until = match request {
        Request::Trigger { until, .. } => *until,
        _ => Until::default(),
    };
    let mut heard = Vec::new();
    loop {
        heard.push(client.reply().unwrap());
        if heard.last().unwrap().is_end(until) {
            return heard;
        }
    }
}

pub(super) fn until<T>(mut reached: impl FnMut() -> Option<T>) -> T {
    let end = Instant::now() + PATIENCE;
    loop {
        if let Some(found) = reached() {
            return found;
        }
        assert!(Instant::now() < end, "it takes too long");
        std::thread::sleep(Duration::from_millis(2));
    }
}

fn capture_of(replies: &[Reply]) -> &str {
    match &replies[0] {
        Reply::Accepted { capture, .. } => capture,
        other => panic!("{other:?}"),
    }
}

pub(super) fn is_durable(replies: &[Reply]) -> bool {
    matches!(replies.last(), Some(Reply::Durable { .. }))
}

const INSIDE: &str = "SCAND_TEST_INSIDE";

/// The folder of a daemon that this process is to be, where it is one.
pub(super) fn inside() -> Option<PathBuf> {
    std::env::var_os(INSIDE).map(PathBuf::from)
}

/// A daemon in a process of its own: a test, by its whole name, that runs itself again.
pub(super) fn daemon(test: &str, folder: &Path) -> (Child, PathBuf) {
    let command = Command::new(std::env::current_exe().unwrap());
    daemon_by(command, test, folder)
}

/// The same by way of a command that wants the arguments of a test.
pub(super) fn daemon_by(mut command: Command, test: &str, folder: &Path) -> (Child, PathBuf) {
    let log = std::fs::File::create(folder.join("log")).unwrap();
    let child = command
        .args(["--exact", test, "--nocapture", "--test-threads=1"])
        .env(INSIDE, folder)
        .stdout(std::process::Stdio::null())
        .stderr(log)
        .spawn()
        .unwrap();
    let socket = folder.join("0.sock");
    until(|| UnixStream::connect(&socket).ok());
    (child, socket)
}

/// Is that daemon until it is killed or told to end.
pub(super) fn be_a_daemon(folder: &Path, behaviour: Behaviour) -> ! {
    let stand = start_in(tempfile::tempdir().unwrap(), 4_000_000, |plan| {
        plan.recording.folder = folder.join("recordings");
        // Some twenty captures a file.
        plan.recording.largest_file_mb = 5;
        plan.sync.window_ms = 3000.0;
        plan.models = Some(plan.recording.folder.join("models"));
    });
    stand.behaviour("c00", behaviour);
    let clients = listen(folder.join("0.sock"), &stand.capturing);
    stand.stop();
    clients.finish(Duration::from_secs(1));
    std::process::exit(0);
}

#[test]
fn the_same_press_id_is_the_same_capture_while_it_lasts_later_and_after_a_restart() {
    let folder = tempfile::tempdir().unwrap();
    let service = service_over(folder.path(), |_| ());
    service.stand.behaviour("c00", Behaviour::Slow);
    let mut first = service.client();
    first.send(&trigger(Some("p-1"), Until::Durable)).unwrap();
    assert!(matches!(first.reply().unwrap(), Reply::Accepted { .. }));
    // While the capture lasts, the same id follows it and another one hears that there is one.
    let follower = std::thread::scope(|scope| {
        let follower = scope.spawn(|| service.press(Some("p-1")));
        assert_eq!(service.press(Some("p-2")), [Reply::Busy]);
        follower.join().unwrap()
    });
    let again = service.press(Some("p-1"));
    assert_eq!(follower, again);
    let other = service.press_until_taken(Some("p-2"));
    assert!(is_durable(&other), "{other:?}");
    assert_ne!(capture_of(&other), capture_of(&again));
    service.stand.stop();
    let service = service_over(folder.path(), |_| ());
    assert_eq!(service.press(Some("p-1")), again);
    assert_eq!(service.press(Some("p-2")), other);
    let third = service.press(Some("p-3"));
    assert!(is_durable(&third), "{third:?}");
    service.stand.stop();
    let found = recordings(&folder.path().join("recordings"));
    let taken: Vec<_> = found.iter().flat_map(captures).collect();
    assert_eq!(taken.len(), 3, "{taken:?}");
}

#[test]
fn a_press_waits_for_what_it_asked_for_and_no_longer() {
    let service = service(|plan| plan.models = Some(plan.recording.folder.join("models")));
    let heard = replies(&mut service.client(), &trigger(Some("p"), Until::Captured));
    assert!(
        matches!(heard.last(), Some(Reply::Captured { .. })),
        "{heard:?}"
    );
    let heard = service.press(Some("p"));
    assert!(is_durable(&heard), "{heard:?}");
    let capture = capture_of(&heard).to_owned();
    let mut waiting = service.client();
    waiting.send(&trigger(Some("p"), Until::Done)).unwrap();
    (0..3).for_each(|_| drop(waiting.reply().unwrap()));
    let reason = "no silhouettes".to_owned();
    service.stand.capturing.job_ended(Event::JobFailed {
        capture: capture.clone(),
        recording: Some(PathBuf::new()),
        reason: reason.clone(),
    });
    assert_eq!(
        waiting.reply().unwrap(),
        Reply::JobFailed {
            capture,
            recording: None,
            reason
        }
    );
}

#[test]
fn nobody_waits_for_models_where_none_are_made() {
    let service = service(|_| ());
    let heard = replies(&mut service.client(), &trigger(None, Until::Done));
    assert!(matches!(&heard[..], [Reply::Refused { reason }] if reason.contains("no models")));
    assert_eq!(service.stand.capturing.status().complete, 0);
}

#[test]
fn a_kill_between_accepted_and_durable_leaves_one_capture_with_one_end() {
    if let Some(folder) = inside() {
        be_a_daemon(&folder, Behaviour::Slow);
    }
    let name = "daemon::service_tests::a_kill_between_accepted_and_durable_leaves_one_capture_with_one_end";
    let mut ends = BTreeSet::new();
    // From at once to after the capture, which takes 100 ms, is on the disk.
    for wait_ms in [0, 40, 90, 101, 103, 106, 110, 120, 300] {
        let folder = tempfile::tempdir().unwrap();
        let (mut daemon, socket) = daemon(name, folder.path());
        let mut client = Client::connect(&socket, Some(PATIENCE)).unwrap();
        client.send(&trigger(Some("p-1"), Until::Durable)).unwrap();
        let accepted = client.reply().unwrap();
        std::thread::sleep(Duration::from_millis(wait_ms));
        daemon.kill().unwrap();
        daemon.wait().unwrap();
        let mut before = vec![accepted];
        while let Ok(reply) = client.reply() {
            before.push(reply);
        }
        let service = service_over(folder.path(), |_| ());
        let after = service.press(Some("p-1"));
        let same = after.starts_with(&before);
        assert!(same, "killed after {wait_ms} ms: {before:?}, {after:?}");
        let failed = matches!(after.last(), Some(Reply::Failed { .. }));
        assert!(is_durable(&after) || failed, "{after:?}");
        ends.insert(failed);
        assert_eq!(service.press(Some("p-1")), after);
        service.stand.stop();
        // What was acknowledged as durable is in the recording, and nothing else.
        let found = recordings(&folder.path().join("recordings"));
        let found: Vec<_> = found.iter().flat_map(captures).collect();
        let complete = found.iter().filter(|c| c.1 == CaptureOutcome::Complete);
        assert_eq!(complete.count(), usize::from(!failed), "{found:?}");
    }
    assert_eq!(ends.len(), 2, "no kill came early, or none late");
}

#[test]
fn told_to_end_it_finishes_the_capture_and_every_client_has_its_end() {
    if let Some(folder) = inside() {
        be_a_daemon(&folder, Behaviour::Slow);
    }
    let name =
        "daemon::service_tests::told_to_end_it_finishes_the_capture_and_every_client_has_its_end";
    let folder = tempfile::tempdir().unwrap();
    let (mut daemon, socket) = daemon(name, folder.path());
    let connect = || Client::connect(&socket, Some(PATIENCE)).unwrap();
    let (mut durable, mut done, mut idle) = (connect(), connect(), connect());
    durable.send(&trigger(Some("p"), Until::Durable)).unwrap();
    assert!(matches!(durable.reply().unwrap(), Reply::Accepted { .. }));
    done.send(&trigger(Some("p"), Until::Done)).unwrap();
    assert!(matches!(done.reply().unwrap(), Reply::Accepted { .. }));
    replies(&mut idle, &Request::Status {});
    let pid = rustix::process::Pid::from_child(&daemon);
    rustix::process::kill_process(pid, rustix::process::Signal::TERM).unwrap();
    let rest = |client: &mut Client| -> Vec<Reply> {
        std::iter::from_fn(|| client.reply().ok()).collect()
    };
    let (durable, done) = (rest(&mut durable), rest(&mut done));
    assert!(is_durable(&durable), "{durable:?}");
    assert_eq!(done.last(), Some(&Reply::Ending), "{done:?}");
    assert!(is_durable(&done[..done.len() - 1]), "{done:?}");
    assert!(daemon.wait().unwrap().success());
    let found = recordings(&folder.path().join("recordings"));
    assert_eq!(found.iter().flat_map(captures).count(), 1);
}

/// Presses by a name until that has its end, and goes away at any moment meanwhile; all final answers that arrived.
fn press_and_stray(service: &Service, name: &str, dice: &mut Dice) -> Reply {
    until(|| {
        let mut client = service.client();
        client.send(&trigger(Some(name), Until::Durable)).unwrap();
        let hears = dice.below(6);
        for _ in 0..hears {
            let reply = client.reply().unwrap();
            // Nothing was begun, as when the recorder's queue is full: the same name may try again.
            if matches!(reply, Reply::Busy | Reply::Refused { .. }) {
                return None;
            }
            if reply.is_end(Until::Durable) {
                return Some(reply);
            }
        }
        None
    })
}

#[test]
fn a_thousand_presses_with_clients_that_go_away_have_one_end_each() {
    let presses = times(1000, 10_000) as usize;
    let service = service(|plan| plan.recording.largest_file_mb = 20);
    let next = AtomicUsize::new(0);
    let strand = |seed| {
        let mut dice = Dice(seed);
        let mut ends = BTreeMap::new();
        loop {
            let number = next.fetch_add(1, Ordering::Relaxed);
            if number >= presses {
                return ends;
            }
            let name = format!("p-{number}");
            let end = press_and_stray(&service, &name, &mut dice);
            ends.insert(name, end);
        }
    };
    let ends: BTreeMap<String, Reply> = std::thread::scope(|scope| {
        let strands: Vec<_> = (0..4).map(|i| scope.spawn(move || strand(i))).collect();
        strands
            .into_iter()
            .flat_map(|s| s.join().unwrap())
            .collect()
    });
    assert_eq!(ends.len(), presses);
    // A client that asks again gets the same.
    for (name, end) in ends.iter().step_by(50) {
        assert_eq!(service.press(Some(name)).last(), Some(end));
    }
    let Service { stand, .. } = service;
    let (folder, _) = stand.stop();
    let mut taken = BTreeMap::new();
    for recording in recordings(folder.path()) {
        for message in recording.messages(&Topic::Trigger) {
            let trigger = recording.trigger(message).unwrap();
            let name = trigger.press_id.unwrap();
            let id = trigger.id.to_string();
            // On a busy machine an attempt may fail, and is taken once more.
            if let Some(first) = taken.insert(name, id.clone()) {
                assert_eq!(id, format!("{first}.r1"), "a press with two captures");
            }
        }
    }
    for (name, end) in &ends {
        let Reply::Durable { capture, .. } = end else {
            panic!("{name}: {end:?}");
        };
        assert_eq!(taken.get(name), Some(capture), "{name}");
    }
    assert_eq!(taken.len(), presses);
    println!(
        "shown: {presses} presses whose clients go away at any moment: one final answer and one capture each"
    );
}

/// Printed for information (`--nocapture`); figures that depend on the machine are not required.
#[test]
fn what_a_press_waits_for_comes_in_its_order() {
    let service = service(|_| ());
    let mut times: [Vec<Duration>; 3] = Default::default();
    for _ in 0..200 {
        let mut client = service.client();
        let begin = Instant::now();
        client.send(&trigger(None, Until::Durable)).unwrap();
        let replies: Vec<_> = (0..3)
            .map_while(|_| Some((client.reply().ok()?, begin.elapsed())))
            .collect();
        match &replies[..] {
            [
                (Reply::Accepted { .. }, a),
                (Reply::Captured { .. }, c),
                (Reply::Durable { .. }, d),
            ] => {
                [a, c, d]
                    .into_iter()
                    .zip(&mut times)
                    .for_each(|(t, all)| all.push(*t));
            }
            [(Reply::Busy, _), ..] => std::thread::sleep(Duration::from_millis(1)),
            other => panic!("{other:?}"),
        }
    }
    for (name, mut times) in ["accepted", "captured", "durable"].into_iter().zip(times) {
        times.sort();
        let at = |part: f64| times[((times.len() - 1) as f64 * part) as usize];
        println!("press to {name}: p50 {:?}, p99 {:?}", at(0.5), at(0.99));
    }
}
