//! The bytes of MCAP records, taken apart: a cursor that never reads past its end and a function a record.
//! Nothing here reads a file or takes memory that the bytes at hand do not justify.

use super::index::ChunkInfo;
use std::borrow::Cow;
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
pub(super) struct Cursor<'a>(pub &'a [u8]);

impl<'a> Cursor<'a> {
    pub(super) fn bytes(&mut self, length: usize) -> Parsed<&'a [u8]> {
        let (head, tail) = self.0.split_at_checked(length).ok_or(Malformed)?;
        self.0 = tail;
        Ok(head)
    }

    fn array<const N: usize>(&mut self) -> Parsed<[u8; N]> {
        let (head, tail) = self.0.split_first_chunk().ok_or(Malformed)?;
        self.0 = tail;
        Ok(*head)
    }

    pub(super) fn u8(&mut self) -> Parsed<u8> {
        self.array().map(u8::from_le_bytes)
    }

    pub(super) fn u16(&mut self) -> Parsed<u16> {
        self.array().map(u16::from_le_bytes)
    }

    pub(super) fn u32(&mut self) -> Parsed<u32> {
        self.array().map(u32::from_le_bytes)
    }

    pub(super) fn u64(&mut self) -> Parsed<u64> {
        self.array().map(u64::from_le_bytes)
    }

    /// Bytes behind a 32-bit length.
    pub(super) fn block(&mut self) -> Parsed<&'a [u8]> {
        let length = self.u32()?;
        self.bytes(length as usize)
    }

    pub(super) fn string(&mut self) -> Parsed<String> {
        let bytes = self.block()?;
        String::from_utf8(bytes.to_vec()).map_err(|_| Malformed)
    }

    /// A name that this program knows is short, and a long one is not worth the memory.
    fn name(&mut self) -> Parsed<String> {
        const LONGEST: usize = 4096;
        let name = self.block()?;
        if name.len() > LONGEST {
            return Err(Malformed);
        }
        String::from_utf8(name.to_vec()).map_err(|_| Malformed)
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

/// Opcode and body of the record at `position`.
pub(super) fn record_at(bytes: &[u8], position: usize) -> Option<(u8, &[u8])> {
    let rest = bytes.get(position..)?;
    let (opcode, length) = record_header(rest).ok()?;
    let body = &rest[RECORD_HEADER..];
    Some((opcode, body.get(..usize::try_from(length).ok()?)?))
}

/// A schema as its record has it, all of it but the number.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct SchemaText {
    pub name: String,
    pub encoding: String,
    pub data: Cow<'static, [u8]>,
}

/// The same of a channel.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct ChannelText {
    pub schema: u16,
    pub topic: String,
    pub encoding: String,
    pub metadata: BTreeMap<String, String>,
}

/// First and last log time of some messages, if there are any.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct MessageTimes(Option<(u64, u64)>);

impl MessageTimes {
    pub(super) fn add(&mut self, time: u64) {
        let (first, last) = self.0.unwrap_or((time, time));
        self.0 = Some((first.min(time), last.max(time)));
    }

    /// As records have them.
    pub(super) fn or_zeros(self) -> (u64, u64) {
        self.0.unwrap_or_default()
    }
}

/// What a record is and how long its body says it is.
pub(super) fn record_header(bytes: &[u8]) -> Parsed<(u8, u64)> {
    let mut cursor = Cursor(bytes);
    Ok((cursor.u8()?, cursor.u64()?))
}

/// Profile and library that wrote the file.
pub(super) fn header(body: &[u8]) -> Parsed<(String, String)> {
    let mut cursor = Cursor(body);
    Ok((cursor.string()?, cursor.string()?))
}

/// A schema's number, name and encoding.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Schema {
    pub id: u16,
    pub name: String,
    pub encoding: String,
}

pub(super) fn schema(body: &[u8]) -> Parsed<Schema> {
    let mut cursor = Cursor(body);
    let schema = Schema {
        id: cursor.u16()?,
        name: cursor.name()?,
        encoding: cursor.name()?,
    };
    cursor.block()?;
    Ok(schema)
}

/// A channel as its record has it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Channel {
    pub id: u16,
    pub schema_id: u16,
    pub topic: String,
    pub message_encoding: String,
}

pub(super) fn channel(body: &[u8]) -> Parsed<Channel> {
    let mut cursor = Cursor(body);
    let channel = Channel {
        id: cursor.u16()?,
        schema_id: cursor.u16()?,
        topic: cursor.name()?,
        message_encoding: cursor.name()?,
    };
    cursor.string_map()?;
    Ok(channel)
}

