//! The file of a recording that is written: records one after the other, messages in chunks, everything summed. What the
//! messages are, and when a chunk ends, is decided by the writer above.
//!
//! Pictures go from the memory they are in to the file, in blocks that stay in the processor's cache between their CRC
//! and their copy. An unpacked chunk goes into the file as it grows and gets its lengths afterwards: one that a crash cut
//! off has none, and no reader takes it for whole. Its CRC is also its part of the file's, so that no byte is summed twice.

use super::encoding::{self, MessageHead};
use super::records::{ChannelText, MessageTimes, RECORD_HEADER, SchemaText};
use super::summary::{AttachmentEntry, ChunkEntry, MetadataEntry, Summary};
use super::writer::Compression;
use crc32fast::Hasher;
use mcap::MAGIC;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{Error, ErrorKind, IoSlice, Result, Write};
use std::os::unix::fs::FileExt;

/// Bytes that are gathered before they are written; larger ones than [`LARGE`] pass by.
const GATHERED: usize = 64 << 10;
const LARGE: usize = 16 << 10;
/// Bytes that are summed and then written, while they are in the cache.
const BLOCK: usize = 256 << 10;

/// Indexes of a chunk's messages: of each channel the log times and offsets.
pub(super) type MessageIndexes = BTreeMap<u16, Vec<(u64, u64)>>;

/// A recording's file, open at its end.
pub(super) struct Container {
    file: File,
    /// Bytes that are in the file.
    written: u64,
    /// What comes next in the file.
    gathered: Vec<u8>,
    /// How many of those are summed.
    summed: usize,
    /// CRC of the file up to here, or while a chunk is open that of the chunk's content.
    sum: Hasher,
    chunk: Option<Chunk>,
    compression: Compression,
    summary: Summary,
    /// After a write that failed nobody knows where the file ends.
    failed: bool,
}

/// The open chunk.
struct Chunk {
    offset: u64,
    /// Bytes of its content.
    size: u64,
    times: MessageTimes,
    indexes: MessageIndexes,
    /// CRC of the file up to the chunk.
    before: Hasher,
    /// Where its content is packed; `None` if that goes into the file as it is.
    packing: Option<zstd::Encoder<'static, Vec<u8>>>,
}

impl Container {
    /// Begins an empty file.
    pub(super) fn begin(
        file: File,
        profile: &str,
        library: &str,
        compression: Compression,
    ) -> Self {
        let mut gathered = MAGIC.to_vec();
        encoding::header(&mut gathered, profile, library);
        Self {
            file,
            written: 0,
            gathered,
            summed: 0,
            sum: Hasher::new(),
            chunk: None,
            compression,
            summary: Summary::default(),
            failed: false,
        }
    }

    /// The number of a schema, which is defined here if it is a new one.
    pub(super) fn schema(&mut self, schema: SchemaText) -> Result<u16> {
        let mut known = self.summary.schemas.iter();
        if let Some((&id, _)) = known.find(|(_, known)| **known == schema) {
            return Ok(id);
        }
        let id = next_number(self.summary.schemas.keys().next_back(), "schemas")?;
        self.put_in_chunk(|out| encoding::schema(out, id, &schema))?;
        self.summary.schemas.insert(id, schema);
        Ok(id)
    }

    /// The same of a channel.
    pub(super) fn channel(&mut self, channel: ChannelText) -> Result<u16> {
        let mut known = self.summary.channels.iter();
        if let Some((&id, _)) = known.find(|(_, known)| **known == channel) {
            return Ok(id);
        }
        let id = next_number(self.summary.channels.keys().next_back(), "channels")?;
        self.put_in_chunk(|out| encoding::channel(out, id, &channel))?;
        self.summary.channels.insert(id, channel);
        Ok(id)
    }

