//! Finds the points of a set that are near a place: points sorted into cubes.

use nalgebra::Point3;

type Cube = [i32; 3];

/// Cubes around a place in which the nearest points are looked for at most, in each direction.
const FARTHEST: i32 = 8;

/// Points by the cubes that they lie in.
pub(super) struct PointGrid {
    /// Edge of a cube in metres.
    size: f64,
    /// The points with their cubes and indices, in ascending order of these.
    sorted: Vec<(Cube, u32, Point3<f64>)>,
}

impl PointGrid {
    /// Sorts points into cubes of an edge of `size` metres, which is above 0.
    pub(super) fn new(points: impl Iterator<Item = Point3<f64>>, size: f64) -> Self {
        let keyed = points.zip(0..).map(|(p, index)| (cube(p, size), index, p));
        let mut sorted: Vec<(Cube, u32, Point3<f64>)> = keyed.collect();
        sorted.sort_unstable_by_key(|(cube, index, _)| (*cube, *index));
        Self { size, sorted }
    }

    /// Indices of the points that are no farther than a cube's edge, in a fixed order.
    pub(super) fn within_an_edge(&self, p: Point3<f64>) -> impl Iterator<Item = usize> + '_ {
        let near = self.around(p, 1);
        let square = self.size * self.size;
        let near = near.filter(move |(squared, _)| *squared <= square);
        near.map(|(_, index)| index as usize)
    }

    /// Indices of the `count` nearest points; fewer where there are no more within some cubes.
    pub(super) fn nearest(&self, p: Point3<f64>, count: usize) -> Vec<usize> {
        let mut found: Vec<(f64, u32)> = Vec::new();
        for reach in 1..=FARTHEST {
            found = self.around(p, reach).collect();
            let radius = f64::from(reach) * self.size;
            let surely = found
                .iter()
                .filter(|(squared, _)| *squared <= radius * radius);
            if surely.count() >= count {
                break;
            }
        }
        found.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        found.truncate(count);
        found.into_iter().map(|(_, index)| index as usize).collect()
    }

    /// Squared distances and indices of the points in the cubes that are no more than `reach` cubes away from that of a
    /// place.
    fn around(&self, p: Point3<f64>, reach: i32) -> impl Iterator<Item = (f64, u32)> + '_ {
        let middle = cube(p, self.size);
        let columns = (-reach..=reach).flat_map(move |x| (-reach..=reach).map(move |y| [x, y]));
        columns.flat_map(move |[x, y]| {
            // Cubes in a column follow each other.
            let [first, last] = [-reach, reach].map(|z| {
                let [a, b, c] = middle;
                [
                    a.saturating_add(x),
                    b.saturating_add(y),
                    c.saturating_add(z),
                ]
            });
            let from = self.sorted.partition_point(|point| point.0 < first);
            let column = self.sorted[from..].iter();
            let column = column.take_while(move |point| point.0 <= last);
            column.map(move |(_, index, q)| ((q - p).norm_squared(), *index))
        })
    }
}

fn cube(p: Point3<f64>, size: f64) -> Cube {
    p.coords.map(|c| (c / size).floor() as i32).into()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_nearest_points_are_those_of_a_search_through_all(
            points in prop::collection::vec(prop::array::uniform3(-1.0..1.0_f64), 1..80),
            p in prop::array::uniform3(-1.0..1.0_f64),
        ) {
            let points: Vec<Point3<f64>> = points.into_iter().map(Point3::from).collect();
            let p = Point3::from(p);
            let grid = PointGrid::new(points.iter().copied(), 0.4);
            let distance = |index: usize| (points[index] - p).norm();
            let mut all: Vec<usize> = (0..points.len()).collect();
            all.sort_by(|&a, &b| distance(a).total_cmp(&distance(b)));
            let found = grid.nearest(p, 6);
            all.truncate(6);
            prop_assert_eq!(&found, &all);
            let mut within: Vec<usize> = grid.within_an_edge(p).collect();
            within.sort_unstable();
            let expected = (0..points.len()).filter(|&i| distance(i) <= 0.4);
            prop_assert_eq!(within, expected.collect::<Vec<_>>());
        }
    }
}
