//! Finds cameras of which only the last view, or only the first one, shows the board elsewhere than the other cameras
//! do. One view is not enough to tell whether the camera was moved or the picture was taken at another moment, so the
//! finding says what may have happened, and what to show the camera next.

use super::super::outliers::ELSEWHERE;
use super::super::result::{Fit, LeftOut};
use super::super::session::Session;
use super::Finding;
use crate::frame::CameraId;

/// The cameras that may have been moved before their last view, or after their first.
pub(super) fn of(session: &Session, fit: &Fit) -> Vec<Finding> {
    let cameras = session.cameras.iter().enumerate();
    cameras
        .filter_map(|(index, camera)| of_camera(session, fit, index, &camera.id))
        .collect()
}

fn of_camera(session: &Session, fit: &Fit, index: usize, id: &CameraId) -> Option<Finding> {
    let own = session.views.iter().filter(|v| v.camera == index);
    let mut seen: Vec<usize> = own.map(|v| v.placement).collect();
    seen.sort_unstable();
    let is_own = |l: &&LeftOut| l.views.contains(id);
    let mut left_out = fit.left_out.iter().filter(is_own);
    let (Some(lone), None) = (left_out.next(), left_out.next()) else {
        return None;
    };
    let placement = lone
        .placement
        .as_ref()
        .filter(|_| lone.reason == ELSEWHERE)?;
    let [first, second, .., last] = seen[..] else {
        return None;
    };
    let words = if session.placements[last] == *placement {
        format!(
            "camera {id}: its last view, at {placement}, shows the board elsewhere than the other cameras do: the camera \
             may have been moved before it; show the board to it again"
        )
    } else if session.placements[first] == *placement {
        let from = &session.placements[second];
        format!(
            "camera {id}: its first view, at {placement}, shows the board elsewhere than the other cameras do: the camera \
             may have been moved after it; if so, calibrate from {from} on (--from-placement {from})"
        )
    } else {
        return None;
    };
    Some(Finding {
        cameras: vec![id.clone()],
        words,
    })
}
