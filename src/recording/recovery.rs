//! What a crash or a power cut left behind, made a complete recording: all that can be read of `NAME.mcap.part` goes
//! into `NAME.mcap`, what cannot be read into `NAME.mcap.tail`. Nothing is removed before both are on the disk.

use super::writer::{Compression, PART, Writer, sync_folder};
use super::{Damage, Error, Recording};
use mcap::records::Record;
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use std::collections::BTreeMap;
use std::fs::{File, TryLockError};
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Largest record that is read: a chunk may hold a whole capture.
const LARGEST_RECORD: usize = 256 << 20;

/// What became of a recording that was cut off.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Recovered {
    /// The complete recording.
    pub path: PathBuf,
    /// Its messages.
    pub messages: u64,
    /// Where what could not be read is kept, and its bytes; `None` where all could be read.
    pub tail: Option<(PathBuf, u64)>,
}

/// The recordings in a folder that were not completed, in the order of their names.
///
/// # Errors
/// If the folder cannot be read.
pub fn unfinished(folder: &Path) -> Result<Vec<PathBuf>, Error> {
    let entries = std::fs::read_dir(folder).map_err(io(folder))?;
    let mut parts = Vec::new();
    for entry in entries {
        let path = entry.map_err(io(folder))?.path();
        if finished_name(&path).is_some() {
            parts.push(path);
        }
    }
    parts.sort();
    Ok(parts)
}

/// Completes a recording that was cut off. It is read from front to back up to the first damage; where there is
/// no room for a copy, or anything else fails, the `.part` stays as it is.
///
/// # Errors
/// If the file is none that was cut off, is being written, is no recording, or another one has its name; or the copy
/// cannot be written.
pub fn recover(part: &Path) -> Result<Recovered, Error> {
    let path = finished_name(part).ok_or_else(|| Error::NotUnfinished { path: part.into() })?;
    let mut file = File::open(part).map_err(io(part))?;
    lock(&file, part)?;
    let recording = Recording::open_cut_off(part)?;
    let damage = recording.verify()?;
    let length = recording.file_length();
    // Damage of no length, such as a name defined twice, makes nothing unreadable.
    let first = damage.iter().find(|d| d.length > 0);
    let readable = first.map_or(length, |d| d.offset);
    let (_, program) = recording.written_by();
    let tail = (readable < length).then(|| (with_ending(&path, "tail"), length - readable));

    let staged = with_ending(&path, "recovering");
    remove_stale(&staged)?;
    let mut writer = Writer::create_at(&path, &staged, program, Compression::None)?;
    let put_into_place = || {
        let messages = copy(&mut file, part, readable, &mut writer)?;
        if path.try_exists().map_err(io(&path))? {
            check_equal(&path, messages)?;
            return Ok(messages);
        }
        if let Some((tail, _)) = &tail {
            keep_tail(&mut file, part, readable, tail)?;
        }
        writer.finish()?;
        Ok(messages)
    };
    let done = put_into_place();
    // What was begun and not put into place is of no use, and may be what filled the disk.
    let removed = remove_stale(&staged);
    let messages = done?;
    removed?;
    std::fs::remove_file(part)
        .and_then(|()| sync_folder(part))
        .map_err(io(part))?;
    Ok(Recovered {
        path,
        messages,
        tail,
    })
}

/// A crash between the recording's getting its name and the removal of its `.part` leaves both: then the one under its
/// name holds it all, and there is nothing to do. Another recording is never touched.
fn check_equal(path: &Path, messages: u64) -> Result<(), Error> {
    let found = Recording::open(path)?;
    let count: u64 = found.channels().iter().map(|c| c.messages).sum();
    if count == messages && found.verify()?.is_empty() {
        return Ok(());
    }
    Err(io(path)(std::io::ErrorKind::AlreadyExists.into()))
}

/// A recording that is being written is locked.
fn lock(file: &File, part: &Path) -> Result<(), Error> {
    match file.try_lock() {
        Ok(()) => Ok(()),
        Err(TryLockError::WouldBlock) => Err(Error::BeingWritten { path: part.into() }),
        Err(TryLockError::Error(cause)) => Err(io(part)(cause)),
    }
}

