//! What to do about a change: calibrate from the part of the session since then, but only where enough of it is left.

use super::super::session::Session;
use std::collections::BTreeSet;

/// How much of a session has to be left for a calibration that is worth a try.
#[derive(Clone, Copy, Debug)]
pub(super) struct Least {
    /// Placements that any camera saw.
    pub placements: usize,
    /// Views of each camera that the change concerns.
    pub views: usize,
}

impl Least {
    /// Whether enough is left from a placement on, of the session and of each of these cameras (indices in the
    /// session).
    pub(super) fn is_left(self, session: &Session, from: usize, cameras: &[usize]) -> bool {
        let since = || session.views.iter().filter(move |v| v.placement >= from);
        let placements: BTreeSet<usize> = since().map(|v| v.placement).collect();
        let views = |camera: usize| since().filter(|v| v.camera == camera).count();
        placements.len() >= self.placements && cameras.iter().all(|&c| views(c) >= self.views)
    }
}
