//! Judges a fit: a verdict with its reasons. The limits are parameters; nothing is estimated here.

use super::diagnosis::Finding;
use super::reason::{Reason, ReasonKind};
use super::result::{Fit, FittedCamera, FittedPlacement, LeftOutShare};
use super::verdict_of_contradictions::contradictions;
use super::verdict_of_joints::single_joints;
use super::verdict_of_lens::beyond_model;
use super::verdict_of_shape::of_shape;
use crate::calibration::{CalibrationLevel, Camera, DepthResponse};
use crate::frame::CameraId;
use crate::range;
use crate::words::count;
use nalgebra::Vector3;
use std::collections::BTreeMap;

/// When a calibration is good.
#[derive(serde::Deserialize, serde::Serialize, Clone, Debug, PartialEq)]
#[serde(deny_unknown_fields, default)]
pub struct Limits {
    /// Root mean square residual, in pixels, up to which a calibration is good.
    /// Default 0.25, from 0 to `accepted_px`.
    #[serde(deserialize_with = "range::within::<_, _, 0, 100>")]
    pub good_px: f64,
    /// The same, up to which it is accepted.
    /// Default 0.4, from `good_px` to `refused_px`.
    #[serde(deserialize_with = "range::within::<_, _, 0, 100>")]
    pub accepted_px: f64,
    /// The same, beyond which it is refused. One camera of several refuses it with three times that.
    /// Default 0.6, from `accepted_px` to 100.
    #[serde(deserialize_with = "range::within::<_, _, 0, 100>")]
    pub refused_px: f64,
    /// Largest ratio of the residual of held-out placements to that of the fit.
    /// Default 1.3, range 1 to 1000.
    #[serde(deserialize_with = "range::within::<_, _, 1, 1000>")]
    pub held_out_ratio: f64,
    /// Share of a camera's picture in which the board should have been seen.
    /// Default 0.2, range 0 to 1.
    #[serde(deserialize_with = "range::within::<_, _, 0, 1>")]
    pub coverage: f64,
    /// Fewest views of each camera.
    /// Default 6, range 0 to 1000.
    #[serde(deserialize_with = "range::count::<_, _, 0, 1000>")]
    pub views: usize,
    /// Largest bias, in millimetres at any distance, that may remain in a depth camera's readings.
    /// Default 1, range 0 to 1000.
    #[serde(deserialize_with = "range::within::<_, _, 0, 1000>")]
    pub depth_bias_mm: f64,
    /// How far, in millimetres, a depth camera's distances may be off where nothing contradicts them: what the pose of
    /// the camera and the number of boards leave unknown. Above it a calibration is doubtful, above `depth_bias_mm` it
    /// is accepted at best.
    /// Default 3, range 0 to 1000.
    #[serde(deserialize_with = "range::within::<_, _, 0, 1000>")]
    pub depth_unknown_mm: f64,
    /// Share of the views, of all cameras or of a camera with two or more, above which a calibration that left them out
    /// is doubtful.
    /// Default 0.2, from 0 to `left_out_refused`.
    #[serde(deserialize_with = "range::within::<_, _, 0, 1>")]
    pub left_out_doubtful: f64,
    /// The same share, above which it is refused.
    /// Default 0.4, from `left_out_doubtful` to 1.
    #[serde(deserialize_with = "range::within::<_, _, 0, 1>")]
    pub left_out_refused: f64,
    /// Share of a camera's corners above which a calibration that dropped them is accepted at best.
    /// Default 0.05, range 0 to 1.
    #[serde(deserialize_with = "range::within::<_, _, 0, 1>")]
    pub dropped_corners: f64,
    /// How far, in millimetres, the board may be bent; above it a calibration is doubtful.
    /// Default 1, range 0 to 100.
    #[serde(deserialize_with = "range::within::<_, _, 0, 100>")]
    pub bend_mm: f64,
    /// By how many per cent its squares may be longer in one direction than in the other; above it a calibration is
    /// doubtful.
    /// Default 0.3, range 0 to 100.
    #[serde(deserialize_with = "range::within::<_, _, 0, 100>")]
    pub stretch_percent: f64,
    /// With fewer placements a calibration is doubtful.
    /// Default 4, range 0 to 1000.
    #[serde(deserialize_with = "range::count::<_, _, 0, 1000>")]
    pub placements: usize,
    /// Standard deviation of a camera's focal length, as a share of it, above which a calibration is doubtful.
    /// Default 0.005, range 0.000001 to 1.
    #[serde(deserialize_with = "range::at_least_a_millionth::<_, _, 1>")]
    pub focal_deviation: f64,
    /// Whether two cameras may look from one place in one direction, as behind a beam splitter. Default no.
    pub same_place: bool,
}

