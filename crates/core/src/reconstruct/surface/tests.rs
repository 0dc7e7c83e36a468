//! Tests solids whose surface is known.

use super::*;
use std::collections::BTreeMap;

/// Any function; every cube may be crossed by its surface.
struct Function<F>(F);

impl<F: Fn(Point3<f64>) -> f64 + Sync> Solid for Function<F> {
    fn side(&self, _: Point3<f64>, _: f64, undecided: UndecidedConstraints) -> Side {
        Side::Across(undecided)
    }

    fn value(&self, p: Point3<f64>, _: UndecidedConstraints) -> f32 {
        // In units of a thousandth, so that the root's tolerance is small against a cell.
        (1e3 * self.0(p)) as f32
    }

    fn normal(&self, p: Point3<f64>, _: UndecidedConstraints) -> (Vector3<f32>, Constraint) {
        let slope = |axis: usize| {
            let mut h = Vector3::zeros();
            h[axis] = 1e-5;
            self.0(p - h) - self.0(p + h)
        };
        (
            Vector3::new(slope(0), slope(1), slope(2))
                .normalize()
                .cast(),
            0,
        )
    }
}

fn unit_lattice(cells: u32) -> Lattice {
    Lattice::covering(
        Point3::new(-1.0, -1.0, -1.0),
        Point3::new(1.0, 1.0, 1.0),
        2.0 / f64::from(cells),
    )
}

/// Each edge is used once in either direction, and the triangles around each vertex form one fan.
fn assert_manifold(mesh: &Mesh) {
    let mut next = BTreeMap::new();
    for t in &mesh.triangles {
        for i in 0..3 {
            let edge = (t[i], t[(i + 1) % 3]);
            assert!(
                next.insert(edge, t[(i + 2) % 3]).is_none(),
                "edge {edge:?} used twice"
            );
        }
    }
    let mut valence = vec![0; mesh.vertices.len()];
    let mut start = vec![u32::MAX; mesh.vertices.len()];
    for &(a, b) in next.keys() {
        assert!(next.contains_key(&(b, a)), "edge {a} {b} is open");
        valence[a as usize] += 1;
        start[a as usize] = b;
    }
    for v in 0..mesh.vertices.len() as u32 {
        let (first, mut around, mut steps) = (start[v as usize], start[v as usize], 0);
        while steps == 0 || around != first {
            around = next[&(v, around)];
            steps += 1;
        }
        assert_eq!(
            steps, valence[v as usize],
            "vertex {v} has more than one fan"
        );
    }
}

fn volume(mesh: &Mesh) -> f64 {
    let corners =
        (0..mesh.triangles.len()).map(|t| mesh.corners(t).map(|p| p.coords.cast::<f64>()));
    corners.map(|[a, b, c]| a.dot(&b.cross(&c)) / 6.0).sum()
}

#[test]
fn a_ball_is_round_and_turned_outwards() {
    let ball = Function(|p: Point3<f64>| 0.7 - p.coords.norm());
    let (surface, _) = extract(&ball, &unit_lattice(40), usize::MAX).unwrap();
    assert_manifold(&surface.mesh);
    let worst = surface
        .mesh
        .vertices
        .iter()
        .map(|v| (v.coords.norm() - 0.7).abs())
        .fold(0.0, f32::max);
    assert!(worst < 2e-3, "{worst}");
    let expected = 4.0 / 3.0 * std::f64::consts::PI * 0.7f64.powi(3);
    assert!((volume(&surface.mesh) / expected - 1.0).abs() < 3e-3);
}

#[test]
fn a_box_keeps_its_edges_and_corners() {
    let half = Vector3::new(0.61, 0.43, 0.37);
    let cuboid = Function(move |p: Point3<f64>| (half - p.coords.abs()).min());
    let (surface, _) = extract(&cuboid, &unit_lattice(32), usize::MAX).unwrap();
    assert_manifold(&surface.mesh);
    let expected = 8.0 * half.x * half.y * half.z;
    assert!(
        (volume(&surface.mesh) / expected - 1.0).abs() < 5e-3,
        "{}",
        volume(&surface.mesh)
    );
    let corner = Point3::from(half.cast::<f32>());
    let nearest = surface
        .mesh
        .vertices
        .iter()
        .map(|v| (v - corner).norm())
        .fold(1.0, f32::min);
    assert!(nearest < 6e-3, "{nearest}");
}

#[test]
fn noise_at_the_scale_of_a_cell_is_still_manifold() {
    for seed in 0..12u32 {
        // Random values on the lattice itself: every cell configuration and ambiguous face turns up.
        let noise = Function(move |p: Point3<f64>| {
            let inside = p.coords.abs().max() < 0.8;
            let q = (p.coords * 97.0).map(|v| v.round() as i64 as u32);
            let mut h =
                q.x ^ q.y.rotate_left(11) ^ q.z.rotate_left(22) ^ seed.wrapping_mul(0x9e37_79b9);
            for _ in 0..3 {
                h = (h ^ h >> 15).wrapping_mul(0x2c1b_3c6d);
            }
            if inside {
                f64::from(h >> 16) / 32768.0 - 1.0
            } else {
                -1.0
            }
        });
        let (surface, _) = extract(&noise, &unit_lattice(24), usize::MAX).unwrap();
        assert!(surface.mesh.triangles.len() > 1000);
        assert_manifold(&surface.mesh);
    }
}

#[test]
fn an_empty_solid_has_no_surface() {
    let (surface, _) = extract(&Function(|_| -1.0), &unit_lattice(8), usize::MAX).unwrap();
    assert!(surface.mesh.vertices.is_empty() && surface.mesh.triangles.is_empty());
}

#[test]
fn what_changes_in_places_is_extracted_as_if_from_nothing() {
    let ball = |p: Point3<f64>| 0.7 - p.coords.norm();
    let dent = Vector3::new(0.5, 0.3, 0.2);
    let dented = move |p: Point3<f64>| ball(p).min((p.coords - dent).norm() - 0.3);
    let may_differ = |p: Point3<f64>, half: f64| (p.coords - dent).norm() < 0.3 + 2.0 * half;
    let lattice = unit_lattice(40);
    let (_, before) = extract(&Function(ball), &lattice, usize::MAX).unwrap();
    let (changed, _) = extract_changed(&Function(dented), &lattice, &before, may_differ);
    let (anew, _) = extract(&Function(dented), &lattice, usize::MAX).unwrap();
    assert_eq!(changed.mesh.triangles, anew.mesh.triangles);
    for (a, b) in changed.mesh.vertices.iter().zip(&anew.mesh.vertices) {
        assert!((a - b).norm() < 2e-3, "{a} {b}");
    }
    assert_manifold(&changed.mesh);
}
