//! Finds where the surface crosses the edges of the cells. Each corner and edge is evaluated once, and not at all
//! if an earlier extraction has done so.
//!
//! Edge e of a cell runs along axis e / 4 from the corner [`EDGE_START`]`[e]`.

use super::cells::{Cells, Corners, advance};
use super::{Constraint, Lattice, SampledSolid, Solid};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

/// The first corner of each edge; the second is the next one along the edge's axis.
pub(super) const EDGE_START: [usize; 12] = [0, 2, 4, 6, 0, 1, 4, 5, 0, 1, 2, 3];

/// The second corner of edge `e`.
pub(super) const fn edge_end(e: usize) -> usize {
    EDGE_START[e] + (1 << (e / 4))
}

/// Stands for an edge that the surface does not cross.
const NOT_CUT: u32 = u32::MAX;

/// Where the surface crosses an edge.
#[derive(Clone, Copy, Debug)]
pub(super) struct Crossing {
    pub(super) point: Point3<f64>,
    pub(super) normal: Vector3<f32>,
    pub(super) constraint: Constraint,
}

/// The solid's values at the corners of cells.
pub(super) struct Samples {
    pub(super) corners: Corners,
    /// For each corner.
    pub(super) values: Vec<f32>,
}

impl Samples {
    /// Evaluates the solid, where `before` does not know its value.
    pub(super) fn take(
        solid: &impl Solid,
        lattice: &Lattice,
        cells: &Cells,
        before: Option<&SampledSolid>,
    ) -> Self {
        let corners = Corners::of(cells);
        let mut cell_of = vec![u32::MAX; corners.len()];
        // Whether it belongs to a cell that was sampled before.
        let mut known = vec![false; corners.len()];
        for (cell, numbers) in corners.of_cell.iter().enumerate().rev() {
            let is_known = cells.is_known(cell);
            for &corner in numbers {
                cell_of[corner as usize] = cell as u32;
                known[corner as usize] |= is_known;
            }
        }
        const CHUNK: usize = 4096;
        let values = corners
            .keys
            .par_chunks(CHUNK)
            .enumerate()
            .flat_map_iter(|(chunk, keys)| {
                let mut at = before.map_or(0, |b| {
                    b.samples.corners.keys.partition_point(|&k| k < keys[0])
                });
                let (cell_of, known) = (&cell_of, &known);
                let corners = &corners;
                keys.iter().enumerate().map(move |(i, &key)| {
                    let corner = chunk * CHUNK + i;
                    if let Some(before) = before.filter(|_| known[corner]) {
                        at = advance(&before.samples.corners.keys, at, key);
                        return before.samples.values[at];
                    }
                    let p = lattice.corner(corners.position(corner));
                    solid.value(p, cells.undecided(cell_of[corner] as usize))
                })
            })
            .collect();
        Self { corners, values }
    }
}

/// An edge whose ends lie on different sides of the surface.
struct CutEdge {
    /// The number of its first corner.
    start: u32,
    axis: u8,
    /// The solid's values at its ends.
    values: [f32; 2],
    /// The first cell that has the edge.
    cell: u32,
    /// Whether a cell that was sampled before has it.
    known: bool,
}

/// The edges that the surface crosses.
pub(super) struct CutEdges {
    /// For each cell which of its corners are inside, bit i for corner i.
    inside: Vec<u8>,
    /// For each cell the numbers of its twelve edges, or [`NOT_CUT`].
    edges_of_cell: Vec<[u32; 12]>,
    edges: Vec<CutEdge>,
    /// For each edge its first corner's key and its axis as one number; sorted.
    pub(super) keys: Vec<u64>,
}

