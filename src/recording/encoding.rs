//! The bytes of MCAP records, put together: what `records` takes apart. Each function appends one record. Nothing here
//! writes a file, and what follows what is decided elsewhere.

use super::records::{ChannelText, MESSAGE_HEADER, RECORD_HEADER, SchemaText};
use super::summary::{AttachmentEntry, ChunkEntry, MetadataEntry};
use mcap::records::op;
use std::collections::BTreeMap;

fn text(out: &mut Vec<u8>, text: &str) {
    block(out, text.as_bytes());
}

/// Bytes behind their 32-bit length.
fn block(out: &mut Vec<u8>, bytes: &[u8]) {
    out.extend((bytes.len() as u32).to_le_bytes());
    out.extend_from_slice(bytes);
}

fn pairs(out: &mut Vec<u8>, pairs: &BTreeMap<String, String>) {
    let length: usize = pairs.iter().map(|(k, v)| 8 + k.len() + v.len()).sum();
    out.extend((length as u32).to_le_bytes());
    for (key, value) in pairs {
        text(out, key);
        text(out, value);
    }
}

fn number(out: &mut Vec<u8>, number: u64) {
    out.extend(number.to_le_bytes());
}

fn numbers<const N: usize>(out: &mut Vec<u8>, all: [u64; N]) {
    all.iter().for_each(|&n| number(out, n));
}

/// A record whose length is known when its body is there.
fn record(out: &mut Vec<u8>, opcode: u8, body: impl FnOnce(&mut Vec<u8>)) {
    out.push(opcode);
    let length_at = out.len();
    number(out, 0);
    let begin = out.len();
    body(out);
    let length = (out.len() - begin) as u64;
    out[length_at..begin].copy_from_slice(&length.to_le_bytes());
}

pub(super) fn header(out: &mut Vec<u8>, profile: &str, library: &str) {
    record(out, op::HEADER, |out| {
        text(out, profile);
        text(out, library);
    });
}

pub(super) fn schema(out: &mut Vec<u8>, id: u16, schema: &SchemaText) {
    record(out, op::SCHEMA, |out| {
        out.extend(id.to_le_bytes());
        text(out, &schema.name);
        text(out, &schema.encoding);
        block(out, &schema.data);
    });
}

pub(super) fn channel(out: &mut Vec<u8>, id: u16, channel: &ChannelText) {
    record(out, op::CHANNEL, |out| {
        out.extend(id.to_le_bytes());
        out.extend(channel.schema.to_le_bytes());
        text(out, &channel.topic);
        text(out, &channel.encoding);
        pairs(out, &channel.metadata);
    });
}

/// What a message has beside its data.
#[derive(Clone, Copy)]
pub(super) struct MessageHead {
    pub channel: u16,
    pub sequence: u32,
    pub log_time: u64,
    pub publish_time: u64,
}

/// A message but for its data, of which `length` bytes follow.
pub(super) fn message_head(out: &mut Vec<u8>, head: &MessageHead, length: usize) {
    out.push(op::MESSAGE);
    number(out, (MESSAGE_HEADER + length) as u64);
    out.extend(head.channel.to_le_bytes());
    out.extend(head.sequence.to_le_bytes());
    numbers(out, [head.log_time, head.publish_time]);
}

/// A chunk but for its data, which `chunk.compressed_size` bytes follow.
pub(super) fn chunk_head(out: &mut Vec<u8>, chunk: &ChunkEntry, crc: u32) {
    out.push(op::CHUNK);
    number(out, chunk.length() - RECORD_HEADER as u64);
    numbers(out, [chunk.times.0, chunk.times.1, chunk.uncompressed_size]);
    out.extend(crc.to_le_bytes());
    text(out, chunk.compression);
    number(out, chunk.compressed_size);
}

/// The place of a chunk's head whose lengths are not known yet: no reader takes what follows for a whole chunk.
pub(super) fn open_chunk_head(out: &mut Vec<u8>) {
    out.push(op::CHUNK);
    numbers(out, [u64::MAX, 0, 0, u64::MAX]);
    out.extend(u32::MAX.to_le_bytes());
    text(out, "");
    number(out, u64::MAX);
}