/// Distance in metres of two cameras' optical centres below which they are at one place.
const SAME_CENTER: f64 = 0.01;
/// Angle in degrees between their axes below which they look in one direction.
const SAME_AXIS_DEGREES: f64 = 10.0;
/// How many times the residual that refuses a calibration one of its cameras must have to refuse it alone: a noisy
/// camera has more than sharp ones, but its lens and pose are right.
const OF_CAMERA: f64 = 3.0;
/// Views that a camera must have lost before its share of them counts: one may be an accident.
const FEWEST_LEFT_OUT: usize = 2;

impl Default for Limits {
    fn default() -> Self {
        Self {
            good_px: 0.25,
            accepted_px: 0.4,
            refused_px: 0.6,
            held_out_ratio: 1.3,
            coverage: 0.2,
            views: 6,
            depth_bias_mm: 1.0,
            depth_unknown_mm: 3.0,
            left_out_doubtful: 0.2,
            left_out_refused: 0.4,
            dropped_corners: 0.05,
            bend_mm: 1.0,
            stretch_percent: 0.3,
            placements: 4,
            focal_deviation: 0.005,
            same_place: false,
        }
    }
}

impl Limits {
    /// Refuses values that contradict each other.
    ///
    /// # Errors
    /// The first value out of its range: its field, the value, and the range.
    pub fn checked(&self) -> Result<(), String> {
        let not_below = |field: &str, found: f64, [least, most]: [f64; 2]| match found >= least {
            true => Ok(()),
            false => Err(format!("{field} is {found}, expected {least} to {most}")),
        };
        not_below("accepted_px", self.accepted_px, [self.good_px, 100.0])?;
        not_below("refused_px", self.refused_px, [self.accepted_px, 100.0])?;
        let least = [self.left_out_doubtful, 1.0];
        not_below("left_out_refused", self.left_out_refused, least)
    }

    fn by_rms(&self, rms: f64) -> CalibrationLevel {
        match rms {
            r if r <= self.good_px => CalibrationLevel::Good,
            r if r <= self.accepted_px => CalibrationLevel::Accepted,
            r if r <= self.refused_px => CalibrationLevel::Doubtful,
            _ => CalibrationLevel::Refused,
        }
    }
}

/// A level with its reasons.
#[derive(serde::Serialize, Clone, Debug, PartialEq)]
pub struct Judgement {
    /// The verdict's level.
    pub level: CalibrationLevel,
    /// Why it is not good.
    pub reasons: Vec<Reason>,
    /// The camera with the largest residual, and that in pixels.
    pub worst_camera: Option<(String, f64)>,
    /// The placement with the largest residual, and that in pixels.
    pub worst_placement: Option<(String, f64)>,
}

/// What is known of the error of a depth camera's distances.
#[derive(Clone, Debug, PartialEq)]
pub struct DepthError {
    /// The largest mean difference between its distances and the boards, over steps of distance, in metres.
    pub seen: f64,
    /// What they may be off at most, with what boards do not show, in metres.
    pub at_most: f64,
    /// What readings have that the response cannot have, where they do not fit it.
    pub misfit: Option<DepthMisfit>,
    /// How many boards it read, and how many of them contradict the others and were left out.
    pub boards: LeftOutShare,
    /// What those that were left out agree on, in words, if they do.
    pub change: Option<String>,
}

/// Readings that do not fit a depth camera's response.
#[derive(Clone, Debug, PartialEq)]
pub struct DepthMisfit {
    /// Root mean square error of boards that were held out, at 1 m, in metres.
    pub held_out: f64,
    /// The kind of the likely cause.
    pub kind: ReasonKind,
    /// The likely causes in words.
    pub words: String,
}

