//! Pictures of the cameras for those who set up the rig: one connection to the daemon while somebody looks, whatever
//! the number of people, and what each camera showed last. The pictures pass through as the daemon wrote them; none is
//! decoded here, and none is kept when nobody looks.

use super::daemon::{Daemon, Error};
use super::models::Models;
use crate::trigger::{Event, Reply, Request};
use parking_lot::Mutex;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::time::{Duration, Instant};
use tokio::sync::watch;
use tokio::time::{sleep, timeout};

/// How long pictures are asked for after somebody asked to see them.
const LASTS: Duration = Duration::from_secs(5);
/// How long the daemon may take for its first reply.
const PATIENCE: Duration = Duration::from_secs(3);
/// Pause after the daemon refused, or was away.
const PAUSE: Duration = Duration::from_secs(1);
/// How long it is believed which capture was the last good one.
const GOOD: Duration = Duration::from_secs(if cfg!(test) { 1 } else { 10 });
/// Most cameras that are kept.
const MOST_CAMERAS: usize = 64;

/// What a camera showed last.
struct Shown {
    number: u64,
    heard: Instant,
    age_ms: u64,
    /// `picture`, `seen` and `words` as the daemon wrote them.
    content: Value,
}

/// What all cameras showed last.
pub(super) struct Look {
    state: Mutex<State>,
    /// A number that grows with each picture.
    changed: watch::Sender<u64>,
    /// Until when somebody looks.
    wanted: watch::Sender<Option<Instant>>,
}

#[derive(Default)]
struct State {
    cameras: BTreeMap<String, Shown>,
    /// Why there are no pictures.
    problem: Option<String>,
    /// How sharp each camera's picture was in the last capture with a green model, in percent.
    good: BTreeMap<String, u32>,
}

impl Look {
    pub(super) fn new() -> Self {
        Self {
            state: Mutex::default(),
            changed: watch::Sender::new(0),
            wanted: watch::Sender::new(None),
        }
    }

    /// What changed after the number `since`, as soon as something did, but after `at_most` in any case. A client
    /// that asks keeps the pictures coming for five seconds.
    pub(super) async fn after(&self, since: u64, at_most: Duration) -> Value {
        self.wanted.send_replace(Some(Instant::now() + LASTS));
        let mut changed = self.changed.subscribe();
        // A number of an earlier process counts for nothing.
        let since = Some(since).filter(|since| since <= &*changed.borrow());
        let since = since.unwrap_or(0);
        let _ = timeout(at_most, changed.wait_for(|number| *number > since)).await;
        let state = self.state.lock();
        let number = *self.changed.borrow();
        let newer = state
            .cameras
            .iter()
            .filter(|(_, shown)| shown.number > since);
        let cameras: serde_json::Map<String, Value> = newer
            .map(|(camera, shown)| {
                let mut content = shown.content.clone();
                let age_ms = shown.age_ms + shown.heard.elapsed().as_millis() as u64;
                content["age_ms"] = age_ms.into();
                (camera.clone(), content)
            })
            .collect();
        json!({ "number": number, "problem": state.problem, "cameras": cameras, "good": state.good })
    }

    /// Asks the daemon for pictures while somebody looks, for ever.
    pub(super) async fn keep(&self, daemon: &Daemon, models: &Models) {
        let mut wanted = self.wanted.subscribe();
        loop {
            if wanted
                .wait_for(|until| left(*until).is_some())
                .await
                .is_err()
            {
                return;
            }
            self.read_good(models).await;
            let ended = tokio::select! {
                ended = self.listen(daemon) => ended,
                () = self.keep_good(models) => Ok(()),
            };
            let has_failed = ended.is_err();
            self.forget(ended.err());
            if has_failed {
                sleep(PAUSE).await;
            }
        }
    }

    /// Reads how sharp the pictures of the last good capture were, for ever: it may be one that is taken while somebody
    /// looks.
    async fn keep_good(&self, models: &Models) {
        loop {
            sleep(GOOD).await;
            self.read_good(models).await;
        }
    }

    async fn read_good(&self, models: &Models) {
        let models = models.clone();
        let good = tokio::task::spawn_blocking(move || models.good_sharpness()).await;
        self.state.lock().good = good.unwrap_or_default();
    }

    /// Drops all pictures, and keeps why there are no more.
    fn forget(&self, problem: Option<Error>) {
        let mut state = self.state.lock();
        state.cameras.clear();
        state.problem = problem.map(|error| error.to_string());
        drop(state);
        self.changed.send_modify(|number| *number += 1);
    }

    /// Listens to the daemon's pictures until nobody looks any more.
    async fn listen(&self, daemon: &Daemon) -> Result<(), Error> {
        let mut connection = daemon.open().await?;
        match connection.ask(&Request::Look {}, PATIENCE).await? {
            Reply::Looking => self.state.lock().problem = None,
            reply @ Reply::Refused { .. } => {
                let refused = daemon.refused(&mut connection, reply).await;
                // Why a daemon cannot start names files, and who looks may be a viewer.
                return Err(match daemon.is_stopped() {
                    true => Error::Away(std::io::ErrorKind::ConnectionReset.into()),
                    false => refused,
                });
            }
            reply => {
                return Err(Error::Senseless(
                    format!("{reply:?}").chars().take(200).collect(),
                ));
            }
        }
        loop {
            let event = connection.event();
            tokio::pin!(event);
            let event = loop {
                let Some(left) = left(*self.wanted.borrow()) else {
                    return Ok(());
                };
                if let Ok(event) = timeout(left, &mut event).await {
                    break event;
                }
            };
            self.show(event?)?;
        }
    }

    fn show(&self, event: Event) -> Result<(), Error> {
        let Event::Looked {
            camera,
            age_ms,
            picture,
            seen,
            words,
        } = event
        else {
            return Err(Error::Away(std::io::ErrorKind::ConnectionReset.into()));
        };
        let mut state = self.state.lock();
        if state.cameras.len() < MOST_CAMERAS || state.cameras.contains_key(&camera) {
            let shown = Shown {
                number: *self.changed.borrow() + 1,
                heard: Instant::now(),
                age_ms,
                content: json!({ "picture": picture, "seen": seen, "words": words }),
            };
            state.cameras.insert(camera, shown);
        }
        drop(state);
        self.changed.send_modify(|number| *number += 1);
        Ok(())
    }
}

/// How long somebody looks yet.
fn left(until: Option<Instant>) -> Option<Duration> {
    let left = until?.saturating_duration_since(Instant::now());
    (!left.is_zero()).then_some(left)
}
