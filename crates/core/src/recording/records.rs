//! The bytes of MCAP records. What a record holds is the `mcap` crate's struct; its parser takes the memory that a
//! length in the file asks for, so records are parsed here, by a cursor that never reads past its end, and encoded by
//! the crate. Nothing here reads a file or takes memory that the bytes at hand do not justify.

use binrw::{BinWrite, Endian};
use mcap::Schema;
use mcap::records::{
    AttachmentHeader, Channel, ChunkHeader, Header, MessageHeader, MessageIndex, MessageIndexEntry,
    Metadata, SchemaHeader, op,
};
use std::collections::BTreeMap;

/// Opcode and length that precede every record's body.
pub(super) const RECORD_HEADER: usize = 9;
/// Channel, sequence, log and publish time that open a message's body.
pub(super) const MESSAGE_HEADER: usize = 22;

/// A record's body does not hold what its opcode promises.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Malformed;

pub(super) type Parsed<T> = Result<T, Malformed>;

/// Reads little-endian values from the front of a slice.
struct Cursor<'a>(&'a [u8]);

impl<'a> Cursor<'a> {
    fn bytes(&mut self, length: usize) -> Parsed<&'a [u8]> {
        let (head, tail) = self.0.split_at_checked(length).ok_or(Malformed)?;
        self.0 = tail;
        Ok(head)
    }

    fn array<const N: usize>(&mut self) -> Parsed<[u8; N]> {
        let (head, tail) = self.0.split_first_chunk().ok_or(Malformed)?;
        self.0 = tail;
        Ok(*head)
    }

    fn u16(&mut self) -> Parsed<u16> {
        self.array().map(u16::from_le_bytes)
    }

    fn u32(&mut self) -> Parsed<u32> {
        self.array().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Parsed<u64> {
        self.array().map(u64::from_le_bytes)
    }

    /// Bytes behind a 32-bit length.
    fn block(&mut self) -> Parsed<&'a [u8]> {
        let length = self.u32()?;
        self.bytes(length as usize)
    }

    fn string(&mut self) -> Parsed<String> {
        let bytes = self.block()?;
        String::from_utf8(bytes.to_vec()).map_err(|_| Malformed)
    }

    fn string_map(&mut self) -> Parsed<BTreeMap<String, String>> {
        let mut block = Cursor(self.block()?);
        let mut map = BTreeMap::new();
        while !block.0.is_empty() {
            map.insert(block.string()?, block.string()?);
        }
        Ok(map)
    }
}

/// What a record is and how long its body says it is.
pub(super) fn record_header(bytes: &[u8]) -> Parsed<(u8, u64)> {
    let (opcode, rest) = bytes.split_first().ok_or(Malformed)?;
    Ok((*opcode, Cursor(rest).u64()?))
}

/// Opcode and body of the record at `position`.
pub(super) fn record_at(bytes: &[u8], position: usize) -> Option<(u8, &[u8])> {
    let rest = bytes.get(position..)?;
    let (opcode, length) = record_header(rest).ok()?;
    let body = &rest[RECORD_HEADER..];
    Some((opcode, body.get(..usize::try_from(length).ok()?)?))
}

pub(super) fn header(body: &[u8]) -> Parsed<Header> {
    let mut cursor = Cursor(body);
    Ok(Header {
        profile: cursor.string()?,
        library: cursor.string()?,
    })
}

pub(super) fn schema(body: &[u8]) -> Parsed<Schema<'static>> {
    let mut cursor = Cursor(body);
    Ok(Schema {
        id: cursor.u16()?,
        name: cursor.string()?,
        encoding: cursor.string()?,
        data: cursor.block()?.to_vec().into(),
    })
}

pub(super) fn channel(body: &[u8]) -> Parsed<Channel> {
    let mut cursor = Cursor(body);
    Ok(Channel {
        id: cursor.u16()?,
        schema_id: cursor.u16()?,
        topic: cursor.string()?,
        message_encoding: cursor.string()?,
        metadata: cursor.string_map()?,
    })
}

/// What opens a message's body; its data follow.
pub(super) fn message(body: &[u8]) -> Parsed<MessageHeader> {
    let mut cursor = Cursor(body);
    Ok(MessageHeader {
        channel_id: cursor.u16()?,
        sequence: cursor.u32()?,
        log_time: cursor.u64()?,
        publish_time: cursor.u64()?,
    })
}

/// What opens a chunk's body, whose whole length is `length`; its data follow. `head` may be cut after the
/// compression's name.
pub(super) fn chunk(head: &[u8], length: u64) -> Parsed<ChunkHeader> {
    let mut cursor = Cursor(head);
    let chunk = ChunkHeader {
        message_start_time: cursor.u64()?,
        message_end_time: cursor.u64()?,
        uncompressed_size: cursor.u64()?,
        uncompressed_crc: cursor.u32()?,
        compression: cursor.string()?,
        compressed_size: cursor.u64()?,
    };
    let left = length.checked_sub((head.len() - cursor.0.len()) as u64);
    let fits = left.is_some_and(|left| chunk.compressed_size <= left);
    fits.then_some(chunk).ok_or(Malformed)
}

/// Largest part of a chunk's body that [`chunk`] needs; names of compressions are short.
pub(super) const CHUNK_HEAD_AT_MOST: usize = 8 + 8 + 8 + 4 + 4 + 64 + 8;

