//! A bounding volume hierarchy over a mesh: finds what a ray meets first, and which point of the surface is
//! nearest. It is built once and then only read, so any number of threads may use it.

use super::{Mesh, closest_on_triangle};
use nalgebra::{Point3, Vector3};

/// A leaf is not split further below this many triangles.
const LEAF: usize = 4;
/// Bins a split is searched in (Wald 2007, "On fast construction of SAH-based bounding volume hierarchies").
const BINS: usize = 16;
/// Deeper than this a node is split in the middle, which bounds the depth of the tree and so the stack.
const DEEP: usize = 48;
/// Room for the deepest tree: [`DEEP`] levels and 32 more of halving.
const STACK: usize = 96;

/// Where a ray meets a mesh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Distance along the ray in lengths of its direction.
    pub t: f64,
    /// Index of the triangle.
    pub triangle: usize,
    /// Weights of the triangle's three corners at the point, of sum 1.
    pub barycentric: [f64; 3],
}

/// The point of a mesh that is nearest to another.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Closest {
    /// The point on the surface.
    pub point: Point3<f64>,
    /// Its distance, in metres.
    pub distance: f64,
    /// Index of the triangle it lies on.
    pub triangle: usize,
}

/// The hierarchy. Keeps copies of the triangles it needs, not the mesh.
#[derive(Clone, Debug)]
pub struct Bvh {
    nodes: Vec<Node>,
    /// Corners of the triangles, in the order of the leaves.
    corners: Vec<[Point3<f32>; 3]>,
    /// Index in the mesh of each.
    triangles: Vec<u32>,
}

/// A box and what is in it: `count` triangles from `first`, or, where `count` is 0, two nodes, the next one
/// in the list and the one at `first`.
#[derive(Clone, Copy, Debug)]
struct Node {
    bounds: Bounds,
    first: u32,
    count: u32,
}

#[derive(Clone, Copy, Debug)]
struct Bounds {
    min: [f32; 3],
    max: [f32; 3],
}

impl Bounds {
    const EMPTY: Self = Self {
        min: [f32::INFINITY; 3],
        max: [f32::NEG_INFINITY; 3],
    };

    fn add(&mut self, p: Point3<f32>) {
        for axis in 0..3 {
            self.min[axis] = self.min[axis].min(p[axis]);
            self.max[axis] = self.max[axis].max(p[axis]);
        }
    }

    fn union(mut self, other: &Self) -> Self {
        for axis in 0..3 {
            self.min[axis] = self.min[axis].min(other.min[axis]);
            self.max[axis] = self.max[axis].max(other.max[axis]);
        }
        self
    }

    /// Half the area; 0 where empty.
    fn area(&self) -> f32 {
        let [x, y, z] = [0, 1, 2].map(|a| (self.max[a] - self.min[a]).max(0.0));
        x * y + y * z + z * x
    }

    fn distance_squared(&self, p: Point3<f64>) -> f64 {
        let outside = |a: usize| {
            (f64::from(self.min[a]) - p[a])
                .max(p[a] - f64::from(self.max[a]))
                .max(0.0)
        };
        outside(0).powi(2) + outside(1).powi(2) + outside(2).powi(2)
    }

    /// Where a ray enters, if it meets the box before `t_max`.
    fn entry(&self, ray: &Ray, t_max: f64) -> Option<f64> {
        let (mut near, mut far) = (0.0_f64, t_max);
        for a in 0..3 {
            let low = (f64::from(self.min[a]) - ray.origin[a]) * ray.inverse[a];
            let high = (f64::from(self.max[a]) - ray.origin[a]) * ray.inverse[a];
            // Not a number is 0 times infinity: the ray runs in a face of the box, which it is inside of.
            if !low.is_nan() && !high.is_nan() {
                near = low.min(high).max(near);
                far = low.max(high).min(far);
            }
        }
        // A ray in a face is met in spite of rounding.
        (near <= far * (1.0 + 1e-12)).then_some(near)
    }
}

struct Ray {
    origin: Point3<f64>,
    direction: Vector3<f64>,
    inverse: Vector3<f64>,
}

