//! Patches of a surface a few cells wide, in each of which one vertex stands for the others: its error takes too long
//! to compute for all vertices, and varies little from one vertex to the next.

use nalgebra::Point3;

type Key = [i32; 3];

/// Cubes to each side of one over which values are smoothed.
const REACH: i32 = 2;

/// Points by the cubes that they lie in.
pub(super) struct Patches {
    /// The cubes with points, in ascending order, each with the points' indices.
    cubes: Vec<(Key, Vec<u32>)>,
}

impl Patches {
    /// Sorts points, given with their indices, into cubes of an edge of `size` metres.
    pub(super) fn new(points: impl Iterator<Item = (u32, Point3<f32>)>, size: f64) -> Self {
        let key = |p: Point3<f32>| {
            p.coords
                .map(|c| (f64::from(c) / size).floor() as i32)
                .into()
        };
        let mut keyed: Vec<(Key, u32)> = points.map(|(index, p)| (key(p), index)).collect();
        keyed.sort_unstable();
        let cubes = keyed.chunk_by(|a, b| a.0 == b.0);
        let cubes = cubes.map(|cube| (cube[0].0, cube.iter().map(|(_, index)| *index).collect()));
        Self {
            cubes: cubes.collect(),
        }
    }

    /// The indices of each cube's points, the cubes in a fixed order.
    pub(super) fn indices(&self) -> impl ExactSizeIterator<Item = &[u32]> {
        self.cubes.iter().map(|(_, indices)| indices.as_slice())
    }

    /// For each cube the mean of the values of itself and the cubes within [`REACH`].
    pub(super) fn smoothed(&self, values: &[f64]) -> Vec<f64> {
        let around = |key: &Key| {
            let (mut sum, mut count) = (0.0, 0.0);
            for x in -REACH..=REACH {
                for y in -REACH..=REACH {
                    // Cubes in a column follow each other.
                    let first = [key[0] + x, key[1] + y, key[2] - REACH];
                    let from = self.cubes.partition_point(|cube| cube.0 < first);
                    let column = self.cubes[from..].iter().zip(&values[from..]);
                    let last = [first[0], first[1], key[2] + REACH];
                    for (_, value) in column.take_while(|(cube, _)| cube.0 <= last) {
                        sum += value;
                        count += 1.0;
                    }
                }
            }
            sum / count
        };
        self.cubes.iter().map(|(key, _)| around(key)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_are_sorted_into_cubes_and_values_are_smoothed_over_neighbours_alone() {
        let at = [
            [0.5, 0.5, 0.5],
            [0.6, 0.5, 0.5],
            [2.5, 0.5, -0.5],
            [5.5, 0.5, 0.5],
        ];
        let points = at.into_iter().zip(0..).map(|(p, i)| (i, Point3::from(p)));
        let patches = Patches::new(points, 1.0);
        let cubes: Vec<&[u32]> = patches.indices().collect();
        assert_eq!(cubes, [&[0, 1][..], &[2], &[3]]);
        assert_eq!(patches.smoothed(&[1.0, 3.0, 7.0]), [2.0, 2.0, 7.0]);
    }
}
