//! One chunk: its bytes unpacked and checked, and the messages and channels in it.

use super::index::{Chunk, Index, MessageRef};
use super::records::{self, MESSAGE_HEADER, Malformed, Parsed, RECORD_HEADER, record_at};
use super::scan::LARGEST_RECORD;
use super::source::Source;
use super::{Damage, Error};
use bytes::Bytes;
use mcap::records::op;
use std::io::Read;

/// Largest chunk that may unpack to more than a hundred times what it is: pictures of one colour shrink so.
const LARGEST_OF_LITTLE: u64 = 96 << 20;

/// What the chunks of one file may unpack to together: pictures shrink a little, flat ones a lot, but a file that grows
/// a hundredfold was made to.
pub(super) struct Budget {
    allowed: u64,
    taken: u64,
}

impl Budget {
    pub(super) fn of(source: &Source) -> Self {
        const ALWAYS: u64 = 256 << 20;
        Self {
            allowed: ALWAYS.saturating_add(source.length.saturating_mul(100)),
            taken: 0,
        }
    }

    /// Takes what a chunk unpacks to, or says that it is too much. One that is too large by itself takes nothing:
    /// [`unpack`] refuses it.
    pub(super) fn take(&mut self, chunk: &Chunk) -> Result<(), Damage> {
        let size = chunk.header.uncompressed_size;
        if size > LARGEST_RECORD {
            return Ok(());
        }
        let (taken, allowed) = (self.taken.saturating_add(size), self.allowed);
        if taken > allowed {
            return Err(Damage {
                offset: chunk.offset,
                length: chunk.header.compressed_size,
                what: format!("the chunks together unpack to more than {allowed} bytes"),
            });
        }
        self.taken = taken;
        Ok(())
    }
}

/// Reads a chunk, unpacks it and checks its CRC. Memory is taken as bytes arrive, not as the header claims.
pub(super) fn unpack(source: &Source, chunk: &Chunk) -> Result<Bytes, Error> {
    let header = &chunk.header;
    let damaged = |what: String| Error::Damaged {
        path: source.path.clone(),
        damage: Damage {
            offset: chunk.offset,
            length: header.compressed_size,
            what,
        },
    };
    let size = header.uncompressed_size;
    if size > LARGEST_RECORD {
        return Err(damaged(format!(
            "the chunk says it unpacks to {size} bytes, expected at most {LARGEST_RECORD}"
        )));
    }
    if size > LARGEST_OF_LITTLE && size / 100 > header.compressed_size {
        let packed = header.compressed_size;
        return Err(damaged(format!(
            "the chunk says it unpacks from {packed} to {size} bytes, expected at most \
            {LARGEST_OF_LITTLE} from so few"
        )));
    }
    // Both sizes are below 256 MiB here, and the packed one is within the file.
    let packed = source.read(
        chunk.offset + chunk.head_length(),
        header.compressed_size as usize,
    )?;
    let unpacked = match header.compression.as_str() {
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
    if header.uncompressed_crc != 0 && crc != header.uncompressed_crc {
        let expected = header.uncompressed_crc;
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

/// Lists the records of an unpacked chunk in `index`, which is a part of the file's; whether all of them make sense.
pub(super) fn list(unpacked: &[u8], number: u32, mut index: Index) -> (Index, bool) {
    let mut broken_at = None;
    for record in records::all(unpacked) {
        let (at, taken) = match record {
            Err(at) => (at, Err(Malformed)),
            Ok((opcode, at, body)) => (at, take(&mut index, number, opcode, at as u64, body)),
        };
        if taken.is_err() {
            broken_at.get_or_insert(at);
        }
    }
    if let Some(at) = broken_at {
        let what = format!("the chunk's records cannot be parsed from its byte {at} on");
        index.add_note(0, what);
    }
    (index, broken_at.is_none())
}

fn take(index: &mut Index, number: u32, opcode: u8, at: u64, body: &[u8]) -> Parsed<()> {
    match opcode {
        op::SCHEMA => index.add_schema(records::schema(body)?, 0),
        op::CHANNEL => index.add_channel(records::channel(body)?, 0),
        op::MESSAGE => index.add_message(number, at, records::message(body)?),
        _ => {}
    }
    Ok(())
}

/// The data of the message that `message` stands for, within `bytes` that begin at its record or hold it
/// at `position`; `None` when there is another record, or none.
pub(super) fn message_data(bytes: &Bytes, position: usize, message: &MessageRef) -> Option<Bytes> {
    let (opcode, body) = record_at(bytes, position)?;
    let header = records::message(body).ok()?;
    let same = opcode == op::MESSAGE
        && header.channel_id == message.channel
        && header.log_time == message.log_time;
    let start = position + RECORD_HEADER + MESSAGE_HEADER;
    same.then(|| bytes.slice(start..position + RECORD_HEADER + body.len()))
}
