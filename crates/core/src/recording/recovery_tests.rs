//! Tests that what a crash leaves behind becomes a complete recording, without any loss.

use super::testing::*;
use super::*;
use crate::frame::Timestamp;
use std::os::unix::fs::{MetadataExt, PermissionsExt, chown};
use std::path::{Path, PathBuf};

/// The writer of a recording that was synced after each of two captures.
fn unfinished_writer(folder: &Path) -> Writer {
    writer_of(folder, ["cup-1", "cup-2"])
}

fn writer_of(folder: &Path, captures: [&str; 2]) -> Writer {
    let path = folder.join("a.mcap");
    let mut writer = Writer::create(&path, "scand 1.2.3", Compression::None).unwrap();
    let rig = Rig::new();
    writer
        .attach("rig.toml", "application/toml", at(0), b"a = 1\n")
        .unwrap();
    rig.write_to(&mut writer);
    for (id, ms) in captures.into_iter().zip([100, 5000]) {
        rig.write_capture(&mut writer, id, ms, 3);
        writer.sync().unwrap();
    }
    writer
}

/// The bytes of that recording if the machine stopped then.
fn cut_off(folder: &Path) -> Vec<u8> {
    let writer = unfinished_writer(folder);
    let bytes = std::fs::read(folder.join("a.mcap.part")).unwrap();
    drop(writer);
    std::fs::remove_file(folder.join("a.mcap.part")).unwrap();
    bytes
}

fn part_of(folder: &Path, bytes: &[u8]) -> PathBuf {
    let part = folder.join("a.mcap.part");
    std::fs::write(&part, bytes).unwrap();
    part
}

/// Topic, log time and data.
type Message = (String, Timestamp, Vec<u8>);

/// Every message.
fn messages(path: &Path) -> Vec<Message> {
    let recording = Recording::open(path).unwrap();
    let mut all = Vec::new();
    for topic in recording.topics() {
        for message in recording.messages(topic) {
            if let Ok((data, _)) = recording.read(topic, message) {
                all.push((topic.to_string(), message.log_time(), data.to_vec()));
            }
        }
    }
    all
}

#[test]
fn a_recovered_recording_and_its_tail_belong_to_whom_the_part_belonged() {
    let folder = tempfile::tempdir().unwrap();
    let bytes = cut_off(folder.path());
    let part = part_of(folder.path(), &bytes[..bytes.len() - 200]);
    std::fs::set_permissions(&part, std::fs::Permissions::from_mode(0o640)).unwrap();
    // Only root can.
    let _ = chown(&part, Some(12_345), Some(23_456));
    let of = |path: &Path| std::fs::metadata(path).map(|m| (m.uid(), m.gid(), m.mode() & 0o777));
    let expected = of(&part).unwrap();
    let recovered = recover(&part).unwrap();
    let (tail, _) = recovered.tail.unwrap();
    assert_eq!(of(&recovered.path).unwrap(), expected);
    assert_eq!(of(&tail).unwrap(), expected);
}

#[test]
fn a_completed_copy_and_its_notes_belong_to_whom_the_originals_belong() {
    let folder = tempfile::tempdir().unwrap();
    let bytes = cut_off(folder.path());
    let cut = folder.path().join("cut.mcap");
    std::fs::write(&cut, &bytes[..bytes.len() - 200]).unwrap();
    std::fs::write(beside(&cut), "").unwrap();
    let of = |path: &Path| std::fs::metadata(path).map(|m| (m.uid(), m.gid(), m.mode() & 0o777));
    for original in [&cut, &beside(&cut)] {
        std::fs::set_permissions(original, std::fs::Permissions::from_mode(0o440)).unwrap();
        // Only root can.
        let _ = chown(original, Some(12_345), Some(23_456));
    }
    let (owner, group, _) = of(&cut).unwrap();
    let recovered = recover_copy(&cut).unwrap();
    for copy in [&recovered.path, &beside(&recovered.path)] {
        // Its owner can write to it, too.
        assert_eq!(of(copy).unwrap(), (owner, group, 0o640));
    }
}

