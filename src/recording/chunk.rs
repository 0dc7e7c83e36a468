//! One chunk: its bytes unpacked and checked, and the messages and channels in it.

use super::index::{ChunkInfo, Index, MessageRef};
use super::records::{self, MESSAGE_HEADER, RECORD_HEADER, record_at};
use super::source::Source;
use super::walk::LARGEST_RECORD;
use super::{Damage, Error};
use bytes::Bytes;
use mcap::records::op;
use std::io::Read;

/// Largest chunk that may unpack to more than a hundred times what it is: pictures of one colour shrink so.
const LARGEST_OF_LITTLE: u64 = 96 << 20;

/// Reads a chunk, unpacks it and checks its CRC. Memory is taken as bytes arrive, not as the header claims.
pub(super) fn unpack(source: &Source, chunk: &ChunkInfo) -> Result<Bytes, Error> {
    let damaged = |what: String| Error::Damaged {
        path: source.path.clone(),
        damage: Damage {
            offset: chunk.record_offset,
            length: chunk.compressed_size,
            what,
        },
    };
    let size = chunk.uncompressed_size;
    if size > LARGEST_RECORD {
        return Err(damaged(format!(
            "the chunk says it unpacks to {size} bytes, at most {LARGEST_RECORD} are read"
        )));
    }
    if size > LARGEST_OF_LITTLE && size / 100 > chunk.compressed_size {
        let packed = chunk.compressed_size;
        return Err(damaged(format!(
            "the chunk says it unpacks from {packed} to {size} bytes: of so few at most \
             {LARGEST_OF_LITTLE} are made"
        )));
    }
    // Both sizes are below 256 MiB here, and the packed one is within the file.
    let packed = source.read(chunk.data_offset, chunk.compressed_size as usize)?;
    let unpacked = match chunk.compression.as_str() {
        "" => packed,
        "zstd" => unpack_zstd(&packed, size as usize)
            .map_err(|e| damaged(format!("the chunk's zstd data: {e}")))?,
        "lz4" => {
            unpack_lz4(&packed, size).map_err(|e| damaged(format!("the chunk's lz4 data: {e}")))?
        }
        other => {
            return Err(damaged(format!(
                "the chunk's compression is {other:?}, expected zstd, lz4 or none"
            )));
        }
    };
    if unpacked.len() as u64 != size {
        let found = unpacked.len();
        return Err(damaged(format!(
            "the chunk unpacks to {found} bytes, its header says {size}"
        )));
    }
    let crc = crc32fast::hash(&unpacked);
    if chunk.uncompressed_crc != 0 && crc != chunk.uncompressed_crc {
        let expected = chunk.uncompressed_crc;
        return Err(damaged(format!(
            "the chunk's CRC is {crc:08x}, its header says {expected:08x}"
        )));
    }
    Ok(unpacked.into())
}

fn unpack_zstd(packed: &[u8], size: usize) -> std::io::Result<Vec<u8>> {
    // One call into memory of the size that was promised: it cannot grow, and the system hands out its
    // pages only as they are written.
    zstd::bulk::decompress(packed, size)
}

fn unpack_lz4(packed: &[u8], size: u64) -> std::io::Result<Vec<u8>> {
    let mut unpacked = Vec::new();
    // One byte more than promised, so that too much is noticed.
    lz4::Decoder::new(packed)?
        .take(size + 1)
        .read_to_end(&mut unpacked)?;
    Ok(unpacked)
}

/// Lists the records of an unpacked chunk in `index`, which is a part of the file's.
pub(super) fn list(unpacked: &[u8], number: u32, mut index: Index) -> Index {
    let mut position = 0;
    let mut broken_at = None;
    while position < unpacked.len() {
        let Some((opcode, body)) = record_at(unpacked, position) else {
            broken_at.get_or_insert(position);
            break;
        };
        let taken = match opcode {
            op::SCHEMA => records::schema(body).map(|s| index.add_schema(s, 0)),
            op::CHANNEL => records::channel(body).map(|c| index.add_channel(c, 0)),
            op::MESSAGE => records::message_header(body).map(|(channel, log_time)| {
                index.add_message(MessageRef {
                    log_time,
                    chunk: number,
                    channel,
                    offset: position as u64,
                });
            }),
            _ => Ok(()),
        };
        if taken.is_err() {
            broken_at.get_or_insert(position);
        }
        position += RECORD_HEADER + body.len();
    }
    if let Some(at) = broken_at {
        let what = format!("the chunk's records stop making sense at its byte {at}");
        index.add_damage(0, 0, what);
    }
    index
}

/// The data of the message that `message` stands for, within `bytes` that begin at its record or hold it
/// at `position`; `None` when there is another record, or none.
pub(super) fn message_data(bytes: &Bytes, position: usize, message: &MessageRef) -> Option<Bytes> {
    let (opcode, body) = record_at(bytes, position)?;
    let (channel, log_time) = records::message_header(body).ok()?;
    let same = opcode == op::MESSAGE && channel == message.channel && log_time == message.log_time;
    let start = position + RECORD_HEADER + MESSAGE_HEADER;
    same.then(|| bytes.slice(start..position + RECORD_HEADER + body.len()))
}
