//! Complete recordings made smaller: the same messages in packed chunks. The packed copy is read again and compared
//! before it takes the place of the original; until then the original is not touched.

use super::entries::each_entry;
use super::rewriting::{dress, io, lock, remove_stale, with_ending};
use super::writer::{Compression, Writer};
use super::{Error, Recording};
use crate::storage::sync_parent;
use sha2::{Digest, Sha256};
use std::fs::{File, FileTimes, Metadata};
use std::os::unix::fs::MetadataExt;
use std::path::Path;

/// Bytes of a recording after which its packed copy is brought to the disk: a capture that comes meanwhile is not to
/// wait for more than these.
const SYNCED: usize = 16 << 20;
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

/// Packs a complete recording. All that is in it stays, byte for byte and in the same order, and so do its name, its
/// time, its owner and its permissions. It is given up as soon as `goes_on` says so, which is asked often.
///
/// # Errors
/// If it is no complete and undamaged recording, or is being written or packed; or the packed copy cannot be written,
/// or does not hold the same. The recording is then as it was.
pub fn pack(path: &Path, goes_on: impl Fn() -> bool) -> Result<Packed, Error> {
    // A link stays one.
    let path = &path.canonicalize().map_err(io(path))?;
    let recording = Recording::open(path)?;
    let mut file = File::open(path).map_err(io(path))?;
    lock(&file, path)?;
    if recording.is_packed() {
        return Ok(Packed::Already);
    }
    // Chunks and attachments are checked as they are read, by this thread alone.
    if let Some(damage) = recording.damage().first().cloned() {
        return Err(Error::Damaged {
            path: path.into(),
            damage,
        });
    }
    let copies = ["packed", "packing"].map(|ending| with_ending(path, ending));
    let [packed, packing] = &copies;
    for copy in &copies {
        remove_stale(copy)?;
    }
    let (_, program) = recording.written_by();
    let mut made = || {
        let mut writer = Writer::bare(packed, packing, program, Compression::Zstd)?;
        let Some(content) = copy(&mut file, path, &mut writer, &goes_on)? else {
            return Ok(Packed::GivenUp);
        };
        writer.finish()?;
        check(packed, content, recording.written_by())?;
        put_into_place(&file, path, packed)
    };
    let made = made();
    // What has not taken its place by now is of no use.
    for copy in &copies {
        remove_stale(copy)?;
    }
    made
}

/// Copies all entries; a digest of them, or `None` if that was given up.
fn copy(
    file: &mut File,
    path: &Path,
    writer: &mut Writer,
    goes_on: &dyn Fn() -> bool,
) -> Result<Option<[u8; 32]>, Error> {
    let mut digest = Sha256::new();
    let mut since_sync = 0;
    let whole = each_entry(file, path, (u64::MAX, false), |entry| {
        entry.add_to(&mut digest);
        entry.write_to(writer)?;
        since_sync += entry.length();
        if since_sync >= SYNCED {
            writer.sync()?;
            since_sync = 0;
        }
        Ok(goes_on())
    })?;
    Ok(whole.then(|| digest.finalize().into()))
}

/// Whether the packed copy holds what it is to hold.
fn check(packed: &Path, expected: [u8; 32], written_by: (&str, &str)) -> Result<(), Error> {
    let mut file = File::open(packed).map_err(io(packed))?;
    let mut digest = Sha256::new();
    each_entry(&mut file, packed, (u64::MAX, false), |entry| {
        entry.add_to(&mut digest);
        Ok(true)
    })?;
    let same = <[u8; 32]>::from(digest.finalize()) == expected;
    if same && Recording::open(packed)?.written_by() == written_by {
        return Ok(());
    }
    let differs = std::io::Error::other("what was packed does not unpack to the same");
    Err(io(packed)(differs))
}

/// Gives the packed copy the original's name, unless somebody has moved or replaced that meanwhile.
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
    let dressed = || {
        let copy = File::options().write(true).open(packed)?;
        dress(&copy, &original)?;
        copy.set_times(FileTimes::new().set_modified(original.modified()?))?;
        copy.sync_all()?;
        std::fs::rename(packed, path)?;
        sync_parent(path)
    };
    dressed().map_err(io(path))?;
    Ok(Packed::Smaller(original.len(), after))
}
