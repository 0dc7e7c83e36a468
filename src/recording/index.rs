//! What a recording holds and where: its channels, chunks and messages, without the messages themselves.

use super::Damage;
use super::records::{Channel, Schema};
use std::collections::BTreeMap;

/// A chunk's place and what its header says of it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct ChunkInfo {
    pub record_offset: u64,
    pub data_offset: u64,
    pub compressed_size: u64,
    pub uncompressed_size: u64,
    pub uncompressed_crc: u32,
    pub compression: String,
}

/// Where a message is: in which chunk (or in none) and at which byte of it (or of the file).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct MessageRef {
    pub(super) log_time: u64,
    pub(super) chunk: u32,
    pub(super) offset: u64,
    pub(super) channel: u16,
}

impl MessageRef {
    /// Stands for no chunk; larger than any chunk's number.
    pub(super) const LOOSE: u32 = u32::MAX;

    /// When it was logged, which for a frame is when its exposure began.
    pub fn log_time(&self) -> crate::frame::Timestamp {
        crate::frame::Timestamp(self.log_time)
    }

    /// The same for all messages of one chunk, so that they can be read together.
    pub fn chunk(&self) -> u32 {
        self.chunk
    }
}

/// An attached file: its name and where it is.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct Attachment {
    /// Its name.
    pub name: String,
    /// Its media type.
    pub media_type: String,
    #[serde(skip)]
    pub(super) offset: u64,
    /// Bytes it takes in the recording, its name included.
    pub length: u64,
}

/// Everything that walking over a file finds.
#[derive(Debug, Default)]
pub(super) struct Index {
    pub profile: String,
    pub library: String,
    pub schemas: BTreeMap<u16, Schema>,
    pub channels: BTreeMap<u16, Channel>,
    pub chunks: Vec<ChunkInfo>,
    pub messages: Vec<MessageRef>,
    pub metadata: Vec<(String, BTreeMap<String, String>)>,
    pub attachments: Vec<Attachment>,
    /// What the statistics record counts, where there is one.
    pub message_count: Option<u64>,
    /// Whether the file is whole from its first magic bytes to its last.
    pub complete: bool,
    pub damage: Vec<Damage>,
}

impl Index {
    /// Most damaged places that are listed one by one.
    const MOST_DAMAGE: usize = 1000;

    pub(super) fn add_damage(&mut self, offset: u64, length: u64, what: impl Into<String>) {
        if self.damage.len() < Self::MOST_DAMAGE {
            self.damage.push(Damage {
                offset,
                length,
                what: what.into(),
            });
        }
    }

    /// Takes a schema; the first of a number counts, as for any reader that streams.
    pub(super) fn add_schema(&mut self, schema: Schema, offset: u64) {
        let name = super::error::shortened(&schema.name);
        let first = self
            .schemas
            .entry(schema.id)
            .or_insert_with(|| schema.clone());
        if *first != schema {
            let id = schema.id;
            self.add_damage(
                offset,
                0,
                format!("schema {id} ({name:?}) is defined twice"),
            );
        }
    }

    /// Takes a channel; the first of a number counts.
    pub(super) fn add_channel(&mut self, channel: Channel, offset: u64) {
        let topic = super::error::shortened(&channel.topic);
        let first = self
            .channels
            .entry(channel.id)
            .or_insert_with(|| channel.clone());
        if *first != channel {
            let id = channel.id;
            self.add_damage(
                offset,
                0,
                format!("channel {id} ({topic:?}) is defined twice"),
            );
        }
    }

    /// Whether the message indexes are all there and can be believed, so that no chunk has to be opened to
    /// know what is in it.
    pub(super) fn is_trustworthy(&self) -> bool {
        let known = |m: &MessageRef| self.channels.contains_key(&m.channel);
        self.complete
            && self.damage.is_empty()
            && self.message_count == Some(self.messages.len() as u64)
            && self.messages.iter().all(known)
    }
}
