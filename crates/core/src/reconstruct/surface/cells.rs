//! Numbers the cells that the surface may cross, and their corners, by merging sorted lists. There is no hash map,
//! so the order depends only on the cells.
//!
//! Corner i of a cell has x offset i & 1, y offset i >> 1 & 1, z offset i >> 2.

use super::descend::ActiveCell;
use super::{Lattice, UndecidedConstraints};
use rayon::prelude::*;

/// A corner or cell as one number that sorts by z, y, x.
pub(super) fn key([x, y, z]: [u32; 3]) -> u64 {
    u64::from(z) << 40 | u64::from(y) << 20 | u64::from(x)
}

pub(super) fn position(key: u64) -> [u32; 3] {
    const MASK: u64 = (1 << 20) - 1;
    [
        (key & MASK) as u32,
        (key >> 20 & MASK) as u32,
        (key >> 40) as u32,
    ]
}

/// What the key of a cell's corner i is more than the cell's.
fn offset(i: usize) -> u64 {
    let i = i as u32;
    key([i & 1, i >> 1 & 1, i >> 2])
}

/// The cells that the surface may cross, sorted.
pub(super) struct Cells {
    cells: Vec<Cell>,
}

#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Cell {
    key: u64,
    undecided: UndecidedConstraints,
    /// Whether the solid in it is the one sampled before.
    known: bool,
}

impl Cells {
    pub(super) fn new(lattice: &Lattice, cells: Vec<ActiveCell>) -> Self {
        debug_assert!(lattice.cells.iter().all(|&n| n <= Lattice::LONGEST));
        let fresh = |(at, undecided)| Cell {
            key: key(at),
            undecided,
            known: false,
        };
        let mut cells: Vec<Cell> = cells.into_iter().map(fresh).collect();
        cells.par_sort_unstable();
        cells.dedup_by_key(|c| c.key);
        Self { cells }
    }

    /// These cells, and those of `before` in which `stays` says that nothing has changed.
    pub(super) fn with_known(
        mut self,
        before: &Self,
        stays: impl Fn([u32; 3]) -> bool + Sync,
    ) -> Self {
        let known = |cell: &Cell| {
            stays(position(cell.key)).then_some(Cell {
                known: true,
                ..*cell
            })
        };
        self.cells
            .par_extend(before.cells.par_iter().filter_map(known));
        // Sorting by key alone, stably, leaves what was sampled anew in front.
        self.cells.par_sort_by_key(|c| c.key);
        self.cells.dedup_by_key(|c| c.key);
        self
    }

    /// Adds cells of which nothing is known.
    pub(super) fn insert(&mut self, more: Vec<[u32; 3]>) {
        self.cells.extend(more.into_iter().map(|at| Cell {
            key: key(at),
            undecided: UndecidedConstraints::MAX,
            known: false,
        }));
        self.cells.sort_by_key(|c| c.key);
        self.cells.dedup_by_key(|c| c.key);
    }

    pub(super) fn len(&self) -> usize {
        self.cells.len()
    }

    pub(super) fn position(&self, cell: usize) -> [u32; 3] {
        position(self.cells[cell].key)
    }

    pub(super) fn undecided(&self, cell: usize) -> UndecidedConstraints {
        self.cells[cell].undecided
    }

    /// Whether the solid in a cell is the one sampled before.
    pub(super) fn is_known(&self, cell: usize) -> bool {
        self.cells[cell].known
    }

    /// The number of the cell at a position.
    pub(super) fn find(&self, at: [u32; 3]) -> Option<usize> {
        let key = key(at);
        self.cells.binary_search_by_key(&key, |c| c.key).ok()
    }
}

/// The corners of all cells.
pub(super) struct Corners {
    /// Sorted.
    pub(super) keys: Vec<u64>,
    /// For each cell the numbers of its corners.
    pub(super) of_cell: Vec<[u32; 8]>,
}

impl Corners {
    pub(super) fn of(cells: &Cells) -> Self {
        // A cell's corners are the cell moved by nothing or by one along each axis.
        let mut keys: Vec<u64> = cells.cells.iter().map(|c| c.key).collect();
        for step in [offset(1), offset(2), offset(4)] {
            keys = with_moved(&keys, step);
        }
        let of_cell = cells
            .cells
            .par_chunks(4096)
            .flat_map_iter(|chunk| {
                let first = |i| keys.partition_point(|&k| k < chunk[0].key + offset(i));
                let mut next: [usize; 8] = std::array::from_fn(first);
                let keys = &keys;
                chunk.iter().map(move |cell| {
                    std::array::from_fn(|i| {
                        next[i] = advance(keys, next[i], cell.key + offset(i));
                        next[i] as u32
                    })
                })
            })
            .collect();
        Self { keys, of_cell }
    }

    pub(super) fn len(&self) -> usize {
        self.keys.len()
    }

    pub(super) fn position(&self, corner: usize) -> [u32; 3] {
        position(self.keys[corner])
    }
}

/// The place at or after `from` of the first of the sorted `keys` that is not below `key`.
pub(super) fn advance(keys: &[u64], from: usize, key: u64) -> usize {
    from + keys[from..].iter().take_while(|&&k| k < key).count()
}

/// The union of sorted keys with the same keys moved by a step.
fn with_moved(keys: &[u64], step: u64) -> Vec<u64> {
    let mut union = Vec::with_capacity(keys.len() * 2);
    let mut moved = keys.iter().map(|k| k + step).peekable();
    for &k in keys {
        while let Some(m) = moved.next_if(|&m| m < k) {
            union.push(m);
        }
        moved.next_if_eq(&k);
        union.push(k);
    }
    union.extend(moved);
    union
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeSet;

    proptest! {
        #[test]
        fn corners_are_those_of_the_cells(at in prop::collection::vec([0..5u32, 0..5u32, 0..5u32], 0..60)) {
            let lattice = Lattice { origin: nalgebra::Point3::origin(), cell_size: 1.0, cells: [5; 3] };
            let cells = Cells::new(&lattice, at.iter().map(|&a| (a, 1)).collect());
            let corners = Corners::of(&cells);
            let corner_of = |[x, y, z]: [u32; 3], i: u32| [x + (i & 1), y + (i >> 1 & 1), z + (i >> 2)];
            let expected: BTreeSet<u64> =
                at.iter().flat_map(|&a| (0..8).map(move |i| key(corner_of(a, i)))).collect();
            prop_assert_eq!(&corners.keys, &expected.into_iter().collect::<Vec<_>>());
            for (cell, numbers) in corners.of_cell.iter().enumerate() {
                for (i, &n) in numbers.iter().enumerate() {
                    let expected = corner_of(cells.position(cell), i as u32);
                    prop_assert_eq!(corners.position(n as usize), expected);
                }
            }
        }
    }
}
