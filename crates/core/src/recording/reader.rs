//! Opens a recording and reads its messages. It is indexed first; a message's chunk is read when the message is
//! needed, so a recording may be larger than memory.

use super::chunk::{self, Budget};
use super::index::{Attachment, Chunk, Index, MessageRef};
use super::records::{self, MESSAGE_HEADER, RECORD_HEADER};
use super::scan::LARGEST_RECORD;
use super::source::Source;
use super::{Damage, Error, MessageError, Topic};
use crate::calibration::{Board, CalibrationRecord};
use crate::frame::Timestamp;
use crate::words::count;
use bytes::Bytes;
use mcap::records::Channel;
use parking_lot::Mutex;
use rayon::prelude::*;
use std::collections::{BTreeMap, VecDeque};
use std::fs::File;
use std::path::Path;

/// A channel as a recording has it.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct ChannelInfo {
    /// Its topic's name.
    pub topic: String,
    /// Its messages' schema.
    pub schema: String,
    /// `protobuf` or `json`.
    pub encoding: String,
    /// How many messages it has.
    pub messages: u64,
    /// Whether it is a topic of the format.
    pub known: bool,
}

/// An open recording.
#[derive(Debug)]
pub struct Recording {
    source: Source,
    index: Index,
    /// Messages of each topic in the order of their log times.
    topics: BTreeMap<Topic, Vec<MessageRef>>,
    cache: Mutex<ChunkCache>,
    /// Every chunk was read and checked to find what is in the file.
    is_checked: bool,
}

impl Recording {
    /// Opens a file and indexes its contents. Damage is not an error as long as anything can be read: see
    /// [`Self::damage`]. A file that is being written is indexed as far as it is written now.
    ///
    /// # Errors
    /// If it cannot be read, is not an MCAP file, or is a recording of another format.
    pub fn open(path: &Path) -> Result<Self, Error> {
        Self::of(Source::open(path)?)
    }

    /// As [`Self::open`], of a file that is open already, for a process that can open none. `path` is the file's name:
    /// messages have it, and its ending says whether the file may be unfinished.
    ///
    /// # Errors
    /// As for [`Self::open`].
    pub fn of_file(file: File, path: &Path) -> Result<Self, Error> {
        Self::of(Source::of_file(file, path)?)
    }

    fn of(source: Source) -> Result<Self, Error> {
        let mut index = Index::of(&source)?;
        // What is too much to unpack is left out here, and so wherever the recording is read.
        let is_checked = !index.is_trustworthy() || has_bombs(&source, &index.chunks);
        if is_checked {
            scan_chunks(&source, &mut index)?;
        }
        index.tell_too_many();
        index.check_format(&source.path)?;
        let topics = sort_by_topic(&mut index);
        Ok(Self {
            source,
            index,
            topics,
            cache: Mutex::default(),
            is_checked,
        })
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.source.path
    }

    pub(super) fn source(&self) -> &Source {
        &self.source
    }

    /// Its length in bytes.
    pub fn file_length(&self) -> u64 {
        self.source.length
    }

    /// Profile and library that the file says wrote it.
    pub fn written_by(&self) -> (&str, &str) {
        let header = self.index.header.as_ref();
        header.map_or(("", ""), |h| (&h.profile, &h.library))
    }

    /// Whether the file ends before its last bytes, as a copy does that was interrupted. One that is being written
    /// does not.
    ///
    /// # Errors
    /// If it cannot be read.
    pub fn is_cut_off(&self) -> Result<bool, Error> {
        if self.source.being_written || self.index.complete {
            return Ok(false);
        }
        let end = mcap::MAGIC.len();
        // The magic bytes at the begin are those at the end only if there is nothing else.
        let last = self.source.length.saturating_sub(end as u64);
        Ok(last == 0 || self.source.read(last, end)? != mcap::MAGIC)
    }

    /// What could not be read, as far as opening the file showed. Contents of chunks are checked when they
    /// are read: [`Self::verify`] reads them all.
    pub fn damage(&self) -> &[Damage] {
        &self.index.damage
    }

    /// Metadata records: name and pairs.
    pub fn metadata(&self) -> &[(String, BTreeMap<String, String>)] {
        &self.index.metadata
    }

