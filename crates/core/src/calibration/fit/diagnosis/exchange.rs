//! Tests whether cameras are, after a change, where other cameras were before it. Then the cables or names of two
//! cameras, or of several in a ring, were exchanged. An exchange is found only if the session has no fault once it is
//! undone.

use super::super::outliers::LEAST_USUAL;
use super::super::result::Fit;
use super::super::session::Session;
use super::super::{Parameters, solve};
use super::split::{Split, is_near};
use super::suspects::{Reference, quick};

/// Cameras that were exchanged with each other.
pub(super) struct Exchange {
    /// Each camera, and the one that it shows from then on what that showed before; indices in the session.
    pub shows: Vec<[usize; 2]>,
    /// Index of one of their splits.
    pub split: usize,
}

impl Exchange {
    pub(super) fn takes_part(&self, camera: usize) -> bool {
        self.shows.iter().any(|[own, _]| *own == camera)
    }
}

/// Most cameras whose orders are tried where the reference itself may be one of them.
const MOST_CAMERAS: usize = 5;

/// Part of a session's views that may not fit after an exchange was undone.
const MOST_LEFT_OUT: f64 = 0.1;
/// How many times the residuals of the reference those of the session may then be.
const AS_USUAL: f64 = 2.0;

/// The first exchange among these changes, if there is one.
pub(super) fn of(
    reference: &Reference,
    splits: &[Split],
    parameters: &Parameters,
) -> Option<Exchange> {
    let rings = (0..splits.len()).filter_map(|first| ring(splits, first));
    let mut candidates = rings.chain(with_reference(reference, splits));
    candidates.find(|found| is_confirmed(reference, found, splits, parameters))
}

/// Whether the session has no fault of these cameras once the exchange is undone.
fn is_confirmed(
    reference: &Reference,
    found: &Exchange,
    splits: &[Split],
    parameters: &Parameters,
) -> bool {
    let undone = undone(reference.session, found, splits[found.split].first_late);
    let Ok(fit) = solve::fit(&undone, &quick(parameters)) else {
        return false;
    };
    let usual = reference.fit.figures.median_px.max(LEAST_USUAL);
    let is_sound = |[own, _]: &[usize; 2]| is_sound(&fit, reference, *own, usual);
    found.shows.iter().all(is_sound)
}

/// Whether a camera has kept its views, with residuals as are `usual` in pixels.
fn is_sound(fit: &Fit, reference: &Reference, camera: usize, usual: f64) -> bool {
    let id = reference.id(camera);
    let fitted = fit.cameras.iter().find(|c| c.camera.id == *id);
    fitted.is_some_and(|own| {
        fit.left_out_share_of(own).part() <= MOST_LEFT_OUT
            && own.figures.median_px <= AS_USUAL * usual
    })
}

/// The session with the views from a placement on under the names of the cameras that they are of.
fn undone(session: &Session, found: &Exchange, from: usize) -> Session {
    let mut undone = session.clone();
    for view in undone.views.iter_mut().filter(|v| v.placement >= from) {
        let shows = found.shows.iter().find(|[own, _]| *own == view.camera);
        view.camera = shows.map_or(view.camera, |[_, as_before]| *as_before);
    }
    undone
}

/// The ring of cameras that the change `first` begins: each is after it where the next was before it.
fn ring(splits: &[Split], first: usize) -> Option<Exchange> {
    let mut members = vec![first];
    loop {
        let split = &splits[*members.last()?];
        let takes_place_of = |other: &&Split| {
            other.camera != split.camera
                && split.overlaps(other)
                && is_near(split.late(), other.early(), split.distance())
        };
        let next = splits.iter().find(takes_place_of)?;
        let next = splits.iter().position(|s| s.camera == next.camera)?;
        if next == first {
            break;
        }
        if members.contains(&next) {
            return None;
        }
        members.push(next);
    }
    let camera = |k: usize| splits[members[k % members.len()]].camera;
    Some(Exchange {
        shows: (0..members.len())
            .map(|k| [camera(k), camera(k + 1)])
            .collect(),
        split: first,
    })
}

/// Where the reference is a single camera, it may take part: then all others seem to move.
fn with_reference(reference: &Reference, splits: &[Split]) -> Option<Exchange> {
    let [held] = reference.cameras.as_slice() else {
        return None;
    };
    let first = splits.first()?;
    if splits.len() + 1 > MOST_CAMERAS || !splits.iter().all(|s| s.overlaps(first)) {
        return None;
    }
    // From each camera to the rig before the change: the reference, then the others.
    let rig_from_held = reference.fit.cameras.first()?.camera.rig_from_camera;
    let mut early = vec![rig_from_held];
    early.extend(splits.iter().map(|s| s.early().inverse()));
    // The rig is where the reference's pictures put it.
    let fits = |order: &[usize]| {
        let moved = |(k, split): (usize, &Split)| {
            let seen = rig_from_held * early[order[0]].inverse() * early[order[k + 1]];
            is_near(&seen.inverse(), split.late(), split.distance())
        };
        order[0] != 0 && splits.iter().enumerate().all(moved)
    };
    let order = permutations(early.len())
        .into_iter()
        .find(|order| fits(order))?;
    let camera = |k: usize| match k {
        0 => *held,
        k => splits[k - 1].camera,
    };
    let shows = order.iter().enumerate().filter(|(k, place)| k != *place);
    Some(Exchange {
        shows: shows
            .map(|(k, &place)| [camera(k), camera(place)])
            .collect(),
        split: 0,
    })
}

/// All permutations of this many things.
fn permutations(count: usize) -> Vec<Vec<usize>> {
    let mut all: Vec<Vec<usize>> = vec![Vec::new()];
    for _ in 0..count {
        let longer = |order: &Vec<usize>| {
            let free = (0..count).filter(|k| !order.contains(k));
            let order = order.clone();
            free.map(|k| [order.clone(), vec![k]].concat())
                .collect::<Vec<_>>()
        };
        all = all.iter().flat_map(longer).collect();
    }
    all
}
