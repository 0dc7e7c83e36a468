//! A recording from front to back, an entry at a time, as it is copied: messages with their channels, metadata,
//! attachments. What they mean is not asked.

use super::rewriting::io;
use super::walk::LARGEST_RECORD;
use super::writer::Writer;
use super::{Damage, Error};
use mcap::records::Record;
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;
use std::sync::Arc;

/// What a recording is made of.
pub(super) enum Entry<'a> {
    Message(mcap::Message<'a>),
    Metadata(mcap::records::Metadata),
    Attachment(mcap::Attachment<'a>),
}

impl Entry<'_> {
    /// Writes it as it is.
    pub(super) fn write_to(&self, writer: &mut Writer) -> Result<(), Error> {
        match self {
            Self::Message(message) => writer.copy(message),
            Self::Metadata(metadata) => writer.metadata(&metadata.name, &metadata.metadata),
            Self::Attachment(attachment) => writer.copy_attachment(attachment),
        }
    }

    /// Bytes of its data.
    pub(super) fn length(&self) -> usize {
        match self {
            Self::Message(message) => message.data.len(),
            Self::Metadata(_) => 0,
            Self::Attachment(attachment) => attachment.data.len(),
        }
    }

    /// Adds all of it to a digest; each part with its length, so that none runs into the next.
    pub(super) fn add_to(&self, digest: &mut Sha256) {
        let mut add = |bytes: &[u8]| {
            digest.update((bytes.len() as u64).to_le_bytes());
            digest.update(bytes);
        };
        match self {
            Self::Message(message) => {
                let channel = &message.channel;
                let schema = channel.schema.as_ref();
                add(b"message");
                add(channel.topic.as_bytes());
                add(channel.message_encoding.as_bytes());
                add(format!("{:?}", channel.metadata).as_bytes());
                add(schema.map_or("", |s| &s.name).as_bytes());
                add(schema.map_or("", |s| &s.encoding).as_bytes());
                add(schema.map_or(&[], |s| &s.data));
                add(&message.sequence.to_le_bytes());
                add(&message.log_time.to_le_bytes());
                add(&message.publish_time.to_le_bytes());
                add(&message.data);
            }
            Self::Metadata(metadata) => {
                add(b"metadata");
                add(metadata.name.as_bytes());
                add(format!("{:?}", metadata.metadata).as_bytes());
            }
            Self::Attachment(attachment) => {
                add(b"attachment");
                add(attachment.name.as_bytes());
                add(attachment.media_type.as_bytes());
                add(&attachment.log_time.to_le_bytes());
                add(&attachment.create_time.to_le_bytes());
                add(&attachment.data);
            }
        }
    }
}

/// Hands out the entries of the first `readable` bytes of a recording, in their order, while `each` says that it wants
/// more; whether it did to the end. Unless it `is_checked`, each chunk is before its first entry is handed out.
pub(super) fn each_entry(
    file: &mut File,
    path: &Path,
    (readable, is_checked): (u64, bool),
    mut each: impl FnMut(&Entry) -> Result<bool, Error>,
) -> Result<bool, Error> {
    file.seek(SeekFrom::Start(0)).map_err(io(path))?;
    let mut source = file.take(readable);
    let options = LinearReaderOptions::default()
        .with_skip_end_magic(true)
        .with_prevalidate_chunk_crcs(!is_checked)
        .with_record_length_limit(LARGEST_RECORD as usize);
    let mut reader = LinearReader::new_with_options(options);
    let mut known = Known::default();
    let unreadable = |cause: mcap::McapError| Error::Damaged {
        path: path.into(),
        damage: Damage {
            offset: 0,
            length: readable,
            what: cause.to_string(),
        },
    };
    while let Some(event) = reader.next_event() {
        match event.map_err(unreadable)? {
            LinearReadEvent::ReadRequest(length) => {
                let read = source.read(reader.insert(length)).map_err(io(path))?;
                reader.notify_read(read);
            }
            LinearReadEvent::Record { data, opcode } => {
                let record = mcap::parse_record(opcode, data).map_err(unreadable)?;
                if let Some(entry) = known.take(record)
                    && !each(&entry)?
                {
                    return Ok(false);
                }
            }
        }
    }
    Ok(true)
}

/// What the records so far have defined.
#[derive(Default)]
struct Known {
    schemas: BTreeMap<u16, Arc<mcap::Schema<'static>>>,
    channels: BTreeMap<u16, Arc<mcap::Channel<'static>>>,
}

impl Known {
    /// Remembers a definition; gives an entry that is none.
    fn take<'a>(&mut self, record: Record<'a>) -> Option<Entry<'a>> {
        match record {
            Record::Schema { header, data } => {
                let schema = mcap::Schema {
                    id: header.id,
                    name: header.name,
                    encoding: header.encoding,
                    data: data.into_owned().into(),
                };
                self.schemas.entry(header.id).or_insert(Arc::new(schema));
                None
            }
            Record::Channel(channel) => {
                let schema = self.schemas.get(&channel.schema_id).cloned();
                let described = mcap::Channel {
                    id: channel.id,
                    topic: channel.topic,
                    schema,
                    message_encoding: channel.message_encoding,
                    metadata: channel.metadata,
                };
                let id = channel.id;
                self.channels.entry(id).or_insert(Arc::new(described));
                None
            }
            // A message of no channel says nothing.
            Record::Message { header, data } => {
                let channel = self.channels.get(&header.channel_id)?.clone();
                Some(Entry::Message(mcap::Message {
                    channel,
                    sequence: header.sequence,
                    log_time: header.log_time,
                    publish_time: header.publish_time,
                    data,
                }))
            }
            Record::Metadata(metadata) => Some(Entry::Metadata(metadata)),
            Record::Attachment { header, data, .. } => Some(Entry::Attachment(mcap::Attachment {
                log_time: header.log_time,
                create_time: header.create_time,
                name: header.name,
                media_type: header.media_type,
                data,
            })),
            _ => None,
        }
    }
}
