//! Compares a model with the truth: samples both, measures, and sums the figures up for the whole model and for
//! each provenance.

use super::appearance::Appearance;
use super::expected::Expected;
use super::figures::{Figures, ModelSample, TruthSample, expected};
use super::load::LoadedModel;
use super::rim::Rims;
use super::sample::{Sample, sample};
use super::surface::Surface;
use super::{Error, Parameters, wall};
use crate::mesh::{Mesh, check, convex_hull};
use crate::reconstruct::Provenance;
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use serde::Serialize;

/// All that was found.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Evaluation {
    /// Of the whole model.
    pub whole: Figures,
    /// The figures for each provenance, if the model has provenances. A point of the truth belongs to the provenance of
    /// the model's nearest point.
    pub by_provenance: Vec<ProvenanceFigures>,
    /// Expected errors against actual ones, by what was expected.
    pub by_expected_error: Vec<ExpectedBin>,
    /// The model as a solid.
    pub model: Solid,
    /// The truth as a solid.
    pub truth: Solid,
    /// 100 · (|model's volume| / truth's volume − 1).
    pub volume_error_percent: f64,
}

/// Of the part of one provenance.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ProvenanceFigures {
    /// Which.
    pub provenance: Provenance,
    /// Its share of the model's samples.
    pub share: f64,
    /// What was found.
    #[serde(flatten)]
    pub figures: Figures,
}

/// Samples whose expected error lies in a range.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ExpectedBin {
    /// From here.
    pub from_mm: f64,
    /// To below here; none is without end.
    pub to_mm: Option<f64>,
    /// What was found.
    #[serde(flatten)]
    pub expected: Expected,
}

/// A mesh as a solid.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Solid {
    /// Vertices.
    pub vertices: usize,
    /// Triangles.
    pub triangles: usize,
    /// Closed, oriented and manifold.
    pub watertight: bool,
    /// Connected pieces.
    pub components: usize,
    /// Handles, summed over the pieces; only of what is watertight.
    pub genus: Option<u64>,
    /// Volume in cubic centimetres.
    pub volume_cm3: f64,
    /// Area in square centimetres.
    pub area_cm2: f64,
}

impl Solid {
    /// Examines a mesh.
    pub fn of(mesh: &Mesh) -> Self {
        let report = check(mesh);
        Self {
            vertices: report.vertices,
            triangles: report.triangles,
            watertight: report.is_watertight(),
            components: report.components,
            genus: report.genus,
            volume_cm3: report.volume * 1e6,
            area_cm2: report.area * 1e4,
        }
    }
}

/// Measures `model` against `truth`, both z up in metres and in the same frame.
///
/// # Errors
/// Where one of the two has no surface above the floor.
pub fn evaluate(
    model: &LoadedModel,
    truth: &Mesh,
    parameters: &Parameters,
) -> Result<Evaluation, Error> {
    let (model_surface, truth_surface) = (Surface::new(&model.mesh), Surface::new(truth));
    let rims = Rims::new(truth, parameters);
    let of_model = sample_above(&model.mesh, "model", parameters)?;
    let of_truth = sample_above(truth, "truth", parameters)?;
    let measure = MeasureModel {
        model,
        surface: &model_surface,
        truth: &truth_surface,
        rims: &rims,
        parameters,
    };
    let model_samples: Vec<_> = of_model.par_iter().filter_map(|s| measure.at(s)).collect();
    let measure = MeasureTruth {
        model,
        surface: &model_surface,
        truth: &truth_surface,
        hull: convex_hull(&truth.used_vertices()),
        rims: &rims,
        appearance: Appearance::new(&truth_surface, &model_surface, parameters),
        parameters,
    };
    let truth_samples = measure.all(&of_truth);
    let solids = (Solid::of(&model.mesh), Solid::of(truth));
    Ok(Evaluation {
        whole: Figures::of(&model_samples, &truth_samples, parameters),
        by_provenance: by_provenance(&model_samples, &truth_samples, parameters),
        by_expected_error: by_expected_error(&model_samples, parameters),
        model: solids.0,
        truth: solids.1,
        volume_error_percent: 100.0 * (solids.0.volume_cm3.abs() / solids.1.volume_cm3.abs() - 1.0),
    })
}

/// The samples above the floor: the side on which the object stands is never seen.
fn sample_above(
    mesh: &Mesh,
    what: &'static str,
    parameters: &Parameters,
) -> Result<Vec<Sample>, Error> {
    let mut samples = sample(mesh, parameters.samples);
    samples.retain(|s| s.point.z > parameters.floor_mm / 1e3);
    if samples.is_empty() {
        return Err(Error::NoSurface {
            what,
            floor_mm: parameters.floor_mm,
        });
    }
    Ok(samples)
}

struct MeasureModel<'a> {
    model: &'a LoadedModel,
    surface: &'a Surface<'a>,
    truth: &'a Surface<'a>,
    rims: &'a Rims,
    parameters: &'a Parameters,
}

