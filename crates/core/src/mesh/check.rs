//! Checks a mesh: whether it is closed, oriented and manifold, and how many pieces and handles it has. It repairs
//! nothing.

use super::components::{Components, Forest, components};
use super::edges::{Side, edges, is_sound, sorted_sides};
use super::{Mesh, measure};

/// What was found in a mesh. Triangles that name a vertex twice or one that does not exist are counted and
/// otherwise left out.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub struct Report {
    /// Vertices, used or not.
    pub vertices: usize,
    /// Triangles, sound or not.
    pub triangles: usize,
    /// Edges of only one triangle: the borders of holes.
    pub boundary_edges: usize,
    /// Edges of more than two triangles.
    pub non_manifold_edges: usize,
    /// Edges whose triangles do not run along it in turn: as often one way as the other.
    pub misoriented_edges: usize,
    /// Vertices where more than one fan of triangles meets, as in a bow tie.
    pub non_manifold_vertices: usize,
    /// Triangles with an index that names no vertex.
    pub out_of_range_triangles: usize,
    /// Triangles of no area, or that name a vertex twice.
    pub degenerate_triangles: usize,
    /// Triangles over the same three vertices as an earlier one, whichever way they turn.
    pub duplicate_triangles: usize,
    /// Vertices with a coordinate that is not finite.
    pub non_finite_vertices: usize,
    /// Vertices of no triangle.
    pub unused_vertices: usize,
    /// Connected pieces.
    pub components: usize,
    /// Handles, summed over the pieces; `None` unless the mesh is watertight.
    pub genus: Option<u64>,
    /// Signed volume in cubic metres.
    pub volume: f64,
    /// Area in square metres.
    pub area: f64,
}

impl Report {
    /// No edge has only one triangle.
    pub fn is_closed(&self) -> bool {
        self.boundary_edges == 0
    }

    /// Neighbouring triangles turn the same way.
    pub fn is_oriented(&self) -> bool {
        self.misoriented_edges == 0
    }

    /// At each edge two triangles or one, at each vertex one fan.
    pub fn is_manifold(&self) -> bool {
        self.non_manifold_edges == 0 && self.non_manifold_vertices == 0
    }

    /// Closed, oriented, manifold at edges and vertices, and not empty: the surface of a solid, as far as
    /// connectivity can tell (it may still cut through itself).
    pub fn is_watertight(&self) -> bool {
        self.triangles > self.out_of_range_triangles
            && self.out_of_range_triangles == 0
            && self.non_finite_vertices == 0
            && self.is_closed()
            && self.is_oriented()
            && self.is_manifold()
    }
}

/// Examines `mesh` in linear time. Whatever it holds, the answer is an answer and not a panic.
pub fn check(mesh: &Mesh) -> Report {
    let found = components(mesh);
    let (volume, area) = measure::volume_and_total_area(mesh);
    let mut report = Report {
        components: found.parts.len(),
        degenerate_triangles: count(&mesh.triangles, |t| is_degenerate(mesh, t)),
        duplicate_triangles: count_duplicates(mesh),
        unused_vertices: count(&found.labels, |&label| label == Components::NONE),
        volume,
        area,
        ..connectivity(mesh)
    };
    if report.is_watertight() {
        report.genus = Some(found.parts.iter().map(|p| p.genus().max(0) as u64).sum());
    }
    report
}

/// What [`Report::is_watertight`] says of `mesh`, without the rest of [`check`].
pub fn is_watertight(mesh: &Mesh) -> bool {
    connectivity(mesh).is_watertight()
}

/// What [`Report::is_closed`] says of `mesh`, without the rest of [`check`].
pub fn is_closed(mesh: &Mesh) -> bool {
    let sides = sorted_sides(&mesh.triangles, mesh.vertices.len());
    edges(&sides).all(|edge| edge.len() > 1)
}

/// What decides whether a mesh is watertight; the rest is empty.
fn connectivity(mesh: &Mesh) -> Report {
    let sides = sorted_sides(&mesh.triangles, mesh.vertices.len());
    let mut report = Report {
        vertices: mesh.vertices.len(),
        triangles: mesh.triangles.len(),
        non_manifold_vertices: count_non_manifold_vertices(mesh, &sides),
        out_of_range_triangles: count(&mesh.triangles, |t| is_out_of_range(mesh, t)),
        non_finite_vertices: count(&mesh.vertices, |v| !v.coords.iter().all(|c| c.is_finite())),
        ..Report::default()
    };
    count_bad_edges(&sides, &mut report);
    report
}

