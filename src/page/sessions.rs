//! Who may look and press: sessions, and the tokens that begin them. Only hashes are kept, in a file that only its
//! owner can read. Tokens that begin a session live in memory, for ten minutes, and work once.

use super::secrets::{Hash, new_secret};
use crate::storage::{self, write_atomically_for_owner};
use parking_lot::Mutex;
use std::collections::{BTreeMap, VecDeque};
use std::net::IpAddr;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// How long a link waits for its one use.
const PAIRING: Duration = Duration::from_secs(600);
/// Links that may wait at a time.
const MOST_PAIRINGS: usize = 16;
/// Sessions that may last at a time.
const MOST_SESSIONS: usize = 200;
/// Wrong tokens of one client, and of all, that are looked at within [`WINDOW`]; any further one is refused unseen.
const MOST_TRIES: usize = 20;
const MOST_TRIES_OF_ALL: usize = 200;
const WINDOW: Duration = Duration::from_secs(60);
/// Largest file of sessions that is read, in bytes.
const LARGEST_FILE: u64 = 1 << 20;
const FILE: &str = "sessions.json";

/// What somebody may do.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// Look at everything, change nothing.
    Viewer,
    /// Look, press, take plates, begin and close sessions, and note.
    Operator,
    /// Read `/metrics`, and nothing else.
    Metrics,
}

/// A session as it is kept.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct StoredSession {
    hash: Hash,
    role: Role,
    begun_s: u64,
    ends_s: u64,
}

/// A session as a list shows it.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Listed {
    /// A short name of it, for `scand page revoke`.
    pub id: String,
    /// What it may do.
    pub role: Role,
    /// Seconds until it ends by itself.
    pub left_s: u64,
}

/// Why a session cannot begin.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub(super) enum Error {
    #[error("the link is not valid: it was used, is older than ten minutes, or was never made")]
    Unknown,
    #[error("there were {MOST_TRIES} wrong tries within a minute: wait a minute")]
    TooManyTries,
    #[error("{MOST_PAIRINGS} links are still unused: use one, or wait ten minutes")]
    TooManyPairings,
    #[error("{MOST_SESSIONS} sessions are open: end some with `scand page revoke`")]
    TooManySessions,
    #[error("the system gave no random bytes for a link or a session: {0}")]
    Random(std::io::Error),
    #[error(transparent)]
    Storage(#[from] storage::Error),
    #[error("{}: {cause}", path.display())]
    Read { path: PathBuf, cause: String },
}

/// All sessions and links.
pub(super) struct Sessions {
    path: PathBuf,
    operator: Duration,
    viewer: Duration,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    sessions: Vec<StoredSession>,
    pairings: BTreeMap<Hash, (Role, Instant)>,
    /// When a wrong token came, and from where.
    wrong: VecDeque<(Instant, IpAddr)>,
}

/// The time as the file has it.
fn now_s() -> u64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    since.unwrap_or_default().as_secs()
}

impl Sessions {
    /// The sessions kept in a folder; those of operators and viewers last so long.
    ///
    /// # Errors
    /// If the file of sessions is not one: it is not replaced, for that would end sessions unasked.
    pub(super) fn open(folder: &Path, operator: Duration, viewer: Duration) -> Result<Self, Error> {
        let path = folder.join(FILE);
        let sessions = read(&path)?;
        Ok(Self {
            path,
            operator,
            viewer,
            state: Mutex::new(State {
                sessions,
                ..State::default()
            }),
        })
    }

    /// A token that begins one session of this role within ten minutes.
    pub(super) fn pair(&self, role: Role) -> Result<String, Error> {
        let mut state = self.state.lock();
        state
            .pairings
            .retain(|_, (_, made)| made.elapsed() < PAIRING);
        if state.pairings.len() >= MOST_PAIRINGS {
            return Err(Error::TooManyPairings);
        }
        let token = new_secret().map_err(Error::Random)?;
        state
            .pairings
            .insert(Hash::of(&token), (role, Instant::now()));
        Ok(token)
    }

    /// Takes a client's token for a session: its secret, its role and how long it lasts.
    pub(super) fn begin(
        &self,
        token: &str,
        client: IpAddr,
    ) -> Result<(String, Role, Duration), Error> {
        let mut state = self.state.lock();
        state.wrong.retain(|(at, _)| at.elapsed() <= WINDOW);
        let own = state.wrong.iter().filter(|(_, of)| *of == client).count();
        if own >= MOST_TRIES || state.wrong.len() >= MOST_TRIES_OF_ALL {
            return Err(Error::TooManyTries);
        }
        let hash = Hash::of(token);
        let waiting = state.pairings.get(&hash).copied();
        let Some((role, _)) = waiting.filter(|(_, made)| made.elapsed() < PAIRING) else {
            state.pairings.remove(&hash);
            state.wrong.push_back((Instant::now(), client));
            return Err(Error::Unknown);
        };
        let lasts = if role == Role::Operator {
            self.operator
        } else {
            self.viewer
        };
        // Only then is the link used up: where no session can begin, it works once that is mended.
        let secret = self.add(&mut state, role, lasts)?;
        state.pairings.remove(&hash);
        Ok((secret, role, lasts))
    }

