//! Meshes of surfaces of revolution: rings of as many vertices as their circumference needs, zipped together.

use super::profiles::Profile;
use nalgebra::Point3;
use scand_core::mesh::Mesh;
use std::f64::consts::TAU;

/// Turning by more than this (a cosine) between segments, a point of the profile is a corner and is kept.
const CORNER: f64 = 0.94;

/// A ring of vertices around the axis, or a single one on it.
pub(super) struct Ring {
    pub(super) first: u32,
    pub(super) count: u32,
}

/// The mesh of the solid that `profile` sweeps around z, with edges of about `spacing` metres.
pub(super) fn revolve(profile: &Profile, spacing: f64) -> Mesh {
    let mut mesh = Mesh::default();
    let points = resampled(profile, spacing);
    let rings: Vec<Ring> = points
        .iter()
        .map(|&point| ring(&mut mesh, point, spacing))
        .collect();
    for pair in rings.windows(2) {
        zip(&mut mesh.triangles, &pair[0], &pair[1]);
    }
    if profile.is_loop {
        zip(&mut mesh.triangles, &rings[rings.len() - 1], &rings[0]);
    }
    mesh
}

fn ring(mesh: &mut Mesh, [r, z]: [f64; 2], spacing: f64) -> Ring {
    let first = mesh.vertices.len() as u32;
    let count = match r == 0.0 {
        true => 1,
        false => (TAU * r / spacing).ceil().max(6.0) as u32,
    };
    for k in 0..count {
        let angle = TAU * f64::from(k) / f64::from(count);
        let p = Point3::new(r * angle.cos(), r * angle.sin(), z);
        mesh.vertices.push(p.cast());
    }
    Ring { first, count }
}

/// Fills the strip between two rings, `a` before `b` on the profile, walking both around by their shares.
pub(super) fn zip(triangles: &mut Vec<[u32; 3]>, a: &Ring, b: &Ring) {
    let sides = |ring: &Ring| if ring.count == 1 { 0 } else { ring.count };
    let (na, nb) = (sides(a), sides(b));
    let vertex = |ring: &Ring, k: u32| ring.first + k % ring.count;
    let (mut i, mut j) = (0, 0);
    while i < na || j < nb {
        // The one whose next vertex comes first: (i + 1) / na against (j + 1) / nb, without rounding.
        let next_of_a = u64::from(i + 1) * u64::from(nb);
        let next_of_b = u64::from(j + 1) * u64::from(na);
        if j == nb || (i < na && next_of_a <= next_of_b) {
            triangles.push([vertex(a, i), vertex(a, i + 1), vertex(b, j)]);
            i += 1;
        } else {
            triangles.push([vertex(a, i), vertex(b, j + 1), vertex(b, j)]);
            j += 1;
        }
    }
}

/// The profile with its corners kept and points about `spacing` apart between them, closer on tight bends.
fn resampled(profile: &Profile, spacing: f64) -> Vec<[f64; 2]> {
    let kept = thinned(profile, spacing);
    let mut points = Vec::new();
    let count = if profile.is_loop {
        kept.len()
    } else {
        kept.len() - 1
    };
    for k in 0..count {
        let (a, b) = (kept[k], kept[(k + 1) % kept.len()]);
        let pieces = (distance(a, b) / spacing).round().max(1.0) as usize;
        points.extend((0..pieces).map(|piece| {
            let t = piece as f64 / pieces as f64;
            [a[0] + (b[0] - a[0]) * t, a[1] + (b[1] - a[1]) * t]
        }));
    }
    if !profile.is_loop {
        points.push(kept[kept.len() - 1]);
    }
    points
}

/// The points of a profile that must stay: ends, corners, and one where the path has gone on for `spacing`
/// or turned by 0.3 rad since the last.
fn thinned(profile: &Profile, spacing: f64) -> Vec<[f64; 2]> {
    let points = &profile.points;
    let mut kept = vec![points[0]];
    let (mut run, mut turned) = (0.0, 0.0_f64);
    for k in 1..points.len() {
        let is_last = k + 1 == points.len();
        let bend = match is_last {
            true => 1.0,
            false => cosine(points[k - 1], points[k], points[k + 1]),
        };
        run += distance(points[k - 1], points[k]);
        turned += bend.clamp(-1.0, 1.0).acos();
        let is_end = is_last && !profile.is_loop;
        if is_end || bend < CORNER || run >= spacing || turned > 0.3 {
            kept.push(points[k]);
            (run, turned) = (0.0, 0.0);
        }
    }
    kept
}

fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    (b[0] - a[0]).hypot(b[1] - a[1])
}

/// Cosine of the angle by which the path turns at `b`.
fn cosine(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> f64 {
    let (u, v) = ([b[0] - a[0], b[1] - a[1]], [c[0] - b[0], c[1] - b[1]]);
    (u[0] * v[0] + u[1] * v[1]) / (u[0].hypot(u[1]) * v[0].hypot(v[1]))
}
