//! Chooses the pictures that the report shows, and makes them small.

use crate::calibrate::{self, Detections, Outcome};
use crate::calibration::fit::{Corner, Figures, ViewResiduals};
use crate::capture::Placements;
use crate::frame::CameraId;
use crate::image::Grid;
use crate::output::encode_jpeg;
use crate::report::{Found, ViewPicture};
use nalgebra::{Point2, Vector2};
use std::collections::BTreeSet;

/// Most pictures of each kind, and most of one camera among the worst: together less than 1.5 MB.
const MOST: usize = 6;
const MOST_OF_CAMERA: usize = 2;
/// Largest width of a picture in the report, in pixels, and its quality.
const WIDTH: usize = 560;
const QUALITY: u8 = 60;

type Corners = Vec<(Point2<f64>, Option<Vector2<f64>>)>;

/// A picture that is to be shown.
struct ReportPicture {
    camera: CameraId,
    placement: String,
    found: Found,
    words: String,
    corners: Corners,
}

/// The views that were left out, pictures without a board, and the worst views that were used; those that cannot be
/// read any more are not shown.
pub(super) fn pictures(recordings: &[Placements], outcome: &Outcome) -> Vec<ViewPicture> {
    let mut chosen = left_out(outcome);
    chosen.extend(without_board(&outcome.detections));
    chosen.extend(worst(outcome));
    let shots = calibrate::shots(recordings);
    let picture = |chosen: ReportPicture| {
        let key = (chosen.placement.clone(), chosen.camera.to_string());
        let (recording, shot) = shots.get(&key)?;
        let grey = recording.grey(shot).ok()?;
        let step = grey.width().div_ceil(WIDTH).max(1);
        let small = smaller(&grey, step).map(|&value| [value; 3]);
        Some(ViewPicture {
            jpeg: encode_jpeg(&small, QUALITY).ok()?,
            size: [small.width(), small.height()].map(|side| side * step),
            camera: chosen.camera,
            placement: chosen.placement,
            found: chosen.found,
            words: chosen.words,
            corners: chosen.corners,
        })
    };
    chosen.into_iter().filter_map(picture).collect()
}

/// Views that the fit threw out, in the order in which it did: the worst first.
fn left_out(outcome: &Outcome) -> Vec<ReportPicture> {
    let session = &outcome.detections.session;
    let all = outcome.fit.left_out.iter().flat_map(|left_out| {
        let views = left_out.views.iter();
        views.filter_map(|id| Some((id, left_out.placement.as_ref()?, &left_out.reason)))
    });
    let chosen = |(id, placement, reason): (&CameraId, &String, &String)| {
        let camera = session.cameras.iter().position(|c| c.id == *id)?;
        let index = session.placements.iter().position(|p| p == placement)?;
        let mut views = session.views.iter();
        let view = views.find(|v| (v.camera, v.placement) == (camera, index))?;
        let corner = |c: &Corner| (c.pixel, None);
        Some(ReportPicture {
            camera: id.clone(),
            placement: placement.clone(),
            found: Found::LeftOut,
            words: reason.clone(),
            corners: view.corners.iter().map(corner).collect(),
        })
    };
    all.filter_map(chosen).take(MOST).collect()
}

/// Pictures without a board that could be used: of each camera and reason one, then others.
fn without_board(detections: &Detections) -> Vec<ReportPicture> {
    let mut told = BTreeSet::new();
    let (first, others): (Vec<_>, Vec<_>) = detections
        .rejected
        .iter()
        .partition(|r| told.insert((&r.camera, &r.reason)));
    let chosen = |rejected: &calibrate::Rejected| ReportPicture {
        camera: rejected.camera.clone(),
        placement: rejected.placement.clone(),
        found: Found::Nothing,
        words: rejected.reason.clone(),
        corners: Vec::new(),
    };
    first
        .into_iter()
        .chain(others)
        .take(MOST)
        .map(chosen)
        .collect()
}

/// The views with the largest residuals.
fn worst(outcome: &Outcome) -> Vec<ReportPicture> {
    let fit = &outcome.fit;
    let rms = |view: &ViewResiduals| Figures::of(view.lengths()).rms_px;
    let mut views: Vec<(f64, &ViewResiduals)> = fit.residuals.iter().map(|v| (rms(v), v)).collect();
    views.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut counts = vec![0; fit.cameras.len()];
    let of_few = views.into_iter().filter(|(_, view)| {
        counts[view.camera] += 1;
        counts[view.camera] <= MOST_OF_CAMERA
    });
    let chosen = |(rms, view): (f64, &ViewResiduals)| ReportPicture {
        camera: fit.cameras[view.camera].camera.id.clone(),
        placement: fit.placements[view.placement].name.clone(),
        found: Found::Used,
        words: format!("{rms:.3} px rms, {} corners", view.corners.len()),
        corners: view
            .corners
            .iter()
            .map(|(pixel, r)| (*pixel, Some(*r)))
            .collect(),
    };
    of_few.take(MOST).map(chosen).collect()
}

/// A picture of the means of squares of `step` by `step` pixels.
fn smaller(picture: &Grid<u8>, step: usize) -> Grid<u8> {
    let size = [picture.width() / step, picture.height() / step].map(|side| side.max(1));
    Grid::from_fn(size[0], size[1], |x, y| {
        let (mut sum, mut count) = (0_u32, 0);
        for j in (y * step..(y + 1) * step).take_while(|&j| j < picture.height()) {
            for i in (x * step..(x + 1) * step).take_while(|&i| i < picture.width()) {
                sum += u32::from(picture[(i, j)]);
                count += 1;
            }
        }
        (sum / count.max(1)) as u8
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_smaller_picture_has_the_means() {
        let picture = Grid::from_fn(5, 4, |x, y| (10 * x + y) as u8);
        let small = smaller(&picture, 2);
        assert_eq!((small.width(), small.height()), (2, 2));
        assert_eq!(small[(0, 0)], 5);
        assert_eq!(small[(1, 1)], 27);
        assert_eq!(smaller(&picture, 1), picture);
    }
}
