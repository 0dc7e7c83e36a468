//! Rules about the depth cameras: whether there is depth, whether it is right, and whether the model follows it.

use super::{Level, Parameters, Reason, ReasonCode, about_cameras, mm, percent};
use crate::frame::CameraId;
use crate::reconstruct::Method;
use crate::reconstruct::region::BiasSource;
use crate::report::{DepthMeasures, Measurements, RegionMeasures};

/// Share of the object's front from which on a depth camera counts as one that reads the object. Of what is black or
/// shiny some pixels beside the table have readings all the same.
const LEAST_COVERAGE: f64 = 0.05;
/// What a model is that no depth restored.
const HOLLOWS_FILLED: &str = "the model is the visual hull, its hollows are filled";

pub(super) fn judge(measured: &Measurements, parameters: &Parameters, into: &mut Vec<Reason>) {
    if measured.depth_cameras == 0 {
        let why = "no depth camera took part in the capture";
        return into.push(only_a_hull(
            ReasonCode::NoDepthCamera,
            why,
            measured,
            parameters,
        ));
    }
    if measured.method == Method::Hull {
        let why = "no depth was used, as requested";
        return into.push(only_a_hull(
            ReasonCode::DepthNotUsed,
            why,
            measured,
            parameters,
        ));
    }
    let reads_nothing = |d: &&DepthMeasures| d.coverage < LEAST_COVERAGE && d.regions.is_none();
    let (blind, seeing): (Vec<_>, Vec<_>) = measured.depths.iter().partition(reads_nothing);
    if !blind.is_empty() {
        into.push(without_depth(&blind, seeing.is_empty()));
    }
    if !seeing.is_empty() && seeing.iter().all(|d| d.regions.is_none()) {
        into.push(Reason {
            level: Level::Green,
            code: ReasonCode::NoRegion,
            cameras: Vec::new(),
            words: "no concave region was found: the model is the visual hull".to_owned(),
        });
    }
    about_bias(&seeing, parameters, into);
    into.extend(outlines(&seeing, parameters));
    into.extend(elsewhere(&seeing, parameters));
    into.extend(unchecked(&seeing, parameters));
    about_regions(&seeing, parameters, into);
    if !seeing.is_empty() {
        into.extend(lids(measured, parameters));
        into.extend(unobserved(measured, parameters));
    }
}

/// Silhouettes show no hollow: a person has to look at such a model, unless the configuration asks for hulls only.
fn only_a_hull(
    code: ReasonCode,
    why: &str,
    measured: &Measurements,
    parameters: &Parameters,
) -> Reason {
    Reason {
        level: parameters.unless_hull_is_wanted(Level::Amber),
        code,
        cameras: Vec::new(),
        words: format!(
            "{why}: {HOLLOWS_FILLED}; any part of its {:.0} cubic centimetres may be hollow",
            1e6 * measured.model.mesh.volume
        ),
    }
}

fn without_depth(blind: &[&DepthMeasures], all: bool) -> Reason {
    let names: Vec<&str> = blind.iter().map(|d| d.camera.as_str()).collect();
    let (is_one, names) = (names.len() == 1, names.join(", "));
    let consequence = match (all, is_one) {
        (true, _) => HOLLOWS_FILLED,
        (false, true) => "what only it sees stays the visual hull",
        (false, false) => "what only they see stays the visual hull",
    };
    let words = match is_one {
        true => {
            format!("depth camera {names} has hardly any readings of the object: {consequence}")
        }
        false => {
            format!("depth cameras {names} have hardly any readings of the object: {consequence}")
        }
    };
    Reason {
        level: Level::Amber,
        code: ReasonCode::NoDepth,
        cameras: blind.iter().map(|d| d.camera.clone()).collect(),
        words,
    }
}

/// Parts that face up and that nothing looked into, as only a hull's whole top is.
fn lids(measured: &Measurements, parameters: &Parameters) -> Option<Reason> {
    let found = measured.model.unobserved;
    let level = parameters.lid_unread.level(found.lids)?;
    Some(Reason {
        level: parameters.unless_hull_is_wanted(level),
        code: ReasonCode::LidUnread,
        cameras: Vec::new(),
        words: format!(
            "no depth camera read {} of the surface, which faces up: up to {:.0} cubic centimetres below it may be hollow",
            percent(found.lids),
            1e6 * found.under_lids
        ),
    })
}

/// What is a guess: lids, and what a depth camera saw through, although it was not carved.
fn unobserved(measured: &Measurements, parameters: &Parameters) -> Option<Reason> {
    let found = measured.model.unobserved;
    let share = found.guessed + found.lids + found.seen_through;
    let in_all = parameters.unobserved.level(share);
    let level = in_all.max(parameters.lid_unread.level(found.seen_through))?;
    let mut words = format!(
        "{} of the surface were not observed: the model is a guess there",
        percent(share)
    );
    if found.seen_through > 0.0 {
        words += &format!(
            "; of {} a depth camera read the surface more than a centimetre beneath the model's",
            percent(found.seen_through)
        );
    }
    Some(Reason {
        level: parameters.unless_hull_is_wanted(level),
        code: ReasonCode::Unobserved,
        cameras: Vec::new(),
        words,
    })
}

fn about_bias(seeing: &[&DepthMeasures], parameters: &Parameters, into: &mut Vec<Reason>) {
    let found = |camera: &CameraId| {
        let found = seeing.iter().find(|d| d.camera == *camera);
        found.map_or(0.0, |d| d.bias.found)
    };
    let reason = about_cameras(
        ReasonCode::DepthBiased,
        &parameters.bias_excess_mm,
        seeing.iter().map(|d| (&d.camera, excess(d, parameters))),
        |v| format!("{v:.1} mm more"),
        |names| format!("depth is off by more than its calibration allows: {names}"),
    );
    into.extend(reason.map(|mut reason| {
        if let [camera] = reason.cameras.as_slice() {
            reason.words += &format!("; {} in all", mm(found(camera)));
        }
        reason
    }));
}