    /// Writes a message whose data are these parts, one behind the other.
    pub(super) fn message(&mut self, head: &MessageHead, data: [&[u8]; 2]) -> Result<()> {
        let chunk = self.open_chunk()?;
        let offset = chunk.size;
        chunk.times.add(head.log_time);
        let index = chunk.indexes.entry(head.channel).or_default();
        index.push((head.log_time, offset));
        self.summary.times.add(head.log_time);
        *self.summary.messages.entry(head.channel).or_default() += 1;
        let length = data[0].len() + data[1].len();
        self.put_in_chunk(|out| encoding::message_head(out, head, length))?;
        self.put(data[0])?;
        self.put(data[1])
    }

    /// Writes a metadata record, after the open chunk.
    pub(super) fn metadata(&mut self, name: &str, about: &BTreeMap<String, String>) -> Result<()> {
        self.end_chunk()?;
        let mut record = Vec::new();
        encoding::metadata(&mut record, name, about);
        self.summary.metadata.push(MetadataEntry {
            offset: self.position(),
            length: record.len() as u64,
            name: name.into(),
        });
        self.put(&record)
    }

    /// Writes an attachment, after the open chunk.
    pub(super) fn attach(&mut self, attachment: &mcap::Attachment) -> Result<()> {
        self.end_chunk()?;
        let entry = AttachmentEntry {
            offset: self.position(),
            log_time: attachment.log_time,
            create_time: attachment.create_time,
            name: attachment.name.clone(),
            media_type: attachment.media_type.clone(),
            data_size: attachment.data.len() as u64,
        };
        let mut head = Vec::new();
        encoding::attachment_head(&mut head, &entry);
        let mut crc = Hasher::new();
        crc.update(&head[RECORD_HEADER..]);
        crc.update(&attachment.data);
        self.put(&head)?;
        self.put(&attachment.data)?;
        self.put(&crc.finalize().to_le_bytes())?;
        self.summary.attachments.push(entry);
        Ok(())
    }

    /// Ends the open chunk, if there is one: the next message begins another.
    pub(super) fn end_chunk(&mut self) -> Result<()> {
        let Some(chunk) = self.chunk.take() else {
            return Ok(());
        };
        self.sum_gathered();
        let content = std::mem::replace(&mut self.sum, chunk.before);
        let packed = chunk.packing.map(zstd::Encoder::finish).transpose()?;
        let mut entry = ChunkEntry {
            offset: chunk.offset,
            times: chunk.times.or_zeros(),
            compression: if packed.is_some() { "zstd" } else { "" },
            compressed_size: packed.as_ref().map_or(chunk.size, |p| p.len() as u64),
            uncompressed_size: chunk.size,
            index_offsets: BTreeMap::new(),
            index_length: 0,
        };
        let mut head = Vec::new();
        encoding::chunk_head(&mut head, &entry, content.clone().finalize());
        if let Some(packed) = packed {
            self.put(&head)?;
            self.put(&packed)?;
        } else {
            self.place(chunk.offset, &head)?;
            self.sum.update(&head);
            self.sum.combine(&content);
        }
        let mut indexes = Vec::new();
        entry.index_offsets = put_indexes(&mut indexes, &chunk.indexes, self.position());
        entry.index_length = indexes.len() as u64;
        self.summary.chunks.push(entry);
        self.put(&indexes)
    }

    /// Ends the open chunk; everything is in the file then, though not on the disk yet.
    pub(super) fn flush(&mut self) -> Result<()> {
        self.end_chunk()?;
        self.write_out(&[])
    }

    /// Writes what the file ends with.
    pub(super) fn finish(mut self) -> Result<()> {
        self.flush()?;
        let closing = self
            .summary
            .close(self.written, self.sum.clone().finalize());
        self.put(&closing)?;
        self.write_out(&[])
    }

    fn position(&self) -> u64 {
        self.written + self.gathered.len() as u64
    }

    /// The open chunk, begun if there is none.
    fn open_chunk(&mut self) -> Result<&mut Chunk> {
        let chunk = match self.chunk.take() {
            Some(chunk) => chunk,
            None => self.begin_chunk()?,
        };
        Ok(self.chunk.insert(chunk))
    }

