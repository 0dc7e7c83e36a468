//! Finds the point up to which a truncated or damaged recording is intact, and the records that must follow there to
//! complete it. The file is read once, from front to back, up to its last intact record or the first damage. Nothing is
//! written before everything is known, and intact data is never overwritten; only wrong indexes are, and these can be
//! derived from the chunk before them.

use super::Error;
use super::chunk::{self, Budget};
use super::index::{Chunk, Index, most_of};
use super::records::{self, put, put_head, put_indexes};
use super::scan::{Scan, ScanEvent, Span};
use super::source::Source;
use crc32fast::Hasher;
use mcap::MAGIC;
use mcap::records::{Header, MessageIndex, Metadata, op};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::Result as IoResult;
use std::os::unix::fs::FileExt;

/// Bytes that are read and then summed or compared, while they are in the cache.
const BLOCK: usize = 256 << 10;

/// A recording that lacks its end, or is damaged somewhere.
pub(super) struct Truncated {
    /// Up to where its records are whole; what follows is not, or lies behind what is not.
    pub sound: u64,
    pub messages: u64,
    /// Bytes behind the sound part that are nothing which the end says again.
    pub rest: u64,
    /// What is to follow the sound part.
    end: Vec<u8>,
    /// What is to stand elsewhere within it.
    patches: Vec<Patch>,
}

/// Bytes, and where they are to be.
type Patch = (u64, Vec<u8>);

impl Truncated {
    /// Cuts the rest away and writes the end; nothing is on the disk yet.
    pub(super) fn complete(&self, file: &File) -> IoResult<()> {
        for (offset, bytes) in &self.patches {
            file.write_all_at(bytes, *offset)?;
        }
        file.set_len(self.sound)?;
        file.write_all_at(&self.end, self.sound)
    }

    /// Whether another file is what this one would be, completed.
    pub(super) fn is_completed_in(&self, source: &Source, other: &File) -> Result<bool, Error> {
        let length = self.sound + self.end.len() as u64;
        if !self.patches.is_empty() || !other.metadata().is_ok_and(|m| m.len() == length) {
            return Ok(false);
        }
        let mut theirs = vec![0; BLOCK];
        let mut at = 0;
        while at < length {
            let block = BLOCK.min((length - at) as usize);
            let left = self.sound.saturating_sub(at).min(block as u64) as usize;
            let mut ours = source.read(at, left)?;
            let end = (at + left as u64).saturating_sub(self.sound) as usize;
            ours.extend_from_slice(&self.end[end..end + block - left]);
            let read = other.read_exact_at(&mut theirs[..block], at);
            if read.is_err() || theirs[..block] != ours {
                return Ok(false);
            }
            at += block as u64;
        }
        Ok(true)
    }
}

/// Reads a recording up to where it is whole.
pub(super) fn find_end(source: &Source) -> Result<Truncated, Error> {
    if source.length == 0 {
        // Cut off before its first byte was on the disk.
        return Repair::new(source).truncated(0);
    }
    let mut scan = Scan::begin(source)?;
    let mut repair = Repair::new(source);
    while let Some(event) = scan.next()? {
        let sound = match event {
            ScanEvent::Damage(damage) => Some(damage.offset),
            ScanEvent::Record(span) => repair.take(&span, &mut scan)?.then_some(span.offset()),
        };
        if let Some(sound) = sound {
            return repair.truncated(sound);
        }
    }
    repair.truncated(source.length)
}

/// What was read so far, all of it whole.
struct Repair<'a> {
    source: &'a Source,
    index: Index,
    budget: Budget,
    patches: Vec<Patch>,
    /// CRC of the file up to `summed`, as it is to be.
    sum: Hasher,
    summed: u64,
    /// The indexes of the last chunk, where those that follow it are others.
    expected: Option<Expected>,
}

/// What should stand behind a chunk.
struct Expected {
    begin: u64,
    bytes: Vec<u8>,
    offsets: BTreeMap<u16, u64>,
}

