//! Relaxes the restored patches that face a depth camera towards its depth surface, by a screened Laplacian system:
//! detail comes from the depth, weighted by the certainty of each pixel, and the traces of noise and of the pixels'
//! raster are smoothed away. Walls and everything else stay where the carving put them.

use super::iterate::solve;
use super::laplacian::{Patch, ScreenedSystem, Singular};
use super::{Parameters, Source};
use crate::mesh::vertex_normals;
use crate::reconstruct::{Model, Provenance};
use nalgebra::{Point3, Vector3};

/// Relaxes what `sources` restored. `source_of` tells on whose carving a vertex lies. They are relaxed together: where
/// two of them restored one surface, it is one.
///
/// # Errors
/// If a part of the patch has no anchor.
pub(super) fn relax(
    model: &mut Model,
    sources: &[Source],
    source_of: impl Fn(usize) -> Option<usize>,
    parameters: &Parameters,
) -> Result<(), Singular> {
    let restored = |v: u32| {
        let from = model.provenance[v as usize];
        source_of(v as usize).is_some()
            && matches!(from, Provenance::Restored | Provenance::Bridged)
    };
    let patch = Patch::new(&model.mesh, restored);
    let positions: Vec<[f64; 3]> = patch
        .vertices
        .iter()
        .map(|&v| model.mesh.vertices[v as usize].cast::<f64>().into())
        .collect();
    let weight = |&v: &u32| {
        let noise = source_of(v as usize).map_or(0.0, |i| sources[i].depth.facts.temporal_noise);
        let sigma = f64::from(model.expected_error[v as usize]).max(1e-5);
        (f64::from(noise).max(1e-5) / sigma)
            .powi(2)
            .clamp(0.05, 4.0)
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
    for (x, &v) in solution.iter().zip(&patch.vertices) {
        let v = v as usize;
        let Some(source) = source_of(v) else {
            continue;
        };
        let eye: Point3<f32> = sources[source].camera.camera.center().cast();
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