    fn begin_chunk(&mut self) -> Result<Chunk> {
        self.sum_gathered();
        let offset = self.position();
        let packing = match self.compression {
            Compression::None => None,
            Compression::Zstd => Some(zstd::Encoder::new(Vec::new(), 0)?),
        };
        if packing.is_none() {
            // Summed when it says what it shall.
            encoding::open_chunk_head(&mut self.gathered);
            self.summed = self.gathered.len();
        }
        Ok(Chunk {
            offset,
            size: 0,
            times: MessageTimes::default(),
            indexes: MessageIndexes::new(),
            before: std::mem::take(&mut self.sum),
            packing,
        })
    }

    /// Writes a small record into the open chunk.
    fn put_in_chunk(&mut self, record: impl FnOnce(&mut Vec<u8>)) -> Result<()> {
        self.open_chunk()?;
        let mut bytes = Vec::new();
        record(&mut bytes);
        self.put(&bytes)
    }

    /// Writes bytes into the open chunk, or behind everything where there is none.
    fn put(&mut self, bytes: &[u8]) -> Result<()> {
        if let Some(chunk) = &mut self.chunk {
            chunk.size += bytes.len() as u64;
            if let Some(packing) = &mut chunk.packing {
                self.sum.update(bytes);
                return packing.write_all(bytes);
            }
        }
        if bytes.len() >= LARGE {
            return bytes.chunks(BLOCK).try_for_each(|b| self.write_out(b));
        }
        self.gathered.extend_from_slice(bytes);
        if self.gathered.len() >= GATHERED {
            self.write_out(&[])?;
        }
        Ok(())
    }

    fn sum_gathered(&mut self) {
        self.sum.update(&self.gathered[self.summed..]);
        self.summed = self.gathered.len();
    }

    /// Writes what was gathered, and `block` behind it.
    fn write_out(&mut self, block: &[u8]) -> Result<()> {
        self.sum_gathered();
        self.sum.update(block);
        self.attempt(|c| write_both(&c.file, &c.gathered, block))?;
        self.written += (self.gathered.len() + block.len()) as u64;
        self.gathered.clear();
        self.summed = 0;
        Ok(())
    }

    /// Writes over bytes that are in the file, or will be.
    fn place(&mut self, offset: u64, bytes: &[u8]) -> Result<()> {
        match offset.checked_sub(self.written) {
            Some(ahead) => {
                self.gathered[ahead as usize..][..bytes.len()].copy_from_slice(bytes);
                Ok(())
            }
            None => self.attempt(|c| c.file.write_all_at(bytes, offset)),
        }
    }

    fn attempt(&mut self, write: impl FnOnce(&Self) -> Result<()>) -> Result<()> {
        if self.failed {
            return Err(Error::other("an earlier write has failed"));
        }
        let written = write(self);
        self.failed = written.is_err();
        written
    }
}

/// The records of a chunk's message indexes, and where each is if they begin at `position` in the file.
pub(super) fn put_indexes(
    out: &mut Vec<u8>,
    indexes: &MessageIndexes,
    position: u64,
) -> BTreeMap<u16, u64> {
    let put = |(&channel, messages): (&u16, &Vec<(u64, u64)>)| {
        let offset = position + out.len() as u64;
        encoding::message_index(out, channel, messages);
        (channel, offset)
    };
    indexes.iter().map(put).collect()
}

fn next_number(last: Option<&u16>, what: &str) -> Result<u16> {
    let next = last.map_or(Some(1), |last| last.checked_add(1));
    next.ok_or_else(|| Error::other(format!("a recording has at most 65535 {what}")))
}

/// Writes two slices, the second behind the first, with as few calls as the system lets do.
fn write_both(mut file: &File, first: &[u8], second: &[u8]) -> Result<()> {
    let mut both = [IoSlice::new(first), IoSlice::new(second)];
    let mut left = &mut both[..];
    IoSlice::advance_slices(&mut left, 0);
    while !left.is_empty() {
        match file.write_vectored(left) {
            Ok(0) => return Err(ErrorKind::WriteZero.into()),
            Ok(written) => IoSlice::advance_slices(&mut left, written),
            Err(cause) if cause.kind() == ErrorKind::Interrupted => {}
            Err(cause) => return Err(cause),
        }
    }
    Ok(())
}
