//! Compares two models of one object: how far apart they are, where they differ most, and what else has changed.
//! Neither is taken as the truth.

use super::Error;
use super::against_truth::{Solid, provenance_at};
use super::load::LoadedModel;
use super::sample::{Sample, sample};
use super::statistics::{Summary, share};
use super::surface::Surface;
use crate::mesh::Mesh;
use crate::reconstruct::Provenance;
use nalgebra::Point3;
use rayon::prelude::*;
use serde::Serialize;

/// How two models are compared.
#[derive(serde::Deserialize, Serialize, Clone, Debug, PartialEq)]
#[serde(deny_unknown_fields, default)]
pub struct DifferenceParameters {
    /// Points that are spread evenly over each surface, 1 to 20 000 000; its vertices are looked at beside them.
    /// Default 200 000.
    pub samples: usize,
    /// Surfaces nowhere farther apart than this are the same, in millimetres, 0 or more; round-off is never a
    /// difference. Default 0.01.
    pub tolerance_mm: f64,
    /// Largest number of places with the largest differences that are listed, 0 or more. Default 8.
    pub places: usize,
    /// Places are at least this far apart, in millimetres, 0 or more. Default 10.
    pub place_distance_mm: f64,
}

impl Default for DifferenceParameters {
    fn default() -> Self {
        Self {
            samples: 200_000,
            tolerance_mm: 0.01,
            places: 8,
            place_distance_mm: 10.0,
        }
    }
}

/// Points on a surface are found on it again to 1e-13 mm; this is far more, and far less than a model holds: its
/// coordinates are single precision, to some 1e-5 mm.
const ROUND_OFF_MM: f64 = 1e-6;

impl DifferenceParameters {
    /// What is farther apart, in millimetres, is a difference.
    fn same_within_mm(&self) -> f64 {
        self.tolerance_mm.max(ROUND_OFF_MM)
    }
}

/// What was found.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Difference {
    /// Nowhere farther apart than the tolerance, and alike in tightness, pieces and handles. Provenance does
    /// not count.
    pub same: bool,
    /// From points of a to b. The largest is of its vertices, too.
    pub a_to_b: Summary,
    /// From points of b to a. The largest is of its vertices, too.
    pub b_to_a: Summary,
    /// Mean signed distance from a to points of b: positive where b is larger.
    pub growth_mm: f64,
    /// The first model as a solid.
    pub a: Solid,
    /// The second.
    pub b: Solid,
    /// 100 · (b's volume / a's − 1).
    pub volume_change_percent: f64,
    /// Where they are farthest apart, largest first.
    pub places: Vec<Place>,
    /// Where a's surface has another provenance in b; `None` unless both tell it.
    pub provenance: Option<ProvenanceChanges>,
}

/// A place where the models differ.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Place {
    /// Where, in the rig's frame.
    pub position_mm: [f64; 3],
    /// How far it is from the other model.
    pub distance_mm: f64,
    /// Whose surface it is on.
    pub on: Side,
}

/// One of two models.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Side {
    /// The first.
    A,
    /// The second.
    B,
}

/// What has another provenance.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ProvenanceChanges {
    /// Share of a's surface.
    pub changed_share: f64,
    /// Each kind of change, in the order of the provenances.
    pub changes: Vec<ProvenanceChange>,
}

/// One kind of change.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ProvenanceChange {
    /// In a.
    pub from: Provenance,
    /// At the nearest point of b.
    pub to: Provenance,
    /// Share of a's surface.
    pub share: f64,
}

/// A point of one model, seen from the other.
struct Measured {
    point: Point3<f64>,
    /// Positive outside of the other.
    signed_mm: f64,
    /// Provenance here and at the nearest point of the other.
    provenance: Option<(Provenance, Provenance)>,
}

/// The points of one model, seen from the other.
struct MeasuredSurface {
    /// Of equal shares of the area: means, quantiles and shares of these are those of the surface.
    even: Vec<Measured>,
    /// The vertices, so that nothing small and sharp slips through. They are dense where triangles are small, and say
    /// nothing of how large a part of the surface is.
    vertices: Vec<Measured>,
}

impl MeasuredSurface {
    fn all(&self) -> impl Iterator<Item = &Measured> {
        self.even.iter().chain(&self.vertices)
    }

    fn summary(&self) -> Option<Summary> {
        let even = Summary::of(self.even.iter().map(|p| p.signed_mm.abs()))?;
        Some(Summary {
            max_mm: self.all().map(|p| p.signed_mm.abs()).fold(0.0, f64::max),
            ..even
        })
    }
}

