//! The index of a recording: its definitions, and where its chunks and messages are, without the messages
//! themselves. It is filled from the records of a file, whether they are read, repaired or packed.

use super::records::{self, CHUNK_HEAD_AT_MOST, MESSAGE_HEADER, Malformed, Parsed, RECORD_HEADER};
use super::scan::{LARGEST_RECORD, Scan, ScanEvent, Span};
use super::source::Source;
use super::{Damage, Error, error::shortened};
use mcap::Schema;
use mcap::records::{
    AttachmentIndex, Channel, ChunkHeader, Header, MessageHeader, MessageIndex, MessageIndexEntry,
    Metadata, MetadataIndex, op,
};
use std::collections::BTreeMap;
use std::path::Path;

/// A chunk's place, what its head says of it, and where the indexes of its messages are.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Chunk {
    pub offset: u64,
    pub header: ChunkHeader,
    /// Where the message index of each channel is.
    pub index_offsets: BTreeMap<u16, u64>,
    pub index_length: u64,
}

impl Chunk {
    pub(super) fn new(offset: u64, header: ChunkHeader) -> Self {
        Self {
            offset,
            header,
            index_offsets: BTreeMap::new(),
            index_length: 0,
        }
    }

    /// Bytes of its record before its data.
    pub(super) fn head_length(&self) -> u64 {
        records::chunk_head_length(&self.header)
    }

    /// Bytes that it takes, packed or not.
    pub(super) fn size(&self) -> u64 {
        self.header
            .uncompressed_size
            .max(self.header.compressed_size)
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
    /// Bytes it takes in the recording, its name included.
    pub length: u64,
    #[serde(skip)]
    pub(super) entry: AttachmentIndex,
}

/// Everything that the records of a file say.
#[derive(Debug, Default)]
pub(super) struct Index {
    pub header: Option<Header>,
    pub schemas: BTreeMap<u16, Schema<'static>>,
    pub channels: BTreeMap<u16, Channel>,
    pub chunks: Vec<Chunk>,
    pub messages: Vec<MessageRef>,
    pub metadata: Vec<(String, BTreeMap<String, String>)>,
    pub metadata_entries: Vec<MetadataIndex>,
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
    /// Bytes of all definitions.
    definitions: usize,
}

impl Index {
    /// Most damaged places that are listed one by one.
    const MOST_DAMAGE: usize = 1000;
    /// Bytes of schemas and channels that are remembered at most. Ours have some ten thousand.
    const MOST_DEFINITIONS: usize = 16 << 20;

    /// For a file of this length. A message of ours takes more than 64 bytes of a file; the many that a small
    /// packed file can claim to hold would take memory for nothing.
    pub(super) fn new(length: u64) -> Self {
        let most = 500_000u64.saturating_add(length / 64);
        Self {
            most_messages: usize::try_from(most).unwrap_or(usize::MAX),
            ..Self::default()
        }
    }

    /// Everything that is in a file, its chunks unopened.
    pub(super) fn of(source: &Source) -> Result<Self, Error> {
        let mut index = Self::new(source.length);
        let mut scan = Scan::begin(source)?;
        while let Some(event) = scan.next()? {
            match event {
                ScanEvent::Damage(damage) => index.add_damage(damage),
                ScanEvent::Record(span) => {
                    let body = scan.head(&span, most_of(span.opcode))?;
                    if index.take(&span, body).is_err() {
                        index.add_damage(unparsable(&span));
                    }
                }
            }
        }
        index.complete = scan.is_complete();
        Ok(index)
    }

