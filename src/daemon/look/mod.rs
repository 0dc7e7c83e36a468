//! Looking at the cameras while a rig is set up: who looks, and what each camera showed last. Nothing of it is recorded
//! or written to a disk. `maker` has the pictures made in a confined process, `turns` decides which camera is next, and
//! the capturing thread takes the frames between captures. design/page.md has the reasons.

pub mod protocol;

mod base64;
mod maker;
mod measured;
#[cfg(test)]
mod tests;
mod turns;

pub use maker::LookPlan;
pub(super) use maker::{LookMaker, LookTask};
pub(super) use turns::Turns;

use crate::clock::Clock;
use crate::frame::{CameraId, Timestamp};
use crate::trigger::{Event, LookFigures};
use parking_lot::Mutex;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use tokio::sync::watch;

/// What the capturing thread looks with.
pub(super) struct LookScheduler {
    pub(super) looks: Looks,
    /// `None` where nobody can look.
    pub(super) maker: Option<LookMaker>,
    pub(super) turns: Turns,
    /// Why a camera's looks are whole although they were to be binned, as it was last told of each.
    pub(super) told: BTreeMap<CameraId, String>,
}

impl LookScheduler {
    /// Why a camera's looks are whole, if that is new.
    pub(super) fn new_reason<'a>(
        &mut self,
        camera: &CameraId,
        why: Option<&'a str>,
    ) -> Option<&'a str> {
        let why = why.filter(|why| self.told.get(camera).is_none_or(|told| told != why))?;
        self.told.insert(camera.clone(), why.to_owned());
        Some(why)
    }
}

/// What a camera showed last.
#[derive(Clone, Debug)]
pub(super) struct CameraLook {
    /// When it was exposed, or asked.
    pub(super) time: Timestamp,
    /// The picture, a JPEG, and what is seen in it; or why there is none.
    pub(super) outcome: Result<(Vec<u8>, LookFigures), String>,
}

/// What all cameras showed last, shared by those who take the pictures and those who look.
#[derive(Clone)]
pub(super) struct Looks(Arc<Shared>);

struct Shared {
    clock: Clock,
    lookers: AtomicUsize,
    /// By camera, with a number that grows.
    newest: Mutex<BTreeMap<String, (u64, Arc<CameraLook>)>>,
    changed: watch::Sender<u64>,
}

impl Looks {
    pub(super) fn new(clock: Clock) -> Self {
        Self(Arc::new(Shared {
            clock,
            lookers: AtomicUsize::new(0),
            newest: Mutex::default(),
            changed: watch::Sender::new(0),
        }))
    }

    /// The clock that pictures are stamped by.
    pub(super) fn clock(&self) -> Clock {
        self.0.clock
    }

    /// How many look.
    pub(super) fn count(&self) -> usize {
        self.0.lookers.load(Ordering::Acquire)
    }

    /// Looks, until what is returned is dropped.
    pub(super) fn begin(&self) -> LookSubscription {
        self.0.lookers.fetch_add(1, Ordering::AcqRel);
        LookSubscription {
            changed: self.0.changed.subscribe(),
            looks: self.clone(),
            told: BTreeMap::new(),
        }
    }

    /// Shows what a camera showed, if somebody still looks. A message that says the same as the last one is not told
    /// again.
    pub(super) fn show(&self, camera: &str, look: CameraLook) {
        let mut newest = self.0.newest.lock();
        if self.count() == 0 {
            return;
        }
        let before = newest.get(camera).map(|(_, look)| &look.outcome);
        if let (Some(Err(before)), Err(now)) = (before, &look.outcome)
            && before == now
        {
            return;
        }
        let number = *self.0.changed.borrow() + 1;
        newest.insert(camera.to_owned(), (number, Arc::new(look)));
        drop(newest);
        self.0.changed.send_replace(number);
    }
}

/// Somebody who looks. A slow one misses pictures, and holds up nobody.
pub(super) struct LookSubscription {
    looks: Looks,
    changed: watch::Receiver<u64>,
    /// For each camera, the number of the message that was sent last.
    told: BTreeMap<String, u64>,
}

impl LookSubscription {
    /// The next picture that was not sent yet, of the camera whose last one was sent longest ago.
    pub(super) async fn next(&mut self) -> Event {
        loop {
            self.changed.mark_unchanged();
            if let Some(event) = self.untold() {
                return event;
            }
            if self.changed.changed().await.is_err() {
                return std::future::pending().await;
            }
        }
    }

    fn untold(&mut self) -> Option<Event> {
        let shared = &self.looks.0;
        let newest = shared.newest.lock();
        let told = |camera: &str| self.told.get(camera).copied().unwrap_or(0);
        let untold = newest
            .iter()
            .filter(|(camera, (number, _))| *number > told(camera));
        let (camera, (number, look)) = untold.min_by_key(|(camera, _)| told(camera))?;
        let (camera, number, look) = (camera.clone(), *number, look.clone());
        drop(newest);
        let age_ns = shared.clock.timestamp().nanoseconds_since(look.time).max(0);
        self.told.insert(camera.clone(), number);
        let (picture, seen, words) = match &look.outcome {
            Ok((picture, seen)) => (Some(base64::encode(picture)), Some(seen.clone()), None),
            Err(words) => (None, None, Some(words.clone())),
        };
        Some(Event::Looked {
            camera,
            age_ms: (age_ns / 1_000_000) as u64,
            picture,
            seen: seen.map(Box::new),
            words,
        })
    }
}

impl Drop for LookSubscription {
    /// What the last one leaves is forgotten, so that the next one sees no old picture.
    fn drop(&mut self) {
        let mut newest = self.looks.0.newest.lock();
        if self.looks.0.lookers.fetch_sub(1, Ordering::AcqRel) == 1 {
            newest.clear();
        }
    }
}
