//! Finds the minimum cut of a grid of cells between a source and a sink, which is the labelling of least cost among
//! all, by growing a tree from either terminal (Boykov and Kolmogorov, "An experimental comparison of min-cut/max-flow
//! algorithms for energy minimization in vision", PAMI 26(9), 2004). It computes with whole numbers on one thread, so
//! the result is always the same.

use crate::image::Grid;
use std::collections::VecDeque;

/// Directions to the four neighbours: right, down, left, up. The opposite of d is (d + 2) % 4.
const RIGHT: usize = 0;
const DOWN: usize = 1;

#[derive(Clone, Copy, PartialEq)]
enum Tree {
    None,
    Source,
    Sink,
}

/// A parent in place of a direction: the terminal itself.
const TERMINAL: u8 = 4;
/// A parent in place of a direction: none.
const ORPHAN: u8 = 5;

/// A grid graph that is being cut. A frame of cells without edges surrounds it, so that every cell has four
/// neighbours.
pub(super) struct GridCut {
    width: usize,
    offsets: [isize; 4],
    /// What is left of the edge from the source (positive) or to the sink (negative).
    terminal: Vec<i32>,
    /// What is left of the edges to the neighbours.
    residual: Vec<[i32; 4]>,
    tree: Vec<Tree>,
    parent: Vec<u8>,
    /// When the distance to the terminal was last known.
    stamp: Vec<u32>,
    distance: Vec<u32>,
    active: VecDeque<u32>,
    orphans: VecDeque<u32>,
    time: u32,
}

impl GridCut {
    /// From each cell's preference (positive for the source's side) and the cost of telling it from its
    /// right and its lower neighbour.
    pub(super) fn new(preference: &Grid<i32>, costs: &Grid<[i32; 2]>) -> Self {
        let (columns, rows) = (preference.width(), preference.height());
        let width = columns + 2;
        let size = width * (rows + 2);
        let step = width as isize;
        let mut this = Self {
            width,
            offsets: [1, step, -1, -step],
            terminal: vec![0; size],
            residual: vec![[0; 4]; size],
            tree: vec![Tree::None; size],
            parent: vec![ORPHAN; size],
            stamp: vec![0; size],
            distance: vec![0; size],
            active: VecDeque::new(),
            orphans: VecDeque::new(),
            time: 0,
        };
        for y in 0..rows {
            for x in 0..columns {
                let cell = this.index(x, y);
                this.terminal[cell] = preference[(x, y)];
                let [right, down] = costs[(x, y)];
                if x + 1 < columns {
                    this.link(cell, RIGHT, right);
                }
                if y + 1 < rows {
                    this.link(cell, DOWN, down);
                }
            }
        }
        this
    }

    fn index(&self, x: usize, y: usize) -> usize {
        (y + 1) * self.width + x + 1
    }

    fn link(&mut self, cell: usize, direction: usize, cost: i32) {
        let neighbour = self.neighbour(cell, direction);
        self.residual[cell][direction] = cost;
        self.residual[neighbour][opposite(direction)] = cost;
    }

    #[inline]
    fn neighbour(&self, cell: usize, direction: usize) -> usize {
        cell.wrapping_add_signed(self.offsets[direction])
    }

    /// Cuts. True is the source's side; a cell that either side may have at the same cost goes to the source.
    pub(super) fn solve(mut self, columns: usize, rows: usize) -> Grid<bool> {
        self.plant();
        while let Some(&cell) = self.active.front() {
            let cell = cell as usize;
            match self.grow(cell) {
                Some((source, sink, direction)) => {
                    self.augment(source, sink, direction);
                    self.adopt();
                }
                None => {
                    self.active.pop_front();
                }
            }
        }
        Grid::from_fn(columns, rows, |x, y| {
            self.tree[self.index(x, y)] != Tree::Sink
        })
    }

