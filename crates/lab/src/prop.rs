//! A prop: a block in the backdrop's cloth that stands beside an object, as one that holds it up would.

use super::random::Random;
use super::rig::Bounds;
use super::shape::block;
use nalgebra::Vector3;
use scand_core::mesh::Mesh;
use std::f64::consts::TAU;

/// A prop's height over the object's.
const HEIGHT: f64 = 0.6;
/// Metres between the prop and what it nearly touches.
const GAP: f64 = 5e-4;
/// Edge length of its triangles, in metres.
const SPACING: f64 = 0.004;

/// A block of `width` metres that stands on the table, close to the object, in a direction that depends on the seed and
/// the capture.
pub(super) fn beside(object: &Mesh, width: f64, seed: u64, capture: usize) -> Mesh {
    let azimuth = Random::new(&[seed, 22, capture as u64]).between(0.0, TAU);
    let outwards = Vector3::new(azimuth.cos(), azimuth.sin(), 0.0);
    let across = Vector3::new(-azimuth.sin(), azimuth.cos(), 0.0);
    let height = HEIGHT * Bounds::of(object).max.z;
    let points = object.vertices.iter().map(|v| v.coords.cast::<f64>());
    let reached = points
        .filter(|p| p.z < height && p.dot(&across).abs() < width / 2.0 + GAP)
        .map(|p| p.dot(&outwards))
        .fold(0.0, f64::max);
    let middle = outwards * (reached + GAP + width / 2.0);
    let mut mesh = block([width, width, height], azimuth.to_degrees(), SPACING);
    for v in &mut mesh.vertices {
        *v = (v.cast::<f64>() + middle).cast();
    }
    mesh
}
