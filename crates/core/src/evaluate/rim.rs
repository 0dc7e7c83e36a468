//! Finds the rims of a truth: the places where it bends outwards sharply, where silhouettes and depth images are wrong
//! first.

use super::Parameters;
use crate::mesh::{Bvh, Mesh, Side, edges, sorted_sides};
use nalgebra::Point3;

/// A smaller bend at one edge, in degrees, is ignored: rounding of thin triangles makes such bends.
const LEAST_DEGREES: f64 = 3.0;
/// A bend above this many degrees at one edge is a rim, however large its triangles.
const SHARP_DEGREES: f64 = 40.0;

/// The rims of a mesh: its convex edges that are sharp, or where the surface turns with a radius below
/// [`Parameters::rim_radius_mm`].
pub(super) struct Rims(Bvh);

impl Rims {
    /// Finds the rims of `mesh`, but not those that lie on the floor.
    pub(super) fn new(mesh: &Mesh, parameters: &Parameters) -> Self {
        let sides = sorted_sides(&mesh.triangles, mesh.vertices.len());
        let floor = (parameters.floor_mm / 1e3) as f32;
        let above = |v: u32| mesh.vertices[v as usize].z > floor;
        let rims = edges(&sides)
            .filter(|edge| above(edge[0].low) && above(edge[0].high))
            .filter(|edge| is_rim(mesh, edge, parameters.rim_radius_mm / 1e3));
        // An edge is a triangle of no width.
        let triangles = rims.map(|edge| [edge[0].low, edge[0].high, edge[0].high]);
        Self(Bvh::new(&Mesh {
            vertices: mesh.vertices.clone(),
            triangles: triangles.collect(),
        }))
    }

    /// Whether `p` is within `reach` metres of a rim.
    pub(super) fn are_near(&self, p: Point3<f64>, reach: f64) -> bool {
        self.0.closest_point_within(p, reach).is_some()
    }
}

fn is_rim(mesh: &Mesh, edge: &[Side], radius: f64) -> bool {
    let [first, second] = edge else { return false };
    let corners = |side: &Side| {
        let triangle = mesh.triangles[side.triangle as usize];
        let at = |i: usize| {
            mesh.vertices[triangle[(usize::from(side.side) + i) % 3] as usize].cast::<f64>()
        };
        [at(0), at(1), at(2)]
    };
    let [a, b, opposite] = corners(first);
    let [c, d, beyond] = corners(second);
    let (n, m) = ((b - a).cross(&(opposite - a)), (d - c).cross(&(beyond - c)));
    if n.norm() <= 0.0 || m.norm() <= 0.0 || n.dot(&(beyond - a)) >= 0.0 {
        return false;
    }
    let angle = n.angle(&m);
    // The bend is spread over half of each triangle's height over the edge.
    let width = 0.5 * (n.norm() + m.norm()) / (b - a).norm();
    angle > SHARP_DEGREES.to_radians()
        || (angle > LEAST_DEGREES.to_radians() && angle * radius > width)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::shapes;

    fn rims(mesh: &Mesh) -> Rims {
        let parameters = Parameters {
            floor_mm: -1e6,
            ..Parameters::default()
        };
        Rims::new(mesh, &parameters)
    }

    #[test]
    fn a_cube_has_rims_at_its_edges_and_not_inside_its_faces() {
        let cube = shapes::cube(0.05);
        let rims = rims(&cube);
        assert!(rims.are_near(Point3::new(0.05, 0.049, 0.01), 0.003));
        assert!(!rims.are_near(Point3::new(0.05, 0.0, 0.0), 0.003));
        let inside_out = Mesh {
            triangles: cube.triangles.iter().map(|&[a, b, c]| [a, c, b]).collect(),
            ..cube
        };
        let far = Parameters::default();
        assert!(!Rims::new(&inside_out, &far).are_near(Point3::new(0.05, 0.05, 0.01), 0.003));
    }

    #[test]
    fn what_bends_gently_has_no_rim_and_what_bends_tightly_is_one() {
        let on = |radius: f32, levels| {
            let ball = shapes::sphere(radius, levels);
            rims(&ball).are_near(ball.vertices[7].cast(), 0.001)
        };
        assert!(!on(0.03, 2) && !on(0.03, 5));
        assert!(on(0.0015, 2) && on(0.0015, 3));
    }

    #[test]
    fn edges_on_the_floor_do_not_count() {
        let mut cube = shapes::cube(0.05);
        cube.vertices.iter_mut().for_each(|v| v.z += 0.05);
        let rims = Rims::new(&cube, &Parameters::default());
        assert!(!rims.are_near(Point3::new(0.05, 0.0, 0.0), 0.003));
        assert!(rims.are_near(Point3::new(0.05, 0.0, 0.1), 0.003));
    }
}
