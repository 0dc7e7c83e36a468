//! Which camera is looked at next: the one that waits longest, and none more often than twice a second. It only
//! decides.

use crate::frame::CameraId;
use std::collections::BTreeMap;
use std::time::{Duration, Instant};

/// Shortest time between two pictures of a camera.
pub(super) const PERIOD: Duration = Duration::from_millis(500);

/// When each camera was looked at last.
#[derive(Debug, Default)]
pub(in crate::daemon) struct Turns(BTreeMap<CameraId, Instant>);

impl Turns {
    /// Whose turn is next of `cameras`, and when; `None` of none. One that was not looked at yet comes first, else the
    /// one whose last picture is the oldest.
    pub(in crate::daemon) fn next<'a>(
        &self,
        cameras: impl Iterator<Item = &'a CameraId>,
        now: Instant,
    ) -> Option<(CameraId, Instant)> {
        let next = cameras.min_by_key(|id| self.0.get(*id).copied())?;
        let due = self.0.get(next).map_or(now, |last| *last + PERIOD);
        Some((next.clone(), due))
    }

    /// Notes that a camera is looked at now.
    pub(in crate::daemon) fn note(&mut self, camera: CameraId, now: Instant) {
        self.0.insert(camera, now);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cameras_take_turns_and_none_comes_more_often_than_twice_a_second() {
        let ids: Vec<CameraId> = ["a", "b", "c"].map(|id| CameraId::new(id).unwrap()).into();
        let begin = Instant::now();
        let mut now = begin;
        let mut turns = Turns::default();
        let mut seen = Vec::new();
        while now < begin + Duration::from_secs(2) {
            let (next, due) = turns.next(ids.iter(), now).unwrap();
            if due <= now {
                seen.push((next.clone(), now));
                turns.note(next, now);
            }
            now += Duration::from_millis(10);
        }
        let order: Vec<&str> = seen.iter().take(4).map(|(id, _)| id.as_str()).collect();
        assert_eq!(order, ["a", "b", "c", "a"]);
        for id in &ids {
            let times: Vec<Instant> = seen
                .iter()
                .filter(|(s, _)| s == id)
                .map(|(_, t)| *t)
                .collect();
            assert_eq!(times.len(), 4);
            assert!(times.windows(2).all(|pair| pair[1] - pair[0] >= PERIOD));
        }
        assert!(turns.next([].iter(), now).is_none());
    }
}