/// Compares two models in one frame.
///
/// # Errors
/// Where one of them has no area.
pub fn difference(
    a: &LoadedModel,
    b: &LoadedModel,
    parameters: &DifferenceParameters,
) -> Result<Difference, Error> {
    let (of_a, of_b) = (
        measure(a, b, "first model", parameters)?,
        measure(b, a, "second model", parameters)?,
    );
    let (Some(a_to_b), Some(b_to_a)) = (of_a.summary(), of_b.summary()) else {
        return Err(Error::NoArea { what: "model" });
    };
    let growth = of_b.even.iter().map(|p| p.signed_mm).sum::<f64>();
    let solids = (Solid::of(&a.mesh), Solid::of(&b.mesh));
    let kind = |s: &Solid| (s.watertight, s.components, s.genus);
    let near = a_to_b.max_mm.max(b_to_a.max_mm) <= parameters.same_within_mm();
    Ok(Difference {
        same: near && kind(&solids.0) == kind(&solids.1),
        a_to_b,
        b_to_a,
        growth_mm: growth / of_b.even.len() as f64,
        volume_change_percent: 100.0 * (solids.1.volume_cm3 / solids.0.volume_cm3 - 1.0),
        a: solids.0,
        b: solids.1,
        places: places(&of_a, &of_b, parameters),
        provenance: provenance_changes(&of_a.even),
    })
}

fn measure(
    model: &LoadedModel,
    other: &LoadedModel,
    what: &'static str,
    parameters: &DifferenceParameters,
) -> Result<MeasuredSurface, Error> {
    let surface = Surface::new(&other.mesh);
    let even = sample(&model.mesh, parameters.samples);
    if even.is_empty() {
        return Err(Error::NoArea { what });
    }
    let at = |s: &Sample| {
        let nearest = surface.nearest(s.point)?;
        let here = provenance_at(model, s.triangle, s.weights);
        let there = provenance_at(other, nearest.triangle, nearest.weights);
        Some(Measured {
            point: s.point,
            signed_mm: nearest.signed_distance * 1e3,
            provenance: here.zip(there),
        })
    };
    let all = |samples: &[Sample]| -> Vec<Measured> { samples.par_iter().filter_map(at).collect() };
    Ok(MeasuredSurface {
        even: all(&even),
        vertices: all(&vertices(&model.mesh)),
    })
}

/// Each vertex once, as a point of the first triangle that names it.
fn vertices(mesh: &Mesh) -> Vec<Sample> {
    let mut found = vec![false; mesh.vertices.len()];
    let mut samples = Vec::with_capacity(mesh.vertices.len());
    for (triangle, corners) in mesh.triangles.iter().enumerate() {
        for (corner, &v) in corners.iter().enumerate() {
            if !std::mem::replace(&mut found[v as usize], true) {
                let mut weights = [0.0; 3];
                weights[corner] = 1.0;
                samples.push(Sample {
                    point: mesh.vertices[v as usize].cast(),
                    triangle,
                    weights,
                });
            }
        }
    }
    samples
}

/// The largest differences above the tolerance, each far enough from those before it.
fn places(
    a: &MeasuredSurface,
    b: &MeasuredSurface,
    parameters: &DifferenceParameters,
) -> Vec<Place> {
    let on = |side: Side| {
        move |p: &Measured| Place {
            position_mm: (p.point.coords * 1e3).into(),
            distance_mm: p.signed_mm.abs(),
            on: side,
        }
    };
    let all = a.all().map(on(Side::A)).chain(b.all().map(on(Side::B)));
    let mut all: Vec<Place> = all
        .filter(|p| p.distance_mm > parameters.same_within_mm())
        .collect();
    all.sort_by(|p, q| q.distance_mm.total_cmp(&p.distance_mm));
    let mut kept: Vec<Place> = Vec::new();
    for place in all {
        if kept.len() == parameters.places {
            break;
        }
        let at = Point3::from(place.position_mm);
        let apart = |other: &Place| {
            (at - Point3::from(other.position_mm)).norm() >= parameters.place_distance_mm
        };
        if kept.iter().all(apart) {
            kept.push(place);
        }
    }
    kept
}