    /// A pair of the session's metadata, such as `operator`; of several records the last that has it.
    pub fn session_pair(&self, key: &str) -> Option<&str> {
        let records = self.index.metadata.iter().rev();
        let sessions = records.filter(|(name, _)| name == "session");
        sessions
            .filter_map(|(_, pairs)| pairs.get(key))
            .next()
            .map(String::as_str)
    }

    /// The board that a calibration session's metadata names: the last record `board`, if there is one.
    ///
    /// # Errors
    /// If it cannot be a board; the message names the pair.
    pub fn board(&self) -> Result<Option<Board>, Error> {
        let mut records = self.index.metadata.iter().rev();
        let Some((_, pairs)) = records.find(|(name, _)| name == "board") else {
            return Ok(None);
        };
        let board = Board::from_pairs(pairs).map_err(|cause| Error::Metadata {
            path: self.source.path.clone(),
            name: "board",
            cause,
        })?;
        Ok(Some(board))
    }

    /// What the recording says about its calibration: the last metadata record `calibration`. `None` if it has no such
    /// record.
    ///
    /// # Errors
    /// If the record's verdict is not one that a calibration can have.
    pub fn calibration_record(&self) -> Result<Option<CalibrationRecord>, Error> {
        let mut records = self.index.metadata.iter().rev();
        let Some((_, pairs)) = records.find(|(name, _)| name == "calibration") else {
            return Ok(None);
        };
        CalibrationRecord::from_pairs(pairs).map_err(|cause| Error::Metadata {
            path: self.source.path.clone(),
            name: "calibration",
            cause,
        })
    }

    /// Attached files.
    pub fn attachments(&self) -> &[Attachment] {
        &self.index.attachments
    }

    /// Reads an attached file.
    ///
    /// # Errors
    /// If it is larger than 256 MiB, damaged or cannot be read.
    pub fn attachment(&self, attachment: &Attachment) -> Result<Vec<u8>, Error> {
        let (offset, length) = (attachment.entry.offset, attachment.length);
        let damaged = |what: &str| self.damaged(offset, length, what.into());
        if length > LARGEST_RECORD {
            return Err(damaged("the attachment is larger than 256 MiB"));
        }
        let body = offset + RECORD_HEADER as u64;
        let body = self.source.read(body, length as usize)?;
        match records::attachment(&body) {
            Ok((_, data)) => Ok(data.to_vec()),
            Err(_) => Err(damaged("the attachment's lengths or CRC are wrong")),
        }
    }

    /// All channels, in the order of their topics.
    pub fn channels(&self) -> Vec<ChannelInfo> {
        let mut counts: BTreeMap<u16, u64> = BTreeMap::new();
        for message in &self.index.messages {
            *counts.entry(message.channel).or_default() += 1;
        }
        let mut channels: Vec<_> = self.index.channels.values().collect();
        channels.sort_by_key(|c| (&c.topic, c.id));
        let info = |c: &Channel| ChannelInfo {
            topic: c.topic.clone(),
            schema: self.schema_of(c.id).into(),
            encoding: c.message_encoding.clone(),
            messages: counts.get(&c.id).copied().unwrap_or(0),
            known: Topic::parse(&c.topic).is_some(),
        };
        channels.into_iter().map(info).collect()
    }

    /// Topics that have messages.
    pub fn topics(&self) -> impl Iterator<Item = &Topic> {
        self.topics.keys()
    }

    /// A topic's messages in the order of their log times.
    pub fn messages(&self, topic: &Topic) -> &[MessageRef] {
        self.topics.get(topic).map_or(&[], Vec::as_slice)
    }

    /// A topic's messages with a log time at or before `time`, oldest first.
    pub fn messages_until(&self, topic: &Topic, time: Timestamp) -> &[MessageRef] {
        let messages = self.messages(topic);
        &messages[..messages.partition_point(|m| m.log_time <= time.0)]
    }

    /// A topic's messages with exactly this log time.
    pub fn messages_at(&self, topic: &Topic, time: Timestamp) -> &[MessageRef] {
        let until = self.messages_until(topic, time);
        &until[until.partition_point(|m| m.log_time < time.0)..]
    }