    /// A token for `/metrics`, which holds until it is revoked.
    pub(super) fn metrics(&self) -> Result<String, Error> {
        let lasts = Duration::from_secs(u64::from(u32::MAX));
        self.add(&mut self.state.lock(), Role::Metrics, lasts)
    }

    fn add(&self, state: &mut State, role: Role, lasts: Duration) -> Result<String, Error> {
        let now = now_s();
        let mut sessions = state.sessions.clone();
        sessions.retain(|kept| kept.ends_s > now);
        if sessions.len() >= MOST_SESSIONS {
            return Err(Error::TooManySessions);
        }
        let secret = new_secret().map_err(Error::Random)?;
        sessions.push(StoredSession {
            hash: Hash::of(&secret),
            role,
            begun_s: now,
            ends_s: now.saturating_add(lasts.as_secs()),
        });
        self.write(&sessions)?;
        state.sessions = sessions;
        Ok(secret)
    }

    /// The role of a session that lasts.
    pub(super) fn role(&self, secret: &str) -> Option<Role> {
        let (hash, now) = (Hash::of(secret), now_s());
        let state = self.state.lock();
        // A clock that was set back makes no session longer than it was given.
        let lasts = |kept: &&StoredSession| {
            kept.hash == hash && kept.begun_s <= now + 300 && now < kept.ends_s
        };
        state.sessions.iter().find(lasts).map(|kept| kept.role)
    }

    /// Ends the sessions that a list calls by this name, or all of them; the number of those.
    pub(super) fn revoke(&self, id: Option<&str>) -> Result<usize, Error> {
        let mut state = self.state.lock();
        if id.is_none() {
            state.pairings.clear();
        }
        self.end(&mut state, |kept| {
            id.is_none_or(|id| kept.hash.name() == id)
        })
    }

    fn end(
        &self,
        state: &mut State,
        is_meant: impl Fn(&StoredSession) -> bool,
    ) -> Result<usize, Error> {
        let mut stays = state.sessions.clone();
        stays.retain(|kept| !is_meant(kept));
        let ended = state.sessions.len() - stays.len();
        self.write(&stays)?;
        state.sessions = stays;
        Ok(ended)
    }

    /// Ends one session by its secret.
    pub(super) fn leave(&self, secret: &str) -> Result<usize, Error> {
        let hash = Hash::of(secret);
        self.end(&mut self.state.lock(), |kept| kept.hash == hash)
    }

    /// The sessions that last.
    pub(super) fn list(&self) -> Vec<Listed> {
        let now = now_s();
        let state = self.state.lock();
        let lasting = state.sessions.iter().filter(|kept| kept.ends_s > now);
        let listed = lasting.map(|kept| Listed {
            id: kept.hash.name().into(),
            role: kept.role,
            left_s: kept.ends_s - now,
        });
        listed.collect()
    }

    /// Every session and link is as old as it may become.
    #[cfg(test)]
    pub(super) fn expire_all(&self) {
        let mut state = self.state.lock();
        for session in &mut state.sessions {
            session.ends_s = now_s();
        }
        for (_, made) in state.pairings.values_mut() {
            *made = made.checked_sub(PAIRING).unwrap();
        }
    }

    fn write(&self, sessions: &[StoredSession]) -> Result<(), Error> {
        let text = serde_json::to_string_pretty(sessions).unwrap_or_default();
        Ok(write_atomically_for_owner(&self.path, text.as_bytes())?)
    }
}