/// Where a channel's messages are in the chunk before: log times and offsets.
pub(super) fn message_index(out: &mut Vec<u8>, channel: u16, messages: &[(u64, u64)]) {
    record(out, op::MESSAGE_INDEX, |out| {
        out.extend(channel.to_le_bytes());
        out.extend((messages.len() as u32 * 16).to_le_bytes());
        for &(time, offset) in messages {
            numbers(out, [time, offset]);
        }
    });
}

pub(super) fn metadata(out: &mut Vec<u8>, name: &str, about: &BTreeMap<String, String>) {
    record(out, op::METADATA, |out| {
        text(out, name);
        pairs(out, about);
    });
}

/// An attachment but for its data and the CRC behind them.
pub(super) fn attachment_head(out: &mut Vec<u8>, attachment: &AttachmentEntry) {
    out.push(op::ATTACHMENT);
    number(out, attachment.length() - RECORD_HEADER as u64);
    numbers(out, [attachment.log_time, attachment.create_time]);
    text(out, &attachment.name);
    text(out, &attachment.media_type);
    number(out, attachment.data_size);
}

pub(super) fn data_end(out: &mut Vec<u8>, crc: u32) {
    record(out, op::DATA_END, |out| out.extend(crc.to_le_bytes()));
}

/// How many there are of everything.
pub(super) struct Statistics<'a> {
    pub schemas: u16,
    pub channels: u32,
    pub attachments: u32,
    pub metadata: u32,
    pub chunks: u32,
    /// First and last log time.
    pub times: (u64, u64),
    /// Messages of each channel.
    pub messages: &'a BTreeMap<u16, u64>,
}

pub(super) fn statistics(out: &mut Vec<u8>, of: &Statistics) {
    record(out, op::STATISTICS, |out| {
        number(out, of.messages.values().sum());
        out.extend(of.schemas.to_le_bytes());
        for count in [of.channels, of.attachments, of.metadata, of.chunks] {
            out.extend(count.to_le_bytes());
        }
        numbers(out, [of.times.0, of.times.1]);
        by_channel(out, of.messages);
    });
}

fn by_channel(out: &mut Vec<u8>, numbers: &BTreeMap<u16, u64>) {
    out.extend((numbers.len() as u32 * 10).to_le_bytes());
    for (channel, of) in numbers {
        out.extend(channel.to_le_bytes());
        number(out, *of);
    }
}

pub(super) fn chunk_index(out: &mut Vec<u8>, chunk: &ChunkEntry) {
    record(out, op::CHUNK_INDEX, |out| {
        numbers(out, [chunk.times.0, chunk.times.1]);
        numbers(out, [chunk.offset, chunk.length()]);
        by_channel(out, &chunk.index_offsets);
        number(out, chunk.index_length);
        text(out, chunk.compression);
        numbers(out, [chunk.compressed_size, chunk.uncompressed_size]);
    });
}

pub(super) fn attachment_index(out: &mut Vec<u8>, attachment: &AttachmentEntry) {
    record(out, op::ATTACHMENT_INDEX, |out| {
        numbers(out, [attachment.offset, attachment.length()]);
        numbers(out, [attachment.log_time, attachment.create_time]);
        number(out, attachment.data_size);
        text(out, &attachment.name);
        text(out, &attachment.media_type);
    });
}

pub(super) fn metadata_index(out: &mut Vec<u8>, metadata: &MetadataEntry) {
    record(out, op::METADATA_INDEX, |out| {
        numbers(out, [metadata.offset, metadata.length]);
        text(out, &metadata.name);
    });
}

/// Where the summary's records of one kind are.
pub(super) fn summary_offset(out: &mut Vec<u8>, (opcode, start, length): (u8, u64, u64)) {
    record(out, op::SUMMARY_OFFSET, |out| {
        out.push(opcode);
        numbers(out, [start, length]);
    });
}

/// The footer but for the CRC that ends it.
pub(super) fn footer_head(out: &mut Vec<u8>, summary_start: u64, offsets_start: u64) {
    out.push(op::FOOTER);
    numbers(out, [20, summary_start, offsets_start]);
}
