//! Finds the cells that the surface may cross, from coarse to fine. The work grows with the surface, not with the
//! volume.

use super::{Lattice, Side, Solid, UndecidedConstraints};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

/// Levels above the finest: the coarsest cubes have 2⁵ cells a side.
const LEVELS: u32 = 5;

/// A cell and the constraints that may matter in it.
pub(super) type ActiveCell = ([u32; 3], UndecidedConstraints);

/// The cells of the lattice that the surface may cross and that `matter`, given by center and half edge, in an
/// order that does not depend on threads.
///
/// # Errors
/// As soon as the cubes that the surface may cross hold more than `most` cells: how many they hold.
pub(super) fn cells_across_at_most(
    most: usize,
    solid: &impl Solid,
    lattice: &Lattice,
    matters: impl Fn(Point3<f64>, f64) -> bool + Sync,
) -> Result<Vec<ActiveCell>, usize> {
    let mut cubes = coarsest(lattice);
    for level in (0..=LEVELS).rev() {
        let across: Vec<ActiveCell> = cubes
            .par_iter()
            .filter_map(|&(at, undecided)| {
                let (center, half) = cube(lattice, at, level);
                if !matters(center, half) {
                    return None;
                }
                match solid.side(center, half, undecided) {
                    Side::Across(undecided) => Some((at, undecided)),
                    _ => None,
                }
            })
            .collect();
        // A surface that crosses a cube of n cells a side crosses about n² of its cells.
        let held = across.len().saturating_mul(1 << (2 * level));
        if held > most {
            return Err(held);
        }
        if level == 0 {
            return Ok(across);
        }
        cubes = across.iter().flat_map(|&cube| children(cube)).collect();
        let size = 1 << (level - 1);
        cubes.retain(|&(at, _)| (0..3).all(|i| at[i] * size < lattice.cells[i]));
    }
    unreachable!("level 0 returns")
}

/// The same, however many there are.
pub(super) fn cells_across(
    solid: &impl Solid,
    lattice: &Lattice,
    matters: impl Fn(Point3<f64>, f64) -> bool + Sync,
) -> Vec<ActiveCell> {
    cells_across_at_most(usize::MAX, solid, lattice, matters).unwrap_or_default()
}

fn coarsest(lattice: &Lattice) -> Vec<ActiveCell> {
    let [nx, ny, nz] = lattice.cells.map(|n| n.div_ceil(1 << LEVELS));
    let mut cubes = Vec::with_capacity(nx as usize * ny as usize * nz as usize);
    for z in 0..nz {
        for y in 0..ny {
            cubes.extend((0..nx).map(|x| ([x, y, z], UndecidedConstraints::MAX)));
        }
    }
    cubes
}

/// The center and half edge of a cube.
fn cube(lattice: &Lattice, at: [u32; 3], level: u32) -> (Point3<f64>, f64) {
    let half = 0.5 * lattice.cell_size * f64::from(1u32 << level);
    let center = lattice.corner(at.map(|i| i << level)) + Vector3::repeat(half);
    (center, half)
}

fn children((at, undecided): ActiveCell) -> impl Iterator<Item = ActiveCell> {
    (0..8u32).map(move |child| {
        (
            [
                2 * at[0] + (child & 1),
                2 * at[1] + (child >> 1 & 1),
                2 * at[2] + (child >> 2),
            ],
            undecided,
        )
    })
}
