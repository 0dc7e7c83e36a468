//! How much free space a disk has.

use std::path::Path;

/// Bytes that may still be written in a folder without special rights.
///
/// # Errors
/// If the folder cannot be asked.
pub fn free_bytes(folder: &Path) -> std::io::Result<u64> {
    let system = rustix::fs::statvfs(folder)?;
    Ok(system.f_bavail.saturating_mul(system.f_frsize))
}
