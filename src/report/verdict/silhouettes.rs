//! Rules about the colour cameras: do their silhouettes agree, and are their pictures fit for it.

use super::{Code, Parameters, Reason, about_cameras, percent};
use crate::frame::CameraId;
use crate::report::{ColorMeasures, Measurements};

pub(super) fn judge(measured: &Measurements, parameters: &Parameters, into: &mut Vec<Reason>) {
    let each = |value: fn(&ColorMeasures) -> f64| -> Vec<(&CameraId, f64)> {
        let colors = measured.colors.iter();
        colors.map(|c| (&c.camera, value(c))).collect()
    };
    let displaced = displaced(measured, parameters);
    into.extend(displaced.or_else(|| uncovered(measured, parameters)));
    into.extend(about_cameras(
        Code::FrameCut,
        &parameters.frame_cut,
        each(frame_cut).into_iter(),
        |v| format!("{} of its side", percent(v)),
        |names| format!("the frame cuts the object; what lies outside is only guessed: {names}"),
    ));
    into.extend(about_cameras(
        Code::Overexposed,
        &parameters.overexposed,
        each(|c| f64::from(c.silhouette.overexposed)).into_iter(),
        percent,
        |names| format!("parts of the object are overexposed: {names}"),
    ));
    into.extend(about_cameras(
        Code::Underexposed,
        &parameters.underexposed,
        each(|c| f64::from(c.silhouette.underexposed)).into_iter(),
        percent,
        |names| format!("parts of the object are black: {names}"),
    ));
    into.extend(about_cameras(
        Code::Blurred,
        &parameters.blur_px,
        each(|c| f64::from(c.silhouette.blur_px.unwrap_or(0.0))).into_iter(),
        |v| format!("{v:.1} px"),
        |names| format!("the object's outline is blurred: {names}"),
    ));
    into.extend(about_cameras(
        Code::BackdropChanged,
        &parameters.backdrop_changed,
        each(|c| {
            c.silhouette
                .difference
                .as_ref()
                .map_or(0.0, |d| f64::from(d.mismatch))
        })
        .into_iter(),
        percent,
        |names| format!("the backdrop is not as the background plate shows it: {names}"),
    ));
}

/// Cameras displaced by less than this share of the worst one's displacement are taken for harmed by it.
const BLAMED: f64 = 0.9;

/// A camera that moved: its whole silhouette lies beside the place that the others give it. It harms the
/// others' silhouettes too, though less, and they are not to blame.
fn displaced(measured: &Measurements, parameters: &Parameters) -> Option<Reason> {
    let share = |c: &ColorMeasures| {
        let [dx, dy] = c.consistency.shift_px;
        dx.hypot(dy) / longest_side(c)
    };
    let worst = measured.colors.iter().map(share).fold(0.0, f64::max);
    let blamed = measured
        .colors
        .iter()
        .filter(|c| share(c) >= BLAMED * worst);
    let mut reason = about_cameras(
        Code::CameraDisplaced,
        &parameters.displaced,
        blamed.map(|c| (&c.camera, share(c))),
        |v| format!("by {} of the object's size", percent(v)),
        |names| format!("the silhouette lies beside where the other cameras put it: {names}"),
    )?;
    if let [camera] = reason.cameras.as_slice() {
        let of_camera = measured.colors.iter().find(|c| c.camera == *camera)?;
        let [dx, dy] = of_camera.consistency.shift_px;
        reason.words +=
            &format!("; it seems to have moved, by at least about {dx:+.0}, {dy:+.0} px");
    }
    Some(reason)
}

/// Parts of silhouettes that the hull leaves uncovered, where no camera moved: bad masks, mostly.
fn uncovered(measured: &Measurements, parameters: &Parameters) -> Option<Reason> {
    about_cameras(
        Code::SilhouetteUncovered,
        &parameters.uncovered,
        measured
            .colors
            .iter()
            .map(|c| (&c.camera, c.consistency.missing)),
        percent,
        |names| format!("the model leaves parts of the silhouette uncovered: {names}"),
    )
}

/// Pixels on the frame's edges over the object's longest side.
fn frame_cut(camera: &ColorMeasures) -> f64 {
    let cut: usize = camera.silhouette.edge_px.iter().sum();
    cut as f64 / longest_side(camera)
}

/// Of the object in the picture, in pixels.
fn longest_side(camera: &ColorMeasures) -> f64 {
    camera.object_px.into_iter().fold(1, usize::max) as f64
}
