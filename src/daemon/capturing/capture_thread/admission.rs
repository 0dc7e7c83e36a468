//! Checks that there is room for a capture: in memory, on the disk, and in the recorder's queue. If there is not,
//! it gives the reason with which the press is refused, for example that the disk is full.

use super::CaptureThread;
use crate::daemon::rig::{CameraKind, State};
use crate::storage::free_bytes;
use crate::words::count;

impl CaptureThread {
    /// Whether a capture can be begun; if not, why.
    pub(super) fn check_capacity(&self) -> Result<(), String> {
        if !self.recorder.has_room() {
            return Err(format!(
                "the recorder's queue is full: {} must still be written; wait for the recorder and press again",
                count(self.recorder.waiting(), "capture")
            ));
        }
        let bytes = self.capture_bytes();
        let pool = &self.plan.pool;
        if pool.in_use() as u64 + bytes > pool.limit() as u64 {
            return Err(format!(
                "a capture needs {} MB of memory, but {} of {} MB are in use; press again when captures are written, or \
                 raise capture.memory_mb",
                bytes / 1_000_000,
                pool.in_use() / 1_000_000,
                pool.limit() / 1_000_000
            ));
        }
        let folder = &self.plan.recording.folder;
        let free = free_bytes(folder).map_err(|e| format!("{}: {e}", folder.display()))?;
        if self.usable(free).is_none_or(|usable| usable < bytes) {
            return Err(format!(
                "the disk is full: {} has {} MB left, a capture takes {} MB, {} must still be written, and {} MB must \
                 stay free (recording.keep_free_mb); move recordings elsewhere",
                folder.display(),
                free / 1_000_000,
                bytes / 1_000_000,
                count(self.recorder.waiting(), "capture"),
                self.plan.recording.keep_free_mb
            ));
        }
        Ok(())
    }

    /// How many of `free` bytes captures may take; `None` if fewer are free than have to stay free.
    pub(super) fn usable(&self, free: u64) -> Option<u64> {
        let bytes = self.capture_bytes();
        // Captures that wait for the disk will take their share of it.
        let waiting = self.recorder.waiting() as u64 * bytes;
        // A recording has more than pictures, and a file that begins has the backgrounds.
        let rest = self.backgrounds_bytes() + bytes / 10 + 1_000_000;
        let keep_free_bytes = self.plan.recording.keep_free_bytes();
        free.checked_sub(keep_free_bytes.saturating_add(waiting + rest))
    }

    /// Bytes of the backgrounds that a file begins with.
    fn backgrounds_bytes(&self) -> u64 {
        let backgrounds = self.plan.header.backgrounds.values();
        backgrounds.map(|(_, picture)| picture.bytes() as u64).sum()
    }

    /// Bytes of a capture, as the cameras are set.
    pub(super) fn capture_bytes(&self) -> u64 {
        let frames = |kind| match kind {
            CameraKind::Color => 1,
            CameraKind::Depth | CameraKind::DepthInTurn => self.plan.sync.depth_frames as u64,
        };
        let bytes = self.rig.states().map(|(_, kind, state)| match state {
            State::Ready(info) => info.frame_bytes * frames(kind),
            State::Opening | State::Away(_) => 0,
        });
        bytes.sum()
    }
}
