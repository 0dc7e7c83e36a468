//! Cuts a surface into charts for a texture: connected parts that face about one way, projected onto a plane in which
//! no two of their triangles overlap. Knows nothing of colours, nor of where charts lie in an atlas.

use crate::array::two;
use crate::image::Grid;
use crate::mesh::{Mesh, NO_TRIANGLE, Rings};
use nalgebra::{Point3, Vector3};
use std::collections::HashSet;

/// Texels around a chart, so that a viewer's interpolation meets no other chart's colours.
pub(super) const GUTTER: usize = 2;
/// Least cosine between a triangle's normal and its chart's direction: a texel is 1 / 0.6 times as long there.
const LEAST_COSINE: f64 = 0.6;
/// The owner of a texel that no triangle has.
pub(super) const NOBODY: u32 = u32::MAX;

/// A part of the surface and its plane.
pub(super) struct Chart {
    /// Its triangles.
    pub triangles: Vec<u32>,
    /// For each texel the triangle whose colours it has, also in the gutter around them, or [`NOBODY`].
    pub owners: Grid<u32>,
    plane: Plane,
    /// The centre of the top left texel.
    low: [f64; 2],
}

impl Chart {
    /// A triangle's corners, in texels from the centre of the top left one.
    pub(super) fn corners(&self, mesh: &Mesh, triangle: u32) -> [[f64; 2]; 3] {
        let corners = self.plane.corners(mesh, triangle);
        corners.map(|p| two(|i| p[i] - self.low[i]))
    }
}

/// Axes in which texels are counted, and a texel's length.
struct Plane {
    axes: [Vector3<f64>; 2],
    texel: f64,
}

impl Plane {
    /// The plane across a unit vector.
    fn across(direction: Vector3<f64>, texel: f64) -> Self {
        let least = direction.iamin();
        let along = Vector3::ith(least, 1.0).cross(&direction).normalize();
        Self {
            axes: [along, direction.cross(&along)],
            texel,
        }
    }

    fn corners(&self, mesh: &Mesh, triangle: u32) -> [[f64; 2]; 3] {
        let corners: [Point3<f64>; 3] = mesh.corners(triangle as usize).map(|p| p.cast());
        corners.map(|p| self.axes.map(|axis| axis.dot(&p.coords) / self.texel))
    }
}

/// The charts of a surface, with texels of this length in metres. Each triangle is in one of them.
pub(super) fn charts(mesh: &Mesh, texel: f64) -> Vec<Chart> {
    let surface = Surface {
        mesh,
        normals: (0..mesh.triangles.len()).map(|t| normal(mesh, t)).collect(),
        across: Rings::new(mesh).across(mesh),
        texel,
    };
    let mut is_done = vec![false; mesh.triangles.len()];
    let mut charts = Vec::new();
    for seed in 0..mesh.triangles.len() as u32 {
        if !is_done[seed as usize] {
            charts.push(surface.chart(seed, &mut is_done));
        }
    }
    charts
}

/// The unit normal; `None` of a triangle without area.
fn normal(mesh: &Mesh, triangle: usize) -> Option<Vector3<f64>> {
    let [a, b, c] = mesh.corners(triangle).map(|p| p.cast::<f64>());
    (b - a).cross(&(c - a)).try_normalize(1e-18)
}

struct Surface<'a> {
    mesh: &'a Mesh,
    normals: Vec<Option<Vector3<f64>>>,
    across: Vec<[u32; 3]>,
    texel: f64,
}

