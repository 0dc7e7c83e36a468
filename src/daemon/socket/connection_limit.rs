//! Limits concurrent clients, in total and per user, so that one user cannot lock out the foot switch, which runs as
//! its own user.

use crate::shares::{Full, Share, Shares};
use std::sync::Arc;

/// Limit of concurrent clients.
const MOST: usize = 32;
/// Limit of concurrent clients of one user.
const MOST_OF_A_USER: usize = 24;

/// Counts the clients of each user.
pub(super) struct ConnectionLimiter(Arc<Shares<u32>>);

impl ConnectionLimiter {
    /// Nobody is connected.
    pub(super) fn new() -> Self {
        Self(Shares::new(MOST, MOST_OF_A_USER))
    }

    /// Admits one more client of a user, until what is returned is dropped.
    ///
    /// # Errors
    /// Which limit is reached, in words.
    pub(super) fn acquire(&self, user: u32) -> Result<Share<u32>, String> {
        self.0.take(user).map_err(|full| match full {
            Full::All => format!("{MOST} clients are connected, which is the limit"),
            Full::Own => {
                format!("{MOST_OF_A_USER} clients of user {user} are connected, which is the limit")
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_user_leaves_room_for_others_and_all_have_their_limit() {
        let limiter = ConnectionLimiter::new();
        let mut greedy: Vec<_> = (0..MOST_OF_A_USER)
            .map(|_| limiter.acquire(1000).unwrap())
            .collect();
        let refused = limiter.acquire(1000).err().unwrap();
        assert_eq!(
            refused,
            "24 clients of user 1000 are connected, which is the limit"
        );
        let others: Vec<_> = (0..8).map(|user| limiter.acquire(user).unwrap()).collect();
        let refused = limiter.acquire(8).err().unwrap();
        assert_eq!(refused, "32 clients are connected, which is the limit");
        // A client that disconnects frees its place.
        greedy.pop();
        greedy.push(limiter.acquire(1000).unwrap());
        drop((greedy, others));
        assert!(limiter.acquire(1000).is_ok());
    }
}
