//! Chooses points of a model for a dataset: their positions, their colours, and the pictures that show them.

use super::undistort::View;
use crate::mesh::Bvh;
use crate::reconstruct::{Model, Provenance};
use nalgebra::{Point2, Point3, Vector3};
use rayon::prelude::*;

/// Points of a dataset, at most.
const MOST: usize = 20_000;
/// A surface that turns farther away from a camera than this is not counted as seen: the cosine of 80°.
const LEAST_COSINE: f64 = 0.17;
/// A ray begins this far above the surface, in metres, so that it does not meet the point's own triangles.
const ABOVE: f64 = 2e-4;

/// A point of the surface.
#[derive(Clone, Debug, PartialEq)]
pub struct Point {
    /// Its place in the rig's frame, in metres.
    pub position: Point3<f64>,
    /// Its outward unit normal.
    pub normal: Vector3<f64>,
    /// Its colour, sRGB-encoded.
    pub color: [u8; 3],
    /// The views that show it, by their index, and where, in pixels.
    pub seen: Vec<(usize, Point2<f64>)>,
}

/// Vertices of the model that two views or more show, evenly taken from all of them. Those that no camera measured (on
/// the table, or unseen) are left out.
pub fn points(model: &Model, views: &[View]) -> Vec<Point> {
    let known = |v: &usize| !matches!(model.provenance[*v], Provenance::Unseen | Provenance::Table);
    let vertices: Vec<usize> = (0..model.mesh.vertices.len()).filter(known).collect();
    let step = vertices.len().div_ceil(MOST).max(1);
    let bvh = Bvh::new(&model.mesh);
    let taken: Vec<usize> = vertices.into_iter().step_by(step).collect();
    let points = taken.par_iter().map(|&v| point(model, &bvh, views, v));
    points.filter(|point| point.seen.len() >= 2).collect()
}

fn point(model: &Model, bvh: &Bvh, views: &[View], vertex: usize) -> Point {
    let position: Point3<f64> = model.mesh.vertices[vertex].cast();
    let normal: Vector3<f64> = model.normals[vertex].cast();
    let start = position + normal * ABOVE;
    let shows = |(index, view): (usize, &View)| {
        let to_camera = Point3::from(view.rig_from_camera.translation.vector) - start;
        let faces = to_camera.dot(&normal) > LEAST_COSINE * to_camera.norm();
        let pixel = view.project(position).filter(|_| faces)?;
        (!bvh.is_occluded(start, to_camera, 1.0)).then_some((index, pixel))
    };
    Point {
        position,
        normal,
        color: model
            .texture
            .as_ref()
            .map_or([128; 3], |t| t.vertex_colors[vertex]),
        seen: views.iter().enumerate().filter_map(shows).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{ball, two_views};
    use super::*;

    #[test]
    fn points_are_seen_from_the_side_that_they_face() {
        let (model, views) = (ball(), two_views());
        let found = points(&model, &views);
        assert!(!found.is_empty() && found.len() < model.mesh.vertices.len());
        for point in &found {
            assert_eq!(point.seen.len(), 2);
            for (index, pixel) in &point.seen {
                let view = &views[*index];
                assert!((view.project(point.position).unwrap() - pixel).norm() < 1e-9);
                let to_camera =
                    Point3::from(view.rig_from_camera.translation.vector) - point.position;
                assert!(to_camera.dot(&point.normal) > 0.0);
            }
        }
    }

    #[test]
    fn what_was_not_measured_is_no_point() {
        let mut model = ball();
        model.provenance.fill(Provenance::Unseen);
        assert_eq!(points(&model, &two_views()), []);
    }
}