/// A triangle while the tree is built.
#[derive(Clone, Copy)]
struct Item {
    bounds: Bounds,
    center: [f32; 3],
    triangle: u32,
}

impl Bvh {
    /// Builds the hierarchy by the surface area heuristic. Triangles with a corner that is not finite are
    /// left out.
    pub fn new(mesh: &Mesh) -> Self {
        let mut items: Vec<Item> = (0..mesh.triangles.len())
            .filter_map(|t| item(mesh, t))
            .collect();
        let mut nodes = Vec::with_capacity(items.len());
        if !items.is_empty() {
            build(&mut nodes, &mut items, 0, 0);
        }
        Self {
            nodes,
            corners: items
                .iter()
                .map(|i| mesh.corners(i.triangle as usize))
                .collect(),
            triangles: items.iter().map(|i| i.triangle).collect(),
        }
    }

    /// The first triangle, of either face, that the ray from `origin` along `direction` (of any length)
    /// meets at a t of 0 to `t_max`.
    pub fn raycast(&self, origin: Point3<f64>, direction: Vector3<f64>, t_max: f64) -> Option<Hit> {
        self.trace::<false>(origin, direction, t_max)
    }

    /// Whether the ray meets anything at a t of 0 to `t_max`: cheaper than [`Self::raycast`].
    pub fn is_occluded(&self, origin: Point3<f64>, direction: Vector3<f64>, t_max: f64) -> bool {
        self.trace::<true>(origin, direction, t_max).is_some()
    }

    fn trace<const ANY: bool>(
        &self,
        origin: Point3<f64>,
        direction: Vector3<f64>,
        t_max: f64,
    ) -> Option<Hit> {
        let ray = Ray {
            origin,
            direction,
            inverse: direction.map(f64::recip),
        };
        let mut best: Option<Hit> = None;
        let mut reach = t_max;
        let mut stack = Stack::new();
        if let Some(entry) = self.nodes.first().and_then(|n| n.bounds.entry(&ray, reach)) {
            stack.push(0, entry);
        }
        while let Some((index, entry)) = stack.pop() {
            if entry > reach {
                continue;
            }
            let node = &self.nodes[index];
            if node.count == 0 {
                let children = [index + 1, node.first as usize];
                stack.push_sorted(children.map(|c| (c, self.nodes[c].bounds.entry(&ray, reach))));
                continue;
            }
            for slot in node.slots() {
                let Some((t, barycentric)) = intersect(&ray, &self.corners[slot], reach) else {
                    continue;
                };
                let triangle = self.triangles[slot] as usize;
                if best.is_none_or(|b| (t, triangle) < (b.t, b.triangle)) {
                    reach = t;
                    best = Some(Hit {
                        t,
                        triangle,
                        barycentric,
                    });
                    if ANY {
                        return best;
                    }
                }
            }
        }
        best
    }

    /// The point of the mesh nearest to `p`; `None` where the mesh has no triangle or `p` is not finite.
    pub fn closest_point(&self, p: Point3<f64>) -> Option<Closest> {
        self.closest_point_within(p, f64::INFINITY)
    }

    /// The point of the mesh nearest to `p`, if there is one no farther than `reach` metres.
    pub fn closest_point_within(&self, p: Point3<f64>, reach: f64) -> Option<Closest> {
        let mut best: Option<Closest> = None;
        let mut bound = reach * reach;
        let mut stack = Stack::new();
        if let Some(root) = self.nodes.first() {
            stack.push(0, root.bounds.distance_squared(p));
        }
        while let Some((index, squared)) = stack.pop() {
            // The way round lets no NaN of p through.
            if !matches!(squared.partial_cmp(&bound), Some(o) if o.is_le()) {
                continue;
            }
            let node = &self.nodes[index];
            if node.count == 0 {
                let children = [index + 1, node.first as usize];
                stack.push_sorted(children.map(|c| {
                    let squared = self.nodes[c].bounds.distance_squared(p);
                    (c, (squared <= bound).then_some(squared))
                }));
                continue;
            }
            for slot in node.slots() {
                let point = closest_on_triangle(p, self.corners[slot].map(|c| c.cast()));
                let squared = (point - p).norm_squared();
                let triangle = self.triangles[slot] as usize;
                let nearer = match best {
                    None => squared <= bound,
                    Some(b) => (squared, triangle) < (bound, b.triangle),
                };
                if nearer {
                    bound = squared;
                    best = Some(Closest {
                        point,
                        distance: 0.0,
                        triangle,
                    });
                }
            }
        }
        best.map(|b| Closest {
            distance: bound.sqrt(),
            ..b
        })
    }
}

