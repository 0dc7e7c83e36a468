//! Files that are broken, cut off or hostile: each is an error or a note of what is lost, never a panic and
//! never more memory than the file justifies.

use super::testing::*;
use super::*;
use mcap::records::op;
use std::path::PathBuf;
use std::time::Duration;

/// Reads everything that a recording gives away.
fn read_all(recording: &Recording) -> (usize, Vec<String>) {
    let mut read = 0;
    let mut errors = Vec::new();
    for topic in recording.topics() {
        for message in recording.messages(topic) {
            let result = match topic {
                Topic::Color(_, ColorPart::Calibration)
                | Topic::Depth(_, DepthPart::Calibration) => {
                    recording.intrinsics(topic, message).map(drop)
                }
                Topic::Color(_, ColorPart::Settings) => {
                    recording.settings(topic, message).map(drop)
                }
                Topic::Depth(_, DepthPart::Response) => {
                    recording.response(topic, message).map(drop)
                }
                Topic::Color(..) | Topic::Depth(..) => recording.picture(topic, message).map(drop),
                Topic::Tf => recording.poses(message).map(drop),
                Topic::Volume => recording.volume(message).map(drop),
                Topic::Trigger => recording.trigger(message).map(drop),
                Topic::Capture => recording.capture_record(message).map(drop),
                Topic::Note => recording.note(message).map(drop),
                Topic::Log => recording.read(topic, message).map(drop),
            };
            match result {
                Ok(()) => read += 1,
                Err(error) => errors.push(error.to_string()),
            }
        }
    }
    for attachment in recording.attachments() {
        if let Err(error) = recording.attachment(attachment) {
            errors.push(error.to_string());
        }
    }
    recording.verify().unwrap();
    (read, errors)
}

struct Place {
    _folder: tempfile::TempDir,
    path: PathBuf,
}

impl Place {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("broken.mcap");
        Self {
            _folder: folder,
            path,
        }
    }

    fn open(&self, bytes: &[u8]) -> Result<Recording, Error> {
        std::fs::write(&self.path, bytes).unwrap();
        Recording::open(&self.path)
    }
}

fn small(compression: Compression) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = write_session(folder.path(), &[("a", 100, 2), ("b", 3000, 2)], compression);
    std::fs::read(path).unwrap()
}

#[test]
fn what_a_cut_costs_is_told() {
    let bytes = small(Compression::None);
    let place = Place::new();
    let (_, at, length) = *records_of(&bytes)
        .iter()
        .rfind(|(opcode, ..)| *opcode == op::CHUNK)
        .unwrap();
    let recording = place.open(&bytes[..at + 50]).unwrap();
    let [damage] = recording.damage() else {
        panic!("{:?}", recording.damage())
    };
    assert_eq!((damage.offset, damage.length), (at as u64, 50));
    assert!(damage.what.contains(&length.to_string()), "{damage}");
}

#[test]
fn a_broken_chunk_costs_its_own_messages_only() {
    let bytes = small(Compression::None);
    let place = Place::new();
    let whole = place.open(&bytes).unwrap();
    let frames = Topic::Color(camera_id("c00"), ColorPart::Image);
    assert_eq!(whole.messages(&frames).len(), 2);
    // The first chunk of pictures is that of the backgrounds, the next that of the first capture.
    let target = whole.messages(&frames)[0].chunk();
    let chunks: Vec<_> = records_of(&bytes)
        .into_iter()
        .filter(|(opcode, ..)| *opcode == op::CHUNK)
        .collect();
    let (_, at, length) = chunks[target as usize];
    let mut broken = bytes.clone();
    broken[at + length / 2] ^= 0x10;
    let recording = place.open(&broken).unwrap();
    let pictures: Vec<_> = recording
        .messages(&frames)
        .iter()
        .map(|m| recording.picture(&frames, m))
        .collect();
    let error = pictures[0].as_ref().unwrap_err().to_string();
    assert!(
        error.contains("CRC") && error.contains("broken.mcap"),
        "{error}"
    );
    assert!(pictures[1].is_ok());
    assert_eq!(recording.verify().unwrap().len(), 1);
    // A broken length instead of broken contents: the summary tells where the next chunk is.
    broken = bytes.clone();
    broken[at + 8] = 0x7f;
    let recording = place.open(&broken).unwrap();
    assert_eq!(recording.damage().len(), 1);
    assert_eq!(recording.messages(&frames).len(), 1);
    assert!(
        recording
            .picture(&frames, &recording.messages(&frames)[0])
            .is_ok()
    );
}

