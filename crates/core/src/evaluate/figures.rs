//! The figures of a set of samples, of the whole model or of one provenance.

use super::Parameters;
use super::appearance::Seen;
use super::expected::Expected;
use super::statistics::{Sorted, Summary, share};
use super::wall::Wall;
use crate::reconstruct::Provenance;
use serde::Serialize;

/// What was measured at a point of the model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ModelSample {
    /// Signed distance to the truth in millimetres, positive outside.
    pub signed_mm: f64,
    /// Angle between the two surfaces' normals.
    pub degrees: f64,
    /// Whether the nearest point of the truth is near a rim.
    pub near_rim: bool,
    /// Where the model has this point from, if it says.
    pub provenance: Option<Provenance>,
    /// The error the model expects here, in millimetres, if it says.
    pub expected_mm: Option<f64>,
}

/// What was measured at a point of the truth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TruthSample {
    /// Distance to the model in millimetres.
    pub distance_mm: f64,
    /// Whether it is near a rim.
    pub near_rim: bool,
    /// In the concave part: the distance along the normal, in millimetres.
    pub concave_mm: Option<f64>,
    /// The wall behind it, if it is on one.
    pub wall: Option<Wall>,
    /// Where the model has the nearest point from, if it says.
    pub provenance: Option<Provenance>,
    /// What a person sees of it in the model.
    pub seen: Seen,
}

/// How well model and truth agree, in the sense of Knapitsch et al. 2017 ("Tanks and Temples").
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Figures {
    /// From the model to the truth.
    pub accuracy: Option<Summary>,
    /// From the truth to the model.
    pub completeness: Option<Summary>,
    /// At each threshold of the parameters.
    pub f_scores: Vec<FScore>,
    /// Signed distances from the truth to the model's points: positive where the model is too large.
    pub bias: Option<Bias>,
    /// Angles between the normals of model and truth.
    pub normals: Option<Angles>,
    /// The truth's concave part, with distances along its normal (capped).
    pub concave: Option<Part>,
    /// What is near rims.
    pub rims: Option<RimFigures>,
    /// The truth's sharp edges and rims, with distances to the model: where normals within 1.5 mm differ as those of
    /// two faces that meet at 52° or more.
    pub edges: Option<Part>,
    /// The outside without its edges: angles between the truth's normals and the mean of the model's around the nearest
    /// point.
    pub outside_normals: Option<Angles>,
    /// Share of the truth's samples that stand out of the model by more than 0.3 mm.
    pub dented_share: f64,
    /// Thickness of walls.
    pub walls: Option<WallFigures>,
    /// The errors that the model expects, against what they are.
    pub expected: Option<Expected>,
}

/// Shares of samples nearer than a threshold, and their harmonic mean.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct FScore {
    /// The threshold.
    pub threshold_mm: f64,
    /// Share of the model's samples.
    pub precision: f64,
    /// Share of the truth's samples.
    pub recall: f64,
    /// 2 · precision · recall / (precision + recall).
    pub f_score: f64,
}

/// Signed distances.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Bias {
    /// Their mean.
    pub mean_mm: f64,
    /// Their median.
    pub median_mm: f64,
}

/// Angles between normals.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Angles {
    /// Their mean.
    pub mean_degrees: f64,
    /// Their median.
    pub median_degrees: f64,
    /// Nine of ten are below.
    pub p90_degrees: f64,
}

/// A part of the truth.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Part {
    /// Its share of the truth's samples.
    pub share: f64,
    /// Distances from it.
    #[serde(flatten)]
    pub distances: Summary,
}

/// What is near the truth's rims.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct RimFigures {
    /// From the model to the truth.
    pub accuracy: Option<Summary>,
    /// From the truth to the model.
    pub completeness: Option<Summary>,
}

/// How thick walls are. Errors are capped.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct WallFigures {
    /// The share of the truth's samples that is on walls.
    pub share: f64,
    /// Mean thickness of the truth's walls.
    pub truth_mean_mm: f64,
    /// Mean of the model's thickness less the truth's.
    pub bias_mm: Option<f64>,
    /// Absolute differences of thickness.
    pub error: Option<Summary>,
    /// The share of walls that the model does not have.
    pub lost_share: f64,
}

