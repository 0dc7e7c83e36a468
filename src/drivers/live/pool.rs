//! Bounded memory for frames: a buffer is taken when a frame arrives, and returns to the pool when the last clone of
//! the frame is dropped.

use bytes::Bytes;
use parking_lot::Mutex;
use std::sync::Arc;

/// A bounded amount of memory for frames; clones share it.
#[derive(Debug, Clone)]
pub struct Pool {
    shared: Arc<Shared>,
}

#[derive(Debug)]
struct Shared {
    limit: usize,
    state: Mutex<State>,
}

#[derive(Debug, Default)]
struct State {
    /// Bytes of all buffers, in use or free.
    allocated: usize,
    free: Vec<Vec<u8>>,
}

/// A pool's buffer, to write a frame into.
#[derive(Debug)]
pub struct PooledBuffer {
    bytes: Vec<u8>,
    pool: Arc<Shared>,
}

impl Pool {
    /// A pool of at most `limit` bytes. Allocates nothing yet.
    pub fn new(limit: usize) -> Self {
        Self {
            shared: Arc::new(Shared {
                limit,
                state: Mutex::default(),
            }),
        }
    }

    /// An empty buffer of `length` bytes; `None` if that exceeds the pool's limit.
    pub fn take(&self, length: usize) -> Option<PooledBuffer> {
        let bytes = self.shared.take(length)?;
        Some(PooledBuffer {
            bytes,
            pool: self.shared.clone(),
        })
    }

    /// Bytes of buffers that are in use.
    pub fn in_use(&self) -> usize {
        let state = self.shared.state.lock();
        let free: usize = state.free.iter().map(Vec::capacity).sum();
        state.allocated - free
    }

    /// Bytes of all buffers, in use or free.
    pub fn allocated(&self) -> usize {
        self.shared.state.lock().allocated
    }

    /// The limit in bytes.
    pub fn limit(&self) -> usize {
        self.shared.limit
    }
}

impl Shared {
    /// The smallest free buffer that is large enough, or a new one, for which smaller free ones are dropped if need be.
    fn take(&self, length: usize) -> Option<Vec<u8>> {
        let mut state = self.state.lock();
        let fitting = state.free.iter().enumerate();
        let best = fitting
            .filter(|(_, b)| b.capacity() >= length && b.capacity() <= 2 * length.max(4096))
            .min_by_key(|(_, b)| b.capacity())
            .map(|(i, _)| i);
        if let Some(i) = best {
            return Some(state.free.swap_remove(i));
        }
        while state.allocated.saturating_add(length) > self.limit {
            let unfit = state.free.pop()?;
            state.allocated -= unfit.capacity();
        }
        let bytes = Vec::with_capacity(length);
        state.allocated += bytes.capacity();
        Some(bytes)
    }

    fn give_back(&self, mut bytes: Vec<u8>) {
        bytes.clear();
        self.state.lock().free.push(bytes);
    }
}

impl PooledBuffer {
    /// Appends as many bytes as fit; returns how many.
    pub fn write(&mut self, bytes: &[u8]) -> usize {
        let room = self.bytes.capacity() - self.bytes.len();
        let taken = &bytes[..bytes.len().min(room)];
        self.bytes.extend_from_slice(taken);
        taken.len()
    }

    /// Makes the written bytes shareable; the buffer returns to the pool with the last clone.
    pub fn freeze(self) -> Bytes {
        Bytes::from_owner(self)
    }
}

impl AsRef<[u8]> for PooledBuffer {
    fn as_ref(&self) -> &[u8] {
        &self.bytes
    }
}

impl Drop for PooledBuffer {
    fn drop(&mut self) {
        self.pool.give_back(std::mem::take(&mut self.bytes));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_goes_round_and_stays_within_its_limit() {
        let pool = Pool::new(10_000);
        let mut held = Vec::new();
        while let Some(mut buffer) = pool.take(3_000) {
            assert_eq!(buffer.write(&[7; 3_000]), 3_000);
            held.push(buffer.freeze());
        }
        assert_eq!((held.len(), pool.allocated()), (3, 9_000));
        assert!(held.iter().all(|b| b[..] == [7; 3_000]));
        let clone = held[0].clone();
        held.clear();
        assert_eq!(pool.in_use(), 3_000);
        assert!(pool.take(3_000).is_some());
        drop(clone);
        assert_eq!(pool.allocated(), 9_000);
        // Buffers of another size take the place of free ones.
        assert!(pool.take(10_000).is_some());
        assert_eq!(pool.allocated(), 10_000);
        assert!(pool.take(10_001).is_none());
    }

    #[test]
    fn a_buffer_takes_no_more_than_was_asked_for() {
        let pool = Pool::new(100);
        let mut buffer = pool.take(4).unwrap();
        assert!(buffer.write(&[1, 2, 3, 4, 5, 6, 7, 8]) >= 4);
        let length = buffer.as_ref().len();
        assert_eq!(buffer.freeze().len(), length);
        assert!(pool.allocated() <= 100);
    }
}
