//! What the container writes is what the MCAP library would, byte for byte.

use super::container::Container;
use super::encoding::MessageHead;
use super::records::{ChannelText, SchemaText};
use super::writer::Compression;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::Cursor;

/// Lengths of messages: small, larger than what is gathered, larger than a block, and none.
const LENGTHS: [usize; 6] = [10, 70_000, 3, 900_000, 0, 20_000];

fn head(number: usize) -> MessageHead {
    MessageHead {
        channel: 1 + (number % 2) as u16,
        sequence: number as u32,
        log_time: 1_000_000 - 7 * number as u64,
        publish_time: 5,
    }
}

fn data(number: usize) -> Vec<u8> {
    let byte = |i: usize| (i * 7 + number) as u8;
    (0..LENGTHS[number]).map(byte).collect()
}

fn pairs(of: &[(&str, &str)]) -> BTreeMap<String, String> {
    let owned = |&(k, v): &(&str, &str)| (k.to_owned(), v.to_owned());
    of.iter().map(owned).collect()
}

fn attachment() -> mcap::Attachment<'static> {
    mcap::Attachment {
        log_time: 3,
        create_time: 4,
        name: "rig.toml".into(),
        media_type: "application/toml".into(),
        data: vec![9; 50_000].into(),
    }
}

fn by_the_library() -> Vec<u8> {
    let mut file = Cursor::new(Vec::new());
    let options = mcap::WriteOptions::new()
        .profile("scand")
        .library("test 1")
        .compression(None)
        .chunk_size(None);
    let mut writer = options.create(&mut file).unwrap();
    let metadata = mcap::records::Metadata {
        name: "about".into(),
        metadata: pairs(&[("b", "1"), ("a", "ü")]),
    };
    writer.write_metadata(&metadata).unwrap();
    let schema = writer.add_schema("s", "jsonschema", b"{}").unwrap();
    let others = pairs(&[("k", "v")]);
    writer
        .add_channel(schema, "/a", "json", &BTreeMap::new())
        .unwrap();
    writer.add_channel(schema, "/b", "json", &others).unwrap();
    for number in 0..LENGTHS.len() {
        let MessageHead {
            channel,
            sequence,
            log_time,
            publish_time,
        } = head(number);
        let header = mcap::records::MessageHeader {
            channel_id: channel,
            sequence,
            log_time,
            publish_time,
        };
        writer
            .write_to_known_channel(&header, &data(number))
            .unwrap();
        match number {
            1 => writer.flush().unwrap(),
            2 => writer.attach(&attachment()).unwrap(),
            _ => {}
        }
    }
    writer.finish().unwrap();
    drop(writer);
    file.into_inner()
}

fn by_ourselves(compression: Compression) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a");
    let file = File::create_new(&path).unwrap();
    let mut container = Container::begin(file, "scand", "test 1", compression);
    container
        .metadata("about", &pairs(&[("b", "1"), ("a", "ü")]))
        .unwrap();
    let schema = SchemaText {
        name: "s".into(),
        encoding: "jsonschema".into(),
        data: b"{}".into(),
    };
    // Defined again, it is the same.
    container.schema(schema.clone()).unwrap();
    let schema = container.schema(schema).unwrap();
    for (topic, metadata) in [("/a", pairs(&[])), ("/b", pairs(&[("k", "v")]))] {
        let channel = ChannelText {
            schema,
            topic: topic.into(),
            encoding: "json".into(),
            metadata,
        };
        container.channel(channel).unwrap();
    }
    for number in 0..LENGTHS.len() {
        let data = data(number);
        let (first, second) = data.split_at(data.len() / 3);
        container.message(&head(number), [first, second]).unwrap();
        match number {
            1 => container.flush().unwrap(),
            2 => container.attach(&attachment()).unwrap(),
            _ => {}
        }
    }
    container.finish().unwrap();
    std::fs::read(path).unwrap()
}

#[test]
fn the_file_is_the_one_that_the_library_makes() {
    assert!(by_ourselves(Compression::None) == by_the_library());
}

#[test]
fn packed_chunks_hold_the_same_and_all_sums_are_right() {
    let [plain, packed] = [Compression::None, Compression::Zstd].map(by_ourselves);
    assert!(packed.len() < plain.len() / 10);
    let messages = |bytes: &[u8]| {
        let stream = mcap::MessageStream::new(bytes).unwrap();
        let each = stream.map(|m| {
            let m = m.unwrap();
            (m.channel.topic.clone(), m.log_time, m.data.into_owned())
        });
        each.collect::<Vec<_>>()
    };
    assert!(messages(&plain) == messages(&packed));
    for bytes in [plain, packed] {
        let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
        let stats = summary.stats.unwrap();
        assert_eq!((stats.message_count, stats.chunk_count), (6, 3));
        assert_eq!(
            (stats.message_start_time, stats.message_end_time),
            (999_965, 1_000_000)
        );
        // The library checks the CRC of the data as it reads them through.
        let mut end = None;
        for record in mcap::read::LinearReader::new(&bytes).unwrap() {
            if let mcap::records::Record::DataEnd(found) = record.unwrap() {
                end = Some(found.data_section_crc);
            }
        }
        let end = end.unwrap();
        let record = [&[0x0f, 4, 0, 0, 0, 0, 0, 0, 0][..], &end.to_le_bytes()].concat();
        let at = bytes
            .windows(record.len())
            .rposition(|w| w == record)
            .unwrap();
        assert_eq!(crc32fast::hash(&bytes[..at]), end);
    }
}

#[test]
fn after_a_write_that_failed_nothing_more_is_written() {
    let full = File::options().write(true).open("/dev/full").unwrap();
    let mut container = Container::begin(full, "scand", "test 1", Compression::None);
    let no_space = container.flush().unwrap_err();
    assert_eq!(no_space.kind(), std::io::ErrorKind::StorageFull);
    let again = container.flush().unwrap_err();
    assert!(again.to_string().contains("earlier"), "{again}");
}
