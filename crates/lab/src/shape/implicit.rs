//! The surface where a function is zero, by marching tetrahedra on Kuhn's subdivision of a grid (Doi and
//! Koide 1991): manifold and closed by construction. Kept apart from the reconstruction's own surfaces, so
//! that a truth does not share their faults.

use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use scand_core::mesh::Mesh;
use std::collections::HashMap;

/// Cells a side of the blocks that are skipped as one where the surface is far.
const BLOCK: usize = 8;
/// A value nearer to 0 than this part of a cell counts as this, so that no triangle degenerates.
const NEAREST: f64 = 0.004;

/// Meshes the surface of the body where `distance` is negative. `distance` must never exceed the distance
/// to the surface. `bounds` (smallest and largest corner) contain the body, `spacing` is the cell's edge in
/// metres.
pub(super) fn mesh(
    distance: impl Fn(Point3<f64>) -> f64 + Sync,
    bounds: [[f64; 3]; 2],
    spacing: f64,
) -> Mesh {
    // An odd offset, so that flat faces at round heights do not fall on the lattice.
    let origin = Point3::from(bounds[0]) - Vector3::new(1.41, 1.43, 1.37) * spacing;
    let blocks = [0, 1, 2].map(|a| {
        let cells = (bounds[1][a] - origin[a]) / spacing + 1.5;
        (cells / BLOCK as f64).ceil() as usize
    });
    let grid = Grid {
        origin,
        spacing,
        distance,
    };
    let sampled: Vec<(usize, Vec<f64>)> = (0..blocks.iter().product())
        .into_par_iter()
        .filter_map(|b| Some((b, grid.sample(block_corner(b, blocks))?)))
        .collect();
    let mut surface = Surface {
        grid: &grid,
        mesh: Mesh::default(),
        known: HashMap::new(),
    };
    for (block, values) in &sampled {
        surface.add_block(block_corner(*block, blocks), values);
    }
    surface.mesh
}

fn block_corner(block: usize, [nx, ny, _]: [usize; 3]) -> [usize; 3] {
    [block % nx, block / nx % ny, block / (nx * ny)].map(|i| i * BLOCK)
}

struct Grid<F> {
    origin: Point3<f64>,
    spacing: f64,
    distance: F,
}

impl<F: Fn(Point3<f64>) -> f64> Grid<F> {
    fn point(&self, at: [usize; 3]) -> Point3<f64> {
        self.origin + Vector3::from(at.map(|i| i as f64)) * self.spacing
    }

    /// Values at the corners of a block's cells, in cells; `None` where the surface does not come by.
    fn sample(&self, corner: [usize; 3]) -> Option<Vec<f64>> {
        let half = BLOCK as f64 * self.spacing / 2.0;
        let middle = self.point(corner) + Vector3::repeat(half);
        if (self.distance)(middle).abs() > half * 3.0_f64.sqrt() * 1.01 {
            return None;
        }
        const SIDE: usize = BLOCK + 1;
        let value = |k: usize| {
            let at = [k % SIDE, k / SIDE % SIDE, k / (SIDE * SIDE)];
            let p = self.point([0, 1, 2].map(|a| corner[a] + at[a]));
            let value = (self.distance)(p) / self.spacing;
            match value < 0.0 {
                true => value.min(-NEAREST),
                false => value.max(NEAREST),
            }
        };
        let values: Vec<f64> = (0..SIDE * SIDE * SIDE).map(value).collect();
        let inside = values.iter().filter(|v| **v < 0.0).count();
        (inside > 0 && inside < values.len()).then_some(values)
    }
}

/// The corners of a cell's six tetrahedra, as bits x, y, z, each positively oriented.
const TETRAHEDRA: [[usize; 4]; 6] = [
    [0, 1, 3, 7],
    [0, 3, 2, 7],
    [0, 2, 6, 7],
    [0, 6, 4, 7],
    [0, 4, 5, 7],
    [0, 5, 1, 7],
];

struct Surface<'a, F> {
    grid: &'a Grid<F>,
    mesh: Mesh,
    /// The vertex on each edge, by its lower end and its direction; only looked up, never walked.
    known: HashMap<([u32; 3], u8), u32>,
}

/// A corner of a tetrahedron: its cell's corner and its value.
#[derive(Clone, Copy)]
struct Corner {
    at: [usize; 3],
    value: f64,
}

