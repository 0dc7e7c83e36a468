//! Tests objects' jobs on the disk and the processes that do them. These processes are shell scripts; `tests/rig` runs
//! the real ones.

use super::object_protocol::{CapturesFound, PosesFound};
use super::*;
use crate::clock::Clock;
use crate::frame::{CaptureId, Timestamp, Trigger};
use crate::level::Level;
use crate::recording::{CaptureOutcome, CaptureRecord, Compression, Writer};
use crate::support::wait::until;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::mpsc::{Receiver, channel};
use std::time::Duration;

/// What every script begins with: `$subject`, `$newest`, `$register`, `$nice` and `$out`, and `found` and `make`.
const BEGIN: &str = r#"
while [ $# -gt 0 ]; do
    case $1 in
    --subject=*) subject=${1#--subject=} ;;
    --newest=*) newest=${1#--newest=} ;;
    --nice=*) nice=${1#--nice=} ;;
    --out) out=$2 ;;
    --register) register=1 ;;
    esac
    shift
done
poses='{"verdict":"green","held_by":"colours","words":"held","left_out":[],"unseen_percent":9,"show_next":"below"}'
found() {
    if [ "$register" ]; then tell=$poses; else tell=null; fi
    echo "scand: found: {\"captures\":$1,\"has_folder\":false,\"poses\":$tell}" >&2
}
make() {
    mkdir -p "$out/s/$subject.object"
    echo '{"outcome":"done","verdict":{"level":"amber","reasons":[{"words":"a hand"}]}}' > "$out/s/$subject.object/report.json"
}
"#;

/// Recordings, models and a script, in a folder.
struct Place(tempfile::TempDir);

impl Place {
    fn new(script: &str) -> Self {
        let place = Self(tempfile::tempdir().unwrap());
        std::fs::create_dir(place.recordings()).unwrap();
        std::fs::write(place.recordings().join("s.mcap"), "").unwrap();
        place.does(script);
        place
    }

    /// From now on, processes do this.
    fn does(&self, script: &str) {
        let text = format!("{BEGIN}{script}\n");
        std::fs::write(self.path().join("worker.sh"), text).unwrap();
    }

    fn path(&self) -> &Path {
        self.0.path()
    }

    fn recordings(&self) -> PathBuf {
        self.path().join("recordings")
    }

    fn jobs(&self) -> Arc<Jobs> {
        Arc::new(Jobs::open(&self.recordings()).unwrap())
    }

    fn captured(&self, jobs: &Jobs, number: u64, subject: &str) {
        let capture = format!("s-{number:04}");
        let job = Job::new(&self.recordings().join("s.mcap"), &capture, number, "test");
        jobs.objects().captured(job, subject);
    }

    /// Whoever is told panics as often as `panics` says, and only then hears.
    fn start_with_panics(&self, jobs: &Arc<Jobs>, panics: u32) -> (Workers, Heard) {
        let plan = WorkerPlan {
            parameters: Parameters {
                folder: self.path().join("models"),
                ..Parameters::default()
            },
            settings: String::new(),
            clock: Clock::system(),
            method: crate::reconstruct::Method::default(),
            keep_free: Arc::default(),
            command: vec!["/bin/sh".into(), self.path().join("worker.sh").into()],
        };
        std::fs::create_dir_all(&plan.parameters.folder).unwrap();
        let (tell, heard) = channel();
        let left = AtomicU32::new(panics);
        let tell = move |news| {
            let fewer = |left: u32| left.checked_sub(1);
            let left = left.fetch_update(Ordering::Relaxed, Ordering::Relaxed, fewer);
            assert!(left.is_err(), "as this test wants it");
            drop(tell.send(news));
        };
        let workers = start_objects(jobs, plan, tell).unwrap();
        (workers, Heard(heard))
    }

    fn start(&self, jobs: &Arc<Jobs>) -> (Workers, Heard) {
        self.start_with_panics(jobs, 0)
    }

