//! Rules about the colour cameras: whether their silhouettes agree, and whether their pictures are good enough.

use super::{Level, Parameters, Reason, ReasonCode, about_cameras, percent};
use crate::frame::CameraId;
use crate::report::{ColorMeasures, Measurements};
use crate::statistics::lower_median;

pub(super) fn judge(measured: &Measurements, parameters: &Parameters, into: &mut Vec<Reason>) {
    let each = |value: fn(&ColorMeasures) -> f64| -> Vec<(&CameraId, f64)> {
        let colors = measured.colors.iter();
        colors.map(|c| (&c.camera, value(c))).collect()
    };
    // What comes first in this order brings about what comes later.
    let reason = exchanged(measured)
        .or_else(|| foreign(measured, parameters))
        .or_else(|| displaced(measured, parameters))
        .or_else(|| uncovered(measured, parameters));
    into.extend(reason);
    into.extend(about_cameras(
        ReasonCode::FrameCut,
        &parameters.frame_cut,
        each(frame_cut).into_iter(),
        |v| format!("{} of its side", percent(v)),
        |names| format!("the frame cuts the object; what lies outside is only guessed: {names}"),
    ));
    into.extend(volume_cut(measured, parameters));
    into.extend(about_cameras(
        ReasonCode::Overexposed,
        &parameters.overexposed,
        each(|c| f64::from(c.silhouette.overexposed)).into_iter(),
        percent,
        |names| format!("parts of the object are overexposed: {names}"),
    ));
    into.extend(about_cameras(
        ReasonCode::Underexposed,
        &parameters.underexposed,
        each(|c| f64::from(c.silhouette.underexposed)).into_iter(),
        percent,
        |names| format!("parts of the object are black: {names}"),
    ));
    into.extend(about_cameras(
        ReasonCode::Blurred,
        &parameters.blur_px,
        each(|c| f64::from(c.silhouette.blur_px.unwrap_or(0.0))).into_iter(),
        |v| format!("{v:.1} px"),
        |names| format!("the object's outline is blurred: {names}"),
    ));
    into.extend(about_cameras(
        ReasonCode::BackdropChanged,
        &parameters.backdrop_changed,
        each(|c| {
            c.silhouette
                .difference
                .as_ref()
                .map_or(0.0, |d| f64::from(d.mismatch))
        })
        .into_iter(),
        percent,
        |names| format!("the backdrop differs from its background picture: {names}"),
    ));
    into.extend(about_cameras(
        ReasonCode::ToldByOutline,
        &parameters.told_by_outline,
        each(|c| {
            let difference = c.silhouette.difference.as_ref();
            f64::from(difference.and_then(|d| d.told_by_outline).unwrap_or(0.0))
        })
        .into_iter(),
        percent,
        |names| format!("without colours the object is hard to tell from its shadow: {names}"),
    ));
}

/// Two cameras at each other's place.
fn exchanged(measured: &Measurements) -> Option<Reason> {
    let found = measured.exchanged.as_ref()?;
    let [a, b] = &found.cameras;
    Some(Reason {
        level: Level::Red,
        code: ReasonCode::CamerasExchanged,
        cameras: found.cameras.to_vec(),
        words: format!(
            "{a} and {b} look exchanged: with each other's pose both agree (now {} of a silhouette are uncovered, then {})",
            percent(found.missing_with),
            percent(found.missing_without)
        ),
    })
}

/// A calibration that no single camera is to blame for: without the one that moved, the others would agree.
fn foreign(measured: &Measurements, parameters: &Parameters) -> Option<Reason> {
    let shift = measured.common_shift_share;
    let without = measured.moved.as_ref().map(|m| m.others_share_without);
    let least = without.map_or(shift, |without| without.min(shift));
    let shifts = measured.colors.iter().map(|c| c.consistency.shift_px);
    let mut shifts_px: Vec<f64> = shifts.map(|[dx, dy]| dx.hypot(dy)).collect();
    let is_seen = lower_median(&mut shifts_px).is_some_and(|px| px >= parameters.least_shift_px);
    let is_foreign = is_seen && least > parameters.common_shift;
    if !is_foreign {
        return None;
    }
    let mut words = format!(
        "the calibration does not belong to this recording: half of the silhouettes lie {} of the object's size or more beside \
        the model",
        percent(shift)
    );
    // Of an object that the volume cuts, the silhouettes are larger than what is left of it.
    if volume_cut(measured, parameters).is_some() {
        words += "; or the volume cuts the object";
    }
    Some(Reason {
        level: Level::Red,
        code: ReasonCode::CalibrationForeign,
        cameras: Vec::new(),
        words,
    })
}

/// Parts of the surface that only the volume bounds.
fn volume_cut(measured: &Measurements, parameters: &Parameters) -> Option<Reason> {
    let share = measured.model.unobserved.cut_by_volume;
    let level = parameters.volume_cut.level(share)?;
    Some(Reason {
        level,
        code: ReasonCode::VolumeCut,
        cameras: Vec::new(),
        words: format!(
            "the volume seems to cut the object: it bounds {} of the surface, where no outline shows that the object ends",
            percent(share)
        ),
    })
}

/// A camera that moved. It harms the others' silhouettes too, and they are not to blame.
fn displaced(measured: &Measurements, parameters: &Parameters) -> Option<Reason> {
    let moved = measured.moved.as_ref()?;
    let [dx, dy] = moved.shift_px;
    if dx.hypot(dy) < parameters.least_shift_px {
        return None;
    }
    let mut reason = about_cameras(
        ReasonCode::CameraDisplaced,
        &parameters.displaced,
        [(&moved.camera, moved.shift_share)].into_iter(),
        |v| format!("by {} of the object's size", percent(v)),
        |names| format!("the silhouette is not where the other cameras place it: {names}"),
    )?;
    let [dx, dy] = moved.shift_px;
    reason.words += &format!(
        "; the camera seems to have moved: its picture is off by about {dx:+.1}, {dy:+.1} px"
    );
    Some(reason)
}

/// Parts of silhouettes that the hull leaves uncovered, where no camera moved: bad masks, mostly.
fn uncovered(measured: &Measurements, parameters: &Parameters) -> Option<Reason> {
    about_cameras(
        ReasonCode::SilhouetteUncovered,
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
    cut as f64 / camera.longest_side_px()
}