#[test]
fn a_recording_that_was_just_begun_is_completed() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let _writer = Writer::create(&path, "scand 1.2.3", Compression::None).unwrap();
    let elsewhere = tempfile::tempdir().unwrap();
    let bytes = std::fs::read(folder.path().join("a.mcap.part")).unwrap();
    let recovered = recover(&part_of(elsewhere.path(), &bytes)).unwrap();
    assert_eq!((recovered.messages, recovered.tail), (0, None));
}

#[test]
fn one_that_was_cut_off_before_its_first_byte_is_completed_too() {
    let folder = tempfile::tempdir().unwrap();
    let recovered = recover(&part_of(folder.path(), b"")).unwrap();
    assert_eq!((recovered.messages, recovered.tail), (0, None));
    let recording = Recording::open(&recovered.path).unwrap();
    assert_eq!(recording.verify().unwrap(), []);
    assert!(unfinished(folder.path()).unwrap().is_empty());
}

#[test]
fn a_chunk_that_was_growing_is_kept_apart_and_what_was_synced_before_it_is_whole() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let mut writer = Writer::create(&path, "scand 1.2.3", Compression::None).unwrap();
    let rig = Rig::new();
    rig.write_to(&mut writer);
    rig.write_capture(&mut writer, "cup-1", 100, 3);
    writer.sync().unwrap();
    let part = folder.path().join("a.mcap.part");
    let synced = std::fs::read(&part).unwrap();
    // Frames that are larger than what is gathered: the chunk they are in is on its way when the machine stops.
    let frame = crate::frame::Frame {
        camera: camera_id("c00"),
        stream: crate::frame::Stream::Color,
        timestamp: at(5000),
        picture: crate::frame::Picture::Raw {
            width: 640,
            height: 480,
            encoding: "mono8".into(),
            step: 640,
            data: vec![7; 640 * 480].into(),
        },
    };
    writer.frame(&frame).unwrap();
    let bytes = std::fs::read(&part).unwrap();
    assert!(bytes.len() > synced.len() + 300_000, "{}", bytes.len());
    let elsewhere = tempfile::tempdir().unwrap();
    let before = messages(&part_of(elsewhere.path(), &synced));
    let recovered = recover(&part_of(elsewhere.path(), &bytes)).unwrap();
    assert_eq!(messages(&recovered.path), before);
    let (tail, length) = recovered.tail.unwrap();
    assert_eq!(length as usize, bytes.len() - synced.len());
    assert!(std::fs::read(tail).unwrap() == bytes[synced.len()..]);
}

#[test]
fn a_recording_cut_off_anywhere_is_completed_and_keeps_every_byte() {
    let folder = tempfile::tempdir().unwrap();
    let bytes = cut_off(folder.path());
    let mut most = 0;
    for end in (40..bytes.len()).step_by(1009).chain([bytes.len()]) {
        let part = part_of(folder.path(), &bytes[..end]);
        let before = messages(&part);
        let recovered = recover(&part).unwrap_or_else(|e| panic!("{end}: {e}"));
        assert!(!part.exists());
        assert_eq!(recovered.path, folder.path().join("a.mcap"));
        let recording = Recording::open(&recovered.path).unwrap();
        assert_eq!(recording.verify().unwrap(), [], "{end}");
        assert_eq!(messages(&recovered.path), before, "{end}");
        assert_eq!(recovered.messages, before.len() as u64);
        assert!(recovered.messages >= most, "less of a longer file");
        most = recovered.messages;
        if let Some((tail, length)) = &recovered.tail {
            let kept = std::fs::read(tail).unwrap();
            assert_eq!(kept, bytes[end - *length as usize..end]);
            std::fs::remove_file(tail).unwrap();
        }
        std::fs::remove_file(&recovered.path).unwrap();
        let left = std::fs::read_dir(folder.path()).unwrap().count();
        assert_eq!(left, 0, "{end}");
    }
    let whole = messages(&part_of(folder.path(), &bytes));
    assert_eq!(most, whole.len() as u64);
    let recording = recover(&folder.path().join("a.mcap.part")).unwrap();
    let recording = Recording::open(&recording.path).unwrap();
    assert_eq!(recording.attachments().len(), 1);
    assert_eq!(recording.metadata().len(), 1);
}