    fn plant(&mut self) {
        for cell in 0..self.terminal.len() {
            if self.terminal[cell] != 0 {
                self.parent[cell] = TERMINAL;
                self.distance[cell] = 1;
                self.tree[cell] = if self.terminal[cell] > 0 {
                    Tree::Source
                } else {
                    Tree::Sink
                };
            }
        }
        // A cell whose neighbours are all of its own tree has nothing to grow to.
        for cell in 0..self.terminal.len() {
            let own = self.tree[cell];
            let linked = |&d: &usize| self.residual[cell][d] > 0;
            if own != Tree::None
                && (0..4)
                    .filter(linked)
                    .any(|d| self.tree[self.neighbour(cell, d)] != own)
            {
                self.active.push_back(cell as u32);
            }
        }
    }

    /// Capacity from `cell`'s terminal onwards through `cell` to a neighbour.
    #[inline]
    fn onwards(&self, cell: usize, neighbour: usize, direction: usize) -> i32 {
        match self.tree[cell] {
            Tree::Source => self.residual[cell][direction],
            _ => self.residual[neighbour][opposite(direction)],
        }
    }

    /// Grows a tree from `cell`; where it meets the other tree, the two cells (source's, sink's) and the
    /// direction from the one to the other.
    fn grow(&mut self, cell: usize) -> Option<(usize, usize, usize)> {
        let own = self.tree[cell];
        if own == Tree::None {
            return None;
        }
        for direction in 0..4 {
            let neighbour = self.neighbour(cell, direction);
            if self.onwards(cell, neighbour, direction) == 0 || self.tree[neighbour] == own {
                continue;
            }
            if self.tree[neighbour] != Tree::None {
                return Some(match own {
                    Tree::Source => (cell, neighbour, direction),
                    _ => (neighbour, cell, opposite(direction)),
                });
            }
            self.tree[neighbour] = own;
            self.parent[neighbour] = opposite(direction) as u8;
            self.stamp[neighbour] = self.stamp[cell];
            self.distance[neighbour] = self.distance[cell] + 1;
            self.active.push_back(neighbour as u32);
        }
        None
    }

    /// Sends as much as it can along the path through two trees that meet.
    fn augment(&mut self, source: usize, sink: usize, direction: usize) {
        self.time += 1;
        let mut flow = self.residual[source][direction];
        let mut cell = source;
        while let Some((parent, d)) = self.parent_of(cell) {
            flow = flow.min(self.residual[parent][opposite(d)]);
            cell = parent;
        }
        flow = flow.min(self.terminal[cell]);
        cell = sink;
        while let Some((parent, d)) = self.parent_of(cell) {
            flow = flow.min(self.residual[cell][d]);
            cell = parent;
        }
        flow = flow.min(-self.terminal[cell]);
        self.send(source, direction, flow);
        self.drain(source, flow);
        self.drain(sink, flow);
    }

    #[inline]
    fn send(&mut self, cell: usize, direction: usize, flow: i32) {
        let neighbour = self.neighbour(cell, direction);
        self.residual[cell][direction] -= flow;
        self.residual[neighbour][opposite(direction)] += flow;
    }

    /// Takes the flow from the path between `cell` and its terminal; what is used up makes orphans.
    fn drain(&mut self, mut cell: usize, flow: i32) {
        let from_source = self.tree[cell] == Tree::Source;
        while let Some((parent, d)) = self.parent_of(cell) {
            let left = if from_source {
                self.send(parent, opposite(d), flow);
                self.residual[parent][opposite(d)]
            } else {
                self.send(cell, d, flow);
                self.residual[cell][d]
            };
            if left == 0 {
                self.orphan(cell);
            }
            cell = parent;
        }
        self.terminal[cell] += if from_source { -flow } else { flow };
        if self.terminal[cell] == 0 {
            self.orphan(cell);
        }
    }

    fn orphan(&mut self, cell: usize) {
        self.parent[cell] = ORPHAN;
        self.orphans.push_back(cell as u32);
    }

    #[inline]
    fn parent_of(&self, cell: usize) -> Option<(usize, usize)> {
        let d = self.parent[cell];
        (d < TERMINAL).then(|| (self.neighbour(cell, usize::from(d)), usize::from(d)))
    }

