//! What tells that a file arrived whole: its length and a checksum. It finds accidents; that the file is the right one
//! follows from the digests of what is in it. Nothing is sent here.

use crc32fast::Hasher;
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// Bytes that are read at a time.
const BLOCK: usize = 256 << 10;

/// A file's length and checksum.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FileSum {
    /// Its length in bytes.
    pub bytes: u64,
    /// CRC-32 of its bytes, as zip and PNG have it.
    pub crc32: u32,
}

impl FileSum {
    /// Of the file at `path`.
    ///
    /// # Errors
    /// If it cannot be read.
    pub fn of(path: &Path) -> std::io::Result<Self> {
        let mut file = File::open(path)?;
        let mut block = vec![0; BLOCK];
        let mut sum = RunningSum::default();
        loop {
            match file.read(&mut block)? {
                0 => return Ok(sum.finish()),
                length => sum.add(&block[..length]),
            }
        }
    }
}

/// The sum of a file that comes in pieces.
#[derive(Default)]
pub(super) struct RunningSum {
    bytes: u64,
    crc: Hasher,
}

impl RunningSum {
    /// Takes the next piece.
    pub(super) fn add(&mut self, piece: &[u8]) {
        self.bytes += piece.len() as u64;
        self.crc.update(piece);
    }

    /// How many bytes came until now.
    pub(super) fn bytes(&self) -> u64 {
        self.bytes
    }

    /// What all pieces together have.
    pub(super) fn finish(self) -> FileSum {
        FileSum {
            bytes: self.bytes,
            crc32: self.crc.finalize(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_has_the_sum_of_its_pieces_and_a_changed_byte_another() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        let mut bytes: Vec<u8> = (0..BLOCK + 77).map(|i| (i % 251) as u8).collect();
        std::fs::write(&path, &bytes).unwrap();
        let whole = FileSum::of(&path).unwrap();
        let mut sum = RunningSum::default();
        bytes.chunks(1000).for_each(|piece| sum.add(piece));
        assert_eq!(sum.bytes(), bytes.len() as u64);
        assert_eq!(sum.finish(), whole);
        bytes[70_000] ^= 1;
        std::fs::write(&path, &bytes).unwrap();
        let changed = FileSum::of(&path).unwrap();
        assert_eq!(changed.bytes, whole.bytes);
        assert_ne!(changed.crc32, whole.crc32);
        // The standard's own example.
        std::fs::write(&path, "123456789").unwrap();
        assert_eq!(FileSum::of(&path).unwrap().crc32, 0xcbf4_3926);
    }
}
