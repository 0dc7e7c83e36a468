//! Files that are not recordings, or no longer: cut off, with flipped bits, with wrong lengths, with decompression
//! bombs.

use super::command::{replay, replay_bytes};
use super::recording::{Messages, ball};
use mcap::records::op;

/// Where each record of a file begins, and its opcode.
fn records_of(bytes: &[u8]) -> Vec<(usize, u8)> {
    let mut found = Vec::new();
    let mut at = mcap::MAGIC.len();
    while at + 9 <= bytes.len() - mcap::MAGIC.len() {
        let length = u64::from_le_bytes(bytes[at + 1..at + 9].try_into().unwrap());
        found.push((at, bytes[at]));
        at += 9 + length as usize;
    }
    found
}

#[test]
fn what_is_no_recording_is_refused() {
    replay_bytes("text", b"I am no recording")
        .is_refused(&["is not an MCAP file", "begins with [49, 20, 61"]);
    replay_bytes("empty", b"").is_refused(&["is not an MCAP file", "it is empty"]);
    replay_bytes("magic", mcap::MAGIC).is_refused(&["no /trigger", "without its footer"]);
    let folder = tempfile::tempdir().unwrap();
    let nothing = folder.path().join("nothing.mcap");
    replay(folder, &nothing, None, &[]).is_refused(&["No such file"]);
    let folder = tempfile::tempdir().unwrap();
    let inside = folder.path().join("folder.mcap");
    std::fs::create_dir(&inside).unwrap();
    replay(folder, &inside, None, &[]).is_refused(&["the folder has no recording"]);
    let mut future = Messages(Vec::new()).bytes();
    let end = future.len();
    let metadata = [
        &[5, 0, 0, 0][..],
        b"scand",
        &[14, 0, 0, 0],
        &[6, 0, 0, 0],
        b"format",
    ];
    let body = [&metadata.concat()[..], &[1, 0, 0, 0], b"2"].concat();
    let body = fixed_map_length(body);
    let mut record = vec![op::METADATA];
    record.extend((body.len() as u64).to_le_bytes());
    record.extend(body);
    let header_end = records_of(&future[..end])[1].0;
    future.splice(header_end..header_end, record);
    replay_bytes("future", &future).is_refused(&["unknown format \"2\""]);
}

/// The map of the metadata record above is one pair of 6 + 1 letters, each behind a length.
fn fixed_map_length(mut body: Vec<u8>) -> Vec<u8> {
    let length = (body.len() - 4 - 5 - 4) as u32;
    body[9..13].copy_from_slice(&length.to_le_bytes());
    body
}

#[test]
fn a_file_cut_off_anywhere_is_refused_or_loses_what_was_behind() {
    let bytes = ball().bytes();
    // The last few bytes, and places all over the file.
    let places = (1..bytes.len()).step_by(bytes.len() / 34);
    for length in places.chain(bytes.len() - 6..bytes.len()) {
        let ended = replay_bytes(&format!("cut-{length}"), &bytes[..length]);
        assert_ne!(ended.code, 0, "cut at {length}");
        if length > mcap::MAGIC.len() {
            ended.says(&["at byte"]);
        }
    }
}

#[test]
fn lengths_that_lie_are_told() {
    let bytes = ball().bytes();
    let mut seen = Vec::new();
    for (at, opcode) in records_of(&bytes) {
        if seen.contains(&opcode) || opcode == op::FOOTER {
            continue;
        }
        seen.push(opcode);
        for (name, length) in [("max", u64::MAX), ("tib", 1u64 << 40)] {
            let mut broken = bytes.clone();
            broken[at + 1..at + 9].copy_from_slice(&length.to_le_bytes());
            let ended = replay_bytes(&format!("length-{name}-{opcode:02x}"), &broken);
            assert_ne!(ended.code, 0, "opcode {opcode:#04x}: {}", ended.stderr);
            ended.says(&[&format!("damaged at byte {at}"), &length.to_string()]);
        }
    }
    assert!(seen.len() > 6, "{seen:?}");
}

#[test]
fn flipped_bits_do_no_harm() {
    let bytes = ball().bytes();
    let mut at = 8;
    for i in 0..48 {
        // Steps that grow: the small records at the start and the pictures behind them.
        at += 1 + i * i * bytes.len() / 40_000;
        let mut broken = bytes.clone();
        broken[at % bytes.len()] ^= 1 << (i % 8);
        replay_bytes(&format!("flipped-{}", at % bytes.len()), &broken);
    }
}

/// A chunk record of these bytes.
fn chunk(packed: &[u8], size: u64) -> Vec<u8> {
    let mut body = vec![0; 16];
    body.extend(size.to_le_bytes());
    body.extend([0; 4]);
    body.extend(4u32.to_le_bytes());
    body.extend(b"zstd");
    body.extend((packed.len() as u64).to_le_bytes());
    body.extend(packed);
    let mut record = vec![op::CHUNK];
    record.extend((body.len() as u64).to_le_bytes());
    record.extend(body);
    record
}

/// A file of these records after a header.
fn file(records: &[Vec<u8>]) -> Vec<u8> {
    let mut bytes = mcap::MAGIC.to_vec();
    bytes.push(op::HEADER);
    bytes.extend(8u64.to_le_bytes());
    bytes.extend([0; 8]);
    bytes.extend(records.concat());
    bytes
}

/// `count` records of no content, packed.
fn packed_records(record: &[u8], count: usize) -> (Vec<u8>, u64) {
    let unpacked = record.repeat(count);
    let packed = zstd::bulk::compress(&unpacked, 1).unwrap();
    (packed, unpacked.len() as u64)
}

#[test]
fn bombs_are_defused() {
    // Zeros that admit their size, more than one chunk may have.
    let (packed, size) = packed_records(&[0], 300 << 20);
    replay_bytes("bomb", &file(&[chunk(&packed, size)])).is_refused(&["unpacks to 314572800"]);
    replay_bytes("bomb-lies", &file(&[chunk(&packed, 1000)])).is_refused(&["zstd data"]);
    // Many that each chunk may have.
    let (packed, size) = packed_records(&[0], 100 << 20);
    let bombs = vec![chunk(&packed, size); 300];
    replay_bytes("bombs", &file(&bombs)).is_refused(&["together"]);
    // One chunk that claims less than any may have, and still too much for what it is.
    let (packed, size) = packed_records(&[0], 120 << 20);
    let little = file(&[chunk(&packed, size)]);
    replay_bytes("bomb-little", &little).is_refused(&["to 125829120 bytes, expected at most"]);
    // Messages, each of which is remembered.
    let mut message = vec![op::MESSAGE];
    message.extend(22u64.to_le_bytes());
    message.extend([0; 22]);
    let (packed, size) = packed_records(&message, 3_000_000);
    replay_bytes("bomb-of-messages", &file(&[chunk(&packed, size)]))
        .is_refused(&["more than 500", "too many for a file of this length"]);
    // Channels of one number.
    let mut channel = vec![op::CHANNEL];
    channel.extend(16u64.to_le_bytes());
    channel.extend([0; 16]);
    let (packed, size) = packed_records(&channel, 3_000_000);
    replay_bytes("bomb-of-channels", &file(&[chunk(&packed, size)])).is_refused(&["no /trigger"]);
}
