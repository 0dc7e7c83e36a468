//! Makes complete recordings smaller: the same records, in compressed chunks. The packed copy is read again and
//! compared before it replaces the original, which is not touched until then.

use super::chunk;
use super::index::{Chunk, Index, most_of};
use super::records::{self, put_head, put_indexes};
use super::rewriting::{copy_ownership, io, lock, remove_stale, with_ending};
use super::scan::{LARGEST_RECORD, Scan, ScanEvent, Span};
use super::source::Source;
use super::{Damage, Error, Recording};
use crate::storage::rename_durably;
use bytes::Bytes;
use crc32fast::Hasher;
use mcap::MAGIC;
use mcap::records::op;
use sha2::{Digest, Sha256};
use std::fs::{File, FileTimes, Metadata};
use std::io::{Result as IoResult, Write};
use std::os::unix::fs::MetadataExt;
use std::path::Path;

/// Bytes of a recording after which its packed copy is brought to the disk: a capture that comes meanwhile is not to
/// wait for more than these.
const SYNCED: usize = 16 << 20;
/// Bytes that are packed at a time.
const BLOCK: usize = 1 << 20;
/// A packed copy that is larger than this share of the original is not worth it.
const WORTHWHILE: f64 = 0.98;

/// What became of a recording that was to be packed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Packed {
    /// It is smaller now: bytes before and after.
    Smaller(u64, u64),
    /// It was packed already.
    Already,
    /// It would hardly be smaller, and stays as it is.
    NotWorthwhile,
    /// It was not wanted any more, and stays as it is.
    GivenUp,
}

/// Packs a complete recording. Its contents stay the same, byte for byte and in the same order, and so do its name, its
/// time, its owner and its permissions. Packing stops as soon as `goes_on` returns false; it is called often.
///
/// # Errors
/// If it is no complete and undamaged recording, or is being written or packed; or the packed copy cannot be written,
/// or does not hold the same. The recording is then as it was.
pub fn pack(path: &Path, goes_on: impl Fn() -> bool) -> Result<Packed, Error> {
    // A link stays one.
    let path = &path.canonicalize().map_err(io(path))?;
    let recording = Recording::open(path)?;
    let file = File::open(path).map_err(io(path))?;
    lock(&file, path)?;
    // Chunks and attachments are checked as they are read, by this thread alone.
    if let Some(damage) = recording.damage().first().cloned() {
        return Err(Error::Damaged {
            path: path.into(),
            damage,
        });
    }
    if recording.is_packed() {
        return Ok(Packed::Already);
    }
    let packed = &with_ending(path, "packing");
    remove_stale(packed)?;
    let made = || {
        let mut copy = Copy::begin(packed).map_err(io(packed))?;
        let source = recording.source();
        let Some(content) = copy.fill(source, &goes_on)? else {
            return Ok(Packed::GivenUp);
        };
        copy.finish().map_err(io(packed))?;
        if !is_same(packed, content, &goes_on)? {
            return Ok(Packed::GivenUp);
        }
        put_into_place(&file, path, packed)
    };
    let made = made();
    // What has not taken its place by now is of no use.
    remove_stale(packed)?;
    made
}

/// The records that are copied; indexes are written again.
enum Part {
    /// A chunk and its content.
    Chunk(Chunk, Bytes),
    /// Any other record, and its body.
    Record(Span, Vec<u8>),
}

impl Part {
    /// Adds all of it to a digest, however it is packed.
    fn add_to(&self, digest: &mut Sha256) {
        let mut add = |opcode: u8, body: &[u8]| {
            digest.update([opcode]);
            digest.update((body.len() as u64).to_le_bytes());
            digest.update(body);
        };
        match self {
            Self::Chunk(_, content) => add(op::CHUNK, content),
            Self::Record(span, body) => add(span.opcode, body),
        }
    }
}

