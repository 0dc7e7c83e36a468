//! Sessions cut into files, and sessions whose disk fails.

use super::testing::{Rig, at, frame, trigger};
use super::*;
use crate::calibration::{CalibrationLevel, CalibrationRecord, CalibrationVerdict};
use crate::frame::{Stream, Timestamp};
use std::collections::BTreeMap;
use std::path::Path;

fn session_header(rig: &Rig) -> SessionHeader {
    let plate = |ms| frame(rig.colors[0].id.clone(), Stream::Color, ms).picture;
    let colors = rig.colors.iter();
    SessionHeader {
        colors: rig.colors.clone(),
        depths: vec![rig.depth.clone()],
        volume: Some(rig.volume),
        calibration: Some(judged(CalibrationLevel::Doubtful)),
        settings: BTreeMap::new(),
        backgrounds: colors.map(|c| (c.id.clone(), (at(1), plate(1)))).collect(),
        configuration: "[rig]\nname = \"test\"\n".into(),
        about: BTreeMap::from([("operator".into(), "Ann".into())]),
    }
}

fn judged(level: CalibrationLevel) -> CalibrationRecord {
    CalibrationRecord {
        verdict: CalibrationVerdict {
            level,
            reasons: vec!["camera c0 moved by 0.70°".into()],
        },
        file_sha256: Some("ab12".into()),
    }
}

fn kept(rig: &Rig, id: &str, ms: u64) -> FinishedCapture {
    let colors = rig.colors.iter();
    let mut frames: Vec<_> = colors
        .map(|c| frame(c.id.clone(), Stream::Color, ms + 1))
        .collect();
    let depth = &rig.depth.camera.id;
    frames.extend((0..12).map(|i| frame(depth.clone(), Stream::Depth, ms + 33 * i)));
    FinishedCapture {
        trigger: trigger(id, ms),
        frames,
        record: CaptureRecord {
            id: id.into(),
            outcome: CaptureOutcome::Complete,
            reason: None,
            skew_ns: Some(0),
            cameras: BTreeMap::new(),
        },
        time: at(ms + 500),
    }
}

fn begin(folder: &Path, rig: &Rig, largest_file: u64) -> RecordingSession {
    RecordingSession::begin(
        folder,
        "s",
        "scand test",
        at(2),
        largest_file,
        session_header(rig),
    )
    .unwrap()
}

fn count(recording: &Recording, topic: &Topic) -> usize {
    recording.messages(topic).len()
}

#[test]
fn each_file_of_a_session_stands_alone() {
    let folder = tempfile::tempdir().unwrap();
    let rig = Rig::new();
    let one = kept(&rig, "a", 10_000).bytes();
    let mut session = begin(folder.path(), &rig, 2 * one);
    for (i, id) in ["a", "b", "c", "d", "e"].into_iter().enumerate() {
        let path = session.append(&kept(&rig, id, 10_000 * (i as u64 + 1)));
        let name = ["s.mcap", "s.mcap", "s-002.mcap", "s-002.mcap", "s-003.mcap"][i];
        assert_eq!(path.unwrap(), folder.path().join(name));
    }
    session.close().unwrap();
    for (name, captures) in [("s.mcap", 2), ("s-002.mcap", 2), ("s-003.mcap", 1)] {
        let recording = Recording::open(&folder.path().join(name)).unwrap();
        assert_eq!(recording.verify().unwrap(), []);
        assert_eq!(count(&recording, &Topic::Trigger), captures, "{name}");
        assert_eq!(count(&recording, &Topic::Capture), captures, "{name}");
        for part in [ColorPart::Calibration, ColorPart::Background] {
            let topic = Topic::Color(rig.colors[0].id.clone(), part);
            assert_eq!(count(&recording, &topic), 1, "{name}");
        }
        assert_eq!(count(&recording, &Topic::Volume), 1);
        assert_eq!(recording.attachments()[0].name, "rig.toml");
        let session = recording.metadata().iter().find(|(n, _)| n == "session");
        let about = &session.unwrap().1;
        assert_eq!((&*about["operator"], &*about["name"]), ("Ann", "s"));
        let said = recording.calibration_record().unwrap();
        assert_eq!(said, Some(judged(CalibrationLevel::Doubtful)), "{name}");
    }
}

