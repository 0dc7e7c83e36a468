//! Writes a recording's file with the `mcap` crate's writer and turns its errors into those of the system. A file that
//! was not finished gets no end, so that recovery finds it as the crash left it. `writer` decides what the messages are
//! and when a chunk ends.

use mcap::records::{MessageHeader, Metadata};
use mcap::{McapError, WriteOptions};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufWriter, Error, Result, Seek, SeekFrom, Write};

/// How a recording's chunks are packed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Compression {
    /// Not at all, as a rig does it: pictures of real sensors hardly shrink.
    #[default]
    None,
    /// With zstd at its default level.
    Zstd,
    /// With zstd at its fastest level, for what is packed to travel once.
    ZstdFastest,
}

type Inner = mcap::Writer<BufWriter<Blocks>>;

/// A file that is written a block at a time. A whole picture in one call takes up to twice the processor time, when the
/// kernel looks for pages that lie together.
struct Blocks(File);

impl Blocks {
    const LARGEST: usize = 256 << 10;
}

impl Write for Blocks {
    fn write(&mut self, bytes: &[u8]) -> Result<usize> {
        self.0.write(&bytes[..bytes.len().min(Self::LARGEST)])
    }

    fn flush(&mut self) -> Result<()> {
        Ok(())
    }
}

impl Seek for Blocks {
    fn seek(&mut self, to: SeekFrom) -> Result<u64> {
        self.0.seek(to)
    }
}

/// A recording's file, open at its end.
pub(super) struct Container {
    /// `None` after a write that failed: it is then unknown where the file ends.
    inner: Option<Inner>,
    /// A message that is put together; kept for its memory.
    message: Vec<u8>,
}

impl Container {
    /// Begins an empty file.
    pub(super) fn begin(
        file: File,
        profile: &str,
        library: &str,
        compression: Compression,
    ) -> Result<Self> {
        let (packing, level) = match compression {
            Compression::None => (None, 0),
            // The library's default level.
            Compression::Zstd => (Some(mcap::Compression::Zstd), 0),
            Compression::ZstdFastest => (Some(mcap::Compression::Zstd), 1),
        };
        let options = WriteOptions::new()
            .profile(profile)
            .library(library)
            // Chunks end where the writer above says.
            .chunk_size(None)
            .compression(packing)
            .compression_level(level)
            // In the thread that writes.
            .compression_threads(0);
        let inner = options.create(BufWriter::new(Blocks(file))).map_err(io)?;
        Ok(Self {
            inner: Some(inner),
            message: Vec::new(),
        })
    }

    /// The number of a schema, which is defined here if it is a new one.
    pub(super) fn schema(&mut self, schema: &mcap::Schema) -> Result<u16> {
        self.attempt(|w| w.add_schema(&schema.name, &schema.encoding, &schema.data))
    }

    /// The number of a channel, which is defined here if it is a new one.
    pub(super) fn channel(
        &mut self,
        schema: u16,
        topic: &str,
        encoding: &str,
        metadata: &BTreeMap<String, String>,
    ) -> Result<u16> {
        self.attempt(|w| w.add_channel(schema, topic, encoding, metadata))
    }

    /// Writes a message whose data are these parts, one behind the other.
    pub(super) fn message(&mut self, header: &MessageHeader, data: [&[u8]; 2]) -> Result<()> {
        let mut message = std::mem::take(&mut self.message);
        message.clear();
        data.iter().for_each(|part| message.extend_from_slice(part));
        let written = self.attempt(|w| w.write_to_known_channel(header, &message));
        self.message = message;
        written
    }

    /// Writes a metadata record, after the open chunk.
    pub(super) fn metadata(&mut self, metadata: &Metadata) -> Result<()> {
        self.attempt(|w| w.write_metadata(metadata))
    }

    /// Writes an attachment, after the open chunk.
    pub(super) fn attach(&mut self, attachment: &mcap::Attachment) -> Result<()> {
        self.attempt(|w| w.attach(attachment))
    }

    /// Ends the open chunk; everything is in the file then, though not on the disk yet.
    pub(super) fn flush(&mut self) -> Result<()> {
        self.attempt(Inner::flush)
    }

    /// Writes what the file ends with.
    pub(super) fn finish(mut self) -> Result<()> {
        self.attempt(Inner::finish).map(drop)
    }

    fn attempt<T>(
        &mut self,
        write: impl FnOnce(&mut Inner) -> std::result::Result<T, McapError>,
    ) -> Result<T> {
        let Some(inner) = &mut self.inner else {
            return Err(Error::other("an earlier write has failed"));
        };
        let written = write(inner).map_err(io);
        if written.is_err() {
            self.give_up();
        }
        written
    }

    /// Lets go of the file without writing anything more: dropped as it is, the library's writer would end it.
    pub(super) fn give_up(&mut self) {
        if let Some(inner) = self.inner.take() {
            let _unwritten = inner.into_inner().into_parts();
        }
    }
}

impl Drop for Container {
    fn drop(&mut self) {
        self.give_up();
    }
}

/// What the system said, where the library says it in words of its own.
fn io(error: McapError) -> Error {
    match error {
        McapError::Io(cause) | McapError::Parse(binrw::Error::Io(cause)) => cause,
        other => Error::other(other),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn after_a_write_that_failed_nothing_more_is_written() {
        let Ok(full) = File::options().write(true).open("/dev/full") else {
            return;
        };
        let mut container = Container::begin(full, "scand", "test 1", Compression::None).unwrap();
        let no_space = container.flush().unwrap_err();
        assert_eq!(no_space.kind(), std::io::ErrorKind::StorageFull);
        let again = container.flush().unwrap_err();
        assert!(again.to_string().contains("earlier"), "{again}");
    }

    #[test]
    fn what_is_dropped_unfinished_is_given_no_end() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        let file = File::create_new(&path).unwrap();
        let mut container = Container::begin(file, "scand", "test 1", Compression::None).unwrap();
        let schema = mcap::Schema {
            id: 0,
            name: "s".into(),
            encoding: "jsonschema".into(),
            data: b"{}"[..].into(),
        };
        let schema = container.schema(&schema).unwrap();
        let channel = container.channel(schema, "/a", "json", &BTreeMap::new());
        let header = MessageHeader {
            channel_id: channel.unwrap(),
            sequence: 0,
            log_time: 1,
            publish_time: 1,
        };
        container.message(&header, [b"{", b"}"]).unwrap();
        container.flush().unwrap();
        let flushed = std::fs::read(&path).unwrap();
        container.message(&header, [b"{", b"}"]).unwrap();
        drop(container);
        // A chunk that was begun has no length, and nothing follows it.
        let left = std::fs::read(&path).unwrap();
        assert!(left.starts_with(&flushed) && !left.ends_with(mcap::MAGIC));
        assert_eq!(left[flushed.len() + 1..][..8], [0xff; 8]);
    }
}