impl Expected {
    fn end(&self) -> u64 {
        self.begin + self.bytes.len() as u64
    }

    fn set_index(self, chunk: Option<&mut Chunk>) {
        if let Some(chunk) = chunk {
            chunk.index_length = self.bytes.len() as u64;
            chunk.index_offsets = self.offsets;
        }
    }
}

impl<'a> Repair<'a> {
    fn new(source: &'a Source) -> Self {
        Self {
            source,
            index: Index::new(source.length),
            budget: Budget::of(source),
            patches: Vec::new(),
            sum: Hasher::new(),
            summed: 0,
            expected: None,
        }
    }

    /// Takes a record; whether the data end before it, because it is not whole or is of the summary.
    fn take(&mut self, span: &Span, scan: &mut Scan) -> Result<bool, Error> {
        match span.opcode {
            op::MESSAGE_INDEX => self.is_odd_index(span, scan),
            op::CHUNK => {
                self.settle_indexes(span.offset())?;
                self.take_chunk(span, scan)
            }
            op::HEADER | op::SCHEMA | op::CHANNEL | op::MESSAGE | op::ATTACHMENT | op::METADATA => {
                self.settle_indexes(span.offset())?;
                let body = scan.head(span, most_of(span.opcode))?;
                Ok(self.index.take(span, body).is_err())
            }
            op::DATA_END => self.settle_indexes(span.offset()).map(|()| true),
            // Nobody writes these here: a flipped bit would hide a chunk.
            _ => Ok(true),
        }
    }

    /// Whether an index is invalid or belongs to no chunk: correct ones were passed together with their chunk.
    fn is_odd_index(&self, span: &Span, scan: &mut Scan) -> Result<bool, Error> {
        let body = scan.head(span, most_of(op::MESSAGE_INDEX))?;
        let length = |index: MessageIndex| 2 + 4 + 16 * index.records.len() as u64;
        let is_whole = records::message_index(body).map(length) == Ok(span.length);
        Ok(self.expected.is_none() || !is_whole)
    }

    fn take_chunk(&mut self, span: &Span, scan: &mut Scan) -> Result<bool, Error> {
        let head = scan.head(span, records::CHUNK_HEAD_AT_MOST as u64)?;
        let Ok(header) = records::chunk(head, span.length) else {
            return Ok(true);
        };
        let mut chunk = Chunk::new(span.offset(), header);
        if chunk.offset + chunk.head_length() + chunk.header.compressed_size != span.end() {
            return Ok(true);
        }
        // It is kept in the tail with what follows it.
        if self.budget.take(&chunk).is_err() {
            return Ok(true);
        }
        let content = match chunk::unpack(self.source, &chunk) {
            Ok(content) => content,
            Err(Error::Damaged { .. }) => return Ok(true),
            Err(error) => return Err(error),
        };
        let number = self.index.chunks.len() as u32;
        let (part, is_whole) = chunk::list(&content, number, self.index.part());
        if !is_whole {
            return Ok(true);
        }
        let indexes = part.message_indexes();
        self.mend_times(&mut chunk, part.times());
        self.sum_chunk(&chunk, span.end())?;
        self.index.absorb(part, chunk.offset);
        self.index.chunks.push(chunk);
        self.expect_indexes(&indexes, span.end(), scan)?;
        Ok(false)
    }

    /// Nothing in the file checks what a chunk's head says of its times.
    fn mend_times(&mut self, chunk: &mut Chunk, times: (u64, u64)) {
        let header = &mut chunk.header;
        if (header.message_start_time, header.message_end_time) != times {
            (header.message_start_time, header.message_end_time) = times;
            self.patches.push((chunk.offset, head(chunk)));
        }
    }

    /// Sums a chunk, whose content has been summed already if it is not packed.
    fn sum_chunk(&mut self, chunk: &Chunk, end: u64) -> Result<(), Error> {
        self.sum_to(chunk.offset)?;
        self.sum.update(&head(chunk));
        self.summed = chunk.offset + chunk.head_length();
        let crc = chunk.header.uncompressed_crc;
        if chunk.header.compression.is_empty() && crc != 0 {
            let length = chunk.header.uncompressed_size;
            self.sum.combine(&Hasher::new_with_initial_len(crc, length));
            self.summed = end;
        }
        self.sum_to(end)
    }