impl CutEdges {
    pub(super) fn find(cells: &Cells, samples: &Samples) -> Self {
        let Samples {
            corners, values, ..
        } = samples;
        let inside: Vec<u8> = corners
            .of_cell
            .par_iter()
            .map(|c| {
                (0..8).fold(0, |bits, i| {
                    bits | u8::from(values[c[i] as usize] > 0.0) << i
                })
            })
            .collect();
        // The first cell that has the edge from a corner along each axis.
        let mut cell_of = vec![[NOT_CUT; 3]; corners.len()];
        let mut known = vec![[false; 3]; corners.len()];
        for (cell, numbers) in corners.of_cell.iter().enumerate().rev() {
            for e in (0..12).filter(|&e| is_cut(inside[cell], e)) {
                let start = numbers[EDGE_START[e]] as usize;
                cell_of[start][e / 4] = cell as u32;
                known[start][e / 4] |= cells.is_known(cell);
            }
        }
        let (mut edges, mut keys) = (Vec::new(), Vec::new());
        let mut first_edge = Vec::with_capacity(corners.len());
        for (start, cells_of) in cell_of.iter().enumerate() {
            first_edge.push(edges.len() as u32);
            for axis in (0..3).filter(|&axis| cells_of[axis] != NOT_CUT) {
                let cell = cells_of[axis];
                let numbers = &corners.of_cell[cell as usize];
                let end = (4 * axis..4 * axis + 4)
                    .find(|&e| numbers[EDGE_START[e]] as usize == start)
                    .map(|e| numbers[edge_end(e)])
                    .expect("the cell has the edge");
                keys.push(corners.keys[start] * 4 + axis as u64);
                edges.push(CutEdge {
                    start: start as u32,
                    axis: axis as u8,
                    values: [values[start], values[end as usize]],
                    cell,
                    known: known[start][axis],
                });
            }
        }
        let number = |start: u32, axis: usize| {
            let before = cell_of[start as usize][..axis].iter();
            first_edge[start as usize] + before.filter(|&&c| c != NOT_CUT).count() as u32
        };
        let of_cell = |(numbers, &inside): (&[u32; 8], &u8)| {
            std::array::from_fn(|e| {
                if is_cut(inside, e) {
                    number(numbers[EDGE_START[e]], e / 4)
                } else {
                    NOT_CUT
                }
            })
        };
        let edges_of_cell = corners
            .of_cell
            .par_iter()
            .zip(&inside)
            .map(of_cell)
            .collect();
        Self {
            inside,
            edges_of_cell,
            edges,
            keys,
        }
    }

    /// Which corners of a cell are inside.
    pub(super) fn inside(&self, cell: usize) -> u8 {
        self.inside[cell]
    }

    /// The numbers of a cell's edges.
    pub(super) fn of_cell(&self, cell: usize) -> &[u32; 12] {
        &self.edges_of_cell[cell]
    }

    /// Cells that have a cut edge and are not among the cells.
    pub(super) fn missing_cells(&self, lattice: &Lattice, corners: &Corners) -> Vec<[u32; 3]> {
        let mut found = vec![[false; 4]; self.edges.len()];
        for edges in &self.edges_of_cell {
            for (e, &edge) in edges
                .iter()
                .enumerate()
                .filter(|(_, edge)| **edge != NOT_CUT)
            {
                found[edge as usize][around(e)] = true;
            }
        }
        let mut missing = Vec::new();
        for (edge, found) in self.edges.iter().zip(found) {
            for place in (0..4).filter(|&place| !found[place]) {
                let axis = usize::from(edge.axis);
                let (b, c) = ((axis + 1) % 3, (axis + 2) % 3);
                let [back_b, back_c] = STEPS_BACK[place];
                let mut at = corners.position(edge.start as usize);
                if at[b] >= back_b && at[c] >= back_c {
                    at[b] -= back_b;
                    at[c] -= back_c;
                    if (0..3).all(|i| at[i] < lattice.cells[i]) {
                        missing.push(at);
                    }
                }
            }
        }
        missing
    }

