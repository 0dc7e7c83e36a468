//! Decides the provenance of each vertex, and its expected error.

use super::{Source, Template};
use crate::mesh::vertex_normals;
use crate::reconstruct::depth::{DepthKind, OF_READING};
use crate::reconstruct::hull::{Hull, UpDirections, carving_of, is_floor};
use crate::reconstruct::surface::{Constraint, Surface};
use crate::reconstruct::{Model, Provenance};
use nalgebra::{Point2, Point3, Vector3};
use rayon::prelude::*;

/// Cosine between normal and view above which a carved vertex faces the depth camera.
const FACING: f32 = 0.15;

/// A step between neighbouring pixels of more than this many pixels' width hides what lies behind it.
const STEP_PX: f32 = 4.0;

/// Share of the hull behind a wall that no reading faces by which the wall is expected to be off. The surface may be
/// anywhere between the wall and the hull's far side: on most objects it is near the wall, and in a vase whose neck is
/// narrower than its belly on the far side.
const SHADOWED: f32 = 0.28;

/// Makes a model of a surface of the template's hull carved by the depth of `sources` with regions, in their order.
pub(super) fn describe(surface: Surface, template: &Template, sources: &[Source]) -> Model {
    let hull = template.hull;
    let normals = vertex_normals(&surface.mesh);
    let up = UpDirections::of(hull.bounds());
    // What lay on the table of one capture was seen in another in which it faced up, and may be the mouth of a hollow.
    let was_hidden = |v: usize| up.faced(normals[v]).is_none();
    let of_vertex = |(v, &constraint): (usize, &Constraint)| {
        let p = surface.mesh.vertices[v];
        let footprint = || hull.pixel_footprint(p.cast()) as f32;
        match carving_of(constraint) {
            Some(i) => of_depth(p, normals[v], &sources[i], hull),
            None if is_floor(constraint) && was_hidden(v) => (Provenance::Table, footprint()),
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

/// Where a vertex comes from that a depth camera carved or moved, and its expected error in metres. `normal` is its
/// unit outward normal.
pub(super) fn of_depth(
    p: Point3<f32>,
    normal: Vector3<f32>,
    source: &Source,
    hull: &Hull,
) -> (Provenance, f32) {
    let eye = source.camera.camera.center().cast::<f32>();
    let facing = normal.dot(&(eye - p).normalize());
    let behind = || {
        let p = p.cast();
        hull.reach(p, -normal.cast::<f64>(), hull.pixel_footprint(p)) as f32
    };
    of_carved(p, facing, source, behind)
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
    // A lateral half pixel where the surface is steep, the depth's own noise where it faces the camera.
    let lateral = 0.5 * footprint * (1.0 - facing * facing).max(0.0).sqrt();
    let noise = (source.depth.sigma[(x, y)] * facing.abs()).hypot(lateral);
    let bias = source.regions.bias.remaining as f32 * facing.abs();
    if facing > FACING {
        match kind[(x, y)] {
            DepthKind::Measured => (Provenance::Restored, (OF_READING * noise).hypot(bias)),
            _ => (Provenance::Bridged, noise.hypot(bias)),
        }
    } else {
        let from_seen = (z as f32 - depth[(x, y)]).abs();
        let shadowed = noise.hypot(bias).hypot(SHADOWED * behind());
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reconstruct::restore::testing::{SIDE, camera, evidence};

    /// Provenance and error of a point that the middle pixel sees, which faces the camera with the cosine `facing`.
    fn stated(kind: DepthKind, remaining: f64, facing: f32) -> (Provenance, f32) {
        let camera = camera(0.8);
        let (mut depth, mut regions) = evidence(0.8);
        depth.kind = crate::image::Grid::filled(SIDE, SIDE, kind);
        regions.bias.remaining = remaining;
        let source = Source {
            number: 0,
            camera: &camera,
            depth: &depth,
            regions: &regions,
        };
        of_carved(Point3::origin(), facing, &source, || 0.0)
    }

    #[test]
    fn neighbours_average_the_noise_of_readings_but_no_bias_that_they_share() {
        let noise = stated(DepthKind::Measured, 0.0, 1.0);
        assert_eq!(noise, (Provenance::Restored, OF_READING * 1e-3));
        let (_, biased) = stated(DepthKind::Measured, 8e-3, 1.0);
        assert!((biased - 8e-3_f32.hypot(noise.1)).abs() < 1e-6, "{biased}");
        // What is filled in has no neighbours that were read.
        let (provenance, filled) = stated(DepthKind::Filled, 0.0, 1.0);
        assert_eq!((provenance, filled), (Provenance::Bridged, 1e-3));
    }

    #[test]
    fn where_the_surface_is_steep_the_noise_is_that_across_the_view() {
        let (_, error) = stated(DepthKind::Measured, 0.0, 0.2);
        let lateral = 0.5 * (0.8 / 575.0) * (1.0_f32 - 0.04).sqrt();
        let expected = OF_READING * (0.2e-3_f32).hypot(lateral);
        assert!((error - expected).abs() < 1e-6, "{error} {expected}");
    }
}