/// Judges a fit, with the causes on which its left-out views agree and, for each depth camera, the error that its
/// response leaves, or in words that it has none of this session, and why.
pub fn judge(
    fit: &Fit,
    findings: &[Finding],
    depths: &BTreeMap<CameraId, Result<DepthError, String>>,
    limits: &Limits,
) -> Judgement {
    let causes = findings.iter();
    let mut found: Vec<Reason> = causes
        .map(|finding| {
            Reason::new(
                CalibrationLevel::Doubtful,
                ReasonKind::Diagnosed,
                &finding.words,
            )
        })
        .collect();
    found.extend(contradictions(fit, findings));
    found.extend(left_out(fit, limits));
    if !limits.same_place {
        found.extend(at_one_place(fit));
    }
    let rms = fit.figures.rms_px;
    found.push(Reason::new(
        limits.by_rms(rms),
        ReasonKind::Residual,
        format!(
            "the rms of all residuals is {rms:.3} px, expected at most {}",
            limits.good_px
        ),
    ));
    for (index, camera) in fit.cameras.iter().enumerate() {
        found.extend(of_camera(camera, limits));
        found.extend(beyond_model(fit, index, limits.good_px));
    }
    found.extend(of_held_out(fit, limits));
    found.extend(of_shape(&fit.shape, limits.bend_mm, limits.stretch_percent));
    found.extend(single_joints(fit));
    found.extend(too_little(fit, limits));
    found.extend(uncalibrated(fit));
    found.extend(
        depths
            .iter()
            .flat_map(|(id, found)| of_depth(id, found, limits)),
    );
    if !fit.table_is_lowest && fit.cameras.len() > 1 {
        let words = format!(
            "the rig's frame lies on {}, which may not be the table: it does not lie flat below all other placements and \
             cameras",
            fit.table
        );
        found.push(Reason::new(
            CalibrationLevel::Accepted,
            ReasonKind::TableUnknown,
            words,
        ));
    }
    found.retain(|reason| reason.level > CalibrationLevel::Good);
    let worst = |name: String, rms: f64| (name, rms);
    let cameras = fit
        .cameras
        .iter()
        .map(|c: &FittedCamera| worst(c.camera.id.to_string(), c.figures.rms_px));
    let placements = fit
        .placements
        .iter()
        .map(|p: &FittedPlacement| worst(p.name.clone(), p.figures.rms_px));
    Judgement {
        level: found
            .iter()
            .map(|reason| reason.level)
            .max()
            .unwrap_or(CalibrationLevel::Good),
        reasons: found,
        worst_camera: cameras.max_by(|a, b| a.1.total_cmp(&b.1)),
        worst_placement: placements.max_by(|a, b| a.1.total_cmp(&b.1)),
    }
}

/// The shares of views that were left out: of all cameras, and of each.
fn left_out(fit: &Fit, limits: &Limits) -> Vec<Reason> {
    let of_views = |whose: &str, share: LeftOutShare| {
        let (level, words) = of_share(whose, "views", share, limits);
        Reason::new(level, ReasonKind::LeftOut, words)
    };
    let of_all = of_views("", fit.left_out_share());
    let of_each = fit.cameras.iter().filter_map(|camera| {
        let share = fit.left_out_share_of(camera);
        let whose = format!("camera {}: ", camera.camera.id);
        (share.left_out >= FEWEST_LEFT_OUT).then(|| of_views(&whose, share))
    });
    std::iter::once(of_all).chain(of_each).collect()
}

/// The level that a share of what was read allows if it was left out, and its words.
fn of_share(
    whose: &str,
    what: &str,
    share: LeftOutShare,
    limits: &Limits,
) -> (CalibrationLevel, String) {
    let level = match share.part() {
        p if p > limits.left_out_refused => CalibrationLevel::Refused,
        p if p > limits.left_out_doubtful => CalibrationLevel::Doubtful,
        _ => CalibrationLevel::Good,
    };
    let words = format!(
        "{whose}{} of {} {what} ({:.0} %) were left out, expected at most {:.0} %",
        share.left_out,
        share.read,
        100.0 * share.part(),
        100.0 * limits.left_out_doubtful,
    );
    (level, words)
}

