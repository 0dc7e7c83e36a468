//! Places that clients share, such as connections or open streams: so many in all, and so many of one session or
//! address, so that none of these takes all of them.

use parking_lot::Mutex;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Places, counted by what has them.
pub(super) struct Shares<K> {
    most: usize,
    most_of_one: usize,
    taken: Mutex<BTreeMap<K, usize>>,
}

/// One place, until it is dropped.
pub(super) struct Share<K: Ord> {
    shares: Arc<Shares<K>>,
    of: K,
}

impl<K: Ord + Clone> Shares<K> {
    /// So many places in all, and for one.
    pub(super) fn new(most: usize, most_of_one: usize) -> Arc<Self> {
        Arc::new(Self {
            most,
            most_of_one,
            taken: Mutex::default(),
        })
    }

    /// A place; none if all are taken, or as many as one may have.
    pub(super) fn take(self: &Arc<Self>, of: K) -> Option<Share<K>> {
        self.take_up_to(of, self.most_of_one)
    }

    /// A place for one that may have any number of them; none if all are taken.
    pub(super) fn take_any(self: &Arc<Self>, of: K) -> Option<Share<K>> {
        self.take_up_to(of, self.most)
    }

    fn take_up_to(self: &Arc<Self>, of: K, most_of_one: usize) -> Option<Share<K>> {
        let mut taken = self.taken.lock();
        let all: usize = taken.values().sum();
        let own = taken.get(&of).copied().unwrap_or(0);
        if all >= self.most || own >= most_of_one {
            return None;
        }
        taken.insert(of.clone(), own + 1);
        drop(taken);
        Some(Share {
            shares: self.clone(),
            of,
        })
    }
}

impl<K: Ord> Drop for Share<K> {
    fn drop(&mut self) {
        let mut taken = self.shares.taken.lock();
        if let Some(count) = taken.get_mut(&self.of) {
            *count -= 1;
            if *count == 0 {
                taken.remove(&self.of);
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

    #[test]
    fn one_that_stands_for_many_takes_all_places_and_no_more() {
        let shares = Shares::new(3, 1);
        let taken: Vec<_> = (0..4).map(|_| shares.take_any("proxy")).collect();
        assert_eq!(taken.iter().flatten().count(), 3);
        drop(taken);
        assert!(shares.take("a").is_some());
    }
}