    /// A message's bytes and the name of its schema.
    ///
    /// # Errors
    /// If its chunk is damaged, or its schema is not one of its topic's.
    pub fn read(&self, topic: &Topic, message: &MessageRef) -> Result<(Bytes, &str), Error> {
        let schema = self.checked_schema(topic, message.channel)?;
        if message.chunk == MessageRef::LOOSE {
            return Ok((self.read_loose(message)?, schema));
        }
        let bytes = self.chunk(message.chunk)?;
        match chunk::message_data(&bytes, message.offset as usize, message) {
            Some(data) => Ok((data, schema)),
            None => {
                let chunk = &self.index.chunks[message.chunk as usize];
                let what = format!(
                    "the chunk's index lists a message at its byte {}, but there is none",
                    message.offset
                );
                Err(self.damaged(chunk.offset, chunk.header.compressed_size, what))
            }
        }
    }

    /// Reads every message of a topic with `read`, and returns what it made of each in the order of their log times.
    /// They are read in the order in which they lie in the file: in that of times, chunks that take turns would be
    /// unpacked again for each message.
    pub fn read_each<T>(
        &self,
        topic: &Topic,
        read: impl Fn(&MessageRef) -> Result<T, Error>,
    ) -> Vec<(MessageRef, Result<T, Error>)> {
        let messages = self.messages(topic).iter().copied();
        let mut messages: Vec<(usize, MessageRef)> = messages.enumerate().collect();
        messages.sort_by_key(|(_, message)| (message.chunk, message.offset));
        let mut made: Vec<_> = messages
            .into_iter()
            .map(|(place, message)| (place, message, read(&message)))
            .collect();
        made.sort_by_key(|(place, ..)| *place);
        made.into_iter()
            .map(|(_, message, result)| (message, result))
            .collect()
    }

    /// Whether all of its chunks are packed.
    pub fn is_packed(&self) -> bool {
        let chunks = &self.index.chunks;
        let is_packed = |chunk: &Chunk| !chunk.header.compression.is_empty();
        chunks.iter().all(is_packed)
    }

    /// Reads and checks every chunk.
    ///
    /// # Errors
    /// If the file cannot be read at all.
    pub fn verify(&self) -> Result<Vec<Damage>, Error> {
        let check = |chunk: &Chunk| match chunk::unpack(&self.source, chunk) {
            Err(Error::Damaged { damage, .. }) => Ok(Some(damage)),
            Err(error) => Err(error),
            Ok(_) => Ok(None),
        };
        let mut damage: Vec<Damage> = self.index.damage.clone();
        if !self.is_checked {
            let found = each_chunk(&self.index.chunks, 0, |_, chunk| check(chunk))?;
            damage.extend(found.into_iter().flatten());
        }
        damage.sort_by_key(|d| d.offset);
        damage.dedup();
        Ok(damage)
    }

    /// An error about a message, with everything that finds it.
    pub(super) fn message_error(
        &self,
        topic: &Topic,
        message: &MessageRef,
        problem: impl Into<MessageError>,
    ) -> Error {
        Error::Message {
            path: self.source.path.clone(),
            topic: topic.to_string(),
            log_time: message.log_time(),
            problem: problem.into(),
        }
    }

    fn damaged(&self, offset: u64, length: u64, what: String) -> Error {
        Error::Damaged {
            path: self.source.path.clone(),
            damage: Damage {
                offset,
                length,
                what,
            },
        }
    }