impl Node {
    fn slots(&self) -> std::ops::Range<usize> {
        self.first as usize..(self.first + self.count) as usize
    }
}

/// Nodes still to be looked at, the nearest on top.
struct Stack {
    entries: [(u32, f64); STACK],
    length: usize,
}

impl Stack {
    fn new() -> Self {
        Self {
            entries: [(0, 0.0); STACK],
            length: 0,
        }
    }

    fn push(&mut self, node: usize, key: f64) {
        self.entries[self.length] = (node as u32, key);
        self.length += 1;
    }

    fn pop(&mut self) -> Option<(usize, f64)> {
        self.length = self.length.checked_sub(1)?;
        let (node, key) = self.entries[self.length];
        Some((node as usize, key))
    }

    /// Pushes two children, the nearer last; one without a key is left out.
    fn push_sorted(&mut self, [a, b]: [(usize, Option<f64>); 2]) {
        match (a, b) {
            ((a, Some(ka)), (b, Some(kb))) if ka <= kb => {
                self.push(b, kb);
                self.push(a, ka);
            }
            ((a, Some(ka)), (b, Some(kb))) => {
                self.push(a, ka);
                self.push(b, kb);
            }
            ((node, Some(key)), _) | (_, (node, Some(key))) => self.push(node, key),
            _ => {}
        }
    }
}

fn item(mesh: &Mesh, t: usize) -> Option<Item> {
    let mut bounds = Bounds::EMPTY;
    let corners = mesh.corners(t);
    for corner in corners {
        if !corner.iter().all(|c| c.is_finite()) {
            return None;
        }
        bounds.add(corner);
    }
    let center = [0, 1, 2].map(|a| (bounds.min[a] + bounds.max[a]) * 0.5);
    Some(Item {
        bounds,
        center,
        triangle: t as u32,
    })
}

/// Appends the tree over `items` (which start at `offset` in the list of all) to `nodes` and sorts them
/// into the order of its leaves.
fn build(nodes: &mut Vec<Node>, items: &mut [Item], offset: usize, depth: usize) {
    let bounds = items.iter().fold(Bounds::EMPTY, |b, i| b.union(&i.bounds));
    let at = nodes.len();
    nodes.push(Node {
        bounds,
        first: offset as u32,
        count: items.len() as u32,
    });
    if items.len() <= LEAF {
        return;
    }
    let middle = split(items, depth);
    let (left, right) = items.split_at_mut(middle);
    build(nodes, left, offset, depth + 1);
    nodes[at].first = nodes.len() as u32;
    nodes[at].count = 0;
    build(nodes, right, offset + middle, depth + 1);
}

/// Partitions `items` where the surface area heuristic says, and tells where the second part begins.
fn split(items: &mut [Item], depth: usize) -> usize {
    let half = items.len() / 2;
    let mut centers = Bounds::EMPTY;
    for i in items.iter() {
        centers.add(Point3::from(i.center));
    }
    let extent = [0, 1, 2].map(|a| centers.max[a] - centers.min[a]);
    let longest = (0..3).fold(0, |b, a| if extent[a] > extent[b] { a } else { b });
    let best = (0..3)
        .filter(|&a| extent[a] > 0.0 && depth < DEEP)
        .filter_map(|axis| best_plane(items, axis, centers.min[axis], extent[axis]))
        .min_by(|a, b| a.cost.total_cmp(&b.cost));
    let middle = best.map_or(0, |plane| partition(items, |i| plane.bin_of(i) < plane.bin));
    if middle > 0 && middle < items.len() {
        return middle;
    }
    items.select_nth_unstable_by(half, |a, b| {
        (a.center[longest].total_cmp(&b.center[longest])).then(a.triangle.cmp(&b.triangle))
    });
    half
}

