//! Writes the summary at the end of a recording: where its chunks, attachments and metadata are, and how many messages
//! each channel has. It is derived from the index alone.

use super::index::{Chunk, Index};
use super::records::{Encoded, put, put_schema};
use mcap::MAGIC;
use mcap::records::{ChunkIndex, DataEnd, Footer, Statistics, SummaryOffset, op};
use std::collections::BTreeMap;

impl Index {
    /// All that follows the data of a recording whose data end at `at` and have this CRC.
    pub(super) fn closing(&self, at: u64, data_section_crc: u32) -> Vec<u8> {
        let mut out = Vec::new();
        put(&mut out, op::DATA_END, &DataEnd { data_section_crc });
        let start = out.len();
        let mut groups = Vec::new();
        for (group_opcode, group) in self.groups() {
            if !group.is_empty() {
                groups.push(SummaryOffset {
                    group_opcode,
                    group_start: at + out.len() as u64,
                    group_length: group.len() as u64,
                });
                out.extend(group);
            }
        }
        let mut footer = Footer {
            summary_start: at + start as u64,
            summary_offset_start: at + out.len() as u64,
            summary_crc: 0,
        };
        out.extend(each(op::SUMMARY_OFFSET, &groups));
        let footer_at = out.len();
        put(&mut out, op::FOOTER, &footer);
        // Of all but the CRC itself, which comes last.
        footer.summary_crc = crc32fast::hash(&out[start..out.len() - 4]);
        out.truncate(footer_at);
        put(&mut out, op::FOOTER, &footer);
        out.extend_from_slice(MAGIC);
        out
    }

    /// The records of each kind.
    fn groups(&self) -> [(u8, Vec<u8>); 6] {
        let mut schemas = Vec::new();
        self.schemas
            .values()
            .for_each(|schema| put_schema(&mut schemas, schema));
        let chunks: Vec<ChunkIndex> = self.chunks.iter().map(entry).collect();
        let attachments = self.attachments.iter().map(|a| &a.entry);
        [
            (op::SCHEMA, schemas),
            (op::CHANNEL, each(op::CHANNEL, self.channels.values())),
            (op::STATISTICS, each(op::STATISTICS, [&self.statistics()])),
            (op::CHUNK_INDEX, each(op::CHUNK_INDEX, &chunks)),
            (
                op::ATTACHMENT_INDEX,
                each(op::ATTACHMENT_INDEX, attachments),
            ),
            (
                op::METADATA_INDEX,
                each(op::METADATA_INDEX, &self.metadata_entries),
            ),
        ]
    }

    fn statistics(&self) -> Statistics {
        let mut channel_message_counts: BTreeMap<u16, u64> = BTreeMap::new();
        for message in &self.messages {
            *channel_message_counts.entry(message.channel).or_default() += 1;
        }
        let (message_start_time, message_end_time) = self.times();
        Statistics {
            message_count: self.messages.len() as u64,
            schema_count: self.schemas.len() as u16,
            channel_count: self.channels.len() as u32,
            attachment_count: self.attachments.len() as u32,
            metadata_count: self.metadata_entries.len() as u32,
            chunk_count: self.chunks.len() as u32,
            message_start_time,
            message_end_time,
            channel_message_counts,
        }
    }
}

fn entry(chunk: &Chunk) -> ChunkIndex {
    let header = &chunk.header;
    ChunkIndex {
        message_start_time: header.message_start_time,
        message_end_time: header.message_end_time,
        chunk_start_offset: chunk.offset,
        chunk_length: chunk.head_length() + header.compressed_size,
        message_index_offsets: chunk.index_offsets.clone(),
        message_index_length: chunk.index_length,
        compression: header.compression.clone(),
        compressed_size: header.compressed_size,
        uncompressed_size: header.uncompressed_size,
    }
}

/// Records of one kind, one after the other.
fn each<'a, T: Encoded + 'a>(opcode: u8, records: impl IntoIterator<Item = &'a T>) -> Vec<u8> {
    let mut out = Vec::new();
    records
        .into_iter()
        .for_each(|record| put(&mut out, opcode, record));
    out
}
