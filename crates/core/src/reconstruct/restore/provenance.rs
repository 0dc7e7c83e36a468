//! Decides the provenance of each vertex, and its expected error.

use super::{Source, Template};
use crate::mesh::vertex_normals;
use crate::reconstruct::depth::DepthKind;
use crate::reconstruct::hull::{Carving, carving_of, is_floor};
use crate::reconstruct::surface::{Constraint, Surface};
use crate::reconstruct::{Model, Provenance};
use nalgebra::{Point2, Point3};
use rayon::prelude::*;

/// Cosine between normal and view above which a carved vertex faces the depth camera.
const FACING: f32 = 0.15;

/// A step between neighbouring pixels of more than this many pixels' width hides what lies behind it.
const STEP_PX: f32 = 4.0;

/// Share of the hull behind a wall that no reading faces by which the wall is expected to be off. The surface may be
/// anywhere between the wall and the hull's far side: on most objects it is near the wall, and in a vase whose neck is
/// narrower than its belly on the far side.
const SHADOWED: f32 = 0.28;

/// Makes a model of a surface of the template's hull carved by `carvings`, which come from `sources` with regions, in
/// their order.
pub(super) fn describe(
    surface: Surface,
    template: &Template,
    carvings: &[Carving],
    sources: &[Source],
) -> Model {
    let hull = template.hull;
    let normals = vertex_normals(&surface.mesh);
    let of_vertex = |(v, &constraint): (usize, &Constraint)| {
        let p = surface.mesh.vertices[v];
        let footprint = || hull.pixel_footprint(p.cast()) as f32;
        match carving_of(constraint) {
            Some(i) => {
                let source = &sources[i];
                let eye = carvings[i].camera().camera.center().cast::<f32>();
                let facing = normals[v].dot(&(eye - p).normalize());
                let behind = || hull.reach(p.cast(), -normals[v].cast::<f64>(), footprint().into());
                of_carved(p, facing, source, || behind() as f32)
            }
            None if is_floor(constraint) => (Provenance::Table, footprint()),
            None => (Provenance::Hull, footprint()),
        }
    };
    let vertices = surface.constraints.par_iter().enumerate();
    let (provenance, expected_error) = vertices.clone().map(of_vertex).unzip();
    let fused = template.fused_captures;
    let makers = |(v, &constraint): (usize, &Constraint)| match carving_of(constraint) {
        Some(i) => fused.of_depth_view(sources[i].number),
        None => fused.touching(hull, surface.mesh.vertices[v].cast()),
    };
    let captures = match fused.is_of_several() {
        true => vertices.map(makers).collect(),
        false => Vec::new(),
    };
    Model {
        mesh: surface.mesh,
        normals,
        provenance,
        expected_error,
        captures,
        texture: None,
    }
}

/// `behind` tells how thick the hull is behind the vertex, in metres.
fn of_carved(
    p: Point3<f32>,
    facing: f32,
    source: &Source,
    behind: impl Fn() -> f32,
) -> (Provenance, f32) {
    let Some((pixel, z)) = source.camera.project(p.cast()) else {
        return (Provenance::Carved, SHADOWED * behind());
    };
    let footprint = source.camera.camera.pixel_footprint(p.cast()) as f32;
    let (depth, kind) = (&source.depth.depth, &source.depth.kind);
    let (x, y) = nearest(pixel, depth.width(), depth.height());
    let remaining = source.regions.bias.remaining as f32;
    let along_view = source.depth.sigma[(x, y)].hypot(remaining);
    // A lateral half pixel where the surface is steep, the depth's own error where it faces the camera.
    let lateral = 0.5 * footprint * (1.0 - facing * facing).max(0.0).sqrt();
    let error = (along_view * facing.abs()).hypot(lateral);
    if facing > FACING {
        match kind[(x, y)] {
            DepthKind::Measured => (Provenance::Restored, error),
            _ => (Provenance::Bridged, error),
        }
    } else {
        let from_seen = (z as f32 - depth[(x, y)]).abs();
        let shadowed = error.hypot(SHADOWED * behind());
        if step(depth, x, y) > STEP_PX * footprint && from_seen > 2.0 * footprint {
            (Provenance::Unseen, shadowed)
        } else {
            (Provenance::Carved, shadowed)
        }
    }
}

fn nearest(pixel: Point2<f64>, width: usize, height: usize) -> (usize, usize) {
    let clamp = |v: f64, n: usize| v.round().clamp(0.0, n as f64 - 1.0) as usize;
    (clamp(pixel.x, width), clamp(pixel.y, height))
}

/// The largest difference of depth between a pixel and its four neighbours.
fn step(depth: &crate::image::Grid<f32>, x: usize, y: usize) -> f32 {
    let here = depth[(x, y)];
    [(-1, 0), (1, 0), (0, -1), (0, 1)]
        .iter()
        .filter_map(|&(dx, dy)| depth.get(x as isize + dx, y as isize + dy))
        .filter(|&&d| d > 0.0)
        .map(|d| (d - here).abs())
        .fold(0.0, f32::max)
}