/// A plane between two bins along an axis: the first bin behind it, and what it costs.
struct Plane {
    axis: usize,
    low: f32,
    bins_per_metre: f32,
    bin: usize,
    cost: f32,
}

impl Plane {
    fn bin_of(&self, item: &Item) -> usize {
        let bin = (item.center[self.axis] - self.low) * self.bins_per_metre;
        (bin as usize).min(BINS - 1)
    }
}

fn best_plane(items: &[Item], axis: usize, low: f32, extent: f32) -> Option<Plane> {
    let mut plane = Plane {
        axis,
        low,
        bins_per_metre: BINS as f32 / extent,
        bin: 0,
        cost: f32::INFINITY,
    };
    let mut bins = [(Bounds::EMPTY, 0_usize); BINS];
    for i in items {
        let bin = &mut bins[plane.bin_of(i)];
        *bin = (bin.0.union(&i.bounds), bin.1 + 1);
    }
    let mut right_costs = [0.0_f32; BINS];
    let mut right = (Bounds::EMPTY, 0);
    for k in (1..BINS).rev() {
        right = (right.0.union(&bins[k].0), right.1 + bins[k].1);
        right_costs[k] = right.0.area() * right.1 as f32;
    }
    let mut left = (Bounds::EMPTY, 0);
    for k in 1..BINS {
        left = (left.0.union(&bins[k - 1].0), left.1 + bins[k - 1].1);
        let cost = left.0.area() * left.1 as f32 + right_costs[k];
        if left.1 > 0 && left.1 < items.len() && cost < plane.cost {
            (plane.bin, plane.cost) = (k, cost);
        }
    }
    (plane.bin > 0).then_some(plane)
}

/// Moves the items of which `first` holds to the front and counts them.
fn partition(items: &mut [Item], first: impl Fn(&Item) -> bool) -> usize {
    let mut count = 0;
    for k in 0..items.len() {
        if first(&items[k]) {
            items.swap(k, count);
            count += 1;
        }
    }
    count
}

