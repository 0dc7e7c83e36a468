//! A convex body with leaning sides: a pentagon at the bottom, a smaller and shifted one on top, and planes between
//! them.

use super::revolve::{Ring, zip};
use nalgebra::{Point2, Point3};
use scand_core::mesh::Mesh;
use std::f64::consts::TAU;

const SIDES: u32 = 5;
/// Radius of the lower pentagon's corners and the body's height, in metres.
const RADIUS: f64 = 0.048;
const HEIGHT: f64 = 0.062;
/// Size of the upper pentagon against the lower one, and where its middle is: each side leans by another angle.
const UPPER: f64 = 0.72;
const MOVED: [f64; 2] = [0.007, -0.004];

/// The body, of triangles with edges of about `spacing` metres.
pub(super) fn prism(spacing: f64) -> Mesh {
    let mut mesh = Mesh::default();
    let steps = |length: f64| (length / spacing).ceil().max(1.0) as u32;
    let share = |k: u32, n: u32| f64::from(k) / f64::from(n);
    let across = steps(RADIUS);
    let below = (0..across).map(|k| (share(k, across), 0.0));
    let up = steps(HEIGHT);
    let beside = (0..=up).map(|k| (1.0, share(k, up)));
    let above = (0..across).rev().map(|k| (share(k, across), 1.0));
    let rings: Vec<Ring> = below
        .chain(beside)
        .chain(above)
        .map(|(size, height)| ring(&mut mesh, size, height, spacing))
        .collect();
    for pair in rings.windows(2) {
        zip(&mut mesh.triangles, &pair[0], &pair[1]);
    }
    mesh
}

/// A pentagon's outline at a share of the height, shrunk to `size`; its middle where that is 0. Each side has as many
/// vertices, so that corners meet corners.
fn ring(mesh: &mut Mesh, size: f64, height: f64, spacing: f64) -> Ring {
    let first = mesh.vertices.len() as u32;
    let size = size * (1.0 + (UPPER - 1.0) * height);
    let side = 2.0 * RADIUS * size * (TAU / f64::from(2 * SIDES)).sin();
    let a_side = (side / spacing).ceil().max(1.0) as u32;
    let count = if size == 0.0 { 1 } else { SIDES * a_side };
    for k in 0..count {
        let (from, to) = (corner(k / a_side), corner(k / a_side + 1));
        let on_outline = from + (to - from) * (f64::from(k % a_side) / f64::from(a_side));
        let [x, y] = [0, 1].map(|a| size * on_outline[a] + MOVED[a] * height);
        mesh.vertices
            .push(Point3::new(x, y, HEIGHT * height).cast());
    }
    Ring { first, count }
}

fn corner(k: u32) -> Point2<f64> {
    let angle = TAU * (f64::from(k % SIDES) / f64::from(SIDES) + 0.04);
    Point2::new(RADIUS * angle.cos(), RADIUS * angle.sin())
}
