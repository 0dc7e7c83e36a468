//! Finds cameras of which only the last view, or only the first one, shows the board elsewhere than the other cameras
//! do. One view is not enough to tell whether the camera was moved or the picture was taken at another moment, so the
//! finding says what may have happened, and what to show the camera next. Where only two cameras saw the board, it may
//! have been either of them.

use super::super::outliers::{DISAGREE, ELSEWHERE};
use super::super::readings::{FAR, UNDECIDED};
use super::super::result::{Fit, LeftOut};
use super::super::session::Session;
use super::Finding;
use super::advice::Least;
use crate::frame::CameraId;

/// The cameras that may have been moved before their last view, or after their first.
pub(super) fn of(session: &Session, fit: &Fit, least: Least) -> Vec<Finding> {
    let cameras = session.cameras.iter().enumerate();
    let found = cameras.filter_map(|(index, camera)| {
        let lone = lone_view(fit, &camera.id)?;
        let end = SessionEnd::of(session, index, lone.placement.as_ref()?)?;
        Some(of_view(session, index, lone, end, least))
    });
    let mut findings: Vec<Finding> = Vec::new();
    for finding in found {
        // What two cameras contradict each other about is reported once.
        if findings
            .iter()
            .all(|known| known.cameras != finding.cameras)
        {
            findings.push(finding);
        }
    }
    findings
}

/// The only view that a camera lost, if it shows the board elsewhere than another camera does.
fn lone_view<'a>(fit: &'a Fit, id: &CameraId) -> Option<&'a LeftOut> {
    let mut left_out = fit.left_out.iter().filter(|l| l.views.contains(id));
    let (Some(lone), None) = (left_out.next(), left_out.next()) else {
        return None;
    };
    let is_elsewhere = match lone.views.len() {
        1 => lone.reason == ELSEWHERE || lone.reason == FAR,
        // Of three cameras that all disagree, none has moved more likely than the board has.
        2 => lone.reason == UNDECIDED || lone.reason.starts_with(DISAGREE),
        _ => false,
    };
    is_elsewhere.then_some(lone)
}

/// Where in the session a camera's view is.
#[derive(Clone, Copy)]
enum SessionEnd {
    /// It is the camera's last one.
    Last,
    /// It is its first one, and the next is at this placement.
    First(usize),
}

impl SessionEnd {
    fn of(session: &Session, camera: usize, placement: &String) -> Option<Self> {
        let own = session.views.iter().filter(|v| v.camera == camera);
        let mut seen: Vec<usize> = own.map(|v| v.placement).collect();
        seen.sort_unstable();
        let [first, second, .., last] = seen[..] else {
            return None;
        };
        if session.placements[last] == *placement {
            Some(Self::Last)
        } else if session.placements[first] == *placement {
            Some(Self::First(second))
        } else {
            None
        }
    }
}

fn of_view(
    session: &Session,
    camera: usize,
    lone: &LeftOut,
    end: SessionEnd,
    least: Least,
) -> Finding {
    let id = &session.cameras[camera].id;
    let placement = lone.placement.as_deref().unwrap_or_default();
    let other = (lone.views.iter()).find(|other| *other != id);
    let (others, who, again) = match other {
        Some(other) => (format!("camera {other} does"), "one of the two", "both"),
        None => ("the other cameras do".to_owned(), "the camera", "it"),
    };
    let shows = |which: &str| {
        format!(
            "camera {id}: its {which} view, at {placement}, shows the board elsewhere than {others}: {who} may have been \
             moved"
        )
    };
    let words = match end {
        SessionEnd::Last => format!(
            "{} before it; show the board to {again} again",
            shows("last")
        ),
        SessionEnd::First(second) if least.is_left(session, second, &[camera]) => {
            let from = &session.placements[second];
            format!(
                "{} after it; if so, calibrate from {from} on (--from-placement {from})",
                shows("first")
            )
        }
        SessionEnd::First(_) => format!(
            "{} after it; show the board to {again} again",
            shows("first")
        ),
    };
    Finding {
        cameras: lone.views.clone(),
        words,
    }
}
