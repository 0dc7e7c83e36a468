//! Tests whether the views that contradict a rig agree with each other: on another pose of their camera, another lens,
//! another camera's place, another moment, or a mirrored picture. It names causes and changes no fit.

mod advice;
mod exchange;
mod last_view;
mod moment;
mod split;
mod suspects;
#[cfg(test)]
mod tests;

use super::Parameters;
use super::change::ViewChange;
use super::result::{Fit, LeftOut};
use super::session::Session;
use crate::frame::CameraId;
use advice::Least;
use exchange::Exchange;
use moment::PictureFault;
use split::{Change, Split};
use suspects::Reference;

/// A cause on which views that were left out agree.
#[derive(serde::Serialize, Clone, Debug, PartialEq)]
pub struct Finding {
    /// The cameras that it concerns.
    pub cameras: Vec<CameraId>,
    /// The cause, between which placements, and what to do.
    pub words: String,
}

/// What the views have in common that `fit` left out or, if there is no fit, could not be joined.
/// A part of the session is advised only if at least `least_placements` are left in it.
pub fn diagnose(
    session: &Session,
    fit: Option<&Fit>,
    parameters: &Parameters,
    least_placements: usize,
) -> Vec<Finding> {
    let least = Least {
        placements: least_placements,
        views: parameters.min_views,
    };
    let candidates = Reference::candidates(session, fit, parameters, least);
    let told = candidates
        .iter()
        .map(|reference| of_reference(reference, parameters));
    // The sound rig is the one that leaves the least to explain.
    let explained = told.filter(|findings: &Vec<Finding>| !findings.is_empty());
    let mut findings = explained.min_by_key(Vec::len).unwrap_or_default();
    if let Some(fit) = fit {
        let possible = last_view::of(session, fit, least);
        let is_new = |f: &Finding| {
            !findings
                .iter()
                .any(|known| known.cameras.contains(&f.cameras[0]))
        };
        let new: Vec<Finding> = possible.into_iter().filter(is_new).collect();
        findings.extend(new);
        if findings.is_empty() {
            let largest = fit.changes.first();
            findings.extend(largest.map(|change| unexplained(session, fit, change, least)));
        }
    }
    findings
}

/// Makes views that contradict others, and were left out for that, refer to the findings about their cameras.
pub fn refer_to_findings(left_out: &mut [LeftOut], findings: &[Finding]) {
    for left_out in left_out.iter_mut().filter(|l| l.apart.is_some()) {
        let views = &left_out.views;
        let concerns = |finding: &&Finding| finding.cameras.iter().any(|id| views.contains(id));
        let Some(finding) = findings.iter().find(concerns) else {
            continue;
        };
        let names: Vec<&str> = finding.cameras.iter().map(CameraId::as_str).collect();
        let noun = if names.len() == 1 {
            "camera"
        } else {
            "cameras"
        };
        let reference = format!("; see the reason about {noun} {}", names.join(" and "));
        left_out.reason += &reference;
    }
}

/// A change that is seen in the residuals of a camera, and for which no cause was found.
fn unexplained(session: &Session, fit: &Fit, change: &ViewChange, least: Least) -> Finding {
    let id = &fit.cameras[change.camera].camera.id;
    let [before, after] = change.placements.map(|p| &fit.placements[p].name);
    let displaced = format!(
        "camera {id}: its views from {after} on do not fit the earlier ones: they are displaced by {:.2} px",
        change.by_px
    );
    let cause = match fit.cameras.len() {
        1 => format!(
            "its lens may have been refocused or zoomed after {before} (its focal length would have changed by {:+.1} %), \
             or its pictures cut, mirrored or taken by another camera",
            100.0 * change.focal_part
        ),
        _ => format!("it or a camera beside it may have been moved or refocused after {before}"),
    };
    let camera = session.cameras.iter().position(|c| c.id == *id);
    let first = session.placements.iter().position(|name| name == after);
    let is_enough = matches!((camera, first), (Some(camera), Some(first))
        if least.is_left(session, first, &[camera]));
    let or_part = match is_enough {
        true => format!(", or calibrate from {after} on (--from-placement {after})"),
        false => String::new(),
    };
    Finding {
        cameras: vec![id.clone()],
        words: format!("{displaced}; {cause}: show the board again{or_part}"),
    }
}

/// The causes on which the suspected cameras' views agree, compared with this rig of the others.
fn of_reference(reference: &Reference, parameters: &Parameters) -> Vec<Finding> {
    let mut findings = Vec::new();
    let mut splits = Vec::new();
    for &camera in &reference.suspects {
        match moment::of(reference, camera, parameters) {
            Some(moment) => findings.push(of_moment(reference, camera, &moment)),
            None => splits.extend(split::of(reference, camera, parameters)),
        }
    }
    while let Some(found) = exchange::of(reference, &splits, parameters) {
        findings.push(exchanged(reference, &found, &splits));
        splits.retain(|split| !found.takes_part(split.camera));
    }
    findings.extend(splits.iter().map(|split| changed(reference, split)));
    findings.sort_by(|a, b| a.cameras.cmp(&b.cameras));
    findings
}