/// Puts a recording that was cut off there, completes it, and says whether it is the same file still.
fn completed(folder: &Path, bytes: &[u8]) -> (Recovered, bool) {
    let part = part_of(folder, bytes);
    let inode = std::fs::metadata(&part).unwrap().ino();
    let recovered = recover(&part).unwrap();
    let is_same = std::fs::metadata(&recovered.path).unwrap().ino() == inode;
    (recovered, is_same)
}

#[test]
fn one_that_lacks_only_its_end_is_not_copied_and_is_what_would_have_been_written() {
    let folder = tempfile::tempdir().unwrap();
    let bytes = cut_off(folder.path());
    let (recovered, in_place) = completed(folder.path(), &bytes);
    assert!(in_place && recovered.tail.is_none());
    let complete = std::fs::read(&recovered.path).unwrap();
    assert!(complete.starts_with(&bytes));
    std::fs::remove_file(&recovered.path).unwrap();

    // Written to its end without a stop.
    let path = folder.path().join("a.mcap");
    unfinished_writer(folder.path()).finish().unwrap();
    assert!(complete == std::fs::read(&path).unwrap());

    // The machine stopped again while the end was being written, at whatever byte of it.
    for end in (bytes.len()..=complete.len())
        .step_by(37)
        .chain([complete.len()])
    {
        std::fs::remove_file(&path).unwrap();
        let (recovered, in_place) = completed(folder.path(), &complete[..end]);
        assert!(in_place && recovered.tail.is_none(), "{end}");
        assert!(complete == std::fs::read(&path).unwrap(), "{end}");
    }
}

#[test]
fn what_a_power_cut_made_of_the_end_costs_nothing_that_was_kept_before() {
    let folder = tempfile::tempdir().unwrap();
    let bytes = cut_off(folder.path());
    let path = folder.path().join("a.mcap");
    let (first, _) = completed(folder.path(), &bytes);
    let complete = std::fs::read(&path).unwrap();
    // A first recovery has kept a tail, cut it away, and was stopped while it wrote the end: a block of it is zeros.
    let tail = folder.path().join("a.mcap.tail");
    std::fs::write(&tail, b"of the first").unwrap();
    let mut torn = complete.clone();
    torn[bytes.len()..].fill(0);
    std::fs::remove_file(&path).unwrap();
    let (second, in_place) = completed(folder.path(), &torn);
    assert!(in_place);
    assert_eq!(second.messages, first.messages);
    assert_eq!(Recording::open(&path).unwrap().verify().unwrap(), []);
    let (kept, length) = second.tail.unwrap();
    assert_eq!(length as usize, torn.len() - bytes.len());
    assert!(std::fs::read(kept).unwrap() == torn[bytes.len()..]);
    assert_eq!(std::fs::read(&tail).unwrap(), b"of the first");
}

#[test]
fn a_recovery_that_was_stopped_before_the_cut_keeps_its_tail_once() {
    let folder = tempfile::tempdir().unwrap();
    let bytes = cut_off(folder.path());
    let cut = &bytes[..bytes.len() - 200];
    let (first, in_place) = completed(folder.path(), cut);
    let (tail, length) = first.tail.unwrap();
    assert!(in_place && length > 0);
    std::fs::remove_file(&first.path).unwrap();
    // The tail was on the disk, and the recording as it had been.
    let (again, _) = completed(folder.path(), cut);
    assert_eq!(again.tail, Some((tail, length)));
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2);
}