    /// The files of objects' jobs.
    fn left(&self) -> usize {
        let folder = self.recordings().join("jobs/objects");
        std::fs::read_dir(folder).map_or(0, Iterator::count)
    }
}

/// What was told.
struct Heard(Receiver<ObjectResult>);

impl Heard {
    fn next(&self) -> ObjectResult {
        self.0.recv_timeout(Duration::from_secs(300)).unwrap()
    }

    /// Nothing is told for longer than it takes to look whether something may begin.
    fn nothing(&self) {
        let told = self.0.recv_timeout(Duration::from_secs(1));
        assert!(told.is_err(), "{told:?}");
    }
}

fn capture_of(news: &ObjectResult) -> (&str, bool) {
    match news {
        ObjectResult::Registered { capture, .. } => (capture, true),
        ObjectResult::Fused { capture, .. } => (capture, false),
    }
}

#[test]
fn the_second_capture_of_a_subject_is_registered_and_then_fused() {
    let place = Place::new("found 2; [ \"$register\" ] || make");
    let jobs = place.jobs();
    let (_workers, heard) = place.start(&jobs);
    place.captured(&jobs, 1, "17");
    place.captured(&jobs, 2, "18");
    assert_eq!(place.left(), 0);
    place.captured(&jobs, 3, "17");
    let ObjectResult::Registered {
        subject,
        capture,
        poses,
    } = heard.next()
    else {
        panic!("it was fused first");
    };
    assert_eq!((subject.as_str(), capture.as_str()), ("17", "s-0003"));
    let expected = PosesFound {
        verdict: Level::Green,
        held_by: Some("colours".into()),
        words: "held".into(),
        left_out: Vec::new(),
        unseen_percent: 9,
        show_next: Some("below".into()),
    };
    assert_eq!(poses, expected);
    let ObjectResult::Fused { model, .. } = heard.next() else {
        panic!("it was registered twice");
    };
    let model = model.unwrap();
    assert_eq!(model.verdict, Level::Amber);
    assert!(model.folder.ends_with("s/17.object"));
    until("its job is done", || place.left() == 0 && jobs.is_idle());
}

#[test]
fn a_newer_capture_takes_the_place_of_the_job_that_waits() {
    let place = Place::new("found 3; [ \"$register\" ] || make");
    let jobs = place.jobs();
    for number in 1..=3 {
        place.captured(&jobs, number, "17");
    }
    assert_eq!((place.left(), jobs.objects().len()), (1, 1));
    let (_workers, heard) = place.start(&jobs);
    let told = [heard.next(), heard.next()];
    assert_eq!(
        told.each_ref().map(capture_of),
        [("s-0003", true), ("s-0003", false)]
    );
    until("its job is done", || place.left() == 0);
}

#[test]
fn poses_are_found_before_models_that_wait_and_the_object_is_fused_after_them() {
    let script = "echo $nice >> \"$out/nice\"; found 2; [ \"$register\" ] || make";
    let place = Place::new(script);
    let jobs = place.jobs();
    // The model of a capture waits, because nothing here makes any.
    let waiting = Job::new(&place.recordings().join("s.mcap"), "s-0001", 1, "test");
    jobs.enqueue(&waiting).unwrap();
    place.captured(&jobs, 1, "17");
    place.captured(&jobs, 2, "17");
    let (_workers, heard) = place.start(&jobs);
    assert_eq!(capture_of(&heard.next()), ("s-0002", true));
    heard.nothing();
    // It is being made.
    let taken = jobs.take().unwrap();
    heard.nothing();
    jobs.finish(&taken, true);
    assert_eq!(capture_of(&heard.next()), ("s-0002", false));
    let nice = std::fs::read_to_string(place.path().join("models/nice")).unwrap();
    let nice: Vec<u32> = nice.lines().map(|line| line.parse().unwrap()).collect();
    // Somebody waits for poses, and nobody for the object's model.
    assert!(nice.len() == 2 && nice[0] < nice[1], "{nice:?}");
}

