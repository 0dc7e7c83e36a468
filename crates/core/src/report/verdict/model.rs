//! Rules about the model itself.

use super::{Level, Limits, Parameters, Reason, ReasonCode, percent};
use crate::reconstruct::Provenance;
use crate::report::{Measurements, ModelMeasures};
use crate::words;

/// Cubic metres that may stay unproved unsaid: a cube of 4 mm.
const LEAST_UNPROVED: f64 = 6.4e-8;

pub(super) fn judge(measured: &Measurements, parameters: &Parameters, into: &mut Vec<Reason>) {
    let model = &measured.model;
    let reason = |level, code, words| Reason {
        level,
        code,
        cameras: Vec::new(),
        words,
    };
    if !model.watertight {
        let words = "the model's surface does not enclose a solid".to_owned();
        into.push(reason(Level::Red, ReasonCode::NotWatertight, words));
    }
    let beyond = |limits: &Limits, value: f64| limits.level(value).map(|level| (level, value));
    let bridged = model.share(Provenance::Bridged);
    into.extend(beyond(&parameters.bridged, bridged).map(|(level, v)| {
        let words = format!(
            "{} of the model is interpolated over holes in the depth readings",
            percent(v)
        );
        reason(level, ReasonCode::HolesBridged, words)
    }));
    let expected_mm = 1e3 * model.mean_expected_error;
    into.extend(
        beyond(&parameters.expected_mm, expected_mm).map(|(level, v)| {
            let words = format!("the expected error of the model is {v:.1} mm on average");
            reason(level, ReasonCode::ErrorLarge, words)
        }),
    );
    if model.closed_openings > 0 {
        let level = parameters
            .openings_closed
            .level(model.closed_openings as f64);
        let words = format!(
            "the depth opened the object in {} where a colour camera sees it; the model is closed there again",
            words::count(model.closed_openings, "place")
        );
        into.push(reason(
            level.unwrap_or(Level::Green),
            ReasonCode::CarvingUndone,
            words,
        ));
    }
    let components = model.mesh.components as f64;
    into.extend(
        beyond(&parameters.components, components).map(|(level, v)| {
            let words = format!(
                "the model is in {v:.0} separate pieces: it shows several objects, or one that was \
            cut apart"
            );
            reason(level, ReasonCode::SeveralComponents, words)
        }),
    );
    let unproved = model.unproved_volume.unwrap_or(0.0);
    if unproved > LEAST_UNPROVED {
        let words = format!(
            "{:.1} ml are hidden from all but a few cameras by what is ignored in their pictures; they are not in \
            the model, whether they belong to the object or not",
            1e6 * unproved
        );
        into.push(reason(Level::Green, ReasonCode::Unproved, words));
    }
    let handles = model.mesh.genus.unwrap_or(0) as f64;
    into.extend(beyond(&parameters.handles, handles).map(|(level, v)| {
        let words =
            format!("the model has {v:.0} handles or holes through it: it may be perforated");
        reason(level, ReasonCode::ManyHandles, words)
    }));
    let opened = model.handles_of_depth as f64;
    into.extend(
        beyond(&parameters.handles_of_depth, opened).map(|(level, v)| {
            let words = format!(
                "the depth opened {} that no silhouette shows: the model may be perforated",
                words::count(v as usize, "hole")
            );
            reason(level, ReasonCode::OpenedByDepth, words)
        }),
    );
    let unpainted = 1.0 - model.textured.unwrap_or(1.0);
    into.extend(beyond(&parameters.unpainted, unpainted).map(|(level, v)| {
        let words = if does_not_fit(model) {
            "the pictures do not fit into the texture, which texture.largest_side limits: the model has no colours of \
             the cameras"
                .to_owned()
        } else {
            format!(
                "no camera saw {} of the model: its colours there are not observed",
                percent(v)
            )
        };
        reason(level, ReasonCode::Unpainted, words)
    }));
    for (count, from) in [
        (model.dropped_hull_pieces, "beside the hull"),
        (model.dropped_carved_pieces, "that carving cut off"),
    ] {
        if count > 0 {
            let level = parameters.dropped_pieces.level(count as f64);
            let were = if count == 1 { "was" } else { "were" };
            let words = format!(
                "{} {from} {were} dropped",
                words::count(count, "stray piece")
            );
            into.push(reason(
                level.unwrap_or(Level::Green),
                ReasonCode::PiecesDropped,
                words,
            ));
        }
    }
}

/// Whether a model's pictures did not fit into its atlas: that is a single texel then.
fn does_not_fit(model: &ModelMeasures) -> bool {
    model.atlas.is_some_and(|atlas| atlas.size == [1, 1])
}