/// The bytes of a record.
fn record(opcode: u8, body: &[u8]) -> Vec<u8> {
    let mut bytes = vec![opcode];
    bytes.extend((body.len() as u64).to_le_bytes());
    bytes.extend(body);
    bytes
}

fn text(text: &str) -> Vec<u8> {
    let mut bytes = (text.len() as u32).to_le_bytes().to_vec();
    bytes.extend(text.as_bytes());
    bytes
}

fn chunk(compression: &str, packed: &[u8], unpacked_size: u64) -> Vec<u8> {
    let mut body = vec![0; 16];
    body.extend(unpacked_size.to_le_bytes());
    body.extend([0; 4]);
    body.extend(text(compression));
    body.extend((packed.len() as u64).to_le_bytes());
    body.extend(packed);
    record(op::CHUNK, &body)
}

fn file(records: &[Vec<u8>]) -> Vec<u8> {
    let mut bytes = mcap::MAGIC.to_vec();
    bytes.extend(record(op::HEADER, &[text("scand"), text("evil")].concat()));
    bytes.extend(records.concat());
    bytes
}

/// Processor time that this thread has used.
fn thread_time() -> Duration {
    // As Linux has it: nanoseconds on a processor, then those of waiting for one, and how often.
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap();
    let nanoseconds = text.split_whitespace().next().unwrap();
    Duration::from_nanos(nanoseconds.parse().unwrap())
}

/// Opens a hostile file and returns what it says of the damage.
fn damage(bytes: &[u8]) -> String {
    let place = Place::new();
    let start = thread_time();
    let recording = place.open(bytes).unwrap();
    read_all(&recording);
    let spent = thread_time() - start;
    assert!(spent < Duration::from_secs(5), "{spent:?}");
    let damage: Vec<String> = recording.damage().iter().map(ToString::to_string).collect();
    damage.join("\n")
}

#[test]
fn impossible_lengths_take_no_memory() {
    for length in [u64::MAX, u64::MAX - 8, 1 << 40, 257 << 20] {
        for opcode in [
            op::CHUNK,
            op::SCHEMA,
            op::MESSAGE,
            op::ATTACHMENT,
            0x42,
            0x81,
        ] {
            let mut bytes = file(&[]);
            bytes.push(opcode);
            bytes.extend(length.to_le_bytes());
            bytes.extend([0; 100]);
            assert!(
                damage(&bytes).contains(&length.to_string()),
                "{opcode} {length}"
            );
        }
        let mut body = vec![0; 28];
        body.extend(text("zstd"));
        body.extend(length.to_le_bytes());
        assert!(damage(&file(&[record(op::CHUNK, &body)])).contains("cannot be parsed"));
        let huge = chunk("zstd", &[1, 2, 3], length);
        assert!(damage(&file(&[huge])).contains("unpacks to"));
    }
    for body in [vec![0xff; 30], vec![0xff; 3], vec![]] {
        for opcode in [
            op::SCHEMA,
            op::CHANNEL,
            op::MESSAGE_INDEX,
            op::METADATA,
            op::ATTACHMENT,
            op::HEADER,
            op::CHUNK,
        ] {
            let told = damage(&file(&[record(opcode, &body)]));
            assert!(
                told.contains("cannot be parsed"),
                "{opcode} {body:?}: {told}"
            );
        }
    }
}

#[test]
fn a_bomb_is_defused() {
    let bomb = zstd::bulk::compress(&vec![0; 300 << 20], 1).unwrap();
    assert!(bomb.len() < 64 << 10);
    // It admits its size, or it claims a small one.
    assert!(damage(&file(&[chunk("zstd", &bomb, 300 << 20)])).contains("at most"));
    assert!(damage(&file(&[chunk("zstd", &bomb, 1000)])).contains("zstd"));
    let mut lz4 = lz4::EncoderBuilder::new().build(Vec::new()).unwrap();
    std::io::copy(
        &mut std::io::Read::take(std::io::repeat(0), 64 << 20),
        &mut lz4,
    )
    .unwrap();
    let (bomb, result) = lz4.finish();
    result.unwrap();
    assert!(damage(&file(&[chunk("lz4", &bomb, 1000)])).contains("header says 1000"));
    // Many that are within the limit of one each.
    let bomb = zstd::bulk::compress(&vec![0; 200 << 20], 1).unwrap();
    let bombs = vec![chunk("zstd", &bomb, 200 << 20); 100];
    assert!(
        damage(&file(&bombs)).contains("together"),
        "{}",
        damage(&file(&bombs))
    );
}