/// Millimetres of bias beyond what a depth camera's calibration leaves possible.
fn excess(d: &DepthMeasures, parameters: &Parameters) -> f64 {
    let unstated = 1e-3 * parameters.unstated_uncertainty_mm;
    1e3 * (d.bias.found.abs() - d.stated_uncertainty.unwrap_or(unstated))
}

/// Depth cameras that see the object end elsewhere than the colour cameras do. A wrong focal length moves no reading of
/// the table, but makes a hollow too wide or too narrow.
fn outlines(seeing: &[&DepthMeasures], parameters: &Parameters) -> Option<Reason> {
    let apart = |d: &&DepthMeasures| Some((d.camera.clone(), 1e3 * d.outline?.apart));
    let each: Vec<(CameraId, f64)> = seeing.iter().filter_map(apart).collect();
    about_cameras(
        ReasonCode::DepthOutline,
        &parameters.outline_mm,
        each.iter().map(|(camera, apart)| (camera, *apart)),
        |v| format!("{v:.1} mm"),
        |names| {
            format!(
                "the object's outline in the depth is not where the colour cameras' hull has it: {names}; the calibration \
                of one or the other may be wrong"
            )
        },
    )
}

/// Depth cameras that read the object elsewhere than the hull allows. The hull contains the object, so that no reading
/// is in front of it, be it on a rim; and where the model stays the hull, readings behind it show how much too large it
/// is.
fn elsewhere(seeing: &[&DepthMeasures], parameters: &Parameters) -> Option<Reason> {
    let beside = |d: &DepthMeasures| d.beside_regions.map_or(0.0, |found| found.contradiction());
    let ahead = |d: &DepthMeasures| {
        d.in_front_of_hull
            .map_or(0.0, |found| found.contradiction())
    };
    let of_side = |metres: &dyn Fn(&DepthMeasures) -> f64, words: fn(&str) -> String| {
        about_cameras(
            ReasonCode::DepthElsewhere,
            &parameters.elsewhere_mm,
            seeing.iter().map(|d| (&d.camera, 1e3 * metres(d))),
            |v| format!("{v:.1} mm"),
            words,
        )
    };
    let in_front = of_side(&|d| ahead(d).max(-beside(d)), |names| {
        format!(
            "the depth has the object in front of the surface that the colour cameras give it: {names}; the calibration of \
            one or the other may be wrong, or the object's material misleads the depth camera"
        )
    });
    in_front.or_else(|| {
        of_side(&beside, |names| {
            format!(
                "outside of hollows, the depth has the object behind the surface that the colour cameras give it: {names}; \
                too much may stand there, or the calibration of one or the other may be wrong"
            )
        })
    })
}

/// Depth cameras of which neither the table nor the hull shows by how much they are off: those that carved, and those
/// that read all of the object behind a hull that may be too large. The error that the model states includes it.
fn unchecked(seeing: &[&DepthMeasures], parameters: &Parameters) -> Option<Reason> {
    // Of more than the calibration leaves possible, `DepthBiased` tells.
    let is_told = |d: &DepthMeasures| {
        let excess = excess(d, parameters);
        parameters.bias_excess_mm.level(excess).is_some()
    };
    let is_unchecked = |d: &&&DepthMeasures| match d.bias.source {
        BiasSource::Table => false,
        BiasSource::Hull => d.bias.is_excess_of_hull() && !is_told(d),
        BiasSource::None => d.regions.is_some(),
    };
    let found: Vec<_> = seeing.iter().filter(is_unchecked).collect();
    let most = found.iter().map(|d| d.bias.remaining).reduce(f64::max)?;
    let names: Vec<&str> = found.iter().map(|d| d.camera.as_str()).collect();
    Some(Reason {
        level: Level::Green,
        code: ReasonCode::DepthUnchecked,
        cameras: found.iter().map(|d| d.camera.clone()).collect(),
        words: format!(
            "nothing in the capture shows by how much the depth is off: {}; it may be up to {}, and so may the hollows",
            names.join(", "),
            mm(most)
        ),
    })
}

fn about_regions(seeing: &[&DepthMeasures], parameters: &Parameters, into: &mut Vec<Reason>) {
    let each = |value: fn(&RegionMeasures) -> f64| -> Vec<(&CameraId, f64)> {
        let with_regions = seeing.iter().filter_map(|d| Some((d, d.regions.as_ref()?)));
        with_regions.map(|(d, r)| (&d.camera, value(r))).collect()
    };
    into.extend(about_cameras(
        ReasonCode::RegionUnread,
        &parameters.region_unread,
        each(|r| 1.0 - r.coverage).into_iter(),
        |v| format!("{} without readings", percent(v)),
        |names| {
            format!("few depth readings lie in the hollow, so its shape is interpolated: {names}")
        },
    ));
    into.extend(about_cameras(
        ReasonCode::RegionLarge,
        &parameters.region_share,
        each(|r| r.share).into_iter(),
        percent,
        |names| {
            format!(
                "nearly everything in the view of a depth camera was restored from its readings, \
                look closely: {names}"
            )
        },
    ));
    into.extend(about_cameras(
        ReasonCode::DepthDisagrees,
        &parameters.disagreement_mm,
        each(|r| 1e3 * r.disagreement).into_iter(),
        |v| format!("a tenth of the pixels are off by more than {v:.1} mm"),
        |names| format!("the restored surface does not lie where depth was read: {names}"),
    ));
}