impl Surface<'_> {
    /// The chart that a triangle begins, which takes what is left around it.
    fn chart(&self, seed: u32, is_done: &mut [bool]) -> Chart {
        let first = self.normals[seed as usize].unwrap_or_else(Vector3::z);
        let facing = self.connected(seed, |t| !is_done[t as usize] && self.faces(t, first));
        let sum = facing
            .iter()
            .filter_map(|&t| self.normals[t as usize])
            .fold(Vector3::zeros(), |sum, normal| sum + normal);
        let plane = Plane::across(sum.try_normalize(1e-9).unwrap_or(first), self.texel);
        let direction = plane.axes[0].cross(&plane.axes[1]);
        let mut taken = HashSet::new();
        let triangles = self.connected(seed, |t| {
            let is_wanted = !is_done[t as usize] && (t == seed || self.faces(t, direction));
            let corners = plane.corners(self.mesh, t);
            let is_free = is_wanted && covered(corners).all(|at| !taken.contains(&at));
            if is_free {
                taken.extend(covered(corners));
                is_done[t as usize] = true;
            }
            is_free
        });
        self.measured(triangles, plane)
    }

    fn faces(&self, triangle: u32, direction: Vector3<f64>) -> bool {
        let normal = self.normals[triangle as usize];
        normal.is_none_or(|normal| normal.dot(&direction) >= LEAST_COSINE)
    }

    /// The triangles that are reached from a seed over sides of those that are wanted, in the order in which they are.
    fn connected(&self, seed: u32, mut is_wanted: impl FnMut(u32) -> bool) -> Vec<u32> {
        if !is_wanted(seed) {
            return Vec::new();
        }
        let mut found = vec![seed];
        let mut seen = HashSet::from([seed]);
        let mut next = 0;
        while let Some(&triangle) = found.get(next) {
            next += 1;
            for other in self.across[triangle as usize] {
                if other != NO_TRIANGLE && seen.insert(other) && is_wanted(other) {
                    found.push(other);
                }
            }
        }
        found
    }

    /// Lays texels over the triangles of a chart.
    fn measured(&self, triangles: Vec<u32>, plane: Plane) -> Chart {
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for corner in triangles.iter().flat_map(|&t| plane.corners(self.mesh, t)) {
            low = two(|i| low[i].min(corner[i]));
            high = two(|i| high[i].max(corner[i]));
        }
        let gutter = GUTTER as f64;
        let low = low.map(|v| v.floor() - gutter);
        let [width, height] = two(|i| (high[i].ceil() - low[i] + gutter) as usize + 1);
        let mut chart = Chart {
            triangles,
            owners: Grid::filled(width, height, NOBODY),
            plane,
            low,
        };
        for &triangle in &chart.triangles {
            let corners = chart.corners(self.mesh, triangle);
            // A triangle that covers no texel's centre has the one that its middle is in, if that is free.
            let middle = two(|i| (corners.iter().map(|p| p[i]).sum::<f64>() / 3.0).round() as i64);
            let middle = place(middle);
            if chart.owners[middle] == NOBODY {
                chart.owners[middle] = triangle;
            }
            for at in covered(corners) {
                chart.owners[place(at)] = triangle;
            }
        }
        for _ in 0..GUTTER {
            chart.owners = widened(&chart.owners);
        }
        chart
    }
}

/// A texel of a chart, which has none left of it or above it.
fn place([x, y]: [i64; 2]) -> (usize, usize) {
    (x.max(0) as usize, y.max(0) as usize)
}

/// The texels whose centres are within a triangle, row by row; of two triangles that share a side, one has those on it,
/// or none.
fn covered(corners: [[f64; 2]; 3]) -> impl Iterator<Item = [i64; 2]> {
    const SLACK: f64 = 1e-9;
    let [low, high] =
        [f64::min, f64::max].map(|of| of(of(corners[0][1], corners[1][1]), corners[2][1]));
    (low.ceil() as i64..=high.floor() as i64).flat_map(move |row| {
        let y = row as f64;
        let (mut left, mut right) = (f64::INFINITY, f64::NEG_INFINITY);
        for i in 0..3 {
            let (p, q) = (corners[i], corners[(i + 1) % 3]);
            if (p[1] < y) != (q[1] < y) {
                let x = p[0] + (q[0] - p[0]) * (y - p[1]) / (q[1] - p[1]);
                (left, right) = (left.min(x), right.max(x));
            }
        }
        let columns = (left + SLACK).ceil() as i64..=(right - SLACK).floor() as i64;
        columns.map(move |x| [x, row])
    })
}

