//! Triangle meshes, and operations on them that do not depend on where they came from: one operation in each file,
//! over one plain struct. Nothing in this room knows of cameras.

mod bvh;
mod check;
mod closest;
mod components;
mod convex_hull;
mod cuboid;
mod departure;
mod edges;
mod measure;
mod normals;
mod raster;
mod rings;
mod shade;
#[cfg(test)]
pub mod shapes;
mod simplify;

pub use bvh::{Bvh, Closest, Hit};
pub use check::{Report, check, is_closed, is_watertight};
pub use closest::closest_on_triangle;
pub use components::{Component, Components, components, extract};
pub use convex_hull::convex_hull;
pub use cuboid::cuboid;
pub use departure::mean_departures;
pub use edges::{Side, edges, sorted_sides};
pub use measure::{bounding_box, volume_and_total_area};
pub use normals::vertex_normals;
pub use raster::{Fragment, rasterize, rasterize_closed, rasterize_mesh};
pub use rings::{NO_TRIANGLE, Rings};
pub use shade::{
    Drawn, ProjectionKind, Style, View, four_sides, parallel_view, render, vertex_paint,
};
pub use simplify::{Simplified, SimplifyError, simplify};

use crate::array::three;
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
        three(|i| self.vertices[self.triangles[t][i] as usize])
    }

    /// The vertices that triangles name, each once, in their order.
    pub fn used_vertices(&self) -> Vec<Point3<f32>> {
        let mut is_used = vec![false; self.vertices.len()];
        for &v in self.triangles.as_flattened() {
            is_used[v as usize] = true;
        }
        let each = self.vertices.iter().zip(is_used);
        each.filter_map(|(&p, is_used)| is_used.then_some(p))
            .collect()
    }
}