/// What ends a file that counts so many messages, so that its indexes are believed.
fn ended(mut bytes: Vec<u8>, messages: u64) -> Vec<u8> {
    let mut statistics = messages.to_le_bytes().to_vec();
    statistics.resize(46, 0);
    bytes.extend(record(op::STATISTICS, &statistics));
    bytes.extend(record(op::FOOTER, &[0; 20]));
    bytes.extend(mcap::MAGIC);
    bytes
}

#[test]
fn bombs_are_defused_where_indexes_are_whole_and_in_recovery() {
    let content = record(0x99, &vec![0; 80 << 20]);
    let bomb = zstd::bulk::compress(&content, 1).unwrap();
    let bombs = vec![chunk("zstd", &bomb, content.len() as u64); 50];
    let told = damage(&ended(file(&bombs), 0));
    assert!(told.contains("together"), "{told}");
    let place = Place::new();
    let part = place.path.with_extension("mcap.part");
    std::fs::write(&part, file(&bombs)).unwrap();
    let start = thread_time();
    let recovered = recover(&part).unwrap();
    let spent = thread_time() - start;
    assert!(spent < Duration::from_secs(5), "{spent:?}");
    // Whole chunks are in the tail: what was too much, and none of them was lost.
    let (_, length) = recovered.tail.unwrap();
    let one = bombs[0].len() as u64;
    assert!(length > 40 * one && length % one == 0, "{length} {one}");
}

/// The records that define a channel of notes.
fn note_channel() -> Vec<u8> {
    let schema = [&[1, 0][..], &text("scand.Note"), &text("json"), &[0; 4]].concat();
    let channel = [&[1, 0, 1, 0][..], &text("/note"), &text("json"), &[0; 4]].concat();
    [record(op::SCHEMA, &schema), record(op::CHANNEL, &channel)].concat()
}

