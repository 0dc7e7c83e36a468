//! Places for clients: so many in all, and fewer for one user, so that who opens all that he may leaves room for the
//! foot switch, which is a user of its own.

use parking_lot::Mutex;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Most clients at a time.
const MOST: usize = 32;
/// Most clients of one user at a time.
const MOST_OF_A_USER: usize = 24;

/// How many clients each user has.
#[derive(Clone, Default)]
pub(super) struct Places(Arc<Mutex<BTreeMap<u32, usize>>>);

/// The place of a client, which is free again when this is dropped.
pub(super) struct Place {
    places: Places,
    user: u32,
}

impl Places {
    /// A place for one more client of a user.
    ///
    /// # Errors
    /// Why there is none, in words.
    pub(super) fn take(&self, user: u32) -> Result<Place, String> {
        let mut taken = self.0.lock();
        if taken.values().sum::<usize>() >= MOST {
            return Err(format!("{MOST} clients are served already"));
        }
        let own = taken.entry(user).or_default();
        if *own >= MOST_OF_A_USER {
            return Err(format!(
                "{MOST_OF_A_USER} clients of user {user} are served already"
            ));
        }
        *own += 1;
        Ok(Place {
            places: self.clone(),
            user,
        })
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let mut taken = self.places.0.lock();
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
        let places = Places::default();
        let mut greedy: Vec<Place> = (0..MOST_OF_A_USER)
            .map(|_| places.take(1000).unwrap())
            .collect();
        let refused = places.take(1000).err().unwrap();
        assert_eq!(refused, "24 clients of user 1000 are served already");
        let others: Vec<Place> = (0..8).map(|user| places.take(user).unwrap()).collect();
        let refused = places.take(8).err().unwrap();
        assert_eq!(refused, "32 clients are served already");
        // Who leaves makes room.
        greedy.pop();
        greedy.push(places.take(1000).unwrap());
        drop((greedy, others));
        assert!(places.0.lock().is_empty());
    }
}
