//! What the end of a recording says of the rest: where its chunks, attachments and metadata are, and how many messages
//! there are of each channel. It is gathered while a recording is written, or while one that was cut off is read.

use super::encoding::{self, Statistics};
use super::records::{ChannelText, MessageTimes, RECORD_HEADER, SchemaText};
use mcap::MAGIC;
use mcap::records::op;
use std::collections::BTreeMap;

/// A chunk and the indexes behind it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct ChunkEntry {
    pub offset: u64,
    /// First and last log time; zeros where there is no message.
    pub times: (u64, u64),
    pub compression: &'static str,
    pub compressed_size: u64,
    pub uncompressed_size: u64,
    /// Where the message index of each channel is.
    pub index_offsets: BTreeMap<u16, u64>,
    pub index_length: u64,
}

impl ChunkEntry {
    /// Bytes of its record's body before the data: of a chunk that is not packed.
    pub(super) const HEAD: u64 = 8 + 8 + 8 + 4 + 4 + 8;

    /// Bytes of its record.
    pub(super) fn length(&self) -> u64 {
        RECORD_HEADER as u64 + Self::HEAD + self.compression.len() as u64 + self.compressed_size
    }
}

/// An attachment's place and what its head says.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct AttachmentEntry {
    pub offset: u64,
    pub log_time: u64,
    pub create_time: u64,
    pub name: String,
    pub media_type: String,
    pub data_size: u64,
}

impl AttachmentEntry {
    /// Bytes of its record.
    pub(super) fn length(&self) -> u64 {
        let texts = self.name.len() + self.media_type.len();
        (RECORD_HEADER + 8 + 8 + 4 + 4 + texts + 8 + 4) as u64 + self.data_size
    }
}

/// A metadata record's place and name.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct MetadataEntry {
    pub offset: u64,
    pub length: u64,
    pub name: String,
}

/// All of it.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct Summary {
    pub schemas: BTreeMap<u16, SchemaText>,
    pub channels: BTreeMap<u16, ChannelText>,
    pub chunks: Vec<ChunkEntry>,
    pub attachments: Vec<AttachmentEntry>,
    pub metadata: Vec<MetadataEntry>,
    pub times: MessageTimes,
    /// Messages of each channel.
    pub messages: BTreeMap<u16, u64>,
}

impl Summary {
    /// All that follows the data of a recording whose data end at `at` and have this CRC.
    pub(super) fn close(&self, at: u64, data_crc: u32) -> Vec<u8> {
        let mut out = Vec::new();
        encoding::data_end(&mut out, data_crc);
        let start = out.len();
        let mut groups = Vec::new();
        for (opcode, put) in self.groups() {
            let begin = out.len();
            put(self, &mut out);
            let length = (out.len() - begin) as u64;
            if length > 0 {
                groups.push((opcode, at + begin as u64, length));
            }
        }
        let offsets_start = at + out.len() as u64;
        for group in groups {
            encoding::summary_offset(&mut out, group);
        }
        encoding::footer_head(&mut out, at + start as u64, offsets_start);
        let crc = crc32fast::hash(&out[start..]);
        out.extend(crc.to_le_bytes());
        out.extend_from_slice(MAGIC);
        out
    }

    #[allow(clippy::type_complexity)] // Named, it would not be clearer.
    fn groups(&self) -> [(u8, fn(&Self, &mut Vec<u8>)); 6] {
        [
            (op::SCHEMA, |s, out| {
                let each = s.schemas.iter();
                each.for_each(|(&id, schema)| encoding::schema(out, id, schema));
            }),
            (op::CHANNEL, |s, out| {
                let each = s.channels.iter();
                each.for_each(|(&id, channel)| encoding::channel(out, id, channel));
            }),
            (op::STATISTICS, |s, out| {
                encoding::statistics(out, &s.statistics())
            }),
            (op::CHUNK_INDEX, |s, out| {
                s.chunks.iter().for_each(|c| encoding::chunk_index(out, c));
            }),
            (op::ATTACHMENT_INDEX, |s, out| {
                let each = s.attachments.iter();
                each.for_each(|a| encoding::attachment_index(out, a));
            }),
            (op::METADATA_INDEX, |s, out| {
                let each = s.metadata.iter();
                each.for_each(|m| encoding::metadata_index(out, m));
            }),
        ]
    }

    fn statistics(&self) -> Statistics<'_> {
        Statistics {
            schemas: self.schemas.len() as u16,
            channels: self.channels.len() as u32,
            attachments: self.attachments.len() as u32,
            metadata: self.metadata.len() as u32,
            chunks: self.chunks.len() as u32,
            times: self.times.or_zeros(),
            messages: &self.messages,
        }
    }
}