#[test]
fn a_chunks_index_that_lies_is_made_anew() {
    let folder = tempfile::tempdir().unwrap();
    let bytes = cut_off(folder.path());
    let whole = messages(&part_of(folder.path(), &bytes));
    let (first, _) = completed(folder.path(), &bytes);
    let complete = std::fs::read(&first.path).unwrap();
    std::fs::remove_file(&first.path).unwrap();
    // The last record is an index; its last eight bytes say where the last message is.
    let last = bytes.len() - 8;
    // A chunk's head: what its first byte of the first log time says, nothing checks.
    let chunk = records_of(&bytes)
        .into_iter()
        .rfind(|(opcode, ..)| *opcode == mcap::records::op::CHUNK);
    let (_, head, _) = chunk.unwrap();
    for at in [last, head + 9] {
        let mut lying = bytes.clone();
        lying[at] ^= 1;
        let (recovered, in_place) = completed(folder.path(), &lying);
        assert!(in_place && recovered.tail.is_none());
        assert_eq!(messages(&recovered.path), whole);
        assert!(std::fs::read(&recovered.path).unwrap() == complete, "{at}");
        std::fs::remove_file(&recovered.path).unwrap();
    }
}

#[test]
fn a_flipped_bit_moves_what_is_behind_it_into_the_tail() {
    let folder = tempfile::tempdir().unwrap();
    let bytes = cut_off(folder.path());
    let mut with_a_tail = 0;
    for at in (60..bytes.len()).step_by(1511) {
        let mut damaged = bytes.clone();
        damaged[at] ^= 0x10;
        let part = part_of(folder.path(), &damaged);
        let found = match recover(&part) {
            Ok(recovered) => recovered,
            // What cannot be understood stays where it is.
            Err(error) => {
                assert_eq!(std::fs::read(&part).unwrap(), damaged, "{at}: {error}");
                continue;
            }
        };
        let (kept, tail) = kept(&found);
        assert!(damaged.ends_with(&tail), "{at}");
        clear(folder.path());
        let before = part_of(folder.path(), &bytes[..bytes.len() - tail.len()]);
        assert!(kept == messages(&before), "{at}");
        with_a_tail += usize::from(!tail.is_empty());
        clear(folder.path());
    }
    assert!(with_a_tail > 0);
}

#[test]
fn what_another_program_wrote_is_completed_as_well() {
    let folder = tempfile::tempdir().unwrap();
    let plain = mcap::WriteOptions::new()
        .library("other 7")
        .compression(None);
    let packed = |compression| plain.clone().compression(Some(compression));
    let without_sums = plain.clone().calculate_chunk_crcs(false);
    let ways = [
        plain.clone(),
        plain.clone().emit_message_indexes(false),
        plain.clone().use_chunks(false),
        packed(mcap::Compression::Zstd),
        packed(mcap::Compression::Lz4),
        // Its end has no sum either, and is written anew.
        without_sums.calculate_data_section_crc(false),
    ];
    let last = ways.len() - 1;
    for (number, options) in ways.into_iter().enumerate() {
        let bytes = {
            let path = folder.path().join("b.mcap");
            write_as_another(&path, options);
            let bytes = std::fs::read(&path).unwrap();
            std::fs::remove_file(path).unwrap();
            bytes
        };
        for end in (40..bytes.len()).step_by(2003).chain([bytes.len()]) {
            let before = messages(&part_of(folder.path(), &bytes[..end]));
            let (recovered, in_place) = completed(folder.path(), &bytes[..end]);
            assert!(in_place);
            let (kept, tail) = kept(&recovered);
            assert!(kept == before, "{number} cut at {end}");
            assert!(bytes[..end].ends_with(&tail));
            let has_our_end = number < last && end == bytes.len();
            assert!(!has_our_end || tail.is_empty(), "{number}");
            clear(folder.path());
        }
    }
}

fn clear(folder: &Path) {
    for entry in std::fs::read_dir(folder).unwrap() {
        std::fs::remove_file(entry.unwrap().path()).unwrap();
    }
}

/// The messages of what was recovered, and the bytes of its tail.
fn kept(recovered: &Recovered) -> (Vec<Message>, Vec<u8>) {
    let recording = Recording::open(&recovered.path).unwrap();
    assert_eq!(recording.verify().unwrap(), []);
    let tail = recovered.tail.as_ref();
    let tail = tail.map_or_else(Vec::new, |(path, length)| {
        let tail = std::fs::read(path).unwrap();
        assert_eq!(tail.len() as u64, *length);
        tail
    });
    (messages(&recovered.path), tail)
}

