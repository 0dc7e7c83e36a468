//! The edges of a mesh with the triangles on each: sorted, in linear time, the same on every run.

/// One side of one triangle, as seen from its edge.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Side {
    /// The edge's lower vertex.
    pub low: u32,
    /// The edge's higher vertex.
    pub high: u32,
    /// The triangle.
    pub triangle: u32,
    /// Which of its sides: side i runs from corner i to corner i + 1.
    pub side: u8,
    /// Whether the triangle runs along it from `low` to `high`.
    pub forward: bool,
}

/// The sides of `triangles`, so that those of one edge are neighbours: in the order of `low`, then `high`,
/// then triangle. Triangles that name a vertex twice or one at or above `vertex_count` are left out.
pub fn sorted_sides(triangles: &[[u32; 3]], vertex_count: usize) -> Vec<Side> {
    let mut starts = vec![0_u32; vertex_count + 1];
    for side in sides(triangles, vertex_count) {
        starts[side.low as usize + 1] += 1;
    }
    for v in 0..vertex_count {
        starts[v + 1] += starts[v];
    }
    let empty = Side {
        low: 0,
        high: 0,
        triangle: 0,
        side: 0,
        forward: false,
    };
    let mut sorted = vec![empty; starts[vertex_count] as usize];
    let mut next = starts.clone();
    for side in sides(triangles, vertex_count) {
        let slot = &mut next[side.low as usize];
        sorted[*slot as usize] = side;
        *slot += 1;
    }
    for bucket in starts.windows(2) {
        sorted[bucket[0] as usize..bucket[1] as usize]
            .sort_unstable_by_key(|s| (s.high, s.triangle, s.side));
    }
    sorted
}

/// The runs of `sorted_sides` that belong to one edge each.
pub fn edges(sides: &[Side]) -> impl Iterator<Item = &[Side]> {
    sides.chunk_by(|a, b| (a.low, a.high) == (b.low, b.high))
}

fn sides(triangles: &[[u32; 3]], vertex_count: usize) -> impl Iterator<Item = Side> {
    let sound = move |t: &[u32; 3]| is_sound(t, vertex_count);
    let indexed = triangles.iter().enumerate().filter(move |(_, t)| sound(t));
    indexed.flat_map(|(index, t)| (0..3).map(move |i| side_of(t, index as u32, i)))
}

/// Whether a triangle names three different vertices that exist.
pub(super) fn is_sound(&[a, b, c]: &[u32; 3], vertex_count: usize) -> bool {
    a != b && b != c && c != a && [a, b, c].iter().all(|&v| (v as usize) < vertex_count)
}

fn side_of(t: &[u32; 3], triangle: u32, i: usize) -> Side {
    let (from, to) = (t[i], t[(i + 1) % 3]);
    Side {
        low: from.min(to),
        high: from.max(to),
        triangle,
        side: i as u8,
        forward: from < to,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sides_of_an_edge_are_neighbours() {
        let sides = sorted_sides(&[[2, 1, 0], [1, 2, 3], [0, 0, 1], [0, 1, 9]], 4);
        let runs: Vec<_> = edges(&sides)
            .map(|run| (run[0].low, run[0].high, run.len()))
            .collect();
        assert_eq!(
            runs,
            [(0, 1, 1), (0, 2, 1), (1, 2, 2), (1, 3, 1), (2, 3, 1)]
        );
        let shared: Vec<_> = sides.iter().filter(|s| (s.low, s.high) == (1, 2)).collect();
        assert_eq!((shared[0].triangle, shared[0].forward), (0, false));
        assert_eq!((shared[1].triangle, shared[1].forward), (1, true));
    }
}