    /// Finds the point of each edge where the surface crosses it, where `before` does not know it.
    pub(super) fn crossings(
        &self,
        solid: &impl Solid,
        lattice: &Lattice,
        cells: &Cells,
        corners: &Corners,
        before: Option<&SampledSolid>,
    ) -> Vec<Crossing> {
        let crossing = |(edge, key): (&CutEdge, &u64)| {
            if let Some(before) = before.filter(|_| edge.known)
                && let Ok(i) = before.edges.binary_search(key)
            {
                return before.crossings[i];
            }
            let undecided = cells.undecided(edge.cell as usize);
            let start = lattice.corner(corners.position(edge.start as usize));
            let mut along = Vector3::zeros();
            along[usize::from(edge.axis)] = lattice.cell_size;
            let t = root(edge.values, |t| solid.value(start + along * t, undecided));
            let point = start + along * t;
            let (normal, constraint) = solid.normal(point, undecided);
            Crossing {
                point,
                normal,
                constraint,
            }
        };
        self.edges
            .par_iter()
            .zip(&self.keys)
            .map(crossing)
            .collect()
    }

    /// Two triangles for each cut edge, between the vertices of the four cells around it, along the shorter
    /// diagonal. `vertex` gives a cell's vertex for one of its edges.
    pub(super) fn triangles(
        &self,
        placed: &[(Point3<f32>, Constraint)],
        vertex: impl Fn(usize, usize) -> u32,
    ) -> Vec<[u32; 3]> {
        let mut quads = vec![[u32::MAX; 4]; self.edges.len()];
        for (cell, edges) in self.edges_of_cell.iter().enumerate() {
            for (e, &edge) in edges
                .iter()
                .enumerate()
                .filter(|(_, edge)| **edge != NOT_CUT)
            {
                quads[edge as usize][around(e)] = vertex(cell, e);
            }
        }
        let mut triangles = Vec::with_capacity(2 * quads.len());
        for (mut quad, edge) in quads.into_iter().zip(&self.edges) {
            if quad.contains(&u32::MAX) {
                continue; // The solid reached the lattice's border.
            }
            if edge.values[0] <= 0.0 {
                quad.reverse();
            }
            let [a, b, c, d] = quad;
            let distance = |i: u32, j: u32| {
                let (p, q) = (placed[i as usize].0, placed[j as usize].0);
                (p - q).norm_squared()
            };
            if distance(a, c) <= distance(b, d) {
                triangles.extend([[a, b, c], [a, c, d]]);
            } else {
                triangles.extend([[a, b, d], [b, c, d]]);
            }
        }
        triangles
    }
}

fn is_cut(inside: u8, e: usize) -> bool {
    (inside >> EDGE_START[e] ^ inside >> edge_end(e)) & 1 == 1
}

/// How many steps along the two other axes lead from an edge's start back to the corner of the cells around
/// it, counter-clockwise seen from the edge's end.
const STEPS_BACK: [[u32; 2]; 4] = [[0, 0], [1, 0], [1, 1], [0, 1]];

/// The place of a cell among the four around its edge `e`: an index into [`STEPS_BACK`].
fn around(e: usize) -> usize {
    let axis = e / 4;
    let offset = |other: usize| EDGE_START[e] >> other & 1;
    match (offset((axis + 1) % 3), offset((axis + 2) % 3)) {
        (0, 0) => 0,
        (1, 0) => 1,
        (1, 1) => 2,
        _ => 3,
    }
}

/// Root in [0, 1] of a function with values of opposite signs at 0 and 1 (the Illinois method, Dowell and
/// Jarratt 1971, after a bisection, since values saturate away from the surface).
fn root([mut low, mut high]: [f32; 2], f: impl Fn(f64) -> f32) -> f64 {
    const ENOUGH: f32 = 0.25;
    let (mut a, mut b) = (0.0, 1.0);
    let mut kept = 0;
    for step in 0..10 {
        let t = if step == 0 {
            0.5
        } else {
            a + (b - a) * f64::from(low / (low - high))
        };
        let value = f(t);
        if value.abs() < ENOUGH || b - a < 1e-3 {
            return t;
        }
        if (value > 0.0) == (low > 0.0) {
            (a, low) = (t, value);
            if kept == 1 {
                high *= 0.5;
            }
            kept = 1;
        } else {
            (b, high) = (t, value);
            if kept == -1 {
                low *= 0.5;
            }
            kept = -1;
        }
    }
    0.5 * (a + b)
}
