//! A recording that was cut off or damaged is completed where it is: what it holds is read once and checked up to its
//! last unfinished record or the first damage, what follows is cut away, and what is missing at its end is written. Only
//! where everything before is exactly as the writer makes it; what is otherwise is left to the slower way, which copies
//! what can be read.

use super::container::{MessageIndexes, put_indexes};
use super::records::{self, Malformed, MessageTimes, Parsed, RECORD_HEADER, record_at};
use super::summary::{AttachmentEntry, ChunkEntry, MetadataEntry, Summary};
use super::walk::LARGEST_RECORD;
use crc32fast::Hasher;
use mcap::MAGIC;
use mcap::records::op;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::Result;
use std::os::unix::fs::FileExt;

/// Bytes that are read and then summed, while they are in the cache.
const BLOCK: usize = 256 << 10;
/// Bytes of an unpacked chunk's record before its content.
const CHUNK_HEAD: usize = RECORD_HEADER + ChunkEntry::HEAD as usize;

/// A recording that, up to where it is cut off or damaged, lacks nothing but its end.
pub(super) struct Unended {
    /// Up to where its records are whole; what follows is not, or lies behind what is not.
    pub sound: u64,
    pub length: u64,
    pub messages: u64,
    /// What is to follow the sound part.
    end: Vec<u8>,
}

impl Unended {
    /// Bytes of the file that are no part of the completed recording.
    pub(super) fn rest(&self) -> u64 {
        self.length - self.sound
    }

    /// Cuts the rest away and writes the end; nothing is on the disk yet.
    pub(super) fn complete(&self, file: &File) -> Result<()> {
        file.set_len(self.sound)?;
        file.write_all_at(&self.end, self.sound)
    }
}

/// Looks whether a file is a recording that lacks nothing but its end, or is so up to a damage.
pub(super) fn unended(file: &File) -> Result<Option<Unended>> {
    let length = file.metadata()?.len();
    let scan = Scan {
        file,
        length,
        position: 0,
        sum: Hasher::new(),
        buffer: Vec::new(),
        summary: Summary::default(),
        missing: Vec::new(),
        is_ours: false,
    };
    scan.run()
}

/// Where a file has been read up to, and what was found.
struct Scan<'a> {
    file: &'a File,
    length: u64,
    /// Everything before is sound.
    position: u64,
    /// CRC of everything before.
    sum: Hasher,
    buffer: Vec<u8>,
    summary: Summary,
    /// The indexes of the last chunk, where they are not all there.
    missing: Vec<u8>,
    /// Whether it says that it has the format that is known here.
    is_ours: bool,
}

/// What a place in the file holds.
enum Found {
    /// A record that is as it should be.
    Sound,
    /// No whole record any more.
    CutOff,
    /// What can be no record, or a chunk whose bytes are not those that were written.
    Damaged,
    /// The end of the data.
    DataEnd,
    /// Something else, which another reader may understand.
    Strange,
}

impl From<Malformed> for Found {
    fn from(_: Malformed) -> Self {
        Self::Strange
    }
}

