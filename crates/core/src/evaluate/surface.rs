//! A mesh prepared for queries: signed distances, and intersections with a line.

use crate::mesh::{Bvh, Mesh, edges, sorted_sides, vertex_normals};
use nalgebra::{Point3, Vector3};

/// A corner with less weight than this has none: the point lies on an edge or a vertex.
const ON_FEATURE: f64 = 1e-6;

/// A mesh with its hierarchy and the normals of its faces, edges and vertices.
pub(super) struct Surface<'a> {
    /// The mesh.
    pub mesh: &'a Mesh,
    bvh: Bvh,
    faces: Vec<Vector3<f64>>,
    /// For each triangle those of its sides; side i runs from corner i to corner i + 1.
    sides: Vec<[Vector3<f64>; 3]>,
    vertices: Vec<Vector3<f32>>,
}

/// The nearest point of a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Nearest {
    /// Distance in metres: positive outside, negative inside.
    pub signed_distance: f64,
    /// Where it is.
    pub point: Point3<f64>,
    /// Index of its triangle.
    pub triangle: usize,
    /// Weights of the triangle's three corners there, of sum 1.
    pub weights: [f64; 3],
}

/// What a ray meets.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Crossing {
    /// Distance in metres.
    pub distance: f64,
    /// Cosine between the ray and the outward normal: positive where the ray leaves the solid.
    pub cosine: f64,
}

impl<'a> Surface<'a> {
    /// Prepares `mesh`, whose indices must be in range.
    pub(super) fn new(mesh: &'a Mesh) -> Self {
        let face = |t| {
            let [a, b, c] = mesh.corners(t).map(|p: Point3<f32>| p.cast::<f64>());
            let normal: Vector3<f64> = (b - a).cross(&(c - a));
            normal
                .try_normalize(f64::MIN_POSITIVE)
                .unwrap_or_else(Vector3::zeros)
        };
        let faces: Vec<_> = (0..mesh.triangles.len()).map(face).collect();
        let mut sides: Vec<_> = faces.iter().map(|&normal| [normal; 3]).collect();
        for edge in edges(&sorted_sides(&mesh.triangles, mesh.vertices.len())) {
            let sum: Vector3<f64> = edge.iter().map(|s| faces[s.triangle as usize]).sum();
            for side in edge {
                sides[side.triangle as usize][usize::from(side.side)] = sum;
            }
        }
        Self {
            mesh,
            bvh: Bvh::new(mesh),
            faces,
            sides,
            vertices: vertex_normals(mesh),
        }
    }

    /// The unit outward normal of a triangle; zero where it has no area.
    pub(super) fn face_normal(&self, triangle: usize) -> Vector3<f64> {
        self.faces[triangle]
    }

    /// The nearest point to `p`. The sign is that of the angle-weighted normal of the face, edge or vertex
    /// it lies on, which is right for every closed mesh (Baerentzen and Aanaes 2005). `None` where the mesh
    /// is empty.
    pub(super) fn nearest(&self, p: Point3<f64>) -> Option<Nearest> {
        let found = self.bvh.closest_point(p)?;
        let weights = weights(
            self.mesh.corners(found.triangle).map(|c| c.cast()),
            found.point,
        );
        let outward = self.normal_at(found.triangle, weights);
        let outside = (p - found.point).dot(&outward) >= 0.0;
        Some(Nearest {
            signed_distance: if outside {
                found.distance
            } else {
                -found.distance
            },
            point: found.point,
            triangle: found.triangle,
            weights,
        })
    }

    /// The first triangle on a ray along the unit vector `direction`.
    pub(super) fn cast(&self, origin: Point3<f64>, direction: Vector3<f64>) -> Option<Crossing> {
        let hit = self.bvh.raycast(origin, direction, f64::INFINITY)?;
        Some(Crossing {
            distance: hit.t,
            cosine: self.faces[hit.triangle].dot(&direction),
        })
    }

    fn normal_at(&self, triangle: usize, weights: [f64; 3]) -> Vector3<f64> {
        let present = weights.map(|w| w > ON_FEATURE);
        match present {
            [true, true, true] => self.faces[triangle],
            [true, true, false] => self.sides[triangle][0],
            [false, true, true] => self.sides[triangle][1],
            [true, false, true] => self.sides[triangle][2],
            _ => {
                let corner = present.iter().position(|&p| p).unwrap_or(0);
                let vertex = self.mesh.triangles[triangle][corner];
                self.vertices[vertex as usize].cast()
            }
        }
    }
}

/// The weights of a triangle's corners at a point that lies on it.
fn weights([a, b, c]: [Point3<f64>; 3], p: Point3<f64>) -> [f64; 3] {
    let normal = (b - a).cross(&(c - a));
    let square = normal.norm_squared();
    if square <= 0.0 {
        return [1.0, 0.0, 0.0];
    }
    let part = |from: Point3<f64>, to: Point3<f64>| {
        ((from - p).cross(&(to - p)).dot(&normal) / square).clamp(0.0, 1.0)
    };
    let weights = [part(b, c), part(c, a), part(a, b)];
    let sum: f64 = weights.iter().sum();
    weights.map(|w| w / sum)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::shapes;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_sign_tells_inside_from_outside(p in prop::array::uniform3(-2.0..2.0_f64)) {
            // A cube's signed distance is known; its corners and edges are where naive signs fail.
            let cube = shapes::cube(1.0);
            let nearest = Surface::new(&cube).nearest(Point3::from(p)).unwrap();
            let beyond = Vector3::from(p).abs() - Vector3::repeat(1.0);
            let wanted = beyond.map(|c| c.max(0.0)).norm() + beyond.max().min(0.0);
            prop_assert!((nearest.signed_distance - wanted).abs() < 1e-9);
        }
    }

    #[test]
    fn rays_tell_entering_from_leaving() {
        let cube = shapes::cube(1.0);
        let surface = Surface::new(&cube);
        let entering = surface
            .cast(Point3::new(0.1, 0.2, 5.0), -Vector3::z())
            .unwrap();
        assert_eq!((entering.distance, entering.cosine), (4.0, -1.0));
        let leaving = surface
            .cast(Point3::new(0.1, 0.2, 0.0), -Vector3::z())
            .unwrap();
        assert_eq!((leaving.distance, leaving.cosine), (1.0, 1.0));
        assert_eq!(surface.cast(Point3::new(0.1, 0.2, 5.0), Vector3::z()), None);
    }
}
