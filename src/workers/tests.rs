//! Tests jobs on the disk and the processes that do them. These processes are shell scripts that do what a test needs;
//! tests/workers.rs runs the real ones.

use super::find::find;
use super::remakes::Remake;
use super::*;
use crate::clock::Clock;
use crate::frame::{CaptureId, Timestamp, Trigger};
use crate::level::Level;
use crate::recording::{
    CaptureOutcome, CaptureRecord, Compression, Note, Recording, Writer, note_beside, recover,
    unfinished_name,
};
use crate::support::wait::until;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, SystemTime};

/// A time so many milliseconds after the sessions began.
fn at(milliseconds: u64) -> Timestamp {
    Timestamp(1_760_000_000_000_000_000 + milliseconds * 1_000_000)
}

fn trigger(id: &str, ms: u64) -> Trigger {
    Trigger {
        id: CaptureId::new(id).unwrap(),
        time: at(ms),
        source: "pedal".into(),
        press_id: None,
        subject: None,
        placement: None,
    }
}

/// What every script begins with: `$capture` and `$target`, and `done`, which leaves a model there.
const BEGIN: &str = r#"
while [ $# -gt 0 ]; do
    case $1 in
    --replay) replay=$2 ;;
    --capture) capture=$2 ;;
    --out) out=$2 ;;
    --force) force=yes ;;
    esac
    shift
