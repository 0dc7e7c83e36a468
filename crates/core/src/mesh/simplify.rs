//! Reduces the vertices of a mesh, which stays the surface of a solid: edges collapse in the order of their quadric
//! error (Garland and Heckbert 1997). The half-edges and the link condition are `alum`'s; the cost of a collapse, and
//! which ones are refused, is decided here. An edge collapses onto one of its ends, because then every vertex that is
//! left is an original one, with all its attributes, and because `alum` updates the neighbours of a vertex that
//! vanishes, not those of one that moves.

use super::{Mesh, Report, check};
use alum::{
    DVec3, Decimater, HH, Handle, HasDecimation, HasIterators, HasTopology, PolyMeshF64, VH,
};
use nalgebra::{Matrix3, Point3, Vector3};

/// A collapse may not turn a triangle farther than this: the cosine of 78°.
const LEAST_COSINE: f64 = 0.2;
/// Nor leave a triangle thinner than this, unless it is no thinner than the one before: area over the square
/// of the longest side (an equilateral one has 0.43).
const LEAST_SHAPE: f64 = 0.02;
/// What an edge's own length adds to its cost, so that flat places lose short edges first.
const LENGTH_WEIGHT: f64 = 1e-4;

/// A mesh with fewer vertices.
#[derive(Clone, Debug, PartialEq)]
pub struct Simplified {
    /// Closed, oriented and manifold, as the mesh was.
    pub mesh: Mesh,
    /// For each vertex the one of the old mesh that it is, in ascending order: what was known of that holds.
    pub sources: Vec<u32>,
}

/// Why a mesh cannot be simplified.
#[derive(Debug, thiserror::Error)]
pub enum SimplifyError {
    /// Only the surface of a solid can be kept one.
    #[error(
        "only a watertight mesh can be simplified; this one has {} boundary edges, {} misoriented and {} \
         non-manifold edges and {} non-manifold vertices",
        .0.boundary_edges, .0.misoriented_edges, .0.non_manifold_edges, .0.non_manifold_vertices
    )]
    NotWatertight(Box<Report>),
    /// The library gave up.
    #[error("simplification failed: {0}")]
    Library(String),
    /// What came out is not watertight: a defect of this program.
    #[error("simplification to {vertices} vertices broke the mesh")]
    Broken {
        /// Vertices that were left.
        vertices: usize,
    },
}

/// Collapses edges of a watertight mesh until `target_vertices` are left, or no edge can collapse without
/// folding the surface or closing a handle: there may be more than asked for, also where so few would enclose no
/// volume. A mesh that has no more than that already stays as it is.
///
/// # Errors
/// Where the mesh is not watertight.
pub fn simplify(mesh: &Mesh, target_vertices: usize) -> Result<Simplified, SimplifyError> {
    let report = check(mesh);
    if !report.is_watertight() {
        return Err(SimplifyError::NotWatertight(Box::new(report)));
    }
    let mut target = target_vertices;
    loop {
        let simplified =
            collapse(mesh, target).map_err(|error| SimplifyError::Library(format!("{error:?}")))?;
        let after = check(&simplified.mesh);
        if !after.is_watertight() || after.genus != report.genus {
            return Err(SimplifyError::Broken {
                vertices: after.vertices,
            });
        }
        // No triangle turns far in one collapse, but many small turns can leave a few triangles inside out.
        let is_inside_out = report.volume > 0.0 && after.volume <= 0.0;
        if !is_inside_out || target >= report.vertices {
            return Ok(simplified);
        }
        target = 2 * target.max(after.vertices);
    }
}

fn collapse(mesh: &Mesh, target_vertices: usize) -> Result<Simplified, alum::Error> {
    let mut half_edges = PolyMeshF64::with_capacity(
        mesh.vertices.len(),
        mesh.triangles.len() * 3 / 2,
        mesh.triangles.len(),
    );
    // The collapses work on positions of our own.
    half_edges.add_vertices(&vec![DVec3(0.0, 0.0, 0.0); mesh.vertices.len()])?;
    for triangle in &mesh.triangles {
        half_edges.add_face(&triangle.map(VH::from))?;
    }
    // Vertices of no triangle do not count and are not kept.
    let unused = mesh.vertices.len() - check_used(mesh);
    half_edges.decimate_to_vertex_count(&mut Costs::new(mesh), target_vertices + unused)?;
    let deleted = half_edges.face_status_prop();
    let deleted = deleted.try_borrow()?;
    let triangles: Vec<[u32; 3]> = half_edges
        .triangulated_vertices(&deleted)
        .map(|t| from_lowest(t.map(|v| v.index())))
        .collect();
    Ok(compact(mesh, triangles))
}