/// Pairs of cameras at the same place, as exchanged streams would give.
fn at_one_place(fit: &Fit) -> Vec<Reason> {
    let apart = |a: &Camera, b: &Camera| {
        let axes = a.rig_from_camera * Vector3::z();
        let angle = axes.angle(&(b.rig_from_camera * Vector3::z()));
        ((a.center() - b.center()).norm(), angle.to_degrees())
    };
    let mut found = Vec::new();
    for (index, first) in fit.cameras.iter().enumerate() {
        for second in &fit.cameras[index + 1..] {
            let (a, b) = (&first.camera, &second.camera);
            let (distance, degrees) = apart(a, b);
            if distance < SAME_CENTER && degrees < SAME_AXIS_DEGREES {
                let words = format!(
                    "cameras {} and {} are at one place: {:.1} mm and {degrees:.1}° apart, expected {:.0} mm or \
                     {SAME_AXIS_DEGREES:.0}° and more (limits.same_place allows it)",
                    a.id,
                    b.id,
                    1e3 * distance,
                    1e3 * SAME_CENTER,
                );
                found.push(Reason::new(
                    CalibrationLevel::Refused,
                    ReasonKind::AtOnePlace,
                    words,
                ));
            }
        }
    }
    found
}

/// The reasons that a camera's residuals, views, coverage and corners give.
fn of_camera(camera: &FittedCamera, limits: &Limits) -> Vec<Reason> {
    let (id, rms) = (&camera.camera.id, camera.figures.rms_px);
    // A camera that sees worse than others makes a calibration doubtful; one that is nowhere near its place, refused.
    let level = match rms > OF_CAMERA * limits.refused_px {
        true => CalibrationLevel::Refused,
        false => limits.by_rms(rms).min(CalibrationLevel::Doubtful),
    };
    let mut found = vec![Reason::new(
        level,
        ReasonKind::Residual,
        format!(
            "camera {id}: the rms of its residuals is {rms:.3} px, expected at most {}",
            limits.good_px
        ),
    )];
    let dropped = camera.dropped_part();
    if dropped > limits.dropped_corners {
        let words = format!(
            "camera {id}: {:.1} % of its corners were dropped, expected at most {:.0} %",
            100.0 * dropped,
            100.0 * limits.dropped_corners
        );
        found.push(Reason::new(
            CalibrationLevel::Accepted,
            ReasonKind::DroppedCorners,
            words,
        ));
    }
    if camera.views < limits.views {
        let words = format!(
            "camera {id}: it has {}, expected {} or more",
            count(camera.views, "view"),
            limits.views
        );
        found.push(Reason::new(
            CalibrationLevel::Accepted,
            ReasonKind::FewViews,
            words,
        ));
    }
    if camera.coverage < limits.coverage {
        let words = format!(
            "camera {id}: the board was seen in {:.0} % of its picture, expected {:.0} % or more",
            100.0 * camera.coverage,
            100.0 * limits.coverage
        );
        found.push(Reason::new(
            CalibrationLevel::Accepted,
            ReasonKind::Coverage,
            words,
        ));
    }
    found
}

/// The reasons that too few views give, however well they fit.
fn too_little(fit: &Fit, limits: &Limits) -> Vec<Reason> {
    let mut found = Vec::new();
    let placements = fit.placements.len();
    if placements < limits.placements {
        let words = format!(
            "the session has {}, expected {} or more",
            count(placements, "placement"),
            limits.placements
        );
        found.push(Reason::new(
            CalibrationLevel::Doubtful,
            ReasonKind::FewPlacements,
            words,
        ));
    }
    for camera in &fit.cameras {
        let (lens, deviation) = (&camera.camera.intrinsics, camera.uncertainty.focal_px);
        let parts = [0, 1].map(|k| deviation[k] / lens.focal_px[k]);
        let part = parts[0].max(parts[1]);
        if part > limits.focal_deviation {
            let words = format!(
                "camera {}: its focal length is known only to ±{:.2} %, expected {:.2} % or better",
                camera.camera.id,
                100.0 * part,
                100.0 * limits.focal_deviation
            );
            found.push(Reason::new(
                CalibrationLevel::Doubtful,
                ReasonKind::FocalLength,
                words,
            ));
        }
    }
    found
}