done
stem=${replay##*/}
stem=${stem%.part}
target=$out/${stem%.mcap}/$capture
make() {
    mkdir -p "$target"
    echo '{"outcome":"done","verdict":{"level":"amber","reasons":[{"words":"a hand"}]}}' > "$target/report.json"
}
"#;

/// Recordings, models and a script, in a folder.
struct Place {
    folder: tempfile::TempDir,
}

impl Place {
    /// With a file `s.mcap` that stands for a recording.
    fn new(script: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir(folder.path().join("recordings")).unwrap();
        let place = Self { folder };
        std::fs::write(place.recording("s.mcap"), "").unwrap();
        place.change(script);
        place
    }

    fn change(&self, script: &str) {
        let text = format!("{BEGIN}{script}\n");
        std::fs::write(self.path().join("worker.sh"), text).unwrap();
    }

    fn path(&self) -> &Path {
        self.folder.path()
    }

    fn recording(&self, name: &str) -> PathBuf {
        self.path().join("recordings").join(name)
    }

    fn models(&self) -> PathBuf {
        self.path().join("models")
    }

    fn jobs(&self) -> Arc<Jobs> {
        Arc::new(Jobs::open(&self.path().join("recordings")).unwrap())
    }

    /// Offers the captures `s-1`, `s-2` and so on.
    fn offer(&self, jobs: &Jobs, numbers: std::ops::RangeInclusive<u64>) {
        for number in numbers {
            let capture = format!("s-{number}");
            let job = Job::new(&self.recording("s.mcap"), &capture, number, "test");
            jobs.enqueue(&job).unwrap();
        }
    }

    fn plan(&self) -> WorkerPlan {
        WorkerPlan {
            parameters: Parameters {
                folder: self.models(),
                ..Parameters::default()
            },
            settings: "# settings".into(),
            clock: Clock::system(),
            method: crate::reconstruct::Method::default(),
            keep_free: Arc::default(),
            command: vec!["/bin/sh".into(), self.path().join("worker.sh").into()],
        }
    }

    fn start(&self, jobs: &Arc<Jobs>, change: impl FnOnce(&mut WorkerPlan)) -> (Workers, Heard) {
        let mut plan = self.plan();
        change(&mut plan);
        let (ended, heard) = channel();
        let workers = start_models(jobs, plan, move |e| drop(ended.send(e))).unwrap();
        (workers, Heard(heard))
    }

    fn report(&self, capture: &str) -> serde_json::Value {
        let path = self.models().join("s").join(capture).join("report.json");
        serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
    }

    fn left(&self) -> Vec<String> {
        let files = std::fs::read_dir(self.recording("jobs")).unwrap();
        let mut names: Vec<_> = files
            .map(|f| f.unwrap().file_name().into_string().unwrap())
            .filter(|name| name != "settings.toml")
            .collect();
        names.sort();
        names
    }
}

/// Jobs that ended.
struct Heard(Receiver<FinishedJob>);

impl Heard {
    fn next(&self) -> FinishedJob {
        self.0.recv_timeout(Duration::from_secs(60)).unwrap()
    }

    fn nothing(&self) {
        let heard = self.0.recv_timeout(Duration::from_millis(100));
        assert!(heard.is_err(), "{heard:?}");
    }
}

#[test]
fn jobs_are_done_in_their_order_and_gone() {
    let place = Place::new("make");
    let jobs = place.jobs();
    place.offer(&jobs, 1..=3);
    // A job is kept once.
    place.offer(&jobs, 2..=2);
    assert_eq!((jobs.backlog().waiting, place.left().len()), (3, 3));
    assert_eq!(jobs.backlog().expected_s, None);
    let (workers, heard) = place.start(&jobs, |_| ());
    for number in 1..=3 {
        let ended = heard.next();
        assert_eq!(ended.capture, format!("s-{number}"));
        assert_eq!(ended.recording, place.recording("s.mcap"));
        let model = ended.model.unwrap();
        assert_eq!(
            (model.verdict, model.reasons),
            (Level::Amber, vec!["a hand".to_owned()])
        );
        assert_eq!(model.folder, place.models().join("s").join(ended.capture));
    }
    until("not finished", || jobs.backlog().done == 3);
    assert_eq!(place.left(), [""; 0]);
    let backlog = jobs.backlog();
    assert_eq!((backlog.waiting, backlog.running.len()), (0, 0));
    assert_eq!(backlog.expected_s, Some(0.0));
    workers.stop();
    heard.nothing();
}

#[test]
fn a_rejected_captures_job_is_not_done_until_the_capture_is_wanted_again() {
    let place = Place::new("make");
    let jobs = place.jobs();
    place.offer(&jobs, 1..=2);
    let recording = place.recording("s.mcap");
    assert_eq!(jobs.withdraw("s-1"), Some(recording));
    assert_eq!(jobs.withdraw("s-1"), None, "it is withdrawn already");
    assert_eq!(jobs.withdraw("1"), None, "no capture has this name");
    // Neither a second offer nor a restart brings it back.
    place.offer(&jobs, 1..=1);
    let jobs = place.jobs();
    assert_eq!((jobs.backlog().waiting, place.left().len()), (1, 2));
    let (workers, heard) = place.start(&jobs, |_| ());
    assert_eq!(heard.next().capture, "s-2");
    heard.nothing();
    jobs.offer_again("s-1");
    assert_eq!(heard.next().capture, "s-1");
    until("not finished", || jobs.backlog().done == 2);
    assert_eq!(place.left(), [""; 0]);
    workers.stop();
}

#[test]
fn one_that_crashes_fails_alone_with_a_report_and_its_words() {
    let place = Place::new(
        "[ $capture = s-2 ] && { echo 'scand: a pointer to nowhere' >&2; kill -SEGV $$; }\n\
         [ $capture = s-3 ] && exit 0\n\
         [ $capture = s-4 ] && { echo 'scand: no light' >&2; exit 1; }\n\
         make",
    );
    let jobs = place.jobs();
    place.offer(&jobs, 1..=5);
    let (_workers, heard) = place.start(&jobs, |_| ());
    assert!(heard.next().model.is_ok());
    let crashed = heard.next().model.unwrap_err();
    assert_eq!(
        crashed,
        "the worker was killed by signal 11: a pointer to nowhere"
    );
    let report = place.report("s-2");
    assert_eq!(report["outcome"], "failed");
    assert_eq!(report["reason"], crashed.as_str());
    assert_eq!(report["recording"], "s.mcap");
    assert_eq!(report["capture"]["id"], "s-2");
    let words = std::fs::read_to_string(place.models().join("s/s-2/worker.log")).unwrap();
    assert_eq!(words, "scand: a pointer to nowhere\n");
    // One that says that it is done, and left nothing.
    let reason = heard.next().model.unwrap_err();
    assert!(reason.contains("report.json"), "{reason}");
    assert_eq!(heard.next().model.unwrap_err(), "no light");
    assert!(heard.next().model.is_ok());
    until("not finished", || jobs.backlog().done == 2);
    assert_eq!((jobs.backlog().failed, place.left()), (3, vec![]));
}

#[test]
fn one_that_is_killed_after_its_model_was_put_in_place_has_made_it() {
    let place = Place::new("make\nkill -KILL $$");
    let jobs = place.jobs();
    place.offer(&jobs, 1..=1);
    let (_workers, heard) = place.start(&jobs, |_| ());
    let made = heard.next().model.expect("its model lies there");
    assert_eq!(made.verdict, Level::Amber);
    assert_eq!(place.report("s-1")["outcome"], "done");
    // A model that lay there before is none that this process made.
    place.change("kill -KILL $$");
    until("not finished", || jobs.backlog().done == 1);
    place.offer(&jobs, 1..=1);
    let killed = heard.next().model.unwrap_err();
    assert_eq!(killed, "the worker was killed by signal 9");
    assert_eq!(place.report("s-1")["outcome"], "done");
}

#[test]
fn a_panic_of_its_thread_costs_a_job_its_starts_and_no_other_job() {
    let place = Place::new("echo >> \"$out/starts-of-$capture\"; make");
    let jobs = place.jobs();
    place.offer(&jobs, 1..=2);
    let (ended, heard) = channel();
    let ended = move |job: FinishedJob| {
        assert!(job.capture != "s-1", "as this test wants it");
        ended.send(job).unwrap();
    };
    let _workers = start_models(&jobs, place.plan(), ended).unwrap();
    let heard = Heard(heard);
    assert_eq!(heard.next().capture, "s-2");
    until("not finished", || jobs.backlog().done == 1);
    let backlog = jobs.backlog();
    assert_eq!((backlog.failed, backlog.waiting), (1, 0));
    assert_eq!((backlog.running.len(), place.left().len()), (0, 0));
    let starts = std::fs::read_to_string(place.models().join("starts-of-s-1")).unwrap();
    assert_eq!(starts.lines().count(), 3);
}

#[test]
fn one_that_hangs_is_killed_when_its_time_is_over() {
    let place = Place::new("[ $capture = s-1 ] && exec sleep 1000\nmake");
    let jobs = place.jobs();
    place.offer(&jobs, 1..=1);
    let clock = Clock::by_hand(crate::frame::Timestamp(0));
    let (_workers, heard) = place.start(&jobs, |plan| plan.clock = clock);
    // Its time begins when its thread reads the clock, whenever that is.
    let hung = loop {
        clock.advance(Duration::from_secs(24 * 3600));
        if let Ok(job) = heard.0.recv_timeout(Duration::from_millis(1)) {
            break job;
        }
    };
    let reason = hung.model.unwrap_err();
    assert!(reason.contains("workers.time_limit_s"), "{reason}");
    assert_eq!(place.report("s-1")["outcome"], "failed");
    place.offer(&jobs, 2..=2);
    assert!(heard.next().model.is_ok());
}

#[test]
fn there_are_never_more_than_were_asked_for_and_jobs_come_meanwhile() {
    let place = Place::new(
        "mkdir \"$out/running-$capture\"\n\
         while [ ! -e \"$out/go\" ]; do sleep 0.02; done\n\
         ls -d \"$out\"/running-* | wc -l >> \"$out/counts\"\n\
         make\n\
         rmdir \"$out/running-$capture\"",
    );
    let jobs = place.jobs();
    let (_workers, heard) = place.start(&jobs, |plan| plan.parameters.count = 2);
    place.offer(&jobs, 1..=10);
    let running = |jobs: &Jobs| jobs.backlog().running.len();
    until("two do not run", || running(&jobs) == 2);
    place.offer(&jobs, 11..=200);
    let backlog = jobs.backlog();
    assert_eq!((backlog.running.len(), backlog.waiting), (2, 198));
    assert_eq!(backlog.running[0].capture, "s-1");
    assert_eq!(place.left().len(), 200);
    // The rest is removed as a person would, and nobody waits for it.
    for number in 7..=200 {
        let job = Job::new(
            &place.recording("s.mcap"),
            &format!("s-{number}"),
            number,
            "",
        );
        std::fs::remove_file(place.recording("jobs").join(job.file_name())).unwrap();
    }
    std::fs::write(place.models().join("go"), "").unwrap();
    for _ in 1..=6 {
        assert!(heard.next().model.is_ok());
    }
    until("not finished", || jobs.backlog().waiting == 0);
    let counts = std::fs::read_to_string(place.models().join("counts")).unwrap();
    let counts: Vec<u32> = counts.lines().map(|l| l.trim().parse().unwrap()).collect();
    assert_eq!((counts.len(), *counts.iter().max().unwrap()), (6, 2));
}

#[test]
fn what_a_stop_interrupts_is_done_after_the_next_start() {
    let place = Place::new("echo $$ > \"$out/pid\"\nexec sleep 1000");
    let jobs = place.jobs();
    place.offer(&jobs, 1..=2);
    let (workers, heard) = place.start(&jobs, |_| ());
    let pid = place.models().join("pid");
    until("not begun", || {
        std::fs::read(&pid).is_ok_and(|p| !p.is_empty())
    });
    let process = std::fs::read_to_string(&pid).unwrap();
    let process = Path::new("/proc").join(process.trim());
    assert!(process.exists());
    workers.stop();
    assert!(!process.exists());
    heard.nothing();
    // Offered when nobody does jobs any more.
    place.offer(&jobs, 3..=3);
    assert_eq!(place.left().len(), 3);
    place.change("make");
    let jobs = place.jobs();
    assert_eq!(jobs.backlog().waiting, 3);
    let (_workers, heard) = place.start(&jobs, |_| ());
    for number in 1..=3 {
        let ended = heard.next();
        assert_eq!(ended.capture, format!("s-{number}"));
        assert!(ended.model.is_ok());
    }
}

#[test]
fn who_is_asked_to_end_is_done_again_and_who_takes_the_daemon_along_is_not() {
    let place = Place::new(
        "[ -e \"$out/$capture\" ] && make || { touch \"$out/$capture\"; kill -TERM $$; }",
    );
    let jobs = place.jobs();
    place.offer(&jobs, 1..=1);
    let fatal = Job {
        begun: 3,
        ..Job::new(&place.recording("s.mcap"), "s-2", 2, "test")
    };
    jobs.enqueue(&fatal).unwrap();
    let (_workers, heard) = place.start(&jobs, |_| ());
    assert!(heard.next().model.is_ok());
    let reason = heard.next().model.unwrap_err();
    assert!(reason.contains("started 3 times"), "{reason}");
    assert_eq!(place.report("s-2")["outcome"], "failed");
}

#[test]
fn a_job_that_somebody_ends_again_and_again_comes_to_an_end() {
    let place = Place::new("[ $capture = s-1 ] && kill -TERM $$; make");
    let jobs = place.jobs();
    place.offer(&jobs, 1..=2);
    let (_workers, heard) = place.start(&jobs, |_| ());
    let ended = heard.next();
    assert_eq!(ended.capture, "s-1");
    let reason = ended.model.unwrap_err();
    assert!(reason.contains("the worker ended first"), "{reason}");
    assert!(heard.next().model.is_ok());
}

/// A file in the place of the folder of jobs makes writing there fail.
#[test]
fn a_job_that_the_disk_refuses_is_told_of_leaves_nothing_and_is_done_when_it_is_offered_again() {
    let place = Place::new("make");
    let folder = place.recording("jobs");
    let jobs = place.jobs();
    let job = Job::new(&place.recording("s.mcap"), "s-1", 1, "test");
    std::fs::remove_dir(&folder).unwrap();
    std::fs::write(&folder, "").unwrap();
    let refused = jobs.enqueue(&job).unwrap_err().to_string();
    assert!(refused.contains(folder.to_str().unwrap()), "{refused}");
    assert!(jobs.is_idle());

    std::fs::remove_file(&folder).unwrap();
    jobs.enqueue(&job).unwrap();
    assert_eq!(place.left(), [job.file_name()]);
    let (_workers, heard) = place.start(&jobs, |_| ());
    assert_eq!(heard.next().capture, "s-1");
    until("not finished", || place.left().is_empty());
}

#[test]
fn that_the_disk_refuses_a_job_of_an_interrupted_recording_is_told_so_that_it_is_offered_again() {
    let place = Place::new("make");
    let path = place.recording("a.mcap");
    record(&path, &[("a-1", 1000)], true);
    let folder = place.recording("jobs");
    let jobs = place.jobs();
    std::fs::remove_dir(&folder).unwrap();
    std::fs::write(&folder, "").unwrap();
    let recordings = [path];
    assert!(!jobs.enqueue_missing(&recordings, &place.models()));
    std::fs::remove_file(&folder).unwrap();
    let jobs = place.jobs();
    assert!(jobs.enqueue_missing(&recordings, &place.models()));
    assert_eq!(place.left().len(), 1);
}

#[test]
fn what_is_no_job_is_set_aside_and_what_a_kill_left_is_removed() {
    let place = Place::new("make");
    let folder = place.recording("jobs");
    drop(place.jobs());
    std::fs::write(folder.join("0-s-0.job"), "{").unwrap();
    let outside = r#"{"recording":"../x","file":"","capture":"a","trigger_ns":1,"source":""}"#;
    std::fs::write(folder.join("1-a.job"), outside).unwrap();
    std::fs::write(folder.join(".2-b.job.part-1-0"), "").unwrap();
    let jobs = place.jobs();
    place.offer(&jobs, 3..=3);
    let (_workers, heard) = place.start(&jobs, |_| ());
    assert_eq!(heard.next().capture, "s-3");
    until("not finished", || place.left() == ["0-s-0.bad", "1-a.bad"]);
}

#[test]
fn a_model_of_a_worker_that_is_distrusted_is_replaced_when_its_job_is_done_here_and_no_other_is() {
    let place = Place::new("echo \"$force\" > \"$out/force-of-$capture\"; make");
    let marked = place.models().join("s/s-1");
    std::fs::create_dir_all(&marked).unwrap();
    std::fs::create_dir_all(place.models().join("s/s-2")).unwrap();
    std::fs::write(marked.join(distrusted::MARK), "").unwrap();
    let jobs = place.jobs();
    place.offer(&jobs, 1..=2);
    let (_workers, heard) = place.start(&jobs, |_| ());
    for (capture, expected) in [("s-1", "yes\n"), ("s-2", "\n")] {
        assert_eq!(heard.next().capture, capture);
        let force = place.models().join(format!("force-of-{capture}"));
        assert_eq!(std::fs::read_to_string(force).unwrap(), expected);
    }
}

/// Nobody says anything of a job here, as long as the process of the fleet does not run.
#[test]
fn with_a_fleet_a_job_that_a_person_removes_counts_no_more_and_what_is_no_job_is_set_aside() {
    let place = Place::new("make");
    let folder = place.recording("jobs");
    std::fs::create_dir(&folder).unwrap();
    std::fs::write(folder.join("0-s-0.job"), "{").unwrap();
    let jobs = place.jobs();
    place.offer(&jobs, 1..=2);
    assert_eq!(jobs.backlog().waiting, 3);
    let address: FleetAddress = "nats://127.0.0.1".parse().unwrap();
    let (workers, heard) = place.start(&jobs, |plan| plan.parameters.fleet = Some(address));
    until("not set aside", || jobs.backlog().waiting == 2);
    assert_eq!(
        (place.left().len(), place.left()[0].as_str()),
        (3, "0-s-0.bad")
    );
    let job = |number| {
        Job::new(
            &place.recording("s.mcap"),
            &format!("s-{number}"),
            number,
            "test",
        )
    };
    let file = |number| folder.join(job(number).file_name());
    std::fs::remove_file(file(1)).unwrap();
    until("still counted", || jobs.backlog().waiting == 1);
    // As the process of the fleet does with one that failed before.
    let failed = place.path().join("failed");
    std::fs::write(&failed, serde_json::to_vec(&job(1)).unwrap()).unwrap();
    std::fs::rename(&failed, file(1)).unwrap();
    until("not counted", || jobs.backlog().waiting == 2);
    for number in 1..=2 {
        assert!(!jobs.is_idle());
        std::fs::remove_file(file(number)).unwrap();
    }
    until("not idle", || jobs.is_idle());
    heard.nothing();
    workers.stop();
}

#[test]
fn no_job_is_begun_when_the_disk_is_as_full_as_it_may_be() {
    let place = Place::new("make");
    let jobs = place.jobs();
    place.offer(&jobs, 1..=1);
    let keep_free = Arc::new(AtomicU64::new(u64::MAX));
    let (workers, heard) = place.start(&jobs, |plan| plan.keep_free = keep_free.clone());
    heard.nothing();
    workers.stop();
    assert_eq!(place.left().len(), 1);
    // It may become as full as it is.
    let (_workers, heard) = place.start(&place.jobs(), |plan| plan.keep_free = keep_free.clone());
    heard.nothing();
    keep_free.store(0, Ordering::Relaxed);
    assert!(heard.next().model.is_ok());
}

/// A recording with these captures, each triggered at so many milliseconds; completed if it has no ending `.part`.
fn record(path: &Path, captures: &[(&str, u64)], complete: bool) {
    let mut writer = Writer::create(path, "test", Compression::None).unwrap();
    for (id, ms) in captures {
        writer.trigger(&trigger(id, *ms)).unwrap();
        let record = CaptureRecord {
            id: (*id).into(),
            outcome: CaptureOutcome::Complete,
            reason: None,
            skew_ns: None,
            cameras: Default::default(),
        };
        writer.capture(&record, at(*ms + 1)).unwrap();
    }
    writer.sync().unwrap();
    if complete {
        writer.finish().unwrap();
    }
}

#[test]
fn a_capture_is_found_whatever_became_of_its_recording() {
    let place = Place::new("");
    let folder = place.path().join("recordings");
    let path = place.recording("a.mcap");
    let captures = [("a-1", 1000), ("a-2", 2000)];
    record(&path, &captures, false);
    let job = Job::new(&path, "a-2", at(2000).0, "test");
    assert_eq!(find(&folder, &job), Some(unfinished_name(&path)));
    // Completed by a recovery: another file.
    recover(&unfinished_name(&path)).unwrap();
    assert_eq!(find(&folder, &job), Some(path.clone()));
    // Renamed by a person, while another session has the name, and captures of the same names.
    let renamed = place.recording("b.mcap");
    std::fs::rename(&path, &renamed).unwrap();
    record(&path, &[("a-1", 5000), ("a-2", 6000)], true);
    assert_eq!(find(&folder, &job), Some(renamed.clone()));
    std::fs::remove_file(&renamed).unwrap();
    assert_eq!(find(&folder, &job), None);
    let of_the_other = Job::new(&path, "a-2", at(6000).0, "test");
    assert_eq!(find(&folder, &of_the_other), Some(path));
}

#[test]
fn a_renamed_recording_is_found_also_if_the_clock_was_ahead_at_its_capture() {
    let place = Place::new("");
    let path = place.recording("a.mcap");
    record(&path, &[("a-1", 1000)], true);
    let job = Job::new(&path, "a-1", at(1000).0, "test");
    assert!(
        !job.file.is_empty(),
        "a file system on which no file is known under another name"
    );
    let file = std::fs::File::options().write(true).open(&path).unwrap();
    let before = SystemTime::UNIX_EPOCH + Duration::from_secs(1_000_000_000);
    file.set_modified(before).unwrap();
    let renamed = place.recording("b.mcap");
    std::fs::rename(&path, &renamed).unwrap();
    assert_eq!(find(&place.path().join("recordings"), &job), Some(renamed));
}

#[test]
fn a_crash_between_a_capture_and_its_job_is_made_good() {
    let place = Place::new("make");
    let path = place.recording("a.mcap");
    record(&path, &[("a-1", 1000), ("a-2", 2000), ("a-3", 3000)], true);
    std::fs::create_dir_all(place.models().join("a/a-1")).unwrap();
    let jobs = place.jobs();
    jobs.enqueue(&Job::new(&path, "a-2", at(2000).0, "test"))
        .unwrap();
    let gone = place.recording("gone.mcap");
    assert!(jobs.enqueue_missing(&[path, gone], &place.models()));
    assert_eq!(jobs.backlog().waiting, 2);
    let (_workers, heard) = place.start(&jobs, |_| ());
    assert_eq!([heard.next().capture, heard.next().capture], ["a-2", "a-3"]);
}

#[test]
fn notes_that_were_written_while_no_daemon_ran_take_effect_at_its_start() {
    let place = Place::new("make");
    let path = place.recording("a.mcap");
    record(&path, &[("a-1", 1000), ("a-2", 2000), ("a-3", 3000)], true);
    let jobs = place.jobs();
    for (capture, ms) in [("a-1", 1000), ("a-2", 2000), ("a-3", 3000)] {
        jobs.enqueue(&Job::new(&path, capture, at(ms).0, "test"))
            .unwrap();
    }
    assert!(jobs.withdraw("a-2").is_some());
    drop(jobs);
    let note = |capture: &str, kind: &str, time| {
        let note = Note {
            capture: capture.into(),
            kind: kind.into(),
            text: String::new(),
            author: None,
        };
        note_beside(&Recording::open(&path).unwrap(), &note, at(time)).unwrap();
    };
    note("a-1", "reject", 9000);
    // What was rejected at the rig stays so until that is taken back.
    note("a-2", "reject", 8000);
    assert_eq!(
        place.jobs().heed_notes(),
        [("a-1".to_owned(), path.clone())]
    );
    assert_eq!(place.jobs().backlog().waiting, 1);
    note("a-2", "clear", 9000);
    let jobs = place.jobs();
    assert_eq!(jobs.heed_notes(), []);
    assert_eq!(jobs.backlog().waiting, 2);
    let (_workers, heard) = place.start(&jobs, |_| ());
    assert_eq!([heard.next().capture, heard.next().capture], ["a-2", "a-3"]);
}

#[test]
fn a_rejected_captures_job_goes_with_its_recording_but_not_while_that_is_only_away() {
    let place = Place::new("make");
    let path = place.recording("a.mcap");
    record(&path, &[("a-1", 1000)], true);
    let jobs = place.jobs();
    jobs.enqueue(&Job::new(&path, "a-1", at(1000).0, "test"))
        .unwrap();
    assert!(jobs.withdraw("a-1").is_some());
    assert!(jobs.has_jobs_of_session("a"));
    // A recording on a disk of its own, which is not mounted now.
    std::fs::remove_file(&path).unwrap();
    std::os::unix::fs::symlink(place.path().join("unmounted/a.mcap"), &path).unwrap();
    assert_eq!(jobs.heed_notes(), []);
    assert_eq!(place.left().len(), 1);
    std::fs::remove_file(&path).unwrap();
    assert_eq!(jobs.heed_notes(), []);
    assert_eq!(place.left(), [""; 0]);
    assert!(!jobs.has_jobs_of_session("a"));
}

#[test]
fn clients_are_told_what_the_next_model_is_made_with_also_after_a_reload() {
    let place = Place::new("make");
    let jobs = place.jobs();
    assert!(jobs.backlog().settings.is_empty());
    let settings = |amber: f64| format!("[verdict.background_age_h]\namber = {amber:?}\n");
    let told = |jobs: &Jobs| jobs.backlog().settings["verdict.background_age_h"]["amber"].clone();
    let (_workers, _heard) = place.start(&jobs, |plan| plan.settings = settings(36.0));
    assert_eq!(told(&jobs), 36.0);
    jobs.set_settings(&settings(7.5)).unwrap();
    assert_eq!(told(&jobs), 7.5);
}

#[test]
fn settings_that_are_there_are_not_written_again() {
    let place = Place::new("make");
    let jobs = place.jobs();
    let file = || std::fs::metadata(place.recording("jobs/settings.toml")).unwrap();
    jobs.set_settings("# one").unwrap();
    let before = file().ino();
    jobs.set_settings("# one").unwrap();
    assert_eq!(file().ino(), before);
    jobs.set_settings("# two").unwrap();
    assert_ne!(file().ino(), before);
}

/// A folder in the place of the settings makes writing them fail.
#[test]
fn a_start_goes_on_without_its_settings_and_models_wait_until_they_can_be_written() {
    let place = Place::new("make");
    let jobs = place.jobs();
    let settings = place.recording("jobs/settings.toml");
    std::fs::create_dir(&settings).unwrap();
    place.offer(&jobs, 1..=1);
    let (_workers, heard) = place.start(&jobs, |_| ());
    heard.nothing();
    std::fs::remove_dir(&settings).unwrap();
    assert!(heard.next().model.is_ok());
    assert_eq!(std::fs::read_to_string(settings).unwrap(), "# settings");
}

/// A status may ask for the backlog at any time, and what asks whether a job may begin waits for other locks.
#[test]
fn what_is_to_be_done_is_told_while_it_is_asked_whether_a_remake_or_an_object_may_begin() {
    let place = Place::new("make");
    let jobs = place.jobs();
    let settings = [("hull.resolution".to_owned(), 120.into())].into();
    let remake = Remake::new("a-0001", &settings).unwrap();
    jobs.remakes().enqueue(remake).unwrap();
    for capture in ["a-0001", "a-0002"] {
        let job = Job::new(Path::new("s.mcap"), capture, at(0).0, "pedal");
        jobs.objects().captured(job, "cup");
    }
    let (tell, told) = channel();
    std::thread::spawn(move || {
        let remake = jobs.remakes().take(|| jobs.backlog().remakes == 1);
        let object = jobs.objects().take(false, || jobs.backlog().objects == 1);
        tell.send((remake.is_some(), object.is_some()))
    });
    let limit = Duration::from_secs(20);
    assert_eq!(told.recv_timeout(limit), Ok((true, true)));
}
