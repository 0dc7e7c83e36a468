//! Limits concurrent clients, in total and per user, so that one user cannot lock out the foot switch, which runs as
//! its own user.

use parking_lot::Mutex;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Limit of concurrent clients.
const MOST: usize = 32;
/// Limit of concurrent clients of one user.
const MOST_OF_A_USER: usize = 24;

/// Counts the clients of each user.
#[derive(Clone, Default)]
pub(super) struct ConnectionLimiter(Arc<Mutex<BTreeMap<u32, usize>>>);

/// The right of one client to be served; dropping it frees its place.
pub(super) struct Permit {
    limiter: ConnectionLimiter,
    user: u32,
}

impl ConnectionLimiter {
    /// Admits one more client of a user.
    ///
    /// # Errors
    /// Which limit is reached, in words.
    pub(super) fn acquire(&self, user: u32) -> Result<Permit, String> {
        let mut taken = self.0.lock();
        if taken.values().sum::<usize>() >= MOST {
            return Err(format!("{MOST} clients are connected, which is the limit"));
        }
        let own = taken.entry(user).or_default();
        if *own >= MOST_OF_A_USER {
            return Err(format!(
                "{MOST_OF_A_USER} clients of user {user} are connected, which is the limit"
            ));
        }
        *own += 1;
        Ok(Permit {
            limiter: self.clone(),
            user,
        })
    }
}

impl Drop for Permit {
    fn drop(&mut self) {
        let mut taken = self.limiter.0.lock();
        if let Some(own) = taken.get_mut(&self.user) {
            *own -= 1;
            if *own == 0 {
                taken.remove(&self.user);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_user_leaves_room_for_others_and_all_have_their_limit() {
        let limiter = ConnectionLimiter::default();
        let mut greedy: Vec<Permit> = (0..MOST_OF_A_USER)
            .map(|_| limiter.acquire(1000).unwrap())
            .collect();
        let refused = limiter.acquire(1000).err().unwrap();
        assert_eq!(
            refused,
            "24 clients of user 1000 are connected, which is the limit"
        );
        let others: Vec<Permit> = (0..8).map(|user| limiter.acquire(user).unwrap()).collect();
        let refused = limiter.acquire(8).err().unwrap();
        assert_eq!(refused, "32 clients are connected, which is the limit");
        // A client that disconnects frees its place.
        greedy.pop();
        greedy.push(limiter.acquire(1000).unwrap());
        drop((greedy, others));
        assert!(limiter.0.lock().is_empty());
    }
}