fn provenance_changes(points: &[Measured]) -> Option<ProvenanceChanges> {
    let pairs: Vec<_> = points.iter().filter_map(|p| p.provenance).collect();
    if pairs.is_empty() {
        return None;
    }
    let mut changes = Vec::new();
    for from in Provenance::ALL {
        for to in Provenance::ALL {
            let share = share(&pairs, |&pair| pair == (from, to));
            if from != to && share > 0.0 {
                changes.push(ProvenanceChange { from, to, share });
            }
        }
    }
    Some(ProvenanceChanges {
        // An empty sum is −0.
        changed_share: changes.iter().fold(0.0, |sum, c| sum + c.share),
        changes,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::shapes;

    fn parameters() -> DifferenceParameters {
        DifferenceParameters {
            samples: 20_000,
            ..DifferenceParameters::default()
        }
    }

    fn model(mesh: Mesh) -> LoadedModel {
        LoadedModel {
            mesh,
            ..LoadedModel::default()
        }
    }

    #[test]
    fn the_same_surface_is_the_same_however_it_is_cut_into_triangles() {
        let cube = shapes::cube(0.05);
        let finer = shapes::subdivided(&cube);
        let found = difference(&model(cube), &model(finer), &parameters()).unwrap();
        assert!(found.same && found.places.is_empty());
        assert!(found.a_to_b.max_mm < 1e-6);
        assert_eq!((found.a.vertices, found.b.vertices), (8, 26));
    }

    #[test]
    fn one_dent_is_found_where_it_is() {
        let ball = shapes::sphere(0.03, 5);
        let mut dented = ball.clone();
        let dent = ball.vertices[100];
        dented.vertices[100] *= 0.9;
        let found = difference(&model(ball), &model(dented), &parameters()).unwrap();
        assert!(!found.same);
        let place = found.places[0];
        assert!((place.distance_mm - 3.0).abs() < 1.6, "{place:?}");
        let from_dent = Point3::from(place.position_mm) - dent.cast::<f64>() * 1e3;
        assert!(from_dent.norm() < 3.5, "{place:?}");
        for (i, place) in found.places.iter().enumerate().skip(1) {
            assert!(place.distance_mm <= found.places[i - 1].distance_mm);
        }
        assert!(found.volume_change_percent < 0.0 && found.growth_mm < 0.0);
    }

    #[test]
    fn a_hole_makes_a_difference_even_if_it_is_small() {
        let ball = shapes::sphere(0.03, 5);
        let mut open = ball.clone();
        open.triangles.pop();
        let loose = DifferenceParameters {
            tolerance_mm: 5.0,
            ..parameters()
        };
        assert!(!difference(&model(ball), &model(open), &loose).unwrap().same);
    }

    #[test]
    fn provenance_changes_are_told_and_do_not_count() {
        let with = |of: &dyn Fn(f32) -> Provenance| {
            let mesh = shapes::sphere(0.03, 4);
            LoadedModel {
                provenance: Some(mesh.vertices.iter().map(|v| of(v.z)).collect()),
                ..model(mesh)
            }
        };
        let all_hull = with(&|_| Provenance::Hull);
        let half = with(&|z| {
            if z > 0.0 {
                Provenance::Restored
            } else {
                Provenance::Hull
            }
        });
        let found = difference(&all_hull, &half, &parameters()).unwrap();
        assert!(found.same);
        let [change] = found.provenance.unwrap().changes[..] else {
            panic!("one kind of change")
        };
        let kinds = (change.from, change.to);
        assert_eq!(kinds, (Provenance::Hull, Provenance::Restored));
        assert!((change.share - 0.5).abs() < 0.05, "{}", change.share);
        let none = difference(&all_hull, &model(shapes::sphere(0.03, 4)), &parameters());
        assert_eq!(none.unwrap().provenance, None);
    }

    #[test]
    fn a_model_without_area_is_an_error() {
        let flat = model(shapes::cube(0.0));
        let error = difference(&model(shapes::cube(1.0)), &flat, &parameters()).unwrap_err();
        assert_eq!(error.to_string(), "the second model has no area to compare");
    }

    /// A box, and beside it a ball that has a twelfth of its area and a thousand times as many vertices.
    fn box_and_ball(radius: f32, of_ball: Provenance) -> LoadedModel {
        let mut ball = shapes::sphere(radius, 5);
        ball.vertices.iter_mut().for_each(|v| v.x += 0.2);
        let mut mesh = shapes::cube(0.05);
        let mut provenance = vec![Provenance::Hull; mesh.vertices.len()];
        shapes::append(&mut mesh, &ball);
        provenance.resize(mesh.vertices.len(), of_ball);
        LoadedModel {
            provenance: Some(provenance),
            ..model(mesh)
        }
    }

    #[test]
    fn figures_are_of_the_surface_however_dense_its_vertices_are() {
        let a = box_and_ball(0.02, Provenance::Hull);
        let b = box_and_ball(0.021, Provenance::Restored);
        let found = difference(&a, &b, &parameters()).unwrap();
        let share = |radius: f64| {
            let of_ball = 4.0 * std::f64::consts::PI * radius * radius;
            of_ball / (of_ball + 6.0 * 0.1 * 0.1)
        };
        let near = |found: f64, wanted: f64| {
            assert!((found - wanted).abs() < 0.003, "{found}, not {wanted}");
        };
        let changed = found.provenance.unwrap().changed_share;
        near(changed, share(0.02));
        // A millimetre on the ball, and nothing on the box.
        near(found.a_to_b.mean_mm, share(0.02));
        near(found.growth_mm, share(0.021));
        near(found.a_to_b.p90_mm, 0.0);
        near(found.a_to_b.max_mm, 1.0);
        assert_eq!(found.a_to_b.samples, 20_000);
    }
}
