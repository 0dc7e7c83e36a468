//! Places that clients share, such as connections or open streams: so many in all, and so many of one user, session or
//! address, so that none of these takes all of them. Nothing waits here.

use parking_lot::Mutex;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Places, counted by what has them.
pub(crate) struct Shares<K> {
    most: usize,
    most_of_one: usize,
    taken: Mutex<BTreeMap<K, usize>>,
}

/// One place, until it is dropped.
pub(crate) struct Share<K: Ord> {
    shares: Arc<Shares<K>>,
    of: K,
}

/// Why there is no place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Full {
    /// All are taken.
    All,
    /// One has as many as it may have.
    Own,
}

impl<K: Ord + Clone> Shares<K> {
    /// So many places in all, and for one.
    pub(crate) fn new(most: usize, most_of_one: usize) -> Arc<Self> {
        Arc::new(Self {
            most,
            most_of_one,
            taken: Mutex::default(),
        })
    }

    /// A place.
    ///
    /// # Errors
    /// If all are taken, or as many as one may have.
    pub(crate) fn take(self: &Arc<Self>, of: K) -> Result<Share<K>, Full> {
        self.take_up_to(of, self.most_of_one)
    }

    /// A place for one that may have any number of them.
    ///
    /// # Errors
    /// If all are taken.
    #[cfg(feature = "page")]
    pub(crate) fn take_any(self: &Arc<Self>, of: K) -> Result<Share<K>, Full> {
        self.take_up_to(of, self.most)
    }

    fn take_up_to(self: &Arc<Self>, of: K, most_of_one: usize) -> Result<Share<K>, Full> {
        let mut taken = self.taken.lock();
        let all: usize = taken.values().sum();
        let own = taken.get(&of).copied().unwrap_or(0);
        if all >= self.most {
            return Err(Full::All);
        }
        if own >= most_of_one {
            return Err(Full::Own);
        }
        taken.insert(of.clone(), own + 1);
        drop(taken);
        Ok(Share {
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
        assert!(first.is_ok() && second.is_ok());
        assert_eq!(shares.take("a").err(), Some(Full::Own));
        let other = shares.take("b");
        assert!(other.is_ok());
        assert_eq!(shares.take("c").err(), Some(Full::All));
        drop(first);
        assert!(shares.take("c").is_ok());
        drop((second, other));
        assert!(shares.taken.lock().is_empty());
    }

    #[cfg(feature = "page")]
    #[test]
    fn one_that_stands_for_many_takes_all_places_and_no_more() {
        let shares = Shares::new(3, 1);
        let taken: Vec<_> = (0..4).map(|_| shares.take_any("proxy")).collect();
        assert_eq!(taken.iter().flatten().count(), 3);
        drop(taken);
        assert!(shares.take("a").is_ok());
    }
}
