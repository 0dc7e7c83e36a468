//! Numbers for the corners and edges of the cells that matter, by sorting: no hash map, so the order never
//! depends on anything but the cells.
//!
//! Corner i of a cell has x offset i & 1, y offset i >> 1 & 1, z offset i >> 2. Edge e runs along axis
//! e / 4 from the corner [`EDGE_START`]`[e]`.

use super::descend::ActiveCell;
use super::{Constraint, Lattice, Solid, Undecided};
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

/// A corner or cell as one number that sorts by z, y, x.
fn key([x, y, z]: [u32; 3]) -> u64 {
    u64::from(z) << 40 | u64::from(y) << 20 | u64::from(x)
}

fn position(key: u64) -> [u32; 3] {
    const MASK: u64 = (1 << 20) - 1;
    [
        (key & MASK) as u32,
        (key >> 20 & MASK) as u32,
        (key >> 40) as u32,
    ]
}

fn corner_of([x, y, z]: [u32; 3], i: usize) -> [u32; 3] {
    let i = i as u32;
    [x + (i & 1), y + (i >> 1 & 1), z + (i >> 2)]
}

/// The cells that the surface may cross, sorted.
pub(super) struct Cells {
    keys: Vec<u64>,
    undecided: Vec<Undecided>,
}

impl Cells {
    pub(super) fn new(lattice: &Lattice, cells: Vec<ActiveCell>) -> Self {
        debug_assert!(lattice.cells.iter().all(|&n| n <= Lattice::LONGEST));
        let mut cells: Vec<_> = cells
            .into_iter()
            .map(|(at, undecided)| (key(at), undecided))
            .collect();
        cells.par_sort_unstable();
        cells.dedup_by_key(|c| c.0);
        let (keys, undecided) = cells.into_iter().unzip();
        Self { keys, undecided }
    }

    /// Adds cells of which nothing is known.
    pub(super) fn insert(&mut self, more: Vec<[u32; 3]>) {
        let old = self
            .keys
            .iter()
            .copied()
            .zip(self.undecided.iter().copied());
        let mut all: Vec<_> = old
            .chain(more.into_iter().map(|at| (key(at), Undecided::MAX)))
            .collect();
        all.sort_unstable();
        all.dedup_by_key(|c| c.0);
        (self.keys, self.undecided) = all.into_iter().unzip();
    }

    pub(super) fn len(&self) -> usize {
        self.keys.len()
    }

    pub(super) fn position(&self, cell: usize) -> [u32; 3] {
        position(self.keys[cell])
    }

    pub(super) fn undecided(&self, cell: usize) -> Undecided {
        self.undecided[cell]
    }

    /// The number of the cell at a position.
    pub(super) fn find(&self, at: [u32; 3]) -> Option<usize> {
        self.keys.binary_search(&key(at)).ok()
    }
}

/// Where the surface crosses an edge.
#[derive(Clone, Copy, Debug)]
pub(super) struct Crossing {
    pub(super) point: Point3<f64>,
    pub(super) normal: Vector3<f32>,
    pub(super) constraint: Constraint,
}

/// An edge whose ends lie on different sides of the surface.
struct CutEdge {
    start: [u32; 3],
    axis: usize,
    /// The solid's values at its ends.
    values: [f32; 2],
    /// A cell that has the edge.
    cell: u32,
}

/// The edges that the surface crosses.
pub(super) struct CutEdges {
    /// For each cell which of its corners are inside, bit i for corner i.
    inside: Vec<u8>,
    /// For each cell the numbers of its twelve edges, or [`NOT_CUT`].
    edges_of_cell: Vec<[u32; 12]>,
    edges: Vec<CutEdge>,
}

impl CutEdges {
    /// Evaluates the solid at the cells' corners, each once.
    pub(super) fn find(solid: &impl Solid, lattice: &Lattice, cells: &Cells) -> Self {
        let corner_values = corner_values(solid, lattice, cells);
        let inside: Vec<u8> = corner_values
            .par_iter()
            .map(|v| (0..8).fold(0, |bits, i| bits | u8::from(v[i] > 0.0) << i))
            .collect();
        let mut cuts: Vec<(u64, u32)> = inside
            .par_iter()
            .enumerate()
            .flat_map_iter(|(cell, &inside)| {
                let at = cells.position(cell);
                (0..12).filter(move |&e| is_cut(inside, e)).map(move |e| {
                    let start = key(corner_of(at, EDGE_START[e]));
                    (start * 4 + e as u64 / 4, (cell * 12 + e) as u32)
                })
            })
            .collect();
        cuts.par_sort_unstable();
        let mut edges_of_cell = vec![[NOT_CUT; 12]; cells.len()];
        let mut edges = Vec::with_capacity(cuts.len() / 4);
        let mut last = None;
        for (edge_key, slot) in cuts {
            let (cell, e) = (slot as usize / 12, slot as usize % 12);
            if last != Some(edge_key) {
                last = Some(edge_key);
                let values = [
                    corner_values[cell][EDGE_START[e]],
                    corner_values[cell][edge_end(e)],
                ];
                let start = position(edge_key / 4);
                edges.push(CutEdge {
                    start,
                    axis: e / 4,
                    values,
                    cell: cell as u32,
                });
            }
            edges_of_cell[cell][e] = edges.len() as u32 - 1;
        }
        Self {
            inside,
            edges_of_cell,
            edges,
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
    pub(super) fn missing_cells(&self, lattice: &Lattice) -> Vec<[u32; 3]> {
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
                let (b, c) = ((edge.axis + 1) % 3, (edge.axis + 2) % 3);
                let [back_b, back_c] = STEPS_BACK[place];
                let mut at = edge.start;
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

    /// Finds the point of each edge where the surface crosses it.
    pub(super) fn crossings(
        &self,
        solid: &impl Solid,
        lattice: &Lattice,
        cells: &Cells,
    ) -> Vec<Crossing> {
        let crossing = |edge: &CutEdge| {
            let undecided = cells.undecided(edge.cell as usize);
            let start = lattice.corner(edge.start);
            let mut along = Vector3::zeros();
            along[edge.axis] = lattice.cell_size;
            let t = root(edge.values, |t| solid.value(start + along * t, undecided));
            let point = start + along * t;
            let (normal, constraint) = solid.normal(point, undecided);
            Crossing {
                point,
                normal,
                constraint,
            }
        };
        self.edges.par_iter().map(crossing).collect()
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

/// The solid's values at the eight corners of each cell.
fn corner_values(solid: &impl Solid, lattice: &Lattice, cells: &Cells) -> Vec<[f32; 8]> {
    let mut corners: Vec<(u64, u32)> = (0..cells.len())
        .into_par_iter()
        .flat_map_iter(|cell| {
            let at = cells.position(cell);
            (0..8).map(move |i| (key(corner_of(at, i)), (cell * 8 + i) as u32))
        })
        .collect();
    corners.par_sort_unstable();
    let unique: Vec<(u64, u32)> = corners
        .chunk_by(|a, b| a.0 == b.0)
        .map(|same| same[0])
        .collect();
    let evaluated: Vec<f32> = unique
        .par_iter()
        .map(|&(key, slot)| {
            solid.value(
                lattice.corner(position(key)),
                cells.undecided(slot as usize / 8),
            )
        })
        .collect();
    let mut values = vec![[0.0; 8]; cells.len()];
    for (same, value) in corners.chunk_by(|a, b| a.0 == b.0).zip(evaluated) {
        for &(_, slot) in same {
            values[slot as usize / 8][slot as usize % 8] = value;
        }
    }
    values
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
