//! Finds the nearest triangle for each corner of a lattice that lies near a mesh. Work and memory grow with the
//! surface.

use super::curved::Curved;
use crate::array::three;
use crate::mesh::closest_on_triangle;
use crate::reconstruct::surface::Lattice;
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

/// Corners within this many cells of the surface are known: all of a cell that it crosses.
const BAND: f64 = 1.8;
/// Layers of corners that one task takes.
const SLAB: u32 = 8;
/// Levels of cubes above the cells.
const LEVELS: u32 = 5;

/// The corners near a mesh.
pub(super) struct Nearest {
    /// Sorted by z, y, x.
    keys: Vec<u64>,
    triangles: Vec<u32>,
    /// For each level from 1 the cubes of 2, 4, 8 … cells a side that have such a corner, sorted.
    cubes: Vec<Vec<u64>>,
}

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

impl Nearest {
    pub(super) fn new(curved: &Curved, lattice: &Lattice) -> Self {
        let places: Vec<Point3<f64>> = curved
            .positions
            .iter()
            .map(|p| Point3::from((p - lattice.origin) / lattice.cell_size))
            .collect();
        let slabs = (lattice.cells[2] + 1).div_ceil(SLAB);
        let mut of_slab = vec![Vec::new(); slabs as usize];
        for (t, ids) in curved.triangles.iter().enumerate() {
            let z = three(|i| places[ids[i] as usize].z);
            let low = (z[0].min(z[1]).min(z[2]) - BAND).max(0.0) as u32 / SLAB;
            let high = (z[0].max(z[1]).max(z[2]) + BAND).max(0.0) as u32 / SLAB;
            for slab in low..=high.min(slabs - 1) {
                of_slab[slab as usize].push(t as u32);
            }
        }
        let found: Vec<Vec<(u64, u32)>> = of_slab
            .par_iter()
            .enumerate()
            .map(|(slab, triangles)| of_one_slab(slab as u32, triangles, &places, curved, lattice))
            .collect();
        let (keys, triangles): (Vec<u64>, Vec<u32>) = found.into_iter().flatten().unzip();
        let cubes = (1..=LEVELS)
            .map(|level| {
                let mut cubes: Vec<u64> = keys
                    .iter()
                    .map(|&k| key(position(k).map(|v| v >> level)))
                    .collect();
                cubes.dedup();
                cubes.par_sort_unstable();
                cubes.dedup();
                cubes
            })
            .collect();
        Self {
            keys,
            triangles,
            cubes,
        }
    }

    pub(super) fn len(&self) -> usize {
        self.keys.len()
    }

    /// Place and nearest triangle of a corner.
    pub(super) fn corner(&self, i: usize) -> ([u32; 3], u32) {
        (position(self.keys[i]), self.triangles[i])
    }

    /// The corner at a whole place in the lattice.
    pub(super) fn find(&self, at: [f64; 3]) -> Option<usize> {
        if at.iter().any(|&v| !(0.0..1e6).contains(&v)) {
            return None;
        }
        self.keys.binary_search(&key(at.map(|v| v as u32))).ok()
    }

    /// Whether the surface may cross a cube of 2^level cells a side.
    pub(super) fn reaches(&self, level: u32, cube: [u32; 3]) -> bool {
        let cubes = self.cubes.get(level as usize - 1);
        cubes.is_none_or(|cubes| cubes.binary_search(&key(cube)).is_ok())
    }
}

fn of_one_slab(
    slab: u32,
    triangles: &[u32],
    places: &[Point3<f64>],
    curved: &Curved,
    lattice: &Lattice,
) -> Vec<(u64, u32)> {
    let [nx, ny, nz] = lattice.cells.map(|n| n as usize + 1);
    let (first, last) = (slab * SLAB, ((slab + 1) * SLAB).min(nz as u32));
    let mut best = vec![(f32::INFINITY, u32::MAX); nx * ny * (last - first) as usize];
    for &t in triangles {
        let ids = curved.triangles[t as usize];
        let corners = three(|i| places[ids[i] as usize]);
        let (low, high) = (
            corners[0].inf(&corners[1]).inf(&corners[2]),
            corners[0].sup(&corners[1]).sup(&corners[2]),
        );
        let range = |axis: usize, count: usize| {
            let first = (low[axis] - BAND).ceil().max(0.0) as usize;
            first..((high[axis] + BAND).floor() as usize + 1).min(count)
        };
        let normal: Vector3<f64> = curved.faces[t as usize];
        let zs = range(2, nz);
        for z in zs.start.max(first as usize)..zs.end.min(last as usize) {
            for y in range(1, ny) {
                for x in range(0, nx) {
                    let p = Point3::new(x as f64, y as f64, z as f64);
                    let across = normal.dot(&(p - corners[0]));
                    let slot = &mut best[((z - first as usize) * ny + y) * nx + x];
                    if across.abs() > BAND || across * across >= f64::from(slot.0) {
                        continue;
                    }
                    let squared = (p - closest_on_triangle(p, corners)).norm_squared();
                    if squared <= BAND * BAND && (squared as f32) < slot.0 {
                        *slot = (squared as f32, t);
                    }
                }
            }
        }
    }
    let place = |i: usize| {
        [
            (i % nx) as u32,
            (i / nx % ny) as u32,
            (i / nx / ny) as u32 + first,
        ]
    };
    let known = best.iter().enumerate().filter(|(_, b)| b.1 != u32::MAX);
    known.map(|(i, b)| (key(place(i)), b.1)).collect()
}