#[test]
fn a_capture_that_comes_while_poses_are_found_has_them_found_next() {
    // The first one goes on until it is told to end.
    let place = Place::new(
        "found 2; [ \"$register\" ] || make; touch \"$out/begun-$newest\"
         while [ \"$newest\" = s-0002 ] && [ ! -e \"$out/go\" ]; do sleep 0.1; done",
    );
    let jobs = place.jobs();
    place.captured(&jobs, 1, "17");
    place.captured(&jobs, 2, "17");
    let (_workers, heard) = place.start(&jobs);
    let models = place.path().join("models");
    until("poses are being found", || {
        models.join("begun-s-0002").exists()
    });
    place.captured(&jobs, 3, "17");
    assert_eq!((place.left(), jobs.objects().len()), (1, 1));
    std::fs::write(models.join("go"), "").unwrap();
    let told = [heard.next(), heard.next(), heard.next()];
    // The older one is told, and no model is made of it.
    assert_eq!(
        told.each_ref().map(capture_of),
        [("s-0002", true), ("s-0003", true), ("s-0003", false)]
    );
    until("its job is done", || place.left() == 0);
}

#[test]
fn a_stop_while_poses_are_found_has_them_found_again() {
    let place = Place::new("touch \"$out/begun\"; sleep 600");
    let jobs = place.jobs();
    place.captured(&jobs, 1, "17");
    place.captured(&jobs, 2, "17");
    let (workers, heard) = place.start(&jobs);
    let begun = place.path().join("models/begun");
    until("poses are being found", || begun.exists());
    workers.stop();
    assert!(heard.0.try_recv().is_err());
    assert_eq!(place.left(), 1);
    place.does("found 2; [ \"$register\" ] || make");
    let again = place.jobs();
    let (_workers, heard) = place.start(&again);
    let told = [heard.next(), heard.next()];
    assert_eq!(
        told.each_ref().map(capture_of),
        [("s-0002", true), ("s-0002", false)]
    );
    until("its job is done", || place.left() == 0);
}

#[test]
fn a_process_that_is_killed_after_its_model_was_put_in_place_has_made_it() {
    let place = Place::new("found 2; [ \"$register\" ] || { make; kill -KILL $$; }");
    let jobs = place.jobs();
    place.captured(&jobs, 1, "17");
    place.captured(&jobs, 2, "17");
    let (_workers, heard) = place.start(&jobs);
    assert_eq!(capture_of(&heard.next()), ("s-0002", true));
    let ObjectResult::Fused { model, .. } = heard.next() else {
        panic!("it was registered twice");
    };
    assert_eq!(model.expect("its model lies there").verdict, Level::Amber);
}

#[test]
fn a_crash_repeats_a_job_but_not_for_ever() {
    let place = Place::new("found 2; [ \"$register\" ] || make");
    // What is told after the daemon ended without a word while it did a job that it had begun so often.
    let after_crashes = |begun: u32, is_registered: bool| -> Vec<ObjectResult> {
        let jobs = place.jobs();
        place.captured(&jobs, 1, "17");
        place.captured(&jobs, 2, "17");
        let mut taken = jobs.objects().take(false, || true).unwrap();
        taken.job.newest.begun = begun;
        taken.job.is_registered = is_registered;
        jobs.objects().note(&taken);
        drop(jobs);
        let jobs = place.jobs();
        let (_workers, heard) = place.start(&jobs);
        until("its job is done", || place.left() == 0);
        heard.0.try_iter().collect()
    };
    let too_often = "it was started 3 times";
    let told = after_crashes(3, true);
    let [ObjectResult::Fused { model, .. }] = &told[..] else {
        panic!("{told:?}");
    };
    let reason = model.as_ref().unwrap_err();
    assert!(reason.contains(too_often), "{reason}");
    let report = place.path().join("models/s/17.object/report.json");
    let report = std::fs::read_to_string(report).unwrap();
    assert!(report.contains(too_often), "{report}");
    for begun in [1, 3] {
        let told = after_crashes(begun, false);
        let [
            ObjectResult::Registered { poses, .. },
            ObjectResult::Fused { model, .. },
        ] = &told[..]
        else {
            panic!("{told:?}");
        };
        assert_eq!(poses.words.contains(too_often), begun == 3, "{poses:?}");
        // Who was told that there are no poses is not told that there is no model: that is tried anew.
        assert!(model.is_ok(), "{model:?}");
    }
}

#[test]
fn a_panic_repeats_a_job_but_not_for_ever_and_its_thread_goes_on() {
    let place = Place::new("found 2; [ \"$register\" ] || make");
    for (panics, is_told) in [(2, true), (4, false)] {
        let jobs = place.jobs();
        place.captured(&jobs, 1, "17");
        place.captured(&jobs, 2, "17");
        let (_workers, heard) = place.start_with_panics(&jobs, panics);
        until("its job is done", || place.left() == 0);
        let told: Vec<ObjectResult> = heard.0.try_iter().collect();
        assert_eq!(!told.is_empty(), is_told, "{told:?}");
        place.captured(&jobs, 3, "17");
        let told = heard.next();
        assert_eq!(capture_of(&told), ("s-0003", true));
    }
}

#[test]
fn a_stop_repeats_what_was_being_done() {
    let place =
        Place::new("if [ \"$register\" ]; then found 2; else touch \"$out/begun\"; sleep 600; fi");
    let jobs = place.jobs();
    place.captured(&jobs, 1, "17");
    place.captured(&jobs, 2, "17");
    let (workers, heard) = place.start(&jobs);
    assert_eq!(capture_of(&heard.next()), ("s-0002", true));
    let begun = place.path().join("models/begun");
    until("the model is being made", || begun.exists());
    workers.stop();
    assert_eq!(place.left(), 1);
    place.does("found 2; make");
    let again = place.jobs();
    assert!(again.has_jobs_of_session("s") && !again.is_idle());
    let (_workers, heard) = place.start(&again);
    // It was registered before.
    assert_eq!(capture_of(&heard.next()), ("s-0002", false));
    until("its job is done", || place.left() == 0);
}

#[test]
fn a_process_that_fails_leaves_a_report_and_ends_the_job() {
    let place = Place::new("echo 'scand: no light' >&2; exit 70");
    let jobs = place.jobs();
    place.captured(&jobs, 1, "../17");
    place.captured(&jobs, 2, "../17");
    let (_workers, heard) = place.start(&jobs);
    let ObjectResult::Registered { poses, .. } = heard.next() else {
        panic!("who waits for poses was told nothing");
    };
    assert_eq!(poses, PosesFound::failed("no light"));
    assert_eq!(poses.verdict, Level::Red);
    let ObjectResult::Fused { model, .. } = heard.next() else {
        panic!("poses were reported twice");
    };
    assert_eq!(model.unwrap_err(), "no light");
    let report = place.path().join("models/s/%2E.%2F17.object/report.json");
    assert!(
        std::fs::read_to_string(report)
            .unwrap()
            .contains("no light")
    );
    until("its job is done", || place.left() == 0);
}

/// A recording with a complete capture of each name and subject, a second apart.
fn record(path: &Path, captures: &[(&str, &str)]) {
    let mut writer = Writer::create(path, "test", Compression::None).unwrap();
    for (i, (id, subject)) in captures.iter().enumerate() {
        let number: u64 = id.rsplit('-').next().unwrap().parse().unwrap();
        let time = Timestamp(1_760_000_000_000_000_000 + number * 1_000_000_000);
        let trigger = Trigger {
            id: CaptureId::new(id).unwrap(),
            time,
            source: format!("test {i}"),
            press_id: None,
            subject: Some((*subject).into()),
            placement: None,
        };
        writer.trigger(&trigger).unwrap();
        let record = CaptureRecord {
            id: (*id).into(),
            outcome: CaptureOutcome::Complete,
            reason: None,
            skew_ns: None,
            cameras: Default::default(),
        };
        writer.capture(&record, time).unwrap();
    }
    writer.finish().unwrap();
}

#[test]
fn captures_in_all_recordings_of_a_session_count_and_an_empty_subject_is_none() {
    let place = Place::new("found 2");
    let [first, second] = ["s.mcap", "s-002.mcap"].map(|name| place.recordings().join(name));
    std::fs::remove_file(&first).unwrap();
    record(
        &first,
        &[("s-0001", "17"), ("s-0002", ""), ("s-0003", "18")],
    );
    record(&second, &[("s-0004", "17"), ("s-0005", "")]);
    let jobs = place.jobs();
    for alone in ["s-0002", "s-0003", "s-0005", "s-0009"] {
        jobs.objects().noted(alone);
        assert!(jobs.objects().is_empty(), "{alone}");
    }
    jobs.objects().noted("s-0001");
    assert_eq!(jobs.objects().len(), 1);
    let taken = jobs.objects().take(true, || true).unwrap();
    assert_eq!(taken.job.newest.capture, "s-0004");
    assert_eq!(taken.job.newest.recording, "s-002.mcap");
    // The same after a crash, whichever of the recordings was interrupted.
    jobs.objects().finish(&taken);
    assert!(jobs.enqueue_missing(&[first], &place.path().join("models")));
    assert_eq!(jobs.objects().len(), 1);
}

#[test]
fn a_note_on_a_capture_of_the_session_in_progress_reads_no_recording() {
    let place = Place::new("");
    let jobs = place.jobs();
    for (number, subject) in [(1, "17"), (2, "17"), (3, "18"), (4, "")] {
        place.captured(&jobs, number, subject);
    }
    let objects = jobs.objects();
    let registered = objects.take(false, || true).unwrap();
    objects.finish(&registered);
    for alone in ["s-0003", "s-0004", "s-0005"] {
        assert!(objects.noted_in_progress(alone));
        assert!(objects.is_empty(), "{alone}");
    }
    // In the recording, which is empty, nothing would be found.
    objects.noted("s-0001");
    assert_eq!(objects.len(), 1);
    let again = objects.take(true, || true).unwrap();
    assert_eq!(again.job.newest.capture, "s-0002");
    assert!(!objects.noted_in_progress("r-0001"));
    // Another session of this name, whose captures are others.
    place.captured(&jobs, 1, "17");
    objects.finish(&again);
    objects.noted("s-0001");
    assert!(objects.is_empty());
}

#[test]
fn what_a_note_asks_for_is_done_after_the_next_start_if_the_daemon_ends_before() {
    let place = Place::new("found 2; make");
    let recording = place.recordings().join("s.mcap");
    std::fs::remove_file(&recording).unwrap();
    record(&recording, &[("s-0001", "17"), ("s-0002", "17")]);
    place.jobs().objects().keep_noted("s-0001");
    let jobs = place.jobs();
    let (_workers, heard) = place.start(&jobs);
    assert_eq!(capture_of(&heard.next()), ("s-0002", false));
    until("its job is done", || place.left() == 0);
}

#[test]
fn with_one_capture_left_and_no_model_nothing_is_told() {
    let place = Place::new("poses=null; found 1");
    let jobs = place.jobs();
    place.captured(&jobs, 1, "17");
    place.captured(&jobs, 2, "17");
    let (_workers, heard) = place.start(&jobs);
    until("its job is done", || place.left() == 0);
    assert!(heard.0.try_recv().is_err());
    assert_eq!(CapturesFound::parse("scand: found: nonsense"), None);
}