/// The owners, with each texel that has none but touches one that has.
fn widened(owners: &Grid<u32>) -> Grid<u32> {
    const AROUND: [[isize; 2]; 8] = [
        [-1, 0],
        [1, 0],
        [0, -1],
        [0, 1],
        [-1, -1],
        [1, -1],
        [-1, 1],
        [1, 1],
    ];
    Grid::from_fn(owners.width(), owners.height(), |x, y| {
        let beside = |[dx, dy]: &[isize; 2]| owners.get(x as isize + dx, y as isize + dy).copied();
        let mut owned = AROUND.iter().filter_map(beside).filter(|&o| o != NOBODY);
        match owners[(x, y)] {
            NOBODY => owned.next().unwrap_or(NOBODY),
            own => own,
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::array::three;
    use crate::mesh::shapes;

    /// Each triangle is in one chart, and its middle belongs to it alone.
    fn check(mesh: &Mesh, charts: &[Chart]) {
        let mut found: Vec<u32> = charts.iter().flat_map(|c| c.triangles.clone()).collect();
        found.sort_unstable();
        assert!(found.into_iter().eq(0..mesh.triangles.len() as u32));
        for chart in charts {
            for &triangle in &chart.triangles {
                let corners = chart.corners(mesh, triangle);
                let middle = two(|i| corners.iter().map(|p| p[i]).sum::<f64>() / 3.0);
                let [x, y] = middle.map(|v| v.round() as usize);
                let owner = chart.owners[(x, y)];
                let covers = covered(corners).any(|at| place(at) == (x, y));
                assert!(owner == triangle || !covers, "{triangle}: {owner}");
                let [width, height] = [chart.owners.width(), chart.owners.height()];
                let gutter = GUTTER as f64;
                for [x, y] in corners {
                    assert!(x >= gutter && x <= width as f64 - 1.0 - gutter);
                    assert!(y >= gutter && y <= height as f64 - 1.0 - gutter);
                }
            }
        }
    }

    #[test]
    fn a_ball_has_few_charts_and_a_box_one_for_each_side() {
        let ball = shapes::sphere(0.05, 4);
        let of_ball = charts(&ball, 5e-4);
        check(&ball, &of_ball);
        assert!(of_ball.len() < 40, "{}", of_ball.len());
        let cuboid = crate::mesh::cuboid([0.0; 3], [0.03, 0.02, 0.01]);
        let of_box = charts(&cuboid, 5e-4);
        check(&cuboid, &of_box);
        assert_eq!(of_box.len(), 6);
    }

    /// A strip that winds around an axis as stairs do: all of it faces up.
    #[test]
    fn what_lies_above_itself_is_cut() {
        let step = |i: u32, radius: f32| {
            let turn = i as f32 * 0.3;
            Point3::new(radius * turn.cos(), radius * turn.sin(), i as f32 * 1e-4)
        };
        let steps = 50;
        let mesh = Mesh {
            vertices: (0..steps)
                .flat_map(|i| [step(i, 0.01), step(i, 0.02)])
                .collect(),
            triangles: (0..steps - 1)
                .flat_map(|i| {
                    let v = 2 * i;
                    [[v, v + 1, v + 2], [v + 2, v + 1, v + 3]]
                })
                .collect(),
        };
        let found = charts(&mesh, 5e-4);
        check(&mesh, &found);
        // It winds around 2.3 times.
        assert!((3..10).contains(&found.len()), "{}", found.len());
    }

    #[test]
    fn triangles_without_area_and_without_neighbours_have_charts() {
        let point = Point3::new(1.0, 2.0, 3.0);
        let mesh = Mesh {
            vertices: vec![point; 4],
            triangles: vec![[0, 1, 2], [2, 1, 3], [0, 0, 0]],
        };
        check(&mesh, &charts(&mesh, 1e-3));
    }

    #[test]
    fn triangles_that_share_a_side_cover_no_texel_twice() {
        let corners = [[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]];
        let [a, b] = [[0, 1, 2], [0, 2, 3]].map(|t| three(|i| corners[t[i]]));
        let mut all: Vec<_> = covered(a).chain(covered(b)).collect();
        let count = all.len();
        all.sort_unstable();
        all.dedup();
        assert_eq!(all.len(), count);
        assert_eq!(count, 9);
    }
}