    /// Takes a record, of whose body there is what [`Self::of`] reads of it, or more.
    pub(super) fn take(&mut self, span: &Span, body: &[u8]) -> Parsed<()> {
        let offset = span.offset();
        match span.opcode {
            op::HEADER => self.header = Some(records::header(body)?),
            op::SCHEMA => self.add_schema(records::schema(body)?, offset),
            op::CHANNEL => self.add_channel(records::channel(body)?, offset),
            op::CHUNK => {
                let header = records::chunk(body, span.length)?;
                self.chunks.push(Chunk::new(offset, header));
            }
            op::MESSAGE => self.add_message(MessageRef::LOOSE, offset, records::message(body)?),
            op::MESSAGE_INDEX => self.take_message_index(span, &records::message_index(body)?)?,
            op::METADATA => {
                let length = span.end() - offset;
                self.add_metadata(offset, length, records::metadata(body)?);
            }
            op::ATTACHMENT => self.take_attachment(span, body)?,
            op::STATISTICS => self.message_count = Some(records::message_count(body)?),
            _ => {}
        }
        Ok(())
    }

    /// Takes the messages of the chunk before.
    fn take_message_index(&mut self, span: &Span, index: &MessageIndex) -> Parsed<()> {
        let number = self.chunks.len();
        let chunk = self.chunks.last_mut().ok_or(Malformed)?;
        let smallest = (RECORD_HEADER + MESSAGE_HEADER) as u64;
        let size = chunk.header.uncompressed_size;
        let fits = |offset: u64| offset.saturating_add(smallest) <= size;
        if !index.records.iter().all(|entry| fits(entry.offset)) {
            return Err(Malformed);
        }
        let channel = index.channel_id;
        chunk.index_offsets.insert(channel, span.offset());
        chunk.index_length += span.end() - span.offset();
        for entry in &index.records {
            self.add_reference(MessageRef {
                log_time: entry.log_time,
                chunk: number as u32 - 1,
                offset: entry.offset,
                channel,
            });
        }
        Ok(())
    }

    /// Adds a metadata record of this place and length.
    pub(super) fn add_metadata(&mut self, offset: u64, length: u64, metadata: Metadata) {
        self.metadata_entries.push(MetadataIndex {
            offset,
            length,
            name: metadata.name.clone(),
        });
        self.metadata.push((metadata.name, metadata.metadata));
    }

    fn take_attachment(&mut self, span: &Span, body: &[u8]) -> Parsed<()> {
        let (header, data_size) = records::attachment_head(body)?;
        self.attachments.push(Attachment {
            name: shortened(&header.name),
            media_type: shortened(&header.media_type),
            length: span.length,
            entry: AttachmentIndex {
                offset: span.offset(),
                length: span.end() - span.offset(),
                log_time: header.log_time,
                create_time: header.create_time,
                data_size,
                name: header.name,
                media_type: header.media_type,
            },
        });
        Ok(())
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
            self.add_reference(message);
        }
        for damage in part.damage {
            self.add_damage(Damage { offset, ..damage });
        }
        self.too_many |= part.too_many;
    }

    /// Adds a message that is in this chunk, or in none.
    pub(super) fn add_message(&mut self, chunk: u32, offset: u64, header: MessageHeader) {
        self.add_reference(MessageRef {
            log_time: header.log_time,
            chunk,
            offset,
            channel: header.channel_id,
        });
    }

    fn add_reference(&mut self, message: MessageRef) {
        if self.messages.len() < self.most_messages {
            self.messages.push(message);
        } else {
            self.too_many = true;
        }
    }

    /// Refuses a file with more messages than are remembered.
    pub(super) fn check_number(&self, path: &Path) -> Result<(), Error> {
        match self.too_many_messages() {
            Some(damage) => Err(Error::Damaged {
                path: path.into(),
                damage,
            }),
            None => Ok(()),
        }
    }

    /// Tells of the messages that were not remembered, if there were any.
    pub(super) fn tell_too_many(&mut self) {
        if let Some(damage) = self.too_many_messages() {
            self.add_damage(damage);
        }
    }

    fn too_many_messages(&self) -> Option<Damage> {
        let most = self.most_messages;
        self.too_many.then(|| Damage {
            offset: 0,
            length: 0,
            what: format!("more than {most} messages, too many for a file of this length"),
        })
    }