fn check_used(mesh: &Mesh) -> usize {
    let mut used = vec![false; mesh.vertices.len()];
    mesh.triangles
        .iter()
        .flatten()
        .for_each(|&v| used[v as usize] = true);
    used.iter().filter(|&&u| u).count()
}

/// The same triangle, begun with its lowest vertex.
fn from_lowest(mut triangle: [u32; 3]) -> [u32; 3] {
    while triangle[0] > triangle[1] || triangle[0] > triangle[2] {
        triangle.rotate_left(1);
    }
    triangle
}

fn compact(mesh: &Mesh, triangles: Vec<[u32; 3]>) -> Simplified {
    let mut sources: Vec<u32> = triangles.iter().flatten().copied().collect();
    sources.sort_unstable();
    sources.dedup();
    let index = |v: u32| sources.partition_point(|&s| s < v) as u32;
    Simplified {
        mesh: Mesh {
            vertices: sources.iter().map(|&v| mesh.vertices[v as usize]).collect(),
            triangles: triangles.into_iter().map(|t| t.map(index)).collect(),
        },
        sources,
    }
}

/// The sum of squared distances to planes, weighted by the area of the triangles they come from:
/// xᵀ A x + 2 bᵀ x + c (Garland and Heckbert 1997, section 5).
#[derive(Clone, Copy, Default)]
struct Quadric {
    a: Matrix3<f64>,
    b: Vector3<f64>,
    c: f64,
}

impl Quadric {
    fn of([p, q, r]: [Point3<f64>; 3]) -> Self {
        let cross: Vector3<f64> = (q - p).cross(&(r - p));
        let Some(normal) = cross.try_normalize(f64::MIN_POSITIVE) else {
            return Self::default();
        };
        let (area, offset) = (cross.norm() / 2.0, -normal.dot(&p.coords));
        Self {
            a: normal * normal.transpose() * area,
            b: normal * (offset * area),
            c: offset * offset * area,
        }
    }

    fn add(&mut self, other: &Self) {
        self.a += other.a;
        self.b += other.b;
        self.c += other.c;
    }

    fn at(&self, p: Point3<f64>) -> f64 {
        (p.coords.dot(&(self.a * p.coords)) + 2.0 * self.b.dot(&p.coords) + self.c).max(0.0)
    }
}

struct Costs {
    positions: Vec<Point3<f64>>,
    quadrics: Vec<Quadric>,
}

impl Costs {
    fn new(mesh: &Mesh) -> Self {
        // Quadrics cancel badly far from the origin.
        let origin = mesh.vertices[0].coords.cast::<f64>();
        let positions: Vec<_> = mesh
            .vertices
            .iter()
            .map(|v| v.cast::<f64>() - origin)
            .collect();
        let mut quadrics = vec![Quadric::default(); positions.len()];
        for triangle in &mesh.triangles {
            let quadric = Quadric::of(triangle.map(|v| positions[v as usize]));
            for &v in triangle {
                quadrics[v as usize].add(&quadric);
            }
        }
        Self {
            positions,
            quadrics,
        }
    }

    fn position(&self, v: VH) -> Point3<f64> {
        self.positions[v.index() as usize]
    }

    /// Whether every triangle that keeps its place when `from` becomes `to` still faces as it did and is not
    /// a sliver.
    fn keeps_shape(&self, mesh: &PolyMeshF64, from: VH, to: VH) -> bool {
        let (old, new) = (self.position(from), self.position(to));
        mesh.voh_ccw_iter(from).all(|h| {
            // The triangle on this half-edge's left: from, a, b.
            let (a, b) = (h.head(mesh), h.next(mesh).head(mesh));
            if a == to || b == to {
                return true;
            }
            let (a, b) = (self.position(a), self.position(b));
            let (before, after) = ((a - old).cross(&(b - old)), (a - new).cross(&(b - new)));
            before.dot(&after) > LEAST_COSINE * before.norm() * after.norm()
                && shape(new, a, b) > LEAST_SHAPE.min(shape(old, a, b))
        })
    }
}