/// Möller and Trumbore 1997, with edges widened by rounding's size, so that a ray through the edge of two
/// triangles meets at least one.
#[inline]
fn intersect(ray: &Ray, corners: &[Point3<f32>; 3], t_max: f64) -> Option<(f64, [f64; 3])> {
    const WIDENED: f64 = 1e-10;
    let a: Point3<f64> = corners[0].cast();
    let ab = corners[1].cast::<f64>() - a;
    let ac = corners[2].cast::<f64>() - a;
    let p = ray.direction.cross(&ac);
    let determinant = ab.dot(&p);
    if determinant == 0.0 {
        return None;
    }
    let inverse = determinant.recip();
    let s = ray.origin - a;
    let u = s.dot(&p) * inverse;
    let q = s.cross(&ab);
    let v = ray.direction.dot(&q) * inverse;
    let t = ac.dot(&q) * inverse;
    let inside = u >= -WIDENED && v >= -WIDENED && u + v <= 1.0 + WIDENED;
    (inside && (0.0..=t_max).contains(&t)).then_some((t, [1.0 - u - v, u, v]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn soup(points: &[[f32; 3]], triangles: usize) -> Mesh {
        let n = points.len() as u32;
        Mesh {
            vertices: points.iter().map(|&p| p.into()).collect(),
            triangles: (0..triangles as u32)
                .map(|t| [t % n, (t * 7 + 1) % n, (t * 13 + 2) % n])
                .collect(),
        }
    }

    fn slow_raycast(mesh: &Mesh, origin: Point3<f64>, direction: Vector3<f64>) -> Option<f64> {
        let ray = Ray {
            origin,
            direction,
            inverse: direction.map(f64::recip),
        };
        (0..mesh.triangles.len())
            .filter_map(|t| intersect(&ray, &mesh.corners(t), 1e3).map(|(t, _)| t))
            .min_by(f64::total_cmp)
    }

    fn slow_closest(mesh: &Mesh, p: Point3<f64>) -> f64 {
        (0..mesh.triangles.len())
            .map(|t| (closest_on_triangle(p, mesh.corners(t).map(|c| c.cast())) - p).norm())
            .fold(f64::INFINITY, f64::min)
    }

    proptest! {
        #[test]
        fn the_hierarchy_agrees_with_looking_at_every_triangle(
            points in prop::collection::vec(prop::array::uniform3(-1.0..1.0f32), 3..200),
            triangles in 1..300usize,
            origin in prop::array::uniform3(-2.0..2.0f64),
            target in prop::array::uniform3(-1.0..1.0f64),
        ) {
            let mesh = soup(&points, triangles);
            let bvh = Bvh::new(&mesh);
            let origin = Point3::from(origin);
            let direction = Point3::from(target) - origin;
            let hit = bvh.raycast(origin, direction, 1e3);
            prop_assert_eq!(hit.map(|h| h.t), slow_raycast(&mesh, origin, direction));
            prop_assert_eq!(bvh.is_occluded(origin, direction, 1e3), hit.is_some());
            if let Some(h) = hit {
                let corners = mesh.corners(h.triangle).map(|c| c.cast::<f64>().coords);
                let on_triangle: Vector3<f64> =
                    (0..3).map(|k| corners[k] * h.barycentric[k]).sum();
                let on_ray = origin + direction * h.t;
                prop_assert!((on_triangle - on_ray.coords).norm() < 1e-6);
            }
            let closest = bvh.closest_point(origin).unwrap();
            prop_assert_eq!(closest.distance, slow_closest(&mesh, origin));
            prop_assert!((closest.point - origin).norm() - closest.distance < 1e-12);
            let near = bvh.closest_point_within(origin, closest.distance * 0.99);
            prop_assert!(near.is_none() || closest.distance == 0.0);
        }

        #[test]
        fn rays_along_an_axis_and_in_the_plane_of_a_face_are_met(x in 0..9u8, y in 0..9u8) {
            // A grid of 8x8 squares at z = 0, hit exactly on its vertices and edges.
            let points: Vec<_> = (0..81).map(|i| [(i % 9) as f32, (i / 9) as f32, 0.0]).collect();
            let squares = (0..64u32).map(|s| s % 8 + s / 8 * 9);
            let triangles = squares.flat_map(|c| [[c, c + 1, c + 10], [c, c + 10, c + 9]]).collect();
            let mesh = Mesh { vertices: points.iter().map(|&p| p.into()).collect(), triangles };
            let bvh = Bvh::new(&mesh);
            let from = Point3::new(f64::from(x), f64::from(y), 5.0);
            let hit = bvh.raycast(from, -Vector3::z(), 10.0);
            prop_assert_eq!(hit.map(|h| h.t), Some(5.0));
            prop_assert!(bvh.raycast(from, -Vector3::z(), 4.9).is_none());
            prop_assert!(bvh.raycast(from, Vector3::z(), 10.0).is_none());
        }
    }

    #[test]
    fn an_empty_mesh_many_equal_triangles_and_numbers_that_are_none() {
        let empty = Bvh::new(&Mesh::default());
        let o = Point3::origin();
        assert!(empty.raycast(o, Vector3::z(), 1.0).is_none());
        assert!(empty.closest_point(o).is_none());
        let mut mesh = soup(&[[0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [0.0, 1.0, 1.0]], 0);
        mesh.triangles = vec![[0, 1, 2]; 1000];
        let bvh = Bvh::new(&mesh);
        let below = Point3::new(0.2, 0.2, 0.0);
        let hit = bvh.raycast(below, Vector3::z(), 2.0).unwrap();
        assert_eq!((hit.t, hit.triangle), (1.0, 0), "the lowest index wins");
        assert_eq!(bvh.closest_point(below).unwrap().triangle, 0);
        let nowhere = Point3::new(f64::NAN, 0.0, 0.0);
        assert!(bvh.raycast(nowhere, Vector3::z(), 2.0).is_none());
        assert!(bvh.closest_point(nowhere).is_none());
        mesh.vertices[0].x = f32::NAN;
        assert!(Bvh::new(&mesh).closest_point(o).is_none());
    }
}
