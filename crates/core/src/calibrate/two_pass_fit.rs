//! Fits a second time if markers lie close to the board's corners: the first fit shows what is printed around them.

use super::Error;
use super::detections::{Detections, shots};
use crate::calibration::fit::{self, Corner, Fit, Parameters, crowded_views, matched_with_print};
use crate::capture::Placements;
use rayon::prelude::*;

/// Fits a session; where markers crowd corners, once more after these have been matched with the print.
///
/// # Errors
/// As [`fit::fit`], and if a picture cannot be read any more.
pub(super) fn fit_in_two_passes(
    detections: &mut Detections,
    recordings: &[Placements],
    parameters: &Parameters,
) -> Result<Result<Fit, fit::Error>, Error> {
    let crowded = crowded_views(&detections.session);
    if crowded.is_empty() {
        return Ok(fit::fit(&detections.session, parameters));
    }
    let quick = Parameters {
        folds: 0,
        ..parameters.clone()
    };
    let first = match fit::fit(&detections.session, &quick) {
        Ok(first) => first,
        Err(error) => return Ok(Err(error)),
    };
    match_with_print(detections, recordings, &first, &crowded)?;
    Ok(fit::fit(&detections.session, parameters))
}

/// Puts corners that markers crowd to where the print says that they are.
fn match_with_print(
    detections: &mut Detections,
    recordings: &[Placements],
    first: &Fit,
    crowded: &[usize],
) -> Result<(), Error> {
    let shots = shots(recordings);
    let session = &detections.session;
    let rematch = |&index: &usize| -> Result<Option<(usize, Vec<Corner>)>, Error> {
        let view = &session.views[index];
        let key = (
            session.placements[view.placement].clone(),
            session.cameras[view.camera].id.to_string(),
        );
        let Some((recording, shot)) = shots.get(&key) else {
            return Ok(None);
        };
        let picture = recording.grey(shot)?;
        let corners = matched_with_print(session, first, view, &picture);
        Ok(corners.map(|corners| (index, corners)))
    };
    let found: Vec<_> = crowded
        .par_iter()
        .map(rematch)
        .collect::<Result<_, Error>>()?;
    for (index, corners) in found.into_iter().flatten() {
        detections.session.views[index].corners = corners;
    }
    Ok(())
}
