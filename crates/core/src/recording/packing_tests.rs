//! Tests that a packed recording has the same messages, and that one that could not be packed is unchanged.

use super::rewriting::with_ending;
use super::testing::*;
use super::*;
use crate::frame::Timestamp;
use std::cell::Cell;
use std::fs;
use std::os::unix::fs::{MetadataExt, PermissionsExt, chown};
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

/// Pictures that shrink, over several chunks.
fn recorded(folder: &Path) -> PathBuf {
    let path = folder.join("a.mcap");
    let mut writer = Writer::create(&path, "scand 1.2.3", Compression::None).unwrap();
    let rig = Rig::new();
    let text = b"a = 1\n".repeat(3000);
    writer
        .attach("rig.toml", "application/toml", at(0), &text)
        .unwrap();
    let session = [("name".to_owned(), "cups".to_owned())].into();
    writer.metadata("session", &session).unwrap();
    rig.write_to(&mut writer);
    for (id, ms) in [("cup-1", 100), ("cup-2", 5000), ("cup-3", 9000)] {
        rig.write_capture(&mut writer, id, ms, 30);
        writer.sync().unwrap();
    }
    writer.finish().unwrap();
    path
}

type Content = (
    Vec<(String, Timestamp, Vec<u8>)>,
    Vec<(String, std::collections::BTreeMap<String, String>)>,
    Vec<Vec<u8>>,
);

/// All messages, metadata and attachments.
fn content(path: &Path) -> Content {
    let recording = Recording::open(path).unwrap();
    let mut messages = Vec::new();
    for topic in recording.topics() {
        for message in recording.messages(topic) {
            let (data, _) = recording.read(topic, message).unwrap();
            messages.push((topic.to_string(), message.log_time(), data.to_vec()));
        }
    }
    let attachments = recording.attachments().iter();
    let attachments = attachments.map(|a| recording.attachment(a).unwrap());
    (
        messages,
        recording.metadata().to_vec(),
        attachments.collect(),
    )
}

fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).unwrap();
    let name = |e: std::io::Result<fs::DirEntry>| e.unwrap().file_name().into_string().unwrap();
    let mut names: Vec<String> = entries.map(name).collect();
    names.sort();
    names
}

#[test]
fn a_packed_recording_is_smaller_and_holds_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let path = recorded(folder.path());
    let before = content(&path);
    let length = fs::metadata(&path).unwrap().len();
    let taken = SystemTime::UNIX_EPOCH + Duration::from_secs(1_700_000_000);
    fs::File::open(&path).unwrap().set_modified(taken).unwrap();
    fs::set_permissions(&path, fs::Permissions::from_mode(0o640)).unwrap();
    // Only root can: what others pack is theirs.
    let _ = chown(&path, Some(12_345), Some(23_456));
    let owner = fs::metadata(&path).map(|m| (m.uid(), m.gid())).unwrap();

    let Packed::Smaller(was, is) = pack(&path, || true).unwrap() else {
        panic!("it shrinks")
    };
    let after = fs::metadata(&path).unwrap();
    assert_eq!((was, is), (length, after.len()));
    assert!(is < length / 10 * 7, "{is} of {length}");
    assert_eq!(content(&path), before);
    assert_eq!(after.modified().unwrap(), taken);
    assert_eq!(after.permissions().mode() & 0o777, 0o640);
    assert_eq!((after.uid(), after.gid()), owner);
    assert_eq!(names(folder.path()), ["a.mcap"]);
    let recording = Recording::open(&path).unwrap();
    assert_eq!(recording.written_by(), ("scand", "scand 1.2.3"));
    assert_eq!(recording.verify().unwrap(), []);
    assert_eq!(pack(&path, || true).unwrap(), Packed::Already);
}

