//! The convex hull of points: quickhull (Barber, Dobkin and Huhdanpaa 1996) on an integer grid, where the
//! side of a plane is decided exactly, so that coplanar and nearly coplanar points cannot break it.

use super::Mesh;
use nalgebra::Point3;
use std::collections::BTreeMap;

/// Steps of the grid over the points' largest extent: finer than `f32` can tell points apart.
const STEPS: f64 = (1_u32 << 24) as f64;

/// The convex hull of `points`, closed and oriented, its vertices among the points (in their order); `None`
/// where they lie in one plane or one of them is not finite. Points that stick out by less than 1/2^24 of the
/// extent may be left out.
pub fn convex_hull(points: &[Point3<f32>]) -> Option<Mesh> {
    let grid = to_grid(points)?;
    let mut hull = Hull::tetrahedron(&grid)?;
    while let Some(face) = hull.pending.pop() {
        if hull.faces[face].alive {
            hull.grow(face);
        }
    }
    Some(hull.into_mesh(points))
}

type Cell = [i64; 3];

fn to_grid(points: &[Point3<f32>]) -> Option<Vec<Cell>> {
    let mut min = [f64::INFINITY; 3];
    let mut max = [f64::NEG_INFINITY; 3];
    for p in points {
        for axis in 0..3 {
            let value = f64::from(p[axis]);
            if !value.is_finite() {
                return None;
            }
            min[axis] = min[axis].min(value);
            max[axis] = max[axis].max(value);
        }
    }
    let extent = (0..3).map(|i| max[i] - min[i]).fold(0.0, f64::max);
    // A power of two, so that points of a coarse grid stay exactly collinear and coplanar.
    let scale = (STEPS / extent).log2().floor().exp2();
    let cell = |p: &Point3<f32>| {
        std::array::from_fn(|i| ((f64::from(p[i]) - min[i]) * scale).round() as i64)
    };
    (extent > 0.0).then(|| points.iter().map(cell).collect())
}

fn difference(a: Cell, b: Cell) -> Cell {
    std::array::from_fn(|i| a[i] - b[i])
}

fn cross(a: Cell, b: Cell) -> Cell {
    std::array::from_fn(|i| {
        let (j, k) = ((i + 1) % 3, (i + 2) % 3);
        a[j] * b[k] - a[k] * b[j]
    })
}

/// Exact: a cross product of grid differences stays below 2^51, its product with a difference below 2^76.
fn dot(a: Cell, b: Cell) -> i128 {
    (0..3).map(|i| i128::from(a[i]) * i128::from(b[i])).sum()
}

struct Face {
    corners: [u32; 3],
    /// Across the side from corner i to corner i + 1.
    neighbours: [usize; 3],
    normal: Cell,
    /// Points outside this face that no earlier face has taken.
    outside: Vec<u32>,
    alive: bool,
}

struct Hull<'a> {
    grid: &'a [Cell],
    faces: Vec<Face>,
    pending: Vec<usize>,
}

impl<'a> Hull<'a> {
    fn tetrahedron(grid: &'a [Cell]) -> Option<Self> {
        let [a, b, c, d] = spread(grid)?;
        let mut hull = Self {
            grid,
            faces: Vec::new(),
            pending: Vec::new(),
        };
        for (corners, neighbours) in [
            ([a, b, c], [1, 2, 3]),
            ([b, a, d], [0, 3, 2]),
            ([c, b, d], [0, 1, 3]),
            ([a, c, d], [0, 2, 1]),
        ] {
            hull.add(corners, neighbours);
        }
        let all = (0..grid.len() as u32).collect();
        hull.share_out(all, 0);
        Some(hull)
    }

    fn add(&mut self, corners: [u32; 3], neighbours: [usize; 3]) {
        let [a, b, c] = corners.map(|v| self.grid[v as usize]);
        self.faces.push(Face {
            corners,
            neighbours,
            normal: cross(difference(b, a), difference(c, a)),
            outside: Vec::new(),
            alive: true,
        });
    }

    /// Above 0 where point `p` is outside the face; grows with the distance.
    fn height(&self, face: &Face, p: u32) -> i128 {
        let corner = self.grid[face.corners[0] as usize];
        dot(difference(self.grid[p as usize], corner), face.normal)
    }

    /// Gives each point to the first face from `first` on that it lies outside of; the others are inside.
    fn share_out(&mut self, points: Vec<u32>, first: usize) {
        for p in points {
            let taker = (first..self.faces.len()).find(|&f| self.height(&self.faces[f], p) > 0);
            if let Some(face) = taker {
                self.faces[face].outside.push(p);
            }
        }
        let faces = first..self.faces.len();
        self.pending
            .extend(faces.filter(|&f| !self.faces[f].outside.is_empty()));
    }

    /// Takes the farthest point outside `face` into the hull.
    fn grow(&mut self, face: usize) {
        let points = &self.faces[face].outside;
        let farthest = points
            .iter()
            .max_by_key(|&&p| (self.height(&self.faces[face], p), std::cmp::Reverse(p)));
        let Some(&apex) = farthest else { return };
        let (rim, orphans) = self.remove_visible(face, apex);
        let first = self.faces.len();
        // Walk round the rim: each new face knows its neighbours by the rim's vertices.
        let mut at = *rim.keys().next().expect("a visible face has a rim");
        for i in 0..rim.len() {
            let (to, beyond) = rim[&at];
            let (before, after) = (
                first + (i + rim.len() - 1) % rim.len(),
                first + (i + 1) % rim.len(),
            );
            let side = side_from(&self.faces[beyond].corners, to);
            self.faces[beyond].neighbours[side] = first + i;
            self.add([at, to, apex], [beyond, after, before]);
            at = to;
        }
        self.share_out(orphans, first);
    }

