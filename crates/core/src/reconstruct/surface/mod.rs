//! Extracts the surface of a solid that is given as a function of space: dual contouring (Ju, Losasso, Schaefer and
//! Warren 2002) on a sparse grid, with one vertex for each sheet of the surface in a cell (Nielson 2004), so that
//! the mesh is closed, oriented and manifold whatever the solid looks like. Knows neither cameras nor depth.
//!
//! - `descend` finds the cells that the surface may cross, from coarse to fine;
//! - `cells` gives them and their corners numbers;
//! - `edges` finds where the surface crosses their edges;
//! - `sheets` decides how the surface runs through a cell;
//! - `vertex` places a sheet's vertex.

mod cells;
mod descend;
mod edges;
mod sheets;
mod vertex;

use crate::mesh::Mesh;
use cells::Cells;
use edges::{Crossing, CutEdges, Samples};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

/// The constraints of a solid that may matter in a part of space: bit i stands for every constraint whose
/// number is i modulo 64.
pub type UndecidedConstraints = u64;

/// What is known of a box.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// All of it is outside the solid.
    Outside,
    /// All of it is inside.
    Inside,
    /// The surface may cross it, by these constraints alone.
    Across(UndecidedConstraints),
}

/// Which constraint of a solid its surface lies on.
pub type Constraint = u16;

/// A solid as a function of space.
pub trait Solid: Sync {
    /// What is known of the cube of half edge `half` around `center`, where only `undecided` constraints may
    /// matter. It may say `Across` too often, never too rarely.
    fn side(&self, center: Point3<f64>, half: f64, undecided: UndecidedConstraints) -> Side;

    /// Positive inside, negative outside, monotone across the surface; of no particular unit.
    fn value(&self, p: Point3<f64>, undecided: UndecidedConstraints) -> f32;

    /// At a point of the surface: the unit outward normal, and the constraint that bounds the solid there.
    fn normal(&self, p: Point3<f64>, undecided: UndecidedConstraints)
    -> (Vector3<f32>, Constraint);
}

/// A regular lattice of cubes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lattice {
    /// Corner (0, 0, 0).
    pub origin: Point3<f64>,
    /// Edge of a cube in metres.
    pub cell_size: f64,
    /// Cubes along x, y and z; at most [`Lattice::LONGEST`] each.
    pub cells: [u32; 3],
}

impl Lattice {
    /// Most cubes along an axis: their corners' numbers still fit 63 bits, and the work stays bounded.
    pub const LONGEST: u32 = 1 << 14;

    /// A lattice over the box from `min` to `max` with a margin of more than a cell around it. Its corners
    /// avoid the planes of the box, where a solid's faces often lie exactly.
    pub fn covering(min: Point3<f64>, max: Point3<f64>, cell_size: f64) -> Self {
        let margin = 1.63 * cell_size;
        let origin = min - Vector3::repeat(margin);
        let count =
            |extent: f64| (((extent + 2.0 * margin) / cell_size).ceil() as u32).min(Self::LONGEST);
        Self {
            origin,
            cell_size,
            cells: (max - min).map(count).into(),
        }
    }

    /// Where corner (x, y, z) is.
    #[inline]
    pub(in crate::reconstruct) fn corner(&self, at: [u32; 3]) -> Point3<f64> {
        self.origin + Vector3::from(at.map(f64::from)) * self.cell_size
    }
}

/// A solid's surface.
#[derive(Clone, Debug, Default)]
pub struct Surface {
    /// Closed, oriented, manifold.
    pub mesh: Mesh,
    /// For each vertex the constraint that it lies on (the one that most of its cell's edges cross).
    pub constraints: Vec<Constraint>,
}

/// What an extraction saw of a solid: enough to extract one that differs from it in places only.
pub struct SampledSolid {
    cells: Cells,
    samples: Samples,
    /// The keys of the edges that the surface crosses, sorted, and where it does.
    edges: Vec<u64>,
    crossings: Vec<Crossing>,
}