    /// The schema of a message, as the file has it.
    pub(super) fn schema_record(&self, message: &MessageRef) -> mcap::Schema<'static> {
        let channel = self.index.channels.get(&message.channel);
        let schema = channel.and_then(|c| self.index.schemas.get(&c.schema_id));
        schema.cloned().unwrap_or_else(|| mcap::Schema {
            id: 0,
            name: String::new(),
            encoding: String::new(),
            data: Default::default(),
        })
    }

    fn schema_of(&self, channel: u16) -> &str {
        let id = self.index.channels.get(&channel).map_or(0, |c| c.schema_id);
        self.index.schemas.get(&id).map_or("", |s| &s.name)
    }

    fn checked_schema(&self, topic: &Topic, channel: u16) -> Result<&str, Error> {
        let found = self.schema_of(channel);
        let encoding = self
            .index
            .channels
            .get(&channel)
            .map_or("", |c| &c.message_encoding);
        let expected = topic.schemas();
        let wanted = if expected[0].starts_with("scand.") {
            "json"
        } else {
            "protobuf"
        };
        if expected.contains(&found) && encoding == wanted {
            return Ok(found);
        }
        Err(Error::Schema {
            path: self.source.path.clone(),
            topic: topic.to_string(),
            found: super::error::shortened(found),
            encoding: super::error::shortened(encoding),
            expected: expected.join(" or ") + " in " + wanted,
        })
    }

    fn read_loose(&self, message: &MessageRef) -> Result<Bytes, Error> {
        let header = self.source.read(message.offset, RECORD_HEADER)?;
        let length = match records::record_header(&header) {
            Ok((_, length)) if length <= LARGEST_RECORD => length as usize,
            _ => 0,
        };
        let bytes: Bytes = self
            .source
            .read(message.offset, RECORD_HEADER + length)?
            .into();
        chunk::message_data(&bytes, 0, message).ok_or_else(|| {
            let length = (RECORD_HEADER + MESSAGE_HEADER) as u64;
            self.damaged(
                message.offset,
                length,
                "the file no longer has this message".into(),
            )
        })
    }

    /// An unpacked chunk, from the cache if it is there.
    fn chunk(&self, number: u32) -> Result<Bytes, Error> {
        let known = self.cache.lock().get(number);
        let unpacked = match known {
            Some(unpacked) => unpacked,
            None => {
                let unpacked = self.unpack(&self.index.chunks[number as usize])?;
                self.cache.lock().put(number, unpacked.clone());
                unpacked
            }
        };
        unpacked.map_err(|damage| Error::Damaged {
            path: self.source.path.clone(),
            damage,
        })
    }

    fn unpack(&self, chunk: &Chunk) -> Result<Unpacked, Error> {
        // Before there are both: others that are in memory make room for it.
        let size = chunk.header.uncompressed_size.min(LARGEST_RECORD);
        self.cache.lock().make_room(size as usize);
        match chunk::unpack(&self.source, chunk) {
            Ok(bytes) => Ok(Ok(bytes)),
            Err(Error::Damaged { damage, .. }) => Ok(Err(damage)),
            Err(error) => Err(error),
        }
    }
}

/// What is in a chunk, or what is wrong with it.
type Unpacked = Result<Bytes, Damage>;

/// The chunks that were unpacked last: some megabytes of them, or one that is larger. A small file may have very many
/// messages in one chunk, so that it must not be unpacked for each of them; nor may one that is damaged.
#[derive(Debug, Default)]
struct ChunkCache {
    chunks: VecDeque<(u32, Bytes)>,
    damaged: BTreeMap<u32, Damage>,
}

impl ChunkCache {
    const MOST_BYTES: usize = 48 << 20;

    fn get(&mut self, number: u32) -> Option<Unpacked> {
        if let Some(damage) = self.damaged.get(&number) {
            return Some(Err(damage.clone()));
        }
        let at = self.chunks.iter().position(|(n, _)| *n == number)?;
        let found = self.chunks.remove(at)?;
        self.chunks.push_back(found.clone());
        Some(Ok(found.1))
    }

    fn put(&mut self, number: u32, unpacked: Unpacked) {
        match unpacked {
            Ok(bytes) => {
                self.make_room(bytes.len());
                self.chunks.push_back((number, bytes));
            }
            Err(damage) => {
                self.damaged.insert(number, damage);
            }
        }
    }

    /// Drops the oldest chunks until one of `size` bytes fits in, or none is left.
    fn make_room(&mut self, size: usize) {
        let kept: usize = self.chunks.iter().map(|(_, b)| b.len()).sum();
        let mut total = kept + size;
        while total > Self::MOST_BYTES
            && let Some((_, dropped)) = self.chunks.pop_front()
        {
            total -= dropped.len();
        }
    }
}

/// Chunks with more bytes than this are unpacked one after the other, and as many as have so many together
/// at the same time, so that memory stays bounded.
const LARGE: u64 = 32 << 20;