/// Hands out the parts of an undamaged recording, in their order, while `each` says that it wants more; whether it did
/// to the end.
fn each_part(
    source: &Source,
    mut each: impl FnMut(Part) -> Result<bool, Error>,
) -> Result<bool, Error> {
    let damaged = |damage: Damage| Error::Damaged {
        path: source.path.clone(),
        damage,
    };
    let mut scan = Scan::begin(source)?;
    while let Some(event) = scan.next()? {
        let span = match event {
            ScanEvent::Damage(damage) => return Err(damaged(damage)),
            ScanEvent::Record(span) if span.opcode == op::DATA_END => break,
            ScanEvent::Record(span) if span.opcode == op::MESSAGE_INDEX => continue,
            ScanEvent::Record(span) => span,
        };
        let unparsable = |what: &str| {
            damaged(Damage {
                offset: span.offset(),
                length: span.end() - span.offset(),
                what: what.into(),
            })
        };
        let part = if span.opcode == op::CHUNK {
            let head = scan.head(&span, most_of(op::CHUNK))?;
            let header = records::chunk(head, span.length);
            let header = header.map_err(|_| unparsable("the chunk cannot be parsed"))?;
            let chunk = Chunk::new(span.offset(), header);
            let content = chunk::unpack(source, &chunk)?;
            Part::Chunk(chunk, content)
        } else if span.length > LARGEST_RECORD {
            return Err(unparsable("the attachment is larger than 256 MiB"));
        } else {
            Part::Record(span, source.read(span.body, span.length as usize)?)
        };
        if !each(part)? {
            return Ok(false);
        }
    }
    Ok(true)
}

/// A packed copy that is being written.
struct Copy<'a> {
    path: &'a Path,
    file: File,
    /// Bytes that are in the file, and their CRC.
    written: u64,
    sum: Hasher,
    since_sync: usize,
    index: Index,
}

impl<'a> Copy<'a> {
    fn begin(path: &'a Path) -> IoResult<Self> {
        let mut copy = Self {
            path,
            file: File::create_new(path)?,
            written: 0,
            sum: Hasher::new(),
            since_sync: 0,
            index: Index::new(u64::MAX),
        };
        copy.put(MAGIC)?;
        Ok(copy)
    }

    /// Copies the contents of a recording. Returns their digest, or `None` if it was stopped.
    fn fill(
        &mut self,
        source: &Source,
        goes_on: &dyn Fn() -> bool,
    ) -> Result<Option<[u8; 32]>, Error> {
        let mut digest = Sha256::new();
        let is_whole = each_part(source, |part| {
            part.add_to(&mut digest);
            let added = match part {
                Part::Chunk(chunk, content) => self.chunk(chunk, &content, goes_on)?,
                Part::Record(span, body) => self.record(span.opcode, &body)?,
            };
            Ok(added && goes_on())
        })?;
        Ok(is_whole.then(|| digest.finalize().into()))
    }

    fn record(&mut self, opcode: u8, body: &[u8]) -> Result<bool, Error> {
        let head = [&[opcode][..], &(body.len() as u64).to_le_bytes()].concat();
        let offset = self.written;
        self.put(&head).map_err(io(self.path))?;
        self.put(body).map_err(io(self.path))?;
        let span = Span {
            opcode,
            body: offset + head.len() as u64,
            length: body.len() as u64,
        };
        let taken = self.index.take(&span, body);
        taken.map_err(|_| self.unparsable("a record cannot be parsed"))?;
        Ok(true)
    }