fn of_held_out(fit: &Fit, limits: &Limits) -> Option<Reason> {
    match &fit.held_out {
        Some(held_out) if held_out.ratio > limits.held_out_ratio => Some(Reason::new(
            CalibrationLevel::Doubtful,
            ReasonKind::HeldOut,
            format!(
                "placements that were held out are predicted {:.2} times worse than they are fitted, expected at \
                 most {}",
                held_out.ratio, limits.held_out_ratio
            ),
        )),
        Some(_) => None,
        None => Some(Reason::new(
            CalibrationLevel::Accepted,
            ReasonKind::FewPlacements,
            "there are too few placements to hold any out",
        )),
    }
}

/// The cameras that could not be calibrated.
fn uncalibrated(fit: &Fit) -> impl Iterator<Item = Reason> + '_ {
    let whole = fit.left_out.iter().filter(|l| l.placement.is_none());
    whole.filter_map(|l| {
        let words = format!(
            "camera {} is not calibrated: {}",
            l.camera.as_ref()?,
            l.reason
        );
        Some(Reason::new(
            CalibrationLevel::Doubtful,
            ReasonKind::NotCalibrated,
            words,
        ))
    })
}

/// The reasons that a depth camera's response gives: boards that were left out, and what the others leave.
fn of_depth(id: &CameraId, found: &Result<DepthError, String>, limits: &Limits) -> Vec<Reason> {
    match found {
        Ok(error) => {
            let boards = of_depth_boards(id, error, limits);
            boards.chain(of_depth_error(id, error, limits)).collect()
        }
        Err(words) => {
            let (level, kind) = (CalibrationLevel::Doubtful, ReasonKind::NoResponse);
            vec![Reason::new(level, kind, words)]
        }
    }
}

/// The reasons that the boards give that were left out of a depth camera's response.
fn of_depth_boards<'a>(
    id: &'a CameraId,
    error: &'a DepthError,
    limits: &'a Limits,
) -> impl Iterator<Item = Reason> + 'a {
    let change = error.change.iter().map(move |change| {
        let words = format!("depth camera {id}: {change}");
        Reason::new(CalibrationLevel::Doubtful, ReasonKind::DepthChanged, words)
    });
    let share = error.boards;
    let counts = share.left_out >= FEWEST_LEFT_OUT;
    let share = counts.then(|| {
        let whose = format!("depth camera {id}: ");
        let (level, words) = of_share(&whose, "boards that it read", share, limits);
        Reason::new(level, ReasonKind::DepthLeftOut, words)
    });
    change.chain(share)
}