fn count<T>(items: &[T], is: impl Fn(&T) -> bool) -> usize {
    items.iter().filter(|item| is(item)).count()
}

fn is_out_of_range(mesh: &Mesh, triangle: &[u32; 3]) -> bool {
    triangle.iter().any(|&v| v as usize >= mesh.vertices.len())
}

fn is_degenerate(mesh: &Mesh, triangle: &[u32; 3]) -> bool {
    !is_out_of_range(mesh, triangle) && measure::volume_and_area(mesh, triangle).1 == 0.0
}

fn count_bad_edges(sides: &[Side], report: &mut Report) {
    for edge in edges(sides) {
        let forward = count(edge, |side| side.forward);
        match edge.len() {
            1 => report.boundary_edges += 1,
            2 => {}
            _ => report.non_manifold_edges += 1,
        }
        if edge.len() > 1 && 2 * forward != edge.len() {
            report.misoriented_edges += 1;
        }
    }
}

/// Joins the corners of triangles across each edge; the corners of a vertex then form its fans.
fn count_non_manifold_vertices(mesh: &Mesh, sides: &[Side]) -> usize {
    let mut corners = Forest::new(3 * mesh.triangles.len());
    for edge in edges(sides) {
        for pair in edge.windows(2) {
            let ([a, b], [c, d]) = (corners_of(&pair[0]), corners_of(&pair[1]));
            corners.join(a, c);
            corners.join(b, d);
        }
    }
    let mut fans = vec![0_u32; mesh.vertices.len()];
    for (index, triangle) in mesh.triangles.iter().enumerate() {
        if !is_sound(triangle, mesh.vertices.len()) {
            continue;
        }
        for (i, &v) in triangle.iter().enumerate() {
            let corner = (3 * index + i) as u32;
            fans[v as usize] += u32::from(corners.root(corner) == corner);
        }
    }
    count(&fans, |&n| n > 1)
}

/// The corners at the lower and the higher end of a side.
fn corners_of(side: &Side) -> [u32; 2] {
    let first = 3 * side.triangle + u32::from(side.side);
    let second = 3 * side.triangle + u32::from((side.side + 1) % 3);
    if side.forward {
        [first, second]
    } else {
        [second, first]
    }
}

