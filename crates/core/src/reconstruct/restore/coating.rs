//! The paper's own restoration (section 2.F): the hull's patch over a cavity, the lid M, is given the
//! Laplacian coordinates of the depth surface H, which has M's topology and lies on the same rays
//! (equations 7 to 9).
//!
//! With the coating ξ = δ_H - δ_M equation 9 becomes L S = δ_M + ξ = δ_H. L is singular, so an anchor is part
//! of the method: soft weights towards H where the depth was measured, and the border where M meets the rest
//! of the hull.

use super::factor::solve;
use super::laplacian::{Patch, ScreenedSystem, Singular};
use super::provenance::of_depth;
use super::{Parameters, Source, Template};
use crate::image::Grid;
use crate::mesh::{Mesh, vertex_normals};
use crate::reconstruct::Model;
use crate::reconstruct::depth::DepthKind;
use crate::reconstruct::region::front_vertices;
use nalgebra::{Point2, Point3};

/// Moves the lids of the regions that one depth camera sees onto its depth. `depth` is the carving depth of
/// the regions, 0 elsewhere.
///
/// # Errors
/// If a part of the lid hangs in the air.
pub(super) fn restore(
    model: &mut Model,
    source: &Source,
    depth: &Grid<f32>,
    parameters: &Parameters,
    template: &Template,
) -> Result<(), Singular> {
    let front_threshold = template.front_threshold;
    let maker = template.fused_captures.of_depth_view(source.number);
    let eye: Point3<f32> = source.camera.camera.center().cast();
    let front = front_vertices(&model.mesh, &model.normals, eye, front_threshold);
    let seen: Vec<Option<(usize, usize)>> = model
        .mesh
        .vertices
        .iter()
        .map(|&v| region_pixel(v, source))
        .collect();
    let patch = Patch::new(&model.mesh, |v| {
        front[v as usize] && seen[v as usize].is_some()
    });
    let lid: Vec<[f64; 3]> = patch
        .vertices
        .iter()
        .map(|&v| position(&model.mesh, v))
        .collect();
    let mut surface = lid.clone();
    for (h, &v) in surface.iter_mut().zip(&patch.vertices[..patch.inner]) {
        *h = on_depth(model.mesh.vertices[v as usize], source, depth).unwrap_or(*h);
    }
    let (delta_lid, delta_surface) = (patch.laplacian(&lid), patch.laplacian(&surface));
    let coated: Vec<[f64; 3]> = delta_lid
        .iter()
        .zip(&delta_surface)
        .map(|(m, h)| {
            let coating: [f64; 3] = std::array::from_fn(|k| h[k] - m[k]);
            std::array::from_fn(|k| m[k] + coating[k])
        })
        .collect();
    let weight = |&v: &u32| {
        let measured =
            seen[v as usize].is_some_and(|p| source.depth.kind[p] == DepthKind::Measured);
        if measured {
            parameters.anchor_weight
        } else {
            0.1 * parameters.anchor_weight
        }
    };
    let weights: Vec<f64> = patch.vertices[..patch.inner].iter().map(weight).collect();
    let solution = solve(
        &patch,
        &ScreenedSystem {
            delta: &coated,
            delta_weight: 1.0,
            target: &surface[..patch.inner],
            target_weight: &weights,
            ring: &lid[patch.inner..],
        },
    )?;
    for (x, &v) in solution.iter().zip(&patch.vertices) {
        model.mesh.vertices[v as usize] = Point3::from(*x).cast();
    }
    model.normals = vertex_normals(&model.mesh);
    for &v in &patch.vertices[..patch.inner] {
        let v = v as usize;
        let (p, normal) = (model.mesh.vertices[v], model.normals[v]);
        (model.provenance[v], model.expected_error[v]) = of_depth(p, normal, source, template.hull);
        if let Some(captures) = model.captures.get_mut(v) {
            *captures = maker;
        }
    }
    Ok(())
}

fn position(mesh: &Mesh, v: u32) -> [f64; 3] {
    mesh.vertices[v as usize].cast::<f64>().into()
}

/// The pixel of a region that sees a vertex.
fn region_pixel(v: Point3<f32>, source: &Source) -> Option<(usize, usize)> {
    let (pixel, _) = source.camera.project(v.cast())?;
    let (x, y) = (pixel.x.round(), pixel.y.round());
    let labels = &source.regions.labels;
    labels.get(x as isize, y as isize).filter(|&&l| l != 0)?;
    Some((x as usize, y as usize))
}

/// The point of the depth surface on the ray of a vertex: bilinear over the region's pixels.
fn on_depth(v: Point3<f32>, source: &Source, depth: &Grid<f32>) -> Option<[f64; 3]> {
    let (pixel, _) = source.camera.project(v.cast())?;
    let (x0, y0) = (pixel.x.floor(), pixel.y.floor());
    let (mut sum, mut weights) = (0.0, 0.0);
    for (dx, dy) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)] {
        let (x, y) = (x0 + dx, y0 + dy);
        let inside = source
            .regions
            .labels
            .get(x as isize, y as isize)
            .is_some_and(|&l| l != 0);
        if inside && depth[(x as usize, y as usize)] > 0.0 {
            let weight = (1.0 - (pixel.x - x).abs()) * (1.0 - (pixel.y - y).abs());
            sum += weight * f64::from(depth[(x as usize, y as usize)]);
            weights += weight;
        }
    }
    let point = source
        .camera
        .point(Point2::new(pixel.x, pixel.y), sum / weights)?;
    (weights > 1e-6).then(|| point.into())
}
