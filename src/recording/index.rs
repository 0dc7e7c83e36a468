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

impl ChunkInfo {
    /// Bytes that it takes, packed or not.
    pub(super) fn size(&self) -> u64 {
        self.uncompressed_size.max(self.compressed_size)
    }
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
    /// Messages that are remembered at most; see [`Self::new`].
    most_messages: usize,
    /// Whether there were more.
    too_many: bool,
}

impl Index {
    /// Most damaged places that are listed one by one.
    const MOST_DAMAGE: usize = 1000;

    /// For a file of this length. A message of ours takes more than 64 bytes of a file; the many that a small
    /// packed file can claim to hold would take memory for nothing.
    pub(super) fn new(length: u64) -> Self {
        let most = 500_000u64.saturating_add(length / 64);
        Self {
            most_messages: usize::try_from(most).unwrap_or(usize::MAX),
            ..Self::default()
        }
    }

    /// An empty index, to be added to this one.
    pub(super) fn part(&self) -> Self {
        Self {
            most_messages: self.most_messages.saturating_sub(self.messages.len()),
            ..Self::default()
        }
    }

    /// Adds what was found in one chunk.
    pub(super) fn absorb(&mut self, part: Self, offset: u64) {
        for schema in part.schemas.into_values() {
            self.add_schema(schema, offset);
        }
        for channel in part.channels.into_values() {
            self.add_channel(channel, offset);
        }
        for message in part.messages {
            self.add_message(message);
        }
        for Damage { length, what, .. } in part.damage {
            self.add_damage(offset, length, what);
        }
        self.too_many |= part.too_many;
    }

    pub(super) fn add_message(&mut self, message: MessageRef) {
        if self.messages.len() < self.most_messages {
            self.messages.push(message);
        } else {
            self.too_many = true;
        }
    }

    /// Tells of the messages that were not remembered, if there were any.
    pub(super) fn tell_too_many(&mut self) {
        if std::mem::take(&mut self.too_many) {
            let most = self.most_messages;
            let what = format!("more than {most} messages, too many for a file of this length");
            self.add_damage(0, 0, what);
        }
    }

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
            && !self.too_many
            && self.message_count == Some(self.messages.len() as u64)
            && self.messages.iter().all(known)
    }
}