/// Extracts the surface of `solid` within `lattice`. The solid must not reach the lattice's border. Work
/// grows with the number of cells that the surface crosses; the result does not depend on threads.
///
/// # Errors
/// If the surface may cross more than `most` cells: about how many it may.
pub fn extract(
    solid: &impl Solid,
    lattice: &Lattice,
    most: usize,
) -> Result<(Surface, SampledSolid), usize> {
    let across = descend::cells_across_at_most(most, solid, lattice, |_, _| true)?;
    let cells = Cells::new(lattice, across);
    Ok(extract_from(cells, solid, lattice, None))
}

/// Extracts the surface of a solid that is the one of `before`, on the same lattice, but in the cubes (given by
/// center and half edge) in which it `may_differ`. Work grows with those cubes.
pub fn extract_changed(
    solid: &impl Solid,
    lattice: &Lattice,
    before: &SampledSolid,
    may_differ: impl Fn(Point3<f64>, f64) -> bool + Sync,
) -> (Surface, SampledSolid) {
    let across = descend::cells_across(solid, lattice, &may_differ);
    let half = 0.5 * lattice.cell_size;
    let stays = |at| !may_differ(lattice.corner(at) + Vector3::repeat(half), half);
    let cells = Cells::new(lattice, across).with_known(&before.cells, stays);
    extract_from(cells, solid, lattice, Some(before))
}

fn extract_from(
    mut cells: Cells,
    solid: &impl Solid,
    lattice: &Lattice,
    before: Option<&SampledSolid>,
) -> (Surface, SampledSolid) {
    let (samples, cut) = loop {
        let samples = Samples::take(solid, lattice, &cells, before);
        let cut = CutEdges::find(&cells, &samples);
        // A solid whose `side` was wrong by a hair would leave a hole here: take in what is missing.
        let missing = cut.missing_cells(lattice, &samples.corners);
        if missing.is_empty() {
            break (samples, cut);
        }
        cells.insert(missing);
    };
    let sheets = sheets::trace(solid, lattice, &cells, &cut);
    let crossings = cut.crossings(solid, lattice, &cells, &samples.corners, before);
    let placed: Vec<_> = sheets
        .par_iter()
        .enumerate()
        .flat_map_iter(|(cell, sheets)| {
            let (min, edges) = (lattice.corner(cells.position(cell)), cut.of_cell(cell));
            let crossings = &crossings;
            (0..sheets.count).map(move |sheet| {
                let on_sheet = (0..12)
                    .filter(move |&e| sheets.of_edge[e] == sheet)
                    .map(|e| &crossings[edges[e] as usize]);
                vertex::place(on_sheet, min, lattice.cell_size)
            })
        })
        .collect();
    let first_vertex: Vec<u32> = sheets
        .iter()
        .scan(0, |next, sheets| {
            let first = *next;
            *next += u32::from(sheets.count);
            Some(first)
        })
        .collect();
    let triangles = cut.triangles(&placed, |cell, edge| {
        first_vertex[cell] + u32::from(sheets[cell].of_edge[edge])
    });
    let (vertices, constraints) = placed.into_iter().unzip();
    let surface = Surface {
        mesh: Mesh {
            vertices,
            triangles,
        },
        constraints,
    };
    let sampled = SampledSolid {
        cells,
        samples,
        edges: cut.keys,
        crossings,
    };
    (surface, sampled)
}

/// A box around the surface, as tight as the lattice's cells; `None` where there is no surface.
pub fn bounds(solid: &impl Solid, lattice: &Lattice) -> Option<(Point3<f64>, Point3<f64>)> {
    let cells = descend::cells_across(solid, lattice, |_, _| true);
    cells.into_iter().fold(None, |bounds, (at, _)| {
        let (low, high) = (lattice.corner(at), lattice.corner(at.map(|i| i + 1)));
        bounds.map_or(Some((low, high)), |(l, h): (Point3<f64>, _)| {
            Some((l.inf(&low), high.sup(&h)))
        })
    })
}

#[cfg(test)]
mod tests;
