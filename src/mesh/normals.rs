//! Normals of vertices.

use super::Mesh;
use nalgebra::Vector3;

/// Unit outward normals, a vertex each: the mean of the surrounding faces' normals weighted by the angle at
/// the vertex (Thürmer and Wüthrich 1998). A vertex without a face of positive area gets +z.
pub fn vertex_normals(mesh: &Mesh) -> Vec<Vector3<f32>> {
    let mut sums = vec![Vector3::<f32>::zeros(); mesh.vertices.len()];
    for triangle in &mesh.triangles {
        let corners = triangle.map(|v| mesh.vertices[v as usize]);
        let face = (corners[1] - corners[0]).cross(&(corners[2] - corners[0]));
        let Some(normal) = face.try_normalize(f32::MIN_POSITIVE) else {
            continue;
        };
        for i in 0..3 {
            let a = corners[(i + 1) % 3] - corners[i];
            let b = corners[(i + 2) % 3] - corners[i];
            sums[triangle[i] as usize] += normal * a.angle(&b);
        }
    }
    sums.into_iter()
        .map(|s| s.try_normalize(1e-12).unwrap_or_else(Vector3::z))
        .collect()
}