impl Scan<'_> {
    fn run(mut self) -> Result<Option<Unended>> {
        if !self.takes_begin()? {
            return Ok(None);
        }
        loop {
            match self.next()? {
                Found::Sound => {}
                Found::Strange => return Ok(None),
                Found::CutOff | Found::Damaged => {
                    return Ok(self.is_ours.then(|| self.ended()));
                }
                Found::DataEnd => return self.with_an_end(),
            }
        }
    }

    fn ended(&self) -> Unended {
        let mut sum = self.sum.clone();
        sum.update(&self.missing);
        let at = self.position + self.missing.len() as u64;
        let closing = self.summary.close(at, sum.finalize());
        Unended {
            sound: self.position,
            length: self.length,
            messages: self.summary.messages.values().sum(),
            end: [self.missing.as_slice(), &closing].concat(),
        }
    }

    /// A file that was being completed when the machine stopped: as far as it is there, its end is what would be
    /// written.
    fn with_an_end(mut self) -> Result<Option<Unended>> {
        let mut unended = self.ended();
        let rest = unended.rest();
        if !self.is_ours || rest > unended.end.len() as u64 {
            return Ok(None);
        }
        self.read(rest, 0)?;
        // Nothing of that is to be kept: it is written again.
        unended.length = unended.sound;
        Ok(unended.end.starts_with(&self.buffer).then_some(unended))
    }

    /// Reads bytes behind what is known to be sound; the CRC of all but the first.
    fn read(&mut self, length: u64, unsummed: usize) -> Result<Hasher> {
        let mut sum = Hasher::new();
        self.buffer.resize(length as usize, 0);
        let (mut offset, mut unsummed) = (self.position, unsummed);
        for block in self.buffer.chunks_mut(BLOCK) {
            self.file.read_exact_at(block, offset)?;
            sum.update(block.get(unsummed..).unwrap_or_default());
            unsummed = 0;
            offset += block.len() as u64;
        }
        Ok(sum)
    }

    /// Goes behind what was read.
    fn pass(&mut self, sum: &Hasher, unsummed: usize) {
        self.sum.update(&self.buffer[..unsummed]);
        self.sum.combine(sum);
        self.position += self.buffer.len() as u64;
    }

    fn left(&self) -> u64 {
        self.length - self.position
    }

    fn takes_begin(&mut self) -> Result<bool> {
        if self.left() < MAGIC.len() as u64 {
            return Ok(false);
        }
        let sum = self.read(MAGIC.len() as u64, 0)?;
        self.pass(&sum, 0);
        Ok(self.buffer == MAGIC)
    }

    fn next(&mut self) -> Result<Found> {
        let Some(left) = self.left().checked_sub(RECORD_HEADER as u64) else {
            return Ok(Found::CutOff);
        };
        self.read(RECORD_HEADER as u64, 0)?;
        let (opcode, length) = match records::record_header(&self.buffer) {
            Ok((op::DATA_END, _)) => return Ok(Found::DataEnd),
            // Blocks that never came to the disk are zeros.
            Ok((0, _)) => return Ok(Found::Damaged),
            Err(_) => return Ok(Found::Strange),
            Ok((_, length)) if length > left => return Ok(Found::CutOff),
            Ok((_, length)) if length > LARGEST_RECORD => return Ok(Found::Strange),
            Ok(found) => found,
        };
        let record = RECORD_HEADER as u64 + length;
        if opcode == op::CHUNK {
            let sum = self.read(record, CHUNK_HEAD)?;
            return self.take_chunk(&sum);
        }
        let sum = self.read(record, 0)?;
        let taken = match opcode {
            op::HEADER => records::header(&self.buffer[RECORD_HEADER..]).map(|_| ()),
            op::METADATA => self.take_metadata(),
            op::ATTACHMENT => self.take_attachment(),
            _ => Err(Malformed),
        };
        if taken.is_err() {
            return Ok(Found::Strange);
        }
        self.pass(&sum, 0);
        Ok(Found::Sound)
    }

    fn take_metadata(&mut self) -> Parsed<()> {
        let (name, pairs) = records::metadata(&self.buffer[RECORD_HEADER..])?;
        if name == "scand" {
            self.is_ours = pairs.get("format").is_some_and(|format| format == "1");
        }
        self.summary.metadata.push(MetadataEntry {
            offset: self.position,
            length: self.buffer.len() as u64,
            name,
        });
        Ok(())
    }

    fn take_attachment(&mut self) -> Parsed<()> {
        let body = &self.buffer[RECORD_HEADER..];
        let (name, media_type, data) = records::attachment(body)?;
        let mut head = records::Cursor(body);
        let entry = AttachmentEntry {
            offset: self.position,
            log_time: head.u64()?,
            create_time: head.u64()?,
            data_size: data.len() as u64,
            name,
            media_type,
        };
        if entry.length() != self.buffer.len() as u64 {
            return Err(Malformed);
        }
        self.summary.attachments.push(entry);
        Ok(())
    }

    /// Takes the chunk that was read, whose content has this CRC, and the indexes behind it.
    fn take_chunk(&mut self, sum: &Hasher) -> Result<Found> {
        let (mut entry, indexes) = match self.chunk(sum.clone().finalize()) {
            Ok(chunk) => chunk,
            Err(found) => return Ok(found),
        };
        self.pass(sum, CHUNK_HEAD);
        let mut expected = Vec::new();
        entry.index_offsets = put_indexes(&mut expected, &indexes, self.position);
        entry.index_length = expected.len() as u64;
        let sum = self.read(entry.index_length.min(self.left()), 0)?;
        if !expected.starts_with(&self.buffer) {
            return Ok(Found::Strange);
        }
        self.summary.chunks.push(entry);
        for (channel, messages) in indexes {
            *self.summary.messages.entry(channel).or_default() += messages.len() as u64;
            let times = messages.iter().map(|(time, _)| *time);
            times.for_each(|time| self.summary.times.add(time));
        }
        if self.buffer.len() < expected.len() {
            // They are written again.
            self.length = self.position;
            self.missing = expected;
            return Ok(Found::CutOff);
        }
        self.pass(&sum, 0);
        Ok(Found::Sound)
    }

    /// The chunk that was read, without what is behind it, if all in it is as it should be; else what it is.
    fn chunk(&mut self, crc: u32) -> std::result::Result<(ChunkEntry, MessageIndexes), Found> {
        let content = self.buffer.get(CHUNK_HEAD..).ok_or(Malformed)?;
        let head = &self.buffer[RECORD_HEADER..CHUNK_HEAD];
        let length = content.len() as u64;
        let body = self.position + RECORD_HEADER as u64;
        let info = records::chunk_header(head, body, ChunkEntry::HEAD + length)?;
        let sizes = [info.compressed_size, info.uncompressed_size];
        let has_sum = info.uncompressed_crc != 0;
        if !info.compression.is_empty() || sizes != [length; 2] || !has_sum {
            return Err(Found::Strange);
        }
        if info.uncompressed_crc != crc {
            return Err(Found::Damaged);
        }
        let (times, indexes) = messages(content, &mut self.summary)?;
        let mut said = records::Cursor(head);
        if times.or_zeros() != (said.u64()?, said.u64()?) {
            return Err(Found::Strange);
        }
        let entry = ChunkEntry {
            offset: self.position,
            times: times.or_zeros(),
            compression: "",
            compressed_size: length,
            uncompressed_size: length,
            index_offsets: BTreeMap::new(),
            index_length: 0,
        };
        Ok((entry, indexes))
    }
}