#[test]
fn another_recording_of_that_name_is_not_touched_but_an_equal_one_is_enough() {
    let folder = tempfile::tempdir().unwrap();
    let bytes = cut_off(folder.path());
    let part = part_of(folder.path(), &bytes);
    let path = folder.path().join("a.mcap");
    std::fs::write(&path, b"mine").unwrap();
    assert!(recover(&part).is_err());
    assert_eq!(std::fs::read(&path).unwrap(), b"mine");
    assert_eq!(std::fs::read(&part).unwrap(), bytes);
    // Nor is anything left beside them where a part of the recording cannot be read.
    part_of(folder.path(), &bytes[..bytes.len() - 5]);
    assert!(recover(&part).is_err());
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2);
    part_of(folder.path(), &bytes);
    // One of as many messages is not enough.
    let elsewhere = tempfile::tempdir().unwrap();
    writer_of(elsewhere.path(), ["cup-1", "cup-3"])
        .finish()
        .unwrap();
    std::fs::copy(elsewhere.path().join("a.mcap"), &path).unwrap();
    let error = recover(&part).unwrap_err().to_string();
    assert!(error.contains("exists"), "{error}");
    assert_eq!(std::fs::read(&part).unwrap(), bytes);

    std::fs::remove_file(&path).unwrap();
    recover(&part).unwrap();
    // A crash before the `.part` was removed.
    let part = part_of(folder.path(), &bytes);
    let complete = std::fs::read(&path).unwrap();
    recover(&part).unwrap();
    assert!(!part.exists());
    assert_eq!(std::fs::read(&path).unwrap(), complete);
}

#[test]
fn one_that_has_its_name_already_is_enough_and_its_tail_is_kept_too() {
    let folder = tempfile::tempdir().unwrap();
    let mut damaged = cut_off(folder.path());
    let middle = damaged.len() / 2;
    damaged[middle] ^= 1;
    let first = recover(&part_of(folder.path(), &damaged)).unwrap();
    let kept = kept(&first);
    for has_tail in [true, false] {
        let part = part_of(folder.path(), &damaged);
        if !has_tail {
            std::fs::remove_file(folder.path().join("a.mcap.tail")).unwrap();
        }
        let again = recover(&part).unwrap();
        assert_eq!(again, first);
        assert!(self::kept(&again) == kept);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2);
    }
}

#[test]
fn what_is_being_written_or_is_no_recording_stays() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("b.mcap");
    let writer = Writer::create(&path, "scand 1.2.3", Compression::None).unwrap();
    let part = folder.path().join("b.mcap.part");
    assert_eq!(
        unfinished(folder.path()).unwrap(),
        std::slice::from_ref(&part)
    );
    assert!(matches!(recover(&part), Err(Error::BeingWritten { .. })));
    drop(writer);
    std::fs::write(&part, b"not a recording").unwrap();
    assert!(matches!(recover(&part), Err(Error::NotMcap { .. })));
    assert!(part.exists());
    let other = folder.path().join("c.mcap");
    assert!(matches!(recover(&other), Err(Error::NotUnfinished { .. })));
}

#[test]
fn the_tails_of_a_recording_are_found_in_the_order_of_their_recoveries() {
    let folder = tempfile::tempdir().unwrap();
    let recording = folder.path().join("a.mcap");
    assert_eq!(tails(&recording).unwrap(), []);
    let tails_are = ["tail", "tail-2", "tail-10"];
    let others = [
        "tail-1",
        "tail-x",
        "tail-+3",
        "tail.recovering",
        "part",
        "b.tail",
    ];
    for ending in tails_are.into_iter().chain(others) {
        std::fs::write(folder.path().join(format!("a.mcap.{ending}")), "x").unwrap();
    }
    std::fs::write(folder.path().join("b.mcap.tail"), "x").unwrap();
    let found = tails(&recording).unwrap();
    let endings: Vec<&str> = found.iter().map(|(ending, _)| ending.as_str()).collect();
    assert_eq!(endings, tails_are);
    assert!(found.iter().all(|(_, path)| path.is_file()));
    assert!(tails(&folder.path().join("none/a.mcap")).is_err());
}
