//! Makes the surface of a box as a mesh.

use super::Mesh;
use nalgebra::Point3;

/// An axis-aligned box between two corners.
pub fn cuboid(min: [f32; 3], max: [f32; 3]) -> Mesh {
    let vertices = (0..8)
        .map(|i| {
            let at = |axis: usize| [min, max][i >> axis & 1][axis];
            Point3::new(at(0), at(1), at(2))
        })
        .collect();
    #[rustfmt::skip]
    let triangles = vec![
        [0, 2, 3], [0, 3, 1], [4, 5, 7], [4, 7, 6], [0, 1, 5], [0, 5, 4],
        [2, 6, 7], [2, 7, 3], [0, 4, 6], [0, 6, 2], [1, 3, 7], [1, 7, 5],
    ];
    Mesh {
        vertices,
        triangles,
    }
}
