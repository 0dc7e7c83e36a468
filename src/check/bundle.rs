//! The support bundle: one tar archive of bounded size, compressed with zstd. It uses the oldest format that every tool
//! reads (POSIX ustar).

use crate::storage;
use std::io::{Error, ErrorKind, Result, Write};
use std::path::Path;
use std::time::{SystemTime, UNIX_EPOCH};

/// Largest size of one file in a bundle; only the end of a longer one is kept.
pub const LARGEST_FILE: usize = 4 << 20;
/// Most files in a bundle.
const MOST_FILES: usize = 32;

/// Files to be written into one archive.
#[derive(Clone, Debug, Default)]
pub struct Bundle {
    files: Vec<(String, Vec<u8>)>,
}

impl Bundle {
    /// Adds a file. Only the end of a file that is too long is kept: that is where a log is newest.
    pub fn add(&mut self, name: &str, contents: impl Into<Vec<u8>>) {
        let mut contents = contents.into();
        if self.files.len() >= MOST_FILES {
            return;
        }
        if let Some(before) = contents.len().checked_sub(LARGEST_FILE) {
            contents.drain(..before);
        }
        self.files.push((name.to_owned(), contents));
    }

    /// Writes the archive atomically, readable by its owner only.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn save(&self, path: &Path) -> std::result::Result<(), storage::Error> {
        let packed = self.packed().map_err(|cause| storage::Error::Io {
            action: "pack",
            path: path.into(),
            cause,
        })?;
        storage::write_atomically_for_owner(path, &packed)
    }

    fn packed(&self) -> Result<Vec<u8>> {
        let mut packed = zstd::Encoder::new(Vec::new(), 6)?;
        self.write(&mut packed)?;
        packed.finish()
    }

    fn write(&self, to: &mut impl Write) -> Result<()> {
        let now = SystemTime::now().duration_since(UNIX_EPOCH);
        let seconds = now.unwrap_or_default().as_secs();
        for (name, contents) in &self.files {
            to.write_all(&header(name, contents.len(), seconds)?)?;
            to.write_all(contents)?;
            to.write_all(&vec![
                0;
                contents.len().next_multiple_of(512) - contents.len()
            ])?;
        }
        to.write_all(&[0; 1024])
    }
}

/// A configuration without what stands for a user and a password in an address. scand refuses such an address, but the
/// file that was refused is what support wants to see.
pub fn without_passwords(text: &str) -> String {
    let mut shown = String::new();
    let mut rest = text;
    while let Some(at) = rest.find("//") {
        let (before, after) = rest.split_at(at + 2);
        shown.push_str(before);
        let is_end = |c: char| c.is_whitespace() || c == '"' || c == '\'';
        let address = &after[..after.find(is_end).unwrap_or(after.len())];
        rest = match address.rfind('@') {
            Some(end) => {
                shown.push_str("***");
                &after[end..]
            }
            None => after,
        };
    }
    shown + rest
}

/// The 512 bytes before a file's contents: POSIX.1-1988, ustar.
fn header(name: &str, length: usize, seconds: u64) -> Result<[u8; 512]> {
    let mut header = [0; 512];
    let mut put = |at: usize, text: &str| {
        header[at..at + text.len()].copy_from_slice(text.as_bytes());
    };
    if name.len() > 99 {
        return Err(Error::new(ErrorKind::InvalidInput, "a name is too long"));
    }
    put(0, name);
    put(100, "0000600\0");
    put(108, "0000000\0");
    put(116, "0000000\0");
    put(124, &format!("{length:011o}\0"));
    put(136, &format!("{seconds:011o}\0"));
    // The checksum is taken with blanks in its own place.
    put(148, "        ");
    put(156, "0");
    put(257, "ustar\x0000");
    let sum: u32 = header.iter().map(|&byte| u32::from(byte)).sum();
    header[148..156].copy_from_slice(format!("{sum:06o}\0 ").as_bytes());
    Ok(header)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::process::{Command, Stdio};

    #[test]
    fn a_configuration_is_shown_without_passwords() {
        let text = "fleet = \"nats://me:hid//d@en@host:4222\" # ask me@home\nurl='tls://k@h' x = \"//a/b\"\n";
        let shown =
            "fleet = \"nats://***@host:4222\" # ask me@home\nurl='tls://***@h' x = \"//a/b\"\n";
        assert_eq!(without_passwords(text), shown);
        assert_eq!(without_passwords("folder = \"x\" //"), "folder = \"x\" //");
    }

    #[test]
    fn tar_reads_what_was_packed_and_nothing_is_longer_than_allowed() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("bundle.tar.zst");
        let mut bundle = Bundle::default();
        bundle.add("check.txt", "ok\n");
        let mut long = vec![b'a'; LARGEST_FILE];
        long.extend(b"the end");
        bundle.add("journal.txt", long);
        (0..100).for_each(|n| bundle.add(&format!("more-{n}"), Vec::new()));
        bundle.save(&path).unwrap();
        let tar = zstd::decode_all(std::fs::File::open(&path).unwrap()).unwrap();
        let mut child = Command::new("tar")
            .args(["-x", "-f", "-"])
            .current_dir(folder.path())
            .stdin(Stdio::piped())
            .spawn()
            .unwrap();
        child.stdin.take().unwrap().write_all(&tar).unwrap();
        assert!(child.wait().unwrap().success());
        let read = |name: &str| std::fs::read(folder.path().join(name)).unwrap();
        assert_eq!(read("check.txt"), b"ok\n");
        assert_eq!(read("journal.txt").len(), LARGEST_FILE);
        assert!(read("journal.txt").ends_with(b"the end"));
        // Those two, the archive, and thirty more.
        assert_eq!(
            std::fs::read_dir(folder.path()).unwrap().count(),
            MOST_FILES + 1
        );
    }
}
