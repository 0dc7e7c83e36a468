//! Finds where the vertical lines through a lattice's corners enter and leave a closed mesh, which distinguishes inside
//! from outside far from the surface.

use crate::array::three;
use crate::reconstruct::surface::Lattice;
use nalgebra::Point3;

/// The crossings of all columns.
pub(super) struct Columns {
    /// Row and column of the lattice, sorted, with the heights of crossings, ascending in each column.
    crossings: Vec<(u32, u32, f32)>,
}

impl Columns {
    /// Of a closed mesh. A line through an edge or a vertex crosses exactly one of the triangles around it.
    pub(super) fn new(
        positions: &[Point3<f64>],
        triangles: &[[u32; 3]],
        lattice: &Lattice,
    ) -> Self {
        let mut crossings = Vec::new();
        for t in triangles {
            let corners =
                three(|i| (positions[t[i] as usize] - lattice.origin) / lattice.cell_size);
            let range = |axis: usize| {
                let values = three(|i| corners[i][axis]);
                let low = values[0].min(values[1]).min(values[2]).ceil().max(0.0);
                let high = values[0].max(values[1]).max(values[2]).floor();
                low as u32..(high + 1.0).clamp(0.0, f64::from(lattice.cells[axis]) + 1.0) as u32
            };
            for y in range(1) {
                for x in range(0) {
                    let (px, py) = (f64::from(x), f64::from(y));
                    // Edge functions, computed alike for both triangles of an edge; a tie goes to one of them.
                    let sides = three(|i| {
                        let (mut a, mut b) = (i, (i + 1) % 3);
                        let forward = t[a] < t[b];
                        if !forward {
                            (a, b) = (b, a);
                        }
                        let (a, b) = (corners[a], corners[b]);
                        let value = (b.x - a.x) * (py - a.y) - (b.y - a.y) * (px - a.x);
                        (value >= 0.0) == forward
                    });
                    if sides[0] == sides[1] && sides[1] == sides[2] {
                        crossings.push((y, x, height(corners.map(Point3::from), px, py) as f32));
                    }
                }
            }
        }
        crossings.sort_unstable_by(|a, b| (a.0, a.1).cmp(&(b.0, b.1)).then(a.2.total_cmp(&b.2)));
        Self { crossings }
    }

    /// Whether a point, given in cells from the lattice's origin, lies inside: told on the nearest column.
    pub(super) fn is_inside(&self, x: f64, y: f64, z: f64) -> bool {
        let (x, y) = (x.round().max(0.0) as u32, y.round().max(0.0) as u32);
        let first = self.crossings.partition_point(|c| (c.0, c.1) < (y, x));
        let column = self.crossings[first..]
            .iter()
            .take_while(|c| (c.0, c.1) == (y, x));
        column.filter(|c| f64::from(c.2) < z).count() % 2 == 1
    }
}

fn height([a, b, c]: [Point3<f64>; 3], x: f64, y: f64) -> f64 {
    let n = (b - a).cross(&(c - a));
    if n.z.abs() < 1e-12 {
        return (a.z + b.z + c.z) / 3.0;
    }
    let low = a.z.min(b.z).min(c.z);
    let high = a.z.max(b.z).max(c.z);
    (a.z - (n.x * (x - a.x) + n.y * (y - a.y)) / n.z).clamp(low, high)
}