/// A chunk with notes at these times, which say their times, and so many bytes behind them that say nothing.
fn chunk_of_notes(times: impl Iterator<Item = u64>, more: usize) -> Vec<u8> {
    let mut content = note_channel();
    for time in times {
        let note = format!(r#"{{"capture": "cup-1", "kind": "text", "text": "{time}"}}"#);
        let header = [&[1_u8, 0, 0, 0, 0, 0][..], &time.to_le_bytes(), &[0; 8]].concat();
        let body = [header, note.into_bytes()].concat();
        content.extend(record(op::MESSAGE, &body));
    }
    content.extend(record(0x99, &vec![0; more]));
    let packed = zstd::bulk::compress(&content, 1).unwrap();
    chunk("zstd", &packed, content.len() as u64)
}

#[test]
fn a_chunk_is_not_unpacked_anew_for_each_of_its_messages() {
    // Larger than all that is kept of several.
    let large = chunk_of_notes(0..3000, 60 << 20);
    assert!(damage(&file(&[large])).contains("without its footer"));
    // Several that take turns, which are not all kept.
    let turns = (0..4_u64).map(|n| chunk_of_notes((0..2000).map(move |i| 4 * i + n), 16 << 20));
    let place = Place::new();
    let recording = place.open(&file(&turns.collect::<Vec<_>>())).unwrap();
    let start = thread_time();
    let read = recording.read_each(&Topic::Note, |m| recording.note(m));
    let spent = thread_time() - start;
    assert!(spent < Duration::from_secs(5), "{spent:?}");
    let told = read.iter().map(|(message, note)| {
        let text = &note.as_ref().unwrap().text;
        assert_eq!(*text, message.log_time().0.to_string());
        message.log_time().0
    });
    assert!(told.eq(0..8000));
    let notes = Notes::of(&recording);
    assert_eq!(notes.on("cup-1").said.len(), 8000);
}

#[test]
fn a_damaged_chunk_is_unpacked_once_and_a_message_that_is_listed_twice_is_one() {
    let packed = chunk_of_notes(0..1, 90 << 20);
    let entries = |count: usize| {
        let entry = [0_u64, note_channel().len() as u64].map(u64::to_le_bytes);
        let length = (16 * count as u32).to_le_bytes();
        [&[1_u8, 0][..], &length, &entry.concat().repeat(count)].concat()
    };
    let whole = |chunk: Vec<u8>, count: usize| {
        let index = record(op::MESSAGE_INDEX, &entries(count));
        ended(file(&[note_channel(), chunk, index]), count as u64)
    };
    let place = Place::new();
    let recording = place.open(&whole(packed.clone(), 2)).unwrap();
    assert!(recording.damage().is_empty(), "{:?}", recording.damage());
    assert_eq!(recording.messages(&Topic::Note).len(), 1);
    assert_eq!(read_all(&recording), (1, Vec::new()));
    // Its CRC stands behind two times and its size.
    let mut damaged = packed;
    damaged[9 + 24] ^= 1;
    let recording = place.open(&whole(damaged, 1)).unwrap();
    let message = recording.messages(&Topic::Note)[0];
    let start = thread_time();
    for _ in 0..2000 {
        let error = recording.note(&message).unwrap_err().to_string();
        assert!(error.contains("CRC"), "{error}");
    }
    let spent = thread_time() - start;
    assert!(spent < Duration::from_secs(5), "{spent:?}");
}

#[test]
fn unknown_compressions_and_records_are_told_or_skipped() {
    assert!(damage(&file(&[chunk("brotli", &[0; 20], 20)])).contains("\"brotli\""));
    let told = damage(&file(&[record(0x42, b"future"), record(0x99, b"private")]));
    assert!(told.contains("without its footer"), "{told}");
    assert!(damage(&file(&[vec![0; 500]])).contains("no record of opcode 0"));
}

#[test]
fn messages_that_make_no_sense_are_named() {
    let place = Place::new();
    let open = |topic: &str, schema: &str, encoding: &str, data: &[u8]| {
        let channel = [&[1, 0, 1, 0][..], &text(topic), &text(encoding), &[0; 4]].concat();
        let schema = [&[1, 0][..], &text(schema), &text(encoding), &[0; 4]].concat();
        let message = [&[1, 0, 0, 0, 0, 0][..], &[7; 8], &[0; 8], data].concat();
        let bytes = file(&[
            record(op::SCHEMA, &schema),
            record(op::CHANNEL, &channel),
            record(op::MESSAGE, &message),
        ]);
        let recording = place.open(&bytes).unwrap();
        let (_, errors) = read_all(&recording);
        errors.join("\n")
    };
    let volume = |json: &str| open("/volume", "scand.Volume", "json", json.as_bytes());
    assert_eq!(
        volume(r#"{"min": [0,0,0], "max": [1,1,1], "more": {}}"#),
        ""
    );
    let error = volume(r#"{"frame_id": "rig", "min": [0,0,0]}"#);
    assert!(
        error.contains("broken.mcap: /volume at 1986-01-17T21:26:49.866Z: "),
        "{error}"
    );
    assert!(error.contains("missing field `max`"), "{error}");
    assert!(volume(r#"{"min": [0,0,0], "max": [0,1,1]}"#).contains("expected edges"));
    assert!(volume(r#"{"min": [0,0,0], "max": [1000,1,1]}"#).contains("expected edges"));
    assert!(volume(r#"{"frame_id": "world", "min": [0,0,0], "max": [1,1,1]}"#).contains("\"rig\""));
    assert!(volume(&"[".repeat(100_000)).contains("scand.Volume"));
    let wrong = open("/volume", "foxglove.Log", "protobuf", b"");
    assert!(
        wrong.contains("\"foxglove.Log\"") && wrong.contains("scand.Volume in json"),
        "{wrong}"
    );
    let image = open(
        "/color/a/image",
        "foxglove.RawImage",
        "protobuf",
        &[0xff; 40],
    );
    assert!(image.contains("foxglove.RawImage"), "{image}");
    let lens = open(
        "/color/a/calibration",
        "foxglove.CameraCalibration",
        "protobuf",
        b"",
    );
    assert!(lens.contains("K has 0 numbers"), "{lens}");
    let trigger = |json: &str| open("/trigger", "scand.Trigger", "json", json.as_bytes());
    assert!(trigger(r#"{"source": "pedal"}"#).contains("missing field `id`"));
    assert!(trigger(r#"{"id": "../../etc"}"#).contains("capture id \"../../etc\""));
    assert_eq!(trigger(r#"{"id": "a", "source": "x", "subject": 7}"#), "");
    let capture = |json: &str| open("/capture", "scand.Capture", "json", json.as_bytes());
    let times = |t: &str| {
        let cameras = format!(r#"{{"c": {{"timestamps": [{t}], "lost": 3}}}}"#);
        capture(&format!(
            r#"{{"id": "a", "outcome": "complete", "cameras": {cameras}}}"#
        ))
    };
    assert_eq!(times(r#""12", 13"#), "");
    assert!(times(r#""a dozen""#).contains("decimal nanoseconds"));
    assert!(capture(r#"{"id": "a", "outcome": "maybe"}"#).contains("maybe"));
    let response = |json: &str| {
        let topic = "/depth/k/response";
        open(topic, "scand.DepthResponse", "json", json.as_bytes())
    };
    assert!(response(r#"{"slope": 1, "intercept": 0, "scale": []}"#).contains("scale"));
    assert!(response(r#"{"slope": 0, "intercept": 0, "scale": [1]}"#).contains("slope"));
    let poses = open("/tf", "foxglove.FrameTransform", "protobuf", &[0x0a, 0x80]);
    assert!(poses.contains("FrameTransform"), "{poses}");
}

#[test]
fn an_index_that_lies_is_not_believed() {
    let bytes = small(Compression::None);
    let place = Place::new();
    let indexes = records_of(&bytes);
    let indexes = indexes
        .iter()
        .filter(|(opcode, ..)| *opcode == op::MESSAGE_INDEX);
    for &(_, at, length) in indexes {
        for offset in [9, 13, length - 1] {
            let mut broken = bytes.clone();
            broken[at + 9 + offset.min(length - 1)] ^= 0x05;
            if let Ok(recording) = place.open(&broken) {
                read_all(&recording);
            }
        }
    }
}

/// Tests of more than ten seconds: `make check` leaves them to `make test`.
mod long {
    use super::*;

    #[test]
    fn a_file_cut_off_anywhere_is_read_up_to_its_last_whole_chunk() {
        let bytes = small(Compression::None);
        let place = Place::new();
        let whole = read_all(&place.open(&bytes).unwrap()).0;
        let mut last = 0;
        for length in 8..bytes.len() {
            let recording = place.open(&bytes[..length]).unwrap();
            assert!(!recording.damage().is_empty(), "cut at {length}");
            let (read, errors) = read_all(&recording);
            assert_eq!(errors, Vec::<String>::new(), "cut at {length}");
            assert!(read >= last, "cut at {length}: {read} after {last}");
            last = read;
        }
        assert_eq!(last, whole);
        for length in 0..8 {
            assert!(matches!(
                place.open(&bytes[..length]),
                Err(Error::NotMcap { .. })
            ));
        }
    }

    #[test]
    fn a_flipped_bit_in_a_chunk_is_noticed_and_none_does_harm() {
        for compression in [Compression::None, Compression::Zstd] {
            let bytes = small(compression);
            let place = Place::new();
            let whole = read_all(&place.open(&bytes).unwrap());
            // From a chunk's sizes on; its first and last log time are not read.
            let checked: Vec<_> = records_of(&bytes)
                .into_iter()
                .filter(|(opcode, ..)| *opcode == op::CHUNK)
                .map(|(_, at, length)| at + 9 + 16..at + 9 + length)
                .collect();
            for at in (0..bytes.len()).step_by(bytes.len() / 1500 + 1) {
                let mut broken = bytes.clone();
                broken[at] ^= 1 << (at % 8);
                let Ok(recording) = place.open(&broken) else {
                    continue;
                };
                let read = read_all(&recording);
                // zstd's own headers have bits that mean nothing; what they unpack to is checked all the same.
                let plain = compression == Compression::None;
                if plain && checked.iter().any(|chunk| chunk.contains(&at)) {
                    let damage = recording.verify().unwrap();
                    assert!(!damage.is_empty() || read != whole, "byte {at}");
                }
            }
        }
    }
}
