//! Triangle meshes and what can be said of them without knowing where they came from: an operation a file
//! over one plain struct. Nothing in this room knows of cameras.

mod bvh;
mod closest;
mod normals;
mod raster;

pub use bvh::{Bvh, Closest, Hit};
pub use closest::closest_on_triangle;
pub use normals::vertex_normals;
pub use raster::{Fragment, rasterize, rasterize_mesh};

use nalgebra::Point3;

/// An indexed triangle mesh. Triangles are counter-clockwise seen from outside. Positions in metres.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// Vertex positions.
    pub vertices: Vec<Point3<f32>>,
    /// Indices into `vertices`.
    pub triangles: Vec<[u32; 3]>,
}

impl Mesh {
    /// The three corners of triangle `t`.
    pub fn corners(&self, t: usize) -> [Point3<f32>; 3] {
        self.triangles[t].map(|v| self.vertices[v as usize])
    }
}