    /// Packs a chunk; whether that was not given up.
    fn chunk(
        &mut self,
        chunk: Chunk,
        content: &[u8],
        goes_on: &dyn Fn() -> bool,
    ) -> Result<bool, Error> {
        let number = self.index.chunks.len() as u32;
        let (part, is_whole) = chunk::list(content, number, self.index.part());
        if !is_whole {
            return Err(self.unparsable("a chunk's records cannot be parsed"));
        }
        let Some(packed) = packed(content, goes_on).map_err(io(self.path))? else {
            return Ok(false);
        };
        let mut chunk = Chunk::new(self.written, chunk.header);
        chunk.header.compression = "zstd".into();
        chunk.header.compressed_size = packed.len() as u64;
        let mut head = Vec::new();
        put_head(&mut head, op::CHUNK, &chunk.header, packed.len() as u64);
        let end = self.written + (head.len() + packed.len()) as u64;
        let (indexes, offsets) = put_indexes(&part.message_indexes(), end);
        for bytes in [&head, &packed, &indexes] {
            self.put(bytes).map_err(io(self.path))?;
        }
        chunk.index_offsets = offsets;
        chunk.index_length = indexes.len() as u64;
        self.index.absorb(part, chunk.offset);
        self.index.chunks.push(chunk);
        self.since_sync += content.len();
        if self.since_sync >= SYNCED {
            self.file.sync_data().map_err(io(self.path))?;
            self.since_sync = 0;
        }
        Ok(true)
    }

    fn put(&mut self, bytes: &[u8]) -> IoResult<()> {
        self.sum.update(bytes);
        self.written += bytes.len() as u64;
        self.file.write_all(bytes)
    }

    fn finish(mut self) -> IoResult<()> {
        let sum = std::mem::take(&mut self.sum).finalize();
        let closing = self.index.closing(self.written, sum);
        self.put(&closing)?;
        self.file.sync_all()
    }

    fn unparsable(&self, what: &str) -> Error {
        io(self.path)(std::io::Error::other(what.to_owned()))
    }
}

/// Bytes, packed, unless that was given up meanwhile.
fn packed(content: &[u8], goes_on: &dyn Fn() -> bool) -> IoResult<Option<Vec<u8>>> {
    let mut encoder = zstd::Encoder::new(Vec::new(), 0)?;
    for block in content.chunks(BLOCK) {
        encoder.write_all(block)?;
        if !goes_on() {
            return Ok(None);
        }
    }
    encoder.finish().map(Some)
}

/// Finds that the packed copy holds what it is to hold; false if that was given up meanwhile.
fn is_same(packed: &Path, expected: [u8; 32], goes_on: &dyn Fn() -> bool) -> Result<bool, Error> {
    let mut digest = Sha256::new();
    let recording = Recording::open(packed)?;
    let is_whole = each_part(recording.source(), |part| {
        part.add_to(&mut digest);
        Ok(goes_on())
    })?;
    if !is_whole {
        return Ok(false);
    }
    if recording.damage().is_empty() && <[u8; 32]>::from(digest.finalize()) == expected {
        return Ok(true);
    }
    let differs = std::io::Error::other("the packed copy does not unpack to the same messages");
    Err(io(packed)(differs))
}

/// Gives the packed copy the original's name, unless the original was moved or replaced meanwhile.
fn put_into_place(file: &File, path: &Path, packed: &Path) -> Result<Packed, Error> {
    let original = file.metadata().map_err(io(path))?;
    let now = std::fs::metadata(path).map_err(io(path))?;
    let same =
        |a: &Metadata, b: &Metadata| (a.dev(), a.ino(), a.len()) == (b.dev(), b.ino(), b.len());
    if !same(&original, &now) {
        let replaced = std::io::Error::other("it was replaced while it was being packed");
        return Err(io(path)(replaced));
    }
    let after = std::fs::metadata(packed).map_err(io(packed))?.len();
    if after as f64 > WORTHWHILE * original.len() as f64 {
        return Ok(Packed::NotWorthwhile);
    }
    let moved = || {
        let copy = File::options().write(true).open(packed)?;
        copy_ownership(&copy, &original)?;
        copy.set_times(FileTimes::new().set_modified(original.modified()?))?;
        copy.sync_all()?;
        rename_durably(packed, path)
    };
    moved().map_err(io(path))?;
    Ok(Packed::Smaller(original.len(), after))
}
