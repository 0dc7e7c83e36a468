//! Writes zip packages, for formats that are based on zip: entries are stored or deflated in the given order, with a
//! date in 1980, so that the same entries make the same bytes.

use super::Error;
use flate2::Compression;
use flate2::write::DeflateEncoder;
use std::io::Write;

/// An entry of a package.
pub(super) struct Entry<'a> {
    /// Its path, of ASCII, with `/`.
    pub(super) name: &'a str,
    /// Its content.
    pub(super) bytes: &'a [u8],
    /// Whether it is deflated.
    pub(super) deflate: bool,
}

/// 1980-01-01, the first date that a package can have.
const DATE: u16 = (1 << 5) | 1;
const STORED: u16 = 0;
const DEFLATED: u16 = 8;
/// An extra field of this kind is padding to its readers, as in the packages that OpenUSD writes.
const PADDING: u16 = 0x1986;
const PADDING_HEADER: usize = 4;

/// A package. Each entry's bytes begin at a multiple of `alignment`.
///
/// # Errors
/// If the package would have 4 GiB or more.
pub(super) fn pack(
    entries: &[Entry<'_>],
    alignment: usize,
    format: &'static str,
) -> Result<Vec<u8>, Error> {
    let too_large = || Error::TooLarge {
        format,
        what: "it has 4 GiB or more",
    };
    let (mut bytes, mut directory) = (Vec::new(), Vec::new());
    for entry in entries {
        let deflated = entry.deflate.then(|| deflate(entry.bytes));
        let data = deflated.as_deref().unwrap_or(entry.bytes);
        let header = Header {
            entry,
            data_size: u32::try_from(data.len()).map_err(|_| too_large())?,
            size: u32::try_from(entry.bytes.len()).map_err(|_| too_large())?,
            offset: u32::try_from(bytes.len()).map_err(|_| too_large())?,
        };
        header.write_local(&mut bytes, alignment);
        bytes.extend_from_slice(data);
        header.write_central(&mut directory);
    }
    let start = u32::try_from(bytes.len()).map_err(|_| too_large())?;
    bytes.extend_from_slice(&directory);
    u32::try_from(bytes.len()).map_err(|_| too_large())?;
    let count = entries.len() as u16;
    bytes.extend(b"PK\x05\x06\0\0\0\0");
    bytes.extend([count, count].map(u16::to_le_bytes).as_flattened());
    bytes.extend((directory.len() as u32).to_le_bytes());
    bytes.extend(start.to_le_bytes());
    bytes.extend([0, 0]);
    Ok(bytes)
}

fn deflate(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = DeflateEncoder::new(Vec::new(), Compression::default());
    // A vector takes whatever is written to it.
    let _ = encoder.write_all(bytes);
    encoder.finish().unwrap_or_default()
}

struct Header<'a> {
    entry: &'a Entry<'a>,
    data_size: u32,
    size: u32,
    offset: u32,
}

impl Header<'_> {
    /// What the header before the data and that in the directory have in common.
    fn common(&self, extra: usize) -> Vec<u8> {
        let method = if self.entry.deflate { DEFLATED } else { STORED };
        // Needs version 2.0, no flags, its method, the time 0:00.
        let mut bytes = [20, 0, method, 0, DATE].map(u16::to_le_bytes).concat();
        let words = [crc32fast::hash(self.entry.bytes), self.data_size, self.size];
        bytes.extend(words.map(u32::to_le_bytes).as_flattened());
        let lengths = [self.entry.name.len() as u16, extra as u16];
        bytes.extend(lengths.map(u16::to_le_bytes).as_flattened());
        bytes
    }

    fn write_local(&self, bytes: &mut Vec<u8>, alignment: usize) {
        let end = bytes.len() + 30 + self.entry.name.len();
        let extra = match end.next_multiple_of(alignment) - end {
            0 => 0,
            few if few < PADDING_HEADER => few + alignment.next_multiple_of(PADDING_HEADER),
            enough => enough,
        };
        bytes.extend(b"PK\x03\x04");
        bytes.extend(self.common(extra));
        bytes.extend(self.entry.name.as_bytes());
        if extra > 0 {
            bytes.extend(PADDING.to_le_bytes());
            bytes.extend(((extra - PADDING_HEADER) as u16).to_le_bytes());
            bytes.resize(bytes.len() + extra - PADDING_HEADER, 0);
        }
    }

    fn write_central(&self, directory: &mut Vec<u8>) {
        directory.extend(b"PK\x01\x02\x14\0");
        directory.extend(self.common(0));
        // No comment, disk 0, no attributes.
        directory.extend([0; 10]);
        directory.extend(self.offset.to_le_bytes());
        directory.extend(self.entry.name.as_bytes());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Read;

    #[test]
    fn entries_are_aligned_and_come_back() {
        let text = b"the same again and again, ".repeat(20);
        for length in 0..70 {
            let name = "x".repeat(length + 1);
            let entries = [
                Entry {
                    name: &name,
                    bytes: &text,
                    deflate: false,
                },
                Entry {
                    name: "b",
                    bytes: &text,
                    deflate: true,
                },
            ];
            let bytes = pack(&entries, 64, "test").unwrap();
            let half = |at: usize| usize::from(u16::from_le_bytes([bytes[at], bytes[at + 1]]));
            let data = 30 + half(26) + half(28);
            assert_eq!(data % 64, 0, "{length}");
            assert_eq!(&bytes[data..data + text.len()], &text[..]);
            let second = data + text.len();
            assert_eq!(&bytes[second..second + 4], b"PK\x03\x04");
            let packed = second + 30 + half(second + 26) + half(second + 28);
            assert_eq!(packed % 64, 0);
            let mut back = Vec::new();
            let packed = &bytes[packed..packed + half(second + 18)];
            flate2::read::DeflateDecoder::new(packed)
                .read_to_end(&mut back)
                .unwrap();
            assert_eq!(back, text);
        }
    }
}