    /// Sums the file from where it is summed to, up to `end`.
    fn sum_to(&mut self, end: u64) -> Result<(), Error> {
        while self.summed < end {
            let block = (end - self.summed).min(BLOCK as u64);
            self.sum
                .update(&self.source.read(self.summed, block as usize)?);
            self.summed += block;
        }
        Ok(())
    }

    /// Looks whether a chunk is followed by the indexes of its messages.
    fn expect_indexes(
        &mut self,
        indexes: &[MessageIndex],
        begin: u64,
        scan: &mut Scan,
    ) -> Result<(), Error> {
        let (bytes, offsets) = put_indexes(indexes, begin);
        let expected = Expected {
            begin,
            bytes,
            offsets,
        };
        if self.source.read(begin, expected.bytes.len())? == expected.bytes {
            scan.skip_to(expected.end());
            expected.set_index(self.index.chunks.last_mut());
        } else {
            self.expected = Some(expected);
        }
        Ok(())
    }

    /// Mends the indexes that end at `end` if they are as long as they should be. Others stay: a reader that finds that
    /// they cannot be right looks into the chunks.
    fn settle_indexes(&mut self, end: u64) -> Result<(), Error> {
        if let Some(expected) = self.expected.take_if(|expected| expected.end() == end) {
            self.sum_to(expected.begin)?;
            self.sum.update(&expected.bytes);
            self.summed = end;
            let patch = (expected.begin, expected.bytes.clone());
            self.patches.push(patch);
            expected.set_index(self.index.chunks.last_mut());
        }
        self.expected = None;
        Ok(())
    }

    /// The recording, whole up to `sound`.
    fn truncated(mut self, mut sound: u64) -> Result<Truncated, Error> {
        self.index.check_format(&self.source.path)?;
        self.index.check_number(&self.source.path)?;
        let mut end = Vec::new();
        if sound <= MAGIC.len() as u64 {
            sound = 0;
            end = self.beginning();
        } else if let Some(expected) = self.expected.take_if(|expected| sound < expected.end()) {
            // They were cut off with what follows, and are written again.
            sound = expected.begin;
            end.clone_from(&expected.bytes);
            expected.set_index(self.index.chunks.last_mut());
        } else {
            self.settle_indexes(sound)?;
        }
        self.sum_to(sound)?;
        self.sum.update(&end);
        let closing = self
            .index
            .closing(sound + end.len() as u64, self.sum.finalize());
        end.extend(closing);
        let rest = self.source.length - sound;
        let is_told_again =
            rest <= end.len() as u64 && end.starts_with(&self.source.read(sound, rest as usize)?);
        Ok(Truncated {
            sound,
            messages: self.index.messages.len() as u64,
            rest: if is_told_again { 0 } else { rest },
            end,
            patches: self.patches,
        })
    }

    /// What a recording begins with, for one that was cut off before it had that.
    fn beginning(&mut self) -> Vec<u8> {
        let header = Header {
            profile: "scand".into(),
            library: String::new(),
        };
        let format = Metadata {
            name: "scand".into(),
            metadata: [("format".into(), "1".into())].into(),
        };
        let mut bytes = MAGIC.to_vec();
        put(&mut bytes, op::HEADER, &header);
        let offset = bytes.len() as u64;
        put(&mut bytes, op::METADATA, &format);
        let length = bytes.len() as u64 - offset;
        self.index.add_metadata(offset, length, format);
        bytes
    }
}

/// The bytes of a chunk's record before its data.
fn head(chunk: &Chunk) -> Vec<u8> {
    let mut head = Vec::new();
    put_head(
        &mut head,
        op::CHUNK,
        &chunk.header,
        chunk.header.compressed_size,
    );
    head
}
