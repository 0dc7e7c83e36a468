//! Measures what a person sees first in a model: how far the truth's edges are rounded off, by how much the outside's
//! normals are wrong (facets and waves), and what is dented.

use super::Parameters;
use super::near::PointGrid;
use super::sample::{Sample, sample};
use super::surface::{Nearest, Surface};
use crate::mesh::{Mesh, volume_and_total_area};
use nalgebra::{Point3, Vector3};

/// Radius in metres within which the truth's normals tell whether a place is at an edge.
const EDGE_RADIUS: f64 = 1.5e-3;
/// A place is at an edge if the mean of the unit normals around it is shorter: two faces meet at 52° or more there.
const EDGE_NORMAL: f64 = 0.9;
/// Metres beneath the truth's convex hull within which a place belongs to the outside.
const OUTSIDE: f64 = 0.5e-3;
/// Metres within which the model must have a surface, for its normal to be compared.
const COMPARED: f64 = 5e-3;
/// Metres by which the truth must stand out of the model to count as dented.
const DENT: f64 = 0.3e-3;
/// Points a square metre that stand for the surfaces where normals are averaged: some 14 within [`EDGE_RADIUS`] of a
/// place on a flat surface, so that a place near an edge has some on both faces, however large the object is.
const POINTS_A_SQUARE_METRE: f64 = 2e6;
/// The fewest of the truth and of the model, which objects smaller than a cup have.
const OF_SMALL_TRUTH: usize = 60_000;
const OF_SMALL_MODEL: usize = 120_000;
/// The most of one surface, for memory's sake: they stand close enough on a square metre, as a cube of 40 cm has.
const MOST_POINTS: usize = 2_000_000;
/// Points of the model around a place whose normals are averaged, so that facets count as what they show.
const AVERAGED: usize = 6;

/// What a person sees of a place of the truth in the model.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Seen {
    /// Whether the place is at a sharp edge or rim.
    pub is_edge: bool,
    /// On the outside and not at an edge: the angle between the truth's normal and the mean of the model's around the
    /// nearest point, in degrees.
    pub outside_degrees: Option<f64>,
    /// Whether the model leaves the place outside by more than 0.3 mm.
    pub is_dented: bool,
}

/// The normals of the truth and of the model around their places.
pub(super) struct Appearance {
    truth: Normals,
    model: Normals,
}

impl Appearance {
    /// Prepares both surfaces. Of the truth only what is above the floor counts.
    pub(super) fn new(truth: &Surface, model: &Surface, parameters: &Parameters) -> Self {
        let floor = parameters.floor_mm / 1e3;
        let mut of_truth = points(truth.mesh, OF_SMALL_TRUTH);
        of_truth.retain(|sample| sample.point.z > floor);
        let of_model = points(model.mesh, OF_SMALL_MODEL);
        let (_, area) = volume_and_total_area(model.mesh);
        // On a flat surface a disc of this radius holds some more points than are averaged.
        let square = 1.5 * AVERAGED as f64 * area / (std::f64::consts::PI * of_model.len() as f64);
        let radius = if square.is_finite() {
            square.sqrt()
        } else {
            0.0
        };
        Self {
            truth: Normals::new(truth, &of_truth, EDGE_RADIUS),
            model: Normals::new(model, &of_model, radius.max(1e-6)),
        }
    }

    /// What is seen of a place of the truth that is `beneath_hull` metres beneath the truth's convex hull and has the
    /// unit normal `normal`; `nearest` is the model's nearest point.
    pub(super) fn at(
        &self,
        place: &Sample,
        normal: Vector3<f64>,
        beneath_hull: f64,
        nearest: &Nearest,
    ) -> Seen {
        let is_edge = self.truth.is_edge(place.point);
        let is_compared =
            !is_edge && beneath_hull < OUTSIDE && nearest.signed_distance.abs() < COMPARED;
        let of_model = is_compared.then(|| self.model.around(nearest.point));
        Seen {
            is_edge,
            outside_degrees: of_model
                .flatten()
                .map(|found| found.angle(&normal).to_degrees()),
            is_dented: nearest.signed_distance > DENT,
        }
    }
}

/// Points spread evenly over a surface, `fewest` or more. How many there are depends on the surface alone: a figure
/// must not change with the number of places where it is measured.
fn points(mesh: &Mesh, fewest: usize) -> Vec<Sample> {
    let (_, area) = volume_and_total_area(mesh);
    let count = (area * POINTS_A_SQUARE_METRE).ceil() as usize;
    sample(mesh, count.clamp(fewest, MOST_POINTS))
}

/// Unit normals of points of a surface.
struct Normals {
    points: PointGrid,
    normals: Vec<Vector3<f64>>,
}

impl Normals {
    fn new(surface: &Surface, samples: &[Sample], cube: f64) -> Self {
        let normal = |sample: &Sample| surface.face_normal(sample.triangle);
        Self {
            points: PointGrid::new(samples.iter().map(|sample| sample.point), cube),
            normals: samples.iter().map(normal).collect(),
        }
    }

    /// Whether the normals within a cube's edge differ as they do where faces meet.
    fn is_edge(&self, p: Point3<f64>) -> bool {
        let (mut sum, mut count): (Vector3<f64>, f64) = (Vector3::zeros(), 0.0);
        for index in self.points.within_an_edge(p) {
            sum += self.normals[index];
            count += 1.0;
        }
        count > 0.0 && sum.norm() < EDGE_NORMAL * count
    }

    /// The mean unit normal of the nearest points; `None` where they cancel out.
    fn around(&self, p: Point3<f64>) -> Option<Vector3<f64>> {
        let nearest = self.points.nearest(p, AVERAGED);
        let sum: Vector3<f64> = nearest.iter().map(|&index| self.normals[index]).sum();
        sum.try_normalize(1e-9)
    }
}