/// Bytes of a chunk's record before its data.
pub(super) fn chunk_head_length(chunk: &ChunkHeader) -> u64 {
    (RECORD_HEADER + 8 + 8 + 8 + 4 + 4 + chunk.compression.len() + 8) as u64
}

/// A channel and its messages in the chunk before.
pub(super) fn message_index(body: &[u8]) -> Parsed<MessageIndex> {
    let mut cursor = Cursor(body);
    let channel_id = cursor.u16()?;
    let (entries, rest) = cursor.block()?.as_chunks::<16>();
    if !rest.is_empty() {
        return Err(Malformed);
    }
    let entry = |bytes: &[u8; 16]| {
        let mut cursor = Cursor(bytes);
        Ok(MessageIndexEntry {
            log_time: cursor.u64()?,
            offset: cursor.u64()?,
        })
    };
    Ok(MessageIndex {
        channel_id,
        records: entries.iter().map(entry).collect::<Parsed<_>>()?,
    })
}

/// All records of a chunk's content: opcode, position and body of each; an error ends them.
pub(super) fn all(content: &[u8]) -> impl Iterator<Item = Result<(u8, usize, &[u8]), usize>> {
    let mut position = 0;
    std::iter::from_fn(move || {
        let at = position;
        if at >= content.len() {
            return None;
        }
        let Some((opcode, body)) = record_at(content, at) else {
            position = content.len();
            return Some(Err(at));
        };
        position = at + RECORD_HEADER + body.len();
        Some(Ok((opcode, at, body)))
    })
}

/// Number of messages that a statistics record counts.
pub(super) fn message_count(body: &[u8]) -> Parsed<u64> {
    Cursor(body).u64()
}

/// Offset of the chunk that a chunk index is about.
pub(super) fn chunk_offset(body: &[u8]) -> Parsed<u64> {
    let mut cursor = Cursor(body);
    cursor.bytes(16)?;
    cursor.u64()
}

/// Start of the summary section, 0 if there is none.
pub(super) fn summary_start(footer: &[u8]) -> Parsed<u64> {
    Cursor(footer).u64()
}

pub(super) fn metadata(body: &[u8]) -> Parsed<Metadata> {
    let mut cursor = Cursor(body);
    Ok(Metadata {
        name: cursor.string()?,
        metadata: cursor.string_map()?,
    })
}

/// What opens an attachment's body, and the size of the data that follow.
pub(super) fn attachment_head(body: &[u8]) -> Parsed<(AttachmentHeader, u64)> {
    let mut cursor = Cursor(body);
    let header = AttachmentHeader {
        log_time: cursor.u64()?,
        create_time: cursor.u64()?,
        name: cursor.string()?,
        media_type: cursor.string()?,
    };
    Ok((header, cursor.u64()?))
}

/// An attachment and its data; its CRC is checked.
pub(super) fn attachment(body: &[u8]) -> Parsed<(AttachmentHeader, &[u8])> {
    let (checked, crc) = body.split_last_chunk().ok_or(Malformed)?;
    let (header, size) = attachment_head(checked)?;
    let texts = header.name.len() + header.media_type.len();
    let mut cursor = Cursor(checked);
    cursor.bytes(8 + 8 + 4 + 4 + texts + 8)?;
    let data = cursor.bytes(usize::try_from(size).map_err(|_| Malformed)?)?;
    match u32::from_le_bytes(*crc) {
        0 => {}
        crc if crc == crc32fast::hash(checked) => {}
        _ => return Err(Malformed),
    }
    Ok((header, data))
}

/// Appends a record.
pub(super) fn put<T: Encoded>(out: &mut Vec<u8>, opcode: u8, record: &T) {
    put_head(out, opcode, record, 0);
}

/// Appends a record but for its data, of which so many bytes follow.
pub(super) fn put_head<T: Encoded>(out: &mut Vec<u8>, opcode: u8, head: &T, data: u64) {
    let mut body = std::io::Cursor::new(Vec::new());
    let written = head.write_options(&mut body, Endian::Little, ());
    written.expect("memory takes whatever is written");
    let body = body.into_inner();
    out.push(opcode);
    out.extend((body.len() as u64 + data).to_le_bytes());
    out.extend(body);
}

/// The records of a chunk's message indexes, and where each is if they begin at `position` in the file.
pub(super) fn put_indexes(
    indexes: &[MessageIndex],
    position: u64,
) -> (Vec<u8>, BTreeMap<u16, u64>) {
    let mut bytes = Vec::new();
    let mut offsets = BTreeMap::new();
    for index in indexes {
        offsets.insert(index.channel_id, position + bytes.len() as u64);
        put(&mut bytes, op::MESSAGE_INDEX, index);
    }
    (bytes, offsets)
}

pub(super) fn put_schema(out: &mut Vec<u8>, schema: &Schema) {
    let header = SchemaHeader {
        id: schema.id,
        name: schema.name.clone(),
        encoding: schema.encoding.clone(),
    };
    let length = schema.data.len() as u32;
    put_head(out, op::SCHEMA, &header, 4 + u64::from(length));
    out.extend(length.to_le_bytes());
    out.extend_from_slice(&schema.data);
}

/// What the `mcap` crate encodes.
pub(super) trait Encoded: BinWrite<Args<'static> = ()> {}

impl<T: BinWrite<Args<'static> = ()>> Encoded for T {}
