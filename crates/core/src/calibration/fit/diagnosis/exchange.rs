//! Tests whether cameras are, after a change, where other cameras were before it. Then the cables or names of two
//! cameras, or of several in a ring, were exchanged, for good or until they were put back. An exchange is found only if
//! the session has no fault once it is undone.

use super::super::outliers::LEAST_USUAL;
use super::super::result::Fit;
use super::super::session::{Session, View};
use super::super::{Parameters, solve};
use super::split::{Split, is_near};
use super::suspects::{Reference, quick};

/// Cameras that were exchanged with each other.
pub(super) struct Exchange {
    /// Each camera, and the one that it shows from then on what that showed before; indices in the session.
    pub shows: Vec<[usize; 2]>,
    /// Index of one of their splits.
    pub split: usize,
    /// Index of that camera's split after which all of them are as before, if there is one.
    pub back: Option<usize>,
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
    let from = splits[found.split].first_late;
    let until = found.back.map(|back| splits[back].first_late);
    let undone = undone(reference.session, found, from, until);
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

/// The session with the views from a placement on, or those before `until`, under the names of the cameras that they
/// are of.
fn undone(session: &Session, found: &Exchange, from: usize, until: Option<usize>) -> Session {
    let mut undone = session.clone();
    let is_exchanged =
        |v: &&mut View| v.placement >= from && until.is_none_or(|until| v.placement < until);
    for view in undone.views.iter_mut().filter(is_exchanged) {
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
        let takes_place_of = |other: &Split| {
            other.camera != split.camera
                && split.overlaps(other)
                && is_near(split.late(), other.early(), split.distance())
        };
        let next = splits.iter().position(takes_place_of)?;
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
        back: put_back(splits, &members).and_then(|back| back.first().copied()),
    })
}

/// The splits, one of the camera of each of these, after which all cameras are where they were before them; `None` if
/// they are not all put back at once.
fn put_back(splits: &[Split], members: &[usize]) -> Option<Vec<usize>> {
    let undoing = |&member: &usize| {
        let out = &splits[member];
        let undoes = |s: &Split| {
            s.camera == out.camera
                && s.first_late > out.first_late
                && is_near(s.late(), out.early(), out.distance())
        };
        splits.iter().position(undoes)
    };
    let back: Vec<usize> = members.iter().map(undoing).collect::<Option<_>>()?;
    let first = &splits[*back.first()?];
    let is_at_once = back.iter().all(|&k| splits[k].overlaps(first));
    is_at_once.then_some(back)
}

/// Where the reference is a single camera, it may take part: then all others seem to move.
fn with_reference(reference: &Reference, splits: &[Split]) -> Option<Exchange> {
    let [held] = reference.cameras.as_slice() else {
        return None;
    };
    let first = splits.first()?;
    let members: Vec<usize> = (0..splits.len())
        .filter(|&k| splits[k].overlaps(first))
        .collect();
    let back = put_back(splits, &members);
    let explained = members.len() + back.as_ref().map_or(0, Vec::len);
    if members.len() + 1 > MOST_CAMERAS || explained != splits.len() {
        return None;
    }
    let changes: Vec<&Split> = members.iter().map(|&k| &splits[k]).collect();
    // From each camera to the rig before the change: the reference, then the others.
    let rig_from_held = reference.fit.cameras.first()?.camera.rig_from_camera;
    let mut early = vec![rig_from_held];
    early.extend(changes.iter().map(|s| s.early().inverse()));
    // The rig is where the reference's pictures put it.
    let fits = |order: &[usize]| {
        let moved = |(k, split): (usize, &&Split)| {
            let seen = rig_from_held * early[order[0]].inverse() * early[order[k + 1]];
            is_near(&seen.inverse(), split.late(), split.distance())
        };
        order[0] != 0 && changes.iter().enumerate().all(moved)
    };
    let order = permutations(early.len())
        .into_iter()
        .find(|order| fits(order))?;
    let camera = |k: usize| match k {
        0 => *held,
        k => changes[k - 1].camera,
    };
    let shows = order.iter().enumerate().filter(|(k, place)| k != *place);
    Some(Exchange {
        shows: shows
            .map(|(k, &place)| [camera(k), camera(place)])
            .collect(),
        split: 0,
        back: back.and_then(|back| back.first().copied()),
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