    /// Removes all faces that `apex` is outside of. Answers with the rim of the gap (from each vertex to the
    /// next, with the face beyond) and the points that have lost their face.
    fn remove_visible(
        &mut self,
        face: usize,
        apex: u32,
    ) -> (BTreeMap<u32, (u32, usize)>, Vec<u32>) {
        let mut rim = BTreeMap::new();
        let mut orphans = Vec::new();
        let mut stack = vec![face];
        self.faces[face].alive = false;
        while let Some(current) = stack.pop() {
            orphans.append(&mut self.faces[current].outside);
            for side in 0..3 {
                let beyond = self.faces[current].neighbours[side];
                if !self.faces[beyond].alive {
                    continue;
                }
                if self.height(&self.faces[beyond], apex) > 0 {
                    self.faces[beyond].alive = false;
                    stack.push(beyond);
                } else {
                    let corners = self.faces[current].corners;
                    rim.insert(corners[side], (corners[(side + 1) % 3], beyond));
                }
            }
        }
        (rim, orphans)
    }

    fn into_mesh(self, points: &[Point3<f32>]) -> Mesh {
        let alive = || self.faces.iter().filter(|f| f.alive);
        let mut used: Vec<u32> = alive().flat_map(|f| f.corners).collect();
        used.sort_unstable();
        used.dedup();
        let index = |v: u32| used.partition_point(|&u| u < v) as u32;
        Mesh {
            vertices: used.iter().map(|&v| points[v as usize]).collect(),
            triangles: alive().map(|f| f.corners.map(index)).collect(),
        }
    }
}

/// Which side of a triangle begins at vertex `from`.
fn side_from(corners: &[u32; 3], from: u32) -> usize {
    corners
        .iter()
        .position(|&v| v == from)
        .expect("neighbours share an edge")
}

/// Four points that span a volume, the last below the plane of the others.
fn spread(grid: &[Cell]) -> Option<[u32; 4]> {
    let indices = 0..grid.len() as u32;
    let farthest = |measure: &dyn Fn(Cell) -> i128| {
        indices
            .clone()
            .max_by_key(|&v| (measure(grid[v as usize]), std::cmp::Reverse(v)))
    };
    let a = farthest(&|p| i128::from(-p[0]))?;
    let origin = grid[a as usize];
    let from_a = |p: Cell| difference(p, origin);
    let b = farthest(&|p| dot(from_a(p), from_a(p)))?;
    let along = from_a(grid[b as usize]);
    let c = farthest(&|p| {
        let area = cross(along, from_a(p));
        dot(area, area)
    })?;
    let normal = cross(along, from_a(grid[c as usize]));
    let d = farthest(&|p| dot(normal, from_a(p)).abs())?;
    match dot(normal, from_a(grid[d as usize])) {
        0 => None,
        height if height < 0 => Some([a, b, c, d]),
        _ => Some([a, c, b, d]),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::{check, shapes};
    use proptest::prelude::*;

    #[test]
    fn the_hull_of_a_torus_fills_its_hole() {
        let torus = shapes::torus(1.0, 0.3, 96, 48);
        let report = check(&convex_hull(&torus.vertices).unwrap());
        assert!(report.is_watertight());
        assert_eq!(report.genus, Some(0));
        // Half a torus outside the circle of its centres (Pappus), and a cylinder within.
        let outer = std::f64::consts::PI * 0.09 / 2.0
            * std::f64::consts::TAU
            * (1.0 + 4.0 * 0.3 / (3.0 * std::f64::consts::PI));
        let inner = std::f64::consts::PI * 0.6;
        assert!(
            (report.volume / (outer + inner) - 1.0).abs() < 0.01,
            "{}",
            report.volume
        );
    }

    #[test]
    fn points_on_faces_and_edges_do_not_disturb_a_cube() {
        let mut points = Vec::new();
        for i in 0..1000_usize {
            let at = |v: usize| (v % 10) as f32 / 9.0;
            points.push(Point3::new(at(i), at(i / 10), at(i / 100)));
        }
        let report = check(&convex_hull(&points).unwrap());
        assert!(report.is_watertight());
        assert!((report.volume - 1.0).abs() < 1e-6);
    }

    #[test]
    fn flat_broken_and_missing_points_have_no_hull() {
        let flat: Vec<_> = (0..20)
            .map(|i| Point3::new(i as f32, (i * i) as f32, 1.0))
            .collect();
        assert_eq!(convex_hull(&flat), None);
        assert_eq!(convex_hull(&[]), None);
        assert_eq!(convex_hull(&[Point3::origin(); 9]), None);
        let mut broken = shapes::cube(1.0).vertices;
        broken[3].y = f32::INFINITY;
        assert_eq!(convex_hull(&broken), None);
    }

    proptest! {
        #[test]
        fn no_point_is_outside_and_the_hull_is_closed(
            cells in prop::collection::vec(prop::array::uniform3(-4_i8..5), 4..80),
        ) {
            // A coarse grid, so that many points are coplanar, collinear or equal.
            let points: Vec<_> = cells.iter().map(|c| Point3::from(c.map(f32::from))).collect();
            if let Some(hull) = convex_hull(&points) {
                prop_assert!(check(&hull).is_watertight());
                for t in 0..hull.triangles.len() {
                    let [a, b, c] = hull.corners(t).map(|p| p.cast::<f64>());
                    let normal = (b - a).cross(&(c - a));
                    for p in &points {
                        let height = normal.dot(&(p.cast::<f64>() - a)) / normal.norm();
                        prop_assert!(height < 1e-5, "{height}");
                    }
                }
            }
        }
    }
}