impl<F: Fn(Point3<f64>) -> f64> Surface<'_, F> {
    fn add_block(&mut self, corner: [usize; 3], values: &[f64]) {
        for cell in 0..BLOCK * BLOCK * BLOCK {
            let at = [cell % BLOCK, cell / BLOCK % BLOCK, cell / (BLOCK * BLOCK)];
            let corners: [Corner; 8] = std::array::from_fn(|bits| {
                let [x, y, z] = [0, 1, 2].map(|a| at[a] + (bits >> a & 1));
                Corner {
                    at: [corner[0] + x, corner[1] + y, corner[2] + z],
                    value: values[x + (BLOCK + 1) * (y + (BLOCK + 1) * z)],
                }
            });
            let inside = corners.iter().filter(|c| c.value < 0.0).count();
            if inside > 0 && inside < 8 {
                for tetrahedron in TETRAHEDRA {
                    self.add_tetrahedron(tetrahedron.map(|k| corners[k]));
                }
            }
        }
    }

    /// Adds the triangles that part the corners inside from those outside. The corners are brought into an
    /// order that keeps the orientation and has the lone corner, or the inner pair, first.
    fn add_tetrahedron(&mut self, corners: [Corner; 4]) {
        let inside = (0..4).fold(0, |m, k| m | usize::from(corners[k].value < 0.0) << k);
        const LONE: [[usize; 4]; 4] = [[0, 1, 2, 3], [1, 0, 3, 2], [2, 3, 0, 1], [3, 2, 1, 0]];
        let order = match inside {
            0 | 15 => return,
            1 | 14 => LONE[0],
            2 | 13 => LONE[1],
            4 | 11 => LONE[2],
            8 | 7 => LONE[3],
            3 => [0, 1, 2, 3],
            5 => [0, 2, 3, 1],
            9 => [0, 3, 1, 2],
            6 => [1, 2, 0, 3],
            10 => [1, 3, 2, 0],
            _ => [2, 3, 0, 1],
        };
        let [a, b, c, d] = order.map(|k| corners[k]);
        match inside.count_ones() {
            1 => {
                let triangle = [self.vertex(a, b), self.vertex(a, c), self.vertex(a, d)];
                self.mesh.triangles.push(triangle);
            }
            3 => {
                let triangle = [self.vertex(a, b), self.vertex(a, d), self.vertex(a, c)];
                self.mesh.triangles.push(triangle);
            }
            _ => {
                let [ac, ad] = [self.vertex(a, c), self.vertex(a, d)];
                let [bc, bd] = [self.vertex(b, c), self.vertex(b, d)];
                self.mesh.triangles.extend([[ac, ad, bd], [ac, bd, bc]]);
            }
        }
    }

    /// The vertex on the edge between a corner inside and one outside.
    fn vertex(&mut self, a: Corner, b: Corner) -> u32 {
        let (low, high) = if a.at <= b.at { (a, b) } else { (b, a) };
        let direction = (0..3).fold(0, |d, k| d | ((high.at[k] - low.at[k]) as u8) << k);
        let key = (low.at.map(|i| i as u32), direction);
        if let Some(&vertex) = self.known.get(&key) {
            return vertex;
        }
        let vertex = self.mesh.vertices.len() as u32;
        self.mesh.vertices.push(self.crossing(low, high).cast());
        self.known.insert(key, vertex);
        vertex
    }

    /// Where the function is zero between two corners, by regula falsi (Illinois variant).
    fn crossing(&self, low: Corner, high: Corner) -> Point3<f64> {
        let (from, to) = (self.grid.point(low.at), self.grid.point(high.at));
        let (mut a, mut b) = ((0.0, low.value), (1.0, high.value));
        let mut t = a.1 / (a.1 - b.1);
        for _ in 0..6 {
            let value = (self.grid.distance)(from + (to - from) * t) / self.grid.spacing;
            if value.abs() < 1e-4 {
                break;
            }
            if (value < 0.0) == (a.1 < 0.0) {
                (a, b.1) = ((t, value), b.1 / 2.0);
            } else {
                (b, a.1) = ((t, value), a.1 / 2.0);
            }
            t = (a.0 * b.1 - b.0 * a.1) / (b.1 - a.1);
        }
        from + (to - from) * t.clamp(NEAREST, 1.0 - NEAREST)
    }
}