#[test]
fn what_is_kept_is_on_the_disk_before_the_file_is_complete() {
    let folder = tempfile::tempdir().unwrap();
    let rig = Rig::new();
    let mut session = begin(folder.path(), &rig, u64::MAX);
    session.append(&kept(&rig, "a", 10_000)).unwrap();
    let part = folder.path().join("s.mcap.part");
    // As after a crash: a copy, because the writer holds a lock on the file itself.
    let copy = folder.path().join("copy.mcap.part");
    std::fs::copy(&part, &copy).unwrap();
    assert!(matches!(recover(&part), Err(Error::BeingWritten { .. })));
    let recovered = recover(&copy).unwrap();
    let recording = Recording::open(&recovered.path).unwrap();
    assert_eq!(count(&recording, &Topic::Capture), 1);
    assert_eq!(recovered.tail, None);
}

#[test]
fn plates_that_a_wrong_clock_put_into_the_future_count_from_the_capture_on() {
    let folder = tempfile::tempdir().unwrap();
    let rig = Rig::new();
    let mut ahead = session_header(&rig);
    for (time, _) in ahead.backgrounds.values_mut() {
        *time = at(7_200_000);
    }
    let mut session =
        RecordingSession::begin(folder.path(), "s", "scand test", at(2), 1 << 30, ahead).unwrap();
    let capture = kept(&rig, "a", 10_000);
    let path = session.append(&capture).unwrap();
    session.close().unwrap();
    let recording = Recording::open(&path).unwrap();
    let plates = Topic::Color(rig.colors[0].id.clone(), ColorPart::Background);
    assert_eq!(
        recording.messages(&plates)[0].log_time(),
        capture.trigger.time
    );
}

#[test]
fn what_the_rig_says_of_itself_is_what_it_says_now() {
    let folder = tempfile::tempdir().unwrap();
    let rig = Rig::new();
    let mut before = session_header(&rig);
    before
        .about
        .insert("calibration_sha256".into(), "old".into());
    let mut session =
        RecordingSession::begin(folder.path(), "s", "scand test", at(2), 1 << 30, before).unwrap();
    session.append(&kept(&rig, "a", 10_000)).unwrap();
    let about = BTreeMap::from([("calibration_sha256".into(), "new".into())]);
    let now = SessionHeader {
        about,
        ..session_header(&rig)
    };
    session.change(now, at(15_000)).unwrap();
    let path = session.append(&kept(&rig, "b", 20_000)).unwrap();
    session.close().unwrap();
    let recording = Recording::open(&path).unwrap();
    let mut metadata = recording.metadata().iter();
    let about = &metadata.find(|(name, _)| name == "session").unwrap().1;
    assert_eq!(about["calibration_sha256"], "new");
    assert_eq!(about["operator"], "Ann");
}

#[test]
fn new_plates_count_from_the_next_capture_on_and_in_every_file() {
    let folder = tempfile::tempdir().unwrap();
    let rig = Rig::new();
    let one = kept(&rig, "a", 10_000).bytes();
    let mut session = begin(folder.path(), &rig, 2 * one);
    session.append(&kept(&rig, "a", 10_000)).unwrap();
    let mut changed = session_header(&rig);
    for (time, _) in changed.backgrounds.values_mut() {
        *time = at(15_000);
    }
    session.change(changed, at(15_500)).unwrap();
    for (id, ms) in [("b", 20_000), ("c", 30_000)] {
        session.append(&kept(&rig, id, ms)).unwrap();
    }
    session.close().unwrap();
    let plates = Topic::Color(rig.colors[0].id.clone(), ColorPart::Background);
    let times = |name: &str| -> Vec<Timestamp> {
        let recording = Recording::open(&folder.path().join(name)).unwrap();
        let messages = recording.messages(&plates).iter();
        messages.map(MessageRef::log_time).collect()
    };
    assert_eq!(times("s.mcap"), [at(1), at(15_000)]);
    assert_eq!(times("s-002.mcap"), [at(15_000)]);
}

#[test]
fn another_calibration_begins_another_file_of_the_same_session() {
    let rig = Rig::new();
    let folder = tempfile::tempdir().unwrap();
    let mut session = begin(folder.path(), &rig, u64::MAX);
    session.append(&kept(&rig, "a", 10_000)).unwrap();
    let mut changed = session_header(&rig);
    changed.configuration = "[rig]\nname = \"other\"\n".into();
    changed.colors[0].intrinsics.focal_px.x += 1.0;
    changed.about.clear();
    session.change(changed.clone(), at(15_000)).unwrap();
    session.append(&kept(&rig, "b", 20_000)).unwrap();
    session.close().unwrap();
    let files = ["s.mcap", "s-002.mcap"].map(|name| folder.path().join(name));
    let [first, second] = files.map(|path| Recording::open(&path).unwrap());
    for (recording, focal) in [
        (first, rig.colors[0].intrinsics.focal_px.x),
        (second, changed.colors[0].intrinsics.focal_px.x),
    ] {
        assert_eq!(count(&recording, &Topic::Capture), 1);
        let topic = Topic::Color(rig.colors[0].id.clone(), ColorPart::Calibration);
        let message = recording.messages(&topic)[0];
        let read = recording.intrinsics(&topic, &message).unwrap();
        assert_eq!(read.focal_px.x, focal);
        let session = recording
            .metadata()
            .iter()
            .find(|(name, _)| name == "session");
        assert_eq!(session.unwrap().1["operator"], "Ann");
    }
}

