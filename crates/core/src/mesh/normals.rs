//! Computes the normals of vertices.

use super::Mesh;
use crate::array::three;
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

/// Unit outward normals, a vertex each: the mean of the surrounding faces' normals weighted by the angle at
/// the vertex (Thürmer and Wüthrich 1998). A vertex without a face of positive area gets +z.
pub fn vertex_normals(mesh: &Mesh) -> Vec<Vector3<f32>> {
    let shares: Vec<[Vector3<f32>; 3]> = mesh
        .triangles
        .par_iter()
        .map(|t| shares_of(three(|i| mesh.vertices[t[i] as usize])))
        .collect();
    let mut sums = vec![Vector3::<f32>::zeros(); mesh.vertices.len()];
    for (triangle, shares) in mesh.triangles.iter().zip(shares) {
        for (&vertex, share) in triangle.iter().zip(shares) {
            sums[vertex as usize] += share;
        }
    }
    sums.into_par_iter()
        .map(|s| s.try_normalize(1e-12).unwrap_or_else(Vector3::z))
        .collect()
}

/// What a triangle adds to the normals of its corners.
fn shares_of(corners: [Point3<f32>; 3]) -> [Vector3<f32>; 3] {
    let face = (corners[1] - corners[0]).cross(&(corners[2] - corners[0]));
    let Some(normal) = face.try_normalize(f32::MIN_POSITIVE) else {
        return [Vector3::zeros(); 3];
    };
    three(|i| {
        let a = corners[(i + 1) % 3] - corners[i];
        let b = corners[(i + 2) % 3] - corners[i];
        normal * a.angle(&b)
    })
}
