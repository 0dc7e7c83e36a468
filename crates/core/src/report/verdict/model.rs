//! Rules about the model itself.

use super::{Level, Limits, Parameters, Reason, ReasonCode, percent};
use crate::reconstruct::Provenance;
use crate::report::{Measurements, ModelMeasures};
use crate::words;

/// Cubic metres that may stay unproved unsaid: a cube of 4 mm.
const LEAST_UNPROVED: f64 = 6.4e-8;

/// Share of the surface from which a note says how much is interpolated.
const NOTED_BRIDGED: f64 = 0.05;

pub(super) fn judge(measured: &Measurements, parameters: &Parameters, into: &mut Vec<Reason>) {
    let model = &measured.model;
    let found = [
        not_watertight(model),
        bridged(model, parameters),
        expected_error(model, parameters),
        closed_openings(model, parameters),
        components(model, parameters),
        unproved(model),
        unrequired(model),
        handles(model, parameters),
        opened_by_depth(model, parameters),
        unpainted(model, parameters),
        dropped(model.dropped_hull_pieces, parameters, |pieces, were| {
            format!("{pieces} beside the hull {were} dropped")
        }),
        dropped(model.dropped_carved_pieces, parameters, |pieces, were| {
            format!("{pieces} that carving cut off {were} dropped")
        }),
    ];
    into.extend(found.into_iter().flatten());
}

fn reason(level: Level, code: ReasonCode, words: String) -> Reason {
    Reason {
        level,
        code,
        cameras: Vec::new(),
        words,
    }
}

/// The reason that a value is beyond its limits, if it is.
fn beyond(
    limits: &Limits,
    value: f64,
    code: ReasonCode,
    words: impl FnOnce() -> String,
) -> Option<Reason> {
    let level = limits.level(value)?;
    Some(reason(level, code, words()))
}

fn not_watertight(model: &ModelMeasures) -> Option<Reason> {
    let words = "the model's surface does not enclose a solid".to_owned();
    (!model.watertight).then(|| reason(Level::Red, ReasonCode::NotWatertight, words))
}

fn bridged(model: &ModelMeasures, parameters: &Parameters) -> Option<Reason> {
    let share = model.share(Provenance::Bridged);
    let level = parameters.bridged.level(share);
    if level.is_none() && share < NOTED_BRIDGED {
        return None;
    }
    let words = format!(
        "{} of the model is interpolated over holes in the depth readings",
        percent(share)
    );
    let level = level.unwrap_or(Level::Green);
    Some(reason(level, ReasonCode::HolesBridged, words))
}

fn expected_error(model: &ModelMeasures, parameters: &Parameters) -> Option<Reason> {
    let mm = 1e3 * model.mean_expected_error;
    beyond(&parameters.expected_mm, mm, ReasonCode::ErrorLarge, || {
        format!("the expected error of the model is {mm:.1} mm on average")
    })
}

fn closed_openings(model: &ModelMeasures, parameters: &Parameters) -> Option<Reason> {
    let count = model.closed_openings;
    if count == 0 {
        return None;
    }
    let level = parameters.openings_closed.level(count as f64);
    let words = format!(
        "the depth opened the object in {} where a colour camera sees it; the model is closed there again",
        words::count(count, "place")
    );
    let level = level.unwrap_or(Level::Green);
    Some(reason(level, ReasonCode::CarvingUndone, words))
}

fn components(model: &ModelMeasures, parameters: &Parameters) -> Option<Reason> {
    let count = model.mesh.components as f64;
    let (limits, code) = (&parameters.components, ReasonCode::SeveralComponents);
    beyond(limits, count, code, || {
        format!(
            "the model is in {count:.0} separate pieces: it shows several objects, or one that was \
            cut apart"
        )
    })
}

fn unproved(model: &ModelMeasures) -> Option<Reason> {
    let volume = model.unproved_volume.unwrap_or(0.0);
    (volume > LEAST_UNPROVED).then(|| {
        let words = format!(
            "{:.1} ml are hidden from all but a few cameras by what is ignored in their pictures; they are not in \
            the model, whether they belong to the object or not",
            1e6 * volume
        );
        reason(Level::Green, ReasonCode::Unproved, words)
    })
}

/// Pieces that may be phantoms. This is only a note: their vertices are unseen, and of those a large share is amber.
fn unrequired(model: &ModelMeasures) -> Option<Reason> {
    let pieces = &model.unrequired_pieces;
    let [low, high] = pieces.first()?.bounds;
    let middle = [0, 1, 2].map(|axis| 0.5e3 * (low[axis] + high[axis]));
    let volume: f64 = pieces.iter().map(|piece| piece.volume).sum();
    let words = format!(
        "no silhouette requires {} of {:.1} ml in all, the largest around x {:.0}, y {:.0}, z {:.0} mm: wherever a \
            camera has such a piece in its picture, the rest of the model covers the same part of the silhouette; \
            it may be a phantom, and its provenance is unseen",
        words::count(pieces.len(), "piece"),
        1e6 * volume,
        middle[0],
        middle[1],
        middle[2]
    );
    Some(reason(Level::Green, ReasonCode::PieceUnrequired, words))
}

fn handles(model: &ModelMeasures, parameters: &Parameters) -> Option<Reason> {
    let count = model.mesh.genus.unwrap_or(0) as f64;
    beyond(&parameters.handles, count, ReasonCode::ManyHandles, || {
        format!("the model has {count:.0} handles or holes through it: it may be perforated")
    })
}

fn opened_by_depth(model: &ModelMeasures, parameters: &Parameters) -> Option<Reason> {
    let count = model.handles_of_depth;
    let (limits, code) = (&parameters.handles_of_depth, ReasonCode::OpenedByDepth);
    beyond(limits, count as f64, code, || {
        format!(
            "the depth opened {} that no silhouette shows: the model may be perforated",
            words::count(count as usize, "hole")
        )
    })
}

fn unpainted(model: &ModelMeasures, parameters: &Parameters) -> Option<Reason> {
    let share = 1.0 - model.textured.unwrap_or(1.0);
    beyond(&parameters.unpainted, share, ReasonCode::Unpainted, || {
        if does_not_fit(model) {
            return "the pictures do not fit into the texture, which texture.largest_side limits: the model has no colours \
                    of the cameras"
                .to_owned();
        }
        format!(
            "no camera saw {} of the model: its colours there are not observed",
            percent(share)
        )
    })
}

fn dropped(
    count: usize,
    parameters: &Parameters,
    in_words: impl FnOnce(&str, &str) -> String,
) -> Option<Reason> {
    if count == 0 {
        return None;
    }
    let level = parameters.dropped_pieces.level(count as f64);
    let were = if count == 1 { "was" } else { "were" };
    let words = in_words(&words::count(count, "stray piece"), were);
    let level = level.unwrap_or(Level::Green);
    Some(reason(level, ReasonCode::PiecesDropped, words))
}

/// Whether a model's pictures did not fit into its atlas: that is a single texel then.
fn does_not_fit(model: &ModelMeasures) -> bool {
    model.atlas.is_some_and(|atlas| atlas.size == [1, 1])
}
