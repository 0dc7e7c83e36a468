//! Closed meshes whose properties are known in closed form, for tests.

use super::{Mesh, cuboid};
use nalgebra::{Point3, Vector3};
use std::f32::consts::TAU;

/// A regular tetrahedron in a cube of the given half edge.
pub fn tetrahedron(half: f32) -> Mesh {
    let corners = [[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]];
    Mesh {
        vertices: corners
            .map(|c| Point3::from(c.map(|v| v as f32 * half)))
            .to_vec(),
        triangles: vec![[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]],
    }
}

/// A torus around z with `major` and `minor` radius, of `around` x `across` vertices.
pub fn torus(major: f32, minor: f32, around: u32, across: u32) -> Mesh {
    let vertex = |i: u32, j: u32| {
        let (u, v) = (
            TAU * i as f32 / around as f32,
            TAU * j as f32 / across as f32,
        );
        let r = major + minor * v.cos();
        Point3::new(r * u.cos(), r * u.sin(), minor * v.sin())
    };
    let index = |i: u32, j: u32| (i % around) * across + j % across;
    let mut mesh = Mesh::default();
    for i in 0..around {
        for j in 0..across {
            mesh.vertices.push(vertex(i, j));
            let [a, b, c, d] = [
                index(i, j),
                index(i + 1, j),
                index(i + 1, j + 1),
                index(i, j + 1),
            ];
            mesh.triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    mesh
}

/// An icosphere: 20 faces, each split into four `levels` times.
pub fn sphere(radius: f32, levels: usize) -> Mesh {
    let p = (1.0 + 5.0_f32.sqrt()) / 2.0;
    let corners = [
        [-1.0, p, 0.0],
        [1.0, p, 0.0],
        [-1.0, -p, 0.0],
        [1.0, -p, 0.0],
        [0.0, -1.0, p],
        [0.0, 1.0, p],
        [0.0, -1.0, -p],
        [0.0, 1.0, -p],
        [p, 0.0, -1.0],
        [p, 0.0, 1.0],
        [-p, 0.0, -1.0],
        [-p, 0.0, 1.0],
    ];
    #[rustfmt::skip]
    let mut triangles: Vec<[u32; 3]> = vec![
        [0, 11, 5], [0, 5, 1], [0, 1, 7], [0, 7, 10], [0, 10, 11], [1, 5, 9], [5, 11, 4], [11, 10, 2],
        [10, 7, 6], [7, 1, 8], [3, 9, 4], [3, 4, 2], [3, 2, 6], [3, 6, 8], [3, 8, 9], [4, 9, 5],
        [2, 4, 11], [6, 2, 10], [8, 6, 7], [9, 8, 1],
    ];
    let mut vertices: Vec<Vector3<f32>> = corners.map(|c| Vector3::from(c).normalize()).to_vec();
    for _ in 0..levels {
        triangles = split(&triangles, &mut vertices, |a, b| (a + b).normalize());
    }
    let vertices = vertices.iter().map(|v| Point3::from(v * radius)).collect();
    Mesh {
        vertices,
        triangles,
    }
}

/// The same surface with every triangle split into four.
pub fn subdivided(mesh: &Mesh) -> Mesh {
    let mut vertices: Vec<Vector3<f32>> = mesh.vertices.iter().map(|v| v.coords).collect();
    let triangles = split(&mesh.triangles, &mut vertices, |a, b| (a + b) / 2.0);
    let vertices = vertices.into_iter().map(Point3::from).collect();
    Mesh {
        vertices,
        triangles,
    }
}

fn split(
    triangles: &[[u32; 3]],
    vertices: &mut Vec<Vector3<f32>>,
    between: impl Fn(Vector3<f32>, Vector3<f32>) -> Vector3<f32>,
) -> Vec<[u32; 3]> {
    let mut middles = std::collections::BTreeMap::new();
    let mut middle = |a: u32, b: u32| {
        *middles.entry((a.min(b), a.max(b))).or_insert_with(|| {
            vertices.push(between(vertices[a as usize], vertices[b as usize]));
            vertices.len() as u32 - 1
        })
    };
    let mut finer = Vec::with_capacity(triangles.len() * 4);
    for &[a, b, c] in triangles {
        let [ab, bc, ca] = [middle(a, b), middle(b, c), middle(c, a)];
        finer.extend([[a, ab, ca], [b, bc, ab], [c, ca, bc], [ab, bc, ca]]);
    }
    finer
}

/// An axis-aligned cube around the origin with the given half edge.
pub fn cube(half: f32) -> Mesh {
    cuboid([-half; 3], [half; 3])
}

/// Adds `other` to `mesh` without welding.
pub fn append(mesh: &mut Mesh, other: &Mesh) {
    let offset = mesh.vertices.len() as u32;
    mesh.vertices.extend(&other.vertices);
    mesh.triangles
        .extend(other.triangles.iter().map(|t| t.map(|v| v + offset)));
}
