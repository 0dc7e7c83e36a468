//! Tells child processes that their work is no longer needed, and wakes the threads that wait for them.

use rustix::event::{EventfdFlags, eventfd};
use std::io;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::sync::Arc;

/// One side says it, the other waits with it; both hold the same one. Once said, it stays said.
#[derive(Clone, Debug)]
pub struct Cancel(Arc<OwnedFd>);

impl Cancel {
    /// Nothing is cancelled yet.
    ///
    /// # Errors
    /// If this process has no open file left.
    pub fn new() -> io::Result<Self> {
        Ok(Self(Arc::new(eventfd(0, EventfdFlags::CLOEXEC)?)))
    }

    /// Cancels.
    pub fn cancel(&self) {
        // A counter of 64 bits that is never read takes this often enough.
        let _ = rustix::io::write(&self.0, &1u64.to_ne_bytes());
    }
}

impl AsFd for Cancel {
    /// Readable once it is cancelled.
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.0.as_fd()
    }
}