#[test]
fn a_session_of_the_same_name_is_refused_and_no_file_of_another_is_in_the_way() {
    let folder = tempfile::tempdir().unwrap();
    let rig = Rig::new();
    std::fs::write(folder.path().join("s-002.mcap"), "in the way").unwrap();
    let one = kept(&rig, "a", 10_000).bytes();
    let mut session = begin(folder.path(), &rig, one);
    session.append(&kept(&rig, "a", 10_000)).unwrap();
    let path = session.append(&kept(&rig, "b", 20_000)).unwrap();
    assert_eq!(path, folder.path().join("s-003.mcap"));
    std::fs::write(folder.path().join("s-004.mcap.part"), "in the way").unwrap();
    let path = session.append(&kept(&rig, "c", 30_000)).unwrap();
    assert_eq!(path, folder.path().join("s-005.mcap"));
    session.close().unwrap();
    let again = RecordingSession::begin(
        folder.path(),
        "s",
        "scand test",
        at(2),
        1,
        session_header(&rig),
    );
    assert!(again.err().unwrap().to_string().contains("s.mcap"));
}

#[test]
fn what_is_being_written_is_whole_up_to_where_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let rig = Rig::new();
    let mut session = begin(folder.path(), &rig, 1 << 30);
    let path = session.append(&kept(&rig, "s-0001", 10)).unwrap();
    let part = unfinished_name(&path);
    let half = folder.path().join("half.mcap.part");
    let open = Recording::open(&part).unwrap();
    assert_eq!((open.damage(), open.verify().unwrap()), (&[][..], vec![]));
    assert_eq!(count(&open, &Topic::Capture), 1);
    // The same bytes and half a record, whose writer is at work, and then ends.
    let mut bytes = std::fs::read(&part).unwrap();
    bytes.extend_from_slice(&bytes.clone()[8..40]);
    std::fs::write(&half, bytes).unwrap();
    let writer = std::fs::File::open(&half).unwrap();
    writer.lock().unwrap();
    let open = Recording::open(&half).unwrap();
    assert_eq!((open.damage(), count(&open, &Topic::Capture)), (&[][..], 1));
    drop(writer);
    assert_eq!(Recording::open(&half).unwrap().damage().len(), 1);
    session.close().unwrap();
    assert_eq!(Recording::open(&path).unwrap().damage(), []);
}

#[test]
fn a_session_whose_file_broke_is_completed_by_a_later_close() {
    let folder = tempfile::tempdir().unwrap();
    let rig = Rig::new();
    let mut session = begin(folder.path(), &rig, 1 << 30);
    let path = session.append(&kept(&rig, "a", 10_000)).unwrap();
    assert_eq!(session.earlier_file_of("a"), None);
    session.break_file();
    let note = Note {
        capture: "a".into(),
        kind: "accept".into(),
        text: String::new(),
        author: None,
    };
    session.note(&note, at(11_000)).unwrap_err();
    assert!(unfinished_name(&path).exists() && !path.exists());
    assert_eq!(session.earlier_file_of("a"), Some(unfinished_name(&path)));
    // Something keeps the file from its name.
    std::fs::write(&path, "in the way").unwrap();
    for _ in 0..2 {
        let error = session.close().unwrap_err().to_string();
        assert!(error.contains("s.mcap"), "{error}");
        assert!(unfinished_name(&path).exists());
    }
    std::fs::remove_file(&path).unwrap();
    session.close().unwrap();
    assert!(!unfinished_name(&path).exists());
    let recording = Recording::open(&path).unwrap();
    assert_eq!(recording.damage(), []);
    assert_eq!(count(&recording, &Topic::Capture), 1);
}

#[test]
fn a_file_that_lacks_only_its_name_gets_it_from_a_later_close() {
    let folder = tempfile::tempdir().unwrap();
    let rig = Rig::new();
    let mut session = begin(folder.path(), &rig, 1 << 30);
    let path = session.append(&kept(&rig, "a", 10_000)).unwrap();
    std::fs::write(&path, "in the way").unwrap();
    session.close().unwrap_err();
    session.close().unwrap_err();
    std::fs::remove_file(&path).unwrap();
    session.close().unwrap();
    assert_eq!(Recording::open(&path).unwrap().damage(), []);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
}
