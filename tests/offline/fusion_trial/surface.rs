//! How good a fused model is with its underside, which `scand evaluate` leaves out, because one capture never shows it.

use rayon::prelude::*;
use scand::evaluate::{Sample, sample};
use scand::mesh::{Bvh, Mesh, volume_and_total_area};

/// Points on each surface.
const SAMPLES: usize = 60_000;
/// The underside faces down by more than this …
const DOWN: f64 = -0.3;
/// … in so many of the lowest metres of the truth.
const LOWEST: f64 = 0.012;

/// A model against the truth, in one frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct Scores {
    /// F-score at 0.5 mm of the whole surface.
    pub f_at_half_mm: f64,
    /// F-score at 1 mm of the whole surface.
    pub f_at_1_mm: f64,
    /// Mean distance, in millimetres, of the truth's underside from the model.
    pub underside_mean_mm: f64,
    /// The model's volume over the truth's.
    pub volume_share: f64,
}

impl Scores {
    /// Measures `model` against `truth`, both in metres with z up, in the frame of the capture in which `truth` stands.
    pub(super) fn of(model: &Mesh, truth: &Mesh) -> Self {
        let (of_model, of_truth) = (sample(model, SAMPLES), sample(truth, SAMPLES));
        let accuracy = distances_mm(&of_model, &Bvh::new(truth));
        let completeness = distances_mm(&of_truth, &Bvh::new(model));
        let f_score = |most_mm: f64| {
            let near = |distances: &[f64]| {
                let count = distances.iter().filter(|d| **d < most_mm).count();
                count as f64 / distances.len().max(1) as f64
            };
            let (precision, recall) = (near(&accuracy), near(&completeness));
            2.0 * precision * recall / (precision + recall).max(f64::MIN_POSITIVE)
        };
        let lowest = of_truth.iter().map(|s| s.point.z);
        let lowest = lowest.fold(f64::INFINITY, f64::min);
        let is_underneath =
            |s: &Sample| s.point.z < lowest + LOWEST && normal_z(truth, s.triangle) < DOWN;
        let underside = of_truth.iter().zip(&completeness);
        let underside = underside.filter(|(s, _)| is_underneath(s));
        let underside: Vec<f64> = underside.map(|(_, distance)| *distance).collect();
        let volume = |mesh: &Mesh| volume_and_total_area(mesh).0.abs();
        Self {
            f_at_half_mm: f_score(0.5),
            f_at_1_mm: f_score(1.0),
            underside_mean_mm: underside.iter().sum::<f64>() / underside.len() as f64,
            volume_share: volume(model) / volume(truth),
        }
    }
}

fn distances_mm(from: &[Sample], to: &Bvh) -> Vec<f64> {
    let distance = |s: &Sample| {
        to.closest_point(s.point)
            .map_or(f64::INFINITY, |c| c.distance)
    };
    from.par_iter().map(|s| 1e3 * distance(s)).collect()
}

/// The upward part of a triangle's unit normal.
fn normal_z(mesh: &Mesh, triangle: usize) -> f64 {
    let [a, b, c] = mesh.corners(triangle).map(|v| v.cast::<f64>());
    let normal = (b - a).cross(&(c - a));
    normal.z / normal.norm().max(f64::MIN_POSITIVE)
}

#[test]
fn the_underside_counts_and_is_measured_by_itself() {
    let truth = scand_lab::Shape::Box.mesh(0.004);
    let same = Scores::of(&truth, &truth);
    assert!(
        same.f_at_1_mm > 0.999 && same.f_at_half_mm > 0.999,
        "{same:?}"
    );
    assert!(same.underside_mean_mm < 1e-3, "{same:?}");
    assert!((same.volume_share - 1.0).abs() < 1e-9, "{same:?}");
    // A bottom that is 3 mm too low.
    let mut longer = truth.clone();
    for v in longer.vertices.iter_mut().filter(|v| v.z < 1e-4) {
        v.z -= 0.003;
    }
    let found = Scores::of(&longer, &truth);
    // Near its edges, the sides are nearer.
    assert!((2.4..3.1).contains(&found.underside_mean_mm), "{found:?}");
    assert!(
        found.f_at_1_mm < 0.9 && found.volume_share > 1.05,
        "{found:?}"
    );
}