#[test]
fn it_is_given_up_at_any_record_and_the_original_stays() {
    let folder = tempfile::tempdir().unwrap();
    let path = recorded(folder.path());
    let bytes = fs::read(&path).unwrap();
    for last in [0, 1, 5, 9] {
        let asked = Cell::new(0);
        let goes_on = || asked.replace(asked.get() + 1) < last;
        assert_eq!(pack(&path, goes_on).unwrap(), Packed::GivenUp);
        assert_eq!(fs::read(&path).unwrap(), bytes);
        assert_eq!(names(folder.path()), ["a.mcap"]);
    }
}

#[test]
fn a_damaged_recording_is_not_touched() {
    let folder = tempfile::tempdir().unwrap();
    let path = recorded(folder.path());
    let mut bytes = fs::read(&path).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 0x10;
    fs::write(&path, &bytes).unwrap();
    assert!(pack(&path, || true).is_err());
    assert_eq!(fs::read(&path).unwrap(), bytes);
    assert_eq!(names(folder.path()), ["a.mcap"]);
}

#[test]
fn what_an_earlier_attempt_left_is_in_nobodys_way() {
    let folder = tempfile::tempdir().unwrap();
    let path = recorded(folder.path());
    fs::write(folder.path().join("a.mcap.packing"), b"a part").unwrap();
    assert!(matches!(pack(&path, || true).unwrap(), Packed::Smaller(..)));
    assert_eq!(names(folder.path()), ["a.mcap"]);
}

#[test]
fn one_that_is_moved_meanwhile_does_not_come_back() {
    let folder = tempfile::tempdir().unwrap();
    let path = recorded(folder.path());
    let elsewhere = folder.path().join("b.mcap");
    let bytes = fs::read(&path).unwrap();
    let moved = Cell::new(false);
    let goes_on = || {
        if !moved.replace(true) {
            fs::rename(&path, &elsewhere).unwrap();
        }
        true
    };
    assert!(pack(&path, goes_on).is_err());
    assert_eq!(fs::read(&elsewhere).unwrap(), bytes);
    assert_eq!(names(folder.path()), ["b.mcap"]);
}

#[test]
fn two_do_not_pack_one() {
    let folder = tempfile::tempdir().unwrap();
    let path = recorded(folder.path());
    let tried = Cell::new(false);
    let goes_on = || {
        if !tried.replace(true) {
            let second = pack(&path, || true);
            assert!(
                matches!(second, Err(Error::BeingWritten { .. })),
                "{second:?}"
            );
        }
        true
    };
    assert!(matches!(pack(&path, goes_on).unwrap(), Packed::Smaller(..)));
}

#[test]
fn a_link_to_a_recording_stays_a_link() {
    let folder = tempfile::tempdir().unwrap();
    let path = recorded(folder.path());
    let link = folder.path().join("link.mcap");
    std::os::unix::fs::symlink(&path, &link).unwrap();
    assert!(matches!(pack(&link, || true).unwrap(), Packed::Smaller(..)));
    assert!(link.symlink_metadata().unwrap().is_symlink());
    assert!(Recording::open(&path).unwrap().is_packed());
}

#[test]
fn packing_is_given_up_while_the_copy_is_checked_too() {
    let folder = tempfile::tempdir().unwrap();
    let path = recorded(folder.path());
    let before = std::fs::read(&path).unwrap();
    let packed = with_ending(&path, "packing");
    // Only a finished copy can be opened.
    let goes_on = || Recording::open(&packed).is_err();
    assert!(matches!(pack(&path, goes_on).unwrap(), Packed::GivenUp));
    assert!(!packed.exists());
    assert_eq!(std::fs::read(&path).unwrap(), before);
}

#[test]
fn what_another_program_wrote_of_itself_stays() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let options = mcap::WriteOptions::new().library("other 7");
    let options = options.emit_message_indexes(false).compression(None);
    write_as_another(&path, options);
    let before = content(&path);
    assert_eq!(before.0.len(), 50);
    assert!(matches!(pack(&path, || true).unwrap(), Packed::Smaller(..)));
    assert_eq!(content(&path), before);
    let recording = Recording::open(&path).unwrap();
    assert_eq!(recording.written_by().1, "other 7");
    assert_eq!(recording.verify().unwrap(), []);
}