/// Copies all records of the first `readable` bytes; how many messages there were.
fn copy(file: &mut File, part: &Path, readable: u64, writer: &mut Writer) -> Result<u64, Error> {
    file.seek(SeekFrom::Start(0)).map_err(io(part))?;
    let mut source = file.take(readable);
    let options = LinearReaderOptions::default()
        .with_skip_end_magic(true)
        .with_prevalidate_chunk_crcs(true)
        .with_record_length_limit(LARGEST_RECORD);
    let mut reader = LinearReader::new_with_options(options);
    let mut known = Known::default();
    let unreadable = |cause: mcap::McapError| Error::Damaged {
        path: part.into(),
        damage: Damage {
            offset: 0,
            length: readable,
            what: cause.to_string(),
        },
    };
    while let Some(event) = reader.next_event() {
        match event.map_err(unreadable)? {
            LinearReadEvent::ReadRequest(length) => {
                let read = source.read(reader.insert(length)).map_err(io(part))?;
                reader.notify_read(read);
            }
            LinearReadEvent::Record { data, opcode } => {
                let record = mcap::parse_record(opcode, data).map_err(unreadable)?;
                known.take(record, writer)?;
            }
        }
    }
    Ok(known.messages)
}

/// What the records so far have defined.
#[derive(Default)]
struct Known {
    schemas: BTreeMap<u16, Arc<mcap::Schema<'static>>>,
    channels: BTreeMap<u16, Arc<mcap::Channel<'static>>>,
    messages: u64,
}

impl Known {
    fn take(&mut self, record: Record<'_>, writer: &mut Writer) -> Result<(), Error> {
        match record {
            Record::Schema { header, data } => {
                let schema = mcap::Schema {
                    id: header.id,
                    name: header.name,
                    encoding: header.encoding,
                    data: data.into_owned().into(),
                };
                self.schemas.entry(header.id).or_insert(Arc::new(schema));
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
                self.channels
                    .entry(channel.id)
                    .or_insert(Arc::new(described));
            }
            Record::Message { header, data } => {
                // A message of no channel says nothing.
                if let Some(channel) = self.channels.get(&header.channel_id) {
                    writer.copy(&mcap::Message {
                        channel: channel.clone(),
                        sequence: header.sequence,
                        log_time: header.log_time,
                        publish_time: header.publish_time,
                        data,
                    })?;
                    self.messages += 1;
                }
            }
            // The writer has written its own, which is the same.
            Record::Metadata(metadata) if metadata.name == "scand" => {}
            Record::Metadata(metadata) => writer.metadata(&metadata.name, &metadata.metadata)?,
            Record::Attachment { header, data, .. } => {
                writer.copy_attachment(&mcap::Attachment {
                    log_time: header.log_time,
                    create_time: header.create_time,
                    name: header.name,
                    media_type: header.media_type,
                    data,
                })?
            }
            _ => {}
        }
        Ok(())
    }
}

/// Copies what could not be read beside the recording, durably.
fn keep_tail(file: &mut File, part: &Path, from: u64, tail: &Path) -> Result<(), Error> {
    let staged = with_ending(tail, "recovering");
    remove_stale(&staged)?;
    let mut copied = || {
        file.seek(SeekFrom::Start(from))?;
        let mut copy = File::create_new(&staged)?;
        std::io::copy(file, &mut copy)?;
        copy.sync_all()?;
        std::fs::rename(&staged, tail)?;
        sync_folder(tail)
    };
    copied().map_err(io(part))
}

/// Removes what a recovery began, if it is there.
fn remove_stale(path: &Path) -> Result<(), Error> {
    match std::fs::remove_file(path) {
        Err(cause) if cause.kind() != std::io::ErrorKind::NotFound => Err(io(path)(cause)),
        _ => Ok(()),
    }
}

/// The name that a recording gets when it is complete, of one that is not: `NAME.mcap` of `NAME.mcap.part`.
pub fn finished_name(part: &Path) -> Option<PathBuf> {
    let name = part.file_name()?.to_str()?.strip_suffix(PART)?;
    name.ends_with(".mcap").then(|| part.with_file_name(name))
}

/// The name that a recording has until it is complete: `NAME.mcap.part` of `NAME.mcap`.
pub fn unfinished_name(path: &Path) -> PathBuf {
    super::writer::part_of(path)
}

fn with_ending(path: &Path, ending: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".");
    name.push(ending);
    name.into()
}

fn io(path: &Path) -> impl Fn(std::io::Error) -> Error {
    let path = path.to_owned();
    move |cause| Error::Io {
        path: path.clone(),
        cause,
    }
}
