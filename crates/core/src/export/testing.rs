//! Models for the tests of this room.

use crate::description::Description;
use crate::mesh::{shapes, vertex_normals};
pub(super) use crate::output::glb::tests::{described, textured_square};
use crate::output::glb::{Parameters, encode};
use crate::reconstruct::{Model, Provenance, Texture};

/// A ball of radius 5 cm around (0, 0, 0.1) whose atlas tells the direction: red grows with x, green with y, blue
/// with z. Each triangle has a rectangle of 8 x 8 texels of its own in one colour.
pub(super) fn painted_ball() -> Model {
    let mut mesh = shapes::sphere(0.05, 3);
    for vertex in &mut mesh.vertices {
        vertex.z += 0.1;
    }
    let triangles = mesh.triangles.len();
    let side = (triangles as f64).sqrt().ceil() as usize;
    let color = |t: usize| {
        let centre = mesh.corners(t).iter().fold([0.0; 3], |sum: [f32; 3], p| {
            [
                sum[0] + p.x / 3.0,
                sum[1] + p.y / 3.0,
                sum[2] + (p.z - 0.1) / 3.0,
            ]
        });
        centre.map(|c| (128.0 + c / 0.05 * 120.0) as u8)
    };
    let colors: Vec<[u8; 3]> = (0..triangles).map(color).collect();
    let atlas = crate::image::RgbImage::from_fn(side * 8, side * 8, |x, y| {
        colors
            .get(y / 8 * side + x / 8)
            .copied()
            .unwrap_or_default()
    });
    let corner_uv = (0..triangles).map(|t| {
        let (x, y) = ((t % side * 8) as f32, (t / side * 8) as f32);
        let all = (side * 8) as f32;
        [[2.0, 2.0], [6.0, 2.0], [2.0, 6.0]].map(|[u, v]| [(x + u) / all, (y + v) / all])
    });
    let corner_uv = corner_uv.collect();
    let vertices = mesh.vertices.len();
    Model {
        normals: vertex_normals(&mesh),
        provenance: vec![Provenance::Restored; vertices],
        expected_error: (0..vertices).map(|v| v as f32 * 1e-6).collect(),
        captures: (0..vertices).map(|v| 1 + v as u32 % 3).collect(),
        texture: Some(Texture {
            atlas,
            corner_uv,
            vertex_colors: vec![[9; 3]; vertices],
            seen: (0..triangles).map(|t| t % 7 != 0).collect(),
        }),
        mesh,
    }
}

/// The model's file.
pub(super) fn as_glb(model: &Model, about: &Description) -> Vec<u8> {
    let parameters = Parameters {
        jpeg_quality: 100,
        ..Parameters::default()
    };
    encode(model, about, &parameters).unwrap()
}