fn of_moment(reference: &Reference, camera: usize, moment: &PictureFault) -> Finding {
    let id = reference.id(camera);
    // Of two cameras, either may be at fault.
    let other = reference
        .is_relative
        .then(|| reference.id(reference.cameras[0]));
    let on = |from: &Option<usize>| match from {
        Some(from) => format!(" from {} on", reference.session.placements[*from]),
        None => String::new(),
    };
    let words = match moment {
        PictureFault::Mirrored { from } => match other {
            None => format!(
                "camera {id}: its pictures are mirrored{}: mirrored back they agree with the other cameras'; switch its \
                 mirroring off and show the board again",
                on(from)
            ),
            Some(other) => format!(
                "the pictures of camera {other} or of camera {id} are mirrored{}: with either mirrored back they agree; \
                 switch the mirroring off and show the board again",
                on(from)
            ),
        },
        PictureFault::Shifted { by, from } => {
            let orders = ["late", "early"];
            let order = orders[usize::from(*by > 0)];
            let moment = if *by < 0 { "before" } else { "after" };
            let from = on(from);
            let count = match by.abs() {
                1 => "one placement".to_owned(),
                more => format!("{more} placements"),
            };
            match other {
                None => format!(
                    "camera {id}: its pictures are {count} {order}{from}: each shows the board where it was {count} \
                     {moment}; press the pedal with all cameras ready, and show the board again"
                ),
                Some(other) => format!(
                    "camera {id}: its pictures are {count} {order}{from}, or those of camera {other} are {count} {}: \
                     press the pedal with both cameras ready, and show the board again",
                    orders[usize::from(*by < 0)]
                ),
            }
        }
    };
    Finding {
        cameras: other.into_iter().chain([id]).cloned().collect(),
        words,
    }
}

fn exchanged(reference: &Reference, found: &Exchange, splits: &[Split]) -> Finding {
    let mut pairs: Vec<[&CameraId; 2]> = found
        .shows
        .iter()
        .map(|pair| pair.map(|camera| reference.id(camera)))
        .collect();
    pairs.sort();
    let cameras: Vec<CameraId> = pairs.iter().map(|[id, _]| (*id).clone()).collect();
    let names: Vec<&str> = cameras.iter().map(CameraId::as_str).collect();
    let (last, others) = names.split_last().unwrap_or((&"", &[]));
    let ring = match pairs.len() {
        2 => String::new(),
        _ => {
            let shows = pairs
                .iter()
                .map(|[id, as_before]| format!("{id} shows what {as_before} did"));
            format!(" ({})", shows.collect::<Vec<_>>().join(", "))
        }
    };
    let name = |placement: usize| &reference.session.placements[placement];
    let from = name(splits[found.split].first_late);
    let when = match found.back {
        None => format!("from {from} on"),
        // A view beside the second change may fit either side.
        Some(back) => format!("from {from} to about {}", name(splits[back].last_early)),
    };
    let last_change = &splits[found.back.unwrap_or(found.split)];
    let words = format!(
        "cameras {} and {last} are exchanged {when}{ring}: check their cables and names (the pictures do not show which \
         order is right); {}",
        others.join(", "),
        last_change.advice(reference)
    );
    Finding { cameras, words }
}

fn changed(reference: &Reference, split: &Split) -> Finding {
    let placements = &reference.session.placements;
    let when = format!(
        "between {} and {}",
        placements[split.last_early], placements[split.first_late]
    );
    let id = reference.id(split.camera);
    let (cameras, subject, verb) = match reference.is_relative {
        true => {
            let other = reference.id(reference.cameras[0]);
            let words = format!("cameras {other} and {id}");
            (
                vec![other.clone(), id.clone()],
                words,
                "moved against each other",
            )
        }
        false => (vec![id.clone()], format!("camera {id}"), "moved"),
    };
    let moved = |[degrees, metres]: [f64; 2]| match metres {
        m if m >= 2e-3 => format!("{verb} by {degrees:.2}° and {:.0} mm {when}", 1e3 * m),
        _ => format!("{verb} by {degrees:.2}° {when}"),
    };
    let zoomed = |part: f64| match reference.is_relative {
        // Which of two was refocused cannot be told.
        true => format!(
            "the focal length of one of them changed by {:.2} % {when}",
            100.0 * part.abs()
        ),
        false => format!(
            "the focal length of camera {id} changed by {:+.2} % {when}",
            100.0 * part
        ),
    };
    let cause = match split.change {
        Change::Moved(by) => format!("{subject} {}", moved(by)),
        Change::Refocused(part) if reference.is_relative => format!("{subject}: {}", zoomed(part)),
        Change::Refocused(part) => format!("{}: it was refocused or zoomed", zoomed(part)),
        Change::Either(by, part) => {
            format!("{subject} may have {}, or {}", moved(by), zoomed(part))
        }
        Change::Both(by, part) => format!("{subject} {}, and {}", moved(by), zoomed(part)),
    };
    Finding {
        cameras,
        words: format!("{cause}; {}", split.advice(reference)),
    }
}