/// Runs `task` on every chunk, on all cores, but for large ones. `first` is the number of the first one.
fn each_chunk<T: Send>(
    chunks: &[Chunk],
    first: u32,
    task: impl Fn(u32, &Chunk) -> Result<T, Error> + Sync,
) -> Result<Vec<T>, Error> {
    let numbered = || (first..).zip(chunks);
    let mut done: Vec<(u32, T)> = numbered()
        .collect::<Vec<_>>()
        .into_par_iter()
        .filter(|(_, c)| c.size() <= LARGE)
        .map(|(n, c)| Ok((n, task(n, c)?)))
        .collect::<Result<_, Error>>()?;
    for (n, c) in numbered().filter(|(_, c)| c.size() > LARGE) {
        done.push((n, task(n, c)?));
    }
    done.sort_by_key(|(n, _)| *n);
    Ok(done.into_iter().map(|(_, t)| t).collect())
}

/// How many of the chunks have [`LARGE`] bytes together; at least one.
fn batch(chunks: &[Chunk]) -> usize {
    let mut bytes = 0u64;
    let fits = |c: &&Chunk| {
        bytes = bytes.saturating_add(c.size());
        bytes <= LARGE
    };
    chunks.iter().take_while(fits).count().max(1)
}

/// Opens every chunk to find its messages, where the file's own indexes are missing or cannot be believed.
fn scan_chunks(source: &Source, index: &mut Index) -> Result<(), Error> {
    let mut chunks = std::mem::take(&mut index.chunks);
    drop_bombs(source, index, &mut chunks);
    index.messages.retain(|m| m.chunk == MessageRef::LOOSE);
    let mut first = 0;
    while first < chunks.len() {
        let batch = &chunks[first..first + batch(&chunks[first..])];
        let found = each_chunk(batch, first as u32, |number, chunk| {
            match chunk::unpack(source, chunk) {
                Ok(bytes) => Ok(Ok(chunk::list(&bytes, number, index.part()).0)),
                Err(Error::Damaged { damage, .. }) => Ok(Err(damage)),
                Err(error) => Err(error),
            }
        })?;
        first += batch.len();
        for (chunk, contents) in batch.iter().zip(found) {
            match contents {
                Ok(contents) => index.absorb(contents, chunk.offset),
                Err(damage) => index.add_damage(damage),
            }
        }
    }
    index.chunks = chunks;
    Ok(())
}

/// Whether the chunks together unpack to far more than their file.
fn has_bombs(source: &Source, chunks: &[Chunk]) -> bool {
    let mut budget = Budget::of(source);
    chunks.iter().any(|chunk| budget.take(chunk).is_err())
}

/// Leaves out the chunks that together unpack to far more than their file.
fn drop_bombs(source: &Source, index: &mut Index, chunks: &mut Vec<Chunk>) {
    let mut budget = Budget::of(source);
    chunks.retain(|chunk| match budget.take(chunk) {
        Ok(()) => true,
        Err(damage) => {
            index.add_damage(damage);
            false
        }
    });
}

/// The messages of each topic of ours, in the order of their log times; messages of undefined channels are counted as
/// damage.
fn sort_by_topic(index: &mut Index) -> BTreeMap<Topic, Vec<MessageRef>> {
    let of_channel: BTreeMap<u16, Option<Topic>> = index
        .channels
        .iter()
        .map(|(&id, c)| (id, Topic::parse(&c.topic)))
        .collect();
    let mut topics: BTreeMap<Topic, Vec<MessageRef>> = BTreeMap::new();
    let mut lost = 0;
    for message in &index.messages {
        match of_channel.get(&message.channel) {
            Some(Some(topic)) => match topics.get_mut(topic) {
                Some(messages) => messages.push(*message),
                None => {
                    topics.insert(topic.clone(), vec![*message]);
                }
            },
            Some(None) => {}
            None => lost += 1,
        }
    }
    for messages in topics.values_mut() {
        messages.sort_unstable();
        // An index may list one message many times over.
        messages.dedup();
    }
    if lost > 0 {
        let what = format!("the file defines no channel for {}", count(lost, "message"));
        index.add_note(0, what);
    }
    topics
}
