//! A mesh with fewer vertices, made quickly: good enough to be compared and drawn at a low resolution.

use crate::mesh::{Mesh, bounding_box};
use nalgebra::{Point3, center, distance_squared};
use rayon::prelude::*;

/// A mesh with the vertices of each cell of a grid of edge `cell` metres merged into the one of them that is
/// farthest from the middle, so that convex outlines stay where they are. Not manifold.
pub(super) fn coarse(mesh: &Mesh, cell: f32) -> Mesh {
    let Some([low, high]) = bounding_box(&mesh.vertices) else {
        return Mesh::default();
    };
    let middle = center(&low, &high);
    let key = |v: &Point3<f32>| {
        let at = |axis: usize| ((v[axis] - low[axis]) / cell) as u64 & 0x1f_ffff;
        at(0) << 42 | at(1) << 21 | at(2)
    };
    let keys = mesh.vertices.par_iter().enumerate();
    let mut order: Vec<(u64, u32)> = keys.map(|(i, v)| (key(v), i as u32)).collect();
    order.par_sort_unstable();
    let mut of_vertex = vec![0u32; mesh.vertices.len()];
    let mut vertices = Vec::new();
    for group in order.chunk_by(|a, b| a.0 == b.0) {
        let each = group.iter().map(|&(_, i)| mesh.vertices[i as usize]);
        let out = |v: &Point3<f32>| distance_squared(v, &middle);
        let farthest = each.reduce(|best, v| if out(&v) > out(&best) { v } else { best });
        group
            .iter()
            .for_each(|&(_, i)| of_vertex[i as usize] = vertices.len() as u32);
        vertices.extend(farthest);
    }
    let merged = mesh
        .triangles
        .iter()
        .map(|t| t.map(|v| of_vertex[v as usize]));
    let triangles = merged
        .filter(|[a, b, c]| a != b && b != c && c != a)
        .collect();
    Mesh {
        vertices,
        triangles,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::{rasterize_mesh, shapes};

    #[test]
    fn a_coarse_ball_has_the_same_outline_and_few_vertices() {
        let ball = shapes::sphere(0.05, 5);
        let few = coarse(&ball, 0.005);
        assert!(few.vertices.len() * 5 < ball.vertices.len());
        let area = |mesh: &Mesh| {
            let project = |p: Point3<f32>| [60.0 + 1000.0 * p.x, 60.0 + 1000.0 * p.y, 1.0 + p.z];
            let drawn = rasterize_mesh(mesh, project, 120, 120);
            drawn.pixels().iter().filter(|f| f.is_covered()).count() as f64
        };
        let ratio = area(&few) / area(&ball);
        assert!((ratio - 1.0).abs() < 0.02, "{ratio}");
    }

    #[test]
    fn nothing_stays_nothing() {
        assert_eq!(coarse(&Mesh::default(), 0.01), Mesh::default());
    }
}