fn count_duplicates(mesh: &Mesh) -> usize {
    let mut keys: Vec<_> = mesh.triangles.clone();
    keys.iter_mut().for_each(|t| t.sort_unstable());
    keys.sort_unstable();
    keys.windows(2).filter(|pair| pair[0] == pair[1]).count()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::shapes;
    use proptest::prelude::*;

    #[test]
    fn sound_solids_pass() {
        for (mesh, genus) in [
            (shapes::tetrahedron(1.0), 0),
            (shapes::cube(1.0), 0),
            (shapes::sphere(1.0, 2), 0),
            (shapes::torus(1.0, 0.3, 20, 10), 1),
        ] {
            let report = check(&mesh);
            assert!(report.is_watertight(), "{report:?}");
            assert!(is_watertight(&mesh) && is_closed(&mesh));
            assert_eq!(report.genus, Some(genus));
            assert_eq!(report.components, 1);
            assert_eq!(report.degenerate_triangles, 0);
            assert!(report.volume > 0.0);
        }
        let cube = check(&shapes::cube(0.5));
        assert!((cube.volume - 1.0).abs() < 1e-12);
        assert!((cube.area - 6.0).abs() < 1e-12);
    }

    #[test]
    fn volume_does_not_suffer_far_from_the_origin() {
        let mut cube = shapes::cube(0.5);
        cube.vertices.iter_mut().for_each(|v| v.x += 4096.0);
        assert!((check(&cube).volume - 1.0).abs() < 1e-9);
    }

    #[test]
    fn a_hole_is_a_boundary() {
        let mut mesh = shapes::cube(1.0);
        mesh.triangles.pop();
        let report = check(&mesh);
        assert_eq!(report.boundary_edges, 3);
        assert!(!report.is_closed() && !report.is_watertight());
        assert!(!is_closed(&mesh) && !is_watertight(&mesh));
        assert!(report.is_oriented() && report.is_manifold());
        assert_eq!(report.genus, None);
    }

    #[test]
    fn a_flipped_face_is_misoriented() {
        let mut mesh = shapes::cube(1.0);
        mesh.triangles[3].swap(0, 1);
        let report = check(&mesh);
        assert_eq!(report.misoriented_edges, 3);
        assert!(report.is_closed() && !report.is_oriented() && !report.is_watertight());
    }

    #[test]
    fn a_bow_tie_vertex_is_not_manifold() {
        let mut mesh = shapes::tetrahedron(1.0);
        shapes::append(&mut mesh, &shapes::tetrahedron(2.0));
        mesh.triangles[4..]
            .iter_mut()
            .flatten()
            .filter(|v| **v == 4)
            .for_each(|v| *v = 0);
        let report = check(&mesh);
        assert_eq!(report.non_manifold_vertices, 1);
        assert_eq!(report.non_manifold_edges, 0);
        assert_eq!(report.components, 1);
        assert_eq!(report.unused_vertices, 1);
        assert!(!report.is_watertight());
    }

    #[test]
    fn two_solids_that_share_an_edge_are_not_manifold() {
        let mut mesh = shapes::tetrahedron(1.0);
        shapes::append(&mut mesh, &shapes::tetrahedron(2.0));
        for v in mesh.triangles[4..].iter_mut().flatten() {
            *v = if *v < 6 { *v - 4 } else { *v };
        }
        let report = check(&mesh);
        assert_eq!(report.non_manifold_edges, 1);
        assert!(report.is_closed() && report.is_oriented() && !report.is_manifold());
    }

    #[test]
    fn broken_and_duplicate_triangles_are_counted() {
        let mut mesh = shapes::tetrahedron(1.0);
        mesh.triangles.extend([[0, 1, 99], [2, 2, 1], [1, 2, 0]]);
        mesh.vertices.push([f32::NAN, 0.0, 0.0].into());
        let report = check(&mesh);
        assert_eq!(report.out_of_range_triangles, 1);
        assert_eq!(report.degenerate_triangles, 1);
        assert_eq!(report.duplicate_triangles, 1);
        assert_eq!(report.non_finite_vertices, 1);
        assert!(!report.is_watertight());
        assert!(!check(&Mesh::default()).is_watertight());
    }

    #[test]
    fn two_solids_are_two_components() {
        let mut mesh = shapes::cube(1.0);
        shapes::append(&mut mesh, &shapes::torus(3.0, 0.5, 16, 8));
        let report = check(&mesh);
        assert!(report.is_watertight());
        assert_eq!((report.components, report.genus), (2, Some(1)));
    }

    proptest! {
        #[test]
        fn any_triangles_are_examined_without_a_panic(
            triangles in prop::collection::vec(prop::array::uniform3(0_u32..9), 0..40),
        ) {
            let vertices = (0..7).map(|i| [i as f32, (i * i) as f32, 1.0].into()).collect();
            let report = check(&Mesh { vertices, triangles: triangles.clone() });
            prop_assert_eq!(report.triangles, triangles.len());
            let sound: Vec<_> = triangles.iter().filter(|t| is_sound(t, 7)).collect();
            let sides = 3 * sound.len();
            prop_assert!(report.boundary_edges + 3 * report.non_manifold_edges <= sides);
        }

        #[test]
        fn the_report_does_not_depend_on_the_order_of_triangles(seed in 0_usize..1000) {
            let mut mesh = shapes::torus(1.0, 0.4, 8, 6);
            let before = check(&mesh);
            mesh.triangles.rotate_left(seed % 96);
            mesh.triangles.iter_mut().for_each(|t| t.rotate_left(seed % 3));
            let after = check(&mesh);
            prop_assert_eq!(after.genus, before.genus);
            prop_assert!((after.volume - before.volume).abs() < 1e-12);
            prop_assert!(after.is_watertight());
        }
    }
}