    /// Finds every orphan a new parent in its own tree, or sets it free.
    fn adopt(&mut self) {
        while let Some(cell) = self.orphans.pop_front() {
            let cell = cell as usize;
            match self.nearest_parent(cell) {
                Some((direction, distance)) => {
                    self.parent[cell] = direction as u8;
                    self.stamp[cell] = self.time;
                    self.distance[cell] = distance + 1;
                }
                None => self.set_free(cell),
            }
        }
    }

    fn nearest_parent(&mut self, cell: usize) -> Option<(usize, u32)> {
        let mut best: Option<(usize, u32)> = None;
        for direction in 0..4 {
            let neighbour = self.neighbour(cell, direction);
            if self.tree[neighbour] == self.tree[cell]
                && self.onwards(neighbour, cell, opposite(direction)) > 0
                && let Some(distance) = self.distance_to_terminal(neighbour)
                && best.is_none_or(|(_, d)| distance < d)
            {
                best = Some((direction, distance));
            }
        }
        best
    }

    /// Steps from a cell to its terminal; `None` if its line ends at an orphan.
    fn distance_to_terminal(&mut self, cell: usize) -> Option<u32> {
        let (mut at, mut steps) = (cell, 0);
        loop {
            if self.stamp[at] == self.time {
                steps += self.distance[at];
                break;
            }
            steps += 1;
            match self.parent[at] {
                ORPHAN => return None,
                TERMINAL => {
                    self.stamp[at] = self.time;
                    self.distance[at] = 1;
                    break;
                }
                d => at = self.neighbour(at, usize::from(d)),
            }
        }
        let (mut at, mut left) = (cell, steps);
        while self.stamp[at] != self.time {
            self.stamp[at] = self.time;
            self.distance[at] = left;
            left -= 1;
            at = self.neighbour(at, usize::from(self.parent[at]));
        }
        Some(steps)
    }

    fn set_free(&mut self, cell: usize) {
        for direction in 0..4 {
            let neighbour = self.neighbour(cell, direction);
            if self.tree[neighbour] != self.tree[cell] {
                continue;
            }
            if self.onwards(neighbour, cell, opposite(direction)) > 0 {
                self.active.push_back(neighbour as u32);
            }
            if usize::from(self.parent[neighbour]) == opposite(direction) {
                self.orphan(neighbour);
            }
        }
        self.tree[cell] = Tree::None;
    }
}

#[inline]
fn opposite(direction: usize) -> usize {
    (direction + 2) % 4
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn cost(
        preference: &Grid<i32>,
        costs: &Grid<[i32; 2]>,
        label: impl Fn(usize, usize) -> bool,
    ) -> i32 {
        let mut sum = 0;
        for y in 0..preference.height() {
            for x in 0..preference.width() {
                let p = preference[(x, y)];
                sum += if label(x, y) { (-p).max(0) } else { p.max(0) };
                let [right, down] = costs[(x, y)];
                if x + 1 < preference.width() && label(x, y) != label(x + 1, y) {
                    sum += right;
                }
                if y + 1 < preference.height() && label(x, y) != label(x, y + 1) {
                    sum += down;
                }
            }
        }
        sum
    }

    proptest! {
        /// No labelling of a 4x3 grid costs less: all 4096 are tried.
        #[test]
        fn no_labelling_costs_less(
            preference in prop::collection::vec(-9..10i32, 12),
            costs in prop::collection::vec([0..6i32, 0..6i32], 12),
        ) {
            let preference = Grid::from_pixels(4, 3, preference);
            let costs = Grid::from_pixels(4, 3, costs);
            let found = GridCut::new(&preference, &costs).solve(4, 3);
            let least = (0..4096u32)
                .map(|bits| cost(&preference, &costs, |x, y| bits >> (y * 4 + x) & 1 == 1))
                .min();
            prop_assert_eq!(Some(cost(&preference, &costs, |x, y| found[(x, y)])), least);
        }
    }
}