impl Figures {
    /// Sums up samples of the model and of the truth.
    pub fn of(model: &[ModelSample], truth: &[TruthSample], parameters: &Parameters) -> Self {
        let all = |_: &ModelSample| true;
        Self {
            accuracy: accuracy(model, all),
            completeness: completeness(truth, |_| true),
            f_scores: f_scores(model, truth, &parameters.thresholds_mm),
            bias: bias(model),
            normals: angles(model.iter().map(|s| s.degrees)),
            concave: part(truth, |s| s.concave_mm),
            rims: rims(model, truth),
            edges: part(truth, |s| s.seen.is_edge.then_some(s.distance_mm)),
            outside_normals: angles(truth.iter().filter_map(|s| s.seen.outside_degrees)),
            dented_share: share(truth, |s| s.seen.is_dented),
            walls: walls(truth, parameters.cap_mm),
            expected: expected(model, all),
        }
    }

    /// The F-score at a threshold, if it is one of those asked for.
    pub fn f_score_at(&self, threshold_mm: f64) -> Option<f64> {
        let found = self
            .f_scores
            .iter()
            .find(|f| f.threshold_mm == threshold_mm);
        found.map(|f| f.f_score)
    }
}

fn accuracy(model: &[ModelSample], keep: impl Fn(&ModelSample) -> bool) -> Option<Summary> {
    let kept = model.iter().filter(|s| keep(s));
    Summary::of(kept.map(|s| s.signed_mm.abs()))
}

fn completeness(truth: &[TruthSample], keep: impl Fn(&TruthSample) -> bool) -> Option<Summary> {
    let kept = truth.iter().filter(|s| keep(s));
    Summary::of(kept.map(|s| s.distance_mm))
}

fn f_scores(model: &[ModelSample], truth: &[TruthSample], thresholds: &[f64]) -> Vec<FScore> {
    let score = |&threshold_mm: &f64| {
        let precision = share(model, |s| s.signed_mm.abs() < threshold_mm);
        let recall = share(truth, |s| s.distance_mm < threshold_mm);
        let f_score = 2.0 * precision * recall / (precision + recall).max(1e-9);
        FScore {
            threshold_mm,
            precision,
            recall,
            f_score,
        }
    };
    thresholds.iter().map(score).collect()
}

fn bias(model: &[ModelSample]) -> Option<Bias> {
    let sorted = Sorted::new(model.iter().map(|s| s.signed_mm));
    Some(Bias {
        mean_mm: sorted.mean()?,
        median_mm: sorted.quantile(0.5)?,
    })
}

fn angles(degrees: impl Iterator<Item = f64>) -> Option<Angles> {
    let sorted = Sorted::new(degrees);
    Some(Angles {
        mean_degrees: sorted.mean()?,
        median_degrees: sorted.quantile(0.5)?,
        p90_degrees: sorted.quantile(0.9)?,
    })
}

/// Fewer samples of a part than this say nothing of it.
const LEAST_OF_PART: usize = 100;

/// The part of the truth for which there is a distance, in millimetres.
fn part(truth: &[TruthSample], distance: impl Fn(&TruthSample) -> Option<f64>) -> Option<Part> {
    let distances = Summary::of(truth.iter().filter_map(distance))?;
    let share = distances.samples as f64 / truth.len() as f64;
    (distances.samples > LEAST_OF_PART).then_some(Part { share, distances })
}

fn rims(model: &[ModelSample], truth: &[TruthSample]) -> Option<RimFigures> {
    let figures = RimFigures {
        accuracy: accuracy(model, |s| s.near_rim),
        completeness: completeness(truth, |s| s.near_rim),
    };
    (figures.accuracy.is_some() || figures.completeness.is_some()).then_some(figures)
}

fn walls(truth: &[TruthSample], cap_mm: f64) -> Option<WallFigures> {
    let walls: Vec<Wall> = truth.iter().filter_map(|s| s.wall).collect();
    let truth_mean = Sorted::new(walls.iter().map(|w| w.thickness * 1e3)).mean()?;
    let differences: Vec<f64> = walls
        .iter()
        .filter_map(|w| Some(((w.found? - w.thickness) * 1e3).clamp(-cap_mm, cap_mm)))
        .collect();
    Some(WallFigures {
        share: walls.len() as f64 / truth.len() as f64,
        truth_mean_mm: truth_mean,
        bias_mm: Sorted::new(differences.iter().copied()).mean(),
        error: Summary::of(differences.iter().map(|d| d.abs())),
        lost_share: share(&walls, |w| w.found.is_none()),
    })
}

/// Expected against actual errors of those samples that `keep` picks.
pub(super) fn expected(
    model: &[ModelSample],
    keep: impl Fn(&ModelSample) -> bool,
) -> Option<Expected> {
    let kept = model.iter().filter(|s| keep(s));
    let pairs: Vec<(f64, f64)> = kept
        .filter_map(|s| Some((s.expected_mm?, s.signed_mm.abs())))
        .collect();
    Expected::of(&pairs)
}