fn read(path: &Path) -> Result<Vec<StoredSession>, Error> {
    let wrong = |cause: String| Error::Read {
        path: path.into(),
        cause,
    };
    match std::fs::metadata(path) {
        Err(cause) if cause.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(cause) => return Err(wrong(cause.to_string())),
        Ok(found) if found.len() > LARGEST_FILE => return Err(wrong("it is too large".into())),
        Ok(_) => {}
    }
    let text = std::fs::read_to_string(path).map_err(|cause| wrong(cause.to_string()))?;
    serde_json::from_str(&text).map_err(|cause| wrong(cause.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::Ipv4Addr;
    use std::os::unix::fs::PermissionsExt;

    const HOUR: Duration = Duration::from_secs(3600);
    const CLIENT: IpAddr = IpAddr::V4(Ipv4Addr::LOCALHOST);

    fn open(folder: &Path) -> Sessions {
        Sessions::open(folder, HOUR, 2 * HOUR).unwrap()
    }

    #[test]
    fn a_link_begins_one_session_which_survives_a_restart_until_it_is_revoked() {
        let folder = tempfile::tempdir().unwrap();
        let sessions = open(folder.path());
        let token = sessions.pair(Role::Viewer).unwrap();
        let (secret, role, lasts) = sessions.begin(&token, CLIENT).unwrap();
        assert_eq!((role, lasts), (Role::Viewer, 2 * HOUR));
        assert!(matches!(
            sessions.begin(&token, CLIENT),
            Err(Error::Unknown)
        ));
        let again = open(folder.path());
        assert_eq!(again.role(&secret), Some(Role::Viewer));
        assert_eq!(again.role(&token), None);
        let id = again.list().remove(0).id;
        assert_eq!(again.revoke(Some("00000000")).unwrap(), 0);
        assert_eq!(again.revoke(Some(&id)).unwrap(), 1);
        assert_eq!(again.role(&secret), None);
        assert_eq!(open(folder.path()).role(&secret), None);
    }

    #[test]
    fn the_file_has_no_secret_and_is_its_owners_alone() {
        let folder = tempfile::tempdir().unwrap();
        let sessions = open(folder.path());
        let token = sessions.pair(Role::Operator).unwrap();
        let (secret, ..) = sessions.begin(&token, CLIENT).unwrap();
        let bearer = sessions.metrics().unwrap();
        let path = folder.path().join(FILE);
        let text = std::fs::read_to_string(&path).unwrap();
        for hidden in [&token, &secret, &bearer] {
            assert!(!text.contains(hidden.as_str()));
        }
        let mode = std::fs::metadata(&path).unwrap().permissions().mode();
        assert_eq!(mode & 0o777, 0o600);
        // A file that was damaged is not taken for an empty one.
        std::fs::write(&path, "[{").unwrap();
        assert!(Sessions::open(folder.path(), HOUR, HOUR).is_err());
    }

    #[test]
    fn an_expired_session_and_one_of_the_future_are_none() {
        let folder = tempfile::tempdir().unwrap();
        let sessions = open(folder.path());
        let secret = sessions.metrics().unwrap();
        sessions.state.lock().sessions[0].ends_s = now_s();
        assert_eq!(sessions.role(&secret), None);
        assert!(sessions.list().is_empty());
        let secret = sessions.metrics().unwrap();
        sessions.state.lock().sessions[0].begun_s = now_s() + 3600;
        assert_eq!(sessions.role(&secret), None);
    }

    #[test]
    fn a_link_that_is_older_than_ten_minutes_begins_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let sessions = open(folder.path());
        let token = sessions.pair(Role::Operator).unwrap();
        sessions.expire_all();
        assert!(matches!(
            sessions.begin(&token, CLIENT),
            Err(Error::Unknown)
        ));
        assert!(sessions.list().is_empty());
    }

    #[test]
    fn a_link_that_could_begin_no_session_is_not_used_up() {
        let folder = tempfile::tempdir().unwrap();
        let sessions = open(folder.path());
        let token = sessions.pair(Role::Viewer).unwrap();
        let kept = vec![
            StoredSession {
                hash: Hash::of("another"),
                role: Role::Viewer,
                begun_s: now_s(),
                ends_s: now_s() + 3600,
            };
            MOST_SESSIONS
        ];
        sessions.state.lock().sessions = kept;
        let full = sessions.begin(&token, CLIENT);
        assert!(matches!(full, Err(Error::TooManySessions)));
        sessions.state.lock().sessions.clear();
        sessions.begin(&token, CLIENT).unwrap();
        assert!(matches!(
            sessions.begin(&token, CLIENT),
            Err(Error::Unknown)
        ));
    }

    #[test]
    fn guesses_are_limited_and_so_are_links() {
        let folder = tempfile::tempdir().unwrap();
        let sessions = open(folder.path());
        let token = sessions.pair(Role::Operator).unwrap();
        for n in 0..MOST_TRIES {
            assert!(matches!(
                sessions.begin(&format!("{n}"), CLIENT),
                Err(Error::Unknown)
            ));
        }
        let own = sessions.begin(&token, CLIENT);
        assert!(matches!(own, Err(Error::TooManyTries)));
        // Who guesses keeps out nobody else.
        let other = |n: u8| IpAddr::V4(Ipv4Addr::new(10, 0, 0, n));
        sessions.begin(&token, other(0)).unwrap();
        for n in 0..MOST_TRIES_OF_ALL - MOST_TRIES {
            let client = other(1 + (n / MOST_TRIES) as u8);
            let guess = sessions.begin(&format!("{n}"), client);
            assert!(matches!(guess, Err(Error::Unknown)));
        }
        let all = sessions.begin("guess", other(100));
        assert!(matches!(all, Err(Error::TooManyTries)));
        sessions.pair(Role::Operator).unwrap();
        for _ in 1..MOST_PAIRINGS {
            sessions.pair(Role::Viewer).unwrap();
        }
        let more = sessions.pair(Role::Viewer);
        assert!(matches!(more, Err(Error::TooManyPairings)));
    }
}