impl MeasureModel<'_> {
    fn at(&self, sample: &Sample) -> Option<ModelSample> {
        let nearest = self.truth.nearest(sample.point)?;
        let normals = (
            self.surface.face_normal(sample.triangle),
            self.truth.face_normal(nearest.triangle),
        );
        Some(ModelSample {
            signed_mm: nearest.signed_distance * 1e3,
            degrees: normals.0.angle(&normals.1).to_degrees(),
            near_rim: self
                .rims
                .are_near(nearest.point, self.parameters.rim_width_mm / 1e3),
            provenance: provenance_at(self.model, sample.triangle, sample.weights),
            expected_mm: expected_at(self.model, sample),
        })
    }
}

/// Of the triangle's corner that is nearest.
pub(super) fn provenance_at(
    model: &LoadedModel,
    triangle: usize,
    weights: [f64; 3],
) -> Option<Provenance> {
    let corner = (0..3).fold(
        0,
        |best, i| if weights[i] > weights[best] { i } else { best },
    );
    let vertex = model.mesh.triangles[triangle][corner];
    Some(model.provenance.as_ref()?[vertex as usize])
}

fn expected_at(model: &LoadedModel, sample: &Sample) -> Option<f64> {
    let values = model.expected_error.as_ref()?;
    let corners = model.mesh.triangles[sample.triangle].iter();
    let weighted = corners
        .zip(sample.weights)
        .map(|(&v, w)| w * f64::from(values[v as usize]));
    // In the precision that the model has it in, so that the same value at all corners is that value between them.
    Some(f64::from(weighted.sum::<f64>() as f32) * 1e3)
}

struct MeasureTruth<'a> {
    model: &'a LoadedModel,
    surface: &'a Surface<'a>,
    truth: &'a Surface<'a>,
    hull: Option<Mesh>,
    rims: &'a Rims,
    appearance: Appearance,
    parameters: &'a Parameters,
}

impl MeasureTruth<'_> {
    fn all(&self, samples: &[Sample]) -> Vec<TruthSample> {
        let hull = self.hull.as_ref().map(Surface::new);
        samples
            .par_iter()
            .filter_map(|s| self.at(s, hull.as_ref()))
            .collect()
    }

    fn at(&self, sample: &Sample, hull: Option<&Surface>) -> Option<TruthSample> {
        let nearest = self.surface.nearest(sample.point)?;
        let on_hull = hull.and_then(|hull| hull.nearest(sample.point));
        let beneath_hull = on_hull.map_or(0.0, |n| n.signed_distance.abs());
        let normal = self.truth.face_normal(sample.triangle);
        let concave = self.is_concave(normal, beneath_hull);
        Some(TruthSample {
            distance_mm: nearest.signed_distance.abs() * 1e3,
            near_rim: self
                .rims
                .are_near(sample.point, self.parameters.rim_width_mm / 1e3),
            concave_mm: concave.then(|| self.along_normal(sample.point, normal)),
            wall: wall::behind(self.truth, self.surface, sample, self.parameters),
            provenance: provenance_at(self.model, nearest.triangle, nearest.weights),
            seen: self.appearance.at(sample, normal, beneath_hull, &nearest),
        })
    }

    /// Deep inside the truth's convex hull, and facing up or inwards.
    fn is_concave(&self, normal: Vector3<f64>, beneath_hull: f64) -> bool {
        beneath_hull > self.parameters.concave_depth_mm / 1e3 && normal.z > -0.2
    }

    /// The distance along the normal, either way, to the first face of the model if it turns the same way,
    /// for the other side of a thin wall must not count as found; in millimetres, capped.
    fn along_normal(&self, p: Point3<f64>, normal: Vector3<f64>) -> f64 {
        let either = [normal, -normal].map(|along| {
            let hit = self.surface.cast(p - along * 1e-6, along)?;
            let same = hit.cosine * along.dot(&normal) > 0.3;
            same.then_some(hit.distance * 1e3)
        });
        let cap = self.parameters.cap_mm;
        either.into_iter().flatten().fold(cap, f64::min)
    }
}

fn by_provenance(
    model: &[ModelSample],
    truth: &[TruthSample],
    parameters: &Parameters,
) -> Vec<ProvenanceFigures> {
    let of = |provenance: Provenance| {
        let part: Vec<_> = model
            .iter()
            .filter(|s| s.provenance == Some(provenance))
            .copied()
            .collect();
        let other: Vec<_> = truth
            .iter()
            .filter(|s| s.provenance == Some(provenance))
            .copied()
            .collect();
        let found = !(part.is_empty() && other.is_empty());
        found.then(|| ProvenanceFigures {
            provenance,
            share: part.len() as f64 / model.len() as f64,
            figures: Figures::of(&part, &other, parameters),
        })
    };
    Provenance::ALL.into_iter().filter_map(of).collect()
}

fn by_expected_error(model: &[ModelSample], parameters: &Parameters) -> Vec<ExpectedBin> {
    let mut from_mm = 0.0;
    let ends = parameters.expected_bins_mm.iter().map(|&end| Some(end));
    ends.chain([None])
        .filter_map(|to_mm| {
            let range = from_mm..to_mm.unwrap_or(f64::INFINITY);
            let bin = expected(model, |s| s.expected_mm.is_some_and(|e| range.contains(&e)));
            let from_mm = std::mem::replace(&mut from_mm, range.end);
            bin.map(|expected| ExpectedBin {
                from_mm,
                to_mm,
                expected,
            })
        })
        .collect()
}