/// The messages of a chunk; what it defines goes into the summary.
fn messages(content: &[u8], summary: &mut Summary) -> Parsed<(MessageTimes, MessageIndexes)> {
    let mut times = MessageTimes::default();
    let mut indexes = MessageIndexes::new();
    let mut position = 0;
    while position < content.len() {
        let (opcode, body) = record_at(content, position).ok_or(Malformed)?;
        match opcode {
            op::SCHEMA => {
                let (id, schema) = records::schema_text(body)?;
                define(&mut summary.schemas, id, schema)?;
            }
            op::CHANNEL => {
                let (id, channel) = records::channel_text(body)?;
                define(&mut summary.channels, id, channel)?;
            }
            op::MESSAGE => {
                let (channel, time) = records::message_header(body)?;
                if !summary.channels.contains_key(&channel) {
                    return Err(Malformed);
                }
                times.add(time);
                let index = indexes.entry(channel).or_default();
                index.push((time, position as u64));
            }
            _ => return Err(Malformed),
        }
        position += RECORD_HEADER + body.len();
    }
    Ok((times, indexes))
}

/// Takes a definition; one of a number that is taken must be the same.
fn define<T: PartialEq>(known: &mut BTreeMap<u16, T>, id: u16, new: T) -> Parsed<()> {
    let is_same = known.get(&id).is_none_or(|known| *known == new);
    known.insert(id, new);
    is_same.then_some(()).ok_or(Malformed)
}
