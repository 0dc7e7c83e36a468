//! Places that clients share, such as open streams: so many in all, and so many of one session, so that no session
//! takes all of them.

use crate::page::secrets::Hash;
use parking_lot::Mutex;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Places, counted by session.
pub(super) struct Shares {
    most: usize,
    most_of_one: usize,
    taken: Mutex<BTreeMap<Hash, usize>>,
}

/// One place, until it is dropped.
pub(super) struct Share {
    shares: Arc<Shares>,
    session: Hash,
}

impl Shares {
    /// So many places in all, and for one session.
    pub(super) fn new(most: usize, most_of_one: usize) -> Arc<Self> {
        Arc::new(Self {
            most,
            most_of_one,
            taken: Mutex::default(),
        })
    }

    /// A place for the session with this secret; none if all are taken, or as many as one session may have.
    pub(super) fn take(self: &Arc<Self>, secret: &str) -> Option<Share> {
        let session = Hash::of(secret);
        let mut taken = self.taken.lock();
        let all: usize = taken.values().sum();
        let own = taken.get(&session).copied().unwrap_or(0);
        if all >= self.most || own >= self.most_of_one {
            return None;
        }
        taken.insert(session.clone(), own + 1);
        Some(Share {
            shares: self.clone(),
            session,
        })
    }
}

impl Drop for Share {
    fn drop(&mut self) {
        let mut taken = self.shares.taken.lock();
        if let Some(count) = taken.get_mut(&self.session) {
            *count -= 1;
            if *count == 0 {
                taken.remove(&self.session);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_session_takes_all_places() {
        let shares = Shares::new(3, 2);
        let first = shares.take("a");
        let second = shares.take("a");
        assert!(first.is_some() && second.is_some() && shares.take("a").is_none());
        let other = shares.take("b");
        assert!(other.is_some() && shares.take("c").is_none());
        drop(first);
        assert!(shares.take("c").is_some());
        drop((second, other));
        assert!(shares.taken.lock().is_empty());
    }
}
