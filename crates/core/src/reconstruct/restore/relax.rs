//! Relaxes the restored patches that face a depth camera towards its depth surface, by a screened Laplacian system:
//! detail comes from the depth, weighted by the certainty of each pixel, and the traces of noise and of the pixels'
//! raster are smoothed away. Walls and everything else stay where the carving put them.

use super::iterate::solve;
use super::laplacian::{Patch, ScreenedSystem, Singular};
use super::{Parameters, Source};
use crate::mesh::vertex_normals;
use crate::reconstruct::{Model, Provenance};
use nalgebra::{Point3, Vector3};

/// Relaxes what `source` restored. `is_of_source` tells which vertices lie on its carving.
///
/// # Errors
/// If a part of the patch has no anchor.
pub(super) fn relax(
    model: &mut Model,
    source: &Source,
    is_of_source: impl Fn(usize) -> bool,
    parameters: &Parameters,
) -> Result<(), Singular> {
    let restored = |v: u32| {
        let from = model.provenance[v as usize];
        is_of_source(v as usize) && matches!(from, Provenance::Restored | Provenance::Bridged)
    };
    let patch = Patch::new(&model.mesh, restored);
    let positions: Vec<[f64; 3]> = patch
        .vertices
        .iter()
        .map(|&v| model.mesh.vertices[v as usize].cast::<f64>().into())
        .collect();
    let noise = f64::from(source.depth.facts.temporal_noise).max(1e-5);
    let weight = |&v: &u32| {
        let sigma = f64::from(model.expected_error[v as usize]).max(1e-5);
        (noise / sigma).powi(2).clamp(0.05, 4.0)
    };
    let weights: Vec<f64> = patch.vertices[..patch.inner].iter().map(weight).collect();
    let solution = solve(
        &patch,
        &ScreenedSystem {
            delta: &vec![[0.0; 3]; patch.inner],
            delta_weight: parameters.smoothness,
            target: &positions[..patch.inner],
            target_weight: &weights,
            ring: &positions[patch.inner..],
        },
    )?;
    let eye: Point3<f32> = source.camera.camera.center().cast();
    for (x, &v) in solution.iter().zip(&patch.vertices) {
        let v = v as usize;
        // Only along the normal: sliding within the surface would even out the triangles and shrink rims.
        let normal: Vector3<f32> = model.normals[v];
        let here = model.mesh.vertices[v];
        let towards_eye = (eye - here).try_normalize(1e-12).unwrap_or(normal);
        if normal.dot(&towards_eye) > 0.0 {
            let moved: Point3<f32> = Point3::from(*x).cast();
            model.mesh.vertices[v] = here + normal * normal.dot(&(moved - here));
        }
    }
    model.normals = vertex_normals(&model.mesh);
    Ok(())
}