/// The reasons that a depth camera's readings give: what boards showed and would explain it, or else what they left
/// unknown.
fn of_depth_error(id: &CameraId, error: &DepthError, limits: &Limits) -> Vec<Reason> {
    let Limits {
        depth_bias_mm,
        depth_unknown_mm,
        ..
    } = limits;
    let [seen, at_most] = [error.seen, error.at_most].map(|metres| 1e3 * metres);
    let by_most = |found: f64, most: f64| match found > most {
        true => CalibrationLevel::Doubtful,
        false => CalibrationLevel::Accepted,
    };
    if seen > *depth_bias_mm {
        let bias = format!("a bias of {seen:.2} mm is left, expected at most {depth_bias_mm}");
        let (kind, words) = match &error.misfit {
            Some(misfit) => (
                misfit.kind,
                format!("depth camera {id}: {bias}; {}", misfit.words),
            ),
            None => (ReasonKind::DepthBias, format!("depth camera {id}: {bias}")),
        };
        return vec![Reason::new(CalibrationLevel::Doubtful, kind, words)];
    }
    let unknown = (at_most > *depth_bias_mm).then(|| {
        let words = match error.at_most < DepthResponse::MOST_UNCERTAINTY {
            true => format!(
                "depth camera {id}: its distances are known only to {at_most:.2} mm, expected {depth_bias_mm} or better"
            ),
            false => format!(
                "depth camera {id}: it is not known how far off its distances are, expected {depth_bias_mm} mm at most"
            ),
        };
        Reason::new(by_most(at_most, *depth_unknown_mm), ReasonKind::DepthUnknown, words)
    });
    // They may be off in places and leave no mean bias.
    let misfit = error.misfit.as_ref().map(|misfit| {
        let off_mm = 1e3 * misfit.held_out;
        let words = format!(
            "depth camera {id}: its readings do not fit boards that were held out, by {off_mm:.2} mm at 1 m (rms); {}",
            misfit.words
        );
        Reason::new(by_most(off_mm, *depth_bias_mm), misfit.kind, words)
    });
    unknown.into_iter().chain(misfit).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn judged(error: DepthError) -> Vec<Reason> {
        let id = CameraId::new("kinect").unwrap();
        let mut found = of_depth(&id, &Ok(error), &Limits::default());
        found.retain(|reason| reason.level > CalibrationLevel::Good);
        found
    }

    fn told(seen_mm: f64, misfit_mm: Option<f64>) -> Vec<Reason> {
        judged(DepthError {
            seen: 1e-3 * seen_mm,
            at_most: 1e-3 * seen_mm,
            misfit: misfit_mm.map(|mm| DepthMisfit {
                held_out: 1e-3 * mm,
                kind: ReasonKind::DepthBowl,
                words: "a bowl would explain 80 % of what is left".into(),
            }),
            boards: LeftOutShare::default(),
            change: None,
        })
    }

    #[test]
    fn boards_that_a_depth_response_left_out_count_like_views() {
        let left_out = |left_out: usize, change: Option<&str>| {
            judged(DepthError {
                seen: 1e-4,
                at_most: 1e-4,
                misfit: None,
                boards: LeftOutShare { read: 14, left_out },
                change: change.map(str::to_owned),
            })
        };
        assert_eq!(left_out(1, None), []);
        assert_eq!(left_out(2, None), []);
        let words = "depth camera kinect: 5 of 14 boards that it read (36 %) were left out, expected at most 20 %";
        let share = Reason::new(CalibrationLevel::Doubtful, ReasonKind::DepthLeftOut, words);
        assert_eq!(left_out(5, None), std::slice::from_ref(&share));
        assert_eq!(left_out(6, None)[0].level, CalibrationLevel::Refused);
        let change = "its readings changed between p08 and p09 (3.0 % deeper)";
        let words = format!("depth camera kinect: {change}");
        let changed = Reason::new(CalibrationLevel::Doubtful, ReasonKind::DepthChanged, words);
        assert_eq!(left_out(5, Some(change)), [changed, share]);
    }

    #[test]
    fn readings_that_do_not_fit_are_a_reason_even_where_they_leave_no_bias() {
        assert_eq!(told(0.1, None), []);
        for (off_mm, level) in [
            (0.8, CalibrationLevel::Accepted),
            (1.3, CalibrationLevel::Doubtful),
        ] {
            let words = format!(
                "depth camera kinect: its readings do not fit boards that were held out, by {off_mm:.2} mm at 1 m (rms); \
                 a bowl would explain 80 % of what is left"
            );
            let expected = Reason::new(level, ReasonKind::DepthBowl, words);
            assert_eq!(told(0.1, Some(off_mm)), [expected]);
        }
    }

    #[test]
    fn an_error_that_is_not_known_is_told_as_such() {
        let found = judged(DepthError {
            seen: 0.0,
            at_most: DepthResponse::MOST_UNCERTAINTY,
            misfit: None,
            boards: LeftOutShare::default(),
            change: None,
        });
        assert_eq!(found[0].level, CalibrationLevel::Doubtful);
        let words = "depth camera kinect: it is not known how far off its distances are, ";
        assert!(found[0].words.starts_with(words), "{found:?}");
    }

    #[test]
    fn a_bias_has_one_reason_with_what_would_explain_it() {
        let bias = "depth camera kinect: a bias of 2.00 mm is left, expected at most 1";
        let alone = Reason::new(CalibrationLevel::Doubtful, ReasonKind::DepthBias, bias);
        assert_eq!(told(2.0, None), [alone]);
        let words = format!("{bias}; a bowl would explain 80 % of what is left");
        let explained = Reason::new(CalibrationLevel::Doubtful, ReasonKind::DepthBowl, words);
        assert_eq!(told(2.0, Some(1.3)), [explained]);
    }
}