/// A triangle's area over the square of its longest side.
fn shape(p: Point3<f64>, q: Point3<f64>, r: Point3<f64>) -> f64 {
    let longest = (q - p)
        .norm_squared()
        .max((r - q).norm_squared())
        .max((p - r).norm_squared());
    (q - p).cross(&(r - p)).norm() / 2.0 / longest.max(f64::MIN_POSITIVE)
}

impl Decimater<PolyMeshF64> for Costs {
    type Cost = f64;

    fn collapse_cost(&self, mesh: &PolyMeshF64, h: HH) -> Option<f64> {
        let (from, to) = (h.tail(mesh), h.head(mesh));
        let mut quadric = self.quadrics[from.index() as usize];
        quadric.add(&self.quadrics[to.index() as usize]);
        let at = self.position(to);
        let length = (at - self.position(from)).norm_squared();
        let cost = quadric.at(at) + LENGTH_WEIGHT * length * length;
        self.keeps_shape(mesh, from, to).then_some(cost)
    }

    fn before_collapse(&mut self, mesh: &PolyMeshF64, h: HH) -> Result<(), alum::Error> {
        let (from, to) = (h.tail(mesh).index() as usize, h.head(mesh).index() as usize);
        let gone = self.quadrics[from];
        self.quadrics[to].add(&gone);
        Ok(())
    }

    fn after_collapse(&mut self, _: &PolyMeshF64, _: VH) -> Result<(), alum::Error> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::{Bvh, shapes};
    use proptest::prelude::*;

    #[test]
    fn a_torus_stays_one_and_near_where_it_was() {
        let torus = shapes::torus(0.05, 0.02, 240, 120);
        let (before, simplified) = (check(&torus), simplify(&torus, 4000).unwrap());
        let after = check(&simplified.mesh);
        assert_eq!((after.vertices, after.genus), (4000, Some(1)));
        assert!((after.volume / before.volume - 1.0).abs() < 0.003);
        let bvh = Bvh::new(&simplified.mesh);
        for v in &torus.vertices {
            let distance = bvh.closest_point(v.cast()).unwrap().distance;
            assert!(distance < 0.2e-3, "{distance}");
        }
        for (v, &source) in simplified.mesh.vertices.iter().zip(&simplified.sources) {
            assert_eq!(*v, torus.vertices[source as usize]);
        }
    }

    #[test]
    fn flat_faces_cost_nothing_and_edges_stay() {
        let mut cube = shapes::cube(0.5);
        let mut finer = Mesh::default();
        for _ in 0..4 {
            finer = shapes::subdivided(&cube);
            cube = finer.clone();
        }
        let simplified = simplify(&finer, 8).unwrap();
        let report = check(&simplified.mesh);
        assert_eq!(report.vertices, 8);
        assert!((report.volume - 1.0).abs() < 1e-6, "{}", report.volume);
    }

    #[test]
    fn what_cannot_be_reached_is_approached_and_what_is_there_stays() {
        let torus = shapes::torus(1.0, 0.3, 24, 12);
        let least = simplify(&torus, 0).unwrap();
        assert_eq!(check(&least.mesh).genus, Some(1));
        let same = simplify(&torus, 1000).unwrap();
        assert_eq!(same.sources.len(), 288);
        assert_eq!(check(&same.mesh).volume, check(&torus).volume);
    }

    #[test]
    fn an_open_mesh_is_refused_with_its_defects() {
        let mut open = shapes::cube(1.0);
        open.triangles.pop();
        let error = simplify(&open, 5).unwrap_err().to_string();
        assert!(error.contains("3 boundary edges"), "{error}");
        assert!(simplify(&Mesh::default(), 5).is_err());
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn any_bumpy_solid_stays_a_solid_to_any_size(
            bumps in prop::collection::vec(0.6_f32..1.4, 162), target in 4_usize..162,
        ) {
            let mut ball = shapes::sphere(1.0, 2);
            for (v, bump) in ball.vertices.iter_mut().zip(bumps) {
                *v *= bump;
            }
            let simplified = simplify(&ball, target).unwrap();
            prop_assert!(simplified.mesh.vertices.len() >= target);
            prop_assert!(check(&simplified.mesh).volume > 0.0);
            prop_assert_eq!(simplify(&ball, target).unwrap(), simplified);
        }
    }
}