    /// Refuses a recording of another format, by the metadata record that names it.
    pub(super) fn check_format(&self, path: &Path) -> Result<(), Error> {
        for (name, pairs) in &self.metadata {
            if name == "scand"
                && let Some(format) = pairs.get("format")
                && format != "1"
            {
                return Err(Error::UnknownFormat {
                    path: path.into(),
                    found: shortened(format),
                });
            }
        }
        Ok(())
    }

    /// First and last log time of its messages; zeros where there is none.
    pub(super) fn times(&self) -> (u64, u64) {
        let times = || self.messages.iter().map(|message| message.log_time);
        (times().min().unwrap_or(0), times().max().unwrap_or(0))
    }

    /// Where the messages of each channel are.
    pub(super) fn message_indexes(&self) -> Vec<MessageIndex> {
        let mut entries: BTreeMap<u16, Vec<MessageIndexEntry>> = BTreeMap::new();
        for message in &self.messages {
            let entry = MessageIndexEntry {
                log_time: message.log_time,
                offset: message.offset,
            };
            entries.entry(message.channel).or_default().push(entry);
        }
        let index = |(channel_id, records)| MessageIndex {
            channel_id,
            records,
        };
        entries.into_iter().map(index).collect()
    }

    pub(super) fn add_damage(&mut self, damage: Damage) {
        if self.damage.len() < Self::MOST_DAMAGE {
            self.damage.push(damage);
        }
    }

    /// Adds damage that costs no bytes.
    pub(super) fn add_note(&mut self, offset: u64, what: String) {
        self.add_damage(Damage {
            offset,
            length: 0,
            what,
        });
    }

    /// Takes a schema; the first of a number counts, as for any reader that streams.
    pub(super) fn add_schema(&mut self, schema: Schema<'static>, offset: u64) {
        let (id, name) = (schema.id, shortened(&schema.name));
        match self.schemas.get(&id) {
            Some(first) if *first == schema => {}
            Some(_) => self.add_note(offset, format!("schema {id} ({name:?}) is defined twice")),
            None => {
                let size = schema.name.len() + schema.encoding.len() + schema.data.len();
                if self.has_room(size, offset) {
                    self.schemas.insert(id, schema);
                }
            }
        }
    }

    /// Takes a channel; the first of a number counts.
    pub(super) fn add_channel(&mut self, channel: Channel, offset: u64) {
        let (id, topic) = (channel.id, shortened(&channel.topic));
        match self.channels.get(&id) {
            Some(first) if *first == channel => {}
            Some(_) => self.add_note(offset, format!("channel {id} ({topic:?}) is defined twice")),
            None => {
                let pairs = channel.metadata.iter().map(|(k, v)| k.len() + v.len());
                let names = channel.topic.len() + channel.message_encoding.len();
                if self.has_room(names + pairs.sum::<usize>(), offset) {
                    self.channels.insert(id, channel);
                }
            }
        }
    }

    /// Whether a definition of this size is remembered. A file's definitions could fill the memory otherwise.
    fn has_room(&mut self, size: usize, offset: u64) -> bool {
        let most = Self::MOST_DEFINITIONS;
        let fits = self.definitions + size <= most;
        if fits {
            self.definitions += size;
        } else {
            let what = format!("schemas and channels of more than {most} bytes");
            self.add_note(offset, what);
        }
        fits
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

/// How much of a record's body is read: of those with data, what opens it.
pub(super) fn most_of(opcode: u8) -> u64 {
    match opcode {
        op::CHUNK => CHUNK_HEAD_AT_MOST as u64,
        op::MESSAGE => MESSAGE_HEADER as u64,
        op::ATTACHMENT => 64 << 10,
        op::HEADER
        | op::SCHEMA
        | op::CHANNEL
        | op::MESSAGE_INDEX
        | op::METADATA
        | op::STATISTICS => LARGEST_RECORD,
        _ => 0,
    }
}

fn unparsable(span: &Span) -> Damage {
    let opcode = span.opcode;
    Damage {
        offset: span.offset(),
        length: span.end() - span.offset(),
        what: format!("the record of opcode {opcode:#04x} cannot be parsed"),
    }
}