/// A schema's number and all that its record has.
pub(super) fn schema_text(body: &[u8]) -> Parsed<(u16, SchemaText)> {
    let mut cursor = Cursor(body);
    let id = cursor.u16()?;
    let schema = SchemaText {
        name: cursor.string()?,
        encoding: cursor.string()?,
        data: cursor.block()?.to_vec().into(),
    };
    Ok((id, schema))
}

/// A channel's number and all that its record has.
pub(super) fn channel_text(body: &[u8]) -> Parsed<(u16, ChannelText)> {
    let mut cursor = Cursor(body);
    let id = cursor.u16()?;
    let channel = ChannelText {
        schema: cursor.u16()?,
        topic: cursor.string()?,
        encoding: cursor.string()?,
        metadata: cursor.string_map()?,
    };
    Ok((id, channel))
}

/// Channel and log time of a message, whose data follow the header.
pub(super) fn message_header(body: &[u8]) -> Parsed<(u16, u64)> {
    let mut cursor = Cursor(body);
    let channel = cursor.u16()?;
    let _sequence = cursor.u32()?;
    let log_time = cursor.u64()?;
    let _publish_time = cursor.u64()?;
    Ok((channel, log_time))
}

/// What opens a chunk's body: all but its records. `head` may be cut after the compression's name; `offset`
/// and `length` are those of the whole body in the file.
pub(super) fn chunk_header(head: &[u8], offset: u64, length: u64) -> Parsed<ChunkInfo> {
    let mut cursor = Cursor(head);
    let _start_time = cursor.u64()?;
    let _end_time = cursor.u64()?;
    let uncompressed_size = cursor.u64()?;
    let uncompressed_crc = cursor.u32()?;
    let compression = cursor.name()?;
    let compressed_size = cursor.u64()?;
    let used = (head.len() - cursor.0.len()) as u64;
    if compressed_size > length.saturating_sub(used) {
        return Err(Malformed);
    }
    Ok(ChunkInfo {
        record_offset: offset - RECORD_HEADER as u64,
        data_offset: offset + used,
        compressed_size,
        uncompressed_size,
        uncompressed_crc,
        compression,
    })
}

/// Largest part of a chunk's body that [`chunk_header`] needs; names of compressions are short.
pub(super) const CHUNK_HEADER_AT_MOST: usize = 8 + 8 + 8 + 4 + 4 + 64 + 8;

/// A channel and the (log time, offset) of its messages in the chunk before.
pub(super) fn message_index(body: &[u8]) -> Parsed<(u16, Vec<(u64, u64)>)> {
    let mut cursor = Cursor(body);
    let channel = cursor.u16()?;
    let (entries, rest) = cursor.block()?.as_chunks::<16>();
    if !rest.is_empty() {
        return Err(Malformed);
    }
    let entry = |e: &[u8; 16]| {
        let (time, offset) = e.split_at(8);
        let number = |b: &[u8]| b.iter().rev().fold(0, |n, &b| n << 8 | u64::from(b));
        (number(time), number(offset))
    };
    Ok((channel, entries.iter().map(entry).collect()))
}

/// Number of messages that a statistics record counts.
pub(super) fn statistics(body: &[u8]) -> Parsed<u64> {
    Cursor(body).u64()
}

/// Offset of the chunk that a chunk index is about.
pub(super) fn chunk_index(body: &[u8]) -> Parsed<u64> {
    let mut cursor = Cursor(body);
    cursor.bytes(16)?;
    cursor.u64()
}

/// Start of the summary section, 0 for none.
pub(super) fn footer(body: &[u8]) -> Parsed<u64> {
    Cursor(body).u64()
}

/// A metadata record's name and pairs.
pub(super) fn metadata(body: &[u8]) -> Parsed<(String, BTreeMap<String, String>)> {
    let mut cursor = Cursor(body);
    Ok((cursor.string()?, cursor.string_map()?))
}

/// An attachment's name, media type and data.
pub(super) fn attachment(body: &[u8]) -> Parsed<(String, String, &[u8])> {
    let checked = body.len().checked_sub(4).ok_or(Malformed)?;
    let crc = Cursor(&body[checked..]).u32()?;
    let mut cursor = Cursor(&body[..checked]);
    cursor.bytes(16)?;
    let name = cursor.string()?;
    let media_type = cursor.string()?;
    let length = usize::try_from(cursor.u64()?).map_err(|_| Malformed)?;
    let data = cursor.bytes(length)?;
    if crc != 0 && crc32fast::hash(&body[..checked]) != crc {
        return Err(Malformed);
    }
    Ok((name, media_type, data))
}
